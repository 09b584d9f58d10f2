//! What a model states beyond its structure, and how a balance takes it in.

use super::number::Mechanics;
use super::shape::{Hypothesis, Shape};
use super::state::Accepted;
use crate::plant::drive::{DriveParams, RawDriveParams, Structure};
use crate::plant::effects::law::{EncoderError, ForceLaw};
use crate::plant::effects::{EffectKind as E, ParameterValue, PhysicsTerm, Port};
use crate::plant::machine::AxisModel;
use std::f64::consts::TAU;

/// The axis with everything in its drive that is a number of the structure by another name, and with a third
/// inertia as a mode.
pub(super) fn folded(axis: &AxisModel) -> AxisModel {
    let mut raw = axis.drive.raw().clone();
    let mut physics: Vec<PhysicsTerm> =
        axis.physics.iter().filter(|t| into_keys(t, &mut raw).is_none()).cloned().collect();
    if axis.drive.structure() == Structure::TripleInertia {
        physics.push(lumped(&axis.drive, &mut raw));
    }
    let drive = DriveParams::new(raw).unwrap_or_else(|_| axis.drive.clone());
    AxisModel { drive, physics, ..axis.clone() }
}

/// Terms that are keys of a drive.
fn into_keys(term: &PhysicsTerm, raw: &mut RawDriveParams) -> Option<()> {
    let add = |t: &mut Option<f64>, extra: f64| *t = Some((t.unwrap_or(0.0) + extra).max(0.0));
    let r2 = raw.screw_lead_m.map_or(1.0, |l| (l / TAU).powi(2));
    let at_motor = term.port == Port::Motor;
    match (term.effect, term.port) {
        (E::DeadTime, Port::MotorEncoder) => {
            add(&mut raw.motor_encoder_delay_s, term.number("extra_delay_s")?)
        }
        (E::DeadTime, Port::StageEncoder) => {
            add(&mut raw.stage_encoder_delay_s, term.number("extra_delay_s")?)
        }
        (E::DeadTime, _) => add(&mut raw.amplifier_dead_time_s, term.number("extra_delay_s")?),
        (E::CurrentLoopLag, _) => raw.current_loop_bandwidth_rad_s = Some(term.number("bandwidth_rad_s")?),
        (E::CoulombFriction, _) if at_motor => {
            add(&mut raw.motor_coulomb_friction_n, term.number("force_n")?);
        }
        (E::CoulombFriction, _) => add(&mut raw.stage_coulomb_friction_n, term.number("force_n")?),
        (E::ViscousFriction, _) if at_motor => {
            add(&mut raw.rotary_damping_nm_s_rad, term.number("n_s_m")? * r2);
        }
        (E::ViscousFriction, _) => add(&mut raw.translational_damping_n_s_m, term.number("n_s_m")?),
        _ => return None,
    }
    Some(())
}

/// Motor and screw as one inertia, and the mode between them.
fn lumped(drive: &DriveParams, raw: &mut RawDriveParams) -> PhysicsTerm {
    let (motor, screw) = (drive.rotary_inertia_kg_m2(), drive.screw_inertia_kg_m2());
    let k = drive.torsional_stiffness_nm_rad();
    raw.rotary_inertia_kg_m2 = Some(motor + screw);
    (raw.screw_inertia_kg_m2, raw.torsional_stiffness_nm_rad, raw.torsional_damping_nm_s_rad) =
        (None, None, None);
    let frequency_hz = (k * (motor + screw) / (motor * screw)).sqrt() / TAU;
    let damping = drive.torsional_damping_nm_s_rad() / (2.0 * (k * screw).sqrt());
    let number = |name: &str, value| (name.to_owned(), ParameterValue::Number(value));
    PhysicsTerm {
        effect: E::TorsionalMode,
        port: Port::Coupling,
        parameters: vec![
            number("free_free_frequency_hz", frequency_hz),
            number("screw_inertia_share", screw / (motor + screw)),
            number("damping_ratio", damping),
        ],
    }
}

/// The stated laws that this balance can evaluate, with the names of those that it cannot.
pub(super) fn given(axis: &AxisModel, m: &Mechanics) -> (Vec<Accepted>, Vec<String>) {
    let (mut list, mut left) = (Vec::new(), Vec::new());
    for (k, term) in axis.physics.iter().enumerate() {
        match law(axis, term, m) {
            Some(accepted) => list.push(Accepted { given: Some(k), ..accepted }),
            None if matches!(term.effect, E::ExternalDisturbance | E::EncoderQuantization) => {}
            None => left.push(format!(
                "{} at {} stands in the model and is not heeded by this diagnosis.",
                term.effect.name(),
                term.port.name()
            )),
        }
    }
    (list, left)
}

fn law(axis: &AxisModel, term: &PhysicsTerm, m: &Mechanics) -> Option<Accepted> {
    let get = |name: &str| term.number(name);
    let flips = get("with_direction").is_some_and(|x| x != 0.0);
    let of = |shape, amplitudes: Vec<f64>| {
        Accepted::found(Hypothesis::named(term.effect, term.port, shape), amplitudes)
    };
    if let Some(law) = ForceLaw::of(term, axis.drive.screw_lead_m())
        && !(flips && matches!(law, ForceLaw::Map { .. }))
    {
        return Some(Accepted { stated: Some(law), ..of(Shape::Gravity, vec![1.0]) });
    }
    Some(match term.effect {
        E::PreslidingFriction => {
            let total_n = m.stage_coulomb_n;
            let yield_m = total_n / get("presliding_stiffness_n_m")?;
            of(
                Shape::Presliding { yield_m },
                vec![get("share").unwrap_or(1.0) * total_n, get("bristle_rate_n").unwrap_or(0.0)],
            )
        }
        E::FrictionDrift => {
            let change_n = get("relative_change")? * m.stage_coulomb_n;
            of(Shape::Drift { tau_s: get("time_constant_s")? }, vec![change_n])
        }
        E::TorqueConstantSaturation => {
            let parabolic = get("parabolic").unwrap_or(0.0);
            of(Shape::Saturation { per_a2: get("per_a2")?, parabolic }, vec![1.0])
        }
        E::Backlash if get("force_n").is_some() => {
            let (force_n, stiffness) = (get("force_n")?, get("stiffness_n_m")?);
            of(Shape::Play { gap_m: get("gap_m")?, yield_m: force_n / stiffness }, vec![force_n])
        }
        E::Backlash => {
            let loose = get("loose_damper").is_some_and(|x| x != 0.0);
            let gap_m = get("gap_m")?;
            let shape = match get("flank_m") {
                Some(flank_m) => Shape::Gap { gap_m, flank_m },
                None => Shape::Backlash { gap_m, loose },
            };
            of(shape, vec![1.0])
        }
        E::NonlinearStiffness => of(Shape::Cubic, vec![get("cubic_n_m3")?]),
        E::PositionDependentStiffness => {
            let (r, length_m) = (get("relative_variation")?, get("length_m")?);
            match get("phase_rad") {
                Some(p) => of(Shape::StiffnessWave { length_m }, vec![r * p.cos(), r * p.sin()]),
                None => of(Shape::StiffnessSlope, vec![r / length_m]),
            }
        }
        E::TorsionalMode => {
            let shape = Shape::Torsion {
                frequency_hz: get("free_free_frequency_hz")?,
                share: get("screw_inertia_share").unwrap_or(0.5),
                damping: get("damping_ratio").unwrap_or(0.02),
            };
            of(shape, vec![1.0])
        }
        E::EncoderInterpolationError => {
            let error = EncoderError::of(term)?;
            let (period_m, harmonics) = error.wave();
            let first = harmonics.first().copied().unwrap_or([0.0; 2]);
            let second = harmonics.get(1).copied().unwrap_or([0.0; 2]);
            let [sine_m, cosine_m] = first;
            of(
                Shape::EncoderError { period_m, sine_m, cosine_m },
                vec![first[0], first[1], second[0], second[1]],
            )
        }
        _ => return None,
    })
}

/// Force that the model states to leave unexplained, N.
pub(super) fn stated_rest_n(axis: &AxisModel) -> f64 {
    let terms = axis.physics.iter().filter(|t| t.effect == E::ExternalDisturbance);
    terms.filter_map(|t| t.number("force_rms_n")).fold(0.0, f64::max)
}
