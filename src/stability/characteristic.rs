//! The characteristic equation of two delays over its mass: value and slope, where its roots lie.

use crate::plant::cutting::TwoDelay;
use nalgebra::Complex;

/// The equation over its mass, in the units of the search: 1/s.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scaled {
    pub(super) damping: f64,
    pub(super) stiffness: f64,
    pub(super) cutting: f64,
    pub(super) delay_1_s: f64,
    pub(super) delay_2_s: f64,
    /// Roots with a smaller imaginary part are not asked for.
    pub(super) lowest_rad_s: f64,
}

impl Scaled {
    pub(super) fn new(equation: &TwoDelay) -> Self {
        let m = equation.mass_kg;
        Self {
            damping: equation.damping_n_s_m / m,
            stiffness: equation.stiffness_n_m / m,
            cutting: equation.cutting_stiffness_n_m / m,
            delay_1_s: equation.delay_1_s,
            delay_2_s: equation.delay_2_s,
            lowest_rad_s: 0.0,
        }
    }

    /// Without the surface's slow fading.
    ///
    /// Below the natural frequency k + 2K - m w^2 is more than 2K: no root there can grow. Far below it the
    /// equation has a ladder of roots, 1/tau apart, at which marks of the surface fade while the bar gives
    /// way as a mere spring; with everything else well damped one of them is the rightmost. They are no
    /// bending vibration. The ladder is cut at half the natural frequency, at the step nearest to it.
    pub(super) fn of_bending(mut self) -> Self {
        let half_step = std::f64::consts::PI * 2.0 / (self.delay_1_s + self.delay_2_s).max(1e-9);
        self.lowest_rad_s = (0.5 * self.stiffness.sqrt() - half_step).max(0.0);
        self
    }

    /// Value and derivative at `s`.
    #[inline]
    pub(super) fn value_and_slope(&self, s: Complex<f64>) -> (Complex<f64>, Complex<f64>) {
        let first = (-s * self.delay_1_s).exp();
        let second = (-s * self.delay_2_s).exp();
        let value = s * s
            + s * self.damping
            + (self.stiffness + 2.0 * self.cutting)
            + (first + second) * self.cutting;
        let slope =
            s * 2.0 + self.damping - (first * self.delay_1_s + second * self.delay_2_s) * self.cutting;
        (value, slope)
    }

    pub(super) fn longest_delay_s(&self) -> f64 {
        self.delay_1_s.max(self.delay_2_s)
    }

    /// Newton's method; `None` where it does not settle or settles left of `worth`.
    pub(super) fn polish(&self, start: Complex<f64>, worth: f64) -> Option<Complex<f64>> {
        let longest_step = 0.5 / self.longest_delay_s().max(1e-9);
        let mut s = start;
        for _ in 0..30 {
            let (value, slope) = self.value_and_slope(s);
            let mut step = value / slope;
            let size = step.norm_sqr();
            if !size.is_finite() {
                return None;
            }
            // The exponentials bend over 1/tau: a longer step leaves the root that is near.
            if size > longest_step * longest_step {
                step *= longest_step / size.sqrt();
            }
            s -= step;
            // Newton doubles the digits: after a short step the root is within a fraction of it.
            let near = size < 0.01 * longest_step * longest_step;
            if near && s.re + 0.2 * longest_step < worth {
                return None;
            }
            if size < 1e-14 * (1.0 + s.norm_sqr()) {
                return Some(Complex::new(s.re, s.im.abs()));
            }
        }
        None
    }

    /// Growth at which a root near the angular frequency `w` would lie: there the delayed terms are as large
    /// as the rest, 2 K |cos(w (tau2 - tau1)/2)| e^{-growth tau} = |D(j w)|.
    pub(super) fn likely_growth(&self, w: f64) -> f64 {
        let (re, im) = (self.stiffness + 2.0 * self.cutting - w * w, w * self.damping);
        let mean_s = (self.delay_1_s + self.delay_2_s) / 2.0;
        let beat = (w * (self.delay_2_s - self.delay_1_s) / 2.0).cos().abs().max(0.05);
        // Near resonance D is small and does not stay so off the axis: no more than the cut can drive.
        let most = self.cutting / w.max(1.0);
        let driven = 2.0 * self.cutting * beat;
        let growth = -0.5 * rough_ln((re * re + im * im) / (driven * driven)) / mean_s.max(1e-9);
        growth.clamp(-3.0 * most - 200.0, most)
    }

    /// Angular frequencies between which every root right of `growth` lies.
    ///
    /// There |D(s)| <= r = K (e^{-growth tau1} + e^{-growth tau2}) with D = s^2 + c s + k + 2K: both
    /// delayed terms fall to the right. Of D the imaginary part, w (2 sigma + c), bounds the growth, and
    /// takes its share of r; what is left for the real part, k + 2K + sigma^2 + c sigma - w^2, bounds w.
    pub(super) fn window_rad_s(&self, growth: f64) -> (f64, f64) {
        let reach = self.cutting * ((-growth * self.delay_1_s).exp() + (-growth * self.delay_2_s).exp());
        let middle = self.stiffness + 2.0 * self.cutting;
        // c s + s^2 for real parts between `growth` and zero; right of zero both only raise it.
        let falls = (-growth).max(0.0) * self.damping;
        let rises = growth.max(0.0) * (growth + self.damping);
        let low = (middle + rises - reach - falls).max(0.0).sqrt();
        let turning = low * (2.0 * growth + self.damping).max(0.0);
        let left = (reach * reach - turning * turning).max(0.0).sqrt();
        let low = (middle + rises - left - falls).max(0.0).sqrt().max(low);
        // No root grows faster than this: m s^2 alone, or the imaginary part, would outweigh the cut.
        let fastest = (2.0 * reach).sqrt().min(reach / (2.0 * low).max(f64::MIN_POSITIVE));
        let high = middle + left + growth.min(0.0).powi(2) + fastest * (fastest + self.damping);
        (low, high.sqrt())
    }
}

/// Natural logarithm within 0.06 (a straight line between powers of two): good enough for a seed.
fn rough_ln(x: f64) -> f64 {
    const PER_OCTAVE: f64 = 4_503_599_627_370_496.0;
    let octaves = x.max(f64::MIN_POSITIVE).to_bits() as f64 / PER_OCTAVE - 1023.0;
    (octaves + 0.043) * std::f64::consts::LN_2
}
