//! What a model states beyond its structure, and how a balance takes it in.

use super::laws::{Effect, Hypothesis, Shape, Stated};
use super::number::Mechanics;
use super::state::{Accepted, Balance, stated_mechanics};
use crate::plant::drive::{DriveParams, RawDriveParams, Structure};
use crate::plant::effects::encoder_interpolation_error::EncoderError;
use crate::plant::effects::law::ForceLaw;
use crate::plant::effects::{
    EffectKind as E, PhysicsTerm, WITH_DIRECTION, external_disturbance, torsional_mode,
};
use crate::plant::machine::AxisModel;
use std::f64::consts::TAU;

/// The axis with everything in its drive that is a number of the structure by another name, and with a third
/// inertia as a mode.
pub(super) fn folded(axis: &AxisModel) -> AxisModel {
    let mut raw = axis.drive.raw().clone();
    let mut physics: Vec<PhysicsTerm> =
        axis.physics.iter().filter(|t| t.into_key(&mut raw).is_none()).cloned().collect();
    if axis.drive.structure() == Structure::TripleInertia {
        physics.push(lumped(&axis.drive, &mut raw));
    }
    let drive = DriveParams::new(raw).unwrap_or_else(|_| axis.drive.clone());
    AxisModel { drive, physics, ..axis.clone() }
}

/// The axis with the stage's encoder read later by so much, or the motor's where that is less than nothing.
pub(super) fn read_later(axis: &AxisModel, later_s: f64) -> AxisModel {
    let d = &axis.drive;
    let numbers = [
        ("motor_encoder_delay_s", d.motor_encoder_delay_s() + (-later_s).max(0.0)),
        ("stage_encoder_delay_s", d.stage_encoder_delay_s() + later_s.max(0.0)),
    ];
    let drive = d.with_numbers(numbers).unwrap_or_else(|_| d.clone());
    AxisModel { drive, ..axis.clone() }
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
    torsional_mode::term([frequency_hz, screw / (motor + screw), damping])
}

/// The stated laws that this balance can evaluate and its positions are not free of, with the names of those
/// that it cannot; `[stated, axis]`:
/// the axis as stated, and [`folded`].
pub(super) fn given([stated, axis]: [&AxisModel; 2], balance: &Balance) -> (Vec<Accepted>, Vec<String>) {
    let m = &stated_mechanics(balance);
    let read_right = |t: &PhysicsTerm| EncoderError::of(t).is_some() && balance.read_right.contains(&t.port);
    let three = stated.drive.structure() == Structure::TripleInertia;
    let (mut list, mut left) = (Vec::new(), Vec::new());
    for (k, term) in axis.physics.iter().enumerate().filter(|(_, term)| !read_right(term)) {
        match law(axis, term, m) {
            Some(mut accepted) => {
                if three && k + 1 == axis.physics.len() {
                    accepted.hypothesis.law_mut().state_by_parts();
                }
                list.push(Accepted { given: Some(k), ..accepted });
            }
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
    let of = |shape: Shape, amplitudes| {
        let hypothesis = Hypothesis { effect: term.effect, port: term.port, shape };
        Accepted::found(hypothesis, amplitudes)
    };
    if let Some(law) = ForceLaw::of(term, axis.drive.screw_lead_m()) {
        // No table turns with the direction.
        let is_told = !(term.says(&WITH_DIRECTION) && matches!(law, ForceLaw::Map { .. }));
        let stated = Shape::Stated(Stated { effect: term.effect });
        return is_told.then(|| Accepted { stated: Some(law), ..of(stated, vec![1.0]) });
    }
    let (shape, amplitudes) = (Effect::of_kind(term.effect)?.stated)(term, m)?;
    Some(of(shape, amplitudes))
}

/// Force that the model states to leave unexplained, N.
pub(super) fn stated_rest_n(axis: &AxisModel) -> f64 {
    let terms = axis.physics.iter().filter(|t| t.effect == E::ExternalDisturbance);
    terms.filter_map(|t| t.value(&external_disturbance::RMS)).fold(0.0, f64::max)
}
