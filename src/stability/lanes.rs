//! Newton's method on the two-delay equation from eight places at once: the search spends its time on
//! e^{-s tau}, and one call computes it for all.
//!
//! What comes out is near a root, not on it: the search polishes what may be the rightmost one by itself.

use super::characteristic::Scaled;
use crate::signal::dispatch::{Kernel, multiply_add};
use crate::signal::exponential::{ROUND, exp};
use nalgebra::Complex;

/// Places at once.
pub(super) const PLACES: usize = 8;
/// Steps before the rest is left to the search.
const STEPS: usize = 12;

type Lanes = [f64; PLACES];

/// Newton's steps from many seeds, no farther than is worth it: a lane that is done takes the next seed.
pub(super) struct Descend<'a> {
    pub(super) scaled: &'a Scaled,
    pub(super) seeds: &'a [Complex<f64>],
    /// Roots left of it are not wanted.
    pub(super) worth: f64,
    /// Where they lead to, in no order; as many as there are seeds are enough.
    pub(super) led: &'a mut [Complex<f64>],
}

impl Kernel for Descend<'_> {
    /// How many of `led` were written: close to a root that may be worth it, or not there after `STEPS`.
    type Output = usize;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> usize {
        let longest_step = 0.5 / self.scaled.longest_delay_s().max(1e-9);
        let (capped, near) = (longest_step * longest_step, 0.01 * longest_step * longest_step);
        let (mut re, mut im, mut steps) = ([0.0; PLACES], [0.0; PLACES], [STEPS; PLACES]);
        let (mut next, mut open, mut found) = (0, 0, 0);
        for k in 0..PLACES.min(self.seeds.len()) {
            (re[k], im[k], steps[k]) = (self.seeds[k].re, self.seeds[k].im, 0);
            (next, open) = (next + 1, open + 1);
        }
        while open > 0 {
            let (step_re, step_im) = newton::<FUSED>(self.scaled, &re, &im);
            let mut sizes = [0.0; PLACES];
            for k in 0..PLACES {
                let size = step_re[k] * step_re[k] + step_im[k] * step_im[k];
                // The exponentials bend over 1/tau: a longer step leaves the root that is near.
                let share = if size > capped { longest_step / size.sqrt() } else { 1.0 };
                re[k] -= step_re[k] * share;
                im[k] -= step_im[k] * share;
                sizes[k] = size;
            }
            for k in 0..PLACES {
                steps[k] += 1;
                let goes_on = sizes[k] >= near && steps[k] < STEPS && sizes[k].is_finite();
                if goes_on || steps[k] > STEPS {
                    continue;
                }
                let gone =
                    !sizes[k].is_finite() || sizes[k] < near && re[k] + 0.2 * longest_step < self.worth;
                // Newton doubles the digits: what is left is below a millionth of 1/tau.
                let there = sizes[k] < 1e-6 * capped || steps[k] == STEPS;
                if !gone && !there {
                    continue;
                }
                if !gone {
                    self.led[found] = Complex::new(re[k], im[k]);
                    found += 1;
                }
                if let Some(seed) = self.seeds.get(next) {
                    (re[k], im[k], steps[k], next) = (seed.re, seed.im, 0, next + 1);
                } else {
                    (steps[k], open) = (STEPS, open - 1);
                }
            }
        }
        found
    }
}

/// Value over slope of the equation.
#[inline(always)]
fn newton<const FUSED: bool>(scaled: &Scaled, re: &Lanes, im: &Lanes) -> (Lanes, Lanes) {
    let first = fading_turn::<FUSED>(re, im, scaled.delay_1_s, scaled.cutting);
    let second = fading_turn::<FUSED>(re, im, scaled.delay_2_s, scaled.cutting);
    let (mut out_re, mut out_im) = ([0.0; PLACES], [0.0; PLACES]);
    let rest = scaled.stiffness + 2.0 * scaled.cutting;
    for k in 0..PLACES {
        let (x, y) = (re[k], im[k]);
        let value_re = multiply_add::<FUSED>(x, x + scaled.damping, rest - y * y) + first.0[k] + second.0[k];
        let value_im = multiply_add::<FUSED>(y, 2.0 * x + scaled.damping, first.1[k] + second.1[k]);
        let slope_re = 2.0 * x + scaled.damping
            - multiply_add::<FUSED>(first.0[k], scaled.delay_1_s, second.0[k] * scaled.delay_2_s);
        let slope_im =
            2.0 * y - multiply_add::<FUSED>(first.1[k], scaled.delay_1_s, second.1[k] * scaled.delay_2_s);
        let over = 1.0 / multiply_add::<FUSED>(slope_re, slope_re, slope_im * slope_im);
        out_re[k] = multiply_add::<FUSED>(value_re, slope_re, value_im * slope_im) * over;
        out_im[k] = multiply_add::<FUSED>(value_im, slope_re, -value_re * slope_im) * over;
    }
    (out_re, out_im)
}

/// a e^{-s tau}: e^{-x tau} (cos(y tau) - j sin(y tau)).
///
/// Sine and cosine by Taylor's series after pi/2 is taken off, 1e-11 of the value: the
/// answer is polished elsewhere. Below e^-700 and above e^700 the power stays there.
#[inline(always)]
fn fading_turn<const FUSED: bool>(re: &Lanes, im: &Lanes, tau: f64, a: f64) -> (Lanes, Lanes) {
    use std::f64::consts::{FRAC_2_PI, FRAC_PI_2};
    let (mut out_re, mut out_im) = ([0.0; PLACES], [0.0; PLACES]);
    for k in 0..PLACES {
        let size = a * exp::<FUSED>((-re[k] * tau).clamp(-700.0, 700.0));
        let y = im[k] * tau;
        let turned = multiply_add::<FUSED>(y, FRAC_2_PI, ROUND);
        let q = multiply_add::<FUSED>(turned - ROUND, -FRAC_PI_2, y);
        let q2 = q * q;
        let mut sine = -1.0 / 39_916_800.0;
        for term in [1.0 / 362_880.0, -1.0 / 5_040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0] {
            sine = multiply_add::<FUSED>(sine, q2, term);
        }
        sine *= q;
        let mut cosine = 1.0 / 479_001_600.0;
        for term in [-1.0 / 3_628_800.0, 1.0 / 40_320.0, -1.0 / 720.0, 1.0 / 24.0, -0.5, 1.0] {
            cosine = multiply_add::<FUSED>(cosine, q2, term);
        }
        // Quarter turns: odd ones exchange the two, the second bit turns the sine, both bits the cosine.
        let quarter = turned.to_bits();
        let odd = quarter & 1 == 1;
        let (sin, cos) = if odd { (cosine, sine) } else { (sine, cosine) };
        let sin = f64::from_bits(sin.to_bits() ^ (quarter & 2) << 62);
        let cos = f64::from_bits(cos.to_bits() ^ (quarter.wrapping_add(1) & 2) << 62);
        out_re[k] = size * cos;
        out_im[k] = -size * sin;
    }
    (out_re, out_im)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::signal::dispatch::{Fast, run};

    struct Turn(f64, f64);

    impl Kernel for Turn {
        type Output = (f64, f64);

        #[inline(always)]
        fn run<const FUSED: bool>(self) -> (f64, f64) {
            let (re, im) = fading_turn::<FUSED>(&[self.0; PLACES], &[self.1; PLACES], 0.025, 3.0);
            (re[5], im[5])
        }
    }

    #[test]
    fn fading_turn_is_the_complex_exponential() {
        for fast in [Fast::detect(), Fast::off()] {
            for i in 0..2000 {
                let s = Complex::new(f64::from(i % 37) * 40.0 - 500.0, f64::from(i) * 13.7 - 900.0);
                let exact = (-s * 0.025).exp() * 3.0;
                let (re, im) = run(fast, Turn(s.re, s.im));
                let apart = (Complex::new(re, im) - exact).norm() / exact.norm();
                assert!(apart < 1e-10, "{s}: {apart}");
            }
        }
    }
}
