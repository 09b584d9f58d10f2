//! Stiffness that depends on the load.

use super::torque_constant_saturation::LOADS;
use super::{EffectKind, Parameter, Specification};

/// Size.
pub const CUBIC: Parameter = Parameter::size("cubic_n_m3", "N/m3");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "current",
    equation: "S = K D + K_3 D^3",
    phrase: |_| "a stiffness of the screw that changes with the load",
    mistaken_for: &[EffectKind::TorqueConstantSaturation],
    told_apart_by: LOADS,
    ..Specification::new(EffectKind::NonlinearStiffness, &[CUBIC])
};

/// D^3: hardening per N/m3.
#[must_use]
pub fn cubic(stretch_m: f64) -> f64 {
    stretch_m * stretch_m * stretch_m
}
