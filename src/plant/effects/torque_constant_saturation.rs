//! Torque constant that falls with current.

use super::{EffectKind, Parameter, Specification};

/// Share that is lost per square of the current, while it is small: all of it between a milliampere and ten
/// kiloampere.
pub const PER_A2: Parameter = Parameter::constant("per_a2", "1/A2", [1e-8, 1e6]);
/// 0: K / (1 + b i^2), 1: K (1 - b i^2).
pub const PARABOLIC: Parameter = Parameter::further("parabolic", "1");

/// What tells laws of the load apart.
pub(super) const LOADS: &str = "accelerations at a third and at full current";

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "current",
    equation: "T = K_t i (1 - b i^2 + ...)",
    phrase: |_| "a torque that falls behind large currents, {per_a2}",
    mistaken_for: &[EffectKind::NonlinearStiffness],
    told_apart_by: LOADS,
    ..Specification::new(EffectKind::TorqueConstantSaturation, &[PER_A2, PARABOLIC])
};

/// Share of its torque that a saturated motor loses; `bent`: b i^2.
#[must_use]
pub fn lost_share(bent: f64, parabolic: f64) -> f64 {
    bent / (1.0 + (1.0 - parabolic) * bent)
}
