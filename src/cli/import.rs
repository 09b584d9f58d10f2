//! `stillcut import`: a foreign file into a recording.

use super::bad_input;
use crate::config::import_map::read_import_map;
use crate::recording::{import, write_recording};
use crate::units::counted;
use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;

/// Turns a foreign CSV, Parquet or MAT file into a recording.
///
/// The map names each column, its unit and the signal it is; the rate is checked, and irregular times
/// are put on a uniform grid where the map asks for it. Examples stand in config/import.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// What the columns are.
    #[arg(long)]
    map: PathBuf,
    /// The foreign file.
    file: PathBuf,
    /// Recording to write.
    #[arg(long)]
    out: PathBuf,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let map = read_import_map(&arguments.map).map_err(bad_input)?;
    let recording = import(&arguments.file, &map).map_err(bad_input)?;
    write_recording(&arguments.out, &recording).map_err(bad_input)?;
    let mut console = std::io::stderr();
    if console.is_terminal() {
        let seconds = recording.len() as f64 * recording.sample_rate.period_s();
        writeln!(
            console,
            "{}: {} at {} Hz ({seconds:.2} s), axes {}",
            arguments.out.display(),
            counted(recording.len(), "sample"),
            recording.sample_rate.hz(),
            recording.axes.join(", ")
        )?;
    }
    Ok(())
}
