//! Time stamps that are not even: put on a grid, or cut.

use super::Logged;
use super::fault::{Action, FaultKind};
use super::statistics::{changes, median};
use super::work::{Told, Work, stretches};

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

fn resample(work: &mut Work<'_>, times_s: &[f64], (first, last, period_s): (f64, f64, f64), gap_s: f64) {
    let n = ((last - first) / period_s).round() as usize + 1;
    let grid: Vec<f64> = (0..n).map(|i| (first + i as f64 * period_s).min(last)).collect();
    let before: Vec<usize> =
        grid.iter().map(|t| times_s.partition_point(|s| s <= t).clamp(1, times_s.len() - 1) - 1).collect();
    for column in &mut work.recording.columns {
        let x = &column.values;
        let at = |(t, &i): (&f64, &usize)| {
            let part = (t - times_s[i]) / (times_s[i + 1] - times_s[i]);
            x[i] + part.clamp(0.0, 1.0) * (x[i + 1] - x[i])
        };
        column.values = grid.iter().zip(&before).map(at).collect();
    }
    work.usable = before.iter().map(|&i| times_s[i + 1] - times_s[i] <= gap_s).collect();
    work.times_s = grid;
}
