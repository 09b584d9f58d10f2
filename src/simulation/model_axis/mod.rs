//! The axis as its model states it, in its control loop: what the recording would be if the model were true.
//!
//! The command, and what was added to the loop's reference, drive model and machine alike; nothing that was
//! measured is differentiated. Several models run side by side, one to a vector lane. The laws are those of
//! [`crate::plant::effects`]; of the observers and of the diagnosis' regression nothing is used.

mod constants;
mod control;
mod further;
mod lanes;
mod tanh;

pub use control::{ControlLaw, LoopRecord, Replay, read_controller, replay};

use crate::plant::effects::EffectKind;
use crate::plant::machine::AxisModel;
use crate::signal::dispatch::{self, Fast};
use constants::Constants;
use lanes::{Lanes, Run};

/// Models that run side by side.
pub const LANES: usize = 8;

/// What model and machine were both given.
#[derive(Debug, Clone, PartialEq)]
pub struct Trial {
    /// Sampling period, s.
    pub period_s: f64,
    /// Position command, one a sample, m.
    pub command_m: Vec<f64>,
    /// Added to the loop's reference, in its unit; empty: nothing.
    pub injected: Vec<f64>,
    /// Recorded positions of motor and stage at the first sample, m: the spring is free there.
    pub start_m: [f64; 2],
    /// Velocity at the first sample, m/s.
    pub start_m_s: f64,
    /// Control law.
    pub law: ControlLaw,
    /// Integral of the velocity error at the first sample, m.
    pub integral_m: f64,
    /// Later than the model's dead time by this, s: where inside a sample a reference is taken up.
    pub taken_up_s: f64,
    /// Thrust per unit of the reference that the model's own torque constant does not give, N; `None`: the
    /// reference is a current.
    pub thrust_per_unit: Option<f64>,
}

/// What the loop did, one value a sample.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Response {
    /// Reference to the drive, in the unit of the control law.
    pub reference: Vec<f64>,
    /// What the motor encoder says, as travel, m.
    pub motor_m: Vec<f64>,
    /// What the stage encoder says, m.
    pub stage_m: Vec<f64>,
}

impl Response {
    /// True where the loop ran away: a machine that ran is not this model.
    #[must_use]
    pub fn ran_away(&self) -> bool {
        self.reference.iter().chain(&self.stage_m).any(|x| !x.is_finite() || x.abs() > 1.0e9)
    }
}

/// Effects among an axis' terms that have no law in this simulation: cuts and disturbances of one recording.
#[must_use]
pub fn not_simulated(axis: &AxisModel) -> Vec<EffectKind> {
    Constants::of(axis, None).not_simulated
}

/// Runs a trial on each model. Axes of one or two inertias; a third one stands among the terms as a mode.
///
/// Fourth-order Runge-Kutta at a step that the fastest of the models allows. Cost: see
/// `benches/simulation.rs`. Deterministic; a model's numbers do not depend on its neighbours' but by the
/// step.
/// Units: SI. Errors: none; a loop that runs away ends in numbers that are not finite.
/// Checked by: `model_axis::*`, against equations that share no line with these.
#[must_use]
pub fn respond(axes: &[AxisModel], trial: &Trial) -> Vec<Response> {
    respond_on(Fast::detect_wide(), axes, trial)
}

/// [`respond`] with or without vector instructions, for comparison.
#[must_use]
pub fn respond_on(fast: Fast, axes: &[AxisModel], trial: &Trial) -> Vec<Response> {
    let constants: Vec<Constants> = axes.iter().map(|a| Constants::of(a, trial.thrust_per_unit)).collect();
    let moves_m = trial.command_m.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
    let fastest_m_s = moves_m / trial.period_s;
    let step_s = constants.iter().map(|c| c.longest_step_s(fastest_m_s)).fold(f64::INFINITY, f64::min);
    let steps = (trial.period_s / step_s).ceil().clamp(1.0, 200.0) as usize;
    let mut out = Vec::with_capacity(axes.len());
    let mut rest = constants.as_slice();
    while let Some(first) = rest.first() {
        let width = if rest.len() > LANES / 2 { LANES } else { 1 + 3 * usize::from(rest.len() > 1) };
        let (here, later) = rest.split_at(rest.len().min(width));
        let pick = |l: usize| here.get(l).unwrap_or(first);
        let responses = match width {
            1 => dispatch::run(fast, Run { lanes: Lanes::<1>::new(pick, trial.start_m), trial, steps }),
            4 => dispatch::run(fast, Run { lanes: Lanes::<4>::new(pick, trial.start_m), trial, steps }),
            _ => dispatch::run(fast, Run { lanes: Lanes::<LANES>::new(pick, trial.start_m), trial, steps }),
        };
        out.extend(responses.into_iter().take(here.len()));
        rest = later;
    }
    out
}
