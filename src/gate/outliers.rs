//! Single rows far from their neighbours.

use super::columns::{AxisColumns, Role};
use super::criteria::Criteria;
use super::fault::{Action, FaultKind};
use super::statistics::{NORMAL, range};
use super::work::{Told, Work, stretches, times};
use crate::signal::sliding_median::sliding_median;
use std::ops::Range;

/// One or two rows; more is a signal.
const LONGEST: usize = 2;

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
        let local = sliding_median(&sizes, 100).into_iter().map(|d| NORMAL * d).collect();
        Self { index, from_median, local, range: range(x) }
    }

    /// True where the column moves with another that is far off.
    fn moves(&self, c: &Criteria, rows: &Range<usize>) -> bool {
        let own = 0.25 * c.outlier_range * self.range;
        rows.clone().any(|i| self.from_median[i].abs() > (0.5 * c.outlier_scales * self.local[i]).max(own))
    }
}

/// Masks single rows far off in one column alone, and bridges them.
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
        rows.retain(|r| {
            let inside = r.start >= 1 && r.end < x.len() && r.len() <= LONGEST;
            let size = r.clone().map(|i| d.from_median[i].abs()).fold(0.0, f64::max);
            inside
                && (x[r.end] - x[r.start - 1]).abs() < c.outlier_neighbours * size
                && !deviations.iter().any(|o| o.index != d.index && o.moves(&c, r))
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
