//! kill -9 at named points: between a write and its sync, inside the checkpoint of the log, at every call of a
//! migration, between a recording and its event, while shared memory is made.
//!
//! The library of `io_faults` ends the process there (`IO_KILL`). Every run checks that it really was killed.

use crate::io_faults::shim;
use crate::running::{LatheThread, Place, ask, tokens, until};
use crate::service::Process;
use crate::store::older_history;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use stillcut::store::{AuditVerdict, FILE_NAME, verify_audit_file};

const TOKENS: &str = "tokens = \"tokens.toml\"";

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap()
}

fn environment<'a>(library: &'a Path, point: &'a str) -> [(&'a str, &'a str); 2] {
    [("LD_PRELOAD", library.to_str().unwrap()), ("IO_KILL", point)]
}

/// Whether a write was acknowledged; false when the service is gone.
fn write(address: &str, token: &str, path: &str) -> bool {
    let body = "{\"reason\":\"test\"}";
    let request = format!(
        "POST {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {token}\r\nConnection: close\r\n\
         Content-Type: application/json\r\nContent-Length: {}\r\n\r\n{body}",
        body.len()
    );
    let mut said = Vec::new();
    let Ok(mut stream) = TcpStream::connect(address) else { return false };
    let _ = stream.set_read_timeout(Some(Duration::from_secs(10)));
    let _ = stream.write_all(request.as_bytes());
    let _ = stream.read_to_end(&mut said); // an answer counts as far as it came
    said.starts_with(b"HTTP/1.1 200") || said.starts_with(b"HTTP/1.1 202")
}

/// How it ended, once it has: by kill -9, or in good order.
fn was_killed(process: &mut Process) -> bool {
    use std::os::unix::process::ExitStatusExt as _;
    process.child.wait().unwrap().signal() == Some(9)
}

fn is_dead(process: &mut Process) -> bool {
    process.child.try_wait().unwrap().is_some()
}

/// How long the starts after the kills took.
#[derive(Default)]
struct Returns(Vec<Duration>);

impl Returns {
    /// One that other work on the machine held up is no fault: the median counts.
    fn judge(mut self) {
        self.0.sort_unstable();
        let (median, slowest) = (self.0[self.0.len() / 2], self.0[self.0.len() - 1]);
        println!("back after {median:?}, slowest {slowest:?}");
        assert!(median < Duration::from_secs(2), "{median:?}");
    }
}

/// Starts it again without the library: the audit chain is whole, and the history.
fn again(place: &Place, point: &str, returns: &mut Returns) -> Process {
    let began = Instant::now();
    let process = Process::start(place, TOKENS);
    returns.0.push(began.elapsed());
    let verdict = runtime().block_on(verify_audit_file(&place.state().join(FILE_NAME), None)).unwrap();
    assert!(matches!(verdict, AuditVerdict::Intact { .. }), "{point}: {verdict:?}");
    let replaced =
        ask(&process.address, "GET", "/api/v1/state", &[], None).json()["store"]["replaced"].clone();
    assert!(replaced.is_null(), "{point}: the history is whole");
    process
}

fn audit_rows(process: &Process) -> usize {
    let mut count = 0;
    loop {
        let page = ask(&process.address, "GET", &format!("/api/v1/audit?after={count}"), &[], None).json();
        match page.as_array().unwrap().len() {
            0 => return count,
            more => count += more,
        }
    }
}

/// Around every kind of call with which a write reaches the history, and around those with which the log is taken
/// into the database at a stop: what was acknowledged is there.
#[test]
fn killed_between_a_write_and_its_answer_nothing_acknowledged_is_lost() {
    let outer = tempfile::tempdir().unwrap();
    let Some(library) = shim(outer.path()) else { return };
    let log = format!("/{FILE_NAME}-wal$");
    let database = format!("/{FILE_NAME}$");
    let mut returns = Returns::default();
    // The numbers are beyond the calls of a start, which writes the database's first pages, its head, and the room
    // that is taken ahead, by way of the log; after that the database is written in a checkpoint only.
    for (point, writes) in [
        (format!("write:{log}:before:720"), 500),
        (format!("write:{log}:after:721"), 500),
        (format!("sync:{log}:before:40"), 500),
        (format!("sync:{log}:after:40"), 500),
        (format!("write:{database}:before:280"), 20),
        (format!("write:{database}:after:282"), 20),
        (format!("sync:{database}:before:4"), 20),
        (format!("sync:{database}:after:4"), 20),
        (format!("cut:{log}:before:1"), 20),
    ] {
        let place = Place::new("point");
        let [_, operator, _] = tokens(&place);
        let mut process = Process::start_with(&place, TOKENS, &environment(&library, &point));
        let write = |p: &Process| write(&p.address, &operator, "/api/v1/events/1/acknowledge");
        let acknowledged = (0..writes).take_while(|_| write(&process)).count();
        let _ = Command::new("kill").arg(process.child.id().to_string()).status();
        assert!(was_killed(&mut process), "{point}: never reached");
        let process = again(&place, &point, &mut returns);
        let found = audit_rows(&process);
        println!("{point}: {acknowledged} acknowledged, {found} rows");
        assert!(acknowledged > 0 && found >= acknowledged, "{point}: {found} rows of {acknowledged}");
        assert!(write(&process), "{point}: it goes on");
    }
    returns.judge();
}

async fn events_in(path: &Path) -> i64 {
    use sqlx::{Connection as _, Row as _};
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(path);
    let mut connection = sqlx::SqliteConnection::connect_with(&options).await.unwrap();
    let count = sqlx::query("SELECT count(*) FROM event WHERE kind = 'chatter_onset'");
    let row = count.fetch_one(&mut connection).await.unwrap();
    connection.close().await.unwrap();
    row.get(0)
}

/// An upgrade that is killed at any of its calls is finished by the next start, and no half copy of the old
/// history is left under the name of a whole one.
#[test]
fn killed_in_a_migration_the_next_start_finishes_it() {
    let outer = tempfile::tempdir().unwrap();
    let Some(library) = shim(outer.path()) else { return };
    let most: usize = std::env::var("STILLCUT_POINTS").ok().and_then(|v| v.parse().ok()).unwrap_or(8);
    let (mut killed, mut at, mut returns) = (0, 1, Returns::default());
    while killed < most {
        let place = Place::new("migrate");
        let _ = tokens(&place);
        std::fs::create_dir_all(place.state()).unwrap();
        runtime().block_on(older_history(&place.state().join(FILE_NAME), 1));
        let point = format!("any:/state/:before:{at}");
        // Beyond its last call the start succeeds, and there is nothing more to try.
        if let Ok(mut process) = Process::try_start(&place, TOKENS, &environment(&library, &point)) {
            until(&point, 1, || is_dead(&mut process) || killed > 0);
            break;
        }
        killed += 1;
        at += if most > 8 { 1 } else { 9 };
        let process = again(&place, &point, &mut returns);
        let kept = ask(&process.address, "GET", "/api/v1/events?kind=chatter_onset", &[], None).json();
        assert_eq!(kept["events"].as_array().unwrap().len(), 3, "{point}");
        drop(process);
        let names = std::fs::read_dir(place.state()).unwrap().flatten().map(|e| e.path());
        let copies =
            names.filter(|p| p.file_name().unwrap().to_string_lossy().starts_with("history.before-"));
        for copy in copies {
            assert_eq!(runtime().block_on(events_in(&copy)), 3, "{point}: {}", copy.display());
        }
    }
    returns.judge();
    println!("an upgrade killed at {killed} of its calls");
    assert!(killed >= 5, "the fault can be injected: {killed}");
}

/// A recording is there whole or not at all, whatever of it was written.
#[test]
fn killed_while_a_recording_is_written_none_is_half() {
    let outer = tempfile::tempdir().unwrap();
    let Some(library) = shim(outer.path()) else { return };
    let mut returns = Returns::default();
    for (point, whole) in [
        ("write:.parquet.:before:2", 0),
        ("rename:.parquet$:before:1", 0),
        ("rename:.parquet$:after:1", 1), // between the file and its event
    ] {
        let place = Place::new("halfrec");
        let [_, operator, _] = tokens(&place);
        let mut process = Process::start_with(&place, TOKENS, &environment(&library, point));
        let lathe = LatheThread::start(&place.domain);
        let came = || ask(&process.address, "GET", "/readyz", &[], None).status == 200;
        until("samples come", 10, came);
        std::thread::sleep(Duration::from_millis(500));
        assert!(write(&process.address, &operator, "/api/v1/recordings"), "{point}");
        until(point, 20, || is_dead(&mut process));
        let process = again(&place, point, &mut returns);
        let list = ask(&process.address, "GET", "/api/v1/recordings", &[], None).json();
        let list = list.as_array().unwrap();
        assert_eq!(list.len(), whole, "{point}: {list:?}");
        for recording in list {
            let name = format!("recordings/{}.parquet", recording["id"].as_str().unwrap());
            let read = stillcut::recording::read_recording(&place.state().join(name)).unwrap();
            assert!(read.len() > 1000, "{point}");
        }
        drop(lathe);
    }
    returns.judge();
}

/// Shared memory that is half made does not keep the next service from starting, nor the samples from coming.
#[test]
fn killed_while_shared_memory_is_made_the_next_start_makes_it() {
    let outer = tempfile::tempdir().unwrap();
    let Some(library) = shim(outer.path()) else { return };
    let (mut killed, mut returns, mut found) = (0, Returns::default(), Returns::default());
    for (call, when, at) in [
        ("open", "after", 1),
        ("open", "after", 3),
        ("open", "after", 9),
        ("open", "before", 20),
        ("cut", "before", 1),
        ("cut", "after", 2),
        ("cut", "after", 5),
        ("write", "before", 1),
        ("write", "after", 2),
    ] {
        let place = Place::new("node");
        let _ = tokens(&place);
        let point = format!("{call}:{}:{when}:{at}", place.domain.prefix());
        match Process::try_start(&place, TOKENS, &environment(&library, &point)) {
            Ok(mut process) => killed += usize::from(is_dead(&mut process)),
            Err(_) => killed += 1,
        }
        let process = again(&place, &point, &mut returns);
        let lathe = LatheThread::start(&place.domain);
        let began = Instant::now();
        until("samples come", 10, || ask(&process.address, "GET", "/readyz", &[], None).status == 200);
        found.0.push(began.elapsed());
        drop(lathe);
    }
    returns.judge();
    found.judge();
    println!("killed at {killed} points while shared memory was made");
    assert!(killed >= 5, "the fault can be injected: {killed}");
}
