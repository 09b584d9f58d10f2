//! `stillcut.toml`: the configuration of the service, its defaults in one place.
//!
//! `config/stillcut.toml` states every key with its default, unit and meaning; `print-config` prints
//! it, and a test holds it equal to the defaults here.

mod network;
mod pair;
mod turret;

use super::force::{AxisToml, ForceConfig, ForceToml};
use super::machine::machine_from_text;
use super::scenario::read_scenario;
use super::{ConfigError, parse, parse_number, read_text};
use crate::avoidance::AvoidanceSettings;
use crate::chatter::{Band, FALSE_ALARM_S, MeanForce};
use crate::pipeline::{AxisPlan, BandPlan, CutPrior, MarginPlan, PipelineSettings, ToolAxis, lines_of};
use crate::plant::cutting::{Cutting, RawCutting};
use crate::plant::machine::Machine;
use crate::plant::scenario::{RawScenario, Scenario, ToolCount};
use crate::plant::workpiece::{RawWorkpiece, Workpiece};
use crate::units::SampleRate;
use pair::Pair;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
pub use turret::{COMMISSIONING_ITEMS, TurretConfig};

/// Every setting with its default, unit and meaning.
pub const DEFAULT_TEXT: &str = include_str!("../../config/stillcut.toml");
/// Stands where nobody has set the turret's limits yet.
const NOT_COMMISSIONED: &str = "not commissioned";
/// Drives of the virtual lathe's turret axes, used where no model is named.
pub const BUILT_IN_MODEL: &str = include_str!("../../config/turrets.toml");

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
struct ServiceToml {
    machine: MachineToml,
    workpiece: WorkpieceToml,
    cutting: CuttingToml,
    detection: DetectionToml,
    turret: TurretToml,
    transport: TransportToml,
    http: HttpToml,
    history: HistoryToml,
    recorder: RecorderToml,
    log: LogToml,
    mtconnect: MtconnectToml,
    fleet: FleetToml,
}

macro_rules! section {
    ($name:ident { $($key:ident: $kind:ty = $default:expr),* $(,)? }) => {
        #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields, default)]
        struct $name { $($key: $kind,)* }

        impl Default for $name {
            fn default() -> Self {
                Self { $($key: $default,)* }
            }
        }
    };
}

section!(MachineToml {
    model: Option<PathBuf> = None,
    method: String = "medob".into(),
    force_cutoff_hz: f64 = 1000.0,
    motor_cutoff_hz: Option<f64> = None,
    watch: Vec<String> = vec!["x1".into(), "y1".into()],
    accelerometers: Option<PathBuf> = None,
    axes: BTreeMap<String, AxisToml> = BTreeMap::new(),
});
section!(WorkpieceToml {
    diameter_m: f64 = 0.0249,
    projection_length_m: f64 = 0.180,
    elastic_modulus_pa: f64 = 193e9,
    density_kg_m3: f64 = 7850.0,
    damping_ratio: f64 = 0.01,
    clamp_factor: f64 = 0.975,
});
section!(CuttingToml {
    scenario: Option<PathBuf> = None,
    radial_stiffness_pa: f64 = 2500e6,
    width_m: f64 = 0.2e-3,
    feed_m_rev: f64 = 0.15e-3,
    process_damping_n: f64 = 60.0,
});
section!(DetectionToml {
    band_hz: Option<Pair<f64>> = None,
    hours_between_false_alarms: f64 = FALSE_ALARM_S / 3600.0,
    tool_axis: Option<String> = None,
    tool_axis_zero_m: f64 = 0.0,
    tool_axis_toward_chuck: bool = false,
    infeed_axis: Option<String> = None,
    infeed_axis_zero_m: f64 = 0.0,
    infeed_axis_toward_bar: bool = true,
});
section!(TurretToml {
    axes: Pair<String> = Pair(["x1".into(), "y1".into()]),
    direction_rad: Pair<f64> = Pair([0.0, std::f64::consts::FRAC_PI_4]),
    lowest_offset_m: Pair<f64> = Pair([-1.0e-3; 2]),
    highest_offset_m: Pair<f64> = Pair([1.0e-3; 2]),
    speed_m_s: Pair<f64> = Pair([2.0e-3; 2]),
    acceleration_m_s2: Pair<f64> = Pair([50.0e-3; 2]),
    largest_pitch_difference_rad: f64 = 0.14,
    command_ttl_s: f64 = 2.5,
    limits_by: String = NOT_COMMISSIONED.into(),
    limits_date: String = NOT_COMMISSIONED.into(),
    before_chatter: bool = false,
    accept: Vec<String> = vec![],
});
section!(TransportToml { prefix: String = "stillcut".into(), root: PathBuf = "/run/stillcut".into() });
section!(HttpToml {
    listen: String = "127.0.0.1:8620".into(),
    certificate: Option<PathBuf> = None,
    key: Option<PathBuf> = None,
    tokens: Option<PathBuf> = None,
    hosts: Vec<String> = vec![],
    allow_remote_without_tls: bool = false,
});
section!(HistoryToml {
    folder: PathBuf = "/var/lib/stillcut".into(),
    max_age_days: u32 = 400,
    max_bytes: u64 = 1_000_000_000,
});
section!(RecorderToml {
    before_s: f64 = 8.0,
    after_s: f64 = 2.0,
    max_age_days: u32 = 90,
    max_bytes: u64 = 4_000_000_000,
});
section!(LogToml { format: String = "text".into() });
section!(FleetToml {
    server: Option<String> = None,
    credentials: Option<PathBuf> = None,
    machine: String = "lathe".into(),
    diagnose: bool = false,
});
section!(MtconnectToml {
    listen: Option<String> = None,
    allow_remote: bool = false,
});

/// How HTTP is served.
#[derive(Debug, Clone, PartialEq)]
pub struct HttpConfig {
    /// Address and port; port 0 takes any.
    pub listen: SocketAddr,
    /// Certificate chain and key.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// File of tokens.
    pub tokens: Option<PathBuf>,
    /// Names that `Host` may carry beside loopback's, without ports.
    pub hosts: Vec<String>,
    /// Loopback may write without a token: for the demonstration only, never from a file.
    pub trust_loopback: bool,
}

/// Folder and retention of the history.
#[derive(Debug, Clone, PartialEq)]
pub struct HistoryConfig {
    /// Folder of the history file, the lock and the recordings.
    pub folder: PathBuf,
    /// Oldest event kept, ns.
    pub max_age_ns: i64,
    /// Largest file.
    pub max_bytes: u64,
}

/// The black box.
#[derive(Debug, Clone, PartialEq)]
pub struct RecorderConfig {
    /// Seconds kept before an event.
    pub before_s: f64,
    /// Seconds waited for after it.
    pub after_s: f64,
    /// Oldest recording kept, ns.
    pub max_age_ns: i64,
    /// Largest folder.
    pub max_bytes: u64,
}

/// The broker of the fleet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FleetConfig {
    /// `nats://host:port`.
    pub server: String,
    /// File with one line `user:password` for the broker.
    pub credentials: Option<PathBuf>,
    /// Name of this machine in subjects.
    pub machine: String,
    /// Diagnoses go to the fleet's workers.
    pub diagnose: bool,
}

/// The configuration of the service, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct ServiceConfig {
    /// Binary that diagnoses run in, in a process of their own; `None`: the one that runs now. Not in the
    /// file.
    pub program: Option<PathBuf>,
    /// The file itself, where it was read from one. Not in the file.
    pub file: Option<PathBuf>,
    /// Drives of the axes.
    pub machine: Machine,
    /// File that the drives were read from.
    pub model: Option<PathBuf>,
    /// How the force of each axis is estimated.
    pub force: ForceConfig,
    /// Axes listened to.
    pub watch: Vec<String>,
    /// Bar in the chuck and cut as they are stated, with the physics of a scenario where one is named: band,
    /// stability curve and choice of pitch start here.
    pub cut: Scenario,
    /// Watched band, where it is stated.
    pub band: Option<Band>,
    /// Axis that moves the tools along the bar, with its place at the chuck and its direction.
    pub tools: Option<(String, f64, bool)>,
    /// Mean time between false alarms, of cutting, s.
    pub false_alarm_s: f64,
    /// Axis that tells the radius at the tools, the same of it.
    pub infeed: Option<(String, f64, bool)>,
    /// Turret.
    pub turret: TurretConfig,
    /// Prefix and folder of the shared memory domain.
    pub transport: (String, PathBuf),
    /// HTTP.
    pub http: HttpConfig,
    /// History.
    pub history: HistoryConfig,
    /// Black box.
    pub recorder: RecorderConfig,
    /// Log lines as JSON.
    pub log_json: bool,
    /// Broker of the fleet, where there is one.
    pub fleet: Option<FleetConfig>,
    /// Where MTConnect agents connect.
    pub mtconnect: Option<SocketAddr>,
    /// What was read, without comments.
    pub text: String,
}

const DAY_NS: i64 = 86_400_000_000_000;

/// Reads the configuration of the service. Errors: one line with file, place and what was expected.
pub fn read_service_config(path: &Path) -> Result<ServiceConfig, ConfigError> {
    service_config_from_text(path, &read_text(path, "configuration")?)
}

/// Parses a configuration; paths in it are relative to the folder of `path`.
pub fn service_config_from_text(path: &Path, text: &str) -> Result<ServiceConfig, ConfigError> {
    let raw: ServiceToml = parse(path, text)?;
    Reader { path, folder: path.parent().unwrap_or(Path::new("")) }.config(raw)
}

impl Default for ServiceConfig {
    /// All defaults; the same as an empty file.
    fn default() -> Self {
        #[expect(clippy::expect_used, reason = "the defaults are constants that a test reads")]
        service_config_from_text(Path::new("defaults"), "").expect("defaults are valid")
    }
}

struct Reader<'a> {
    path: &'a Path,
    folder: &'a Path,
}

impl Reader<'_> {
    fn bad(&self, place: &str, message: impl Into<String>) -> ConfigError {
        ConfigError::Content { path: self.path.to_owned(), place: place.to_owned(), message: message.into() }
    }

    fn within(&self, place: &str, value: f64, (low, high): (f64, f64)) -> Result<f64, ConfigError> {
        parse_number(self.path, place, value, (low, high))
    }

    fn resolve(&self, path: &Path) -> PathBuf {
        if path.is_absolute() { path.to_owned() } else { self.folder.join(path) }
    }

    /// An axis that tells a distance: its name, the distance where it stands at zero, whether that shrinks.
    fn tool_axis(
        &self,
        key: &str,
        (axis, zero_m, toward): (&Option<String>, f64, bool),
    ) -> Result<Option<(String, f64, bool)>, ConfigError> {
        let zero_m = self.within(&format!("detection.{key}_zero_m"), zero_m, (-10.0, 10.0))?;
        Ok(axis.clone().map(|axis| (axis, zero_m, toward)))
    }

    fn config(&self, raw: ServiceToml) -> Result<ServiceConfig, ConfigError> {
        let text = toml::to_string(&raw).map_err(|e| self.bad("configuration", e.to_string()))?;
        let model = raw.machine.model.as_deref().map(|p| self.resolve(p));
        let machine = match &model {
            Some(path) => {
                super::machine::read_machine(path).map_err(|e| self.bad("machine.model", e.to_string()))?
            }
            None => machine_from_text(Path::new("built-in model"), BUILT_IN_MODEL)?,
        };
        let force = ForceToml {
            method: &raw.machine.method,
            force_cutoff_hz: raw.machine.force_cutoff_hz,
            motor_cutoff_hz: raw.machine.motor_cutoff_hz,
            accelerometers: raw.machine.accelerometers.as_deref().map(|p| self.resolve(p)),
            axes: &raw.machine.axes,
        };
        let force = ForceConfig::new(self.path, &force, &machine)?;
        let known = |a: &String| machine.axis(a).is_some() || force.accelerometer_axes().any(|b| b == a);
        let unknown = |place: &str, axes: &[String]| {
            let axis = axes.iter().find(|a| !known(a))?;
            let names: Vec<&str> = machine.axes.iter().map(|a| a.name.as_str()).collect();
            let what = format!("the model has no axis {axis}; it has {}", names.join(", "));
            Some(self.bad(place, what))
        };
        if raw.machine.watch.is_empty() {
            return Err(self.bad("machine.watch", "[]: expected the name of one axis or more"));
        }
        let turret = self.turret(&raw.turret)?;
        // A turret that nothing moves may have axes of any name.
        let moved = model.is_some() && turret.commissioned.is_some();
        let of_turret = || unknown("turret.axes", &turret.axes).filter(|_| moved);
        if let Some(error) = unknown("machine.watch", &raw.machine.watch).or_else(of_turret) {
            return Err(error);
        }
        let watch = &raw.machine.watch;
        if let Some(axis) = watch.iter().enumerate().find_map(|(i, a)| watch[..i].contains(a).then_some(a)) {
            return Err(self.bad("machine.watch", format!("{axis} twice: expected each axis once")));
        }
        let d = &raw.detection;
        let cut = self.cut(&raw.workpiece, &raw.cutting)?;
        // The band that is predicted from it must be one that can be heard.
        let (bends_hz, most_hz) = (cut.workpiece.bending_frequency_hz(), 0.35 * machine.sample_rate.hz());
        if d.band_hz.is_none() && !(20.0..most_hz).contains(&bends_hz) {
            let what =
                format!("the bar bends at {bends_hz:.1} Hz, expected 20 to {most_hz} Hz; lengths in m");
            return Err(self.bad("workpiece", what));
        }
        let band = d.band_hz.map(|stated| self.band(stated.0, machine.sample_rate)).transpose()?;
        let http = self.http(&raw.http)?;
        Ok(ServiceConfig {
            program: None,
            file: self.path.is_file().then(|| self.path.to_owned()),
            force,
            watch: raw.machine.watch.clone(),
            cut,
            band,
            tools: self
                .tool_axis("tool_axis", (&d.tool_axis, d.tool_axis_zero_m, d.tool_axis_toward_chuck))?,
            false_alarm_s: 3600.0
                * self.within(
                    "detection.hours_between_false_alarms",
                    d.hours_between_false_alarms,
                    (1.0, 1e6),
                )?,
            infeed: self
                .tool_axis("infeed_axis", (&d.infeed_axis, d.infeed_axis_zero_m, d.infeed_axis_toward_bar))?,
            turret,
            transport: (raw.transport.prefix.clone(), raw.transport.root.clone()),
            mtconnect: self.mtconnect(&raw.mtconnect, http.listen)?,
            http,
            history: self.history(&raw.history)?,
            recorder: self.recorder(&raw.recorder)?,
            log_json: self.is_json(&raw.log)?,
            fleet: self.fleet(&raw.fleet)?,
            machine,
            model,
            text,
        })
    }

    fn history(&self, raw: &HistoryToml) -> Result<HistoryConfig, ConfigError> {
        Ok(HistoryConfig {
            folder: self.resolve(self.named("history.folder", &raw.folder)?),
            max_age_ns: self.days("history.max_age_days", raw.max_age_days)?,
            max_bytes: self.bytes("history.max_bytes", raw.max_bytes)?,
        })
    }

    fn recorder(&self, raw: &RecorderToml) -> Result<RecorderConfig, ConfigError> {
        Ok(RecorderConfig {
            before_s: self.within("recorder.before_s", raw.before_s, (0.5, 60.0))?,
            after_s: self.within("recorder.after_s", raw.after_s, (0.0, 30.0))?,
            max_age_ns: self.days("recorder.max_age_days", raw.max_age_days)?,
            max_bytes: self.bytes("recorder.max_bytes", raw.max_bytes)?,
        })
    }

    fn is_json(&self, raw: &LogToml) -> Result<bool, ConfigError> {
        match raw.format.as_str() {
            "text" => Ok(false),
            "json" => Ok(true),
            other => Err(self.bad("log.format", format!("`{other}` is not one of text, json"))),
        }
    }

    /// The watched band: above half of the sampling rate nothing can be heard.
    fn band(&self, [low, high]: [f64; 2], rate: SampleRate) -> Result<Band, ConfigError> {
        let place = "detection.band_hz";
        let band = Band::new(low, high).map_err(|e| self.bad(place, e.to_string()))?;
        let half = 0.5 * rate.hz();
        if high >= half {
            let what = format!("{high} Hz is not below {half} Hz, half of the machine's sampling rate");
            return Err(self.bad(place, what));
        }
        Ok(band)
    }

    /// A path that names something.
    fn named<'a>(&self, place: &str, path: &'a Path) -> Result<&'a Path, ConfigError> {
        if path.as_os_str().is_empty() {
            return Err(self.bad(place, "expected a path, found an empty text"));
        }
        Ok(path)
    }

    fn workpiece(&self, raw: &WorkpieceToml) -> Result<Workpiece, ConfigError> {
        self.within("workpiece.diameter_m", raw.diameter_m, (1e-3, 2.0))?;
        self.within("workpiece.projection_length_m", raw.projection_length_m, (1e-3, 10.0))?;
        self.within("workpiece.elastic_modulus_pa", raw.elastic_modulus_pa, (1e8, 2e12))?;
        self.within("workpiece.density_kg_m3", raw.density_kg_m3, (100.0, 30e3))?;
        self.within("workpiece.clamp_factor", raw.clamp_factor, (0.1, 2.0))?;
        let raw = RawWorkpiece {
            diameter_m: raw.diameter_m,
            projection_length_m: raw.projection_length_m,
            elastic_modulus_pa: raw.elastic_modulus_pa,
            density_kg_m3: raw.density_kg_m3,
            damping_ratio: raw.damping_ratio,
            clamp_factor: raw.clamp_factor,
            tap_test: None,
        };
        Workpiece::new(raw).map_err(|e| self.bad("workpiece", e.to_string()))
    }

    /// Bar and cut from this file, or from the scenario that it names.
    fn cut(&self, bar: &WorkpieceToml, cut: &CuttingToml) -> Result<Scenario, ConfigError> {
        let Some(path) = &cut.scenario else {
            let (workpiece, cutting) = (*self.workpiece(bar)?.raw(), *self.cutting(cut)?.raw());
            let raw = RawScenario { workpiece, cutting, ..RawScenario::default() };
            return Scenario::new(&raw).map_err(|e| self.bad("cutting", e.to_string()));
        };
        let place = "cutting.scenario";
        let others = CuttingToml { scenario: None, ..cut.clone() };
        if *bar != WorkpieceToml::default() || others != CuttingToml::default() {
            let what = "the bar and the cut are stated here too: expected either the scenario or these keys";
            return Err(self.bad(place, what));
        }
        let scenario = read_scenario(&self.resolve(self.named(place, path)?))?;
        if scenario.tools.count() != ToolCount::Two {
            return Err(self.bad(place, "a cut of one tool: expected two, whose pitch can be moved"));
        }
        Ok(scenario)
    }

    fn cutting(&self, raw: &CuttingToml) -> Result<Cutting, ConfigError> {
        self.within("cutting.width_m", raw.width_m, (1e-7, 0.05))?;
        self.within("cutting.feed_m_rev", raw.feed_m_rev, (1e-7, 0.02))?;
        let raw = RawCutting {
            radial_stiffness_pa: raw.radial_stiffness_pa,
            width_m: raw.width_m,
            feed_m_rev: raw.feed_m_rev,
            process_damping_n: raw.process_damping_n,
            ..RawCutting::default()
        };
        Cutting::new(raw).map_err(|e| self.bad("cutting", e.to_string()))
    }

    fn days(&self, place: &str, days: u32) -> Result<i64, ConfigError> {
        self.within(place, days.into(), (1.0, 36_500.0))?;
        Ok(i64::from(days) * DAY_NS)
    }

    /// Less would hold no history and no recording.
    fn bytes(&self, place: &str, bytes: u64) -> Result<u64, ConfigError> {
        match bytes {
            1_000_000.. => Ok(bytes),
            _ => Err(self.bad(place, format!("{bytes} is not 1000000 or more"))),
        }
    }
}

impl ServiceConfig {
    /// The pipeline for a stream of these axes: an axis that the model does not know has no force.
    #[must_use]
    pub fn pipeline_settings(&self, sample_rate: SampleRate, axes: &[String]) -> PipelineSettings {
        let plan = |name: &String| {
            let [force, beside] = self.force.plans(name, self.machine.axis(name), sample_rate);
            let nut = self.force.nut(name).and_then(|nut| axes.iter().position(|a| a == nut));
            let turret = self.turret.axes.iter().position(|axis| axis == name);
            let pushed = turret.map_or(0.0, |i| self.turret.direction_rad[i].cos());
            AxisPlan { name: name.clone(), force, beside, nut, watch: self.watch.contains(name), pushed }
        };
        let tool_axis = |stated: &Option<(String, f64, bool)>| {
            let (axis, zero_m, toward) = stated.as_ref()?;
            let index = axes.iter().position(|a| a == axis)?;
            Some(ToolAxis { index, zero_m: *zero_m, toward: *toward })
        };
        PipelineSettings {
            sample_rate,
            axes: axes.iter().map(plan).collect(),
            band: self.band.map_or_else(|| self.predicted_band(), BandPlan::Stated),
            tools: tool_axis(&self.tools),
            infeed: tool_axis(&self.infeed),
            stated_pitch_rad: None,
            margin: Some(self.margin_plan()),
            mean: MeanForce::OverAir,
            false_alarm_s: self.false_alarm_s,
        }
    }

    /// theta_2 - theta_1 as stated, rad, of a stream in which nothing ever reports it. `None`: one tool, or
    /// no axis of the machine.
    #[must_use]
    pub fn stated_pitch_rad(&self, axes: &[String]) -> Option<f64> {
        let ours = axes.iter().any(|axis| self.machine.axis(axis).is_some());
        let two = self.cut.tools.count() == ToolCount::Two;
        (ours && two).then(|| self.cut.tools.pitch_difference_rad())
    }

    /// A line for each setting that names an axis which a stream of these axes does not have.
    pub fn not_in_the_stream(&self, axes: &[String]) -> impl Iterator<Item = String> {
        let of = |key: &'static str, stated: &Option<(String, f64, bool)>| {
            let (axis, ..) = stated.as_ref()?;
            (!axes.contains(axis)).then(|| format!("detection.{key}: the stream has no axis {axis}"))
        };
        [of("tool_axis", &self.tools), of("infeed_axis", &self.infeed)].into_iter().flatten()
    }

    fn predicted_band(&self) -> BandPlan {
        let Scenario { workpiece, cutting, physics, .. } = self.cut;
        if !physics.is_empty()
            && let Ok(lines) = lines_of(&self.cut, self.turret.largest_pitch_difference_rad)
        {
            return BandPlan::Structured(workpiece, cutting, lines);
        }
        BandPlan::Cut(workpiece, cutting)
    }

    /// What the stability margin rests on.
    #[must_use]
    pub fn margin_plan(&self) -> MarginPlan {
        MarginPlan {
            prior: CutPrior {
                workpiece: self.cut.workpiece,
                cutting: self.cut.cutting,
                position_m: self.cut.workpiece.projection_length_m(),
            },
            force_hz: MarginPlan::FORCE_HZ,
        }
    }

    /// The decision for a stream of these axes: the same for the service and for its replay.
    /// Errors: one line which setting does not fit.
    pub fn avoidance_settings(&self, axes: &[String]) -> Result<AvoidanceSettings, String> {
        let turret = &self.turret;
        let place = |name: &String| {
            let index = axes.iter().position(|n| n == name);
            index.ok_or_else(|| format!("turret.axes: the stream has no axis {name}"))
        };
        let places = [place(&turret.axes[0])?, place(&turret.axes[1])?];
        Ok(AvoidanceSettings {
            turret: turret.kinematics(places).map_err(|e| e.to_string())?,
            diameter_m: self.cut.workpiece.diameter_m(),
            largest_pitch_rad: turret.largest_pitch_difference_rad,
            interval_s: 1.0,
            ttl_s: turret.command_ttl_s,
            freshness_s: 0.05,
            report_deadline_s: 0.5,
            reached_m: 20e-6,
            stated: Some(self.cut),
            before_chatter: turret.before_chatter,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::is_date;
    use crate::plant::cut_effects::Physics;

    fn error(text: &str) -> String {
        service_config_from_text(Path::new("c.toml"), text).unwrap_err().to_string()
    }

    #[test]
    fn the_printed_configuration_is_the_default() {
        let printed: ServiceToml = parse(Path::new("stillcut.toml"), DEFAULT_TEXT).unwrap();
        assert_eq!(printed, ServiceToml::default());
        let given: toml::Table = toml::from_str(DEFAULT_TEXT).unwrap();
        let all = toml::Table::try_from(ServiceToml::default()).unwrap();
        assert_eq!(given, all, "every key stands in the printed text");
    }

    #[test]
    fn mistakes_are_named_in_one_line() {
        let cases = [
            ("[http]\nlisten = \"here\"\n", "c.toml: http.listen: `here` is not an address"),
            ("[http]\nlisten = \"0.0.0.0:1\"\n", "reachable from other machines"),
            ("[http]\nkey = \"k\"\n", "certificate and key are needed together"),
            ("[htpt]\n", "c.toml:1:2: unknown field `htpt`"),
            ("[http]\nlisen = 1\n", "c.toml:2:1: unknown field `lisen`"),
            ("[workpiece]\ndiameter_m = -1.0\n", "workpiece.diameter_m: -1 is not between"),
            ("[machine]\nmethod = \"magic\"\n", "machine.method: `magic` is not one of thrust, dob"),
            ("[machine]\nmethod = \"frf\"\n", "machine.method: `frf` needs machine.accelerometers"),
            ("[machine.axes.q]\n", "machine.axes.q: the model has no axis q"),
            ("[machine.axes.x1]\nbeside = \"m\"\n", "machine.axes.x1.beside: `m` is not one of"),
            ("[machine.axes.x1]\nturns = 99.0\n", "machine.axes.x1.turns: 99 is not between 0.1 and 10"),
            ("[machine.axes.x1]\nencoders = \"no\"\n", "`no` is not one of both, motor, stage"),
            ("[machine.axes.x1]\nspeed = 1\n", "unknown field `speed`"),
            ("[machine]\nwatch = [\"q\"]\n", "machine.watch: the model has no axis q"),
            ("[machine]\nwatch = []\n", "machine.watch: []: expected the name of one axis"),
            ("[machine]\nwatch = [\"x1\", \"x1\"]\n", "machine.watch: x1 twice"),
            ("[detection]\nband_hz = [500.0, 4500.0]\n", "detection.band_hz: 4500 Hz is not below 4500 Hz"),
            ("[history]\nfolder = \"\"\n", "history.folder: expected a path"),
            (
                "[mtconnect]\nlisten = \"127.0.0.1:8620\"\n",
                "mtconnect.listen: 127.0.0.1:8620 is the port of http.listen",
            ),
            ("[turret]\ndirection_rad = [0.0, nan]\n", "turret.direction_rad: NaN is not between"),
            (
                "[turret]\ndirection_rad = [0.7, 0.72]\n",
                "turret.direction_rad: turret axes at 0.7 and 0.72 rad",
            ),
            ("[fleet]\ndiagnose = true\n", "fleet.diagnose: true: expected fleet.server"),
            ("[turret]\naxes = [\"x1\", \"x1\"]\n", "turret.axes: x1 twice"),
            ("[turret]\naxes = [\"x1\", \"y1\", \"z1\"]\n", "3 values, expected two"),
            ("[turret]\naxes = [\"x1\"]\n", "1 value, expected two"),
            ("[turret]\nlowest_offset_m = [-1e-3, -1e-3, 5.0]\n", "3 values, expected two"),
            ("[detection]\nband_hz = [500.0, 700.0, 9.0]\n", "3 values, expected two"),
            ("[workpiece]\ndiameter_m = 24.9\n", "workpiece.diameter_m: 24.9 is not between 0.001 and 2"),
            ("[workpiece]\nprojection_length_m = 180.0\n", "workpiece.projection_length_m: 180 is not"),
            ("[workpiece]\nprojection_length_m = 9.0\n", "bends at 0.2 Hz, expected 20 to 3150 Hz"),
            ("[workpiece]\ndensity_kg_m3 = 7.85\n", "workpiece.density_kg_m3: 7.85 is not between"),
            ("[cutting]\nwidth_m = 0.2\n", "cutting.width_m: 0.2 is not between"),
            (
                "[turret]\nlargest_pitch_difference_rad = 0\n",
                "pitch_difference_rad: 0 is not between 0.001 and 1",
            ),
            ("[history]\nmax_bytes = 0\n", "history.max_bytes: 0 is not 1000000 or more"),
            ("[recorder]\nmax_bytes = 0\n", "recorder.max_bytes: 0 is not 1000000 or more"),
            ("[recorder]\nmax_age_days = 0\n", "recorder.max_age_days: 0 is not between 1 and 36500"),
            ("[http]\nhosts = [\"https://lathe\"]\n", "http.hosts: `https://lathe` is not a host name"),
            ("[http]\nhosts = [\"lathe:port\"]\n", "http.hosts: `lathe:port` is not"),
            ("[http]\nhosts = [\"*\"]\n", "http.hosts: `*` is not"),
            ("[http]\nhosts = [\"\"]\n", "http.hosts: `` is not"),
            ("[http]\nhosts = [\"[::1]x\"]\n", "http.hosts: `[::1]x` is not"),
            (
                "[turret]\nlimits_by = \"A. Smith\"\nlimits_date = \"2026-02-31\"\n",
                "turret.limits_date: `2026-02-31` is not a date such as",
            ),
            ("[turret]\nlimits_by = \"A. Smith\"\n", "turret.limits_date: missing beside turret.limits_by"),
            ("[turret]\ncommand_ttl_s = 9.0\n", "turret.command_ttl_s: 9 is not between 1.1 and 2.5"),
            ("[log]\nformat = \"xml\"\n", "log.format: `xml` is not one of text, json"),
            ("[detection]\nband_hz = [700.0, 500.0]\n", "detection.band_hz"),
            (
                "[turret]\nlimits_by = \"A. Smith\"\nlimits_date = \"today\"\n",
                "`today` is not a date such as",
            ),
            (
                "[turret]\nlimits_by = \" \"\nlimits_date = \"2026-11-21\"\n",
                "turret.limits_by: expected the name",
            ),
            ("[mtconnect]\nlisten = \"0.0.0.0:7878\"\n", "needs mtconnect.allow_remote = true"),
            ("[recorder]\nbefore_s = \"long\"\n", "c.toml:2:12: `before_s`: invalid type: string \"long\""),
        ];
        for (text, expected) in cases {
            let message = error(text);
            assert!(message.contains(expected), "{text}: {message}");
            assert_eq!(message.lines().count(), 1, "{message}");
        }
    }

    #[test]
    fn limits_are_commissioned_by_somebody_on_some_day() {
        let read =
            |text: &str| service_config_from_text(Path::new("c.toml"), text).unwrap().turret.commissioned;
        assert_eq!(read(""), None);
        let both = "[turret]\nlimits_by = \"A. Smith\"\nlimits_date = \"2026-11-21\"\n";
        assert_eq!(read(both), Some(("A. Smith".into(), "2026-11-21".into())));
        assert!(is_date("2028-02-29") && is_date("2026-04-30"));
        for bad in [
            "2026-02-29",
            "2026-02-31",
            "2026-04-31",
            "2026-00-01",
            "2026-13-01",
            "2026-1-01",
            "21-11-2026",
            "2026-11-21T",
            "2026/11/21",
            "",
        ] {
            assert!(!is_date(bad), "{bad}");
        }
    }

    #[test]
    fn hosts_are_names_with_or_without_a_port() {
        let text = "[http]\nhosts = [\"lathe-7.example\", \"lathe:443\", \"10.0.0.7\", \"[fd00::7]:8620\"]\n";
        let config = service_config_from_text(Path::new("c.toml"), text).unwrap();
        assert_eq!(config.http.hosts, ["lathe-7.example", "lathe", "10.0.0.7", "fd00::7"]);
    }

    #[test]
    fn a_distance_of_an_axis_that_does_not_come_is_told() {
        let text = "[detection]\ntool_axis = \"z\"\ninfeed_axis = \"x1\"\n";
        let config = service_config_from_text(Path::new("c.toml"), text).unwrap();
        let missing = |axes: &[&str]| {
            let axes: Vec<String> = axes.iter().map(|&a| a.to_owned()).collect();
            config.not_in_the_stream(&axes).collect::<Vec<_>>()
        };
        assert_eq!(missing(&["x1", "y1"]), ["detection.tool_axis: the stream has no axis z"]);
        assert!(missing(&["x1", "y1", "z"]).is_empty());
    }

    #[test]
    fn the_axes_of_a_commissioned_turret_are_in_the_model() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("m.toml"), BUILT_IN_MODEL).unwrap();
        let model = "[machine]\nmodel = \"m.toml\"\n[turret]\naxes = [\"x1\", \"q\"]\n";
        let limits = "limits_by = \"A. Smith\"\nlimits_date = \"2026-11-21\"\n";
        let read = |text: &str| service_config_from_text(&folder.path().join("c.toml"), text);
        assert!(read(model).is_ok(), "nothing moves this turret");
        let error = read(&format!("{model}{limits}")).unwrap_err().to_string();
        assert!(error.contains("turret.axes: the model has no axis q; it has x1, y1"), "{error}");
    }

    #[test]
    #[cfg(feature = "nats")]
    fn the_brokers_password_does_not_stand_in_the_configuration() {
        let message = error("[fleet]\nserver = \"nats://user:secret@broker:4222\"\n");
        assert!(message.contains("fleet.credentials") && !message.contains("secret"), "{message}");
    }

    #[test]
    fn remote_needs_tls_and_tokens_or_a_plain_word() {
        let all = "[http]\nlisten = \"0.0.0.0:1\"\ncertificate = \"c\"\nkey = \"k\"\ntokens = \"t\"\n";
        assert!(service_config_from_text(Path::new("/etc/c.toml"), all).is_ok());
        let word = "[http]\nlisten = \"0.0.0.0:1\"\nallow_remote_without_tls = true\n";
        assert!(service_config_from_text(Path::new("c.toml"), word).is_ok());
    }

    #[test]
    fn a_scenario_is_named_in_place_of_bar_and_cut() {
        let folder = tempfile::tempdir().unwrap();
        let config = |text: &str| service_config_from_text(&folder.path().join("c.toml"), text);
        let scenario = "[workpiece]\ndiameter_m = 0.022\n[[physics]]\neffect = \"second_mode\"\n\
                        port = \"workpiece\"\nfrequency_hz = 900.0\ndamping_ratio = 0.006\nn_m = 1.2e6\n";
        std::fs::write(folder.path().join("s.toml"), scenario).unwrap();
        let read = config("[cutting]\nscenario = \"s.toml\"\n").unwrap();
        assert!((read.cut.workpiece.diameter_m() - 0.022).abs() < 1e-12);
        assert!(!read.cut.physics.is_empty());
        // A second mode is listened to.
        let band = |c: &ServiceConfig| c.predicted_band().band().unwrap();
        let cut = Scenario { physics: Physics::default(), ..read.cut };
        let plain = ServiceConfig { cut, ..read.clone() };
        assert!(band(&read).high_hz() > 900.0 && band(&plain).high_hz() < 900.0, "{:?}", band(&read));
        let both = config("[cutting]\nscenario = \"s.toml\"\nwidth_m = 1e-4\n").unwrap_err().to_string();
        assert!(both.contains("cutting.scenario: the bar and the cut are stated here too"), "{both}");
        let gone = config("[cutting]\nscenario = \"t.toml\"\n").unwrap_err().to_string();
        assert!(gone.contains("t.toml"), "{gone}");
    }
}
