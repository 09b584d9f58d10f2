//! Hermitian positive definite banded systems: Cholesky in the band.

use rustfft::num_complex::Complex64;
use thiserror::Error;

/// Why a system cannot be solved.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum BandedError {
    /// A pivot is not positive.
    #[error("least-squares equations are singular at unknown {index} of {size}")]
    Singular {
        /// Unknown.
        index: usize,
        /// Number of unknowns.
        size: usize,
    },
}

/// Lower band of a Hermitian matrix: row i holds columns i - width ..= i.
#[derive(Debug, Clone, PartialEq)]
pub struct BandedHermitian {
    size: usize,
    width: usize,
    rows: Vec<Complex64>,
}

impl BandedHermitian {
    /// Zero matrix of `size` with `width` diagonals beside the main one.
    #[must_use]
    pub fn new(size: usize, width: usize) -> Self {
        Self { size, width, rows: vec![Complex64::new(0.0, 0.0); size * (width + 1)] }
    }

    fn index(&self, row: usize, column: usize) -> usize {
        debug_assert!(column <= row && row - column <= self.width);
        row * (self.width + 1) + self.width + column - row
    }

    /// Adds weight * a^H a, where `a` begins at unknown `start`.
    pub fn add_outer(&mut self, start: usize, a: &[Complex64], weight: f64) {
        for (i, x) in a.iter().enumerate() {
            if x.norm_sqr() == 0.0 {
                continue;
            }
            for (j, y) in a.iter().enumerate().take(i + 1) {
                let at = self.index(start + i, start + j);
                self.rows[at] += x.conj() * y * weight;
            }
        }
    }

    /// Solution and an estimate of the condition number (of the matrix scaled to a unit diagonal).
    /// Errors: a pivot that is not positive.
    pub fn solve(&self, right: &[Complex64]) -> Result<(Vec<Complex64>, f64), BandedError> {
        let scale: Vec<f64> =
            (0..self.size).map(|i| self.rows[self.index(i, i)].re.max(1e-300).sqrt().recip()).collect();
        let mut scaled = self.clone();
        for i in 0..self.size {
            for j in i.saturating_sub(self.width)..=i {
                let at = self.index(i, j);
                scaled.rows[at] *= scale[i] * scale[j];
            }
        }
        let factor = scaled.factor()?;
        let mut x: Vec<Complex64> = right.iter().zip(&scale).map(|(r, s)| r * s).collect();
        factor.substitute(&mut x);
        x.iter_mut().zip(&scale).for_each(|(x, s)| *x *= *s);
        Ok((x, scaled.largest_eigenvalue() * factor.largest_inverse_eigenvalue()))
    }

    fn factor(&self) -> Result<Self, BandedError> {
        let mut l = self.clone();
        for i in 0..self.size {
            let first = i.saturating_sub(self.width);
            for j in first..=i {
                let mut sum = l.rows[l.index(i, j)];
                for k in first.max(j.saturating_sub(self.width))..j {
                    sum -= l.rows[l.index(i, k)] * l.rows[l.index(j, k)].conj();
                }
                let at = l.index(i, j);
                if i == j {
                    if !(sum.re > 1e-14) {
                        return Err(BandedError::Singular { index: i, size: self.size });
                    }
                    l.rows[at] = Complex64::new(sum.re.sqrt(), 0.0);
                } else {
                    l.rows[at] = sum / l.rows[l.index(j, j)].re;
                }
            }
        }
        Ok(l)
    }

    /// Solves L L^H x = b in place; `self` is the factor.
    fn substitute(&self, x: &mut [Complex64]) {
        for i in 0..self.size {
            let mut sum = x[i];
            for k in i.saturating_sub(self.width)..i {
                sum -= self.rows[self.index(i, k)] * x[k];
            }
            x[i] = sum / self.rows[self.index(i, i)].re;
        }
        for i in (0..self.size).rev() {
            x[i] /= self.rows[self.index(i, i)].re;
            let value = x[i];
            for k in i.saturating_sub(self.width)..i {
                x[k] -= self.rows[self.index(i, k)].conj() * value;
            }
        }
    }

    fn multiply(&self, x: &[Complex64]) -> Vec<Complex64> {
        let mut y = vec![Complex64::new(0.0, 0.0); self.size];
        for i in 0..self.size {
            for j in i.saturating_sub(self.width)..i {
                let a = self.rows[self.index(i, j)];
                y[i] += a * x[j];
                y[j] += a.conj() * x[i];
            }
            y[i] += self.rows[self.index(i, i)] * x[i];
        }
        y
    }

    fn largest_eigenvalue(&self) -> f64 {
        power_iteration(self.size, |x| *x = self.multiply(x))
    }

    fn largest_inverse_eigenvalue(&self) -> f64 {
        power_iteration(self.size, |x| self.substitute(x))
    }
}

fn power_iteration(size: usize, step: impl Fn(&mut Vec<Complex64>)) -> f64 {
    let mut x: Vec<Complex64> = (0..size).map(|i| Complex64::from_polar(1.0, (i * i % 97) as f64)).collect();
    let mut size = 0.0;
    for _ in 0..30 {
        let norm = x.iter().map(Complex64::norm_sqr).sum::<f64>().sqrt();
        x.iter_mut().for_each(|v| *v /= norm);
        step(&mut x);
        size = x.iter().map(Complex64::norm_sqr).sum::<f64>().sqrt();
    }
    size
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_banded_system_gives_back_the_solution_it_was_made_from() {
        let mut a = BandedHermitian::new(40, 5);
        let value = |k: usize| Complex64::new((k as f64 * 1.7).sin(), (k as f64 * 0.9).cos());
        for start in 0..35 {
            let row: Vec<Complex64> = (0..6).map(|k| value(start * 6 + k)).collect();
            a.add_outer(start, &row, 1.0);
        }
        for i in 0..40 {
            a.add_outer(i, &[Complex64::new(1.0, 0.0)], 0.1);
        }
        let x: Vec<Complex64> = (0..40).map(|k| value(3 * k + 1)).collect();
        let (solved, condition) = a.solve(&a.multiply(&x)).unwrap();
        assert!(condition > 1.0 && condition.is_finite());
        for (a, b) in x.iter().zip(&solved) {
            assert!((a - b).norm() < 1e-9);
        }
    }
}
