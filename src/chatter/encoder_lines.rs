//! Lines that the steps of an axis' encoders draw into its force: a travel at v over steps of d makes lines
//! at v/d and its multiples (thesis 2.4: a step is felt as a force by every observer that differentiates).

use super::criteria::{CRITERIA, WINDOWS};
use crate::keyframe::keep;

/// Multiples that are looked at: a step's share of them falls with the number.
const MULTIPLES: u32 = 3;
/// Slices that are remembered: those that the longest window hears, and the one that fills.
const KEPT: usize = WINDOWS[WINDOWS.len() - 1] / WINDOWS[0] + 1;

/// How an axis travelled, in slices as long as the shortest window.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct EncoderLines {
    started: bool,
    since_s: f64,
    /// Of motor and stage encoder, in steps.
    from: [f64; 2],
    /// Steps a second, mean of each slice, newest first.
    rates_hz: [[f64; KEPT]; 2],
}

keep!(EncoderLines { started, since_s, from, rates_hz });

impl EncoderLines {
    fn slice_s() -> f64 {
        WINDOWS[0] as f64 / CRITERIA.rate_hz
    }

    /// Takes where motor and stage stand, in steps of their encoders; an encoder that is not known stands.
    pub(super) fn step(&mut self, at: [f64; 2], period_s: f64) {
        if !std::mem::replace(&mut self.started, true) {
            self.from = at;
        }
        self.since_s += period_s;
        if self.since_s < Self::slice_s() {
            return;
        }
        for ((rates, from), at) in self.rates_hz.iter_mut().zip(&mut self.from).zip(at) {
            rates.rotate_right(1);
            rates[0] = (at - *from).abs() / self.since_s;
            *from = at;
        }
        self.since_s = 0.0;
    }

    /// Whether steps drew a line at this frequency within the last so many values of the band: one that
    /// moves on faster than a slice resolves draws none.
    pub(super) fn draw(&self, hz: f64, values: usize) -> bool {
        let slices = (values / WINDOWS[0] + 1).min(KEPT);
        let near = |rate_hz: &f64| {
            (1..=MULTIPLES).any(|k| (f64::from(k) * rate_hz - hz).abs() * Self::slice_s() < 1.0)
        };
        self.rates_hz.iter().any(|rates| rates[..slices].iter().any(near))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_travel_draws_a_line_while_a_window_hears_it_and_a_sweep_or_a_stand_draws_none() {
        let (period_s, step_m) = (1.0 / 9000.0, 37.5e-9);
        let said = |speed_m_s: &dyn Fn(f64) -> f64, hz: f64| {
            let (mut lines, mut at_m, mut said) = (EncoderLines::default(), 0.0, Vec::new());
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
        assert!(said(&|_| 9.1e-6, 485.0) > 0.9, "its second multiple");
        assert!(said(&|_| 0.0, 485.0) == 0.0);
        assert!(said(&|t| 300e-6 * t, 485.0) < 0.2, "8000 Hz/s");
    }
}
