//! The force of one axis, sample by sample: whichever estimator a plan names, with what it needs to run live.
//!
//! ```text
//!  MotionSample --[motor side low-pass]--> ForceEstimator (windows made anew, a little in each sample, where
//!               |                          the spindle has settled at another speed)
//!               `-accelerations----------> FrfStream
//! ```
//! The live pipeline and `stillcut force` both step an [`Observer`]: one code, one number.

use super::balance::Method;
use super::estimator::{
    AxisSignals, ForceError, ForceEstimate, ForceEstimator, ForceSettings, ForceState, MotionSample, Signals,
};
use super::frf::FrfEstimator;
use super::frf_stream::FrfStream;
use super::harmonic::{HarmonicSettings, SPEED_TOLERANCE};
use super::idle_map::IdleMap;
use super::offline::idle_map;
use super::physics::physics_of;
use super::validity::Validity;
use crate::keyframe::{Keep, Words};
use crate::plant::drive::{DriveParams, Structure};
use crate::plant::machine::AxisModel;
use crate::signal::butterworth::{Butterworth, ButterworthState};
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
            presliding_travel_m: physics.presliding_travel_m(),
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

    /// The settings with the lag of that low-pass, which the stage's side waits for.
    fn late_settings(&self, drive_filter: Option<&Butterworth>) -> ForceSettings {
        let drive_side_late_s = drive_filter.map_or(0.0, Butterworth::slow_delay_s);
        ForceSettings { drive_side_late_s, ..self.settings.clone() }
    }

    /// Disturbance by position from idle runs, through the same filters as the cut. `None` where no run
    /// moves. Errors: as [`Observer::new`].
    pub fn idle_map(
        &self,
        rate: SampleRate,
        runs: &[Vec<MotionSample>],
    ) -> Result<Option<IdleMap>, ForceError> {
        let filter = self.drive_filter(rate)?;
        let settings =
            ForceSettings { idle_map: None, learn_stiffness: false, ..self.late_settings(filter.as_ref()) };
        let signals = AxisSignals { drive: &self.drive, rate, signals: self.signals };
        let bare = ForceEstimator::new(self.method, &signals, settings)?;
        let Some(filter) = filter else { return Ok(idle_map(&bare, runs)) };
        let filtered = |run: &Vec<MotionSample>| {
            let first = run.first().copied().unwrap_or_default();
            let mut state = drive_state(&filter, &first);
            run.iter().map(|sample| filter_drive(&filter, &mut state, *sample)).collect()
        };
        Ok(idle_map(&bare, &runs.iter().map(filtered).collect::<Vec<Vec<MotionSample>>>()))
    }
}

fn drive_state(filter: &Butterworth, first: &MotionSample) -> [ButterworthState; 2] {
    [filter.settled(first.motor_travel_m.unwrap_or(0.0)), filter.settled(first.thrust_ref_n)]
}

/// Both sides of the motor's balance alike: what one loses the other must lose.
#[inline]
fn filter_drive(
    filter: &Butterworth,
    [motor, thrust]: &mut [ButterworthState; 2],
    mut sample: MotionSample,
) -> MotionSample {
    sample.motor_travel_m = sample.motor_travel_m.map(|x| filter.step(motor, x));
    sample.thrust_ref_n = filter.step(thrust, sample.thrust_ref_n);
    sample
}

/// The running estimator of one axis.
#[derive(Debug, Clone)]
pub struct Observer(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Servo(Box<Servo>),
    Accelerometers(Box<FrfStream>),
}

#[derive(Debug, Clone)]
struct Servo {
    estimator: ForceEstimator,
    drive_filter: Option<Butterworth>,
    follow: Option<Follow>,
    running: Option<Running>,
}

#[derive(Debug, Clone)]
struct Running {
    force: ForceState,
    drive: Option<[ButterworthState; 2]>,
}

impl Observer {
    /// Designs the estimator. Errors: as [`ForceEstimator::new`] and [`FrfStream::new`].
    pub fn new(plan: &ForcePlan, rate: SampleRate) -> Result<Self, ForceError> {
        Ok(Self(match plan {
            ForcePlan::Servo(plan) => Kind::Servo(Box::new(Servo::new(plan, rate)?)),
            ForcePlan::Accelerometers(estimator) => {
                Kind::Accelerometers(Box::new(FrfStream::new(estimator.clone(), rate)?))
            }
        }))
    }

    /// One sample in, one estimate out. The first one settles the filters and alone asks for memory.
    #[inline]
    pub fn step(&mut self, sample: &MotionSample) -> ForceEstimate {
        match &mut self.0 {
            Kind::Servo(servo) => servo.step(sample),
            Kind::Accelerometers(stream) => {
                stream.step(sample.accel_m_s2, sample.spindle_speed_rpm.unwrap_or(0.0))
            }
        }
    }

    /// Forgets all but the design.
    pub fn restart(&mut self) {
        match &mut self.0 {
            Kind::Servo(servo) => servo.running = None,
            Kind::Accelerometers(stream) => stream.restart(),
        }
    }

    fn servo(&self) -> Option<&ForceEstimator> {
        match &self.0 {
            Kind::Servo(servo) => Some(&servo.estimator),
            Kind::Accelerometers(_) => None,
        }
    }

    /// Axial stiffness in use over that of the model, where it is learned while cutting.
    #[must_use]
    pub fn learned_stiffness_ratio(&self) -> Option<f64> {
        match &self.0 {
            Kind::Servo(servo) => {
                let running = servo.running.as_ref()?;
                servo.estimator.learned_stiffness_ratio(&running.force)
            }
            Kind::Accelerometers(_) => None,
        }
    }

    /// Condition number of the window of spindle harmonics, or of the fit behind an estimator of
    /// accelerometers.
    #[must_use]
    pub fn condition(&self) -> Option<f64> {
        match &self.0 {
            Kind::Servo(servo) => servo.estimator.condition(),
            Kind::Accelerometers(stream) => Some(stream.estimator().condition),
        }
    }

    /// Force that friction can hide on an axis that stands still, N; `None` where friction plays no part.
    #[must_use]
    pub fn friction_bound_n(&self) -> Option<f64> {
        self.servo().map(ForceEstimator::friction_bound_n)
    }

    /// Samples until the filters have forgotten their start.
    #[must_use]
    pub fn settling_samples(&self) -> usize {
        match &self.0 {
            Kind::Servo(servo) => servo.estimator.settling_samples(),
            Kind::Accelerometers(stream) => stream.settling_samples(),
        }
    }

    /// By how much the estimate lags the force, s.
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        match &self.0 {
            Kind::Servo(servo) => servo.estimator.delay_s(),
            Kind::Accelerometers(stream) => stream.delay_s(),
        }
    }

    /// Standard deviation that encoder steps (of accelerometers: their noise) cause, N.
    #[must_use]
    pub fn noise_floor_n(&self) -> f64 {
        match &self.0 {
            Kind::Servo(servo) => servo.estimator.noise_floor_n(),
            Kind::Accelerometers(stream) => stream.estimator().noise_floor_n,
        }
    }

    /// Band in which the estimate can be used, Hz.
    #[must_use]
    pub fn usable_band_hz(&self) -> [f64; 2] {
        match &self.0 {
            Kind::Servo(servo) => servo.estimator.usable_band_hz(),
            Kind::Accelerometers(stream) => stream.estimator().band_hz(),
        }
    }
}

/// Multiplications that one sample spends on windows for another speed: a few microseconds.
const TUNING_WORK: usize = 1 << 14;

impl Servo {
    fn new(plan: &ServoPlan, rate: SampleRate) -> Result<Self, ForceError> {
        let signals = AxisSignals { drive: &plan.drive, rate, signals: plan.signals };
        let drive_filter = plan.drive_filter(rate)?;
        Ok(Self {
            estimator: ForceEstimator::new(plan.method, &signals, plan.late_settings(drive_filter.as_ref()))?,
            drive_filter,
            follow: plan.settings.harmonic.map(|h| Follow::new(h.spindle_speed_rpm, rate)),
            running: None,
        })
    }

    #[inline]
    fn step(&mut self, sample: &MotionSample) -> ForceEstimate {
        let off_speed = match sample.spindle_speed_rpm {
            Some(speed_rpm) if self.follow.is_some() => self.follow_spindle(speed_rpm.abs(), sample),
            _ => false,
        };
        let (estimator, filter) = (&self.estimator, &self.drive_filter);
        let running = self.running.get_or_insert_with(|| Running {
            force: estimator.settled(sample),
            drive: filter.as_ref().map(|filter| drive_state(filter, sample)),
        });
        let sample = match (filter, &mut running.drive) {
            (Some(filter), Some(state)) => filter_drive(filter, state, *sample),
            _ => *sample,
        };
        let mut estimate = estimator.step(&mut running.force, &sample);
        // A window made for another speed gives numbers without meaning.
        estimate.flags |= Validity::when(off_speed, Validity::EXTRAPOLATED | Validity::SETTLING);
        estimate
    }

    /// Watches the spindle and works on windows for its speed; true while those in use are for another one.
    /// A speed that cannot be (window too long) leaves everything as it was.
    fn follow_spindle(&mut self, speed_rpm: f64, sample: &MotionSample) -> bool {
        let Some(follow) = &mut self.follow else { return false };
        let first = self.running.is_none();
        let wanted_rpm = follow.step(speed_rpm, first);
        if let Some(wanted_rpm) = wanted_rpm.filter(|_| first || !follow.is_tuning()) {
            follow.target_rpm = wanted_rpm;
            if self.estimator.begin_tuning(wanted_rpm).is_err() {
                follow.target_rpm = f64::NAN;
            }
        }
        if follow.is_tuning() {
            // Before the first sample there is no estimate that could wait.
            let work = if first { usize::MAX } else { TUNING_WORK };
            match self.estimator.advance_tuning(work) {
                Ok(true) => {
                    follow.arrived();
                    if let Some(running) = &mut self.running {
                        self.estimator.settle(&mut running.force, sample);
                    }
                }
                Ok(false) => {}
                Err(_) => follow.target_rpm = f64::NAN,
            }
        }
        follow.off
    }
}

/// Watches whether the spindle turns as fast as a window was made for.
#[derive(Debug, Clone, PartialEq)]
struct Follow {
    design_rpm: f64,
    /// Speed that windows are being made for; NaN: none.
    target_rpm: f64,
    sum_rpm: f64,
    count: usize,
    before_rpm: f64,
    off: bool,
    block: usize,
}

crate::keyframe::keep!(Follow { design_rpm, target_rpm, sum_rpm, count, before_rpm, off, block });

/// Over which the spindle's speed is averaged, s: an encoder's noise in it is then far below the tolerance.
const SPEED_BLOCK_S: f64 = 0.25;

impl Follow {
    fn new(design_rpm: f64, rate: SampleRate) -> Self {
        let block = (SPEED_BLOCK_S * rate.hz()).ceil() as usize;
        let target_rpm = f64::NAN;
        Self { design_rpm, target_rpm, sum_rpm: 0.0, count: 0, before_rpm: 0.0, off: false, block }
    }

    fn is_tuning(&self) -> bool {
        !self.target_rpm.is_nan()
    }

    /// The windows for the target are in use.
    fn arrived(&mut self) {
        (self.design_rpm, self.target_rpm, self.off) = (self.target_rpm, f64::NAN, false);
    }

    /// Answers a speed to design for, where it is not that of the design: that of the first sample, later one
    /// that two means in a row agree on.
    #[inline]
    fn step(&mut self, speed_rpm: f64, first: bool) -> Option<f64> {
        let differs = |a: f64, b: f64| !((a - b).abs() <= SPEED_TOLERANCE * b);
        if first {
            (self.sum_rpm, self.count, self.before_rpm) = (0.0, 0, 0.0);
            self.off = differs(speed_rpm, self.design_rpm);
            return (speed_rpm > 0.0 && self.off).then_some(speed_rpm);
        }
        self.sum_rpm += speed_rpm;
        self.count += 1;
        if self.count < self.block {
            return None;
        }
        let mean_rpm = self.sum_rpm / self.count as f64;
        let steady = !differs(mean_rpm, self.before_rpm);
        (self.sum_rpm, self.count, self.before_rpm) = (0.0, 0, mean_rpm);
        self.off = differs(mean_rpm, self.design_rpm);
        (steady && self.off).then_some(mean_rpm)
    }
}

impl Keep for Observer {
    fn keep(&self, to: &mut Vec<u64>) {
        match &self.0 {
            Kind::Servo(servo) => servo.keep(to),
            Kind::Accelerometers(stream) => stream.keep(to),
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        match &mut self.0 {
            Kind::Servo(servo) => servo.restore(from),
            Kind::Accelerometers(stream) => stream.restore(from),
        }
    }
}

impl Keep for Servo {
    fn keep(&self, to: &mut Vec<u64>) {
        if let Some(follow) = &self.follow {
            follow.keep(to);
            self.estimator.tuning_pieces().keep(to);
        }
        self.running.is_some().keep(to);
        if let Some(running) = &self.running {
            running.force.keep(to);
            if let Some(drive) = &running.drive {
                drive.keep(to);
            }
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        if let Some(follow) = &mut self.follow {
            let before_rpm = follow.design_rpm;
            follow.restore(from)?;
            let mut pieces = 0;
            pieces.restore(from)?;
            if follow.design_rpm.to_bits() != before_rpm.to_bits() {
                self.estimator.begin_tuning(follow.design_rpm).ok()?;
                self.estimator.advance_tuning(usize::MAX).ok()?;
            }
            if follow.is_tuning() {
                self.estimator.begin_tuning(follow.target_rpm).ok()?;
                self.estimator.catch_up(pieces).ok()?;
            }
        }
        let mut running = false;
        running.restore(from)?;
        self.running = None;
        if running {
            let mut force = self.estimator.settled(&MotionSample::default());
            force.restore(from)?;
            let mut drive = self.drive_filter.as_ref().map(|f| [f.settled(0.0), f.settled(0.0)]);
            if let Some(drive) = &mut drive {
                drive.restore(from)?;
            }
            self.running = Some(Running { force, drive });
        }
        Some(())
    }
}
