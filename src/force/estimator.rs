//! One axis, one method: aligned signals -> force balance -> idle map -> low-pass.

use super::alignment::Alignment;
use super::balance::{ForceBalance, Method};
use super::band::usable_band_hz;
use super::friction::{Presliding, PreslidingState};
use super::harmonic::{HarmonicEstimator, HarmonicState, harmonic_estimator};
use super::idle_map::IdleMap;
use super::physics::PhysicsModel;
use super::settings::{Filter, FilterState};
pub use super::settings::{ForceError, ForceSettings, LowPass, MAX_NOTCHES, NotchCentre, NotchPlan};
pub use super::signals::{AxisSignals, Signals};
use super::signals::{encoder_lines_1_m, measured_balance};
use super::stiffness_learner::{LearnedStiffness, StiffnessLearner};
use super::validity::Validity;
use crate::keyframe::{Keep, Words};
use crate::plant::drive::DriveParams;
use crate::signal::delay_line::DelayLine;
use crate::signal::finite_difference::{STENCIL_NODES, Stencil, stencils};
use crate::signal::harmonic_fit::HarmonicFitError;
use crate::signal::notch::{Notch, NotchState};
use crate::units::SampleRate;

/// One instant of one axis. A position that is absent is held at its last value and flagged.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionSample {
    /// Thrust reference K_t I / R on the screw axis, N.
    pub thrust_ref_n: f64,
    /// Motor angle as stage travel, m.
    pub motor_travel_m: Option<f64>,
    /// Screw at the nut as stage travel, where a third position is measured, m.
    pub nut_position_m: Option<f64>,
    /// Linear scale, m.
    pub stage_position_m: Option<f64>,
    /// Spindle speed, where it is known, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// Accelerations of the spindle housing (x, y, z), for `frf` alone, m/s2.
    pub accel_m_s2: Option<[f64; 3]>,
}

/// One estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceEstimate {
    /// Cutting force as it was [`ForceEstimator::delay_s`] ago, N; positive opposes stage motion.
    pub force_n: f64,
    /// What speaks against it.
    pub flags: Validity,
}

/// Aligned motion of one instant: what the balance works on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignedMotion {
    /// Thrust that acted, N.
    pub thrust_n: f64,
    /// Motor travel velocity, m/s.
    pub motor_velocity_m_s: f64,
    /// Stage velocity, m/s.
    pub stage_velocity_m_s: f64,
    /// Position of the stage (of the motor where there is no scale), m.
    pub position_m: f64,
}

/// A designed estimator of one axis; immutable.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceEstimator {
    method: Method,
    balance: ForceBalance,
    pub(super) alignment: Alignment,
    pub(super) motor: SideStencils,
    nut: Stencil,
    pub(super) stage: SideStencils,
    current: Stencil,
    physics: Option<PhysicsModel>,
    friction_smoothing_m_s: f64,
    presliding: Presliding,
    filter: Filter,
    idle_map: Option<IdleMap>,
    signals: Signals,
    noise_floor_n: f64,
    friction_bound_n: f64,
    band_hz: f64,
    usable_band_hz: [f64; 2],
    drive_side_late_s: f64,
    constant_flags: Validity,
    encoder_lines_1_m: [f64; 2],
    harmonic: Option<HarmonicEstimator>,
    learner: Option<StiffnessLearner>,
    notches: Vec<(NotchCentre, Notch)>,
    speed_memory: f64,
    settling: usize,
    filter_delay_s: f64,
    rate: SampleRate,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SideStencils {
    pub(super) force: Stencil,
    pub(super) velocity: Stencil,
    pub(super) position: Stencil,
}

/// State of a [`ForceEstimator`]; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceState {
    current: DelayLine,
    motor: DelayLine,
    nut: DelayLine,
    stage: DelayLine,
    current_n: f64,
    last_ref_n: f64,
    presliding: PreslidingState,
    filter: FilterState,
    harmonic: Option<HarmonicState>,
    learned: LearnedStiffness,
    notches: [NotchState; MAX_NOTCHES],
    /// Speed of the axis, slowed down: what the notches follow.
    speed_m_s: f64,
    seen: u32,
    /// Samples for which a value that was not there still rings on.
    missing: u32,
}

impl Keep for ForceState {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { current, motor, nut, stage, current_n, last_ref_n, presliding, .. } = self;
        let Self { filter, harmonic, learned, notches, speed_m_s, seen, missing, .. } = self;
        [current, motor, nut, stage].into_iter().for_each(|line| line.keep(to));
        [current_n, last_ref_n, speed_m_s].into_iter().for_each(|x| x.keep(to));
        missing.keep(to);
        presliding.keep(to);
        learned.keep(to);
        filter.keep(to);
        notches.keep(to);
        seen.keep(to);
        if let Some(harmonic) = harmonic {
            harmonic.keep(to);
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let Self { current, motor, nut, stage, current_n, last_ref_n, presliding, .. } = self;
        [current, motor, nut, stage].into_iter().try_for_each(|line| line.restore(from))?;
        let Self { filter, harmonic, learned, notches, speed_m_s, seen, missing, .. } = self;
        [current_n, last_ref_n, speed_m_s].into_iter().try_for_each(|x| x.restore(from))?;
        missing.restore(from)?;
        presliding.restore(from)?;
        learned.restore(from)?;
        filter.restore(from)?;
        notches.restore(from)?;
        seen.restore(from)?;
        harmonic.as_mut().map_or(Some(()), |h| h.restore(from))
    }
}

impl ForceEstimator {
    /// Designs the estimator of one method.
    /// Errors: a cutoff that does not fit the rate, delays too long, a position that the method needs
    /// and the axis does not measure.
    pub fn new(method: Method, axis: &AxisSignals<'_>, settings: ForceSettings) -> Result<Self, ForceError> {
        let balance = measured_balance(method, axis)?;
        Self::from_balance(method, balance, axis, settings)
    }

    /// Any other balance over the same aligned motion (a residual, one side alone).
    /// Errors: a cutoff that does not fit the rate, delays too long.
    pub fn from_balance(
        method: Method,
        balance: ForceBalance,
        axis: &AxisSignals<'_>,
        settings: ForceSettings,
    ) -> Result<Self, ForceError> {
        let (drive, rate) = (axis.drive, axis.rate);
        let alignment = Alignment::new(drive, rate, settings.drive_side_late_s)?;
        let period_s = rate.period_s();
        let side = |age: f64, factors: [f64; 3]| {
            let s = stencils(age, period_s);
            SideStencils { force: Stencil::combined(&s, factors), velocity: s[1], position: s[0] }
        };
        let filter = Filter::new(settings.low_pass, rate)?;
        let harmonic = harmonic_estimator(method, axis, &settings)?;
        let learns = settings.learn_stiffness && method == Method::VibrationMode;
        let ages = [alignment.motor, alignment.stage];
        let learner = if learns { StiffnessLearner::new(axis, &balance, ages)? } else { None };
        let band_hz = filter.band_hz(settings.low_pass, rate);
        let beyond = settings.unmodelled_modes_hz.iter().any(|f| *f < 1.1 * band_hz);
        let mut estimator = Self {
            method,
            balance,
            motor: side(alignment.motor, balance.motor.as_array()),
            // The screw's encoder is taken to be as late as the stage's.
            nut: side(alignment.stage, balance.nut.as_array()).force,
            stage: side(alignment.stage, balance.stage.as_array()),
            current: stencils(alignment.current, period_s)[0],
            physics: settings.physics.clone().filter(|p| !p.is_empty()),
            alignment,
            friction_smoothing_m_s: drive.friction_smoothing_m_s(),
            presliding: Presliding::new(settings.presliding_travel_m, drive.stage_encoder_resolution_m()),
            filter,
            idle_map: settings.idle_map.clone(),
            signals: axis.signals,
            noise_floor_n: 0.0,
            friction_bound_n: settings.friction_bound_n(drive),
            band_hz,
            usable_band_hz: usable_band_hz(method, axis, &settings, band_hz),
            drive_side_late_s: settings.drive_side_late_s,
            constant_flags: Validity::when(beyond, Validity::MODE_OUTSIDE_MODEL),
            encoder_lines_1_m: encoder_lines_1_m(drive, &balance),
            harmonic,
            learner,
            notches: settings.design_notches(rate)?,
            // 20 Hz: fast enough for a feed that ramps, slow enough not to follow chatter.
            speed_memory: (-std::f64::consts::TAU * 20.0 / rate.hz()).exp(),
            settling: 0,
            filter_delay_s: 0.0,
            rate,
        };
        estimator.noise_floor_n = estimator.quantization_noise_n(drive);
        let window = estimator.harmonic.as_ref().map_or(0, HarmonicEstimator::window_samples);
        estimator.filter_delay_s = estimator.filter.delay_s(rate);
        estimator.settling = estimator.settling_of(window);
        Ok(estimator)
    }

    /// State settled on a first sample: as if the axis had stood there for ever.
    #[must_use]
    pub fn settled(&self, first: &MotionSample) -> ForceState {
        let mut state = ForceState {
            current: DelayLine::filled(0.0),
            motor: DelayLine::filled(0.0),
            nut: DelayLine::filled(0.0),
            stage: DelayLine::filled(0.0),
            current_n: 0.0,
            last_ref_n: 0.0,
            presliding: Presliding::settled(0.0),
            filter: self.filter.settled(0.0),
            harmonic: self.harmonic.as_ref().map(|h| h.settled(first)),
            learned: LearnedStiffness::default(),
            notches: [NotchState::default(); MAX_NOTCHES],
            speed_m_s: 0.0,
            seen: 0,
            missing: 0,
        };
        self.settle(&mut state, first);
        state
    }

    /// Settles a state anew. No allocation.
    pub fn settle(&self, state: &mut ForceState, first: &MotionSample) {
        let motor = first.motor_travel_m.unwrap_or(0.0);
        let nut = first.nut_position_m.unwrap_or(0.0);
        let stage = first.stage_position_m.unwrap_or(0.0);
        let rest = self.balance.thrust * first.thrust_ref_n
            + self.balance.motor.position_n_m * motor
            + self.balance.nut.position_n_m * nut
            + self.balance.stage.position_n_m * stage;
        state.current = DelayLine::filled(first.thrust_ref_n);
        state.motor = DelayLine::filled(motor);
        state.nut = DelayLine::filled(nut);
        state.stage = DelayLine::filled(stage);
        (state.current_n, state.last_ref_n) = (first.thrust_ref_n, first.thrust_ref_n);
        state.presliding = Presliding::settled(stage);
        self.filter.settle(&mut state.filter, rest);
        state.learned = StiffnessLearner::settled();
        if let (Some(harmonic), Some(inner)) = (&self.harmonic, &mut state.harmonic) {
            harmonic.settle(inner, first);
        }
        state.notches = [NotchState::default(); MAX_NOTCHES];
        (state.speed_m_s, state.seen, state.missing) = (0.0, 0, 0);
    }

    /// Begins windows for another spindle speed (`fitted`, `spectral`; the others have none); those of now
    /// stay in use until the new ones are made. Errors: a window that cannot be fitted.
    pub fn begin_tuning(&mut self, spindle_speed_rpm: f64) -> Result<(), HarmonicFitError> {
        self.harmonic.as_mut().map_or(Ok(()), |h| h.begin_tuning(spindle_speed_rpm))
    }

    /// Works on for about so many multiplications; true when the new windows are in use, and states of the
    /// old ones must be settled anew. No allocation.
    /// Errors: harmonics that the window cannot tell apart.
    pub fn advance_tuning(&mut self, multiplications: usize) -> Result<bool, HarmonicFitError> {
        let Some(harmonic) = &mut self.harmonic else { return Ok(true) };
        if !harmonic.advance_tuning(multiplications)? {
            return Ok(false);
        }
        self.noise_floor_n = harmonic.noise_floor_n();
        let window_samples = harmonic.window_samples();
        self.settling = self.settling_of(window_samples);
        Ok(true)
    }

    /// Pieces of the windows in the making that are done, for a keyframe.
    pub(super) fn tuning_pieces(&self) -> usize {
        self.harmonic.as_ref().map_or(0, HarmonicEstimator::tuning_pieces)
    }

    /// Does so many pieces. Errors: as [`Self::advance_tuning`].
    pub(super) fn catch_up(&mut self, pieces: usize) -> Result<(), HarmonicFitError> {
        self.harmonic.as_mut().map_or(Ok(()), |h| h.catch_up(pieces))
    }

    fn settling_of(&self, window_samples: usize) -> usize {
        // What a notch of a few hertz forgets in a tenth of a second, and the filter before the estimator.
        let notches = if self.notches.is_empty() { 0.0 } else { 0.1 * self.rate.hz() };
        let before = 8.0 * self.drive_side_late_s * self.rate.hz();
        let extra = notches.max(before).ceil() as usize;
        self.alignment.lag_samples + window_samples + self.filter.memory_samples(self.rate) + extra
    }

    /// One sample in, one estimate out. Constant cost, no allocation.
    #[inline]
    #[must_use]
    pub fn step(&self, state: &mut ForceState, sample: &MotionSample) -> ForceEstimate {
        self.step_with_motion(state, sample).0
    }

    /// The same, with the motion at the instant of the balance (before the low-pass).
    #[inline]
    #[must_use]
    pub fn step_with_motion(
        &self,
        state: &mut ForceState,
        sample: &MotionSample,
    ) -> (ForceEstimate, AlignedMotion) {
        let (mut raw_n, mut motion) = self.balance_step(state, sample);
        let mut harmonic_flags = Validity::VALID;
        if let (Some(harmonic), Some(inner)) = (&self.harmonic, &mut state.harmonic) {
            let windowed = harmonic.step(inner, &self.without_signal_errors(sample));
            (raw_n, harmonic_flags) = (windowed.force_n, windowed.flags);
            if let Some((at_window, motor_m)) = windowed.motion {
                motion = at_window;
                raw_n -= self.physics_n(motor_m, &motion);
            }
        }
        self.watch_missing(state, sample);
        raw_n += self.learned_n(state, &motion);
        let disturbance_n = self
            .idle_map
            .as_ref()
            .map_or(0.0, |map| map.disturbance_n(motion.position_m, self.travel_velocity_m_s(&motion)));
        let notched_n = self.notch(state, raw_n - disturbance_n, &motion);
        let force_n = self.filter.step(&mut state.filter, notched_n);
        let flags = harmonic_flags | self.flags(state, &motion);
        (ForceEstimate { force_n, flags }, motion)
    }

    /// The balance before idle map and low-pass, with the aligned motion behind it; the instant is
    /// [`Self::alignment_lag_samples`] ago.
    #[inline]
    fn balance_step(&self, state: &mut ForceState, sample: &MotionSample) -> (f64, AlignedMotion) {
        let sample = &self.without_signal_errors(sample);
        let told_n = sample.thrust_ref_n;
        // The reference given at the last sample has driven the current until now.
        state.current_n =
            self.alignment.current_memory * (state.current_n - state.last_ref_n) + state.last_ref_n;
        if self.alignment.current_memory == 0.0 {
            state.current_n = told_n;
        }
        state.last_ref_n = told_n;
        state.current.push(state.current_n);
        state.motor.push(sample.motor_travel_m.unwrap_or_else(|| state.motor.at(0)));
        state.stage.push(sample.stage_position_m.unwrap_or_else(|| state.stage.at(0)));
        let mut nut_n = 0.0;
        if self.balance.needs_nut() {
            state.nut.push(sample.nut_position_m.unwrap_or_else(|| state.nut.at(0)));
            nut_n = state.nut.apply(&self.nut);
        }
        state.seen = state.seen.saturating_add(1);

        let motion = AlignedMotion {
            thrust_n: state.current.apply(&self.current),
            motor_velocity_m_s: state.motor.apply(&self.motor.velocity),
            stage_velocity_m_s: state.stage.apply(&self.stage.velocity),
            position_m: match self.signals {
                Signals::MotorOnly => state.motor.apply(&self.motor.position),
                Signals::StageOnly | Signals::Both | Signals::Three => {
                    state.stage.apply(&self.stage.position)
                }
            },
        };
        let motor_friction_n = if self.balance.motor_friction_n == 0.0 {
            0.0
        } else {
            self.balance.motor_friction_n * (motion.motor_velocity_m_s / self.friction_smoothing_m_s).tanh()
        };
        let stage_share =
            self.presliding.step(&mut state.presliding, state.stage.apply(&self.stage.position));
        let raw_n = self.balance.thrust * motion.thrust_n
            + state.motor.apply(&self.motor.force)
            + nut_n
            + state.stage.apply(&self.stage.force)
            - motor_friction_n
            - self.balance.stage_friction_n * stage_share
            - self
                .physics
                .as_ref()
                .map_or(0.0, |_| self.physics_n(state.motor.apply(&self.motor.position), &motion));
        (raw_n, motion)
    }

    /// What the stiffness learned while cutting adds.
    #[inline]
    fn learned_n(&self, state: &mut ForceState, motion: &AlignedMotion) -> f64 {
        let Some(learner) = &self.learner else { return 0.0 };
        let ForceState { learned, motor, stage, missing, .. } = state;
        let lines = [&*motor, &*stage];
        let told = (motion.thrust_n, motion.motor_velocity_m_s);
        learner.step(learned, told, |side, stencil| lines[side].apply(stencil), *missing == 0)
    }

    /// Stiffness in use over that of the model, where it is learned.
    #[must_use]
    pub fn learned_stiffness_ratio(&self, state: &ForceState) -> Option<f64> {
        self.learner.as_ref().map(|_| StiffnessLearner::ratio(&state.learned))
    }

    /// The sample as it would be without saturation of the torque and periodic errors of the encoders.
    #[inline]
    fn without_signal_errors(&self, sample: &MotionSample) -> MotionSample {
        let Some(physics) = &self.physics else { return *sample };
        MotionSample {
            thrust_ref_n: physics.thrust_n(sample.thrust_ref_n),
            motor_travel_m: sample.motor_travel_m.map(|x| physics.motor_travel_m(x)),
            stage_position_m: sample.stage_position_m.map(|x| physics.stage_position_m(x)),
            ..*sample
        }
    }

    /// What the model's further physics adds to the balance: motor side by the thrust's factor, stage side
    /// as it is.
    #[inline]
    fn physics_n(&self, motor_m: f64, motion: &AlignedMotion) -> f64 {
        let Some(physics) = &self.physics else { return 0.0 };
        let stage_v = self.travel_velocity_m_s(motion);
        let (motor_x, motor_v) = match self.signals {
            Signals::StageOnly => (motion.position_m, stage_v),
            Signals::MotorOnly | Signals::Both | Signals::Three => (motor_m, motion.motor_velocity_m_s),
        };
        self.balance.thrust * physics.motor_n(motor_x, motor_v)
            + self.balance.stage_disturbance * physics.stage_n(motion.position_m, stage_v)
    }

    /// Factors of the balance.
    #[must_use]
    pub fn balance(&self) -> &ForceBalance {
        &self.balance
    }

    pub(super) fn scaled_current(&self) -> Stencil {
        Stencil {
            youngest: self.current.youngest,
            weights: self.current.weights.map(|w| w * self.balance.thrust),
        }
    }

    #[inline]
    fn notch(&self, state: &mut ForceState, mut force_n: f64, motion: &AlignedMotion) -> f64 {
        if self.notches.is_empty() {
            return force_n;
        }
        let speed = self.travel_velocity_m_s(motion).abs();
        state.speed_m_s += (1.0 - self.speed_memory) * (speed - state.speed_m_s);
        for ((centre, notch), inner) in self.notches.iter().zip(&mut state.notches) {
            let centre_hz = match centre {
                NotchCentre::Fixed { hz } => *hz,
                NotchCentre::MotorEncoder => state.speed_m_s * self.encoder_lines_1_m[0],
                NotchCentre::StageEncoder => state.speed_m_s * self.encoder_lines_1_m[1],
            };
            // A line slower than 5 Hz would take the force itself away.
            let centre_hz = if centre_hz < 5.0 { 0.0 } else { centre_hz };
            force_n = notch.step(inner, force_n, centre_hz);
        }
        force_n
    }

    /// Velocity of whichever position the axis measures (the stage's before the motor's), m/s.
    #[must_use]
    pub fn travel_velocity_m_s(&self, motion: &AlignedMotion) -> f64 {
        match self.signals {
            Signals::MotorOnly => motion.motor_velocity_m_s,
            Signals::StageOnly | Signals::Both | Signals::Three => motion.stage_velocity_m_s,
        }
    }

    /// A held value enters the balance some samples later and rings in the low-pass: it is told of as long.
    fn watch_missing(&self, state: &mut ForceState, sample: &MotionSample) {
        let missing = (self.balance.needs_nut() && sample.nut_position_m.is_none())
            || (self.balance.needs_motor() && sample.motor_travel_m.is_none())
            || (self.balance.needs_stage() && sample.stage_position_m.is_none());
        let rings = u32::try_from(self.settling + STENCIL_NODES).unwrap_or(u32::MAX);
        state.missing = if missing { rings } else { state.missing.saturating_sub(1) };
    }

    fn flags(&self, state: &ForceState, motion: &AlignedMotion) -> Validity {
        let settling = (state.seen as usize) < self.settling;
        let speed = self.travel_velocity_m_s(motion).abs();
        let still = speed < 2.0 * self.friction_smoothing_m_s;
        let line = self.encoder_lines_1_m.iter().any(|lines| {
            let frequency_hz = speed * lines;
            frequency_hz > 1.0 && frequency_hz < self.band_hz
        });
        let friction_n = match self.method {
            // Its balance knows of no friction, which hides the force all the same.
            Method::Thrust => self.friction_bound_n,
            _ => {
                self.balance.motor_friction_n.abs()
                    + self.balance.stage_friction_n.abs()
                    + self.physics.as_ref().map_or(0.0, PhysicsModel::coulomb_n)
            }
        };
        let beyond_map = !still && self.idle_map.as_ref().is_some_and(|map| !map.holds(motion.position_m));
        // Without the stage's own motion in the balance, what friction holds back does not show at all.
        let hidden =
            if self.balance.needs_stage() { Validity::MEAN_NOT_OBSERVABLE } else { Validity::BELOW_FRICTION };
        let below =
            still && friction_n > 0.0 && motion.thrust_n.abs() * self.balance.thrust.abs() < friction_n;
        self.constant_flags
            | Validity::when(beyond_map, Validity::EXTRAPOLATED)
            | Validity::when(state.missing > 0, Validity::SIGNAL_MISSING)
            | Validity::when(settling, Validity::SETTLING)
            | Validity::when(line, Validity::ENCODER_LINE_IN_BAND)
            | Validity::when(below && self.method != Method::Spectral, hidden)
    }

    /// Method.
    #[must_use]
    pub fn method(&self) -> Method {
        self.method
    }

    /// By how much the estimate lags the force, s: encoder delays, stencil and low-pass (its delay for
    /// slow signals where it is not the same at every frequency).
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        self.alignment_lag_samples() as f64 * self.rate.period_s() + self.filter_delay_s
    }

    /// Samples between the aligned instant and now, before the low-pass.
    #[must_use]
    pub fn alignment_lag_samples(&self) -> usize {
        self.harmonic.as_ref().map_or(self.alignment.lag_samples, HarmonicEstimator::lag_samples)
    }

    /// Condition number of the window of spindle harmonics, where the method has one.
    #[must_use]
    pub fn condition(&self) -> Option<f64> {
        self.harmonic.as_ref().map(HarmonicEstimator::condition)
    }

    /// Force that friction can hide on an axis that stands still, N: where an estimate is flagged
    /// [`Validity::BELOW_FRICTION`], this bound is all that is known.
    #[must_use]
    pub fn friction_bound_n(&self) -> f64 {
        self.friction_bound_n
    }

    /// Delay of the low-pass alone in whole samples (nearest, for slow signals).
    #[must_use]
    pub fn filter_delay_samples(&self) -> usize {
        (self.filter_delay_s * self.rate.hz()).round() as usize
    }

    /// Band in which the estimate can be used, Hz: see [`super::band`].
    #[must_use]
    pub fn usable_band_hz(&self) -> [f64; 2] {
        self.usable_band_hz
    }

    /// Standard deviation of the estimate that the encoders' steps alone cause, N.
    #[must_use]
    pub fn noise_floor_n(&self) -> f64 {
        self.noise_floor_n
    }

    /// Samples until the filters have forgotten their start.
    #[must_use]
    pub fn settling_samples(&self) -> usize {
        self.settling
    }

    /// sigma^2 = q_m^2/12 sum h_m^2 + q_t^2/12 sum h_t^2 over the impulse responses of the chain.
    fn quantization_noise_n(&self, drive: &DriveParams) -> f64 {
        let variance = |stencil: &Stencil, step_m: f64| {
            if step_m == 0.0 {
                return 0.0;
            }
            step_m * step_m / 12.0 * self.filter.energy(&stencil.weights, self.rate)
        };
        if let Some(harmonic) = &self.harmonic {
            return harmonic.noise_floor_n();
        }
        let motor = variance(&self.motor.force, drive.motor_encoder_resolution_m());
        let stage = variance(&self.stage.force, drive.stage_encoder_resolution_m());
        let nut = variance(&self.nut, drive.stage_encoder_resolution_m());
        (motor + nut + stage).sqrt()
    }
}
