//! Friction that acts as a spring before it slides.

use super::{EffectKind, Parameter, Specification, Spoken};

/// Stiffness of the bristle.
pub const STIFFNESS: Parameter = Parameter::further("presliding_stiffness_n_m", "N/m");
/// Part of the axis' dry friction that is so.
pub const SHARE: Parameter = Parameter::further("share", "1").spoken(Spoken::Not);
/// Force of the bristle's rate.
pub const RATE: Parameter = Parameter::further("bristle_rate_n", "N");
/// Way on which the bristle yields, which a fit has in place of the stiffness.
pub const YIELD: Parameter = Parameter::constant("yield_m", "m", [1e-9, 1.0]);

/// What tells laws of the way since a reversal apart.
pub(super) const REVERSALS: &str = "reversals of 1 to 100 um below 1 mm/s";

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "history",
    equation: "F = s_0 z, dz/dt = v - |v| s_0 z / F_c",
    phrase: |_| {
        "friction that gives like a spring of {presliding_stiffness_n_m} after \
                 each reversal before it slides"
    },
    mistaken_for: &[EffectKind::Backlash],
    told_apart_by: REVERSALS,
    ..Specification::new(EffectKind::PreslidingFriction, &[STIFFNESS, SHARE, RATE, YIELD])
};

/// Presliding friction (Dahl): a spring that yields at the Coulomb force.
///
/// dz/dt = v - |v| (s_0 / F_c) z, F = s_0 z; over a step with constant v exactly
/// z -> z_inf + (z - z_inf) exp(-s_0 |v| dt / F_c), z_inf = (F_c / s_0) sgn v.
/// Units: SI. Source: Dahl 1968; LuGre without Stribeck and micro-damping.
/// Checked by: tests::presliding_is_a_spring_and_then_coulomb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Presliding {
    /// s_0, N/m.
    pub stiffness_n_m: f64,
    /// F_c, N.
    pub coulomb_n: f64,
}

impl Presliding {
    /// The force after `dt` at velocity `v`, from the force before.
    #[must_use]
    pub fn step(&self, force_n: f64, velocity_m_s: f64, dt_s: f64) -> f64 {
        let end = self.coulomb_n * velocity_m_s.signum();
        let decay = (-self.stiffness_n_m * velocity_m_s.abs() * dt_s / self.coulomb_n).exp();
        end + (force_n - end) * decay
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presliding_is_a_spring_and_then_coulomb() {
        let law = Presliding { stiffness_n_m: 4e6, coulomb_n: 50.0 };
        let small = law.step(0.0, 1e-4, 1e-4); // 10 nm: 0.04 N
        assert!((small - 0.04).abs() < 1e-4);
        assert!((law.step(0.0, 1.0, 1.0) - 50.0).abs() < 1e-9);
    }
}
