//! How the force of each axis is estimated: `[machine]` and `[machine.axes.<axis>]` of `stillcut.toml`.

use super::accelerometers::read_estimators;
use super::{ConfigError, parse_number};
use crate::force::balance::Method;
use crate::force::budget::drive_side_cutoff_hz;
use crate::force::frf::FrfEstimator;
use crate::force::guideway::GuidewayTravel;
use crate::force::harmonic_settings::Reading;
use crate::force::idle_map::IdleMap;
use crate::force::motion::MotionSample;
use crate::force::plan::{ForcePlan, ServoPlan};
use crate::force::recorded::motion_of_recording;
use crate::force::settings::{LowPass, NotchCentre};
use crate::force::signals::Signals;
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
use crate::units::SampleRate;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// What may be said of one axis; what is not said is as for all.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub(super) struct AxisToml {
    method: Option<String>,
    beside: Option<String>,
    force_cutoff_hz: Option<f64>,
    motor_cutoff_hz: Option<f64>,
    encoders: Option<String>,
    nut: Option<String>,
    turns: Option<f64>,
    harmonics: Option<usize>,
    teeth: Option<f64>,
    reading: Option<String>,
    notch: Vec<String>,
    idle: Vec<PathBuf>,
}

/// `[machine]` as far as it concerns the force.
pub(super) struct ForceToml<'a> {
    pub(super) method: &'a str,
    pub(super) force_cutoff_hz: f64,
    pub(super) motor_cutoff_hz: Option<f64>,
    pub(super) accelerometers: Option<PathBuf>,
    pub(super) axes: &'a BTreeMap<String, AxisToml>,
}

/// Name of the method that works on accelerometers.
pub const FRF: &str = "frf";

/// A method by name: of servo signals, or `None` for accelerometers.
type Choice = Option<Method>;

#[derive(Debug, Clone, PartialEq)]
struct AxisForce {
    method: Choice,
    beside: Option<Choice>,
    force_cutoff_hz: f64,
    /// `None`: where the steps of the rotary encoder end what the drive side tells.
    motor_cutoff_hz: Option<f64>,
    signals: Signals,
    nut: Option<String>,
    turns: Option<f64>,
    harmonics: Option<usize>,
    teeth: Option<f64>,
    reading: Option<Reading>,
    notches: Vec<NotchCentre>,
    idle: Vec<PathBuf>,
    /// Disturbance by position, for each method that the axis names.
    idle_maps: Vec<(Method, IdleMap)>,
    /// What the idle runs say of the guideway, where the model does not.
    guideway: GuidewayTravel,
}

/// How the force of each axis is estimated, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceConfig {
    all: AxisForce,
    axes: BTreeMap<String, AxisForce>,
    accelerometers: Vec<FrfEstimator>,
}

/// Estimators of one axis: the one that is acted on, the one beside it.
pub type Plans = [Option<ForcePlan>; 2];

impl ForceConfig {
    /// Checks the tables. Errors: an unknown method, numbers out of range, an axis that model or file of
    /// accelerometers do not know.
    pub(super) fn new(path: &Path, raw: &ForceToml<'_>, machine: &Machine) -> Result<Self, ConfigError> {
        let file = raw.accelerometers.as_deref();
        let accelerometers = file.map(read_estimators).transpose()?.unwrap_or_default();
        let reader = Reader { path, accelerometers: &accelerometers };
        let all = AxisForce {
            method: reader.method("machine.method", raw.method)?,
            beside: None,
            force_cutoff_hz: reader.cutoff("machine.force_cutoff_hz", raw.force_cutoff_hz)?,
            motor_cutoff_hz: raw
                .motor_cutoff_hz
                .map(|hz| reader.cutoff("machine.motor_cutoff_hz", hz))
                .transpose()?,
            signals: Signals::Both,
            nut: None,
            turns: None,
            harmonics: None,
            teeth: None,
            reading: None,
            notches: Vec::new(),
            idle: Vec::new(),
            idle_maps: Vec::new(),
            guideway: GuidewayTravel::default(),
        };
        let mut axes = BTreeMap::new();
        for (name, axis) in raw.axes {
            let force = reader.axis(name, axis, &all)?;
            if machine.axis(name).is_none() && force.method.is_some() {
                return Err(
                    reader.bad(&format!("machine.axes.{name}"), format!("the model has no axis {name}"))
                );
            }
            axes.insert(name.clone(), force);
        }
        Ok(Self { all, axes, accelerometers })
    }

    /// Reads the air-cutting runs that the tables name and makes their maps. Errors: one line; a run that
    /// cannot be read, that was sampled at another rate than the model states, that lacks the signals of its
    /// axis, in which the axis does not move, or through which no estimator of the axis can be made.
    pub fn read_idle_runs<E: std::fmt::Display>(
        &mut self,
        machine: &Machine,
        read: impl Fn(&Path) -> Result<Recording, E>,
    ) -> Result<(), String> {
        for (name, axis) in &mut self.axes {
            let Some(model) = machine.axis(name) else { continue };
            let mut runs = Vec::new();
            for path in &axis.idle {
                let place = |e: String| format!("machine.axes.{name}.idle: {e}");
                let recording = read(path).map_err(|e| place(e.to_string()))?;
                let (is, expected) = (recording.sample_rate.hz(), machine.sample_rate.hz());
                if (is / expected - 1.0).abs() > 1e-6 {
                    let what =
                        format!("sampled at {is} Hz, expected {expected} Hz as the machine model says");
                    return Err(place(format!("{}: axis {name}: {what}", path.display())));
                }
                let motion = motion_of_recording(&recording, name, &model.drive)
                    .map_err(|e| place(format!("{}: {e}", path.display())))?;
                // A stream of samples carries both encoders of an axis that has them.
                if motion.signals == Signals::StageOnly && model.drive.axial_stiffness_n_m() > 0.0 {
                    let is = motion.signals.name();
                    let what = "expected its rotary encoder too";
                    return Err(place(format!("{}: axis {name}: {is}, {what}", path.display())));
                }
                runs.push(motion.samples);
            }
            if !runs.is_empty() {
                axis.learn_travel(model, &runs, machine.sample_rate);
                let maps = axis.maps_of(model, &runs, machine.sample_rate);
                axis.idle_maps = maps.map_err(|what| format!("machine.axes.{name}.idle: {what}"))?;
            }
        }
        Ok(())
    }

    /// Axes whose force comes from accelerometers.
    pub fn accelerometer_axes(&self) -> impl Iterator<Item = &str> {
        let chosen = |axis: &&FrfEstimator| self.axis(&axis.axis).method.is_none();
        self.accelerometers.iter().filter(chosen).map(|e| e.axis.as_str())
    }

    /// Name of the axis of the stream that carries the third position of an axis.
    #[must_use]
    pub fn nut(&self, axis: &str) -> Option<&str> {
        self.axis(axis).nut.as_deref()
    }

    /// The estimators of an axis: none where neither model nor accelerometers know it.
    #[must_use]
    pub fn plans(&self, name: &str, model: Option<&AxisModel>, rate: SampleRate) -> Plans {
        let axis = self.axis(name);
        let plan = |choice: Choice| match choice {
            Some(method) => model.map(|model| ForcePlan::Servo(axis.servo(model, method, rate))),
            None => {
                let estimator = self.accelerometers.iter().find(|e| e.axis == name);
                estimator.cloned().map(ForcePlan::Accelerometers)
            }
        };
        [plan(axis.method), axis.beside.and_then(plan)]
    }

    fn axis(&self, name: &str) -> &AxisForce {
        self.axes.get(name).unwrap_or(&self.all)
    }
}

impl AxisForce {
    fn servo(&self, model: &AxisModel, method: Method, rate: SampleRate) -> ServoPlan {
        let mut plan = ServoPlan::of_axis(model, method, self.signals);
        if let GuidewayTravel::Learned(_) = plan.settings.guideway {
            plan.settings.guideway = self.guideway;
        }
        plan.settings.notches = self.notches.clone();
        plan.settings.learn_stiffness = true;
        plan.settings.low_pass = LowPass::Butterworth { order: 4, cutoff_hz: self.force_cutoff_hz };
        // At half the rate and above there is nothing to take away.
        plan.motor_cutoff_hz = match self.motor_cutoff_hz {
            Some(hz) => Some(hz).filter(|hz| *hz < rate.hz() / 2.0),
            None => drive_side_cutoff_hz(&model.drive, rate),
        };
        if let Some(harmonic) = &mut plan.settings.harmonic {
            harmonic.turns = self.turns.unwrap_or(harmonic.turns);
            harmonic.harmonics = self.harmonics;
            harmonic.lines_per_turn = self.teeth.unwrap_or(harmonic.lines_per_turn);
            harmonic.reading = self.reading.unwrap_or(harmonic.reading);
        }
        let map = self.idle_maps.iter().find(|(of, _)| *of == method);
        plan.settings.idle_map = map.map(|(_, map)| map.clone());
        plan
    }

    /// Travel of the guideway's friction as the air-cutting runs show it; an estimator that cannot be made is
    /// refused where its map is.
    fn learn_travel(&mut self, model: &AxisModel, runs: &[Vec<MotionSample>], rate: SampleRate) {
        let Some(method) = self.method else { return };
        let mut plan = self.servo(model, method, rate);
        let told: Vec<&[MotionSample]> = runs.iter().map(Vec::as_slice).collect();
        if plan.learn_travel(rate, &told).is_ok() {
            self.guideway = plan.settings.guideway;
        }
    }

    /// Disturbance by position of the air-cutting runs, for each method of servo signals. Errors: why there
    /// is none.
    fn maps_of(
        &self,
        model: &AxisModel,
        runs: &[Vec<MotionSample>],
        rate: SampleRate,
    ) -> Result<Vec<(Method, IdleMap)>, String> {
        let methods = [self.method, self.beside.flatten()].into_iter().flatten();
        let map = |method: Method| {
            let map = self.servo(model, method, rate).idle_map(rate, runs);
            let map = map.map_err(|e| format!("no map through {}: {e}", method.name()))?;
            let still = || "no run moves the axis by more than 50 um: nothing to align them by".to_owned();
            Ok((method, map.ok_or_else(still)?))
        };
        methods.map(map).collect()
    }
}

struct Reader<'a> {
    path: &'a Path,
    accelerometers: &'a [FrfEstimator],
}

impl Reader<'_> {
    fn bad(&self, place: &str, message: String) -> ConfigError {
        ConfigError::Content { path: self.path.to_owned(), place: place.to_owned(), message }
    }

    fn cutoff(&self, place: &str, hz: f64) -> Result<f64, ConfigError> {
        parse_number(self.path, place, hz, (1.0, 1e5))
    }

    fn method(&self, place: &str, name: &str) -> Result<Choice, ConfigError> {
        if name == FRF {
            if self.accelerometers.is_empty() {
                return Err(
                    self.bad(place, format!("`{FRF}` needs machine.accelerometers, a file of estimators"))
                );
            }
            return Ok(None);
        }
        Method::from_name(name).map(Some).ok_or_else(|| {
            let known: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
            self.bad(place, format!("`{name}` is not one of {}, {FRF}", known.join(", ")))
        })
    }

    fn axis(&self, name: &str, raw: &AxisToml, all: &AxisForce) -> Result<AxisForce, ConfigError> {
        let place = |key: &str| format!("machine.axes.{name}.{key}");
        let method = |key: &str, name: &Option<String>| {
            name.as_deref().map(|name| self.method(&place(key), name)).transpose()
        };
        let number = |key: &str, value: Option<f64>, range| {
            value.map(|value| parse_number(self.path, &place(key), value, range)).transpose()
        };
        let chosen = method("method", &raw.method)?.unwrap_or(all.method);
        let beside = method("beside", &raw.beside)?;
        let known = self.accelerometers.iter().any(|e| e.axis == name);
        if (chosen.is_none() || beside == Some(None)) && !known {
            let message = format!("the file of accelerometers has no axis {name}");
            return Err(self.bad(&format!("machine.axes.{name}"), message));
        }
        let signals = match (raw.encoders.as_deref(), &raw.nut) {
            (None | Some("both"), None) => Signals::Both,
            (None | Some("both"), Some(_)) => Signals::Three,
            (Some("motor"), None) => Signals::MotorOnly,
            (Some("stage"), None) => Signals::StageOnly,
            (Some(_), Some(_)) => {
                return Err(
                    self.bad(&place("nut"), "a third position needs `encoders = \"both\"`".to_owned())
                );
            }
            (Some(other), None) => {
                return Err(
                    self.bad(&place("encoders"), format!("`{other}` is not one of both, motor, stage"))
                );
            }
        };
        let cutoffs = [
            number("force_cutoff_hz", raw.force_cutoff_hz, (1.0, 1e5))?,
            number("motor_cutoff_hz", raw.motor_cutoff_hz, (1.0, 1e5))?,
        ];
        let reading = raw.reading.as_deref().map(|name| {
            let message = || format!("`{name}` is not one of middle, young");
            Reading::from_name(name).ok_or_else(|| self.bad(&place("reading"), message()))
        });
        let notches = raw.notch.iter().map(|name| {
            let message = || format!("`{name}` is not motor_encoder, stage_encoder or a frequency in Hz");
            NotchCentre::from_name(name).ok_or_else(|| self.bad(&place("notch"), message()))
        });
        Ok(AxisForce {
            method: chosen,
            beside,
            force_cutoff_hz: cutoffs[0].unwrap_or(all.force_cutoff_hz),
            motor_cutoff_hz: cutoffs[1].or(all.motor_cutoff_hz),
            signals,
            nut: raw.nut.clone(),
            turns: number("turns", raw.turns, (0.1, 10.0))?,
            harmonics: raw.harmonics,
            teeth: number("teeth", raw.teeth, (1.0, 100.0))?,
            reading: reading.transpose()?,
            notches: notches.collect::<Result<_, _>>()?,
            idle: raw.idle.iter().map(|p| self.path.parent().unwrap_or(Path::new("")).join(p)).collect(),
            idle_maps: Vec::new(),
            guideway: GuidewayTravel::default(),
        })
    }
}
