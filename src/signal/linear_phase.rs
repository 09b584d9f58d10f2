//! Low-pass with the same delay at every frequency: windowed-sinc FIR of odd length.

use super::{FilterError, check_frequency};
use crate::units::SampleRate;
use std::f64::consts::PI;

/// A designed FIR low-pass: symmetric weights, delay of exactly `half_length` samples.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearPhase {
    /// One half and the middle: weights\[0\] is the middle.
    weights: Vec<f64>,
}

/// The samples that a [`LinearPhase`] still needs.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearPhaseState {
    /// Each sample twice, so that the window lies in one piece.
    values: Vec<f64>,
    head: usize,
}

crate::keyframe::keep!(LinearPhaseState { values, head } if |s| s.head < s.values.len() / 2);

impl LinearPhase {
    /// A low-pass that is flat below `pass_hz` and falls over `width_hz` to -70 dB.
    ///
    /// Kaiser window: beta = 0.1102 (A - 8.7), taps = (A - 7.95) / (2.285 * 2 pi width / rate), A = 70 dB.
    /// Errors: the band does not fit below half the rate.
    /// Source: Kaiser (1974). Checked by: flat_then_dark.
    pub fn low_pass(pass_hz: f64, width_hz: f64, rate: SampleRate) -> Result<Self, FilterError> {
        const ATTENUATION_DB: f64 = 70.0;
        let nyquist_hz = rate.hz() / 2.0;
        check_frequency("pass band", pass_hz, nyquist_hz)?;
        check_frequency("transition band", width_hz, nyquist_hz)?;
        check_frequency("end of the transition band", pass_hz + width_hz / 2.0, nyquist_hz)?;
        let beta = 0.1102 * (ATTENUATION_DB - 8.7);
        let taps = (ATTENUATION_DB - 7.95) / (2.285 * 2.0 * PI * width_hz / rate.hz());
        let half = (taps / 2.0).ceil() as usize;
        let cutoff = (pass_hz + width_hz / 2.0) / rate.hz();
        let mut weights: Vec<f64> = (0..=half)
            .map(|k| {
                let (x, u) = (k as f64, k as f64 / (half as f64 + 1.0));
                let sinc = if k == 0 { 2.0 * cutoff } else { (2.0 * PI * cutoff * x).sin() / (PI * x) };
                sinc * bessel_i0(beta * (1.0 - u * u).sqrt()) / bessel_i0(beta)
            })
            .collect();
        let sum = 2.0 * weights.iter().skip(1).sum::<f64>() + weights[0];
        weights.iter_mut().for_each(|w| *w /= sum);
        Ok(Self { weights })
    }

    /// Delay in samples.
    #[must_use]
    pub fn half_length(&self) -> usize {
        self.weights.len() - 1
    }

    /// State that has always seen `x`.
    #[must_use]
    pub fn settled(&self, x: f64) -> LinearPhaseState {
        LinearPhaseState { values: vec![x; 2 * (2 * self.half_length() + 1)], head: 0 }
    }

    /// Settles a state anew. No allocation.
    pub fn settle(&self, state: &mut LinearPhaseState, x: f64) {
        state.values.fill(x);
        state.head = 0;
    }

    /// One sample. Cost: one multiply per two samples of length; no allocation.
    #[inline]
    #[must_use]
    pub fn step(&self, state: &mut LinearPhaseState, x: f64) -> f64 {
        let half = self.half_length();
        let length = 2 * half + 1;
        state.head = if state.head == 0 { length - 1 } else { state.head - 1 };
        state.values[state.head] = x;
        state.values[state.head + length] = x;
        let window = &state.values[state.head..state.head + length];
        let (young, rest) = window.split_at(half);
        let (middle, old) = (rest[0], &rest[1..]);
        let pairs = young.iter().rev().zip(old).zip(&self.weights[1..]);
        self.weights[0] * middle + pairs.map(|((a, b), w)| w * (a + b)).sum::<f64>()
    }

    /// Sum of the squares of what comes out for a short input: cost of one product per weight and sample.
    #[must_use]
    pub fn energy(&self, input: &[f64]) -> f64 {
        let half = self.half_length() as isize;
        let weight = |k: isize| self.weights.get((k - half).unsigned_abs()).copied().unwrap_or(0.0);
        let taps = 2 * half + 1;
        let out = |i: isize| {
            let products = input.iter().enumerate().map(|(j, x)| (i - j as isize, x));
            products.filter(|(k, _)| (0..taps).contains(k)).map(|(k, x)| x * weight(k)).sum::<f64>()
        };
        (0..taps + input.len() as isize).map(|i| out(i).powi(2)).sum()
    }

    /// Gain at a frequency (the phase is that of the delay).
    #[must_use]
    pub fn gain(&self, frequency_hz: f64, rate: SampleRate) -> f64 {
        let w = 2.0 * PI * frequency_hz / rate.hz();
        self.weights[0]
            + 2.0
                * self.weights.iter().enumerate().skip(1).map(|(k, h)| h * (w * k as f64).cos()).sum::<f64>()
    }
}

/// Modified Bessel function of order zero, by its power series; terms fall fast for the |x| < 10 used here.
fn bessel_i0(x: f64) -> f64 {
    let q = x * x / 4.0;
    let (mut term, mut sum) = (1.0, 1.0);
    for k in 1..60 {
        term *= q / f64::from(k * k);
        sum += term;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flat_then_dark() {
        let rate = SampleRate::new(10_000.0).unwrap();
        let filter = LinearPhase::low_pass(800.0, 400.0, rate).unwrap();
        for f in [0.0, 100.0, 500.0, 799.0] {
            assert!((filter.gain(f, rate) - 1.0).abs() < 1e-3, "{f}: {}", filter.gain(f, rate));
        }
        for f in [1201.0, 2000.0, 4999.0] {
            assert!(filter.gain(f, rate).abs() < 1e-3, "{f}: {}", filter.gain(f, rate));
        }
    }

    #[test]
    fn a_step_arrives_half_way_after_the_delay() {
        let rate = SampleRate::new(10_000.0).unwrap();
        let filter = LinearPhase::low_pass(500.0, 500.0, rate).unwrap();
        let mut state = filter.settled(0.0);
        let y: Vec<f64> = (0..200).map(|_| filter.step(&mut state, 1.0)).collect();
        let half = filter.half_length();
        assert!((0.5 * (y[half] + y[half - 1]) - 0.5).abs() < 1e-9);
    }
}
