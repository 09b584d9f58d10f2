//! Power loss, slow disks and calls that fail, at the border between the history file and the system.
//!
//! A small library (tests/shim/io_faults.c) is preloaded into the real binary and records, delays or refuses the
//! writes and syncs of the history file. Skipped where there is no C compiler.

use crate::folders::not_run;
use crate::running::{LatheThread, Place, ask, tokens, until};
use crate::service::Process;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use sqlx::{Connection as _, Row as _};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};
use stillcut::store::{AuditVerdict, FILE_NAME, Retention, StoreWriter, verify_audit_file};
use stillcut::telemetry::Metrics;

/// The library, compiled. Nothing where there is no compiler.
pub(crate) fn shim(folder: &Path) -> Option<PathBuf> {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/shim/io_faults.c");
    let library = folder.join("io_faults.so");
    let mut command = Command::new("cc");
    command.args(["-shared", "-fPIC", "-O2", "-o"]).arg(&library).arg(source).arg("-ldl");
    let made = command.stderr(Stdio::null()).status().is_ok_and(|s| s.success());
    if !made {
        not_run("no C compiler is installed");
    }
    made.then_some(library)
}

fn acknowledge(process: &Process, token: &str) -> bool {
    let body = Some("{\"reason\":\"test\"}");
    process.ask("POST", "/api/v1/events/1/acknowledge", token, body).status == 200
}

fn metric(process: &Process, series: &str) -> f64 {
    let text = ask(&process.address, "GET", "/metrics", &[], None).body;
    let lines = text.lines().filter(|l| l.starts_with(series));
    lines.filter_map(|l| l.rsplit(' ').next()?.parse::<f64>().ok()).sum()
}

/// One call of the service on the history file or its log.
#[derive(Debug)]
enum Call {
    Write { place: usize, data: Vec<u8> },
    Sync,
    Cut { length: usize },
}

/// The calls with their file and where their record ends.
fn calls(log: &[u8]) -> Vec<(usize, usize, Call)> {
    let (mut at, mut found) = (0, Vec::new());
    let word = |at: usize| u64::from_le_bytes(log[at..at + 8].try_into().unwrap());
    while at + 24 <= log.len() {
        let kinds = word(at);
        let (operation, file) = (kinds & 0xffff_ffff, (kinds >> 32) as usize);
        let (place, length) = (word(at + 8) as usize, word(at + 16) as usize);
        at += 24;
        let call = match operation {
            1 => {
                let data = log[at..at + length].to_vec();
                at += length;
                Call::Write { place, data }
            }
            2 => Call::Sync,
            _ => Call::Cut { length: place },
        };
        found.push((file, at, call));
    }
    found
}

fn put(file: &mut Vec<u8>, place: usize, data: &[u8]) {
    file.resize(file.len().max(place + data.len()), 0);
    file[place..place + data.len()].copy_from_slice(data);
}

/// What a disk may hold when the power goes after `count` calls: everything up to each file's last sync, and of what
/// came later any part, the last write perhaps torn.
fn after_power_loss(calls: &[(usize, usize, Call)], count: usize, random: &mut ChaCha8Rng) -> [Vec<u8>; 2] {
    let mut files = [Vec::new(), Vec::new()];
    let mut durable = [0, 0];
    for (k, (file, _, call)) in calls[..count].iter().enumerate() {
        if matches!(call, Call::Sync) {
            durable[*file] = k;
        }
    }
    let keep_most = random.random::<u64>() % 3;
    for (k, (file, _, call)) in calls[..count].iter().enumerate() {
        let certain = k <= durable[*file];
        let lost = match keep_most {
            0 => random.random::<u64>() % 2 == 0,
            1 => random.random::<u64>() % 8 == 0,
            _ => true,
        };
        if !certain && lost {
            continue;
        }
        match call {
            Call::Write { place, data } => {
                let torn = !certain && random.random::<u64>() % 4 == 0;
                let length = if torn { data.len() / 512 / 2 * 512 } else { data.len() };
                put(&mut files[*file], *place, &data[..length]);
            }
            Call::Cut { length } => files[*file].resize(*length, 0),
            Call::Sync => {}
        }
    }
    files
}

async fn audit_rows(path: &Path) -> i64 {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(path);
    let mut connection = sqlx::SqliteConnection::connect_with(&options).await.unwrap();
    let row = sqlx::query("SELECT count(*) FROM audit").fetch_one(&mut connection).await.unwrap();
    connection.close().await.unwrap();
    row.get(0)
}

/// The disk after a power loss at any moment: what was acknowledged is there, the history opens without help.
#[test]
fn power_loss_at_any_moment_loses_nothing_acknowledged() {
    let place = Place::new("power");
    let Some(library) = shim(place.folder.path()) else { return };
    let [_, operator, _] = tokens(&place);
    let log = place.folder.path().join("io.log");
    let environment = [("LD_PRELOAD", library.to_str().unwrap()), ("IO_LOG", log.to_str().unwrap())];
    let process = Process::start_with(&place, "tokens = \"tokens.toml\"", &environment);
    // Enough for the log to be taken into the database several times.
    let mut acknowledged: Vec<usize> = Vec::new();
    let began = Instant::now();
    let enough = |count: usize| count >= 600 || count >= 60 && began.elapsed() > Duration::from_secs(30);
    while !enough(acknowledged.len()) {
        assert!(acknowledge(&process, &operator));
        acknowledged.push(usize::try_from(std::fs::metadata(&log).unwrap().len()).unwrap());
    }
    drop(process);
    let calls = calls(&std::fs::read(&log).unwrap());
    let synced = calls.iter().filter(|c| matches!(c.2, Call::Sync)).count();
    assert!(
        synced > acknowledged.len() / 2 && acknowledged.len() > 50,
        "the fault can be injected: {synced}"
    );
    let states: usize = std::env::var("STILLCUT_STATES").ok().and_then(|v| v.parse().ok()).unwrap_or(200);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let first = calls.iter().position(|c| c.1 >= acknowledged[0]).unwrap();
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let mut cut_off = 0;
    for state in 0..states {
        let count = first + random.random::<u64>() as usize % (calls.len() - first);
        let files = after_power_loss(&calls, count, &mut random);
        let folder = tempfile::tempdir_in("/dev/shm").or_else(|_| tempfile::tempdir()).unwrap();
        let path = folder.path().join(FILE_NAME);
        std::fs::write(&path, &files[0]).unwrap();
        std::fs::write(folder.path().join("history.sqlite-wal"), &files[1]).unwrap();
        let wanted = acknowledged.iter().filter(|end| **end <= calls[count.max(1) - 1].1).count();
        let (rows, report, verdict) = runtime.block_on(async {
            let keep =
                Retention { max_age_ns: i64::MAX, max_bytes: u64::MAX, audit_rows: u64::MAX, outbox: false };
            let metrics = Arc::new(Metrics::new(&[], 0.0).unwrap());
            let (writer, reader, report) = StoreWriter::start(folder.path(), keep, metrics, 1).await.unwrap();
            reader.close().await;
            writer.close().await.unwrap();
            (audit_rows(&path).await, report, verify_audit_file(&path, None).await.unwrap())
        });
        assert_eq!(report.damage, None, "state {state}: it opens without help");
        assert!(matches!(verdict, AuditVerdict::Intact { .. }), "state {state}: {verdict:?}");
        assert!(rows >= wanted as i64, "state {state}: {rows} rows of {wanted} acknowledged");
        cut_off += usize::from(rows < acknowledged.len() as i64);
    }
    println!(
        "{states} states of the disk, {} acknowledged writes, {cut_off} states before the last",
        acknowledged.len()
    );
    assert!(cut_off > states / 4, "the losses were real");
}

/// A disk that takes half a second for a sync: the pipeline does not notice, nothing is lost.
#[test]
fn a_slow_disk_is_not_the_pipelines_affair() {
    let place = Place::new("slow");
    let Some(library) = shim(place.folder.path()) else { return };
    let [_, operator, _] = tokens(&place);
    let environment = [("LD_PRELOAD", library.to_str().unwrap()), ("IO_DELAY_MS", "500")];
    let process = Process::start_with(&place, "tokens = \"tokens.toml\"", &environment);
    let lathe = LatheThread::start(&place.domain);
    until("samples come", 10, || metric(&process, "stillcut_samples_total{axis=\"x1\"}") > 9000.0);
    let lost = || metric(&process, "stillcut_samples_lost_total");
    let lost_before = lost();
    let began = Instant::now();
    assert!((0..4).all(|_| acknowledge(&process, &operator)));
    assert!(began.elapsed() > Duration::from_millis(1500), "the fault happened: {:?}", began.elapsed());
    assert_eq!(lost(), lost_before, "the pipeline loses nothing meanwhile");
    assert_eq!(metric(&process, "stillcut_queue_dropped_total"), 0.0);
    drop(lathe);
}

/// How many calls a start makes until it listens.
fn calls_of_a_start(library: &Path) -> usize {
    let place = Place::new("count");
    let log = place.folder.path().join("io.log");
    let environment = [("LD_PRELOAD", library.to_str().unwrap()), ("IO_LOG", log.to_str().unwrap())];
    let _process = Process::start_with(&place, "", &environment);
    calls(&std::fs::read(&log).unwrap()).len()
}

/// Any call on the history file fails once: what was acknowledged is there, the service goes on, nothing panics.
#[test]
fn any_call_on_the_history_may_fail_once() {
    let outer = tempfile::tempdir().unwrap();
    let Some(library) = shim(outer.path()) else { return };
    let most: usize = std::env::var("STILLCUT_CALLS").ok().and_then(|v| v.parse().ok()).unwrap_or(6);
    let (mut started, mut refused) = (0, 0);
    let of_the_start = calls_of_a_start(&library);
    for k in 0..most {
        // Half of the start's calls, half of the running service's.
        let at = if k < most / 2 { 1 + k * of_the_start / (most / 2) } else { of_the_start + 3 * k };
        for error in ["5", "28"] {
            let place = Place::new(&format!("nth{at}e{error}"));
            let [_, operator, _] = tokens(&place);
            let config = place.folder.path().join("c.toml");
            std::fs::write(&config, place.toml("tokens = \"tokens.toml\"") + "[log]\nformat = \"json\"\n")
                .unwrap();
            let number = at.to_string();
            let environment =
                [("LD_PRELOAD", library.to_str().unwrap()), ("IO_FAIL_AT", &number), ("IO_ERROR", error)];
            let acknowledged = match Process::try_start(&place, "tokens = \"tokens.toml\"", &environment) {
                Ok(process) => {
                    started += 1;
                    let count = (0..25).filter(|_| acknowledge(&process, &operator)).count();
                    assert!(count >= 23, "call {at}: it goes on: {count}");
                    count
                }
                Err(said) => {
                    refused += 1;
                    assert!(said.starts_with("error: ") && said.lines().count() == 1, "call {at}: {said}");
                    0
                }
            };
            let process = Process::start(&place, "tokens = \"tokens.toml\"");
            let rows = ask(&process.address, "GET", "/api/v1/audit", &[], None).json();
            assert!(rows.as_array().unwrap().len() >= acknowledged, "call {at} error {error}");
        }
    }
    println!("{started} runs went on, {refused} refused to start in one line");
    assert!(started > 0);
}
