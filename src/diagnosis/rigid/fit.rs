//! Least squares judged on parts it was not fitted to.

use crate::signal::inner_products::rms;
use nalgebra::{DMatrix, DVector};

/// Folds of the held-out judgement; each is several stretches of time.
const FOLDS: usize = 4;
/// Stretches per recording.
const STRETCHES: usize = 24;

/// The rows to explain and where they belong.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rows {
    pub(super) target: Vec<f64>,
    fold: Vec<usize>,
}

/// A fit of some columns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    pub(super) coefficients: Vec<f64>,
    /// Root mean square left on stretches that were not fitted.
    pub(super) heldout_rms: f64,
    /// Root mean square left when fitted to everything.
    pub(super) rms: f64,
    /// What is left, fitted to everything.
    pub(super) residual: Vec<f64>,
    /// Standard deviations of the coefficients, for independent rows.
    pub(super) deviations: Vec<f64>,
}

impl Rows {
    /// Rows of several recordings, one after the other; `lengths` says how many belong to each.
    pub(super) fn new(target: Vec<f64>, lengths: &[usize]) -> Self {
        let mut fold = Vec::with_capacity(target.len());
        for &n in lengths {
            fold.extend((0..n).map(|k| (k * STRETCHES / n.max(1)) % FOLDS));
        }
        Self { target, fold }
    }

    /// Fits the columns, all and with each fold left out.
    pub(super) fn fit(&self, columns: &[Vec<f64>]) -> Fit {
        self.fit_to(&self.target, columns)
    }

    /// The same for another target of the same rows.
    pub(super) fn fit_to(&self, target: &[f64], columns: &[Vec<f64>]) -> Fit {
        let p = columns.len();
        let scale: Vec<f64> = columns.iter().map(|c| rms(c).max(1.0e-300)).collect();
        let mut grams = vec![DMatrix::<f64>::zeros(p, p); FOLDS];
        let mut rights = vec![DVector::<f64>::zeros(p); FOLDS];
        for (k, (y, f)) in target.iter().zip(&self.fold).enumerate() {
            for i in 0..p {
                let a = columns[i][k] / scale[i];
                rights[*f][i] += a * y;
                for j in 0..=i {
                    grams[*f][(i, j)] += a * columns[j][k] / scale[j];
                }
            }
        }
        for g in &mut grams {
            g.fill_upper_triangle_with_lower_triangle();
        }
        let all: DMatrix<f64> = grams.iter().sum();
        let right: DVector<f64> = rights.iter().sum();
        let whole = solve(&all, &right);
        let parts: Vec<DVector<f64>> =
            (0..FOLDS).map(|f| solve(&(&all - &grams[f]), &(&right - &rights[f]))).collect();
        let predict =
            |b: &DVector<f64>, k: usize| (0..p).map(|i| b[i] * columns[i][k] / scale[i]).sum::<f64>();
        let residual: Vec<f64> = target.iter().enumerate().map(|(k, y)| y - predict(&whole, k)).collect();
        let held: Vec<f64> =
            target.iter().enumerate().map(|(k, y)| y - predict(&parts[self.fold[k]], k)).collect();
        let left = rms(&residual);
        let inverse = all.clone().try_inverse();
        let deviations = (0..p)
            .map(|i| inverse.as_ref().map_or(f64::INFINITY, |m| left * m[(i, i)].max(0.0).sqrt() / scale[i]))
            .collect();
        let coefficients = (0..p).map(|i| whole[i] / scale[i]).collect();
        Fit { coefficients, heldout_rms: rms(&held), rms: left, residual, deviations }
    }
}

/// Solves the normal equations; a hair of the diagonal keeps twins from blowing up.
fn solve(gram: &DMatrix<f64>, right: &DVector<f64>) -> DVector<f64> {
    let mut g = gram.clone();
    let p = g.nrows();
    let hair = 1.0e-10 * (0..p).map(|i| g[(i, i)]).fold(0.0, f64::max) + 1.0e-300;
    for i in 0..p {
        g[(i, i)] += hair;
    }
    g.cholesky().map_or_else(|| DVector::zeros(p), |c| c.solve(right))
}

/// How many rows there are for each one that is independent: 1 + 2 sum of the autocorrelation while it is
/// positive.
pub(super) fn correlation_rows(residual: &[f64]) -> f64 {
    let n = residual.len();
    let power: f64 = residual.iter().map(|r| r * r).sum();
    if power <= 0.0 {
        return 1.0;
    }
    let mut sum = 1.0;
    for lag in 1..(n / 8).max(1) {
        let product: f64 = residual[lag..].iter().zip(residual).map(|(a, b)| a * b).sum();
        let rho = product / power;
        if rho < 0.05 {
            break;
        }
        sum += 2.0 * rho;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coefficients_of_an_exact_law_come_back() {
        let x: Vec<f64> = (0..500).map(|k| (f64::from(k) * 0.7).sin()).collect();
        let z: Vec<f64> = (0..500).map(|k| (f64::from(k) * 0.11).cos()).collect();
        let y: Vec<f64> = x.iter().zip(&z).map(|(x, z)| 3.0 * x - 0.25 * z).collect();
        let fit = Rows::new(y, &[500]).fit(&[x, z]);
        assert!((fit.coefficients[0] - 3.0).abs() < 1.0e-6 && (fit.coefficients[1] + 0.25).abs() < 1.0e-6);
        assert!(fit.heldout_rms < 1.0e-6);
    }

    #[test]
    fn a_column_of_chance_does_not_help_on_what_was_held_out() {
        let mut state = 3_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        let y: Vec<f64> = (0..400).map(|_| random()).collect();
        let chance: Vec<Vec<f64>> = (0..6).map(|_| (0..400).map(|_| random()).collect()).collect();
        let rows = Rows::new(y, &[400]);
        let with = rows.fit(&chance);
        assert!(with.rms < rms(&rows.target), "fitted, it always helps");
        assert!(with.heldout_rms > 0.99 * rms(&rows.target), "held out, it does not");
    }

    #[test]
    fn smooth_residuals_count_for_few_rows() {
        let smooth: Vec<f64> = (0..2000).map(|k| (f64::from(k) * 0.01).sin()).collect();
        assert!(correlation_rows(&smooth) > 50.0);
    }
}
