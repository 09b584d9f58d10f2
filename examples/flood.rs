//! What does a flood of requests cost the pipeline? Offers a rate, with slow, idle, oversized and malformed clients.
//!
//! ```sh
//! cargo build --release && cargo run --release --example flood -- --seconds 30 --rate 10000
//! ```
//! Starts the real service and the virtual lathe. First a quiet stretch in `observe` and one in `act`, then the flood
//! in `act`; prints for each: latency of decisions from the service's own histogram (in `observe` a decision takes
//! in fifty batches, in `act` one), samples lost, `/healthz`, memory, processor time, mode at the end.

mod running;

use running::{Process, busy_s, lathe, number, service};
use std::io::{Read as _, Write as _};
use std::net::TcpStream;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use stillcut::service::clock;

/// Limits that somebody answers for: without them nothing acts.
const COMMISSIONED: &str = "[turret]\nlimits_by = \"flood\"\nlimits_date = \"2026-11-23\"\naccept = [\"hours_observed\", \"cuts_heard\", \"alarms_reviewed\", \"commands_advised\", \"model_drift\", \"estimators_disagree\"]\n";

fn get(address: &str, path: &str) -> String {
    let config = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(10)));
    let agent: ureq::Agent = config.build().into();
    let answer = agent.get(format!("http://{address}{path}")).call();
    answer.ok().and_then(|mut a| a.body_mut().read_to_string().ok()).unwrap_or_default()
}

/// Upper bounds and counts of the latency histogram, and samples lost.
fn counters(address: &str) -> (Vec<(f64, u64)>, u64) {
    let text = get(address, "/metrics");
    let bucket = |l: &str| {
        let rest = l.strip_prefix("stillcut_decision_latency_seconds_bucket{le=\"")?;
        let (bound, count) = rest.split_once("\"} ")?;
        Some((bound.parse().unwrap_or(f64::INFINITY), count.parse().ok()?))
    };
    let lost = text.lines().filter(|l| l.starts_with("stillcut_samples_lost_total{"));
    let lost = lost.filter_map(|l| l.rsplit(' ').next()?.parse::<f64>().ok()).sum::<f64>() as u64;
    (text.lines().filter_map(bucket).collect(), lost)
}

/// Quantile between two looks at the histogram, inside its bucket by proportion.
fn quantile(before: &[(f64, u64)], after: &[(f64, u64)], share: f64) -> f64 {
    let counts: Vec<(f64, u64)> = after.iter().zip(before).map(|(a, b)| (a.0, a.1 - b.1)).collect();
    let wanted = share * counts.last().map_or(0, |c| c.1) as f64;
    let (mut low_s, mut below) = (0.0, 0);
    for (bound_s, count) in counts {
        if count as f64 >= wanted {
            let inside = (wanted - below as f64) / ((count - below).max(1)) as f64;
            return if bound_s.is_finite() { low_s + inside * (bound_s - low_s) } else { low_s };
        }
        (low_s, below) = (bound_s, count);
    }
    f64::INFINITY
}

fn rss_mb(id: u32) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{id}/statm")).unwrap_or_default();
    text.split(' ').nth(1).and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) * 4096.0 / 1e6
}

const KINDS: [&str; 6] = [
    "GET /api/v1/state HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "GET /api/v1/events?limit=100 HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "PUT /api/v1/mode HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 9\r\n\r\n{\"mode\":[",
    "GET /metrics HTTP/1.1\r\nHost: localhost\r\n\r\n",
    "GET /none/%ff?x=%00 HTTP/1.1\r\nHost: localhost\r\n\r\n",
];

/// Offers requests at a rate over one connection after another, reading what comes back. What is sent is put
/// together once: the generator shares the cores with what it floods.
fn offer(address: &str, rate: f64, stop: &AtomicBool, (offered, answered): (&AtomicU64, &AtomicU64)) {
    const TOGETHER: u64 = 24;
    let many: String = (0..TOGETHER as usize).map(|k| KINDS[k % KINDS.len()]).collect();
    let (began, mut mine) = (clock::now(), 0_u64);
    while !stop.load(Ordering::Relaxed) {
        let Ok(mut stream) = TcpStream::connect(address) else { continue };
        let Ok(mut reader) = stream.try_clone() else { continue };
        let _ = reader.set_read_timeout(Some(Duration::from_millis(500)));
        let counted = std::thread::scope(|scope| {
            let reading = scope.spawn(move || {
                let (mut count, mut buffer) = (0_u64, vec![0_u8; 1 << 18]);
                while let Ok(read) = reader.read(&mut buffer)
                    && read > 0
                {
                    count += String::from_utf8_lossy(&buffer[..read]).matches("HTTP/1.1 ").count() as u64;
                }
                count
            });
            for _ in 0..200 {
                let due = (began.elapsed().as_secs_f64() * rate) as u64;
                if mine >= due {
                    std::thread::sleep(Duration::from_millis(1));
                    continue;
                }
                (mine, _) = (mine + TOGETHER, offered.fetch_add(TOGETHER, Ordering::Relaxed));
                if stream.write_all(many.as_bytes()).is_err() || stop.load(Ordering::Relaxed) {
                    break;
                }
            }
            let _ = stream.shutdown(std::net::Shutdown::Write);
            reading.join().unwrap_or(0)
        });
        answered.fetch_add(counted, Ordering::Relaxed);
    }
}

/// Clients that send a byte a second, or nothing, or ten megabytes; each tries again when it is cut off.
fn nuisance(address: &str, kind: usize, stop: &AtomicBool) {
    let body = if kind < 2 { Vec::new() } else { vec![b'a'; 1 << 20] };
    while !stop.load(Ordering::Relaxed) {
        let Ok(mut stream) = TcpStream::connect(address) else {
            std::thread::sleep(Duration::from_millis(100));
            continue;
        };
        match kind {
            0 => {
                let _ = stream.set_read_timeout(Some(Duration::from_secs(6)));
                let _ = stream.read(&mut [0; 16]);
            }
            1 => {
                for byte in "GET / HTTP/1.1\r\nX-Slow: ".bytes() {
                    std::thread::sleep(Duration::from_secs(1));
                    if stream.write_all(&[byte]).is_err() || stop.load(Ordering::Relaxed) {
                        break;
                    }
                }
            }
            _ => {
                let head = "POST /api/v1/override HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\nContent-Length: 10485760\r\n\r\n";
                let _ = stream.write_all(head.as_bytes());
                let _ = (0..10).try_for_each(|_| stream.write_all(&body));
                std::thread::sleep(Duration::from_millis(200));
            }
        }
    }
}

/// Switches to `act`; what the service answers.
fn act(address: &str, token: &str) -> String {
    let agent: ureq::Agent = ureq::Agent::config_builder().http_status_as_error(false).build().into();
    let url = format!("http://{address}/api/v1/mode");
    let tag = agent.get(&url).call().ok();
    let tag = tag.and_then(|a| a.headers().get("etag")?.to_str().ok().map(str::to_owned)).unwrap_or_default();
    let put = agent.put(&url).header("If-Match", tag).header("Content-Type", "application/json");
    let put = put.header("Authorization", format!("Bearer {token}"));
    let answer = put.send("{\"mode\":\"act\",\"reason\":\"flood\"}");
    answer.map_or_else(|e| e.to_string(), |mut a| a.body_mut().read_to_string().unwrap_or_default())
}

/// The mode that the service is in.
fn mode(address: &str) -> String {
    let text = get(address, "/api/v1/mode");
    let rest = text.split("\"mode\":\"").nth(1).unwrap_or("?");
    rest.split('"').next().unwrap_or("?").to_owned()
}

struct Stretch {
    name: &'static str,
    mode: String,
    p999_us: f64,
    p50_us: f64,
    lost: u64,
    health_ms: f64,
    rss_mb: f64,
    cpu: f64,
    count: u64,
}

/// Watches for some seconds.
fn watch(name: &'static str, (address, id): (&str, u32), seconds: f64) -> Stretch {
    let (before, lost_before) = counters(address);
    let (busy, began, mut slowest) = (busy_s(id), clock::now(), Duration::ZERO);
    let mut most_mb = 0.0_f64;
    while began.elapsed().as_secs_f64() < seconds {
        let asked = clock::now();
        let good = get(address, "/healthz") == "alive\n";
        slowest = slowest.max(if good { asked.elapsed() } else { Duration::from_secs(99) });
        most_mb = most_mb.max(rss_mb(id));
        std::thread::sleep(Duration::from_millis(100));
    }
    let cpu = (busy_s(id) - busy) / began.elapsed().as_secs_f64();
    let (after, lost) = counters(address);
    Stretch {
        name,
        mode: mode(address),
        p999_us: 1e6 * quantile(&before, &after, 0.999),
        p50_us: 1e6 * quantile(&before, &after, 0.5),
        lost: lost - lost_before,
        health_ms: 1e3 * slowest.as_secs_f64(),
        rss_mb: most_mb,
        cpu,
        count: after.last().map_or(0, |b| b.1) - before.last().map_or(0, |b| b.1),
    }
}

fn main() -> ExitCode {
    running::expect_numbers(&["--seconds", "--rate"]);
    let (seconds, rate) = (number("--seconds", 30.0), number("--rate", 10_000.0));
    let folder = std::env::temp_dir().join(format!("stillcut-flood-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    let prefix = format!("flood{}", std::process::id());
    let token = running::configure(&folder, &prefix, "engineer", COMMISSIONED);
    let (process, address) = service(&folder);
    let lathe = Process(lathe(&folder, &prefix));
    let id = process.0.id();
    std::thread::sleep(Duration::from_secs(17)); // until the black box is full
    let mut rows = vec![watch("quiet", (&address, id), seconds)];
    let answer = act(&address, &token);
    if mode(&address) != "act" {
        eprintln!("`act` was refused: {answer}");
        return ExitCode::FAILURE;
    }
    rows.push(watch("acting", (&address, id), seconds));
    let (stop, offered, answered) =
        (AtomicBool::new(false), Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
    std::thread::scope(|scope| {
        for _ in 0..4 {
            let (address, stop, counts) = (&address, &stop, (&*offered, &*answered));
            scope.spawn(move || offer(address, rate / 4.0, stop, counts));
        }
        for k in 0..402 {
            let (address, stop) = (&address, &stop);
            let small = std::thread::Builder::new().stack_size(64 * 1024);
            let _ =
                small.spawn_scoped(scope, move || nuisance(address, if k < 400 { k % 2 } else { 2 }, stop));
        }
        rows.push(watch("flood", (&address, id), seconds));
        stop.store(true, Ordering::Relaxed);
    });
    println!(
        "| stretch | mode at its end | decisions | p50 us | p99.9 us | samples lost | slowest /healthz ms | RSS MB | cores |"
    );
    println!("|---|---|---|---|---|---|---|---|---|");
    for r in &rows {
        println!(
            "| {} | {} | {} | {:.0} | {:.0} | {} | {:.0} | {:.1} | {:.3} |",
            r.name, r.mode, r.count, r.p50_us, r.p999_us, r.lost, r.health_ms, r.rss_mb, r.cpu
        );
    }
    let (offered, answered) = (offered.load(Ordering::Relaxed), answered.load(Ordering::Relaxed));
    println!(
        "{offered} requests offered in {seconds} s ({:.0} a second), {answered} answered",
        offered as f64 / seconds
    );
    drop((process, lathe));
    let _ = std::fs::remove_dir_all(&folder);
    if rows.iter().all(|r| r.lost == 0) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
