//! Torque periodic in the motor angle.

use super::position_periodic_force::{ORDER, STROKES, WAVELENGTH, force};
use super::{AMPLITUDE_N, EffectKind, HARMONICS_N, PHASE, Specification, WITH_DIRECTION};

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(force),
    domain: "motor_angle",
    equation: "F = sum_h A_h sin(h order theta + phase_h)",
    phrase: |_| "a ripple of the motor's torque {order_per_rev} times a turn, {amplitude_n}",
    mistaken_for: &[EffectKind::PositionPeriodicForce, EffectKind::PositionDependentForce],
    told_apart_by: STROKES,
    ..Specification::new(
        EffectKind::TorqueRipple,
        &[AMPLITUDE_N, HARMONICS_N, ORDER, WAVELENGTH, PHASE, WITH_DIRECTION],
    )
};
