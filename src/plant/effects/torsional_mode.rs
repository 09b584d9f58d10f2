//! A third inertia: motor and screw twist against each other.

use super::{EffectKind, Parameter, PhysicsTerm, Port, Specification};

/// Of motor and screw without the rest.
pub const FREQUENCY: Parameter = Parameter::constant("free_free_frequency_hz", "Hz", [50.0, 20_000.0]);
/// Part of the rotary inertia that is the screw's.
pub const SHARE: Parameter = Parameter::constant("screw_inertia_share", "1", [0.05, 0.95]).usual(0.5);
/// Of the spring between them, by the screw's inertia.
pub const DAMPING: Parameter = Parameter::constant("damping_ratio", "1", [1e-3, 0.5]).usual(0.02);

/// What tells effects of the frequency apart.
pub(super) const SWEEP: &str = "a sweep up to twice the axial resonance at two amplitudes";

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "frequency",
    equation: "J_s e'' + c e' + (k + K) e = -J_s a_m - K D",
    phrase: |_| "that the motor and the screw's far end twist against each other at {free_free_frequency_hz}",
    mistaken_for: &[EffectKind::DeadTime, EffectKind::CurrentLoopLag],
    told_apart_by: SWEEP,
    ..Specification::new(EffectKind::TorsionalMode, &[FREQUENCY, SHARE, DAMPING])
};

/// The mode as a term of a model: frequency in Hz, share of the screw's inertia, damping ratio.
#[must_use]
pub fn term([frequency_hz, share, damping]: [f64; 3]) -> PhysicsTerm {
    let numbers = [(&FREQUENCY, frequency_hz), (&SHARE, share), (&DAMPING, damping)];
    PhysicsTerm::new(EffectKind::TorsionalMode, Port::Coupling, &numbers)
}

/// Motor and screw on a torsional spring: the screw side as travel behind the motor, e = x_c - x_m.
///
/// M_s e'' + (c + C_k) e' + (k + K) e = -M_s a_m - K D - C_k D'
/// with M_s the screw's inertia, k and c the torsional spring and damper, all as seen on the screw axis.
/// The damper of the nut acts on e' + D'. Units: SI.
/// Checked by: tests::a_slow_load_twists_the_coupling_statically.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Torsion {
    /// M_s, kg.
    pub screw_mass_kg: f64,
    /// k, N/m.
    pub torsional_stiffness_n_m: f64,
    /// c, N s/m.
    pub torsional_damping_n_s_m: f64,
    /// K, N/m.
    pub axial_stiffness_n_m: f64,
    /// C_k, N s/m.
    pub axial_damping_n_s_m: f64,
}

impl Torsion {
    /// From the free-free frequency of motor and screw: w^2 = k (1/M_m + 1/M_s).
    #[must_use]
    pub fn stiffness_of(free_free_frequency_hz: f64, motor_mass_kg: f64, screw_mass_kg: f64) -> f64 {
        let w = std::f64::consts::TAU * free_free_frequency_hz;
        w * w * motor_mass_kg * screw_mass_kg / (motor_mass_kg + screw_mass_kg)
    }

    /// e'' from e, e' and the load -M_s a_m - K D - C_k D'.
    #[must_use]
    pub fn accel(&self, e_m: f64, rate_m_s: f64, load_n: f64) -> f64 {
        let c = self.torsional_damping_n_s_m + self.axial_damping_n_s_m;
        let k = self.torsional_stiffness_n_m + self.axial_stiffness_n_m;
        (load_n - c * rate_m_s - k * e_m) / self.screw_mass_kg
    }

    /// e, e', e'' for a sampled load: the exact response to a load that is linear between samples, whose
    /// droop sinc^2(f dt) is taken out beforehand by 1 - delta^2 / 12 (what is left: 0.2 % at a tenth of the
    /// rate).
    #[must_use]
    pub fn response(&self, load_n: &[f64], dt_s: f64) -> [Vec<f64>; 3] {
        let near = |i: usize| load_n[i.min(load_n.len() - 1)];
        let sharp: Vec<f64> = (0..load_n.len())
            .map(|i| near(i) - (near(i + 1) - 2.0 * near(i) + near(i.saturating_sub(1))) / 12.0)
            .collect();
        let k = self.torsional_stiffness_n_m + self.axial_stiffness_n_m;
        let c = self.torsional_damping_n_s_m + self.axial_damping_n_s_m;
        let w = (k / self.screw_mass_kg).sqrt();
        let zeta = (c / (2.0 * w * self.screw_mass_kg)).min(0.95);
        let (sigma, wd) = (zeta * w, w * (1.0 - zeta * zeta).sqrt());
        let (sin, cos) = (wd * dt_s).sin_cos();
        let decay = (-sigma * dt_s).exp();
        // Relative to the quasi-static path s(t) = f/k - c f'/k^2, e - s rings freely between samples.
        let (give, lag_s, per_dt) = (k.recip(), c / k, dt_s.recip());
        let (from_e, from_v) = (decay * (cos + sigma / wd * sin), decay * sin / wd);
        let (rate_from_e, rate_from_v) = (decay * w * w / wd * sin, decay * (cos - sigma / wd * sin));
        let mut e = sharp.first().copied().unwrap_or(0.0) * give;
        let mut v = 0.0;
        let mut out = [
            Vec::with_capacity(load_n.len()),
            Vec::with_capacity(load_n.len()),
            Vec::with_capacity(load_n.len()),
        ];
        for (i, f) in sharp.iter().enumerate() {
            out[0].push(e);
            out[1].push(v);
            out[2].push(self.accel(e, v, load_n[i]));
            let next = sharp.get(i + 1).copied().unwrap_or(*f);
            // Both over k.
            let (path, slope) = (f * give, (next - f) * per_dt * give);
            let (a, b) = (e - (path - lag_s * slope), v - slope);
            e = next * give - lag_s * slope + (from_e * a + from_v * b);
            v = slope + (rate_from_v * b - rate_from_e * a);
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_load_twists_the_coupling_statically() {
        let t = Torsion {
            screw_mass_kg: 40.0,
            torsional_stiffness_n_m: 6e8,
            torsional_damping_n_s_m: 2e3,
            axial_stiffness_n_m: 4e7,
            axial_damping_n_s_m: 1.5e3,
        };
        let load: Vec<f64> = (0..4000).map(|k| 100.0 * (k as f64 / 4000.0).min(0.5)).collect();
        let [e, _, _] = t.response(&load, 1e-4);
        assert!((e[3999] / (50.0 / 6.4e8) - 1.0).abs() < 1e-3, "{}", e[3999]);
    }

    #[test]
    fn a_fast_load_meets_the_dynamic_stiffness() {
        // Steady state: |e| = F / |k + K - M w^2 + i w c|, at a tenth of the sampling rate.
        let t = Torsion {
            screw_mass_kg: 1.0,
            torsional_stiffness_n_m: 6e7,
            torsional_damping_n_s_m: 400.0,
            axial_stiffness_n_m: 0.0,
            axial_damping_n_s_m: 0.0,
        };
        let w = std::f64::consts::TAU * 1000.0;
        let load: Vec<f64> = (0..20_000).map(|k| (w * f64::from(k) * 1e-4).sin()).collect();
        let [e, _, _] = t.response(&load, 1e-4);
        let amplitude = (e[18_000..].iter().map(|x| x * x).sum::<f64>() / 1000.0).sqrt();
        let expected = (6e7 - w * w).hypot(400.0 * w).recip();
        assert!((amplitude / expected - 1.0).abs() < 4e-3, "{amplitude} {expected}");
    }
}
