//! Force proportional to speed squared.

use super::stribeck_friction::SPEEDS;
use super::{EffectKind, ForceLaw, Parameter, Specification};

/// Size.
pub const COEFFICIENT: Parameter = Parameter::size("n_s2_m2", "N s2/m2");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(|term, _| Some(ForceLaw::NonlinearViscosity { n_s2_m2: term.value(&COEFFICIENT)? })),
    domain: "velocity",
    equation: "F = c v |v|",
    phrase: |_| "friction that grows with the square of the speed, {n_s2_m2}",
    mistaken_for: &[EffectKind::StribeckFriction, EffectKind::ViscousFriction],
    told_apart_by: SPEEDS,
    ..Specification::new(EffectKind::NonlinearViscosity, &[COEFFICIENT])
};

/// v |v|: windage and churning per N s2/m2.
#[must_use]
pub fn nonlinear_viscosity(velocity_m_s: f64) -> f64 {
    velocity_m_s * velocity_m_s.abs()
}
