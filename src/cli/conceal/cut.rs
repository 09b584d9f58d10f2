//! `stillcut conceal --scenario`: machines whose cut hides something.

use super::{Bench, Handed, Trial, cut_judge};
use crate::cli::bad_input;
use crate::config::scenario::{read_scenario, scenario_to_text};
use crate::plant::scenario::Scenario;
use crate::report::study::Outcome;
use crate::simulation::concealed_cut::{
    CUT_EFFECTS, CUT_OUTSIDE, CutCase, CutCaseError, CutCaseSpec, HiddenCut, conceal_cut,
};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Lathes around a scenario; half of them have a probe.
pub(super) struct CutBench {
    scenario: Scenario,
    name: String,
}

impl CutBench {
    /// Errors: no such scenario.
    pub(super) fn read(path: &Path) -> anyhow::Result<Self> {
        let scenario = read_scenario(path).map_err(bad_input)?;
        Ok(Self { scenario, name: path.display().to_string() })
    }
}

impl Bench for CutBench {
    type Case = CutCase;

    fn model(&self) -> String {
        self.name.clone()
    }

    fn every(&self) -> Vec<&'static str> {
        CUT_EFFECTS.into_iter().chain(CUT_OUTSIDE).collect()
    }

    fn check(&self, effect: &str) -> anyhow::Result<()> {
        let known = self.every().contains(&effect);
        if known { Ok(()) } else { Err(bad_input(CutCaseError::UnknownEffect { name: effect.to_owned() })) }
    }

    fn draw(&self, trial: &Trial) -> anyhow::Result<CutCase> {
        let spec = CutCaseSpec {
            effects: trial.effects.clone(),
            depth: trial.depth,
            seed: trial.seed,
            probe: trial.number.is_multiple_of(2),
        };
        conceal_cut(&self.scenario, &spec).map_err(bad_input)
    }

    fn judge(&self, trial: &Trial, case: &CutCase) -> anyhow::Result<Outcome> {
        cut_judge::judge(trial, case)
    }

    fn handed<'a>(&self, trial: &Trial, case: &'a CutCase) -> Handed<'a> {
        Handed {
            model: ("scenario.toml", scenario_to_text(&case.scenario)),
            recordings: &case.recordings,
            truth: truth(trial, case),
        }
    }
}

fn truth(trial: &Trial, case: &CutCase) -> Value {
    let hidden = |h: &HiddenCut| {
        let parameters: Map<String, Value> =
            h.parameters.iter().map(|(k, v)| ((*k).to_owned(), json!(v))).collect();
        json!({"effect": h.name, "port": h.port.name(), "scale": h.depth, "parameters": parameters})
    };
    let t = &case.truth;
    json!({
        "seed": trial.seed,
        "missing": case.hidden.iter().map(hidden).collect::<Vec<Value>>(),
        "actual": {
            "radial_stiffness_pa": t.pressure_pa, "damping_ratio": t.damping_ratio,
            "clamp_factor": t.clamp_factor, "process_damping_n": t.flank_damping_n,
        },
    })
}
