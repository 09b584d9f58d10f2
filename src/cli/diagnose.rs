//! `stillcut diagnose`.

use super::bad_input;
use super::gated::{Checked, read_checked};
use crate::config::machine::read_machine;
use crate::diagnosis::{DiagnoseError, DiagnoseOptions, Progress, diagnose_with};
use crate::gate::{Action, Fault, Gated};
use crate::recording::write_whole;
use crate::report::diagnosis::write;
use crate::report::faults::FaultOf;
use crate::report::html::{ReportContext, diagnosis_page};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Says what physics a machine model, or the scenario of a cut, leaves out.
///
/// Example: stillcut diagnose --scenario lathe.toml --recording entry.parquet --cuts cuts.csv --out answer
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The machine's model: what does the drive leave out?
    #[arg(long, conflicts_with = "scenario", required_unless_present = "scenario")]
    model: Option<PathBuf>,
    /// The scenario of a cut: what does the cut leave out?
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// A recording of the machine; may be given several times.
    #[arg(long = "recording")]
    pub(super) recordings: Vec<PathBuf>,
    /// A table of cuts (stillcut.cuts/1, Parquet or CSV), beside the recordings or instead of them.
    #[arg(long, requires = "scenario")]
    pub(super) cuts: Option<PathBuf>,
    /// Folder for diagnosis.json, report.html, model.toml (scenario.toml) and the contributions.
    #[arg(long)]
    pub(super) out: PathBuf,
    /// Seconds within which the answer stands: work is counted, so a busy machine answers later, not
    /// differently.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    pub(super) budget_s: f64,
    /// Print the smallest set of cuts that would tell the alternatives apart.
    #[arg(long, requires = "scenario")]
    pub(super) plan: bool,
    /// Write lines `progress SHARE WHAT` to standard error, for programs that watch.
    #[arg(long)]
    pub(super) progress: bool,
}

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

/// Runs `work` with a bar on a terminal, and lines for a program that watches.
pub(super) fn with_progress<T>(lines: bool, work: impl FnOnce(Progress<'_>) -> T) -> T {
    let bar = ProgressBar::new(100); // drawn on a terminal only
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent:>3} % {msg}") {
        bar.set_style(style);
    }
    let progress = |share: f64, what: &str| {
        bar.set_position((100.0 * share) as u64);
        bar.set_message(what.to_owned());
        if lines {
            // Whoever watched may have gone; the diagnosis goes on.
            let _ = writeln!(std::io::stderr(), "progress {share:.3} {what}");
        }
    };
    let out = work(&progress);
    bar.finish_and_clear();
    out
}

fn run_drive(arguments: &Arguments, model: &Path) -> anyhow::Result<()> {
    if arguments.recordings.is_empty() {
        return Err(bad_input("--model needs at least one --recording"));
    }
    let machine = read_machine(model).map_err(bad_input)?;
    let axes: Vec<String> = machine.axes.iter().map(|a| a.name.clone()).collect();
    let paths = arguments.recordings.iter().map(PathBuf::as_path);
    let Checked { gated, paths, files, faults } = read_checked(paths, &axes)?;
    let masked = gated.iter().map(Gated::masked).collect();
    let resting = gated.iter().map(Gated::resting).collect();
    let clock_moved = gated.iter().any(Gated::moved_in_time);
    // Recordings of different loggers have no common mean.
    let first = gated.first().map_or([1; 2], |g| g.averaged);
    let averaged = if gated.iter().all(|g| g.averaged == first) { first } else { [1; 2] };
    let recordings: Vec<_> = gated.into_iter().map(|g| g.recording).collect();
    let options = DiagnoseOptions { budget_s: arguments.budget_s, masked, resting, clock_moved, averaged };
    let work = |progress: Progress<'_>| diagnose_with(&machine, &recordings, &options, progress);
    let diagnosis = with_progress(arguments.progress, work).map_err(|error| {
        let concerned = paths.iter().zip(&recordings).filter(|(_, r)| error.concerns(&r.experiment));
        let concerned: Vec<String> = concerned.map(|(path, _)| path.display().to_string()).collect();
        // What was masked is why too little is left.
        if let DiagnoseError::TooShort { .. } = error
            && let Some(at) = faults.iter().find(|f| f.fault.action == Action::Mask)
        {
            let (file, Fault { column, kind, statement, .. }) = (&at.recording, &at.fault);
            let (kind, why) = (kind.name(), statement.trim_end_matches('.'));
            return bad_input(format!("{file}: column {column}: {kind}: {why}; nothing is left to judge"));
        }
        bad_input(if concerned.is_empty() {
            error.to_string()
        } else {
            format!("{}: {error}", concerned.join(", "))
        })
    })?;
    let (files, left_out) = (diagnosis.looked_at(&files), diagnosis.left_out(&files));
    let mut faults = faults;
    for found in &diagnosis.force_faults {
        let told = FaultOf::of_force(files[found.recording].clone(), found);
        let same = |f: &FaultOf| {
            f.recording == told.recording
                && f.fault.column == told.fault.column
                && f.fault.kind == told.fault.kind
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

pub(super) fn name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}
