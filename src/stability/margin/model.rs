//! The spectrum of the force of a linear cut with two tools, and its derivatives by what is not known.

use crate::keyframe::keep;
use nalgebra::{Complex, SVector};
use std::f64::consts::PI;

/// How many numbers are not known.
pub(super) const PARAMETERS: usize = 9;

/// ln K_r, ln zeta, ln clamp factor, ln C_i, ln phi^2, pitch offset (rad), ln of the random share of the
/// force, ln of the measurement noise over that in air, its change in 100 Hz.
pub(super) type Parameters = SVector<f64, PARAMETERS>;

/// Place of a number in [`Parameters`].
pub(super) mod place {
    pub(in super::super) const STIFFNESS: usize = 0;
    pub(in super::super) const DAMPING: usize = 1;
    pub(in super::super) const CLAMP: usize = 2;
    pub(in super::super) const PROCESS: usize = 3;
    pub(in super::super) const POSITION: usize = 4;
    pub(in super::super) const PITCH: usize = 5;
    pub(in super::super) const LEVEL: usize = 6;
    pub(in super::super) const NOISE: usize = 7;
    pub(in super::super) const SLOPE: usize = 8;
}

/// Corner of the random part of the force, Hz: "to 2 kHz", first order (contracts, section 6).
const RANDOM_FORCE_HZ: f64 = 2000.0;

/// What is known of a stretch of cutting.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Condition {
    /// m, kg.
    pub(super) mass_kg: f64,
    /// w of a rigid clamp, rad/s.
    pub(super) rigid_rad_s: f64,
    /// T.
    pub(super) turn_s: f64,
    /// d = theta_2 - theta_1.
    pub(super) pitch_rad: f64,
    /// phi^2 at the tools.
    pub(super) shape_squared: f64,
    /// K b for K_r = 1, over what the mean force says of K_r: m.
    pub(super) width_m: f64,
    /// C_i = 1: b/b0 over the surface speed, s/m.
    pub(super) process_s_m: f64,
    /// Mean of the force that is heard, N.
    pub(super) mean_n: f64,
    /// First-order low-pass of the force, Hz.
    pub(super) force_hz: f64,
    /// ln of the noise in air in the middle of the band (N^2/Hz), its change in 100 Hz, and that middle.
    pub(super) noise: Noise,
}

keep!(Condition {
    mass_kg,
    rigid_rad_s,
    turn_s,
    pitch_rad,
    shape_squared,
    width_m,
    process_s_m,
    mean_n,
    force_hz,
    noise
});

/// Measurement noise: a straight line of ln S over the frequency.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Noise {
    /// ln of N^2/Hz in the middle.
    pub(super) level: f64,
    /// Its change in 100 Hz.
    pub(super) slope: f64,
    /// Middle of the band, Hz.
    pub(super) middle_hz: f64,
}

keep!(Noise { level, slope, middle_hz });

/// One value of the spectrum with its derivatives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Density {
    /// One-sided, N^2/Hz.
    pub(super) total: f64,
    /// The cut's own part.
    pub(super) cut: f64,
    /// Return difference 1 + L: the curve of Nyquist's criterion.
    pub(super) difference: Complex<f64>,
    /// By each parameter.
    pub(super) by: Parameters,
}

impl Default for Density {
    fn default() -> Self {
        Self { total: 0.0, cut: 0.0, difference: Complex::new(1.0, 0.0), by: Parameters::zeros() }
    }
}

/// A cut with numbers for everything.
///
/// y = -G (n1 - n2)/Delta with Delta = 1 + G (A1 + A2), and the force on tool 1
///
/// F1 = [(P + A2) n1 + A1 n2]/Q,  Q = P + A1 + A2,  P = 1/G = m (w^2 + s^2 + 2 zeta w s)/phi^2
/// A1 = K (1 + e^{-s tau2}) + s c,  A2 = K (1 + e^{-s tau1}) + s c,  c = C_i b/(b0 v)
///
/// n_j = nu F_j times first-order noise of unit variance, independent in the two tools.
/// Source: the cut-method note, section 1, for the healthy cut. Checked by: `derivatives_are_differences`,
/// `roots_are_those_of_the_two_delay_equation`, `the_margin_is_the_decay_of_the_vibration` (suite).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Cut {
    /// m/phi^2.
    inertia: f64,
    natural_rad_s: f64,
    damping_ratio: f64,
    stiffness: f64,
    process: f64,
    delay_1_s: f64,
    delay_2_s: f64,
    /// d tau2 / d d.
    delay_by_pitch_s: f64,
    /// (nu F1)^2 and (F2/F1)^2.
    random: f64,
    share_2: f64,
    force_hz: f64,
    noise: Noise,
}

keep!(Cut {
    inertia,
    natural_rad_s,
    damping_ratio,
    stiffness,
    process,
    delay_1_s,
    delay_2_s,
    delay_by_pitch_s,
    random,
    share_2,
    force_hz,
    noise
});

impl Cut {
    pub(super) fn new(condition: &Condition, at: &Parameters) -> Self {
        let pitch_rad = condition.pitch_rad + at[place::PITCH];
        let [theta_1, theta_2] = [PI - pitch_rad / 2.0, PI + pitch_rad / 2.0];
        let per_rad = condition.turn_s / (2.0 * PI);
        Self {
            inertia: condition.mass_kg / (condition.shape_squared * at[place::POSITION].exp()),
            natural_rad_s: condition.rigid_rad_s * at[place::CLAMP].exp(),
            damping_ratio: at[place::DAMPING].exp(),
            stiffness: condition.width_m * at[place::STIFFNESS].exp(),
            process: condition.process_s_m * at[place::PROCESS].exp(),
            delay_1_s: theta_1 * per_rad,
            delay_2_s: theta_2 * per_rad,
            delay_by_pitch_s: per_rad / 2.0,
            random: (at[place::LEVEL].exp() * condition.mean_n).powi(2),
            share_2: (theta_1 / theta_2).powi(2),
            force_hz: condition.force_hz,
            noise: Noise {
                level: condition.noise.level + at[place::NOISE],
                slope: condition.noise.slope + at[place::SLOPE],
                middle_hz: condition.noise.middle_hz,
            },
        }
    }

    /// Spectrum of the force at a frequency. Cost: some 150 flops and two sine-cosine pairs.
    pub(super) fn density(&self, frequency_hz: f64) -> Density {
        let w = 2.0 * PI * frequency_hz;
        let s = Complex::new(0.0, w);
        let [e1, e2] = [self.delay_1_s, self.delay_2_s].map(|tau| Complex::from_polar(1.0, -w * tau));
        let own = self.natural_rad_s;
        let ring = s * (2.0 * self.damping_ratio * own * self.inertia);
        let spring = self.inertia * own * own;
        let p = ring + (spring - self.inertia * w * w);
        let (k1, k2) = ((e2 + 1.0) * self.stiffness, (e1 + 1.0) * self.stiffness);
        let c = s * self.process;
        let (a1, a2) = (k1 + c, k2 + c);
        let (n, q) = (p + a2, p + a1 + a2);
        let inverse = q.inv();
        let input = self.random * random_shape(frequency_hz) * low_pass(frequency_hz, self.force_hz);
        let over = input * inverse.norm_sqr();
        let cut = over * (n.norm_sqr() + self.share_2 * a1.norm_sqr());
        let offset = (frequency_hz - self.noise.middle_hz) / 100.0;
        let floor = (self.noise.level + self.noise.slope * offset).exp();
        let none = Complex::new(0.0, 0.0);
        let turned = s * (self.stiffness * self.delay_by_pitch_s);
        let by = |dp: Complex<f64>, d1: Complex<f64>, d2: Complex<f64>| {
            let numerator = product(n, dp + d2) + self.share_2 * product(a1, d1);
            over * 2.0 * numerator - 2.0 * cut * ((dp + d1 + d2) * inverse).re
        };
        let by = Parameters::from([
            by(none, k1, k2),
            by(ring, none, none),
            by(ring + 2.0 * spring, none, none),
            by(none, c, c),
            by(-p, none, none),
            by(none, -(e2 * turned), e1 * turned) + over * a1.norm_sqr() * self.share_by_pitch(),
            2.0 * cut,
            floor,
            floor * offset,
        ]);
        // Without the delayed waves every cut is stable: 1 + L = Q/(P + 2 K + 2 s c).
        let difference = q / (p + 2.0 * (self.stiffness + c));
        Density { total: cut + floor, cut, difference, by }
    }

    /// Left side of the two-delay equation over phi^2, and its derivative by s.
    pub(super) fn characteristic(&self, s: Complex<f64>) -> [Complex<f64>; 2] {
        let [e1, e2] = [self.delay_1_s, self.delay_2_s].map(|tau| (-s * tau).exp() * self.stiffness);
        let own = self.natural_rad_s;
        let ring = 2.0 * self.damping_ratio * own;
        let value = (s * s + s * ring + own * own) * self.inertia
            + s * (2.0 * self.process)
            + e1
            + e2
            + 2.0 * self.stiffness;
        let slope =
            (s * 2.0 + ring) * self.inertia + 2.0 * self.process - e1 * self.delay_1_s - e2 * self.delay_2_s;
        [value, slope]
    }

    /// d (theta1/theta2)^2 / d d: d theta1 = -d/2, d theta2 = +d/2, theta1 + theta2 = 2 pi.
    fn share_by_pitch(&self) -> f64 {
        -self.share_2 * self.turn_s().powi(2) / (2.0 * PI * self.delay_1_s * self.delay_2_s)
    }

    /// T.
    pub(super) fn turn_s(&self) -> f64 {
        self.delay_1_s + self.delay_2_s
    }
}

/// Real part of conj(a) b.
fn product(a: Complex<f64>, b: Complex<f64>) -> f64 {
    a.re * b.re + a.im * b.im
}

/// One-sided density of first-order noise of unit variance, 1/Hz.
fn random_shape(frequency_hz: f64) -> f64 {
    2.0 / (PI * RANDOM_FORCE_HZ) * low_pass(frequency_hz, RANDOM_FORCE_HZ)
}

fn low_pass(frequency_hz: f64, corner_hz: f64) -> f64 {
    1.0 / (1.0 + (frequency_hz / corner_hz).powi(2))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::plant::cutting::TwoDelay;
    use crate::plant::scenario::{RawScenario, Scenario};
    use crate::stability::count::Turn;
    use crate::stability::{Root, rightmost_root};

    /// The default scenario at a pitch, and what it says of the numbers that are not known.
    pub(in super::super) fn example(pitch_rad: f64) -> (Condition, Parameters) {
        let scenario = Scenario::default();
        let (bar, cutting) = (&scenario.workpiece, &scenario.cutting);
        let turn_s = scenario.spindle.period_s();
        let condition = Condition {
            mass_kg: bar.modal_mass_kg(),
            rigid_rad_s: 2.0 * PI * bar.bending_frequency_hz() / bar.raw().clamp_factor,
            turn_s,
            pitch_rad,
            shape_squared: 1.0,
            width_m: cutting.raw().width_m,
            process_s_m: turn_s / (PI * bar.diameter_m()),
            mean_n: 90.0,
            force_hz: 1000.0,
            noise: Noise { level: (1e-3f64).ln(), slope: 0.1, middle_hz: 600.0 },
        };
        let at = Parameters::from([
            cutting.raw().radial_stiffness_pa.ln(),
            bar.raw().damping_ratio.ln(),
            bar.raw().clamp_factor.ln(),
            cutting.raw().process_damping_n.ln(),
            0.0,
            0.0,
            (0.03f64).ln(),
            0.0,
            0.0,
        ]);
        (condition, at)
    }

    /// The rightmost root of that scenario by the search of the stability map.
    pub(in super::super) fn mapped(pitch_rad: f64) -> Root {
        let raw = RawScenario { pitch_difference_rad: pitch_rad, ..RawScenario::default() };
        rightmost_root(&TwoDelay::from_scenario(&Scenario::new(&raw).unwrap()))
    }

    #[test]
    fn derivatives_are_differences() {
        let (condition, at) = example(0.08);
        for hz in [520.0, 600.0, 648.0, 650.0, 700.0] {
            let exact = Cut::new(&condition, &at).density(hz);
            for k in 0..PARAMETERS {
                let step = 1e-6;
                let (mut more, mut less) = (at, at);
                more[k] += step;
                less[k] -= step;
                let high = Cut::new(&condition, &more).density(hz).total;
                let low = Cut::new(&condition, &less).density(hz).total;
                let difference = (high - low) / (2.0 * step);
                let error = (difference - exact.by[k]).abs();
                assert!(error < 1e-5 * exact.by[k].abs() + 1e-6 * exact.total, "{k} at {hz}: {difference}");
            }
        }
    }

    #[test]
    fn roots_are_those_of_the_two_delay_equation() {
        for pitch_rad in [0.0, 0.05, 0.09] {
            let (condition, at) = example(pitch_rad);
            let root = mapped(pitch_rad);
            let s = Complex::new(root.growth_1_s, 2.0 * PI * root.frequency_hz);
            let [value, slope] = Cut::new(&condition, &at).characteristic(s);
            assert!((value / slope).norm() < 1e-6, "{pitch_rad}: {value}");
        }
    }

    /// Nyquist's criterion against the sign of the rightmost root.
    #[test]
    fn the_return_difference_goes_round_zero_where_a_cut_is_unstable() {
        for pitch_rad in [0.0, 0.03, 0.055, 0.07, 0.08, 0.085, 0.09] {
            let (condition, at) = example(pitch_rad);
            let growth_1_s = mapped(pitch_rad).growth_1_s;
            let cut = Cut::new(&condition, &at);
            let mut turn = Turn::default();
            (0..1600).for_each(|k| turn.to(cut.density(450.0 + 0.25 * f64::from(k)).difference));
            assert_eq!(turn.rad.abs() > PI, growth_1_s > 0.0, "{pitch_rad}: {turn:?} {growth_1_s}");
        }
    }
}
