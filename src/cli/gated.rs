//! Recordings behind the gate, for every command that reads one of an axis.

use super::bad_input;
use crate::gate::{Criteria, Fault, Gated, Logged, check, rounded_by_one};
use crate::recording::{read_logged, read_recording};
use crate::report::faults::{FaultOf, file_name};
use crate::sample::Recording;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Reads a recording and checks the columns of `axes`.
pub(super) fn read_gated(path: &Path, axes: &[String]) -> anyhow::Result<Gated> {
    let logged = read_logged(path).map_err(bad_input)?;
    Ok(check(&logged, axes, &Criteria::default()))
}

/// Several recordings of one machine: those that can be judged, with what is wrong with all of them.
#[derive(Default)]
pub(super) struct Checked {
    pub(super) gated: Vec<Gated>,
    /// Where those that can be judged lie.
    pub(super) paths: Vec<PathBuf>,
    /// Their places among those that were handed in.
    pub(super) given: Vec<usize>,
    /// Names of their files.
    pub(super) files: Vec<String>,
    pub(super) faults: Vec<FaultOf>,
}

/// Reads and checks recordings. Errors: unreadable ones; all of them are refused.
pub(super) fn read_checked<'a>(
    paths: impl Iterator<Item = &'a Path>,
    axes: &[String],
) -> anyhow::Result<Checked> {
    let paths: Vec<PathBuf> = paths.map(Path::to_owned).collect();
    let mut all: Vec<Gated> = paths.iter().map(|path| read_gated(path, axes)).collect::<Result<_, _>>()?;
    rounded_by_one(&mut all, axes);
    let mut checked = Checked::default();
    let mut refusal = None;
    for (of, (path, gated)) in paths.into_iter().zip(all).enumerate() {
        let recording = path.display().to_string();
        let faults = gated.faults.iter().cloned();
        let faults = faults.map(|fault| FaultOf { of, recording: recording.clone(), fault });
        checked.faults.extend(faults);
        if let Some(fault) = gated.refusal() {
            refusal.get_or_insert_with(|| refused(&path, fault));
            continue;
        }
        checked.given.push(of);
        checked.files.push(file_name(&path));
        checked.paths.push(path);
        checked.gated.push(gated);
    }
    match refusal {
        Some(refusal) if checked.gated.is_empty() => Err(refusal),
        _ => Ok(checked),
    }
}

/// One line with file, column and fault.
fn refused(path: &Path, fault: &Fault) -> anyhow::Error {
    let (file, column, kind) = (path.display(), &fault.column, fault.kind.name());
    bad_input(format!("{file}: column {column}: {kind}: {}", fault.statement.trim_end_matches('.')))
}

/// A recording for an answer of one row a row: what changes no rows is mended where `mended`, all is told on
/// standard error.
/// Errors: unreadable, or rows that are not even.
pub(super) fn read_told(path: &Path, axes: &[String], mended: bool) -> anyhow::Result<Recording> {
    let logged = read_logged(path).map_err(bad_input)?;
    let rows = logged.recording.len();
    let gated = check(&logged, axes, &Criteria::default());
    tell(path, &gated);
    if mended && gated.recording.len() == rows {
        return Ok(gated.recording);
    }
    read_recording(path).map_err(bad_input)
}

/// Tells what is wrong with a recording that is taken as it is.
pub(super) fn tell_of(path: &Path, recording: &Recording) {
    /// Rows of a long recording that are looked at: a quarter of an hour at 1 kHz.
    const MOST_ROWS: usize = 1 << 20;
    let mut head = recording.clone();
    head.columns.iter_mut().for_each(|c| c.values.truncate(MOST_ROWS));
    let axes = head.axes.clone();
    tell(path, &check(&Logged::even(head), &axes, &Criteria::default()));
}

/// Everything that is wrong, on standard error. Whoever wants a force or the live decisions again gets them
/// from the rows as they are: only a diagnosis draws conclusions that such a fault would falsify.
fn tell(path: &Path, gated: &Gated) {
    for fault in &gated.faults {
        // Whoever reads standard error may have gone; the answer is written all the same.
        let _ = writeln!(
            std::io::stderr(),
            "note: {}: {}: {}",
            path.display(),
            fault.kind.name(),
            fault.statement
        );
    }
}
