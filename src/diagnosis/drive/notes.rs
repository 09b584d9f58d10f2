//! What a reader must know, in sentences, and what may be said where the budget ended before the questions
//! did.
//!
//! Then what was found stands, what was not asked is named, no line of the force's column is told as a fault
//! that a law which was not asked might explain, and where nothing was found no number is told as wrong: each
//! may be bent by what was not asked.

use super::bank::candidates;
use super::case::{Case, Found};
use super::laws::Hypothesis;
use super::rest::Rest;
use super::words::engineering;
use crate::diagnosis::result::{ForceFault, ForceFaultKind};
use crate::diagnosis::selection::Reach;

/// Faults of the force's column that may be told, and notes on the rest.
pub(super) fn budget(
    case: &Case<'_>,
    faults: Vec<ForceFault>,
    nothing_found: bool,
) -> (Vec<ForceFault>, Vec<String>) {
    if !case.out_of_budget {
        return (faults, Vec::new());
    }
    let names = not_asked(case);
    let what =
        if names.is_empty() { "what is left beside what was found".to_owned() } else { names.join(", ") };
    let mut notes = vec![format!("The budget ended before every hypothesis was asked. Not asked: {what}.")];
    if nothing_found {
        notes.push("Nothing found is therefore no proof that nothing is missing.".to_owned());
    }
    let of = |fault: &ForceFault| match fault.kind {
        ForceFaultKind::MainsLine { frequency_hz, .. } => format!(
            "{} carries a line at {frequency_hz:.2} Hz: the mains, or a law that was not asked.",
            fault.column
        ),
        ForceFaultKind::ClockOffset { late_s } => format!(
            "{} seems {:.3} ms later than the motion it makes, or a law that was not asked is at work.",
            fault.column,
            1e3 * late_s
        ),
    };
    let mut doubtful: Vec<String> = faults.iter().map(of).collect();
    doubtful.dedup();
    notes.extend(doubtful);
    (Vec::new(), notes)
}

/// What nobody asked: all of the bank where no round was complete, else what promised to be worth a fit in
/// the last round and got none.
fn not_asked(case: &Case<'_>) -> Vec<String> {
    let name = |h: &Hypothesis| format!("{} at {}", h.effect, h.port);
    let mut names: Vec<String> = match case.rounds.last() {
        None => candidates(case.balance, case.start).iter().map(name).collect(),
        Some(round) => {
            let fitted: Vec<String> = round.fitted.iter().map(|f| name(&f.hypothesis)).collect();
            let promised = round.screened.iter().take(Reach::default().fitted);
            promised.map(|s| name(&s.hypothesis)).filter(|n| !fitted.contains(n)).collect()
        }
    };
    let mut seen = Vec::new();
    names.retain(|n| {
        let new = !seen.contains(n);
        seen.push(n.clone());
        new
    });
    names
}

impl Case<'_> {
    /// What a reader must know, in sentences. `is_left`: what is left stands above its floor.
    /// `[left_n, thrust_n]`: all that is left, white or not, and the thrust.
    pub(super) fn notes_of(
        &self,
        (left, [left_n, thrust_n]): (&Rest, [f64; 2]),
        (is_left, unexplained): (bool, bool),
        found: &[Found],
    ) -> Vec<String> {
        let mut notes = self.notes.clone();
        if unexplained && !found.is_empty() {
            let names: Vec<String> =
                found.iter().map(|f| format!("{} at {}", f.term.effect, f.term.port)).collect();
            notes
                .push(format!("Candidates that take part of it and are not asserted: {}.", names.join(", ")));
        }
        let of = |x: f64| engineering(x, "N");
        if is_left && left.force_n > left.floor_n {
            notes.push(format!(
                "{} stay above a floor of {}, at the {}, up to {:.1} Hz.",
                of(left.force_n),
                of(left.floor_n),
                left.port.name(),
                left.band_hz[1]
            ));
        } else if is_left {
            notes.push(format!(
                "{} of a thrust of {} are left: the model says less than half of what drives this axis.",
                of(left_n),
                of(thrust_n)
            ));
        }
        notes
    }
}
