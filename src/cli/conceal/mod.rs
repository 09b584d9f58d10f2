//! `stillcut conceal`: machines that hide something, and the diagnosis judged blind on them.

mod cases;
mod cut;
mod cut_judge;
mod judge;

use super::bad_input;
use crate::config::machine::read_machine;
use crate::plant::machine::Machine;
use crate::recording::write_whole;
use crate::report::study::{Study, study_page};
use crate::simulation::concealed_axis::{Case, CaseError, CaseSpec, OUTSIDE, conceal, feed_drive_effects};
use indicatif::{ProgressBar, ProgressStyle};
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
    spec: CaseSpec,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if let Some(scenario) = &arguments.scenario {
        return cut::run(&arguments, scenario);
    }
    let Some(model) = &arguments.model else {
        return Err(bad_input("expected --model or --scenario"));
    };
    let machine = read_machine(model).map_err(bad_input)?;
    let trials = plan(&arguments);
    if trials.is_empty() {
        return Err(bad_input("nothing to do: no effect, depth or seed is given"));
    }
    // A name that nothing can be hidden by must stop the study before it starts, not in the middle.
    check_names(&trials)?;
    std::fs::create_dir_all(&arguments.out)
        .map_err(|e| bad_input(format!("{}: {e}", arguments.out.display())))?;
    let bar = progress_bar(trials.len());
    if arguments.cases_only {
        for trial in &trials {
            bar.set_message(trial.label.clone());
            let case = draw(&machine, trial).map_err(bad_input)?;
            cases::write_case(&arguments.out.join(cases::folder_name(trial)), trial, &case)?;
            bar.inc(1);
        }
        return Ok(());
    }
    let study = judge_all(&machine, &trials, &bar)?;
    bar.finish_and_clear();
    write_study(&study, &arguments.out)
}

fn progress_bar(trials: usize) -> ProgressBar {
    let bar = ProgressBar::new(trials as u64);
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} {elapsed}<{eta} {msg}") {
        bar.set_style(style);
    }
    bar
}

/// `conceal.json` and `report.html`.
fn write_study(study: &Study, out: &Path) -> anyhow::Result<()> {
    let text = serde_json::to_string_pretty(&judge::study_json(study))?;
    write_whole(&out.join("conceal.json"), text.as_bytes())?;
    write_whole(&out.join("report.html"), study_page(study).as_bytes())?;
    Ok(())
}

/// Simulates ahead on one thread while the diagnosis (itself on two) works on the case before.
fn judge_all(machine: &Machine, trials: &[Trial], bar: &ProgressBar) -> anyhow::Result<Study> {
    let mut study = Study { model: machine.name.clone(), outcomes: Vec::new() };
    std::thread::scope(|scope| {
        let (send, receive) = sync_channel::<Result<Case, CaseError>>(1);
        scope.spawn(move || {
            for trial in trials {
                if send.send(draw(machine, trial)).is_err() {
                    return; // the judge has stopped
                }
            }
        });
        for trial in trials {
            bar.set_message(format!("{} at {}", trial.label, trial.spec.depth));
            let case = receive.recv()?.map_err(bad_input)?;
            study.outcomes.push(judge::judge(trial, &case)?);
            bar.inc(1);
        }
        Ok(study)
    })
}

fn check_names(trials: &[Trial]) -> anyhow::Result<()> {
    let known = |name: &str| {
        feed_drive_effects().contains(&name)
            || OUTSIDE.contains(&name)
            || matches!(name, "position_periodic_force" | "encoder_interpolation_error")
    };
    match trials.iter().flat_map(|t| &t.spec.effects).find(|name| !known(name)) {
        Some(name) => Err(bad_input(CaseError::UnknownEffect { name: name.clone() })),
        None => Ok(()),
    }
}

fn draw(machine: &Machine, trial: &Trial) -> Result<Case, CaseError> {
    let Some(axis) = machine.axes.first() else {
        return Err(CaseError::Structure { axis: "(none)".into(), key: "axis" });
    };
    conceal(axis, machine.sample_rate, &trial.spec)
}

/// Every machine of the study, in a fixed order.
fn plan(arguments: &Arguments) -> Vec<Trial> {
    let mut trials = Vec::new();
    for label in &labels(&arguments.effects) {
        let healthy = label == "healthy";
        let effects: Vec<String> =
            if healthy { Vec::new() } else { label.split('+').map(|s| s.trim().to_owned()).collect() };
        let depths: &[f64] = if healthy { &[1.0] } else { &arguments.depths };
        for &depth in depths {
            for seed in arguments.first_seed..arguments.first_seed + arguments.seeds {
                let spec = CaseSpec {
                    effects: effects.clone(),
                    depth,
                    seed: mixed(label, depth, seed),
                    model_error: arguments.model_error,
                    background: arguments.background,
                    ..CaseSpec::default()
                };
                trials.push(Trial { label: label.clone(), spec });
            }
        }
    }
    trials
}

/// `all` stands for every effect of the feed drive, the outsiders, wrong numbers and the healthy machine.
fn labels(asked: &[String]) -> Vec<String> {
    let every = || ["healthy"].into_iter().chain(feed_drive_effects()).chain(OUTSIDE).map(str::to_owned);
    asked.iter().flat_map(|a| if a == "all" { every().collect() } else { vec![a.clone()] }).collect()
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
