//! What the diagnosis said against what was hidden.

use super::Trial;
use crate::diagnosis::{Diagnosis, Finding, Verdict, diagnose};
use crate::plant::effects::Port;
use crate::report::study::{JudgedInterval, Outcome, Said, Study, Truth};
use crate::simulation::concealed_axis::{Case, HiddenEffect};
use serde_json::{Value, json};

/// Tolerance of a wavelength and of an order, as a share.
const WAVELENGTH_TOLERANCE: f64 = 0.03;
const ORDER_TOLERANCE: f64 = 0.02;

/// Diagnoses one case blind and compares.
pub(super) fn judge(trial: &Trial, case: &Case) -> anyhow::Result<Outcome> {
    // Nothing but the model and the recordings is handed over.
    let diagnosis = diagnose(&case.model, &case.recordings, &|_, _| {})?;
    let said =
        |f: &Finding| Said { effect: f.effect.name(), port: f.port.name(), probability: f.probability };
    Ok(Outcome {
        label: trial.label.clone(),
        depth: trial.depth,
        seed: trial.seed,
        truth: truth_of(case),
        verdict: diagnosis.verdict,
        said: diagnosis.findings.iter().map(said).collect(),
        named: named(&diagnosis, case),
        noticed: noticed(&diagnosis, case),
        port_right: port_right(&diagnosis, case),
        intervals: judged_intervals(&diagnosis, case),
        agreement: agreement(&diagnosis, case),
        heldout_over_floor: diagnosis
            .findings
            .first()
            .map(|f| f.fit.heldout_rms_after_n / f.fit.noise_floor_n),
    })
}

fn truth_of(case: &Case) -> Truth {
    super::truth_of(case.hidden.first().map(|h| h.name.as_str()))
}

/// The whole answer is right: every effect among the first findings, or silence, or the wrong number, or
/// "unknown".
fn named(d: &Diagnosis, case: &Case) -> bool {
    match truth_of(case) {
        Truth::Healthy => {
            matches!(d.verdict, Verdict::ModelAdequate | Verdict::ParameterError) && d.findings.is_empty()
        }
        Truth::WrongNumber => {
            let right = |h: &HiddenEffect| {
                let key = h.name.trim_start_matches("parameter/");
                d.parameter_corrections.iter().any(|c| c.name.starts_with(key))
            };
            d.verdict == Verdict::ParameterError && d.findings.is_empty() && case.hidden.iter().all(right)
        }
        Truth::Outsider => d.verdict == Verdict::UnexplainedMismatch,
        Truth::Effect => {
            let first = &d.findings[..d.findings.len().min(case.hidden.len())];
            let named = |h: &HiddenEffect| first.iter().any(|f| same(f, h));
            d.verdict == Verdict::MissingPhysics && case.hidden.iter().all(named)
        }
    }
}

/// Something was noticed at all; for a healthy machine, wrongly.
fn noticed(d: &Diagnosis, case: &Case) -> bool {
    match truth_of(case) {
        Truth::WrongNumber => d.verdict != Verdict::ModelAdequate,
        _ => matches!(d.verdict, Verdict::MissingPhysics | Verdict::UnexplainedMismatch),
    }
}

fn same(finding: &Finding, hidden: &HiddenEffect) -> bool {
    let base = hidden.name.split('/').next().unwrap_or("");
    // Gravity and a difference between the directions differ only at rest: the other must stay alive.
    let twins = ["gravity_load", "asymmetric_friction"];
    let said = finding.effect.name();
    if said != base {
        let twin = twins.contains(&base) && twins.contains(&said);
        return twin && finding.alternatives.iter().any(|a| a.effect.name() == base && a.probability >= 0.2);
    }
    let near = |key: &str, tolerance: f64| {
        let want = hidden.parameters.iter().find(|(k, _)| *k == key);
        let got = finding.parameters.iter().find(|e| e.name == key);
        want.is_none_or(|(_, w)| got.is_some_and(|g| (g.value / w - 1.0).abs() <= tolerance))
    };
    let place = !base.contains("encoder") || finding.port == hidden.port;
    place && near("wavelength_m", WAVELENGTH_TOLERANCE) && near("order_per_rev", ORDER_TOLERANCE)
}

fn port_right(d: &Diagnosis, case: &Case) -> bool {
    let Some(hidden) = case.hidden.first() else { return d.findings.is_empty() };
    if truth_of(case) == Truth::WrongNumber {
        return d.findings.is_empty();
    }
    let first = d.findings.first().map(|f| f.port).or(d.location.as_ref().map(|l| l.port));
    first.is_some_and(|p| case.hidden.iter().any(|h| h.port == p)) || first == Some(hidden.port)
}

/// The reported intervals of the parameters of what was hidden and found. A stiffness that changes over the
/// travel tells its slope only: the variation is held against that over the length which the answer states.
fn judged_intervals(d: &Diagnosis, case: &Case) -> Vec<JudgedInterval> {
    let mut judged = Vec::new();
    for hidden in &case.hidden {
        let Some(finding) = d.findings.iter().find(|f| same(f, hidden)) else { continue };
        for (key, truth) in &hidden.parameters {
            let Some(estimate) = finding.parameters.iter().find(|e| e.name == *key) else { continue };
            let truth = match (*key, stiffness_lengths(finding, hidden)) {
                ("length_m", _) => continue,
                ("relative_variation", Some([stated_m, true_m])) => truth * stated_m / true_m,
                _ => *truth,
            };
            let (name, value, ci95) = (estimate.name.clone(), estimate.value, estimate.ci95);
            judged.push(JudgedInterval { name, value, ci95, truth });
        }
    }
    judged
}

/// Over which length the answer states a change of the stiffness, and the length of the hidden one, m.
fn stiffness_lengths(finding: &Finding, hidden: &HiddenEffect) -> Option<[f64; 2]> {
    let stated = finding.parameters.iter().find(|e| e.name == "length_m")?.value;
    let (_, hidden_m) = hidden.parameters.iter().find(|(key, _)| *key == "length_m")?;
    Some([stated, *hidden_m])
}

/// Share of the concealed force, mean square, that the contribution of the first right finding explains.
fn agreement(d: &Diagnosis, case: &Case) -> Option<f64> {
    let hidden = case.hidden.first()?;
    let finding = d.findings.iter().find(|f| same(f, hidden))?;
    let side = match finding.port {
        Port::Motor => 0,
        Port::Coupling => 1,
        Port::Stage => 2,
        _ => return None,
    };
    let (mut left, mut whole) = (0.0_f64, 0.0_f64);
    for part in &finding.contribution {
        let (Some(force), Some(recording)) =
            (case.hidden_force_n.get(part.recording), case.recordings.get(part.recording))
        else {
            continue;
        };
        let rate = recording.sample_rate.hz();
        let pairs: Vec<[f64; 2]> = part
            .t_s
            .iter()
            .zip(&part.value)
            .filter_map(|(t, v)| force[side].get((t * rate).round() as usize).map(|h| [*v, *h]))
            .collect();
        for [v, h] in pairs {
            left += (h - v).powi(2);
            whole += h * h;
        }
    }
    (whole > 0.0).then(|| 1.0 - left / whole)
}

fn interval_json(i: &JudgedInterval) -> Value {
    json!({"name": i.name, "value": i.value, "ci95": i.ci95, "truth": i.truth})
}

/// `conceal.json`.
pub(super) fn study_json(study: &Study) -> Value {
    let trials: Vec<Value> = study
        .outcomes
        .iter()
        .map(|o| {
            let said = |s: &Said| json!({"effect": s.effect, "port": s.port, "probability": s.probability});
            let said: Vec<Value> = o.said.iter().map(said).collect();
            let intervals: Vec<Value> = o.intervals.iter().map(interval_json).collect();
            json!({
                "hidden": o.label, "depth": o.depth, "seed": o.seed, "verdict": o.verdict.name(),
                "findings": said,
                "noticed": o.noticed, "right": o.named, "port_right": o.port_right,
                "intervals": intervals,
                "intervals_holding_truth": o.intervals.iter().filter(|i| i.holds()).count(),
                "contribution_r2": o.agreement, "heldout_over_floor": o.heldout_over_floor,
            })
        })
        .collect();
    let summary: Vec<Value> = study
        .rates()
        .iter()
        .map(|r| {
            json!({
                "hidden": r.label, "depth": r.depth, "machines": r.machines, "noticed": r.noticed,
                "right": r.named,
                "port_right": r.port_right, "right_ci95": r.named_ci95(),
            })
        })
        .collect();
    json!({"schema": "stillcut.conceal/1", "model": study.model, "summary": summary, "trials": trials})
}
