//! Columns whose step is as large as what they should show.

use super::columns::AxisColumns;
use super::fault::{Action, FaultKind};
use super::motion::Motion;
use super::statistics::{digits, percentile};
use super::work::{Told, Work};

/// Over this long a column should have changed by more than its step, s.
const WITHIN_S: f64 = 1e-3;

/// Tells a step whose rounding, q^2 / 12, is a large part of the power of the changes of a moving axis.
pub(super) fn rounded(work: &mut Work<'_>, axis: &AxisColumns) {
    let motion = Motion::of(work, axis);
    let columns: Vec<_> = axis.measured().filter(|c| !work.silent[c.index]).collect();
    for column in columns {
        let x = work.values(column.index);
        let q = work.step(column.index);
        let few = digits(x, q, work.criteria.digits);
        let of_digits = |d: i32| {
            let sizes: Vec<f64> = x.iter().map(|v| v.abs()).filter(|v| *v > 0.0).collect();
            10f64.powi(percentile(&sizes, 0.5).log10().floor() as i32 - d + 1)
        };
        let size = few.map_or(q, of_digits);
        let reach = work.rows_in(WITHIN_S).max(work.updates[column.index]);
        let moving = |i: usize| motion.as_ref().is_none_or(|m| !m.rests(i));
        let changes: Vec<f64> =
            (reach..x.len()).filter(|i| moving(*i)).map(|i| (x[i] - x[i - reach]).powi(2)).collect();
        if changes.len() < work.criteria.rate_changes {
            continue;
        }
        // Motion comes in bursts, of which the larger ones count.
        let power = percentile(&changes, 0.9);
        let share = size * size / 12.0 / power.max(f64::MIN_POSITIVE);
        if few.is_none() && (q <= 0.0 || share < work.criteria.rounding_share) {
            continue;
        }
        let name = work.name(column.index);
        let statement = match few {
            Some(d) => format!(
                "{name} is rounded to {d} significant digits, a step of {size:.2e} at its usual size."
            ),
            None if power <= 0.0 => {
                format!("{name} has a step of {q:.3e}: most of its changes are less than that.")
            }
            None => format!(
                "{name} has a step of {q:.3e}: rounding is {:.0} % of the power of its changes \
                 within {:.1} ms.",
                100.0 * share.min(1.0),
                1e3 * reach as f64 * work.period_s()
            ),
        };
        work.tell(Told {
            column: &name,
            kind: FaultKind::Rounded,
            action: Action::Tell,
            rows: &[],
            statement,
        });
    }
}
