//! Single rows far from their neighbours, of which the other columns tell nothing.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::statistics::{NORMAL, median, range};
use super::work::{Told, Work, stretches, times};
use crate::signal::sliding_median::sliding_median;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// One or two rows; more is a signal.
const LONGEST: usize = 2;
/// Rows to both sides in which another column tells a deviation.
const BESIDE: usize = 2;

/// Distance of each row from the median of seven, and how far the rows about it are from theirs.
struct Deviation {
    index: usize,
    from_median: Vec<f64>,
    local: Vec<f64>,
    /// Of the whole column.
    range: f64,
}

impl Deviation {
    fn of(work: &Work<'_>, index: usize) -> Self {
        let x = work.values(index);
        let around = sliding_median(x, 3);
        let from_median: Vec<f64> = x.iter().zip(&around).map(|(a, b)| a - b).collect();
        let sizes: Vec<f64> = from_median.iter().map(|d| d.abs()).collect();
        let local =
            sliding_median(&sizes, work.criteria.neighbours).into_iter().map(|d| NORMAL * d).collect();
        Self { index, from_median, local, range: range(x) }
    }

    /// What its neighbours and the other columns do not tell of the first of these rows, and how much they
    /// usually do not tell; `None`: too few rows.
    ///
    /// Least squares over the rows about it, on the values before and behind such a stretch and on second
    /// differences of the others: a controller kicks where it sees a step of an encoder, a vibration goes on.
    fn untold(
        &self,
        (x, others): (&[f64], &[&[f64]]),
        rows: &Range<usize>,
        around: usize,
    ) -> Option<[f64; 2]> {
        let reach = BESIDE + 1;
        let from = rows.start.saturating_sub(around).max(reach);
        let to = (rows.end + around).min(x.len().saturating_sub(rows.len() + reach));
        let lags = 2 * BESIDE + 1;
        let second = |x: &[f64], i: usize| x[i + 1] - 2.0 * x[i] + x[i - 1];
        let middle = x[rows.start] - self.from_median[rows.start];
        let told_by = |i: usize, column: usize| match column {
            0 => 1.0,
            c if c <= reach => x[i - c] - middle,
            c if c <= 2 * reach => x[i + rows.len() - 1 + c - reach] - middle,
            c => {
                let (other, lag) = ((c - 1 - 2 * reach) / lags, (c - 1 - 2 * reach) % lags);
                second(others[other], i + lag - BESIDE)
            }
        };
        // Rows whose neighbours are not these.
        let clear = |i: &usize| *i + rows.len() + reach <= rows.start || *i >= rows.end + reach;
        let places: Vec<usize> = (from..to).filter(clear).collect();
        let columns = 1 + 2 * reach + others.len() * lags;
        if places.len() < 2 * columns || rows.start < reach || rows.end + reach > x.len() {
            return None;
        }
        let mut told = DMatrix::from_fn(places.len(), columns, |k, c| told_by(places[k], c));
        let scales: Vec<f64> = told.column_iter().map(|c| c.norm().max(f64::MIN_POSITIVE)).collect();
        told.column_iter_mut().zip(&scales).for_each(|(mut c, s)| c /= *s);
        let values = DVector::from_iterator(places.len(), places.iter().map(|i| x[*i] - middle));
        // Columns of one length: what depends on others is held by next to nothing.
        let normal = told.tr_mul(&told) + DMatrix::identity(columns, columns) * 1e-9;
        let by = normal.cholesky()?.solve(&told.tr_mul(&values));
        let left: Vec<f64> = (values - told * &by).iter().map(|l| l.abs()).collect();
        let own: f64 = (0..columns).map(|c| by[c] * told_by(rows.start, c) / scales[c]).sum();
        Some([(x[rows.start] - middle - own).abs(), NORMAL * median(&left)])
    }
}

/// Masks single rows that are far off what their neighbours and the other columns tell, and bridges them.
pub(super) fn outliers(work: &mut Work<'_>, axis: &AxisColumns) {
    let c = *work.criteria;
    // A tooth that enters makes a force of a row or two: sensors of force are left out.
    let judged = axis.measured().filter(|c| c.role != Role::Sensor && !work.silent[c.index]);
    let columns: Vec<usize> = judged.map(|c| c.index).collect();
    let deviations: Vec<Deviation> = columns.iter().map(|i| Deviation::of(work, *i)).collect();
    let mut found: Vec<(usize, Vec<Range<usize>>)> = Vec::new();
    for d in &deviations {
        let x = work.values(d.index);
        let least = c.outlier_range * d.range;
        if least <= 0.0 {
            continue;
        }
        let far: Vec<bool> = (0..x.len())
            .map(|i| d.from_median[i].abs() > least.max(c.outlier_scales * d.local[i]) && work.usable[i])
            .collect();
        let mut rows = stretches(&far, 0);
        let others: Vec<&[f64]> =
            columns.iter().filter(|i| **i != d.index).map(|i| work.values(*i)).collect();
        rows.retain(|r| {
            let inside = r.start >= 1 && r.end < x.len() && r.len() <= LONGEST;
            let size = r.clone().map(|i| d.from_median[i].abs()).fold(0.0, f64::max);
            inside && (x[r.end] - x[r.start - 1]).abs() < c.outlier_neighbours * size
        });
        rows.retain(|r| {
            let untold = d.untold((x, &others), r, c.neighbours);
            untold.is_none_or(|[own, usual]| own > least.max(c.outlier_scales * usual))
        });
        let count: usize = rows.iter().map(Range::len).sum();
        if count > 0 && count as f64 <= c.outlier_rows * x.len() as f64 {
            found.push((d.index, rows));
        }
    }
    for (column, rows) in found {
        for r in &rows {
            work.mask(r.clone());
            work.bridge(column, r.clone());
        }
        let name = work.name(column);
        let statement = format!("{name} is far off its neighbours {}, for a row or two.", times(rows.len()));
        work.tell(Told {
            column: &name,
            kind: FaultKind::Outlier,
            action: Action::Mask,
            rows: &rows,
            statement,
        });
    }
}
