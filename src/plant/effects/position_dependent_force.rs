//! Force that is any function of position.

use super::position_periodic_force::STROKES;
use super::{AMPLITUDE_N, EffectKind, ForceLaw, Parameter, Specification, WITH_DIRECTION};

/// Position of the first knot of the table.
pub const FIRST: Parameter = Parameter::further("first_m", "m");
/// From knot to knot.
pub const SPACING: Parameter = Parameter::further("spacing_m", "m");
/// The table: one force a knot.
pub const FORCE: Parameter = Parameter::size("force_n", "N");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(|term, _| {
        Some(ForceLaw::Map {
            first_m: term.value(&FIRST)?,
            spacing_m: term.value(&SPACING)?,
            force_n: term.list(FORCE.name).filter(|l| !l.is_empty())?.to_vec(),
        })
    }),
    domain: "position",
    equation: "F = F(x), cubic between knots",
    phrase: |_| "a force of up to {amplitude_n} that depends on the position",
    mistaken_for: &[EffectKind::PositionPeriodicForce, EffectKind::TorqueRipple],
    told_apart_by: STROKES,
    ..Specification::new(
        EffectKind::PositionDependentForce,
        &[AMPLITUDE_N, FORCE, FIRST, SPACING, WITH_DIRECTION],
    )
};
