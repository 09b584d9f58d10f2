//! Magnitudes in place of signed values, a force that drives against its motion, columns in each other's
//! place.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::motion::Motion;
use super::scaling::ratio;
use super::statistics::{changes, deviation, median, percentile};
use super::work::{Told, Work, stretches};

/// A drive column without one of the signs that folds at zero while the axis moves both ways.
///
/// What was folded meets zero in the form of a V. A pull that cannot push stays flat at zero, and a weight
/// never comes near it. A load that comes on an axis that stands pushes it off its place one way, and all the
/// while the drive takes it up in steps from near zero; a fold comes in motion of both directions.
pub(super) fn rectified(work: &mut Work<'_>, axis: &AxisColumns) {
    let Some(motion) = Motion::of(work, axis) else { return };
    if motion.both_ways().iter().any(|share| *share < work.criteria.both_ways) {
        return;
    }
    for column in drives(work, axis) {
        if !is_folded(work, column, &motion) {
            continue;
        }
        let name = work.name(column);
        let statement = format!(
            "{name} is a magnitude, not a signed value: it folds at zero while the axis moves both ways."
        );
        let alone = axis.with(Role::Drive).filter(|i| !work.silent[*i]).count() == 1;
        let named = ["current_ref_a", "torque_ref_nm", "thrust_ref_n"].iter().any(|n| name.ends_with(n));
        let action = if alone || named { Action::Refuse } else { Action::Tell };
        work.tell(Told { column: &name, kind: FaultKind::Rectified, action, rows: &[], statement });
    }
}

fn drives(work: &Work<'_>, axis: &AxisColumns) -> Vec<usize> {
    axis.with(Role::Drive).filter(|i| !work.silent[*i]).collect()
}

fn is_folded(work: &Work<'_>, column: usize, motion: &Motion) -> bool {
    /// Rows beside a touch whose slope says how long it should be.
    const BESIDE: usize = 3;
    let c = work.criteria;
    let x = work.values(column);
    let (mut up, mut down) = (0_usize, 0_usize);
    x.iter().for_each(|v| {
        if *v > 0.0 {
            up += 1
        } else if *v < 0.0 {
            down += 1
        }
    });
    if up.min(down) as f64 > c.other_sign * x.len() as f64 {
        return false;
    }
    let u: Vec<f64> = x.iter().map(|v| v.abs()).collect();
    let full = percentile(&u, 0.99);
    let [near, close] = c.touch.map(|t| t * full);
    let low: Vec<bool> = u.iter().map(|v| *v < near).collect();
    let touches: Vec<_> =
        stretches(&low, 0).into_iter().filter(|t| t.start > BESIDE && t.end + BESIDE < u.len()).collect();
    let pointed = touches.iter().filter(|t| {
        // The slopes of both sides, taken from where it is well above the touch.
        let falls = (u[t.start - BESIDE] - u[t.start]) / BESIDE as f64;
        let rises = (u[t.end - 1 + BESIDE] - u[t.end - 1]) / BESIDE as f64;
        if falls <= 0.0 || rises <= 0.0 {
            return false;
        }
        let due = near / falls + near / rises;
        t.len() as f64 <= (c.touch_rows * due).max(1.0)
    });
    let pointed: Vec<_> = pointed.collect();
    let reaches = |t: &&&std::ops::Range<usize>| u[(**t).clone()].iter().any(|v| *v <= close);
    let goes =
        |t: &&std::ops::Range<usize>, way: f64| way * motion.speed[(t.start + t.end) / 2] > motion.rest;
    let one_way = [1.0, -1.0].into_iter().any(|way| pointed.iter().all(|t| goes(t, way)));
    let enough = pointed.len() >= 3 && !one_way || pointed.iter().any(|t| reaches(&t));
    enough && pointed.len() as f64 >= c.touch_share * touches.len() as f64
}

/// A position is smoother than the force that makes it: the one that stands for the axis, or another that
/// does not go with it.
pub(super) fn swapped(work: &mut Work<'_>, axis: &AxisColumns) {
    let Some(first) = axis.position(&work.recording).filter(|p| !work.silent[*p]) else { return };
    let goes_along = |p: usize| ratio(work.values(first), work.values(p)).correlation.abs();
    let apart = |p: &usize| *p == first || goes_along(*p) < work.criteria.scale_correlation;
    let live = axis.with(Role::Position).filter(|p| !work.silent[*p]);
    let positions: Vec<usize> = live.filter(apart).filter(|p| goes_anywhere(work, *p)).collect();
    let of = |x: &[f64], by: &[f64]| deviation(by) / deviation(x).max(f64::MIN_POSITIVE);
    for drive in drives(work, axis) {
        let x = work.values(drive);
        let rough = of(x, &changes(x)).max(f64::MIN_POSITIVE);
        let over = |p: usize| of(work.values(p), &without_jumps(work.values(p))) / rough;
        let Some(position) = positions.iter().copied().find(|p| over(*p) > work.criteria.roughness) else {
            continue;
        };
        let (name, other) = (work.name(drive), work.name(position));
        let statement = format!(
            "{name} and {other} look swapped: {other} changes {:.0} times as roughly as the force that \
             should make it.",
            over(position)
        );
        work.tell(Told {
            column: &name,
            kind: FaultKind::Swapped,
            action: Action::Refuse,
            rows: &[],
            statement,
        });
    }
}

/// Changes from row to row of a series without rows that jump out of it and back: those are a fault of their
/// own, and a step that stays is none.
fn without_jumps(x: &[f64]) -> Vec<f64> {
    let middle = |w: &[f64]| w[0].max(w[1]).min(w[0].min(w[1]).max(w[2]));
    changes(&x.windows(3).map(middle).collect::<Vec<f64>>())
}

/// False for an axis that is held still and shows its noise: that is rough, too.
fn goes_anywhere(work: &Work<'_>, position: usize) -> bool {
    const STEPS: f64 = 100.0;
    let x = work.values(position);
    super::statistics::range(x) > STEPS * work.step(position)
}

/// Two positions of one axis that run against one another: one counts the other way round, the one against
/// which the drive works. Where friction does not say which the pair stays as it is, and is refused later.
pub(super) fn opposite_encoder(work: &mut Work<'_>, axis: &AxisColumns) {
    let positions: Vec<usize> = axis.with(Role::Position).filter(|p| !work.silent[*p]).collect();
    let [first, second] = positions[..] else { return };
    // Of the places: speeds of the two ends of a spring are opposite above its resonance as well.
    let [a, b] = [first, second].map(|p| work.kept(work.values(p)));
    let Some(drive) = drives(work, axis).into_iter().next() else { return };
    if ratio(&a, &b).correlation > -work.criteria.scale_correlation {
        return;
    }
    for (turned, other) in [(first, second), (second, first)] {
        let motion = Motion::of_position(work, turned);
        if drives_against(work, drive, &motion).is_some() {
            let (name, other) = (work.name(turned), work.name(other));
            let statement = format!("{name} counts against {other} and the drive; its sign was turned.");
            return turn(work, turned, &name, statement);
        }
    }
}

/// An axis with friction takes power and gives none.
pub(super) fn wrong_sign(work: &mut Work<'_>, axis: &AxisColumns) {
    let Some(motion) = Motion::of(work, axis) else { return };
    for column in drives(work, axis) {
        let against = drives_against(work, column, &motion);
        let Some(share) = against.filter(|_| !work.has(column, FaultKind::Rectified)) else { continue };
        let name = work.name(column);
        let percent = 50.0 * (1.0 - share);
        let statement = format!(
            "{name} drives against the motion: {percent:.0} % of its power is taken from the axis; its sign \
             was turned."
        );
        turn(work, column, &name, statement);
    }
}

/// The share of a drive's power that the motion takes, where it goes both ways and gives too much of it.
fn drives_against(work: &Work<'_>, drive: usize, motion: &Motion) -> Option<f64> {
    let c = work.criteria;
    let goes_both_ways = motion.both_ways().iter().all(|share| *share >= c.sign_both_ways);
    let share = goes_both_ways.then(|| power_share(work, drive, motion))?;
    (share < c.against_motion).then_some(share)
}

/// Share of a drive's power that the motion takes, -1 to 1.
///
/// b = sum (u - u_0) v / sum |(u - u_0) v|, u_0: mean of the medians of both directions
fn power_share(work: &Work<'_>, drive: usize, motion: &Motion) -> f64 {
    let u = work.values(drive);
    let of = |way: f64| {
        let rows = u.iter().zip(&motion.speed).filter(|(_, v)| way * **v > motion.rest);
        median(&rows.map(|(u, _)| *u).collect::<Vec<_>>())
    };
    let offset = 0.5 * (of(1.0) + of(-1.0));
    let power = || u.iter().zip(&motion.speed).map(|(u, v)| (u - offset) * v);
    power().sum::<f64>() / power().map(f64::abs).sum::<f64>().max(f64::MIN_POSITIVE)
}

/// Turns a column's sign and tells it.
fn turn(work: &mut Work<'_>, column: usize, name: &str, statement: String) {
    work.recording.columns[column].values.iter_mut().for_each(|v| *v = -*v);
    let kind = FaultKind::WrongSign;
    work.tell(Told { column: name, kind, action: Action::Correct, rows: &[], statement });
}
