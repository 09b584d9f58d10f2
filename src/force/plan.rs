//! How the force of one axis is estimated: the estimator that is chosen, with its settings.

use super::balance::Method;
use super::estimator::ForceEstimator;
use super::frf::FrfEstimator;
use super::guideway::GuidewayTravel;
use super::harmonic_settings::HarmonicSettings;
use super::idle_map::IdleMap;
use super::motion::MotionSample;
use super::offline::idle_map;
use super::physics::physics_of;
use super::settings::{ForceError, ForceSettings};
use super::signals::{AxisSignals, Signals};
use crate::plant::drive::{DriveParams, Structure};
use crate::plant::machine::AxisModel;
use crate::signal::butterworth::Butterworth;
use crate::units::SampleRate;

/// How the force of one axis is estimated.
#[derive(Debug, Clone, PartialEq)]
pub enum ForcePlan {
    /// From servo signals.
    Servo(ServoPlan),
    /// From accelerometers, by speed-dependent frequency responses (`frf`).
    Accelerometers(FrfEstimator),
}

impl ForcePlan {
    /// The plan of servo signals, if it is one.
    #[must_use]
    pub fn servo(&self) -> Option<&ServoPlan> {
        match self {
            Self::Servo(plan) => Some(plan),
            Self::Accelerometers(_) => None,
        }
    }
}

/// An estimator of servo signals.
#[derive(Debug, Clone, PartialEq)]
pub struct ServoPlan {
    /// Drive as its observer knows it.
    pub drive: DriveParams,
    /// Which positions the axis measures.
    pub signals: Signals,
    /// Method.
    pub method: Method,
    /// Low-pass, idle map and the like.
    pub settings: ForceSettings,
    /// Above this the drive side (reference and rotary encoder) of the multi-encoder observer is not listened
    /// to: in the chatter band the motor hardly moves, and the steps of its encoder are larger than its
    /// motion; the stage waits for that low-pass. Other methods do not use it. `None`: all of it.
    pub motor_cutoff_hz: Option<f64>,
}

impl ServoPlan {
    /// The observer of an axis with the physics that its model has beyond the structure. Low-pass, notches,
    /// idle map and window are the defaults; `fitted` and `spectral` start at 1200 rpm and follow the
    /// spindle.
    #[must_use]
    pub fn of_axis(axis: &AxisModel, method: Method, signals: Signals) -> Self {
        let (physics, drive) = physics_of(&axis.physics, &axis.drive);
        let windowed = matches!(method, Method::Fitted | Method::Spectral);
        let settings = ForceSettings {
            guideway: physics.guideway(),
            unmodelled_modes_hz: physics.modes_hz.clone(),
            physics: Some(physics).filter(|_| method != Method::Thrust),
            harmonic: windowed.then(|| HarmonicSettings::at_speed(1200.0)),
            controller: axis.controller,
            ..ForceSettings::default()
        };
        Self { drive, signals, method, settings, motor_cutoff_hz: None }
    }
}

impl ServoPlan {
    /// The low-pass on the drive side, for balances whose stage carries on above it. Where the stretch of the
    /// screw or the thrust alone is the estimate, nothing would.
    fn drive_filter(&self, rate: SampleRate) -> Result<Option<Butterworth>, ForceError> {
        let carried_on = matches!(self.method, Method::Medob | Method::RigidMode)
            && self.signals != Signals::MotorOnly
            && self.drive.structure() != Structure::Rigid;
        let cutoff_hz = self.motor_cutoff_hz.filter(|_| carried_on);
        Ok(cutoff_hz.map(|hz| Butterworth::low_pass(2, hz, rate)).transpose()?)
    }

    /// The estimator, its drive side behind that low-pass. Errors: as [`ForceEstimator::new`].
    pub(super) fn estimator(&self, rate: SampleRate) -> Result<ForceEstimator, ForceError> {
        self.estimator_of(rate, self.settings.clone())
    }

    fn estimator_of(&self, rate: SampleRate, settings: ForceSettings) -> Result<ForceEstimator, ForceError> {
        let settings = ForceSettings { drive_filter: self.drive_filter(rate)?, ..settings };
        let signals = AxisSignals { drive: &self.drive, rate, signals: self.signals };
        ForceEstimator::new(self.method, &signals, settings)
    }

    /// Learns the travel over which the guideway's friction turns from whole runs, where the model does not
    /// state it. Errors: as [`ForceEstimator::new`].
    pub fn learn_travel(&mut self, rate: SampleRate, runs: &[&[MotionSample]]) -> Result<(), ForceError> {
        if let GuidewayTravel::Stated(_) = self.settings.guideway {
            return Ok(());
        }
        // Methods share the guideway; windows and maps have no part in it.
        let both = matches!(self.signals, Signals::Both | Signals::Three);
        let method = if both { Method::Medob } else { self.method };
        let bare = ForceSettings { idle_map: None, learn_stiffness: false, ..self.settings.clone() };
        let bare = ForceSettings { compare_sides: false, notches: Vec::new(), ..bare };
        let plan = Self { method, settings: bare, ..self.clone() };
        for run in runs {
            let estimator = plan.estimator_of(
                rate,
                ForceSettings { guideway: self.settings.guideway, ..plan.settings.clone() },
            )?;
            let Some(first) = run.first() else { continue };
            let mut state = estimator.settled(first);
            if estimator.travel(&state).is_none() {
                return Ok(());
            }
            for sample in *run {
                let _ = estimator.step(&mut state, sample);
            }
            self.settings.guideway = estimator.travel(&state).unwrap_or(self.settings.guideway);
        }
        Ok(())
    }

    /// Disturbance by position from idle runs, through the same filters as the cut. `None` where no run
    /// moves. Errors: as [`ForceEstimator::new`].
    pub fn idle_map(
        &self,
        rate: SampleRate,
        runs: &[Vec<MotionSample>],
    ) -> Result<Option<IdleMap>, ForceError> {
        let settings = ForceSettings { idle_map: None, learn_stiffness: false, ..self.settings.clone() };
        Ok(idle_map(&self.estimator_of(rate, settings)?, runs))
    }
}
