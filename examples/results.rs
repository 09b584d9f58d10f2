//! What does this build reach? Prints the tables of one part as they stand in `docs/results-*.md`.
//!
//! ```sh
//! cargo build --release && cargo run --release --example results -- chatter --first-seed 1
//! cargo run --release --example results -- diagnosis --first-seed 1 --seeds 3
//! cargo run --release --example results -- cut --first-seed 1
//! ```
//! Everything is made by this repository's own generators; seeds that nobody has looked at are scored once.

#[path = "../tests/suite/cut_streams.rs"]
mod cut_streams;
#[path = "../tests/suite/passes.rs"]
mod passes;
mod running;
#[path = "../tests/suite/stream_score.rs"]
mod stream_score;

use cut_streams::Kind;
use running::{binary, number};
use serde_json::Value;
use std::collections::BTreeMap;
use std::error::Error;
use std::path::Path;
use std::process::Command;
use stillcut::service::clock;

type Done = Result<(), Box<dyn Error>>;

fn main() -> Done {
    let part = std::env::args().nth(1).unwrap_or_default();
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a count from the command line"
    )]
    let whole = |name: &str, default: f64| number(name, default).max(1.0) as u64;
    let (first, seeds) =
        (whole("--first-seed", 1.0), whole("--seeds", if part == "chatter" { 20.0 } else { 1.0 }));
    head(&part);
    match part.as_str() {
        "chatter" => chatter(first, seeds),
        "diagnosis" => {
            let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/suite/feed-axis.toml");
            concealed(("--model", &model), first, seeds)
        }
        "cut" => {
            let scenario = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/lathe.toml");
            concealed(("--scenario", &scenario), first, seeds)
        }
        other => Err(format!("{other:?}: expected chatter, diagnosis or cut").into()),
    }
}

/// What was measured where.
fn head(part: &str) {
    let git = Command::new("git").args(["rev-parse", "--short", "HEAD"]).output();
    let commit =
        git.map_or_else(|_| "unknown".into(), |o| String::from_utf8_lossy(&o.stdout).trim().to_owned());
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let binary = binary();
    let profile = Path::new(binary.get_program()).parent().and_then(Path::file_name);
    let profile = profile.map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    println!("`results -- {part}`, commit {commit}, profile `{profile}`, {cores} cores.\n");
}

fn chatter(first: u64, seeds: u64) -> Done {
    println!("Streams, seeds {first} to {}:\n", first + seeds - 1);
    println!(
        "| stream | found | alarms in chatter | false alarms | median delay ms | 90 % ms | over the bound |"
    );
    println!("|---|---|---|---|---|---|---|");
    let (mut all, mut over) = (Vec::new(), Vec::new());
    let middle = |of: &[f64]| of.get(of.len() / 2).map_or_else(|| "-".into(), |x| format!("{x:.1}"));
    let kinds = [Kind::Stable, Kind::Chatter, Kind::ChatterAtEntry, Kind::Hits, Kind::Orders, Kind::Servo];
    for kind in kinds {
        let score = stream_score::score(kind, first..first + seeds);
        println!(
            "| {kind:?} | {} of {} | {} | {} | {} | {} | {} |",
            score.found,
            score.episodes,
            score.alarms,
            score.false_alarms,
            at(&score.delays_s, 0.5),
            at(&score.delays_s, 0.9),
            middle(&score.over_bound),
        );
        all.extend(score.delays_s);
        over.extend(score.over_bound);
    }
    all.sort_by(f64::total_cmp);
    over.sort_by(f64::total_cmp);
    println!("| all | {} | | | {} | {} | {} |", all.len(), at(&all, 0.5), at(&all, 0.9), middle(&over));

    println!("\nPasses of 20 s along the bar, 2 s of air between them, the turret in act:\n");
    println!("| seed | alarms at, s |\n|---|---|");
    for seed in first..first + seeds.min(8) {
        let onsets: Vec<String> = passes::onsets(seed, 50.0).iter().map(|t| format!("{t:.2}")).collect();
        println!("| {seed} | {} |", onsets.join(", "));
    }
    for more in [vec!["--cuts", "40"], vec!["--wide", "--cuts", "24"]] {
        println!("\n`stillcut campaign {} --seed {first}`:\n\n```text", more.join(" "));
        run(binary().arg("campaign").args(more).args(["--seed", &first.to_string()]))?;
        println!("```");
    }
    Ok(())
}

/// A share of the delays is below this, ms.
fn at(delays_s: &[f64], share: f64) -> String {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a place in a list")]
    let place = (share * delays_s.len() as f64) as usize;
    delays_s.get(place).map_or_else(|| "-".into(), |s| format!("{:.0}", 1e3 * s))
}

/// `stillcut conceal`: what was hidden, how often it was named, and what a stated probability is worth.
fn concealed((option, base): (&str, &Path), first: u64, seeds: u64) -> Done {
    let folder = std::env::temp_dir().join(format!("stillcut-results-{}", std::process::id()));
    let began = clock::now();
    run(binary()
        .arg("conceal")
        .args([option.as_ref(), base.as_os_str(), "--out".as_ref(), folder.as_os_str()])
        .args(["--seeds", &seeds.to_string(), "--first-seed", &first.to_string()]))?;
    let minutes = began.elapsed().as_secs_f64() / 60.0;
    let answer: Value = serde_json::from_slice(&std::fs::read(folder.join("conceal.json"))?)?;
    // The figures are printed; a folder that stays is the system's temporary folder's affair.
    let _ = std::fs::remove_dir_all(&folder);
    let list = |name: &str| answer[name].as_array().cloned().unwrap_or_default();
    println!("`stillcut conceal {option} --seeds {seeds} --first-seed {first}`, {minutes:.0} minutes:\n");
    println!("| hidden | size | machines | noticed | right | port right |\n|---|---|---|---|---|---|");
    for row in list("summary") {
        let text = |name: &str| row[name].to_string().replace('"', "");
        let cells = ["hidden", "depth", "machines", "noticed", "right", "port_right"].map(text);
        println!("| {} |", cells.join(" | "));
    }
    let trials = list("trials");
    let intervals = trials.iter().map(|t| t["intervals"].as_array().map_or(0, Vec::len)).sum::<usize>();
    let hold: u64 = trials.iter().filter_map(|t| t["intervals_holding_truth"].as_u64()).sum();
    println!("\n95 % intervals that hold the truth: {hold} of {intervals}.\n");
    reliability(&trials);
    Ok(())
}

/// Stated probability of the first finding against how often the machine was named right.
fn reliability(trials: &[Value]) {
    let mut bins: BTreeMap<u32, (f64, u32, u32)> = BTreeMap::new();
    for trial in trials {
        let Some(p) = trial["findings"][0]["probability"].as_f64() else { continue };
        let edge = [0.5, 0.9, 0.99].iter().filter(|edge| p >= **edge).count();
        let bin = bins.entry(edge as u32).or_default();
        *bin = (bin.0 + p, bin.1 + 1, bin.2 + u32::from(trial["right"] == Value::Bool(true)));
    }
    println!("| stated probability | machines | mean of it | right |\n|---|---|---|---|");
    for (edge, (sum, count, right)) in bins {
        let name = ["below 0.5", "0.5 to 0.9", "0.9 to 0.99", "0.99 and more"][edge as usize];
        println!("| {name} | {count} | {:.3} | {right} |", sum / f64::from(count));
    }
}

/// Runs to the end with what it says on ours. Errors: says which command failed.
fn run(command: &mut Command) -> Done {
    let status = command.status()?;
    if status.success() { Ok(()) } else { Err(format!("{command:?}: {status}").into()) }
}
