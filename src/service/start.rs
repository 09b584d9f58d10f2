//! Starting and stopping: every part is up before the first request, and goes in the reverse order.

use super::announcer::{Announcer, Then};
use super::commissioning::{Commissioning, state_of};
use super::config_hash::{machine_hash, shown_config};
use super::control::Control;
use super::diagnosis_jobs::{diagnoses_of, run_diagnoses, stream_axes};
use super::first_entries::FirstEntries;
use super::handle::{Handle, Inner};
use super::hub::{Hub, Outlets, Report};
use super::live::{LiveState, SpectrumView, StoreView, StreamMessage};
use super::past::Past;
use super::recordings::{RecordingLimits, Recordings, RecordingsError};
use super::stability::CurveCache;
use super::store_watch::StoreWatch;
use super::upkeep::{CommissioningUpkeep, History, Kept, Upkeep, file_id};
use super::way_back::WayBack;
use super::{clock, drift, engine, mtconnect, past_file, recorder};
use crate::config::service::ServiceConfig;
use crate::http::{Access, TlsError, TokenFileError, router, serve, tls_acceptor};
use crate::ownership::{own_folder, own_lock};
use crate::store::{
    Judged, LOCK, Observation, Observer, OpenReport, RECORDINGS, Retention, StoreError, StoreReader,
    StoreWriter,
};
use crate::telemetry::{Event, EventKind, Metrics};
use crate::transport::{Domain, TransportError};
use crate::units::counted;
use std::fs::{File, TryLockError};
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;
use thiserror::Error;
use tokio::net::TcpListener;
use tokio::sync::{broadcast, mpsc, watch};
use tokio_rustls::TlsAcceptor;
use tokio_util::sync::CancellationToken;

/// Why the service did not start. One line.
#[derive(Debug, Error)]
pub enum ServiceError {
    /// Another service uses the same state.
    #[error("{}: another service is running on this folder", path.display())]
    SecondInstance {
        /// Lock file.
        path: PathBuf,
    },
    /// A file or thread cannot be made.
    #[error("{}: {source}; expected a place that this user may write", path.display())]
    Files {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The address cannot be listened on.
    #[error("{what} {address}: {source}; stop what listens there or choose another address")]
    Listen {
        /// Key of the configuration.
        what: &'static str,
        /// Address.
        address: SocketAddr,
        /// What the system said.
        source: std::io::Error,
    },
    /// The history cannot be opened.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The folder of recordings cannot be used.
    #[error(transparent)]
    Recordings(#[from] RecordingsError),
    /// Shared memory cannot be used.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The tokens cannot be used.
    #[error(transparent)]
    Tokens(#[from] TokenFileError),
    /// TLS cannot be set up.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// Metrics cannot be registered: a slip of ours.
    #[error("metrics: {0}")]
    Metrics(#[from] prometheus::Error),
}

/// Reports that may wait for the hub.
const REPORTS: usize = 256;
const CONTROLS: usize = 64;
/// Stream messages a slow listener may be behind: about four seconds.
const STREAM: usize = 256;
/// A row of the audit record with a long reason; together they take a quarter of the history at most.
const AUDIT_ROW_BYTES: u64 = 1000;
const LEAST_AUDIT_ROWS: u64 = 10_000;
/// How long stopping may take before what is left is abandoned.
const STOP_DEADLINE: Duration = Duration::from_secs(3);
/// How long the start waits for its own record.
const FIRST_ENTRIES: Duration = Duration::from_secs(2);

/// A service that runs in this process.
#[derive(Debug)]
pub struct Running {
    handle: Handle,
    runtime: tokio::runtime::Runtime,
    records: tokio::runtime::Runtime,
    engine: JoinHandle<()>,
    recorder: JoinHandle<()>,
    drift: JoinHandle<()>,
    hub: tokio::task::JoinHandle<()>,
    upkeep: tokio::task::JoinHandle<()>,
    past: tokio::task::JoinHandle<()>,
    http: tokio::task::JoinHandle<()>,
    control: mpsc::Sender<Control>,
    writer: StoreWriter,
    progress: Arc<AtomicU64>,
    _lock: File,
}

/// Tokens, of which one is good where others than this machine's users are let in.
pub(super) fn access(config: &ServiceConfig) -> Result<Access, ServiceError> {
    let access = Access::load(config.http.tokens.as_deref(), config.http.trust_loopback)?;
    if config.turret.commissioned.as_ref().is_some_and(|(by, date)| access.holds_secret(&[by, date])) {
        return Err(TokenFileError::InSetting("turret.limits_by").into());
    }
    if config.fleet.as_ref().is_some_and(|fleet| access.holds_secret(&[&fleet.machine])) {
        return Err(TokenFileError::InSetting("fleet.machine").into());
    }
    if !config.http.listen.ip().is_loopback() {
        access.needs_a_good_token(clock::now())?;
    }
    Ok(access)
}

/// Starts everything. When it returns, HTTP answers and samples are taken in; the start is on record where
/// the disk lets it.
/// Errors: what [`ServiceError`] says, one line; nothing is left running.
pub fn start(config: ServiceConfig) -> Result<Running, ServiceError> {
    let config = Arc::new(config);
    let lock = lock_state(&config.history.folder)?;
    // What must be on record before a command goes does not stand in line behind requests.
    let records = worker("records", || {})?;
    let runtime = worker("http", super::priority::step_back)?;
    let metrics = Arc::new(Metrics::new(&stream_axes(&config), clock::wall_s())?);
    let retention = Retention {
        max_age_ns: config.history.max_age_ns,
        max_bytes: config.history.max_bytes,
        audit_rows: (config.history.max_bytes / (4 * AUDIT_ROW_BYTES)).max(LEAST_AUDIT_ROWS),
        outbox: config.fleet.is_some(),
    };
    let opening =
        StoreWriter::start(&config.history.folder, retention, Arc::clone(&metrics), clock::wall_ns());
    let (writer, reader, report) = records.block_on(opening)?;
    let parts = Parts { config, lock, runtime, records, metrics, writer, reader, report };
    parts.start()
}

/// A runtime with one thread.
fn worker(name: &str, begins: fn()) -> Result<tokio::runtime::Runtime, ServiceError> {
    let mut builder = tokio::runtime::Builder::new_multi_thread();
    let built = builder.worker_threads(1).thread_name(name).on_thread_start(begins).enable_all().build();
    built.map_err(|source| ServiceError::Files { path: format!("thread {name}").into(), source })
}

/// How often the lock is asked for again.
const LOCK_TRIES: usize = 15;
/// Pause before each time.
const LOCK_PAUSE: std::time::Duration = std::time::Duration::from_millis(20);

/// One service on one folder: the lock is held for life. A process that another thread is just starting
/// holds a copy of it until it runs its own program: it is asked for again for a moment.
fn lock_state(folder: &Path) -> Result<File, ServiceError> {
    let files = |path: &Path, source| ServiceError::Files { path: path.to_owned(), source };
    own_folder(folder, 0o750).map_err(|e| files(folder, e))?;
    let path = folder.join(LOCK);
    let file = own_lock(&path).map_err(|e| files(&path, e))?;
    let mut tries_left = LOCK_TRIES;
    loop {
        match file.try_lock() {
            Ok(()) => return Ok(file),
            Err(TryLockError::Error(source)) => return Err(files(&path, source)),
            Err(TryLockError::WouldBlock) if tries_left == 0 => {
                return Err(ServiceError::SecondInstance { path });
            }
            Err(TryLockError::WouldBlock) => std::thread::sleep(LOCK_PAUSE),
        }
        tries_left -= 1;
    }
}

struct Parts {
    config: Arc<ServiceConfig>,
    lock: File,
    /// Requests.
    runtime: tokio::runtime::Runtime,
    /// Reports of the pipeline and the history.
    records: tokio::runtime::Runtime,
    metrics: Arc<Metrics>,
    writer: StoreWriter,
    reader: StoreReader,
    report: OpenReport,
}

/// What is reached from outside.
struct Doors {
    access: Access,
    tls: Option<TlsAcceptor>,
    listener: TcpListener,
    address: SocketAddr,
    agents: Option<TcpListener>,
}

/// What the pipeline thread shares with the other parts.
struct EngineLinks {
    reports: mpsc::Sender<Report>,
    controls: mpsc::Receiver<Control>,
    recorder: std::sync::mpsc::SyncSender<recorder::Job>,
    drift: std::sync::mpsc::SyncSender<drift::Feed>,
    progress: Arc<AtomicU64>,
    way_back: Arc<WayBack>,
    commissioning: Arc<Commissioning>,
}

impl Parts {
    fn start(self) -> Result<Running, ServiceError> {
        let config = Arc::clone(&self.config);
        let shown = shown_config(&config);
        self.metrics.set_config_hash(&shown.hash)?;
        let Doors { access, tls, listener, address, agents } = self.open_doors()?;
        let (stream, _) = broadcast::channel(STREAM);
        let (control, controls) = mpsc::channel(CONTROLS);
        let announcer = self.start_announcer((stream.clone(), control.clone()));
        let (recordings, recorder_queue, recorder) = self.start_recorder(announcer.clone())?;
        let (drift_feeds, drift) = self.start_drift((announcer.clone(), control.clone()))?;
        let (reports, reported) = mpsc::channel(REPORTS);
        let progress = Arc::new(AtomicU64::new(0));
        let way_back = Arc::new(WayBack::new());
        let commissioning = self.commissioning();
        let engine = self.start_engine(
            &shown.hash,
            EngineLinks {
                reports,
                controls,
                recorder: recorder_queue,
                drift: drift_feeds,
                progress: Arc::clone(&progress),
                way_back: Arc::clone(&way_back),
                commissioning: Arc::clone(&commissioning),
            },
        )?;

        let (state, watched_state) = watch::channel(Arc::new(LiveState::default()));
        let (spectrum, watched_spectrum) = watch::channel(Arc::new(SpectrumView::default()));
        let past = Arc::new(Mutex::new(Past::default()));
        let outlets = Outlets {
            state,
            spectrum,
            stream: stream.clone(),
            announcer: announcer.clone(),
            past: Arc::clone(&past),
        };
        let (hub, kept) = self.start_hub(outlets, reported);
        let watched = (recordings.clone(), recording_limits(&config));
        let upkeep = self.upkeep(announcer.clone(), watched, (kept, &commissioning));
        let upkeep = self.runtime.spawn(upkeep.run());
        let handle = Handle(Arc::new(Inner {
            address,
            state: watched_state,
            spectrum: watched_spectrum,
            stream,
            control: control.clone(),
            pipeline: engine.thread().clone(),
            announcer,
            writer: self.writer.clone(),
            reader: self.reader.clone(),
            metrics: Arc::clone(&self.metrics),
            recordings,
            diagnoses: diagnoses_of(&config),
            config: shown,
            stop: CancellationToken::new(),
            settings: Arc::clone(&config),
            curves: CurveCache::default(),
            way_back,
            commissioning: Arc::clone(&commissioning),
            answered: Mutex::default(),
            past,
            settled: CancellationToken::new(),
        }));
        let past = self.start_beside(&handle, agents);
        let http = self.serve(&handle, listener, (access, tls));
        let told = self.runtime.spawn(self.first_entries().tell(handle.clone()));
        // A disk that refuses is no reason not to run: what waits for it is kept like everything else.
        drop(self.runtime.block_on(async { tokio::time::timeout(FIRST_ENTRIES, told).await }));
        Ok(Running {
            handle,
            runtime: self.runtime,
            records: self.records,
            engine,
            recorder,
            drift,
            hub,
            upkeep,
            past,
            http,
            control,
            writer: self.writer,
            progress,
            _lock: self.lock,
        })
    }

    /// What is reached from outside: each address is taken before anything runs.
    fn open_doors(&self) -> Result<Doors, ServiceError> {
        let config = &self.config;
        let access = access(config)?;
        let tls = config.http.tls.as_ref().map(|(c, k)| tls_acceptor(c, k)).transpose()?;
        let listener = self.listen("http.listen", config.http.listen)?;
        let bound = listener.local_addr();
        let address = bound.map_err(|source| ServiceError::Files { path: "http.listen".into(), source })?;
        let agents = config.mtconnect.map(|a| self.listen("mtconnect.listen", a)).transpose()?;
        Ok(Doors { access, tls, listener, address, agents })
    }

    fn start_engine(&self, config_hash: &str, links: EngineLinks) -> Result<JoinHandle<()>, ServiceError> {
        let EngineLinks { reports, controls, recorder, drift, progress, way_back, commissioning } = links;
        let (prefix, root) = &self.config.transport;
        let setup = engine::Setup {
            config: Arc::clone(&self.config),
            config_hash: config_hash.to_owned(),
            domain: Domain::new(prefix, root)?,
            epoch: u64::try_from(self.report.epoch).unwrap_or(0),
            reports,
            controls,
            recorder,
            drift,
            metrics: Arc::clone(&self.metrics),
            progress,
            store: StoreWatch::new(Arc::clone(self.writer.gauges())),
            way_back,
            commissioning,
        };
        Ok(engine::start(setup)?)
    }

    /// The task, and where the upkeep says what the history is like.
    fn start_hub(
        &self,
        outlets: Outlets,
        reported: mpsc::Receiver<Report>,
    ) -> (tokio::task::JoinHandle<()>, watch::Sender<Kept>) {
        let unseen = Kept { store: StoreView { healthy: true, ..StoreView::default() }, open_alarms: 0 };
        let (kept, watched_kept) = watch::channel(unseen);
        let hub = Hub::new(outlets, Arc::clone(&self.metrics), watched_kept);
        (self.records.spawn(hub.run(reported)), kept)
    }

    /// What runs beside pipeline and pages; answers the task that keeps the past.
    fn start_beside(&self, handle: &Handle, agents: Option<TcpListener>) -> tokio::task::JoinHandle<()> {
        let (beside, memory) = (self.config.history.folder.clone(), Arc::clone(&handle.0.past));
        let past = self.runtime.spawn(past_file::keep(beside, memory, handle.0.stop.clone()));
        self.runtime.spawn(run_diagnoses(handle.clone()));
        #[cfg(feature = "nats")]
        if let Some(fleet) = &self.config.fleet {
            let sink =
                super::fleet::run(handle.clone(), super::fleet::Broker::of(fleet), fleet.machine.clone());
            self.runtime.spawn(sink);
        }
        if let Some(listener) = agents {
            self.runtime.spawn(mtconnect::serve(handle.clone(), listener));
        }
        past
    }

    fn first_entries(&self) -> FirstEntries {
        let (writer, reader) = (self.writer.clone(), self.reader.clone());
        FirstEntries { config: Arc::clone(&self.config), writer, reader, report: self.report.clone() }
    }

    fn listen(&self, what: &'static str, address: SocketAddr) -> Result<TcpListener, ServiceError> {
        let bound = self.runtime.block_on(TcpListener::bind(address));
        bound.map_err(|source| ServiceError::Listen { what, address, source })
    }

    fn start_announcer(&self, ends: (broadcast::Sender<StreamMessage>, mpsc::Sender<Control>)) -> Announcer {
        let _inside = self.records.enter();
        Announcer::start(self.writer.clone(), Arc::clone(&self.metrics), ends)
    }

    fn serve(
        &self,
        handle: &Handle,
        listener: TcpListener,
        (access, tls): (Access, Option<TlsAcceptor>),
    ) -> tokio::task::JoinHandle<()> {
        let access = Arc::new(access);
        self.runtime.spawn(refresh_tokens(Arc::clone(&access), handle.clone()));
        let site = router(handle.clone(), access, self.config.http.hosts.clone());
        self.runtime.spawn(serve(listener, site, tls, (Arc::clone(&self.metrics), handle.stopping())))
    }

    fn upkeep(
        &self,
        announcer: Announcer,
        recordings: (Recordings, RecordingLimits),
        (kept, commissioning): (watch::Sender<Kept>, &Arc<Commissioning>),
    ) -> Upkeep {
        let history = History {
            writer: self.writer.clone(),
            reader: self.reader.clone(),
            folder: self.config.history.folder.clone(),
            replaced: self.report.damage.as_ref().map(|d| d.moved_to.display().to_string()),
            unchecked: self.report.unchecked,
            file: file_id(&self.config.history.folder.join(crate::store::FILE_NAME)),
        };
        let commissioning = CommissioningUpkeep {
            shown: Arc::clone(commissioning),
            observer: self.observer(),
            turret: self.config.turret.clone(),
            axes: stream_axes(&self.config),
        };
        let metrics = Arc::clone(&self.metrics);
        Upkeep { history, recordings, announcer, metrics, kept, commissioning }
    }

    fn observer(&self) -> Observer {
        Observer {
            epoch: self.report.epoch,
            machine: machine_hash(&self.config),
            started_ns: clock::wall_ns(),
        }
    }

    /// Nothing is known of earlier lives before the first look at the history.
    fn commissioning(&self) -> Arc<Commissioning> {
        let shown = Commissioning::default();
        shown.show(state_of(&self.config.turret, &Observation::default(), Judged::default()));
        Arc::new(shown)
    }

    fn start_recorder(
        &self,
        announcer: Announcer,
    ) -> Result<(Recordings, std::sync::mpsc::SyncSender<recorder::Job>, JoinHandle<()>), ServiceError> {
        let folder = self.config.history.folder.join(RECORDINGS);
        let recordings = Recordings::open(&folder)?;
        let room = recordings.clone();
        self.writer.may_remove(Box::new(move || room.make_room().is_some()));
        let limits = recording_limits(&self.config);
        let outcome: recorder::Outcome = Box::new(move |kind, text| {
            let event = Event { id: clock::new_id(), ..Event::new(kind, clock::wall_ns(), text) };
            announcer.announce(event, Then::Nothing);
        });
        let started = recorder::start(recordings.clone(), limits, Arc::clone(&self.metrics), outcome);
        let (queue, thread) = started.map_err(|source| ServiceError::Files { path: folder, source })?;
        Ok((recordings, queue, thread))
    }

    /// A mismatch is told with the recording that shows it.
    fn start_drift(
        &self,
        (announcer, control): (Announcer, mpsc::Sender<Control>),
    ) -> Result<(std::sync::mpsc::SyncSender<drift::Feed>, JoinHandle<()>), ServiceError> {
        let found = move |mismatch: drift::Mismatch| {
            let (done, saved) = tokio::sync::oneshot::channel();
            let (word, reason) = (EventKind::ModelMismatch.word(), mismatch.sentence());
            let asked = control.try_send(Control::SaveRecording { word, reason, done });
            let recording = asked.ok().and_then(|()| saved.blocking_recv().ok()?.ok());
            let text = match recording {
                Some(id) => format!("{} (recording {id})", mismatch.sentence()),
                None => mismatch.sentence(),
            };
            let mut event = Event::new(EventKind::ModelMismatch, clock::wall_ns(), text);
            (event.id, event.axis) = (clock::new_id(), Some(mismatch.axis));
            announcer.announce(event, Then::Nothing);
        };
        drift::start(Arc::clone(&self.config), Arc::clone(&self.metrics), found)
            .map_err(|source| ServiceError::Files { path: "drift thread".into(), source })
    }
}

/// How often the token file is looked at for changes.
const TOKENS: Duration = Duration::from_secs(1);

/// Looks at the token file on a thread that may wait for the disk, and confirms, from what was read last,
/// that somebody could take the turret back.
async fn refresh_tokens(access: Arc<Access>, handle: Handle) {
    let (stop, way_back) = (handle.stopping(), Arc::clone(&handle.0.way_back));
    let mut look: Option<tokio::task::JoinHandle<()>> = None;
    loop {
        let looking = look.get_or_insert_with(|| {
            let access = Arc::clone(&access);
            tokio::task::spawn_blocking(move || access.refresh())
        });
        if tokio::time::timeout(TOKENS / 2, looking).await.is_ok() {
            look = None;
        }
        let now = clock::now();
        let open = access.way_back(now);
        way_back.confirm(open, now);
        if let Some(trouble) = way_back.note(access.trouble(now)) {
            handle.metrics().security_events.with_label_values(&["token_file"]).inc();
            handle.tell(EventKind::AccessLost, trouble);
        }
        if !open && handle.turret_is_back() {
            access.close_way_back();
        }
        if tokio::time::timeout(TOKENS, stop.cancelled()).await.is_ok() {
            return;
        }
    }
}

fn recording_limits(config: &ServiceConfig) -> RecordingLimits {
    RecordingLimits { max_bytes: config.recorder.max_bytes, max_age_ns: config.recorder.max_age_ns }
}

impl Running {
    /// The way in.
    #[must_use]
    pub fn handle(&self) -> &Handle {
        &self.handle
    }

    /// Wakes of the pipeline thread so far: a watchdog is fed while it grows.
    #[must_use]
    pub fn progress(&self) -> u64 {
        self.progress.load(Ordering::Relaxed)
    }

    /// A part that has ended by itself, which none ever should: the service is then to be started anew.
    #[must_use]
    pub fn failed_part(&self) -> Option<&'static str> {
        let parts = [
            ("pipeline", self.engine.is_finished()),
            ("recorder", self.recorder.is_finished()),
            ("comparison with the model", self.drift.is_finished()),
            ("hub", self.hub.is_finished()),
            ("upkeep", self.upkeep.is_finished()),
            ("HTTP", self.http.is_finished()),
            ("history", self.writer.has_ended() || self.handle.0.announcer.has_ended()),
        ];
        parts.into_iter().find(|(_, ended)| *ended).map(|(name, _)| name)
    }

    /// Waits for something on the service's own runtime, for callers without one.
    pub fn wait<T>(&self, what: impl Future<Output = T>) -> T {
        self.runtime.block_on(what)
    }

    /// Stops in order: no more samples, everything reported is stored, open requests end. What the disk
    /// refuses by now is kept for the next start. Answers how many writes were lost all the same.
    pub fn stop(self) -> usize {
        let Self { handle, runtime, records, engine, recorder, drift, .. } = self;
        let Self { hub, upkeep, past, http, control, writer, .. } = self;
        let stored = async {
            // The thread may have ended already; then nobody listens.
            let _ = control.send(Control::Stop).await;
        };
        runtime.block_on(async { drop(tokio::time::timeout(STOP_DEADLINE, stored).await) });
        let _ = engine.join();
        let _ = recorder.join();
        let _ = drift.join();
        let gauges = Arc::clone(writer.gauges());
        let closed = runtime.block_on(async {
            let _ = tokio::time::timeout(STOP_DEADLINE, hub).await;
            upkeep.abort();
            handle.tell(EventKind::ServiceStop, "stopped in good order".to_owned());
            handle.request_stop();
            let _ = tokio::time::timeout(STOP_DEADLINE, http).await;
            let _ = tokio::time::timeout(STOP_DEADLINE, past).await;
            handle.0.reader.close().await;
            tokio::time::timeout(STOP_DEADLINE, writer.close()).await.is_ok()
        });
        let waiting = if closed { 0 } else { gauges.waiting.load(Ordering::Relaxed) };
        if waiting > 0 {
            tracing::error!(
                event = "store_lost",
                "the disk does not answer; lost: {}",
                counted(waiting, "write")
            );
        }
        drop((handle, writer));
        runtime.shutdown_timeout(STOP_DEADLINE);
        records.shutdown_timeout(STOP_DEADLINE);
        waiting + gauges.lost.load(Ordering::Relaxed)
    }
}
