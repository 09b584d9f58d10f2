//! Does anything break when service and lathe are killed at random moments? Kills the real binary with
//! kill -9, starts it again, and counts.
//!
//! ```sh
//! cargo build --release && cargo run --release --example kill_campaign -- --kills 500 --seed 1
//! ```
//! Every kill: what was acknowledged is there afterwards, no number twice, the chain of the audit record
//! holds, shared memory works again, samples flow. Prints one table; ends with status 1 when a row has a loss.

mod running;

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use running::{address, binary, lathe, number};
use std::path::PathBuf;
use std::process::{Child, ExitCode, Stdio};
use std::time::Duration;
use stillcut::service::clock;

/// Ready later than this is a loss (the target on an idle machine is 2 s).
const TOO_LATE: Duration = Duration::from_secs(10);

struct Place {
    folder: PathBuf,
    prefix: String,
}

impl Place {
    fn lathe(&self) -> Child {
        lathe(&self.folder, &self.prefix)
    }

    fn service(&self) -> Child {
        let mut command = binary();
        command.args(["run", "--config"]).arg(self.folder.join("c.toml"));
        command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("the binary starts")
    }
}

fn agent() -> ureq::Agent {
    let config = ureq::Agent::config_builder().http_status_as_error(false);
    config.timeout_global(Some(Duration::from_secs(3))).build().into()
}

/// What a good answer says; anything else in words.
fn body(agent: &ureq::Agent, url: &str) -> Result<String, String> {
    let mut answer = agent.get(url).call().map_err(|e| e.to_string())?;
    let text = answer.body_mut().read_to_string().map_err(|e| e.to_string())?;
    if answer.status() == 200 { Ok(text) } else { Err(format!("{}: {text}", answer.status())) }
}

/// One acknowledged write; true when it was acknowledged.
fn write(agent: &ureq::Agent, address: &str, token: &str) -> bool {
    let url = format!("http://{address}/api/v1/events/1/acknowledge");
    let request = agent.post(url).header("Authorization", format!("Bearer {token}"));
    request
        .header("Content-Type", "application/json")
        .send("{\"reason\":\"campaign\"}")
        .is_ok_and(|r| r.status() == 200)
}

#[derive(Default)]
struct Row {
    tries: u32,
    survived: u32,
    worst: Duration,
}

fn prepare() -> (Place, String) {
    let folder = std::env::temp_dir().join(format!("stillcut-campaign-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let prefix = format!("camp{}", std::process::id());
    let token = running::configure(&folder, &prefix, "operator", "");
    (Place { folder, prefix }, token)
}

struct Pair {
    service: Child,
    lathe: Child,
    address: Option<String>,
}

/// Samples flow that were taken in after `since_ns`: `connected` alone holds for a second after the last one.
fn connected(agent: &ureq::Agent, address: &str, since_ns: i64) -> bool {
    let Ok(text) = body(agent, &format!("http://{address}/api/v1/state")) else { return false };
    let at = text.split("\"last_sample_at\":\"").nth(1).and_then(|rest| rest.split('"').next());
    let newest_ns = at.and_then(clock::parse_rfc3339);
    text.contains("\"connected\":true") && newest_ns.is_some_and(|at| at > since_ns)
}

/// Starts what is dead and waits until samples flow again; nothing when they do not.
fn recover(place: &Place, pair: &mut Pair, agent: &ureq::Agent) -> Option<Duration> {
    let (began, since_ns) = (clock::now(), clock::wall_ns());
    while began.elapsed() < TOO_LATE {
        if !matches!(pair.lathe.try_wait(), Ok(None)) {
            pair.lathe = place.lathe();
        }
        if !matches!(pair.service.try_wait(), Ok(None)) || pair.address.is_none() {
            let _ = pair.service.kill();
            let _ = pair.service.wait();
            pair.service = place.service();
            pair.address = address(&mut pair.service);
        }
        if pair.address.as_ref().is_some_and(|a| connected(agent, a, since_ns)) {
            return Some(began.elapsed());
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    None
}

/// Rows of the audit record. A read that is refused (the disk is busy) is asked again for ten seconds: what counts
/// is what is there, not how soon it can be read. Errors: the last refusal.
fn rows(agent: &ureq::Agent, address: &str) -> Result<usize, String> {
    let (mut count, began) = (0, clock::now());
    loop {
        match body(agent, &format!("http://{address}/api/v1/audit?after={count}")) {
            Ok(page) => match page.matches("\"sequence\":").count() {
                0 => return Ok(count),
                found => count += found,
            },
            Err(refusal) if began.elapsed() > TOO_LATE => return Err(refusal),
            Err(refusal) => {
                eprintln!("asked again: {refusal}");
                std::thread::sleep(Duration::from_millis(200));
            }
        }
    }
}

fn main() -> ExitCode {
    running::expect_numbers(&["--kills", "--seed"]);
    let (kills, seed) = (number("--kills", 40.0) as u64, number("--seed", 1.0) as u64);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (place, token) = prepare();
    let agent = agent();
    let mut pair = Pair { service: place.service(), lathe: place.lathe(), address: None };
    pair.address = address(&mut pair.service);
    let mut table: [(&str, Row); 4] =
        ["service", "lathe", "both", "while starting"].map(|n| (n, Row::default()));
    let mut acknowledged = 0_usize;
    for _ in 0..kills {
        if let Some(address) = &pair.address {
            let until = clock::now() + Duration::from_millis(random.random::<u64>() % 400);
            while clock::now() < until {
                acknowledged += usize::from(write(&agent, address, &token));
            }
        }
        let kind = (random.random::<u64>() % 4) as usize;
        let (service, lathe) = (kind != 1, kind != 0);
        for _ in 0..if kind == 3 { 3 } else { 1 } {
            if service {
                let _ = pair.service.kill();
                let _ = pair.service.wait();
                pair.address = None;
            }
            if lathe {
                let _ = pair.lathe.kill();
                let _ = pair.lathe.wait();
            }
            if kind == 3 {
                // Killed again in the first milliseconds, where shared memory can be left half made.
                (pair.service, pair.lathe) = (place.service(), place.lathe());
                std::thread::sleep(Duration::from_micros(random.random::<u64>() % 30_000));
            }
        }
        if kind == 3 {
            let _ = (pair.service.kill(), pair.service.wait(), pair.lathe.kill(), pair.lathe.wait());
        }
        let row = &mut table[kind].1;
        row.tries += 1;
        let recovered = recover(&place, &mut pair, &agent);
        let kept = pair.address.as_ref().map_or(Err("not started".to_owned()), |a| rows(&agent, a));
        if let Some(took) = recovered.filter(|_| kept.as_ref().is_ok_and(|k| *k >= acknowledged)) {
            row.survived += 1;
            row.worst = row.worst.max(took);
        } else {
            eprintln!("loss: recovered {recovered:?}, rows {kept:?} of {acknowledged} acknowledged");
        }
    }
    let _ = (pair.service.kill(), pair.service.wait(), pair.lathe.kill(), pair.lathe.wait());
    let history = place.folder.join("state/history.sqlite");
    let verify = binary().args(["audit", "verify", "--history"]).arg(&history).output();
    let said = verify.map(|o| String::from_utf8_lossy(&o.stdout).trim().to_owned()).unwrap_or_default();
    println!("| killed | tries | survived | slowest recovery |\n|---|---|---|---|");
    for (name, row) in &table {
        println!("| {name} | {} | {} | {:.2} s |", row.tries, row.survived, row.worst.as_secs_f64());
    }
    println!("\nseed {seed}; {acknowledged} acknowledged writes; audit record {said}");
    let good =
        table.iter().all(|(_, r)| r.survived == r.tries) && said.starts_with("intact") && acknowledged > 0;
    let _ = std::fs::remove_dir_all(&place.folder);
    if good { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
