//! Cuts that hide something: the judge of the diagnosis of the cut.
//!
//! [`conceal_cut`] draws a machine around a scenario, hides effects in it, cuts five recordings and returns
//! what a shop would have: a scenario whose numbers are off within the contract, and recordings. What was
//! hidden is returned beside it, for the judge alone. Integrator, surface and laws are this module's own.

mod bench;
mod draw;
mod machine;
mod schedule;
mod signal;

pub use draw::{CUT_EFFECTS, CUT_OUTSIDE, HiddenCut};
pub use machine::{Hidden, Mode, Moment, TrueCut};
pub use schedule::growth_1_s;

use crate::plant::cutting::RawCutting;
use crate::plant::scenario::{RawScenario, Scenario, ToolCount};
use crate::plant::scenario_error::ScenarioError;
use crate::plant::workpiece::RawWorkpiece;
use crate::sample::Recording;
use draw::{Unsaid, hide};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use schedule::Extremes;
use thiserror::Error;

/// Rate of the recordings.
pub const RATE_HZ: f64 = 9000.0;
/// How the recordings say that the signal shows the force.
pub const STATED_BANDWIDTH_HZ: f64 = 2000.0;
/// How late they say it is.
pub const STATED_DELAY_S: f64 = 3.5e-4;

/// What to hide and how.
#[derive(Debug, Clone, PartialEq)]
pub struct CutCaseSpec {
    /// Names of [`CUT_EFFECTS`] and [`CUT_OUTSIDE`]; none: nothing is hidden.
    pub effects: Vec<String>,
    /// 1: plain; 0.1: a tenth of it.
    pub depth: f64,
    /// The same seed gives the same machine, cuts and noise.
    pub seed: u64,
    /// Whether the recordings have a probe at the bar (`force_sensor_lag` always has one).
    pub probe: bool,
}

/// A machine that hides something, with its recordings.
#[derive(Debug, Clone)]
pub struct CutCase {
    /// What the shop believes.
    pub scenario: Scenario,
    /// `entry`, `pitch`, `speed`, `feed_width`, `travel`.
    pub recordings: Vec<Recording>,
    /// What the scenario leaves out; for the judge.
    pub hidden: Vec<HiddenCut>,
    /// True numbers; for the judge.
    pub truth: TrueCut,
}

/// Why a machine cannot be drawn.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CutCaseError {
    /// The name is none that can be hidden.
    #[error("no effect {name} can be hidden in a cut; known: {}", known_names())]
    UnknownEffect {
        /// What was asked for.
        name: String,
    },
    /// A depth must be positive.
    #[error("depth {depth} is not above zero")]
    Depth {
        /// What was asked for.
        depth: f64,
    },
    /// A machine is drawn around a bar that is described, and around the plain structure.
    #[error("a machine is drawn around a bar with length, modulus and density, and no [[physics]]")]
    Structure,
    /// The drawn scenario is not physical.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

fn known_names() -> String {
    [CUT_EFFECTS.as_slice(), CUT_OUTSIDE.as_slice()].concat().join(", ")
}

/// A machine that hides something, not cut with yet.
#[derive(Debug, Clone)]
pub struct ConcealedMachine {
    /// Its true numbers.
    pub truth: TrueCut,
    /// What its scenario will leave out.
    pub hidden: Vec<HiddenCut>,
    unsaid: Unsaid,
    random: ChaCha8Rng,
}

impl ConcealedMachine {
    /// Draws a machine around `around` and hides in it what `spec` says.
    ///
    /// Errors: an unknown effect, a depth of zero or less, a scenario that is a tap test or has physics.
    pub fn draw(around: &Scenario, spec: &CutCaseSpec) -> Result<Self, CutCaseError> {
        if !(spec.depth.is_finite() && spec.depth > 0.0) {
            return Err(CutCaseError::Depth { depth: spec.depth });
        }
        if around.workpiece.is_tapped() || !around.physics.is_empty() {
            return Err(CutCaseError::Structure);
        }
        let mut random = ChaCha8Rng::seed_from_u64(spec.seed);
        let mut truth = drawn(around, &mut random);
        let mut unsaid = Unsaid { pressure_factor: 1.0, damping_factor: 1.0, ..Unsaid::default() };
        let mut hidden = Vec::new();
        for name in &spec.effects {
            hidden.push(hide(name, spec.depth, (&mut truth, &mut unsaid), &mut random)?);
        }
        Ok(Self { truth, hidden, unsaid, random })
    }
}

/// Draws a machine around `around`, hides what `spec` says and cuts five recordings with it.
///
/// Errors: as [`ConcealedMachine::draw`]. Cost: some seconds.
/// Checked by: `concealed_cut::a_tap_on_a_concealed_machine_grows_as_the_linear_cut_says`.
pub fn conceal_cut(around: &Scenario, spec: &CutCaseSpec) -> Result<CutCase, CutCaseError> {
    let ConcealedMachine { mut truth, hidden, unsaid, mut random } = ConcealedMachine::draw(around, spec)?;
    let extremes = Extremes::find(&mut truth);
    let scenario = stated(&truth, &unsaid, &mut random)?;
    let probe = spec.probe || truth.hidden.signal_delay_s > 0.0;
    let recordings = schedule::recordings(&truth, &extremes, probe, &mut random);
    Ok(CutCase { scenario, recordings, hidden, truth })
}

/// A machine around a scenario.
fn drawn(around: &Scenario, random: &mut ChaCha8Rng) -> TrueCut {
    let raw = around.raw();
    let mut about = |x: f64, share: f64| x * random.random_range(1.0 - share..1.0 + share);
    let (bar, cutting) = (raw.workpiece, raw.cutting);
    let length_m = about(bar.projection_length_m, 0.1);
    TrueCut {
        two_tools: raw.tool_count == ToolCount::Two,
        diameter_m: about(bar.diameter_m, 0.1),
        length_m,
        modulus_pa: bar.elastic_modulus_pa,
        density_kg_m3: bar.density_kg_m3,
        damping_ratio: about(bar.damping_ratio, 0.4),
        clamp_factor: about(bar.clamp_factor, 0.05),
        pressure_pa: about(cutting.radial_stiffness_pa, 0.2),
        width_m: about(cutting.width_m, 0.2),
        feed_m_rev: about(cutting.feed_m_rev, 0.2),
        flank_damping_n: about(cutting.process_damping_n.max(20.0), 0.3),
        memory: 1.0,
        clearance_rad: cutting.clearance_rad,
        flank_force_n: cutting.flank_force_n,
        tangential_ratio: cutting.tangential_ratio,
        speed_rpm: about(raw.speed_rpm, 0.2),
        position_m: length_m * random.random_range(0.93..0.99),
        random_ratio: random.random_range(0.02..0.05),
        hidden: Hidden::default(),
    }
}

/// The scenario as an engineer states it: four numbers off within the contract, the rest exact.
fn stated(truth: &TrueCut, unsaid: &Unsaid, random: &mut ChaCha8Rng) -> Result<Scenario, ScenarioError> {
    let mut off = |x: f64, share: f64| x / random.random_range(1.0 - share..1.0 + share);
    let workpiece = RawWorkpiece {
        diameter_m: truth.diameter_m,
        projection_length_m: truth.length_m,
        elastic_modulus_pa: truth.modulus_pa,
        density_kg_m3: truth.density_kg_m3,
        damping_ratio: off(truth.damping_ratio, 0.3) * unsaid.damping_factor,
        clamp_factor: off(truth.clamp_factor, 0.02),
        tap_test: None,
    };
    let damping = off(truth.flank_damping_n, 0.2);
    let cutting = RawCutting {
        radial_stiffness_pa: off(truth.pressure_pa, 0.15) * unsaid.pressure_factor,
        width_m: truth.width_m,
        feed_m_rev: truth.feed_m_rev,
        process_damping_n: if unsaid.damping { 0.0 } else { damping },
        regeneration: !unsaid.regeneration,
        clearance_rad: truth.clearance_rad,
        flank_force_n: truth.flank_force_n,
        tangential_ratio: truth.tangential_ratio,
        ..RawCutting::default()
    };
    Scenario::new(&RawScenario {
        workpiece,
        cutting,
        speed_rpm: truth.speed_rpm,
        tool_count: if truth.two_tools { ToolCount::Two } else { ToolCount::One },
        position_m: Some(truth.position_m),
        ..RawScenario::default()
    })
}
