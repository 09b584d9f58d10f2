//! The running service as its users see it: HTTP handlers, `run`, `demo` and tests.

use super::announcer::Announcer;
use super::clock;
use super::commissioning::{Commissioning, CommissioningView};
use super::control::{Control, ModeNow, Origin, Refusal};
use super::diagnoses::Diagnoses;
use super::live::{LiveState, Mode, SpectrumView, StreamMessage};
use super::past::Past;
use super::recordings::{RecordingInfo, Recordings, RecordingsError};
use super::stability::{CurveCache, StabilityCurve};
use super::way_back::WayBack;
use crate::avoidance::pitch::is_same_pitch;
use crate::config::service::ServiceConfig;
use crate::store::{AuditEntry, AuditRow, EventFilter, EventPage, StoreError, StoreReader, StoreWriter};
use crate::telemetry::{Event, EventKind, Metrics};
use crate::units::counted;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use thiserror::Error;
use tokio::sync::{broadcast, mpsc, oneshot, watch};
use tokio_util::sync::CancellationToken;

/// Why an operation was not done.
#[derive(Debug, Error)]
pub enum OperationError {
    /// There is nothing of that name or number.
    #[error("{0}")]
    NotFound(String),
    /// The pipeline thread refused.
    #[error(transparent)]
    Refused(#[from] Refusal),
    /// The history cannot be read or written.
    #[error("the history is not available")]
    Store(#[from] StoreError),
    /// What must be on record first could not be put there in time; nothing was done.
    #[error("the audit record did not confirm within {} s; nothing was done", ANSWER_DEADLINE.as_secs())]
    NotRecorded,
    /// The disk is late: what was asked for and its row in the audit record are queued together.
    #[error(
        "the history did not confirm within {} s; it may be done later, with its row in the audit record",
        ANSWER_DEADLINE.as_secs()
    )]
    NotConfirmed,
    /// A file beside the history cannot be written, and why.
    #[error("the folder of the history cannot be written")]
    NotWritten(String),
    /// The recordings cannot be read.
    #[error(transparent)]
    Recordings(#[from] RecordingsError),
    /// Too many of these at once.
    #[error("{0}")]
    Busy(String),
    /// What was asked for cannot be done with what is there.
    #[error("{0}")]
    Unsuitable(String),
}

/// A change of mode that was made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Changed {
    /// The mode now, as the pipeline thread says.
    pub mode: ModeNow,
    /// Whether the change is in the audit record yet; if not, it waits for the disk.
    pub recorded: bool,
}

/// One thing that readiness depends on.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Check {
    /// `samples`, `store`, `pipeline`, `access`.
    pub name: &'static str,
    /// Whether it is as it should be.
    pub ok: bool,
    /// What is seen.
    pub detail: String,
}

/// The configuration in force, as it is shown.
#[derive(Debug, Clone)]
pub struct ShownConfig {
    /// TOML text without secrets.
    pub text: String,
    /// SHA-256 of it, hexadecimal.
    pub hash: String,
}

pub(super) struct Inner {
    pub(super) address: SocketAddr,
    pub(super) state: watch::Receiver<Arc<LiveState>>,
    pub(super) spectrum: watch::Receiver<Arc<SpectrumView>>,
    pub(super) stream: broadcast::Sender<StreamMessage>,
    pub(super) control: mpsc::Sender<Control>,
    /// Woken by what a person asks.
    pub(super) pipeline: std::thread::Thread,
    pub(super) announcer: Announcer,
    pub(super) writer: StoreWriter,
    pub(super) reader: StoreReader,
    pub(super) metrics: Arc<Metrics>,
    pub(super) recordings: Recordings,
    pub(super) diagnoses: Diagnoses,
    pub(super) config: ShownConfig,
    pub(super) stop: CancellationToken,
    pub(super) settings: Arc<ServiceConfig>,
    pub(super) curves: CurveCache,
    /// Whether somebody could take the turret back.
    pub(super) way_back: Arc<WayBack>,
    pub(super) commissioning: Arc<Commissioning>,
    /// The newest mode that somebody was answered: the picture may be a moment older.
    pub(super) answered: Mutex<Option<ModeNow>>,
    /// What pages that are opened later see.
    pub(super) past: Arc<Mutex<Past>>,
    /// Done once the settings are on record.
    pub(super) settled: CancellationToken,
}

/// A cheap copy of the way into the running service.
#[derive(Clone)]
pub struct Handle(pub(super) Arc<Inner>);

impl std::fmt::Debug for Handle {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Handle").field("address", &self.0.address).finish_non_exhaustive()
    }
}

/// A row of the audit record, now.
fn entry(origin: &Origin, action: &str, detail: &str) -> AuditEntry {
    AuditEntry {
        wall_ns: clock::wall_ns(),
        actor: origin.actor.clone(),
        role: origin.role.clone(),
        action: action.to_owned(),
        detail: format!("{detail}; reason: {}", origin.reason),
    }
}

/// A write, when the disk confirms it in time.
async fn confirmed<T>(
    write: impl Future<Output = Result<T, StoreError>> + Send,
) -> Result<T, OperationError> {
    let written = tokio::time::timeout(ANSWER_DEADLINE, write).await;
    Ok(written.map_err(|_| OperationError::NotConfirmed)??)
}

const ANSWER_DEADLINE: Duration = Duration::from_secs(2);
/// What is done already does not wait longer for its record than this.
const RECORD_PATIENCE: Duration = Duration::from_millis(500);
/// Whoever takes the turret back is answered within a quarter of a second.
const OVERRIDE_PATIENCE: Duration = Duration::from_millis(150);

impl Handle {
    /// Where HTTP listens.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.0.address
    }

    /// The picture at this moment.
    #[must_use]
    pub fn state(&self) -> Arc<LiveState> {
        Arc::clone(&self.0.state.borrow())
    }

    /// Stability over the pitch for the present speed of the spindle.
    /// Errors: no speed, or no cut that has a curve.
    pub async fn stability(&self) -> Result<StabilityCurve, OperationError> {
        let speed_rpm = self.state().source.spindle_speed_rpm;
        self.0.curves.at(&self.0.settings, speed_rpm).await.map_err(OperationError::Unsuitable)
    }

    /// Where commissioning stands.
    #[must_use]
    pub fn commissioning(&self) -> CommissioningView {
        self.0.commissioning.view()
    }

    /// The mode, not older than what anybody was answered.
    #[must_use]
    pub fn mode(&self) -> ModeNow {
        let state = self.state();
        let answered = self.0.answered.lock().unwrap_or_else(PoisonError::into_inner).clone();
        answered.filter(|mode| mode.revision > state.mode_revision).unwrap_or_else(|| ModeNow {
            mode: state.mode,
            revision: state.mode_revision,
            reason: state.mode_reason.clone(),
        })
    }

    fn note_mode(&self, mode: &ModeNow) {
        let mut answered = self.0.answered.lock().unwrap_or_else(PoisonError::into_inner);
        if answered.as_ref().is_none_or(|known| known.revision < mode.revision) {
            *answered = Some(mode.clone());
        }
    }

    /// Follows the picture.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<Arc<LiveState>> {
        self.0.state.clone()
    }

    /// The newest spectrum.
    #[must_use]
    pub fn spectrum(&self) -> Arc<SpectrumView> {
        Arc::clone(&self.0.spectrum.borrow())
    }

    /// Listens to the live stream.
    #[must_use]
    pub fn subscribe(&self) -> broadcast::Receiver<StreamMessage> {
        self.0.stream.subscribe()
    }

    /// Metrics.
    #[must_use]
    pub fn metrics(&self) -> &Arc<Metrics> {
        &self.0.metrics
    }

    /// The configuration in force.
    #[must_use]
    pub fn config(&self) -> &ShownConfig {
        &self.0.config
    }

    /// Resolves when the service begins to stop.
    #[must_use]
    pub fn stopping(&self) -> CancellationToken {
        self.0.stop.clone()
    }

    /// The machine model that diagnoses start from.
    #[must_use]
    pub fn model(&self) -> Option<&PathBuf> {
        self.0.settings.model.as_ref()
    }

    /// Diagnosis jobs.
    #[must_use]
    pub fn diagnoses(&self) -> &Diagnoses {
        &self.0.diagnoses
    }

    /// A page of the history.
    /// Errors: the history cannot be read.
    pub async fn events(&self, filter: &EventFilter) -> Result<EventPage, OperationError> {
        Ok(self.0.reader.page(filter).await?)
    }

    /// How far a sink outside has confirmed the events.
    /// Errors: the history cannot be read.
    pub async fn outbox_confirmed(&self, sink: &str) -> Result<i64, OperationError> {
        Ok(self.0.reader.outbox(sink).await?.0)
    }

    /// Notes that a sink outside has confirmed every event up to `sequence`. Durable when it returns.
    /// Errors: the history cannot be written.
    pub async fn confirm_outbox(&self, sink: &'static str, sequence: i64) -> Result<(), OperationError> {
        Ok(self.0.writer.confirm(sink, sequence).await?)
    }

    /// Shows on the metrics how many events wait for a sink.
    pub async fn note_outbox(&self, sink: &str) {
        if let Ok((_, waiting)) = self.0.reader.outbox(sink).await {
            self.metrics().outbox_waiting.set(waiting);
        }
    }

    /// One event.
    /// Errors: there is none of that number, or the history cannot be read.
    pub async fn event(&self, sequence: i64) -> Result<Event, OperationError> {
        let found = self.0.reader.event(sequence).await?;
        found.ok_or_else(|| OperationError::NotFound(format!("there is no event {sequence}")))
    }

    /// Rows of the audit chain after `after`.
    /// Errors: the history cannot be read.
    pub async fn audit_rows(&self, after: i64) -> Result<Vec<AuditRow>, OperationError> {
        Ok(self.0.reader.audit(after).await?)
    }

    /// Puts on record that somebody does, or was refused, something. Durable when it returns.
    /// Errors: it is not on record; it may be later, when the disk answers again.
    pub async fn audit(&self, origin: &Origin, action: &str, detail: &str) -> Result<(), OperationError> {
        let written = tokio::time::timeout(ANSWER_DEADLINE, self.write_audit(origin, action, detail)).await;
        written.map_err(|_| OperationError::NotRecorded)??;
        Ok(())
    }

    async fn write_audit(&self, origin: &Origin, action: &str, detail: &str) -> Result<i64, StoreError> {
        self.0.writer.audit(entry(origin, action, detail)).await
    }

    /// Puts on record what became of a request. The row is queued before this first waits; what was done is
    /// done, so the caller is only told whether the row is durable yet.
    pub(super) async fn record_outcome(&self, origin: &Origin, action: &str, outcome: &str) -> bool {
        let written = self.write_audit(origin, action, outcome);
        match tokio::time::timeout(RECORD_PATIENCE, written).await {
            Ok(Ok(_)) => true,
            Ok(Err(error)) => {
                tracing::error!(event = "audit_lost", action, actor = origin.actor, outcome, "{error}");
                self.0.metrics.queue_dropped.with_label_values(&["store", "false"]).inc();
                false
            }
            Err(_) => false, // it waits in the queue
        }
    }

    /// Acknowledges an event; doing it again changes nothing. Change and row are durable together.
    /// `right`: whether its alarm was right, where the person says.
    /// Errors: there is none of that number, or the disk is late and the change waits for it.
    pub async fn acknowledge(
        &self,
        sequence: i64,
        right: Option<bool>,
        origin: &Origin,
    ) -> Result<Event, OperationError> {
        self.event(sequence).await?;
        let judged = right.map_or("", |right| if right { ", a right alarm" } else { ", a false alarm" });
        let entry = entry(origin, "acknowledge", &format!("event {sequence}{judged}"));
        confirmed(self.0.writer.acknowledge(sequence, right, entry)).await?;
        self.event(sequence).await
    }

    /// Silences an event for some minutes. Change and row are durable together.
    /// Errors: there is none of that number, or the disk is late and the change waits for it.
    pub async fn silence(
        &self,
        sequence: i64,
        minutes: f64,
        origin: &Origin,
    ) -> Result<Event, OperationError> {
        self.event(sequence).await?;
        let entry = entry(origin, "silence", &format!("event {sequence} for {minutes} min"));
        #[expect(clippy::cast_possible_truncation, reason = "a few hours in nanoseconds")]
        let until = clock::wall_ns().saturating_add((minutes * 60e9) as i64);
        confirmed(self.0.writer.silence(sequence, until, entry)).await?;
        self.event(sequence).await
    }

    async fn ask<T>(
        &self,
        make: impl FnOnce(oneshot::Sender<Result<T, Refusal>>) -> Control,
    ) -> Result<T, OperationError> {
        let (done, answer) = oneshot::channel();
        let asked = async {
            self.0.control.send(make(done)).await.map_err(|_| Refusal::NoAnswer)?;
            self.0.pipeline.unpark();
            answer.await.map_err(|_| Refusal::NoAnswer)?
        };
        let answered = tokio::time::timeout(ANSWER_DEADLINE, asked).await;
        Ok(answered.map_err(|_| Refusal::NoAnswer)??)
    }

    /// Changes the mode. `revision`: the one that somebody saw who may raise it; without it the way leads
    /// down only, and the pipeline thread judges which way it is. What may lead up is put on record first,
    /// after the settings of this start; the way down waits for nothing. What became of it is on record
    /// afterwards, also a refusal.
    pub async fn set_mode(
        &self,
        mode: Mode,
        revision: Option<u64>,
        origin: Origin,
    ) -> Result<Changed, OperationError> {
        if revision.is_some() && mode != Mode::Observe {
            let settled = tokio::time::timeout(ANSWER_DEADLINE, self.0.settled.cancelled()).await;
            settled.map_err(|_| OperationError::NotRecorded)?;
            self.audit(&origin, "set_mode_asked", &format!("mode {}", mode.word())).await?;
        }
        let asked = origin.clone();
        let outcome = self.ask(|done| Control::SetMode { mode, revision, origin: asked, done }).await;
        self.changed((&origin, "set_mode", &format!("mode {}", mode.word())), outcome).await
    }

    /// Takes the turret back: equal pitch and `observe`, at once. What comes back goes to
    /// [`Self::record_override`] with the reason, once that is known.
    /// Errors: the pipeline thread does not answer.
    pub async fn take_back(&self, actor: &str) -> Result<ModeNow, OperationError> {
        let actor = actor.to_owned();
        let mode = self.ask(|done| Control::Override { actor, done }).await?;
        self.note_mode(&mode);
        Ok(mode)
    }

    /// Whether acting has ended and the turret stands at equal pitch, as far as it is heard.
    pub(super) fn turret_is_back(&self) -> bool {
        let state = self.state();
        let away = state.pitch.reported_rad.is_some_and(|pitch_rad| !is_same_pitch(pitch_rad, 0.0));
        self.mode().mode != Mode::Act && !away
    }

    /// Puts on record that the turret was taken back, or was to be. What is done is done: neither the disk
    /// nor the next picture is waited for longer than a person would.
    pub async fn record_override(
        &self,
        origin: &Origin,
        outcome: Result<ModeNow, OperationError>,
    ) -> Result<Changed, OperationError> {
        if outcome.is_ok() {
            let text = format!("{} took the turret back ({})", origin.actor, origin.reason);
            self.tell(EventKind::Override, text);
        }
        let recorded = self.record_change((origin, "override", "equal pitch, mode observe"), &outcome);
        let recorded = tokio::time::timeout(OVERRIDE_PATIENCE, recorded).await.unwrap_or(false);
        Ok(Changed { mode: outcome?, recorded })
    }

    /// Holds the turret where it is, or lets it go; ends by itself with the mode.
    /// Errors: not acting, or it is not on record in time: then nothing was done.
    pub async fn hold(&self, on: bool, origin: Origin) -> Result<Changed, OperationError> {
        let asked = origin.clone();
        let outcome = self.ask(|done| Control::Hold { on, origin: asked, done }).await;
        self.changed((&origin, "hold", if on { "turret held" } else { "turret let go" }), outcome).await
    }

    /// Clears a latched fault.
    /// Errors: nothing is latched, or it is not on record in time: then nothing was done.
    pub async fn clear_fault(&self, origin: Origin) -> Result<Changed, OperationError> {
        self.audit(&origin, "clear_fault_asked", "latched fault").await?;
        let asked = origin.clone();
        let outcome = self.ask(|done| Control::ClearFault { origin: asked, done }).await;
        self.changed((&origin, "clear_fault", "latched fault"), outcome).await
    }

    /// Puts the outcome on record and waits until the picture shows it: the asker reads its own change.
    async fn changed(
        &self,
        (origin, action, what): (&Origin, &str, &str),
        outcome: Result<ModeNow, OperationError>,
    ) -> Result<Changed, OperationError> {
        let recorded = self.record_change((origin, action, what), &outcome).await;
        let mode = outcome?;
        self.note_mode(&mode);
        let mut picture = self.watch();
        let shown = picture.wait_for(|state| state.mode_revision >= mode.revision);
        // A picture that is late is late; the answer itself is true.
        drop(tokio::time::timeout(Duration::from_millis(500), shown).await);
        Ok(Changed { mode, recorded })
    }

    /// Puts on record what became of a change; the row is queued before this first waits.
    fn record_change<'a>(
        &'a self,
        (origin, action, what): (&'a Origin, &'a str, &str),
        outcome: &Result<ModeNow, OperationError>,
    ) -> impl Future<Output = bool> + Send + 'a {
        let detail = match outcome {
            Ok(mode) => format!("{what}: done, revision {}", mode.revision),
            Err(OperationError::Refused(Refusal::NoAnswer)) => format!("{what}: no answer in time"),
            Err(error) => format!("{what}: refused, {error}"),
        };
        async move { self.record_outcome(origin, action, &detail).await }
    }

    /// Saves what the black box holds now; answers the recording's name.
    /// Errors: too many that wait, the pipeline thread does not answer, or nothing can be put on record.
    pub async fn save_recording(&self, origin: Origin) -> Result<String, OperationError> {
        self.audit(&origin, "save_recording_asked", "black box").await?;
        let reason = origin.reason.clone();
        let outcome = self.ask(|done| Control::SaveRecording { word: "manual", reason, done }).await;
        let detail = match &outcome {
            Ok(id) => format!("recording {id}: begun"),
            Err(error) => format!("black box: refused, {error}"),
        };
        self.record_outcome(&origin, "save_recording", &detail).await;
        outcome
    }

    /// Stored recordings, newest first. The disk is read on a thread that may wait for it.
    /// Errors: the folder cannot be read.
    pub async fn recordings(&self) -> Result<Vec<RecordingInfo>, OperationError> {
        let recordings = self.0.recordings.clone();
        let listed = tokio::task::spawn_blocking(move || recordings.list()).await;
        Ok(listed.map_err(|e| OperationError::Unsuitable(e.to_string()))??)
    }

    /// [`Self::recording_path`] on a thread that may wait for the disk.
    /// Errors: there is none of that name.
    pub async fn recording_file(&self, id: &str) -> Result<PathBuf, OperationError> {
        let (handle, id) = (self.clone(), id.to_owned());
        let found = tokio::task::spawn_blocking(move || handle.recording_path(&id)).await;
        found.map_err(|e| OperationError::Unsuitable(e.to_string()))?
    }

    /// File of one recording.
    /// Errors: there is none of that name.
    pub fn recording_path(&self, id: &str) -> Result<PathBuf, OperationError> {
        let found = self.0.recordings.path(id);
        found.ok_or_else(|| OperationError::NotFound(format!("there is no recording {id}")))
    }

    /// Tells an event that arose outside the pipeline; it is stored in its turn.
    pub(super) fn tell(&self, kind: EventKind, text: String) {
        let event = Event { id: clock::new_id(), ..Event::new(kind, clock::wall_ns(), text) };
        self.0.announcer.announce(event, super::announcer::Then::Nothing);
    }

    /// Stores an event that arose outside the pipeline.
    pub async fn report(&self, kind: EventKind, text: String) {
        let event = Event { id: clock::new_id(), ..Event::new(kind, clock::wall_ns(), text) };
        self.0.announcer.announce_durably(event).await;
    }

    /// What readiness depends on.
    #[must_use]
    pub fn checks(&self) -> Vec<Check> {
        let state = self.state();
        let behind_s = (clock::wall_ns() - state.time_ns) as f64 * 1e-9;
        let samples = match (&state.source.connected, &state.source.last_sample_at) {
            (true, _) => "samples are fresh".to_owned(),
            (false, Some(at)) => format!("no samples since {at}"),
            (false, None) => "no samples yet".to_owned(),
        };
        let trouble = self.0.way_back.trouble();
        vec![
            Check { name: "samples", ok: state.source.connected, detail: samples },
            Check {
                name: "store",
                ok: state.store.healthy,
                detail: format!("waiting to be stored: {}", counted(state.store.unpersisted, "event")),
            },
            Check {
                name: "pipeline",
                ok: behind_s.abs() < 2.0,
                detail: format!("picture is {behind_s:.1} s old"),
            },
            Check {
                name: "access",
                ok: trouble.is_none(),
                detail: trouble.unwrap_or_else(|| "the tokens can be used".to_owned()),
            },
        ]
    }

    /// Begins to stop. [`super::Running::stop`] waits for the end.
    pub fn request_stop(&self) {
        self.0.stop.cancel();
    }
}
