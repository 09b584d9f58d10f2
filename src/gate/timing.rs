//! Time stamps that are not even: put on a grid, or cut.

use super::Logged;
use super::fault::{Action, FaultKind};
use super::statistics::{changes, median};
use super::work::{Told, Work, stretches};
use crate::sample::Column;

/// Puts the rows on the even grid of the recording's rate, with straight lines between them.
pub(super) fn even(work: &mut Work<'_>, logged: &Logged) {
    let c = work.criteria;
    let steps = changes(&logged.times_s);
    let middle = median(&steps);
    if steps.is_empty() || middle <= 0.0 {
        return;
    }
    let off: Vec<bool> = steps.iter().map(|d| (d / middle - 1.0).abs() > c.time_jitter).collect();
    let jitter = off.iter().filter(|o| **o).count() as f64 / steps.len() as f64;
    let gap = |times: f64| steps.iter().filter(|d| **d > times * middle).count();
    let gaps = gap(c.time_gap[1]);
    if jitter < c.jittering_rows && gap(c.time_gap[0]) == 0 {
        return;
    }
    let Some((&first, &last)) = logged.times_s.first().zip(logged.times_s.last()) else { return };
    let missing_s: f64 = steps.iter().filter(|d| **d > c.time_gap[1] * middle).sum();
    let period_s = work.period_s();
    // Where more is missing than is there, the runs are recordings of their own.
    let action = if missing_s > 0.5 * (last - first) { Action::Refuse } else { Action::Correct };
    let spans = stretches(&off, 1);
    let rows: Vec<_> = spans.iter().map(|s| s.start + 1..s.end + 1).collect();
    let worst = steps.iter().fold(0.0_f64, |m, d| m.max((d / middle - 1.0).abs()));
    let what = match (action, gaps) {
        (Action::Refuse, _) => {
            format!("{missing_s:.3} s of {:.3} s are missing; give each run as a file", last - first)
        }
        (_, 0) => "put on an even grid".to_owned(),
        (_, n) => format!("put on an even grid, {missing_s:.4} s in {n} gaps left out"),
    };
    work.tell(Told {
        column: "t_s",
        kind: FaultKind::IrregularTime,
        action,
        rows: &rows,
        statement: format!(
            "t_s is uneven: {:.2} % of its steps are off the median of {middle:.4e} s, by up to \
             {:.0} %; {what}.",
            100.0 * jitter,
            100.0 * worst
        ),
    });
    if action == Action::Correct {
        resample(work, &logged.times_s, (first, last, period_s), c.time_gap[1] * middle);
    }
}

/// Sum of squares of the third differences: what a motion leaves little of.
fn roughness(x: &[f64]) -> f64 {
    x.windows(4).map(|w| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]).powi(2)).sum()
}

/// True for a column that is smooth from row to row: it tells when its rows were taken.
fn is_smooth(x: &[f64]) -> bool {
    /// Turns over changes: a sine of a sixtieth of the rate.
    const SMOOTH: f64 = 0.01;
    let changes: f64 = x.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum();
    let turns: f64 = x.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).powi(2)).sum();
    changes > 0.0 && turns < SMOOTH * changes
}

fn resample(work: &mut Work<'_>, times_s: &[f64], (first, last, period_s): (f64, f64, f64), gap_s: f64) {
    let n = ((last - first) / period_s).round() as usize + 1;
    let grid: Vec<f64> = (0..n).map(|i| (first + i as f64 * period_s).min(last)).collect();
    let before: Vec<usize> =
        grid.iter().map(|t| times_s.partition_point(|s| s <= t).clamp(1, times_s.len() - 1) - 1).collect();
    let evened = |column: &Column| -> Vec<f64> {
        let x = &column.values;
        let at = |(t, &i): (&f64, &usize)| {
            let part = (t - times_s[i]) / (times_s[i + 1] - times_s[i]);
            x[i] + part.clamp(0.0, 1.0) * (x[i + 1] - x[i])
        };
        grid.iter().zip(&before).map(at).collect()
    };
    let grids: Vec<Vec<f64>> = work.recording.columns.iter().map(evened).collect();
    // Stamps that were written unevenly of rows that were taken evenly: moved, a smooth column is rougher.
    let smooth = work.recording.columns.iter().zip(&grids).filter(|(c, _)| is_smooth(&c.values));
    let worse: Vec<bool> = smooth.map(|(c, even)| roughness(even) > roughness(&c.values)).collect();
    if n == work.recording.len() && 2 * worse.iter().filter(|w| **w).count() > worse.len() {
        work.times_s = grid;
        return;
    }
    for (column, even) in work.recording.columns.iter_mut().zip(grids) {
        column.values = even;
    }
    work.usable = before.iter().map(|&i| times_s[i + 1] - times_s[i] <= gap_s).collect();
    work.times_s = grid;
}
