//! `stillcut diagnose`.

use super::bad_input;
use super::gated::{Checked, read_checked};
use crate::config::machine::read_machine;
use crate::diagnosis::{DiagnoseOptions, diagnose_with};
use crate::gate::Gated;
use crate::recording::write_whole;
use crate::report::diagnosis::write;
use crate::report::html::{ReportContext, diagnosis_page};
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write as _;
use std::path::PathBuf;

/// Says what physics a machine model leaves out.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The machine's model.
    #[arg(long)]
    model: PathBuf,
    /// A recording of the machine; may be given several times.
    #[arg(long = "recording", required = true)]
    recordings: Vec<PathBuf>,
    /// Folder for diagnosis.json, report.html, model.toml and the contributions.
    #[arg(long)]
    out: PathBuf,
    /// Seconds within which the answer stands: work is counted, so a busy machine answers later, not
    /// differently.
    #[arg(long, default_value_t = 60.0)]
    budget_s: f64,
    /// Write lines `progress SHARE WHAT` to standard error, for programs that watch.
    #[arg(long)]
    progress: bool,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if !(arguments.budget_s.is_finite() && arguments.budget_s > 0.0) {
        let given = arguments.budget_s;
        return Err(bad_input(format!("--budget-s {given}: expected is a number of seconds above zero")));
    }
    let machine = read_machine(&arguments.model).map_err(bad_input)?;
    let axes: Vec<String> = machine.axes.iter().map(|a| a.name.clone()).collect();
    let paths = arguments.recordings.iter().map(PathBuf::as_path);
    let Checked { gated, files, faults } = read_checked(paths, &axes)?;
    let masked = gated.iter().map(Gated::masked).collect();
    let recordings: Vec<_> = gated.into_iter().map(|g| g.recording).collect();
    let bar = ProgressBar::new(100); // drawn on a terminal only
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent:>3} % {msg}") {
        bar.set_style(style);
    }
    let progress = |share: f64, what: &str| {
        bar.set_position((100.0 * share) as u64);
        bar.set_message(what.to_owned());
        if arguments.progress {
            // Whoever watched may have gone; the diagnosis goes on.
            let _ = writeln!(std::io::stderr(), "progress {share:.3} {what}");
        }
    };
    let options = DiagnoseOptions { budget_s: arguments.budget_s, masked };
    let diagnosis = diagnose_with(&machine, &recordings, &options, &progress).map_err(|error| {
        let concerned = files.iter().zip(&recordings).filter(|(_, r)| error.concerns(&r.experiment));
        let concerned: Vec<&str> = concerned.map(|(file, _)| file.as_str()).collect();
        bad_input(if concerned.is_empty() {
            error.to_string()
        } else {
            format!("{}: {error}", concerned.join(", "))
        })
    })?;
    bar.finish_and_clear();
    for note in &diagnosis.notes {
        // Whoever reads standard error may have gone; the files are written all the same.
        let _ = writeln!(std::io::stderr(), "note: {note}");
    }
    write(&arguments.out, &diagnosis, &files, &faults)?;
    let context = ReportContext { machine: machine.name.clone(), files, faults };
    write_whole(&arguments.out.join("report.html"), diagnosis_page(&diagnosis, &context).as_bytes())?;
    Ok(())
}
