//! Columns that say nothing, and axes that hardly ever move.

use super::columns::{AxisColumns, Role};
use super::fault::{Action, FaultKind};
use super::motion::Motion;
use super::work::{Told, Work, stretches};

/// A measured column with one value: refused if it is the drive's only one, or the only position.
pub(super) fn empty(work: &mut Work<'_>, axis: &AxisColumns) {
    let found: Vec<_> = axis
        .measured()
        .filter(|c| {
            let x = work.values(c.index);
            x.iter().all(|v| *v == x[0])
        })
        .collect();
    for column in &found {
        work.silent[column.index] = true;
    }
    for column in &found {
        let alone = axis.with(column.role).all(|i| work.silent[i]);
        let needed = matches!(column.role, Role::Drive | Role::Position);
        let value = work.values(column.index)[0];
        work.tell(Told {
            column: &work.name(column.index),
            kind: FaultKind::Empty,
            action: if alone && needed { Action::Refuse } else { Action::Tell },
            rows: &[],
            statement: format!("{} is always {value}: it was not recorded.", work.name(column.index)),
        });
    }
}

/// More than half of the rows at rest: there a force below friction says nothing, and enters no fit.
pub(super) fn long_rest(work: &mut Work<'_>, axis: &AxisColumns) {
    let Some(motion) = Motion::of(work, axis) else { return };
    let rests: Vec<bool> = (0..work.rows()).map(|i| motion.rests(i)).collect();
    let share = rests.iter().filter(|r| **r).count() as f64 / work.rows().max(1) as f64;
    if share <= work.criteria.rest_share {
        return;
    }
    let spans: Vec<_> =
        stretches(&rests, motion.reach).into_iter().filter(|s| s.len() > 4 * motion.reach).collect();
    for span in &spans {
        // Where the axis stops and starts friction turns, which says something.
        let (from, to) = (span.start + motion.reach, span.end - motion.reach);
        work.mask(from..to);
    }
    let name = work.name(motion.position);
    work.tell(Told {
        column: &name,
        kind: FaultKind::LongRest,
        action: Action::Mask,
        rows: &spans,
        statement: format!(
            "{name} rests in {:.0} % of the rows; a force below friction says nothing there.",
            100.0 * share
        ),
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gate::{Criteria, Gated, Logged, check};
    use crate::sample::{Column, Recording};
    use crate::units::SampleRate;

    const RATE_HZ: f64 = 1000.0;

    /// An axis that swings for `moving_s` of ten seconds and then stands, under a force that never does.
    fn checked(moving_s: f64, force: impl Fn(f64) -> f64) -> Gated {
        let at =
            |f: &dyn Fn(f64) -> f64| (0..10_000).map(|k| f(f64::from(k) / RATE_HZ)).collect::<Vec<f64>>();
        let swing = |t: f64| 0.02 * (3.0 * t.min(moving_s)).sin();
        let column = |name: &str, values| Column { name: name.into(), values };
        let recording = Recording {
            sample_rate: SampleRate::new(RATE_HZ).unwrap(),
            experiment: "rest".into(),
            axes: vec!["x".into()],
            columns: vec![column("x_thrust_ref_n", at(&force)), column("x_motor_position_m", at(&swing))],
            start_s: 0.0,
            metadata: Vec::new(),
        };
        check(&Logged::even(recording), &["x".into()], &Criteria::default())
    }

    fn told(gated: &Gated) -> Vec<(FaultKind, Action)> {
        gated.faults.iter().map(|f| (f.kind, f.action)).collect()
    }

    #[test]
    fn most_of_a_recording_at_rest_is_masked_and_where_it_stops_is_kept() {
        let force = |t: f64| 40.0 * (3.0 * t).cos() + (37.0 * t).sin();
        let gated = checked(3.0, force);
        assert_eq!(told(&gated), [(FaultKind::LongRest, Action::Mask)]);
        let masked = gated.masked();
        let rows = |from_s: f64, to_s: f64| &masked[(from_s * RATE_HZ) as usize..(to_s * RATE_HZ) as usize];
        assert!(rows(0.0, 3.0).iter().all(|m| !m), "it moves");
        assert!(!masked[3002], "friction turns where it stops");
        assert!(rows(3.1, 9.9).iter().all(|m| *m), "it stands");
        // Less than half of it at rest is ordinary.
        assert_eq!(told(&checked(7.0, force)), []);
    }

    #[test]
    fn a_drive_that_is_always_the_same_is_refused() {
        let gated = checked(10.0, |_| 0.0);
        assert_eq!(told(&gated), [(FaultKind::Empty, Action::Refuse)]);
    }
}
