//! Least squares with folds: fitted on some blocks of time, judged on the others.

use super::encoder_noise::NoiseShare;
use super::problem::Column;
use super::two_cores::on_two_cores;
use super::whitening::Layout;
use crate::signal::inner_products::dot;
use nalgebra::{DMatrix, DVector};
use std::ops::AddAssign;

/// Folds of the held-out judgement.
pub(crate) const FOLDS: usize = 4;
/// Share of a column's power that the other folds hold, from which on they measure it (it is three quarters
/// where the column is spread evenly).
const LEAST_TRAINED: f64 = 0.5;
/// Length of a block that stays together, s.
const BLOCK_S: f64 = 0.25;

/// Share of itself by which the noise of the encoders may be read wrongly.
const NOISE_DOUBT: f64 = 0.05;

/// Weight of a held coefficient over what the data say of it.
const HELD: f64 = 100.0;

/// A run of the flat vector that belongs to one fold.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Segment {
    start: usize,
    end: usize,
    fold: usize,
}

/// How the flat vector falls into folds.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Folds {
    segments: Vec<Segment>,
    total: usize,
    block: usize,
    lengths: Vec<usize>,
    first_block: Vec<usize>,
}

impl Folds {
    pub(crate) fn new(layout: &Layout, rate_hz: f64) -> Self {
        // Short recordings have shorter blocks: every fold gets two.
        let most = layout.lengths.iter().sum::<usize>() / (2 * FOLDS);
        let block = ((BLOCK_S * rate_hz) as usize).min(most).max(1);
        let mut segments = Vec::new();
        let mut first = 0;
        let mut first_block = Vec::new();
        for (recording, &n) in layout.lengths.iter().enumerate() {
            first_block.push(first);
            for side in 0..layout.sides {
                let start = layout.start(recording, side);
                let mut k = 0;
                while k * block < n {
                    let end = ((k + 1) * block).min(n);
                    segments.push(Segment {
                        start: start + k * block,
                        end: start + end,
                        fold: (first + k) % FOLDS,
                    });
                    k += 1;
                }
            }
            first += n.div_ceil(block);
        }
        Self { segments, total: layout.total(), block, lengths: layout.lengths.clone(), first_block }
    }

    /// Samples.
    pub(crate) fn total(&self) -> usize {
        self.total
    }

    /// Copies the samples of one fold from one residual into another.
    pub(crate) fn copy_fold(&self, fold: usize, from: &Column, to: &mut Column) {
        for (recording, n) in self.lengths.iter().enumerate() {
            for k in 0..n.div_ceil(self.block) {
                if (self.first_block[recording] + k) % FOLDS != fold {
                    continue;
                }
                let range = k * self.block..((k + 1) * self.block).min(*n);
                let (source, sink) = (&from[recording], &mut to[recording]);
                for (a, b) in [(&source.motor, &mut sink.motor), (&source.stage, &mut sink.stage)] {
                    if let (Some(a), Some(b)) = (a, b) {
                        b[range.clone()].copy_from_slice(&a[range.clone()]);
                    }
                }
            }
        }
    }

    /// Instants in each fold.
    pub(crate) fn instants(&self) -> [f64; FOLDS] {
        let mut out = [0.0; FOLDS];
        for (recording, n) in self.lengths.iter().enumerate() {
            for k in 0..n.div_ceil(self.block) {
                let length = ((k + 1) * self.block).min(*n) - k * self.block;
                out[(self.first_block[recording] + k) % FOLDS] += length as f64;
            }
        }
        out
    }

    /// Inner product in each fold, pair by pair.
    ///
    /// Block by block over all pairs: a column that stands in many of them is read from memory once.
    fn dots(&self, pairs: &[(&[f64], &[f64])]) -> Vec<[f64; FOLDS]> {
        let mut out = vec![[0.0; FOLDS]; pairs.len()];
        for s in &self.segments {
            for (sum, (a, b)) in out.iter_mut().zip(pairs) {
                sum[s.fold] += dot(&a[s.start..s.end], &b[s.start..s.end]);
            }
        }
        out
    }

    fn power(&self, a: &[f64]) -> [f64; FOLDS] {
        self.dots(&[(a, a)])[0]
    }
}

/// Inner products of columns and target, per fold.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Gram {
    /// Columns with columns, per fold.
    inner: Vec<DMatrix<f64>>,
    /// Columns with the target.
    target: Vec<DVector<f64>>,
    /// Target with itself.
    power: [f64; FOLDS],
    samples: usize,
    /// What is heeded beside the sums.
    beside: Beside,
}

/// What a solution heeds beside the sums: the noise that the columns carry, and what was known before.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Beside {
    /// What noise adds to the sums in an instant; of the first columns.
    pub(crate) noise: NoiseShare,
    /// Instants in each fold.
    pub(crate) instants: [f64; FOLDS],
    /// Precision and value of the first coefficients before anything is measured.
    pub(crate) known: Vec<[f64; 2]>,
    /// Columns that are knots of maps: held-out folds expect nothing of those that the others hardly measure.
    pub(crate) knots: Vec<usize>,
}

impl Beside {
    /// Coefficients of the columns `used` (zero where not) and the diagonal of their covariance, in units of
    /// the residual's variance.
    ///
    /// With noise N in the sums T the equations (T - N) b = y hold in the mean, with an error of covariance
    /// S = T + d d': that of the residual and that of N itself. Weighed by it beside what was known, P, b_0,
    ///
    /// ```text
    ///   (H + P) b = (T - N) S^-1 y + P b_0,   H = (T - N) S^-1 (T - N)
    /// ```
    ///
    /// Where a column is noise, H vanishes and what was known stands; without noise it is least squares.
    /// Checked by: tests::{noise_in_a_column_is_taken_out, a_column_of_noise_says_nothing}.
    fn solve(&self, sums: &Sums, used: &[usize]) -> (DVector<f64>, Vec<f64>) {
        let m = used.len();
        let scale: Vec<f64> = used.iter().map(|&k| sums.inner[(k, k)].max(1e-300).sqrt().recip()).collect();
        let mut total = DMatrix::from_fn(m, m, |i, j| sums.inner[(used[i], used[j])] * scale[i] * scale[j]);
        // A whisper of ridge: two columns that the data cannot tell apart share, instead of cancelling.
        (0..m).for_each(|i| total[(i, i)] += 1e-10);
        let mut target = DVector::from_fn(m, |i, _| sums.target[used[i]] * scale[i]);
        let nothing = || (DVector::zeros(sums.target.len()), vec![f64::INFINITY; m]);
        let known = self.known.len();
        let noisy = self.noise.target.len();
        if noisy > 0 {
            let of = |i: usize, j: usize| {
                let inside = used[i] < noisy && used[j] < noisy;
                if inside { self.noise.columns[(used[i], used[j])] * scale[i] * scale[j] } else { 0.0 }
            };
            let noise = DMatrix::from_fn(m, m, of) * sums.instants;
            let of_target = |i: usize, _| {
                if used[i] < noisy { self.noise.target[used[i]] * scale[i] } else { 0.0 }
            };
            let shared = DVector::from_fn(m, of_target) * sums.instants;
            let stated =
                DVector::from_fn(
                    m,
                    |i, _| if used[i] < known { self.known[used[i]][1] / scale[i] } else { 0.0 },
                );
            let doubt = (&noise * stated - &shared) * NOISE_DOUBT;
            let doubts = &doubt * doubt.transpose();
            let error = total + &doubts;
            let taken = noise + doubts;
            target -= shared;
            let Some(chol) = error.clone().cholesky() else { return nothing() };
            target -= &taken * chol.solve(&target);
            total = error - &taken * 2.0 + &taken * chol.solve(&taken);
        }
        for i in (0..m).filter(|i| used[*i] < known) {
            let [precision, value] = self.known[used[i]];
            total[(i, i)] += precision * scale[i] * scale[i];
            target[i] += precision * value * scale[i];
        }
        let Some(chol) = total.cholesky() else { return nothing() };
        let (b, inverse) = (chol.solve(&target), chol.inverse());
        let mut out = DVector::zeros(sums.target.len());
        (0..m).for_each(|i| out[used[i]] = b[i] * scale[i]);
        (out, (0..m).map(|i| inverse[(i, i)] * scale[i] * scale[i]).collect())
    }
}

/// Sums over some of the folds.
struct Sums {
    inner: DMatrix<f64>,
    target: DVector<f64>,
    instants: f64,
}

/// Coefficients with what they leave.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Solution {
    /// Fitted to everything.
    pub(crate) coefficients: Vec<f64>,
    /// Standard deviations from the curvature and the residual.
    pub(crate) deviations: Vec<f64>,
    /// Sum of squares left, fitted to everything.
    pub(crate) left: f64,
    /// Sum of squares left on held-out folds.
    pub(crate) heldout: f64,
}

/// Rows of the Gram matrix that are summed together: their blocks stay in the cache.
const ROWS: usize = 8;

/// A row of the lower triangle and of the right-hand side: a column with all up to itself, then the target.
fn row<'a>(
    columns: &'a [&'a [f64]],
    a: usize,
    target: &'a [f64],
) -> impl Iterator<Item = (&'a [f64], &'a [f64])> {
    columns[..=a].iter().copied().chain([target]).map(move |other| (columns[a], other))
}

/// target - columns * coefficients.
pub(crate) fn left(mut target: Vec<f64>, columns: &[Vec<f64>], coefficients: &[f64]) -> Vec<f64> {
    for (column, b) in columns.iter().zip(coefficients).filter(|(_, b)| **b != 0.0) {
        target.iter_mut().zip(column).for_each(|(z, x)| *z -= b * x);
    }
    target
}

impl Gram {
    pub(crate) fn new(columns: &[Vec<f64>], target: &[f64], folds: &Folds) -> Self {
        let n = columns.len();
        let mut gram = Self {
            inner: vec![DMatrix::zeros(n, n); FOLDS],
            target: vec![DVector::zeros(n); FOLDS],
            power: folds.power(target),
            samples: folds.total(),
            beside: Beside::default(),
        };
        let all: Vec<&[f64]> = columns.iter().map(Vec::as_slice).collect();
        let rows: Vec<usize> = (0..n).collect();
        let rows: Vec<&[usize]> = rows.chunks(ROWS).collect();
        let products = on_two_cores(&rows, |rows| {
            folds.dots(&rows.iter().flat_map(|&a| row(&all, a, target)).collect::<Vec<_>>())
        });
        for (rows, products) in rows.into_iter().zip(products) {
            gram.fill(rows, &products);
        }
        gram
    }

    /// This Gram with what is heeded beside its sums.
    pub(crate) fn beside(mut self, beside: Beside) -> Self {
        self.beside = beside;
        self
    }

    /// Puts the products of whole rows in their places.
    fn fill(&mut self, rows: &[usize], products: &[[f64; FOLDS]]) {
        let mut products = products.iter();
        for &a in rows {
            for (b, d) in products.by_ref().take(a + 1).enumerate() {
                for f in 0..FOLDS {
                    self.inner[f][(a, b)] = d[f];
                    self.inner[f][(b, a)] = d[f];
                }
            }
            if let Some(d) = products.next() {
                for f in 0..FOLDS {
                    self.target[f][a] = d[f];
                }
            }
        }
    }

    /// This Gram with further columns behind its own. `columns`: its own, then those.
    pub(crate) fn with(&self, columns: &[&[f64]], target: &[f64], folds: &Folds) -> Self {
        let n = self.columns();
        let m = columns.len() - n;
        let mut gram = Self {
            inner: self.inner.iter().map(|g| g.clone().resize(n + m, n + m, 0.0)).collect(),
            target: self.target.iter().map(|t| t.clone().resize_vertically(n + m, 0.0)).collect(),
            power: self.power,
            samples: self.samples,
            beside: self.beside.clone(),
        };
        let rows: Vec<usize> = (n..n + m).collect();
        for rows in rows.chunks(ROWS) {
            let pairs: Vec<_> = rows.iter().flat_map(|&a| row(columns, a, target)).collect();
            gram.fill(rows, &folds.dots(&pairs));
        }
        gram
    }

    /// These columns are knots of a map.
    pub(crate) fn mark_knots(&mut self, columns: std::ops::Range<usize>) {
        self.beside.knots.extend(columns);
    }

    /// This Gram with `factor` times the last column in another one, not by itself.
    pub(crate) fn tied_to(mut self, column: usize, factor: f64) -> Self {
        let last = self.columns() - 1;
        for (inner, target) in self.inner.iter_mut().zip(&mut self.target) {
            let row = inner.row(last) * factor;
            inner.row_mut(column).add_assign(&row);
            let with = inner.column(last) * factor;
            inner.column_mut(column).add_assign(&with);
            target[column] += factor * target[last];
            *inner = inner.clone().resize(last, last, 0.0);
            *target = target.clone().resize_vertically(last, 0.0);
        }
        self
    }

    /// This Gram with one coefficient held near a value, as if it had been measured a hundred times better
    /// than here.
    pub(crate) fn holding(&self, column: usize, value: f64) -> Self {
        let mut gram = self.clone();
        for inner in &mut gram.inner {
            inner[(column, column)] *= 1.0 + HELD;
        }
        gram.holding_target(column, value)
    }

    /// The target's part of [`Gram::holding`], for a Gram whose columns already hold.
    pub(crate) fn holding_target(mut self, column: usize, value: f64) -> Self {
        for f in 0..FOLDS {
            let weight = HELD / (1.0 + HELD) * self.inner[f][(column, column)];
            self.target[f][column] += weight * value;
            self.power[f] += weight * value * value;
        }
        self
    }

    /// The same columns with another target.
    pub(crate) fn retarget(&self, columns: &[Vec<f64>], target: &[f64], folds: &Folds) -> Self {
        let mut gram = self.clone();
        gram.power = folds.power(target);
        let pairs: Vec<(&[f64], &[f64])> = columns.iter().map(|c| (c.as_slice(), target)).collect();
        for (a, d) in folds.dots(&pairs).into_iter().enumerate() {
            for f in 0..FOLDS {
                gram.target[f][a] = d[f];
            }
        }
        gram
    }

    /// Solves for the columns `used` (all others zero).
    pub(crate) fn solve(&self, used: &[usize]) -> Solution {
        let all = self.sums(None);
        let (coefficients, inverse) = self.beside.solve(&all, used);
        let lost = |b: &DVector<f64>, inner: &DMatrix<f64>, target: &DVector<f64>| {
            (b.transpose() * inner * b)[(0, 0)] - 2.0 * b.dot(target)
        };
        let power: f64 = self.power.iter().sum();
        let left = (power + lost(&coefficients, &all.inner, &all.target)).max(0.0);
        let variance = left / (self.samples.saturating_sub(used.len()).max(1)) as f64;
        let mut heldout = 0.0;
        for f in 0..FOLDS {
            let trained = self.trained(f, &all, (&coefficients, variance));
            let (b, _) = self.beside.solve(&trained, used);
            heldout += self.power[f] + lost(&b, &self.inner[f], &self.target[f]);
        }
        let mut deviations = vec![0.0; self.columns()];
        for (k, &column) in used.iter().enumerate() {
            deviations[column] = (inverse[k] * variance).max(0.0).sqrt();
        }
        Solution { coefficients: coefficients.iter().copied().collect(), deviations, left, heldout }
    }

    /// Coefficients fitted to all folds but one.
    pub(crate) fn solve_without(&self, fold: usize, used: &[usize]) -> Vec<f64> {
        let all = self.sums(None);
        let (b, _) = self.beside.solve(&all, used);
        let power: f64 = self.power.iter().sum();
        let left = power + (b.transpose() * &all.inner * &b)[(0, 0)] - 2.0 * b.dot(&all.target);
        let variance = left.max(0.0) / (self.samples.saturating_sub(used.len()).max(1)) as f64;
        self.beside.solve(&self.trained(fold, &all, (&b, variance)), used).0.iter().copied().collect()
    }

    /// Sums over all folds but one. The knot of a map at a place that was passed in that fold is hardly
    /// measured by the others: it is expected to be no larger than it is in the whole (normally distributed
    /// about zero), or noise beside it would set it.
    fn trained(&self, fold: usize, all: &Sums, (whole, variance): (&DVector<f64>, f64)) -> Sums {
        let mut sums = self.sums(Some(fold));
        for &k in &self.beside.knots {
            if sums.inner[(k, k)] < LEAST_TRAINED * all.inner[(k, k)] && whole[k] != 0.0 {
                sums.inner[(k, k)] += variance / whole[k].powi(2);
            }
        }
        sums
    }

    /// Sums over all folds but one.
    fn sums(&self, without: Option<usize>) -> Sums {
        let n = self.columns();
        let mut sums = Sums { inner: DMatrix::zeros(n, n), target: DVector::zeros(n), instants: 0.0 };
        for f in (0..FOLDS).filter(|f| Some(*f) != without) {
            sums.inner += &self.inner[f];
            sums.target += &self.target[f];
            sums.instants += self.beside.instants[f];
        }
        sums
    }

    /// Number of columns.
    pub(crate) fn columns(&self) -> usize {
        self.target[0].len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tied_column_is_the_sum_of_both() {
        let layout = Layout { lengths: vec![400], sides: 1 };
        let folds = Folds::new(&layout, 100.0);
        let wave = |w: f64| (0..400).map(|k| (w * f64::from(k)).sin()).collect::<Vec<f64>>();
        let (x, y, c, target) = (wave(0.1), wave(0.37), wave(0.9), wave(0.21));
        let sum: Vec<f64> = y.iter().zip(&c).map(|(y, c)| y - 0.7 * c).collect();
        let own = [x.clone(), y];
        let tied =
            Gram::new(&own, &target, &folds).with(&[&own[0], &own[1], &c], &target, &folds).tied_to(1, -0.7);
        let made = Gram::new(&[x, sum], &target, &folds);
        assert_eq!(tied.columns(), 2);
        for f in 0..FOLDS {
            assert!((&tied.inner[f] - &made.inner[f]).amax() < 1e-9);
            assert!((&tied.target[f] - &made.target[f]).amax() < 1e-9);
        }
    }

    /// One column of amplitude 3 that is measured with noise, one without; `signal`: of the noisy one.
    fn noisy(signal: f64) -> Solution {
        let layout = Layout { lengths: vec![8000], sides: 1 };
        let folds = Folds::new(&layout, 1000.0);
        let mut noise = super::super::chance::normal(7);
        let (mut x, mut y, mut target) = (Vec::new(), Vec::new(), Vec::new());
        for k in 0..8000 {
            let (a, b) = (signal * (0.37 * f64::from(k)).sin(), (0.11 * f64::from(k)).cos());
            x.push(a + noise());
            y.push(b);
            target.push(3.0 * a + 2.0 * b + 0.1 * noise());
        }
        let share =
            NoiseShare { columns: DMatrix::from_element(1, 1, 1.0), target: DVector::from_element(1, 0.0) };
        let beside = Beside {
            noise: share,
            instants: folds.instants(),
            known: vec![[(0.3_f64 * 2.7).powi(-2), 2.7]],
            knots: Vec::new(),
        };
        Gram::new(&[x, y], &target, &folds).beside(beside).solve(&[0, 1])
    }

    #[test]
    fn noise_in_a_column_is_taken_out() {
        let fit = noisy(2.0);
        assert!((fit.coefficients[0] - 3.0).abs() < 0.1, "{fit:?}");
        assert!((fit.coefficients[1] - 2.0).abs() < 0.1, "{fit:?}");
    }

    #[test]
    fn a_column_of_noise_says_nothing() {
        let fit = noisy(0.0);
        assert!((fit.coefficients[0] - 2.7).abs() < 0.2 && fit.deviations[0] > 0.05, "{fit:?}");
        assert!((fit.coefficients[1] - 2.0).abs() < 0.1, "{fit:?}");
    }
}
