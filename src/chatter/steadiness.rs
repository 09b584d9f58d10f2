//! Whether a line stands still. Chatter holds its frequency from its growth on, and its amplitude once it is
//! grown; what a hit or a burst leaves behind wanders from lobe to lobe, and noise that a lobe colours swells
//! and fades as its bandwidth says.

use super::detector::{BANKS, BankEvidence, PLACED};

/// A line that moves farther than this is another: the filter's bandwidth, times tau.
const APART: f64 = 0.25;
/// Over learned noise: less is noise that lasts.
const STANDS_OUT: f64 = 12.0;
/// Of each decision in the mean of the power: 0.6 s.
const SHARE: f64 = 0.0067;
/// Variance over the square of the mean. Noise has 1; over the 1.2 s that the mean is of, five to eight
/// independent looks.
const STEADY: f64 = 0.06;
/// How long a line must have been there.
const LASTS_S: f64 = 1.0;
/// A line is watched from here on, and no longer than this.
const SEEN_S: f64 = 0.05;
const UNDECIDED_S: f64 = 2.0;
/// It may drift with speed and tools: of each decision in the place of the line, 0.15 s.
const FOLLOWS: f64 = 0.027;

/// What is remembered of the lines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Steadiness {
    /// Frequency of each bank's line and since when it is there.
    held: [(f64, f64); BANKS],
    line_hz: f64,
    since_s: f64,
    mean_n2: f64,
    square_n4: f64,
}

crate::keyframe::keep!(Steadiness { held, line_hz, since_s, mean_n2, square_n4 });

impl Steadiness {
    pub(super) const NEW: Self =
        Self { held: [(0.0, 0.0); BANKS], line_hz: 0.0, since_s: 0.0, mean_n2: 0.0, square_n4: 0.0 };

    /// Takes the lines of one decision.
    pub(super) fn look(&mut self, t_s: f64, banks: &[BankEvidence; BANKS], on_order: bool) {
        for (held, bank) in self.held.iter_mut().zip(banks) {
            if (bank.frequency_hz - held.0).abs() * bank.tau_s > APART {
                *held = (bank.frequency_hz, t_s);
            }
        }
        let bank = &banks[PLACED];
        let away_hz = bank.frequency_hz - self.line_hz;
        let power = bank.power_n2;
        if bank.contrast < STANDS_OUT || on_order || away_hz.abs() * bank.tau_s > APART {
            (self.line_hz, self.since_s) = (bank.frequency_hz, t_s);
            (self.mean_n2, self.square_n4) = (power, power * power);
            return;
        }
        self.line_hz += away_hz * FOLLOWS;
        self.mean_n2 += (power - self.mean_n2) * SHARE;
        self.square_n4 += (power * power - self.square_n4) * SHARE;
    }

    /// How long the line of a bank has stood where it is.
    pub(super) fn held_s(&self, bank: usize, t_s: f64) -> f64 {
        t_s - self.held[bank].1
    }

    /// Whether a line stands out that may yet prove steady: it must not be learned as noise meanwhile.
    pub(super) fn watches(&self, t_s: f64) -> bool {
        (SEEN_S..UNDECIDED_S).contains(&(t_s - self.since_s))
    }

    /// Whether a line has stood out long enough, and steadily enough, that it is no noise.
    pub(super) fn steady(&self, t_s: f64) -> bool {
        let square = self.mean_n2 * self.mean_n2;
        t_s - self.since_s > LASTS_S && self.square_n4 - square < STEADY * square
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bank(frequency_hz: f64, power_n2: f64) -> BankEvidence {
        BankEvidence { tau_s: 0.05, frequency_hz, power_n2, contrast: 30.0, ..BankEvidence::default() }
    }

    fn steady_at(power: impl Fn(u32) -> f64, frequency: impl Fn(u32) -> f64) -> Option<f64> {
        let mut steadiness = Steadiness::NEW;
        (0..1000).map(|k| (k, 0.004 * f64::from(k))).find_map(|(k, t_s)| {
            steadiness.look(t_s, &[bank(frequency(k), power(k)); BANKS], false);
            steadiness.steady(t_s).then_some(t_s)
        })
    }

    #[test]
    fn a_line_that_stays_is_steady_and_one_that_swells_or_wanders_is_not() {
        let ripple = |k: u32| 4.0 + 0.5 * (0.3 * f64::from(k)).sin();
        let drift = |k: u32| 650.0 - 0.012 * f64::from(k); // 3 Hz/s, as a speed ramp moves it
        assert!((1.0..1.1).contains(&steady_at(ripple, drift).unwrap()));
        // Noise through a lobe: its power has the distribution of an exponential.
        let noise = |k: u32| -(0.01 + 0.98 * (f64::from(k / 30) * 0.618).fract()).ln();
        assert_eq!(steady_at(noise, |_| 650.0), None);
        assert_eq!(steady_at(ripple, |k| 650.0 + 15.0 * f64::from(k / 100 % 2)), None);
    }
}
