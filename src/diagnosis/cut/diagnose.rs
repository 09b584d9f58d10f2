//! From cuts to an answer: what is observed, the one selection, and what it says.

use super::super::result::Verdict;
use super::super::selection::{Reach, Selected, Work, select};
use super::super::{Progress, cut::input::CutInputError};
use super::adequacy::left;
use super::answer::{self, Fitting, Posterior, defeated};
use super::criteria::CRITERIA;
use super::fit::Problem;
use super::foretold;
use super::hidden;
use super::input::{CutEvidence, CutRecording, CutTable};
use super::known::Reference;
use super::laws::Law;
use super::machine::{Frame, Point};
use super::observable::{Every, Observable};
use super::observe::observe;
use super::result::{CutDiagnosis, CutFit, MappedCut};
use super::scatter::{Scattered, scattered};
use super::search::{Asked, Cut, Defended, Model};
use super::stretches::{Stretches, divide};
use super::table::{TableRows, row_condition};
use super::{plan, recorded};
use crate::plant::scenario::Scenario;

/// Effects that are taken up at most, and hypotheses that are fitted in a round to recordings.
const REACH: Reach = Reach { most_findings: 3, fitted: 9 };

/// Says what `scenario` leaves out, from recordings of cuts, a table of cuts, or both. Deterministic.
///
/// `budget_s`: work that may be done, in seconds of an ordinary computer; counted in evaluations.
/// Errors: no cut at all, none that can be judged, or one that the work has no room for.
pub fn diagnose(
    scenario: &Scenario,
    evidence: CutEvidence<'_>,
    budget_s: f64,
    progress: Progress<'_>,
) -> Result<CutDiagnosis, CutInputError> {
    let table = evidence.table.filter(|t| !t.rows.is_empty());
    if evidence.recordings.is_empty() && table.is_none() {
        return Err(CutInputError::NoCut);
    }
    table.map_or(Ok(()), |table| table.check(scenario))?;
    let frame = Frame::of(scenario, &evidence);
    let laws = Law::open(scenario, [frame.probe(), frame.has_recordings()]);
    // Half of the budget for the search, a quarter for whether what it found holds, a quarter for its proof.
    let [mut work, mut beside, mut proof] =
        [0.5, 0.25, 0.25].map(|share| Work::new(evaluations(share * budget_s, &evidence)));
    progress(0.02, "dividing the recordings");
    let (known, point) = first_known(&frame, evidence, table, &mut work).ok_or(CutInputError::NoCut)?;
    let (stretches, mut observables) = observed(&frame, &known, evidence, table);
    // A table costs little, and its screening says little: the fit may have been bent far.
    let rivals = if evidence.recordings.is_empty() { laws.len() } else { REACH.fitted };
    // What stands in for a column that is missing may be wrong: where something is left, the question is
    // asked again without what rests on it, with the other half of the budget.
    let mut fits = None;
    let mut left_out = Vec::new();
    if hidden::any(evidence.recordings, &observables) {
        let mut half = work.half();
        let problem = Problem { frame: &frame, observables: &observables };
        let first =
            answered(&Cut::new(&problem, laws.clone(), rivals), &point, [&mut half, &mut beside], progress);
        fits = first.filter(|a| a.scattered.is_none() && left(&problem, &a.selected.model.point).is_none());
        if fits.is_none() {
            let mut fitted = |rest: &Problem<'_>| Cut::new(rest, Vec::new(), 0).start(&point, &mut work);
            left_out = hidden::leave_out(&frame, evidence.recordings, &mut observables, &mut fitted);
        }
    }
    let problem = Problem { frame: &frame, observables: &observables };
    let cut = Cut::new(&problem, laws.clone(), rivals);
    let answered = fits.or_else(|| answered(&cut, &point, [&mut work, &mut beside], progress));
    let Answered { start, selected, defended, posterior, scattered } =
        answered.ok_or(CutInputError::NoCut)?;
    progress(0.85, "what these cuts tell");
    let fitting = Fitting {
        problem: &problem,
        laws: &laws,
        start: &start,
        selected: &selected,
        defended: &defended,
        posterior,
        scattered: scattered.as_ref(),
    };
    let mut diagnosis = answer::diagnosis(&fitting);
    if !evidence.recordings.is_empty() {
        progress(0.87, "what the recordings show of it");
        proof.take_over([&work, &beside]);
        recorded::complete(&fitting, evidence.recordings, (&stretches, &known), &mut proof, &mut diagnosis);
        hidden::tell(evidence.recordings, &left_out, &laws, &mut diagnosis);
    }
    // What is seen without a model (a line of no spindle, lost contact) is told; silence about what nobody
    // looked at would be an answer.
    if observables.is_empty() && diagnosis.verdict == Verdict::ModelAdequate {
        return Err(CutInputError::NothingToJudge);
    }
    if let Some(table) = table {
        progress(0.9, "foretelling each speed from the others");
        tell_rows(table, &fitting, &mut diagnosis);
    }
    diagnosis.plan = plan::plan(&fitting);
    note_signals(evidence.recordings, &mut diagnosis);
    if work.is_spent() || beside.is_spent() {
        out_of_budget(&fitting, &mut diagnosis);
    }
    progress(1.0, "done");
    Ok(diagnosis)
}

/// The machine by which the recordings are divided, and a first point of the fit. `None`: no such machine.
fn first_known(
    frame: &Frame,
    evidence: CutEvidence<'_>,
    table: Option<&CutTable>,
    work: &mut Work,
) -> Option<(Reference, Point)> {
    let mut point = frame.origin();
    let mut known = frame.machine(&point).map(Reference::of)?;
    if evidence.recordings.is_empty() {
        let (_, observables) = observed(frame, &known, evidence, table);
        let problem = Problem { frame, observables: &observables };
        point = Cut::new(&problem, Vec::new(), 0).start(&point, work)?.point;
        return Some((known, point));
    }
    // What is linear, what fades and how noisy each recording is, is judged by the machine as stated, then by
    // the same structure with the numbers that fit, twice: noise that is taken for that of another recording
    // makes a random force of what is none.
    for _ in 0..2 {
        let (_, observables) = observed(frame, &known, evidence, table);
        let problem = Problem { frame, observables: &observables };
        let cut = Cut::new(&problem, Vec::new(), 0);
        let fitted = cut.rough(&point, work)?;
        // A chip without a past never chatters: by it nothing swells, and all that fades is soon gone.
        let past = frame.with_past(&fitted).and_then(|with| cut.rough(&with, work));
        let loss = |point: &&Point| problem.value(point, Every(2));
        let best = [Some(&fitted), past.as_ref()].into_iter().flatten();
        let best = best.min_by(|a, b| loss(a).total_cmp(&loss(b)))?;
        known = known.refined(&problem, best, evidence.recordings.len()).unwrap_or(known);
        point = frame.with_typical_noise(&fitted);
    }
    Some((known, point))
}

/// How the rows of a table are foretold, for the answer, its findings and the stability map.
fn tell_rows(table: &CutTable, fitting: &Fitting<'_>, diagnosis: &mut CutDiagnosis) {
    let said = foretold::rows(fitting.problem.frame, table, fitting);
    diagnosis.rows = said.rows;
    diagnosis.table = Some(said.fit);
    for finding in &mut diagnosis.findings {
        finding.fit = CutFit { table: Some(said.fit), ..finding.fit };
    }
    diagnosis.mapped.extend(mapped(table, &diagnosis.stated));
}

/// Cuts of a table for the stability map.
fn mapped(table: &CutTable, scenario: &Scenario) -> impl Iterator<Item = MappedCut> {
    table.rows.iter().map(|row| MappedCut {
        name: row.cut.clone(),
        at: row_condition(row, scenario),
        chatter: row.outcome.map(|o| o == super::input::CutOutcome::Chatter),
    })
}

/// What a selection came to.
struct Answered {
    start: Model,
    selected: Selected<Asked, Model>,
    defended: Vec<Defended>,
    posterior: Option<Posterior>,
    scattered: Option<Scattered>,
}

/// The one selection from a point on; what no stretch tells from nothing is taken out again.
///
/// `work`: for the selection; `beside`: for asking what it found again beside what no law is.
fn answered(
    cut: &Cut<'_>,
    point: &Point,
    [work, beside]: [&mut Work; 2],
    progress: Progress<'_>,
) -> Option<Answered> {
    let reach = Reach { fitted: cut.rivals, ..REACH };
    let start = cut.start(point, work)?;
    let mut selected = select(cut, start.clone(), reach, work, &|share, what| progress(0.8 * share, what));
    // A gain says that something is better with the law, its interval whether all stretches say so alike.
    let mut posterior = Posterior::new(cut.problem, &selected.model.point);
    let unseen = |p: &Option<Posterior>| p.as_ref().and_then(Posterior::unseen);
    while let Some(k) = unseen(&posterior).or_else(|| defeated(cut.problem, &selected, &cut.defended())) {
        let mut without = selected.model.point.clone();
        without.terms.remove(k);
        selected.model = cut.refined(&without, work);
        posterior = Posterior::new(cut.problem, &selected.model.point);
    }
    // A law that follows what is another machine in every stretch is none.
    let scattered = scattered(cut, &selected.model, beside);
    if let Some(scattered) = &scattered
        && scattered.point.terms.len() < selected.model.point.terms.len()
    {
        selected.model = cut.refined(&scattered.point, beside);
        posterior = Posterior::new(cut.problem, &selected.model.point);
    }
    Some(Answered { start, selected, defended: cut.defended(), posterior, scattered })
}

/// Everything that was observed, as seen by what is known.
fn observed<'a>(
    frame: &Frame,
    known: &Reference,
    evidence: CutEvidence<'_>,
    table: Option<&CutTable>,
) -> (Stretches, Vec<Box<dyn Observable + 'a>>) {
    let stretches = divide(evidence.recordings, &known.machine.scenario);
    let mut out = observe(evidence.recordings, &stretches, known);
    if let Some(table) = table {
        out.push(Box::new(TableRows::new(table, &frame.stated, |_| true)));
    }
    (stretches, out)
}

/// Evaluations that fit into so many seconds: measured on two cores.
fn evaluations(budget_s: f64, evidence: &CutEvidence<'_>) -> u64 {
    let seconds: f64 =
        evidence.recordings.iter().map(|r| r.len() as f64 / r.sample_rate.hz()).sum::<f64>().max(0.1);
    let rows = evidence.table.map_or(0, |t| t.rows.len()) as f64;
    let evaluation_s = CRITERIA.evaluation_s_per_s * seconds + CRITERIA.evaluation_s_per_row * rows;
    (budget_s.max(0.0) / evaluation_s) as u64
}

/// A spindle that turned otherwise than commanded, beyond what the change of a speed leaves (1e-4), and a
/// force signal of which nothing is stated.
fn note_signals(recordings: &[CutRecording], diagnosis: &mut CutDiagnosis) {
    for recording in recordings {
        let percent = 100.0 * (recording.speed_factor - 1.0);
        if percent.abs() > 0.01 {
            let (name, than) = (&recording.experiment, if percent > 0.0 { "faster" } else { "slower" });
            diagnosis.notes.push(format!(
                "In {name} the spindle turned {:.2} % {than} than commanded: the speed is that of the \
                 measured angle.",
                percent.abs()
            ));
        }
    }
    let unstated = |r: &&CutRecording| !r.signal_is_stated;
    let names: Vec<&str> = recordings.iter().filter(unstated).map(|r| r.experiment.as_str()).collect();
    if !names.is_empty() {
        diagnosis.notes.push(format!(
            "No force_delay_s and no force_bandwidth_hz in {}: the signal is taken as the force itself, at \
             once; one that is late or filtered is told as physics of the cut.",
            names.join(", ")
        ));
    }
}

/// What may be said where the budget ended first: what was found stands, what was not asked is named, and
/// where nothing was found no number is told as wrong, since each may be bent by what was not asked.
fn out_of_budget(fitting: &Fitting<'_>, diagnosis: &mut CutDiagnosis) {
    let asked = fitting.selected.rounds.iter().flat_map(|r| r.fitted.iter().map(|f| f.hypothesis.law));
    let asked: Vec<Law> = asked.collect();
    let open = fitting.laws.iter().filter(|law| !asked.contains(law));
    let mut names: Vec<&str> = open.map(|law| law.name()).collect();
    names.dedup();
    let what = if names.is_empty() { "what is left beside them".to_owned() } else { names.join(", ") };
    diagnosis.notes.push(format!("The budget ended before every hypothesis was asked. Not asked: {what}."));
    if diagnosis.findings.is_empty() {
        diagnosis.notes.push("Nothing found is therefore no proof that nothing is missing.".to_owned());
        if diagnosis.verdict == Verdict::ParameterError {
            diagnosis.verdict = Verdict::UnexplainedMismatch;
            diagnosis.location = Some(super::result::CutLocation {
                port: crate::plant::effects::Port::Process,
                domain: "frequency",
                bands_hz: Vec::new(),
                time: Vec::new(),
            });
        }
        diagnosis.parameter_corrections.clear();
        diagnosis.scenario = diagnosis.stated;
    }
}
