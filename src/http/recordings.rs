//! Black-box recordings over HTTP.

use super::events::{ReasonBody, origin};
use super::extract::{Body, Named};
use super::problem::{Problem, Refused};
use super::{Caller, Role, Site};
use crate::service::RecordingInfo;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Serialize;
use std::sync::Arc;
use tokio::io::AsyncReadExt as _;
use utoipa::ToSchema;

/// Stored recordings, newest first.
#[utoipa::path(get, path = "/api/v1/recordings", tag = "history", operation_id = "listRecordings",
    responses((status = 200, description = "All recordings", body = Vec<RecordingInfo>),
        Refused))]
pub(super) async fn list(State(site): State<Site>) -> Result<Json<Vec<RecordingInfo>>, Problem> {
    Ok(Json(site.handle.recordings()?))
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
    let origin = origin(&caller, &body?.0.reason)?;
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
    let path = site.handle.recording_path(&id)?;
    let Ok(seat) = Arc::clone(&site.exports).try_acquire_owned() else {
        site.handle.metrics().http_refused.with_label_values(&["exports"]).inc();
        let problem =
            Problem::new(StatusCode::TOO_MANY_REQUESTS, "busy", "two downloads are running already");
        return Err(problem.retry_after(5));
    };
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

fn futures_of(
    mut file: tokio::fs::File,
    seat: tokio::sync::OwnedSemaphorePermit,
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
