//! The live stream: server-sent events that a client can resume.

use super::events::EventView;
use super::problem::{Problem, Refused};
use super::{Role, Site, address_of};
use crate::service::{EventFilter, Handle, StreamMessage, clock};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event as Sse, KeepAlive};
use axum::response::{IntoResponse, Response};
use std::convert::Infallible;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{broadcast, mpsc};
use tokio_stream::wrappers::ReceiverStream;

/// Messages that may wait for one slow client; beyond it the client is told what it missed.
const AHEAD: usize = 16;
/// Missed events that are read at once on reconnection.
const RESUME: i64 = 500;
/// Rounds of that; who missed more is told how many lie between.
const ROUNDS: usize = 40;

/// How often a listener's token is looked at again.
const JUDGED_EVERY: Duration = Duration::from_secs(1);

/// Live data: `state` ten times a second, `force` and `spectrum` twenty times, and every stored `event` with
/// its place as id. With `Last-Event-ID` the events in between come first. Ends when the token does.
#[utoipa::path(get, path = "/api/v1/stream", tag = "live", operation_id = "stream",
    params(("Last-Event-ID" = Option<String>, Header,
        description = "Place of the last event that the client saw")),
    responses((status = 200,
        description = "Server-sent events", body = String, content_type = "text/event-stream"),
        Refused))]
pub(super) async fn stream(State(site): State<Site>, request: Request) -> Result<Response, Problem> {
    let (address, headers) = (address_of(&request), request.into_parts().0.headers);
    let Ok(seat) = Arc::clone(&site.streams).try_acquire_owned() else {
        site.handle.metrics().http_refused.with_label_values(&["streams"]).inc();
        let detail = "too many listeners; close one";
        return Err(Problem::new(StatusCode::SERVICE_UNAVAILABLE, "too_many_streams", detail).retry_after(5));
    };
    let last = headers.get("last-event-id").and_then(|v| v.to_str().ok()).and_then(|v| v.parse::<i64>().ok());
    let (send, receive) = mpsc::channel(AHEAD);
    let handle = site.handle.clone();
    tokio::spawn(async move {
        tokio::select! {
            () = feed(handle, last, send) => {}
            () = revoked(site, headers, address) => {}
        }
        drop(seat);
    });
    let sse = axum::response::Sse::new(ReceiverStream::new(receive));
    Ok(sse.keep_alive(KeepAlive::new().interval(Duration::from_secs(5))).into_response())
}

/// Resolves when the caller may no longer read: the token was taken away or has expired.
async fn revoked(site: Site, headers: HeaderMap, address: IpAddr) {
    let may_read = || {
        let caller = site.access.caller(&headers, address, clock::now());
        caller.is_some_and(|c| c.require(Role::Viewer).is_ok())
    };
    while may_read() {
        tokio::time::sleep(JUDGED_EVERY).await;
    }
}

type Out = mpsc::Sender<Result<Sse, Infallible>>;

/// Ends when the client leaves or the service stops.
async fn feed(handle: Handle, last: Option<i64>, out: Out) {
    let stop = handle.stopping();
    let live = handle.subscribe(); // before looking back, so that nothing falls between
    let work = async {
        let sent = match last {
            Some(place) => resume(&handle, place, &out).await,
            None => Some(0),
        };
        if let Some(sent) = sent {
            forward(live, sent, &out).await;
        }
    };
    tokio::select! {
        () = work => {}
        () = stop.cancelled() => {}
        () = out.closed() => {}
    }
}

/// Sends what was stored after `place`; answers the last place sent, or nothing when the client left.
async fn resume(handle: &Handle, place: i64, out: &Out) -> Option<i64> {
    let newest = EventFilter { limit: 1, ..EventFilter::default() };
    // A history that cannot be read leaves a hole; the client sees it by the numbers.
    let Ok(page) = handle.events(&newest).await else { return Some(0) };
    // A place beyond the end is of another history: this one was begun anew.
    let place = place.min(page.events.first().map_or(0, |e| e.sequence));
    let newest = page.events.first().map_or(0, |e| e.sequence);
    let mut sent = place;
    for _ in 0..ROUNDS {
        let filter =
            EventFilter { cursor: Some(sent), ascending: true, limit: RESUME, ..EventFilter::default() };
        let Ok(page) = handle.events(&filter).await else { break };
        for event in &page.events {
            sent = event.sequence;
            let data = serde_json::to_string(&EventView::from(event)).unwrap_or_default();
            out.send(Ok(Sse::default().id(sent.to_string()).event("event").data(data))).await.ok()?;
        }
        if page.next.is_none() {
            return Some(sent);
        }
    }
    if sent < newest {
        out.send(Ok(lag(newest.abs_diff(sent)))).await.ok()?;
    }
    Some(newest)
}

fn lag(missed: u64) -> Sse {
    Sse::default().event("lag").data(format!("{{\"missed\":{missed}}}"))
}

async fn forward(mut live: broadcast::Receiver<StreamMessage>, sent: i64, out: &Out) {
    loop {
        let message = match live.recv().await {
            Ok(message) if message.id.is_some_and(|id| id <= sent) => continue,
            Ok(message) => sse(&message),
            Err(broadcast::error::RecvError::Lagged(missed)) => lag(missed),
            Err(broadcast::error::RecvError::Closed) => return,
        };
        if out.send(Ok(message)).await.is_err() {
            return;
        }
    }
}

fn sse(message: &StreamMessage) -> Sse {
    let sse = Sse::default().event(message.kind).data(message.data.as_ref());
    match message.id {
        Some(id) => sse.id(id.to_string()),
        None => sse,
    }
}
