//! `diagnosis.json`, `contribution-N.parquet` and `model.toml` (contracts, section 4).

use super::cut_files::{contribution_name, remove_contributions};
use super::faults::{FaultOf, faults_json};
use crate::diagnosis::{Alternative, Diagnosis, Estimate, Finding, Location, SimulatedTrial, TimeSpans};
use crate::recording::{RecordingError, Table, TableColumn, write_table, write_whole};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Writes everything but the page for a person. `files`: names of the recordings that were judged, and of those
/// that were left out; `faults`: what is wrong with these and the others.
///
/// Errors: the folder cannot be made or a file not written.
pub fn write(
    out: &Path,
    diagnosis: &Diagnosis,
    files: (&[String], &[String]),
    faults: &[FaultOf],
) -> Result<(), RecordingError> {
    std::fs::create_dir_all(out).map_err(|source| RecordingError::Io { path: out.to_owned(), source })?;
    remove_contributions(out)?;
    for finding in &diagnosis.findings {
        write_contribution(out, diagnosis, finding)?;
    }
    let model = crate::config::machine::machine_to_text(&diagnosis.model);
    write_whole(&out.join("model.toml"), model.as_bytes())?;
    let text = serde_json::to_string_pretty(&to_json(diagnosis, files, faults)).unwrap_or_default();
    write_whole(&out.join("diagnosis.json"), (text + "\n").as_bytes())
}

/// The machine-readable answer.
#[must_use]
pub fn to_json(
    diagnosis: &Diagnosis,
    (files, left_out): (&[String], &[String]),
    faults: &[FaultOf],
) -> Value {
    json!({
        "schema": "stillcut.diagnosis/1",
        "axis": (!diagnosis.axis.is_empty()).then_some(&diagnosis.axis),
        "verdict": diagnosis.verdict.name(),
        "no_evidence": diagnosis.no_evidence,
        "location": diagnosis.location.as_ref().map(|l| location(l, diagnosis)),
        "findings": diagnosis.findings.iter().map(finding).collect::<Vec<_>>(),
        "unexplained": diagnosis.unexplained.as_ref().map(|u| json!({
            "port": u.port.name(), "bands_hz": u.bands_hz, "time_s": times(&u.time, diagnosis),
            "force_n": u.force_n, "floor_n": u.floor_n,
        })),
        "candidates": diagnosis.candidates.iter().map(|c| json!({
            "effect": c.effect.name(), "port": c.port.name(), "evidence_nats": c.evidence_nats,
            "level_nats": c.level_nats, "reason": c.reason.sentence(),
        })).collect::<Vec<_>>(),
        "residual_band_hz": diagnosis.residual_band_hz,
        "noise_floor_n": noise_floor(diagnosis),
        "detection_limits": diagnosis.detection_limits.iter().map(|l| json!({
            "effect": l.effect.name(), "port": l.port.name(), "force_rms_n": l.force_rms_n,
        })).collect::<Vec<_>>(),
        "parameter_corrections": diagnosis.parameter_corrections.iter().map(|c| json!({
            "name": c.name, "nominal": c.nominal, "value": c.value, "ci95": c.ci95,
        })).collect::<Vec<_>>(),
        "recordings": diagnosis.recordings.iter().enumerate().map(|(k, r)| json!({
            "file": files.get(k).cloned().unwrap_or_default(),
            "experiment": r.experiment, "rms_before_n": r.rms_before_n, "rms_after_n": r.rms_after_n,
        })).collect::<Vec<_>>(),
        "left_out": left_out,
        "recording_faults": faults_json(faults),
        "closed_loop": closed_loop(diagnosis, files),
        "notes": diagnosis.notes,
    })
}

/// The proof in simulation; a model that ran away has null for its numbers.
fn closed_loop(diagnosis: &Diagnosis, files: &[String]) -> Value {
    let loops = match &diagnosis.closed_loop {
        Ok(loops) => loops,
        Err(why) => return json!({ "not_simulated_because": why }),
    };
    let three = |x: &[f64; 3]| json!({ "stated": x[0], "recalibrated": x[1], "found": x[2] });
    let trial = |t: &SimulatedTrial| {
        json!({
            "file": files.get(t.recording).cloned().unwrap_or_default(),
            "experiment": diagnosis.recordings.get(t.recording).map(|r| r.experiment.as_str()),
            "injected": t.injected,
            "thrust_rms_n": three(&t.thrust_rms_n),
            "stage_rms_m": three(&t.stage_rms_m),
        })
    };
    let read = loops.read.map(|c| {
        json!({
            "position_gain_1_s": c.position_gain_1_s,
            "velocity_gain_1_s": c.velocity_gain_1_s,
            "velocity_integral_1_s": c.velocity_integral_1_s,
            "velocity_filter_rad_s": c.velocity_filter_rad_s,
        })
    });
    json!({
        "control_law_share": loops.law_share,
        "control_law_read": read,
        "recordings": loops.trials.iter().map(trial).collect::<Vec<_>>(),
        "effects_not_simulated": loops.not_simulated.iter().map(|e| e.name()).collect::<Vec<_>>(),
    })
}

fn noise_floor(diagnosis: &Diagnosis) -> Map<String, Value> {
    let floors = diagnosis.balances.iter().zip(&diagnosis.noise_floor_n);
    floors.map(|(balance, n)| ((*balance).to_owned(), json!(n))).collect()
}

/// Spans by the word of their recording.
fn times(spans: &[TimeSpans], diagnosis: &Diagnosis) -> Map<String, Value> {
    let mut time: Map<String, Value> = Map::new();
    for t in spans.iter().filter(|t| !t.spans_s.is_empty()) {
        let word = diagnosis.recordings.get(t.recording).map_or("", |r| r.experiment.as_str());
        // Several recordings may carry the same word.
        let same = |n: usize| if n == 1 { word.to_owned() } else { format!("{word} ({n})") };
        let name = (1..).map(same).find(|name| !time.contains_key(name)).unwrap_or_default();
        time.insert(name, json!(t.spans_s));
    }
    time
}

fn location(l: &Location, diagnosis: &Diagnosis) -> Value {
    let time = times(&l.time, diagnosis);
    json!({
        "port": l.port.name(), "domain": l.domain, "bands_hz": l.bands_hz, "time_s": time,
        "shares": l.shares.map(|s| json!({ "motor": s[0], "stage": s[1], "sum": s[2] })),
    })
}

fn finding(f: &Finding) -> Value {
    let mut parameters: Map<String, Value> =
        f.parameters.iter().map(|e| (e.name.clone(), estimate(e))).collect();
    for map in &f.maps {
        parameters.insert(map.name.clone(), json!({ "value": map.values }));
    }
    json!({
        "rank": f.rank, "effect": f.effect.name(), "port": f.port.name(), "statement": f.statement, "equation": f.equation,
        "parameters": parameters,
        "fit": {
            "heldout_rms_before_n": f.fit.heldout_rms_before_n, "heldout_rms_after_n": f.fit.heldout_rms_after_n,
            "noise_floor_n": f.fit.noise_floor_n,
        },
        "probability": f.probability,
        "alternatives": f.alternatives.iter().map(alternative).collect::<Vec<_>>(),
        "next_experiment": f.next_experiment,
        "contribution": contribution_name(f.rank),
        "evidence": f.evidence,
    })
}

fn estimate(e: &Estimate) -> Value {
    json!({ "value": e.value, "unit": e.unit, "ci95": e.ci95 })
}

fn alternative(a: &Alternative) -> Value {
    json!({ "effect": a.effect.name(), "port": a.port.name(), "probability": a.probability })
}

fn write_contribution(out: &Path, diagnosis: &Diagnosis, finding: &Finding) -> Result<(), RecordingError> {
    let (mut experiment, mut t_s, mut value) = (Vec::<String>::new(), Vec::new(), Vec::new());
    for c in &finding.contribution {
        let name = diagnosis.recordings.get(c.recording).map_or_else(String::new, |r| r.experiment.clone());
        experiment.extend(std::iter::repeat_n(name, c.t_s.len()));
        t_s.extend_from_slice(&c.t_s);
        value.extend_from_slice(&c.value);
    }
    let table = Table {
        columns: vec![
            ("experiment", TableColumn::Text(&experiment)),
            ("t_s", TableColumn::Double(&t_s)),
            ("value", TableColumn::Double(&value)),
        ],
        metadata: vec![
            ("effect".to_owned(), finding.effect.name().to_owned()),
            ("port".to_owned(), finding.port.name().to_owned()),
        ],
    };
    write_table(&out.join(contribution_name(finding.rank)), &table)
}
