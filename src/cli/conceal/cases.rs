//! A case as a folder: what a shop would hand over, and beside it the truth for the judge.

use super::Trial;
use crate::cli::bad_input;
use crate::config::machine::machine_to_text;
use crate::plant::machine::AxisModel;
use crate::recording::{write_recording, write_whole};
use crate::simulation::concealed_axis::Case;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Name of the folder of a case.
pub(super) fn folder_name(trial: &Trial) -> String {
    format!("{}-d{}-s{}", trial.label.replace('/', "."), trial.spec.depth, trial.spec.seed)
}

/// Writes model, recordings and `truth.json`.
pub(super) fn write_case(folder: &Path, trial: &Trial, case: &Case) -> anyhow::Result<()> {
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
            json!({
                "effect": h.name, "port": h.port.name(), "scale": h.depth,
                "parameters_at_scale_1": parameters,
            })
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
