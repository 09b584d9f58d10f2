//! One axis, one method: aligned signals -> force balance -> idle map -> low-pass.

use super::above_band::AboveBand;
use super::alignment::Alignment;
use super::balance::{ForceBalance, Method};
use super::band::{band_of_lines_hz, heard_up_to_hz, usable_above_hz, usable_band_hz};
use super::beyond::Beyond;
use super::closed_loop::ClosedLoop;
use super::guideway::GuidewayTravel;
use super::guideway_learner::Guideway;
use super::harmonic::HarmonicEstimator;
use super::idle_map::IdleMap;
use super::lane_part::{LanePart, lane_part};
use super::lanes::{LaneDesign, LaneMotion, LaneState};
use super::motion::{Aligned, AlignedMotion, ForceEstimate, MotionSample, Underway};
use super::physics::PhysicsModel;
use super::settings::{Filter, ForceError, ForceSettings, MAX_NOTCHES, NotchCentre, response_to};
use super::signals::{AxisSignals, Signals, measured_balance};
use super::stiffness_learner::{LearnedStiffness, StiffnessLearner};
use super::thinned::HIGH_PASS_HZ;
use super::two_sides::{Mismatch, SeenSides, TwoSides, both_sides};
use super::validity::{Properties, Validity};
use crate::plant::drive::DriveParams;
use crate::signal::harmonic_fit::HarmonicFitError;
use crate::signal::notch::{Notch, NotchState};
use crate::units::SampleRate;

/// A designed estimator of one axis; immutable.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceEstimator {
    method: Method,
    balance: ForceBalance,
    alignment: Alignment,
    part: LanePart,
    /// Whether motor, nut and stage enter the balance.
    needs: [bool; 3],
    alone: LaneDesign<1>,
    physics: Option<PhysicsModel>,
    filter: Filter,
    idle_map: Option<IdleMap>,
    signals: Signals,
    properties: Properties,
    reach_hz: f64,
    pub(super) harmonic: Option<HarmonicEstimator>,
    travel: GuidewayTravel,
    guideway: Option<Guideway>,
    learner: Option<StiffnessLearner>,
    two_sides: Option<TwoSides>,
    notch: Option<Notch>,
    notches: Vec<NotchCentre>,
    speed_memory: f64,
    filter_delay_s: f64,
    rate: SampleRate,
}

/// State of a [`ForceEstimator`]; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceState {
    lanes: LaneState<1>,
    beyond: Beyond,
}

/// The lane of an axis among its neighbours.
pub(super) type InLane<'a, const L: usize> = (&'a LaneState<L>, usize);

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
        let late_s = settings.drive_filter.map_or(0.0, |filter| filter.slow_delay_s());
        let alignment = Alignment::new(drive, rate, late_s)?;
        let filter = Filter::new(settings.low_pass, rate)?;
        let harmonic = HarmonicEstimator::of_method(method, axis, &settings)?;
        let band_hz = filter.band_hz(settings.low_pass, rate);
        let mut part = lane_part((method, &balance), axis, &settings, (&alignment, &filter));
        let (learner, two_sides) = both_sides((method, &balance), axis, &settings, (&alignment, band_hz))?;
        part.motor_side = learner.as_ref().map(StiffnessLearner::motor_force);
        let usable_band_hz = usable_band_hz(method, axis, &settings, band_hz);
        let usable_above_hz = usable_above_hz(method, axis, &settings, band_hz);
        part.above = match harmonic {
            None => AboveBand::new((usable_band_hz[1], usable_above_hz), band_hz, rate)?,
            Some(_) => None,
        };
        let mut estimator = Self {
            method,
            balance,
            alignment,
            part,
            needs: [balance.needs_motor(), balance.needs_nut(), balance.needs_stage()],
            alone: LaneDesign::new(vec![Some(part)]),
            physics: settings.physics.clone().filter(|p| !p.is_empty()),
            idle_map: settings.idle_map.clone(),
            signals: axis.signals,
            properties: Properties {
                friction_bound_n: Some(settings.friction_bound_n(drive)),
                usable_band_hz,
                usable_above_hz,
                ..Properties::default()
            },
            reach_hz: heard_up_to_hz(method, drive, &settings, band_hz),
            harmonic,
            travel: settings.guideway,
            guideway: Guideway::new(settings.guideway, &balance, axis),
            learner,
            two_sides,
            notch: settings.notch(rate)?,
            notches: settings.notches.clone(),
            // 20 Hz: fast enough for a feed that ramps, slow enough not to follow chatter.
            speed_memory: (-std::f64::consts::TAU * 20.0 / rate.hz()).exp(),
            filter_delay_s: filter.delay_s(rate),
            filter,
            rate,
        };
        let noise_floor_n = match (method, settings.controller) {
            (Method::Thrust, Some(controller)) => {
                let steps_m = [drive.motor_encoder_resolution_m(), drive.stage_encoder_resolution_m()];
                let through = |hz| estimator.filter.gain(hz, rate);
                ClosedLoop::new(axis, controller).step_noise_n(steps_m, rate, through)
            }
            _ => estimator.quantization_noise_n(drive),
        };
        estimator.properties.noise_floor_n = noise_floor_n;
        if let Some(above) = estimator.part.above {
            let responses = estimator.step_responses(drive);
            estimator.part.above = Some(above.with_noise(noise_floor_n, &responses, rate));
            estimator.alone = LaneDesign::new(vec![Some(estimator.part)]);
        }
        estimator.set_settling();
        Ok(estimator)
    }

    /// State settled on a first sample: as if the axis had stood there for ever.
    #[must_use]
    pub fn settled(&self, first: &MotionSample) -> ForceState {
        let mut state = ForceState { lanes: self.alone.start(), beyond: self.beyond(first) };
        self.put(first, (&mut state.lanes, 0));
        self.alone.settle(&mut state.lanes, 0);
        self.settle_beyond(&mut state.beyond, first, (&state.lanes, 0));
        state
    }

    /// What the axis puts into its lane.
    pub(super) fn part(&self) -> LanePart {
        self.part
    }

    /// State of what lies beyond the lane, not yet settled.
    pub(super) fn beyond(&self, first: &MotionSample) -> Beyond {
        let linear_phase = match &self.filter {
            Filter::LinearPhase(filter) => Some(filter.settled(0.0)),
            Filter::Butterworth(_) | Filter::None => None,
        };
        Beyond {
            linear_phase,
            harmonic: self.harmonic.as_ref().map(|h| h.settled(first)),
            guideway: self.guideway.as_ref().map(|g| g.settled(0.0)),
            learned: LearnedStiffness::default(),
            sides: SeenSides::default(),
            notches: [NotchState::default(); MAX_NOTCHES],
            speed_m_s: 0.0,
        }
    }

    /// Settles it anew beside a lane that was settled. No allocation.
    pub(super) fn settle_beyond<const L: usize>(
        &self,
        state: &mut Beyond,
        first: &MotionSample,
        (lanes, lane): InLane<'_, L>,
    ) {
        let input = &lanes.input;
        let at_rest = [input.thrust_ref_n, input.motor_m, input.nut_m, input.stage_m].map(|x| x[lane]);
        let rest_n = self.part.rest.iter().zip(at_rest).map(|(factor, x)| factor * x).sum();
        if let (Filter::LinearPhase(filter), Some(inner)) = (&self.filter, &mut state.linear_phase) {
            filter.settle(inner, rest_n);
        }
        if let (Some(harmonic), Some(inner)) = (&self.harmonic, &mut state.harmonic) {
            harmonic.settle(inner, first);
        }
        if let (Some(guideway), Some(inner)) = (&self.guideway, &mut state.guideway) {
            // A window for another speed is no other guideway.
            let evidence = inner.evidence;
            *inner = guideway.settled(input.stage_m[lane]).with(evidence);
        }
        state.learned = LearnedStiffness::default();
        state.sides = SeenSides::default();
        state.notches = [NotchState::default(); MAX_NOTCHES];
        state.speed_m_s = 0.0;
    }

    /// The windows of spindle harmonics (`fitted`, `spectral`; the others have none): another spindle speed
    /// is begun there, and pieces of it are caught up with.
    pub fn windows(&mut self) -> Option<&mut HarmonicEstimator> {
        self.harmonic.as_mut()
    }

    /// Works on for about so many multiplications; true when the new windows are in use, and states of the
    /// old ones must be settled anew. No allocation.
    /// Errors: harmonics that the window cannot tell apart.
    pub fn advance_tuning(&mut self, multiplications: usize) -> Result<bool, HarmonicFitError> {
        let Some(harmonic) = &mut self.harmonic else { return Ok(true) };
        if !harmonic.advance_tuning(multiplications)? {
            return Ok(false);
        }
        self.properties.noise_floor_n = harmonic.noise_floor_n();
        self.properties.usable_band_hz = band_of_lines_hz(self.method, harmonic.lines_hz(), self.reach_hz);
        self.set_settling();
        Ok(true)
    }

    fn set_settling(&mut self) {
        // What a notch of a few hertz forgets in a tenth of a second, and the filter before the estimator.
        let notches = if self.notch.is_none() { 0.0 } else { 0.1 * self.rate.hz() };
        let late_s = self.part.drive_filter.map_or(0.0, |filter| filter.slow_delay_s());
        let extra = notches.max(8.0 * late_s * self.rate.hz()).ceil() as usize;
        let window = self.harmonic.as_ref().map_or(0, HarmonicEstimator::window_samples);
        let filter = self.filter.memory_samples(self.rate);
        self.part.settling = self.alignment.lag_samples + window + filter + extra;
        self.alone.set_settling(0, self.part.settling);
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
        self.put(sample, (&mut state.lanes, 0));
        let balance = self.alone.balance(&mut state.lanes);
        let mut now = self.underway(&balance, 0);
        if self.has_beyond() {
            self.go_beyond(&mut state.beyond, sample, (&state.lanes, 0), &mut now);
        }
        let mut flags = [now.flags];
        let [low_n] = self.alone.low_pass(&mut state.lanes, [now.force_n], &mut flags);
        let force_n = self.linear_phase(&mut state.beyond, low_n);
        (ForceEstimate { force_n, flags: flags[0] }, now.motion)
    }

    /// Puts a sample into the input of a lane; what is absent keeps its last value and is marked.
    #[inline(always)]
    pub(super) fn put<const L: usize>(
        &self,
        sample: &MotionSample,
        (lanes, lane): (&mut LaneState<L>, usize),
    ) {
        let sample = self.without_signal_errors(sample);
        let read = [sample.motor_travel_m, sample.nut_position_m, sample.stage_position_m];
        let input = &mut lanes.input;
        input.thrust_ref_n[lane] = sample.thrust_ref_n;
        input.motor_m[lane] = read[0].unwrap_or(input.motor_m[lane]);
        input.nut_m[lane] = read[1].unwrap_or(input.nut_m[lane]);
        input.stage_m[lane] = read[2].unwrap_or(input.stage_m[lane]);
        let absent = (0..3).any(|k| self.needs[k] & read[k].is_none());
        input.absent[lane] = if absent { 1.0 } else { 0.0 };
    }

    /// The balance of one lane as an estimate on its way.
    #[inline]
    pub(super) fn underway<const L: usize>(&self, balance: &LaneMotion<L>, lane: usize) -> Underway {
        let motion = AlignedMotion {
            thrust_n: balance.thrust_n[lane],
            motor_m: balance.motor_m[lane],
            motor_velocity_m_s: balance.motor_velocity_m_s[lane],
            stage_m: balance.stage_m[lane],
            stage_velocity_m_s: balance.stage_velocity_m_s[lane],
        };
        let aligned =
            Aligned { motion, inertia_n: balance.motor_side_n[lane], friction: balance.turned[lane] };
        Underway { force_n: balance.raw_n[lane], flags: balance.flags[lane], motion, aligned }
    }

    /// Whether anything but balance and Butterworth low-pass makes the estimate.
    #[inline]
    pub(super) fn has_beyond(&self) -> bool {
        matches!(self.filter, Filter::LinearPhase(_))
            || self.physics.is_some()
            || self.harmonic.is_some()
            || self.guideway.is_some()
            || self.learner.is_some()
            || self.idle_map.is_some()
            || self.notch.is_some()
    }

    /// Windows, physics, learned stiffness, idle map and notches, between balance and low-pass.
    #[inline]
    pub(super) fn go_beyond<const L: usize>(
        &self,
        state: &mut Beyond,
        sample: &MotionSample,
        lanes: InLane<'_, L>,
        now: &mut Underway,
    ) {
        match (&self.harmonic, &mut state.harmonic) {
            (Some(harmonic), Some(inner)) => {
                let windowed = harmonic.step(inner, &self.without_signal_errors(sample));
                now.force_n = windowed.force_n;
                if let Some(motion) = windowed.motion {
                    now.motion = motion;
                    now.force_n -= self.physics_n(now);
                    now.flags =
                        self.flags_of(now) | now.flags.only(Validity::SETTLING | Validity::SIGNAL_MISSING);
                }
                now.flags |= windowed.flags;
            }
            _ => now.force_n -= self.physics_n(now),
        }
        if let (Some(guideway), Some(inner)) = (&self.guideway, &mut state.guideway) {
            let (friction_n, flag) = guideway.step(inner, now);
            now.force_n -= friction_n;
            now.flags |= flag;
        }
        self.compare_sides(state, now, lanes);
        if let Some(map) = &self.idle_map {
            let velocity_m_s = self.travel_velocity_m_s(&now.motion);
            let moves = velocity_m_s.abs() >= self.part.law.still_m_s;
            let known_n = map.disturbance_n(self.position_m(&now.motion), velocity_m_s);
            now.flags |= Validity::when(moves && known_n.is_none(), Validity::EXTRAPOLATED);
            now.force_n -= known_n.unwrap_or(0.0);
        }
        now.force_n = self.notch(state, now.force_n, &now.motion);
    }

    fn flags_of(&self, now: &Underway) -> Validity {
        let speed_m_s = self.travel_velocity_m_s(&now.motion).abs();
        self.part.law.flags(speed_m_s, now.motion.thrust_n * self.balance.thrust)
    }

    /// The low-pass of one delay, where it is that one.
    #[inline]
    pub(super) fn linear_phase(&self, state: &mut Beyond, force_n: f64) -> f64 {
        match (&self.filter, &mut state.linear_phase) {
            (Filter::LinearPhase(filter), Some(inner)) => filter.step(inner, force_n),
            _ => force_n,
        }
    }

    /// Both sides of the axis: adds what the stiffness learned while cutting makes, flags what they
    /// contradict.
    #[inline]
    fn compare_sides<const L: usize>(
        &self,
        state: &mut Beyond,
        now: &mut Underway,
        (lanes, lane): InLane<'_, L>,
    ) {
        let Some(learner) = &self.learner else { return };
        if let Some(physics) = &self.physics {
            let motion = &mut now.aligned.motion;
            motion.thrust_n -= physics.motor_n(motion.motor_m, motion.motor_velocity_m_s);
        }
        let learned = &mut state.learned;
        now.force_n += learner.added_n(learned, &now.aligned);
        let seen_n = learner.step(learned, (&now.aligned, now.force_n), !lanes.is_missing(lane));
        let Some(two_sides) = &self.two_sides else { return };
        if let Some(seen_n) = seen_n.filter(|_| learner.counts(learned)) {
            two_sides.step(&mut state.sides, seen_n, learned.ratio);
        }
        now.flags |= Validity::when(state.sides.is_large(), Validity::MODE_OUTSIDE_MODEL);
    }

    /// What both sides of the axis say of the estimate; `None` where they are not compared (one encoder, a
    /// rigid axis, a low-pass on one side alone, a method without the motor's motion) or not yet.
    pub(super) fn mismatch(&self, state: &Beyond) -> Option<Mismatch> {
        self.two_sides.as_ref()?.mismatch(&state.sides, state.learned.ratio)
    }

    /// What both sides contradict each other by, whatever the method makes of it, N rms.
    pub(super) fn contradiction_n(&self, state: &ForceState) -> f64 {
        self.two_sides.as_ref().map_or(0.0, |sides| sides.contradiction_n(&state.beyond.sides))
    }

    /// Travel over which the guideway's friction turns, as it is known now; `None` where the balance has
    /// none.
    #[must_use]
    pub fn travel(&self, state: &ForceState) -> Option<GuidewayTravel> {
        self.travel_of(&state.beyond)
    }

    /// The same of a state beyond its lane.
    pub(super) fn travel_of(&self, state: &Beyond) -> Option<GuidewayTravel> {
        let turns = self.balance.stage_friction_n > 0.0;
        let learned = state.guideway.as_ref().map(|inner| GuidewayTravel::Learned(inner.evidence));
        turns.then(|| learned.unwrap_or(self.travel))
    }

    /// Stiffness in use over that of the model, where it is learned.
    #[must_use]
    pub fn learned_stiffness_ratio(&self, state: &ForceState) -> Option<f64> {
        self.learned_ratio(&state.beyond)
    }

    /// The same of a state beyond its lane.
    pub(super) fn learned_ratio(&self, state: &Beyond) -> Option<f64> {
        self.learner.as_ref()?.ratio_in_use(&state.learned)
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
    fn physics_n(&self, now: &Underway) -> f64 {
        let Some(physics) = &self.physics else { return 0.0 };
        let motion = &now.motion;
        let stage_v = self.travel_velocity_m_s(motion);
        let stage_x = self.position_m(motion);
        let (motor_x, motor_v) = match self.signals {
            Signals::StageOnly => (stage_x, stage_v),
            Signals::MotorOnly | Signals::Both | Signals::Three => {
                (motion.motor_m, motion.motor_velocity_m_s)
            }
        };
        self.balance.thrust * physics.motor_n(motor_x, motor_v)
            + self.balance.stage_disturbance * physics.stage_n(stage_x, stage_v)
    }

    #[inline]
    fn notch(&self, state: &mut Beyond, mut force_n: f64, motion: &AlignedMotion) -> f64 {
        let Some(notch) = self.notch else { return force_n };
        let speed = self.travel_velocity_m_s(motion).abs();
        state.speed_m_s += (1.0 - self.speed_memory) * (speed - state.speed_m_s);
        for (centre, inner) in self.notches.iter().zip(&mut state.notches) {
            let centre_hz = match centre {
                NotchCentre::Fixed { hz } => *hz,
                NotchCentre::MotorEncoder => state.speed_m_s * self.part.law.lines_1_m[0],
                NotchCentre::StageEncoder => state.speed_m_s * self.part.law.lines_1_m[1],
            };
            // A line slower than 5 Hz would take the force itself away.
            let centre_hz = if centre_hz < HIGH_PASS_HZ { 0.0 } else { centre_hz };
            force_n = notch.step(inner, force_n, centre_hz);
        }
        force_n
    }

    /// Whichever position the axis measures (the stage's before the motor's), m.
    #[must_use]
    pub fn position_m(&self, motion: &AlignedMotion) -> f64 {
        if self.part.by_motor { motion.motor_m } else { motion.stage_m }
    }

    /// Its velocity, m/s.
    #[must_use]
    pub fn travel_velocity_m_s(&self, motion: &AlignedMotion) -> f64 {
        if self.part.by_motor { motion.motor_velocity_m_s } else { motion.stage_velocity_m_s }
    }

    /// Method.
    #[must_use]
    pub fn method(&self) -> Method {
        self.method
    }

    /// What it states of its estimates.
    #[must_use]
    pub fn properties(&self) -> Properties {
        Properties {
            delay_s: self.alignment_lag_samples() as f64 * self.rate.period_s() + self.filter_delay_s,
            settling_samples: self.part.settling,
            condition: self.harmonic.as_ref().map(HarmonicEstimator::condition),
            ..self.properties
        }
    }

    /// Samples between the aligned instant and now, before the low-pass.
    #[must_use]
    pub fn alignment_lag_samples(&self) -> usize {
        self.harmonic.as_ref().map_or(self.alignment.lag_samples, HarmonicEstimator::lag_samples)
    }

    /// Delay of the low-pass alone in whole samples (nearest, for slow signals).
    #[must_use]
    pub fn filter_delay_samples(&self) -> usize {
        (self.filter_delay_s * self.rate.hz()).round() as usize
    }

    /// sigma^2 = q_m^2/12 sum h_m^2 + q_t^2/12 sum h_t^2 over the impulse responses of the chain.
    fn quantization_noise_n(&self, drive: &DriveParams) -> f64 {
        if let Some(harmonic) = &self.harmonic {
            return harmonic.noise_floor_n();
        }
        let scatter = |(response, step2): &(Vec<f64>, f64)| step2 * self.filter.energy(response, self.rate);
        self.step_responses(drive).iter().map(scatter).sum::<f64>().sqrt()
    }

    /// Responses of the balance to one reading of motor, nut and stage, the motor's behind the low-pass of
    /// the drive side, each with the mean square of the error that its steps make, m^2.
    fn step_responses(&self, drive: &DriveParams) -> Vec<(Vec<f64>, f64)> {
        let behind = |x: &[f64]| match self.part.drive_filter {
            Some(low_pass) => response_to(x, low_pass, self.rate),
            None => x.to_vec(),
        };
        let steps_m = [drive.motor_encoder_resolution_m(), drive.stage_encoder_resolution_m()];
        let motor = (behind(&self.part.motor[0].weights), steps_m[0]);
        let stage = (self.part.stage[0].weights.to_vec(), steps_m[1]);
        let nut = self.part.nut.map(|nut| (nut.weights.to_vec(), steps_m[1]));
        let direct = [Some(motor), nut, Some(stage)].into_iter().flatten();
        let direct = direct.filter(|_| self.method != Method::Thrust); // there through the loop alone
        direct.map(|(response, step_m)| (response, step_m * step_m / 12.0)).collect()
    }
}
