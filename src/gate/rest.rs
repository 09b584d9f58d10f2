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
