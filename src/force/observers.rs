//! The estimators of all axes of a machine, those of servo signals side by side.
//!
//! ```text
//!  MotionSample --> lanes: alignment, balance --> windows, physics, map of an axis --> lanes: low-pass --> N
//!       |            (windows made anew, a little in each sample, where the spindle has another speed)
//!       `-accelerations--> FrfStream
//! ```

use super::beyond::Beyond;
use super::estimator::ForceEstimator;
use super::follow::Follow;
use super::frf_stream::FrfStream;
use super::guideway::GuidewayTravel;
use super::lanes::{LaneDesign, LaneMotion, LaneState};
use super::motion::{ForceEstimate, MotionSample, Underway};
use super::plan::{ForcePlan, ServoPlan};
use super::settings::ForceError;
use super::two_sides::Mismatch;
use super::validity::{Properties, Validity};
use crate::keyframe::{Keep, Words};
use crate::units::SampleRate;

/// The running estimators of up to `L` axes.
#[derive(Debug, Clone)]
pub struct Observers<const L: usize> {
    axes: Vec<AxisObserver>,
    /// Of the axes with servo signals; `None`: there are none.
    lanes: Option<LaneDesign<L>>,
    state: Option<LaneState<L>>,
    /// Some axis has more than a balance and a Butterworth low-pass.
    beyond: bool,
    /// Some axis has accelerometers.
    streams: bool,
}

/// The estimator of one axis: what it is, and what of its state does not lie in a lane.
#[derive(Debug, Clone)]
pub struct AxisObserver(Kind);

#[derive(Debug, Clone)]
enum Kind {
    Servo(Box<Servo>),
    Accelerometers(Box<FrfStream>),
    /// The force comes from elsewhere.
    Absent,
}

#[derive(Debug, Clone)]
struct Servo {
    estimator: ForceEstimator,
    follow: Option<Follow>,
    beyond: Option<Beyond>,
}

impl AxisObserver {
    /// Designs the estimator. Errors: as [`ForceEstimator::new`] and [`FrfStream::new`].
    pub fn new(plan: &ForcePlan, rate: SampleRate) -> Result<Self, ForceError> {
        Ok(Self(match plan {
            ForcePlan::Servo(plan) => Kind::Servo(Box::new(Servo::new(plan, rate)?)),
            ForcePlan::Accelerometers(estimator) => {
                Kind::Accelerometers(Box::new(FrfStream::new(estimator.clone(), rate)?))
            }
        }))
    }

    /// An axis whose force is not estimated: zero.
    #[must_use]
    pub fn absent() -> Self {
        Self(Kind::Absent)
    }

    fn servo(&self) -> Option<&Servo> {
        match &self.0 {
            Kind::Servo(servo) => Some(servo),
            Kind::Accelerometers(_) | Kind::Absent => None,
        }
    }

    /// Axial stiffness in use over that of the model, where it is learned while cutting.
    #[must_use]
    pub fn learned_stiffness_ratio(&self) -> Option<f64> {
        let servo = self.servo()?;
        servo.estimator.learned_ratio(servo.beyond.as_ref()?)
    }

    /// Travel over which the guideway's friction turns, as it is known now; `None` where it has no part.
    #[must_use]
    pub fn guideway_travel(&self) -> Option<GuidewayTravel> {
        let servo = self.servo()?;
        servo.estimator.travel_of(servo.beyond.as_ref()?)
    }

    /// What both sides of the axis say of the estimate, where they are compared.
    #[must_use]
    pub fn mismatch(&self) -> Option<Mismatch> {
        let servo = self.servo()?;
        servo.estimator.mismatch(servo.beyond.as_ref()?)
    }

    /// What it states of its estimates; nothing where the force comes from elsewhere.
    #[must_use]
    pub fn properties(&self) -> Properties {
        match &self.0 {
            Kind::Servo(servo) => servo.estimator.properties(),
            Kind::Accelerometers(stream) => stream.properties(),
            Kind::Absent => Properties::default(),
        }
    }

    /// Whether any of a band, Hz, lies where the estimate can be used; true where nothing is estimated.
    #[must_use]
    pub fn reaches(&self, [low_hz, high_hz]: [f64; 2]) -> bool {
        let Properties { usable_band_hz: [from_hz, to_hz], usable_above_hz, .. } = self.properties();
        let inside = low_hz <= to_hz && high_hz >= from_hz;
        let above = usable_above_hz.is_some_and(|again_hz| high_hz >= again_hz);
        matches!(self.0, Kind::Absent) || inside || above
    }
}

const NO_ESTIMATE: ForceEstimate = ForceEstimate { force_n: 0.0, flags: Validity::VALID };

impl<const L: usize> Observers<L> {
    /// Puts the estimators of the axes side by side; an axis without one gives zero. Requires: at most `L`.
    #[must_use]
    pub fn new(axes: Vec<AxisObserver>) -> Self {
        let part = |axis: &AxisObserver| Some(axis.servo()?.estimator.part());
        let parts: Vec<_> = axes.iter().map(part).collect();
        let lanes = parts.iter().any(Option::is_some).then(|| LaneDesign::new(parts));
        let beyond = axes.iter().filter_map(AxisObserver::servo).any(|servo| servo.estimator.has_beyond());
        let streams = axes.iter().any(|axis| matches!(axis.0, Kind::Accelerometers(_)));
        Self { axes, lanes, state: None, beyond, streams }
    }

    /// The estimator of one axis.
    #[must_use]
    pub fn axis(&self, axis: usize) -> Option<&AxisObserver> {
        self.axes.get(axis).filter(|axis| !matches!(axis.0, Kind::Absent))
    }

    /// One sample of every axis in, one estimate of each out. The first one settles the filters and alone
    /// asks for memory.
    #[inline]
    pub fn step(&mut self, sample: impl Fn(usize) -> MotionSample) -> [ForceEstimate; L] {
        let Some(lanes) = &mut self.lanes else {
            let mut estimates = [NO_ESTIMATE; L];
            self.step_streams(&sample, &mut estimates);
            return estimates;
        };
        let first = self.state.is_none();
        let state = self.state.get_or_insert_with(|| lanes.start());
        for (lane, axis) in self.axes.iter_mut().enumerate() {
            let Kind::Servo(servo) = &mut axis.0 else { continue };
            let now = sample(lane);
            servo.estimator.put(&now, (state, lane));
            let arrived = servo.follow.is_some() && servo.follow_spindle(now.spindle_speed_rpm, first);
            if first || arrived {
                // A fresh copy: one whose address nobody asks for stays in registers.
                let sample = sample(lane);
                lanes.set_settling(lane, servo.estimator.properties().settling_samples);
                lanes.settle(state, lane);
                servo.settle(&sample, (state, lane));
            }
        }
        let mut balance = lanes.balance(state);
        if self.beyond {
            for (lane, axis) in self.axes.iter_mut().enumerate() {
                let Kind::Servo(servo) = &mut axis.0 else { continue };
                let now = servo.go_beyond(&sample(lane), (state, lane), &balance);
                (balance.raw_n[lane], balance.flags[lane]) = (now.force_n, now.flags);
            }
        }
        let mut force_n = lanes.low_pass(state, balance.raw_n, &mut balance.flags);
        if self.beyond {
            for (axis, force_n) in self.axes.iter_mut().zip(&mut force_n) {
                let Kind::Servo(servo) = &mut axis.0 else { continue };
                *force_n = servo.linear_phase(*force_n);
            }
        }
        let together = force_n.into_iter().zip(balance.flags);
        let mut estimates = [NO_ESTIMATE; L];
        for (estimate, (force_n, flags)) in estimates.iter_mut().zip(together) {
            *estimate = ForceEstimate { force_n, flags };
        }
        if self.streams {
            self.step_streams(&sample, &mut estimates);
        }
        estimates
    }

    fn step_streams(&mut self, sample: &impl Fn(usize) -> MotionSample, estimates: &mut [ForceEstimate; L]) {
        for (place, (axis, estimate)) in self.axes.iter_mut().zip(estimates).enumerate() {
            let Kind::Accelerometers(stream) = &mut axis.0 else { continue };
            let sample = sample(place);
            *estimate = stream.step(sample.accel_m_s2, sample.spindle_speed_rpm.unwrap_or(0.0));
        }
    }

    /// Forgets all but the design.
    pub fn restart(&mut self) {
        self.state = None;
        for AxisObserver(kind) in &mut self.axes {
            match kind {
                Kind::Servo(servo) => servo.beyond = None,
                Kind::Accelerometers(stream) => stream.restart(),
                Kind::Absent => {}
            }
        }
    }
}

impl Observers<1> {
    /// The only axis. Requires: made with one.
    pub(super) fn alone(&self) -> &AxisObserver {
        &self.axes[0]
    }
}

/// Multiplications that one sample spends on windows for another speed: a few microseconds.
const TUNING_WORK: usize = 1 << 14;

impl Servo {
    fn new(plan: &ServoPlan, rate: SampleRate) -> Result<Self, ForceError> {
        let estimator = plan.estimator(rate)?;
        let windowed = plan.settings.harmonic.filter(|_| estimator.harmonic.is_some());
        let follow = windowed.map(|h| Follow::new(h.spindle_speed_rpm, rate));
        Ok(Self { estimator, follow, beyond: None })
    }

    fn settle<const L: usize>(&mut self, sample: &MotionSample, lane: (&LaneState<L>, usize)) {
        let estimator = &self.estimator;
        let beyond = self.beyond.get_or_insert_with(|| estimator.beyond(sample));
        estimator.settle_beyond(beyond, sample, lane);
    }

    #[inline]
    fn go_beyond<const L: usize>(
        &mut self,
        sample: &MotionSample,
        (state, lane): (&LaneState<L>, usize),
        balance: &LaneMotion<L>,
    ) -> Underway {
        let mut now = self.estimator.underway(balance, lane);
        if let Some(beyond) = self.beyond.as_mut().filter(|_| self.estimator.has_beyond()) {
            self.estimator.go_beyond(beyond, sample, (state, lane), &mut now);
        }
        // A window made for another speed gives numbers without meaning.
        let off_speed = self.follow.as_ref().is_some_and(|follow| follow.off);
        now.flags |= Validity::when(off_speed, Validity::EXTRAPOLATED | Validity::SETTLING);
        now
    }

    #[inline]
    fn linear_phase(&mut self, force_n: f64) -> f64 {
        let estimator = &self.estimator;
        self.beyond.as_mut().map_or(force_n, |beyond| estimator.linear_phase(beyond, force_n))
    }

    /// Watches the spindle and works on windows for its speed; true when they are in use and the filters must
    /// be settled anew. A speed that cannot be (window too long) leaves everything as it was.
    fn follow_spindle(&mut self, speed_rpm: Option<f64>, first: bool) -> bool {
        let Some(follow) = &mut self.follow else { return false };
        let Some(speed_rpm) = speed_rpm.map(f64::abs) else {
            // Nothing says that it turns at another speed.
            follow.off = false;
            return false;
        };
        let wanted_rpm = follow.step(speed_rpm, first);
        if let Some(wanted_rpm) = wanted_rpm.filter(|_| first || !follow.is_tuning()) {
            follow.target_rpm = wanted_rpm;
            let begun = self.estimator.windows().map(|windows| windows.begin_tuning(wanted_rpm));
            if matches!(begun, Some(Err(_))) {
                follow.target_rpm = f64::NAN;
            }
        }
        if !follow.is_tuning() {
            return false;
        }
        // Before the first sample there is no estimate that could wait.
        let work = if first { usize::MAX } else { TUNING_WORK };
        let arrived = self.estimator.advance_tuning(work);
        match arrived {
            Ok(true) => follow.arrived(),
            Ok(false) => {}
            Err(_) => follow.target_rpm = f64::NAN,
        }
        arrived == Ok(true)
    }
}

impl<const L: usize> Keep for Observers<L> {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { axes, lanes: _, state, beyond: _, streams: _ } = self;
        state.is_some().keep(to);
        for AxisObserver(kind) in axes {
            match kind {
                Kind::Servo(servo) => servo.keep(to),
                Kind::Accelerometers(stream) => stream.keep(to),
                Kind::Absent => {}
            }
        }
        if let Some(state) = state {
            state.keep(to);
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let mut running = false;
        running.restore(from)?;
        for AxisObserver(kind) in &mut self.axes {
            match kind {
                Kind::Servo(servo) => servo.take_back(running, from)?,
                Kind::Accelerometers(stream) => stream.restore(from)?,
                Kind::Absent => {}
            }
        }
        self.state = None;
        if let Some(lanes) = self.lanes.as_mut().filter(|_| running) {
            for (lane, axis) in self.axes.iter().enumerate() {
                if let Some(servo) = axis.servo() {
                    lanes.set_settling(lane, servo.estimator.properties().settling_samples);
                }
            }
            self.state.insert(lanes.start()).restore(from)?;
        }
        Some(())
    }
}

impl Servo {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { estimator, follow, beyond } = self;
        if let (Some(follow), Some(windows)) = (follow, &estimator.harmonic) {
            follow.keep(to);
            windows.tuning_pieces().keep(to);
        }
        if let Some(beyond) = beyond {
            beyond.keep(to);
        }
    }

    fn take_back(&mut self, running: bool, from: &mut Words<'_>) -> Option<()> {
        if let Some(follow) = &mut self.follow {
            let before_rpm = follow.design_rpm;
            follow.restore(from)?;
            let mut pieces = 0;
            pieces.restore(from)?;
            if follow.design_rpm.to_bits() != before_rpm.to_bits() {
                self.estimator.windows()?.begin_tuning(follow.design_rpm).ok()?;
                self.estimator.advance_tuning(usize::MAX).ok()?;
            }
            if follow.is_tuning() {
                let windows = self.estimator.windows()?;
                windows.begin_tuning(follow.target_rpm).ok()?;
                windows.catch_up(pieces).ok()?;
            }
        }
        self.beyond = None;
        if running {
            self.beyond.insert(self.estimator.beyond(&MotionSample::default())).restore(from)?;
        }
        Some(())
    }
}
