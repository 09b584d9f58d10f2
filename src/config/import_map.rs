//! The map of a foreign file: which column is which signal, in which unit, at which rate.
//!
//! ```toml
//! [source]                 # all optional
//! delimiter = ";"          # CSV: one character; default ","
//! header_row = 4           # CSV: line of the names, from 1; 0: none, columns are "1", "2", ...
//! data_row = 6             # CSV: first line of numbers; default: the line after the names
//! [[source.keep]]          # only rows where a column lies in a range (ends included)
//! column = "segment"
//! from = 0
//! to = 4
//! [time]
//! column = "t"             # without it, sample_rate_hz is required
//! unit = "ms"
//! restarts = true          # the time begins again in each block: blocks are put end to end
//! [recording]
//! experiment = "trajectory"
//! sample_rate_hz = 1000.0  # what it should be: checked to 1 %
//! resample_hz = 400.0      # onto a uniform grid, for irregular times
//! metadata = { source = "..." }
//! [[signals]]
//! from = "vir"             # or `constant = 0.0` for what was not recorded but is known
//! to = "x_thrust_ref_n"
//! unit = "V"               # what the column is in
//! scale = 35.15            # unit to the unit of `to`; not needed where both measure the same
//! offset = 0.0             # subtracted first, in the column's unit
//! integrate = true         # sum over time: a position from a velocity
//! ```

use super::{ConfigError, parse, read_text};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

/// A map as it was typed.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct MapToml {
    #[serde(default)]
    source: Source,
    #[serde(default)]
    time: TimeToml,
    #[serde(default)]
    recording: RecordingToml,
    signals: Vec<SignalToml>,
}

/// How the file is read.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Source {
    /// CSV: what separates the columns.
    pub delimiter: char,
    /// CSV: line of the names, from 1; 0: none.
    pub header_row: usize,
    /// CSV: first line of numbers.
    pub data_row: Option<usize>,
    /// Only rows where these columns lie in these ranges.
    pub keep: Vec<Keep>,
}

impl Default for Source {
    fn default() -> Self {
        Self { delimiter: ',', header_row: 1, data_row: None, keep: Vec::new() }
    }
}

/// A condition on rows.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Keep {
    /// Column of the file.
    pub column: String,
    /// Lowest value that is kept.
    pub from: f64,
    /// Highest value that is kept.
    pub to: f64,
}

#[derive(Debug, Clone, PartialEq, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct TimeToml {
    column: Option<String>,
    unit: Option<String>,
    restarts: bool,
}

#[derive(Debug, Clone, PartialEq, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct RecordingToml {
    experiment: Option<String>,
    sample_rate_hz: Option<f64>,
    resample_hz: Option<f64>,
    metadata: BTreeMap<String, String>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct SignalToml {
    from: Option<String>,
    constant: Option<f64>,
    to: String,
    unit: Option<String>,
    scale: Option<f64>,
    #[serde(default)]
    offset: f64,
    #[serde(default)]
    integrate: bool,
}

/// Where a signal's values come from.
#[derive(Debug, Clone, PartialEq)]
pub enum Origin {
    /// A column of the file.
    Column(String),
    /// The same value in every row.
    Constant(f64),
}

/// A column of the recording and how it is made.
#[derive(Debug, Clone, PartialEq)]
pub struct Signal {
    /// Where the values come from.
    pub origin: Origin,
    /// Name in the recording.
    pub to: String,
    /// Factor from the file's unit.
    pub scale: f64,
    /// Subtracted before scaling.
    pub offset: f64,
    /// Summed over time.
    pub integrate: bool,
}

/// Where the time comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum Clock {
    /// A column of the file.
    Column {
        /// Its name.
        name: String,
        /// Seconds per unit.
        scale: f64,
        /// It begins again in each block.
        restarts: bool,
    },
    /// Rows are this far apart.
    Rate(f64),
}

/// A checked map.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportMap {
    /// How the file is read.
    pub source: Source,
    /// Time.
    pub clock: Clock,
    /// Free word.
    pub experiment: Option<String>,
    /// Rate that is expected.
    pub sample_rate_hz: Option<f64>,
    /// Rate of the grid to put the samples on.
    pub resample_hz: Option<f64>,
    /// Further metadata.
    pub metadata: Vec<(String, String)>,
    /// Signals.
    pub signals: Vec<Signal>,
}

/// What a unit measures, as a word, and its factor to SI.
const UNITS: [(&str, &str, f64); 41] = [
    ("s", "time", 1.0),
    ("ms", "time", 1.0e-3),
    ("us", "time", 1.0e-6),
    ("min", "time", 60.0),
    ("m", "length", 1.0),
    ("mm", "length", 1.0e-3),
    ("um", "length", 1.0e-6),
    ("nm_length", "length", 1.0e-9),
    ("in", "length", 0.0254),
    ("m/s", "velocity", 1.0),
    ("mm/s", "velocity", 1.0e-3),
    ("mm/min", "velocity", 1.0e-3 / 60.0),
    ("in/s", "velocity", 0.0254),
    ("m/s2", "acceleration", 1.0),
    ("g", "acceleration", 9.806_65),
    ("rad", "angle", 1.0),
    ("mrad", "angle", 1.0e-3),
    ("deg", "angle", std::f64::consts::PI / 180.0),
    ("arcmin", "angle", std::f64::consts::PI / 10_800.0),
    ("rev", "angle", std::f64::consts::TAU),
    ("rad/s", "angular velocity", 1.0),
    ("rpm", "angular velocity", std::f64::consts::TAU / 60.0),
    ("deg/s", "angular velocity", std::f64::consts::PI / 180.0),
    ("N", "force", 1.0),
    ("kN", "force", 1.0e3),
    ("mN", "force", 1.0e-3),
    // Pound force: 0.45359237 kg times standard gravity.
    ("lbf", "force", 0.453_592_37 * 9.806_65),
    ("kip", "force", 453.592_37 * 9.806_65),
    ("N m", "torque", 1.0),
    ("mN m", "torque", 1.0e-3),
    ("in lbf", "torque", 0.0254 * 0.453_592_37 * 9.806_65),
    ("A", "current", 1.0),
    ("mA", "current", 1.0e-3),
    ("V", "voltage", 1.0),
    ("mV", "voltage", 1.0e-3),
    ("Hz", "frequency", 1.0),
    ("kHz", "frequency", 1.0e3),
    ("%", "share", 0.01),
    ("count", "count", 1.0),
    ("1", "number", 1.0),
    ("degC", "temperature", 1.0),
];

/// Suffix of a column and what it measures; longest first, so that `_m_s2` is not taken for `_s2`.
const SUFFIXES: [(&str, &str, f64); 14] = [
    ("_rad_s", "angular velocity", 1.0),
    ("_m_s2", "acceleration", 1.0),
    ("_m_s", "velocity", 1.0),
    ("_rad", "angle", 1.0),
    ("_rpm", "angular velocity", std::f64::consts::TAU / 60.0),
    ("_degc", "temperature", 1.0),
    ("_nm", "torque", 1.0),
    ("_hz", "frequency", 1.0),
    ("_a", "current", 1.0),
    ("_n", "force", 1.0),
    ("_m", "length", 1.0),
    ("_v", "voltage", 1.0),
    ("_s", "time", 1.0),
    ("_1", "number", 1.0),
];

fn unit(name: &str) -> Option<(&'static str, f64)> {
    UNITS.iter().find(|(n, _, _)| *n == name).map(|(_, what, factor)| (*what, *factor))
}

/// Reads a map. Errors: one line with file, place and what was expected.
pub fn read_import_map(path: &Path) -> Result<ImportMap, ConfigError> {
    import_map_from_text(path, &read_text(path, "import map")?)
}

/// Parses a map; `path` only names the source in errors.
pub fn import_map_from_text(path: &Path, text: &str) -> Result<ImportMap, ConfigError> {
    let raw: MapToml = parse(path, text)?;
    let content =
        |place: String, message: String| ConfigError::Content { path: path.to_owned(), place, message };
    let clock = clock(&raw.time, &raw.recording).map_err(|(p, m)| content(p, m))?;
    if raw.signals.is_empty() {
        return Err(content("signals".into(), "no signal is mapped; expected tables [[signals]]".into()));
    }
    let mut signals: Vec<Signal> = Vec::new();
    for (k, typed) in raw.signals.iter().enumerate() {
        let made = signal(typed).map_err(|m| content(format!("signals[{k}] ({})", typed.to), m))?;
        if signals.iter().any(|s| s.to == made.to) {
            return Err(content(format!("signals[{k}] ({})", typed.to), "is mapped twice".into()));
        }
        signals.push(made);
    }
    for (key, rate) in
        [("sample_rate_hz", raw.recording.sample_rate_hz), ("resample_hz", raw.recording.resample_hz)]
    {
        if rate.is_some_and(|hz| !(hz.is_finite() && hz > 0.0)) {
            return Err(content(format!("recording.{key}"), "expected a number above zero".into()));
        }
    }
    Ok(ImportMap {
        source: raw.source,
        clock,
        experiment: raw.recording.experiment,
        sample_rate_hz: raw.recording.sample_rate_hz,
        resample_hz: raw.recording.resample_hz,
        metadata: raw.recording.metadata.into_iter().collect(),
        signals,
    })
}

fn clock(time: &TimeToml, recording: &RecordingToml) -> Result<Clock, (String, String)> {
    match (&time.column, recording.sample_rate_hz) {
        (Some(name), _) => {
            let typed = time.unit.as_deref().unwrap_or("s");
            match unit(typed) {
                Some(("time", scale)) => {
                    Ok(Clock::Column { name: name.clone(), scale, restarts: time.restarts })
                }
                _ => Err((
                    "time.unit".into(),
                    format!("`{typed}` is no unit of time; expected s, ms, us or min"),
                )),
            }
        }
        (None, Some(rate)) => Ok(Clock::Rate(rate)),
        (None, None) => Err((
            "time".into(),
            "neither time.column nor recording.sample_rate_hz says when the rows were taken".into(),
        )),
    }
}

fn signal(typed: &SignalToml) -> Result<Signal, String> {
    let Some((_, wanted, si)) = SUFFIXES.iter().find(|(s, _, _)| typed.to.ends_with(s)) else {
        let known: Vec<&str> = SUFFIXES.iter().map(|(s, _, _)| *s).collect();
        return Err(format!("the name must end with its unit, one of {}", known.join(" ")));
    };
    let origin = match (&typed.from, typed.constant) {
        (Some(name), None) => Origin::Column(name.clone()),
        (None, Some(value)) if value.is_finite() => Origin::Constant(value),
        _ => return Err("expected either from = \"...\" or constant = a number".into()),
    };
    let scale = match (&typed.unit, typed.scale, &origin) {
        (None, None, Origin::Constant(_)) => 1.0,
        (None, _, _) => return Err("unit = \"...\" is missing: state what the column is in".into()),
        (Some(name), scale, _) => factor(name, scale, (wanted, *si), typed.integrate)?,
    };
    if !(scale.is_finite() && scale != 0.0 && typed.offset.is_finite()) {
        return Err(format!("scale {scale} and offset {} must be finite, the scale not zero", typed.offset));
    }
    Ok(Signal { origin, to: typed.to.clone(), scale, offset: typed.offset, integrate: typed.integrate })
}

/// Factor from a stated unit to that of the target; a rate becomes its integral where that is asked for.
fn factor(name: &str, scale: Option<f64>, target: (&str, f64), integrate: bool) -> Result<f64, String> {
    let (wanted, si) = target;
    let Some((what, to_si)) = unit(name) else {
        let hint = "known units stand in the manual; a unit of your own needs scale";
        return scale.ok_or_else(|| format!("unit `{name}` is not known; {hint}"));
    };
    if let Some(scale) = scale {
        return Ok(scale);
    }
    let measured = match (integrate, what) {
        (true, "velocity") => "length",
        (true, "angular velocity") => "angle",
        (true, "acceleration") => "velocity",
        _ => what,
    };
    if measured == wanted {
        Ok(to_si / si)
    } else {
        Err(format!("unit `{name}` measures {what}, the column {wanted}: state scale = ... or another unit"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<ImportMap, String> {
        import_map_from_text(Path::new("map.toml"), text).map_err(|e| e.to_string())
    }

    const HEAD: &str = "[time]\ncolumn = \"t\"\nunit = \"ms\"\n";

    #[test]
    fn units_of_one_kind_convert_by_themselves() {
        let map = read(&format!(
            "{HEAD}[[signals]]\nfrom = \"n\"\nto = \"x_motor_angle_rad\"\nunit = \"rpm\"\nintegrate = true\n\
             [[signals]]\nfrom = \"f\"\nto = \"x_thrust_ref_n\"\nunit = \"lbf\"\n"
        ))
        .unwrap();
        assert!((map.signals[0].scale - 0.104_719_755).abs() < 1.0e-9);
        assert!((map.signals[1].scale - 4.448_221_6).abs() < 1.0e-6);
        assert_eq!(map.clock, Clock::Column { name: "t".into(), scale: 1.0e-3, restarts: false });
    }

    #[test]
    fn a_wrong_kind_of_unit_is_refused() {
        let text = format!("{HEAD}[[signals]]\nfrom = \"u\"\nto = \"x_thrust_ref_n\"\nunit = \"V\"\n");
        assert_eq!(
            read(&text).unwrap_err(),
            "map.toml: signals[0] (x_thrust_ref_n): unit `V` measures voltage, the column force: state \
             scale = ... or \
             another unit"
        );
        assert!(read(&text.replace("unit = \"V\"", "unit = \"V\"\nscale = 35.15")).is_ok());
    }

    #[test]
    fn a_name_without_a_unit_and_a_missing_clock_are_refused() {
        let text = format!("{HEAD}[[signals]]\nfrom = \"u\"\nto = \"thrust\"\nunit = \"N\"\n");
        assert!(read(&text).unwrap_err().contains("must end with its unit"));
        let text = "[[signals]]\nfrom = \"u\"\nto = \"x_thrust_ref_n\"\nunit = \"N\"\n";
        assert!(read(text).unwrap_err().contains("says when the rows were taken"));
    }
}
