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
/// Length of a block that stays together, s.
const BLOCK_S: f64 = 0.25;

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
        let block = ((BLOCK_S * rate_hz) as usize).max(1);
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
}

impl Beside {
    /// Subtracts the noise of `instants` and adds what was known. `part`: of the noise.
    fn apply(&self, part: f64, instants: f64, (inner, target): (&mut DMatrix<f64>, &mut DVector<f64>)) {
        let n = self.noise.target.len();
        let mut block = inner.view_mut((0, 0), (n, n));
        block -= &self.noise.columns * (part * instants);
        let mut head = target.rows_mut(0, n);
        head -= &self.noise.target * (part * instants);
        for (k, [precision, value]) in self.known.iter().enumerate() {
            inner[(k, k)] += precision;
            target[k] += precision * value;
        }
    }
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
        let (total, right, _) = self.sums(None);
        let power: f64 = self.power.iter().sum();
        let (coefficients, inverse) = self.solve_sums(None, used);
        let lost = |b: &DVector<f64>, inner: &DMatrix<f64>, target: &DVector<f64>| {
            (b.transpose() * inner * b)[(0, 0)] - 2.0 * b.dot(target)
        };
        let left = (power + lost(&coefficients, &total, &right)).max(0.0);
        let mut heldout = 0.0;
        for f in 0..FOLDS {
            let (b, _) = self.solve_sums(Some(f), used);
            heldout += self.power[f] + lost(&b, &self.inner[f], &self.target[f]);
        }
        let variance = left / (self.samples.saturating_sub(used.len()).max(1)) as f64;
        let mut deviations = vec![0.0; right.len()];
        for (k, &column) in used.iter().enumerate() {
            deviations[column] = (inverse[k] * variance).max(0.0).sqrt();
        }
        Solution { coefficients: coefficients.iter().copied().collect(), deviations, left, heldout }
    }

    /// Coefficients fitted to all folds but one.
    pub(crate) fn solve_without(&self, fold: usize, used: &[usize]) -> Vec<f64> {
        self.solve_sums(Some(fold), used).0.iter().copied().collect()
    }

    /// Sums over all folds but one, and their instants.
    fn sums(&self, without: Option<usize>) -> (DMatrix<f64>, DVector<f64>, f64) {
        let n = self.columns();
        let mut sums = (DMatrix::zeros(n, n), DVector::zeros(n), 0.0);
        for f in (0..FOLDS).filter(|f| Some(*f) != without) {
            sums.0 += &self.inner[f];
            sums.1 += &self.target[f];
            sums.2 += self.beside.instants[f];
        }
        sums
    }

    /// Coefficients (zero where not used) and the diagonal of the inverse over the used columns.
    fn solve_sums(&self, without: Option<usize>, used: &[usize]) -> (DVector<f64>, Vec<f64>) {
        let (inner, target, instants) = self.sums(without);
        // Where the noise is nearly all that a column holds, its estimate may take more than there is.
        for part in [1.0, 0.9, 0.7, 0.0] {
            let (mut inner, mut target) = (inner.clone(), target.clone());
            self.beside.apply(part, instants, (&mut inner, &mut target));
            if let Some(solution) = solve_used(&inner, &target, used) {
                return solution;
            }
        }
        (DVector::zeros(target.len()), vec![f64::INFINITY; used.len()])
    }

    /// Number of columns.
    pub(crate) fn columns(&self) -> usize {
        self.target[0].len()
    }
}

/// Coefficients (zero where not used) and the diagonal of the inverse over the used columns; `None`: the
/// matrix is not positive definite.
fn solve_used(
    total: &DMatrix<f64>,
    right: &DVector<f64>,
    used: &[usize],
) -> Option<(DVector<f64>, Vec<f64>)> {
    let m = used.len();
    let scale: Vec<f64> = used.iter().map(|&k| total[(k, k)].max(1e-300).sqrt().recip()).collect();
    let mut a = DMatrix::zeros(m, m);
    let mut y = DVector::zeros(m);
    for i in 0..m {
        for j in 0..m {
            a[(i, j)] = total[(used[i], used[j])] * scale[i] * scale[j];
        }
        // A whisper of ridge: two columns that the data cannot tell apart share, instead of cancelling.
        a[(i, i)] += 1e-10;
        y[i] = right[used[i]] * scale[i];
    }
    let mut out = DVector::zeros(right.len());
    let chol = a.cholesky()?;
    let b = chol.solve(&y);
    let inverse = chol.inverse();
    for i in 0..m {
        out[used[i]] = b[i] * scale[i];
    }
    Some((out, (0..m).map(|i| inverse[(i, i)] * scale[i] * scale[i]).collect()))
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
}
