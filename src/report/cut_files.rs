//! `diagnosis.json`, `contribution-N.parquet`, `scenario.toml` and `cuts.parquet` of a diagnosis of the cut
//! (contracts, section 6, "Outputs").

use super::faults::{FaultOf, faults_json};
use crate::config::scenario::scenario_to_text;
use crate::diagnosis::cut::input::{CutRow, CutTable, KnownOfCut};
use crate::diagnosis::cut::result::{
    CutDiagnosis, CutFinding, CutFit, CutLocation, CutProof, CutRowFit, PlannedCut, Sides, TableFit,
};
use crate::diagnosis::{Alternative, Estimate};
use crate::recording::{CUTS_FORMAT, RecordingError, Table, TableColumn, write_table, write_whole};
use crate::stability::Root;
use serde_json::{Map, Value, json};
use std::path::Path;

/// What was handed in.
#[derive(Debug, Clone)]
pub struct CutFiles<'a> {
    /// File of the scenario.
    pub scenario: String,
    /// Files of the recordings that were judged, in order.
    pub recordings: Vec<String>,
    /// What is wrong with the recordings, those that were refused among them.
    pub faults: Vec<FaultOf>,
    /// Table of cuts.
    pub table: Option<&'a CutTable>,
}

/// Writes everything but the page for a person; `diagnosis.json` last, so that whoever waits for it finds the
/// rest.
///
/// Errors: the folder cannot be made or a file not written.
pub fn write(out: &Path, diagnosis: &CutDiagnosis, files: &CutFiles<'_>) -> Result<(), RecordingError> {
    std::fs::create_dir_all(out).map_err(|source| RecordingError::Io { path: out.to_owned(), source })?;
    remove_contributions(out)?;
    for finding in diagnosis.findings.iter().filter(|f| !f.contribution.is_empty()) {
        write_contribution(out, diagnosis, finding)?;
    }
    if let Some(table) = files.table {
        write_cuts(&out.join("cuts.parquet"), table, &diagnosis.rows)?;
    }
    write_whole(&out.join("scenario.toml"), scenario_to_text(&diagnosis.scenario).as_bytes())?;
    let text = serde_json::to_string_pretty(&to_json(diagnosis, files)).unwrap_or_default();
    write_whole(&out.join("diagnosis.json"), (text + "\n").as_bytes())
}

/// Contributions of an answer that stood here before, which may have had more findings. Errors: one of them
/// cannot be removed.
pub(super) fn remove_contributions(out: &Path) -> Result<(), RecordingError> {
    for rank in 1.. {
        let path = out.join(contribution_name(rank));
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => break,
            done => done.map_err(|source| RecordingError::Io { path, source })?,
        }
    }
    Ok(())
}

/// The machine-readable answer.
#[must_use]
pub fn to_json(diagnosis: &CutDiagnosis, files: &CutFiles<'_>) -> Value {
    json!({
        "schema": "stillcut.diagnosis/1",
        "verdict": diagnosis.verdict.name(),
        "location": diagnosis.location.as_ref().map(|l| location(l, diagnosis)),
        "findings": diagnosis.findings.iter().map(finding).collect::<Vec<_>>(),
        "residual_band_hz": diagnosis.residual_band_hz,
        "noise_floor_n": diagnosis.noise_floor_n,
        "parameter_corrections": diagnosis.parameter_corrections.iter().map(|c| json!({
            "name": c.name, "nominal": c.nominal, "value": c.value, "ci95": c.ci95,
        })).collect::<Vec<_>>(),
        "recordings": diagnosis.recordings.iter().enumerate().map(|(k, r)| json!({
            "file": files.recordings.get(k).cloned().unwrap_or_default(),
            "experiment": r.experiment, "rms_before_n": r.rms_before_n, "rms_after_n": r.rms_after_n,
            "free_run_before_db": r.free.as_ref().map(|f| f.apart_db[0]),
            "free_run_after_db": r.free.as_ref().map(|f| f.apart_db[1]),
        })).collect::<Vec<_>>(),
        "proof": diagnosis.proof.as_ref().map(|p| proof(p, diagnosis)),
        "recording_faults": faults_json(&files.faults),
        "table": diagnosis.table.as_ref().map(|t| Value::Object(table_fit(t))),
        "not_identifiable": diagnosis.not_identifiable.iter().map(|n| json!({
            "effect": n.effect.name(), "port": n.port.name(), "why": n.why,
        })).collect::<Vec<_>>(),
        "plan": diagnosis.plan.iter().map(planned).collect::<Vec<_>>(),
        "tried": diagnosis.tried.iter().map(|t| json!({
            "effect": t.effect.map(|e| e.name()), "port": t.port.name(), "evidence_nats": t.evidence_nats,
        })).collect::<Vec<_>>(),
        "notes": diagnosis.notes,
    })
}

fn location(l: &CutLocation, diagnosis: &CutDiagnosis) -> Value {
    let mut time: Map<String, Value> = Map::new();
    for t in l.time.iter().filter(|t| !t.spans_s.is_empty()) {
        let word = diagnosis.recordings.get(t.recording).map_or("", |r| r.experiment.as_str());
        // Several recordings may carry the same word.
        let same = |n: usize| if n == 1 { word.to_owned() } else { format!("{word} ({n})") };
        let name = (1..).map(same).find(|name| !time.contains_key(name)).unwrap_or_default();
        time.insert(name, json!(t.spans_s));
    }
    json!({ "port": l.port.name(), "domain": l.domain, "bands_hz": l.bands_hz, "time_s": time })
}

fn finding(f: &CutFinding) -> Value {
    let parameters: Map<String, Value> = f.parameters.iter().map(|e| (e.name.clone(), estimate(e))).collect();
    let contribution = (!f.contribution.is_empty()).then(|| contribution_name(f.rank));
    json!({
        "rank": f.rank, "effect": f.effect.name(), "port": f.port.name(), "statement": f.statement,
        "equation": f.equation,
        "parameters": parameters,
        "fit": fit(&f.fit),
        "probability": f.probability,
        "alternatives": f.alternatives.iter().map(alternative).collect::<Vec<_>>(),
        "next_experiment": f.next_experiment,
        "contribution": contribution,
        "evidence_nats": f.evidence_nats,
    })
}

fn fit(fit: &CutFit) -> Value {
    let mut out = fit.table.as_ref().map(table_fit).unwrap_or_default();
    if let Some(forces) = &fit.forces {
        out.insert("heldout_rms_before_n".to_owned(), json!(forces.heldout_rms_before_n));
        out.insert("heldout_rms_after_n".to_owned(), json!(forces.heldout_rms_after_n));
        out.insert("noise_floor_n".to_owned(), json!(forces.noise_floor_n));
    }
    if let Some(gain_nats) = fit.gain_nats {
        out.insert("heldout_gain_nats".to_owned(), json!(gain_nats));
    }
    Value::Object(out)
}

/// The same of the scenario as stated, of its structure with other numbers, and of the answer.
fn sides(of: &Sides<f64>) -> Value {
    json!({ "stated": of.stated, "numbers_alone": of.refitted, "answer": of.answer })
}

/// How the answer stands on stretches that no number was fitted to.
fn proof(p: &CutProof, diagnosis: &CutDiagnosis) -> Value {
    let lines = p.lines.iter().map(|line| {
        let of = |root: &Root| json!({ "growth_1_s": root.growth_1_s, "frequency_hz": root.frequency_hz });
        json!({
            "experiment": diagnosis.recordings.get(line.recording).map(|r| r.experiment.as_str()),
            "span_s": line.span_s,
            "measured": of(&line.measured), "growth_se_1_s": line.deviation_1_s,
            "stated": of(&line.foretold.stated), "numbers_alone": of(&line.foretold.refitted),
            "answer": of(&line.foretold.answer),
        })
    });
    json!({
        "stretches": p.stretches, "parts": p.parts,
        "loss_nats": sides(&p.loss_nats), "rms_n": sides(&p.rms_n), "lines": lines.collect::<Vec<_>>(),
    })
}

fn table_fit(fit: &TableFit) -> Map<String, Value> {
    let pairs = [
        ("heldout_log_loss_before", json!(fit.heldout_log_loss_before)),
        ("heldout_log_loss_after", json!(fit.heldout_log_loss_after)),
        ("heldout_right_before", json!(fit.heldout_right_before)),
        ("heldout_right_after", json!(fit.heldout_right_after)),
        ("heldout_cuts", json!(fit.heldout_cuts)),
    ];
    pairs.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

fn estimate(e: &Estimate) -> Value {
    json!({ "value": e.value, "unit": e.unit, "ci95": e.ci95 })
}

fn alternative(a: &Alternative) -> Value {
    json!({ "effect": a.effect.name(), "port": a.port.name(), "probability": a.probability })
}

fn planned(cut: &PlannedCut) -> Value {
    json!({
        "spindle_speed_rpm": cut.spindle_speed_rpm, "feed_m_rev": cut.feed_m_rev, "width_m": cut.width_m,
        "tool_position_m": cut.tool_position_m, "pitch_difference_rad": cut.pitch_difference_rad,
        "duration_s": cut.duration_s, "tells": cut.tells, "expected_nats": cut.expected_nats,
    })
}

/// File of what a finding adds, of a drive or a cut.
pub(super) fn contribution_name(rank: usize) -> String {
    format!("contribution-{rank}.parquet")
}

fn write_contribution(
    out: &Path,
    diagnosis: &CutDiagnosis,
    finding: &CutFinding,
) -> Result<(), RecordingError> {
    let (mut experiment, mut t_s) = (Vec::<String>::new(), Vec::new());
    let (mut value, mut value_2) = (Vec::new(), Vec::new());
    for c in &finding.contribution {
        let name = diagnosis.recordings.get(c.recording).map_or_else(String::new, |r| r.experiment.clone());
        experiment.extend(std::iter::repeat_n(name, c.t_s.len()));
        t_s.extend_from_slice(&c.t_s);
        value.extend_from_slice(&c.value);
        value_2.extend(c.value_2.iter().flatten());
    }
    let mut columns = vec![
        ("experiment", TableColumn::Text(&experiment)),
        ("t_s", TableColumn::Double(&t_s)),
        ("value", TableColumn::Double(&value)),
    ];
    if value_2.len() == value.len() {
        columns.push(("value_2", TableColumn::Double(&value_2)));
    }
    let metadata = vec![
        ("effect".to_owned(), finding.effect.name().to_owned()),
        ("port".to_owned(), finding.port.name().to_owned()),
    ];
    write_table(&out.join(contribution_name(finding.rank)), &Table { columns, metadata })
}

/// One optional column of a table of cuts.
struct Known {
    name: &'static str,
    of: fn(&KnownOfCut) -> Option<f64>,
}

const KNOWN: [Known; 12] = [
    Known { name: "feed_m_rev", of: |k| k.feed_m_rev },
    Known { name: "tool_position_m", of: |k| k.tool_position_m },
    Known { name: "pitch_difference_rad", of: |k| k.pitch_difference_rad },
    Known { name: "workpiece_diameter_m", of: |k| k.workpiece_diameter_m },
    Known { name: "line_hz", of: |k| k.line_hz },
    Known { name: "growth_1_s", of: |k| k.growth_1_s },
    Known { name: "growth_se_1_s", of: |k| k.growth_se_1_s },
    Known { name: "tool1_radial_force_n", of: |k| k.tool1_radial_force_n },
    Known { name: "tool2_radial_force_n", of: |k| k.tool2_radial_force_n },
    Known { name: "cutting_force_n", of: |k| k.cutting_force_n },
    Known { name: "feed_force_n", of: |k| k.feed_force_n },
    Known { name: "started_s", of: |k| k.started_s },
];

/// The rows as they came, with what is foretold of each before and after.
fn write_cuts(path: &Path, table: &CutTable, fits: &[CutRowFit]) -> Result<(), RecordingError> {
    let rows = &table.rows;
    let number = |of: fn(&CutRow) -> f64| rows.iter().map(of).collect::<Vec<f64>>();
    let names: Vec<String> = rows.iter().map(|r| r.cut.clone()).collect();
    let outcomes: Vec<String> = rows.iter().map(|r| r.outcome_word.clone()).collect();
    let (speeds, widths) = (number(|r| r.spindle_speed_rpm), number(|r| r.width_m));
    let known: Vec<(&'static str, Vec<Option<f64>>)> = KNOWN
        .iter()
        .map(|k| (k.name, rows.iter().map(|r| (k.of)(&r.known)).collect::<Vec<_>>()))
        .filter(|(_, values)| values.iter().any(Option::is_some))
        .collect();
    let said = |of: fn(&CutRowFit) -> f64| {
        (0..rows.len()).map(|k| fits.get(k).map(of).filter(|v| v.is_finite())).collect::<Vec<_>>()
    };
    let said = [
        ("growth_before_1_s", said(|f| f.before.growth_1_s)),
        ("growth_after_1_s", said(|f| f.after.growth_1_s)),
        ("frequency_before_hz", said(|f| f.before.frequency_hz)),
        ("frequency_after_hz", said(|f| f.after.frequency_hz)),
        ("chatter_probability_before", said(|f| f.before.chatter_probability)),
        ("chatter_probability_after", said(|f| f.after.chatter_probability)),
    ];
    let mut columns = vec![
        ("cut", TableColumn::Text(&names)),
        ("spindle_speed_rpm", TableColumn::Double(&speeds)),
        ("width_m", TableColumn::Double(&widths)),
        ("outcome", TableColumn::Text(&outcomes)),
    ];
    let optional = known.iter().chain(&said);
    columns.extend(optional.map(|(name, values)| (*name, TableColumn::OptionalDouble(values))));
    write_table(path, &Table { columns, metadata: vec![("format".to_owned(), CUTS_FORMAT.to_owned())] })
}
