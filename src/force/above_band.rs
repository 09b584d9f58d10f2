//! How much of an estimate lies above the band in which its method is right within a tenth.
//!
//! ```text
//!  F --5 Hz to low-pass--> total           share = sqrt(<above^2> / <total^2>), memory 2 s
//!                            `--above the band's end--> above
//! ```
//! For methods whose band ends before the low-pass does: `thrust` (the loop), `dob` (the axial mode), sums of
//! both sides behind a low-pass of the drive side. What encoder steps make of it is taken off.
//! Checked by: force_flags::a_force_above_the_usable_band_is_flagged.

use super::stiffness_learner::{HIGH_PASS_HZ, MEMORY_S};
use crate::signal::FilterError;
use crate::signal::butterworth::{Butterworth, ButterworthState, Pass};
use crate::units::SampleRate;

/// Share of the deviation from which on it is said.
const LEAST_SHARE: f64 = 1.0 / 3.0;
/// Seen for so long at least, s.
const LEAST_S: f64 = 0.5;

/// Design; immutable.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct AboveBand {
    high: Butterworth,
    low: Butterworth,
    end: Butterworth,
    forget: f64,
    least_weight: f64,
}

/// What has been seen; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct SeenAbove {
    high: ButterworthState,
    low: ButterworthState,
    end: ButterworthState,
    total_n2: f64,
    above_n2: f64,
    weight: f64,
    begun: bool,
}

crate::keyframe::keep!(SeenAbove { high, low, end, total_n2, above_n2, weight, begun });

impl AboveBand {
    /// For a method that is right up to `end_hz` behind a low-pass at `low_pass_hz`; `None` where that is all
    /// of it, or hardly anything. Errors: frequencies that do not fit the rate.
    pub(super) fn new(end_hz: f64, low_pass_hz: f64, rate: SampleRate) -> Result<Option<Self>, FilterError> {
        let low_pass_hz = low_pass_hz.min(0.3 * rate.hz());
        if end_hz >= 0.9 * low_pass_hz || low_pass_hz <= 2.0 * HIGH_PASS_HZ {
            return Ok(None);
        }
        let end_hz = end_hz.max(HIGH_PASS_HZ);
        Ok(Some(Self {
            high: Butterworth::new(Pass::High, 2, HIGH_PASS_HZ, rate)?,
            low: Butterworth::low_pass(4, low_pass_hz, rate)?,
            end: Butterworth::new(Pass::High, 4, end_hz, rate)?,
            forget: (-1.0 / (MEMORY_S * rate.hz())).exp(),
            least_weight: LEAST_S * rate.hz(),
        }))
    }

    /// One estimate before its low-pass, N; `noise_n`: what encoder steps make of it. True where too much of
    /// it lies above the band.
    #[inline]
    pub(super) fn step(&self, state: &mut SeenAbove, force_n: f64, (noise_n, counts): (f64, bool)) -> bool {
        if !std::mem::replace(&mut state.begun, true) {
            state.high = self.high.settled(force_n);
        }
        let total_n = self.low.step(&mut state.low, self.high.step(&mut state.high, force_n));
        let above_n = self.end.step(&mut state.end, total_n);
        if counts {
            let mean = |old: f64, new: f64| self.forget * old + new;
            state.total_n2 = mean(state.total_n2, total_n * total_n);
            state.above_n2 = mean(state.above_n2, above_n * above_n);
            state.weight = mean(state.weight, 1.0);
        }
        let noise_n2 = noise_n * noise_n * state.weight;
        // Below three times the noise nothing is a force.
        state.weight > self.least_weight
            && state.above_n2 > 9.0 * noise_n2
            && state.above_n2 - noise_n2 > LEAST_SHARE * LEAST_SHARE * (state.total_n2 - noise_n2)
    }
}
