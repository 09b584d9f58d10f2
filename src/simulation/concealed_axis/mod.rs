//! Machines that hide something: the judge of the diagnosis.
//!
//! [`conceal`] draws a machine around a model, hides effects in it at a chosen depth, runs three
//! experiments in closed loop (a swept sine, slow strokes, quick moves) and returns what a shop would
//! have: a model with constants a few percent off, and recordings. What was hidden is returned beside
//! it, for the judge alone. The equations of motion are this module's own (see [`plant`]); nothing of
//! the observers or of the diagnosis is used.

mod closed_loop;
mod draw;
mod motion;
pub mod plant;

pub use closed_loop::{Background, Instruments};
pub use draw::{HiddenEffect, OUTSIDE, feed_drive_effects};

use crate::plant::drive::{DriveParams, ParamError, RawDriveParams};
use crate::plant::machine::{AxisModel, Controller, Machine};
use crate::sample::{Column, Recording};
use crate::units::SampleRate;
use closed_loop::{Bench, Trace, phase};
use draw::Draft;
use motion::{Motion, Scales};
use plant::{HiddenPhysics, Plant, TrueDrive, Wave};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use thiserror::Error;

/// What to hide and how.
#[derive(Debug, Clone, PartialEq)]
pub struct CaseSpec {
    /// Names of effects (see [`feed_drive_effects`], [`OUTSIDE`]); none: a healthy machine.
    pub effects: Vec<String>,
    /// 1: plain; 0.1: a tenth of it.
    pub depth: f64,
    /// The same seed gives the same machine, motion and noise.
    pub seed: u64,
    /// How far machines spread around the model, as a share of each constant.
    pub machine_spread: f64,
    /// How far the model's constants are off, standard deviation as a share.
    pub model_error: f64,
    /// Size of the background disturbances: 1 is a quiet axis.
    pub background: f64,
}

impl Default for CaseSpec {
    fn default() -> Self {
        Self {
            effects: Vec::new(),
            depth: 1.0,
            seed: 0,
            machine_spread: 0.2,
            model_error: 0.02,
            background: 1.0,
        }
    }
}

/// A machine that hides something, with its recordings.
#[derive(Debug, Clone)]
pub struct Case {
    /// What the shop believes.
    pub model: Machine,
    /// Swept sine, slow strokes, quick moves.
    pub recordings: Vec<Recording>,
    /// What the model leaves out; for the judge.
    pub hidden: Vec<HiddenEffect>,
    /// True constants; for the judge.
    pub truth: TrueDrive,
    /// Force beyond the structure in N for each recording: what it adds to the thrust needed at the motor, to
    /// the force of the spring, and to the thrust needed at the stage.
    pub hidden_force_n: Vec<[Vec<f64>; 3]>,
}

/// Why a machine cannot be drawn.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum CaseError {
    /// The name is none that can be hidden.
    #[error("no effect {name} can be hidden in a feed drive; known: {}", known_names())]
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
    /// The judge simulates two inertias.
    #[error(
        "axis {axis} states no {key}; a machine is drawn around an axis of two inertias with a torque \
         constant"
    )]
    Structure {
        /// Axis.
        axis: String,
        /// First key that is missing.
        key: &'static str,
    },
    /// The drawn model is not physical.
    #[error("{0}")]
    Model(#[from] ParamError),
}

fn known_names() -> String {
    let mut names: Vec<&str> = feed_drive_effects();
    names.extend(OUTSIDE);
    names.join(", ")
}

/// Draws a machine around `axis`, hides what `spec` says and records it.
///
/// Errors: an unknown effect, a depth of zero or less, an axis without two inertias.
/// Cost: about 0.4 us per sample and integration step.
/// Checked by: `conceal::*`.
pub fn conceal(axis: &AxisModel, sample_rate: SampleRate, spec: &CaseSpec) -> Result<Case, CaseError> {
    if !(spec.depth.is_finite() && spec.depth > 0.0) {
        return Err(CaseError::Depth { depth: spec.depth });
    }
    let mut rng = ChaCha8Rng::seed_from_u64(spec.seed);
    let mut draft = machine_around(axis, spec, sample_rate.period_s(), &mut rng)?;
    // The model is written down before anything is hidden.
    let healthy = draft.drive.clone();
    let mut hidden = Vec::new();
    for name in &spec.effects {
        hidden.push(draw::hide(&mut draft, name, spec.depth, &mut rng)?);
    }
    let model = model_of(axis, &healthy, &draft, spec, &mut rng)?;
    // The shop tunes its loop on the machine as it is.
    let total = draft.drive.reflected_mass_kg + draft.drive.movable_mass_kg;
    draft.instruments.current_per_accel = total / draft.drive.thrust_constant_n_a;
    let period_s = sample_rate.period_s();
    let scales = scales_of(&draft.drive, period_s);
    let motions =
        [motion::sweep(&scales, &mut rng), motion::idle(&scales, &mut rng), motion::moves(&scales, &mut rng)];
    let texture = texture(spec.background, draft.lead_m, &mut rng);
    let truth = draft.drive.clone();
    let bench = Bench {
        plant: Plant { drive: draft.drive, physics: draft.physics, texture },
        instruments: draft.instruments,
        background: draft.background,
        period_s,
    };
    let mut recordings = Vec::new();
    let mut hidden_force_n = Vec::new();
    for motion in &motions {
        let trace = bench.run(motion, &mut rng);
        hidden_force_n.push(trace.hidden_n.clone());
        recordings.push(recording(&axis.name, sample_rate, motion, trace));
    }
    let model = Machine { name: format!("concealed-{}", spec.seed), sample_rate, axes: vec![model] };
    Ok(Case { model, recordings, hidden, truth, hidden_force_n })
}

fn machine_around(
    axis: &AxisModel,
    spec: &CaseSpec,
    period_s: f64,
    rng: &mut impl Rng,
) -> Result<Draft, CaseError> {
    let raw = axis.drive.raw();
    let missing = |key| CaseError::Structure { axis: axis.name.clone(), key };
    let lead_m = raw.screw_lead_m.ok_or_else(|| missing("screw_lead_m"))?;
    let stiffness = raw.axial_stiffness_n_m.ok_or_else(|| missing("axial_stiffness_n_m"))?;
    let thrust_constant = axis.drive.thrust_constant_n_a().ok_or_else(|| missing("torque_constant_nm_a"))?;
    let mut spread = |value: f64| value * (1.0 + spec.machine_spread * rng.random_range(-1.0..1.0));
    let drive = TrueDrive {
        reflected_mass_kg: spread(axis.drive.reflected_mass_kg()),
        movable_mass_kg: spread(axis.drive.movable_mass_kg()),
        thrust_constant_n_a: thrust_constant,
        axial_stiffness_n_m: spread(stiffness),
        structural_damping_n_s_m: spread(axis.drive.structural_damping_n_s_m()),
        reflected_damping_n_s_m: spread(axis.drive.reflected_damping_n_s_m()),
        translational_damping_n_s_m: spread(axis.drive.translational_damping_n_s_m()),
        stage_coulomb_friction_n: spread(axis.drive.stage_coulomb_friction_n()),
        motor_coulomb_friction_n: spread(axis.drive.motor_coulomb_friction_n()),
        friction_smoothing_m_s: axis.drive.friction_smoothing_m_s(),
        current_loop_bandwidth_rad_s: raw.current_loop_bandwidth_rad_s,
    };
    // Where inside a sample period a drive takes up a reference is stated nowhere: a little before its end,
    // and not the same on every machine.
    let inside_sample = -1.0 / 6.0 + rng.random_range(-0.05..0.05);
    let instruments = Instruments {
        travel_m_rad: axis.drive.travel_m_rad(),
        dead_time_s: axis.drive.amplifier_dead_time_s() + period_s * inside_sample,
        motor_encoder_delay_s: axis.drive.motor_encoder_delay_s(),
        stage_encoder_delay_s: axis.drive.stage_encoder_delay_s(),
        motor_step_m: axis.drive.motor_encoder_resolution_m(),
        stage_step_m: axis.drive.stage_encoder_resolution_m(),
        motor_error: None,
        stage_error: None,
        stage_drift_m_s: 0.0,
        controller: axis.controller.unwrap_or(DEFAULT_CONTROLLER),
        current_per_accel: 0.0,
    };
    let size = spec.background * rng.random_range(0.6..1.5);
    let background = Background {
        motor_white_n: 0.25 * size,
        stage_white_n: 0.7 * size,
        coloured_n: 0.05 * size,
        random_walk_n: 0.0,
    };
    let friction_shape = 0.05 * spec.background.min(2.0) * rng.random_range(0.0..1.0);
    Ok(Draft {
        drive,
        physics: HiddenPhysics { friction_shape, ..HiddenPhysics::default() },
        instruments,
        background,
        lead_m,
        poles: raw.motor_pole_count.unwrap_or(10.0),
        slots: raw.motor_slot_count.unwrap_or(12.0),
        motor_signals_per_rev: raw.motor_encoder_signals_per_rev.unwrap_or(512.0),
        stage_signal_period_m: raw.stage_encoder_signal_period_m.unwrap_or(4.0e-6),
        forget_current_loop: false,
        forget_coulomb: false,
        forget_viscous: false,
    })
}

/// Loop of a machine whose model states none: 10 Hz position, 35 Hz velocity.
const DEFAULT_CONTROLLER: Controller = Controller {
    position_gain_1_s: 60.0,
    velocity_gain_1_s: 220.0,
    velocity_integral_1_s: 20.0,
    velocity_filter_rad_s: 3000.0,
};

/// What the shop believes: the healthy machine's constants, each off by a few percent.
fn model_of(
    axis: &AxisModel,
    healthy: &TrueDrive,
    draft: &Draft,
    spec: &CaseSpec,
    rng: &mut impl Rng,
) -> Result<AxisModel, CaseError> {
    let travel = draft.instruments.travel_m_rad;
    let mut off = |value: f64, share: f64| {
        let normal: f64 = StandardNormal.sample(rng);
        Some(value * (1.0 + share * spec.model_error * normal.clamp(-2.5, 2.5)))
    };
    let raw = RawDriveParams {
        rotary_inertia_kg_m2: off(healthy.reflected_mass_kg * travel * travel, 1.0),
        movable_mass_kg: off(healthy.movable_mass_kg, 1.0),
        torque_constant_nm_a: off(healthy.thrust_constant_n_a * travel, 0.5),
        axial_stiffness_n_m: off(healthy.axial_stiffness_n_m, 1.0),
        structural_damping_n_s_m: off(healthy.structural_damping_n_s_m, 2.5),
        rotary_damping_nm_s_rad: off(healthy.reflected_damping_n_s_m * travel * travel, 2.5),
        translational_damping_n_s_m: off(healthy.translational_damping_n_s_m, 2.5)
            .filter(|_| !draft.forget_viscous),
        stage_coulomb_friction_n: off(healthy.stage_coulomb_friction_n, 1.5)
            .filter(|_| !draft.forget_coulomb),
        motor_coulomb_friction_n: off(healthy.motor_coulomb_friction_n, 1.5),
        current_loop_bandwidth_rad_s: healthy
            .current_loop_bandwidth_rad_s
            .filter(|_| !draft.forget_current_loop),
        ..axis.drive.raw().clone()
    };
    let controller = Some(draft.instruments.controller);
    Ok(AxisModel { name: axis.name.clone(), drive: DriveParams::new(raw)?, controller, physics: Vec::new() })
}

/// Sizes of the experiments: the sweep shakes as hard as friction holds, or with 1 m/s2.
fn scales_of(drive: &TrueDrive, period_s: f64) -> Scales {
    let friction = drive.stage_coulomb_friction_n + drive.motor_coulomb_friction_n;
    let inertia = drive.reflected_mass_kg + drive.movable_mass_kg;
    Scales {
        period_s,
        sweep_a: friction.max(inertia) / drive.thrust_constant_n_a,
        sweep_hz: 1400.0_f64.min(0.14 / period_s),
        reach_m: 20.0e-3,
    }
}

/// Repeatable forces over position, some hundredths of a newton each.
fn texture(size: f64, lead_m: f64, rng: &mut impl Rng) -> Vec<Wave> {
    (0..6)
        .map(|_| Wave {
            wavelength_m: lead_m * 2.0_f64.powf(rng.random_range(-3.5..3.0)),
            amplitude: 0.03 * size * rng.random_range(0.2..1.0),
            phase_rad: phase(rng),
        })
        .collect()
}

fn recording(axis: &str, sample_rate: SampleRate, motion: &Motion, trace: Trace) -> Recording {
    let column = |suffix: &str, values| Column { name: format!("{axis}_{suffix}"), values };
    Recording {
        sample_rate,
        experiment: motion.experiment.to_owned(),
        axes: vec![axis.to_owned()],
        columns: vec![
            column("current_ref_a", trace.current_ref_a),
            column("motor_angle_rad", trace.motor_angle_rad),
            column("stage_position_m", trace.stage_position_m),
            column("position_cmd_m", motion.position_m.clone()),
        ],
        start_s: 0.0,
        metadata: Vec::new(),
    }
}
