//! Events out of the history to the broker: in order, at least once, known by their id.

use super::{Broker, BrokerError, DEADLINE, events_stream, refused};
use crate::http::EventView;
use crate::service::Handle;
use crate::store::EventFilter;
use crate::telemetry::Event;
use async_nats::jetstream::Context;
use async_nats::jetstream::message::PublishMessage;
use std::time::Duration;

/// Name of this sink in the history.
const SINK: &str = "nats";
/// Events of one round.
const ROUND: i64 = 200;
/// Between two tries while the broker is away.
const AGAIN: Duration = Duration::from_secs(1);
/// Without news the history is looked at this often.
const LOOK: Duration = Duration::from_secs(1);

/// Sends until the service stops. The broker may come and go as it likes.
pub(in crate::service) async fn run(handle: Handle, broker: Broker, machine: String) {
    let stop = handle.stopping();
    tokio::select! {
        () = stop.cancelled() => {}
        () = send_for_ever(&handle, &broker, &machine) => {}
    }
}

async fn send_for_ever(handle: &Handle, broker: &Broker, machine: &str) {
    let mut away = false;
    loop {
        let Err(error) = send_while_connected(handle, broker, machine, &mut away).await;
        handle.metrics().outbox_sent.with_label_values(&["failed"]).inc();
        if !std::mem::replace(&mut away, true) {
            tracing::warn!(event = "broker_away", "{error}; events are kept and sent later");
        }
        handle.note_outbox(SINK).await;
        tokio::time::sleep(AGAIN).await;
    }
}

async fn send_while_connected(
    handle: &Handle,
    broker: &Broker,
    machine: &str,
    away: &mut bool,
) -> Result<std::convert::Infallible, BrokerError> {
    let context = async_nats::jetstream::new(broker.connect().await?);
    events_stream(&context).await?;
    if std::mem::replace(away, false) {
        tracing::info!(event = "broker_back", "the broker answers again");
    }
    let history = |e: crate::service::OperationError| refused("history")(e.into());
    let mut news = handle.subscribe();
    loop {
        let confirmed = handle.outbox_confirmed(SINK).await.map_err(history)?;
        let filter =
            EventFilter { cursor: Some(confirmed), ascending: true, limit: ROUND, ..EventFilter::default() };
        let page = handle.events(&filter).await.map_err(history)?;
        let mut last = None;
        let mut outcome = Ok(());
        for event in &page.events {
            outcome = publish(&context, machine, event).await;
            if outcome.is_err() {
                break;
            }
            last = Some(event.sequence);
            handle.metrics().outbox_sent.with_label_values(&["sent"]).inc();
        }
        if let Some(sequence) = last {
            handle.confirm_outbox(SINK, sequence).await.map_err(history)?;
        }
        handle.note_outbox(SINK).await;
        outcome?;
        if page.events.is_empty() {
            // News or a second, whichever comes first; what it was is read from the history.
            let _ = tokio::time::timeout(LOOK, async {
                while news.recv().await.is_ok_and(|m| m.kind != "event") {}
            })
            .await;
        }
    }
}

async fn publish(context: &Context, machine: &str, event: &Event) -> Result<(), BrokerError> {
    let fail = refused("event");
    let mut body = serde_json::to_value(EventView::from(event)).map_err(|e| fail(e.into()))?;
    if let Some(fields) = body.as_object_mut() {
        fields.insert("machine".into(), machine.into());
    }
    let subject = format!("stillcut.events.{machine}.{}", event.kind.word());
    let message = PublishMessage::build().payload(body.to_string().into_bytes().into()).message_id(&event.id);
    let sent = async {
        let acknowledged = context.send_publish(subject, message).await.map_err(|e| fail(e.into()))?;
        acknowledged.await.map_err(|e| fail(e.into()))
    };
    match tokio::time::timeout(DEADLINE, sent).await {
        Ok(outcome) => outcome.map(|_| ()),
        Err(_) => Err(fail("no answer in 5 s".into())),
    }
}
