//! `stillcut conceal`: machines that hide something, and the diagnosis judged blind on them.

use super::bad_input;
use crate::config::machine::{machine_to_text, read_machine};
use crate::plant::machine::AxisModel;
use crate::recording::{write_recording, write_whole};
use crate::simulation::concealed_axis::{Case, CaseSpec, OUTSIDE, conceal, feed_drive_effects};
use serde_json::{Map, Value, json};
use std::path::{Path, PathBuf};

/// Judges the diagnosis blind on simulated machines with a hidden effect.
///
/// Draws machines around a model, hides effects in them at each depth, records three experiments of
/// each with a plant richer than any model, runs the diagnosis blind and reports how often it noticed
/// and how often it named the cause.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Model to draw machines around: an axis of two inertias.
    #[arg(long)]
    model: PathBuf,
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
    let machine = read_machine(&arguments.model).map_err(bad_input)?;
    let axis = machine.axes.first().ok_or_else(|| bad_input("the model has no axis"))?;
    let trials = plan(&arguments);
    std::fs::create_dir_all(&arguments.out)
        .map_err(|e| bad_input(format!("{}: {e}", arguments.out.display())))?;
    for trial in &trials {
        let case = conceal(axis, machine.sample_rate, &trial.spec).map_err(bad_input)?;
        let folder = arguments.out.join(folder_name(trial));
        write_case(&folder, trial, &case)?;
    }
    Ok(())
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

fn folder_name(trial: &Trial) -> String {
    format!("{}-d{}-s{}", trial.label.replace('/', "."), trial.spec.depth, trial.spec.seed)
}

fn write_case(folder: &Path, trial: &Trial, case: &Case) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).map_err(|e| bad_input(format!("{}: {e}", folder.display())))?;
    write_whole(&folder.join("machine.toml"), machine_to_text(&case.model).as_bytes())?;
    for recording in &case.recordings {
        write_recording(&folder.join(format!("{}.parquet", recording.experiment)), recording)?;
    }
    let text = serde_json::to_string_pretty(&truth(trial, case))?;
    write_whole(&folder.join("truth.json"), text.as_bytes())?;
    Ok(())
}

fn truth(trial: &Trial, case: &Case) -> Value {
    let missing: Vec<Value> = case
        .hidden
        .iter()
        .map(|h| {
            let parameters: Map<String, Value> =
                h.parameters.iter().map(|(k, v)| ((*k).to_owned(), json!(v))).collect();
            json!({"effect": h.name, "port": h.port.name(), "scale": h.depth, "parameters_at_scale_1": parameters})
        })
        .collect();
    let d = &case.truth;
    let travel = case.model.axes.first().map_or(1.0, |a: &AxisModel| a.drive.travel_m_rad());
    json!({
        "seed": trial.spec.seed,
        "missing": missing,
        "actual": {
            "Jr": d.reflected_mass_kg * travel * travel, "Mt": d.movable_mass_kg,
            "Kt": d.thrust_constant_n_a * travel, "Kr": d.axial_stiffness_n_m,
            "Ck": d.structural_damping_n_s_m, "Dr": d.reflected_damping_n_s_m * travel * travel,
            "Ct": d.translational_damping_n_s_m, "Fc_t": d.stage_coulomb_friction_n,
            "Fc_m": d.motor_coulomb_friction_n,
        },
    })
}
