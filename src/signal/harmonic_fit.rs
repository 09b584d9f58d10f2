//! Least-squares fit of a window by constant, ramp and harmonics, as fixed weights.
//!
//! ```text
//!  y(t) = a_0 + a_1 t + sum_i (s_i sin(i w t) + c_i cos(i w t)),   window of 2N + 1 samples
//! ```
//! The basis is the same for every position of the window, so value, slope and curvature of the fitted
//! curve at one instant are weighted sums of the samples: nothing is solved while running.

use nalgebra::DMatrix;
use rustfft::num_complex::Complex64;
use thiserror::Error;

/// What is fitted, in samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HarmonicBasis {
    /// N: the window has 2N + 1 samples.
    pub half_window: usize,
    /// Angle of the first harmonic per sample, rad.
    pub fundamental_rad: f64,
    /// Highest harmonic.
    pub harmonics: usize,
}

/// Longest window: bounds the memory and the time of a design.
pub const LONGEST_WINDOW: usize = 1 << 14;

/// Why a window cannot be fitted.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum HarmonicFitError {
    /// More unknowns than samples.
    #[error("{unknowns} unknowns in a window of {samples} samples")]
    TooShort {
        /// Unknowns.
        unknowns: usize,
        /// Samples.
        samples: usize,
    },
    /// More samples than are kept.
    #[error("a window of {samples} samples, expected at most {LONGEST_WINDOW}; the spindle turns too slowly")]
    TooLong {
        /// Samples.
        samples: usize,
    },
    /// A harmonic beyond half the rate.
    #[error("harmonic {harmonic} lies at {share:.3} of the sampling rate, expected below 0.5")]
    BeyondNyquist {
        /// Which.
        harmonic: usize,
        /// Its frequency over the rate.
        share: f64,
    },
    /// The columns are dependent.
    #[error("window of {samples} samples cannot tell the harmonics apart")]
    Singular {
        /// Samples.
        samples: usize,
    },
}

/// A solved basis: rows of the pseudo-inverse.
#[derive(Debug, Clone, PartialEq)]
pub struct HarmonicFit {
    basis: HarmonicBasis,
    /// One row for each unknown over the window, oldest sample first.
    inverse: DMatrix<f64>,
    condition: f64,
}

impl HarmonicFit {
    /// Solves the basis by QR with columns of unit length.
    ///
    /// Errors: too few samples, a harmonic beyond half the rate, dependent columns.
    /// Source: Hayashi et al., (17)-(23). Deviation: QR instead of normal equations, time from the
    /// middle of the window. Checked by: the_printed_window_is_ill_conditioned.
    pub fn new(basis: HarmonicBasis) -> Result<Self, HarmonicFitError> {
        let samples = 2 * basis.half_window + 1;
        let unknowns = 2 + 2 * basis.harmonics;
        if samples > LONGEST_WINDOW {
            return Err(HarmonicFitError::TooLong { samples });
        }
        if unknowns > samples {
            return Err(HarmonicFitError::TooShort { unknowns, samples });
        }
        let share = basis.harmonics as f64 * basis.fundamental_rad / std::f64::consts::TAU;
        if !(share > 0.0 && share < 0.5) && basis.harmonics > 0 {
            return Err(HarmonicFitError::BeyondNyquist { harmonic: basis.harmonics, share });
        }
        let mut columns = DMatrix::zeros(samples, unknowns);
        for row in 0..samples {
            let values = basis.row(row as f64 - basis.half_window as f64, 0);
            columns.set_row(row, &nalgebra::RowDVector::from_vec(values));
        }
        let scale: Vec<f64> = columns.column_iter().map(|c| c.norm()).collect();
        for (mut column, scale) in columns.column_iter_mut().zip(&scale) {
            column /= *scale;
        }
        let qr = columns.qr();
        // The triangle has the singular values of the columns.
        let singular = qr.r().singular_values();
        let condition = singular.max() / singular.min();
        if !(condition.is_finite() && condition < 1e10) {
            return Err(HarmonicFitError::Singular { samples });
        }
        let inverse = qr.r().try_inverse().map(|r| r * qr.q().transpose());
        let mut inverse = inverse.ok_or(HarmonicFitError::Singular { samples })?;
        for (mut row, scale) in inverse.row_iter_mut().zip(&scale) {
            row /= *scale;
        }
        Ok(Self { basis, inverse, condition })
    }

    /// Condition number of the scaled columns.
    #[must_use]
    pub fn condition(&self) -> f64 {
        self.condition
    }

    /// Weights, oldest sample first, of the fitted curve's derivative 0, 1 or 2 (per sample) at
    /// `from_middle` samples after the middle.
    #[must_use]
    pub fn weights(&self, from_middle: f64, derivative: usize) -> Vec<f64> {
        let row = nalgebra::RowDVector::from_vec(self.basis.row(from_middle, derivative));
        (row * &self.inverse).iter().copied().collect()
    }

    /// Weights of the ramp alone, per sample: the motion of the window as a whole, without its vibration.
    #[must_use]
    pub fn slope_weights(&self) -> Vec<f64> {
        self.inverse.row(1).iter().copied().collect()
    }

    /// Weights of the harmonics alone at an instant, each multiplied by a complex response: what a
    /// periodic signal becomes after a filter.
    #[must_use]
    pub fn filtered_weights(&self, from_middle: f64, response: impl Fn(usize) -> Complex64) -> Vec<f64> {
        let mut row = vec![0.0; 2 + 2 * self.basis.harmonics];
        for i in 1..=self.basis.harmonics {
            let h = response(i);
            let angle = i as f64 * self.basis.fundamental_rad * from_middle + h.arg();
            row[2 * i] = h.norm() * angle.sin();
            row[2 * i + 1] = h.norm() * angle.cos();
        }
        (nalgebra::RowDVector::from_vec(row) * &self.inverse).iter().copied().collect()
    }
}

impl HarmonicBasis {
    /// Values of the basis functions' derivative 0, 1 or 2 at a time in samples.
    fn row(&self, t: f64, derivative: usize) -> Vec<f64> {
        let mut row = Vec::with_capacity(2 + 2 * self.harmonics);
        row.push(if derivative == 0 { 1.0 } else { 0.0 });
        row.push(match derivative {
            0 => t,
            1 => 1.0,
            _ => 0.0,
        });
        for i in 1..=self.harmonics {
            let w = i as f64 * self.fundamental_rad;
            let (sin, cos) = (w * t).sin_cos();
            let (s, c) = match derivative {
                0 => (sin, cos),
                1 => (w * cos, -w * sin),
                _ => (-w * w * sin, -w * w * cos),
            };
            row.push(s);
            row.push(c);
        }
        row
    }
}

/// The last samples of a signal, as many as a window needs; each stored twice.
#[derive(Debug, Clone, PartialEq)]
pub struct LongLine {
    values: Vec<f64>,
    length: usize,
    next: usize,
}

crate::keyframe::keep!(LongLine { values, length, next }
    if |s| s.length == s.values.len() / 2 && s.next < s.length);

impl LongLine {
    /// A line of `length` samples that has always held `value`.
    #[must_use]
    pub fn filled(length: usize, value: f64) -> Self {
        let length = length.max(1);
        Self { values: vec![value; 2 * length], length, next: 0 }
    }

    /// Adds the youngest sample.
    #[inline]
    pub fn push(&mut self, value: f64) {
        self.values[self.next] = value;
        self.values[self.next + self.length] = value;
        self.next = (self.next + 1) % self.length;
    }

    /// The youngest sample.
    #[must_use]
    pub fn last(&self) -> f64 {
        self.values[self.next + self.length - 1]
    }

    /// The oldest sample.
    #[must_use]
    pub fn oldest(&self) -> f64 {
        self.values[self.next]
    }

    /// How many samples it holds.
    #[must_use]
    #[allow(clippy::len_without_is_empty)] // it is never empty
    pub fn len(&self) -> usize {
        self.length
    }

    /// Sum of weights (oldest first) times the youngest samples; at most as many weights as samples.
    #[inline]
    #[must_use]
    pub fn apply(&self, weights: &[f64]) -> f64 {
        let end = self.next + self.length;
        dot(&self.values[end - weights.len().min(self.length)..end], weights)
    }
}

/// Sum of products in eight lanes: one after the other they would wait for each addition.
#[inline]
fn dot(x: &[f64], w: &[f64]) -> f64 {
    let (a, b) = (x.chunks_exact(8), w.chunks_exact(8));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(x, w)| x * w).sum();
    let mut sums = [0.0; 8];
    for (x, w) in a.zip(b) {
        for lane in 0..8 {
            sums[lane] += x[lane] * w[lane];
        }
    }
    rest + sums.iter().sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn basis(half_window: usize) -> HarmonicBasis {
        // 1300 rpm at 1 kHz: a turn is 46.2 ms.
        HarmonicBasis { half_window, fundamental_rad: TAU * 1300.0 / 60.0 / 1000.0, harmonics: 4 }
    }

    #[test]
    fn the_printed_window_is_ill_conditioned() {
        // facts.md, 3: 2.5e4 at N = 10, 20 at N = 20, 4.4 at one turn (N = 23).
        let condition = |n| HarmonicFit::new(basis(n)).unwrap().condition();
        assert!((condition(10) / 2.5e4 - 1.0).abs() < 0.1, "{}", condition(10));
        assert!((condition(20) / 20.0 - 1.0).abs() < 0.1, "{}", condition(20));
        assert!((condition(23) / 4.4 - 1.0).abs() < 0.1, "{}", condition(23));
    }

    #[test]
    fn a_curve_of_the_basis_comes_back_with_its_derivatives() {
        let fit = HarmonicFit::new(basis(23)).unwrap();
        let w = basis(23).fundamental_rad;
        let y = |t: f64| 2.0 + 0.3 * t + (w * t).sin() - 0.5 * (3.0 * w * t + 0.4).cos();
        let slope = |t: f64| 0.3 + w * (w * t).cos() + 1.5 * w * (3.0 * w * t + 0.4).sin();
        let bend = |t: f64| -w * w * (w * t).sin() + 4.5 * w * w * (3.0 * w * t + 0.4).cos();
        for at in [0.0, 0.35, 22.0] {
            let sum =
                |k| fit.weights(at, k).iter().enumerate().map(|(i, w)| w * y(i as f64 - 23.0)).sum::<f64>();
            assert!((sum(0) - y(at)).abs() < 1e-10);
            assert!((sum(1) - slope(at)).abs() < 1e-10);
            assert!((sum(2) - bend(at)).abs() < 1e-10);
            let ramp: f64 = fit.slope_weights().iter().enumerate().map(|(i, w)| w * y(i as f64 - 23.0)).sum();
            assert!((ramp - 0.3).abs() < 1e-10);
        }
    }
}
