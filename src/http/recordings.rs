//! Black-box recordings over HTTP.

use super::extract::{Asked, Body, Named};
use super::paging::{next_header, page_size};
use super::problem::{Problem, Refused};
use super::reason::ReasonBody;
use super::{Caller, Role, Site};
use crate::service::{RecordingInfo, ReplayView, TextForm};
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use tokio::io::AsyncReadExt as _;
use tokio::sync::OwnedSemaphorePermit;
use utoipa::{IntoParams, ToSchema};

/// Filters and paging.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct RecordingQuery {
    /// `next-cursor` of the page before.
    cursor: Option<i64>,
    /// Recordings a page, 1 to 1000; 1000 when not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<usize>,
    /// Only those whose name begins with this word, for example `chatter_onset`.
    kind: Option<String>,
}

/// Stored recordings, newest first. A page that is not the last carries the header `next-cursor`.
#[utoipa::path(get, path = "/api/v1/recordings", tag = "history", operation_id = "listRecordings",
    params(RecordingQuery),
    responses((status = 200, description = "One page", body = Vec<RecordingInfo>,
            headers(("next-cursor" = i64, description = "Cursor of the next page, where there is one"))),
        Refused))]
pub(super) async fn list(
    State(site): State<Site>,
    Asked(query): Asked<RecordingQuery>,
) -> Result<Response, Problem> {
    let limit = page_size(query.limit)?;
    let mut found = site.handle.recordings().await?;
    let word = |r: &RecordingInfo| r.id.split('-').next().map(str::to_owned);
    found.retain(|r| {
        query.cursor.is_none_or(|c| r.written_ns < c) && (query.kind.is_none() || word(r) == query.kind)
    });
    let next = found.get(limit).and(found.get(limit - 1)).map(|last| HeaderValue::from(last.written_ns));
    found.truncate(limit);
    Ok((next_header(next), Json(found)).into_response())
}

/// Name of a recording that will be there shortly.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct SavedView {
    /// Its name.
    id: String,
}

/// Save what the black box holds now.
#[utoipa::path(post, path = "/api/v1/recordings", tag = "control",
    operation_id = "saveRecording", request_body = ReasonBody,
    security(("token" = [])),
    responses((status = 202, description = "It is being written", body = SavedView),
        Refused))]
pub(super) async fn save(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    body: Result<Body<ReasonBody>, Problem>,
) -> Result<(StatusCode, Json<SavedView>), Problem> {
    caller.require(Role::Operator)?;
    let origin = body?.0.origin(&caller, &site)?;
    let id = site.handle.save_recording(origin).await?;
    Ok((StatusCode::ACCEPTED, Json(SavedView { id })))
}

const CHUNK: usize = 64 * 1024;

/// One recording as Parquet.
#[utoipa::path(get, path = "/api/v1/recordings/{id}/file.parquet", tag = "history",
    operation_id = "downloadRecording",
    params(("id" = String, Path, description = "Name of the recording")),
    responses((status = 200,
        description = "Parquet", body = Vec<u8>, content_type = "application/vnd.apache.parquet"),
        Refused))]
pub(super) async fn download(
    State(site): State<Site>,
    Named(id): Named<String>,
) -> Result<Response, Problem> {
    let path = site.handle.recording_file(&id).await?;
    let seat = take_seat(&site)?;
    let file = tokio::fs::File::open(&path).await.map_err(|_| Problem::not_found("the recording is gone"))?;
    let bytes = file.metadata().await.map_or(0, |m| m.len());
    // The seat is given back when the stream ends or the client goes away.
    let stream = futures_of(file, seat);
    let headers = [
        (header::CONTENT_TYPE, "application/vnd.apache.parquet".to_owned()),
        (header::CONTENT_DISPOSITION, format!("attachment; filename=\"{id}.parquet\"")),
        (header::CONTENT_LENGTH, bytes.to_string()),
    ];
    Ok((headers, axum::body::Body::from_stream(stream)).into_response())
}

/// One of the few places for downloads and replays.
fn take_seat(site: &Site) -> Result<OwnedSemaphorePermit, Problem> {
    Arc::clone(&site.exports).try_acquire_owned().map_err(|_| {
        site.handle.metrics().http_refused.with_label_values(&["exports"]).inc();
        let detail = "two downloads or replays are running already";
        Problem::new(StatusCode::TOO_MANY_REQUESTS, "busy", detail).retry_after(5)
    })
}

async fn text_file(site: &Site, id: &str, form: TextForm) -> Result<Response, Problem> {
    let (kind, ending) = match form {
        TextForm::Csv => ("text/csv; charset=utf-8; header=present", "csv"),
        TextForm::Json => ("application/json", "json"),
    };
    site.handle.recording_file(id).await?;
    let seat = take_seat(site)?;
    let pieces = site.handle.recording_text(id, form, seat).await?;
    let stream = tokio_stream::wrappers::ReceiverStream::new(pieces);
    let name = format!("attachment; filename=\"{id}.{ending}\"");
    let headers = [(header::CONTENT_TYPE, kind.to_owned()), (header::CONTENT_DISPOSITION, name)];
    Ok((headers, axum::body::Body::from_stream(stream)).into_response())
}

/// One recording as CSV.
#[utoipa::path(get, path = "/api/v1/recordings/{id}/file.csv", tag = "history",
    operation_id = "downloadRecordingCsv",
    params(("id" = String, Path, description = "Name of the recording")),
    responses((status = 200, description = "One row a sample", body = String, content_type = "text/csv"),
        Refused))]
pub(super) async fn download_csv(
    State(site): State<Site>,
    Named(id): Named<String>,
) -> Result<Response, Problem> {
    text_file(&site, &id, TextForm::Csv).await
}

/// One recording as JSON.
#[utoipa::path(get, path = "/api/v1/recordings/{id}/file.json", tag = "history",
    operation_id = "downloadRecordingJson",
    params(("id" = String, Path, description = "Name of the recording")),
    responses((status = 200, description = "Rate, metadata, a list a column", body = serde_json::Value),
        Refused))]
pub(super) async fn download_json(
    State(site): State<Site>,
    Named(id): Named<String>,
) -> Result<Response, Problem> {
    text_file(&site, &id, TextForm::Json).await
}

/// One recording through the pipeline again: what it hears and declares.
#[utoipa::path(get, path = "/api/v1/recordings/{id}/replay", tag = "history",
    operation_id = "replayRecording",
    params(("id" = String, Path, description = "Name of the recording")),
    responses((status = 200, description = "Events and track", body = ReplayView),
        Refused))]
pub(super) async fn replay(
    State(site): State<Site>,
    Named(id): Named<String>,
) -> Result<Json<ReplayView>, Problem> {
    site.handle.recording_file(&id).await?;
    let seat = take_seat(&site)?;
    Ok(Json(site.handle.replay(&id, seat).await?))
}

fn futures_of(
    mut file: tokio::fs::File,
    seat: OwnedSemaphorePermit,
) -> impl tokio_stream::Stream<Item = std::io::Result<Bytes>> {
    let (send, receive) = tokio::sync::mpsc::channel(2);
    tokio::spawn(async move {
        let _seat = seat;
        loop {
            let mut chunk = Vec::with_capacity(CHUNK);
            let read = (&mut file).take(CHUNK as u64).read_to_end(&mut chunk).await;
            let message = match read {
                Ok(0) => break,
                Ok(_) => Ok(Bytes::from(chunk)),
                Err(error) => Err(error),
            };
            let failed = message.is_err();
            // A client that takes nothing for a minute is gone.
            let sent = tokio::time::timeout(std::time::Duration::from_secs(60), send.send(message)).await;
            if failed || !matches!(sent, Ok(Ok(()))) {
                break;
            }
        }
    });
    tokio_stream::wrappers::ReceiverStream::new(receive)
}
