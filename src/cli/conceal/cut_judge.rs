//! What the diagnosis of the cut said against what was hidden.

use super::Trial;
use crate::cli::bad_input;
use crate::diagnosis::Verdict;
use crate::diagnosis::cut::diagnose;
use crate::diagnosis::cut::input::{CutEvidence, CutRecording};
use crate::diagnosis::cut::result::{CutDiagnosis, CutFinding};
use crate::report::study::{JudgedInterval, Outcome, Said, Truth};
use crate::simulation::concealed_cut::{CutCase, HiddenCut};

/// Budget of one case (contracts, section 4).
const BUDGET_S: f64 = 60.0;
/// Below half size these two may stand for each other where both are kept alive.
const TWINS: [&str; 2] = ["edge_force", "nonlinear_cutting_force"];
/// Probability from which an alternative is alive.
const ALIVE: f64 = 0.2;

/// Diagnoses one case blind and compares.
pub(super) fn judge(trial: &Trial, case: &CutCase) -> anyhow::Result<Outcome> {
    // Nothing but the scenario and the recordings is handed over.
    let recordings: Result<Vec<CutRecording>, _> =
        case.recordings.iter().map(|r| CutRecording::new(r, &case.scenario)).collect();
    let recordings = recordings.map_err(bad_input)?;
    let evidence = CutEvidence { recordings: &recordings, table: None };
    let said = diagnose(&case.scenario, evidence, BUDGET_S, &|_, _| {}).map_err(bad_input)?;
    let truth = truth_of(case);
    let forces = said.findings.first().and_then(|f| f.fit.forces.as_ref());
    Ok(Outcome {
        label: trial.label.clone(),
        depth: trial.depth,
        seed: trial.seed,
        truth,
        verdict: said.verdict,
        said: said.findings.iter().map(said_of).collect(),
        named: named(&said, case),
        noticed: match truth {
            Truth::WrongNumber => said.verdict != Verdict::ModelAdequate,
            _ => matches!(said.verdict, Verdict::MissingPhysics | Verdict::UnexplainedMismatch),
        },
        port_right: port_right(&said, case),
        intervals: intervals(&said, case),
        agreement: None,
        heldout_over_floor: forces.map(|fit| fit.heldout_rms_after_n / fit.noise_floor_n),
    })
}

fn truth_of(case: &CutCase) -> Truth {
    super::truth_of(case.hidden.first().map(|h| h.name.as_str()))
}

/// The whole answer is right: every effect among the first findings, or silence, or "unexplained".
fn said_of(f: &CutFinding) -> Said {
    Said { effect: f.effect.name(), port: f.port.name(), probability: f.probability }
}

fn named(said: &CutDiagnosis, case: &CutCase) -> bool {
    match truth_of(case) {
        Truth::Healthy => {
            matches!(said.verdict, Verdict::ModelAdequate | Verdict::ParameterError)
                && said.findings.is_empty()
        }
        Truth::WrongNumber => {
            let right = |h: &HiddenCut| {
                let key = h.name.trim_start_matches("parameter/");
                said.parameter_corrections.iter().any(|c| c.name == key)
            };
            said.findings.is_empty() && case.hidden.iter().all(right)
        }
        Truth::Outsider => said.verdict == Verdict::UnexplainedMismatch,
        Truth::Effect => {
            let first = &said.findings[..said.findings.len().min(case.hidden.len())];
            case.hidden.iter().all(|h| first.iter().any(|f| same(f, h)))
        }
    }
}

fn same(finding: &CutFinding, hidden: &HiddenCut) -> bool {
    let base = hidden.name.split('/').next().unwrap_or("");
    let said = finding.effect.name();
    if said != base {
        let twins = TWINS.contains(&base) && TWINS.contains(&said) && hidden.depth < 0.5;
        let alive = finding.alternatives.iter().any(|a| a.effect.name() == base && a.probability >= ALIVE);
        return twins && alive;
    }
    let number = |key: &str| finding.parameters.iter().find(|p| p.name == key).map(|p| p.value.round());
    let order = hidden.parameters.iter().find(|(key, _)| *key == "order").map(|(_, value)| value.round());
    order.is_none() || number("order") == order
}

fn port_right(said: &CutDiagnosis, case: &CutCase) -> bool {
    let silent = matches!(truth_of(case), Truth::Healthy | Truth::WrongNumber);
    if silent {
        return said.findings.is_empty();
    }
    let first = said.findings.first().map(|f| f.port).or(said.location.as_ref().map(|l| l.port));
    first.is_some_and(|port| case.hidden.iter().any(|h| h.port == port))
}

/// The reported intervals of the key parameters of what was hidden and found.
fn intervals(said: &CutDiagnosis, case: &CutCase) -> Vec<JudgedInterval> {
    let mut judged = Vec::new();
    for hidden in &case.hidden {
        let Some(finding) = said.findings.iter().find(|f| same(f, hidden)) else { continue };
        let key = hidden.parameters.first();
        let estimate = key.and_then(|(name, _)| finding.parameters.iter().find(|p| p.name == *name));
        if let (Some((_, truth)), Some(found)) = (key, estimate) {
            judged.push(JudgedInterval {
                name: found.name.clone(),
                value: found.value,
                ci95: found.ci95,
                truth: *truth,
            });
        }
    }
    judged
}
