//! What a reader must know, in sentences, and what may be said where the budget ended before the questions
//! did.
//!
//! Then what was found stands, what was not asked is named, no line of the force's column is told as a fault
//! that a law which was not asked might explain, and where nothing was found no number is told as wrong: each
//! may be bent by what was not asked.

use super::bank::candidates;
use super::case::{Case, Drives, Found};
use super::laws::Hypothesis;
use super::number::Number;
use super::numbers::{Absent, Beside};
use super::rest::{Rest, spans_s};
use super::state::State;
use crate::diagnosis::result::{
    Candidate, CandidateReason, ForceFault, ForceFaultKind, TimeSpans, Unexplained,
};
use crate::diagnosis::selection::Reach;
use crate::units::engineering;

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

/// What is left by the stated model and with all that was found.
pub(super) fn worse([stated_n, found_n]: [f64; 2]) -> String {
    let [stated_n, found_n] = [stated_n, found_n].map(|n| engineering(n, "N", 3));
    format!("With what was found {found_n} are left, with the stated model {stated_n}: it fits worse.")
}

/// Numbers that stay as they are stated and were fitted elsewhere.
pub(super) fn kept(numbers: &[Beside]) -> impl Iterator<Item = String> {
    numbers.iter().map(|c| {
        let [nominal, fitted] = [c.nominal, c.value.max(0.0)].map(|x| engineering(x, "1", 4));
        let deviations = (c.value - c.nominal).abs() / c.deviation;
        format!(
            "{} stays at {nominal} as stated: {fitted} fits better, by {deviations:.1} deviations.",
            c.key
        )
    })
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
    /// What is left above the noise.
    pub(super) fn unexplained(
        &self,
        state: &State,
        (left, is_left): (&Rest, bool),
        drives: &Drives,
    ) -> Option<Unexplained> {
        let time = (0..self.recordings.len())
            .map(|r| TimeSpans { recording: r, spans_s: spans_s(self.balance, state, r, left.band_hz) });
        let force_n = if left.force_n > left.floor_n { left.force_n } else { drives.left_n };
        is_left.then(|| Unexplained {
            port: left.port,
            bands_hz: vec![left.band_hz],
            time: time.collect(),
            force_n: force_n.min(drives.thrust_n),
            floor_n: left.floor_n,
        })
    }

    /// What takes part of the mismatch and is not asserted: `found` beside what is left, and what was asked
    /// last or dropped in the end.
    pub(super) fn candidates(&self, found: &[Found], asserted: bool) -> Vec<Candidate> {
        let stands = found.iter().map(|f| Candidate {
            effect: f.term.effect,
            port: f.term.port,
            evidence_nats: f.evidence_nats,
            level_nats: f.level_nats,
            reason: CandidateReason::StandsBeside,
        });
        let mut list: Vec<Candidate> = stands.filter(|_| !asserted).collect();
        let dropped = self.rounds.iter().filter(|r| r.accepted).filter_map(|r| r.fitted.first());
        let is_law = |h: &Hypothesis| !h.facts().is_number && h.law().fault(&[0.0; 2], 0).is_none();
        for (f, was_taken) in self
            .asked_in_vain()
            .iter()
            .map(|f| (f, false))
            .chain(dropped.map(|f| (f, true)))
            .filter(|(f, _)| is_law(&f.hypothesis))
        {
            let (effect, port) = (f.hypothesis.effect, f.hypothesis.port);
            let known = found.iter().any(|g| (g.term.effect, g.term.port) == (effect, port))
                || list.iter().any(|c| (c.effect, c.port) == (effect, port));
            if known || f.evidence_nats <= 0.0 {
                continue;
            }
            let reason = match (was_taken, f.at_bound) {
                (true, _) => CandidateReason::Undetermined,
                (_, true) => CandidateReason::AtBound,
                _ => CandidateReason::BelowLevel,
            };
            list.push(Candidate {
                effect,
                port,
                evidence_nats: f.evidence_nats,
                level_nats: f.level_nats,
                reason,
            });
        }
        list.sort_by(|a, b| b.evidence_nats.total_cmp(&a.evidence_nats));
        list
    }

    /// Numbers that are missed together, the recordings saying of none that it is the one.
    pub(super) fn undivided(&self, unsaid: &[Number], nats: Option<[f64; 2]>) -> Vec<Candidate> {
        let Some([evidence_nats, level_nats]) = nats else { return Vec::new() };
        let of = |n: &Number| {
            let port = Absent::port_of(self.balance, *n);
            Some(Candidate {
                effect: n.effect()?,
                port,
                evidence_nats,
                level_nats,
                reason: CandidateReason::Undivided,
            })
        };
        unsaid.iter().filter_map(of).collect()
    }

    /// What a reader must know, in sentences. `is_left`: what is left stands above its floor.
    pub(super) fn notes_of(
        &self,
        (left, drives): (&Rest, &Drives),
        is_left: bool,
        candidates: &[Candidate],
    ) -> Vec<String> {
        let mut notes = self.notes.clone();
        let names = |reason: CandidateReason| -> Vec<String> {
            let listed = candidates.iter().filter(|c| c.reason == reason);
            listed.map(|c| format!("{} at {}", c.effect, c.port)).collect()
        };
        let found = names(CandidateReason::StandsBeside);
        if !found.is_empty() {
            notes
                .push(format!("Candidates that take part of it and are not asserted: {}.", found.join(", ")));
        }
        let undivided = names(CandidateReason::Undivided);
        let of = |x: f64| engineering(x, "N", 4);
        match &undivided[..] {
            [] => {}
            [one] => {
                notes.push(format!("The model leaves out {one}: this motion misses it, and no size fits."))
            }
            several => {
                let names = several.join(" or ");
                notes.push(format!("Friction is left out, and this motion does not say which: {names}."));
            }
        }
        if drives.left_n > drives.thrust_n {
            notes.push(
                "No numbers of the balance leave less than the whole thrust: nothing is told of this axis."
                    .to_owned(),
            );
        } else if is_left && left.force_n > left.floor_n {
            notes.push(format!(
                "{} stay above a floor of {}, at the {}, up to {:.1} Hz.",
                of(left.force_n),
                of(left.floor_n),
                left.port.name(),
                left.band_hz[1]
            ));
        } else if is_left && undivided.is_empty() {
            let beside = if drives.beside_loads_n < drives.thrust_n { " beside loads" } else { "" };
            notes.push(format!(
                "{} of a thrust of {}{beside} are left: the model says less than half of what drives this \
                 axis.",
                of(drives.judged_n),
                of(drives.beside_loads_n)
            ));
        }
        notes
    }
}
