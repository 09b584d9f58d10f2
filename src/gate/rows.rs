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
    /// From this row on the so many before it stand there once more.
    Doubled(usize),
    /// So many rows are missing before this one.
    Missing(usize),
    /// This row repeats the one before, and the next makes up for it.
    Late,
}

/// Takes doubled rows out and puts missing ones in, bridged and masked: then the time is right again.
pub(super) fn whole(work: &mut Work<'_>, axis: &AxisColumns) {
    let positions: Vec<usize> = axis.with(Role::Position).filter(|p| !work.silent[*p]).collect();
    let Some(position) = axis.position(&work.recording).filter(|p| positions.contains(p)) else { return };
    let mut found = places(work, position);
    // A row is one of all columns: what another encoder travels must say the same.
    let others: Vec<usize> = positions.into_iter().filter(|p| *p != position).collect();
    found.retain(|(row, place)| others.iter().all(|other| agrees(work, *other, *row - 1, *place)));
    if found.is_empty() {
        return;
    }
    let name = work.name(position);
    let count = |p: &Place| if let Place::Doubled(count) = p { *count } else { 1 };
    let mut say = |kind, what: &str, is: &dyn Fn(Place) -> bool| {
        let of = found.iter().filter(|(_, p)| is(*p));
        let rows: Vec<Range<usize>> = of.map(|(i, p)| *i..i + count(p)).collect();
        if rows.is_empty() {
            return;
        }
        let statement = format!("{name}: {what} {}.", times(rows.len()));
        work.tell(Told { column: &name, kind, action: Action::Mask, rows: &rows, statement });
    };
    say(FaultKind::Doubled, "rows stand there twice,", &|p| matches!(p, Place::Doubled(_)));
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
        let Expected { travel: m, scatter: s, beside } = expected(&d, i);
        if m.abs() <= (c.travel_over_scatter * s).max(least) || (d[i] - m).abs() <= c.row_over_scatter * s {
            continue;
        }
        let ratio = d[i] / m;
        let count = ratio.round();
        // Over rows that are missing the axis may have accelerated, but it went on.
        let most = beside[0].abs().max(beside[1].abs()) * (1.0 + c.whole_travel);
        let is_whole = (ratio - count).abs() < c.whole_travel;
        let goes_on = like(d[i - 1], beside[0]) && like(d[i + 1], beside[1]) && beside[0] * beside[1] > 0.0;
        if count >= 2.0 && is_whole && d[i].abs() > most && goes_on {
            found.push((i + 1, Place::Missing(count as usize - 1)));
            continue;
        }
        if !like(d[i - 1], m) {
            continue;
        }
        let again = (1.0 - count).max(0.0) as usize;
        let repeats = |again: usize| {
            let before = (i + 1).checked_sub(again).and_then(|from| x.get(from..=i));
            before.is_some() && before == x.get(i + 1..=i + again)
        };
        if ratio.abs() < c.whole_travel && like(d[i + 1], m) {
            found.push((i + 1, Place::Doubled(1)));
        } else if again > 1 && is_whole && repeats(again) {
            found.push((i + 1, Place::Doubled(again)));
        } else if ratio.abs() < c.whole_travel && like(0.5 * d[i + 1], m) {
            found.push((i + 1, Place::Late));
        }
    }
    found
}

/// False where the travel of another position to that row is rather that of a single row.
fn agrees(work: &Work<'_>, other: usize, i: usize, place: Place) -> bool {
    let d = changes(&work.values(other)[i - NEIGHBOURS..=i + 1 + NEIGHBOURS]);
    let Expected { travel, .. } = expected(&d, NEIGHBOURS);
    let rows = match place {
        Place::Doubled(count) => 1.0 - count as f64,
        Place::Missing(count) => 1.0 + count as f64,
        Place::Late => 0.0,
    };
    let (single, told) = (d[NEIGHBOURS] - travel, d[NEIGHBOURS] - rows * travel);
    told.abs() <= single.abs()
}

/// Travel that a row should have by its neighbours, how they scatter, and what each side alone says.
struct Expected {
    travel: f64,
    scatter: f64,
    beside: [f64; 2],
}

/// The neighbours may accelerate: each side is a line, and between them the travel is the mean of both.
fn expected(d: &[f64], i: usize) -> Expected {
    let side = |at: &dyn Fn(usize) -> f64| {
        let slope = median(&(1..NEIGHBOURS).map(|k| at(k) - at(k + 1)).collect::<Vec<f64>>());
        let levels: Vec<f64> = (1..=NEIGHBOURS).map(|k| at(k) + (k - 1) as f64 * slope).collect();
        let level = median(&levels);
        (level, levels.iter().map(|l| l - level).collect::<Vec<f64>>())
    };
    let ((before, mut off), (after, more)) = (side(&|k| d[i - k]), side(&|k| d[i + k]));
    off.extend(more);
    Expected { travel: 0.5 * (before + after), scatter: scale(&off), beside: [before, after] }
}

fn mend(work: &mut Work<'_>, found: &[(usize, Place)]) {
    let n = work.rows();
    // For each row of the mended recording the row of the file that it is, or between which two it lies.
    let mut from: Vec<(usize, f64, bool)> = Vec::with_capacity(n + found.len());
    let mut next = found.iter().peekable();
    // Up to here rows stand there once more.
    let mut until = 0;
    for i in 0..n {
        let place = next.next_if(|(row, _)| *row == i).map(|(_, p)| *p);
        match place {
            None if i < until => {}
            Some(Place::Doubled(count)) => until = i + count,
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
