//! Stiffness that depends on the position along the screw.

use super::{EffectKind, PHASE, Parameter, Specification, Spoken};

/// By how much of itself it changes.
pub const VARIATION: Parameter = Parameter::size("relative_variation", "1");
/// Over what way.
pub const LENGTH: Parameter = Parameter::constant("length_m", "m", [1e-3, 2.0]).spoken(Spoken::Not);

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "position",
    equation: "S = K (1 + r x / L) D, or K (1 + r sin(2 pi x / L + phase)) D",
    phrase: |_| "a stiffness of the screw that changes by {relative_variation} over the travel",
    ..Specification::new(EffectKind::PositionDependentStiffness, &[VARIATION, LENGTH, PHASE])
};
