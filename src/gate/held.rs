//! Values that are repeated while the axis moves.

use super::columns::{AxisColumn, AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::motion::Motion;
use super::rows::same_unit;
use super::statistics::{Run, changes, median, percentile, runs};
use super::work::{Told, Work, times};
use std::collections::BTreeMap;
use std::ops::Range;

/// A run of equal values of one column, and what it says.
#[derive(Debug, Clone, Copy)]
struct Hold {
    column: AxisColumn,
    run: Run,
    /// Decades of improbability, were the column alive.
    surprise: f64,
    /// A position that jumps behind it as far as was due.
    jumps: bool,
}

/// Masks what is held and draws a straight line over it.
pub(super) fn held(work: &mut Work<'_>, axis: &AxisColumns) {
    let mut holds: Vec<Hold> = Vec::new();
    for column in axis.measured().filter(|c| !work.silent[c.index]) {
        match column.role {
            Role::Position => holds.extend(of_position(work, axis, column)),
            _ => holds.extend(of_noisy(work, axis, column)),
        }
    }
    let motion = Motion::of(work, axis);
    let mut by_column: BTreeMap<usize, Vec<Run>> = BTreeMap::new();
    for together in groups(holds) {
        let surprise: f64 = together.iter().map(|h| h.surprise).sum();
        if surprise < work.surprise() {
            continue;
        }
        let begun = begun(work, axis, &together);
        if !begun.is_empty() || moves(work, (axis, motion.as_ref()), &together) {
            let held = together.iter().map(|h| (h.column.index, h.run));
            let runs = held.chain(begun.into_iter().map(|index| (index, together[0].run)));
            runs.for_each(|(index, run)| by_column.entry(index).or_default().push(run));
        }
    }
    for (column, runs) in by_column {
        // The first of the equal values was measured.
        let rows: Vec<Range<usize>> = runs.iter().map(|r| r.first + 1..r.end()).collect();
        for r in &rows {
            work.mask(r.clone());
            work.bridge(column, r.clone());
        }
        let longest = runs.iter().map(|r| r.rows).max().unwrap_or(0);
        let name = work.name(column);
        let statement = format!(
            "{name} repeats its last value {} while the axis moves, for up to {:.4} s.",
            times(runs.len()),
            longest as f64 * work.period_s()
        );
        work.tell(Told {
            column: &name,
            kind: FaultKind::Held,
            action: Action::Mask,
            rows: &rows,
            statement,
        });
    }
}

/// Holds of the same rows, give or take one: a logger that stands holds all of its columns.
fn groups(mut holds: Vec<Hold>) -> Vec<Vec<Hold>> {
    holds.sort_by_key(|h| (h.run.first, h.run.rows, h.column.index));
    let mut out: Vec<Vec<Hold>> = Vec::new();
    for hold in holds {
        let same = |g: &&mut Vec<Hold>| {
            let first = g[0].run;
            hold.run.first.abs_diff(first.first) <= 1
                && hold.run.end().abs_diff(first.end()) <= 1
                && g.iter().all(|h| h.column.index != hold.column.index)
        };
        match out.iter_mut().rev().take(8).find(same) {
            Some(group) => group.push(hold),
            None => out.push(vec![hold]),
        }
    }
    out
}

/// Runs of a position: so many steps were due while it stood.
///
/// S = n / ln 10 (Poisson), n q = (L - 1) min(|v_b|, |v_a|); where a motion turned, began or ended meanwhile
/// the jump behind it
fn of_position(work: &Work<'_>, axis: &AxisColumns, column: AxisColumn) -> Vec<Hold> {
    const AROUND: usize = 5;
    let c = work.criteria;
    let x = work.values(column.index);
    let q = work.resolution(column.index);
    let mut out = Vec::new();
    let all = runs(x, c.hold_rows);
    // One hold after another: what moves is beside both. An axis that rests here and there has a live force.
    let stands = |run: &Run| {
        let mut drives = axis.with(Role::Drive).filter(|i| !work.silent[*i]);
        drives.all(|i| work.values(i)[run.first + 1..run.end()].windows(2).all(|w| w[0] == w[1]))
    };
    let follows = |k: usize| all[k].end() == all[k + 1].first && stands(&all[k]) && stands(&all[k + 1]);
    for (k, run) in all.iter().copied().enumerate() {
        let before = (0..k).rev().take(AROUND).take_while(|j| follows(*j)).last().unwrap_or(k);
        let after = (k..all.len() - 1).take(AROUND).take_while(|j| follows(*j)).last().map_or(k, |j| j + 1);
        let (from, to) = (all[before].first, all[after].end());
        if from < AROUND || to + AROUND >= x.len() {
            continue;
        }
        let end = run.end();
        let of = |rows: Range<usize>| rows.map(|i| x[i + 1] - x[i]).collect::<Vec<f64>>();
        let (before, after) = (of(from - AROUND..from), of(to..to + AROUND));
        let (v_b, v_a) = (median(&before), median(&after));
        // Of a motion that is no steady one the slower part: a vibration stands at its ends.
        let quarter = |d: &[f64]| percentile(&d.iter().map(|d| d.abs()).collect::<Vec<_>>(), 0.25);
        let slow = quarter(&before).min(quarter(&after));
        if q <= 0.0 {
            continue;
        }
        let rows = (run.rows - 1) as f64;
        let jump = (x[end] - x[end - 1]).abs();
        let neighbour = before.iter().chain(&after).fold(0.0_f64, |m, d| m.max(d.abs()));
        let [due, least] = if v_b * v_a > 0.0 && slow > 0.0 {
            [rows * slow, c.jump_share * rows * slow]
        } else {
            [jump, c.jump_over_neighbours * neighbour]
        };
        let jumps = jump >= least && neighbour > 0.0;
        if jumps || slow > 0.0 {
            let missed = if jumps { due } else { rows * slow };
            out.push(Hold { column, run, surprise: missed / q / std::f64::consts::LN_10, jumps });
        }
    }
    out
}

/// Runs of a force or a speed: it repeats itself as often as it does beside them. A controller that sees an
/// encoder travel evenly repeats itself, too: over such rows as often as it does over all of them.
///
/// S = sum -log10 p over the rows behind the first, the least over the encoders
fn of_noisy(work: &Work<'_>, axis: &AxisColumns, column: AxisColumn) -> Vec<Hold> {
    let c = work.criteria;
    let x = work.values(column.index);
    let long: Vec<Run> = runs(x, c.hold_rows.max(2 * work.updates[column.index]));
    if long.is_empty() {
        return Vec::new();
    }
    let encoders: Vec<Vec<bool>> = axis.with(Role::Position).map(|p| travels_evenly(work, p)).collect();
    let everywhere: Vec<Repeats> = encoders.iter().map(|even| Repeats::of(x, 0..x.len(), even)).collect();
    let all = vec![true; x.len()];
    let hold = |run: Run| {
        // At a limit it stands for another reason.
        if !work.usable[run.first] || stands_by_itself(x, run, work.resolution(column.index), c.hold_rows) {
            return None;
        }
        let from = run.first.saturating_sub(c.neighbours);
        let to = (run.end() + c.neighbours).min(x.len());
        // From its first repeat on.
        let own = run.first.saturating_sub(1)..run.end();
        let beside = Repeats::of(x, from..to, &all).without(Repeats::of(x, own.clone(), &all));
        let of = |(even, everywhere): (&Vec<bool>, &Repeats)| {
            let own = Repeats::of(x, own.clone(), even);
            everywhere.without(own).surprise(own.repeats) + beside.surprise(run.rows - 1 - own.repeats)
        };
        let by_itself = beside.surprise(run.rows - 1);
        let surprise = encoders.iter().zip(&everywhere).map(of).fold(by_itself, f64::min);
        Some(Hold { column, run, surprise, jumps: false })
    };
    long.into_iter().filter_map(hold).collect()
}

/// How often a column repeats itself, and how often once more.
#[derive(Debug, Clone, Copy, Default)]
struct Repeats {
    rows: usize,
    repeats: usize,
    /// Of those rows that follow a repeat.
    behind: usize,
    again: usize,
}

impl Repeats {
    /// Over those of the rows that count.
    fn of(x: &[f64], rows: Range<usize>, counts: &[bool]) -> Self {
        let mut all = Self::default();
        for i in rows.skip(2).filter(|i| counts[*i]) {
            let (repeats, behind) = (x[i] == x[i - 1], x[i - 1] == x[i - 2]);
            all.rows += 1;
            all.repeats += usize::from(repeats);
            all.behind += usize::from(behind);
            all.again += usize::from(repeats && behind);
        }
        all
    }

    fn without(self, own: Self) -> Self {
        Self {
            rows: self.rows - own.rows,
            repeats: self.repeats - own.repeats,
            behind: self.behind - own.behind,
            again: self.again - own.again,
        }
    }

    /// Decades of improbability of a run of so many repeats.
    fn surprise(self, run: usize) -> f64 {
        let first = (self.repeats as f64 + 1.0) / (self.rows as f64 + 2.0);
        let next = (self.again as f64 + first) / (self.behind as f64 + 1.0);
        if run == 0 { 0.0 } else { -first.log10() - (run - 1) as f64 * next.log10() }
    }
}

/// Rows over which an encoder goes on as far as over the row before or to the next one.
fn travels_evenly(work: &Work<'_>, position: usize) -> Vec<bool> {
    let x = work.values(position);
    let (travel, q) = (changes(x), work.step(position));
    let same =
        |i: usize| travel.get(i).is_some_and(|to| to.abs() > 0.5 * q && (to - travel[i - 1]).abs() < 0.5 * q);
    (0..x.len()).map(|i| i > 1 && (same(i - 1) || same(i))).collect()
}

/// True where a column comes to its value or leaves it by one step, since a coarse encoder moves its
/// controller now and then; and where the parabola through its neighbours stays at the value to a step: so
/// does a smooth column where a motion turns round.
fn stands_by_itself(x: &[f64], run: Run, q: f64, around: usize) -> bool {
    let one_step = |i: usize| x.get(i).is_none_or(|other| (other - x[run.first]).abs() < 1.5 * q);
    if one_step(run.first.wrapping_sub(1)) || one_step(run.end()) {
        return true;
    }
    let (Some(from), to) = (run.first.checked_sub(around), run.end() + around) else { return true };
    let Some(beside) = x.get(from..to) else { return true };
    let half = 0.5 * (beside.len() - 1) as f64;
    let at = |i: usize| (i as f64 - half) / half;
    let outside = (0..beside.len()).filter(|i| *i < around || *i >= around + run.rows);
    // Normal equations of 1 and t^2, t alone: the places lie symmetrically.
    let (mut n, mut t2, mut t4, mut y, mut ty, mut t2y) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for i in outside {
        let (t, v) = (at(i), beside[i] - x[run.first]);
        n += 1.0;
        t2 += t * t;
        t4 += t.powi(4);
        y += v;
        ty += t * v;
        t2y += t * t * v;
    }
    let determinant = n * t4 - t2 * t2;
    let level = (y * t4 - t2y * t2) / determinant;
    let (slope, bend) = (ty / t2, (t2y * n - t2 * y) / determinant);
    let parabola = |t: f64| level + slope * t + bend * t * t;
    (around..around + run.rows).all(|i| parabola(at(i)).abs() <= 1.5 * q)
}

/// Positions that stood through a hold of the other columns, from a rest that had begun before it, and jump
/// behind it: a motion began or ended in it.
fn begun(work: &Work<'_>, axis: &AxisColumns, together: &[Hold]) -> Vec<usize> {
    let run = together[0].run;
    let held = |i: usize| together.iter().any(|h| h.column.index == i);
    let jumps = |i: &usize| {
        let x = work.values(*i);
        let Some(beside) = x.get(run.first..run.end() + 3) else { return false };
        let change = |k: usize| (beside[k + 1] - beside[k]).abs();
        // It goes on from there: the next two changes, of which one may be none on a coarse step.
        let neighbour = change(run.rows).max(change(run.rows + 1));
        let jump = change(run.rows - 1);
        beside[..run.rows].windows(2).all(|w| w[0] == w[1])
            && jump > work.criteria.jump_over_neighbours * neighbour
            && jump > work.criteria.update_steps * work.step(*i)
    };
    axis.with(Role::Position).filter(|i| !work.silent[*i] && !held(*i)).filter(jumps).collect()
}

/// Proof that the axis moved meanwhile; without it, it rested.
fn moves(work: &Work<'_>, (axis, motion): (&AxisColumns, Option<&Motion>), together: &[Hold]) -> bool {
    let c = work.criteria;
    let run = together[0].run;
    if together.iter().any(|h| h.jumps && !speed_rests(work, axis, together, h)) {
        return true;
    }
    let held = |i: usize| together.iter().any(|h| h.column.index == i);
    let speeds = |i: usize| together.iter().any(|h| h.column.index == i && h.column.role == Role::Speed);
    let live = |role| axis.with(role).filter(|i| !work.silent[*i] && !held(*i));
    let travels = live(Role::Position).any(|i| {
        let x = work.values(i);
        let end = run.end().min(x.len() - 1);
        let own = Motion::of_position(work, i);
        (x[end] - x[run.first]).abs() > c.update_steps * work.step(i)
            && (run.first..end).all(|row| !own.rests(row))
    });
    if travels {
        // A coarse speed that the travel confirms is alive.
        let coarse = |h: &Hold| h.column.role == Role::Speed && confirmed(work, motion, h);
        return !together.iter().all(coarse);
    }
    // A position that stands under a speed that does not.
    together.iter().any(|h| h.column.role == Role::Position)
        && live(Role::Speed).filter(|i| !speeds(*i)).any(|i| {
            let v = work.values(i);
            let sizes: Vec<f64> = v[run.first..run.end()].iter().map(|v| v.abs()).collect();
            let all: Vec<f64> = v.iter().map(|v| v.abs()).collect();
            median(&sizes) > 0.1 * percentile(&all, 0.99)
        })
}

/// True where the logged speed of that position is none while it stands: then rows are missing behind it.
fn speed_rests(work: &Work<'_>, axis: &AxisColumns, together: &[Hold], position: &Hold) -> bool {
    let held = |i: usize| together.iter().any(|h| h.column.index == i);
    let own = |i: &usize| !work.silent[*i] && !held(*i) && same_unit(work, position.column.index, *i);
    axis.with(Role::Speed).filter(own).any(|i| {
        let v: Vec<f64> = work.values(i).iter().map(|v| v.abs()).collect();
        let run = position.run;
        median(&v[run.first..run.end()]) <= work.criteria.rest_speed * percentile(&v, 0.99)
    })
}

/// True where the travel stays as it was before, to a step of the speed.
fn confirmed(work: &Work<'_>, motion: Option<&Motion>, hold: &Hold) -> bool {
    let Some(motion) = motion else { return false };
    let speed = &motion.speed[hold.run.first..hold.run.end()];
    let [low, high] =
        speed.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |e, v| [e[0].min(*v), e[1].max(*v)]);
    let v = work.values(hold.column.index);
    // In units of the speed's own column, whatever its scale.
    let (mut top, mut bottom) = (0.0, 0.0);
    for (a, b) in v.iter().zip(&motion.speed) {
        top += a * b;
        bottom += b * b;
    }
    let times = if bottom > 0.0 { top / bottom } else { return false };
    (high - low) * times.abs() <= 2.0 * work.step(hold.column.index)
}
