//! `stillcut diagnose`.

use super::bad_input;
use crate::config::machine::read_machine;
use crate::recording::read_recording;
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
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let machine = read_machine(&arguments.model).map_err(bad_input)?;
    let recordings = arguments
        .recordings
        .iter()
        .map(|p| read_recording(p).map_err(bad_input))
        .collect::<Result<Vec<_>, _>>()?;
    let diagnosis = crate::diagnosis::diagnose(&machine, &recordings, &|_, _| {}).map_err(bad_input)?;
    let _ = diagnosis;
    Ok(())
}
