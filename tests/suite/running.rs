//! A service for one test: its own domain, folder and port; asked over real HTTP.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use stillcut::config::service::{ServiceConfig, service_config_from_text};
use stillcut::plant::scenario::Scenario;
use stillcut::service::virtual_lathe::VirtualLathe;
use stillcut::service::{Running, start};
use stillcut::simulation::lathe::LatheSettings;
use stillcut::transport::Domain;

/// Folder and domain of one test, removed at the end.
pub(crate) struct Place {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) domain: Domain,
}

/// Whose limits a test's turret has: without them nothing acts.
const COMMISSIONED: &str = "turret.limits_by = \"the tests\"\nturret.limits_date = \"2026-11-21\"\nturret.accept = [\"hours_observed\", \"cuts_heard\", \"alarms_reviewed\", \"commands_advised\", \"model_drift\", \"estimators_disagree\"]\n";

impl Place {
    pub(crate) fn new(word: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let prefix = format!("s{}{word}", std::process::id());
        let domain = Domain::new(&prefix, &folder.path().join("iox")).unwrap();
        Self { folder, domain }
    }

    pub(crate) fn state(&self) -> PathBuf {
        self.folder.path().join("state")
    }

    /// TOML of a service in this place, with more lines in its `[http]` table.
    pub(crate) fn toml(&self, http: &str) -> String {
        format!(
            "{COMMISSIONED}[transport]\nprefix = \"{}\"\nroot = \"{}\"\n[http]\nlisten = \"127.0.0.1:0\"\n{http}\n[history]\nfolder = \"{}\"\n",
            self.domain.prefix().trim_end_matches('_'),
            self.domain.root().display(),
            self.state().display(),
        )
    }

    pub(crate) fn config(&self, http: &str) -> ServiceConfig {
        service_config_from_text(&self.folder.path().join("c.toml"), &self.toml(http)).unwrap()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.domain.remove();
    }
}

/// A token file with one token of each role; answers the tokens.
pub(crate) fn tokens(place: &Place) -> [String; 3] {
    use std::os::unix::fs::PermissionsExt as _;
    let mut text = String::new();
    let mut rank = 0;
    let made = ["viewer", "operator", "engineer"].map(|role| {
        rank += 1;
        let random = [rank; 32];
        let (token, digest) = stillcut::http::new_token(random);
        text += &format!("[[token]]\nname = \"{role}-1\"\nrole = \"{role}\"\nsha256 = \"{digest}\"\n");
        token
    });
    let path = place.folder.path().join("tokens.toml");
    std::fs::write(&path, text).unwrap();
    std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600)).unwrap();
    made
}

/// An answer.
#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) kind: String,
    pub(crate) etag: String,
    pub(crate) body: String,
}

impl Answer {
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.body).unwrap_or_else(|e| panic!("{e}: {}", self.body))
    }

    pub(crate) fn code(&self) -> String {
        self.json()["code"].as_str().unwrap_or_default().to_owned()
    }
}

/// Sends a request and takes any answer.
pub(crate) fn ask(
    address: &str,
    method: &str,
    path: &str,
    headers: &[(&str, &str)],
    body: Option<&str>,
) -> Answer {
    let config = ureq::Agent::config_builder()
        .http_status_as_error(false)
        .allow_non_standard_methods(true)
        .timeout_global(Some(Duration::from_secs(60)));
    let agent: ureq::Agent = config.build().into();
    let mut request = ureq::http::Request::builder().method(method).uri(format!("http://{address}{path}"));
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let answered = match body {
        Some(text) => {
            agent.run(request.header("Content-Type", "application/json").body(text.to_owned()).unwrap())
        }
        None => agent.run(request.body(()).unwrap()),
    };
    let mut response = answered.unwrap_or_else(|e| panic!("{method} {path}: {e}"));
    let header = |name: &str| {
        response.headers().get(name).and_then(|v| v.to_str().ok()).unwrap_or_default().to_owned()
    };
    let (kind, etag) = (header("content-type"), header("etag"));
    Answer {
        status: response.status().as_u16(),
        kind,
        etag,
        body: response.body_mut().read_to_string().unwrap_or_default(),
    }
}

pub(crate) fn get(running: &Running, path: &str) -> Answer {
    ask(&running.handle().address().to_string(), "GET", path, &[], None)
}

/// The virtual lathe on a thread, until dropped.
pub(crate) struct LatheThread {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl LatheThread {
    pub(crate) fn start(domain: &Domain) -> Self {
        let (stop, domain) = (Arc::new(AtomicBool::new(false)), domain.clone());
        let flag = Arc::clone(&stop);
        let thread = std::thread::spawn(move || {
            let settings = LatheSettings::realistic(Scenario::default(), 1);
            let mut lathe = VirtualLathe::join(settings, &domain).unwrap();
            lathe.run(&flag, None, |_| {}).unwrap();
        });
        Self { stop, thread: Some(thread) }
    }
}

impl Drop for LatheThread {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// Waits until `good` holds; panics with what it waited for.
pub(crate) fn until(what: &str, seconds: u64, mut good: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(seconds);
    while !good() {
        assert!(Instant::now() < deadline, "waited {seconds} s for: {what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// A running service without tokens.
pub(crate) fn service(place: &Place) -> Running {
    start(place.config("")).unwrap()
}
