//! Friction that is higher at very low speed.

use super::coulomb_friction::sliding_direction;
use super::{EffectKind, ForceLaw, Parameter, Specification};

/// Size.
pub const FORCE: Parameter = Parameter::size("stribeck_force_n", "N");
/// Speed over which it falls off.
pub const SPEED: Parameter = Parameter::constant("stribeck_velocity_m_s", "m/s", [1e-7, 1e3]);

/// What tells laws of the speed apart.
pub(super) const SPEEDS: &str = "constant speeds from 0.5 to 50 mm/s in both directions";

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(|term, _| {
        Some(ForceLaw::Stribeck { force_n: term.value(&FORCE)?, velocity_m_s: term.value(&SPEED)? })
    }),
    domain: "velocity",
    equation: "F = F_st exp(-(v / v_st)^2) tanh(v / v_s)",
    phrase: |_| {
        "friction that is {stribeck_force_n} higher at creep speed and falls \
                 off over {stribeck_velocity_m_s}"
    },
    mistaken_for: &[EffectKind::ViscousFriction, EffectKind::NonlinearViscosity],
    told_apart_by: SPEEDS,
    ..Specification::new(EffectKind::StribeckFriction, &[FORCE, SPEED])
};

/// Stribeck's bump per newton: exp(-(v / v_st)^2) tanh(v / v_s).
///
/// Friction is higher by the Stribeck force where speed is far below the Stribeck velocity.
/// Units: 1. Errors: none. Checked by: tests::the_bump_is_gone_at_speed.
#[must_use]
pub fn stribeck(velocity_m_s: f64, stribeck_velocity_m_s: f64, smoothing_m_s: f64) -> f64 {
    (-(velocity_m_s / stribeck_velocity_m_s).powi(2)).exp() * sliding_direction(velocity_m_s, smoothing_m_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bump_is_gone_at_speed() {
        assert!((stribeck(1e-3, 5e-3, 1e-5) - (-0.04f64).exp()).abs() < 1e-12);
        assert!(stribeck(0.05, 5e-3, 1e-5) < 1e-30);
        assert!(stribeck(-1e-3, 5e-3, 1e-5) < 0.0);
    }
}
