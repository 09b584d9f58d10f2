//! Columns whose step is as large as what they should show.

use super::Gated;
use super::columns::{AxisColumns, Role};
use super::fault::{Action, Fault, FaultKind};
use super::motion::Motion;
use super::statistics::{deviation, digits, mean, percentile};
use super::work::{Told, Work, in_order};
use std::collections::BTreeMap;

/// Over this long a column should have changed by more than its step, s.
const WITHIN_S: f64 = 1e-3;

/// Tells a step whose rounding, q^2 / 12, is a large part of the power of the changes of a moving axis, or of
/// what two positions of it differ by.
pub(super) fn rounded(work: &mut Work<'_>, axis: &AxisColumns) {
    let stretches = stretches(work, axis);
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
        let stretch = stretches.iter().find(|(index, _)| *index == column.index).map(|(_, stretch)| *stretch);
        let of_stretch = stretch.map(|s| (q * q / 12.0 / (s * s).max(f64::MIN_POSITIVE), s));
        let of_stretch = of_stretch.filter(|(share, _)| *share >= work.criteria.rounding_share);
        if few.is_none() && (q <= 0.0 || share < work.criteria.rounding_share) && of_stretch.is_none() {
            continue;
        }
        let name = work.name(column.index);
        let statement = match few {
            None if share < work.criteria.rounding_share => {
                let (share, stretch) = of_stretch.unwrap_or_default();
                format!(
                    "{name} has a step of {q:.3e}: rounding is {:.0} % of the power of its distance from \
                     the other position, {stretch:.3e}.",
                    100.0 * share.min(1.0)
                )
            }
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

/// Tells positions whose step is twice the one that another recording of the machine has, or more: an encoder
/// has one, and the rest is the logger's. Recordings that are refused or averaged have another.
pub fn rounded_by_one(recordings: &mut [Gated], axes: &[String]) {
    let mut finest: BTreeMap<String, f64> = BTreeMap::new();
    let mut found: Vec<(usize, String, f64)> = Vec::new();
    let whole = |g: &Gated| g.refusal().is_none() && g.averaged[1] == 1;
    for (k, Gated { recording, steps, .. }) in recordings.iter().enumerate().filter(|(_, g)| whole(g)) {
        for column in axes.iter().flat_map(|axis| AxisColumns::of(recording, axis).columns) {
            let (name, step) = (&recording.columns[column.index].name, steps[column.index]);
            if column.role == Role::Position && step > 0.0 {
                finest.entry(name.clone()).and_modify(|f| *f = f.min(step)).or_insert(step);
                found.push((k, name.clone(), step));
            }
        }
    }
    for (k, column, step) in found {
        let Gated { recording, faults, .. } = &mut recordings[k];
        let finest = finest[&column];
        let told = faults.iter().any(|f| f.column == column && f.kind == FaultKind::Rounded);
        if (step / finest).round() < 2.0 || told {
            continue;
        }
        let statement =
            format!("{column} has a step of {step:.3e}, and of {finest:.3e} in another recording.");
        faults.push(Fault {
            column,
            kind: FaultKind::Rounded,
            time_s: Vec::new(),
            share: 1.0,
            action: Action::Tell,
            statement,
        });
        in_order(recording, faults);
    }
}

/// Of two positions what each is off the straight line that it makes of the other, in its own unit.
fn stretches(work: &Work<'_>, axis: &AxisColumns) -> Vec<(usize, f64)> {
    let positions: Vec<usize> = axis.with(Role::Position).filter(|p| !work.silent[*p]).collect();
    let [one, other] = positions[..] else { return Vec::new() };
    let off = |of: usize, by: usize| {
        let (x, y) = (work.values(of), work.values(by));
        let [x_mean, y_mean] = [x, y].map(mean);
        let (mut xy, mut yy) = (0.0, 0.0);
        for (x, y) in x.iter().zip(y) {
            xy += (x - x_mean) * (y - y_mean);
            yy += (y - y_mean).powi(2);
        }
        let slope = xy / yy;
        deviation(&x.iter().zip(y).map(|(x, y)| x - slope * y).collect::<Vec<_>>())
    };
    vec![(one, off(one, other)), (other, off(other, one))]
}
