//! Requests made of arbitrary bytes, into the router of a service of this process.

use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::{Request, StatusCode};
use std::net::SocketAddr;
use std::path::PathBuf;
use stillcut::config::service::service_config_from_text;
use stillcut::http::{Access, router};
use stillcut::service::{Running, start};
use tower::ServiceExt as _;

const PATHS: [&str; 16] = [
    "PUT /api/v1/mode",
    "POST /api/v1/override",
    "POST /api/v1/fault/clear",
    "POST /api/v1/events/1/acknowledge",
    "POST /api/v1/events/1/silence",
    "POST /api/v1/diagnoses",
    "POST /api/v1/recordings",
    "PUT /api/v1/mode",
    "GET /api/v1/events?",
    "GET /api/v1/events?cursor=",
    "GET /api/v1/stability?",
    "GET /api/v1/recordings/",
    "GET /api/v1/diagnoses/",
    "GET /api/v1/audit?",
    "GET /api/v1/events/",
    "GET /",
];

/// A service whose history is in memory, and its router.
pub(crate) struct Site {
    router: axum::Router,
    runtime: tokio::runtime::Runtime,
    _running: Running,
}

impl Site {
    pub(crate) fn new() -> Self {
        let folder = PathBuf::from(format!("/dev/shm/fuzz-rest-{}", std::process::id()));
        let text = format!(
            "[transport]\nprefix = \"fuzz{0}\"\nroot = \"{1}/iox\"\n[http]\nlisten = \"127.0.0.1:0\"\n[history]\nfolder = \"{1}/state\"\nmax_bytes = 50000000\n",
            std::process::id(),
            folder.display()
        );
        let config = service_config_from_text(&folder.join("c.toml"), &text).expect("good");
        let running = start(config).expect("a service");
        let access = Access::load(None, true).expect("no tokens");
        let runtime = tokio::runtime::Builder::new_current_thread().enable_time().build().expect("a runtime");
        Self {
            router: router(running.handle().clone(), std::sync::Arc::new(access), vec![]),
            runtime,
            _running: running,
        }
    }

    /// One request: the first byte chooses where to, the second the headers, the rest is body or query.
    /// Anything but an answer below 500 (503 says that something is busy) is a finding.
    pub(crate) fn ask(&mut self, bytes: &[u8]) -> bool {
        let [place, headers, rest @ ..] = bytes else { return false };
        let (method, path) = PATHS[usize::from(place % 16)].split_once(' ').expect("two words");
        let (path, body) = if method == "GET" {
            let text: String = rest.iter().take(300).map(|b| escaped(*b)).collect();
            (format!("{path}{text}"), Vec::new())
        } else {
            (path.to_owned(), rest.to_vec())
        };
        let mut request = Request::builder().method(method).uri(path).header("host", "localhost");
        if headers & 1 == 0 {
            request = request.header("content-type", "application/json");
        }
        if headers & 2 == 0 {
            request = request.header("if-match", rest.get(..rest.len().min(6)).unwrap_or_default());
        } else {
            request = request.header("if-match", "\"1\"");
        }
        if headers & 4 != 0 {
            request = request.header("idempotency-key", rest.get(..rest.len().min(4)).unwrap_or_default());
        }
        if headers & 8 != 0 {
            request = request.header("accept", rest.get(..rest.len().min(12)).unwrap_or_default());
        }
        let Ok(mut request) = request.body(Body::from(body)) else { return false };
        request.extensions_mut().insert(ConnectInfo(SocketAddr::from(([127, 0, 0, 1], 9))));
        let answer = self.runtime.block_on(self.router.clone().oneshot(request)).expect("infallible");
        let status = answer.status();
        assert!(!status.is_server_error() || status == StatusCode::SERVICE_UNAVAILABLE, "{method}: {status}");
        if status.is_client_error() {
            let kind = answer.headers().get("content-type").and_then(|v| v.to_str().ok()).unwrap_or_default();
            assert!(kind == "application/problem+json", "{method} {status}: {kind}");
        }
        status.is_success()
    }
}

/// What may stand in a path or query; the rest percent-encoded.
fn escaped(byte: u8) -> String {
    match byte {
        b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'=' | b'&' | b'-' | b'.' | b'_' | b'/' | b'%' | b'+' => {
            char::from(byte).to_string()
        }
        _ => format!("%{byte:02x}"),
    }
}
