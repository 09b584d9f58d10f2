//! Least-squares fit of a window by constant, ramp and harmonics, as fixed weights.
//!
//! ```text
//!  y(t) = a_0 + a_1 t + sum_i (s_i sin(i w t) + c_i cos(i w t)),   window of 2N + 1 samples
//! ```
//! The basis is the same for every position of the window, so value, slope and curvature of the fitted
//! curve at one instant are weighted sums of the samples. Those for another spindle speed are made in small
//! pieces, a few in each sample, in memory that is there from the start.

use super::inner_products::dot;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
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
    #[error("{unknowns} unknowns in a window of {samples} samples, expected at most one a sample")]
    TooShort {
        /// Unknowns.
        unknowns: usize,
        /// Samples.
        samples: usize,
    },
    /// More samples than are kept.
    #[error("a window of {samples} samples, expected at most {LONGEST_WINDOW}")]
    TooLong {
        /// Samples.
        samples: usize,
    },
    /// A quantity that no window can be made of.
    #[error("{name} {value}: expected {:.4} to {:.1}", .range[0], .range[1])]
    OutOfRange {
        /// Which.
        name: &'static str,
        /// What it is.
        value: f64,
        /// What can be.
        range: [f64; 2],
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

impl HarmonicBasis {
    /// Samples of the window.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.half_window.saturating_mul(2).saturating_add(1)
    }

    /// Constant, ramp, and sine and cosine of each harmonic.
    #[must_use]
    pub fn unknowns(&self) -> usize {
        self.harmonics.saturating_mul(2).saturating_add(2)
    }

    fn check(&self) -> Result<(), HarmonicFitError> {
        let (samples, unknowns) = (self.samples(), self.unknowns());
        if samples > LONGEST_WINDOW {
            return Err(HarmonicFitError::TooLong { samples });
        }
        if unknowns > samples {
            return Err(HarmonicFitError::TooShort { unknowns, samples });
        }
        let share = self.harmonics as f64 * self.fundamental_rad / TAU;
        if !(share > 0.0 && share < 0.5) && self.harmonics > 0 {
            return Err(HarmonicFitError::BeyondNyquist { harmonic: self.harmonics, share });
        }
        Ok(())
    }

    /// Adds `factor` times the basis functions' derivative 0, 1 or 2 at `t` samples from the middle.
    pub fn add_row(&self, (t, derivative): (f64, usize), factor: f64, row: &mut [f64]) {
        row[0] += if derivative == 0 { factor } else { 0.0 };
        row[1] += match derivative {
            0 => factor * t,
            1 => factor,
            _ => 0.0,
        };
        for i in 1..=self.harmonics {
            let w = i as f64 * self.fundamental_rad;
            let (sin, cos) = (w * t).sin_cos();
            let (s, c) = match derivative {
                0 => (sin, cos),
                1 => (w * cos, -w * sin),
                _ => (-w * w * sin, -w * w * cos),
            };
            row[2 * i] += factor * s;
            row[2 * i + 1] += factor * c;
        }
    }

    /// Adds the harmonics alone at an instant, each multiplied by a complex response: what a periodic
    /// signal becomes after a filter.
    pub fn add_filtered(&self, t: f64, response: impl Fn(usize) -> Complex64, row: &mut [f64]) {
        for i in 1..=self.harmonics {
            let h = response(i);
            let angle = i as f64 * self.fundamental_rad * t + h.arg();
            row[2 * i] += h.norm() * angle.sin();
            row[2 * i + 1] += h.norm() * angle.cos();
        }
    }

    /// Column `k` of the window, oldest sample first.
    fn column(&self, k: usize) -> impl Iterator<Item = f64> {
        let middle = self.half_window as f64;
        let w = (k / 2) as f64 * self.fundamental_rad;
        let step = Complex64::from_polar(1.0, w);
        let mut rotor = Complex64::default();
        (0..self.samples()).map(move |i| {
            // Begun anew every 64 samples: rounding does not add up.
            rotor =
                if i % 64 == 0 { Complex64::from_polar(1.0, w * (i as f64 - middle)) } else { rotor * step };
            match k {
                0 => 1.0,
                1 => i as f64 - middle,
                _ if k.is_multiple_of(2) => rotor.im,
                _ => rotor.re,
            }
        })
    }
}

/// Functions that are the same on both sides of the middle (constant, cosines) are at right angles to those
/// that change their sign (ramp, sines).
fn same_parity(j: usize, k: usize) -> bool {
    let even = |k: usize| (k % 2 == 1) != (k < 2);
    even(j) == even(k)
}

/// Steps of the power iterations behind the condition number.
const CONDITION_STEPS: usize = 40;
/// Most harmonics for which memory is kept from the start.
pub const USUAL_HARMONICS: usize = 40;
/// Constant, ramp, sines and cosines of those.
pub const USUAL_UNKNOWNS: usize = 2 * USUAL_HARMONICS + 2;

/// Several functionals of the fitted curve, by QR with columns of unit length (modified Gram-Schmidt), made
/// piece by piece.
///
/// ```text
///  A = Q R S (S: lengths of the columns);  c . x = w . y with w = Q z = A b, R^T z = S^-1 c, R S b = z
/// ```
/// b are the coefficients of the inner products A^T y, which `sliding_fit` keeps at constant cost.
/// Errors: rounding in the weights grows with the square of the condition number; singular beyond 1e10.
/// Source: Hayashi et al., (17)-(23). Deviation: QR instead of normal equations, time from the middle of the
/// window. Checked by: the_weights_are_those_of_a_householder_qr, the_printed_window_is_ill_conditioned.
#[derive(Debug, Clone, PartialEq)]
pub struct HarmonicDesign {
    basis: HarmonicBasis,
    /// Q, one column after the other.
    columns: Vec<f64>,
    /// R, row by row.
    triangle: Vec<f64>,
    scale: Vec<f64>,
    /// For each functional what it makes of the unknowns, later z, at last its coefficients.
    rows: Vec<Vec<f64>>,
    /// |w|^2 of each functional.
    energies: Vec<f64>,
    iterates: [Vec<f64>; 2],
    condition: f64,
    place: Place,
    pieces: usize,
}

/// What comes next.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    /// Column, and the earlier column to take out of it.
    Column(usize, usize),
    /// Step of the power iterations.
    Condition(usize),
    /// Functional.
    Coefficients(usize),
    Done,
}

impl HarmonicDesign {
    /// Memory for windows up to [`LONGEST_WINDOW`] and so many functionals; touched only as far as used.
    #[must_use]
    pub fn new(functionals: usize) -> Self {
        let reserve = |n: usize| (0..functionals).map(|_| Vec::with_capacity(n)).collect();
        Self {
            basis: HarmonicBasis { half_window: 0, fundamental_rad: 0.0, harmonics: 0 },
            columns: Vec::with_capacity(LONGEST_WINDOW * USUAL_UNKNOWNS),
            triangle: Vec::with_capacity(USUAL_UNKNOWNS * USUAL_UNKNOWNS),
            scale: Vec::with_capacity(USUAL_UNKNOWNS),
            rows: reserve(USUAL_UNKNOWNS),
            energies: vec![0.0; functionals],
            iterates: std::array::from_fn(|_| Vec::with_capacity(USUAL_UNKNOWNS)),
            condition: f64::INFINITY,
            place: Place::Done,
            pieces: 0,
        }
    }

    /// Begins anew for a window. Errors: too few or too many samples, a harmonic beyond half the rate.
    pub fn begin(&mut self, basis: HarmonicBasis) -> Result<(), HarmonicFitError> {
        basis.check()?;
        let n = basis.unknowns();
        let fill = |v: &mut Vec<f64>, n: usize| {
            v.clear();
            v.resize(n, 0.0);
        };
        self.basis = basis;
        self.columns.clear();
        fill(&mut self.triangle, n * n);
        self.scale.clear();
        self.rows.iter_mut().for_each(|row| fill(row, n));
        for iterate in &mut self.iterates {
            iterate.clear();
            iterate.extend((0..n).map(|i| 1.0 + (i * i % 97) as f64 / 97.0));
        }
        (self.condition, self.place, self.pieces) = (f64::INFINITY, Place::Column(0, 0), 0);
        Ok(())
    }

    /// The coefficients of a functional, to be filled after [`Self::begin`].
    pub fn functional(&mut self, index: usize) -> (HarmonicBasis, &mut [f64]) {
        (self.basis, &mut self.rows[index])
    }

    /// Works on until about so many multiplications are spent; true when all weights are made.
    /// Errors: columns that cannot be told apart.
    pub fn advance(&mut self, multiplications: usize) -> Result<bool, HarmonicFitError> {
        let mut spent = 0;
        while self.place != Place::Done && spent <= multiplications {
            spent = spent.saturating_add(self.piece()?);
            self.pieces += 1;
        }
        Ok(self.place == Place::Done)
    }

    /// Pieces done since [`Self::begin`].
    #[must_use]
    pub fn pieces(&self) -> usize {
        self.pieces
    }

    /// Does so many pieces. Errors: as [`Self::advance`].
    pub fn catch_up(&mut self, pieces: usize) -> Result<(), HarmonicFitError> {
        while self.place != Place::Done && self.pieces < pieces {
            self.piece()?;
            self.pieces += 1;
        }
        Ok(())
    }

    /// One piece; answers how many multiplications it took.
    fn piece(&mut self) -> Result<usize, HarmonicFitError> {
        let (m, n) = (self.basis.samples(), self.basis.unknowns());
        match self.place {
            Place::Column(k, j) => {
                if j == 0 {
                    self.columns.extend(self.basis.column(k));
                    let length = self.normalise(k);
                    self.scale.push(length);
                }
                let j = (j..k).find(|j| same_parity(*j, k)).unwrap_or(k);
                self.place = Place::Column(k, j + 1);
                if j < k {
                    self.take_out(j, k);
                    return Ok(2 * m);
                }
                let left = self.normalise(k);
                self.triangle[k * n + k] = left;
                // Of a column of unit length.
                if !(left > 1e-10) {
                    return Err(HarmonicFitError::Singular { samples: m });
                }
                self.place = if k + 1 < n { Place::Column(k + 1, 0) } else { Place::Condition(0) };
                Ok(2 * m)
            }
            Place::Condition(step) => {
                self.condition = self.condition_step();
                self.place = if step + 1 < CONDITION_STEPS {
                    Place::Condition(step + 1)
                } else {
                    Place::Coefficients(0)
                };
                Ok(2 * n * n)
            }
            Place::Coefficients(row) => {
                if row >= self.rows.len() {
                    self.place = Place::Done;
                    return Ok(0);
                }
                self.solve_row(row);
                self.place = Place::Coefficients(row + 1);
                Ok(n * n)
            }
            Place::Done => Ok(0),
        }
    }

    fn normalise(&mut self, k: usize) -> f64 {
        let m = self.basis.samples();
        let column = &mut self.columns[k * m..(k + 1) * m];
        let length = dot(column, column).sqrt();
        column.iter_mut().for_each(|x| *x /= length);
        length
    }

    fn take_out(&mut self, j: usize, k: usize) {
        let (m, n) = (self.basis.samples(), self.basis.unknowns());
        let (before, now) = self.columns.split_at_mut(k * m);
        let (q, a) = (&before[j * m..(j + 1) * m], &mut now[..m]);
        let share = dot(q, a);
        add_scaled(a, -share, q);
        self.triangle[j * n + k] = share;
    }

    /// z of R^T z = S^-1 c, then b of R S b = z, in place: w = Q z = A b, |w|^2 = |z|^2.
    fn solve_row(&mut self, row: usize) {
        let (n, r) = (self.basis.unknowns(), &self.triangle);
        let z = &mut self.rows[row];
        z.iter_mut().zip(&self.scale).for_each(|(c, s)| *c /= s);
        solve_transposed(r, z);
        self.energies[row] = dot(z, z);
        for j in (0..n).rev() {
            let rest = dot(&r[j * n + j + 1..(j + 1) * n], &z[j + 1..]);
            z[j] = (z[j] - rest) / r[j * n + j];
        }
        z.iter_mut().zip(&self.scale).for_each(|(b, s)| *b /= s);
    }

    /// One step of power iterations on R^T R and on its inverse: root of the product of their largest
    /// eigenvalues.
    fn condition_step(&mut self) -> f64 {
        let (n, r) = (self.basis.unknowns(), &self.triangle);
        let [up, down] = &mut self.iterates;
        let unit = |v: &mut [f64]| {
            let length = dot(v, v).sqrt();
            v.iter_mut().for_each(|x| *x /= length);
        };
        unit(up);
        for j in 0..n {
            up[j] = dot(&r[j * n + j..(j + 1) * n], &up[j..]);
        }
        let largest = dot(up, up).sqrt();
        for k in (0..n).rev() {
            up[k] = (0..=k).map(|j| r[j * n + k] * up[j]).sum();
        }
        unit(down);
        solve_transposed(r, down);
        let smallest = dot(down, down).sqrt();
        for j in (0..n).rev() {
            let rest = dot(&r[j * n + j + 1..(j + 1) * n], &down[j + 1..]);
            down[j] = (down[j] - rest) / r[j * n + j];
        }
        largest * smallest
    }

    /// Condition number of the columns of unit length.
    #[must_use]
    pub fn condition(&self) -> f64 {
        self.condition
    }

    /// Samples of the window.
    #[must_use]
    pub fn samples(&self) -> usize {
        self.basis.samples()
    }

    /// How many functionals there are.
    #[must_use]
    pub fn functionals(&self) -> usize {
        self.rows.len()
    }

    /// Coefficients of a functional once all are made: it is their sum with the inner products of the window
    /// with constant, ramp, sine and cosine of each harmonic.
    #[must_use]
    pub fn coefficients(&self, index: usize) -> &[f64] {
        &self.rows[index]
    }

    /// Sum of the squares of its weights: the variance that white noise of one gets.
    #[must_use]
    pub fn energy(&self, index: usize) -> f64 {
        self.energies[index]
    }

    /// Its weights, oldest sample first.
    #[must_use]
    pub fn weights(&self, index: usize) -> Vec<f64> {
        let mut weights = vec![0.0; self.basis.samples()];
        for (k, b) in self.rows[index].iter().enumerate() {
            weights.iter_mut().zip(self.basis.column(k)).for_each(|(w, a)| *w += b * a);
        }
        weights
    }
}

/// x of R^T x = b, in place.
fn solve_transposed(r: &[f64], x: &mut [f64]) {
    let n = x.len();
    for j in 0..n {
        x[j] /= r[j * n + j];
        let value = x[j];
        for k in j + 1..n {
            x[k] -= r[j * n + k] * value;
        }
    }
}

fn add_scaled(to: &mut [f64], factor: f64, from: &[f64]) {
    to.iter_mut().zip(from).for_each(|(a, b)| *a += factor * b);
}

/// The last samples of a signal, as many as a window needs.
#[derive(Debug, Clone, PartialEq)]
pub struct LongLine {
    values: Vec<f64>,
    length: usize,
    next: usize,
}

crate::keyframe::keep!(LongLine { values, length, next }
    if |s| s.length == s.values.len() && s.next < s.length);

impl LongLine {
    /// A line of `length` samples that has always held `value`.
    #[must_use]
    pub fn filled(length: usize, value: f64) -> Self {
        let mut line = Self { values: Vec::new(), length: 0, next: 0 };
        line.refill(length, value);
        line
    }

    /// The same with memory for [`LONGEST_WINDOW`], touched only as far as used.
    #[must_use]
    pub fn roomy(length: usize, value: f64) -> Self {
        let mut line = Self { values: Vec::with_capacity(LONGEST_WINDOW), length: 0, next: 0 };
        line.refill(length, value);
        line
    }

    /// As a new line of that length; asks for memory only where the line never had so much.
    pub fn refill(&mut self, length: usize, value: f64) {
        (self.length, self.next) = (length.max(1), 0);
        self.values.clear();
        self.values.resize(self.length, value);
    }

    /// Adds the youngest sample.
    #[inline]
    pub fn push(&mut self, value: f64) {
        self.values[self.next] = value;
        self.next = if self.next + 1 == self.length { 0 } else { self.next + 1 };
    }

    /// The youngest sample.
    #[must_use]
    pub fn last(&self) -> f64 {
        self.values[if self.next == 0 { self.length - 1 } else { self.next - 1 }]
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    fn basis(half_window: usize) -> HarmonicBasis {
        // 1300 rpm at 1 kHz: a turn is 46.2 ms.
        HarmonicBasis { half_window, fundamental_rad: TAU * 1300.0 / 60.0 / 1000.0, harmonics: 4 }
    }

    fn designed(basis: HarmonicBasis, rows: &[(f64, usize)]) -> HarmonicDesign {
        let mut design = HarmonicDesign::new(rows.len());
        design.begin(basis).unwrap();
        for (index, at) in rows.iter().enumerate() {
            let (basis, row) = design.functional(index);
            basis.add_row(*at, 1.0, row);
        }
        while !design.advance(1000).unwrap() {}
        design
    }

    #[test]
    fn the_printed_window_is_ill_conditioned() {
        // facts.md, 3: 2.5e4 at N = 10, 20 at N = 20, 4.4 at one turn (N = 23).
        let condition = |n| designed(basis(n), &[]).condition();
        assert!((condition(10) / 2.5e4 - 1.0).abs() < 0.1, "{}", condition(10));
        assert!((condition(20) / 20.0 - 1.0).abs() < 0.1, "{}", condition(20));
        assert!((condition(23) / 4.4 - 1.0).abs() < 0.1, "{}", condition(23));
    }

    #[test]
    fn a_curve_of_the_basis_comes_back_with_its_derivatives() {
        let w = basis(23).fundamental_rad;
        let y = |t: f64| 2.0 + 0.3 * t + (w * t).sin() - 0.5 * (3.0 * w * t + 0.4).cos();
        let slope = |t: f64| 0.3 + w * (w * t).cos() + 1.5 * w * (3.0 * w * t + 0.4).sin();
        let bend = |t: f64| -w * w * (w * t).sin() + 4.5 * w * w * (3.0 * w * t + 0.4).cos();
        for at in [0.0, 0.35, 22.0] {
            let fit = designed(basis(23), &[(at, 0), (at, 1), (at, 2)]);
            let sum = |k| fit.weights(k).iter().enumerate().map(|(i, w)| w * y(i as f64 - 23.0)).sum::<f64>();
            assert!((sum(0) - y(at)).abs() < 1e-10);
            assert!((sum(1) - slope(at)).abs() < 1e-10);
            assert!((sum(2) - bend(at)).abs() < 1e-10);
        }
    }

    /// Another library's factorisation and singular values, also where the window is far from sound.
    #[test]
    fn the_weights_are_those_of_a_householder_qr() {
        for (half_window, tolerance) in [(10, 1e-7), (23, 1e-11), (150, 1e-11)] {
            let basis =
                HarmonicBasis { harmonics: if half_window > 100 { 20 } else { 4 }, ..basis(half_window) };
            let (m, n) = (basis.samples(), basis.unknowns());
            let columns = DMatrix::from_fn(m, n, |i, k| {
                let mut row = vec![0.0; n];
                basis.add_row((i as f64 - half_window as f64, 0), 1.0, &mut row);
                row[k]
            });
            let lengths: Vec<f64> = columns.column_iter().map(|c| c.norm()).collect();
            let unit = DMatrix::from_fn(m, n, |i, k| columns[(i, k)] / lengths[k]);
            let singular = unit.singular_values();
            let fit = designed(basis, &[(1.7, 2)]);
            let condition = singular.max() / singular.min();
            assert!((fit.condition() / condition - 1.0).abs() < 0.05, "{} {condition}", fit.condition());
            let mut row = vec![0.0; n];
            basis.add_row((1.7, 2), 1.0, &mut row);
            let wanted = nalgebra::DVector::from_fn(n, |k, _| row[k] / lengths[k]);
            let qr = unit.qr();
            let z = qr.r().transpose().solve_lower_triangular(&wanted).unwrap();
            let expected = qr.q() * z;
            let error = (0..m).map(|i| (fit.weights(0)[i] - expected[i]).abs()).fold(0.0, f64::max);
            assert!(error < tolerance * expected.amax(), "{half_window}: {error} of {}", expected.amax());
        }
    }

    #[test]
    fn piece_by_piece_gives_the_same_bits() {
        let rows = [(0.0, 0), (22.0, 2)];
        let at_once = designed(basis(23), &rows);
        let mut pieces = HarmonicDesign::new(rows.len());
        pieces.begin(basis(23)).unwrap();
        for (index, at) in rows.iter().enumerate() {
            let (basis, row) = pieces.functional(index);
            basis.add_row(*at, 1.0, row);
        }
        pieces.catch_up(37).unwrap();
        assert!(pieces.pieces() == 37 && !pieces.advance(0).unwrap());
        while !pieces.advance(0).unwrap() {}
        assert_eq!((pieces.weights(0), pieces.weights(1)), (at_once.weights(0), at_once.weights(1)));
        assert_eq!(pieces.pieces(), at_once.pieces());
    }
}
