//! The one task that writes: whatever waits goes into one transaction, with full sync.

use super::ahead::Ahead;
use super::audit::{AuditEntry, CUT, append};
use super::cuts::PastCut;
use super::evidence::{FALSE, Observation, Observer, RIGHT};
use super::mark::{Marker, Missing};
use super::open::{OpenReport, checkpoint, mark_suspect, open};
use super::reserve::{Kept, Reserve};
use super::retention::{Removed, Retention, prune};
use super::{StoreError, StoreReader, code_of, options};
use crate::ownership::own_folder;
use crate::telemetry::{Event, Metrics};
use crate::units::counted;
use sqlx::{Connection as _, Row as _, SqliteConnection};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};
use tokio::time::Instant;

/// Most writes of one transaction.
const BATCH: usize = 256;
/// Most writes waiting; beyond it the sender is told.
const QUEUE: usize = 8192;
/// Pause before a failed transaction is tried again.
const RETRY: Duration = Duration::from_millis(500);
/// What is committed stands in the log alone no longer than this: a damaged log takes no more away.
const CHECKPOINT: Duration = Duration::from_secs(2);
/// On a slow disk longer: moving the log takes at most this part of the time, since writes wait for it.
const CHECKPOINT_PART: u32 = 20;

/// Removes something that is worth less than the history; answers false where there is nothing.
pub type MakeRoom = Box<dyn Fn() -> bool + Send + Sync>;

enum Write {
    Event(Box<Event>, oneshot::Sender<Event>),
    Acknowledge { sequence: i64, right: Option<bool>, entry: AuditEntry, done: oneshot::Sender<bool> },
    Silence { sequence: i64, until_ns: i64, entry: AuditEntry, done: oneshot::Sender<bool> },
    Audit(AuditEntry, oneshot::Sender<i64>),
    Cut(Box<PastCut>),
    Confirm { sink: &'static str, sequence: i64, done: oneshot::Sender<bool> },
    Settings { epoch: i64, hash: String, done: oneshot::Sender<bool> },
    Observed { observer: Observer, seen: Observation, done: oneshot::Sender<bool> },
    Prune { now_ns: i64, done: oneshot::Sender<Removed> },
    Close(oneshot::Sender<()>),
}

/// State of the writer that health and metrics show.
#[derive(Debug, Default)]
pub struct WriterGauges {
    /// Writes that wait.
    pub waiting: AtomicUsize,
    /// Wall clock of the last durable commit is kept by the caller; this counts commits.
    pub commits: AtomicI64,
    /// Consecutive failures of the transaction at hand; 0 when healthy.
    pub failures: AtomicI64,
    /// What is committed is not kept: the file is no longer where it was opened, or it is damaged.
    pub broken: AtomicBool,
    /// The service ends: what cannot be stored now is kept beside the history.
    closing: AtomicBool,
    /// Writes that at the end could be neither stored nor kept.
    pub lost: AtomicUsize,
}

/// Sends writes to the writing task. Clones send to the same task.
#[derive(Debug, Clone)]
pub struct StoreWriter {
    queue: mpsc::Sender<Write>,
    gauges: Arc<WriterGauges>,
    room: Room,
}

/// What makes room on a full disk, once it is known.
#[derive(Clone, Default)]
struct Room(Arc<OnceLock<MakeRoom>>);

impl std::fmt::Debug for Room {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Room")
    }
}

impl std::fmt::Debug for Write {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Write")
    }
}

struct Task {
    connection: SqliteConnection,
    path: PathBuf,
    retention: Retention,
    gauges: Arc<WriterGauges>,
    metrics: Arc<Metrics>,
    reserve: Reserve,
    marker: Marker,
    room: Room,
    ahead: Ahead,
    /// Since when the log holds what the main file does not.
    in_log: Option<Instant>,
    checkpoint_every: Duration,
}

impl StoreWriter {
    /// Opens the history in `folder` and starts the writing task on the current runtime.
    /// Errors: what [`StoreError`] says; a damaged file is none, it is replaced and reported.
    pub async fn start(
        folder: &Path,
        retention: Retention,
        metrics: Arc<Metrics>,
        wall_ns: i64,
    ) -> Result<(Self, StoreReader, OpenReport), StoreError> {
        own_folder(folder, 0o750).map_err(|source| StoreError::Files { path: folder.to_owned(), source })?;
        let path = folder.join(super::FILE_NAME);
        if path.is_dir() {
            let source = std::io::Error::other("is a folder; expected the history file, or nothing");
            return Err(StoreError::Files { path, source });
        }
        let (connection, report) = open(&path, wall_ns).await?;
        let (queue, waiting) = mpsc::channel(QUEUE);
        let gauges = Arc::new(WriterGauges::default());
        let reader = StoreReader::new(&path, Arc::clone(&metrics));
        let reserve = Reserve::open(folder)?;
        let room = Room::default();
        let mut task = Task {
            connection,
            path,
            retention,
            gauges: Arc::clone(&gauges),
            metrics,
            marker: Marker::new(reserve.path(), report.marked),
            reserve,
            room: room.clone(),
            ahead: Ahead::default(),
            in_log: None,
            checkpoint_every: CHECKPOINT,
        };
        task.checkpoint().await; // the main file is never empty for long
        if let Some(missing) = &report.missing {
            task.count_missing(missing);
            task.tell_missing(missing.sentence(), wall_ns).await;
        } else if let [one, other] = &report.spoilt_notes[..] {
            let what = format!("{one}, {other}: nobody knows whether rows are missing");
            task.tell_missing(what, wall_ns).await;
        }
        task.take_kept().await;
        tokio::spawn(task.run(waiting));
        Ok((Self { queue, gauges, room }, reader, report))
    }

    /// Says what may go where the disk is full. Once; a second time changes nothing.
    pub fn may_remove(&self, room: MakeRoom) {
        let _ = self.room.0.set(room);
    }

    /// State of the writer.
    #[must_use]
    pub fn gauges(&self) -> &Arc<WriterGauges> {
        &self.gauges
    }

    /// True when the writing task has ended.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        self.queue.is_closed()
    }

    fn push(&self, write: Write) -> Result<(), StoreError> {
        self.queue.try_send(write).map_err(|_| StoreError::Closed)?;
        self.gauges.waiting.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// Queues an event; what is answered comes with its place once it is durable.
    /// Errors: the queue is full or closed; the caller counts it.
    pub fn begin_store(&self, event: Event) -> Result<oneshot::Receiver<Event>, StoreError> {
        let (done, stored) = oneshot::channel();
        self.push(Write::Event(Box::new(event), done))?;
        Ok(stored)
    }

    /// Stores an event and answers it with its place once it is durable. Errors: queue full or closed.
    pub async fn store_durably(&self, event: Event) -> Result<Event, StoreError> {
        self.begin_store(event)?.await.map_err(|_| StoreError::Closed)
    }

    /// Marks an event as acknowledged by the actor of `entry`, in one transaction with that row of the audit
    /// record. Answers false where there is no such event: then there is no row either.
    pub async fn acknowledge(
        &self,
        sequence: i64,
        right: Option<bool>,
        entry: AuditEntry,
    ) -> Result<bool, StoreError> {
        let (done, outcome) = oneshot::channel();
        self.push(Write::Acknowledge { sequence, right, entry, done })?;
        outcome.await.map_err(|_| StoreError::Closed)
    }

    /// Silences an event until a time, in one transaction with that row of the audit record. Answers false
    /// where there is no such event: then there is no row either. Errors: queue full or closed.
    pub async fn silence(&self, sequence: i64, until_ns: i64, entry: AuditEntry) -> Result<bool, StoreError> {
        let (done, outcome) = oneshot::channel();
        self.push(Write::Silence { sequence, until_ns, entry, done })?;
        outcome.await.map_err(|_| StoreError::Closed)
    }

    /// Notes that a sink outside has confirmed every event up to `sequence`; never goes back. Errors: queue
    /// full or closed.
    pub async fn confirm(&self, sink: &'static str, sequence: i64) -> Result<(), StoreError> {
        let (done, outcome) = oneshot::channel();
        self.push(Write::Confirm { sink, sequence, done })?;
        outcome.await.map(|_| ()).map_err(|_| StoreError::Closed)
    }

    /// Appends to the audit chain; answers the place once it is durable. Errors: queue full or closed.
    pub async fn audit(&self, entry: AuditEntry) -> Result<i64, StoreError> {
        let (done, outcome) = oneshot::channel();
        self.push(Write::Audit(entry, done))?;
        outcome.await.map_err(|_| StoreError::Closed)
    }

    /// Queues a past cut; nobody waits for it. Errors: the queue is full or closed; the caller counts it.
    pub fn store_cut(&self, cut: PastCut) -> Result<(), StoreError> {
        self.push(Write::Cut(Box::new(cut)))
    }

    /// Notes the settings of a life. Durable when it returns. Errors: queue full or closed.
    pub async fn note_settings(&self, epoch: i64, hash: &str) -> Result<(), StoreError> {
        let (done, outcome) = oneshot::channel();
        self.push(Write::Settings { epoch, hash: hash.to_owned(), done })?;
        outcome.await.map(|_| ()).map_err(|_| StoreError::Closed)
    }

    /// Notes what this life has observed so far. Durable when it returns. Errors: queue full or closed.
    pub async fn note_observed(&self, observer: &Observer, seen: Observation) -> Result<(), StoreError> {
        let (done, outcome) = oneshot::channel();
        self.push(Write::Observed { observer: observer.clone(), seen, done })?;
        outcome.await.map(|_| ()).map_err(|_| StoreError::Closed)
    }

    /// Stores what waits, checkpoints and closes the file; what a disk refuses by now is kept beside it for
    /// the next start. Errors: it was closed already.
    pub async fn close(&self) -> Result<(), StoreError> {
        self.gauges.closing.store(true, Ordering::Relaxed);
        let (done, closed) = oneshot::channel();
        self.push(Write::Close(done))?;
        closed.await.map_err(|_| StoreError::Closed)
    }

    /// Removes what the retention says; answers what went. Errors: queue full or closed.
    pub async fn prune(&self, now_ns: i64) -> Result<Removed, StoreError> {
        let (done, outcome) = oneshot::channel();
        self.push(Write::Prune { now_ns, done })?;
        outcome.await.map_err(|_| StoreError::Closed)
    }
}

/// What a write answers once its transaction is durable.
enum Answer {
    Event(Box<Event>),
    Done(bool),
    Sequence(i64),
    Removed(Removed),
}

/// Tries after the end was asked for: a disk that refuses them all is not waited for.
const LAST_TRIES: u32 = 3;

impl Task {
    async fn run(mut self, mut queue: mpsc::Receiver<Write>) {
        let mut closing = None;
        while closing.is_none()
            && let Some(first) = self.next(&mut queue).await
        {
            let mut batch = vec![first];
            while batch.len() < BATCH
                && let Ok(next) = queue.try_recv()
            {
                batch.push(next);
            }
            closing = self.take_close(&mut batch, &mut queue);
            let Some(answers) = self.commit_until_done(&batch).await else {
                while let Ok(last) = queue.try_recv() {
                    batch.push(last);
                }
                closing = closing.or_else(|| self.take_close(&mut batch, &mut queue));
                self.keep_beside(&batch);
                break;
            };
            self.gauges.waiting.fetch_sub(batch.len(), Ordering::Relaxed);
            answer_all(batch, answers);
            let due = self.in_log.get_or_insert_with(Instant::now).elapsed() >= self.checkpoint_every;
            if due || self.ahead.is_short(&mut self.connection).await {
                self.checkpoint().await;
            }
        }
        queue.close();
        let _ = sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)").execute(&mut self.connection).await;
        let _ = self.connection.close().await;
        if let Some(Write::Close(done)) = closing {
            let _ = done.send(());
        }
    }

    /// What comes next; a log that has stood for a while is moved into the main file meanwhile.
    async fn next(&mut self, queue: &mut mpsc::Receiver<Write>) -> Option<Write> {
        if let Some(since) = self.in_log {
            let left = self.checkpoint_every.saturating_sub(since.elapsed());
            if let Ok(next) = tokio::time::timeout(left, queue.recv()).await {
                return next;
            }
            self.checkpoint().await;
        }
        queue.recv().await
    }

    async fn checkpoint(&mut self) {
        let began = Instant::now();
        checkpoint(&mut self.connection).await;
        self.in_log = None;
        self.checkpoint_every = CHECKPOINT.max(CHECKPOINT_PART * began.elapsed());
        if self.ahead.is_short(&mut self.connection).await {
            self.take_ahead().await;
        }
    }

    /// Takes room ahead; on a full disk one recording goes for it.
    async fn take_ahead(&mut self) {
        let mut taken = self.ahead.take(&self.path, &mut self.connection).await;
        if let Err(error) = &taken {
            self.metrics.store_errors.with_label_values(&[code_of(error)]).inc();
            if self.make_room(error).await {
                taken = self.ahead.take(&self.path, &mut self.connection).await;
            }
        }
        self.ahead.note(taken.is_ok(), &mut self.connection).await;
    }

    fn count_missing(&self, missing: &Missing) {
        for (table, count) in [("event", missing.events), ("audit", missing.audit_rows)] {
            let count = u64::try_from(count).unwrap_or(0);
            self.metrics.history_lost.with_label_values(&[table]).inc_by(count);
        }
    }

    /// Puts on record what an earlier life had made durable and this one does not find, or that nobody knows.
    async fn tell_missing(&mut self, what: String, wall_ns: i64) {
        let entry = AuditEntry {
            wall_ns,
            actor: "service".into(),
            role: "service".into(),
            action: CUT.into(),
            detail: what.clone(),
        };
        // Not stored, the mark stays as it is, and the next start tells it again.
        if let Err(error) = self.commit(&[Write::Audit(entry, oneshot::channel().0)]).await {
            tracing::error!(event = "history_cut", "{what}: {error}");
        }
    }

    /// Takes the word to close out of a batch; nothing more is let in then, and what waits joins the batch.
    fn take_close(&self, batch: &mut Vec<Write>, queue: &mut mpsc::Receiver<Write>) -> Option<Write> {
        let place = batch.iter().position(|w| matches!(w, Write::Close(_)))?;
        let closing = batch.remove(place);
        queue.close();
        while let Ok(last) = queue.try_recv() {
            batch.push(last);
        }
        self.gauges.waiting.fetch_sub(1, Ordering::Relaxed);
        Some(closing)
    }

    /// Stores what the life before kept in the reserve.
    async fn take_kept(&mut self) {
        let kept = self.reserve.read();
        if kept.is_empty() {
            return;
        }
        let writes = counted(kept.len(), "write");
        let write = |one: Kept| match one.restore() {
            Ok(event) => Write::Event(Box::new(event), oneshot::channel().0),
            Err(entry) => Write::Audit(entry, oneshot::channel().0),
        };
        let batch: Vec<Write> = kept.into_iter().map(write).collect();
        match self.commit(&batch).await {
            Ok(_) => {
                self.reserve.clear();
                tracing::info!(event = "store_kept", "stored from the life before: {writes}");
            }
            Err(error) => tracing::error!(event = "store_kept", "not yet stored: {writes}: {error}"),
        }
    }

    /// The end, and the disk refuses: events and rows of the audit record go into the reserve, and what finds
    /// no room there is told one by one.
    fn keep_beside(&self, batch: &[Write]) {
        let line = |write: &Write| match write {
            Write::Event(event, _) => Some(Kept::event(event)),
            Write::Audit(entry, _) => Some(Kept::audit(entry)),
            _ => None, // whoever asked for it is told that it was not done
        };
        let mut waiting = self.reserve.read(); // of a life before, where that could not be stored either
        waiting.extend(batch.iter().filter_map(line));
        let kept = self.reserve.keep(&waiting);
        let (writes, path) = (counted(kept, "write"), self.reserve.path().display());
        tracing::error!(event = "store_kept", "kept in {path} for the next start: {writes}");
        for lost in waiting.get(kept..).unwrap_or_default() {
            let text = serde_json::to_string(lost).unwrap_or_default();
            tracing::error!(event = "store_lost", "{text}");
        }
        let lost = waiting.len() - kept;
        self.gauges.lost.fetch_add(lost, Ordering::Relaxed);
        self.metrics.queue_dropped.with_label_values(&["store", "false"]).inc_by(lost as u64);
    }

    /// Tries until it works; gives up only when the service is ending and the disk still refuses.
    async fn commit_until_done(&mut self, batch: &[Write]) -> Option<Vec<Answer>> {
        let mut last_tries = 0;
        loop {
            match self.commit(batch).await {
                Ok(answers) => {
                    self.gauges.failures.store(0, Ordering::Relaxed);
                    self.gauges.commits.fetch_add(1, Ordering::Relaxed);
                    return Some(answers);
                }
                // The log begins anew where all of it stands in the main file: that asks for no new room.
                Err(error) if code_of(&error) == "full" && self.in_log.take().is_some() => {
                    self.metrics.store_errors.with_label_values(&["full"]).inc();
                    self.reconnect().await;
                    checkpoint(&mut self.connection).await;
                }
                Err(error) if self.make_room(&error).await => {
                    let code = code_of(&error);
                    self.metrics.store_errors.with_label_values(&[code]).inc();
                    self.reconnect().await;
                }
                Err(error) => {
                    self.count_failure(&error);
                    last_tries += u32::from(self.gauges.closing.load(Ordering::Relaxed));
                    if last_tries >= LAST_TRIES {
                        return None;
                    }
                    tokio::time::sleep(RETRY).await;
                    self.reconnect().await;
                }
            }
        }
    }

    /// Where the disk is full: whether something went that is worth less than what is to be stored.
    async fn make_room(&self, error: &sqlx::Error) -> bool {
        if code_of(error) != "full" {
            return false;
        }
        let room = self.room.clone();
        let made = tokio::task::spawn_blocking(move || room.0.get().is_some_and(|room| room()));
        made.await.unwrap_or(false)
    }

    fn count_failure(&self, error: &sqlx::Error) {
        let code = code_of(error);
        self.metrics.store_errors.with_label_values(&[code]).inc();
        if self.gauges.failures.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::error!(event = "store_failed", code, "{}: {error}", self.path.display());
            if matches!(code, "corrupt" | "not_a_database") {
                mark_suspect(&self.path);
            }
        }
    }

    /// SQLite may have rolled back by itself (a full disk does): what the driver believes of the open
    /// transaction is then wrong for good, so the next try starts on a connection of its own.
    async fn reconnect(&mut self) {
        if let Ok(fresh) = SqliteConnection::connect_with(&options(&self.path)).await {
            let spent = std::mem::replace(&mut self.connection, fresh);
            let _ = spent.close().await; // it failed already; what it said was counted
        }
    }

    async fn commit(&mut self, batch: &[Write]) -> Result<Vec<Answer>, sqlx::Error> {
        let mut transaction = self.connection.begin_with("BEGIN IMMEDIATE").await?;
        let mut answers = Vec::with_capacity(batch.len());
        for write in batch {
            answers.push(apply(&mut transaction, write, self.retention).await?);
        }
        transaction.commit().await?;
        // What a mark that cannot be written does not cover is durable all the same; it was told.
        let _ = self.marker.note(&mut self.connection).await;
        Ok(answers)
    }
}

async fn apply(
    connection: &mut SqliteConnection,
    write: &Write,
    keep: Retention,
) -> Result<Answer, sqlx::Error> {
    match write {
        Write::Event(event, _) => insert_event(connection, event).await.map(Answer::Event),
        Write::Acknowledge { sequence, right, entry, .. } => {
            // The first acknowledgement stays; another one is on record all the same.
            let update = "UPDATE event SET acknowledged_by = coalesce(acknowledged_by, ?), \
                 acknowledged_ns = coalesce(acknowledged_ns, ?), judged = coalesce(?, judged) \
                 WHERE sequence = ?";
            let judged = right.map(|right| if right { RIGHT } else { FALSE });
            let query =
                sqlx::query(update).bind(&entry.actor).bind(entry.wall_ns).bind(judged).bind(sequence);
            let done = query.execute(&mut *connection).await?;
            on_record(connection, entry, done.rows_affected() > 0).await
        }
        Write::Silence { sequence, until_ns, entry, .. } => {
            let update = "UPDATE event SET silenced_until_ns = ? WHERE sequence = ?";
            let query = sqlx::query(update).bind(until_ns).bind(sequence);
            let done = query.execute(&mut *connection).await?;
            on_record(connection, entry, done.rows_affected() > 0).await
        }
        Write::Confirm { sink, sequence, .. } => {
            let upsert = "INSERT INTO outbox (sink, confirmed) VALUES (?, ?) \
                 ON CONFLICT (sink) DO UPDATE SET confirmed = max(confirmed, excluded.confirmed)";
            sqlx::query(upsert).bind(*sink).bind(sequence).execute(connection).await?;
            Ok(Answer::Done(true))
        }
        Write::Audit(entry, _) => append(connection, entry).await.map(Answer::Sequence),
        Write::Cut(cut) => super::cuts::insert(connection, cut).await.map(|()| Answer::Done(true)),
        Write::Settings { epoch, hash, .. } => {
            let update = sqlx::query("UPDATE life SET settings = ? WHERE epoch = ?").bind(hash).bind(epoch);
            update.execute(connection).await.map(|_| Answer::Done(true))
        }
        Write::Observed { observer, seen, .. } => {
            super::evidence::note(connection, observer, seen).await.map(|()| Answer::Done(true))
        }
        Write::Close(_) => Ok(Answer::Done(true)), // taken out of the batch before
        Write::Prune { now_ns, .. } => prune(connection, *now_ns, keep).await.map(Answer::Removed),
    }
}

/// Puts on record what was done; nothing where nothing was.
async fn on_record(
    connection: &mut SqliteConnection,
    entry: &AuditEntry,
    done: bool,
) -> Result<Answer, sqlx::Error> {
    if done {
        append(connection, entry).await?;
    }
    Ok(Answer::Done(done))
}

/// Inserts once: an id that is there already (a retry) answers the row that is there.
async fn insert_event(connection: &mut SqliteConnection, event: &Event) -> Result<Box<Event>, sqlx::Error> {
    let insert = "INSERT INTO event \
         (id, wall_ns, kind, axis, t_s, frequency_hz, power_n2, pitch_difference_rad, text) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?) \
         ON CONFLICT (id) DO UPDATE SET id = excluded.id RETURNING sequence";
    let query =
        sqlx::query(insert).bind(&event.id).bind(event.wall_ns).bind(event.kind.word()).bind(&event.axis);
    let query = query.bind(event.t_s).bind(event.frequency_hz).bind(event.power_n2);
    let row = query.bind(event.pitch_difference_rad).bind(&event.text).fetch_one(connection).await?;
    Ok(Box::new(Event { sequence: row.try_get(0)?, ..event.clone() }))
}

/// Tells each sender; one that no longer waits is no error.
fn answer_all(batch: Vec<Write>, answers: Vec<Answer>) {
    for (write, answer) in batch.into_iter().zip(answers) {
        match (write, answer) {
            (Write::Event(_, done), Answer::Event(event)) => {
                let _ = done.send(*event);
            }
            (
                Write::Acknowledge { done, .. }
                | Write::Silence { done, .. }
                | Write::Confirm { done, .. }
                | Write::Settings { done, .. }
                | Write::Observed { done, .. },
                Answer::Done(yes),
            ) => {
                let _ = done.send(yes);
            }
            (Write::Audit(_, done), Answer::Sequence(sequence)) => {
                let _ = done.send(sequence);
            }
            (Write::Prune { done, .. }, Answer::Removed(what)) => {
                let _ = done.send(what);
            }
            _ => {}
        }
    }
}
