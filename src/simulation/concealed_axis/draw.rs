//! Drawing a machine and what it hides: true constants around a model's, an effect of a size that
//! real axes have, scaled by a depth from 1 (plain) to 0 (nothing).

use super::CaseError;
use super::closed_loop::{Background, Instruments, phase};
use super::plant::{HiddenCut, HiddenPhysics, TrueDrive, Wave};
use crate::plant::effects::{EffectKind, Port};
use rand::{Rng, RngExt};

/// What was hidden in a machine, for the judge.
#[derive(Debug, Clone, PartialEq)]
pub struct HiddenEffect {
    /// `stribeck_friction`, `encoder_interpolation_error/stage`, `parameter/movable_mass`, `unknown/...`.
    pub name: String,
    /// Where it enters.
    pub port: Port,
    /// 1: as large as plain cases are.
    pub depth: f64,
    /// Its parameters as they were simulated.
    pub parameters: Vec<(&'static str, f64)>,
}

/// Everything of a machine that an effect may touch.
pub(super) struct Draft {
    pub(super) drive: TrueDrive,
    pub(super) physics: HiddenPhysics,
    pub(super) instruments: Instruments,
    pub(super) background: Background,
    pub(super) lead_m: f64,
    pub(super) poles: f64,
    pub(super) slots: f64,
    pub(super) motor_signals_per_rev: f64,
    pub(super) stage_signal_period_m: f64,
    /// The model to be judged must not state a current loop: its lag is what is hidden.
    pub(super) forget_current_loop: bool,
    /// The same for the stage's Coulomb friction.
    pub(super) forget_coulomb: bool,
    /// The same for the stage's viscous friction.
    pub(super) forget_viscous: bool,
}

/// Names that [`hide`] knows beside the vocabulary of effects: outsiders and wrong numbers.
pub const OUTSIDE: [&str; 10] = [
    "unknown/random_walk",
    "unknown/base_resonance",
    "unknown/position_velocity_friction",
    "unknown/scale_drift",
    "parameter/movable_mass",
    "parameter/rotary_inertia",
    "parameter/axial_stiffness",
    "parameter/torque_constant",
    "parameter/translational_damping",
    "parameter/stage_coulomb_friction",
];

/// Effects of the feed drive that can be hidden, a default list for a study.
#[must_use]
pub fn feed_drive_effects() -> Vec<&'static str> {
    let special = [
        "position_periodic_force/lead",
        "position_periodic_force/ball",
        "encoder_interpolation_error/motor",
        "encoder_interpolation_error/stage",
    ];
    let plain = EffectKind::ALL.iter().filter(|k| {
        let later = **k as usize > EffectKind::ExternalDisturbance as usize;
        !later && !matches!(k, EffectKind::PositionPeriodicForce | EffectKind::EncoderInterpolationError)
    });
    plain.map(|k| k.name()).chain(special).collect()
}

type Parameters = Vec<(&'static str, f64)>;

/// Puts the effect of that name into the machine at `depth`.
///
/// Ranges: section 3 of the survey of missing physics (10-20 mm lead machine-tool axes).
/// Errors: a name that is neither of the vocabulary of feed drives nor in [`OUTSIDE`].
pub(super) fn hide(
    draft: &mut Draft,
    name: &str,
    depth: f64,
    rng: &mut impl Rng,
) -> Result<HiddenEffect, CaseError> {
    let drawn = friction(draft, name, depth, rng)
        .or_else(|| forces(draft, name, depth, rng))
        .or_else(|| coupling(draft, name, depth, rng))
        .or_else(|| signals(draft, name, depth, rng))
        .or_else(|| outsiders(draft, name, depth, rng))
        .or_else(|| wrong_number(draft, name, depth, rng));
    let Some((port, parameters)) = drawn else {
        return Err(CaseError::UnknownEffect { name: name.to_owned() });
    };
    Ok(HiddenEffect { name: name.to_owned(), port, depth, parameters })
}

fn sign(rng: &mut impl Rng) -> f64 {
    if rng.random_bool(0.5) { 1.0 } else { -1.0 }
}

fn friction(draft: &mut Draft, name: &str, depth: f64, rng: &mut impl Rng) -> Option<(Port, Parameters)> {
    let p = &mut draft.physics;
    let level = draft.drive.stage_coulomb_friction_n.max(20.0);
    let parameters = match name {
        // A model that states some friction has a wrong number; what is hidden here is all of it.
        "coulomb_friction" => {
            draft.forget_coulomb = true;
            draft.drive.stage_coulomb_friction_n = depth * level * rng.random_range(0.3..1.0);
            vec![("force_n", draft.drive.stage_coulomb_friction_n)]
        }
        "viscous_friction" => {
            draft.forget_viscous = true;
            draft.drive.translational_damping_n_s_m *= depth;
            vec![("n_s_m", draft.drive.translational_damping_n_s_m)]
        }
        "stribeck_friction" => {
            p.stribeck_force_n = depth * level * rng.random_range(0.15..0.4);
            p.stribeck_velocity_m_s = rng.random_range(2.0e-3..10.0e-3);
            vec![("stribeck_force_n", p.stribeck_force_n), ("stribeck_velocity_m_s", p.stribeck_velocity_m_s)]
        }
        "presliding_friction" => {
            let stiffness = rng.random_range(2.0e6..8.0e6) / depth;
            p.presliding_stiffness_n_m = Some(stiffness);
            vec![("presliding_stiffness_n_m", stiffness)]
        }
        "asymmetric_friction" => {
            p.asymmetry_n = depth * level * rng.random_range(0.1..0.25) * sign(rng);
            vec![("force_difference_n", p.asymmetry_n)]
        }
        "nonlinear_viscosity" => {
            p.nonlinear_viscosity_n_s2_m2 = depth * rng.random_range(2000.0..6000.0);
            vec![("n_s2_m2", p.nonlinear_viscosity_n_s2_m2)]
        }
        "friction_drift" => {
            p.friction_relative_change = -depth * rng.random_range(0.1..0.3);
            p.friction_time_constant_s = rng.random_range(4.0..15.0);
            vec![
                ("relative_change", p.friction_relative_change),
                ("time_constant_s", p.friction_time_constant_s),
            ]
        }
        _ => return None,
    };
    Some((Port::Stage, parameters))
}

fn forces(draft: &mut Draft, name: &str, depth: f64, rng: &mut impl Rng) -> Option<(Port, Parameters)> {
    let level = draft.drive.stage_coulomb_friction_n.max(20.0);
    let amplitude = depth * level * rng.random_range(0.08..0.18);
    let lead = draft.lead_m;
    let p = &mut draft.physics;
    let (port, parameters) = match name {
        "position_periodic_force" | "position_periodic_force/lead" | "position_periodic_force/ball" => {
            let wavelength_m = match name.rsplit('/').next() {
                Some("ball") => lead / rng.random_range(6.2..13.8),
                _ if name.ends_with("lead") => lead / if rng.random_bool(0.7) { 1.0 } else { 2.0 },
                _ => lead / rng.random_range(0.8..10.0),
            };
            p.stage_waves.push(Wave { wavelength_m, amplitude, phase_rad: phase(rng) });
            (Port::Stage, vec![("wavelength_m", wavelength_m), ("amplitude_n", amplitude)])
        }
        "position_dependent_force" => {
            p.bumps = (0..rng.random_range(2..5))
                .map(|_| {
                    let centre = rng.random_range(-16.0e-3..16.0e-3);
                    [centre, rng.random_range(1.5e-3..5.0e-3), sign(rng) * 2.0 * amplitude]
                })
                .collect();
            (Port::Stage, Vec::new()) // a map; the concealed force judges it
        }
        "torque_ripple" => {
            let lcm = least_common_multiple(draft.poles, draft.slots);
            let orders = [0.5 * draft.poles, draft.poles, draft.slots, lcm];
            let order = orders[rng.random_range(0..orders.len())];
            p.motor_waves.push(Wave { wavelength_m: lead / order, amplitude, phase_rad: phase(rng) });
            (Port::Motor, vec![("order_per_rev", order), ("amplitude_n", amplitude)])
        }
        "torque_constant_saturation" => {
            p.saturation_per_a2 = depth * rng.random_range(0.004..0.010);
            (Port::Current, vec![("per_a2", p.saturation_per_a2)])
        }
        "gravity_load" => {
            p.gravity_n = depth * level * rng.random_range(0.15..0.4) * sign(rng);
            (Port::Stage, vec![("force_n", p.gravity_n)])
        }
        "cutting_force" => {
            let start_s = rng.random_range(0.4..2.5);
            let end_s = start_s + rng.random_range(2.0..5.0);
            let fundamental_hz = rng.random_range(20.0..120.0);
            let peak_n = amplitude * HiddenCut::PEAK;
            p.cut = Some(HiddenCut { fundamental_hz, peak_n, start_s, end_s });
            let span = [("start_s", start_s), ("end_s", end_s)];
            let size = [("fundamental_hz", fundamental_hz), ("amplitude_n", peak_n)];
            (Port::Stage, size.into_iter().chain(span).collect())
        }
        "external_disturbance" => {
            p.pulses = (0..6)
                .map(|_| {
                    [rng.random_range(0.2..6.0), rng.random_range(0.02..0.2), 1.5 * amplitude * sign(rng)]
                })
                .collect();
            (Port::Stage, vec![("amplitude_n", 1.5 * amplitude)])
        }
        _ => return None,
    };
    Some((port, parameters))
}

fn least_common_multiple(a: f64, b: f64) -> f64 {
    let (a, b) = (a.round().max(1.0) as u64, b.round().max(1.0) as u64);
    let (mut x, mut y) = (a, b);
    while y != 0 {
        (x, y) = (y, x % y);
    }
    (a / x * b) as f64
}

fn coupling(draft: &mut Draft, name: &str, depth: f64, rng: &mut impl Rng) -> Option<(Port, Parameters)> {
    let stiffness = draft.drive.axial_stiffness_n_m;
    let p = &mut draft.physics;
    let parameters = match name {
        "backlash" => {
            p.gap_m = depth * rng.random_range(0.6e-6..1.6e-6);
            vec![("gap_m", p.gap_m)]
        }
        "torsional_mode" => {
            // Shallower means stiffer: the mode leaves the band upwards.
            let frequency_hz = rng.random_range(650.0..1050.0) / depth.sqrt();
            p.torsion = Some((frequency_hz, rng.random_range(0.4..0.6)));
            vec![("free_free_frequency_hz", frequency_hz)]
        }
        "position_dependent_stiffness" => {
            p.stiffness_variation = depth * rng.random_range(0.1..0.3) * sign(rng);
            p.stiffness_length_m = 0.02 * rng.random_range(1.0..2.0);
            vec![("relative_variation", p.stiffness_variation), ("length_m", p.stiffness_length_m)]
        }
        "nonlinear_stiffness" => {
            // Share of the linear stiffness at the deflection that friction causes.
            let deflection = draft.drive.stage_coulomb_friction_n.max(20.0) / stiffness;
            p.cubic_n_m3 = depth * rng.random_range(0.15..0.5) * stiffness / deflection.powi(2);
            vec![("cubic_n_m3", p.cubic_n_m3)]
        }
        _ => return None,
    };
    Some((Port::Coupling, parameters))
}

fn signals(draft: &mut Draft, name: &str, depth: f64, rng: &mut impl Rng) -> Option<(Port, Parameters)> {
    let i = &mut draft.instruments;
    let (port, parameters) = match name {
        "dead_time" => {
            let extra = depth * rng.random_range(0.1e-3..0.4e-3);
            i.dead_time_s += extra;
            (Port::Current, vec![("extra_delay_s", extra)])
        }
        "current_loop_lag" => {
            let bandwidth = rng.random_range(2000.0..5000.0) / depth;
            draft.drive.current_loop_bandwidth_rad_s = Some(bandwidth);
            draft.forget_current_loop = true;
            (Port::Current, vec![("bandwidth_rad_s", bandwidth)])
        }
        "encoder_interpolation_error"
        | "encoder_interpolation_error/stage"
        | "encoder_interpolation_error/motor" => {
            let motor = name.ends_with("motor");
            let period =
                if motor { draft.lead_m / draft.motor_signals_per_rev } else { draft.stage_signal_period_m };
            let amplitude = depth * rng.random_range(8.0e-9..25.0e-9);
            let wave = Some(Wave { wavelength_m: period, amplitude, phase_rad: phase(rng) });
            if motor {
                i.motor_error = wave;
            } else {
                i.stage_error = wave;
            }
            let port = if motor { Port::MotorEncoder } else { Port::StageEncoder };
            (port, vec![("signal_period_m", period), ("amplitude_m", amplitude)])
        }
        "encoder_quantization" => {
            i.stage_step_m = i.stage_step_m.max(depth * rng.random_range(20.0e-9..80.0e-9));
            (Port::StageEncoder, vec![("step_m", i.stage_step_m)])
        }
        _ => return None,
    };
    Some((port, parameters))
}

fn outsiders(draft: &mut Draft, name: &str, depth: f64, rng: &mut impl Rng) -> Option<(Port, Parameters)> {
    let (port, parameters) = match name {
        "unknown/random_walk" => {
            draft.background.random_walk_n = depth * rng.random_range(3.0..6.0);
            (Port::Stage, vec![("n_per_root_s", draft.background.random_walk_n)])
        }
        "unknown/base_resonance" => {
            let mode = [
                rng.random_range(35.0..110.0),
                rng.random_range(0.01..0.03),
                depth * rng.random_range(0.01..0.03),
            ];
            draft.physics.base_mode = Some(mode);
            (
                Port::StageEncoder,
                vec![("frequency_hz", mode[0]), ("damping_ratio", mode[1]), ("gain", mode[2])],
            )
        }
        "unknown/position_velocity_friction" => {
            draft.physics.sloped_viscosity_n_s_m2 = depth * rng.random_range(1.0e4..3.0e4) * sign(rng);
            (Port::Stage, vec![("n_s_m2", draft.physics.sloped_viscosity_n_s_m2)])
        }
        "unknown/scale_drift" => {
            draft.instruments.stage_drift_m_s = depth * rng.random_range(0.05e-6..0.15e-6) * sign(rng);
            (Port::StageEncoder, vec![("m_s", draft.instruments.stage_drift_m_s)])
        }
        _ => return None,
    };
    Some((port, parameters))
}

fn wrong_number(draft: &mut Draft, name: &str, depth: f64, rng: &mut impl Rng) -> Option<(Port, Parameters)> {
    let d = &mut draft.drive;
    let factor = 1.0 + depth * rng.random_range(0.2..0.45);
    let (port, key, value): (Port, &'static str, &mut f64) = match name {
        "parameter/movable_mass" => (Port::Stage, "movable_mass_kg", &mut d.movable_mass_kg),
        "parameter/rotary_inertia" => (Port::Motor, "reflected_mass_kg", &mut d.reflected_mass_kg),
        "parameter/axial_stiffness" => (Port::Coupling, "axial_stiffness_n_m", &mut d.axial_stiffness_n_m),
        "parameter/torque_constant" => (Port::Current, "thrust_constant_n_a", &mut d.thrust_constant_n_a),
        "parameter/translational_damping" => {
            (Port::Stage, "translational_damping_n_s_m", &mut d.translational_damping_n_s_m)
        }
        "parameter/stage_coulomb_friction" => {
            (Port::Stage, "stage_coulomb_friction_n", &mut d.stage_coulomb_friction_n)
        }
        _ => return None,
    };
    *value *= factor;
    Some((port, vec![(key, *value)]))
}
