//! Axes of three inertias: motor, screw and stage, with a torsional spring before the axial one.
//!
//! The balance has two measured positions, so the screw is not a side of its own. It is carried as the
//! torsional mode that a model can state beside two inertias, and put back into the drive's own keys at the
//! end.

use super::bench::Bench;
use super::result::{Correction, Diagnosis};
use super::search::Outcome;
use super::shape::Shape;
use crate::plant::drive::{DriveParams, RawDriveParams, Structure};
use crate::plant::effects::coupling::Torsion;
use crate::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};
use crate::plant::machine::{AxisModel, Machine};

/// Deviations of curvature are widened by this, as for the other numbers.
const DEVIATION_FACTOR: f64 = 2.0;

/// Share by which a torsional stiffness must be off to be listed: its mode moves by half of it.
const LEAST_CHANGE: f64 = 0.02;

/// The machine with this axis as two inertias and a torsional mode; `None`: not an axis of three.
pub(super) fn lumped(machine: &Machine, axis: &AxisModel) -> Option<(Machine, AxisModel)> {
    let d = &axis.drive;
    if d.structure() != Structure::TripleInertia {
        return None;
    }
    let per_travel2 = d.travel_m_rad().powi(-2);
    let (motor_kg, screw_kg) = (d.reflected_mass_kg(), d.screw_inertia_kg_m2() * per_travel2);
    let stiffness = d.torsional_stiffness_nm_rad() * per_travel2;
    let damping = d.torsional_damping_nm_s_rad() * per_travel2;
    let frequency_hz = (stiffness * (1.0 / motor_kg + 1.0 / screw_kg)).sqrt() / std::f64::consts::TAU;
    let number = |name: &str, value| (name.to_owned(), ParameterValue::Number(value));
    let mode = PhysicsTerm {
        effect: EffectKind::TorsionalMode,
        port: Port::Coupling,
        parameters: vec![
            number("free_free_frequency_hz", frequency_hz),
            number("screw_inertia_share", screw_kg / (motor_kg + screw_kg)),
            number("damping_ratio", (0.5 * damping / (stiffness * screw_kg).sqrt()).max(1.0e-4)),
        ],
    };
    let mut two = axis.clone();
    two.drive = DriveParams::new(RawDriveParams {
        rotary_inertia_kg_m2: Some(d.rotary_inertia_kg_m2() + d.screw_inertia_kg_m2()),
        screw_inertia_kg_m2: None,
        torsional_stiffness_nm_rad: None,
        torsional_damping_nm_s_rad: None,
        ..d.raw().clone()
    })
    .ok()?;
    two.physics.insert(0, mode);
    let mut machine = machine.clone();
    for a in machine.axes.iter_mut().filter(|a| a.name == axis.name) {
        *a = two.clone();
    }
    Some((machine, two))
}

/// The answer in the keys of the axis as it was stated.
pub(super) fn unlumped(
    mut diagnosis: Diagnosis,
    stated: &AxisModel,
    (outcome, bench): (&Outcome, &Bench<'_>),
) -> Diagnosis {
    let screw = stated.drive.screw_inertia_kg_m2();
    for c in diagnosis.parameter_corrections.iter_mut().filter(|c| c.name == "rotary_inertia_kg_m2") {
        c.nominal -= screw;
        c.value -= screw;
        c.ci95 = c.ci95.map(|end| end - screw);
    }
    // The mode stands as a law of the lumped axis; its stiffness is what the model states.
    diagnosis.parameter_corrections.retain(|c| !c.name.starts_with("torsional_mode."));
    let spring = torsional_spring(stated, (outcome, bench));
    diagnosis.parameter_corrections.extend(spring.clone());
    for axis in diagnosis.model.axes.iter_mut().filter(|a| a.name == stated.name) {
        let given = stated.drive.raw();
        let raw = RawDriveParams {
            rotary_inertia_kg_m2: axis.drive.raw().rotary_inertia_kg_m2.map(|total| total - screw),
            screw_inertia_kg_m2: given.screw_inertia_kg_m2,
            torsional_stiffness_nm_rad: spring
                .as_ref()
                .map_or(given.torsional_stiffness_nm_rad, |c| Some(c.value)),
            torsional_damping_nm_s_rad: given.torsional_damping_nm_s_rad,
            ..axis.drive.raw().clone()
        };
        if let Ok(drive) = DriveParams::new(raw) {
            axis.drive = drive;
            axis.physics.remove(0);
        }
    }
    diagnosis
}

/// The torsional stiffness where the mode stands elsewhere than stated.
fn torsional_spring(stated: &AxisModel, (outcome, bench): (&Outcome, &Bench<'_>)) -> Option<Correction> {
    let Shape::Torsion { frequency_hz, .. } = outcome.state.accepted.first()?.hypothesis.shape else {
        return None;
    };
    let d = &stated.drive;
    let r2 = d.travel_m_rad().powi(2);
    let value = r2 * Torsion::stiffness_of(frequency_hz, d.reflected_mass_kg(), d.screw_inertia_kg_m2() / r2);
    let nominal = d.torsional_stiffness_nm_rad();
    // k goes with the square of the frequency.
    let deviation = 2.0 * DEVIATION_FACTOR * bench.accepted_fit(0).step_deviations.first()? * value;
    let apart = (value - nominal).abs();
    let half = 1.96 * deviation;
    (apart > 4.0 * deviation && apart > LEAST_CHANGE * nominal).then_some(Correction {
        name: "torsional_stiffness_nm_rad".into(),
        nominal,
        value,
        ci95: [value - half, value + half],
    })
}
