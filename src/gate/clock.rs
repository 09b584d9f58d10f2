//! Columns whose clocks differ: a force, a speed or another position earlier or later than the motion.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::motion::{Motion, travel};
use super::rows::same_unit;
use super::statistics::{mean, smooth};
use super::work::{Told, Work};
use crate::signal::inner_products::dot;

/// Rows between -3 dB of [`smooth`] and the rate: 0.26 / f_c.
const SMOOTH_ROWS: f64 = 0.26;
/// What a drive is held against: a constant, dry friction, a damper, inertia, a spring; and friction, damper,
/// inertia and spring of another position, if any.
type Row = [f64; 9];

/// Tells delays of speeds, and moves a position or a drive column that no physics delays so.
pub(super) fn offsets(work: &mut Work<'_>, axis: &AxisColumns) {
    position_offset(work, axis);
    // A moving average is late by itself, and that is told.
    let judged = |i: &usize| !work.silent[*i] && !work.has(*i, FaultKind::Smoothed);
    let speeds: Vec<usize> = axis.with(Role::Speed).filter(judged).collect();
    for speed in speeds {
        speed_offset(work, axis, speed);
    }
    let drives: Vec<usize> = axis.with(Role::Drive).filter(|i| !work.silent[*i]).collect();
    for drive in drives {
        if let Some(rows) = drive_offset(work, axis, drive) {
            put_right(work, drive, rows, "the motion it makes");
        }
    }
}

/// Delay of a logged speed against the travel: b(t) = k a(t - tau), by least squares of b on a and a'.
fn speed_offset(work: &mut Work<'_>, axis: &AxisColumns, speed: usize) {
    let position = axis.with(Role::Position).find(|p| !work.silent[*p] && same_unit(work, *p, speed));
    let Some(position) = position else { return };
    let half = half_width(work, work.criteria.slow_hz);
    let a = smooth(&travel(work.values(position), 1, work.period_s()), half);
    let b = smooth(work.values(speed), half);
    let rows: Vec<usize> =
        (2 * half + 2..a.len().saturating_sub(2 * half + 2)).filter(|i| work.usable[*i]).collect();
    let slope = |i: usize| 0.5 * (a[i + 1] - a[i - 1]);
    let (mut aa, mut ad, mut dd, mut ba, mut bd, mut bb) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for &i in &rows {
        let d = slope(i);
        aa += a[i] * a[i];
        ad += a[i] * d;
        dd += d * d;
        ba += b[i] * a[i];
        bd += b[i] * d;
        bb += b[i] * b[i];
    }
    let determinant = aa * dd - ad * ad;
    if determinant <= 0.0 || bb <= 0.0 {
        return;
    }
    let (k, s) = ((ba * dd - bd * ad) / determinant, (bd * aa - ba * ad) / determinant);
    let delay = -s / k;
    let (left, before) = (bb - k * ba - s * bd, bb - ba * ba / aa);
    let c = work.criteria;
    let seen = left < (1.0 - c.delay_gain) * before && ba * ba > c.scale_correlation.powi(2) * aa * bb;
    let most = c.delay_span_s / work.period_s();
    if !seen || delay.abs() <= c.speed_delay_rows || delay.abs() > most.max(3.0) {
        return;
    }
    let name = work.name(speed);
    let statement = format!(
        "{name} is {:.2} ms {} than the travel of {} ({:.1} rows).",
        1e3 * delay.abs() * work.period_s(),
        if delay > 0.0 { "later" } else { "earlier" },
        work.name(position),
        delay.abs()
    );
    work.tell(Told {
        column: &name,
        kind: FaultKind::ClockOffset,
        action: Action::Tell,
        rows: &[],
        statement,
    });
}

/// Moves one of two positions that is later than the other by more than encoders are: the one with which the
/// drive fits worse, or else the one that does not stand for the axis.
///
/// Delay: where b(t + tau) = k a(t) leaves least, both the speeds of the slow band; far less than a screw
/// that winds up under the drive leaves, b = k a - (F' - m a'') / K, K positive where the later one is the
/// stage. Checked by: friction_behind_a_screw_that_winds_up_has_no_clock.
fn position_offset(work: &mut Work<'_>, axis: &AxisColumns) {
    let positions: Vec<usize> = axis.with(Role::Position).filter(|p| !work.silent[*p]).collect();
    let (Some(first), [_, _]) = (axis.position(&work.recording), positions.as_slice()) else { return };
    let Some(second) = positions.into_iter().find(|p| *p != first) else { return };
    let (c, dt) = (*work.criteria, work.period_s());
    // A spring between them is late, too, near its resonance.
    let half = half_width(work, c.slow_hz / 3.0);
    let [a, b] = [first, second].map(|p| smooth(&travel(work.values(p), 1, dt), half));
    let stride = work.rows_in(5e-4);
    let span = work.rows_in(c.delay_span_s).next_multiple_of(stride);
    let edge = span + 2 * half + 2;
    let usable = |i: &usize| work.usable[i - half..i + half].iter().all(|u| *u);
    let places: Vec<usize> =
        (edge..a.len().saturating_sub(edge)).step_by(half.max(1)).filter(usable).collect();
    // Shares of b's power that a does not tell.
    let left = |rows: isize| {
        let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
        for i in &places {
            let (a, b) = (a[*i], b[i.saturating_add_signed(rows)]);
            aa += a * a;
            ab += a * b;
            bb += b * b;
        }
        1.0 - ab * ab / (aa * bb).max(f64::MIN_POSITIVE)
    };
    let count = (span / stride) as isize;
    let all: Vec<f64> = (-count..=count).map(|k| left(k * stride as isize)).collect();
    let Some((rows, least)) = lowest(&all).map(|(at, least)| ((at - count as f64) * stride as f64, least))
    else {
        return;
    };
    let drive = axis.with(Role::Drive).find(|i| !work.silent[*i]);
    let untold = || {
        let Some(drive) = drive else { return all[count as usize] };
        let derivative = |x: &[f64]| travel(x, 1, dt);
        let force = derivative(&smooth(work.values(drive), half));
        let inertia = derivative(&derivative(&a));
        let at_places = |x: &[f64]| places.iter().map(|i| x[*i]).collect::<Vec<f64>>();
        let mut columns = [&a, &inertia, &force].map(|x| at_places(x));
        orthonormal(&mut columns);
        let b = at_places(&b);
        let [of_motion, of_inertia, of_force] = columns.map(|c| dot(&c, &b));
        let of_force = if of_force * rows < 0.0 { of_force } else { 0.0 };
        let told = of_motion.powi(2) + of_inertia.powi(2) + of_force.powi(2);
        1.0 - told / dot(&b, &b).max(f64::MIN_POSITIVE)
    };
    let is_late = rows.abs() * dt > c.late_s && rows.abs() > c.late_rows;
    // A clock tells all, a spring and its damper do not.
    if !is_late || least >= c.delay_gain * untold() {
        return;
    }
    let unexplained = |position: usize| {
        let motion = Motion::of_position(work, position);
        let balance = Balance::new(work, &motion, None, drive?, span)?;
        let Powers { all, left, .. } = balance.powers(0);
        Some(left / all)
    };
    let both = unexplained(first).zip(unexplained(second));
    let first_is_off = both.is_some_and(|(first, second)| first > second);
    let (column, other, rows) = if first_is_off { (first, second, -rows) } else { (second, first, rows) };
    let other = work.name(other);
    put_right(work, column, rows, &other);
}

/// Tells that a column is later than something, earlier below zero, and moves it.
fn put_right(work: &mut Work<'_>, column: usize, rows: f64, than: &str) {
    let name = work.name(column);
    let statement = format!(
        "{name} is {:.2} ms {} than {than}; it was moved in time.",
        1e3 * rows.abs() * work.period_s(),
        if rows > 0.0 { "later" } else { "earlier" }
    );
    work.tell(Told {
        column: &name,
        kind: FaultKind::ClockOffset,
        action: Action::Correct,
        rows: &[],
        statement,
    });
    move_by(work, column, rows);
}

/// Where a parabola through the least of these and its neighbours is lowest, and that least; `None`: at an
/// end.
fn lowest(of: &[f64]) -> Option<(f64, f64)> {
    let best = (0..of.len()).min_by(|a, b| of[*a].total_cmp(&of[*b]))?;
    let [l, m, r] = [*of.get(best.checked_sub(1)?)?, of[best], *of.get(best + 1)?];
    let bend = l - 2.0 * m + r;
    let part = if bend > 0.0 { (0.5 * (l - r) / bend).clamp(-0.5, 0.5) } else { 0.0 };
    Some((best as f64 + part, m))
}

/// Half width of the smoothing that leaves the slow band, rows.
fn half_width(work: &Work<'_>, cutoff_hz: f64) -> usize {
    let rate_hz = work.recording.sample_rate.hz();
    // Of a slow recording what its rate allows.
    let cutoff_hz = cutoff_hz.min(0.1 * rate_hz);
    (0.5 * (SMOOTH_ROWS * rate_hz / cutoff_hz - 1.0)).round().max(1.0) as usize
}

/// The drive against a [`Row`] of the motion, both in the slow band, at rows that move.
struct Balance {
    /// Orthonormal columns, one row each place.
    basis: Vec<Row>,
    places: Vec<usize>,
    /// Position and drive, smoothed.
    position: Vec<f64>,
    drive: Vec<f64>,
    /// Places that are independent.
    independent: f64,
}

impl Balance {
    /// `other`: another position of the axis. Behind a screw that winds up friction turns later than at the
    /// motor, and the force with it: what the stage tells of that is no clock.
    fn new(
        work: &Work<'_>,
        motion: &Motion,
        other: Option<usize>,
        drive: usize,
        span: usize,
    ) -> Option<Self> {
        let half = half_width(work, work.criteria.slow_hz);
        let dt = work.period_s();
        let x = smooth(work.values(motion.position), half);
        let v = travel(&x, 1, dt);
        let a = travel(&v, 1, dt);
        let edge = span + 3 * half + 2;
        let apart = half.max(1);
        let places: Vec<usize> = (edge..x.len().saturating_sub(edge))
            .step_by(apart)
            .filter(|i| !motion.rests(*i) && work.usable[i - half..i + half].iter().all(|u| *u))
            .collect();
        let at_places = |of: &dyn Fn(usize) -> f64| places.iter().map(|i| of(*i)).collect::<Vec<f64>>();
        // Beside a spring: moved by a quarter of its period its force is friction.
        let of_motion = |x: &[f64], v: &[f64], a: &[f64]| {
            [at_places(&|i| v[i].signum()), at_places(&|i| v[i]), at_places(&|i| a[i]), at_places(&|i| x[i])]
        };
        let mut columns = vec![at_places(&|_| 1.0)];
        columns.extend(of_motion(&x, &v, &a));
        if let Some(other) = other {
            let x = smooth(work.values(other), half);
            let v = travel(&x, 1, dt);
            columns.extend(of_motion(&x, &v, &travel(&v, 1, dt)));
        }
        columns.resize_with(Row::default().len(), || vec![0.0; places.len()]);
        orthonormal(&mut columns);
        let basis = (0..places.len()).map(|k| std::array::from_fn(|c| columns[c][k])).collect();
        let time_s = (places.len() * apart) as f64 * dt;
        let cutoff_hz = work.criteria.slow_hz.min(0.1 / dt);
        let independent = 2.0 * cutoff_hz * time_s;
        (independent > 40.0).then(|| Self {
            basis,
            places,
            position: x,
            drive: smooth(work.values(drive), half),
            independent,
        })
    }

    /// The drive, moved by `rows`, about its mean.
    fn drive_at(&self, rows: isize) -> Vec<f64> {
        let mut u: Vec<f64> = self.places.iter().map(|i| self.drive[i.saturating_add_signed(rows)]).collect();
        let middle = mean(&u);
        u.iter_mut().for_each(|u| *u -= middle);
        u
    }

    /// What a column has of each of the basis.
    fn on_basis(&self, column: &[f64]) -> Row {
        let mut on = Row::default();
        for (value, basis) in column.iter().zip(&self.basis) {
            for (sum, b) in on.iter_mut().zip(basis) {
                *sum += value * b;
            }
        }
        on
    }

    /// Power of the drive, of it that inertia explains, and that nothing does, moved by `rows`.
    fn powers(&self, rows: isize) -> Powers {
        let u = self.drive_at(rows);
        let on = self.on_basis(&u);
        let all = dot(&u, &u);
        let explained: f64 = on.iter().map(|c| c * c).sum();
        // A mass is positive: what a spring does has the other sign.
        Powers { all, inertia: on[3].max(0.0).powi(2), left: (all - explained).max(0.0) }
    }

    /// Least power that is left of the drive, as it is, beside a friction that turns after a way, as behind a
    /// screw that winds up: of ways from a tenth of the travel down, each half of the one before.
    fn left_beside_winding(&self) -> f64 {
        let u = self.drive_at(0);
        let left = self.powers(0).left;
        let seen = || self.places.iter().map(|i| self.position[*i]);
        let travel = seen().fold(f64::NEG_INFINITY, f64::max) - seen().fold(f64::INFINITY, f64::min);
        let of_way = |way: f64| {
            let (mut wound, mut last) = (0.0_f64, self.position[0]);
            let turned = self.position.iter().map(|x| {
                wound = (wound + x - last).clamp(-way, way);
                last = *x;
                wound / way
            });
            let turned: Vec<f64> = turned.collect();
            let mut column: Vec<f64> = self.places.iter().map(|i| turned[*i]).collect();
            let on = self.on_basis(&column);
            for (value, basis) in column.iter_mut().zip(&self.basis) {
                *value -= on.iter().zip(basis).map(|(on, b)| on * b).sum::<f64>();
            }
            dot(&u, &column).powi(2) / dot(&column, &column).max(f64::MIN_POSITIVE)
        };
        let ways = (0..12).map(|k| 0.1 * travel * 0.5_f64.powi(k)).filter(|way| *way > 0.0);
        left - ways.map(of_way).fold(0.0, f64::max)
    }
}

#[derive(Debug, Clone, Copy)]
struct Powers {
    all: f64,
    inertia: f64,
    left: f64,
}

/// Gram-Schmidt, in place; a column that depends on the ones before becomes zero.
fn orthonormal(columns: &mut [Vec<f64>]) {
    for k in 0..columns.len() {
        let (done, rest) = columns.split_at_mut(k);
        let own = &mut rest[0];
        let size: f64 = own.iter().map(|v| v * v).sum();
        for before in done.iter() {
            let on: f64 = own.iter().zip(before).map(|(a, b)| a * b).sum();
            own.iter_mut().zip(before).for_each(|(a, b)| *a -= on * b);
        }
        let left: f64 = own.iter().map(|v| v * v).sum();
        let times = if left > 1e-9 * size { left.sqrt().recip() } else { 0.0 };
        own.iter_mut().for_each(|v| *v *= times);
    }
}

/// Rows by which the drive is late (earlier: below 0), if no physics makes it so.
///
/// Where another position is recorded it has to say so as well: each of them alone may take the form in which
/// friction turns for a time.
fn drive_offset(work: &Work<'_>, axis: &AxisColumns, drive: usize) -> Option<f64> {
    let motion = Motion::of(work, axis)?;
    let other = axis.with(Role::Position).find(|p| *p != motion.position && !work.silent[*p]);
    let alone = offset_beside(work, &motion, None, drive)?;
    if other.is_some() {
        let both = offset_beside(work, &motion, other, drive)?;
        return (both.rows * alone.rows > 0.0).then_some(both.rows);
    }
    // Of one position a screw behind it makes friction late as well.
    let kept = 1.0 - work.criteria.delay_gain;
    let is_wound = alone.rows > 0.0 && alone.left > kept * alone.balance.left_beside_winding();
    (!is_wound).then_some(alone.rows)
}

/// Rows by which a drive is late, what is left of it there, and its balance.
struct Offset {
    rows: f64,
    left: f64,
    balance: Balance,
}

/// The same by the motion, and another position.
fn offset_beside(work: &Work<'_>, motion: &Motion, other: Option<usize>, drive: usize) -> Option<Offset> {
    let c = *work.criteria;
    let dt = work.period_s();
    let stride = work.rows_in(5e-4);
    let count = (c.delay_span_s / (stride as f64 * dt)).floor().max(3.0) as isize;
    let span = count as usize * stride;
    let balance = Balance::new(work, motion, other, drive, span)?;
    let at = |k: isize| balance.powers(k * stride as isize);
    let all: Vec<Powers> = (-count..=count).map(at).collect();
    let now = all[count as usize];
    let (at, m) = lowest(&all.iter().map(|p| p.left).collect::<Vec<_>>())?;
    let best = all[at.round() as usize];
    let rows = (at - count as f64) * stride as f64;
    let late_s = rows * dt;
    // Interval of the delay: where F of one number is below its quantile; zero must lie outside.
    let outside = now.left > m * (1.0 + c.delay_f / balance.independent);
    let gains = |share: f64| now.left - m > share * now.left && outside;
    let has_inertia = best.inertia >= c.delay_inertia * best.all;
    // Springs, mounts and forces over position lead as well, and a move takes a part of them. Where friction
    // is nearly all of the drive, as in a slow sweep, its turns tell the time of what is late, but not of
    // what is early: a force builds up before friction lets go.
    let seen = match (has_inertia, late_s > 0.0) {
        (true, true) => gains(c.delay_gain),
        (true, false) | (false, true) => gains(c.early_gain),
        (false, false) => false,
    };
    let physics = if late_s > 0.0 { late_s <= c.late_s || rows <= c.late_rows } else { -late_s <= c.early_s };
    if !seen || physics {
        return None;
    }
    Some(Offset { rows, left: m, balance })
}

/// u(t) becomes u(t + rows), between rows by a straight line; what the file does not hold is masked.
fn move_by(work: &mut Work<'_>, column: usize, rows: f64) {
    let n = work.rows();
    let x = work.values(column).to_vec();
    let last = (n - 1) as f64;
    let at = |i: usize| {
        let place = (i as f64 + rows).clamp(0.0, last);
        let k = (place.floor() as usize).min(n.saturating_sub(2));
        x[k] + (place - k as f64) * (x[k + 1] - x[k])
    };
    work.recording.columns[column].values = (0..n).map(at).collect();
    let lost = rows.abs().ceil() as usize;
    if rows > 0.0 { work.mask(n.saturating_sub(lost)..n) } else { work.mask(0..lost) }
}
