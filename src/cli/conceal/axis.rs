//! `stillcut conceal --model`: axes that hide something. As a folder a case is what a shop would hand over,
//! and beside it the truth for the judge.

use super::{Arguments, Bench, Handed, Trial, judge};
use crate::cli::bad_input;
use crate::config::machine::{machine_to_text, read_machine};
use crate::plant::machine::{AxisModel, Machine};
use crate::report::study::Outcome;
use crate::simulation::concealed_axis::{Case, CaseError, CaseSpec, OUTSIDE, conceal, feed_drive_effects};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Axes around a model.
pub(super) struct AxisBench {
    machine: Machine,
    model_error: f64,
    background: f64,
}

impl AxisBench {
    /// Errors: no such model.
    pub(super) fn read(model: &Path, arguments: &Arguments) -> anyhow::Result<Self> {
        let machine = read_machine(model).map_err(bad_input)?;
        Ok(Self { machine, model_error: arguments.model_error, background: arguments.background })
    }
}

impl Bench for AxisBench {
    type Case = Case;

    fn model(&self) -> String {
        self.machine.name.clone()
    }

    fn every(&self) -> Vec<&'static str> {
        feed_drive_effects().into_iter().chain(OUTSIDE).collect()
    }

    fn check(&self, effect: &str) -> anyhow::Result<()> {
        let known = self.every().contains(&effect)
            || matches!(effect, "position_periodic_force" | "encoder_interpolation_error");
        if known { Ok(()) } else { Err(bad_input(CaseError::UnknownEffect { name: effect.to_owned() })) }
    }

    fn draw(&self, trial: &Trial) -> anyhow::Result<Case> {
        let Some(axis) = self.machine.axes.first() else {
            return Err(bad_input(CaseError::Structure { axis: "(none)".into(), key: "axis" }));
        };
        let spec = CaseSpec {
            effects: trial.effects.clone(),
            depth: trial.depth,
            seed: trial.seed,
            model_error: self.model_error,
            background: self.background,
            ..CaseSpec::default()
        };
        conceal(axis, self.machine.sample_rate, &spec).map_err(bad_input)
    }

    fn judge(&self, trial: &Trial, case: &Case) -> anyhow::Result<Outcome> {
        judge::judge(trial, case)
    }

    fn handed<'a>(&self, trial: &Trial, case: &'a Case) -> Handed<'a> {
        Handed {
            model: ("machine.toml", machine_to_text(&case.model)),
            recordings: &case.recordings,
            truth: truth(trial, case),
        }
    }
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
        "seed": trial.seed,
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
