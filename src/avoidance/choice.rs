//! The lines of a cut, how they grew, and the pitch that eq. (6-10) makes of the highest of them: the rule of
//! the thesis, for when the cut cannot be identified (`best_pitch`).

use super::identified::HeardLine;
use super::pitch::{PitchError, optimum_pitch_rad};
use crate::chatter::SAME_LINE_HZ;
use crate::keyframe::keep;
use crate::units::SpindleSpeed;

/// Most lines that are remembered of a cut.
const LINES: usize = 8;
/// Frequencies that a bar in a lathe can chatter at: longer and thinner than any, to shorter and thicker.
const PLAUSIBLE_HZ: std::ops::RangeInclusive<f64> = 20.0..=20_000.0;
/// A line is the same one where it is heard at the same pitch, rad.
const SAME_PITCH_RAD: f64 = 0.01;

/// Chatter lines heard in this cut, each with when it was heard last.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrackedLines {
    lines: [Option<TrackedLine>; LINES],
}

/// A chatter line of this cut.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrackedLine {
    /// Highest frequency that it had.
    pub highest_hz: f64,
    /// Latest frequency, with growth, speed and pitch.
    pub heard: HeardLine,
    /// When it was heard last.
    pub last_s: f64,
}

keep!(TrackedLine { highest_hz, heard, last_s });
keep!(TrackedLines { lines });
keep!(GrowthMeter { looks, seen } if |m| m.seen <= LOOKS);

impl TrackedLines {
    /// Takes a line; the oldest gives way when there is no room.
    pub fn hear(&mut self, heard: &HeardLine, now_s: f64) {
        if !PLAUSIBLE_HZ.contains(&heard.frequency_hz) {
            return;
        }
        let near = |l: &TrackedLine| {
            (l.heard.frequency_hz - heard.frequency_hz).abs() < SAME_LINE_HZ
                && (l.heard.pitch_rad - heard.pitch_rad).abs() < SAME_PITCH_RAD
        };
        if let Some(line) = self.lines.iter_mut().flatten().find(|l| near(l)) {
            // The growth is that of the first tenths of a second; later the line stands.
            line.heard = HeardLine { growth_1_s: line.heard.growth_1_s.or(heard.growth_1_s), ..*heard };
            line.highest_hz = line.highest_hz.max(heard.frequency_hz);
            line.last_s = now_s;
            return;
        }
        let age = |l: &Option<TrackedLine>| l.map_or(f64::NEG_INFINITY, |l| l.last_s);
        if let Some(place) = self.lines.iter_mut().min_by(|a, b| age(a).total_cmp(&age(b))) {
            *place = Some(TrackedLine { highest_hz: heard.frequency_hz, heard: *heard, last_s: now_s });
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

    /// What was heard, the newest first.
    #[must_use]
    pub fn newest_first(&self) -> Vec<HeardLine> {
        let mut lines: Vec<&TrackedLine> = self.iter().collect();
        lines.sort_by(|a, b| b.last_s.total_cmp(&a.last_s));
        lines.into_iter().map(|l| l.heard).collect()
    }
}

/// Looks at the power of a line that appears.
const LOOKS: usize = 32;
/// Between two of them.
const LOOK_S: f64 = 0.01;
/// Looks over which growth is taken.
const SPAN: usize = 9;

/// How fast a line grew while it appeared: the steepest stretch of ln(power)/2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GrowthMeter {
    looks: [(f64, f64); LOOKS],
    seen: usize,
}

impl Default for GrowthMeter {
    fn default() -> Self {
        Self { looks: [(f64::NEG_INFINITY, 0.0); LOOKS], seen: 0 }
    }
}

impl GrowthMeter {
    /// Takes the power of the strongest line, N^2.
    pub fn look(&mut self, now_s: f64, power_n2: f64) {
        let known = self.seen < LOOKS && power_n2.is_finite() && power_n2 > 0.0;
        let last_s = self.seen.checked_sub(1).map_or(f64::NEG_INFINITY, |i| self.looks[i].0);
        if known && now_s - last_s >= LOOK_S {
            self.looks[self.seen] = (now_s, 0.5 * power_n2.ln());
            self.seen += 1;
        }
    }

    /// Growth of the amplitude, 1/s, once enough was seen. Checked by: `growth_before_it_saturates`.
    #[must_use]
    pub fn growth_1_s(&self) -> Option<f64> {
        let slope = |part: &[(f64, f64)]| {
            let n = part.len() as f64;
            let (t, y) = part.iter().fold((0.0, 0.0), |(t, y), p| (t + p.0 / n, y + p.1 / n));
            let cross: f64 = part.iter().map(|p| (p.0 - t) * (p.1 - y)).sum();
            let square: f64 = part.iter().map(|p| (p.0 - t).powi(2)).sum();
            cross / square.max(1e-9)
        };
        self.looks[..self.seen].windows(SPAN).map(slope).max_by(f64::total_cmp)
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

/// A speed that a lathe's spindle can have while it cuts: 10 to 100 000 rpm, either way round.
#[must_use]
pub fn plausible_speed(rpm: f64) -> Option<SpindleSpeed> {
    let rpm = rpm.abs();
    if (10.0..=100_000.0).contains(&rpm) { SpindleSpeed::from_rpm(rpm).ok() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_highest_line_counts_and_drift_is_one_line() {
        let mut lines = TrackedLines::default();
        let line =
            |frequency_hz, pitch_rad| HeardLine { frequency_hz, growth_1_s: None, turn_s: 0.05, pitch_rad };
        for (f, t) in [(649.0, 0.0), (645.0, 1.0), (612.0, 2.0), (f64::NAN, 2.5)] {
            lines.hear(&line(f, 0.0), t);
        }
        assert_eq!(lines.iter().count(), 2);
        assert!((lines.highest_hz().unwrap() - 649.0).abs() < 1e-12);
        lines.forget(20.0, 18.5);
        assert!((lines.highest_hz().unwrap() - 612.0).abs() < 1e-12);
        lines.hear(&line(612.0, 0.09), 3.0);
        assert_eq!(lines.newest_first().first().map(|l| l.pitch_rad), Some(0.09));
    }

    #[test]
    fn growth_before_it_saturates() {
        let mut meter = GrowthMeter::default();
        assert_eq!(meter.growth_1_s(), None);
        for k in 0..300 {
            let t = f64::from(k) * 1e-3;
            meter.look(t, (1e-3 * (30.0 * t).exp()).min(0.1).powi(2));
        }
        assert!((meter.growth_1_s().unwrap() - 30.0).abs() < 0.5, "{:?}", meter.growth_1_s());
    }

    #[test]
    fn the_second_try_lies_below_pi() {
        let spindle = SpindleSpeed::from_rpm(1200.0).unwrap();
        let first = pitch_for_attempt_rad(spindle, 652.0, 0).unwrap();
        let second = pitch_for_attempt_rad(spindle, 652.0, 1).unwrap();
        assert!((first.to_degrees() - 5.52).abs() < 0.01 && second < 0.9 * first);
    }
}
