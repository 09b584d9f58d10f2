//! The cut as its model states it, running free: what the recording would have been if the model were true.
//!
//! Speed, feed, width, position and pitch as they were recorded drive the model; no measured force does. The
//! surface is the one that the model's own tools have left. Several models (or one with several random
//! forces) run side by side, one to a vector lane. Laws and bar are those of [`crate::plant::cut_terms`]; of
//! [`super::lathe`] and of the fits nothing is used.
//!
//! ```text
//! F_j = B (k_j h_r (h_j/h_r)^p (1 + nu n_j) + F_e + k_c u_j + C_i u_j'/v
//!          + C_f max(0, u_j'/v - tan gamma)) >= 0
//! h_j = advance_j + u_j - o s_other(where it passed that place)      s_j = u_j - min(0, h_j): surface left
//! q_i'' + 2 zeta w q_i' + w^2 q_i = g_i (F2 - F1),  y = sum q_i,  u1 = y,  u2 = w - y + ahead
//! ```
//! Where contact is lost (h_j < 0) the tool leaves the surface as it was.

mod course;
mod lanes;
mod modes;

use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::{Scenario, ToolCount};
use crate::signal::dispatch::{self, Fast};
use course::Course;
use lanes::{Lanes, Run};

/// Models that run side by side.
pub const LANES: usize = 16;

/// Longest step, s: the delayed surface is read on a straight line between two steps, which at 1 kHz takes
/// 5e-4 of it.
const LONGEST_STEP_S: f64 = 1.05e-5;

/// Under what all models of a run cut.
#[derive(Debug, Clone, PartialEq)]
pub struct CutTrial {
    /// Sampling period, s.
    pub period_s: f64,
    /// Angle of the spindle, not wrapped, one a sample, rad.
    pub turned_rad: Vec<f64>,
    /// theta_2 - theta_1, one a sample, rad.
    pub pitch_difference_rad: Vec<f64>,
    /// Everything else, one for each `held` samples.
    pub conditions: Vec<CutCondition>,
    /// Samples for which a condition stands.
    pub held: usize,
}

/// One model, with its random force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutModel {
    /// Structure, numbers and effects.
    pub scenario: Scenario,
    /// nu: standard deviation of the random part of the chip's force over that force.
    pub random_share: f64,
    /// Which random force: two models of the same one are given the same.
    pub seed: u64,
}

/// What one model did, one value a sample.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FreeRun {
    /// Radial force of each tool, as it is (no signal's filter), N.
    pub force_n: [Vec<f64>; 2],
    /// y: bar at the tools, toward tool 1, m.
    pub bar_m: Vec<f64>,
}

impl FreeRun {
    /// Room for that many samples.
    fn of(samples: usize) -> Self {
        Self {
            force_n: [Vec::with_capacity(samples), Vec::with_capacity(samples)],
            bar_m: Vec::with_capacity(samples),
        }
    }
}

/// Runs a trial on each model, from the rest of a quiet cut at the first condition.
///
/// All models have the tools of the first (one or two). Each mode is propagated exactly under a force that is
/// led on by a parabola through its last three values. Deterministic; a model's numbers do not depend on its
/// neighbours'. Cost: see `benches/simulation.rs`.
/// Units: SI. Errors: none; no model or no sample: nothing.
/// Checked by: `the_model_that_runs_free_grows_as_its_root_says`,
/// `free_chatter_grows_to_what_the_lathe_grows_to`, `a_quiet_cut_rests`.
#[must_use]
pub fn free_run(models: &[CutModel], trial: &CutTrial) -> Vec<FreeRun> {
    free_run_on(Fast::detect_wide(), models, trial)
}

/// [`free_run`] with or without vector instructions, for comparison.
#[must_use]
pub fn free_run_on(fast: Fast, models: &[CutModel], trial: &CutTrial) -> Vec<FreeRun> {
    let steps = (trial.period_s / LONGEST_STEP_S).ceil().max(1.0) as usize;
    let mut out = Vec::with_capacity(models.len());
    let Some(first) = models.first().filter(|_| !trial.turned_rad.is_empty()) else { return out };
    let one = first.scenario.tools.count() == ToolCount::One;
    let course = Course::new(trial, one);
    for here in models.chunks(LANES) {
        let pick = |l: usize| here.get(l).unwrap_or(&here[0]);
        let runs = dispatch::run(fast, Run { lanes: Lanes::new(pick, trial, steps), course: &course });
        out.extend(runs.into_iter().take(here.len()));
    }
    out
}

/// Coefficients of a model at a condition; stock and runout over a turn come by the angle.
fn terms_of(model: &CutModel, at: &CutCondition) -> CutTerms {
    CutTerms { stock_factor: 1.0, ..CutTerms::of(&model.scenario, at) }
}
