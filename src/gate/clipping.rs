//! Columns that stand at their limit.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::statistics::{changes, median, runs};
use super::work::{Told, Work, stretches};
use std::ops::Range;

/// Masks the rows at the largest and the smallest value where too many are there. Not positions: they dwell
/// at their ends.
pub(super) fn clipped(work: &mut Work<'_>, axis: &AxisColumns) {
    let columns: Vec<usize> = axis
        .measured()
        .filter(|c| c.role != Role::Position && !work.silent[c.index])
        .map(|c| c.index)
        .collect();
    for column in columns {
        let x = work.values(column);
        let mut at_limit = vec![false; x.len()];
        for sign in [1.0, -1.0] {
            let turned: Vec<f64> = x.iter().map(|v| sign * v).collect();
            if let Some(limit) = limit(work, column, &turned) {
                at_limit.iter_mut().zip(&turned).filter(|(_, v)| **v == limit).for_each(|(a, _)| *a = true);
            }
        }
        let rows: Vec<Range<usize>> = stretches(&at_limit, 0);
        if rows.is_empty() {
            continue;
        }
        rows.iter().for_each(|r| work.mask(r.clone()));
        let count: usize = rows.iter().map(Range::len).sum();
        let name = work.name(column);
        let statement = format!(
            "{name} stands at its limit in {:.2} % of the rows.",
            100.0 * count as f64 / work.rows() as f64
        );
        work.tell(Told {
            column: &name,
            kind: FaultKind::Clipped,
            action: Action::Mask,
            rows: &rows,
            statement,
        });
    }
}

/// The largest value, if the column stands there.
fn limit(work: &Work<'_>, column: usize, x: &[f64]) -> Option<f64> {
    const INWARDS: f64 = 5.0;
    let c = work.criteria;
    let top = x.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if top == 0.0 {
        return None;
    }
    let k = work.updates[column].max(1);
    let at_top = x.iter().filter(|v| **v == top).count();
    if at_top < c.clipped_rows * k || different(x, c.least_values) < c.least_values {
        return None;
    }
    // What changes by more than a step from row to row stands nowhere on its way inwards.
    let per_row = median(&changes(x).iter().map(|d| d.abs()).collect::<Vec<_>>());
    let width = work.step(column).max(per_row);
    let inwards = x.iter().filter(|v| **v < top && **v >= top - (INWARDS + 0.5) * width).count();
    let flat = runs(x, c.flat_top_rows * k).iter().any(|r| x[r.first] == top);
    (flat && at_top as f64 > c.clipped_over_inwards * (inwards as f64 / INWARDS)).then_some(top)
}

/// Different values, counted up to `most`.
fn different(x: &[f64], most: usize) -> usize {
    let mut seen: Vec<f64> = Vec::with_capacity(most);
    for v in x {
        if seen.len() >= most {
            break;
        }
        if !seen.contains(v) {
            seen.push(*v);
        }
    }
    seen.len()
}
