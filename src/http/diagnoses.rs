//! Diagnosis jobs over HTTP.

use super::extract::{Asked, Body, Named};
use super::paging::{next_header, page_size};
use super::problem::{Problem, Refused};
use super::reason::{Reason, ReasonBody};
use super::{Caller, Role, Site};
use crate::service::{AcceptedScenario, BUDGET_S, BUDGETS_S, DiagnosisView};
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::Deserialize;
use utoipa::{IntoParams, ToSchema};

/// Paging.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct DiagnosisQuery {
    /// `next-cursor` of the page before.
    cursor: Option<String>,
    /// Diagnoses a page, 1 to 1000; 1000 when not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<usize>,
}

/// The last hundred diagnoses, newest first. A page that is not the last carries the header `next-cursor`.
#[utoipa::path(get, path = "/api/v1/diagnoses", tag = "diagnosis", operation_id = "listDiagnoses",
    params(DiagnosisQuery),
    responses((status = 200, description = "One page", body = Vec<DiagnosisView>,
            headers(("next-cursor" = String, description = "Cursor of the next page, where there is one"))),
        Refused))]
pub(super) async fn list(
    State(site): State<Site>,
    Asked(query): Asked<DiagnosisQuery>,
) -> Result<Response, Problem> {
    let limit = page_size(query.limit)?;
    let before = query.cursor.unwrap_or_default();
    let (page, more) = site.handle.diagnoses().page(before, limit).await;
    let last = page.last().filter(|_| more);
    let next = last.and_then(|view| HeaderValue::from_str(&view.id).ok());
    Ok((next_header(next), Json(page)).into_response())
}

/// What to diagnose.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct DiagnosisBody {
    /// Names of recordings, 1 to 16, each once.
    #[schema(min_items = 1, max_items = 16)]
    recordings: Vec<String>,
    /// What it may take, s, 10 to 1800; 300 when not given.
    #[schema(minimum = 10, maximum = 1800)]
    #[serde(default = "budget", deserialize_with = "whole")]
    budget_s: u32,
    /// One sentence for the record.
    reason: Reason,
}

fn budget() -> u32 {
    BUDGET_S
}

/// A whole number of seconds; JSON tells 426 and 426.0 not apart.
fn whole<'de, D: serde::Deserializer<'de>>(from: D) -> Result<u32, D::Error> {
    use serde::de::Error as _;
    let number = f64::deserialize(from)?;
    if number.fract() != 0.0 || !(0.0..=f64::from(u32::MAX)).contains(&number) {
        return Err(D::Error::custom("expected a whole number of seconds"));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "whole and in range")]
    Ok(number as u32)
}

/// Start a diagnosis of stored recordings against the configured model.
#[utoipa::path(post, path = "/api/v1/diagnoses", tag = "diagnosis", operation_id = "startDiagnosis",
    request_body = DiagnosisBody, security(("token" = [])),
    responses((status = 202, description = "Queued", body = DiagnosisView),
        Refused))]
pub(super) async fn start(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    body: Result<Body<DiagnosisBody>, Problem>,
) -> Result<(StatusCode, Json<DiagnosisView>), Problem> {
    caller.require(Role::Engineer)?;
    let Body(body) = body?;
    let origin = body.reason.origin(&caller, &site)?;
    if !(1..=16).contains(&body.recordings.len()) {
        let problem =
            Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "invalid_body", "1 to 16 recordings are needed");
        return Err(problem.with_field("/recordings", "expected names from GET /api/v1/recordings"));
    }
    let names = &body.recordings;
    if let Some(twice) = names.iter().enumerate().find_map(|(i, n)| names[..i].contains(n).then_some(i)) {
        let problem =
            Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "invalid_body", "a recording is named twice");
        return Err(problem.with_field(&format!("/recordings/{twice}"), "expected each recording once"));
    }
    in_range(body.budget_s)?;
    let view = site.handle.start_diagnosis(body.recordings, body.budget_s, &origin).await?;
    Ok((StatusCode::ACCEPTED, Json(view)))
}

fn in_range(budget_s: u32) -> Result<(), Problem> {
    if BUDGETS_S.contains(&budget_s) {
        return Ok(());
    }
    let detail = "the budget is out of range";
    let problem = Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "invalid_body", detail);
    Err(problem.with_field("/budget_s", "expected 10 to 1800 s"))
}

/// How the past cuts are to be diagnosed.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CutDiagnosisBody {
    /// What it may take, s, 10 to 1800; 300 when not given.
    #[schema(minimum = 10, maximum = 1800)]
    #[serde(default = "budget", deserialize_with = "whole")]
    budget_s: u32,
    /// One sentence for the record.
    reason: Reason,
}

/// Start a diagnosis of the newest thousand past cuts against the stated cut.
#[utoipa::path(post, path = "/api/v1/cuts/diagnose", tag = "diagnosis", operation_id = "diagnoseCuts",
    request_body = CutDiagnosisBody, security(("token" = [])),
    responses((status = 202, description = "Queued", body = DiagnosisView),
        Refused))]
pub(super) async fn start_cuts(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    body: Result<Body<CutDiagnosisBody>, Problem>,
) -> Result<(StatusCode, Json<DiagnosisView>), Problem> {
    caller.require(Role::Engineer)?;
    let Body(body) = body?;
    let origin = body.reason.origin(&caller, &site)?;
    in_range(body.budget_s)?;
    let view = site.handle.start_cut_diagnosis(body.budget_s, &origin).await?;
    Ok((StatusCode::ACCEPTED, Json(view)))
}

/// End a diagnosis that waits or runs; it stays in the list as `cancelled`.
#[utoipa::path(post, path = "/api/v1/diagnoses/{id}/cancel", tag = "diagnosis",
    operation_id = "cancelDiagnosis", request_body = ReasonBody,
    params(("id" = String, Path, description = "Name of the job")),
    security(("token" = [])),
    responses((status = 202, description = "It is being ended", body = DiagnosisView),
        Refused))]
pub(super) async fn cancel(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    Named(id): Named<String>,
    body: Result<Body<ReasonBody>, Problem>,
) -> Result<(StatusCode, Json<DiagnosisView>), Problem> {
    caller.require(Role::Operator)?;
    let origin = body?.0.origin(&caller, &site)?;
    let view = site.handle.cancel_diagnosis(&id, &origin).await?;
    Ok((StatusCode::ACCEPTED, Json(view)))
}

/// Accept the scenario of a finished diagnosis of the cut. It is put on record and written into the folder of
/// the history; what runs stays as it is until somebody names it in the configuration and starts anew.
#[utoipa::path(post, path = "/api/v1/diagnoses/{id}/accept", tag = "diagnosis",
    operation_id = "acceptDiagnosisScenario", request_body = ReasonBody,
    params(("id" = String, Path, description = "Name of the job")),
    security(("token" = [])),
    responses((status = 200, description = "Where it stands, what is left to do", body = AcceptedScenario),
        Refused))]
pub(super) async fn accept(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    Named(id): Named<String>,
    body: Result<Body<ReasonBody>, Problem>,
) -> Result<Json<AcceptedScenario>, Problem> {
    caller.require(Role::Engineer)?;
    let origin = body?.0.origin(&caller, &site)?;
    Ok(Json(site.handle.accept_scenario(&id, &origin).await?))
}

/// One diagnosis with its result.
#[utoipa::path(get, path = "/api/v1/diagnoses/{id}", tag = "diagnosis", operation_id = "getDiagnosis",
    params(("id" = String, Path, description = "Name of the job")),
    responses((status = 200, description = "The job", body = DiagnosisView),
        Refused))]
pub(super) async fn one(
    State(site): State<Site>,
    Named(id): Named<String>,
) -> Result<Json<DiagnosisView>, Problem> {
    let found = site.handle.diagnoses().whole(&id).await;
    found.map(Json).ok_or_else(|| Problem::not_found("there is no such diagnosis"))
}

/// The report of a finished diagnosis for a person.
#[utoipa::path(get, path = "/api/v1/diagnoses/{id}/report.html", tag = "diagnosis",
    operation_id = "getDiagnosisReport",
    params(("id" = String, Path, description = "Name of the job")),
    responses((status = 200, description = "Self-contained HTML", body = String, content_type = "text/html"),
        Refused))]
pub(super) async fn report(State(site): State<Site>, Named(id): Named<String>) -> Result<Response, Problem> {
    let path = site.handle.diagnoses().file_of(&id, "report.html");
    let path = path.ok_or_else(|| Problem::not_found("there is no such report, or it is not ready"))?;
    let text = tokio::fs::read(&path).await.map_err(|_| Problem::not_found("the report is gone"))?;
    Ok(([(header::CONTENT_TYPE, "text/html; charset=utf-8")], text).into_response())
}

/// What a finished diagnosis of the cut wrote: the stated scenario with findings and corrections in it.
/// Nothing takes it by itself: a person who agrees names it in the configuration (`[cutting] scenario`).
#[utoipa::path(get, path = "/api/v1/diagnoses/{id}/scenario.toml", tag = "diagnosis",
    operation_id = "getDiagnosisScenario",
    params(("id" = String, Path, description = "Name of the job")),
    responses((status = 200, description = "A scenario", body = String, content_type = "application/toml"),
        Refused))]
pub(super) async fn scenario(
    State(site): State<Site>,
    Named(id): Named<String>,
) -> Result<Response, Problem> {
    let none = || Problem::not_found("there is no such scenario, or it is not ready");
    let path = site.handle.diagnoses().file_of(&id, "scenario.toml").ok_or_else(none)?;
    let text = tokio::fs::read(&path).await.map_err(|_| none())?;
    Ok(([(header::CONTENT_TYPE, "application/toml")], text).into_response())
}
