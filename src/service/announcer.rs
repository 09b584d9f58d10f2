//! Tells events: log and counter at once, history first, then listeners, in the order of the history.

use super::control::Control;
use super::live::StreamMessage;
use crate::store::{PastCut, StoreError, StoreWriter};
use crate::telemetry::{Event, Metrics};
use std::sync::Arc;
use tokio::sync::{broadcast, mpsc, oneshot};

/// Events that may wait for the disk; as many as the history's own queue takes.
const WAITING: usize = 8192;

/// What is to be done once an event is durable, beside telling listeners.
#[derive(Debug)]
pub(super) enum Then {
    /// Nothing.
    Nothing,
    /// Tell the pipeline thread that its intent is on record.
    Committed(u64),
    /// Tell whoever waits.
    Done(oneshot::Sender<()>),
}

struct Waiting {
    stored: oneshot::Receiver<Event>,
    then: Then,
}

/// The way to tell an event.
#[derive(Debug, Clone)]
pub(super) struct Announcer {
    writer: StoreWriter,
    metrics: Arc<Metrics>,
    queue: mpsc::Sender<Waiting>,
}

impl Announcer {
    /// Starts the task that tells listeners. Call on the runtime.
    pub(super) fn start(
        writer: StoreWriter,
        metrics: Arc<Metrics>,
        (stream, control): (broadcast::Sender<StreamMessage>, mpsc::Sender<Control>),
    ) -> Self {
        let (queue, waiting) = mpsc::channel(WAITING);
        tokio::spawn(tell(waiting, stream, control));
        Self { writer, metrics, queue }
    }

    /// Counts, logs and stores an event; listeners hear of it once it is durable.
    /// An event that finds no place is counted as dropped: only a disk that fails for long does that.
    pub(super) fn announce(&self, event: Event, then: Then) {
        self.metrics.events.with_label_values(&[event.kind.word()]).inc();
        event.log();
        let queued = self
            .writer
            .begin_store(event)
            .and_then(|stored| self.queue.try_send(Waiting { stored, then }).map_err(|_| StoreError::Closed));
        if queued.is_err() {
            self.metrics.queue_dropped.with_label_values(&["store", "false"]).inc();
        }
    }

    /// Stores a past cut. One that finds no place is counted as dropped.
    pub(super) fn keep_cut(&self, cut: PastCut) {
        if self.writer.store_cut(cut).is_err() {
            self.metrics.queue_dropped.with_label_values(&["store", "false"]).inc();
        }
    }

    /// True when the task that tells listeners has ended.
    pub(super) fn has_ended(&self) -> bool {
        self.queue.is_closed()
    }

    /// As [`Self::announce`], and waits until the event is durable.
    pub(super) async fn announce_durably(&self, event: Event) {
        let (done, told) = oneshot::channel();
        self.announce(event, Then::Done(done));
        let _ = told.await; // dropped: counted there
    }
}

async fn tell(
    mut waiting: mpsc::Receiver<Waiting>,
    stream: broadcast::Sender<StreamMessage>,
    control: mpsc::Sender<Control>,
) {
    while let Some(Waiting { stored, then }) = waiting.recv().await {
        let Ok(event) = stored.await else { continue };
        let data = serde_json::to_string(&crate::http::EventView::from(&event)).unwrap_or_default();
        // No listener is no error.
        let _ = stream.send(StreamMessage { id: Some(event.sequence), kind: "event", data: data.into() });
        match then {
            Then::Nothing => {}
            Then::Committed(sequence) => {
                // A pipeline that no longer listens has ended.
                let _ = control.send(Control::Committed { sequence }).await;
            }
            Then::Done(done) => {
                let _ = done.send(());
            }
        }
    }
}
