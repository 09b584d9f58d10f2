//! Force periodic in position.

use super::law::harmonics;
use super::{
    AMPLITUDE_N, EffectKind, ForceLaw, HARMONICS_N, PHASE, Parameter, PhysicsTerm, Specification,
    WITH_DIRECTION,
};

/// Of the first harmonic.
pub const WAVELENGTH: Parameter = Parameter::constant("wavelength_m", "m", [1e-7, 1e2]);

/// In its place how often it repeats in a turn of the screw; a ripple of the motor is known by it.
pub const ORDER: Parameter = Parameter::constant("order_per_rev", "1", [0.0, 130.0]);

/// What tells forces over the position apart.
pub(super) const STROKES: &str = "the same slow stroke in both directions at two speeds";

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(force),
    domain: "position",
    equation: "F = sum_h A_h sin(2 pi h x / wavelength + phase_h)",
    phrase: |_| "a force that repeats {period}, {amplitude_n}",
    mistaken_for: &[EffectKind::PositionDependentForce, EffectKind::TorqueRipple],
    told_apart_by: STROKES,
    ..Specification::new(
        EffectKind::PositionPeriodicForce,
        &[AMPLITUDE_N, HARMONICS_N, WAVELENGTH, ORDER, PHASE, WITH_DIRECTION],
    )
};

/// A force that repeats over the way, by its wavelength or by how often it does so in a turn of the screw.
pub(super) fn force(term: &PhysicsTerm, screw_lead_m: Option<f64>) -> Option<ForceLaw> {
    Some(ForceLaw::Periodic {
        wavelength_m: match term.value(&WAVELENGTH) {
            Some(wavelength_m) => wavelength_m,
            None => screw_lead_m? / term.value(&ORDER)?,
        },
        harmonics_n: harmonics(term, &HARMONICS_N, &AMPLITUDE_N)?,
        flips: term.says(&WITH_DIRECTION),
    })
}
