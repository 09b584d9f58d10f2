//! Does memory stay flat over days? The real service hears a day of a lathe's samples as fast as it can take them.
//!
//! ```sh
//! cargo build --release && cargo run --release --example soak -- --hours 24
//! ```
//! Forty simulated seconds of the virtual lathe, chatter among them, go round and round over real shared memory
//! with sequence and machine time going on; one sample in a thousand batches is damaged (not a number, repeated,
//! left out). A page's requests go on beside. Prints one row an hour: memory (median and most of the hour; in
//! compressed time a recording is still being written while the black box is filled anew), file handles,
//! write-ahead log, events. Ends with status 1 when a sample that was sent whole is missing, one that was left out
//! or damaged is not counted, or the hour's median of memory grew by more than 10 % after the first hour.

mod running;

use running::{Process, busy_s, number};
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;
use stillcut::plant::scenario::Scenario;
use stillcut::service::clock;
use stillcut::simulation::lathe::{AXES, Lathe, LatheSettings};
use stillcut::transport::wire::{ServoBatch, ServoPoint, axis_name_bytes};
use stillcut::transport::{Domain, ServoPublisher};

const RATE_HZ: f64 = 9000.0;
const BATCH: usize = 9;
/// Samples that may be on their way; the port holds 1024 batches.
const AHEAD: u64 = 800 * BATCH as u64;
/// One batch of so many is damaged.
const DAMAGE_EVERY: u64 = 1000;

struct Service {
    process: Process,
    address: String,
}

impl Service {
    fn start(folder: &Path, prefix: &str) -> Self {
        let limits = "max_bytes = 20000000\n[recorder]\nmax_bytes = 100000000\n";
        running::configure(folder, prefix, "operator", limits);
        let (process, address) = running::service(folder);
        Self { process, address }
    }

    fn get(&self, agent: &ureq::Agent, path: &str) -> String {
        let answer = agent.get(format!("http://{}{path}", self.address)).call();
        answer.ok().and_then(|mut a| a.body_mut().read_to_string().ok()).unwrap_or_default()
    }

    fn proc(&self, name: &str) -> String {
        std::fs::read_to_string(format!("/proc/{}/{name}", self.process.0.id())).unwrap_or_default()
    }

    /// Resident memory, MB.
    fn memory_mb(&self) -> f64 {
        let status = self.proc("status");
        let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).unwrap_or("0");
        line.split_whitespace().next().and_then(|v| v.parse::<f64>().ok()).unwrap_or(0.0) / 1024.0
    }

    fn handles(&self) -> usize {
        std::fs::read_dir(format!("/proc/{}/fd", self.process.0.id())).map_or(0, Iterator::count)
    }
}

fn series(text: &str, name: &str) -> u64 {
    let lines = text.lines().filter(|l| l.starts_with(name));
    lines.filter_map(|l| l.rsplit(' ').next()?.parse::<f64>().ok()).sum::<f64>() as u64
}

/// Forty seconds: air, a cut that begins to chatter.
fn round() -> Vec<ServoPoint> {
    let mut lathe = Lathe::new(LatheSettings::realistic(Scenario::default(), 7));
    let count = (40.0 * RATE_HZ) as usize / BATCH * BATCH;
    (0..count).map(|_| ServoPoint::from_sample(&lathe.step(), 0, AXES.len())).collect()
}

/// What was sent so far.
#[derive(Default)]
struct Sent {
    batches: u64,
    whole: u64,
    left_out: u64,
    refused: u64,
}

/// When a sample is taken, ns.
fn time_ns(sequence: u64) -> u64 {
    (sequence as f64 / RATE_HZ * 1e9) as u64
}

/// Samples that were refused, as a sample or for its first axis.
fn refused(metrics: &str) -> u64 {
    ["all", "x1"]
        .map(|axis| series(metrics, &format!("stillcut_samples_rejected_total{{axis=\"{axis}\"")))
        .iter()
        .sum()
}

fn send(port: &ServoPublisher, round: &[ServoPoint], sent: &mut Sent, sequence: &mut u64) {
    let mut batch = ServoBatch {
        stream: 1,
        sample_rate_hz: RATE_HZ,
        sample_count: BATCH as u32,
        axis_count: AXES.len() as u32,
        ..ServoBatch::default()
    };
    for (to, name) in batch.axis_names.iter_mut().zip(AXES) {
        *to = axis_name_bytes(name);
    }
    let damage = sent.batches % DAMAGE_EVERY == DAMAGE_EVERY - 1;
    let kind = sent.batches / DAMAGE_EVERY % 3;
    for (k, point) in batch.points.iter_mut().take(BATCH).enumerate() {
        let place = (sent.batches as usize * BATCH + k) % round.len();
        *point = ServoPoint { sequence: *sequence, t_ns: time_ns(*sequence), ..round[place] };
        match (damage && k == 4, kind) {
            (true, 0) => {
                point.axes[0].current_ref_a = f64::NAN;
                (sent.refused, *sequence) = (sent.refused + 1, *sequence + 1);
            }
            (true, 1) => {
                (point.sequence, point.t_ns) =
                    (sequence.saturating_sub(2), time_ns(sequence.saturating_sub(2)));
                sent.refused += 1;
            }
            (true, _) => {
                *sequence += 1;
                sent.left_out += 1;
                point.sequence = *sequence;
                (sent.whole, *sequence) = (sent.whole + 1, *sequence + 1);
            }
            _ => (sent.whole, *sequence) = (sent.whole + 1, *sequence + 1),
        }
    }
    port.send(&batch).expect("shared memory");
    sent.batches += 1;
}

fn main() -> ExitCode {
    running::expect_numbers(&["--hours"]);
    let hours = number("--hours", 24.0);
    let folder = std::env::temp_dir().join(format!("stillcut-soak-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder for temporary files");
    let prefix = format!("soak{}", std::process::id());
    let service = Service::start(&folder, &prefix);
    let domain = Domain::new(&prefix, &folder.join("iox")).expect("a domain");
    let who = domain.join("soak").expect("the domain is there");
    let port = ServoPublisher::open(&who).expect("a port");
    let agent = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(10))).build().into();
    let (round, began) = (round(), clock::now());
    let (mut sent, mut sequence, mut row, mut first_mb, mut worst_mb) =
        (Sent::default(), 0, 1.0, 0.0, 0.0_f64);
    let mut hour_mb = Vec::new();
    println!(
        "| hour | samples | lost | refused | RSS MB (median) | most MB | handles | WAL kB | events | recordings | CPU s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    while (sequence as f64) < hours * 3600.0 * RATE_HZ {
        let metrics = service.get(&agent, "/metrics");
        let seen = series(&metrics, "stillcut_samples_total{axis=\"x1\"}") + refused(&metrics);
        while sent.whole + sent.refused < seen + AHEAD {
            send(&port, &round, &mut sent, &mut sequence);
        }
        std::thread::sleep(Duration::from_millis(2));
        hour_mb.push(service.memory_mb());
        if sequence as f64 >= row * 3600.0 * RATE_HZ {
            let _ = ["/", "/api/v1/state", "/api/v1/events?limit=60", "/api/v1/recordings"]
                .map(|path| service.get(&agent, path));
            hour_mb.sort_unstable_by(f64::total_cmp);
            let (median_mb, most_mb) = (hour_mb[hour_mb.len() / 2], hour_mb[hour_mb.len() - 1]);
            hour_mb.clear();
            let wal =
                std::fs::metadata(folder.join("state/history.sqlite-wal")).map_or(0, |m| m.len() / 1024);
            let axis = |name: &str| series(&metrics, &format!("{name}{{axis=\"x1\""));
            println!(
                "| {row} | {} | {} | {} | {median_mb:.1} | {most_mb:.1} | {} | {wal} | {} | {} | {:.0} |",
                axis("stillcut_samples_total"),
                axis("stillcut_samples_lost_total"),
                refused(&metrics),
                service.handles(),
                series(&metrics, "stillcut_events_total"),
                series(&metrics, "stillcut_recordings_total{outcome=\"saved\"}"),
                busy_s(service.process.0.id()),
            );
            if row == 1.0 {
                first_mb = median_mb;
            }
            worst_mb = worst_mb.max(median_mb);
            row += 1.0;
        }
    }
    std::thread::sleep(Duration::from_secs(1));
    let metrics = service.get(&agent, "/metrics");
    let counted = series(&metrics, "stillcut_samples_total{axis=\"x1\"}");
    let lost = series(&metrics, "stillcut_samples_lost_total{axis=\"x1\"}");
    let took = began.elapsed().as_secs_f64();
    println!(
        "{hours} h in {took:.0} s ({:.0} times real time); sent whole {}, taken {counted}; left out {}, counted as lost \
         {lost}; damaged {}, refused {}; median of the memory in the first hour {first_mb:.1} MB, in any {worst_mb:.1} MB",
        hours * 3600.0 / took,
        sent.whole,
        sent.left_out,
        sent.refused,
        refused(&metrics),
    );
    drop(service);
    domain.remove();
    let _ = std::fs::remove_dir_all(&folder);
    let told = (lost, refused(&metrics)) == (sent.left_out, sent.refused);
    let good = counted == sent.whole && told && worst_mb <= 1.1 * first_mb;
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
