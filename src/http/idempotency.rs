//! `Idempotency-Key`: a POST that is sent again with the same key gets the first answer again.
//!
//! Kept in memory for ten minutes, for the same caller and path; a restart forgets, and the history's own
//! ids still store an event once. The same key with another body is refused. Taking the turret back is always
//! done, never answered from memory: doing it twice is the same, not doing it once is not.

use super::extract::BODY_DEADLINE;
use super::problem::Problem;
use super::{BODY_BYTES, Caller, Site};
use crate::service::clock;
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{Request, State};
use axum::http::{HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use sha2::{Digest as _, Sha256};
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What is never answered from memory.
const ALWAYS_DONE: &str = "/api/v1/override";
const KEPT: Duration = Duration::from_secs(600);
/// Most answers kept; beyond it the oldest goes.
const ANSWERS: usize = 256;
const LONGEST_KEY: usize = 128;
/// Answers of writes are small.
const LONGEST_ANSWER: usize = 256 * 1024;

#[derive(Debug, Clone)]
struct Kept {
    at: Instant,
    /// SHA-256 of the request's body.
    asked: [u8; 32],
    status: StatusCode,
    kind: Option<HeaderValue>,
    body: Bytes,
}

/// Answers by caller, path and key.
#[derive(Debug, Default)]
pub(super) struct Answers(Mutex<HashMap<(String, String, String), Kept>>);

impl Answers {
    fn find(&self, name: &(String, String, String), now: Instant) -> Option<Kept> {
        let answers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        answers.get(name).filter(|k| now.duration_since(k.at) < KEPT).cloned()
    }

    fn keep(&self, name: (String, String, String), answer: Kept) {
        let mut answers = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        answers.retain(|_, k| answer.at.duration_since(k.at) < KEPT);
        if answers.len() >= ANSWERS
            && let Some(oldest) = answers.iter().min_by_key(|(_, k)| k.at).map(|(n, _)| n.clone())
        {
            answers.remove(&oldest);
        }
        answers.insert(name, answer);
    }
}

fn again(kept: Kept) -> Response {
    let mut response = (kept.status, Body::from(kept.body)).into_response();
    if let Some(kind) = kept.kind {
        response.headers_mut().insert(header::CONTENT_TYPE, kind);
    }
    response.headers_mut().insert("idempotent-replayed", HeaderValue::from_static("true"));
    response
}

fn another_body() -> Problem {
    let detail = "this Idempotency-Key was used for another request; use a new one";
    Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "idempotency_key_reused", detail)
}

/// The request with its body read, and the body's digest.
async fn digested(request: Request) -> Result<(Request, [u8; 32]), Problem> {
    let (parts, body) = request.into_parts();
    let read = tokio::time::timeout(BODY_DEADLINE, to_bytes(body, BODY_BYTES)).await;
    let bytes = read.map_err(|_| {
        let detail = "the body did not arrive within 5 s";
        Problem::new(StatusCode::REQUEST_TIMEOUT, "body_timeout", detail)
    })?;
    let bytes = bytes.map_err(|_| {
        let detail = "the body is larger than 64 KiB or broke off";
        Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "body_too_large", detail)
    })?;
    let digest = Sha256::digest(&bytes).into();
    Ok((Request::from_parts(parts, Body::from(bytes)), digest))
}

/// The layer: only POST with the header is looked at.
pub(super) async fn layer(State(site): State<Site>, request: Request, next: Next) -> Response {
    let key = request.headers().get("idempotency-key").and_then(|v| v.to_str().ok()).map(str::to_owned);
    let (Some(key), Method::POST) = (key, request.method().clone()) else { return next.run(request).await };
    if request.uri().path() == ALWAYS_DONE {
        return next.run(request).await;
    }
    if key.is_empty() || key.len() > LONGEST_KEY {
        let detail = "Idempotency-Key must have 1 to 128 characters";
        return Problem::bad_request("invalid_idempotency_key", detail).into_response();
    }
    let caller = request.extensions().get::<Caller>().map_or_else(String::new, |c| c.name.clone());
    let name = (caller, request.uri().path().to_owned(), key);
    let (request, asked) = match digested(request).await {
        Ok(pair) => pair,
        Err(problem) => return problem.into_response(),
    };
    if let Some(kept) = site.answers.find(&name, clock::now()) {
        return if kept.asked == asked { again(kept) } else { another_body().into_response() };
    }
    let (parts, body) = next.run(request).await.into_parts();
    let Ok(body) = to_bytes(body, LONGEST_ANSWER).await else {
        let detail = "the answer could not be put together";
        return Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", detail).into_response();
    };
    // What was refused for the caller's fault or ours may be tried again with the same key.
    if parts.status.is_success() {
        let kind = parts.headers.get(header::CONTENT_TYPE).cloned();
        let kept = Kept { at: clock::now(), asked, status: parts.status, kind, body: body.clone() };
        site.answers.keep(name, kept);
    }
    Response::from_parts(parts, Body::from(body))
}
