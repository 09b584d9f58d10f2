//! Recordings as files: Parquet and CSV to a [`Recording`] and back (contracts, section 1).
//!
//! Reading refuses, with file, column and row, whatever is not a uniformly sampled set of finite
//! numbers. Writing goes beside the target and is renamed: a file is there whole or not at all.

mod csv_file;
mod cuts;
mod evidence;
mod foreign;
mod mat_file;
mod parquet_file;
mod parquet_guard;
mod quiet;
mod streamed;

use crate::config::in_one_line;
use crate::gate::Logged;
use crate::sample::{Column, Recording};
use crate::units::{SampleRate, counted};
use std::collections::BTreeSet;
use std::fs::File;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use thiserror::Error;

pub use cuts::{CUTS_FORMAT, read_cuts};
pub use evidence::{Evidence, EvidenceError};
pub use foreign::import;
pub use parquet_file::{Table, TableColumn, write_table};
pub use streamed::StreamedRecording;

/// Why a recording cannot be read or written. One line: file, column, first bad row.
#[derive(Debug, Error)]
pub enum RecordingError {
    /// The system refused.
    #[error("recording {}: {source}", path.display())]
    Io {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not a file of this kind, or damaged.
    #[error("{}: {}", path.display(), in_one_line(message))]
    Format {
        /// File.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A value that cannot be used.
    #[error("{}: column {}, row {row}: {}", path.display(), in_one_line(column), in_one_line(message))]
    Value {
        /// File.
        path: PathBuf,
        /// Column.
        column: String,
        /// Row, from 0.
        row: usize,
        /// What is wrong and what was expected.
        message: String,
    },
}

/// What a file holds before it is checked.
pub(crate) struct RawTable {
    pub(crate) columns: Vec<(String, Vec<f64>)>,
    pub(crate) metadata: Vec<(String, String)>,
}

/// The word that a recording's metadata carries under `format`.
pub const FORMAT: &str = "stillcut.recording/1";

const OWN_KEYS: [&str; 4] = ["format", "sample_rate_hz", "experiment", "axes"];

/// Reads a recording, Parquet or CSV by its extension, for whoever needs even rows.
/// Errors: as of [`read_logged`], and rows that are not uniformly sampled.
pub fn read_recording(path: &Path) -> Result<Recording, RecordingError> {
    let logged = read_logged(path)?;
    check_even(path, &logged)?;
    Ok(logged.recording)
}

/// Reads a recording with the time stamps of its rows, for the gate ([`crate::gate`]).
/// Errors: unreadable file, no time or rate, a value that is not finite, a time that does not grow.
pub fn read_logged(path: &Path) -> Result<Logged, RecordingError> {
    let is_csv = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    let raw = if is_csv { csv_file::read(path)? } else { parquet_file::read(path)? };
    if !is_csv && !raw.metadata.iter().any(|(key, _)| key == "sample_rate_hz") {
        let message = "no sampling rate: metadata sample_rate_hz is missing".to_owned();
        return Err(RecordingError::Format { path: path.to_owned(), message });
    }
    logged_from_raw(path, raw)
}

/// Names and values of the numeric columns of any Parquet table; what is missing is NaN.
/// Errors: unreadable or damaged file.
pub fn read_columns(path: &Path) -> Result<Vec<(String, Vec<f64>)>, RecordingError> {
    parquet_file::read(path).map(|raw| raw.columns)
}

fn logged_from_raw(path: &Path, raw: RawTable) -> Result<Logged, RecordingError> {
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    let meta = |key: &str| meta_of(&raw.metadata, key);
    let stated = stated_rate(path, &raw.metadata)?;
    if let Some((name, _)) = raw.columns.iter().find(|(n, _)| n.contains(char::is_control)) {
        return Err(format_error(format!("column name `{}` holds control characters", name.escape_debug())));
    }
    no_name_twice(path, raw.columns.iter().map(|(name, _)| name.as_str()))?;
    let mut columns = Vec::new();
    let mut times = None;
    for (name, values) in raw.columns {
        if let Some(row) = values.iter().position(|v| !v.is_finite()) {
            let message = format!("{} is not a finite number", values[row]);
            return Err(RecordingError::Value { path: path.to_owned(), column: name, row, message });
        }
        if name == "t_s" {
            times = Some(values);
        } else {
            columns.push(Column { name, values });
        }
    }
    let times = times.ok_or_else(|| format_error("required column t_s is missing".into()))?;
    if columns.is_empty() {
        return Err(format_error("there is no signal beside t_s".into()));
    }
    if times.len() < 2 {
        return Err(format_error(format!("{}; at least 2 are needed", counted(times.len(), "row"))));
    }
    let sample_rate = check_times(path, &times, stated)?;
    let recording = Recording {
        sample_rate,
        experiment: meta("experiment").unwrap_or_else(|| stem(path)),
        axes: axes_of(&raw.metadata, &columns),
        start_s: times[0],
        columns,
        metadata: raw.metadata.into_iter().filter(|(k, _)| !OWN_KEYS.contains(&k.as_str())).collect(),
    };
    Ok(Logged { recording, times_s: times })
}

fn meta_of(metadata: &[(String, String)], key: &str) -> Option<String> {
    metadata.iter().find(|(k, _)| k == key).map(|(_, v)| v.clone())
}

/// The sampling rate that the metadata state. Errors: another format, or a rate that is none.
fn stated_rate(path: &Path, metadata: &[(String, String)]) -> Result<Option<SampleRate>, RecordingError> {
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    if let Some(format) = meta_of(metadata, "format")
        && format != FORMAT
    {
        let found = format.escape_debug();
        return Err(format_error(format!("metadata format is `{found}`, expected `{FORMAT}`")));
    }
    let Some(text) = meta_of(metadata, "sample_rate_hz") else { return Ok(None) };
    let parsed = text.trim().parse::<f64>().ok().and_then(|hz| SampleRate::new(hz).ok());
    let wrong = || {
        let found = text.escape_debug();
        format_error(format!("metadata sample_rate_hz is `{found}`, expected a number above zero"))
    };
    parsed.map(Some).ok_or_else(wrong)
}

/// Times must grow, by the stated period in the median. The rate: the stated one, else that of the steps
/// without gaps.
fn check_times(path: &Path, times: &[f64], stated: Option<SampleRate>) -> Result<SampleRate, RecordingError> {
    /// Steps of more medians are gaps and say nothing of the rate.
    const GAP: f64 = 1.5;
    if let Some(row) = times.windows(2).position(|w| w[1] <= w[0]) {
        let (before, after) = (times[row], times[row + 1]);
        return Err(bad_time(
            path,
            row + 1,
            format!("time runs from {before} to {after} s, expected to grow"),
        ));
    }
    let mut steps: Vec<f64> = times.windows(2).map(|w| w[1] - w[0]).collect();
    let middle = steps.len() / 2;
    let usual_s = *steps.select_nth_unstable_by(middle, f64::total_cmp).1;
    let Some(rate) = stated else {
        steps.retain(|s| *s <= GAP * usual_s);
        return SampleRate::new(steps.len() as f64 / steps.iter().sum::<f64>())
            .map_err(|e| RecordingError::Format { path: path.to_owned(), message: e.to_string() });
    };
    if (usual_s / rate.period_s() - 1.0).abs() > OFF_GRID {
        let period_s = rate.period_s();
        let row = times.windows(2).position(|w| off_grid(w, period_s)).unwrap_or(0);
        return Err(bad_time(path, row + 1, not_uniform(times[row + 1] - times[row], period_s)));
    }
    Ok(rate)
}

/// Neighbours may jitter; a hole of more than half a sample is not uniform sampling.
const OFF_GRID: f64 = 0.5;

fn off_grid(times: &[f64], period_s: f64) -> bool {
    ((times[1] - times[0]) / period_s - 1.0).abs() > OFF_GRID
}

fn not_uniform(step_s: f64, period_s: f64) -> String {
    format!("step of {step_s:.6e} s where {period_s:.6e} s were expected: not uniformly sampled")
}

fn bad_time(path: &Path, row: usize, message: String) -> RecordingError {
    RecordingError::Value { path: path.to_owned(), column: "t_s".into(), row, message }
}

/// The largest deviation of a step from the period is half a sample.
fn check_even(path: &Path, logged: &Logged) -> Result<(), RecordingError> {
    let (times, period_s) = (&logged.times_s, logged.recording.sample_rate.period_s());
    let Some(row) = times.windows(2).position(|w| off_grid(w, period_s)) else { return Ok(()) };
    Err(bad_time(path, row + 1, not_uniform(times[row + 1] - times[row], period_s)))
}

/// Columns are found by their names.
fn no_name_twice<'a>(path: &Path, names: impl Iterator<Item = &'a str>) -> Result<(), RecordingError> {
    let mut seen = BTreeSet::new();
    for name in names {
        if !seen.insert(name) {
            let message = format!("column `{}` is there twice", name.escape_debug());
            return Err(RecordingError::Format { path: path.to_owned(), message });
        }
    }
    Ok(())
}

/// The axes that the metadata name, or else those that the columns belong to.
fn axes_of(metadata: &[(String, String)], columns: &[Column]) -> Vec<String> {
    if let Some(text) = meta_of(metadata, "axes") {
        return text.split(',').map(|a| a.trim().to_owned()).filter(|a| !a.is_empty()).collect();
    }
    const SUFFIXES: [&str; 9] = [
        "_current_ref_a",
        "_torque_ref_nm",
        "_thrust_ref_n",
        "_motor_angle_rad",
        "_motor_position_m",
        "_stage_position_m",
        "_position_cmd_m",
        "_force_n",
        "_accel_m_s2",
    ];
    let mut axes: Vec<String> = Vec::new();
    for column in columns {
        if let Some(axis) = SUFFIXES.iter().find_map(|s| column.name.strip_suffix(s))
            && !axes.iter().any(|a| a == axis)
        {
            axes.push(axis.to_owned());
        }
    }
    axes
}

fn stem(path: &Path) -> String {
    path.file_stem().map_or_else(String::new, |s| s.to_string_lossy().into_owned())
}

/// Writes a recording as Parquet, whole or not at all.
pub fn write_recording(path: &Path, recording: &Recording) -> Result<(), RecordingError> {
    let head = Head {
        sample_rate: recording.sample_rate,
        experiment: &recording.experiment,
        axes: &recording.axes,
        start_s: recording.start_s,
        rows: recording.len(),
    };
    let names: Vec<String> = recording.columns.iter().map(|c| c.name.clone()).collect();
    let fill = &mut |index: usize, out: &mut Vec<f64>| {
        out.extend_from_slice(recording.columns.get(index).map_or(&[], |c| &c.values));
    };
    write_by_column(path, &head, (names, recording.metadata.clone()), fill)
}

/// What a recording says beside its columns.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Head<'a> {
    pub(crate) sample_rate: SampleRate,
    pub(crate) experiment: &'a str,
    pub(crate) axes: &'a [String],
    pub(crate) start_s: f64,
    pub(crate) rows: usize,
}

/// Writes a recording as Parquet, whole or not at all, with one column in memory at a time: `fill` appends
/// the values of the column with that index to an empty list.
pub(crate) fn write_by_column(
    path: &Path,
    head: &Head<'_>,
    (mut names, own): (Vec<String>, Vec<(String, String)>),
    fill: &mut dyn FnMut(usize, &mut Vec<f64>),
) -> Result<(), RecordingError> {
    let mut metadata = vec![
        ("format".to_owned(), FORMAT.to_owned()),
        ("sample_rate_hz".to_owned(), format!("{:?}", head.sample_rate.hz())),
        ("experiment".to_owned(), head.experiment.to_owned()),
        ("axes".to_owned(), head.axes.join(",")),
    ];
    metadata.extend(own);
    names.insert(0, "t_s".to_owned());
    parquet_file::write_doubles(path, (&names, metadata), &mut |index, out| match index {
        0 => out.extend((0..head.rows).map(|i| head.start_s + i as f64 / head.sample_rate.hz())),
        _ => fill(index - 1, out),
    })
}

/// Writes `bytes` beside `path` and renames: the file is there whole or not at all.
pub fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), RecordingError> {
    let io = |source| RecordingError::Io { path: path.to_owned(), source };
    let part = beside(path);
    // What an earlier process left there, or a link that somebody put there, is not written through.
    let _ = std::fs::remove_file(&part);
    let written = File::create_new(&part)
        .and_then(|mut file| file.write_all(bytes).and_then(|()| file.sync_all()))
        .and_then(|()| std::fs::rename(&part, path));
    if written.is_err() {
        let _ = std::fs::remove_file(&part);
    }
    written.map_err(io)
}

/// A name beside `path` for what is not whole yet, another one each time.
pub(crate) fn beside(path: &Path) -> PathBuf {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    path.with_file_name(format!(".{name}.{}.{count}.part", std::process::id()))
}
