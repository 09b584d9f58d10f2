//! Lines that the steps of an axis' encoders draw into its force: the error of a step, which an observer
//! differentiates (Hayashi et al., IV, take it as white), repeats v/d times a second at a travel of v over
//! steps of d.

use super::criteria::{CRITERIA, LONGEST, WINDOWS};
use crate::keyframe::keep;

/// A slice is as long as the shortest window, and begins so many times in its length.
const BEGINS: usize = 4;
/// Places that are remembered: those that the longest window hears, and a slice before it.
const KEPT: usize = BEGINS * (LONGEST / WINDOWS[0] + 1) + 1;

/// Where an axis stood, again and again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct EncoderLines {
    since_s: f64,
    /// Of motor and stage encoder, in steps, newest first.
    places: [[f64; KEPT]; 2],
    /// How many of them there are.
    seen: usize,
}

keep!(EncoderLines { since_s, places, seen } if |lines| lines.seen <= KEPT);

impl EncoderLines {
    pub(super) const NONE: Self = Self { since_s: 0.0, places: [[0.0; KEPT]; 2], seen: 0 };

    fn slice_s() -> f64 {
        WINDOWS[0] as f64 / CRITERIA.rate_hz
    }

    /// Takes where motor and stage stand, in steps of their encoders; an encoder that is not known stands.
    pub(super) fn step(&mut self, at: [f64; 2], period_s: f64) {
        self.since_s += period_s;
        let between_s = Self::slice_s() / BEGINS as f64;
        if self.since_s < between_s && self.seen > 0 {
            return;
        }
        self.since_s = if self.seen > 0 { self.since_s - between_s } else { 0.0 };
        self.seen = (self.seen + 1).min(KEPT);
        for (places, at) in self.places.iter_mut().zip(at) {
            places.rotate_right(1);
            places[0] = at;
        }
    }

    /// Whether steps drew a line at this frequency, within half of what a slice resolves, in the last so many
    /// values of the band: one that moves on faster draws none.
    pub(super) fn draw(&self, hz: f64, values: usize) -> bool {
        let kept = (BEGINS * (values / WINDOWS[0] + 1) + 1).min(self.seen);
        let near = |steps: f64| (steps.abs() - hz * Self::slice_s()).abs() < 0.5;
        self.places.iter().any(|places| {
            let ends = places[..kept].iter().skip(BEGINS);
            places.iter().zip(ends).any(|(to, from)| near(to - from))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_travel_draws_a_line_while_a_window_hears_it_and_a_sweep_or_a_stand_draws_none() {
        let (period_s, step_m) = (1.0 / 9000.0, 37.5e-9);
        let said = |speed_m_s: &dyn Fn(f64) -> f64, hz: f64| {
            let (mut lines, mut at_m, mut said) = (EncoderLines::NONE, 0.0, Vec::new());
            for k in 0..9000 {
                at_m += speed_m_s(f64::from(k) * period_s) * period_s;
                lines.step([0.0, at_m / step_m], period_s);
                said.push(lines.draw(hz, WINDOWS[0]));
            }
            said.iter().filter(|said| **said).count() as f64 / 9000.0
        };
        // 18.2 um/s over steps of 37.5 nm: 485 Hz.
        let moves = |t: f64| if t < 0.5 { 18.2e-6 } else { 0.0 };
        let share = said(&moves, 485.0);
        assert!(share > 0.4 && share < 0.6, "{share}");
        assert!(said(&|_| 18.2e-6, 560.0) == 0.0);
        assert!(said(&|_| 0.0, 485.0) == 0.0);
        assert!(said(&|t| 300e-6 * t, 485.0) < 0.2, "8000 Hz/s");
    }
}
