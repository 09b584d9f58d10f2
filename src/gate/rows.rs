//! Rows that are there twice or not at all, by the travel of the axis.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::statistics::{changes, median, scale};
use super::work::{Told, Work, times};
use crate::signal::sliding_median::sliding_median;
use std::ops::Range;

/// Neighbours on each side whose travel says what a row's should be.
const NEIGHBOURS: usize = 5;

/// What the travel to one row says of the rows about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    /// This row repeats the one before.
    Doubled,
    /// So many rows are missing before this one.
    Missing(usize),
    /// This row repeats the one before, and the next makes up for it.
    Late,
}

/// Takes doubled rows out and puts missing ones in, bridged and masked: then the time is right again.
pub(super) fn whole(work: &mut Work<'_>, axis: &AxisColumns) {
    let positions: Vec<usize> = axis.with(Role::Position).filter(|p| !work.silent[*p]).collect();
    let Some(position) = axis.position(&work.recording).filter(|p| positions.contains(p)) else { return };
    let found = places(work, position);
    if found.is_empty() {
        return;
    }
    let name = work.name(position);
    let mut say = |kind, what: &str, is: &dyn Fn(Place) -> bool| {
        let rows: Vec<Range<usize>> = found.iter().filter(|(_, p)| is(*p)).map(|(i, _)| *i..i + 1).collect();
        if rows.is_empty() {
            return;
        }
        let statement = format!("{name}: {what} {}.", times(rows.len()));
        work.tell(Told { column: &name, kind, action: Action::Mask, rows: &rows, statement });
    };
    say(FaultKind::Doubled, "a row stands there twice,", &|p| p == Place::Doubled);
    say(FaultKind::Dropped, "rows are missing, by the travel,", &|p| matches!(p, Place::Missing(_)));
    say(FaultKind::Held, "a row is late and repeats the one before,", &|p| p == Place::Late);
    mend(work, &found);
}

/// Where the travel of one row is none or a multiple of its neighbours'.
fn places(work: &Work<'_>, position: usize) -> Vec<(usize, Place)> {
    let c = work.criteria;
    let x = work.values(position);
    let d = changes(x);
    let least = c.travel_over_step * work.resolution(position);
    let like = |a: f64, b: f64| (a / b - 1.0).abs() < c.whole_travel;
    let mut found = Vec::new();
    for i in NEIGHBOURS..d.len().saturating_sub(NEIGHBOURS) {
        // Almost every row is as its neighbours: asked first, because it is cheap.
        if like(d[i], d[i - 1]) || d[i] == 0.0 && d[i - 1] == 0.0 {
            continue;
        }
        let Expected { travel: m, scatter: s } = expected(&d, i);
        if m.abs() <= (c.travel_over_scatter * s).max(least) || (d[i] - m).abs() <= c.row_over_scatter * s {
            continue;
        }
        let ratio = d[i] / m;
        let count = ratio.round();
        if !like(d[i - 1], m) {
            continue;
        }
        if ratio.abs() < c.whole_travel && like(d[i + 1], m) {
            found.push((i + 1, Place::Doubled));
        } else if ratio.abs() < c.whole_travel && like(0.5 * d[i + 1], m) {
            found.push((i + 1, Place::Late));
        } else if count >= 2.0 && (ratio - count).abs() < c.whole_travel && like(d[i + 1], m) {
            found.push((i + 1, Place::Missing(count as usize - 1)));
        }
    }
    found
}

/// Travel that a row should have by its neighbours, and how they scatter.
struct Expected {
    travel: f64,
    scatter: f64,
}

/// The neighbours may accelerate: their slope is the median of those of the pairs to both sides.
fn expected(d: &[f64], i: usize) -> Expected {
    let pairs = 1..=NEIGHBOURS;
    let slopes: Vec<f64> = pairs.clone().map(|k| (d[i + k] - d[i - k]) / (2 * k) as f64).collect();
    let slope = median(&slopes);
    let level: Vec<f64> =
        pairs.flat_map(|k| [d[i - k] + k as f64 * slope, d[i + k] - k as f64 * slope]).collect();
    Expected { travel: median(&level), scatter: scale(&level) }
}

fn mend(work: &mut Work<'_>, found: &[(usize, Place)]) {
    let n = work.rows();
    // For each row of the mended recording the row of the file that it is, or between which two it lies.
    let mut from: Vec<(usize, f64, bool)> = Vec::with_capacity(n + found.len());
    let mut next = found.iter().peekable();
    for i in 0..n {
        let place = next.next_if(|(row, _)| *row == i).map(|(_, p)| *p);
        match place {
            Some(Place::Doubled) => continue,
            Some(Place::Late) => from.push((i - 1, 0.5, false)),
            Some(Place::Missing(count)) => {
                let part = |k: usize| k as f64 / (count + 1) as f64;
                from.extend((1..=count).map(|k| (i - 1, part(k), false)));
                from.push((i, 0.0, work.usable[i]));
            }
            None => from.push((i, 0.0, work.usable[i])),
        }
    }
    // A late row lies between the one before and the one behind it.
    let behind = |i: usize, late: bool| (i + if late { 2 } else { 1 }).min(n - 1);
    let is_late = |i: usize| {
        found.binary_search_by_key(&(i + 1), |(row, _)| *row).is_ok_and(|k| found[k].1 == Place::Late)
    };
    for column in &mut work.recording.columns {
        let x = &column.values;
        let at = |&(i, part, _): &(usize, f64, bool)| {
            if part == 0.0 { x[i] } else { x[i] + part * (x[behind(i, is_late(i))] - x[i]) }
        };
        column.values = from.iter().map(at).collect();
    }
    work.times_s = from.iter().map(|f| work.times_s[f.0]).collect();
    work.usable = from.iter().map(|f| f.2).collect();
}

/// A position that jumps where its logged velocity allows no such travel: rows are missing there, however
/// many.
///
/// e_i = dx_i - dt (v_i + v_{i+1}) / 2
pub(super) fn jumps(work: &mut Work<'_>, axis: &AxisColumns) {
    let Some(position) = axis.position(&work.recording).filter(|p| !work.silent[*p]) else { return };
    let velocity = axis.with(Role::Speed).find(|v| !work.silent[*v] && same_unit(work, position, *v));
    let Some(velocity) = velocity else { return };
    let [steps, of_speed, of_itself, scatters, local] = work.criteria.jump_against_velocity;
    let (x, v, dt) = (work.values(position), work.values(velocity), work.period_s());
    let e: Vec<f64> = (0..x.len() - 1).map(|i| x[i + 1] - x[i] - 0.5 * dt * (v[i] + v[i + 1])).collect();
    let largest = changes(v).iter().fold(0.0_f64, |m, d| m.max(d.abs()));
    let sizes: Vec<f64> = e.iter().map(|e| e.abs()).collect();
    let (usual, around) = (scale(&e), sliding_median(&sizes, 20));
    let fixed = steps * work.step(position) + of_speed * dt * largest + scatters * usual;
    let limit = |i: usize| fixed + of_itself * dt * v[i].abs().max(v[i + 1].abs()) + local * around[i];
    let jump = |i: usize| sizes[i] > limit(i);
    // There and back is an outlier, and no jump.
    let back = |i: usize, j: usize| e.get(j).is_some_and(|other| (e[i] + other).abs() < 0.2 * sizes[i]);
    let found: Vec<usize> =
        (0..e.len()).filter(|&i| jump(i) && !back(i, i + 1) && !(i > 0 && back(i, i - 1))).collect();
    if found.is_empty() || found.len() as f64 > work.criteria.jumping_rows * x.len() as f64 {
        return;
    }
    let worst = found.iter().copied().max_by(|a, b| sizes[*a].total_cmp(&sizes[*b])).unwrap_or(0);
    let allowed = dt * v[worst].abs().max(v[worst + 1].abs());
    let name = work.name(position);
    let statement = format!(
        "{name}: rows are missing at {} places; it jumps by up to {:.3e} where its velocity \
         allows {allowed:.3e}.",
        found.len(),
        (x[worst + 1] - x[worst]).abs()
    );
    let rows: Vec<Range<usize>> = found.iter().map(|i| i + 1..i + 2).collect();
    rows.iter().for_each(|r| work.mask(r.clone()));
    work.tell(Told { column: &name, kind: FaultKind::Dropped, action: Action::Mask, rows: &rows, statement });
}

/// True where a speed is the derivative of that position by its unit.
pub(super) fn same_unit(work: &Work<'_>, position: usize, speed: usize) -> bool {
    let (position, speed) = (work.name(position), work.name(speed));
    let of = |name: &str, word: &str| name.contains(word);
    let side = of(&position, "motor") == of(&speed, "motor") || !of(&speed, "motor") && !of(&speed, "stage");
    let unit = position.ends_with("_m") && speed.ends_with("_m_s")
        || position.ends_with("_rad") && (speed.ends_with("_rad_s") || speed.ends_with("_rpm"));
    side && unit
}
