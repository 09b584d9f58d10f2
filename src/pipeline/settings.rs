//! What a pipeline is made from, checked.

use super::{Channel, MarginPlan};
use crate::chatter::{Band, BandError, ChatterError, MeanForce, predicted_band, predicted_band_in_cut};
use crate::force::lanes::LANES;
use crate::force::observers::{AxisObserver, Observers};
use crate::force::plan::ForcePlan;
use crate::force::settings::ForceError;
use crate::plant::cut_terms::CutCondition;
use crate::plant::cutting::Cutting;
use crate::plant::scenario::Scenario;
use crate::plant::workpiece::Workpiece;
use crate::sample::{MAX_AXES, ServoSample};
use crate::signal::sliding_dft::SlidingDftError;
use crate::stability::scenario_root;
use crate::units::SampleRate;
use thiserror::Error;

/// One axis of the stream.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisPlan {
    /// Name.
    pub name: String,
    /// How its force is estimated; `None`: the force comes from elsewhere, or the axis is not used.
    pub force: Option<ForcePlan>,
    /// A second estimator that runs beside the first: how far the two are apart is reported, the first is
    /// acted on.
    pub beside: Option<ForcePlan>,
    /// Place of the axis of the stream whose stage position is the third position of this one (the screw at
    /// the nut).
    pub nut: Option<usize>,
    /// Whether chatter is listened for on it.
    pub watch: bool,
    /// Share of the force away from the bar in its own: the cosine of its direction from "toward the bar"; 0
    /// of an axis that is not the turret's.
    pub pushed: f64,
}

/// Where chatter is looked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BandPlan {
    /// Stated.
    Stated(Band),
    /// Predicted from the workpiece's first bending mode (6-11) and the rule of `chatter::predicted_band`.
    Workpiece(Workpiece),
    /// The same with the stated cut, which holds the bar and raises the band.
    Cut(Workpiece, Cutting),
    /// The same, widened to the lines that physics beyond two delays makes possible; see [`lines_of`].
    Structured(Workpiece, Cutting, Band),
}

impl BandPlan {
    /// The band. Errors: none for what was stated as a band; a bar without one.
    pub fn band(&self) -> Result<Band, BandError> {
        match self {
            BandPlan::Stated(band) => Ok(*band),
            BandPlan::Workpiece(workpiece) => predicted_band(workpiece.bending_frequency_hz()),
            BandPlan::Cut(workpiece, cutting) => predicted_band_in_cut(
                workpiece.bending_frequency_hz(),
                cutting.stiffness_n_m() / workpiece.modal_stiffness_n_m(),
            ),
            BandPlan::Structured(workpiece, cutting, lines) => {
                both(BandPlan::Cut(*workpiece, *cutting).band()?, *lines)
            }
        }
    }

    /// The same with the tools at `position_m` from the chuck, the nearer to it the less the cut holds the
    /// bar, and the bar turned down to `diameter_m`; as stated where one of them is not known.
    /// Errors: as [`Self::band`].
    pub fn band_at(&self, position_m: Option<f64>, diameter_m: Option<f64>) -> Result<Band, BandError> {
        if let BandPlan::Structured(workpiece, cutting, lines) = self {
            return both(BandPlan::Cut(*workpiece, *cutting).band_at(position_m, diameter_m)?, *lines);
        }
        let BandPlan::Cut(stated, cutting) = self else { return self.band() };
        let known = diameter_m.filter(|d| (0.5..1.5).contains(&(d / stated.diameter_m())));
        let workpiece = known.and_then(|d| stated.with_diameter_m(d).ok()).unwrap_or(*stated);
        let held = cutting.stiffness_n_m() / workpiece.modal_stiffness_n_m();
        let shape = position_m.map_or(1.0, |z| workpiece.mode_shape(z));
        predicted_band_in_cut(workpiece.bending_frequency_hz(), held * shape * shape)
    }
}

/// The narrowest band that holds both.
fn both(a: Band, b: Band) -> Result<Band, BandError> {
    Band::new(a.low_hz().min(b.low_hz()), a.high_hz().max(b.high_hz()))
}

/// Where a scenario can chatter: the rightmost roots at pitches up to `largest_pitch_rad` and at strengths of
/// the cut that are off by a quarter, 5 % beyond them either way.
///
/// Errors: no band, where no root is found. Cost: 12 searches, some milliseconds.
/// Checked by: `a_scenario_is_named_in_place_of_bar_and_cut`.
pub fn lines_of(scenario: &Scenario, largest_pitch_rad: f64) -> Result<Band, BandError> {
    let stated = CutCondition::of(scenario);
    let (mut low_hz, mut high_hz) = (f64::INFINITY, 0.0f64);
    for pitch in [0.0, 0.33, 0.67, 1.0] {
        for strength in [0.75, 1.0, 1.25] {
            let at = CutCondition {
                pitch_difference_rad: pitch * largest_pitch_rad,
                width_m: strength * stated.width_m,
                ..stated
            };
            let line_hz = scenario_root(scenario, &at).frequency_hz;
            (low_hz, high_hz) = (low_hz.min(line_hz), high_hz.max(line_hz));
        }
    }
    Band::new(0.95 * low_hz, 1.05 * high_hz)
}

/// An axis of the stream that tells how far the tools are from the chuck, or from the bar's axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolAxis {
    /// Place in the stream.
    pub index: usize,
    /// Distance where the axis stands at zero.
    pub zero_m: f64,
    /// Whether the distance shrinks as the axis counts up.
    pub toward: bool,
}

impl ToolAxis {
    /// The distance; nothing while the axis has no linear scale.
    #[must_use]
    pub fn distance_m(&self, sample: &ServoSample) -> Option<f64> {
        let stage_m = sample.axes.get(self.index)?.stage_position_m?;
        Some(if self.toward { self.zero_m - stage_m } else { self.zero_m + stage_m })
    }
}

/// Everything a [`super::Pipeline`] is made from.
#[derive(Debug, Clone, PartialEq)]
pub struct PipelineSettings {
    /// Rate of the stream.
    pub sample_rate: SampleRate,
    /// Axes in the order of the stream.
    pub axes: Vec<AxisPlan>,
    /// Where chatter is looked for.
    pub band: BandPlan,
    /// What tells where along the bar the tools are.
    pub tools: Option<ToolAxis>,
    /// What tells the radius at the tools.
    pub infeed: Option<ToolAxis>,
    /// How two opposed tools stand that cut the waves of each other, theta_2 - theta_1, rad, where the stream
    /// has no report of it at all. Nothing: a stream that reports it, or none of such a lathe.
    pub stated_pitch_rad: Option<f64>,
    /// What the stability margin rests on; nothing: no margin is estimated.
    pub margin: Option<MarginPlan>,
    /// What the mean of what is listened to tells.
    pub mean: MeanForce,
    /// Mean time between false alarms, of cutting, s.
    pub false_alarm_s: f64,
}

/// Why there can be no such pipeline.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PipelineError {
    /// Too many axes or none.
    #[error("{axes} axes; expected 1 to {MAX_AXES}")]
    Axes {
        /// How many were given.
        axes: usize,
    },
    /// No axis is watched.
    #[error("no axis is watched for chatter; expected at least one")]
    NothingWatched,
    /// The force of an axis cannot be estimated so.
    #[error("axis {axis}: {source}")]
    Force {
        /// Axis.
        axis: String,
        /// Why.
        source: ForceError,
    },
    /// The drive has no torque constant, so its current says nothing about thrust.
    #[error("axis {axis}: torque_constant_nm_a is missing; the current reference has no thrust without it")]
    NoThrust {
        /// Axis.
        axis: String,
    },
    /// The band is not one.
    #[error(transparent)]
    Band(#[from] BandError),
    /// The band does not fit the rate.
    #[error(transparent)]
    Chatter(#[from] ChatterError),
    /// The spectrum does not fit the rate.
    #[error(transparent)]
    Spectrum(#[from] SlidingDftError),
}

pub(super) struct Bins {
    pub(super) first_hz: f64,
    pub(super) step_hz: f64,
    pub(super) count: usize,
}

impl PipelineSettings {
    pub(super) fn check(&self) -> Result<(), PipelineError> {
        if !(1..=MAX_AXES).contains(&self.axes.len()) {
            return Err(PipelineError::Axes { axes: self.axes.len() });
        }
        if !self.axes.iter().any(|a| a.watch) {
            return Err(PipelineError::NothingWatched);
        }
        Ok(())
    }

    pub(super) fn channel(&self, plan: &AxisPlan) -> Result<Channel, PipelineError> {
        let AxisPlan { nut, watch, pushed, .. } = *plan;
        let mut channel = Channel { thrust_n_a: 0.0, travel_m_rad: 1.0, nut, watch, pushed };
        // Two estimators of one axis know one drive.
        let plans = [&plan.force, &plan.beside];
        if let Some(servo) = plans.into_iter().flatten().find_map(ForcePlan::servo) {
            let no_thrust = || PipelineError::NoThrust { axis: plan.name.clone() };
            channel.thrust_n_a = servo.drive.thrust_constant_n_a().ok_or_else(no_thrust)?;
            channel.travel_m_rad = servo.drive.travel_m_rad();
        }
        Ok(channel)
    }

    /// The estimators of all axes that `plan` names, side by side.
    pub(super) fn observers(
        &self,
        plan: impl Fn(&AxisPlan) -> Option<&ForcePlan>,
    ) -> Result<Observers<LANES>, PipelineError> {
        let of_axis = |axis: &AxisPlan| {
            plan(axis).map_or_else(
                || Ok(AxisObserver::absent()),
                |plan| {
                    let named = |source| PipelineError::Force { axis: axis.name.clone(), source };
                    AxisObserver::new(plan, self.sample_rate).map_err(named)
                },
            )
        };
        Ok(Observers::new(self.axes.iter().map(of_axis).collect::<Result<_, _>>()?))
    }

    /// One second, so that bins stand 1 Hz apart.
    pub(super) fn window_samples(&self) -> usize {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a positive rate")]
        let samples = self.sample_rate.hz().round() as usize;
        samples.max(1)
    }

    /// Whole multiples of rate/N that cover the band.
    pub(super) fn spectrum_bins(&self, band: Band) -> Bins {
        let step_hz = self.sample_rate.hz() / self.window_samples() as f64;
        let first = (band.low_hz() / step_hz).floor().max(1.0);
        let last = (band.high_hz() / step_hz).ceil().min((self.sample_rate.hz() / 2.0 / step_hz).floor());
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive, below rate/2")]
        let count = (last - first + 1.0).max(1.0) as usize;
        Bins { first_hz: first * step_hz, step_hz, count }
    }
}
