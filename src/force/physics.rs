//! Physics that a model has beyond its structure, taken off the estimate.
//!
//! Each term of `[[axes.<axis>.physics]]` whose law exists as a force, an encoder error or a delay is
//! turned into its share of the force balance; the others are named, not silently dropped.

use super::guideway::GuidewayTravel;
use crate::plant::drive::{DriveParams, RawDriveParams};
use crate::plant::effects::encoder_interpolation_error::EncoderError;
use crate::plant::effects::law::ForceLaw;
use crate::plant::effects::torque_constant_saturation::{PARABOLIC, PER_A2, lost_share};
use crate::plant::effects::{
    EffectKind, PhysicsTerm, Port, coulomb_friction, presliding_friction, torsional_mode,
};

/// Terms of one axis, ready to be evaluated.
#[derive(Debug, Clone, PartialEq)]
pub struct PhysicsModel {
    motor: Vec<ForceLaw>,
    stage: Vec<ForceLaw>,
    motor_encoder: Vec<EncoderError>,
    stage_encoder: Vec<EncoderError>,
    saturation_1_n2: f64,
    /// 0: K / (1 + c u^2), 1: K (1 - c u^2).
    parabolic: f64,
    smoothing_m_s: f64,
    guideway: GuidewayTravel,
    /// Effects whose law cannot be taken off a force estimate.
    pub not_applied: Vec<EffectKind>,
    /// Frequencies of modes that the terms state and the balance does not have, Hz.
    pub modes_hz: Vec<f64>,
}

impl Default for PhysicsModel {
    /// Nothing beyond the structure.
    fn default() -> Self {
        Self {
            motor: Vec::new(),
            stage: Vec::new(),
            motor_encoder: Vec::new(),
            stage_encoder: Vec::new(),
            saturation_1_n2: 0.0,
            parabolic: 0.0,
            smoothing_m_s: 2e-4,
            guideway: GuidewayTravel::default(),
            not_applied: Vec::new(),
            modes_hz: Vec::new(),
        }
    }
}

/// The model's terms and the drive that carries those of them which are parameters of a drive (dead
/// time, current loop, Coulomb friction of a flexible axis).
#[must_use]
pub fn physics_of(terms: &[PhysicsTerm], drive: &DriveParams) -> (PhysicsModel, DriveParams) {
    let mut model = PhysicsModel { smoothing_m_s: drive.friction_smoothing_m_s(), ..PhysicsModel::default() };
    let mut raw = drive.raw().clone();
    for term in terms {
        if term.effect == EffectKind::TorsionalMode {
            model.modes_hz.extend(term.value(&torsional_mode::FREQUENCY));
        }
        if model.add(term, &mut raw).is_none() {
            model.not_applied.push(term.effect);
        }
    }
    let drive = DriveParams::new(raw).unwrap_or_else(|_| drive.clone());
    (model, drive)
}

impl PhysicsModel {
    /// Adds one term; `None` when it has no law here or lacks a parameter.
    fn add(&mut self, term: &PhysicsTerm, raw: &mut RawDriveParams) -> Option<()> {
        use EffectKind as E;
        // A flexible axis has a place for it in the drive, where the guideway's law and every check see it.
        if let (E::CoulombFriction, Some(_)) = (term.effect, raw.axial_stiffness_n_m) {
            let force_n = term.value(&coulomb_friction::FORCE)?;
            let place = match term.port {
                Port::Motor | Port::Current => &mut raw.motor_coulomb_friction_n,
                _ => &mut raw.stage_coulomb_friction_n,
            };
            let sum_n = place.unwrap_or(0.0) + force_n;
            if sum_n >= 0.0 {
                *place = Some(sum_n);
                return Some(());
            }
        }
        let Some(law) = ForceLaw::of(term, raw.screw_lead_m) else {
            return self.add_other(term.effect, term, raw);
        };
        match term.port {
            Port::Motor | Port::Current => self.motor.push(law),
            _ => self.stage.push(law),
        }
        Some(())
    }

    /// Terms that are not forces: errors of encoders, delays, saturation, pre-sliding.
    fn add_other(&mut self, effect: EffectKind, term: &PhysicsTerm, raw: &mut RawDriveParams) -> Option<()> {
        use EffectKind as E;
        match effect {
            E::EncoderInterpolationError => {
                let error = EncoderError::of(term)?;
                if term.port == Port::MotorEncoder {
                    self.motor_encoder.push(error);
                } else {
                    self.stage_encoder.push(error);
                }
            }
            E::TorqueConstantSaturation => {
                let per_ampere = raw.torque_constant_nm_a? * std::f64::consts::TAU / raw.screw_lead_m?;
                self.saturation_1_n2 += term.value(&PER_A2)? / (per_ampere * per_ampere);
                self.parabolic = term.value(&PARABOLIC).unwrap_or(0.0);
            }
            E::PreslidingFriction => {
                let stiffness = term.value(&presliding_friction::STIFFNESS)?;
                let coulomb = raw.stage_coulomb_friction_n.or(raw.motor_coulomb_friction_n)?;
                self.guideway = GuidewayTravel::Stated((coulomb / stiffness).max(1e-9));
            }
            // What is a key of a drive by another name, such as a delay.
            _ => term.into_key(raw)?,
        }
        Some(())
    }

    /// Travel over which the guideway's friction turns, where a term states it.
    #[must_use]
    pub fn guideway(&self) -> GuidewayTravel {
        self.guideway
    }

    /// Coulomb friction among the terms, N: what can hide a force on an axis that stands still.
    #[must_use]
    pub fn coulomb_n(&self) -> f64 {
        let of = |law: &ForceLaw| if let ForceLaw::Coulomb { force_n } = law { *force_n } else { 0.0 };
        self.motor.iter().chain(&self.stage).map(of).sum()
    }

    /// True when nothing is taken off.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.motor.is_empty()
            && self.stage.is_empty()
            && self.motor_encoder.is_empty()
            && self.stage_encoder.is_empty()
            && self.saturation_1_n2 == 0.0
    }

    /// Thrust that the motor gives for what it was told, N: u / (1 + c u^2), or u (1 - c u^2) where the model
    /// says so.
    #[inline]
    #[must_use]
    pub fn thrust_n(&self, told_n: f64) -> f64 {
        let bent = self.saturation_1_n2 * told_n * told_n;
        told_n * (1.0 - lost_share(bent, self.parabolic))
    }

    /// Motor travel without the encoder's periodic error, m.
    #[inline]
    #[must_use]
    pub fn motor_travel_m(&self, read_m: f64) -> f64 {
        read_m - self.motor_encoder.iter().map(|e| e.at(read_m)).sum::<f64>()
    }

    /// Stage position without the scale's periodic error, m.
    #[inline]
    #[must_use]
    pub fn stage_position_m(&self, read_m: f64) -> f64 {
        read_m - self.stage_encoder.iter().map(|e| e.at(read_m)).sum::<f64>()
    }

    /// Disturbance at the motor, as a force against its motion, N.
    #[inline]
    #[must_use]
    pub fn motor_n(&self, position_m: f64, velocity_m_s: f64) -> f64 {
        self.motor.iter().map(|law| law.force_n(position_m, velocity_m_s, self.smoothing_m_s)).sum()
    }

    /// Disturbance at the stage, as a force against its motion, N.
    #[inline]
    #[must_use]
    pub fn stage_n(&self, position_m: f64, velocity_m_s: f64) -> f64 {
        self.stage.iter().map(|law| law.force_n(position_m, velocity_m_s, self.smoothing_m_s)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::effects::ParameterValue;

    fn term(effect: EffectKind, port: Port, parameters: &[(&str, f64)]) -> PhysicsTerm {
        let parameters =
            parameters.iter().map(|(n, v)| ((*n).to_owned(), ParameterValue::Number(*v))).collect();
        PhysicsTerm { effect, port, parameters }
    }

    fn rigid() -> DriveParams {
        DriveParams::new(RawDriveParams { movable_mass_kg: Some(95.0), ..RawDriveParams::default() }).unwrap()
    }

    #[test]
    fn a_ladder_of_friction_adds_up() {
        let terms = [
            term(EffectKind::ViscousFriction, Port::Stage, &[("n_s_m", 200.0)]),
            term(EffectKind::CoulombFriction, Port::Stage, &[("force_n", 20.0)]),
            term(EffectKind::GravityLoad, Port::Stage, &[("force_n", -3.0)]),
        ];
        let (model, _) = physics_of(&terms, &rigid());
        assert!((model.stage_n(0.0, 0.1) - 37.0).abs() < 1e-9);
        assert!((model.stage_n(0.0, -0.1) + 43.0).abs() < 1e-9);
    }

    #[test]
    fn an_amplitude_without_its_phase_is_named_not_applied() {
        let terms = [term(
            EffectKind::PositionPeriodicForce,
            Port::Stage,
            &[("wavelength_m", 0.005), ("amplitude_n", 5.0)],
        )];
        let (model, _) = physics_of(&terms, &rigid());
        assert!(model.is_empty());
        assert_eq!(model.not_applied, [EffectKind::PositionPeriodicForce]);
    }

    #[test]
    fn a_dead_time_becomes_one_of_the_drive() {
        let terms = [term(EffectKind::DeadTime, Port::Current, &[("extra_delay_s", 1e-4)])];
        let (model, drive) = physics_of(&terms, &rigid());
        assert!(model.is_empty() && model.not_applied.is_empty());
        assert!((drive.amplifier_dead_time_s() - 1e-4).abs() < 1e-15);
    }
}
