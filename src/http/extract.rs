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
    let wrong = |pointer: &str, text: &str| {
        let detail = "the body is not what was expected";
        Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "invalid_body", detail).with_field(pointer, text)
    };
    let mut reader = serde_json::Deserializer::from_slice(bytes);
    let read = serde_path_to_error::deserialize(&mut reader);
    let body = read.map_err(|error| (pointer_of(&error), error.into_inner()));
    let body = body.and_then(|body| reader.end().map(|()| body).map_err(|e| (String::new(), e)));
    let body = body.map_err(|(pointer, error)| {
        let text = error.to_string();
        // The reader calls `null` in place of a word a slip of syntax, too.
        let is_json = || serde_json::from_slice::<serde::de::IgnoredAny>(bytes).is_ok();
        if error.is_data() || is_json() {
            return wrong(&pointer, expected_in(&text));
        }
        Problem::bad_request("malformed_json", "the body is not JSON").with_field("", &text)
    })?;
    // A derived reader also takes the fields' values in a row, without their names.
    match bytes.iter().find(|byte| !byte.is_ascii_whitespace()) {
        Some(b'{') => Ok(body),
        _ => Err(wrong("", "expected a JSON object")),
    }
}

/// What was expected, out of the words of the reader of JSON: the pointer says where, whoever wrote the value
/// knows what it is, and what reads it is nobody's business.
fn expected_in(said: &str) -> &str {
    let said = said.rsplit_once(" at line ").map_or(said, |(said, _)| said);
    match said {
        "number out of range" => "expected no number of that size",
        "expected value" => "expected one of the values in the description",
        _ if said.starts_with("invalid type: ") || said.starts_with("invalid value: ") => {
            said.find("expected ").map_or(said, |at| &said[at..])
        }
        _ => said,
    }
}

/// JSON pointer to what an error is about. A field that is missing or that nobody knows belongs to the object
/// around it, where the library points.
fn pointer_of(error: &serde_path_to_error::Error<serde_json::Error>) -> String {
    use serde_path_to_error::Segment;
    let said = error.inner().to_string();
    let named = said.strip_prefix("missing field `").or(said.strip_prefix("unknown field `"));
    let named = named.and_then(|rest| rest.split('`').next());
    let mut steps: Vec<String> = error
        .path()
        .iter()
        .filter_map(|segment| match segment {
            Segment::Seq { index } => Some(index.to_string()),
            Segment::Map { key } | Segment::Enum { variant: key } => Some(key.clone()),
            Segment::Unknown => None,
        })
        .collect();
    if let Some(name) = named.filter(|name| steps.last().is_none_or(|last| last != name)) {
        steps.push(name.to_owned());
    }
    steps.iter().map(|step| format!("/{}", step.replace('~', "~0").replace('/', "~1"))).collect()
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
        Some((name, detail)) => (format!("query/{name}"), in_plain_words(detail)),
        None => ("query".to_owned(), said.to_owned()),
    }
}

/// What was expected, where the library speaks of its own types.
fn in_plain_words(detail: &str) -> String {
    let integer = ["invalid digit found", "cannot parse integer", "number too"];
    if integer.iter().any(|words| detail.starts_with(words)) {
        return "expected an integer".to_owned();
    }
    if detail.starts_with("provided string was not `true` or `false`") {
        return "expected true or false".to_owned();
    }
    detail.to_owned()
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
    use super::{depth, of_query, parse};

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
    fn a_wrong_field_is_pointed_at() {
        #[derive(Debug, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        #[allow(dead_code)]
        struct Asked {
            reason: String,
            #[serde(default)]
            recordings: Vec<String>,
        }
        for (body, pointer) in [
            ("{\"reason\":7}", "/reason"),
            ("{}", "/reason"),
            ("{\"reason\":\"x\",\"more\":1}", "/more"),
            ("{\"reason\":\"x\",\"a/b~\":1}", "/a~1b~0"),
            ("{\"reason\":\"x\",\"recordings\":[\"a\",3]}", "/recordings/1"),
        ] {
            let problem = parse::<Asked>(body.as_bytes()).unwrap_err();
            assert_eq!(
                (problem.code.as_str(), problem.errors[0].pointer.as_str()),
                ("invalid_body", pointer)
            );
        }
        #[derive(Debug, serde::Deserialize)]
        #[serde(rename_all = "snake_case")]
        enum Word {
            One,
        }
        #[derive(Debug, serde::Deserialize)]
        #[allow(dead_code)]
        struct Wanted {
            word: Word,
        }
        assert!(matches!(parse::<Wanted>(b"{\"word\":\"one\"}"), Ok(Wanted { word: Word::One })));
        for body in ["{\"word\":null}", "[1]"] {
            let problem = parse::<Wanted>(body.as_bytes()).unwrap_err();
            assert_eq!(problem.code, "invalid_body", "{body}");
        }
        for number in ["9".repeat(300), "9".repeat(400), "7".to_owned()] {
            let problem = parse::<Asked>(format!("{{\"reason\":{number}}}").as_bytes()).unwrap_err();
            let told = &problem.errors[0].detail;
            assert!(told.starts_with("expected ") && !told.contains("line"), "{told}");
        }
        let behind = parse::<Asked>(b"{\"reason\":\"x\"} {}").unwrap_err();
        assert_eq!(behind.code, "malformed_json");
        let words = |said: &str| of_query(&format!("Failed to deserialize query string: {said}"));
        let told = words("limit: invalid digit found in string");
        assert_eq!(told, ("query/limit".to_owned(), "expected an integer".to_owned()));
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
