//! How much of an estimate lies above the band in which its method is right within a tenth.
//!
//! ```text
//!  F --5 Hz to low-pass--> total           share = sqrt(<above^2> / <total^2>), memory 2 s
//!                            `--above the band's end, below where it is right again--> above
//! ```
//! For methods whose band ends before the low-pass does: `thrust` (the loop), `dob` (the axial mode), sums of
//! both sides behind a low-pass of the drive side. What encoder steps make of it is taken off.
//! Checked by: force_flags::a_force_above_the_usable_band_is_flagged.

use super::band::NOISE_RATIO;
use super::lane_sections::{LaneSection, filter, lane_sections, settle_sections};
use super::settings::response_to;
use super::stiffness_learner::{LEAST_S, MEMORY_S};
use super::thinned::HIGH_PASS_HZ;
use super::validity::Validity;
use crate::signal::FilterError;
use crate::signal::butterworth::{Butterworth, Pass, Section};
use crate::units::SampleRate;

/// Share of the deviation from which on it is said.
const LEAST_SHARE: f64 = 1.0 / 3.0;

/// What one axis puts into its lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct AboveBand {
    high: Butterworth,
    low: Butterworth,
    end: Butterworth,
    /// Where the method is right again: lets through of a line there just the share from which on it is said.
    again: Option<Butterworth>,
    forget: f64,
    least_weight: f64,
    /// What encoder steps make of the estimate, and of what lies above the band, N^2.
    noise_n2: [f64; 2],
}

impl AboveBand {
    /// For a method that is right up to `end_hz`, and from `again_hz` on, behind a low-pass at `low_pass_hz`;
    /// `None` where that is all of it, or hardly anything. Errors: frequencies that do not fit the rate.
    pub(super) fn new(
        (end_hz, again_hz): (f64, Option<f64>),
        low_pass_hz: f64,
        rate: SampleRate,
    ) -> Result<Option<Self>, FilterError> {
        let low_pass_hz = low_pass_hz.min(0.3 * rate.hz());
        if end_hz >= 0.9 * low_pass_hz || low_pass_hz <= 2.0 * HIGH_PASS_HZ {
            return Ok(None);
        }
        let end_hz = end_hz.max(HIGH_PASS_HZ);
        // |H|^2 = 1 / (1 + (f / corner)^8)
        let corner = |hz: f64| hz / (1.0 / (LEAST_SHARE * LEAST_SHARE) - 1.0).powf(1.0 / 8.0);
        let again = again_hz.map(|hz| Butterworth::low_pass(4, corner(hz), rate)).transpose()?;
        Ok(Some(Self {
            again,
            high: Butterworth::new(Pass::High, 2, HIGH_PASS_HZ, rate)?,
            low: Butterworth::low_pass(4, low_pass_hz, rate)?,
            end: Butterworth::new(Pass::High, 4, end_hz, rate)?,
            forget: (-1.0 / (MEMORY_S * rate.hz())).exp(),
            least_weight: LEAST_S * rate.hz(),
            noise_n2: [0.0; 2],
        }))
    }

    /// With what encoder steps make of the estimate, N, and the responses to one reading of each encoder
    /// before the low-pass, each with the mean square of its error; none where the loop lies between.
    pub(super) fn with_noise(self, noise_n: f64, responses: &[(Vec<f64>, f64)], rate: SampleRate) -> Self {
        if responses.is_empty() {
            return Self { noise_n2: [noise_n * noise_n; 2], ..self };
        }
        let chain = [Some(self.low), Some(self.end), self.again];
        let through = |response: &Vec<f64>| {
            let filters = chain.into_iter().flatten();
            filters.fold(response.clone(), |x, filter| response_to(&x, filter, rate))
        };
        let energy = |response| through(response).iter().map(|x| x * x).sum::<f64>();
        let above_n2 = responses.iter().map(|(response, step2)| step2 * energy(response)).sum();
        Self { noise_n2: [noise_n * noise_n, above_n2], ..self }
    }
}

/// Those of axes side by side; immutable.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LanesAbove<const L: usize> {
    /// From 5 Hz to the low-pass.
    total: Vec<LaneSection<L>>,
    /// Of that, what lies above the band.
    above: Vec<LaneSection<L>>,
    forget: [f64; L],
    least_weight: [f64; L],
    noise_n2: [[f64; L]; 2],
}

/// What has been seen; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct SeenAbove<const L: usize> {
    total: Vec<[[f64; L]; 2]>,
    above: Vec<[[f64; L]; 2]>,
    total_n2: [f64; L],
    above_n2: [f64; L],
    weight: [f64; L],
    /// Lanes that begin with the next estimate, a bit each.
    fresh: u32,
}

crate::keyframe::keep!(SeenAbove<L> { total, above, total_n2, above_n2, weight, fresh });

impl<const L: usize> SeenAbove<L> {
    /// Nothing seen; without a design nothing ever is.
    pub(super) fn of(design: Option<&LanesAbove<L>>) -> Self {
        let zeros = |sections: &Vec<LaneSection<L>>| vec![[[0.0; L]; 2]; sections.len()];
        Self {
            total: design.map_or(Vec::new(), |d| zeros(&d.total)),
            above: design.map_or(Vec::new(), |d| zeros(&d.above)),
            total_n2: [0.0; L],
            above_n2: [0.0; L],
            weight: [0.0; L],
            fresh: (1 << L) - 1,
        }
    }

    /// Forgets what one lane has seen. No allocation.
    pub(super) fn settle(&mut self, lane: usize) {
        [&mut self.total_n2, &mut self.above_n2, &mut self.weight].into_iter().for_each(|x| x[lane] = 0.0);
        self.fresh |= 1 << lane;
    }
}

impl<const L: usize> LanesAbove<L> {
    /// Puts them side by side; `None` where no axis has one.
    pub(super) fn new(axes: &[Option<AboveBand>]) -> Option<Self> {
        axes.iter().any(Option::is_some).then(|| {
            let sections = |pick: fn(&AboveBand) -> Vec<Section>| {
                lane_sections(axes.iter().map(|axis| axis.as_ref().map(pick).unwrap_or_default()))
            };
            let of = |none: f64, pick: fn(&AboveBand) -> f64| {
                std::array::from_fn(|lane| axes.get(lane).and_then(Option::as_ref).map_or(none, pick))
            };
            Self {
                total: sections(|a| [a.high.sections(), a.low.sections()].concat()),
                above: sections(|a| {
                    [a.end.sections(), a.again.as_ref().map_or(&[], |f| f.sections())].concat()
                }),
                forget: of(0.0, |a| a.forget),
                least_weight: of(f64::INFINITY, |a| a.least_weight),
                noise_n2: [of(0.0, |a| a.noise_n2[0]), of(0.0, |a| a.noise_n2[1])],
            }
        })
    }

    /// One estimate of each lane before its low-pass, N. Flags where too much of it lies above the band.
    #[inline(always)]
    pub(super) fn step<const FUSED: bool>(
        &self,
        state: &mut SeenAbove<L>,
        force_n: &[f64; L],
        flags: &mut [Validity; L],
    ) {
        if state.fresh != 0 {
            for lane in (0..L).filter(|lane| state.fresh >> lane & 1 == 1) {
                // Behind the high-pass there is no mean to settle on.
                settle_sections(&self.total, &mut state.total, lane, force_n[lane]);
                settle_sections(&self.above, &mut state.above, lane, 0.0);
            }
            state.fresh = 0;
        }
        let mut total_n = *force_n;
        filter::<L, FUSED>(&self.total, &mut state.total, &mut total_n);
        let mut above_n = total_n;
        filter::<L, FUSED>(&self.above, &mut state.above, &mut above_n);
        let (mut total_n2, mut above_n2, mut weight) = (state.total_n2, state.above_n2, state.weight);
        for lane in 0..L {
            let counts = !flags[lane].shares(Validity::SETTLING | Validity::SIGNAL_MISSING);
            let mean = |old: f64, new: f64| if counts { self.forget[lane] * old + new } else { old };
            total_n2[lane] = mean(total_n2[lane], total_n[lane] * total_n[lane]);
            above_n2[lane] = mean(above_n2[lane], above_n[lane] * above_n[lane]);
            weight[lane] = mean(weight[lane], 1.0);
            let [noise_n2, noise_above_n2] = [0, 1].map(|k| self.noise_n2[k][lane] * weight[lane]);
            let above = (weight[lane] > self.least_weight[lane])
                & (above_n2[lane] > NOISE_RATIO * NOISE_RATIO * noise_above_n2)
                & (above_n2[lane] - noise_above_n2 > LEAST_SHARE * LEAST_SHARE * (total_n2[lane] - noise_n2));
            flags[lane] |= Validity::when(above, Validity::FORCE_ABOVE_BAND);
        }
        (state.total_n2, state.above_n2, state.weight) = (total_n2, above_n2, weight);
    }
}
