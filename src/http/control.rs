//! What people may do to the running service.

use super::extract::Body;
use super::problem::{Problem, Refused};
use super::reason::{Reason, ReasonBody};
use super::{Caller, Role, Site};
use crate::service::live::Mode;
use crate::service::{Changed, ModeNow};
use axum::body::HttpBody as _;
use axum::extract::{FromRequest as _, Request, State};
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The mode and its revision.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ModeView {
    /// How far the service may go.
    mode: Mode,
    /// Grows with every change; also the ETag.
    revision: u64,
    /// Why it is so.
    reason: String,
    /// Answers of a change: whether it is in the audit record yet. `false`: it is done, and its row waits for
    /// the disk.
    #[serde(skip_serializing_if = "Option::is_none")]
    recorded: Option<bool>,
    /// Answers of an override: what was wrong with the body, where the reason in it was not taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason_refused: Option<String>,
}

fn mode_response(now: ModeNow, recorded: Option<bool>, reason_refused: Option<String>) -> Response {
    let ModeNow { mode, revision, reason } = now;
    let view = ModeView { mode, revision, reason, recorded, reason_refused };
    let tag = HeaderValue::from_str(&format!("\"{}\"", view.revision))
        .unwrap_or_else(|_| HeaderValue::from_static("\"\""));
    ([(header::ETAG, tag)], Json(view)).into_response()
}

fn changed(change: Changed) -> Response {
    mode_response(change.mode, Some(change.recorded), None)
}

/// The mode, with its ETag.
#[utoipa::path(get, path = "/api/v1/mode", tag = "control", operation_id = "getMode",
    responses((status = 200, description = "The mode", body = ModeView,
            headers(("ETag" = String, description = "Revision of the mode"))),
        Refused))]
pub(super) async fn get_mode(State(site): State<Site>) -> Response {
    mode_response(site.handle.mode(), None, None)
}

/// A change of mode.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct ModeBody {
    /// The mode wanted.
    mode: Mode,
    /// One sentence for the record.
    reason: Reason,
}

/// Change the mode. Up needs the role engineer and `If-Match` with the mode's ETag; down needs operator.
#[utoipa::path(put, path = "/api/v1/mode", tag = "control", operation_id = "setMode", request_body = ModeBody,
    params(("If-Match" = Option<String>, Header,
        description = "ETag of the mode that the caller saw; needed on the way up")),
    security(("token" = [])),
    responses((status = 200, description = "The mode now", body = ModeView,
            headers(("ETag" = String, description = "Revision of the mode"))),
        Refused))]
pub(super) async fn put_mode(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    headers: HeaderMap,
    body: Result<Body<ModeBody>, Problem>,
) -> Result<Response, Problem> {
    caller.require(Role::Operator)?;
    let Body(body) = body?;
    let origin = body.reason.origin(&caller, &site)?;
    // The picture decides only which refusal is told; whether this is the way up, and whether it is free, the
    // pipeline thread judges by the mode itself.
    let up = body.mode as u8 > site.handle.mode().mode as u8;
    let revision = if up {
        caller.require(Role::Engineer)?;
        Some(if_match(&headers)?)
    } else {
        None
    };
    Ok(changed(site.handle.set_mode(body.mode, revision, origin).await?))
}

fn if_match(headers: &HeaderMap) -> Result<u64, Problem> {
    let Some(value) = headers.get(header::IF_MATCH) else {
        let detail = "a change to a higher mode needs If-Match with the ETag of GET /api/v1/mode";
        return Err(Problem::new(StatusCode::PRECONDITION_REQUIRED, "if_match_required", detail));
    };
    let text = value.to_str().unwrap_or_default().trim().trim_matches('"');
    let stale = || {
        let detail = "If-Match is not an ETag of the mode; it must name the one that was seen";
        Problem::new(StatusCode::PRECONDITION_FAILED, "stale_revision", detail)
    };
    text.parse().map_err(|_| stale())
}

/// Why somebody takes the turret back, where there is time for words.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct TakeBackBody {
    /// One sentence for the record; without a good one the record says that none was given.
    #[serde(default = "Reason::none_given")]
    reason: Reason,
}

/// Take the turret back: equal pitch and `observe`, within one control cycle, before the body is read: a body
/// that is missing or wrong is told as `reason_refused`. Done and answered also while the history cannot be
/// written; an `Idempotency-Key` changes nothing.
#[utoipa::path(post, path = "/api/v1/override", tag = "control",
    operation_id = "takeBack", request_body = TakeBackBody,
    security(("token" = [])),
    responses((status = 200, description = "The mode now", body = ModeView),
        Refused))]
pub(super) async fn take_back(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    request: Request,
) -> Result<Response, Problem> {
    caller.require(Role::Operator)?;
    // Whoever hangs up meanwhile has still asked for it.
    let deed = tokio::spawn(async move {
        let outcome = site.handle.take_back(&caller.name).await;
        let untyped = !request.headers().contains_key(header::CONTENT_TYPE);
        let nothing_sent = untyped && request.body().size_hint().exact() == Some(0);
        let said = Body::<TakeBackBody>::from_request(request, &()).await;
        let (origin, refused) = match said.and_then(|body| body.0.reason.origin(&caller, &site)) {
            Ok(origin) => (origin, None),
            Err(problem) => {
                let told = if nothing_sent { "none was given".to_owned() } else { problem.in_one_line() };
                (Reason::none_given().origin_unquestioned(&caller), Some(told))
            }
        };
        site.handle.record_override(&origin, outcome).await.map(|done| (done, refused))
    });
    let lost =
        |_| Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", "a fault of ours; see the log");
    let (done, refused) = deed.await.map_err(lost)??;
    Ok(mode_response(done.mode, Some(done.recorded), refused))
}

/// Whether the turret is to stay where it is.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct HoldBody {
    /// True: leave it where it is; false: let it go.
    hold: bool,
    /// One sentence for the record.
    reason: Reason,
}

/// Leave the turret where it is, or let it go: what stands is kept, nothing else is asked of it. Possible in
/// `act` only, else 409 `not_acting`; ends by itself when the mode changes.
#[utoipa::path(put, path = "/api/v1/hold", tag = "control",
    operation_id = "holdTurret", request_body = HoldBody,
    security(("token" = [])),
    responses((status = 200, description = "The mode now", body = ModeView),
        Refused))]
pub(super) async fn hold(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    body: Result<Body<HoldBody>, Problem>,
) -> Result<Response, Problem> {
    caller.require(Role::Operator)?;
    let body = body?.0;
    let origin = body.reason.origin(&caller, &site)?;
    Ok(changed(site.handle.hold(body.hold, origin).await?))
}

/// Clear a latched fault, after its cause is gone; without one 409 `no_fault`.
#[utoipa::path(post, path = "/api/v1/fault/clear", tag = "control",
    operation_id = "clearFault", request_body = ReasonBody,
    security(("token" = [])),
    responses((status = 200, description = "The mode now", body = ModeView),
        Refused))]
pub(super) async fn clear_fault(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    body: Result<Body<ReasonBody>, Problem>,
) -> Result<Response, Problem> {
    caller.require(Role::Engineer)?;
    let origin = body?.0.origin(&caller, &site)?;
    Ok(changed(site.handle.clear_fault(origin).await?))
}
