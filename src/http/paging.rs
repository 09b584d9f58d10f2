//! Pages of a list: how many entries, and where the next one begins.

use super::problem::Problem;
use axum::http::{HeaderMap, HeaderValue, header};

/// Most entries of a page of recordings or diagnoses.
pub(super) const PAGE: usize = 1000;

/// Entries a page. Errors: none or too many are asked for.
pub(super) fn page_size(asked: Option<usize>) -> Result<usize, Problem> {
    match asked.unwrap_or(PAGE) {
        limit @ 1..=PAGE => Ok(limit),
        _ => Err(Problem::bad_request("invalid_query", "limit is not what was expected")
            .with_field("query/limit", "expected 1 to 1000")),
    }
}

/// Where the body has no place for the cursor of the next page.
pub(super) fn next_header(next: Option<HeaderValue>) -> HeaderMap {
    next.into_iter().map(|v| (header::HeaderName::from_static("next-cursor"), v)).collect()
}
