//! The model with everything that is said in it.

use super::case::Case;
use super::laws::Effect;
use super::number::{INERTIA, Number};
use super::numbers::{Beside, Doubt, beside, common_scale};
use super::rest::Rest;
use super::state::State;
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::result::{Correction, Finding, Verdict};
use crate::plant::drive::{DriveParams, Structure};
use crate::plant::effects::external_disturbance::{RMS, UP_TO};
use crate::plant::effects::{EffectKind, Parameter, ParameterValue, PhysicsTerm, Role, Specification};
use crate::plant::machine::{AxisModel, Machine};

impl Case<'_> {
    /// The stated drive with the numbers that are told to be wrong, as they are told, and with those that the
    /// recordings tell as well as a model states them.
    fn drive(&self, state: &State, doubt: &Doubt, told_wrong: &[Correction]) -> DriveParams {
        // When encoders are read is said by a correction or as it was stated.
        let stated = super::given::folded(self.stated).drive;
        let mut raw = self.balance.drive.raw().clone();
        (raw.motor_encoder_delay_s, raw.stage_encoder_delay_s) =
            (stated.raw().motor_encoder_delay_s, stated.raw().stage_encoder_delay_s);
        let d = &DriveParams::new(raw).unwrap_or(stated);
        let told = beside(self.balance, self.stated, state, doubt);
        let is_of_constant = told_wrong.iter().any(|c| c.name == "torque_constant_nm_a");
        let off = if is_of_constant { common_scale(self.balance, &told) } else { 0.0 };
        // A law that turns friction is one of that friction.
        let mut found = state.accepted.iter().filter(|a| a.given.is_none());
        let turned = found.any(|a| a.hypothesis.facts().turns_friction);
        let is_known = |n: &&Beside| {
            let is_known = n.deviation < Criteria::STANDARD.damping_tolerance * n.value;
            let is_turned = turned && n.number == Number::StageCoulomb;
            let is_there = n.value > 0.0 || is_turned && n.value == 0.0;
            is_there && (is_known || is_turned || n.is_of_second_mass(self.balance))
        };
        let known = told.iter().filter(is_known).map(|n| (n.key, n.under(off)));
        // The balance has the motor's and a stated screw's inertia as one.
        let screw = screw_kg_m2(self.stated);
        let as_one = |(key, value)| (key, if key == INERTIA { value + screw } else { value });
        let wrong = told_wrong.iter().map(|c| (&*c.name, c.value));
        d.with_numbers(known.chain(wrong).map(as_one)).unwrap_or_else(|_| d.clone())
    }

    pub(super) fn recalibrated(&self, state: &State, doubt: &Doubt, told_wrong: &[Correction]) -> AxisModel {
        AxisModel { drive: self.drive(state, doubt, told_wrong), ..self.axis.clone() }
    }

    /// The model with everything that is said in it.
    pub(super) fn model(
        &self,
        verdict: Verdict,
        (state, doubt): (&State, &Doubt),
        (findings, corrections): (&[Finding], &[Correction]),
        (left, is_left): (&Rest, bool),
    ) -> Machine {
        let mut machine = self.machine.clone();
        if verdict == Verdict::UnexplainedMismatch || verdict == Verdict::ModelAdequate {
            return machine;
        }
        let mut axis = self.recalibrated(state, doubt, corrections);
        for (law, sd) in state.accepted.iter().zip(&doubt.laws) {
            if let Some(index) = law.given
                && is_other_size(law.scale, sd.amplitudes.first().copied().unwrap_or(0.0))
            {
                scale_term(&mut axis.physics[index], law.scale);
            }
        }
        for error in self.errors.iter().filter(|e| e.is_other_size()) {
            let (effect, port) = (error.law.hypothesis.effect, error.port());
            let stated = axis.physics.iter_mut().filter(|t| (t.effect, t.port) == (effect, port));
            stated.for_each(|t| *t = self.told_error(error, state).1);
        }
        let mut raw = axis.drive.raw().clone();
        for f in findings {
            let key = Effect::of_kind(f.effect).is_some_and(|e| (e.key)(&f.term, state.now.path, &mut raw));
            if !key {
                axis.physics.push(f.term.clone());
            }
        }
        if state.now.found_smoothing {
            raw.friction_smoothing_m_s = Some(state.now.smoothing_m_s);
        }
        axis.drive = DriveParams::new(raw).unwrap_or(axis.drive);
        if is_left {
            axis.physics.retain(|t| t.effect != EffectKind::ExternalDisturbance);
            let numbers = [(&RMS, left.force_n), (&UP_TO, left.band_hz[1])];
            axis.physics.push(PhysicsTerm::new(EffectKind::ExternalDisturbance, left.port, &numbers));
        }
        restored(self.stated, &mut axis);
        for a in machine.axes.iter_mut().filter(|a| a.name == self.stated.name) {
            *a = axis.clone();
        }
        machine
    }
}

/// True where a stated law has another size.
pub(super) fn is_other_size(scale: f64, deviation: f64) -> bool {
    let c = &Criteria::STANDARD;
    // A law is stated half as well as dry friction.
    let apart = 2.0 * c.correction_tolerances * c.repeatability;
    (scale - 1.0).abs() > apart.max(c.correction_deviations * deviation)
}

/// Parameters that the size of an effect is in.
pub(super) fn sizes(effect: EffectKind) -> impl Iterator<Item = &'static Parameter> {
    let all = Specification::of(effect).map_or(&[][..], |s| s.parameters);
    all.iter().filter(|p| p.role == Role::Size)
}

/// A stated law times a factor.
fn scale_term(term: &mut PhysicsTerm, scale: f64) {
    for (name, value) in &mut term.parameters {
        if sizes(term.effect).any(|p| p.name == name) {
            match value {
                ParameterValue::Number(x) => *x *= scale,
                ParameterValue::List(list) => list.iter_mut().for_each(|x| *x *= scale),
            }
        }
    }
}

/// The inertia of a screw that is stated by itself, beside the motor's, kg m2.
pub(super) fn screw_kg_m2(stated: &AxisModel) -> f64 {
    if stated.drive.structure() == Structure::TripleInertia {
        stated.drive.screw_inertia_kg_m2()
    } else {
        0.0
    }
}

/// A third inertia that was stated stands in the drive again.
fn restored(stated: &AxisModel, axis: &mut AxisModel) {
    let given = stated.drive.raw();
    let screw = screw_kg_m2(stated);
    if screw == 0.0 {
        return;
    }
    let mut raw = axis.drive.raw().clone();
    raw.rotary_inertia_kg_m2 = raw.rotary_inertia_kg_m2.map(|total| (total - screw).max(1e-12));
    raw.screw_inertia_kg_m2 = Some(screw);
    raw.torsional_stiffness_nm_rad = given.torsional_stiffness_nm_rad;
    raw.torsional_damping_nm_s_rad = given.torsional_damping_nm_s_rad;
    if let Ok(drive) = DriveParams::new(raw) {
        axis.drive = drive;
        axis.physics.retain(|t| t.effect != EffectKind::TorsionalMode);
    }
}
