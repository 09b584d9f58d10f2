//! Least squares judged on parts it was not fitted to.

use crate::signal::inner_products::{dot, rms};
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Folds of the held-out judgement; each is several stretches of time.
const FOLDS: usize = 4;
/// Stretches per recording.
const STRETCHES: usize = 24;

/// The rows to explain and where they belong.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Rows {
    pub(super) target: Vec<f64>,
    /// Stretches of rows, each with its fold.
    stretches: Vec<(Range<usize>, usize)>,
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

/// What a fit leaves, without the series of it.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Judged {
    pub(super) coefficients: Vec<f64>,
    pub(super) heldout_rms: f64,
    pub(super) rms: f64,
}

/// Products of columns with each other and with the target, fold by fold.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Sums {
    grams: Vec<DMatrix<f64>>,
    rights: Vec<DVector<f64>>,
    powers: Vec<f64>,
    rows: usize,
}

impl Rows {
    /// Rows of several recordings, one after the other; `lengths` says how many belong to each.
    pub(super) fn new(target: Vec<f64>, lengths: &[usize]) -> Self {
        let mut stretches = Vec::new();
        let mut first = 0;
        for &n in lengths {
            for k in 0..STRETCHES {
                let at = |k: usize| first + (k * n).div_ceil(STRETCHES);
                stretches.push((at(k)..at(k + 1), k % FOLDS));
            }
            first += n;
        }
        Self { target, stretches }
    }

    /// Products of columns with each other and a target of these rows.
    pub(super) fn sums(&self, target: &[f64], columns: &[Vec<f64>]) -> Sums {
        let mut powers = vec![0.0; FOLDS];
        for (range, fold) in &self.stretches {
            powers[*fold] += dot(&target[range.clone()], &target[range.clone()]);
        }
        let none = Sums {
            grams: vec![DMatrix::zeros(0, 0); FOLDS],
            rights: vec![DVector::zeros(0); FOLDS],
            powers,
            rows: target.len(),
        };
        self.more(&none, target, (&[], columns))
    }

    /// The same with further columns beside those that the sums are of.
    pub(super) fn more(&self, sums: &Sums, target: &[f64], (old, new): (&[Vec<f64>], &[Vec<f64>])) -> Sums {
        let (known, all) = (old.len(), old.len() + new.len());
        let mut out = sums.clone();
        out.grams.iter_mut().for_each(|g| g.resize_mut(all, all, 0.0));
        out.rights.iter_mut().for_each(|r| r.resize_vertically_mut(all, 0.0));
        for (i, a) in (known..).zip(new) {
            for (range, fold) in &self.stretches {
                let a = &a[range.clone()];
                out.rights[*fold][i] += dot(a, &target[range.clone()]);
                for (j, b) in old.iter().chain(new).enumerate().take(i + 1) {
                    out.grams[*fold][(i, j)] += dot(a, &b[range.clone()]);
                }
            }
        }
        out.grams.iter_mut().for_each(DMatrix::fill_upper_triangle_with_lower_triangle);
        out
    }

    /// Fits columns to a target of these rows, all and with each fold left out.
    pub(super) fn fit_to(&self, target: &[f64], columns: &[Vec<f64>]) -> Fit {
        let sums = self.sums(target, columns);
        let Judged { coefficients, heldout_rms, .. } = sums.judged();
        let mut residual = target.to_vec();
        for (column, b) in columns.iter().zip(&coefficients) {
            residual.iter_mut().zip(column).for_each(|(r, c)| *r -= b * c);
        }
        let left = rms(&residual);
        let deviations = sums.deviations(left);
        Fit { coefficients, heldout_rms, rms: left, residual, deviations }
    }

    /// What is left of each stretch by a fit to the others.
    pub(super) fn heldout(&self, target: &[f64], columns: &[Vec<f64>]) -> Vec<f64> {
        let sums = self.sums(target, columns);
        let without: Vec<Vec<f64>> = (0..FOLDS).map(|fold| sums.without(fold)).collect();
        let mut heldout = target.to_vec();
        for (range, fold) in &self.stretches {
            for (column, b) in columns.iter().zip(&without[*fold]) {
                heldout[range.clone()].iter_mut().zip(&column[range.clone()]).for_each(|(r, c)| *r -= b * c);
            }
        }
        heldout
    }
}

impl Sums {
    /// Sizes of the columns, which the equations are scaled by.
    fn scales(&self) -> DVector<f64> {
        let power = |i: usize| self.grams.iter().map(|g| g[(i, i)]).sum::<f64>();
        DVector::from_fn(self.rights[0].len(), |i, _| {
            (power(i) / self.rows.max(1) as f64).sqrt().max(1.0e-300)
        })
    }

    fn scaled(&self, scales: &DVector<f64>) -> (Vec<DMatrix<f64>>, Vec<DVector<f64>>) {
        let gram = |g: &DMatrix<f64>| g.map_with_location(|i, j, x| x / (scales[i] * scales[j]));
        (self.grams.iter().map(gram).collect(), self.rights.iter().map(|r| r.component_div(scales)).collect())
    }

    /// Coefficients of all rows, and what is left of each fold by those of the others.
    pub(super) fn judged(&self) -> Judged {
        let scales = self.scales();
        let (grams, rights) = self.scaled(&scales);
        let (all, right): (DMatrix<f64>, DVector<f64>) = (grams.iter().sum(), rights.iter().sum());
        let left = |power: f64, (gram, right): (&DMatrix<f64>, &DVector<f64>), b: &DVector<f64>| {
            (power - 2.0 * b.dot(right) + (gram * b).dot(b)).max(0.0)
        };
        let whole = solve(&all, &right);
        let held = (0..FOLDS).map(|f| {
            let b = solve(&(&all - &grams[f]), &(&right - &rights[f]));
            left(self.powers[f], (&grams[f], &rights[f]), &b)
        });
        let per_row = |power: f64| (power / self.rows.max(1) as f64).sqrt();
        Judged {
            heldout_rms: per_row(held.sum()),
            rms: per_row(left(self.powers.iter().sum(), (&all, &right), &whole)),
            coefficients: whole.component_div(&scales).as_slice().to_vec(),
        }
    }

    /// Coefficients of all rows but those of one fold.
    fn without(&self, fold: usize) -> Vec<f64> {
        let scales = self.scales();
        let (grams, rights) = self.scaled(&scales);
        let (all, right): (DMatrix<f64>, DVector<f64>) = (grams.iter().sum(), rights.iter().sum());
        let b = solve(&(all - &grams[fold]), &(right - &rights[fold]));
        b.component_div(&scales).as_slice().to_vec()
    }

    /// Standard deviations of the coefficients where independent rows leave `rms`.
    fn deviations(&self, rms: f64) -> Vec<f64> {
        let scales = self.scales();
        let (grams, _) = self.scaled(&scales);
        let inverse = grams.iter().sum::<DMatrix<f64>>().try_inverse();
        let of = |i: usize| inverse.as_ref().map_or(f64::INFINITY, |m| rms * m[(i, i)].max(0.0).sqrt());
        (0..scales.len()).map(|i| of(i) / scales[i]).collect()
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
        let fit = Rows::new(y.clone(), &[500]).fit_to(&y, &[x, z]);
        assert!((fit.coefficients[0] - 3.0).abs() < 1.0e-6 && (fit.coefficients[1] + 0.25).abs() < 1.0e-6);
        assert!(fit.heldout_rms < 1.0e-6);
    }

    #[test]
    fn a_column_of_chance_does_not_help_on_what_was_held_out() {
        let mut random = crate::diagnosis::chance::uniform(3);
        let y: Vec<f64> = (0..400).map(|_| random()).collect();
        let chance: Vec<Vec<f64>> = (0..6).map(|_| (0..400).map(|_| random()).collect()).collect();
        let rows = Rows::new(y, &[400]);
        let with = rows.fit_to(&rows.target, &chance);
        assert!(with.rms < rms(&rows.target), "fitted, it always helps");
        assert!(with.heldout_rms > 0.99 * rms(&rows.target), "held out, it does not");
    }

    /// Each fold predicted row by row from a fit of the others.
    #[test]
    fn what_products_say_of_held_out_rows_is_what_the_rows_say() {
        let column = |f: f64| -> Vec<f64> { (0..600).map(|k| (f64::from(k) * f).sin()).collect() };
        let (old, new) = (vec![column(0.7), column(0.11)], vec![column(0.9)]);
        let y: Vec<f64> = (0..600).map(|k| (f64::from(k) * 0.013).cos() + 0.3 * old[0][k as usize]).collect();
        let rows = Rows::new(y.clone(), &[250, 350]);
        let sums = rows.more(&rows.sums(&y, &old), &y, (&old, &new));
        let all = [old, new].concat();
        let mut left = 0.0;
        for held in 0..FOLDS {
            let is_held = |k: usize| rows.stretches.iter().any(|(r, f)| *f == held && r.contains(&k));
            let kept: Vec<usize> = (0..600).filter(|k| !is_held(*k)).collect();
            let a = DMatrix::from_fn(kept.len(), 3, |i, j| all[j][kept[i]]);
            let b = DVector::from_fn(kept.len(), |i, _| y[kept[i]]);
            let x = a.svd(true, true).solve(&b, 1.0e-12).unwrap();
            let error = |k: usize| y[k] - (0..3).map(|j| x[j] * all[j][k]).sum::<f64>();
            left += (0..600).filter(|k| is_held(*k)).map(|k| error(k).powi(2)).sum::<f64>();
        }
        let expected = (left / 600.0).sqrt();
        assert!((sums.judged().heldout_rms / expected - 1.0).abs() < 1.0e-8);
        assert!((rows.fit_to(&y, &all).heldout_rms / expected - 1.0).abs() < 1.0e-8);
        assert!((rms(&rows.heldout(&y, &all)) / expected - 1.0).abs() < 1.0e-8);
    }

    #[test]
    fn smooth_residuals_count_for_few_rows() {
        let smooth: Vec<f64> = (0..2000).map(|k| (f64::from(k) * 0.01).sin()).collect();
        assert!(correlation_rows(&smooth) > 50.0);
    }
}
