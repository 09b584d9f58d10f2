//! Events and diagnoses over a real NATS server, which comes and goes.

use crate::folders::{not_run, shared};
use crate::running::{Place, ask, get, until};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use stillcut::config::service::service_config_from_text;
use stillcut::service::{Running, start};
use stillcut::telemetry::EventKind;
use tokio_stream::StreamExt as _;

struct Server {
    child: Option<Child>,
    port: u16,
    folder: tempfile::TempDir,
}

impl Server {
    /// Nothing where the server is not installed.
    fn new() -> Option<Self> {
        let port = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let mut server = Self { child: None, port, folder: tempfile::tempdir().unwrap() };
        server.start()?;
        Some(server)
    }

    fn start(&mut self) -> Option<()> {
        let mut command = Command::new("nats-server");
        command.args(["-js", "-a", "127.0.0.1", "-p", &self.port.to_string(), "-sd"]).arg(self.folder.path());
        self.child = Some(command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().ok()?);
        until("the broker listens", 10, || std::net::TcpStream::connect(("127.0.0.1", self.port)).is_ok());
        Some(())
    }

    fn kill(&mut self) {
        if let Some(mut child) = self.child.take() {
            let _ = child.kill();
            let _ = child.wait();
        }
    }

    fn url(&self) -> String {
        format!("nats://127.0.0.1:{}", self.port)
    }

    /// Ids of all events in the stream, in its order.
    fn ids(&self) -> Vec<(i64, String)> {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let client = async_nats::connect(self.url()).await.unwrap();
            let context = async_nats::jetstream::new(client);
            let stream = context.get_stream("STILLCUT_EVENTS").await.unwrap();
            let config = async_nats::jetstream::consumer::pull::Config::default();
            let consumer = stream.create_consumer(config).await.unwrap();
            let mut found = Vec::new();
            loop {
                let mut batch = consumer
                    .fetch()
                    .max_messages(1000)
                    .expires(Duration::from_secs(2))
                    .messages()
                    .await
                    .unwrap();
                let before = found.len();
                while let Some(Ok(message)) = batch.next().await {
                    message.ack().await.unwrap();
                    let body: serde_json::Value = serde_json::from_slice(&message.payload).unwrap();
                    assert_eq!(body["machine"], "m1");
                    found.push((body["sequence"].as_i64().unwrap(), body["id"].as_str().unwrap().to_owned()));
                }
                if found.len() == before {
                    return found;
                }
            }
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.kill();
    }
}

fn service(place: &Place, more: &str) -> Running {
    let path = place.folder.path().join("c.toml");
    // Its turret is moved by nobody.
    let toml = place.toml("").replace("the tests", "not commissioned") + more;
    let mut config = service_config_from_text(&path, &toml).unwrap();
    config.http.trust_loopback = true;
    start(config).unwrap()
}

fn waiting(running: &Running) -> i64 {
    let text = get(running, "/metrics").body;
    let line = text.lines().find(|l| l.starts_with("stillcut_outbox_waiting ")).unwrap();
    line.rsplit(' ').next().unwrap().parse().unwrap()
}

fn make_events(running: &Running, count: usize) {
    running.wait(async {
        for round in 0..count.div_ceil(100) {
            let tell = |k: usize| {
                let handle = running.handle().clone();
                let text = format!("event {k} of round {round}");
                async move { handle.report(EventKind::Override, text).await }
            };
            let all: Vec<_> = (0..100.min(count - 100 * round)).map(|k| tokio::spawn(tell(k))).collect();
            for one in all {
                one.await.unwrap();
            }
        }
    });
}

fn skip(server: Option<Server>) -> Option<Server> {
    if server.is_none() {
        not_run("nats-server is not installed");
    }
    server
}

#[test]
fn events_reach_the_broker_in_order_and_once_however_often_it_goes() {
    let Some(mut server) = skip(Server::new()) else { return };
    let place = Place::new("nats");
    let fleet = format!("[fleet]\nserver = \"{}\"\nmachine = \"m1\"\n", server.url());
    let running = service(&place, &fleet);
    make_events(&running, 20);
    until("all are sent", 20, || waiting(&running) == 0);
    // An hour with an event every second, then shorter absences.
    for count in [3600, 60, 60] {
        server.kill();
        make_events(&running, count);
        until("they wait", 30, || waiting(&running) >= count as i64);
        server.start().unwrap();
        let began = Instant::now();
        until("they are sent later", 600, || waiting(&running) == 0);
        println!("{count} events that waited are with the broker {:?} after its return", began.elapsed());
    }
    // The service goes with events unsent and comes back; what was confirmed is forgotten on purpose.
    server.kill();
    make_events(&running, 30);
    running.stop();
    server.start().unwrap();
    let history = place.state().join(stillcut::store::FILE_NAME);
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        use sqlx::Connection as _;
        let options = sqlx::sqlite::SqliteConnectOptions::new().filename(&history);
        let mut connection = sqlx::SqliteConnection::connect_with(&options).await.unwrap();
        let set = sqlx::query("UPDATE outbox SET confirmed = confirmed - 25");
        assert_eq!(set.execute(&mut connection).await.unwrap().rows_affected(), 1);
        connection.close().await.unwrap();
    });
    let running = service(&place, &fleet);
    until("the rest is sent", 30, || waiting(&running) == 0);
    let ids = server.ids();
    let (mut kept, mut cursor): (Vec<(i64, String)>, _) = (Vec::new(), String::new());
    loop {
        let page = get(&running, &format!("/api/v1/events?limit=1000&order=oldest{cursor}")).json();
        let place =
            |e: &serde_json::Value| (e["sequence"].as_i64().unwrap(), e["id"].as_str().unwrap().to_owned());
        kept.extend(page["events"].as_array().unwrap().iter().map(place));
        let Some(next) = page["next"].as_i64() else { break };
        cursor = format!("&cursor={next}");
    }
    kept.truncate(ids.len());
    assert!(ids.len() >= 3770, "{}", ids.len());
    assert_eq!(ids, kept, "in order, each once, none missing");
    running.stop();
}

#[test]
fn a_diagnosis_is_done_by_a_worker_and_a_killed_worker_is_replaced() {
    let Some(cases) = shared("feed-axis-cases/case-13") else { return };
    let Some(server) = skip(Server::new()) else { return };
    let place = Place::new("work");
    let model = cases.join("machine.toml");
    let fleet = format!(
        "[fleet]\nserver = \"{}\"\nmachine = \"m1\"\ndiagnose = true\n[machine]\nmodel = \"{}\"\nwatch = [\"x\"]\n",
        server.url(),
        model.display()
    );
    let running = service(&place, &fleet);
    let worker = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stillcut"));
        command.args(["worker", "--jobs", "1", "--server", &server.url()]);
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap()
    };
    std::fs::copy(cases.join("moves.parquet"), place.state().join("recordings/imported.parquet")).unwrap();
    let address = running.handle().address().to_string();
    let body = "{\"recordings\":[\"imported\"],\"reason\":\"test\"}";
    let asked = ask(&address, "POST", "/api/v1/diagnoses", &[], Some(body));
    assert_eq!(asked.status, 202, "{asked:?}");
    let path = format!("/api/v1/diagnoses/{}", asked.json()["id"].as_str().unwrap());
    // The first worker dies in the middle of the job.
    let mut first = worker();
    until("it works", 60, || get(&running, &path).json()["progress"].as_f64().unwrap() > 0.0);
    first.kill().unwrap();
    first.wait().unwrap();
    let mut second = worker();
    until("the job is done", 300, || get(&running, &path).json()["state"] == "done");
    assert!(second.wait().unwrap().success(), "it ends after its one job");
    assert_eq!(get(&running, &path).json()["result"]["schema"], "stillcut.diagnosis/1");
    assert!(get(&running, &format!("{path}/report.html")).body.contains("<svg"));
    running.stop();
}
