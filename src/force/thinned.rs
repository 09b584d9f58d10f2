//! Both sides of an axis and its estimate behind one low-pass, looked at once in a few samples.
//!
//! ```text
//!  [a, b, F] --Butterworth, 4th order, f_b--> every n-th --high-pass, 5 Hz--> n = rate / (3 f_b), at most 8
//! ```
//! Mean squares and products of a signal are those of every n-th of its samples, so nothing is lost that is
//! asked for; only what a later filter tells apart must not fold, and from above rate/n - f_b = 2 f_b that
//! comes 24 dB down. Samples are gathered and filtered n at a time, the three at once.
//! Checked by: mean_squares_are_those_of_every_sample.

use super::lane_sections::{LaneSection, filter, lane_sections, settle_sections};
use crate::signal::FilterError;
use crate::signal::butterworth::{Butterworth, Pass};
use crate::signal::dispatch::{Fast, Kernel, run};
use crate::units::SampleRate;

/// Below this neither side is compared.
pub(super) const HIGH_PASS_HZ: f64 = 5.0;

/// Thinned rate over the low-pass.
const RATE_OVER_BAND: f64 = 3.0;
/// Most samples that are gathered.
const MOST: usize = 8;
/// Three signals and an empty place, which makes a vector of them.
const PLACES: usize = 4;

/// Design; immutable.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Thinned {
    low: Butterworth,
    /// Those of the low-pass, then the one of the high-pass.
    sections: Vec<LaneSection<PLACES>>,
    every: u32,
    rate: SampleRate,
    fast: Fast,
}

/// Where it stands; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct SeenThinned {
    gathered: [[f64; PLACES]; MOST],
    count: u32,
    sections: [[[f64; PLACES]; 2]; 3],
    begun: bool,
}

crate::keyframe::keep!(SeenThinned { gathered, count, sections, begun });

impl Thinned {
    /// Up to `band_hz`, but not above 0.3 of the rate. Errors: a band that does not fit the rate.
    pub(super) fn new(band_hz: f64, rate: SampleRate) -> Result<Self, FilterError> {
        let band_hz = band_hz.min(0.3 * rate.hz());
        let low = Butterworth::low_pass(4, band_hz, rate)?;
        let every = (rate.hz() / (RATE_OVER_BAND * band_hz)).floor().clamp(1.0, MOST as f64);
        let hz = rate.hz() / every;
        let not_positive = |_| FilterError::NotPositive { what: "thinned rate in Hz", value: hz };
        let thinned = SampleRate::new(hz).map_err(not_positive)?;
        let high = Butterworth::new(Pass::High, 2, HIGH_PASS_HZ, thinned)?;
        Ok(Self {
            sections: lane_sections(vec![[low.sections(), high.sections()].concat(); PLACES]),
            low,
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 8")]
            every: every as u32,
            rate: thinned,
            fast: Fast::detect(),
        })
    }

    /// The low-pass, through which the noise of the encoders goes too.
    pub(super) fn low_pass(&self) -> &Butterworth {
        &self.low
    }

    /// How often something is looked at.
    pub(super) fn rate(&self) -> SampleRate {
        self.rate
    }

    /// One instant of a, b and F in; at every n-th all three between 5 Hz and the low-pass. N.
    #[inline]
    pub(super) fn step(&self, state: &mut SeenThinned, a: f64, b: f64, force_n: f64) -> Option<[f64; 3]> {
        let now_n = [a, b, force_n, 0.0];
        if !state.begun {
            self.settle(state, now_n);
        }
        if let Some(place) = state.gathered.get_mut(state.count as usize) {
            *place = now_n;
        }
        state.count = state.count.saturating_add(1);
        if state.count < self.every {
            return None;
        }
        state.count = 0;
        let [a, b, force_n, _] = run(self.fast, Look { design: self, state });
        Some([a, b, force_n])
    }

    /// As if it had always been there: a high-pass sees no step.
    #[cold]
    fn settle(&self, state: &mut SeenThinned, now_n: [f64; PLACES]) {
        state.begun = true;
        for (place, x) in now_n.into_iter().enumerate() {
            settle_sections(&self.sections, &mut state.sections, place, x);
        }
    }
}

/// The gathered samples through the low-pass, the last of them through the high-pass.
struct Look<'a> {
    design: &'a Thinned,
    state: &'a mut SeenThinned,
}

impl Kernel for Look<'_> {
    type Output = [f64; PLACES];

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> [f64; PLACES] {
        let SeenThinned { gathered, sections, .. } = self.state;
        let (low, high) = self.design.sections.split_at(self.design.low.sections().len());
        let (of_low, of_high) = sections.split_at_mut(low.len());
        let mut now_n = [0.0; PLACES];
        for gathered_n in gathered.iter().take(self.design.every as usize) {
            now_n = *gathered_n;
            filter::<PLACES, FUSED>(low, of_low, &mut now_n);
        }
        filter::<PLACES, FUSED>(high, of_high, &mut now_n);
        now_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn mean_squares_are_those_of_every_sample() {
        for (rate_hz, every) in [(5000.0, 2), (9000.0, 4), (20_000.0, 8)] {
            let rate = SampleRate::new(rate_hz).unwrap();
            let thinned = Thinned::new(700.0, rate).unwrap();
            assert_eq!(thinned.every, every, "{rate_hz}");
            let mut state = SeenThinned::default();
            let (mut sums, mut seen) = ([0.0; 3], 0.0);
            // A constant, a line in the band beside one beyond it, and one beyond alone.
            for i in 0..(4.0 * rate_hz) as u32 {
                let wave = |hz: f64| (TAU * hz * f64::from(i) / rate_hz).sin();
                let now = [1000.0, 50.0 + wave(333.0) + wave(1903.0), wave(1903.0)];
                let Some(banded) =
                    thinned.step(&mut state, now[0], now[1], now[2]).filter(|_| f64::from(i) > rate_hz)
                else {
                    continue;
                };
                sums.iter_mut().zip(banded).for_each(|(sum, x)| *sum += x * x);
                seen += 1.0;
            }
            let power = |hz: f64| {
                let (re, im) = thinned.low_pass().response(hz);
                0.5 * (re * re + im * im)
            };
            let expected = [0.0, power(333.0) + power(1903.0), power(1903.0)];
            for (sum, expected) in sums.into_iter().zip(expected) {
                assert!((sum / seen - expected).abs() < 1e-3 * expected + 1e-9, "{rate_hz}: {expected}");
            }
        }
    }
}
