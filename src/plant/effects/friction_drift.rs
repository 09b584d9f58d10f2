//! Friction that changes as the machine warms.

use super::{EffectKind, Parameter, Specification};

/// By how much of itself it changes.
pub const CHANGE: Parameter = Parameter::size("relative_change", "1");
/// How fast.
pub const TIME: Parameter = Parameter::constant("time_constant_s", "s", [0.1, 300.0]);
/// Not zero: viscous friction changes as well.
pub const WITH_VISCOUS: Parameter = Parameter::further("with_viscous", "1");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    equation: "F = (F_c tanh(v / v_s) [+ C v]) r (1 - exp(-t / tau))",
    phrase: |_| "friction that changes by {relative_change} with a time constant of {time_constant_s}",
    ..Specification::new(EffectKind::FrictionDrift, &[CHANGE, TIME, WITH_VISCOUS])
};

/// Share of its final change that friction has made after t: 1 - exp(-t / tau).
#[must_use]
pub fn drift(time_s: f64, time_constant_s: f64) -> f64 {
    1.0 - (-time_s / time_constant_s).exp()
}
