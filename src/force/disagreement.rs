//! How far two estimates of one force are apart while both run.

use super::band::NOISE_RATIO;
use super::motion::ForceEstimate;
use super::validity::{Properties, Validity};
use crate::signal::harmonic_fit::LongLine;
use crate::units::SampleRate;

/// Over which it is averaged, s.
const AVERAGE_S: f64 = 1.0;

/// Two estimates of one axis beside each other, each taken at its own lag, the means off: accelerometers and
/// spectral lines do not see a mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Disagreement {
    first: LongLine,
    second: LongLine,
    delays_s: [f64; 2],
    memory: f64,
    noise_n: f64,
    state: Moments,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Moments {
    /// Mean and mean square of the difference, then of the first estimate.
    difference: [f64; 2],
    first: [f64; 2],
    settling: usize,
    begun: bool,
}

crate::keyframe::keep!(Moments { difference, first, settling, begun });
crate::keyframe::keep!(Disagreement { first, second, memory, noise_n, delays_s, state });

impl Disagreement {
    /// For two estimators that state these lags and noise floors.
    #[must_use]
    pub fn new(pair: [Properties; 2], rate: SampleRate) -> Self {
        let mut made = Self {
            first: LongLine::roomy(1, 0.0),
            second: LongLine::roomy(1, 0.0),
            delays_s: [0.0; 2],
            memory: (-rate.period_s() / AVERAGE_S).exp(),
            noise_n: 0.0,
            state: Moments::default(),
        };
        made.begin(pair, rate);
        made
    }

    /// Begins anew where the estimators have other lags or noise floors than before (a window that follows
    /// the spindle). No allocation up to windows of
    /// [`LONGEST_WINDOW`](crate::signal::harmonic_fit::LONGEST_WINDOW).
    pub fn begin(&mut self, pair: [Properties; 2], rate: SampleRate) {
        let delays_s = pair.map(|p| p.delay_s);
        let largest_s = delays_s[0].max(delays_s[1]);
        // What is early waits for what is late.
        let length = |delay_s: f64| ((largest_s - delay_s) * rate.hz()).round() as usize + 1;
        self.first.refill(length(delays_s[0]), 0.0);
        self.second.refill(length(delays_s[1]), 0.0);
        self.delays_s = delays_s;
        self.noise_n = pair[0].noise_floor_n.hypot(pair[1].noise_floor_n);
        self.state = Moments { settling: self.longest(), ..Moments::default() };
    }

    /// One estimate of each. Answers [`Validity::ESTIMATORS_DISAGREE`] where they do.
    ///
    /// They do when the deviation of their difference is above three times what encoder steps explain and
    /// above half of the deviation of the first.
    pub fn step(&mut self, first: ForceEstimate, second: ForceEstimate) -> Validity {
        self.first.push(first.force_n);
        self.second.push(second.force_n);
        let unusable = Validity::SETTLING | Validity::SIGNAL_MISSING;
        if (first.flags | second.flags).shares(unusable) {
            self.state.settling = self.longest();
            return Validity::VALID;
        }
        let state = &mut self.state;
        if state.settling > 0 {
            state.settling -= 1;
            return Validity::VALID;
        }
        let (a, b) = (self.first.oldest(), self.second.oldest());
        // The first values are the averages that everything later starts from.
        let memory = if std::mem::replace(&mut state.begun, true) { self.memory } else { 0.0 };
        let follow = |moments: &mut [f64; 2], x: f64| {
            moments[0] = x + memory * (moments[0] - x);
            moments[1] = x * x + memory * (moments[1] - x * x);
        };
        follow(&mut state.difference, a - b);
        follow(&mut state.first, a);
        let apart_n = deviation_n(self.state.difference);
        let disagree = apart_n > NOISE_RATIO * self.noise_n && apart_n > 0.5 * deviation_n(self.state.first);
        Validity::when(disagree, Validity::ESTIMATORS_DISAGREE)
    }

    fn longest(&self) -> usize {
        self.first.len().max(self.second.len())
    }

    /// Whether it was made for estimators with these lags.
    #[must_use]
    pub fn fits(&self, pair: [Properties; 2]) -> bool {
        self.delays_s.map(f64::to_bits) == pair.map(|p| p.delay_s.to_bits())
    }

    /// Standard deviation of the difference over about the last second, N; `None` until both have settled.
    #[must_use]
    pub fn deviation_n(&self) -> Option<f64> {
        self.state.begun.then(|| deviation_n(self.state.difference))
    }
}

fn deviation_n([mean, square]: [f64; 2]) -> f64 {
    (square - mean * mean).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(delays_s: [f64; 2], noise_floor_n: f64) -> [Properties; 2] {
        delays_s.map(|delay_s| Properties { delay_s, noise_floor_n, ..Properties::default() })
    }

    fn estimate(force_n: f64, flags: Validity) -> ForceEstimate {
        ForceEstimate { force_n, flags }
    }

    #[test]
    fn two_lags_of_one_force_agree_and_another_force_does_not() {
        let rate = SampleRate::new(1000.0).unwrap();
        let wave = |i: i32| 30.0 * (0.3 * f64::from(i)).sin();
        for (other, expected) in [(1.0, false), (-1.0, true)] {
            let mut apart = Disagreement::new(pair([0.005, 0.012], 0.1), rate);
            let mut last = Validity::VALID;
            for i in 0..5000 {
                let second = other * wave(i - 12) + 7.0;
                last = apart.step(estimate(wave(i - 5), Validity::VALID), estimate(second, Validity::VALID));
            }
            let apart_n = apart.deviation_n().unwrap();
            assert_eq!(last.contains(Validity::ESTIMATORS_DISAGREE), expected, "{apart_n}");
            // Twice a wave of 30 N: 60/sqrt(2).
            let expected_n = if expected { 60.0 / 2f64.sqrt() } else { 0.0 };
            assert!((apart_n - expected_n).abs() < 0.5, "{apart_n}");
        }
    }

    #[test]
    fn what_settles_says_nothing() {
        let mut apart = Disagreement::new(pair([0.0, 0.0], 0.0), SampleRate::new(1000.0).unwrap());
        for i in 0..100 {
            let settling = estimate(f64::from(i), Validity::SETTLING);
            assert!(apart.step(settling, estimate(0.0, Validity::VALID)).is_valid());
        }
        assert_eq!(apart.deviation_n(), None);
    }
}
