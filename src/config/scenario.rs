//! `lathe.toml`: reading and writing a [`Scenario`] (contracts, section 3). A key that is not given has the
//! default of the contract's example; a key that is not known is refused by name.

use super::machine::nearest;
use super::{ConfigError, parse, read_text};
use crate::plant::cut_effects::{CutEffect, MOST_PARAMETERS, Physics, Specification};
use crate::plant::cut_terms::CutReferences;
use crate::plant::cutting::RawCutting;
use crate::plant::effects::{EffectKind, Port};
use crate::plant::scenario::{RawScenario, Scenario, ToolCount};
use crate::plant::scenario_error::ScenarioError;
use crate::plant::workpiece::{RawWorkpiece, TapTest};
use serde::Deserialize;
use std::fmt::Write as _;
use std::path::Path;

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct ScenarioToml {
    workpiece: WorkpieceToml,
    cutting: CuttingToml,
    spindle: SpindleToml,
    tools: ToolsToml,
    physics: Vec<toml::Table>,
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
    natural_frequency_hz: Option<f64>,
    modal_stiffness_n_m: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct CuttingToml {
    radial_stiffness_pa: Option<f64>,
    width_m: Option<f64>,
    feed_m_rev: Option<f64>,
    process_damping_n: Option<f64>,
    regeneration: Option<bool>,
    clearance_rad: Option<f64>,
    flank_force_n: Option<f64>,
    tangential_ratio: Option<f64>,
    edge_force_n: Option<f64>,
    exponent: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct SpindleToml {
    speed_rpm: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct ToolsToml {
    count: Option<u32>,
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
    let content =
        |(place, message): Complaint| ConfigError::Content { path: path.to_owned(), place, message };
    let mut raw = raw_from(&toml).map_err(content)?;
    let refused = |error: ScenarioError| content((table_of(&error).to_owned(), error.to_string()));
    // The numbers first: what the effects are referred to follows from them.
    let reference = CutReferences::of(&Scenario::new(&raw).map_err(refused)?);
    raw.physics = physics_from(&toml.physics, &reference).map_err(content)?;
    Scenario::new(&raw).map_err(refused)
}

/// Place and message of an error.
type Complaint = (String, String);

fn raw_from(toml: &ScenarioToml) -> Result<RawScenario, Complaint> {
    let cut = RawCutting::default();
    let default = RawScenario::default();
    let tool_count = match toml.tools.count {
        None | Some(2) => ToolCount::Two,
        Some(1) => ToolCount::One,
        Some(other) => return Err(("tools".into(), format!("count = {other}: expected 1 or 2"))),
    };
    let given = &toml.cutting;
    Ok(RawScenario {
        workpiece: workpiece_from(&toml.workpiece)?,
        cutting: RawCutting {
            radial_stiffness_pa: given.radial_stiffness_pa.unwrap_or(cut.radial_stiffness_pa),
            width_m: given.width_m.unwrap_or(cut.width_m),
            feed_m_rev: given.feed_m_rev.unwrap_or(cut.feed_m_rev),
            process_damping_n: given.process_damping_n.unwrap_or(cut.process_damping_n),
            regeneration: given.regeneration.unwrap_or(cut.regeneration),
            clearance_rad: given.clearance_rad.unwrap_or(cut.clearance_rad),
            flank_force_n: given.flank_force_n.unwrap_or(cut.flank_force_n),
            tangential_ratio: given.tangential_ratio.unwrap_or(cut.tangential_ratio),
            edge_force_n: given.edge_force_n.unwrap_or(cut.edge_force_n),
            exponent: given.exponent.unwrap_or(cut.exponent),
        },
        speed_rpm: toml.spindle.speed_rpm.unwrap_or(default.speed_rpm),
        tool_count,
        position_m: toml.tools.position_m.or(default.position_m),
        travel_m_s: toml.tools.travel_m_s.unwrap_or(default.travel_m_s),
        pitch_difference_rad: toml.tools.pitch_difference_rad.unwrap_or(default.pitch_difference_rad),
        physics: Physics::default(),
    })
}

fn workpiece_from(toml: &WorkpieceToml) -> Result<RawWorkpiece, Complaint> {
    let bar = RawWorkpiece::default();
    let tap_test = match (toml.natural_frequency_hz, toml.modal_stiffness_n_m) {
        (None, None) => None,
        (Some(natural_frequency_hz), Some(modal_stiffness_n_m)) => {
            Some(TapTest { natural_frequency_hz, modal_stiffness_n_m })
        }
        _ => {
            let both = "natural_frequency_hz and modal_stiffness_n_m: expected both or neither";
            return Err(("workpiece".into(), both.into()));
        }
    };
    let beside = [
        ("elastic_modulus_pa", toml.elastic_modulus_pa),
        ("density_kg_m3", toml.density_kg_m3),
        ("clamp_factor", toml.clamp_factor),
    ];
    if let (Some(_), Some((name, _))) = (tap_test, beside.iter().find(|(_, value)| value.is_some())) {
        let instead = format!("{name} beside natural_frequency_hz: expected one description of the bar");
        return Err(("workpiece".into(), instead));
    }
    Ok(RawWorkpiece {
        diameter_m: toml.diameter_m.unwrap_or(bar.diameter_m),
        projection_length_m: toml.projection_length_m.unwrap_or(bar.projection_length_m),
        elastic_modulus_pa: toml.elastic_modulus_pa.unwrap_or(bar.elastic_modulus_pa),
        density_kg_m3: toml.density_kg_m3.unwrap_or(bar.density_kg_m3),
        damping_ratio: toml.damping_ratio.unwrap_or(bar.damping_ratio),
        clamp_factor: toml.clamp_factor.unwrap_or(bar.clamp_factor),
        tap_test,
    })
}

fn physics_from(tables: &[toml::Table], reference: &CutReferences) -> Result<Physics, Complaint> {
    let mut physics = Physics::default();
    for (index, table) in tables.iter().enumerate() {
        let at = |key: &str| format!("physics[{index}]{key}");
        let effect = effect_from(table, reference).map_err(|(key, message)| (at(&key), message))?;
        physics = physics.with(effect).map_err(|error| (at(""), error.to_string()))?;
    }
    Ok(physics)
}

fn effect_from(table: &toml::Table, reference: &CutReferences) -> Result<CutEffect, Complaint> {
    let text = |key: &str| {
        let found = table.get(key).and_then(toml::Value::as_str);
        found.ok_or_else(|| (String::new(), format!("{key} = \"...\" is missing")))
    };
    let name = text("effect")?;
    let specification = EffectKind::from_name(name).and_then(Specification::of).ok_or_else(|| {
        let known: Vec<&str> = CutEffect::SPECIFICATIONS.iter().map(|s| s.kind.name()).collect();
        (".effect".to_owned(), format!("unknown effect of the cut `{name}`{}", nearest(name, &known)))
    })?;
    let port = text("port")?;
    if Port::from_name(port) != Some(specification.port) {
        let expected = format!("`{port}` for {name}: expected `{}`", specification.port);
        return Err((".port".to_owned(), expected));
    }
    let mut values = [f64::NAN; MOST_PARAMETERS];
    for (key, value) in table.iter().filter(|(k, _)| !matches!(k.as_str(), "effect" | "port")) {
        let number = value
            .as_float()
            .or(value.as_integer().map(|i| i as f64))
            .filter(|x| x.is_finite())
            .ok_or_else(|| (format!(".{key}"), "expected a finite number".to_owned()))?;
        let own = specification.parameters.iter().position(|p| p.name == key);
        let same = specification.equivalents.iter().find(|e| e.name == key);
        match (own, same) {
            (Some(k), _) => values[k] = number,
            (None, Some(equivalent)) => {
                if let Some(to_key) = equivalent.to_key.filter(|_| values[0].is_nan()) {
                    values[0] = to_key(number, reference);
                }
            }
            (None, None) => return Err((format!(".{key}"), unknown_parameter(specification, key))),
        }
    }
    // The key itself, where it is given too, rules over its equivalent, whichever comes first.
    let key = specification.parameters[0].name;
    if let Some(given) = table.get(key).and_then(|v| v.as_float().or(v.as_integer().map(|i| i as f64))) {
        values[0] = given;
    }
    for (value, parameter) in values.iter_mut().zip(specification.parameters) {
        if value.is_nan()
            && parameter.neutral.is_infinite()
            && specification.kind == EffectKind::ForceSensorLag
        {
            *value = f64::INFINITY;
        } else if value.is_nan() {
            return Err((String::new(), format!("{name}: {} is missing", parameter.name)));
        }
    }
    let values = values.map(|v| if v.is_nan() { 0.0 } else { v });
    CutEffect::new(specification.kind, values)
        .ok_or_else(|| (".effect".to_owned(), format!("unknown effect of the cut `{name}`")))
}

fn unknown_parameter(specification: &Specification, key: &str) -> String {
    let own = specification.parameters.iter().map(|p| p.name);
    let known: Vec<&str> = own.chain(specification.equivalents.iter().map(|e| e.name)).collect();
    format!("unknown parameter `{key}` of {}{}", specification.kind, nearest(key, &known))
}

/// Text of a scenario that [`scenario_from_text`] reads back to the same scenario.
#[must_use]
pub fn scenario_to_text(scenario: &Scenario) -> String {
    let raw = scenario.raw();
    let mut out = String::from("# Scenario of a cut. SI units; keys in docs/symbols.md.\n");
    let mut table = |name: &str, numbers: &[(&str, f64)], more: &str| {
        let _ = writeln!(out, "[{name}]");
        for (key, value) in numbers {
            let _ = writeln!(out, "{key} = {value:?}");
        }
        let _ = writeln!(out, "{more}");
    };
    let bar = &raw.workpiece;
    let mut numbers = vec![("diameter_m", bar.diameter_m), ("projection_length_m", bar.projection_length_m)];
    match bar.tap_test {
        Some(tap) => numbers.extend([
            ("natural_frequency_hz", tap.natural_frequency_hz),
            ("modal_stiffness_n_m", tap.modal_stiffness_n_m),
        ]),
        None => numbers.extend([
            ("elastic_modulus_pa", bar.elastic_modulus_pa),
            ("density_kg_m3", bar.density_kg_m3),
            ("clamp_factor", bar.clamp_factor),
        ]),
    }
    numbers.push(("damping_ratio", bar.damping_ratio));
    table("workpiece", &numbers, "");
    let cut = &raw.cutting;
    let numbers = [
        ("radial_stiffness_pa", cut.radial_stiffness_pa),
        ("width_m", cut.width_m),
        ("feed_m_rev", cut.feed_m_rev),
        ("process_damping_n", cut.process_damping_n),
        ("clearance_rad", cut.clearance_rad),
        ("flank_force_n", cut.flank_force_n),
        ("tangential_ratio", cut.tangential_ratio),
        ("edge_force_n", cut.edge_force_n),
        ("exponent", cut.exponent),
    ];
    table("cutting", &numbers, &format!("regeneration = {}\n", cut.regeneration));
    table("spindle", &[("speed_rpm", raw.speed_rpm)], "");
    let count = if raw.tool_count == ToolCount::One { 1 } else { 2 };
    let numbers = [
        ("position_m", scenario.tools.position_m()),
        ("travel_m_s", raw.travel_m_s),
        ("pitch_difference_rad", raw.pitch_difference_rad),
    ];
    table("tools", &numbers, &format!("count = {count}"));
    let reference = CutReferences::of(scenario);
    for effect in raw.physics.iter() {
        let (kind, port) = (effect.kind(), effect.port());
        let _ = writeln!(out, "\n[[physics]]\neffect = \"{kind}\"\nport = \"{port}\"");
        for (name, value) in effect.named_values(&reference) {
            let _ = writeln!(out, "{name} = {value:?}");
        }
    }
    out
}

fn table_of(error: &ScenarioError) -> &'static str {
    let ScenarioError::NotPhysical { name, .. } = error else { return "physics" };
    match *name {
        "radial_stiffness_pa"
        | "width_m"
        | "feed_m_rev"
        | "process_damping_n"
        | "clearance_rad"
        | "flank_force_n"
        | "tangential_ratio"
        | "edge_force_n"
        | "exponent" => "cutting",
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

    const TURRET: &str = "[[physics]]\neffect = \"turret_compliance\"\nport = \"turret\"\nn_m = 8.0e6\n\
                          frequency_hz = 620\ndamping_ratio = 0.03\n";

    #[test]
    fn what_is_written_reads_back_to_the_same_scenario() {
        let damped = "[cutting]\nprocess_damping_n = 0\nregeneration = false\n[tools]\ncount = 1\n\
                      [workpiece]\nnatural_frequency_hz = 94\nmodal_stiffness_n_m = 4e6\n\
                      [[physics]]\neffect = \"process_damping\"\nport = \"process\"\nn_s_m = 20.0\n\
                      [[physics]]\neffect = \"regenerative_effect\"\nport = \"process\"\noverlap = 0.9\n";
        for text in ["", TURRET, damped] {
            let scenario = read(text).unwrap();
            assert_eq!(read(&scenario_to_text(&scenario)).unwrap(), scenario, "{text}");
        }
        let overlap = read(damped).unwrap().physics.get(EffectKind::RegenerativeEffect).unwrap();
        assert!((overlap.value("overlap").unwrap() - 0.9).abs() < 1e-12);
    }

    #[test]
    fn every_effect_is_written_and_read() {
        for specification in CutEffect::SPECIFICATIONS {
            let mut values = [0.0; MOST_PARAMETERS];
            for (value, parameter) in values.iter_mut().zip(specification.parameters) {
                *value = parameter.scale;
            }
            let effect = CutEffect::new(specification.kind, values).unwrap();
            let cutting = RawCutting { process_damping_n: 0.0, regeneration: false, ..RawCutting::default() };
            let physics = Physics::new(&[effect]).unwrap();
            let scenario =
                Scenario::new(&RawScenario { cutting, physics, ..RawScenario::default() }).unwrap();
            assert_eq!(read(&scenario_to_text(&scenario)).unwrap(), scenario, "{}", specification.kind);
        }
    }

    #[test]
    fn unknown_effects_parameters_and_ports_are_refused_by_name() {
        let refused = [
            (TURRET.replace("turret_compliance", "turret_complience"), "did you mean `turret_compliance`?"),
            (TURRET.replace("n_m =", "n_mm ="), "physics[0].n_mm: unknown parameter `n_mm` of turret"),
            (TURRET.replace("\"turret\"", "\"bar\""), "physics[0].port: `bar` for turret_compliance"),
            (TURRET.replace("damping_ratio = 0.03\n", ""), "damping_ratio is missing"),
            (TURRET.replace("8.0e6", "-8.0e6"), "n_m = -8000000 is not physical"),
            (format!("{TURRET}{TURRET}"), "turret_compliance stands there twice"),
            (TURRET.replace("turret_compliance", "backlash"), "unknown effect of the cut `backlash`"),
            ("[tools]\ncount = 3\n".to_owned(), "count = 3: expected 1 or 2"),
            ("[workpiece]\nnatural_frequency_hz = 9\n".to_owned(), "expected both or neither"),
        ];
        for (text, why) in refused {
            let error = read(&text).unwrap_err();
            assert!(error.contains(why) && !error.contains('\n'), "{error}");
        }
        let stated =
            "[[physics]]\neffect = \"process_damping\"\nport = \"process\"\nprocess_damping_n = 5.0\n";
        assert!(read(stated).unwrap_err().contains("only where the scenario says process_damping_n = 0"));
    }
}
