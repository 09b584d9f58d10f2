//! `stillcut diagnose`.

use super::bad_input;
use super::diagnose_arguments::Arguments;
use super::gated::{Checked, read_checked};
use super::progress::with_progress;
use crate::config::machine::read_machine;
use crate::diagnosis::{DiagnoseError, DiagnoseOptions, Progress, diagnose_with};
use crate::gate::{Action, Fault, Gated};
use crate::recording::write_whole;
use crate::report::diagnosis::write;
use crate::report::faults::FaultOf;
use crate::report::html::{ReportContext, diagnosis_page};
use std::io::Write as _;
use std::path::{Path, PathBuf};

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if !(arguments.budget_s.is_finite() && arguments.budget_s > 0.0) {
        let given = arguments.budget_s;
        return Err(bad_input(format!("--budget-s {given}: expected is a number of seconds above zero")));
    }
    match (&arguments.model, &arguments.scenario) {
        (_, Some(scenario)) => super::diagnose_cut::run(&arguments, scenario),
        (Some(model), None) => run_drive(&arguments, model),
        (None, None) => Err(bad_input("expected --model or --scenario")),
    }
}

fn run_drive(arguments: &Arguments, model: &Path) -> anyhow::Result<()> {
    if arguments.recordings.is_empty() {
        return Err(bad_input("--model needs at least one --recording"));
    }
    let machine = read_machine(model).map_err(bad_input)?;
    let axes: Vec<String> = machine.axes.iter().map(|a| a.name.clone()).collect();
    let paths = arguments.recordings.iter().map(PathBuf::as_path);
    let Checked { gated, paths, given, files, faults } = read_checked(paths, &axes)?;
    let masked = gated.iter().map(Gated::masked).collect();
    let resting = gated.iter().map(Gated::resting).collect();
    let clock_moved = gated.iter().map(Gated::moved_in_time).collect();
    let thinned = gated.iter().map(Gated::thinned).collect();
    // Recordings of different loggers have no common mean.
    let first = gated.first().map_or([1; 2], |g| g.averaged);
    let averaged = if gated.iter().all(|g| g.averaged == first) { first } else { [1; 2] };
    let recordings: Vec<_> = gated.into_iter().map(|g| g.recording).collect();
    let budget_s = arguments.budget_s;
    let options = DiagnoseOptions { budget_s, masked, resting, clock_moved, thinned, averaged };
    let work = |progress: Progress<'_>| diagnose_with(&machine, &recordings, &options, progress);
    let diagnosis = with_progress(arguments.progress, work).map_err(|error| {
        let concerned = paths.iter().zip(&recordings).filter(|(_, r)| error.concerns(&r.experiment));
        let concerned: Vec<String> = concerned.map(|(path, _)| path.display().to_string()).collect();
        // What was masked is why too little is left, where all of it would be enough.
        let of = |f: &&FaultOf| {
            let recording = given.iter().zip(&recordings).find(|(of, _)| **of == f.of);
            recording.is_some_and(|(_, r)| error.concerns(&r.experiment))
        };
        let masks = faults.iter().filter(|f| f.fault.action == Action::Mask).filter(of);
        if let DiagnoseError::TooShort { needed, rests: false, .. } = error
            && recordings.iter().any(|r| error.concerns(&r.experiment) && r.len() >= needed)
            && let Some(at) = masks.max_by(|a, b| a.fault.share.total_cmp(&b.fault.share))
        {
            let (recording, Fault { column, kind, statement, .. }) = (&at.recording, &at.fault);
            let (kind, why) = (kind.name(), statement.trim_end_matches('.'));
            return bad_input(format!(
                "{recording}: column {column}: {kind}: {why}; nothing is left to judge"
            ));
        }
        bad_input(if concerned.is_empty() {
            error.to_string()
        } else {
            format!("{}: {error}", concerned.join(", "))
        })
    })?;
    let (looked_at, paths) = (diagnosis.looked_at(&given), diagnosis.looked_at(&paths));
    let (files, left_out) = (diagnosis.looked_at(&files), diagnosis.left_out(&files));
    let mut faults = faults;
    for found in &diagnosis.force_faults {
        let recording = paths[found.recording].display().to_string();
        let told = FaultOf::of_force((looked_at[found.recording], recording), found);
        let same = |f: &FaultOf| {
            f.of == told.of && f.fault.column == told.fault.column && f.fault.kind == told.fault.kind
        };
        faults.retain(|f| !same(f));
        faults.push(told);
    }
    for note in diagnosis.no_evidence.iter().chain(&diagnosis.notes) {
        // Whoever reads standard error may have gone; the files are written all the same.
        let _ = writeln!(std::io::stderr(), "note: {note}");
    }
    write(&arguments.out, &diagnosis, (&files, &left_out), &faults)?;
    let context = ReportContext { machine: machine.name.clone(), files, faults };
    write_whole(&arguments.out.join("report.html"), diagnosis_page(&diagnosis, &context).as_bytes())?;
    Ok(())
}
