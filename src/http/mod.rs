//! HTTP: the versioned API, the live stream, health, metrics and the operator page.
//!
//! Every refusal is problem+json with a stable code. Writes need a token; see `access`. The `Host`
//! header is checked, because a browser can be led to talk to services on loopback.

mod access;
mod control;
mod cuts;
mod diagnoses;
mod events;
mod extract;
mod idempotency;
mod page;
mod paging;
mod problem;
mod read;
mod reason;
mod recordings;
mod refusals;
mod seats;
mod secrets;
mod server;
mod stream;
mod token_file;
mod watchful;

pub use access::{Access, Caller};
pub use events::EventView;
pub use problem::{CheckView, FieldError, Problem};
pub use secrets::holds_token;
pub use server::{TlsError, serve, tls_acceptor};
pub use token_file::{Role, TokenFileError, new_token, token_names};

use crate::service::{Handle, clock};
use access::Verdict;
use axum::Router;
use axum::extract::{ConnectInfo, DefaultBodyLimit, MatchedPath, Request, State};
use axum::http::{HeaderValue, StatusCode, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use tokio::sync::Semaphore;
use tower_http::catch_panic::CatchPanicLayer;
use utoipa::OpenApi;
use utoipa::openapi::security::{HttpAuthScheme, HttpBuilder, SecurityScheme};
use utoipa::openapi::{RefOr, Schema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;
use watchful::Where;

/// Largest body of a request.
const BODY_BYTES: usize = 64 * 1024;
/// Most listeners of the live stream.
const STREAMS: usize = 64;
/// Most downloads at once.
const EXPORTS: usize = 2;

/// How long the disk may take to show a token that was added a moment ago.
const FRESH_TOKENS: std::time::Duration = std::time::Duration::from_millis(500);

/// Address of the other end of a connection.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PeerAddress(pub(crate) SocketAddr);

/// What every handler can reach.
#[derive(Debug)]
pub struct Shared {
    handle: Handle,
    access: Arc<Access>,
    hosts: Vec<String>,
    streams: Arc<Semaphore>,
    exports: Arc<Semaphore>,
    answers: idempotency::Answers,
    refusals: watchful::Refusals,
}

type Site = Arc<Shared>;

#[derive(OpenApi)]
#[openapi(
    info(
        title = "Stillcut",
        description = "Supervisory chatter control for parallel turning. Advice to the motion controller; \
            not a safety function. Errors are problem+json with a stable `code`.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0"),
    ),
    components(schemas(Problem)),
    tags(
        (name = "live", description = "What is happening now"),
        (name = "history", description = "Events, recordings, audit record"),
        (name = "control", description = "What people may do; needs a token"),
        (name = "diagnosis", description = "What physics the machine model leaves out"),
        (name = "operation", description = "Health and metrics"),
    ),
)]
struct Description;

fn routes() -> OpenApiRouter<Site> {
    OpenApiRouter::with_openapi(Description::openapi())
        .routes(routes!(read::state))
        .routes(routes!(read::axes))
        .routes(routes!(read::spectrum))
        .routes(routes!(read::stability))
        .routes(routes!(read::past))
        .routes(routes!(read::config))
        .routes(routes!(read::commissioning))
        .routes(routes!(stream::stream))
        .routes(routes!(events::list))
        .routes(routes!(events::one))
        .routes(routes!(events::acknowledge))
        .routes(routes!(events::silence))
        .routes(routes!(control::get_mode, control::put_mode))
        .routes(routes!(control::take_back))
        .routes(routes!(control::hold))
        .routes(routes!(control::clear_fault))
        .routes(routes!(recordings::list, recordings::save))
        .routes(routes!(recordings::download))
        .routes(routes!(recordings::download_csv))
        .routes(routes!(recordings::download_json))
        .routes(routes!(recordings::replay))
        .routes(routes!(diagnoses::list, diagnoses::start))
        .routes(routes!(diagnoses::one))
        .routes(routes!(diagnoses::cancel))
        .routes(routes!(diagnoses::report))
        .routes(routes!(diagnoses::scenario))
        .routes(routes!(diagnoses::accept))
        .routes(routes!(cuts::list))
        .routes(routes!(cuts::table))
        .routes(routes!(diagnoses::start_cuts))
        .routes(routes!(events::audit))
        .routes(routes!(read::healthz))
        .routes(routes!(read::readyz))
        .routes(routes!(read::metrics))
}

/// One example of every object that goes over the wire, by the name of its schema.
fn examples() -> serde_json::Map<String, serde_json::Value> {
    serde_json::from_str(include_str!("examples.json")).unwrap_or_default() // its form is tested
}

/// The description of the API, as `/openapi.json` gives it.
#[must_use]
pub fn description() -> utoipa::openapi::OpenApi {
    let mut api = routes().split_for_parts().1;
    let bearer = HttpBuilder::new().scheme(HttpAuthScheme::Bearer).bearer_format("256 random bits").build();
    let components = api.components.get_or_insert_default();
    for (name, example) in examples() {
        if let Some(RefOr::T(Schema::Object(object))) = components.schemas.get_mut(&name) {
            object.examples = vec![example];
        }
    }
    if let Some(RefOr::T(Schema::Object(problem))) = components.schemas.get_mut("Problem")
        && let Some(RefOr::T(Schema::Object(code))) = problem.properties.get_mut("code")
    {
        code.enum_values = Some(problem::CODES.map(Into::into).into());
    }
    if let Some(RefOr::T(Schema::Object(body))) = components.schemas.get_mut("DiagnosisBody")
        && let Some(RefOr::T(Schema::Array(names))) = body.properties.get_mut("recordings")
    {
        names.unique_items = true;
    }
    components.security_schemes.insert("token".to_owned(), RefOr::T(SecurityScheme::Http(bearer)));
    api
}

/// The whole site over a running service. `hosts`: names beside loopback's that `Host` may carry.
pub fn router(handle: Handle, access: Arc<Access>, hosts: Vec<String>) -> Router {
    let site = Arc::new(Shared {
        handle,
        access,
        hosts,
        streams: Arc::new(Semaphore::new(STREAMS)),
        exports: Arc::new(Semaphore::new(EXPORTS)),
        answers: idempotency::Answers::default(),
        refusals: watchful::Refusals::default(),
    });
    let (api, _) = routes().split_for_parts();
    let swagger = utoipa_swagger_ui::SwaggerUi::new("/api").url("/openapi.json", description());
    let outer = Arc::clone(&site);
    Router::new()
        .merge(api)
        .merge(page::routes())
        .merge(swagger)
        .fallback(not_found)
        .method_not_allowed_fallback(method_not_allowed)
        .layer(DefaultBodyLimit::max(BODY_BYTES))
        .layer(from_fn_with_state(Arc::clone(&site), idempotency::layer))
        .layer(CatchPanicLayer::custom(panicked))
        .layer(from_fn_with_state(outer, gate))
        .with_state(site)
}

async fn not_found() -> Problem {
    Problem::not_found("there is nothing at this path")
}

async fn method_not_allowed(request: Request) -> Problem {
    let detail = format!("{} is not possible here", request.method());
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", detail)
}

fn panicked(_: Box<dyn std::any::Any + Send + 'static>) -> Response {
    let detail = "a fault of ours; it is in the log";
    Problem::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", detail).into_response()
}

/// First and last thing that every request meets: host, token, headers of the answer, time taken.
async fn gate(State(site): State<Site>, mut request: Request, next: Next) -> Response {
    let begun = clock::now();
    let address = address_of(&request);
    let path = request.uri().path().to_owned();
    let route = request.extensions().get::<MatchedPath>().map_or("other", MatchedPath::as_str).to_owned();
    // A length beside it was ignored: what follows on the connection is not taken for a request.
    let chunked = request.headers().contains_key(header::TRANSFER_ENCODING);
    let admitted = admit(&site, &mut request, address).await;
    let caller = request.extensions().get::<Caller>().map_or_else(String::new, |c| c.name.clone());
    let mut response = match admitted {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    };
    // The API browser takes every path below its own and refuses what it does not know in its own words.
    if response.status().is_client_error() && route.starts_with("/api/{") {
        response = Problem::not_found("there is nothing at this path").into_response();
    }
    Problem::place(&mut response, &path);
    if chunked {
        response.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
    }
    secure(&path, &mut response);
    count_refusal(&site, response.status(), Where { address, path: &path, caller: &caller });
    let code = class_of(response.status());
    let metrics = site.handle.metrics();
    let labels = [part_of(&route), code];
    metrics.http_request_duration_seconds.with_label_values(&labels).observe(begun.elapsed().as_secs_f64());
    response
}

/// One of [`crate::telemetry::HTTP_ROUTES`].
fn part_of(route: &str) -> &'static str {
    let Some(inner) = route.strip_prefix("/api/v1/") else {
        return match route {
            "/healthz" | "/readyz" | "/metrics" => "operation",
            _ => "page",
        };
    };
    match inner.split('/').next().unwrap_or_default() {
        "state" | "axes" | "spectrum" | "stability" | "past" | "stream" => "live",
        "events" | "cuts" | "recordings" | "audit" | "diagnoses" => "history",
        "config" | "commissioning" => "operation",
        _ => "control",
    }
}

/// One of [`crate::telemetry::HTTP_CODES`].
fn class_of(status: StatusCode) -> &'static str {
    match status.as_u16() {
        500.. => "5xx",
        400.. => "4xx",
        _ => "2xx",
    }
}

fn count_refusal(site: &Shared, status: StatusCode, place: Where<'_>) {
    let metrics = site.handle.metrics();
    match status {
        StatusCode::FORBIDDEN => site.refusals.tell(metrics, "forbidden", place, clock::now()),
        StatusCode::PAYLOAD_TOO_LARGE => metrics.http_refused.with_label_values(&["body_too_large"]).inc(),
        _ => {}
    }
}

fn address_of(request: &Request) -> IpAddr {
    let peer = request.extensions().get::<PeerAddress>().map(|p| p.0.ip());
    let tested = || request.extensions().get::<ConnectInfo<SocketAddr>>().map(|c| c.0.ip());
    peer.or_else(tested).unwrap_or(IpAddr::V4(std::net::Ipv4Addr::UNSPECIFIED))
}

async fn admit(site: &Site, request: &mut Request, address: IpAddr) -> Result<(), Problem> {
    let (metrics, path) = (site.handle.metrics(), request.uri().path().to_owned());
    let refuse = |kind| {
        site.refusals.tell(metrics, kind, Where { address, path: &path, caller: "" }, clock::now());
    };
    let Some(host) = only_host(request) else {
        refuse("bad_host");
        let detail = "the request names more than one host";
        return Err(Problem::bad_request("ambiguous_host", detail));
    };
    if !host_is_ours(host, &site.hosts) && !takes_back(site, request, address) {
        refuse("bad_host");
        let detail = "this host name is not served here; add it to http.hosts";
        return Err(Problem::new(StatusCode::MISDIRECTED_REQUEST, "unknown_host", detail));
    }
    let mut caller = caller_of(site, request, address);
    if caller.is_none() {
        drop(tokio::time::timeout(FRESH_TOKENS, site.access.look_again(clock::now())).await);
        caller = caller_of(site, request, address);
    }
    let judge = || site.access.judge(request.headers(), address, clock::now());
    match caller.map_or_else(judge, Verdict::Known) {
        Verdict::Known(caller) => {
            if needs_reader(&path) {
                caller.require(Role::Viewer)?;
            }
            request.extensions_mut().insert(caller);
            Ok(())
        }
        Verdict::BadToken => {
            refuse("bad_token");
            Err(Problem::new(StatusCode::UNAUTHORIZED, "bad_token", "this token is not valid"))
        }
        Verdict::RateLimited => {
            refuse("rate_limited");
            let detail = "too many wrong tokens from this address; wait a minute";
            Err(Problem::new(StatusCode::TOO_MANY_REQUESTS, "too_many_bad_tokens", detail).retry_after(60))
        }
    }
}

/// Whether the turret is taken back with a token that may: under whatever name somebody reached the service,
/// that is done. A page of somebody else's has no token.
fn takes_back(site: &Site, request: &Request, address: IpAddr) -> bool {
    is_override(request)
        && request.headers().contains_key(header::AUTHORIZATION)
        && caller_of(site, request, address).is_some_and(|c| c.role >= Some(Role::Operator))
}

fn is_override(request: &Request) -> bool {
    request.uri().path() == "/api/v1/override"
}

/// Who it is: by a token in force, or, to take the turret back, by one that was until none was.
fn caller_of(site: &Site, request: &Request, address: IpAddr) -> Option<Caller> {
    let (headers, now) = (request.headers(), clock::now());
    let back = is_override(request).then(|| site.access.last_operator(headers, now)).flatten();
    back.or_else(|| site.access.caller(headers, address, now))
}

/// The page itself and liveness tell nothing about the machine.
fn needs_reader(path: &str) -> bool {
    path.starts_with("/api/v1/") || path == "/metrics" || path == "/readyz"
}

/// The host that a request is for: the header's, or that of the address line. `None`: two that differ.
fn only_host(request: &Request) -> Option<&str> {
    let mut headers = request.headers().get_all(header::HOST).iter();
    let named = headers.next().map(|v| v.to_str().unwrap_or_default());
    let line = request.uri().authority().map(|a| a.as_str());
    let differ = named.zip(line).is_some_and(|(a, b)| !a.eq_ignore_ascii_case(b));
    (!differ && headers.next().is_none()).then(|| named.or(line).unwrap_or_default())
}

/// True for loopback's own names and the configured ones, with any port.
fn host_is_ours(host: &str, configured: &[String]) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or_default(),
        None => host.split(':').next().unwrap_or_default(),
    };
    let own = name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok_and(|a| a.is_loopback());
    own || configured.iter().any(|h| h.eq_ignore_ascii_case(name))
}

const CSP: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; \
     connect-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'";
/// The vendored Swagger UI styles itself inline; it still loads nothing from elsewhere.
const CSP_INLINE: &str = "default-src 'none'; script-src 'self' 'unsafe-inline'; \
     style-src 'self' 'unsafe-inline'; img-src 'self' data:; connect-src 'self'; form-action 'none'; \
     base-uri 'none'; frame-ancestors 'none'";
/// The diagnosis report is one file with its styles and pictures in it.
const CSP_REPORT: &str =
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'";

fn secure(path: &str, response: &mut Response) {
    let policy = if path == "/api" || path.starts_with("/api/") && !path.starts_with("/api/v1/") {
        CSP_INLINE
    } else if path.ends_with("/report.html") {
        CSP_REPORT
    } else {
        CSP
    };
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(policy));
    headers.insert(header::X_CONTENT_TYPE_OPTIONS, HeaderValue::from_static("nosniff"));
    headers.insert(header::X_FRAME_OPTIONS, HeaderValue::from_static("DENY"));
    headers.insert(header::REFERRER_POLICY, HeaderValue::from_static("no-referrer"));
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
}

#[cfg(test)]
mod tests {
    use super::{StatusCode, class_of, description, examples, host_is_ours, part_of};
    use serde_json::Value;

    /// Every object of the description has an example: it holds what the object must hold and nothing else.
    #[test]
    fn every_object_has_an_example_of_its_form() {
        let api = serde_json::to_value(description()).expect("JSON");
        let examples = examples();
        let schemas = api["components"]["schemas"].as_object().expect("schemas");
        let objects: Vec<_> = schemas.iter().filter(|(_, s)| s["type"] == "object").collect();
        assert_eq!(objects.len(), examples.len(), "an example without an object, or an object without one");
        for (name, schema) in objects {
            agrees(name, schema, &schema["examples"][0], schemas);
        }
    }

    #[test]
    fn the_codes_are_those_that_the_page_explains() {
        let page = include_str!("page/problems.html");
        let explained: Vec<&str> =
            page.split("<dt id=\"").skip(1).filter_map(|rest| rest.split('"').next()).collect();
        assert_eq!(explained, super::problem::CODES);
        let api = serde_json::to_value(description()).expect("JSON");
        let code = &api["components"]["schemas"]["Problem"]["properties"]["code"];
        assert_eq!(code["enum"], serde_json::json!(explained));
        let names = &api["components"]["schemas"]["DiagnosisBody"]["properties"]["recordings"];
        assert_eq!(names["uniqueItems"], true);
    }

    #[test]
    fn every_route_is_counted_in_a_part_that_exists() {
        use crate::telemetry::{HTTP_CODES, HTTP_ROUTES};
        let paths = description().paths.paths;
        let mut parts: Vec<&str> = paths.keys().map(|p| part_of(p)).chain([part_of("/")]).collect();
        parts.push(part_of("other"));
        assert!(parts.iter().all(|p| HTTP_ROUTES.contains(p)), "{parts:?}");
        assert!(HTTP_ROUTES.iter().all(|r| parts.contains(r)), "{parts:?}");
        let codes = [200_u16, 304, 404, 503].map(|c| class_of(StatusCode::from_u16(c).unwrap()));
        assert!(codes == ["2xx", "2xx", "4xx", "5xx"] && codes.iter().all(|c| HTTP_CODES.contains(c)));
    }

    fn agrees(place: &str, schema: &Value, value: &Value, schemas: &serde_json::Map<String, Value>) {
        if let Some(name) = schema["$ref"].as_str().and_then(|r| r.rsplit('/').next()) {
            return agrees(place, &schemas[name], value, schemas);
        }
        if let Some(words) = schema["enum"].as_array() {
            assert!(words.contains(value), "{place}: {value}");
        }
        let kinds = match &schema["type"] {
            Value::Array(kinds) => kinds.clone(),
            Value::Null => return,
            one => vec![one.clone()],
        };
        let kind = match value {
            Value::Null => "null",
            Value::Bool(_) => "boolean",
            Value::Number(n) if n.is_f64() => "number",
            Value::Number(_) => "integer",
            Value::String(_) => "string",
            Value::Array(_) => "array",
            Value::Object(_) => "object",
        };
        assert!(kinds.contains(&kind.into()), "{place}: {kind} where the description has {kinds:?}");
        for item in value.as_array().into_iter().flatten() {
            agrees(place, &schema["items"], item, schemas);
        }
        let Some((fields, known)) = value.as_object().zip(schema["properties"].as_object()) else { return };
        for needed in schema["required"].as_array().into_iter().flatten() {
            assert!(fields.contains_key(needed.as_str().expect("a name")), "{place}: lacks {needed}");
        }
        for (field, value) in fields {
            agrees(&format!("{place}.{field}"), known.get(field).expect(field), value, schemas);
        }
    }

    #[test]
    fn only_own_names_are_served() {
        let configured = ["lathe-7.plant.example".to_owned()];
        for good in ["localhost", "localhost:8620", "127.0.0.1:80", "[::1]:8620", "LATHE-7.plant.example:443"]
        {
            assert!(host_is_ours(good, &configured), "{good}");
        }
        for bad in
            ["", "evil.example", "127.0.0.1.evil.example", "localhost.evil.example:80", "10.0.0.1", "[::2]:1"]
        {
            assert!(!host_is_ours(bad, &configured), "{bad}");
        }
    }
}
