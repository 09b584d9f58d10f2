//! Past cuts over HTTP: page by page, and as the table of cuts that `stillcut diagnose --cuts` reads.

use super::Site;
use super::extract::Asked;
use super::problem::{Problem, Refused};
use crate::service::{MAX_PAGE, PastCut, clock, cuts_csv};
use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// One stretch of a cut at one speed and one pitch.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct PastCutView {
    /// Place in the table.
    sequence: i64,
    /// When it began, RFC 3339 UTC.
    began_at: String,
    /// How long it lasted, s.
    lasted_s: f64,
    /// Spindle speed, rpm.
    spindle_speed_rpm: f64,
    /// Width of cut per tool as the configuration stated it, m.
    width_m: f64,
    /// Feed per turn as the configuration stated it, m.
    feed_m_rev: f64,
    /// Tools from the chuck, where an axis of the stream tells it, m: where a stable cut was farthest, and
    /// where chatter began.
    tool_position_m: Option<f64>,
    /// Pitch angle difference, rad.
    pitch_difference_rad: f64,
    /// `stable` or `chatter`.
    outcome: &'static str,
    /// Chatter frequency; of a stable cut the line that dies out slowest, where its margin was read, Hz.
    line_hz: Option<f64>,
    /// Growth of that line, 1/s: of a stable cut minus its stability margin.
    growth_1_s: Option<f64>,
    /// Its standard error, 1/s.
    growth_se_1_s: Option<f64>,
}

impl From<&PastCut> for PastCutView {
    fn from(cut: &PastCut) -> Self {
        Self {
            sequence: cut.sequence,
            began_at: clock::rfc3339(cut.began_ns),
            lasted_s: cut.lasted_s,
            spindle_speed_rpm: cut.spindle_speed_rpm,
            width_m: cut.width_m,
            feed_m_rev: cut.feed_m_rev,
            tool_position_m: cut.tool_position_m,
            pitch_difference_rad: cut.pitch_difference_rad,
            outcome: cut.outcome(),
            line_hz: cut.line_hz,
            growth_1_s: cut.growth_1_s.map(|g| g[0]),
            growth_se_1_s: cut.growth_1_s.map(|g| g[1]),
        }
    }
}

/// One page.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct CutPageView {
    /// Newest first.
    cuts: Vec<PastCutView>,
    /// Cursor of the next page; absent on the last.
    next: Option<i64>,
}

/// Paging.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct CutQuery {
    /// `next` of the page before.
    cursor: Option<i64>,
    /// Cuts a page, 1 to 1000; 100 when not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<i64>,
}

/// Past cuts, newest first: speed, pitch, and whether they chattered. Width and feed are those stated.
#[utoipa::path(get, path = "/api/v1/cuts", tag = "history", operation_id = "listCuts", params(CutQuery),
    responses((status = 200, description = "One page", body = CutPageView), Refused))]
pub(super) async fn list(
    State(site): State<Site>,
    Asked(query): Asked<CutQuery>,
) -> Result<Json<CutPageView>, Problem> {
    let limit = query.limit.unwrap_or(100);
    if !(1..=MAX_PAGE).contains(&limit) {
        let problem = Problem::bad_request("invalid_query", "limit is not what was expected");
        return Err(problem.with_field("query/limit", "expected 1 to 1000"));
    }
    let mut found = site.handle.cuts(query.cursor, limit + 1).await?;
    let size = usize::try_from(limit).unwrap_or(1);
    let more = found.len() > size;
    found.truncate(size);
    let next = found.last().filter(|_| more).map(|cut| cut.sequence);
    Ok(Json(CutPageView { cuts: found.iter().map(PastCutView::from).collect(), next }))
}

/// The newest thousand as a table of cuts.
#[utoipa::path(get, path = "/api/v1/cuts/file.csv", tag = "history", operation_id = "downloadCuts",
    responses((status = 200, description = "A table of cuts", body = String, content_type = "text/csv"),
        Refused))]
pub(super) async fn table(State(site): State<Site>) -> Result<Response, Problem> {
    let cuts = site.handle.cuts(None, MAX_PAGE).await?;
    let kind = [(header::CONTENT_TYPE, "text/csv; charset=utf-8; header=present")];
    Ok((kind, cuts_csv(&cuts)).into_response())
}
