//! The history over HTTP: pages, filters, CSV, acknowledging and silencing.

use super::extract::{Asked, Body, Named};
use super::paging::{next_header, page_size};
use super::problem::{Problem, Refused};
use super::reason::Reason;
use super::{Caller, Role, Site};
use crate::service::{AuditRow, EventFilter, MAX_PAGE, clock};
use crate::telemetry::{Event, EventKind, Severity};
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};

/// Something that happened.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct EventView {
    /// Place in the history; order is by this.
    sequence: i64,
    /// Unique name.
    id: String,
    /// RFC 3339 UTC.
    time: String,
    /// The same in ns since 1970.
    time_ns: i64,
    /// What happened.
    kind: EventKind,
    /// How loud it is.
    severity: Severity,
    /// Axis it concerns.
    axis: Option<String>,
    /// Machine's clock, s.
    t_s: Option<f64>,
    /// Chatter frequency, Hz.
    frequency_hz: Option<f64>,
    /// Power of the strongest line, N2.
    power_n2: Option<f64>,
    /// Pitch angle difference, rad.
    pitch_difference_rad: Option<f64>,
    /// One sentence.
    text: String,
    /// Who acknowledged it.
    acknowledged_by: Option<String>,
    /// When, RFC 3339 UTC.
    acknowledged_at: Option<String>,
    /// Silenced until, RFC 3339 UTC.
    silenced_until: Option<String>,
    /// What a person says of an alarm: that it was right, or false; absent before anybody says.
    judged_right: Option<bool>,
}

impl From<&Event> for EventView {
    fn from(event: &Event) -> Self {
        Self {
            sequence: event.sequence,
            id: event.id.clone(),
            time: clock::rfc3339(event.wall_ns),
            time_ns: event.wall_ns,
            kind: event.kind,
            severity: event.kind.severity(),
            axis: event.axis.clone(),
            t_s: event.t_s,
            frequency_hz: event.frequency_hz,
            power_n2: event.power_n2,
            pitch_difference_rad: event.pitch_difference_rad,
            text: event.text.clone(),
            acknowledged_by: event.acknowledged_by.clone(),
            acknowledged_at: event.acknowledged_ns.map(clock::rfc3339),
            silenced_until: event.silenced_until_ns.map(clock::rfc3339),
            judged_right: event.judged_right,
        }
    }
}

/// Order of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Order {
    #[default]
    Newest,
    Oldest,
}

/// Filters and paging.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct EventQuery {
    /// `next` of the page before.
    cursor: Option<i64>,
    /// Events a page, 1 to 1000; 100 when not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<i64>,
    /// Newest or oldest first.
    #[param(inline)]
    order: Option<Order>,
    /// Only this kind, for example `chatter_onset`.
    #[param(inline)]
    kind: Option<EventKind>,
    /// Only this axis.
    axis: Option<String>,
    /// Only at or after this RFC 3339 time.
    #[param(format = DateTime)]
    since: Option<String>,
    /// Only at or before this RFC 3339 time.
    #[param(format = DateTime)]
    until: Option<String>,
    /// Only alarms that nobody acknowledged.
    open_alarms: Option<bool>,
    /// Form of the answer, before what `Accept` says: `json`, `csv` or `parquet`.
    #[param(inline)]
    format: Option<Form>,
}

/// Form of a page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum Form {
    Json,
    Csv,
    Parquet,
}

const PARQUET: &str = "application/vnd.apache.parquet";

impl Form {
    /// What is asked for by name, else what `Accept` likes best of the three; JSON where it names none.
    fn of(query: &EventQuery, headers: &HeaderMap) -> Self {
        let lists = headers.get_all(header::ACCEPT).iter().filter_map(|v| v.to_str().ok());
        query.format.unwrap_or_else(|| Self::liked_best(lists.flat_map(|list| list.split(','))))
    }

    fn liked_best<'a>(ranges: impl Iterator<Item = &'a str>) -> Self {
        let mut best = (0.0, Self::Json);
        for range in ranges {
            let mut parts = range.split(';').map(str::trim);
            let form = match parts.next().unwrap_or_default().to_ascii_lowercase().as_str() {
                "application/json" | "application/*" | "*/*" => Self::Json,
                "text/csv" | "text/*" => Self::Csv,
                PARQUET => Self::Parquet,
                _ => continue,
            };
            let liked = parts.find_map(|p| p.strip_prefix("q=").or(p.strip_prefix("Q=")));
            let liked = liked.map_or(1.0, |q| q.parse().unwrap_or(0.0));
            if liked > best.0 {
                best = (liked, form);
            }
        }
        best.1
    }
}

/// One page.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct EventPageView {
    /// Events in the order asked for.
    events: Vec<EventView>,
    /// Cursor of the next page; absent on the last.
    next: Option<i64>,
}

fn filter_from(query: EventQuery) -> Result<EventFilter, Problem> {
    let invalid = |name: &str, detail: &str| {
        Problem::bad_request("invalid_query", format!("{name} is not what was expected"))
            .with_field(&format!("query/{name}"), detail)
    };
    let time = |name: &str, text: Option<String>| match text {
        None => Ok(None),
        Some(text) => match clock::parse_rfc3339(&text) {
            Some(ns) => Ok(Some(ns)),
            None => Err(invalid(name, "expected an RFC 3339 time such as 2026-11-21T08:00:00Z")),
        },
    };
    let limit = query.limit.unwrap_or(100);
    if !(1..=MAX_PAGE).contains(&limit) {
        return Err(invalid("limit", "expected 1 to 1000"));
    }
    Ok(EventFilter {
        cursor: query.cursor,
        ascending: query.order == Some(Order::Oldest),
        kind: query.kind,
        axis: query.axis,
        since_ns: time("since", query.since)?,
        until_ns: time("until", query.until)?,
        unacknowledged_alarms: query.open_alarms.unwrap_or(false),
        limit,
    })
}

/// A page of the history as JSON, CSV or Parquet.
#[utoipa::path(get, path = "/api/v1/events", tag = "history", operation_id = "listEvents", params(EventQuery),
    responses((status = 200,
        description = "One page", content((EventPageView = "application/json"),
            (String = "text/csv"), (Vec<u8> = "application/vnd.apache.parquet")),
            headers(("next-cursor" = String,
                description = "Of CSV and Parquet: cursor of the next page, where there is one"))),
        Refused))]
pub(super) async fn list(
    State(site): State<Site>,
    headers: HeaderMap,
    Asked(query): Asked<EventQuery>,
) -> Result<Response, Problem> {
    let form = Form::of(&query, &headers);
    let page = site.handle.events(&filter_from(query)?).await?;
    let next = page.next;
    let cursor = || next_header(next.map(HeaderValue::from));
    let views = || page.events.iter().map(EventView::from).collect::<Vec<_>>();
    Ok(match form {
        Form::Json => Json(EventPageView { events: views(), next }).into_response(),
        Form::Csv => {
            let kind = [(header::CONTENT_TYPE, "text/csv; charset=utf-8; header=present")];
            (kind, cursor(), csv_text(&views())).into_response()
        }
        Form::Parquet => {
            let bytes = site.handle.events_parquet(page.events).await?;
            ([(header::CONTENT_TYPE, PARQUET)], cursor(), bytes).into_response()
        }
    })
}

fn csv_text(events: &[EventView]) -> String {
    let mut out = String::from(
        "sequence,time,kind,severity,axis,t_s,frequency_hz,power_n2,pitch_difference_rad,text,id,\
         acknowledged_by,acknowledged_at,silenced_until\n",
    );
    let number = |v: Option<f64>| v.map_or_else(String::new, |v| v.to_string());
    for e in events {
        let fields = [
            e.sequence.to_string(),
            e.time.clone(),
            e.kind.word().to_owned(),
            e.severity.word().to_owned(),
            csv_field(e.axis.as_deref().unwrap_or_default()),
            number(e.t_s),
            number(e.frequency_hz),
            number(e.power_n2),
            number(e.pitch_difference_rad),
            csv_field(&e.text),
            e.id.clone(),
            csv_field(e.acknowledged_by.as_deref().unwrap_or_default()),
            e.acknowledged_at.clone().unwrap_or_default(),
            e.silenced_until.clone().unwrap_or_default(),
        ];
        out.push_str(&fields.join(","));
        out.push('\n');
    }
    out
}

/// Quoted; what a spreadsheet would run as a formula gets an apostrophe in front.
fn csv_field(text: &str) -> String {
    let guard = if text.starts_with(['=', '+', '-', '@', '\t', '\r']) { "'" } else { "" };
    format!("\"{guard}{}\"", text.replace('"', "\"\""))
}

/// One event.
#[utoipa::path(get, path = "/api/v1/events/{sequence}", tag = "history", operation_id = "getEvent",
    params(("sequence" = i64, Path, description = "Place in the history")),
    responses((status = 200, description = "The event", body = EventView),
        Refused))]
pub(super) async fn one(
    State(site): State<Site>,
    Named(sequence): Named<i64>,
) -> Result<Json<EventView>, Problem> {
    Ok(Json(EventView::from(&site.handle.event(sequence).await?)))
}

/// Why an event is acknowledged, and what it was.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct AcknowledgeBody {
    /// One sentence for the record, 1 to 500 characters.
    reason: Reason,
    /// Whether the alarm was right or false, where the person knows: commissioning counts it.
    #[serde(default)]
    right: Option<bool>,
}

/// Acknowledge an event, and say whether its alarm was right.
#[utoipa::path(post, path = "/api/v1/events/{sequence}/acknowledge", tag = "control",
    operation_id = "acknowledgeEvent",
    params(("sequence" = i64, Path, description = "Place in the history")), request_body = AcknowledgeBody,
    security(("token" = [])),
    responses((status = 200, description = "The event as it is now", body = EventView),
        Refused))]
pub(super) async fn acknowledge(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    Named(sequence): Named<i64>,
    body: Result<Body<AcknowledgeBody>, Problem>,
) -> Result<Json<EventView>, Problem> {
    caller.require(Role::Operator)?;
    let Body(body) = body?;
    let origin = body.reason.origin(&caller, &site)?;
    Ok(Json(EventView::from(&site.handle.acknowledge(sequence, body.right, &origin).await?)))
}

/// How long an event is not to be shown as an alarm.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SilenceBody {
    /// Minutes, 1 to 480.
    #[schema(value_type = u32, minimum = 1, maximum = 480)]
    minutes: f64,
    /// One sentence for the record.
    reason: Reason,
}

/// Silence an event for a while.
#[utoipa::path(post, path = "/api/v1/events/{sequence}/silence", tag = "control",
    operation_id = "silenceEvent",
    params(("sequence" = i64, Path, description = "Place in the history")), request_body = SilenceBody,
    security(("token" = [])),
    responses((status = 200, description = "The event as it is now", body = EventView),
        Refused))]
pub(super) async fn silence(
    State(site): State<Site>,
    Extension(caller): Extension<Caller>,
    Named(sequence): Named<i64>,
    body: Result<Body<SilenceBody>, Problem>,
) -> Result<Json<EventView>, Problem> {
    caller.require(Role::Operator)?;
    let Body(body) = body?;
    // JSON knows one kind of number: 30.0 is as good as 30.
    if !(1.0..=480.0).contains(&body.minutes) || body.minutes.fract() != 0.0 {
        let problem = Problem::new(
            axum::http::StatusCode::UNPROCESSABLE_ENTITY,
            "invalid_body",
            "minutes is out of range",
        );
        return Err(problem.with_field("/minutes", "expected 1 to 480"));
    }
    let origin = body.reason.origin(&caller, &site)?;
    Ok(Json(EventView::from(&site.handle.silence(sequence, body.minutes, &origin).await?)))
}

/// Paging of the audit record.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub(super) struct AuditQuery {
    /// Rows after this place; `next-cursor` of the page before.
    after: Option<i64>,
    /// Rows a page, 1 to 1000; 1000 when not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<usize>,
}

/// One write that somebody made.
#[derive(Debug, Serialize, ToSchema)]
pub(super) struct AuditView {
    /// Place in the chain.
    sequence: i64,
    /// RFC 3339 UTC.
    time: String,
    /// Name of the token.
    actor: String,
    /// Role of the actor.
    role: String,
    /// What was done.
    action: String,
    /// With what, and why.
    detail: String,
}

impl From<AuditRow> for AuditView {
    fn from(row: AuditRow) -> Self {
        Self {
            sequence: row.sequence,
            time: clock::rfc3339(row.entry.wall_ns),
            actor: row.entry.actor,
            role: row.entry.role,
            action: row.entry.action,
            detail: row.entry.detail,
        }
    }
}

/// The audit record, oldest first. A full page carries the header `next-cursor`.
#[utoipa::path(get, path = "/api/v1/audit", tag = "history", operation_id = "listAudit", params(AuditQuery),
    responses((status = 200, description = "Rows after the given place", body = Vec<AuditView>,
            headers(("next-cursor" = i64, description = "Cursor of the next page, where this one is full"))),
        Refused))]
pub(super) async fn audit(
    State(site): State<Site>,
    Asked(query): Asked<AuditQuery>,
) -> Result<Response, Problem> {
    let limit = page_size(query.limit)?;
    let rows = site.handle.audit_rows(query.after.unwrap_or(0)).await?;
    let page: Vec<AuditView> = rows.into_iter().take(limit).map(AuditView::from).collect();
    let next = page.get(limit - 1).map(|last| HeaderValue::from(last.sequence));
    Ok((next_header(next), Json(page)).into_response())
}

#[cfg(test)]
mod tests {
    use super::{Form, csv_field};

    #[test]
    fn the_form_is_the_one_that_is_liked_best() {
        for (accept, form) in [
            ("text/html, text/csv", Form::Csv),
            ("TEXT/CSV;q=0.5, application/vnd.apache.parquet", Form::Parquet),
            ("application/json, text/csv", Form::Json),
            ("text/csv;q=0, */*;q=0.1", Form::Json),
            ("text/html", Form::Json),
            ("text/csvx", Form::Json),
            ("", Form::Json),
        ] {
            assert_eq!(Form::liked_best(accept.split(',')), form, "{accept}");
        }
    }

    #[test]
    fn spreadsheets_are_not_given_formulas() {
        assert_eq!(csv_field("=1+1"), "\"'=1+1\"");
        assert_eq!(csv_field("say \"hi\", twice"), "\"say \"\"hi\"\", twice\"");
    }
}
