//! Which numbers a balance has beside its laws.

use crate::diagnosis::criteria::Criteria;
use crate::plant::effects::EffectKind;
use statrs::function::erf::erf;
use std::f64::consts::PI;

/// Forms in which parts of dry friction may turn beside tanh(v / v_s), u = v / v_s: the algebraic step
/// u / (1 + u^2)^(1/2), the other smooth one in use, one that turns later, tanh(u / 3), and one that is there
/// sooner, erf of the same slope.
///
/// Dry friction grows with speed up to its level, and nobody states in what form: F (tanh + sum w_k (step_k -
/// tanh)), w_k >= 0. The level is that of the number; a bump at low speed is none of these.
pub(super) const TURNING: [fn(f64) -> f64; 3] =
    [|u| u / u.hypot(1.0), |u| (u / 3.0).tanh(), |u| erf(0.5 * PI.sqrt() * u)];

/// Key of the inertia of all that turns.
pub(super) const INERTIA: &str = "rotary_inertia_kg_m2";

/// A number of the structure, and the two constants that encoders without a common zero and scale leave free.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::diagnosis) enum Number {
    MotorMass,
    MotorDamping,
    MotorCoulomb,
    Stiffness,
    StructuralDamping,
    /// All of the mass where there is one position.
    StageMass,
    StageDamping,
    StageCoulomb,
    /// Parts of the dry friction of motor and stage that turn over one of [`TURNING`]; with one position the
    /// next turns over the least way that the encoder tells, and the last with the motor where the stage
    /// follows by a stated screw.
    MotorTurning(usize),
    StageTurning(usize),
    /// When a reference acts.
    Timing,
    /// By how much the stage's encoder is read later than the motor's, where nobody states when they are.
    EncoderTiming,
    /// Bandwidth of a current loop that was found, in steps of a fiftieth.
    Lag,
    /// Zero of the stretch.
    Zero,
    /// Travel of the motor over that of the scale.
    Scale,
}

impl Number {
    /// The part of [`TURNING`] that it is.
    pub(super) fn part(self) -> Option<usize> {
        match self {
            Self::MotorTurning(part) | Self::StageTurning(part) => Some(part),
            _ => None,
        }
    }

    /// True for what the motion of the motor needs by itself: inertia, dampers, the spring.
    pub(super) fn is_linear_in_motion(self) -> bool {
        use Number as N;
        matches!(
            self,
            N::MotorMass | N::MotorDamping | N::Stiffness | N::StructuralDamping | N::EncoderTiming
        )
    }

    /// True for what is of the stage's side.
    pub(super) fn is_of_stage(self) -> bool {
        matches!(self, Self::StageMass | Self::StageDamping | Self::StageCoulomb | Self::StageTurning(_))
    }

    /// The effect that a model leaves out which leaves out this number.
    pub(super) fn effect(self) -> Option<EffectKind> {
        match self {
            Self::MotorCoulomb | Self::StageCoulomb => Some(EffectKind::CoulombFriction),
            Self::MotorDamping | Self::StageDamping => Some(EffectKind::ViscousFriction),
            _ => None,
        }
    }

    /// The key of a drive that states it, and what such a statement is good to, as a share.
    pub(super) fn key(self) -> Option<(&'static str, f64)> {
        let c = &Criteria::STANDARD;
        Some(match self {
            Self::MotorMass => (INERTIA, c.mass_tolerance),
            Self::StageMass => ("movable_mass_kg", c.mass_tolerance),
            Self::Stiffness => ("axial_stiffness_n_m", c.mass_tolerance),
            Self::StructuralDamping => ("structural_damping_n_s_m", c.damping_tolerance),
            Self::MotorDamping => ("rotary_damping_nm_s_rad", c.damping_tolerance),
            Self::StageDamping => ("translational_damping_n_s_m", c.damping_tolerance),
            Self::MotorCoulomb => ("motor_coulomb_friction_n", c.repeatability),
            Self::StageCoulomb => ("stage_coulomb_friction_n", c.repeatability),
            _ => return None,
        })
    }

    /// The same number of the motor's side.
    pub(super) fn of_motor(self) -> Option<Self> {
        match self {
            Self::StageMass => Some(Self::MotorMass),
            Self::StageDamping => Some(Self::MotorDamping),
            Self::StageCoulomb => Some(Self::MotorCoulomb),
            _ => None,
        }
    }

    pub(super) fn is_mass(self) -> bool {
        matches!(self, Self::MotorMass | Self::StageMass)
    }

    /// True for a level of dry friction or a part of it.
    pub(super) fn is_dry_friction(self) -> bool {
        matches!(self, Self::MotorCoulomb | Self::StageCoulomb) || self.part().is_some()
    }
}

/// Numbers of the axis that laws are evaluated with, on the screw axis, SI.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Mechanics {
    pub(super) motor_mass_kg: f64,
    pub(super) motor_damping_n_s_m: f64,
    pub(super) motor_coulomb_n: f64,
    pub(super) stiffness_n_m: f64,
    pub(super) structural_damping_n_s_m: f64,
    pub(super) stage_mass_kg: f64,
    pub(super) stage_damping_n_s_m: f64,
    pub(super) stage_coulomb_n: f64,
    /// Force of the spring where the stretch is at its mean, N.
    pub(super) spring_zero_n: f64,
}

impl Mechanics {
    /// The number, where it is one of these.
    pub(super) fn of_mut(&mut self, number: Number) -> Option<&mut f64> {
        Some(match number {
            Number::MotorMass => &mut self.motor_mass_kg,
            Number::MotorDamping => &mut self.motor_damping_n_s_m,
            Number::MotorCoulomb => &mut self.motor_coulomb_n,
            Number::Stiffness => &mut self.stiffness_n_m,
            Number::StructuralDamping => &mut self.structural_damping_n_s_m,
            Number::StageMass => &mut self.stage_mass_kg,
            Number::StageDamping => &mut self.stage_damping_n_s_m,
            Number::StageCoulomb => &mut self.stage_coulomb_n,
            Number::Zero => &mut self.spring_zero_n,
            _ => return None,
        })
    }

    /// Where a fit of a number begins.
    pub(super) fn of(mut self, number: Number) -> f64 {
        self.of_mut(number).map_or(0.0, |x| *x)
    }
}

#[cfg(test)]
mod tests {
    use super::Number as N;
    use crate::plant::drive::RawDriveParams;

    #[test]
    fn a_number_that_is_stated_has_a_key_of_a_drive_and_one_of_the_motor_beside_it() {
        let motor = [N::MotorMass, N::MotorDamping, N::MotorCoulomb];
        let stage = [N::StageMass, N::StageDamping, N::StageCoulomb];
        assert_eq!(stage.map(N::of_motor), motor.map(Some));
        for number in motor.into_iter().chain(stage).chain([N::Stiffness, N::StructuralDamping]) {
            let (key, tolerance) = number.key().expect("stated");
            assert!(RawDriveParams::default().number_mut(key).is_some(), "{key}");
            assert!(tolerance > 0.0 && tolerance < 0.1, "{key}");
        }
    }
}
