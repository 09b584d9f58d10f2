//! The vocabulary of physics beyond the structure of a cut (contracts, section 6): one file per effect.
//!
//! An effect is a small `Copy` struct of its numbers with a [`Specification`] for people and fits, its part
//! in the mean and linear cut ([`CutLaw::enter`]) and what it does as the bar turns ([`CutLaw::modulate`],
//! [`CutLaw::speed_factor`]). To add one: its file, and its line in `cut_effects!`.

mod contact_stiffness;
mod edge_force;
mod force_lag;
mod force_sensor_lag;
mod mode_drift;
mod nonlinear_cutting_force;
mod nose_radius;
mod physics;
mod position_dependent_mode;
mod process_damping;
mod regenerative_effect;
mod runout;
mod second_mode;
mod second_plane;
mod specification;
mod speed_dependent_dynamics;
mod speed_dependent_force;
mod spindle_speed_variation;
mod stock_variation;
mod support_compliance;
mod tool_difference;
mod tool_wear;
mod turret_compliance;

pub use contact_stiffness::ContactStiffness;
pub use edge_force::EdgeForce;
pub use force_lag::ForceLag;
pub use force_sensor_lag::ForceSensorLag;
pub use mode_drift::ModeDrift;
pub use nonlinear_cutting_force::NonlinearCuttingForce;
pub use nose_radius::NoseRadius;
pub use physics::Physics;
pub use position_dependent_mode::PositionDependentMode;
pub use process_damping::ProcessDamping;
pub use regenerative_effect::RegenerativeEffect;
pub use runout::Runout;
pub use second_mode::SecondMode;
pub use second_plane::SecondPlane;
pub use specification::{Equivalent, Parameter, Role, Specification};
pub use speed_dependent_dynamics::SpeedDependentDynamics;
pub use speed_dependent_force::SpeedDependentForce;
pub use spindle_speed_variation::SpindleSpeedVariation;
pub use stock_variation::StockVariation;
pub use support_compliance::SupportCompliance;
pub use tool_difference::ToolDifference;
pub use tool_wear::ToolWear;
pub use turret_compliance::TurretCompliance;

use super::cut_terms::{CutCondition, CutReferences, CutTerms};
use super::effects::{EffectKind, Port};

/// No effect has more numbers.
pub const MOST_PARAMETERS: usize = 3;

/// The numbers of an effect in the order of its specification; those that it does not have are zero.
pub type Values = [f64; MOST_PARAMETERS];

/// A condition and what the scenario's numbers are referred to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    /// The cut.
    pub at: CutCondition,
    /// v0, h_r, b0 and every other reference.
    pub reference: CutReferences,
}

/// What the effects do to one tool at one angle of the material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtAngle {
    /// Added to the width of cut, m.
    pub width_m: f64,
    /// Factor of the whole law of the force.
    pub factor: f64,
}

impl Default for AtAngle {
    fn default() -> Self {
        Self { width_m: 0.0, factor: 1.0 }
    }
}

/// One effect of the cut.
pub trait CutLaw: Copy {
    /// Words, parameters, bounds.
    const SPECIFICATION: Specification;

    /// From its numbers, in the order of the specification.
    fn from_values(values: Values) -> Self;

    /// Its numbers, in the order of the specification.
    fn values(&self) -> Values;

    /// Its part in the mean and in the linear cut.
    fn enter(&self, place: &Place, terms: &mut CutTerms);

    /// What it does to a tool that meets the material at `psi_rad` = spindle angle - alpha_j.
    fn modulate(&self, psi_rad: f64, now: &mut AtAngle) {
        let _ = (psi_rad, now);
    }

    /// True speed over the commanded one where the commanded speed has turned the spindle to `angle_rad`.
    fn speed_factor(&self, angle_rad: f64) -> f64 {
        let _ = angle_rad;
        1.0
    }
}

macro_rules! cut_effects {
    ($($name:ident),* $(,)?) => {
        /// One effect of the cut with its numbers.
        #[derive(Debug, Clone, Copy, PartialEq)]
        #[expect(missing_docs, reason = "each is documented at its struct")]
        pub enum CutEffect { $($name($name)),* }

        impl CutEffect {
            /// Specifications of all effects, in the order of the vocabulary.
            pub const SPECIFICATIONS: &[Specification] = &[$($name::SPECIFICATION),*];

            /// Words, parameters, bounds.
            #[must_use]
            pub fn specification(&self) -> &'static Specification {
                match self { $(Self::$name(_) => const { &$name::SPECIFICATION }),* }
            }

            /// The effect of that kind with these numbers; `None`: no effect of the cut.
            #[must_use]
            pub fn new(kind: EffectKind, values: Values) -> Option<Self> {
                match kind {
                    $(EffectKind::$name => Some(Self::$name($name::from_values(values))),)*
                    _ => None,
                }
            }

            /// Its numbers, in the order of the specification.
            #[must_use]
            pub fn values(&self) -> Values {
                match self { $(Self::$name(law) => law.values()),* }
            }

            /// Its part in the mean and in the linear cut.
            pub fn enter(&self, place: &Place, terms: &mut CutTerms) {
                match self { $(Self::$name(law) => law.enter(place, terms)),* }
            }

            /// What it does to a tool that meets the material at that angle; see [`CutLaw::modulate`].
            pub fn modulate(&self, psi_rad: f64, now: &mut AtAngle) {
                match self { $(Self::$name(law) => law.modulate(psi_rad, now)),* }
            }

            /// True speed over the commanded one; see [`CutLaw::speed_factor`].
            #[must_use]
            pub fn speed_factor(&self, angle_rad: f64) -> f64 {
                match self { $(Self::$name(law) => law.speed_factor(angle_rad)),* }
            }
        }
    };
}

cut_effects! {
    RegenerativeEffect,
    ProcessDamping,
    EdgeForce,
    NonlinearCuttingForce,
    NoseRadius,
    SpeedDependentForce,
    Runout,
    SecondMode,
    SecondPlane,
    ModeDrift,
    PositionDependentMode,
    SupportCompliance,
    ContactStiffness,
    SpeedDependentDynamics,
    ToolWear,
    ToolDifference,
    TurretCompliance,
    SpindleSpeedVariation,
    StockVariation,
    ForceLag,
    ForceSensorLag,
}

impl CutEffect {
    /// What it is.
    #[must_use]
    pub fn kind(&self) -> EffectKind {
        self.specification().kind
    }

    /// Where it enters.
    #[must_use]
    pub fn port(&self) -> Port {
        self.specification().port
    }

    /// The value of the parameter of that name.
    #[must_use]
    pub fn value(&self, name: &str) -> Option<f64> {
        let index = self.specification().parameters.iter().position(|p| p.name == name)?;
        Some(self.values()[index])
    }

    /// Every parameter with its value: its own, then those that say the same in other units.
    #[must_use]
    pub fn named_values(&self, reference: &CutReferences) -> Vec<(&'static str, f64)> {
        let specification = self.specification();
        let own = specification.parameters.iter().zip(self.values()).map(|(p, v)| (p.name, v));
        let key = self.values()[0];
        let same = specification.equivalents.iter().map(|e| (e.name, (e.from_key)(key, reference)));
        own.chain(same).filter(|(_, value)| value.is_finite()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_effect_goes_to_its_numbers_and_back() {
        assert_eq!(CutEffect::SPECIFICATIONS.len(), 21);
        for specification in CutEffect::SPECIFICATIONS {
            let mut values = [0.0; MOST_PARAMETERS];
            for (k, parameter) in specification.parameters.iter().enumerate() {
                values[k] = parameter.scale;
                assert!(parameter.holds(parameter.scale), "{}: {}", specification.kind, parameter.name);
            }
            let effect = CutEffect::new(specification.kind, values).unwrap();
            assert_eq!(effect.values(), values, "{}", specification.kind);
            assert_eq!(effect.kind(), specification.kind);
            assert_eq!(specification.parameters.iter().filter(|p| p.role == Role::Key).count(), 1);
            assert_eq!(specification.parameters[0].role, Role::Key);
        }
        assert!(CutEffect::new(EffectKind::Backlash, [0.0; 3]).is_none());
    }
}
