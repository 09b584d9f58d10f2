//! `machine.toml` and `model.toml`: reading and writing a [`Machine`] (contracts, section 2).

use super::{ConfigError, parse, read_text};
use crate::plant::drive::{DriveParams, RawDriveParams};
use crate::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};
use crate::plant::machine::{AxisModel, Controller, Machine};
use crate::units::SampleRate;
use serde::Deserialize;
use std::fmt::Write as _;
use std::path::Path;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct MachineToml {
    machine: HeadToml,
    axes: toml::Table,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct HeadToml {
    name: String,
    sample_rate_hz: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ControllerToml {
    position_gain_1_s: f64,
    velocity_gain_1_s: f64,
    #[serde(default)]
    velocity_integral_1_s: f64,
    velocity_filter_rad_s: f64,
}

macro_rules! drive_keys {
    ($($key:ident),* $(,)?) => {
        const DRIVE_KEYS: &[&str] = &[$(stringify!($key)),*];

        fn set_drive_key(raw: &mut RawDriveParams, key: &str, value: f64) {
            match key { $(stringify!($key) => raw.$key = Some(value),)* _ => {} }
        }

        fn drive_values(raw: &RawDriveParams) -> Vec<(&'static str, f64)> {
            [$((stringify!($key), raw.$key)),*].into_iter().filter_map(|(k, v)| v.map(|v| (k, v))).collect()
        }
    };
}

drive_keys!(
    screw_lead_m,
    rotary_inertia_kg_m2,
    movable_mass_kg,
    torque_constant_nm_a,
    axial_stiffness_n_m,
    structural_damping_n_s_m,
    rotary_damping_nm_s_rad,
    translational_damping_n_s_m,
    stage_coulomb_friction_n,
    motor_coulomb_friction_n,
    friction_smoothing_m_s,
    current_loop_bandwidth_rad_s,
    amplifier_dead_time_s,
    motor_encoder_delay_s,
    stage_encoder_delay_s,
    motor_encoder_resolution_m,
    stage_encoder_resolution_m,
    motor_encoder_signals_per_rev,
    stage_encoder_signal_period_m,
    motor_pole_count,
    motor_slot_count,
    screw_inertia_kg_m2,
    torsional_stiffness_nm_rad,
    torsional_damping_nm_s_rad,
);

/// Reads a machine model. Errors: one line with file, place and what was expected.
pub fn read_machine(path: &Path) -> Result<Machine, ConfigError> {
    machine_from_text(path, &read_text(path, "machine model")?)
}

/// Parses a machine model; `path` only names the source in errors.
pub fn machine_from_text(path: &Path, text: &str) -> Result<Machine, ConfigError> {
    let raw: MachineToml = parse(path, text)?;
    let content =
        |place: String, message: String| ConfigError::Content { path: path.to_owned(), place, message };
    let sample_rate = SampleRate::new(raw.machine.sample_rate_hz)
        .map_err(|e| content("machine.sample_rate_hz".into(), e.to_string()))?;
    if raw.axes.is_empty() {
        return Err(content("axes".into(), "no axis is described; expected a table [axes.<name>]".into()));
    }
    let mut axes = Vec::new();
    for (name, value) in &raw.axes {
        let place = format!("axes.{name}");
        let toml::Value::Table(table) = value else {
            return Err(content(place, "expected a table".into()));
        };
        axes.push(
            axis_from_table(name, table)
                .map_err(|(key, message)| content(format!("{place}{key}"), message))?,
        );
    }
    Ok(Machine { name: raw.machine.name, sample_rate, axes })
}

type Complaint = (String, String);

fn axis_from_table(name: &str, table: &toml::Table) -> Result<AxisModel, Complaint> {
    let mut raw = RawDriveParams::default();
    let mut controller = None;
    let mut physics = Vec::new();
    for (key, value) in table {
        match key.as_str() {
            "controller" => controller = Some(controller_from(value)?),
            "physics" => physics = physics_from(value)?,
            k if DRIVE_KEYS.contains(&k) => {
                let number =
                    number(value).ok_or_else(|| (format!(".{k}"), "expected a number".to_owned()))?;
                set_drive_key(&mut raw, k, number);
            }
            k => return Err((format!(".{k}"), format!("unknown key `{k}`{}", nearest(k, DRIVE_KEYS)))),
        }
    }
    let drive = DriveParams::new(raw).map_err(|e| (String::new(), e.to_string()))?;
    Ok(AxisModel { name: name.to_owned(), drive, controller, physics })
}

fn controller_from(value: &toml::Value) -> Result<Controller, Complaint> {
    let raw: ControllerToml = value
        .clone()
        .try_into()
        .map_err(|e: toml::de::Error| (".controller".to_owned(), e.message().replace('\n', " ")))?;
    let gains = [
        ("position_gain_1_s", raw.position_gain_1_s),
        ("velocity_gain_1_s", raw.velocity_gain_1_s),
        ("velocity_integral_1_s", raw.velocity_integral_1_s),
        ("velocity_filter_rad_s", raw.velocity_filter_rad_s),
    ];
    for (key, gain) in gains {
        if !(gain.is_finite() && gain >= 0.0) {
            return Err((
                format!(".controller.{key}"),
                format!("{gain} is not physical: zero or a number above"),
            ));
        }
    }
    Ok(Controller {
        position_gain_1_s: raw.position_gain_1_s,
        velocity_gain_1_s: raw.velocity_gain_1_s,
        velocity_integral_1_s: raw.velocity_integral_1_s,
        velocity_filter_rad_s: raw.velocity_filter_rad_s,
    })
}

fn physics_from(value: &toml::Value) -> Result<Vec<PhysicsTerm>, Complaint> {
    let place = || ".physics".to_owned();
    let toml::Value::Array(tables) = value else {
        return Err((place(), "expected tables [[axes.<axis>.physics]]".into()));
    };
    let mut terms = Vec::new();
    for (index, table) in tables.iter().enumerate() {
        let at = |key: &str| format!(".physics[{index}]{key}");
        let toml::Value::Table(table) = table else {
            return Err((at(""), "expected a table".into()));
        };
        let text = |key: &str| {
            table
                .get(key)
                .and_then(toml::Value::as_str)
                .ok_or_else(|| (at(""), format!("{key} = \"...\" is missing")))
        };
        let effect_name = text("effect")?;
        let effect = EffectKind::from_name(effect_name)
            .ok_or_else(|| (at(".effect"), format!("unknown effect `{effect_name}`")))?;
        let port_name = text("port")?;
        let port =
            Port::from_name(port_name).ok_or_else(|| (at(".port"), format!("unknown port `{port_name}`")))?;
        let mut parameters = Vec::new();
        for (key, value) in table.iter().filter(|(k, _)| !matches!(k.as_str(), "effect" | "port")) {
            let expected =
                || (at(&format!(".{key}")), "expected a finite number or a list of them".to_owned());
            let value = match value {
                toml::Value::Array(list) => {
                    ParameterValue::List(list.iter().map(number).collect::<Option<_>>().ok_or_else(expected)?)
                }
                other => ParameterValue::Number(number(other).ok_or_else(expected)?),
            };
            parameters.push((key.clone(), value));
        }
        terms.push(PhysicsTerm { effect, port, parameters });
    }
    Ok(terms)
}

fn number(value: &toml::Value) -> Option<f64> {
    match value {
        toml::Value::Float(x) if x.is_finite() => Some(*x),
        toml::Value::Integer(i) => Some(*i as f64),
        _ => None,
    }
}

/// `; did you mean ...?` when one of `known` is close to `key`.
#[must_use]
pub fn nearest(key: &str, known: &[&str]) -> String {
    let best = known.iter().map(|k| (edit_distance(key, k), *k)).min();
    match best {
        Some((distance, name)) if distance <= key.len() / 3 + 1 => format!("; did you mean `{name}`?"),
        _ => String::new(),
    }
}

fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let replaced = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row.last().copied().unwrap_or(0)
}

/// Text of a model file that [`machine_from_text`] reads back to the same machine.
#[must_use]
pub fn machine_to_text(machine: &Machine) -> String {
    let mut out = String::new();
    let _ = writeln!(out, "# Machine model. SI units; keys in docs/symbols.md.\n[machine]");
    let _ = writeln!(out, "name = {}", toml::Value::String(machine.name.clone()));
    let _ = writeln!(out, "sample_rate_hz = {:?}", machine.sample_rate.hz());
    for axis in &machine.axes {
        let key = toml_key(&axis.name);
        let _ = writeln!(out, "\n[axes.{key}]");
        for (name, value) in drive_values(axis.drive.raw()) {
            let _ = writeln!(out, "{name} = {value:?}");
        }
        if let Some(c) = &axis.controller {
            let _ = writeln!(out, "\n[axes.{key}.controller]");
            let _ = writeln!(out, "position_gain_1_s = {:?}", c.position_gain_1_s);
            let _ = writeln!(out, "velocity_gain_1_s = {:?}", c.velocity_gain_1_s);
            let _ = writeln!(out, "velocity_integral_1_s = {:?}", c.velocity_integral_1_s);
            let _ = writeln!(out, "velocity_filter_rad_s = {:?}", c.velocity_filter_rad_s);
        }
        for term in &axis.physics {
            let _ = writeln!(
                out,
                "\n[[axes.{key}.physics]]\neffect = \"{}\"\nport = \"{}\"",
                term.effect, term.port
            );
            for (name, value) in &term.parameters {
                match value {
                    ParameterValue::Number(x) => {
                        let _ = writeln!(out, "{} = {x:?}", toml_key(name));
                    }
                    ParameterValue::List(list) => {
                        let _ = writeln!(out, "{} = {list:?}", toml_key(name));
                    }
                }
            }
        }
    }
    out
}

fn toml_key(name: &str) -> String {
    let bare = !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
    if bare { name.to_owned() } else { toml::Value::String(name.to_owned()).to_string() }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
[machine]
name = "m"
sample_rate_hz = 1000.0
[axes.x]
movable_mass_kg = 95.109
[[axes.x.physics]]
effect = "gravity_load"
port = "stage"
force_n = -3.165
"#;

    fn read(text: &str) -> Result<Machine, String> {
        machine_from_text(Path::new("m.toml"), text).map_err(|e| e.to_string())
    }

    #[test]
    fn what_is_written_reads_back_to_the_same_machine() {
        let machine = read(TEXT).unwrap();
        assert_eq!(read(&machine_to_text(&machine)).unwrap(), machine);
    }

    #[test]
    fn an_unknown_key_is_refused_by_name() {
        let text = TEXT.replace("movable_mass_kg", "moveable_mass_kg");
        assert_eq!(
            read(&text).unwrap_err(),
            "m.toml: axes.x.moveable_mass_kg: unknown key `moveable_mass_kg`; did you mean `movable_mass_kg`?"
        );
    }

    #[test]
    fn an_unphysical_value_is_refused() {
        let text = TEXT.replace("95.109", "-1.0");
        assert!(read(&text).unwrap_err().contains("movable_mass_kg = -1 is not physical"));
    }
}
