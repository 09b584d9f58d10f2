//! `lathe.toml`: reading a [`Scenario`] (contracts, section 3). A key that is not given has the default
//! of the contract's example; a key that is not known is refused by name.

use super::{ConfigError, parse, read_text};
use crate::plant::cutting::RawCutting;
use crate::plant::scenario::{RawScenario, Scenario};
use crate::plant::workpiece::{RawWorkpiece, ScenarioError};
use serde::Deserialize;
use std::path::Path;

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct ScenarioToml {
    workpiece: WorkpieceToml,
    cutting: CuttingToml,
    spindle: SpindleToml,
    tools: ToolsToml,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct WorkpieceToml {
    diameter_m: Option<f64>,
    projection_length_m: Option<f64>,
    elastic_modulus_pa: Option<f64>,
    density_kg_m3: Option<f64>,
    damping_ratio: Option<f64>,
    clamp_factor: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct CuttingToml {
    radial_stiffness_pa: Option<f64>,
    width_m: Option<f64>,
    feed_m_rev: Option<f64>,
    process_damping_n: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct SpindleToml {
    speed_rpm: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct ToolsToml {
    position_m: Option<f64>,
    travel_m_s: Option<f64>,
    pitch_difference_rad: Option<f64>,
}

/// Reads a scenario. Errors: one line with file, place and what was expected.
pub fn read_scenario(path: &Path) -> Result<Scenario, ConfigError> {
    scenario_from_text(path, &read_text(path, "scenario")?)
}

/// Parses a scenario; `path` only names the source in errors.
pub fn scenario_from_text(path: &Path, text: &str) -> Result<Scenario, ConfigError> {
    let toml: ScenarioToml = parse(path, text)?;
    Scenario::new(&raw_from(&toml)).map_err(|error| {
        let ScenarioError::NotPhysical { name, .. } = &error;
        ConfigError::Content {
            path: path.to_owned(),
            place: table_of(name).to_owned(),
            message: error.to_string(),
        }
    })
}

fn raw_from(toml: &ScenarioToml) -> RawScenario {
    let (bar, cut) = (RawWorkpiece::default(), RawCutting::default());
    let default = RawScenario::default();
    RawScenario {
        workpiece: RawWorkpiece {
            diameter_m: toml.workpiece.diameter_m.unwrap_or(bar.diameter_m),
            projection_length_m: toml.workpiece.projection_length_m.unwrap_or(bar.projection_length_m),
            elastic_modulus_pa: toml.workpiece.elastic_modulus_pa.unwrap_or(bar.elastic_modulus_pa),
            density_kg_m3: toml.workpiece.density_kg_m3.unwrap_or(bar.density_kg_m3),
            damping_ratio: toml.workpiece.damping_ratio.unwrap_or(bar.damping_ratio),
            clamp_factor: toml.workpiece.clamp_factor.unwrap_or(bar.clamp_factor),
        },
        cutting: RawCutting {
            radial_stiffness_pa: toml.cutting.radial_stiffness_pa.unwrap_or(cut.radial_stiffness_pa),
            width_m: toml.cutting.width_m.unwrap_or(cut.width_m),
            feed_m_rev: toml.cutting.feed_m_rev.unwrap_or(cut.feed_m_rev),
            process_damping_n: toml.cutting.process_damping_n.unwrap_or(cut.process_damping_n),
        },
        speed_rpm: toml.spindle.speed_rpm.unwrap_or(default.speed_rpm),
        position_m: toml.tools.position_m.or(default.position_m),
        travel_m_s: toml.tools.travel_m_s.unwrap_or(default.travel_m_s),
        pitch_difference_rad: toml.tools.pitch_difference_rad.unwrap_or(default.pitch_difference_rad),
    }
}

fn table_of(key: &str) -> &'static str {
    match key {
        "radial_stiffness_pa" | "width_m" | "feed_m_rev" | "process_damping_n" => "cutting",
        "speed_rpm" => "spindle",
        "position_m" | "travel_m_s" | "pitch_difference_rad" => "tools",
        _ => "workpiece",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Scenario, String> {
        scenario_from_text(Path::new("lathe.toml"), text).map_err(|e| e.to_string())
    }

    #[test]
    fn nothing_given_is_the_default_cut() {
        assert_eq!(read("").unwrap(), Scenario::default());
    }

    #[test]
    fn what_is_given_is_taken() {
        let scenario = read("[spindle]\nspeed_rpm = 900\n[tools]\nposition_m = 0.1\n").unwrap();
        assert!((scenario.spindle.rpm() - 900.0).abs() < 1e-12);
        assert!((scenario.tools.position_m() - 0.1).abs() < 1e-15);
    }

    #[test]
    fn unknown_and_unphysical_keys_are_refused_by_name() {
        assert!(read("[tools]\npitch = 1\n").unwrap_err().contains("unknown field `pitch`"));
        assert_eq!(
            read("[cutting]\nradial_stiffness_pa = 0.0\n").unwrap_err(),
            "lathe.toml: cutting: radial_stiffness_pa = 0 is not physical: a finite number above zero"
        );
    }
}
