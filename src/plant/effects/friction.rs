//! Friction beyond a constant viscous and Coulomb part. Every force opposes the motion (positive along it).

/// Direction of sliding, tanh(v / v_s): Coulomb friction per newton. v_s: smoothing speed in m/s.
#[must_use]
pub fn sliding_direction(velocity_m_s: f64, smoothing_m_s: f64) -> f64 {
    (velocity_m_s / smoothing_m_s).tanh()
}

/// Stribeck's bump per newton: exp(-(v / v_st)^2) tanh(v / v_s).
///
/// Friction is higher by the Stribeck force where speed is far below the Stribeck velocity.
/// Units: 1. Errors: none. Checked by: tests::the_bump_is_gone_at_speed.
#[must_use]
pub fn stribeck(velocity_m_s: f64, stribeck_velocity_m_s: f64, smoothing_m_s: f64) -> f64 {
    (-(velocity_m_s / stribeck_velocity_m_s).powi(2)).exp() * sliding_direction(velocity_m_s, smoothing_m_s)
}

/// Asymmetry per newton of difference between the directions: |tanh(v / v_s)| / 2.
///
/// Friction is F + d/2 forward and F - d/2 backward: the difference adds the same force in both directions,
/// and none at rest (where gravity stays).
#[must_use]
pub fn asymmetric(velocity_m_s: f64, smoothing_m_s: f64) -> f64 {
    0.5 * sliding_direction(velocity_m_s, smoothing_m_s).abs()
}

/// v |v|: windage and churning per N s2/m2.
#[must_use]
pub fn nonlinear_viscosity(velocity_m_s: f64) -> f64 {
    velocity_m_s * velocity_m_s.abs()
}

/// Share of its final change that friction has made after t: 1 - exp(-t / tau).
#[must_use]
pub fn drift(time_s: f64, time_constant_s: f64) -> f64 {
    1.0 - (-time_s / time_constant_s).exp()
}

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
    fn the_bump_is_gone_at_speed() {
        assert!((stribeck(1e-3, 5e-3, 1e-5) - (-0.04f64).exp()).abs() < 1e-12);
        assert!(stribeck(0.05, 5e-3, 1e-5) < 1e-30);
        assert!(stribeck(-1e-3, 5e-3, 1e-5) < 0.0);
    }

    #[test]
    fn presliding_is_a_spring_and_then_coulomb() {
        let law = Presliding { stiffness_n_m: 4e6, coulomb_n: 50.0 };
        let small = law.step(0.0, 1e-4, 1e-4); // 10 nm: 0.04 N
        assert!((small - 0.04).abs() < 1e-4);
        assert!((law.step(0.0, 1.0, 1.0) - 50.0).abs() < 1e-9);
    }
}
