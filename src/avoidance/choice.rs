//! Which pitch: eq. (6-10) on the highest tracked line, and what to try if that did not help.

use super::pitch::{PitchError, optimum_pitch_rad};
use crate::units::SpindleSpeed;

/// Most lines that are remembered of a cut.
const LINES: usize = 8;
/// Frequencies that a bar in a lathe can chatter at: longer and thinner than any, to shorter and thicker.
const PLAUSIBLE_HZ: std::ops::RangeInclusive<f64> = 20.0..=20_000.0;
/// Two lines nearer than this are one, drifted.
const SAME_LINE_HZ: f64 = 8.0;

/// Chatter lines heard in this cut, each with when it was heard last.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrackedLines {
    lines: [Option<TrackedLine>; LINES],
}

/// A chatter line of this cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackedLine {
    /// Highest frequency that it had.
    pub highest_hz: f64,
    /// Latest frequency.
    pub frequency_hz: f64,
    /// When it was heard last.
    pub last_s: f64,
}

impl TrackedLines {
    /// Takes a line; the oldest gives way when there is no room.
    pub fn hear(&mut self, frequency_hz: f64, now_s: f64) {
        if !PLAUSIBLE_HZ.contains(&frequency_hz) {
            return;
        }
        let near = |l: &TrackedLine| (l.frequency_hz - frequency_hz).abs() < SAME_LINE_HZ;
        if let Some(line) = self.lines.iter_mut().flatten().find(|l| near(l)) {
            line.frequency_hz = frequency_hz;
            line.highest_hz = line.highest_hz.max(frequency_hz);
            line.last_s = now_s;
            return;
        }
        let age = |l: &Option<TrackedLine>| l.map_or(f64::NEG_INFINITY, |l| l.last_s);
        if let Some(place) = self.lines.iter_mut().min_by(|a, b| age(a).total_cmp(&age(b))) {
            *place = Some(TrackedLine { highest_hz: frequency_hz, frequency_hz, last_s: now_s });
        }
    }

    /// Forgets lines not heard for `keep_s`: bar and cut have changed.
    pub fn forget(&mut self, now_s: f64, keep_s: f64) {
        for place in &mut self.lines {
            if place.is_some_and(|l| now_s - l.last_s > keep_s) {
                *place = None;
            }
        }
    }

    /// The highest frequency: eq. (6-10) on it keeps every lower line's phase at or below pi.
    #[must_use]
    pub fn highest_hz(&self) -> Option<f64> {
        self.lines.iter().flatten().map(|l| l.highest_hz).max_by(f64::total_cmp)
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &TrackedLine> {
        self.lines.iter().flatten()
    }
}

/// Pitch to try as number `attempt` (from 0), by the rule of the thesis.
///
/// First the waves opposed (pi); then 0.85 pi: tests were stable from 0.7 pi to 1.1 pi, below pi more than
/// above (thesis 6.5.2).
/// Errors: as [`optimum_pitch_rad`]. Checked by: `the_second_try_lies_below_pi`.
pub fn pitch_for_attempt_rad(
    spindle: SpindleSpeed,
    highest_hz: f64,
    attempt: u32,
) -> Result<f64, PitchError> {
    let opposed = optimum_pitch_rad(spindle, highest_hz, 0)?;
    Ok(if attempt == 0 { opposed } else { 0.85 * opposed })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_line_counts_and_drift_is_one_line() {
        let mut lines = TrackedLines::default();
        for (f, t) in [(649.0, 0.0), (645.0, 1.0), (612.0, 2.0), (f64::NAN, 2.5)] {
            lines.hear(f, t);
        }
        assert_eq!(lines.iter().count(), 2);
        assert!((lines.highest_hz().unwrap() - 649.0).abs() < 1e-12);
        lines.forget(20.0, 18.5);
        assert!((lines.highest_hz().unwrap() - 612.0).abs() < 1e-12);
    }

    #[test]
    fn the_second_try_lies_below_pi() {
        let spindle = SpindleSpeed::from_rpm(1200.0).unwrap();
        let first = pitch_for_attempt_rad(spindle, 652.0, 0).unwrap();
        let second = pitch_for_attempt_rad(spindle, 652.0, 1).unwrap();
        assert!((first.to_degrees() - 5.52).abs() < 0.01 && second < 0.9 * first);
    }
}
