//! Writes black-box recordings on a thread of its own: slow disks are nobody else's problem.

use super::black_box::{Chunk, Heard, last_unbroken, samples, signals};
use super::clock;
use super::ledger::{Page, pages_since};
use super::recordings::{RecordingLimits, Recordings};
use crate::avoidance::account::Account;
use crate::recording::{Evidence, Head, RecordingError, write_by_column};
use crate::report::events::{EventLine, events_text};
use crate::telemetry::{EventKind, Metrics};
use crate::units::{SampleRate, counted};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

/// What is to be written.
#[derive(Debug)]
pub(super) struct Job {
    pub(super) id: String,
    pub(super) reason: String,
    pub(super) chunks: Vec<Arc<Chunk>>,
    pub(super) sample_rate: SampleRate,
    pub(super) axes: Vec<String>,
    pub(super) metadata: Vec<(String, String)>,
    /// Digest of the pipeline's settings.
    pub(super) settings: u64,
    /// Digest of the settings of the turret decision.
    pub(super) turret_settings: u64,
    /// Looks at the turret decision, oldest first.
    pub(super) pages: Vec<Arc<Page>>,
}

/// How it went, for the history.
pub(super) type Outcome = Box<dyn Fn(EventKind, String) + Send>;

/// Jobs that may wait; a burst of events shares recordings anyway.
const WAITING: usize = 4;
/// Recordings shorter than this are worth nothing.
const SHORTEST: usize = 100;

/// Starts the thread. It ends when all senders are gone.
pub(super) fn start(
    recordings: Recordings,
    limits: RecordingLimits,
    metrics: Arc<Metrics>,
    outcome: Outcome,
) -> std::io::Result<(SyncSender<Job>, std::thread::JoinHandle<()>)> {
    let (send, jobs) = sync_channel(WAITING);
    let thread = std::thread::Builder::new().name("recorder".into()).spawn(move || {
        super::priority::step_back();
        metrics.stage_up.with_label_values(&["recorder"]).set(1);
        work(&jobs, &recordings, limits, (&metrics, &outcome));
        metrics.stage_up.with_label_values(&["recorder"]).set(0);
    })?;
    Ok((send, thread))
}

fn work(
    jobs: &Receiver<Job>,
    recordings: &Recordings,
    limits: RecordingLimits,
    (metrics, outcome): (&Metrics, &Outcome),
) {
    while let Ok(job) = jobs.recv() {
        match save(recordings, &job) {
            Ok(seconds) => {
                metrics.recordings.with_label_values(&["saved"]).inc();
                metrics.stage_up.with_label_values(&["recorder"]).set(1);
                outcome(
                    EventKind::RecordingSaved,
                    format!("{seconds:.1} s saved as {} ({})", job.id, job.reason),
                );
            }
            Err(Unsaved::TooShort(what)) => {
                metrics.recordings.with_label_values(&["too_short"]).inc();
                tracing::info!(event = "recording_too_short", "{what}");
            }
            Err(Unsaved::Failed(error)) => {
                metrics.recordings.with_label_values(&["failed"]).inc();
                metrics.stage_up.with_label_values(&["recorder"]).set(0);
                outcome(EventKind::RecordingFailed, error);
            }
        }
        // Here for their size alone: whether the wall clock can be believed is known to the upkeep.
        let limits = RecordingLimits { max_age_ns: i64::MAX, ..limits };
        match recordings.prune(limits, clock::wall_ns()) {
            Ok(removed) => metrics.recordings.with_label_values(&["removed"]).inc_by(removed as u64),
            Err(error) => tracing::warn!(event = "recordings_prune", "{error}"),
        }
    }
}

/// Why there is no file.
enum Unsaved {
    /// There was next to nothing: no fault.
    TooShort(String),
    /// The disk refused.
    Failed(String),
}

/// Writes one; where the disk is full the oldest recordings go first. Answers its length in s.
fn save(recordings: &Recordings, job: &Job) -> Result<f64, Unsaved> {
    let failed = |what: String| Unsaved::Failed(format!("{}: {what}", job.id));
    let chunks = last_unbroken(&job.chunks);
    let count: usize = chunks.iter().map(|c| c.samples.len()).sum();
    if count < SHORTEST {
        let what = format!("{}: only {} without a gap, nothing to save", job.id, counted(count, "sample"));
        return Err(Unsaved::TooShort(what));
    }
    let evidence = evidence(job, chunks).map_err(|e| failed(e.to_string()))?;
    let head = Head {
        sample_rate: job.sample_rate,
        experiment: &job.reason,
        axes: &job.axes,
        start_s: samples(chunks).next().map_or(0.0, |s| s.t_s),
        rows: count,
    };
    let metadata = [job.metadata.clone(), evidence.metadata()].concat();
    let (names, signals): (Vec<_>, Vec<_>) = signals(chunks, &job.axes).into_iter().unzip();
    let target = recordings.target(&job.id).ok_or_else(|| failed("is not a name".to_owned()))?;
    recordings.restore();
    // Older ones go for as many bytes as this one can have; where that is not enough, others take them.
    let most_bytes = (count * names.len() * size_of::<f64>()) as u64;
    let mut made_bytes = 0;
    loop {
        let mut fill = |index: usize, out: &mut Vec<f64>| {
            if let Some(signal) = signals.get(index) {
                signal.fill(chunks, out);
            }
        };
        match write_by_column(&target, &head, (names.clone(), metadata.clone()), &mut fill) {
            Ok(()) => return Ok(count as f64 / job.sample_rate.hz()),
            Err(error)
                if is_full(&error)
                    && made_bytes < most_bytes
                    && let Some(bytes) = recordings.make_room() =>
            {
                made_bytes += bytes;
            }
            Err(error) => return Err(Unsaved::Failed(error.to_string())),
        }
    }
}

/// What makes the decisions of these chunks repeatable.
fn evidence(job: &Job, chunks: &[Arc<Chunk>]) -> Result<Evidence, serde_json::Error> {
    let line = |heard: &Heard| {
        let axis = job.axes.get(heard.axis).map_or("", String::as_str);
        EventLine::from_chatter(heard.t_s, axis, &heard.event).with_pitch_at(heard.spindle_speed_rpm)
    };
    let events: Vec<EventLine> = chunks.iter().flat_map(|c| &c.heard).map(line).collect();
    Ok(Evidence {
        settings: job.settings,
        keyframe: chunks.first().map(|c| c.keyframe.clone()).unwrap_or_default(),
        first_sequence: samples(chunks).next().map_or(0, |s| s.sequence),
        stretches: chunks.iter().map(|c| (c.samples.len(), c.digest.value())).collect(),
        decisions: events_text(&events)?,
        account: Some(turret_account(job, chunks)),
    })
}

/// The looks at the turret decision from the first sample on.
fn turret_account(job: &Job, chunks: &[Arc<Chunk>]) -> Account {
    let first_s = samples(chunks).next().map_or(f64::NEG_INFINITY, |s| s.t_s);
    let pages = pages_since(&job.pages, first_s);
    Account {
        settings: job.turret_settings,
        state: pages.first().map(|p| p.state.clone()).unwrap_or_default(),
        stretches: pages.iter().map(|p| p.looks.clone()).collect(),
    }
}

fn is_full(error: &RecordingError) -> bool {
    match error {
        RecordingError::Io { source, .. } => source.kind() == std::io::ErrorKind::StorageFull,
        RecordingError::Format { message, .. } => message.contains("No space left"),
        RecordingError::Value { .. } => false,
    }
}
