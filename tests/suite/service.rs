//! The whole service: in this process with the virtual lathe, and as the real binary that is killed.

use crate::folders::{not_run, project};
use crate::running::{Answer, LatheThread, Place, ask, get, service, tokens, until};
use std::io::{BufRead as _, BufReader, Read as _};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use stillcut::service::{Running, start};
use stillcut::transport::CommandPublisher;

fn state(running: &Running) -> serde_json::Value {
    get(running, "/api/v1/state").json()
}

fn events(running: &Running, kind: &str) -> Vec<serde_json::Value> {
    let page = get(running, &format!("/api/v1/events?limit=100&kind={kind}")).json();
    page["events"].as_array().unwrap().clone()
}

fn set_mode(running: &Running, mode: &str) -> Answer {
    let address = running.handle().address().to_string();
    let etag = get(running, "/api/v1/mode").etag;
    let body = format!("{{\"mode\":\"{mode}\",\"reason\":\"test\"}}");
    ask(&address, "PUT", "/api/v1/mode", &[("If-Match", &etag)], Some(&body))
}

/// The loop over real shared memory: heard, commanded, moved, silent; then taken back.
#[test]
fn chatter_is_heard_recorded_and_suppressed_in_act_only() {
    let place = Place::new("loop");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    assert_eq!(set_mode(&running, "act").code(), "not_ready", "no samples, no acting");
    let lathe = LatheThread::start(&place.domain);
    until("chatter is heard", 30, || state(&running)["chatter"]["state"] == "chatter");
    assert_eq!(state(&running)["pitch"]["hold_reason"], "observing");
    {
        // In observe the command port does not exist: somebody else could have it.
        let other = place.domain.join("other").unwrap();
        drop(CommandPublisher::open(&other).expect("the port is free in observe"));
    }
    assert_eq!(set_mode(&running, "act").status, 200);
    {
        let other = place.domain.join("other").unwrap();
        assert!(CommandPublisher::open(&other).is_err(), "in act there is one commander");
    }
    until("the turret stands apart", 10, || {
        state(&running)["pitch"]["reported_rad"].as_f64().unwrap_or(0.0) > 0.06
    });
    until("chatter ends", 15, || state(&running)["chatter"]["state"] == "quiet");
    let commands = events(&running, "pitch_command");
    let commanded = commands[0]["pitch_difference_rad"].as_f64().unwrap();
    assert!((0.07..0.14).contains(&commanded), "{commanded}");
    assert!(!events(&running, "command_reached").is_empty());
    // The commands go on, so that the turret stays; nothing new is recorded for them.
    std::thread::sleep(Duration::from_secs(4));
    assert!(state(&running)["pitch"]["reported_rad"].as_f64().unwrap() > 0.06);
    assert!(events(&running, "pitch_command").len() <= commands.len() + 1);
    let metrics = get(&running, "/metrics").body;
    let renewed =
        metrics.lines().find(|l| l.starts_with("stillcut_commands_total{outcome=\"renewed\"}")).unwrap();
    assert!(renewed.split(' ').nth(1).unwrap().parse::<u64>().unwrap() >= 2, "{renewed}");

    let address = running.handle().address().to_string();
    let taken = ask(&address, "POST", "/api/v1/override", &[], Some("{\"reason\":\"test\"}"));
    assert_eq!(taken.status, 200, "{taken:?}");
    until("equal pitch", 5, || state(&running)["pitch"]["reported_rad"].as_f64().unwrap_or(1.0).abs() < 1e-3);
    assert_eq!(state(&running)["mode"], "observe");

    until("the recording is there", 10, || {
        !get(&running, "/api/v1/recordings").json().as_array().unwrap().is_empty()
    });
    let recordings = get(&running, "/api/v1/recordings").json();
    let id = recordings[0]["id"].as_str().unwrap().to_owned();
    let path = running.handle().recording_path(&id).unwrap();
    let recording = stillcut::recording::read_recording(&path).unwrap();
    assert_eq!(recording.axes, ["x1", "y1", "x2", "y2", "z1"]);
    assert!(recording.len() > 9000 && recording.get("x1_stage_position_m").is_some());
    drop(lathe);
    until("the silence is noticed", 5, || state(&running)["source"]["connected"] == false);
    let ready = get(&running, "/readyz");
    assert_eq!((ready.status, ready.kind.as_str()), (503, "application/problem+json"));
    assert_eq!((ready.code().as_str(), ready.json()["checks"][0]["ok"].as_bool()), ("unready", Some(false)));
    running.stop();
}

#[test]
fn a_machine_that_comes_back_is_heard_within_two_seconds_and_acting_does_not_resume() {
    let place = Place::new("back");
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    for life in 0..3 {
        let began = Instant::now();
        let lathe = LatheThread::start(&place.domain);
        until("samples come", 5, || state(&running)["source"]["connected"] == true);
        assert!(life == 0 || began.elapsed() < Duration::from_secs(2), "{:?}", began.elapsed());
        until("interlocks are heard", 5, || set_mode(&running, "act").status == 200);
        drop(lathe);
        until("acting ends", 5, || state(&running)["mode"] == "observe");
        assert!(state(&running)["fault"].is_string(), "a fault is latched");
        // The turret falls silent before the samples count as lost: acting ends with the first of them.
        until("the loss is told", 5, || events(&running, "source_lost").len() == life + 1);
        assert_eq!(set_mode(&running, "act").code(), "faulted");
        let address = running.handle().address().to_string();
        let cleared = ask(&address, "POST", "/api/v1/fault/clear", &[], Some("{\"reason\":\"test\"}"));
        assert_eq!(cleared.status, 200);
        assert!(state_until(&running, |s| s["fault"].is_null()));
    }
    assert_eq!(events(&running, "source_lost").len(), 3);
    running.stop();
}

fn state_until(running: &Running, good: impl Fn(&serde_json::Value) -> bool) -> bool {
    until("the picture follows", 3, || good(&state(running)));
    true
}

/// What a page opens with outlives a restart.
#[test]
fn the_past_is_there_after_a_restart() {
    let place = Place::new("past");
    let running = service(&place);
    let lathe = LatheThread::start(&place.domain);
    let columns = |running: &Running| {
        let past = get(running, "/api/v1/past?seconds=600").json();
        past["age_s"].as_array().unwrap().iter().map(|a| a.as_f64().unwrap()).collect::<Vec<_>>()
    };
    until("some seconds are kept", 15, || columns(&running).len() >= 4);
    drop(lathe);
    running.stop();
    std::thread::sleep(Duration::from_secs(2));
    let running = service(&place);
    until("they are there again", 5, || columns(&running).len() >= 4);
    assert!(columns(&running).iter().all(|age| *age > 1.5), "nothing came since");
    let lathe = LatheThread::start(&place.domain);
    until("and go on", 15, || columns(&running).iter().any(|age| *age < 1.0));
    assert!(columns(&running).iter().filter(|age| **age > 2.0).count() >= 4, "the same stream of pictures");
    drop(lathe);
    running.stop();
}

#[test]
fn a_second_service_on_the_same_state_is_refused_in_one_line() {
    let place = Place::new("two");
    let running = service(&place);
    let error = start(place.config("")).unwrap_err().to_string();
    assert!(error.contains("another service is running") && error.lines().count() == 1, "{error}");
    running.stop();
}

/// Limits are commissioned by somebody on some day: without it nothing acts, and each change is on record.
#[test]
fn settings_are_on_record_and_nothing_acts_without_commissioned_limits() {
    let place = Place::new("limits");
    let records = |running: &Running| {
        let rows = get(running, "/api/v1/audit").json();
        let of_settings = rows.as_array().unwrap().iter().filter(|r| r["action"] == "settings");
        of_settings.map(|r| r["detail"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    let running = service(&place);
    until("the first settings are on record", 5, || records(&running).len() == 1);
    assert!(records(&running)[0].contains("limits of the turret by the tests, 2026-11-21"));
    running.stop();
    let running = service(&place);
    assert_eq!(records(&running).len(), 1, "the same settings are no news");
    assert!(events(&running, "config_changed").is_empty());
    running.stop();
    let text =
        place.toml("").replace("the tests", "not commissioned") + "[turret]\nspeed_m_s = [1e-3, 1e-3]\n";
    // A table cannot follow keys with dots of its own name.
    let text: String =
        text.lines().filter(|l| !l.starts_with("turret.")).map(|l| l.to_owned() + "\n").collect();
    let path = place.folder.path().join("c.toml");
    let mut config = stillcut::config::service::service_config_from_text(&path, &text).unwrap();
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    until("the change is told", 5, || events(&running, "config_changed").len() == 1);
    until("and on record", 5, || records(&running).len() == 2);
    assert!(records(&running)[1].contains("not commissioned") && records(&running)[1].contains("0.001"));
    let refused = set_mode(&running, "act");
    assert_eq!((refused.status, refused.code().as_str()), (409, "not_ready"), "{refused:?}");
    assert!(refused.body.contains("turret.limits_by"), "{}", refused.body);
    assert_eq!(set_mode(&running, "advise").status, 200, "advice needs none");
    running.stop();
}

/// Acting needs evidence: what was observed in this life and in earlier ones, and what people said of alarms.
#[test]
fn acting_waits_for_what_commissioning_asks_for() {
    let place = Place::new("evidence");
    let begin = |accept: &str| {
        let text = place.toml("");
        let text: String =
            text.lines().filter(|l| !l.starts_with("turret.accept")).map(|l| l.to_owned() + "\n").collect();
        let path = place.folder.path().join("c.toml");
        let text = format!("turret.accept = [{accept}]\n{text}");
        let mut config = stillcut::config::service::service_config_from_text(&path, &text).unwrap();
        config.http.trust_loopback = true;
        start(config).unwrap()
    };
    let item = |running: &Running, name: &str| {
        let view = get(running, "/api/v1/commissioning").json();
        let found = view["items"].as_array().unwrap().iter().find(|i| i["name"] == name).cloned();
        found.unwrap_or_else(|| panic!("{name}: {view}"))
    };
    let running = begin("");
    let lathe = LatheThread::start(&place.domain);
    until("chatter", 20, || !events(&running, "chatter_onset").is_empty());
    let refused = set_mode(&running, "act");
    assert_eq!((refused.status, refused.code().as_str()), (409, "not_ready"), "{refused:?}");
    for name in ["hours_observed", "cuts_heard", "alarms_reviewed", "commands_advised", "model_drift"] {
        assert!(refused.body.contains(name), "{name}: {}", refused.body);
        assert_eq!(item(&running, name)["met"], false);
    }
    let alarm = events(&running, "chatter_onset")[0]["sequence"].clone();
    let address = running.handle().address().to_string();
    let path = format!("/api/v1/events/{alarm}/acknowledge");
    let judged = ask(&address, "POST", &path, &[], Some("{\"reason\":\"it rang\",\"right\":true}"));
    assert_eq!(judged.json()["judged_right"], true, "{judged:?}");
    assert_eq!(set_mode(&running, "advise").status, 200);
    until("it is counted", 25, || {
        item(&running, "alarms_reviewed")["found"] == "1 right, 0 false"
            && item(&running, "commands_advised")["met"] == true
            && item(&running, "cuts_heard")["found"] == "0" // it goes on
    });
    drop(lathe);
    running.stop();
    // The next life goes on from there; what is accepted by name may be missing.
    let running = begin(
        "\"hours_observed\", \"cuts_heard\", \"alarms_reviewed\", \"model_drift\", \"estimators_disagree\"",
    );
    until("the earlier life counts", 5, || item(&running, "commands_advised")["met"] == true);
    let view = get(&running, "/api/v1/commissioning").json();
    assert_eq!((&view["complete"], &view["limits_by"]), (&false.into(), &"the tests".into()), "{view}");
    assert_eq!(item(&running, "heard_now")["met"], false, "nothing is heard yet");
    let lathe = LatheThread::start(&place.domain);
    until("it is heard", 20, || item(&running, "heard_now")["met"] == true);
    assert_eq!(get(&running, "/api/v1/commissioning").json()["complete"], true);
    until("acting is possible", 20, || set_mode(&running, "act").status == 200);
    drop(lathe);
    running.stop();
}

#[test]
fn a_damaged_history_is_told_in_three_places() {
    let place = Place::new("damage");
    service(&place).stop();
    let path = place.state().join(stillcut::store::FILE_NAME);
    let log = place.state().join(format!("{}-wal", stillcut::store::FILE_NAME));
    assert!(!log.exists(), "an orderly end leaves no log behind");
    std::fs::write(&path, "this is no database".repeat(1000)).unwrap();
    let running = service(&place);
    assert_eq!(events(&running, "history_replaced").len(), 1);
    until("the picture says so", 3, || state(&running)["store"]["replaced"].is_string());
    let metrics = get(&running, "/metrics").body;
    assert!(metrics.contains("stillcut_events_total{kind=\"history_replaced\"} 1"));
    running.stop();
}

/// Damage under the running service is told as soon as somebody reads: health, metrics, one alarm.
#[test]
fn damage_that_readers_meet_is_told() {
    let place = Place::new("torn");
    service(&place).stop();
    let path = place.state().join(stillcut::store::FILE_NAME);
    let running = service(&place);
    std::fs::File::options().write(true).open(&path).unwrap().set_len(4096).unwrap();
    until("the alarm is told", 10, || {
        let _ = get(&running, "/api/v1/events?limit=1000");
        get(&running, "/metrics").body.contains("stillcut_events_total{kind=\"history_damaged\"} 1")
    });
    std::thread::sleep(Duration::from_millis(2500));
    let metrics = get(&running, "/metrics").body;
    assert!(metrics.contains("stillcut_events_total{kind=\"history_damaged\"} 1"), "told once");
    assert!(metrics.contains("stillcut_stage_up{stage=\"store\"} 0"));
    assert!(!metrics.contains("stillcut_store_errors_total{code=\"corrupt\"} 0"), "{metrics}");
    let ready = get(&running, "/readyz");
    assert!(ready.status == 503 && ready.body.contains("store"), "{ready:?}");
    running.stop();
    assert!(path.with_extension("sqlite.suspect").exists(), "the next start looks at every page");
    let running = service(&place);
    assert_eq!(events(&running, "history_replaced").len(), 1);
    running.stop();
}

#[test]
fn a_history_that_was_moved_away_is_told() {
    let place = Place::new("moved");
    let running = service(&place);
    until("the history is healthy", 5, || state(&running)["store"]["healthy"] == true);
    for suffix in ["", "-wal", "-shm"] {
        let path = place.state().join(format!("{}{suffix}", stillcut::store::FILE_NAME));
        std::fs::rename(&path, path.with_extension(format!("away{suffix}"))).unwrap();
    }
    until("readiness says so", 10, || {
        get(&running, "/readyz").body.contains("\"name\":\"store\",\"ok\":false")
    });
    until("the alarm is told", 5, || {
        get(&running, "/metrics").body.contains("stillcut_events_total{kind=\"history_damaged\"} 1")
    });
    running.stop();
}

#[test]
fn promtool_finds_nothing_to_complain_about() {
    let place = Place::new("prom");
    let running = service(&place);
    let answer = get(&running, "/metrics");
    assert_eq!(answer.kind, "text/plain; version=0.0.4; charset=utf-8");
    running.stop();
    let spawned = Command::new("promtool")
        .args(["check", "metrics"])
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn();
    let Ok(mut promtool) = spawned else {
        not_run("promtool is not installed");
        return;
    };
    use std::io::Write as _;
    promtool.stdin.take().unwrap().write_all(answer.body.as_bytes()).unwrap();
    let output = promtool.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// The real binary, ended with the test.
pub(crate) struct Process {
    pub(crate) child: Child,
    pub(crate) address: String,
}

impl Process {
    /// Starts `stillcut run`; answers once it says where it listens.
    pub(crate) fn start(place: &Place, http: &str) -> Self {
        Self::start_with(place, http, &[])
    }

    /// The same with more in its environment.
    pub(crate) fn start_with(place: &Place, http: &str, environment: &[(&str, &str)]) -> Self {
        Self::try_start(place, http, environment).unwrap_or_else(|said| panic!("{said}"))
    }

    /// The same; what it said last where it ended instead.
    pub(crate) fn try_start(place: &Place, http: &str, environment: &[(&str, &str)]) -> Result<Self, String> {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stillcut"));
        command.envs(environment.iter().copied());
        Self::try_run(command, place, http)
    }

    /// The same of a command that is the program as somebody starts it.
    pub(crate) fn try_run(mut command: Command, place: &Place, http: &str) -> Result<Self, String> {
        let config = place.folder.path().join("c.toml");
        std::fs::write(&config, place.toml(http) + "[log]\nformat = \"json\"\n").unwrap();
        command.arg("run").arg("--config").arg(&config).stderr(Stdio::piped()).stdout(Stdio::null());
        let mut child = command.spawn().unwrap();
        let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
        let address = loop {
            let Some(Ok(line)) = lines.next() else {
                let _ = child.wait();
                return Err("it ended without a word".to_owned());
            };
            let Ok(value) = serde_json::from_str::<serde_json::Value>(&line) else {
                let _ = child.wait();
                return Err(line); // the last line of a process that ends is for people
            };
            if value["event"] == "listening" {
                break value["address"].as_str().unwrap().to_owned();
            }
        };
        std::thread::spawn(move || lines.for_each(drop)); // keeps the pipe empty
        Ok(Self { child, address })
    }

    pub(crate) fn ask(&self, method: &str, path: &str, token: &str, body: Option<&str>) -> Answer {
        ask(&self.address, method, path, &[("Authorization", &format!("Bearer {token}"))], body)
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// kill -9 at varying moments after start: every acknowledged write is there afterwards, the history is
/// whole, and the service is back within two seconds.
#[test]
fn killed_again_and_again_nothing_acknowledged_is_lost() {
    let place = Place::new("kill");
    let [_, operator, _] = tokens(&place);
    let mut acknowledged = 0;
    let mut slowest = Duration::ZERO;
    for round in 0..12_u64 {
        let began = Instant::now();
        let mut process = Process::start(&place, "tokens = \"tokens.toml\"");
        slowest = slowest.max(began.elapsed());
        let rows = || {
            let mut count = 0;
            loop {
                let page =
                    process.ask("GET", &format!("/api/v1/audit?after={count}"), &operator, None).json();
                let page = page.as_array().unwrap();
                count += page.len();
                if page.is_empty() {
                    return count;
                }
            }
        };
        assert!(rows() >= acknowledged, "round {round}: acknowledged writes are there");
        let end = Instant::now() + Duration::from_millis(20 + 37 * round % 200);
        while Instant::now() < end {
            let answer =
                process.ask("POST", "/api/v1/events/1/acknowledge", &operator, Some("{\"reason\":\"test\"}"));
            assert_eq!(answer.status, 200, "{answer:?}");
            acknowledged += 1;
        }
        process.child.kill().unwrap();
        process.child.wait().unwrap();
    }
    assert!(acknowledged > 12);
    assert!(slowest < Duration::from_secs(4), "{slowest:?}"); // 2 s on an idle machine
    let history = place.state().join(stillcut::store::FILE_NAME);
    let output = Command::new(env!("CARGO_BIN_EXE_stillcut"))
        .args(["audit", "verify", "--history"])
        .arg(&history)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && said.starts_with("intact: "), "{said}");
    let rows: usize = said.split_whitespace().nth(1).unwrap().parse().unwrap();
    assert!(rows >= acknowledged && rows <= acknowledged + 12, "{rows} rows, {acknowledged} acknowledged");
}

fn send(signal: &str, child: &Child) {
    assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
}

#[test]
fn a_signal_ends_it_in_good_order() {
    let place = Place::new("term");
    for signal in ["-TERM", "-HUP"] {
        let mut process = Process::start(&place, "");
        let status = std::fs::read_to_string(format!("/proc/{}/status", process.child.id())).unwrap();
        let mask = status.lines().find_map(|line| line.strip_prefix("Umask:")).unwrap().trim();
        assert_eq!(u32::from_str_radix(mask, 8).unwrap() & 0o027, 0o027, "others can read what it writes");
        send(signal, &process.child);
        let began = Instant::now();
        let status = process.child.wait().unwrap();
        assert!(status.success(), "{signal}: {status}");
        assert!(began.elapsed() < Duration::from_secs(5));
    }
    let running = service(&place);
    assert_eq!(events(&running, "service_stop").len(), 2);
    running.stop();
}

/// The demonstration has a model: a diagnosis of what was just recorded runs, or says that its axes stand.
fn begin_diagnosis(address: &str) {
    let post = |path: &str, body: &str| ask(address, "POST", path, &[], Some(body));
    until("samples come", 20, || ask(address, "GET", "/readyz", &[], None).status == 200);
    let saved = post("/api/v1/recordings", "{\"reason\":\"test\"}");
    assert_eq!(saved.status, 202, "{saved:?}");
    let mut recordings = serde_json::Value::Null;
    until("the recording is stored", 20, || {
        recordings = ask(address, "GET", "/api/v1/recordings", &[], None).json();
        !recordings[0].is_null()
    });
    let body = format!("{{\"reason\":\"test\",\"recordings\":[{}]}}", recordings[0]["id"]);
    assert_eq!(post("/api/v1/diagnoses", &body).status, 202);
    let mut view = serde_json::Value::Null;
    until("the diagnosis runs or is refused", 20, || {
        view = ask(address, "GET", "/api/v1/diagnoses", &[], None).json();
        view[0]["step"].is_string() || view[0]["state"] == "done" || view[0]["state"] == "failed"
    });
    let stands = view[0]["error"].as_str().is_some_and(|e| {
        e.contains("axis x1, y1 stands still")
            || e.contains("long_rest") && e.contains("nothing is left to judge")
    });
    assert!(view[0]["state"] != "failed" || stands, "{view}");
}

#[test]
fn the_demonstration_leaves_nothing_behind() {
    for signal in ["-INT", "-HUP"] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stillcut"));
        let mut child = command.args(["demo"]).stdout(Stdio::piped()).spawn().unwrap();
        let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
        let page = lines.next().unwrap().unwrap();
        let folder = std::env::temp_dir().join(format!("stillcut-demo-{}", child.id()));
        let prefix = format!("demo{}_", child.id());
        let memory = || {
            let files = std::fs::read_dir("/dev/shm").into_iter().flatten().flatten();
            files.filter(|f| f.file_name().to_string_lossy().starts_with(&prefix)).count()
        };
        assert!(page.starts_with("page ") && folder.is_dir() && memory() > 0, "{page}");
        if signal == "-INT" {
            let address = page.split("http://").nth(1).unwrap().trim_end_matches('/');
            begin_diagnosis(address);
        }
        send(signal, &child);
        let said: Vec<String> = lines.map_while(Result::ok).collect();
        assert!(child.wait().unwrap().success() && said.iter().any(|l| l.starts_with("summary")), "{said:?}");
        assert!(!folder.exists() && memory() == 0, "{signal}: {}", folder.display());
    }
}

/// A person must go forward again: the unit does not start it for ever.
#[test]
fn a_newer_history_ends_with_status_two() {
    let place = Place::new("newer");
    service(&place).stop();
    let config = place.folder.path().join("c.toml");
    std::fs::write(&config, place.toml("")).unwrap();
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) \
         VALUES (99, 'later', 1, x'00', 0)";
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        use sqlx::Connection as _;
        let url = format!("sqlite://{}", place.state().join(stillcut::store::FILE_NAME).display());
        let mut history = sqlx::SqliteConnection::connect(&url).await.unwrap();
        sqlx::query(newer).execute(&mut history).await.unwrap();
        history.close().await.unwrap();
    });
    let (status, said) = run_once(&["run", "--config", config.to_str().unwrap()]);
    assert!(status == 2 && said.contains("schema 99 is newer"), "{said}");
}

/// A place that others can change is for a person to mend, too.
#[test]
fn a_place_that_others_can_change_ends_with_status_two() {
    use std::os::unix::fs::{PermissionsExt as _, symlink};
    let place = Place::new("open");
    let config = place.folder.path().join("c.toml");
    std::fs::write(&config, place.toml("")).unwrap();
    let said = |word: &str| {
        for options in [&["run", "--check", "--config"][..], &["run", "--config"]] {
            let (status, said) = run_once(&[options, &[config.to_str().unwrap()]].concat());
            assert!(status == 2 && said.contains(word) && said.lines().count() == 1, "{status}: {said}");
        }
    };
    let elsewhere = place.folder.path().join("elsewhere");
    std::fs::create_dir(&elsewhere).unwrap();
    symlink(&elsewhere, place.state()).unwrap();
    said("state: is a symbolic link");
    std::fs::remove_file(place.state()).unwrap();
    std::fs::create_dir(place.state()).unwrap();
    std::fs::set_permissions(place.state(), std::fs::Permissions::from_mode(0o777)).unwrap();
    said("state: mode 777 lets every user write");
}

/// The administrator checks for the user whose folder it is: what that one could not use is told.
#[test]
fn check_by_root_is_made_for_the_user_of_the_history() {
    use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, chown};
    let place = Place::new("whose");
    if std::fs::metadata(place.folder.path()).unwrap().uid() != 0 {
        not_run("only root can give files away");
        return;
    }
    let at = |name: &str| place.folder.path().join(name);
    let (config, tokens) = (at("c.toml"), at("tokens.toml"));
    std::fs::write(&config, place.toml("tokens = \"tokens.toml\"")).unwrap();
    let made = run_once(&["token", "--file", tokens.to_str().unwrap(), "--name", "anna", "--role", "viewer"]);
    assert_eq!(made, (0, String::new()));
    std::fs::create_dir(place.state()).unwrap();
    let checked = || run_once(&["run", "--check", "--config", config.to_str().unwrap()]);
    let said = |what: &str| {
        let (status, said) = checked();
        assert!(status == 2 && said.contains(what) && said.lines().count() == 1, "{status}: {said}");
    };
    chown(place.state(), Some(4321), None).unwrap();
    said("keeps the service's user (4321) out");
    chown(place.folder.path(), Some(4321), None).unwrap();
    said("tokens.toml: belongs to user 0, and the service's user (4321) cannot read it");
    chown(&tokens, Some(4321), None).unwrap();
    assert_eq!(checked(), (0, String::new()));
    let mode = |path: &std::path::Path, bits| {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(bits)).unwrap();
    };
    mode(&config, 0o640);
    said("c.toml of user 0 and mode 640 keeps the service's user (4321) out");
    mode(&config, 0o666);
    said("c.toml: mode 666 lets every user write");
    mode(&config, 0o644);
    let history = place.state().join(stillcut::store::FILE_NAME);
    std::fs::write(&history, "").unwrap();
    std::fs::set_permissions(&history, std::fs::Permissions::from_mode(0o640)).unwrap();
    chown(&history, Some(4322), None).unwrap();
    said("history.sqlite: belongs to user 4322, not to the service's (4321)");
    std::fs::remove_file(&history).unwrap();
    for name in ["history.reserve", "history.sqlite-wal", "service.lock"] {
        std::fs::create_dir(place.state().join(name)).unwrap();
        said(&format!("{name}: is no file"));
        std::fs::remove_dir(place.state().join(name)).unwrap();
    }
    // Shared memory: another user's file, also root's, keeps the service's user out.
    let segment = std::path::PathBuf::from(format!("/dev/shm/{}squatted", place.domain.prefix()));
    std::fs::write(&segment, "").unwrap();
    for (owner, whose) in [(4322, "belongs to user 4322"), (0, "belongs to user 0")] {
        chown(&segment, Some(owner), None).unwrap();
        said(&format!("{}: {whose}, and all of the domain must be of user 4321", segment.display()));
    }
    std::fs::remove_file(&segment).unwrap();
    assert_eq!(checked(), (0, String::new()));
}

fn run_once(arguments: &[&str]) -> (i32, String) {
    let mut child = Command::new(env!("CARGO_BIN_EXE_stillcut"))
        .args(arguments)
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    (child.wait().unwrap().code().unwrap(), said)
}

#[test]
fn bad_configurations_end_with_status_two_and_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.toml");
    for (text, expected) in [
        ("[http]\nlisten = \"0.0.0.0:80\"\n", "reachable from other machines"),
        (
            "[http]\ntokens = \"missing.toml\"\nlisten = \"127.0.0.1:0\"\n[history]\nfolder = \"state\"\n",
            "missing.toml",
        ),
        (
            "[transport]\nprefix = \"Bad Prefix\"\n[http]\nlisten = \"127.0.0.1:0\"\n[history]\nfolder = \"s2\"\n",
            "prefix",
        ),
        ("color = 1\n", "bad.toml:1:1: unknown field `color`"),
    ] {
        std::fs::write(&path, text).unwrap();
        let (status, said) = run_once(&["run", "--config", path.to_str().unwrap()]);
        let last = said.lines().last().unwrap_or_default();
        assert_eq!(status, 2, "{said}");
        assert!(last.contains(expected), "{said}");
    }
    let (status, said) = run_once(&["run", "--config", "/nowhere/c.toml"]);
    assert!(status == 2 && said.contains("/nowhere/c.toml"), "{said}");
}

/// What `--check` passes, a start does not refuse for what stands in files.
#[test]
fn check_opens_what_the_configuration_names() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("c.toml");
    let tls = "[http]\ncertificate = \"no.crt\"\nkey = \"no.key\"\n";
    for (text, expected) in [
        ("[http]\ntokens = \"none.toml\"\n", "http.tokens: "),
        (tls, "no.crt: No such file"),
        ("[transport]\nroot = \"here\"\n", "transport.root `here` is not an absolute path"),
        ("[transport]\nprefix = \"\"\n", "transport.prefix `` is not 1 to 24"),
        ("[machine]\nwatch = []\n", "machine.watch: []: expected"),
        ("[history]\nfolder = \"c.toml\"\n", "c.toml: not a directory"),
        ("[machine.axes.x1]\nidle = [\"nope.parquet\"]\n", "machine.axes.x1.idle: "),
    ] {
        std::fs::write(&path, text).unwrap();
        let (status, said) = run_once(&["run", "--check", "--config", path.to_str().unwrap()]);
        assert!(status == 2 && said.contains(expected) && said.lines().count() == 1, "{text}: {said}");
        assert!(said.contains("c.toml: "), "{said}");
    }
    std::fs::write(&path, [0xff, 0xfe, 0]).unwrap();
    let (status, said) = run_once(&["run", "--check", "--config", path.to_str().unwrap()]);
    assert!(status == 2 && said.contains("c.toml: not text; expected TOML in UTF-8"), "{said}");
}

/// What is wrong on a command line is told by the name that was given, with status 2.
#[test]
fn command_lines_that_cannot_work_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    std::fs::write(path("s.toml"), "").unwrap();
    std::fs::write(path("taken"), "").unwrap();
    std::fs::create_dir_all(path("state/history.sqlite")).unwrap();
    std::fs::write(path("c.toml"), "[history]\nfolder = \"state\"\n[http]\nlisten = \"127.0.0.1:0\"\n")
        .unwrap();
    let (scenario, out) = (path("s.toml"), path("r.parquet"));
    let (nowhere, taken) = (path("nowhere/r.parquet"), path("taken"));
    let tokens = path("nowhere/tokens.toml");
    let simulate = ["simulate", "--scenario", &scenario, "--out"];
    for (arguments, expected) in [
        (vec!["audit"], "such as `stillcut audit verify`"),
        (vec!["audit", "verify", "--head", "abc"], "--head `abc`: expected the 64 hexadecimal digits"),
        ([&simulate[..], &[&out, "--duration-s", "-1"]].concat(), "--duration-s -1: expected 0.001 to 86400"),
        ([&simulate[..], &[&out, "--seed", "-1"]].concat(), "invalid value '-1' for '--seed <SEED>'"),
        ([&simulate[..], &[&nowhere, "--duration-s", "0.1"]].concat(), "nowhere/r.parquet: No such file"),
        (vec!["replay", "--recording", &out, "--out", &taken], "taken: is a file; expected a folder"),
        (
            vec!["token", "--file", &tokens, "--name", "anna", "--role", "viewer"],
            "nowhere/tokens.toml: its folder is not there",
        ),
    ] {
        let (status, said) = run_once(&arguments);
        assert!(status == 2 && said.contains(expected) && said.lines().count() == 1, "{arguments:?}: {said}");
        assert!(!said.contains(".part"), "{said}");
    }
    let (status, said) = run_once(&["run", "--config", &path("c.toml")]);
    assert!(status == 2 && said.contains("history.sqlite: is no file"), "{said}");
}

#[test]
fn a_token_is_added_to_a_file_of_tokens_alone() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("tokens.toml");
    let make = |name: &str, days: &str| {
        let file = file.to_str().unwrap();
        run_once(&["token", "--file", file, "--name", name, "--role", "viewer", "--days", days])
    };
    for days in ["0", "3651", "99999999"] {
        let (status, said) = make("anna", days);
        assert!(status == 2 && said.contains("1..=3650") && said.lines().count() == 1, "{days}: {said}");
    }
    assert!(!file.exists(), "nothing was begun");
    assert_eq!(make("anna", "3650"), (0, String::new()));
    assert_eq!(make("ben", "1"), (0, String::new()));
    assert_eq!(stillcut::http::token_names(&file).unwrap(), ["anna", "ben"]);
    let (status, said) = make("anna", "1");
    assert!(status == 2 && said.contains("`anna` is there already"), "{said}");
    std::fs::write(&file, "junk").unwrap();
    let (status, said) = make("carl", "1");
    assert!(status == 2 && said.contains("tokens.toml: "), "{said}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "junk", "left as it was");
}

#[test]
fn every_example_configuration_is_good() {
    // Shared memory and folder of this test's own: those of the example belong to whoever runs on this machine.
    let place = Place::new("example");
    let prefix = format!("prefix = \"{}\"", place.domain.prefix().trim_end_matches('_'));
    let root = format!("root = \"{}\"", place.domain.root().display());
    for name in ["config/stillcut.toml", "deploy/container.toml"] {
        let mut text = std::fs::read_to_string(project(name)).unwrap();
        if text.contains("\n[transport]") {
            text = text.replace("prefix = \"stillcut\"", &prefix).replace("root = \"/run/stillcut\"", &root);
        } else {
            text.push_str(&format!("\n[transport]\n{prefix}\n{root}\n"));
        }
        assert!(text.contains(&prefix) && text.contains(&root), "{name} names domain and folder");
        let path = place.folder.path().join("example.toml");
        std::fs::write(&path, text).unwrap();
        let (status, said) = run_once(&["run", "--check", "--config", path.to_str().unwrap()]);
        assert_eq!((status, said.as_str()), (0, ""), "{name}");
    }
}
