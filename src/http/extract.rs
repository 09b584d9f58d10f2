//! Bodies and queries whose refusal is a problem like any other.

use super::problem::Problem;
use axum::body::Bytes;
use axum::extract::{FromRequest, FromRequestParts, Query, Request};
use axum::http::request::Parts;
use axum::http::{StatusCode, header};
use serde::de::DeserializeOwned;
use std::time::Duration;

/// A body must be there within this time.
pub(super) const BODY_DEADLINE: Duration = Duration::from_secs(5);
/// Deepest nesting of a JSON body.
const JSON_DEPTH: usize = 32;

/// A JSON body.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Body<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequest<S> for Body<T> {
    type Rejection = Problem;

    async fn from_request(request: Request, state: &S) -> Result<Self, Problem> {
        let kind =
            request.headers().get(header::CONTENT_TYPE).and_then(|v| v.to_str().ok()).unwrap_or_default();
        if !kind.split(';').next().is_some_and(|k| k.trim().eq_ignore_ascii_case("application/json")) {
            let detail = "the body must be application/json";
            return Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "unsupported_media_type", detail));
        }
        let read = tokio::time::timeout(BODY_DEADLINE, Bytes::from_request(request, state)).await;
        let bytes = match read {
            Err(_) => {
                let detail = "the body did not arrive within 5 s";
                return Err(Problem::new(StatusCode::REQUEST_TIMEOUT, "body_timeout", detail));
            }
            Ok(Err(rejection)) if rejection.status() == StatusCode::PAYLOAD_TOO_LARGE => {
                let detail = "the body is larger than 64 KiB";
                return Err(Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "body_too_large", detail));
            }
            Ok(Err(_)) => return Err(Problem::bad_request("body_unreadable", "the body could not be read")),
            Ok(Ok(bytes)) => bytes,
        };
        parse(&bytes).map(Self)
    }
}

fn parse<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, Problem> {
    if depth(bytes) > JSON_DEPTH {
        return Err(Problem::bad_request(
            "json_too_deep",
            format!("JSON is nested deeper than {JSON_DEPTH}"),
        ));
    }
    let wrong = |text: &str| {
        let detail = "the body is not what was expected";
        Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "invalid_body", detail).with_field("", text)
    };
    let body = serde_json::from_slice(bytes).map_err(|error| {
        let text = error.to_string();
        if error.is_data() {
            return wrong(&text);
        }
        Problem::bad_request("malformed_json", "the body is not JSON").with_field("", &text)
    })?;
    // A derived reader also takes the fields' values in a row, without their names.
    match bytes.iter().find(|byte| !byte.is_ascii_whitespace()) {
        Some(b'{') => Ok(body),
        _ => Err(wrong("expected a JSON object")),
    }
}

/// Deepest nesting of brackets outside strings.
fn depth(bytes: &[u8]) -> usize {
    let (mut now, mut most, mut in_string, mut escaped) = (0_usize, 0, false, false);
    for byte in bytes {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if in_string => escaped = true,
            b'"' => in_string = !in_string,
            b'{' | b'[' if !in_string => {
                now += 1;
                most = most.max(now);
            }
            b'}' | b']' if !in_string => now = now.saturating_sub(1),
            _ => {}
        }
    }
    most
}

/// The query string; unknown names and wrong values are refused.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Asked<T>(pub(crate) T);

impl<T: DeserializeOwned, S: Send + Sync> FromRequestParts<S> for Asked<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        match Query::<T>::from_request_parts(parts, state).await {
            Ok(Query(value)) => Ok(Self(value)),
            Err(rejection) => {
                let problem = Problem::bad_request("invalid_query", "the query is not what was expected");
                let (pointer, detail) = of_query(&rejection.body_text());
                Err(problem.with_field(&pointer, &detail))
            }
        }
    }
}

/// Which parameter the library means, and what it says of it.
fn of_query(said: &str) -> (String, String) {
    let said = said.strip_prefix("Failed to deserialize query string: ").unwrap_or(said);
    match said.split_once(": ") {
        Some((name, detail)) => (format!("query/{name}"), detail.to_owned()),
        None => ("query".to_owned(), said.to_owned()),
    }
}

/// A path parameter; what does not parse names nothing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Named<T>(pub(crate) T);

impl<T: DeserializeOwned + Send, S: Send + Sync> FromRequestParts<S> for Named<T> {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let path = axum::extract::Path::<T>::from_request_parts(parts, state).await;
        path.map(|axum::extract::Path(value)| Self(value))
            .map_err(|_| Problem::not_found("there is nothing of that name"))
    }
}

#[cfg(test)]
mod tests {
    use super::{depth, parse};

    #[test]
    fn nesting_is_counted_outside_strings() {
        assert_eq!(depth(br#"{"a":[1,{"b":"[[[["}]}"#), 3);
        assert_eq!(depth(br#""\"[""#), 0);
        let deep = "[".repeat(40);
        assert_eq!(parse::<serde_json::Value>(deep.as_bytes()).unwrap_err().code, "json_too_deep");
        assert_eq!(parse::<serde_json::Value>(b"{").unwrap_err().code, "malformed_json");
        assert_eq!(parse::<u8>(b"\"x\"").unwrap_err().code, "invalid_body");
    }

    #[test]
    fn a_body_is_an_object() {
        #[derive(Debug, serde::Deserialize)]
        struct Reason {
            #[serde(default)]
            reason: Option<String>,
        }
        for row in ["[]", " [\"why\"]", "[null]", "\"why\"", "null"] {
            assert_eq!(parse::<Reason>(row.as_bytes()).unwrap_err().code, "invalid_body", "{row}");
        }
        let named = parse::<Reason>(b"\n {\"reason\": \"why\"}").unwrap();
        assert_eq!(named.reason.as_deref(), Some("why"));
    }
}
