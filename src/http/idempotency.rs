//! `Idempotency-Key`: a POST that is sent again with the same key gets the first answer again.
//!
//! Kept in memory for ten minutes, for the same caller and path; a restart forgets, and the history's own
//! ids still store an event once. The same key with another body is refused, and so
//! is one whose first request is still under way. Taking the turret back is always
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

/// Caller, path and key.
type Name = (String, String, String);

#[derive(Debug, Clone)]
struct Answer {
    status: StatusCode,
    kind: Option<HeaderValue>,
    body: Bytes,
}

#[derive(Debug)]
struct Entry {
    at: Instant,
    /// SHA-256 of the request's body.
    asked: [u8; 32],
    /// Nothing while the first request is under way.
    answer: Option<Answer>,
}

/// What is known of a key.
enum Known {
    /// Nothing: the request is to be done, and now counts as under way.
    New,
    UnderWay,
    OtherBody,
    Answered(Answer),
}

/// Answers by caller, path and key.
#[derive(Debug, Default)]
pub(super) struct Answers(Mutex<HashMap<Name, Entry>>);

impl Answers {
    fn claim(&self, name: &Name, asked: [u8; 32], now: Instant) -> Known {
        let mut entries = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        entries.retain(|_, e| e.answer.is_none() || now.duration_since(e.at) < KEPT);
        match entries.get(name) {
            Some(entry) if entry.asked != asked => Known::OtherBody,
            Some(Entry { answer: Some(answer), .. }) => Known::Answered(answer.clone()),
            Some(_) => Known::UnderWay,
            None => {
                let oldest = |(_, e): &(&Name, &Entry)| e.at;
                let done = entries.iter().filter(|(_, e)| e.answer.is_some());
                if entries.len() >= ANSWERS
                    && let Some(oldest) = done.min_by_key(oldest).map(|(n, _)| n.clone())
                {
                    entries.remove(&oldest);
                }
                entries.insert(name.clone(), Entry { at: now, asked, answer: None });
                Known::New
            }
        }
    }

    /// What was refused for the caller's fault or ours may be tried again with the same key.
    fn settle(&self, name: &Name, answer: Option<Answer>) {
        let mut entries = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match (answer, entries.get_mut(name)) {
            (Some(answer), Some(entry)) => entry.answer = Some(answer),
            _ => drop(entries.remove(name)),
        }
    }
}

/// A key whose request is under way; let go without an answer, it is free again.
struct Claim {
    site: Site,
    name: Name,
    answer: Option<Answer>,
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.site.answers.settle(&self.name, self.answer.take());
    }
}

fn again(kept: Answer) -> Response {
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
    // What is not printable ASCII is refused below, like a key that is empty.
    let text = |v: &HeaderValue| v.to_str().unwrap_or_default().to_owned();
    let key = request.headers().get("idempotency-key").map(text);
    let (Some(key), Method::POST) = (key, request.method().clone()) else { return next.run(request).await };
    if request.uri().path() == ALWAYS_DONE {
        return next.run(request).await;
    }
    if key.is_empty() || key.len() > LONGEST_KEY {
        let detail = "Idempotency-Key must have 1 to 128 printable ASCII characters";
        return Problem::bad_request("invalid_idempotency_key", detail).into_response();
    }
    let caller = request.extensions().get::<Caller>().map_or_else(String::new, |c| c.name.clone());
    let name = (caller, request.uri().path().to_owned(), key);
    let (request, asked) = match digested(request).await {
        Ok(pair) => pair,
        Err(problem) => return problem.into_response(),
    };
    match site.answers.claim(&name, asked, clock::now()) {
        Known::New => {}
        Known::Answered(answer) => return again(answer),
        Known::OtherBody => return another_body().into_response(),
        Known::UnderWay => return under_way().into_response(),
    }
    let claim = Claim { site, name, answer: None };
    // On a task of its own: a caller that hangs up and asks again finds the answer, not a second deed.
    let done = tokio::spawn(answer_once(claim, request, next)).await;
    done.unwrap_or_else(|_| internal("a fault of ours; it is in the log").into_response())
}

async fn answer_once(mut claim: Claim, request: Request, next: Next) -> Response {
    let (parts, body) = next.run(request).await.into_parts();
    let Ok(body) = to_bytes(body, LONGEST_ANSWER).await else {
        return internal("the answer could not be put together").into_response();
    };
    if parts.status.is_success() {
        let kind = parts.headers.get(header::CONTENT_TYPE).cloned();
        claim.answer = Some(Answer { status: parts.status, kind, body: body.clone() });
    }
    Response::from_parts(parts, Body::from(body))
}

fn internal(detail: &str) -> Problem {
    Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", detail)
}

fn under_way() -> Problem {
    let detail = "the first request with this Idempotency-Key is still under way";
    Problem::new(StatusCode::CONFLICT, "request_under_way", detail).retry_after(1)
}
