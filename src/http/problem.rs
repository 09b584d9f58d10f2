//! Every refusal leaves as `application/problem+json` (RFC 9457) with a stable code.

use crate::service::{Check, OperationError, Refusal};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;
use utoipa::openapi::{self, RefOr};

/// Media type of a problem.
pub(crate) const PROBLEM_JSON: &str = "application/problem+json";

/// Every code, as the page of problems explains them.
pub(super) const CODES: [&str; 38] = [
    "bad_token",
    "token_required",
    "role_too_low",
    "too_many_bad_tokens",
    "unknown_host",
    "ambiguous_host",
    "not_found",
    "method_not_allowed",
    "invalid_query",
    "malformed_request",
    "uri_too_long",
    "head_too_large",
    "malformed_json",
    "json_too_deep",
    "invalid_body",
    "reason_required",
    "secret_in_text",
    "unsupported_media_type",
    "body_too_large",
    "body_timeout",
    "body_unreadable",
    "invalid_idempotency_key",
    "if_match_required",
    "idempotency_key_reused",
    "request_under_way",
    "stale_revision",
    "not_ready",
    "not_acting",
    "faulted",
    "no_fault",
    "busy",
    "unsuitable",
    "too_many_streams",
    "pipeline_unavailable",
    "store_unavailable",
    "recordings_unavailable",
    "unready",
    "internal",
];

/// One thing that is wrong with what was sent.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct FieldError {
    /// JSON pointer into the body, or `query/<name>`.
    pub pointer: String,
    /// What was expected.
    pub detail: String,
}

/// A refusal.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct Problem {
    /// Page that explains the code.
    #[serde(rename = "type")]
    pub kind: String,
    /// The status in words.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What happened and what to do.
    pub detail: String,
    /// Path that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub instance: Option<String>,
    /// Stable code for programs.
    pub code: String,
    /// Single faults of the input.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldError>,
    /// Of `unready`: each condition of readiness.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub checks: Vec<CheckView>,
    #[serde(skip)]
    #[schema(ignore)]
    retry_after_s: Option<u32>,
}

impl Problem {
    /// What is wrong, in one line.
    pub(super) fn in_one_line(&self) -> String {
        let details = self.errors.iter().map(|e| format!("{} {}", e.pointer, e.detail).trim().to_owned());
        std::iter::once(self.detail.clone()).chain(details).collect::<Vec<_>>().join(": ")
    }

    pub(crate) fn new(status: StatusCode, code: &str, detail: impl Into<String>) -> Self {
        debug_assert!(CODES.contains(&code), "{code} is not in the list of codes");
        Self {
            kind: format!("/docs/problems#{code}"),
            title: status.canonical_reason().unwrap_or("Error").to_owned(),
            status: status.as_u16(),
            detail: detail.into(),
            instance: None,
            code: code.to_owned(),
            errors: Vec::new(),
            checks: Vec::new(),
            retry_after_s: None,
        }
    }

    pub(crate) fn bad_request(code: &str, detail: impl Into<String>) -> Self {
        Self::new(StatusCode::BAD_REQUEST, code, detail)
    }

    pub(crate) fn not_found(detail: impl Into<String>) -> Self {
        Self::new(StatusCode::NOT_FOUND, "not_found", detail)
    }

    pub(crate) fn with_field(mut self, pointer: &str, detail: &str) -> Self {
        self.errors.push(FieldError { pointer: pointer.to_owned(), detail: detail.to_owned() });
        self
    }

    pub(crate) fn with_checks(mut self, checks: Vec<CheckView>) -> Self {
        self.checks = checks;
        self
    }

    pub(crate) fn retry_after(mut self, seconds: u32) -> Self {
        self.retry_after_s = Some(seconds);
        self
    }

    /// Writes the path that was asked for into an answer, where that is a problem.
    pub(crate) fn place(response: &mut Response, path: &str) {
        let Some(problem) = response.extensions_mut().remove::<Self>() else { return };
        let placed = Self { instance: Some(path.to_owned()), ..problem };
        response.headers_mut().remove(header::CONTENT_LENGTH);
        *response.body_mut() = placed.into_response().into_body();
    }
}

/// Every answer that is not named: a [`Problem`].
pub(crate) struct Refused;

impl utoipa::IntoResponses for Refused {
    fn responses() -> BTreeMap<String, RefOr<openapi::Response>> {
        let schema = openapi::Ref::from_schema_name("Problem");
        let content = openapi::ContentBuilder::new().schema(Some(schema)).build();
        let builder = openapi::ResponseBuilder::new().description("Refused");
        let response = builder.content(PROBLEM_JSON, content).build();
        BTreeMap::from([("default".to_owned(), RefOr::T(response))])
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let status = StatusCode::from_u16(self.status).unwrap_or(StatusCode::INTERNAL_SERVER_ERROR);
        let body = serde_json::to_vec(&self).unwrap_or_default();
        let mut response = (status, [(header::CONTENT_TYPE, PROBLEM_JSON)], body).into_response();
        let retry_after_s = self.retry_after_s;
        if self.instance.is_none() {
            response.extensions_mut().insert(self); // the outermost layer knows the path
        }
        let headers = response.headers_mut();
        if let Some(seconds) = retry_after_s {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(seconds));
        }
        if status == StatusCode::UNAUTHORIZED {
            headers.insert(header::WWW_AUTHENTICATE, HeaderValue::from_static("Bearer realm=\"stillcut\""));
        }
        response
    }
}

impl From<OperationError> for Problem {
    fn from(error: OperationError) -> Self {
        let text = error.to_string();
        match error {
            OperationError::NotFound(_) => Self::not_found(text),
            OperationError::Refused(Refusal::Revision { .. } | Refusal::WayUp { .. }) => {
                Self::new(StatusCode::PRECONDITION_FAILED, "stale_revision", text)
            }
            OperationError::Refused(Refusal::Faulted(_)) => Self::new(StatusCode::CONFLICT, "faulted", text),
            OperationError::Refused(Refusal::NotReady(_)) => {
                Self::new(StatusCode::CONFLICT, "not_ready", text)
            }
            OperationError::Refused(Refusal::NotActing(_)) => {
                Self::new(StatusCode::CONFLICT, "not_acting", text)
            }
            OperationError::Refused(Refusal::NoFault) => Self::new(StatusCode::CONFLICT, "no_fault", text),
            OperationError::Refused(Refusal::NoAnswer) => {
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "pipeline_unavailable", text).retry_after(1)
            }
            OperationError::Busy(_) => Self::new(StatusCode::TOO_MANY_REQUESTS, "busy", text).retry_after(5),
            OperationError::Unsuitable(_) => Self::new(StatusCode::CONFLICT, "unsuitable", text),
            OperationError::Store(source) => {
                tracing::error!(event = "store_unavailable", code = source.code(), "{source}");
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "store_unavailable", text).retry_after(1)
            }
            OperationError::NotWritten(why) => {
                tracing::error!(event = "store_unavailable", code = "not_written", "{why}");
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "store_unavailable", text).retry_after(1)
            }
            OperationError::NotRecorded | OperationError::NotConfirmed => {
                tracing::error!(event = "store_unavailable", code = "slow", "{text}");
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "store_unavailable", text).retry_after(1)
            }
            OperationError::Recordings(source) => {
                tracing::error!(event = "recordings_unavailable", "{source}");
                let detail = "the recordings cannot be read";
                Self::new(StatusCode::SERVICE_UNAVAILABLE, "recordings_unavailable", detail).retry_after(5)
            }
        }
    }
}

/// One condition of readiness.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct CheckView {
    /// `samples`, `store` or `pipeline`.
    pub name: String,
    /// As it should be.
    pub ok: bool,
    /// What is seen.
    pub detail: String,
}

impl From<Check> for CheckView {
    fn from(check: Check) -> Self {
        Self { name: check.name.to_owned(), ok: check.ok, detail: check.detail }
    }
}
