//! The pipeline thread: owns every shared memory port, wakes once a millisecond (in `act`; every fiftieth
//! otherwise), drains, steps, decides.
//!
//! It waits for nothing but its own next wake: reports go to a bounded queue that others drain, files
//! are written elsewhere, requests are looked at without waiting. When a queue is full, pictures are
//! dropped first (the next one is 50 ms away), events last, and every drop is counted.

mod acting;
#[cfg(test)]
mod checks;
mod hearing;
mod intake;
mod mode;
mod picture;
mod stamps;
mod turret;

use super::black_box::BlackBox;
use super::clock;
use super::commissioning::{Commissioning, CutCounter};
use super::control::Control;
use super::cut_book::CutBook;
use super::drift::Feed;
use super::hub::{Report, View};
use super::ledger::Ledger;
use super::live::Mode;
use super::recorder::Job;
use super::store_watch::StoreWatch;
use super::way_back::WayBack;
use crate::config::service::ServiceConfig;
use crate::pipeline::Margin;
use crate::telemetry::{Event, EventKind, Metrics};
use crate::transport::wire::{ServoBatch, TurretStatus};
use crate::transport::{Domain, Participant, ServoSubscriber, StatusSubscriber, TransportError};
use acting::Acting;
use intake::Stream;
pub(super) use mode::was_late;
use picture::Picture;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{SyncSender, TrySendError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;

/// How often the thread wakes while it may command.
const WAKE: Duration = Duration::from_millis(1);
/// How often it wakes while nothing leaves the process: as often as a picture is reported. The same samples
/// are taken in, fifty batches at once, while the caches are warm.
const CALM_WAKE: Duration = PICTURE;
/// How often a picture is reported.
const PICTURE: Duration = Duration::from_millis(50);
/// Without samples for this long the source counts as lost.
const SILENCE: Duration = Duration::from_millis(1000);
/// Invariant I10: `act` falls back once the history could not be written for this long.
const STORE_PATIENCE: Duration = Duration::from_secs(10);
/// A status that is older says nothing about interlocks.
const STATUS_DEADLINE: Duration = Duration::from_millis(500);
/// Shared memory that cannot be read for this long ends the thread.
const UNREADABLE: Duration = Duration::from_secs(2);
/// Samples that cease again and again are recorded once in this time.
const SILENCE_SAVED: Duration = Duration::from_secs(60);
/// How long the command port stays after the last word of a service that stops.
const FAREWELL: Duration = Duration::from_millis(100);
/// Events that wait while the queue of reports is full.
const BACKLOG: usize = 1024;

/// What the thread is made from.
pub(super) struct Setup {
    pub(super) config: Arc<ServiceConfig>,
    pub(super) domain: Domain,
    /// SHA-256 of the configuration in force.
    pub(super) config_hash: String,
    pub(super) epoch: u64,
    pub(super) reports: mpsc::Sender<Report>,
    pub(super) controls: mpsc::Receiver<Control>,
    pub(super) recorder: SyncSender<Job>,
    pub(super) drift: SyncSender<Feed>,
    pub(super) metrics: Arc<Metrics>,
    /// Counts wakes: the watchdog is fed from it.
    pub(super) progress: Arc<AtomicU64>,
    /// Whether intents can be recorded.
    pub(super) store: StoreWatch,
    /// Whether somebody could take the turret back.
    pub(super) way_back: Arc<WayBack>,
    /// What is observed, and whether it is enough to act.
    pub(super) commissioning: Arc<Commissioning>,
}

struct Ports {
    servo: ServoSubscriber,
    status: StatusSubscriber,
    who: Participant,
}

impl Ports {
    fn open(domain: &Domain) -> Result<Self, TransportError> {
        let who = domain.join("stillcut-service")?;
        Ok(Self { servo: ServoSubscriber::open(&who)?, status: StatusSubscriber::open(&who)?, who })
    }
}

/// A recording that waits for the seconds after its event.
struct PendingSave {
    id: String,
    reason: String,
    at: Instant,
}

pub(super) struct Engine {
    setup: Setup,
    /// In a box: it is taken out for each batch, and it is large.
    stream: Option<Box<Stream>>,
    source_lost: bool,
    /// When samples came that the pipeline could use, on both clocks.
    last_arrival: Option<(Instant, i64)>,
    /// When anything came, and when the present stream began.
    last_batch: Option<Instant>,
    stream_begun: Option<Instant>,
    status: Option<(TurretStatus, Instant)>,
    interlocks_open: u32,
    mode: Mode,
    mode_revision: u64,
    mode_reason: String,
    fault: Option<String>,
    black_box: BlackBox,
    ledger: Ledger,
    save: Option<PendingSave>,
    backlog: VecDeque<Report>,
    picture: Picture,
    acting: Option<Acting>,
    /// Why this stream has no pitch control: it has no two axes that move the tools apart.
    no_pitch: Option<String>,
    began: Instant,
    last_wake: Instant,
    acknowledge: bool,
    /// A person wants the turret left where it is.
    held: bool,
    told_rad: Option<f64>,
    /// Why a command was not sent, as told last.
    told_held: Option<&'static str>,
    told_speed: bool,
    /// How this cut differs from its model, as far as it is told.
    told_cut: Vec<&'static str>,
    /// Stability margin of the cut that goes on, as read last.
    cut_margin: Option<Margin>,
    turret_state: u32,
    stopping: bool,
    /// The mode changed: the picture shows it at once.
    picture_now: bool,
    /// Observed and not counted yet, s.
    observed_s: f64,
    cuts: CutCounter,
    book: CutBook,
    /// Since when shared memory cannot be read.
    unreadable: Option<Instant>,
    /// When the last recording of ceased samples was planned.
    saved_silence: Option<Instant>,
}

/// Starts the thread; answers once it has joined the domain, or why it could not.
pub(super) fn start(setup: Setup) -> Result<std::thread::JoinHandle<()>, TransportError> {
    let (ready, joined) = std::sync::mpsc::sync_channel(1);
    let root = setup.domain.root().to_owned();
    let thread = std::thread::Builder::new().name("pipeline".into()).spawn(move || {
        let ports = match Ports::open(&setup.domain) {
            Ok(ports) => ports,
            Err(error) => {
                let _ = ready.send(Err(error));
                return;
            }
        };
        let _ = ready.send(Ok(()));
        Engine::new(setup).run(&ports);
    });
    let thread = thread.map_err(|source| TransportError::Files { path: root.clone(), source })?;
    // The join has its own deadline; this one covers opening the ports.
    let deadline = crate::transport::JOIN_DEADLINE * 2;
    joined.recv_timeout(deadline).map_err(|_| TransportError::Wedged { root })??;
    Ok(thread)
}

impl Engine {
    fn new(setup: Setup) -> Self {
        let kept_s = setup.config.recorder.before_s + setup.config.recorder.after_s;
        let rate_hz = setup.config.machine.sample_rate.hz();
        Self {
            black_box: BlackBox::new(kept_s, rate_hz),
            ledger: Ledger::new(kept_s),
            picture: Picture::new(clock::now()),
            setup,
            stream: None,
            source_lost: false,
            last_arrival: None,
            last_batch: None,
            stream_begun: None,
            status: None,
            interlocks_open: u32::MAX,
            mode: Mode::Observe,
            mode_revision: 1,
            mode_reason: "every start begins in observe".to_owned(),
            fault: None,
            save: None,
            backlog: VecDeque::with_capacity(BACKLOG),
            acting: None,
            no_pitch: None,
            began: clock::now(),
            last_wake: clock::now(),
            acknowledge: false,
            held: false,
            told_rad: None,
            told_held: None,
            told_speed: false,
            told_cut: Vec::new(),
            cut_margin: None,
            turret_state: 0,
            stopping: false,
            picture_now: false,
            observed_s: 0.0,
            cuts: CutCounter::default(),
            book: CutBook::default(),
            unreadable: None,
            saved_silence: None,
        }
    }

    fn run(mut self, ports: &Ports) {
        for stage in ["transport", "pipeline"] {
            self.setup.metrics.stage_up.with_label_values(&[stage]).set(1);
        }
        self.show_mode();
        let mut next = clock::now() + WAKE;
        while !self.stopping {
            self.wake(ports);
            self.setup.progress.fetch_add(1, Ordering::Relaxed);
            let now = clock::now();
            if next > now {
                std::thread::park_timeout(next - now); // what a person asks ends it
            }
            let woken = clock::now();
            if woken >= next {
                // After a stall the thread goes on from now; it does not hurry after lost milliseconds.
                next = (next + if self.mode == Mode::Act { WAKE } else { CALM_WAKE }).max(now);
            }
        }
        self.write_recording();
        if self.mode != Mode::Observe {
            self.change_mode(Mode::Observe, "the service stops");
            self.decide(clock::now());
            clock::sleep(FAREWELL); // the port goes with this thread; let the controller read first
        }
        self.flush();
        for stage in ["transport", "pipeline"] {
            self.setup.metrics.stage_up.with_label_values(&[stage]).set(0);
        }
    }

    fn wake(&mut self, ports: &Ports) {
        let began = clock::now();
        self.notice_stall(began);
        while let Ok(control) = self.setup.controls.try_recv() {
            self.obey(control, ports);
        }
        // By the clock of each batch: a thread that was stopped in this wake finds samples younger than it.
        let outcome = ports.servo.drain(|batch| self.take_batch(batch, clock::now()));
        if let Ok(count) = outcome
            && count > 0
        {
            let took_s = began.elapsed().as_secs_f64();
            self.setup.metrics.step_duration_seconds.observe(took_s);
        }
        let outcome_count = *outcome.as_ref().unwrap_or(&0);
        let heard = ports.status.drain(|status| self.take_status(status, began));
        self.notice_ports(outcome.and(heard), began);
        self.supervise(began);
        let deciding = clock::now();
        self.notice_stall(deciding); // it may have been stopped in the midst of this wake
        self.decide(deciding);
        if outcome_count > 0 {
            // From the wake on: what the samples waited before it nobody here can tell.
            self.setup.metrics.decision_latency_seconds.observe(began.elapsed().as_secs_f64());
        }
        if std::mem::take(&mut self.picture_now) || self.picture.is_due(began, PICTURE) {
            let view = self.view(began);
            self.offer(view);
        }
        self.flush();
    }

    /// Ports that stay unreadable are not mended from inside: the thread ends, and the service is started
    /// anew by whoever started it.
    fn notice_ports(&mut self, outcome: Result<usize, TransportError>, now: Instant) {
        let Err(error) = outcome else {
            self.unreadable = None;
            return;
        };
        self.latch(&error.to_string());
        let since = *self.unreadable.get_or_insert(now);
        if now.duration_since(since) > UNREADABLE {
            tracing::error!(event = "transport_lost", "{error}; the service ends to be started anew");
            self.stopping = true;
        }
    }

    /// A thread that was stopped knows nothing of the time between: it does not go on acting.
    fn notice_stall(&mut self, now: Instant) {
        let away = now.duration_since(self.last_wake);
        self.last_wake = now;
        if away > SILENCE && self.mode == Mode::Act {
            self.change_mode(
                Mode::Observe,
                &format!("{} for {:.1} s", mode::STOOD_STILL, away.as_secs_f64()),
            );
        }
    }

    fn take_batch(&mut self, batch: &ServoBatch, now: Instant) {
        // A producer that keeps its stream's number and changes its head is heard once that stream is silent.
        let speaks = !self.source_lost;
        if let Some(stream) = self.stream.as_mut().filter(|s| speaks && s.disowns(batch)) {
            stream.refuse_layout(batch);
            return;
        }
        if !self.stream.as_ref().is_some_and(|s| s.carries(batch)) {
            self.begin_stream(batch, now);
        }
        let Some(mut stream) = self.stream.take() else { return };
        self.last_batch = Some(now);
        let mut taken = 0;
        let now_s = self.seconds(now);
        stream.turret_rad = self.reported_pitch_rad(now);
        if batch.used_points().is_empty() {
            stream.refuse_batch(batch);
        }
        for point in batch.used_points() {
            let believed = stream.believes(point, now_s);
            if let Some(acting) = &mut self.acting {
                acting.sample_seen(now_s, (point, believed), stream.axes().len());
            }
            if !believed {
                continue;
            }
            if let Some(output) = stream.step(point, &mut self.black_box) {
                taken += 1;
                self.picture.add(&output, stream.axes().len());
                self.hear(&output, &stream);
            }
        }
        if taken > 0 {
            self.observe(taken, &stream);
            self.keep_cuts(&stream);
            stream.count_taken(taken);
            self.samples_taken(now, &stream);
        }
        if let Some(chunk) = self.black_box.newest_full() {
            let feed = Feed { chunk, axes: stream.shared_axes(), rate: stream.sample_rate() };
            // A comparison that lags misses a second; nothing rests on it.
            if self.setup.drift.try_send(feed).is_err() {
                self.setup.metrics.queue_dropped.with_label_values(&["drift", "true"]).inc();
            }
        }
        if stream.ended {
            let text = "the producer's counter or clock jumped; its stream begins anew";
            self.report(Event::new(EventKind::DataRejected, clock::wall_ns(), text));
            self.write_recording();
            return; // the next batch begins it
        }
        self.stream = Some(stream);
    }

    /// What commissioning counts of the time: with samples. Cuts are counted where they are heard.
    fn observe(&mut self, taken: u64, stream: &Stream) {
        let evidence = &self.setup.commissioning.evidence;
        self.observed_s += taken as f64 / stream.sample_rate().hz();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let whole_ms = (self.observed_s * 1e3) as u64;
        evidence.observe_ms(whole_ms);
        self.observed_s -= whole_ms as f64 * 1e-3;
    }

    /// Fresh is what the pipeline could use: batches that are empty, repeated or no numbers are silence.
    fn samples_taken(&mut self, now: Instant, stream: &Stream) {
        self.last_arrival = Some((now, clock::wall_ns()));
        if std::mem::replace(&mut self.source_lost, false) {
            let text = format!("samples come again: {}", stream.describe());
            self.report(Event::new(EventKind::SourceFound, clock::wall_ns(), text));
        }
    }

    /// A producer that is new, came back, or changed its axes or rate: everything starts anew.
    fn begin_stream(&mut self, batch: &ServoBatch, now: Instant) {
        self.write_recording(); // what waits is of the samples that go now
        self.black_box.clear();
        self.ledger.clear();
        self.picture.forget();
        self.cuts = CutCounter::default();
        self.book = CutBook::default();
        if self.mode == Mode::Act {
            self.change_mode(Mode::Observe, "the machine's stream began anew");
        }
        match Stream::begin(batch, &self.setup.config, &self.setup.metrics) {
            Ok(stream) => {
                self.no_pitch = self.prepare_acting(&stream).err();
                let no_pitch = self.no_pitch.iter().map(|why| format!("no pitch control: {why}"));
                let said: Vec<String> = std::iter::once(format!("samples come: {}", stream.describe()))
                    .chain(no_pitch)
                    .chain(self.setup.config.not_in_the_stream(stream.axes()))
                    .collect();
                let text = said.join("; ");
                self.report(Event::new(EventKind::SourceFound, clock::wall_ns(), text));
                if let Some(acting) = &mut self.acting {
                    acting.stream_begins(stream.sample_rate().hz());
                }
                self.stream = Some(Box::new(stream));
                (self.source_lost, self.stream_begun) = (false, Some(now));
            }
            Err(message) => {
                let known = self.picture.refused_stream.replace(batch.stream) == Some(batch.stream);
                if !known {
                    self.report(Event::new(EventKind::DataRejected, clock::wall_ns(), message));
                }
                self.stream = None;
            }
        }
    }

    fn supervise(&mut self, now: Instant) {
        let long_ago = |at: Instant| now.duration_since(at) > SILENCE;
        // A stream that never brought a usable sample is silent a second after it began.
        let heard = self.last_arrival.map(|(at, _)| at).max(self.stream_begun);
        let silent = heard.is_some_and(long_ago);
        let gone = self.last_batch.is_some_and(long_ago);
        if silent && !self.source_lost {
            self.source_lost = true;
            let text = if gone { "no samples for one second" } else { "no usable samples for one second" };
            self.report(Event::new(EventKind::SourceLost, clock::wall_ns(), text));
            if self.saved_silence.is_none_or(|at| now.duration_since(at) > SILENCE_SAVED) {
                self.saved_silence = Some(now);
                self.save_around(EventKind::SourceLost.word(), text);
            }
            if self.mode == Mode::Act {
                self.latch(mode::SAMPLES_CEASED);
                self.decide(now);
            }
        }
        if gone && self.stream.is_some() {
            self.write_recording();
            self.stream = None;
            self.picture.forget();
        }
        if self.mode == Mode::Act && !self.setup.way_back.is_open(now) {
            self.latch("no operator's token is in force: nobody could take the turret back");
            self.decide(now);
        }
        if self.mode == Mode::Act && self.setup.store.lag(now) >= STORE_PATIENCE {
            self.change_mode(Mode::Advise, "the history could not be written for 10 s");
        }
        self.watch_interlocks(now);
        if let Some(event) = self.stream.as_mut().and_then(|s| s.faults.event_due(now)) {
            self.report(event);
        }
        if self.save.as_ref().is_some_and(|s| now >= s.at) {
            self.write_recording();
        }
    }

    /// Plans a recording around now; one that waits already covers this too. Answers its name.
    fn save_around(&mut self, word: &str, reason: &str) -> String {
        if let Some(waiting) = &self.save {
            return waiting.id.clone();
        }
        let id = format!("{word}-{}", clock::new_id());
        let at = clock::now() + Duration::from_secs_f64(self.setup.config.recorder.after_s);
        self.save = Some(PendingSave { id: id.clone(), reason: reason.to_owned(), at });
        id
    }

    /// Hands a recording that waits to the recorder. Without samples there is nothing to save: it is counted.
    fn write_recording(&mut self) {
        let Some(save) = self.save.take() else { return };
        let Some(stream) = &self.stream else {
            self.setup.metrics.recordings.with_label_values(&["failed"]).inc();
            let text = format!("{}: no samples, nothing to save", save.id);
            self.report(Event::new(EventKind::RecordingFailed, clock::wall_ns(), text));
            return;
        };
        let workpiece = &self.setup.config.cut.workpiece;
        let band = stream.band_hz();
        let job = Job {
            id: save.id,
            reason: save.reason,
            chunks: self.black_box.snapshot(),
            sample_rate: stream.sample_rate(),
            axes: stream.axes().to_vec(),
            metadata: vec![
                ("workpiece_diameter_m".into(), format!("{:?}", workpiece.diameter_m())),
                ("workpiece_projection_length_m".into(), format!("{:?}", workpiece.projection_length_m())),
                ("analysis_band_hz".into(), format!("{:?},{:?}", band[0], band[1])),
                ("stillcut_version".into(), env!("CARGO_PKG_VERSION").into()),
                ("config_sha256".into(), self.setup.config_hash.clone()),
            ],
            settings: stream.pipeline().settings_digest(),
            turret_settings: self.acting.as_ref().map_or(0, Acting::settings_digest),
            pages: self.ledger.snapshot(),
        };
        if let Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) = self.setup.recorder.try_send(job)
        {
            self.setup.metrics.recordings.with_label_values(&["dropped"]).inc();
            self.setup.metrics.queue_dropped.with_label_values(&["recorder", "false"]).inc();
        }
    }

    /// Queues an event; what has to wait stays in order.
    fn report(&mut self, event: Event) {
        let event = Event { id: clock::new_id(), ..event };
        self.queue(Report::Event(Box::new(event)));
    }

    fn queue(&mut self, report: Report) {
        if self.backlog.len() >= BACKLOG {
            self.setup.metrics.queue_dropped.with_label_values(&["reports", "false"]).inc();
            return;
        }
        self.backlog.push_back(report);
    }

    fn flush(&mut self) {
        while let Some(report) = self.backlog.pop_front() {
            if let Err(mpsc::error::TrySendError::Full(report)) = self.setup.reports.try_send(report) {
                self.backlog.push_front(report);
                return;
            }
        }
    }

    /// A picture that finds no place is dropped: the next one is newer.
    fn offer(&mut self, view: View) {
        if self.setup.reports.try_send(Report::View(Box::new(view))).is_err() {
            self.setup.metrics.queue_dropped.with_label_values(&["reports", "true"]).inc();
        }
    }
}
