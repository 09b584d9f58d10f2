//! `stillcut conceal --scenario`: machines whose cut hides something.

use super::{Arguments, mixed};
use crate::cli::bad_input;
use crate::config::scenario::{read_scenario, scenario_to_text};
use crate::recording::{write_recording, write_whole};
use crate::simulation::concealed_cut::{
    CUT_EFFECTS, CUT_OUTSIDE, CutCase, CutCaseError, CutCaseSpec, conceal_cut,
};
use indicatif::ProgressBar;
use serde_json::{Map, Value, json};
use std::path::Path;

/// One machine of the study.
#[derive(Debug, Clone)]
pub(super) struct CutTrial {
    pub(super) label: String,
    pub(super) spec: CutCaseSpec,
}

pub(super) fn run(arguments: &Arguments, scenario_path: &Path) -> anyhow::Result<()> {
    let scenario = read_scenario(scenario_path).map_err(bad_input)?;
    let trials = plan(arguments);
    if trials.is_empty() {
        return Err(bad_input("nothing to do: no effect, depth or seed is given"));
    }
    let known = |name: &String| CUT_EFFECTS.contains(&name.as_str()) || CUT_OUTSIDE.contains(&name.as_str());
    if let Some(name) = trials.iter().flat_map(|t| &t.spec.effects).find(|name| !known(name)) {
        return Err(bad_input(CutCaseError::UnknownEffect { name: name.clone() }));
    }
    std::fs::create_dir_all(&arguments.out)
        .map_err(|e| bad_input(format!("{}: {e}", arguments.out.display())))?;
    let bar = super::progress_bar(trials.len());
    if arguments.cases_only {
        return write_cases(&scenario, &trials, &arguments.out, &bar);
    }
    let name = scenario_path.display().to_string();
    let study = super::cut_judge::judge_all(&scenario, name, &trials, &bar)?;
    bar.finish_and_clear();
    super::write_study(&study, &arguments.out)
}

fn write_cases(
    scenario: &crate::plant::scenario::Scenario,
    trials: &[CutTrial],
    out: &Path,
    bar: &ProgressBar,
) -> anyhow::Result<()> {
    for trial in trials {
        bar.set_message(trial.label.clone());
        let case = conceal_cut(scenario, &trial.spec).map_err(bad_input)?;
        let name = format!("{}-d{}-s{}", trial.label.replace('/', "."), trial.spec.depth, trial.spec.seed);
        write_case(&out.join(name), trial, &case)?;
        bar.inc(1);
    }
    Ok(())
}

/// Writes scenario, recordings and `truth.json`.
fn write_case(folder: &Path, trial: &CutTrial, case: &CutCase) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| bad_input(format!("{}: {e}", folder.display())))?;
    write_whole(&folder.join("scenario.toml"), scenario_to_text(&case.scenario).as_bytes())?;
    for recording in &case.recordings {
        write_recording(&folder.join(format!("{}.parquet", recording.experiment)), recording)?;
    }
    let text = serde_json::to_string_pretty(&truth(trial, case))?;
    write_whole(&folder.join("truth.json"), text.as_bytes())?;
    Ok(())
}

fn truth(trial: &CutTrial, case: &CutCase) -> Value {
    let hidden = |h: &crate::simulation::concealed_cut::HiddenCut| {
        let parameters: Map<String, Value> =
            h.parameters.iter().map(|(k, v)| ((*k).to_owned(), json!(v))).collect();
        json!({"effect": h.name, "port": h.port.name(), "scale": h.depth, "parameters": parameters})
    };
    let t = &case.truth;
    json!({
        "seed": trial.spec.seed,
        "missing": case.hidden.iter().map(hidden).collect::<Vec<Value>>(),
        "actual": {
            "radial_stiffness_pa": t.pressure_pa, "damping_ratio": t.damping_ratio,
            "clamp_factor": t.clamp_factor, "process_damping_n": t.flank_damping_n,
        },
    })
}

/// Every machine of the study, in a fixed order; half of them have a probe.
fn plan(arguments: &Arguments) -> Vec<CutTrial> {
    let all = || ["healthy"].into_iter().chain(CUT_EFFECTS).chain(CUT_OUTSIDE).map(str::to_owned);
    let labels: Vec<String> = arguments
        .effects
        .iter()
        .flat_map(|asked| if asked == "all" { all().collect() } else { vec![asked.clone()] })
        .collect();
    let mut trials = Vec::new();
    for label in &labels {
        let healthy = label == "healthy";
        let named = || label.split('+').map(|s| s.trim().to_owned()).collect();
        let effects: Vec<String> = if healthy { Vec::new() } else { named() };
        for &depth in if healthy { &[1.0][..] } else { &arguments.depths } {
            for seed in arguments.first_seed..arguments.first_seed + arguments.seeds {
                let probe = seed % 2 == 0;
                let seed = mixed(label, depth, seed);
                let spec = CutCaseSpec { effects: effects.clone(), depth, seed, probe };
                trials.push(CutTrial { label: label.clone(), spec });
            }
        }
    }
    trials
}
