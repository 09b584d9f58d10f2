//! `stillcut conceal`: machines that hide something, and the diagnosis judged blind on them.

mod axis;
mod cut;
mod cut_judge;
mod judge;

use super::bad_input;
use crate::recording::{write_recording, write_whole};
use crate::report::study::{Outcome, Study, Truth, study_page};
use crate::sample::Recording;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;

/// Judges the diagnosis blind on simulated machines with a hidden effect.
///
/// Draws machines around a model (or lathes around a scenario), hides effects in them at each depth,
/// records three experiments (five cuts) of each with a plant richer than any model, runs the diagnosis
/// blind and reports how often it noticed and how often it named the cause.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Model to draw machines around: an axis of two inertias.
    #[arg(long, required_unless_present = "scenario", conflicts_with = "scenario")]
    model: Option<PathBuf>,
    /// Scenario to draw machines around: the diagnosis of the cut is judged, on five recordings a machine.
    #[arg(long)]
    scenario: Option<PathBuf>,
    /// Effects to hide, comma separated; `a+b` hides two at once; `healthy` hides nothing.
    #[arg(long, value_delimiter = ',', default_value = "all")]
    effects: Vec<String>,
    /// Depths: 1 is a plain effect, 0.1 a tenth of it.
    #[arg(long, value_delimiter = ',', default_value = "1,0.3,0.1")]
    depths: Vec<f64>,
    /// Machines per effect and depth.
    #[arg(long, default_value_t = 3)]
    seeds: u64,
    /// First seed.
    #[arg(long, default_value_t = 1)]
    first_seed: u64,
    /// How far the model's constants are off, standard deviation as a share.
    #[arg(long, default_value_t = 0.02)]
    model_error: f64,
    /// Size of background disturbances: 1 is a quiet axis.
    #[arg(long, default_value_t = 1.0)]
    background: f64,
    /// Only writes the cases as folders (model, recordings, truth.json); no diagnosis.
    #[arg(long)]
    cases_only: bool,
    /// Folder for the results.
    #[arg(long)]
    out: PathBuf,
}

/// One machine of the study.
#[derive(Debug, Clone)]
struct Trial {
    label: String,
    effects: Vec<String>,
    depth: f64,
    /// As counted on the command line.
    number: u64,
    /// Of this machine alone.
    seed: u64,
}

impl Trial {
    fn folder(&self) -> String {
        format!("{}-d{}-s{}", self.label.replace('/', "."), self.depth, self.seed)
    }
}

/// Machines of one kind: how they are drawn, written and judged.
trait Bench: Sync {
    type Case: Send;

    /// What the machines are drawn around.
    fn model(&self) -> String;

    /// Every name that `all` stands for, beside `healthy`.
    fn every(&self) -> Vec<&'static str>;

    /// Errors: a name that nothing can be hidden by.
    fn check(&self, effect: &str) -> anyhow::Result<()>;

    fn draw(&self, trial: &Trial) -> anyhow::Result<Self::Case>;

    fn judge(&self, trial: &Trial, case: &Self::Case) -> anyhow::Result<Outcome>;

    /// What a shop would hand over, and the truth.
    fn handed<'a>(&self, trial: &Trial, case: &'a Self::Case) -> Handed<'a>;
}

/// A case for a folder of its own.
struct Handed<'a> {
    /// Name and text of the model.
    model: (&'static str, String),
    recordings: &'a [Recording],
    truth: Value,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    match (&arguments.scenario, &arguments.model) {
        (Some(scenario), _) => study(&cut::CutBench::read(scenario)?, &arguments),
        (None, Some(model)) => study(&axis::AxisBench::read(model, &arguments)?, &arguments),
        (None, None) => Err(bad_input("expected --model or --scenario")),
    }
}

fn study(bench: &impl Bench, arguments: &Arguments) -> anyhow::Result<()> {
    let trials = plan(arguments, &bench.every());
    if trials.is_empty() {
        return Err(bad_input("nothing to do: no effect, depth or seed is given"));
    }
    // A name that nothing can be hidden by must stop the study before it starts, not in the middle.
    trials.iter().flat_map(|t| &t.effects).try_for_each(|name| bench.check(name))?;
    let out = &arguments.out;
    std::fs::create_dir_all(out).map_err(|e| bad_input(format!("{}: {e}", out.display())))?;
    let bar = progress_bar(trials.len());
    if arguments.cases_only {
        for trial in &trials {
            bar.set_message(trial.label.clone());
            let case = bench.draw(trial)?;
            write_case(&out.join(trial.folder()), &bench.handed(trial, &case))?;
            bar.inc(1);
        }
        return Ok(());
    }
    let study = Study { model: bench.model(), outcomes: judge_all(bench, &trials, &bar)? };
    bar.finish_and_clear();
    write_study(&study, out)
}

fn progress_bar(trials: usize) -> ProgressBar {
    let bar = ProgressBar::new(trials as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed}<{eta} {msg}") {
        bar.set_style(style);
    }
    bar
}

/// Writes model, recordings and `truth.json`.
fn write_case(folder: &Path, handed: &Handed<'_>) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| bad_input(format!("{}: {e}", folder.display())))?;
    let (name, text) = &handed.model;
    write_whole(&folder.join(name), text.as_bytes())?;
    for recording in handed.recordings {
        write_recording(&folder.join(format!("{}.parquet", recording.experiment)), recording)?;
    }
    let text = serde_json::to_string_pretty(&handed.truth)?;
    write_whole(&folder.join("truth.json"), text.as_bytes())?;
    Ok(())
}

/// `conceal.json` and `report.html`.
fn write_study(study: &Study, out: &Path) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(&judge::study_json(study))?;
    write_whole(&out.join("conceal.json"), text.as_bytes())?;
    write_whole(&out.join("report.html"), study_page(study).as_bytes())?;
    Ok(())
}

/// Simulates ahead on one thread while the diagnosis (itself on two) works on the case before.
fn judge_all<B: Bench>(bench: &B, trials: &[Trial], bar: &ProgressBar) -> anyhow::Result<Vec<Outcome>> {
    let mut outcomes = Vec::new();
    std::thread::scope(|scope| {
        let (send, receive) = sync_channel::<anyhow::Result<B::Case>>(1);
        scope.spawn(move || {
            for trial in trials {
                if send.send(bench.draw(trial)).is_err() {
                    return; // the judge has stopped
                }
            }
        });
        for trial in trials {
            bar.set_message(format!("{} at {}", trial.label, trial.depth));
            outcomes.push(bench.judge(trial, &receive.recv()??)?);
            bar.inc(1);
        }
        Ok(outcomes)
    })
}

/// What kind of case it is, by the first thing that is hidden.
fn truth_of(hidden: Option<&str>) -> Truth {
    match hidden {
        None => Truth::Healthy,
        Some(name) if name.starts_with("parameter/") => Truth::WrongNumber,
        Some(name) if name.starts_with("unknown/") => Truth::Outsider,
        Some(_) => Truth::Effect,
    }
}

/// Every machine of the study, in a fixed order; `all` stands for `every` name and the healthy machine.
fn plan(arguments: &Arguments, every: &[&str]) -> Vec<Trial> {
    let all = || ["healthy"].iter().chain(every).map(|name| (*name).to_owned());
    let labels = arguments
        .effects
        .iter()
        .flat_map(|asked| if asked == "all" { all().collect() } else { vec![asked.clone()] });
    let mut trials = Vec::new();
    for label in labels {
        let healthy = label == "healthy";
        let effects: Vec<String> =
            if healthy { Vec::new() } else { label.split('+').map(|s| s.trim().to_owned()).collect() };
        let depths: &[f64] = if healthy { &[1.0] } else { &arguments.depths };
        for &depth in depths {
            for number in arguments.first_seed..arguments.first_seed + arguments.seeds {
                let seed = mixed(&label, depth, number);
                trials.push(Trial { label: label.clone(), effects: effects.clone(), depth, number, seed });
            }
        }
    }
    trials
}

/// A seed of its own for every trial (FNV-1a over what defines it), so that machines differ between effects.
fn mixed(label: &str, depth: f64, seed: u64) -> u64 {
    let mut hash: u64 = 0xcbf2_9ce4_8422_2325;
    let bytes = label.bytes().chain(depth.to_bits().to_le_bytes()).chain(seed.to_le_bytes());
    for byte in bytes {
        hash = (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
    hash >> 16
}
