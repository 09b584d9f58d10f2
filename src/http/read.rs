//! What is happening now, the configuration, health and metrics.

use super::extract::Asked;
use super::problem::{CheckView, Problem, Refused};
use super::{Site, access::Caller};
use crate::service::live::{AxisView, LiveState, SpectrumView};
use crate::service::{CommissioningView, LONGEST_S, PastView, stability};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// The whole picture.
#[utoipa::path(get, path = "/api/v1/state", tag = "live", operation_id = "getState",
    responses((status = 200, description = "The picture at this moment", body = LiveState),
        Refused))]
pub(super) async fn state(State(site): State<Site>) -> Json<LiveState> {
    Json((*site.handle.state()).clone())
}

/// The axes.
#[utoipa::path(get, path = "/api/v1/axes", tag = "live", operation_id = "getAxes",
    responses((status = 200, description = "Axes in the order of the stream", body = Vec<AxisView>),
        Refused))]
pub(super) async fn axes(State(site): State<Site>) -> Json<Vec<AxisView>> {
    Json(site.handle.state().axes.clone())
}

/// The newest spectrum of the watched band.
#[utoipa::path(get, path = "/api/v1/spectrum", tag = "live", operation_id = "getSpectrum",
    responses((status = 200, description = "Amplitude of every bin", body = SpectrumView),
        Refused))]
pub(super) async fn spectrum(State(site): State<Site>) -> Json<SpectrumView> {
    Json((*site.handle.spectrum()).clone())
}

/// Stability over the pitch angle difference, for the workpiece of the configuration.
#[utoipa::path(get, path = "/api/v1/stability", tag = "live", operation_id = "getStability",
    responses((status = 200,
        description = "Growth rate of the rightmost root over the pitch", body = stability::StabilityCurve),
        Refused))]
pub(super) async fn stability(State(site): State<Site>) -> Result<Json<stability::StabilityCurve>, Problem> {
    Ok(Json(site.handle.stability().await?))
}

/// How far back.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct PastQuery {
    /// Seconds, 10 to 28800; 20 when not given.
    #[param(minimum = 10, maximum = 28800)]
    seconds: Option<u32>,
}

/// Spectra and forces of the last seconds or hours. Up to 20 s as they were shown, beyond that the largest
/// values of each second, kept over a restart but for the last minute before a kill.
#[utoipa::path(get, path = "/api/v1/past", tag = "live", operation_id = "getPast", params(PastQuery),
    responses((status = 200, description = "At most 600 columns, oldest first", body = PastView), Refused))]
pub(super) async fn past(
    State(site): State<Site>,
    Asked(query): Asked<PastQuery>,
) -> Result<Json<PastView>, Problem> {
    let seconds = query.seconds.unwrap_or(20);
    if !(10..=LONGEST_S).contains(&seconds) {
        let problem = Problem::bad_request("invalid_query", "the query is not what was expected");
        return Err(problem.with_field("query/seconds", "expected 10 to 28800"));
    }
    Ok(Json(site.handle.past(seconds).await))
}

/// Where commissioning stands: what was observed, what is needed before `act`, what is accepted as missing.
#[utoipa::path(get, path = "/api/v1/commissioning", tag = "operation", operation_id = "getCommissioning",
    responses((status = 200, description = "Every item, with what there is and what is needed",
            body = CommissioningView),
        Refused))]
pub(super) async fn commissioning(State(site): State<Site>) -> Json<CommissioningView> {
    Json(site.handle.commissioning())
}

/// The configuration in force, without secrets.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct ConfigView {
    /// TOML, as `stillcut print-config` writes it.
    text: String,
    /// SHA-256 of the text; also the ETag.
    hash: String,
    /// Whether diagnoses can be asked for: `machine.model` names a model to start from.
    can_diagnose: bool,
}

/// The configuration in force.
#[utoipa::path(get, path = "/api/v1/config", tag = "operation", operation_id = "getConfig",
    params(("If-None-Match" = Option<String>, Header, description = "ETag of the copy at hand")),
    responses((status = 200, description = "Configuration with its ETag", body = ConfigView,
            headers(("ETag" = String, description = "Hash of the configuration"))),
        (status = 304, description = "Unchanged"),
        Refused))]
pub(super) async fn config(State(site): State<Site>, headers: HeaderMap) -> Response {
    let config = site.handle.config();
    let etag = format!("\"{}\"", config.hash);
    let tag = HeaderValue::from_str(&etag).unwrap_or_else(|_| HeaderValue::from_static("\"\""));
    if is_at_hand(&headers, &etag) {
        return (StatusCode::NOT_MODIFIED, [(header::ETAG, tag)]).into_response();
    }
    let can_diagnose = site.handle.model().is_some();
    let view = ConfigView { text: config.text.clone(), hash: config.hash.clone(), can_diagnose };
    ([(header::ETAG, tag)], Json(view)).into_response()
}

/// Whether `If-None-Match` names this ETag: one of a list, also a weak one, or `*` for any (RFC 9110).
fn is_at_hand(headers: &HeaderMap, etag: &str) -> bool {
    let fields = headers.get_all(header::IF_NONE_MATCH).iter().filter_map(|v| v.to_str().ok());
    let mut tags = fields.flat_map(|field| field.split(',')).map(str::trim);
    tags.any(|tag| tag == "*" || tag.strip_prefix("W/").unwrap_or(tag) == etag)
}

/// Alive: answers as long as the process can.
#[utoipa::path(get, path = "/healthz", tag = "operation", operation_id = "getHealth",
    responses((status = 200,
        description = "The process answers", body = String, content_type = "text/plain")))]
pub(super) async fn healthz() -> &'static str {
    "alive\n"
}

/// All is as it should be.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct Readiness {
    /// All conditions hold.
    ready: bool,
    /// Each condition.
    checks: Vec<CheckView>,
}

/// Ready: samples are fresh, the history can be written, the pipeline runs.
#[utoipa::path(get, path = "/readyz", tag = "operation", operation_id = "getReadiness",
    responses((status = 200, description = "Ready", body = Readiness),
        (status = 503, description = "Not ready; `checks` has the reasons", body = Problem,
            content_type = "application/problem+json"),
        Refused))]
pub(super) async fn readyz(State(site): State<Site>) -> Response {
    let checks: Vec<CheckView> = site.handle.checks().into_iter().map(CheckView::from).collect();
    let ready = checks.iter().all(|c| c.ok);
    if ready {
        return Json(Readiness { ready, checks }).into_response();
    }
    let failing = checks.iter().filter(|c| !c.ok);
    let detail = failing.map(|c| format!("{}: {}", c.name, c.detail)).collect::<Vec<_>>().join("; ");
    let problem = Problem::new(StatusCode::SERVICE_UNAVAILABLE, "unready", detail);
    problem.with_checks(checks).retry_after(1).into_response()
}

/// Metrics in the Prometheus text format.
#[utoipa::path(get, path = "/metrics", tag = "operation", operation_id = "getMetrics",
    responses((status = 200,
        description = "Prometheus text format 0.0.4", body = String, content_type = "text/plain"),
        Refused))]
pub(super) async fn metrics(State(site): State<Site>, _: Extension<Caller>) -> Response {
    match site.handle.metrics().text() {
        Ok(text) => {
            ([(header::CONTENT_TYPE, "text/plain; version=0.0.4; charset=utf-8")], text).into_response()
        }
        Err(error) => {
            tracing::error!(event = "metrics", "{error}");
            let detail = "the metrics could not be put together";
            Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", detail).into_response()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_etag_is_found_in_a_list_weak_or_by_the_star() {
        let found = |fields: &[&'static str]| {
            let field = |v: &&'static str| (header::IF_NONE_MATCH, HeaderValue::from_static(v));
            let headers: HeaderMap = fields.iter().map(field).collect();
            is_at_hand(&headers, "\"ab\"")
        };
        assert!(found(&["\"ab\""]) && found(&["W/\"ab\""]) && found(&["*"]));
        assert!(found(&["\"x\", W/\"y\" ,\"ab\""]) && found(&["\"x\"", "\"ab\""]));
        assert!(!found(&[]) && !found(&["\"x\", \"abc\""]) && !found(&["ab"]) && !found(&["w/\"ab\""]));
    }
}
