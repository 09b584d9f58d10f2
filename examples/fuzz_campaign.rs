//! Does any parser of outside bytes panic, hang or eat memory? Feeds arbitrary and mutated valid bytes to each
//! of them for a while and counts.
//!
//! ```sh
//! cargo build --release && cargo run --release --example fuzz_campaign -- --seconds 60 --seed 1
//! ```
//! `--target NAME` runs one alone. Prints one table; an input that panics or takes a second is kept in
//! `fuzz-findings/` and ends the campaign with status 1. Limit the memory from outside: `ulimit -v 2000000`.

#[path = "../fuzz/src/targets.rs"]
mod targets;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use std::io::{Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use stillcut::service::clock;

const HANG: Duration = Duration::from_secs(1);

fn argument(name: &str) -> Option<String> {
    std::env::args().skip_while(|a| a != name).nth(1)
}

/// Valid inputs that mutation begins with.
fn seeds(target: &str, live: &targets::Live, scratch: &Path) -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |name: &str| std::fs::read(root.join(name)).expect("a file of the tree");
    match target {
        "configuration" => vec![
            read("config/stillcut.toml"),
            read("config/lathe.toml"),
            read("config/import/emps-mat.toml"),
            b"[http]\nlisten = \"127.0.0.1:0\"\n".to_vec(),
        ],
        "model" => {
            let term = "\n[[axes.x1.physics]]\neffect = \"torque_ripple\"\nport = \"motor\"\norder_per_rev = 6.0\namplitude_n = 2.0\n";
            let mut with_physics = read("config/turrets.toml");
            with_physics.extend_from_slice(term.as_bytes());
            vec![read("config/turrets.toml"), read("config/machines/screw-drive-1.toml"), with_physics]
        }
        "csv" => vec![
            b"t_s,x_force_n\n0,1\n0.001,2\n0.002,3.5\n".to_vec(),
            b"\xef\xbb\xbft_s,x_current_ref_a,x_motor_angle_rad\n0,1,1e-3\n1e-3,-2,4\n".to_vec(),
        ],
        "parquet" => {
            let path = scratch.join(format!("seed-{}.csv", std::process::id()));
            std::fs::write(&path, "t_s,x_force_n\n0,1\n0.001,2\n0.002,3.5\n").expect("scratch");
            let recording = stillcut::recording::read_recording(&path).expect("a recording");
            let out = scratch.join(format!("seed-{}.parquet", std::process::id()));
            stillcut::recording::write_recording(&out, &recording).expect("scratch");
            let bytes = std::fs::read(&out).expect("scratch");
            let _ = (std::fs::remove_file(path), std::fs::remove_file(out));
            vec![bytes]
        }
        "keyframe" => vec![live.keyframe()],
        "evidence" => vec![b"\x003:4,5".to_vec(), b"\x01\x05\xff".to_vec(), b"\x02\x0b\x07".to_vec()],
        "shdr" => vec![b"* PING\r\n* PI".to_vec()],
        "rest" => [
            "{\"mode\":\"advise\",\"reason\":\"test\"}",
            "{\"recordings\":[\"a\"],\"reason\":\"test\"}",
            "{\"minutes\":5.0,\"reason\":\"test\"}",
            "{\"reason\":\"test\"}",
        ]
        .map(|t| t.as_bytes().to_vec())
        .to_vec(),
        _ => vec![(0..=255).collect()],
    }
}

/// Some bytes changed, cut, doubled or put in; now and then nothing but noise.
fn mutate(seed: &[u8], random: &mut ChaCha8Rng) -> Vec<u8> {
    if random.random::<u64>() % 20 == 0 {
        let length = (random.random::<u64>() % 300) as usize;
        return (0..length).map(|_| random.random::<u64>() as u8).collect();
    }
    let mut bytes = seed.to_vec();
    for _ in 0..=random.random::<u64>() % 6 {
        let length = bytes.len().max(1) as u64;
        let at = (random.random::<u64>() % length) as usize;
        let run = ((random.random::<u64>() % 40) as usize).min(bytes.len().saturating_sub(at));
        match random.random::<u64>() % 8 {
            0 if !bytes.is_empty() => bytes[at] = random.random::<u64>() as u8,
            1 if !bytes.is_empty() => bytes[at] ^= 1 << (random.random::<u64>() % 8),
            2 => drop(bytes.drain(at..at + run)),
            3 => {
                let piece = bytes[at..at + run].to_vec();
                bytes.splice(at..at, piece);
            }
            4 => bytes.truncate(at),
            5 => {
                const WORDS: [&str; 12] = [
                    "nan",
                    "inf",
                    "-1",
                    "1e309",
                    "\"",
                    "[",
                    "]",
                    "{",
                    "=",
                    "\n",
                    "\u{0}",
                    "99999999999999999999",
                ];
                let word = WORDS[(random.random::<u64>() % 12) as usize];
                bytes.splice(at..at, word.bytes());
            }
            6 if bytes.len() > 8 => {
                let at = at.min(bytes.len() - 8);
                let wild = [0, u64::MAX, 1, f64::NAN.to_bits(), f64::INFINITY.to_bits(), 1 << 63, 1 << 31];
                let word = wild[(random.random::<u64>() % 7) as usize];
                bytes[at..at + 8].copy_from_slice(&word.to_le_bytes());
            }
            _ => {}
        }
    }
    bytes
}

/// REST bodies and queries over one connection to a service of this process.
struct Rest {
    running: stillcut::service::Running,
    stream: std::net::TcpStream,
}

impl Rest {
    fn new(scratch: &Path) -> Self {
        let folder = scratch.join(format!("fuzz-{}", std::process::id()));
        let text = format!(
            "[transport]\nprefix = \"fuzz{0}\"\nroot = \"{1}/iox\"\n[http]\nlisten = \"127.0.0.1:0\"\n[history]\nfolder = \"{1}/state\"\n",
            std::process::id(),
            folder.display()
        );
        let mut config =
            stillcut::config::service::service_config_from_text(&folder.join("c.toml"), &text).expect("good");
        config.http.trust_loopback = true;
        let running = stillcut::service::start(config).expect("a service");
        let stream = Self::connect(&running);
        Self { running, stream }
    }

    fn connect(running: &stillcut::service::Running) -> std::net::TcpStream {
        let stream = std::net::TcpStream::connect(running.handle().address()).expect("it listens");
        stream.set_read_timeout(Some(Duration::from_secs(5))).expect("a timeout");
        stream.set_nodelay(true).expect("no delay");
        stream
    }

    /// One request; anything but an answer below 500 in time is a finding.
    fn ask(&mut self, bytes: &[u8], kind: u64) -> bool {
        const PATHS: [&str; 7] = [
            "PUT /api/v1/mode",
            "POST /api/v1/diagnoses",
            "POST /api/v1/events/1/silence",
            "POST /api/v1/events/1/acknowledge",
            "POST /api/v1/override",
            "POST /api/v1/fault/clear",
            "GET /api/v1/events?",
        ];
        let path = PATHS[(kind % 7) as usize];
        let request = if path.ends_with('?') {
            let query: String =
                bytes
                    .iter()
                    .take(200)
                    .map(|b| {
                        if b.is_ascii_alphanumeric() || *b == b'=' || *b == b'&' {
                            char::from(*b)
                        } else {
                            '%'
                        }
                    })
                    .collect();
            format!("{path}{query} HTTP/1.1\r\nHost: localhost\r\n\r\n").into_bytes()
        } else {
            let head = format!(
                "{path} HTTP/1.1\r\nHost: localhost\r\nIf-Match: \"1\"\r\nContent-Type: application/json\r\nContent-Length: {}\r\n\r\n",
                bytes.len()
            );
            [head.as_bytes(), bytes].concat()
        };
        if self.stream.write_all(&request).is_err() {
            self.stream = Self::connect(&self.running);
            return false;
        }
        let status = self.read_answer();
        assert!(status < 500 || status == 503, "{path}: {status}");
        (200..300).contains(&status)
    }

    fn read_answer(&mut self) -> u16 {
        let mut got = Vec::new();
        let mut buffer = [0_u8; 16_384];
        loop {
            let count = self.stream.read(&mut buffer).expect("an answer in five seconds");
            if count == 0 {
                self.stream = Self::connect(&self.running);
                break;
            }
            got.extend_from_slice(&buffer[..count]);
            let text = String::from_utf8_lossy(&got);
            let Some(end) = text.find("\r\n\r\n") else { continue };
            let length = text[..end]
                .lines()
                .find_map(|l| l.to_ascii_lowercase().strip_prefix("content-length: ")?.parse::<usize>().ok());
            if got.len() >= end + 4 + length.unwrap_or(0) {
                break;
            }
        }
        let text = String::from_utf8_lossy(&got);
        text.split(' ').nth(1).and_then(|s| s.parse().ok()).unwrap_or(400)
    }
}

/// What one campaign holds.
struct Bench {
    live: targets::Live,
    decisions: targets::Decisions,
    rest: Option<Rest>,
    scratch: PathBuf,
}

impl Bench {
    fn run(&mut self, target: &str, bytes: &[u8], kind: u64) -> bool {
        match target {
            "configuration" => targets::configuration(bytes),
            "model" => targets::model(bytes),
            "csv" | "parquet" => targets::recording(bytes, target, &self.scratch),
            "mat" => targets::mat(bytes, &self.scratch),
            "shdr" => targets::wire::shdr(bytes),
            "keyframe" => self.live.restore(bytes),
            "evidence" => self.decisions.read(bytes),
            "wire" => targets::wire::batch(bytes, &mut self.live),
            _ => {
                let scratch = self.scratch.clone();
                self.rest.get_or_insert_with(|| Rest::new(&scratch)).ask(bytes, kind)
            }
        }
    }
}

/// Time that this thread has had a processor for: what others take away is no hang.
fn busy() -> Duration {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    Duration::from_nanos(text.split(' ').next().and_then(|n| n.parse().ok()).unwrap_or(0))
}

fn keep(target: &str, bytes: &[u8], findings: &mut u32) {
    *findings += 1;
    let _ = std::fs::create_dir_all("fuzz-findings");
    let path = format!("fuzz-findings/{target}-{findings}");
    eprintln!("finding: {path}");
    std::fs::write(path, bytes).expect("the finding is kept");
}

fn main() -> ExitCode {
    let usage = "[--seconds N] [--seed N] [--target NAME]";
    let wrong = |name: &String| !["--seconds", "--seed", "--target"].contains(&name.as_str());
    if let Some(name) = std::env::args().skip(1).step_by(2).find(wrong) {
        let help = name == "--help" || name == "-h";
        println!("{}expected: {usage}", if help { String::new() } else { format!("{name}: ") });
        return if help { ExitCode::SUCCESS } else { ExitCode::from(2) };
    }
    let number = |name: &str, default: u64| argument(name).and_then(|v| v.parse().ok()).unwrap_or(default);
    let (seconds, seed) = (number("--seconds", 60), number("--seed", 1));
    let memory = Path::new("/dev/shm");
    let scratch = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let (live, decisions) = (targets::Live::new(), targets::Decisions::new());
    let mut bench = Bench { live, decisions, rest: None, scratch: scratch.clone() };
    let all =
        ["configuration", "model", "csv", "parquet", "mat", "keyframe", "evidence", "wire", "shdr", "rest"];
    let only = argument("--target");
    let mut findings = 0;
    println!("| target | inputs | accepted | slowest | findings |\n|---|---|---|---|---|");
    for target in all.into_iter().filter(|t| only.as_deref().is_none_or(|o| o == *t)) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let seeds = seeds(target, &bench.live, &scratch);
        let (mut inputs, mut accepted, mut slowest, before) = (0_u64, 0_u64, Duration::ZERO, findings);
        let end = clock::now() + Duration::from_secs(seconds);
        while clock::now() < end && findings < before + 10 {
            let of = (random.random::<u64>() % seeds.len() as u64) as usize;
            let bytes = mutate(&seeds[of], &mut random);
            let kind = random.random::<u64>();
            let began = busy();
            let outcome =
                std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| bench.run(target, &bytes, kind)));
            let took = busy().saturating_sub(began);
            inputs += 1;
            slowest = slowest.max(took);
            match outcome {
                Ok(good) => accepted += u64::from(good),
                Err(_) => keep(target, &bytes, &mut findings),
            }
            if took > HANG {
                keep(target, &bytes, &mut findings);
            }
        }
        let (ms, found) = (slowest.as_secs_f64() * 1e3, findings - before);
        println!("| {target} | {inputs} | {accepted} | {ms:.1} ms | {found} |");
    }
    if let Some(rest) = bench.rest.take() {
        rest.running.stop();
        let _ = std::fs::remove_dir_all(scratch.join(format!("fuzz-{}", std::process::id())));
    }
    if findings == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
