//! History and recordings in other forms, and a recording played again: work for a thread or process of its
//! own, never for the one that answers.

use super::handle::{Handle, OperationError};
use crate::recording::{RecordingError, StreamedRecording, Table, TableColumn, read_columns, write_table};
use crate::telemetry::Event;
use serde::Serialize;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, mpsc, oneshot};
use utoipa::ToSchema;

/// Rows of a text export that travel at once.
const ROWS: usize = 512;
/// Pieces of an export that may wait for a slow client.
const PIECES: usize = 2;
/// A client that takes nothing for this long is gone.
const PATIENCE: Duration = Duration::from_secs(60);
/// A replay that takes longer is ended.
const LONGEST_REPLAY: Duration = Duration::from_secs(60);

/// A text form of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum TextForm {
    /// One row a sample, the header as contracted.
    Csv,
    /// One object: rate, metadata, and a list for each column.
    Json,
}

/// Frequency and power over the time of a recording, 100 a second.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct TrackView {
    /// Time on the machine's clock, s.
    pub t_s: Vec<f64>,
    /// Strongest line, Hz; null where none stands out.
    pub frequency_hz: Vec<Option<f64>>,
    /// Its power, N2.
    pub power_n2: Vec<f64>,
    /// Whether chatter is declared.
    pub chatter: Vec<bool>,
}

/// A recording through the pipeline again.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct ReplayView {
    /// The recording.
    pub id: String,
    /// What the pipeline declares, as `stillcut replay` writes it.
    pub events: Vec<serde_json::Value>,
    /// What it hears.
    pub track: TrackView,
}

/// A folder that goes when it is dropped.
struct Scratch(PathBuf);

impl Scratch {
    fn new(below: &Path) -> std::io::Result<Self> {
        let path = below.join(format!(".export-{}", super::clock::new_id()));
        std::fs::create_dir_all(&path)?;
        Ok(Self(path))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0); // what stays is a hidden folder of a few kilobytes
    }
}

/// Runs blocking work; a panic in it is an answer.
pub(super) async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, String> + Send + 'static,
) -> Result<T, OperationError> {
    let done = tokio::task::spawn_blocking(work).await;
    done.unwrap_or_else(|e| Err(e.to_string())).map_err(OperationError::Unsuitable)
}

impl Handle {
    /// These events as a Parquet file. Errors: the disk refuses.
    pub async fn events_parquet(&self, events: Vec<Event>) -> Result<Vec<u8>, OperationError> {
        let below = self.0.settings.history.folder.clone();
        blocking(move || {
            let scratch = Scratch::new(&below).map_err(|e| format!("{}: {e}", below.display()))?;
            let path = scratch.0.join("events.parquet");
            write_events(&path, &events)?;
            std::fs::read(&path).map_err(|e| format!("{}: {e}", path.display()))
        })
        .await
    }

    /// A recording as text, piece by piece. `seat` is given back when the work ends, whether or not somebody
    /// still listens. Errors: there is none of that name, or it cannot be read.
    pub async fn recording_text(
        &self,
        id: &str,
        form: TextForm,
        seat: OwnedSemaphorePermit,
    ) -> Result<mpsc::Receiver<std::io::Result<Vec<u8>>>, OperationError> {
        let path = self.recording_file(id).await?;
        let (send, receive) = mpsc::channel(PIECES);
        let (opened, told) = oneshot::channel();
        let runtime = tokio::runtime::Handle::current();
        tokio::task::spawn_blocking(move || {
            let _seat = seat;
            let recording = match StreamedRecording::open(&path) {
                Ok(recording) => recording,
                Err(error) => return drop(opened.send(Err(error.to_string()))),
            };
            if opened.send(Ok(())).is_err() {
                return; // the asker is gone
            }
            let put = |piece: std::io::Result<Vec<u8>>| {
                let sent = async { tokio::time::timeout(PATIENCE, send.send(piece)).await };
                matches!(runtime.block_on(sent), Ok(Ok(())))
            };
            let text = |text: String| put(Ok(text.into_bytes()));
            let outcome = match form {
                TextForm::Csv => csv_pieces(&recording, text),
                TextForm::Json => json_pieces(&recording, text),
            };
            if let Err(error) = outcome {
                tracing::warn!(event = "export_broke_off", "{error}");
                put(Err(std::io::Error::other(error.to_string())));
            }
        });
        let told = told.await.unwrap_or_else(|e| Err(e.to_string()));
        told.map(|()| receive).map_err(OperationError::Unsuitable)
    }

    /// A recording through the pipeline again, in a process of its own at low priority, with the
    /// configuration in force. The process ends with the asker and with the service; `seat` is given back
    /// after it. Errors: there is none of that name; one line why it cannot be played.
    pub async fn replay(&self, id: &str, seat: OwnedSemaphorePermit) -> Result<ReplayView, OperationError> {
        let (recording, id) = (self.recording_file(id).await?, id.to_owned());
        let settings = &self.0.settings;
        let (below, config) = (settings.history.folder.clone(), settings.file.clone());
        let program = self.diagnoses().program().to_owned();
        let ended = self.stopping().child_token();
        let _asker = ended.clone().drop_guard();
        blocking(move || {
            let _seat = seat;
            let scratch = Scratch::new(&below).map_err(|e| format!("{}: {e}", below.display()))?;
            let go_on = || !ended.is_cancelled();
            run_replay((&program, config.as_deref()), &recording, &scratch.0, go_on)?;
            read_replay(id, &scratch.0)
        })
        .await
    }
}

fn write_events(path: &Path, events: &[Event]) -> Result<(), String> {
    let integers = |of: fn(&Event) -> i64| events.iter().map(of).collect::<Vec<_>>();
    let texts = |of: fn(&Event) -> String| events.iter().map(of).collect::<Vec<_>>();
    let numbers = |of: fn(&Event) -> Option<f64>| events.iter().map(of).collect::<Vec<_>>();
    let (sequence, time_ns) = (integers(|e| e.sequence), integers(|e| e.wall_ns));
    let id = texts(|e| e.id.clone());
    let kind = texts(|e| e.kind.word().to_owned());
    let severity = texts(|e| e.kind.severity().word().to_owned());
    let axis = texts(|e| e.axis.clone().unwrap_or_default());
    let text = texts(|e| e.text.clone());
    let by = texts(|e| e.acknowledged_by.clone().unwrap_or_default());
    let at = texts(|e| e.acknowledged_ns.map_or_else(String::new, super::clock::rfc3339));
    let (t_s, frequency_hz) = (numbers(|e| e.t_s), numbers(|e| e.frequency_hz));
    let (power_n2, pitch) = (numbers(|e| e.power_n2), numbers(|e| e.pitch_difference_rad));
    let columns = vec![
        ("sequence", TableColumn::Integer(&sequence)),
        ("time_ns", TableColumn::Integer(&time_ns)),
        ("id", TableColumn::Text(&id)),
        ("kind", TableColumn::Text(&kind)),
        ("severity", TableColumn::Text(&severity)),
        ("axis", TableColumn::Text(&axis)),
        ("t_s", TableColumn::OptionalDouble(&t_s)),
        ("frequency_hz", TableColumn::OptionalDouble(&frequency_hz)),
        ("power_n2", TableColumn::OptionalDouble(&power_n2)),
        ("pitch_difference_rad", TableColumn::OptionalDouble(&pitch)),
        ("text", TableColumn::Text(&text)),
        ("acknowledged_by", TableColumn::Text(&by)),
        ("acknowledged_at", TableColumn::Text(&at)),
    ];
    let metadata = vec![("format".to_owned(), "stillcut.history/1".to_owned())];
    write_table(path, &Table { columns, metadata }).map_err(|e| e.to_string())
}

/// The recording as CSV, which every command reads as it reads Parquet.
fn csv_pieces(
    recording: &StreamedRecording,
    mut put: impl FnMut(String) -> bool,
) -> Result<(), RecordingError> {
    let head = recording.head();
    let names: Vec<&str> = head.columns.iter().map(|c| c.name.as_str()).collect();
    let mut text = format!("t_s,{}\n", names.join(","));
    let rate_hz = head.sample_rate.hz();
    recording.rows(ROWS, &mut |first, columns| {
        for row in 0..columns.first().map_or(0, Vec::len) {
            let _ = write!(text, "{}", head.start_s + (first + row) as f64 / rate_hz);
            for values in columns {
                let _ = write!(text, ",{}", values[row]);
            }
            text.push('\n');
        }
        put(std::mem::take(&mut text))
    })
}

fn json_pieces(
    recording: &StreamedRecording,
    mut put: impl FnMut(String) -> bool,
) -> Result<(), RecordingError> {
    // What makes a replay repeatable is for replays; a reader of JSON wants signals.
    let told = recording.head();
    let plain = told.metadata.iter().filter(|(_, value)| value.len() < 1000);
    let metadata: serde_json::Map<String, serde_json::Value> =
        plain.map(|(k, v)| (k.clone(), v.as_str().into())).collect();
    let head = serde_json::json!({
        "sample_rate_hz": told.sample_rate.hz(), "start_s": told.start_s,
        "experiment": told.experiment, "axes": told.axes, "metadata": metadata,
    });
    let mut text = head.to_string();
    text.pop();
    text.push_str(",\"columns\":{");
    for (index, column) in told.columns.iter().enumerate() {
        let comma = if index == 0 { "" } else { "," };
        let _ = write!(text, "{comma}{}:[", serde_json::Value::from(column.name.as_str()));
        let mut wanted = true;
        recording.column(index, 16 * ROWS, &mut |first, values| {
            for (row, value) in values.iter().enumerate() {
                let comma = if first + row == 0 { "" } else { "," };
                let _ = write!(text, "{comma}{value:?}");
            }
            wanted = put(std::mem::take(&mut text));
            wanted
        })?;
        if !wanted {
            return Ok(());
        }
        text.push(']');
    }
    text.push_str("}}\n");
    put(text);
    Ok(())
}

/// Blocks until the replay has ended, or ends it when it is not to go on. Errors: its last line.
fn run_replay(
    (program, config): (&Path, Option<&Path>),
    recording: &Path,
    out: &Path,
    go_on: impl Fn() -> bool,
) -> Result<(), String> {
    let mut command = Command::new("nice");
    command.arg("-n").arg("5").arg(program).arg("replay").arg("--recording").arg(recording);
    command.arg("--out").arg(out).stdin(Stdio::null()).stdout(Stdio::null());
    if let Some(config) = config {
        command.arg("--config").arg(config);
    }
    let errors = out.join("stderr.txt");
    let log = std::fs::File::create(&errors).map_err(|e| format!("{}: {e}", errors.display()))?;
    let mut child = command.stderr(log).spawn().map_err(|e| format!("cannot start the replay: {e}"))?;
    super::priority::first_to_go(&child);
    let began = super::clock::now();
    let status = loop {
        match child.try_wait().map_err(|e| e.to_string())? {
            Some(status) => break status,
            None if began.elapsed() > LONGEST_REPLAY || !go_on() => {
                let _ = child.kill();
                let _ = child.wait();
                let what =
                    "the replay was ended: a minute is over, nobody waits for it, or the service stops";
                return Err(what.to_owned());
            }
            None => super::clock::sleep(Duration::from_millis(20)),
        }
    };
    if status.success() {
        return Ok(());
    }
    let said = std::fs::read_to_string(&errors).unwrap_or_default();
    Err(said.lines().last().unwrap_or("the replay failed").to_owned())
}

fn read_replay(id: String, folder: &Path) -> Result<ReplayView, String> {
    let path = folder.join("events.jsonl");
    let text = std::fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
    let lines: Result<Vec<serde_json::Value>, _> = text.lines().map(serde_json::from_str).collect();
    let events = lines.map_err(|e| format!("{}: {e}", path.display()))?;
    let columns = read_columns(&folder.join("track.parquet")).map_err(|e| e.to_string())?;
    let take = |name: &str| {
        let found = columns.iter().find(|(n, _)| n == name).map(|(_, values)| values.clone());
        found.ok_or_else(|| format!("track.parquet has no column {name}"))
    };
    let track = TrackView {
        t_s: take("t_s")?,
        frequency_hz: take("frequency_hz")?.into_iter().map(|f| f.is_finite().then_some(f)).collect(),
        power_n2: take("power_n2")?,
        chatter: take("chatter")?.into_iter().map(|c| c != 0.0).collect(),
    };
    Ok(ReplayView { id, events, track })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{read_recording, write_recording};
    use crate::sample::{Column, Recording};
    use crate::telemetry::EventKind;
    use crate::units::SampleRate;

    /// A recording in a file of that folder.
    fn stored(folder: &Path) -> (Recording, StreamedRecording) {
        let values = (0..20_000).map(|k| f64::from(k) * 0.125).collect();
        let recording = Recording {
            sample_rate: SampleRate::new(1000.0).unwrap(),
            experiment: "e".into(),
            axes: vec!["x".into()],
            columns: vec![Column { name: "x_force_n".into(), values }],
            start_s: 3.0,
            metadata: vec![("analysis_band_hz".into(), "1,2".into()), ("long".into(), "x".repeat(2000))],
        };
        let path = folder.join("stored.parquet");
        write_recording(&path, &recording).unwrap();
        (recording, StreamedRecording::open(&path).unwrap())
    }

    #[test]
    fn text_forms_give_every_value_back() {
        let folder = tempfile::tempdir().unwrap();
        let (recording, streamed) = stored(folder.path());
        let (mut text, mut longest) = (String::new(), 0);
        csv_pieces(&streamed, |piece| {
            longest = longest.max(piece.len());
            text += &piece;
            true
        })
        .unwrap();
        assert!(longest < 64 * ROWS, "{longest} bytes at once");
        let path = folder.path().join("r.csv");
        std::fs::write(&path, &text).unwrap();
        let back = read_recording(&path).unwrap();
        assert_eq!(back.columns, recording.columns);
        assert!((back.start_s - 3.0).abs() < 1e-12);
        let mut text = String::new();
        json_pieces(&streamed, |piece| {
            text += &piece;
            true
        })
        .unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["columns"]["x_force_n"].as_array().unwrap().len(), 20_000);
        assert_eq!(json["columns"]["x_force_n"][1999], 249.875);
        assert_eq!(json["metadata"].as_object().unwrap().len(), 1, "what only replays need stays out");
    }

    #[test]
    fn a_client_that_is_gone_ends_the_export() {
        let folder = tempfile::tempdir().unwrap();
        let (_, streamed) = stored(folder.path());
        let mut pieces = 0;
        let mut gone = |_: String| {
            pieces += 1;
            false
        };
        csv_pieces(&streamed, &mut gone).unwrap();
        json_pieces(&streamed, &mut gone).unwrap();
        assert_eq!(pieces, 2);
    }

    #[test]
    fn a_damaged_recording_breaks_off_or_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        stored(folder.path());
        let whole = std::fs::read(folder.path().join("stored.parquet")).unwrap();
        let path = folder.path().join("damaged.parquet");
        for place in (4..whole.len() / 2).step_by(whole.len() / 60) {
            let mut bytes = whole.clone();
            bytes[place..place + 3].fill(0xa5);
            std::fs::write(&path, &bytes).unwrap();
            // What is read is complete, or an error says that it is not.
            let Ok(streamed) = StreamedRecording::open(&path) else { continue };
            let mut lines = 0;
            let outcome = csv_pieces(&streamed, |piece| {
                lines += piece.lines().count();
                true
            });
            assert!(outcome.is_err() || lines == 20_001, "byte {place}: {lines} lines");
        }
    }

    #[test]
    fn events_as_parquet_keep_their_numbers() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("e.parquet");
        let mut event = Event::new(EventKind::ChatterOnset, 5, "chatter began");
        (event.sequence, event.frequency_hz) = (9, Some(652.0));
        write_events(&path, &[event.clone(), Event { sequence: 10, frequency_hz: None, ..event }]).unwrap();
        let columns = read_columns(&path).unwrap();
        let column = |name: &str| columns.iter().find(|(n, _)| n == name).unwrap().1.clone();
        assert_eq!(column("sequence"), [9.0, 10.0]);
        assert!(column("frequency_hz")[0] == 652.0 && column("frequency_hz")[1].is_nan());
    }
}
