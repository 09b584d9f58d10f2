//! Constant force.

use super::{EffectKind, ForceLaw, Parameter, Specification};

/// Size.
pub const FORCE: Parameter = Parameter::size("force_n", "N");

/// What tells a load from friction.
pub(super) const AT_REST: &str = "hold the axis at rest for two seconds at several positions: a load stays, \
                                  friction's asymmetry does not";

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(|term, _| Some(ForceLaw::Constant { force_n: term.value(&FORCE)? })),
    domain: "direction",
    equation: "F = constant",
    phrase: |_| "a constant force of {force_n} (weight, or an offset of the drive)",
    mistaken_for: &[EffectKind::AsymmetricFriction],
    told_apart_by: AT_REST,
    ..Specification::new(EffectKind::GravityLoad, &[FORCE])
};
