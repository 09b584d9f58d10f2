//! What a column that is missing hides: what stands in its place may be wrong, so that nothing is charged to
//! the machine that may be its fault.

use super::super::result::Verdict;
use super::adequacy::left;
use super::fit::Problem;
use super::input::{Borne, CutRecording, MissingColumn};
use super::laws::Law;
use super::machine::Frame;
use super::observable::{Lent, Observed, Origin, OriginKind};
use super::result::{CutDiagnosis, NotIdentifiable};
use super::search::Model;
use crate::plant::cut_effects::Specification;

/// What a column that is missing may bear of this.
fn borne(kind: OriginKind) -> Option<Borne> {
    match kind {
        OriginKind::Calm | OriginKind::Followed => Some(Borne::Vibration),
        OriginKind::Means => Some(Borne::Means),
        OriginKind::Orders => Some(Borne::Orders),
        OriginKind::Angle | OriginKind::Table => None,
    }
}

/// True where an observable is foretold with the help of a column that its recording lacks.
fn rests_on_another(recordings: &[CutRecording], origin: Origin) -> bool {
    let recording = origin.recording.and_then(|k| recordings.get(k));
    let Some((recording, kind)) = recording.zip(borne(origin.kind)) else { return false };
    recording.missing.iter().any(|m| m.bears.contains(&kind))
}

/// True where something of these recordings is.
pub(crate) fn any(recordings: &[CutRecording], observables: &[Observed<'_>]) -> bool {
    observables.iter().any(|o| rests_on_another(recordings, o.origin()))
}

/// Leaves out, recording by recording, what rests on another column and does not fit the stated structure,
/// the worst first, until the rest does. Says which recordings. `fitted`: the stated structure.
///
/// Cost: a fit of the stated structure a recording.
pub(crate) fn leave_out(
    frame: &Frame,
    recordings: &[CutRecording],
    observables: &mut Vec<Observed<'_>>,
    fitted: &mut dyn FnMut(&Problem<'_>) -> Option<Model>,
) -> Vec<usize> {
    let mut out = Vec::new();
    for _ in 0..recordings.len() {
        let problem = Problem { frame, observables };
        let Some(model) = fitted(&problem) else { break };
        let excess = |k: usize| {
            let own = observables.iter().map(AsRef::as_ref).filter(|o| o.origin().recording == Some(k));
            let lent: Vec<Observed<'_>> = own.map(|o| Box::new(Lent(o)) as Observed<'_>).collect();
            let of = lent.iter().any(|o| rests_on_another(recordings, o.origin()));
            let left = of.then(|| left(&Problem { frame, observables: &lent }, &model.point)).flatten()?;
            Some((k, left.excess_nats))
        };
        let worst = (0..recordings.len()).filter_map(excess).max_by(|a, b| a.1.total_cmp(&b.1));
        let Some((worst, _)) = worst else { break };
        out.push(worst);
        observables
            .retain(|o| o.origin().recording != Some(worst) || !rests_on_another(recordings, o.origin()));
    }
    out
}

/// Columns that no recording has.
fn lacking(recordings: &[CutRecording]) -> Vec<MissingColumn> {
    let Some(first) = recordings.first() else { return Vec::new() };
    let everywhere = |m: &&MissingColumn| recordings.iter().all(|r| r.missing.contains(m));
    first.missing.iter().filter(everywhere).copied().collect()
}

/// Says what is missing and what was `left_out` for it, takes back what cannot be told, and lists that.
pub(crate) fn tell(
    recordings: &[CutRecording],
    left_out: &[usize],
    laws: &[Law],
    diagnosis: &mut CutDiagnosis,
) {
    for recording in left_out.iter().filter_map(|k| recordings.get(*k)) {
        diagnosis.notes.push(format!(
            "{}: what stands in for its missing columns does not fit; what rests on them was left out.",
            recording.experiment
        ));
    }
    for missing in recordings.iter().flat_map(|r| &r.missing) {
        let instead = missing.instead.map_or(String::new(), |i| format!("; {i} is used in its place"));
        let note = format!(
            "There is no column {}{instead}. Without it these cuts do not show {}.",
            missing.name, missing.hides
        );
        if !diagnosis.notes.contains(&note) {
            diagnosis.notes.push(note);
        }
    }
    for column in lacking(recordings) {
        for effect in column.effects {
            // What is stated already, or impossible with these tools, nobody asks for.
            let Some(specification) = Specification::of(*effect) else { continue };
            if !laws.iter().any(|l| l.kind() == Some(*effect)) {
                continue;
            }
            let why = format!(
                "there is no column {}, without which these cuts do not show {}",
                column.name, column.hides
            );
            diagnosis.not_identifiable.retain(|n| n.effect != *effect);
            diagnosis.not_identifiable.push(NotIdentifiable {
                effect: *effect,
                port: specification.port,
                why,
            });
        }
        take_back(&column, diagnosis);
    }
}

/// What was found and is hidden without a column is a mismatch without a name.
fn take_back(column: &MissingColumn, diagnosis: &mut CutDiagnosis) {
    let (back, kept): (Vec<_>, Vec<_>) =
        diagnosis.findings.drain(..).partition(|f| column.effects.contains(&f.effect));
    diagnosis.findings = kept;
    let Some(first) = back.first() else { return };
    for finding in &back {
        diagnosis.scenario.physics = diagnosis.scenario.physics.without(finding.effect);
    }
    let names: Vec<&str> = column.effects.iter().map(|e| e.name()).collect();
    diagnosis.notes.push(format!(
        "Something shows at {} that could be {}: without the column {} none of them is told from another.",
        first.port.name(),
        names.join(" or "),
        column.name
    ));
    for (k, finding) in diagnosis.findings.iter_mut().enumerate() {
        finding.rank = k + 1;
    }
    if diagnosis.findings.is_empty() {
        diagnosis.verdict = Verdict::UnexplainedMismatch;
        if let Some(location) = &mut diagnosis.location {
            location.port = first.port;
        }
    }
}
