//! Faults injected into the running service: full disk, read-only disk, wall clock that jumps, floods and
//! slow clients, processes that are stopped. Each test checks that its fault really happened.

use crate::folders::not_run;
use crate::running::{Answer, LatheThread, Place, ask, get, service, tokens, until};
use crate::service::Process;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use stillcut::service::{Running, clock, start};

/// A small file system in memory, gone at the end. Nothing where mounting is not allowed.
pub(crate) struct SmallDisk(PathBuf);

impl SmallDisk {
    pub(crate) fn mount(folder: &Path, options: &str) -> Option<Self> {
        std::fs::create_dir_all(folder).unwrap();
        let mut command = Command::new("mount");
        // The root of a tmpfs is everybody's unless it is said.
        let options = format!("{options},mode=755");
        command.args(["-t", "tmpfs", "-o", &options, "tmpfs"]).arg(folder).stderr(Stdio::null());
        let mounted = command.status().is_ok_and(|s| s.success());
        mounted.then(|| Self(folder.to_owned()))
    }

    /// Leaves no byte free.
    pub(crate) fn fill(&self) -> PathBuf {
        let path = self.0.join("ballast");
        let mut file = std::fs::File::create(&path).unwrap();
        let piece = vec![1_u8; 4096];
        while file.write_all(&piece).is_ok() {}
        while file.write_all(&[1]).is_ok() {}
        path
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

fn metric(text: &str, series: &str) -> f64 {
    let line = text.lines().find(|l| l.starts_with(series) && l[series.len()..].starts_with(' '));
    line.and_then(|l| l.rsplit(' ').next()?.parse().ok()).unwrap_or_else(|| panic!("no series {series}"))
}

fn lost(address: &str) -> f64 {
    let text = ask(address, "GET", "/metrics", &[], None).body;
    ["x1", "y1", "x2", "y2"]
        .map(|a| metric(&text, &format!("stillcut_samples_lost_total{{axis=\"{a}\"}}")))
        .iter()
        .sum()
}

/// Writes until a full disk refuses: the history's log has some room of its own, which is used again and again.
/// Answers how many writes there were, the last of them not recorded.
pub(crate) fn exhaust(address: &str, headers: &[(&str, &str)]) -> usize {
    let body = format!("{{\"reason\":\"{}\"}}", "x".repeat(490));
    for count in 1..2000 {
        let taken = ask(address, "POST", "/api/v1/override", headers, Some(&body));
        assert_eq!(taken.status, 200, "done whatever the disk does: {taken:?}");
        if taken.json()["recorded"] == false {
            return count;
        }
    }
    panic!("the disk never refused");
}

/// Rows of the audit record for an action.
fn audited(address: &str, headers: &[(&str, &str)], action: &str) -> usize {
    let (mut count, mut after) = (0, 0);
    loop {
        let rows = ask(address, "GET", &format!("/api/v1/audit?after={after}"), headers, None).json();
        let rows = rows.as_array().unwrap();
        let Some(last) = rows.last() else { return count };
        after = last["sequence"].as_i64().unwrap();
        count += rows.iter().filter(|r| r["action"] == action).count();
    }
}

#[test]
fn a_full_disk_loses_no_event_and_no_sample_and_heals_by_itself() {
    let place = Place::new("full");
    let Some(disk) = SmallDisk::mount(&place.state(), "size=4m") else {
        not_run("mounting a small file system is not allowed here");
        return;
    };
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let address = running.handle().address().to_string();
    let lathe = LatheThread::start(&place.domain);
    until("samples come", 10, || get(&running, "/readyz").status == 200);
    let ballast = disk.fill();
    exhaust(&address, &[]);
    let set_mode = |mode: &str| {
        let etag = ask(&address, "GET", "/api/v1/mode", &[], None).etag;
        let body = format!("{{\"mode\":\"{mode}\",\"reason\":\"test\"}}");
        ask(&address, "PUT", "/api/v1/mode", &[("If-Match", &etag)], Some(&body)).status
    };
    // Going up needs a record and is refused; what happens by itself waits.
    assert_ne!(set_mode("advise"), 200, "no record, no way up");
    until("readiness says so", 15, || {
        let ready = get(&running, "/readyz");
        ready.status == 503 && ready.body.contains("store")
    });
    let text = get(&running, "/metrics").body;
    assert!(metric(&text, "stillcut_store_errors_total{code=\"full\"}") > 0.0, "the fault happened");
    let samples = metric(&text, "stillcut_samples_total{axis=\"x1\"}");
    // Events that arise now: a save that cannot be written, and its failure.
    let _ = ask(&address, "POST", "/api/v1/recordings", &[], Some("{\"reason\":\"full\"}"));
    std::thread::sleep(Duration::from_secs(4));
    let later = get(&running, "/metrics").body;
    assert!(metric(&later, "stillcut_samples_total{axis=\"x1\"}") > samples, "the pipeline goes on");
    assert!(metric(&later, "stillcut_events_unpersisted") > 0.0, "what waits is shown");
    std::fs::remove_file(ballast).unwrap();
    until("it heals", 15, || get(&running, "/readyz").status == 200);
    until("everything waiting is stored", 15, || {
        metric(&get(&running, "/metrics").body, "stillcut_events_unpersisted") == 0.0
    });
    let text = get(&running, "/metrics").body;
    assert_eq!(metric(&text, "stillcut_queue_dropped_total{intentional=\"false\",queue=\"store\"}"), 0.0);
    // Every event that was counted is in the history.
    let page = get(&running, "/api/v1/events?limit=1000").json();
    let counted: f64 = text
        .lines()
        .filter(|l| l.starts_with("stillcut_events_total{"))
        .filter_map(|l| l.rsplit(' ').next()?.parse::<f64>().ok())
        .sum();
    assert!(page["events"].as_array().unwrap().len() as f64 >= counted, "{counted} counted");
    assert!(lost(&address) == 0.0, "no sample is lost");
    drop(lathe);
    running.stop();
}

/// A service on a disk of 24 MB with so many recordings of so many bytes, oldest first; nothing, said aloud,
/// where no disk can be mounted.
fn with_recordings(place: &Place, count: u8, bytes: usize) -> Option<(SmallDisk, Running)> {
    let Some(disk) = SmallDisk::mount(&place.state(), "size=24m") else {
        not_run("mounting a small file system is not allowed here");
        return None;
    };
    let mut config = place.config("");
    config.http.trust_loopback = true;
    let running = start(config).unwrap();
    let recordings = place.state().join("recordings");
    for k in 0..count {
        std::fs::write(recordings.join(format!("manual-{k}.parquet")), vec![k; bytes]).unwrap();
        std::thread::sleep(Duration::from_millis(20));
    }
    Some((disk, running))
}

/// Recordings are worth less than the history: they go at the moment that the history meets the full disk.
#[test]
fn on_a_full_disk_recordings_go_before_a_single_acknowledgement_fails() {
    let place = Place::new("fullroom");
    let Some((disk, running)) = with_recordings(&place, 3, 2 << 20) else { return };
    let address = running.handle().address().to_string();
    let recordings = place.state().join("recordings");
    let _ballast = disk.fill();
    // As many as use up what was taken ahead.
    acknowledge(&address, 1200);
    let removed = |text: &str| metric(text, "stillcut_recordings_total{outcome=\"removed\"}");
    until("it is counted and told", 5, || {
        let told = get(&running, "/api/v1/events?kind=recordings_removed").json();
        removed(&get(&running, "/metrics").body) > 0.0 && !told["events"].as_array().unwrap().is_empty()
    });
    let text = get(&running, "/metrics").body;
    assert!(metric(&text, "stillcut_store_errors_total{code=\"full\"}") > 0.0, "the fault happened");
    assert!(!recordings.join("manual-0.parquet").exists(), "the oldest first");
    assert!(removed(&text) < 3.0, "no more than needed");
    running.stop();
}

fn acknowledge(address: &str, count: usize) {
    let reason = "x".repeat(450);
    for k in 0..count {
        let body = format!("{{\"reason\":\"{k} {reason}\"}}");
        let answer = ask(address, "POST", "/api/v1/events/1/acknowledge", &[], Some(&body));
        assert_eq!(answer.status, 200, "{k}: {answer:?}");
    }
}

/// A file that goes at the end of a test, however it ends.
struct RemovedAtEnd(PathBuf);

impl Drop for RemovedAtEnd {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// A program takes each byte of the disk as soon as it is free: the history goes on in the room that it took
/// ahead, and the recordings are not all given to that program at once.
#[test]
fn where_each_free_byte_is_taken_at_once_the_history_goes_on_in_its_own_room() {
    let place = Place::new("greedy");
    let Some((disk, running)) = with_recordings(&place, 8, 1 << 20) else { return };
    let address = running.handle().address().to_string();
    let recordings = place.state().join("recordings");
    let ballast = RemovedAtEnd(disk.fill());
    let mut file = std::fs::File::options().append(true).open(&ballast.0).unwrap();
    let full_bytes = file.metadata().unwrap().len();
    // Ends with the disk, whatever becomes of the test.
    let greedy = std::thread::spawn(move || {
        while file.metadata().is_ok_and(|m| m.nlink() > 0) {
            let _ = file.write(&[1; 4096]);
        }
    });
    acknowledge(&address, 1100);
    let left = std::fs::read_dir(&recordings).unwrap().count();
    assert!((3..8).contains(&left), "{left} recordings are left");
    acknowledge(&address, 400);
    let taken = std::fs::metadata(&ballast.0).unwrap().len() - full_bytes;
    assert!(taken > 0, "the fault happened: some of it was taken");
    drop(ballast);
    greedy.join().unwrap();
    running.stop();
}

/// The end comes while the disk is full: what waits is kept in room that was taken before, and is in the
/// history after the next start.
#[test]
fn a_stop_with_a_full_disk_keeps_what_waits_for_the_next_start() {
    let place = Place::new("fullstop");
    let Some(disk) = SmallDisk::mount(&place.state(), "size=4m") else {
        not_run("mounting a small file system is not allowed here");
        return;
    };
    let trusted = || {
        let mut config = place.config("");
        config.http.trust_loopback = true;
        start(config).unwrap()
    };
    let running = trusted();
    let address = running.handle().address().to_string();
    let ballast = disk.fill();
    let writes = exhaust(&address, &[]);
    until("what waits is shown", 5, || {
        metric(&get(&running, "/metrics").body, "stillcut_events_unpersisted") > 0.0
    });
    assert_eq!(running.stop(), 0, "nothing is lost");
    std::fs::remove_file(ballast).unwrap();
    let running = trusted();
    let found = |kind: &str| {
        let page = get(&running, &format!("/api/v1/events?kind={kind}&limit=1000")).json();
        page["events"].as_array().unwrap().len()
    };
    assert_eq!((found("override"), found("service_stop")), (writes, 1));
    let address = running.handle().address().to_string();
    assert_eq!(audited(&address, &[], "override"), writes, "the audit record too");
    running.stop();
}

/// The disk is full at a start after a crash: the service is ready all the same, hears the signal to end, and
/// keeps what was asked of it.
#[test]
fn a_start_with_a_full_disk_is_ready_and_ends_in_good_order() {
    let place = Place::new("fullstart");
    let Some(disk) = SmallDisk::mount(&place.state(), "size=6m") else {
        not_run("mounting a small file system is not allowed here");
        return;
    };
    let [_, operator, engineer] = tokens(&place);
    let begin = || Process::start(&place, "tokens = \"tokens.toml\"");
    let mut process = begin();
    process.child.kill().unwrap();
    process.child.wait().unwrap();
    let ballast = disk.fill();
    let began = Instant::now();
    let mut process = begin();
    assert!(began.elapsed() < Duration::from_secs(5), "{:?}", began.elapsed());
    let operators = format!("Bearer {operator}");
    let writes = exhaust(&process.address, &[("Authorization", &operators)]);
    let (etag, bearer) = ("\"1\"", format!("Bearer {engineer}"));
    let headers = [("If-Match", etag), ("Authorization", &bearer)];
    let body = Some("{\"mode\":\"advise\",\"reason\":\"test\"}");
    let raised = ask(&process.address, "PUT", "/api/v1/mode", &headers, body);
    assert_eq!(raised.status, 503, "without a record there is no way up: {raised:?}");
    let end = |process: &mut Process| {
        let signal = Command::new("kill").args(["-TERM", &process.child.id().to_string()]).status();
        assert!(signal.unwrap().success());
        assert_eq!(process.child.wait().unwrap().code(), Some(0), "in good order");
    };
    end(&mut process);
    std::fs::remove_file(ballast).unwrap();
    let mut process = begin();
    let page = process.ask("GET", "/api/v1/events?kind=override&limit=1000", &operator, None).json();
    assert_eq!(page["events"].as_array().unwrap().len(), writes);
    let count = |action: &str| audited(&process.address, &[("Authorization", &operators)], action);
    assert_eq!((count("override"), count("settings")), (writes, 1));
    end(&mut process);
}

#[test]
fn a_read_only_disk_is_one_line_and_status_two() {
    let place = Place::new("rofs");
    let Some(_disk) = SmallDisk::mount(&place.state(), "size=4m,ro") else {
        not_run("mounting a read-only file system is not allowed here");
        return;
    };
    let error = start(place.config("")).unwrap_err().to_string();
    assert!(error.contains("Read-only") && error.lines().count() == 1, "{error}");
}

/// The wall clock jumps ten years ahead and back while everything runs: it labels, it does not decide.
#[test]
fn a_wall_clock_that_jumps_ten_years_neither_stops_nor_prunes_anything() {
    let library = "/usr/lib/x86_64-linux-gnu/faketime/libfaketimeMT.so.1";
    if !Path::new(library).exists() {
        not_run("libfaketime is not installed");
        return;
    }
    let place = Place::new("clock");
    let [_, operator, _] = tokens(&place);
    let file = place.folder.path().join("tokens.toml");
    let tomorrow = clock::rfc3339(clock::wall_ns() + 86_400_000_000_000);
    let role = "role = \"operator\"\n";
    let text = std::fs::read_to_string(&file).unwrap();
    std::fs::write(&file, text.replace(role, &format!("{role}expires = \"{tomorrow}\"\n"))).unwrap();
    let offset = place.folder.path().join("offset");
    std::fs::write(&offset, "+0").unwrap();
    let environment = [
        ("LD_PRELOAD", library),
        ("FAKETIME_TIMESTAMP_FILE", offset.to_str().unwrap()),
        ("FAKETIME_NO_CACHE", "1"),
        ("FAKETIME_DONT_FAKE_MONOTONIC", "1"),
        ("FAKETIME_DONT_RESET", "1"),
        // Files keep their true times: what was recorded before a jump looks ten years old after it.
        ("NO_FAKE_STAT", "1"),
    ];
    let process = Process::start_with(&place, "tokens = \"tokens.toml\"", &environment);
    let lathe = LatheThread::start(&place.domain);
    let state = || ask(&process.address, "GET", "/api/v1/state", &[], None).json();
    until("samples come", 10, || state()["source"]["connected"] == true);
    let year = |s: &serde_json::Value| s["time"].as_str().unwrap()[..4].parse::<i32>().unwrap();
    let this_year = year(&state());
    let events = |kind: &str| {
        let path = format!("/api/v1/events?limit=1000&kind={kind}");
        ask(&process.address, "GET", &path, &[], None).json()["events"].as_array().unwrap().len()
    };
    until("what came is stored", 10, || events("source_found") == 1);
    let before = events("service_start") + events("source_found");
    let recordings =
        || ask(&process.address, "GET", "/api/v1/recordings", &[], None).json().as_array().unwrap().len();
    until("the onset is recorded", 30, || recordings() > 0);
    for jump in ["+10y", "-10y", "+1h", "+0"] {
        std::fs::write(&offset, jump).unwrap();
        if jump.ends_with('y') {
            until("the jump is seen", 5, || (year(&state()) - this_year).abs() >= 9);
            let saved = recordings();
            let asked = process.ask("POST", "/api/v1/recordings", &operator, Some("{\"reason\":\"test\"}"));
            assert!(asked.status < 300, "{jump}: {asked:?}");
            until("it is saved and the others stay", 20, || recordings() > saved);
        }
        let asked =
            process.ask("POST", "/api/v1/events/1/acknowledge", &operator, Some("{\"reason\":\"test\"}"));
        assert_eq!(asked.status, 200, "{jump}: {asked:?}");
        let taken = process.ask("POST", "/api/v1/override", &operator, Some("{\"reason\":\"test\"}"));
        assert_eq!(taken.status, 200, "{jump}: {taken:?}");
        std::thread::sleep(Duration::from_millis(1500));
        assert_eq!(state()["source"]["connected"], true, "{jump}");
    }
    assert_eq!(lost(&process.address), 0.0, "no sample is lost");
    assert_eq!(events("source_lost"), 0, "the silence is measured on the monotonic clock");
    assert_eq!(events("override"), 4);
    assert!(events("clock_step") >= 3, "the steps are told");
    assert_eq!(events("service_start") + events("source_found"), before, "nothing was pruned");
    // Order is by sequence, whatever the labels say.
    let page = ask(&process.address, "GET", "/api/v1/events?limit=1000", &[], None).json();
    let order: Vec<i64> =
        page["events"].as_array().unwrap().iter().map(|e| e["sequence"].as_i64().unwrap()).collect();
    assert!(order.windows(2).all(|w| w[0] > w[1]));
    drop(lathe);
}

fn rss_bytes(process: u32) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/statm")).unwrap();
    text.split(' ').nth(1).unwrap().parse::<f64>().unwrap() * 4096.0
}

/// Requests without end, broken and slow ones among them: the pipeline loses nothing, health answers, memory
/// stays, slow clients are cut off.
#[test]
fn a_flood_of_requests_costs_the_pipeline_nothing() {
    let place = Place::new("flood");
    let process = Process::start(&place, "");
    let lathe = LatheThread::start(&place.domain);
    until("samples come", 10, || {
        ask(&process.address, "GET", "/api/v1/state", &[], None).json()["source"]["connected"] == true
    });
    let memory = rss_bytes(process.child.id());
    let stop = Arc::new(AtomicBool::new(false));
    let answered = Arc::new(AtomicUsize::new(0));
    let threads: Vec<_> = (0..3)
        .map(|kind| {
            let (stop, answered, address) =
                (Arc::clone(&stop), Arc::clone(&answered), process.address.clone());
            std::thread::spawn(move || {
                while !stop.load(Ordering::Relaxed) {
                    answered.fetch_add(pipelined(&address, kind), Ordering::Relaxed);
                }
            })
        })
        .collect();
    // Clients that send half a head and wait.
    let mut slow: Vec<TcpStream> = (0..60)
        .filter_map(|_| {
            let mut stream = TcpStream::connect(&process.address).ok()?;
            stream.write_all(b"GET /api/v1/state HTTP/1.1\r\nHost: loc").ok()?;
            Some(stream)
        })
        .collect();
    assert!(slow.len() > 30);
    let mut slowest = Duration::ZERO;
    let until_s = Instant::now() + Duration::from_secs(8);
    while Instant::now() < until_s {
        let began = Instant::now();
        assert_eq!(ask(&process.address, "GET", "/healthz", &[], None).status, 200);
        slowest = slowest.max(began.elapsed());
        std::thread::sleep(Duration::from_millis(100));
    }
    stop.store(true, Ordering::Relaxed);
    threads.into_iter().for_each(|t| t.join().unwrap());
    let answered = answered.load(Ordering::Relaxed);
    println!("{answered} requests answered in 8 s, /healthz within {slowest:?}");
    assert!(answered > 2000, "{answered}");
    assert_eq!(lost(&process.address), 0.0, "no sample is lost");
    assert!(slowest < Duration::from_secs(2), "{slowest:?}"); // 0.1 s on an idle machine
    let grown = rss_bytes(process.child.id()) - memory;
    assert!(grown < 50e6, "{grown} bytes more");
    // The half-open ones are cut off by now.
    let cut = |s: &mut TcpStream| {
        s.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
        !matches!(s.read(&mut [0; 64]), Err(e) if e.kind() == std::io::ErrorKind::WouldBlock)
    };
    let held = slow.len();
    assert_eq!(
        slow.iter_mut().map(cut).filter(|gone| *gone).count(),
        held,
        "half a head is not held for longer than five seconds"
    );
    drop(lathe);
}

/// Many requests over one connection; answers how many came back.
fn pipelined(address: &str, kind: usize) -> usize {
    let Ok(mut stream) = TcpStream::connect(address) else { return 0 };
    stream.set_read_timeout(Some(Duration::from_millis(500))).unwrap();
    let request = match kind {
        0 => "GET /api/v1/state HTTP/1.1\r\nHost: localhost\r\n\r\n".to_owned(),
        1 => "GET /api/v1/events?limit=1000 HTTP/1.1\r\nHost: localhost\r\n\r\n".to_owned(),
        _ => "PUT /api/v1/mode HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n{\"mode\":[".to_owned(),
    };
    let many = request.repeat(40);
    if stream.write_all(many.as_bytes()).is_err() {
        return 0;
    }
    let (mut count, mut buffer) = (0, vec![0_u8; 65_536]);
    while count < 40 {
        let Ok(read) = stream.read(&mut buffer) else { break };
        if read == 0 {
            break;
        }
        count += String::from_utf8_lossy(&buffer[..read]).matches("HTTP/1.1 ").count();
    }
    count
}

#[test]
fn bodies_that_are_too_large_too_slow_or_no_json_are_refused() {
    let place = Place::new("body");
    let running = service(&place);
    let address = running.handle().address().to_string();
    let large = format!("{{\"reason\":\"{}\"}}", "a".repeat(10_000_000));
    let mut stream = TcpStream::connect(&address).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
    let head = format!(
        "POST /api/v1/override HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
        large.len()
    );
    stream.write_all(head.as_bytes()).unwrap();
    let _ = stream.write_all(large.as_bytes()); // the other side may hang up in the middle
    let mut said = String::new();
    let _ = stream.read_to_string(&mut said);
    assert!(said.starts_with("HTTP/1.1 413") || said.starts_with("HTTP/1.1 401"), "{said:.200}");
    for body in ["", "{", "[]", "{\"reason\": \"\\ud800\"}", "\u{0}", &"[".repeat(60_000)] {
        let answer = ask(&address, "POST", "/api/v1/override", &[], Some(body));
        assert!((400..500).contains(&answer.status), "{body:.20}: {answer:?}");
        assert_eq!(answer.kind, "application/problem+json", "{body:.20}");
    }
    // One byte a second: cut off.
    let began = Instant::now();
    let mut slow = TcpStream::connect(&address).unwrap();
    slow.set_read_timeout(Some(Duration::from_millis(1000))).unwrap();
    let ended = "GET / HTTP/1.1\r\nX-Slow: ".bytes().cycle().take(20).any(|byte| {
        let gone = slow.write_all(&[byte]).is_err();
        gone || matches!(slow.read(&mut [0; 512]), Ok(0) | Ok(1..))
    });
    assert!(ended && began.elapsed() < Duration::from_secs(9), "{:?}", began.elapsed());
    running.stop();
}

/// What is refused before a route is looked for is a problem too.
#[test]
fn a_head_that_cannot_be_read_is_a_problem() {
    let place = Place::new("head");
    let running = service(&place);
    let address = running.handle().address().to_string();
    let many = format!("GET / HTTP/1.1\r\nHost: localhost\r\n{}\r\n", "X-A: b\r\n".repeat(80));
    let large = format!("GET / HTTP/1.1\r\nHost: localhost\r\nX-A: {}\r\n\r\n", "b".repeat(40_000));
    let long = format!("GET /{} HTTP/1.1\r\nHost: localhost\r\n\r\n", "a".repeat(70_000));
    let good = "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n";
    let cases = [
        ("nonsense\r\n\r\n".to_owned(), vec![(400, "malformed_request")]),
        ("GET / HTTP/9.9\r\n\r\n".to_owned(), vec![(400, "malformed_request")]),
        ("GET / HTTP/1.1\r\nHost localhost\r\n\r\n".to_owned(), vec![(400, "malformed_request")]),
        (many, vec![(431, "head_too_large")]),
        (large, vec![(431, "head_too_large")]),
        (long, vec![(414, "uri_too_long"), (431, "head_too_large")]),
        (format!("{good}nonsense\r\n\r\n"), vec![(400, "malformed_request")]),
    ];
    for (request, expected) in cases {
        let mut stream = TcpStream::connect(&address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        let asked = &request[..request.len().min(60)];
        let _ = stream.write_all(request.as_bytes()); // may be refused before it has gone whole
        let (mut said, mut piece) = (Vec::new(), [0; 4096]);
        while let Ok(count @ 1..) = stream.read(&mut piece) {
            said.extend_from_slice(&piece[..count]);
        }
        let said = String::from_utf8_lossy(&said);
        let last = said.rfind("HTTP/1.1 ").map_or("", |at| &said[at..]);
        let (head, body) = last.split_once("\r\n\r\n").unwrap_or_else(|| panic!("{asked}: {said}"));
        assert!(head.contains("content-type: application/problem+json"), "{asked}: {head}");
        let body: serde_json::Value =
            serde_json::from_str(body).unwrap_or_else(|e| panic!("{asked}: {e}: {body}"));
        let found = (body["status"].as_u64().unwrap(), body["code"].as_str().unwrap());
        assert!(expected.contains(&found), "{asked}: {found:?}");
    }
    running.stop();
}

/// Clients that ask for much and take nothing hold every place: for five seconds, not for ever.
#[test]
fn clients_that_never_read_do_not_lock_others_out() {
    let place = Place::new("noread");
    let running = service(&place);
    let address = running.handle().address().to_string();
    let request = "GET /api/v1/config HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(2000);
    let deaf: Vec<TcpStream> = (0..256)
        .filter_map(|_| {
            let mut stream = TcpStream::connect(&address).ok()?;
            stream.set_nonblocking(true).ok()?;
            while stream.write(request.as_bytes()).is_ok() {}
            Some(stream)
        })
        .collect();
    assert_eq!(deaf.len(), 256);
    let began = Instant::now();
    let answers = || {
        let mut stream = TcpStream::connect(&address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(1))).unwrap();
        let mut said = [0; 12];
        let asked = stream.write_all(b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n");
        asked.is_ok() && stream.read_exact(&mut said).is_ok() && said.ends_with(b"200")
    };
    until("health answers", 10, answers);
    println!("/healthz answers {:?} after 256 clients fell silent", began.elapsed());
    drop(deaf);
    running.stop();
}

struct Stopped(Child);

impl Drop for Stopped {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn signal(word: &str, process: u32) {
    assert!(Command::new("kill").args([word, &process.to_string()]).status().unwrap().success());
}

/// A service that is stopped while acting: the command expires at the machine, the turret goes back by itself,
/// and the service that goes on does not go on acting.
#[test]
fn a_service_stopped_in_act_leaves_the_turret_at_equal_pitch_and_wakes_in_observe() {
    let place = Place::new("stop");
    let [_, _, engineer] = tokens(&place);
    let process = Process::start(&place, "tokens = \"tokens.toml\"");
    let lathe = LatheThread::start(&place.domain);
    let state = || ask(&process.address, "GET", "/api/v1/state", &[], None).json();
    let reported = || state()["pitch"]["reported_rad"].as_f64().unwrap_or(0.0);
    until("chatter is heard", 30, || state()["chatter"]["state"] == "chatter");
    let up = || -> Answer {
        let etag = ask(&process.address, "GET", "/api/v1/mode", &[], None).etag;
        let authorization = format!("Bearer {engineer}");
        let headers = [("If-Match", etag.as_str()), ("Authorization", authorization.as_str())];
        ask(&process.address, "PUT", "/api/v1/mode", &headers, Some("{\"mode\":\"act\",\"reason\":\"test\"}"))
    };
    until("interlocks are heard", 5, || up().status == 200);
    until("the turret stands apart", 15, || reported() > 0.06);
    signal("-STOP", process.child.id());
    std::thread::sleep(Duration::from_secs(5));
    signal("-CONT", process.child.id());
    until("it answers again", 5, || state()["mode"] == "observe");
    assert!(state()["mode_reason"].as_str().unwrap().contains("stood still"), "{}", state()["mode_reason"]);
    until("equal pitch", 3, || reported().abs() < 1e-3);
    until("samples flow again", 2, || state()["source"]["connected"] == true);
    assert!(lost(&process.address) > 10_000.0, "the samples of the pause are counted as lost");
    assert_eq!(state()["mode"], "observe", "acting does not resume");
    drop(lathe);
}

/// The machine's process is stopped and goes on, is killed and replaced; the service is killed and replaced:
/// in any order samples flow again within two seconds.
#[test]
fn loss_and_return_of_either_side_in_any_order() {
    let place = Place::new("order");
    let lathe = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_stillcut"));
        command.args([
            "lathe",
            "--entry-s",
            "1000",
            "--prefix",
            place.domain.prefix().trim_end_matches('_'),
            "--root",
        ]);
        command.arg(place.domain.root()).stdout(Stdio::null()).stderr(Stdio::null());
        Stopped(command.spawn().unwrap())
    };
    let mut process = Process::start(&place, "");
    let mut machine = lathe();
    let connected = |p: &Process| {
        ask(&p.address, "GET", "/api/v1/state", &[], None).json()["source"]["connected"] == true
    };
    // `connected` holds for a second after the last sample: what counts is that samples were found anew.
    let found = |p: &Process| {
        let page = ask(&p.address, "GET", "/api/v1/events?kind=source_found&limit=1000", &[], None).json();
        page["events"].as_array().unwrap().len()
    };
    until("samples come", 10, || connected(&process) && found(&process) > 0);
    let mut slowest = Duration::ZERO;
    for fault in
        ["stop lathe", "kill lathe", "kill service", "kill both", "lathe first", "stop lathe", "kill service"]
    {
        let before = found(&process);
        match fault {
            "stop lathe" => {
                signal("-STOP", machine.0.id());
                until("the silence is told within 1.5 s", 3, || !connected(&process));
                signal("-CONT", machine.0.id());
            }
            "kill lathe" => {
                let _ = machine.0.kill();
                let _ = machine.0.wait();
                machine = lathe();
            }
            "kill service" => {
                process.child.kill().unwrap();
                process.child.wait().unwrap();
                process = Process::start(&place, "");
            }
            "kill both" => {
                process.child.kill().unwrap();
                process.child.wait().unwrap();
                let _ = machine.0.kill();
                let _ = machine.0.wait();
                process = Process::start(&place, "");
                machine = lathe();
            }
            _ => {
                process.child.kill().unwrap();
                process.child.wait().unwrap();
                let _ = machine.0.kill();
                let _ = machine.0.wait();
                machine = lathe();
                std::thread::sleep(Duration::from_millis(300));
                process = Process::start(&place, "");
            }
        }
        let began = Instant::now();
        until(fault, 10, || connected(&process) && found(&process) > before);
        slowest = slowest.max(began.elapsed());
        println!("{fault}: samples after {:?}", began.elapsed());
    }
    assert!(slowest < Duration::from_secs(2), "{slowest:?}");
}
