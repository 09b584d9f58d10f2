//! The diagnosis on simulated axes whose answer is known, and on models it wrote itself.

use crate::folders::shared;
use std::path::Path;
use stillcut::config::machine::{machine_from_text, machine_to_text, read_machine};
use stillcut::diagnosis::{Diagnosis, Verdict, diagnose};
use stillcut::plant::machine::Machine;
use stillcut::recording::read_recording;
use stillcut::sample::Recording;
use stillcut::simulation::concealed_axis::{CaseSpec, conceal};

/// Seconds `from_s` to `to_s` of a recording: tests run unoptimised as well.
fn cut(recording: &Recording, from_s: f64, to_s: f64) -> Recording {
    let rate = recording.sample_rate.hz();
    let range = (from_s * rate) as usize..((to_s * rate) as usize).min(recording.len());
    let mut piece = recording.clone();
    piece.start_s = recording.time_s(range.start);
    for column in &mut piece.columns {
        column.values = column.values[range.clone()].to_vec();
    }
    piece
}

fn read(folder: &Path, file: &str) -> (Machine, Recording) {
    let machine = read_machine(&folder.join("machine.toml")).unwrap();
    (machine, read_recording(&folder.join(file)).unwrap())
}

fn ask(machine: &Machine, recording: &Recording) -> Diagnosis {
    diagnose(machine, std::slice::from_ref(recording), &|_, _| {}).unwrap()
}

#[test]
fn a_healthy_axis_has_no_finding() {
    let Some(folder) = shared("feed-axis-cases/case-01") else { return };
    let (machine, recording) = read(&folder, "moves.parquet");
    let d = ask(&machine, &recording);
    assert!(d.findings.is_empty(), "{:?}", d.findings.iter().map(|f| &f.statement).collect::<Vec<_>>());
    assert_eq!(d.verdict, Verdict::ModelAdequate);
    assert!(d.recordings[0].rms_after_n < 0.02 * d.recordings[0].rms_before_n);
}

#[test]
fn a_backlash_is_found_with_its_gap_and_the_written_model_invents_nothing_elsewhere() {
    let Some(folder) = shared("feed-axis-cases/case-06") else { return };
    let (machine, moves) = read(&folder, "moves.parquet");
    let (_, sweep) = read(&folder, "sweep.parquet");
    let d = ask(&machine, &moves);
    let first = &d.findings[0];
    assert_eq!((first.effect.name(), first.port.name()), ("backlash", "coupling"));
    let gap = &first.parameters[0];
    assert!((gap.value / 1.0001e-6 - 1.0).abs() < 0.01, "{gap:?}");
    let text = machine_to_text(&d.model);
    let model = machine_from_text(Path::new("model.toml"), &text).unwrap();
    let other = ask(&model, &sweep);
    assert!(other.findings.is_empty(), "{:?}", other.findings);
    assert_eq!(other.verdict, Verdict::ModelAdequate);
}

fn concealed(effect: &str, seed: u64) -> (Machine, Vec<Recording>) {
    let machine = super::conceal::model();
    let spec = CaseSpec { effects: vec![effect.to_owned()], seed, ..CaseSpec::default() };
    let case = conceal(&machine.axes[0], machine.sample_rate, &spec).unwrap();
    (case.model, case.recordings)
}

#[test]
fn a_resonance_outside_the_vocabulary_is_located_and_not_named() {
    let (machine, recordings) = concealed("unknown/base_resonance", 5);
    let d = diagnose(&machine, &recordings, &|_, _| {}).unwrap();
    assert_eq!(d.verdict, Verdict::UnexplainedMismatch);
    assert!(d.findings.is_empty());
    let location = d.location.unwrap();
    assert_eq!(location.port.name(), "stage_encoder");
    assert_eq!(location.domain, "frequency");
}

#[test]
fn a_large_dead_time_does_not_shrink_the_stage_balance_to_nothing() {
    // The stage balance has no force of its own to hold its scale: beside a large misfit at the motor it once fell to zero.
    let (machine, recordings) = concealed("dead_time", 92_261_891_788_363);
    let d = diagnose(&machine, &recordings, &|_, _| {}).unwrap();
    assert_eq!(d.findings.iter().map(|f| f.effect.name()).collect::<Vec<_>>(), ["dead_time"]);
    let mass = d.parameter_corrections.iter().find(|c| c.name == "movable_mass_kg");
    assert!(mass.is_none_or(|c| (c.value / c.nominal - 1.0).abs() < 0.1), "{mass:?}");
}

#[test]
fn a_random_walk_is_not_given_a_name() {
    let Some(folder) = shared("feed-axis-cases/case-14") else { return };
    let (machine, recording) = read(&folder, "idle.parquet");
    let d = ask(&machine, &cut(&recording, 7.0, 13.0));
    assert_eq!(d.verdict, Verdict::UnexplainedMismatch);
    assert!(d.findings.is_empty());
    assert!(d.location.is_some_and(|l| l.port.name() == "stage" && !l.bands_hz.is_empty()));
}

#[test]
fn the_same_recording_gives_the_same_answer() {
    let Some(folder) = shared("feed-axis-cases/case-05") else { return };
    let (machine, recording) = read(&folder, "moves.parquet");
    let piece = cut(&recording, 0.0, 2.0);
    assert!(ask(&machine, &piece) == ask(&machine, &piece));
}

#[test]
fn a_recording_without_the_axis_is_refused() {
    let Some(folder) = shared("feed-axis-cases/case-01") else { return };
    let (machine, mut recording) = read(&folder, "moves.parquet");
    recording.columns.retain(|c| !c.name.contains("current"));
    let error = diagnose(&machine, &[recording], &|_, _| {}).map(|d| d.verdict).map_err(|e| e.to_string());
    assert!(error.is_err_and(|e| e.contains("x_current_ref_a")));
}
