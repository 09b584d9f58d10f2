//! Low-pass kernels that also shift in time and differentiate, all from one band.
//!
//! Every signal of a force balance passes the same low-pass, so a balance that holds before the filter
//! holds after it. Shift and derivative are taken of the continuous kernel and then sampled: a
//! difference quotient would droop, and its droop looks like dead time.

use crate::signal::inner_products::correlate;
use nalgebra::{SMatrix, SVector};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::f64::consts::PI;

/// Moments of the kernel that are made exact: constants up to fourth powers pass without error.
const MOMENTS: usize = 5;
/// Half width of the kernel in widths of its Gaussian: exp(-6.2^2/2) = 4.5e-9 is left out.
const HALF_WIDTHS: f64 = 6.2;

/// A finite impulse response, centred: `y[i] = sum_j taps[half + j] x[i - j]`, j from -half to half.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Kernel {
    taps: Vec<f64>,
    half: usize,
}

/// What a kernel does besides low-passing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Action {
    /// 0, 1 or 2.
    pub(crate) derivative: u32,
    /// Output at t is the signal at t + advance.
    pub(crate) advance_s: f64,
}

/// How long a step rings through the low-pass of a band: two widths of its Gaussian, s.
pub(crate) fn ring_s(band_hz: f64) -> f64 {
    2.0 * 0.72 / band_hz
}

/// sinc times Gaussian, and its first two derivatives.
///
/// h(t) = 2 f sinc(2 f t) exp(-t^2 / 2 s^2), s = 0.72 / f: flat to about 0.5 f, gone at 1.9 f.
fn continuous(band_hz: f64, derivative: u32, t: f64) -> f64 {
    let s = 0.72 / band_hz;
    let gauss = (-0.5 * (t / s).powi(2)).exp();
    let w = 2.0 * PI * band_hz;
    let z = w * t;
    // p = sin(w t)/(pi t) and its derivatives; series near zero, where the quotients cancel.
    let (p, p1, p2) = if z.abs() < 1e-2 {
        let z2 = z * z;
        let scale = w / PI;
        (
            scale * (1.0 - z2 / 6.0 + z2 * z2 / 120.0),
            scale * w * (-z / 3.0 + z * z2 / 30.0),
            scale * w * w * (-1.0 / 3.0 + z2 / 10.0 - z2 * z2 / 168.0),
        )
    } else {
        let (sin, cos) = z.sin_cos();
        let scale = w / PI;
        (
            scale * sin / z,
            scale * w * (cos / z - sin / (z * z)),
            scale * w * w * (-sin / z - 2.0 * cos / (z * z) + 2.0 * sin / (z * z * z)),
        )
    };
    let g1 = -t / (s * s);
    let g2 = g1 * g1 - 1.0 / (s * s);
    match derivative {
        0 => p * gauss,
        1 => (p1 + p * g1) * gauss,
        _ => (p2 + 2.0 * p1 * g1 + p * g2) * gauss,
    }
}

impl Kernel {
    /// The kernel of a band at a sampling rate.
    pub(crate) fn low_pass(band_hz: f64, rate_hz: f64, action: Action) -> Self {
        let dt = 1.0 / rate_hz;
        let reach = HALF_WIDTHS * 0.72 / band_hz + action.advance_s.abs();
        let half = (reach * rate_hz).ceil() as usize + 1;
        let mut taps: Vec<f64> = (0..=2 * half)
            .map(|k| (k as f64 - half as f64) * dt + action.advance_s)
            .map(|t| continuous(band_hz, action.derivative, t) * dt)
            .collect();
        correct_moments(&mut taps, half, (band_hz, rate_hz), action);
        Self { taps, half }
    }

    /// The kernel of a band for a reference that the drive holds for a sample and follows by a first-order
    /// loop.
    ///
    /// y(t) = h * hold * loop, hold: mean over one period after the sample, loop: w exp(-w t); all three as
    /// continuous functions, then sampled. A recursion from sample to sample has another phase and gain: at a
    /// twelfth of the rate 2 %, which is read as lag. `bandwidth_rad_s`: none, no loop.
    /// Checked by: `a_held_sine_comes_out_as_the_continuous_loop_makes_it`.
    pub(crate) fn of_held_reference(
        band_hz: f64,
        rate_hz: f64,
        advance_s: f64,
        bandwidth_rad_s: Option<f64>,
    ) -> Self {
        /// Steps of the continuous functions in a sample.
        const FINE: usize = 16;
        /// Time constants after which the loop has forgotten.
        const FORGOTTEN: f64 = 20.0;
        let memory_s = bandwidth_rad_s.map_or(0.0, |w| FORGOTTEN / w);
        let reach = HALF_WIDTHS * 0.72 / band_hz + advance_s.abs() + memory_s;
        let half = (reach * rate_hz).ceil() as usize + 2;
        let step_s = 1.0 / (rate_hz * FINE as f64);
        let first_s = -((half * FINE) as f64) * step_s + advance_s;
        let mut h: Vec<f64> =
            (0..=2 * half * FINE).map(|i| continuous(band_hz, 0, first_s + i as f64 * step_s)).collect();
        if let Some(w) = bandwidth_rad_s {
            // Exact for an input that is straight between the steps.
            let (decay, mut state, mut before) = ((-w * step_s).exp(), 0.0, 0.0);
            let slope = 1.0 - (1.0 - decay) / (w * step_s);
            for x in &mut h {
                state = decay * state + (1.0 - decay) * before + slope * (*x - before);
                before = std::mem::replace(x, state);
            }
        }
        let held = |i: usize| {
            let window = &h[i.saturating_sub(FINE)..=i];
            let ends = 0.5 * (window[0] + window[window.len() - 1]);
            (window.iter().sum::<f64>() - ends) / FINE as f64
        };
        let mut taps: Vec<f64> = (0..=2 * half).map(|j| held(j * FINE)).collect();
        let total: f64 = taps.iter().sum();
        taps.iter_mut().for_each(|t| *t /= total);
        Self { taps, half }
    }

    /// The mean over that many rows about the middle one; of an even number the ends count half.
    pub(crate) fn mean(rows: usize) -> Self {
        let half = rows / 2;
        let end = if rows.is_multiple_of(2) { 0.5 } else { 1.0 };
        let tap = |k: usize| if k == 0 || k == 2 * half { end } else { 1.0 };
        let taps = (0..=2 * half).map(|k| if half == 0 { 1.0 } else { tap(k) / rows as f64 }).collect();
        Self { taps, half }
    }

    /// One kernel after another.
    pub(crate) fn after(&self, other: &Self) -> Self {
        let half = self.half + other.half;
        let mut taps = vec![0.0; 2 * half + 1];
        for (k, a) in self.taps.iter().enumerate() {
            taps[k..k + other.taps.len()].iter_mut().zip(&other.taps).for_each(|(t, b)| *t += a * b);
        }
        Self { taps, half }
    }

    /// The same without what lies further out than `half` samples, its sum kept.
    pub(crate) fn cut_to(self, half: usize) -> Self {
        if self.half <= half {
            return self;
        }
        let total: f64 = self.taps.iter().sum();
        let mut taps = self.taps[self.half - half..=self.half + half].to_vec();
        let kept: f64 = taps.iter().sum();
        if kept != 0.0 {
            taps.iter_mut().for_each(|t| *t *= total / kept);
        }
        Self { taps, half }
    }

    /// Power that white noise keeps at a frequency, as a share.
    pub(crate) fn power(&self, hz: f64, rate_hz: f64) -> f64 {
        let turn = 2.0 * PI * hz / rate_hz;
        let (mut re, mut im) = (0.0, 0.0);
        for (k, tap) in self.taps.iter().enumerate() {
            let (sin, cos) = (turn * k as f64).sin_cos();
            re += tap * cos;
            im += tap * sin;
        }
        re * re + im * im
    }

    /// Samples needed on either side.
    pub(crate) fn half(&self) -> usize {
        self.half
    }

    /// `y[j]` at sample `first + j step` of `x`, `count` of them. The caller keeps `half` samples on either
    /// side.
    pub(crate) fn apply(&self, x: &[f64], grid: Grid) -> Vec<f64> {
        if grid.step == 1 {
            return self.apply_to_each(x, grid);
        }
        let reversed: Vec<f64> = self.taps.iter().rev().copied().collect();
        let mut out = vec![0.0; grid.count];
        correlate(x, &reversed, (grid.first - self.half, grid.step), &mut out);
        out
    }
}

impl Kernel {
    /// The same at each sample, by overlap-save: blocks by transforms, two of them as real and imaginary part
    /// of one. Checked by: `a_kernel_does_by_blocks_what_it_does_by_sums`.
    fn apply_to_each(&self, x: &[f64], grid: Grid) -> Vec<f64> {
        let n = (4 * self.taps.len()).next_power_of_two();
        let block = n - 2 * self.half;
        let mut planner = FftPlanner::new();
        let (forward, inverse) = (planner.plan_fft_forward(n), planner.plan_fft_inverse(n));
        let none = Complex::new(0.0, 0.0);
        let mut response = vec![none; n];
        response.iter_mut().zip(&self.taps).for_each(|(r, tap)| r.re = tap / n as f64);
        forward.process(&mut response);
        let mut out = vec![0.0; grid.count];
        for (pair, two) in out.chunks_mut(2 * block).enumerate() {
            let from = grid.first - self.half + 2 * pair * block;
            let at = |k: usize| x.get(from + k).copied().unwrap_or(0.0);
            let mut z: Vec<Complex<f64>> = (0..n).map(|k| Complex::new(at(k), at(k + block))).collect();
            forward.process(&mut z);
            z.iter_mut().zip(&response).for_each(|(z, r)| *z *= r);
            inverse.process(&mut z);
            let (first, second) = two.split_at_mut(block.min(two.len()));
            first.iter_mut().zip(&z[2 * self.half..]).for_each(|(y, z)| *y = z.re);
            second.iter_mut().zip(&z[2 * self.half..]).for_each(|(y, z)| *y = z.im);
        }
        out
    }
}

/// Output samples of a filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grid {
    /// Sample of the first output.
    pub(crate) first: usize,
    /// Samples from one output to the next.
    pub(crate) step: usize,
    /// Outputs.
    pub(crate) count: usize,
}

/// Adds a small smooth piece so that powers up to the fourth are filtered, shifted and differentiated
/// exactly.
///
/// sum_j k_j (-j)^q = d^d/dT^d sum_i h_i (T - i)^q at T = shift, h: the unshifted low-pass.
fn correct_moments(taps: &mut [f64], half: usize, (band_hz, rate_hz): (f64, f64), action: Action) {
    let band_per_sample = band_hz * (1.0 / rate_hz);
    let plain: Vec<f64> =
        (0..taps.len()).map(|k| continuous(band_per_sample, 0, k as f64 - half as f64)).collect();
    let total: f64 = plain.iter().sum();
    let moment = |q: i32| {
        plain.iter().enumerate().map(|(k, h)| h / total * (k as f64 - half as f64).powi(q)).sum::<f64>()
    };
    let scale = half as f64;
    let width = 0.72 / band_per_sample * 1.6;
    let window: Vec<f64> =
        (0..taps.len()).map(|k| (-0.5 * ((k as f64 - half as f64) / width).powi(2)).exp()).collect();
    let power = |k: usize, q: usize| (-(k as f64 - half as f64) / scale).powi(q as i32);
    let mut wanted = SVector::<f64, MOMENTS>::zeros();
    for q in 0..MOMENTS {
        let d = action.derivative as usize;
        if q >= d {
            let falling: f64 = (0..d).map(|r| (q - r) as f64).product();
            let left = q - d;
            let mut sum = 0.0;
            let mut binomial = 1.0;
            for r in 0..=left {
                let sign = if r % 2 == 0 { 1.0 } else { -1.0 };
                sum +=
                    binomial * (action.advance_s * rate_hz).powi((left - r) as i32) * sign * moment(r as i32);
                binomial = binomial * (left - r) as f64 / (r + 1) as f64;
            }
            wanted[q] = falling * sum * rate_hz.powi(action.derivative as i32) / scale.powi(q as i32);
        }
        wanted[q] -= taps.iter().enumerate().map(|(k, t)| t * power(k, q)).sum::<f64>();
    }
    let mut gram = SMatrix::<f64, MOMENTS, MOMENTS>::zeros();
    for a in 0..MOMENTS {
        for b in 0..MOMENTS {
            gram[(a, b)] = window.iter().enumerate().map(|(k, w)| w * power(k, a) * power(k, b)).sum();
        }
    }
    if let Some(lambda) = gram.lu().solve(&wanted) {
        for (k, tap) in taps.iter_mut().enumerate() {
            let poly: f64 = (0..MOMENTS).map(|q| lambda[q] * power(k, q)).sum();
            *tap += window[k] * poly;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Constants to cubes pass exactly; a sine well inside the band passes to 1e-6, shifted and
    /// differentiated.
    #[test]
    fn shift_and_derivative_are_those_of_the_continuous_signal() {
        let (rate, band, f) = (10_000.0, 800.0, 300.0);
        let n = 400;
        let w = 2.0 * PI * f;
        let x: Vec<f64> = (0..n).map(|k| (w * k as f64 / rate).sin()).collect();
        for (derivative, advance_s) in [(0, 0.0), (1, 2.3e-4), (2, -3.7e-4)] {
            let kernel = Kernel::low_pass(band, rate, Action { derivative, advance_s });
            let y = kernel.apply(&x, Grid { first: 200, step: 1, count: 1 })[0];
            let phase = w * (200.0 / rate + advance_s) + f64::from(derivative) * PI / 2.0;
            // The band's own gain at 300 Hz: 1 - erfc(...) / 2, below 1 by 2.4e-3 at most.
            let want = w.powi(derivative as i32) * phase.sin();
            assert!((y - want).abs() < 5e-3 * w.powi(derivative as i32), "{derivative}: {y} for {want}");
        }
    }

    /// Against the frequency response of hold and loop in closed form; the image of the staircase above the
    /// band is not in a sine.
    #[test]
    fn a_held_sine_comes_out_as_the_continuous_loop_makes_it() {
        let (rate, band) = (10_000.0, 800.0);
        for (f, loop_rad_s, advance_s) in
            [(100.0, Some(5000.0), -2e-4), (300.0, Some(2500.0), -1.9e-4), (400.0, None, 0.0)]
        {
            let w = 2.0 * PI * f;
            let x: Vec<f64> = (0..600).map(|k| (w * f64::from(k) / rate).sin()).collect();
            let kernel = Kernel::of_held_reference(band, rate, advance_s, loop_rad_s);
            let plain = Kernel::low_pass(band, rate, Action { derivative: 0, advance_s: 0.0 });
            let at = Grid { first: 300, step: 1, count: 40 };
            let got = kernel.apply(&x, at);
            let angle = 0.5 * w / rate;
            let hold = Complex::from_polar(angle.sin() / angle, -angle);
            let lag = loop_rad_s.map_or(Complex::new(1.0, 0.0), |b| 1.0 / Complex::new(1.0, w / b));
            let response = hold * lag * Complex::from_polar(1.0, w * advance_s);
            let (sine, cosine): (Vec<f64>, Vec<f64>) = (
                plain.apply(&x, at),
                plain.apply(&(0..600).map(|k| (w * f64::from(k) / rate).cos()).collect::<Vec<_>>(), at),
            );
            for k in 0..40 {
                let want = response.re * sine[k] + response.im * cosine[k];
                assert!((got[k] - want).abs() < 2e-5, "{f}: {} for {want}", got[k]);
            }
        }
    }

    #[test]
    fn a_kernel_does_by_blocks_what_it_does_by_sums() {
        let kernel = Kernel::low_pass(20.0, 2000.0, Action { derivative: 1, advance_s: 1e-4 });
        let x: Vec<f64> = (0..9000).map(|k| (1e-3 * f64::from(k)).sin() + 1e-3 * f64::from(k % 7)).collect();
        for count in [1, 500, 8000] {
            let by_blocks = kernel.apply(&x, Grid { first: 460, step: 1, count });
            let by_sums = |k: usize| {
                let taps = kernel.taps.iter().enumerate();
                taps.map(|(j, tap)| tap * x[460 + k + kernel.half - j]).sum::<f64>()
            };
            for (k, y) in by_blocks.iter().enumerate() {
                assert!((y - by_sums(k)).abs() < 1e-9, "{count} {k}: {y} for {}", by_sums(k));
            }
        }
    }

    #[test]
    fn a_parabola_has_its_acceleration() {
        let x: Vec<f64> = (0..400).map(|k| 3.0 + 2.0 * k as f64 + 0.5 * (k as f64).powi(2)).collect();
        let kernel = Kernel::low_pass(0.08, 1.0, Action { derivative: 2, advance_s: 1.3 });
        let y = kernel.apply(&x, Grid { first: 200, step: 1, count: 2 });
        assert!((y[0] - 1.0).abs() < 1e-7 && (y[1] - 1.0).abs() < 1e-7, "{y:?}");
    }
}
