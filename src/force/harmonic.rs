//! Two estimators that know the spindle: positions fitted by spindle harmonics before the balance
//! (`fitted`), and spectral lines of the thrust corrected by the drive's response (`spectral`).
//!
//! Both are windows of fixed weights for one spindle speed; `observer` flags another speed and has
//! new weights made, a little in each sample, where the spindle has settled at one.

use super::alignment::Alignment;
use super::balance::{ForceBalance, Method};
use super::closed_loop::ClosedLoop;
use super::friction::{Presliding, PreslidingState};
use super::harmonic_settings::{HarmonicSettings, Reading};
use super::motion::{AlignedMotion, MotionSample};
use super::settings::{ForceError, ForceSettings};
use super::signals::{AxisSignals, Signals, measured_balance};
use super::validity::Validity;
use crate::signal::harmonic_fit::{HarmonicBasis, HarmonicDesign, HarmonicFitError, USUAL_UNKNOWNS};
use crate::signal::sliding_fit::{SlidingBasis, SlidingFit};
use crate::units::SampleRate;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Beyond this condition number the harmonics of a window are told apart by rounding only.
const ILL_CONDITIONED: f64 = 1e3;
/// Relative deviation of the spindle's speed from the design's up to which weights and responses hold:
/// over two turns the phase of harmonic 10 then errs by less than 0.1 rad.
pub(super) const SPEED_TOLERANCE: f64 = 1e-3;

/// A designed harmonic estimator.
#[derive(Debug, Clone, PartialEq)]
pub struct HarmonicEstimator {
    kind: Kind,
    settings: HarmonicSettings,
    rate: SampleRate,
    windows: Windows,
    /// Weights in the making, and the lag that they will have.
    design: HarmonicDesign,
    next_lag_samples: usize,
    /// What encoder steps make of the lines through the loop, for those weights, N rms a line (`spectral`).
    next_line_noise_n: f64,
    friction_smoothing_m_s: f64,
    /// Encoder steps of motor and stage as travel, m.
    steps_m: [f64; 2],
}

#[derive(Debug, Clone, PartialEq)]
enum Kind {
    Fitted(Fitted),
    Spectral(Spectral),
}

/// Most functionals of a window: that of the thrust, and force, position and velocity of motor and stage.
const FUNCTIONALS: usize = 7;

/// Signals under the window, in this order.
#[derive(Debug, Clone, Copy)]
enum Signal {
    Thrust,
    Motor,
    Stage,
}

/// Functionals of the window for one spindle speed, as coefficients of its inner products.
#[derive(Debug, Clone, PartialEq)]
struct Windows {
    coefficients: [Vec<f64>; FUNCTIONALS],
    energies: [f64; FUNCTIONALS],
    basis: SlidingBasis,
    condition: f64,
    lag_samples: usize,
    samples: usize,
    line_noise_n: f64,
}

#[derive(Debug, Clone, PartialEq)]
struct Fitted {
    balance: ForceBalance,
    alignment: Alignment,
    presliding: Presliding,
}

impl Fitted {
    /// What the windows stand for, by the instants that the alignment gives. The alignment's own lag (three
    /// samples and the encoders' delays) stays; the window's comes on top. Answers the lag.
    fn describe(&self, reading: Reading, rate: SampleRate, design: &mut HarmonicDesign) -> usize {
        let (basis, row) = design.functional(0);
        let middle_age = match reading {
            Reading::Middle => basis.half_window,
            Reading::Young => 0,
        };
        let young = basis.half_window as f64 - middle_age as f64;
        basis.add_row((young - self.alignment.current, 0), 1.0, row);
        let scale = [1.0, rate.hz(), rate.hz() * rate.hz()];
        let sides = [(self.alignment.motor, self.balance.motor), (self.alignment.stage, self.balance.stage)];
        for (side, (age, factors)) in sides.into_iter().enumerate() {
            let (at, first) = (young - age, 1 + 3 * side);
            let (_, row) = design.functional(first);
            for (k, factor) in factors.as_array().iter().enumerate() {
                basis.add_row((at, k), factor * scale[k], row);
            }
            for k in 0..2 {
                basis.add_row((at, k), scale[k], design.functional(first + 1 + k).1);
            }
        }
        middle_age + self.alignment.lag_samples
    }

    fn step(&self, state: &mut HarmonicState, windows: &Windows, friction_smoothing_m_s: f64) -> Windowed {
        let [thrust, motor_force, motor, motor_speed, stage_force, stage, stage_speed] =
            &windows.coefficients;
        let of = |signal: Signal, coefficients: &[f64]| state.fit.apply(signal as usize, coefficients);
        let [motor_n, stage_n] = [of(Signal::Motor, motor_force), of(Signal::Stage, stage_force)];
        let motion = AlignedMotion {
            thrust_n: of(Signal::Thrust, thrust),
            motor_m: of(Signal::Motor, motor),
            motor_velocity_m_s: of(Signal::Motor, motor_speed),
            stage_m: of(Signal::Stage, stage),
            stage_velocity_m_s: of(Signal::Stage, stage_speed),
        };
        state.presliding = self.presliding.step::<false>(state.presliding, motion.stage_m);
        let force_n = self.balance.thrust * motion.thrust_n + motor_n + stage_n
            - self.balance.motor_friction_n * (motion.motor_velocity_m_s / friction_smoothing_m_s).tanh()
            - self.balance.stage_friction_n * state.presliding.share;
        Windowed { force_n, flags: Validity::VALID, motion: Some(motion) }
    }
}

#[derive(Debug, Clone, PartialEq)]
struct Spectral {
    closed_loop: ClosedLoop,
    friction_n: f64,
    /// Least and most travel within which the guideway holds instead of sliding.
    presliding_travel_m: [f64; 2],
    uses_stage: bool,
    rate_hz: f64,
}

impl Spectral {
    /// What the windows stand for: the inverse transform of corrected lines is one sum of weights. Answers
    /// the lag.
    fn describe(&self, reading: Reading, rate: SampleRate, design: &mut HarmonicDesign) -> usize {
        // On the thrust its lines through the inverse of the closed loop; on thrust or position the lines as
        // they are; on the position the motion of the window as a whole.
        let [force, lines, velocity] = [0, 1, 2];
        let (basis, row) = design.functional(force);
        let at = match reading {
            Reading::Middle => 0.0,
            Reading::Young => basis.half_window as f64 - 3.0,
        };
        let line_hz = basis.fundamental_rad * rate.hz() / TAU;
        basis.add_filtered(at, |i| 1.0 / self.closed_loop.thrust_per_cutting(i as f64 * line_hz), row);
        basis.add_filtered(at, |_| Complex64::new(1.0, 0.0), design.functional(lines).1);
        design.functional(velocity).1[1] = rate.hz();
        (basis.half_window as f64 - at) as usize
    }

    /// What rounding to encoder steps makes of a line of the force, as white noise of the thrust would have
    /// to be, N: the mean over the lines of q^2/12 |u/e|^2 / |u/F|^2, the noise being even across a line.
    /// Checked by: force_flags::encoder_steps_reach_the_thrust_through_the_loop.
    fn line_noise_n(&self, steps_m: [f64; 2], basis: HarmonicBasis) -> f64 {
        let line_hz = basis.fundamental_rad * self.rate_hz / TAU;
        let noise_n2 = |i: usize| {
            let hz = i as f64 * line_hz;
            let reading = self.closed_loop.thrust_per_reading(hz);
            let pairs = reading.iter().zip(steps_m);
            let power: f64 = pairs.map(|(u, step_m)| u.norm_sqr() * step_m * step_m / 12.0).sum();
            power / self.closed_loop.thrust_per_cutting(hz).norm_sqr()
        };
        ((1..=basis.harmonics).map(noise_n2).sum::<f64>() / basis.harmonics as f64).sqrt()
    }

    /// On an axis that stands still the friction holds the force: what shows in the thrust, through the
    /// inverse of the closed loop, is what is beyond friction, u/G = F_cut - F_friction, so friction is added
    /// to that amplitude. Where the guideway does not slide (the axis moves by less than the travel over
    /// which friction turns), nothing is known but that the force is below friction.
    ///
    /// Where the vibration turns the velocity of a moving axis around, friction turns with it and the lines
    /// of the thrust hold it: flagged.
    /// Checked by: force::a_stopped_axis_adds_friction_to_the_corrected_amplitude.
    fn step(&self, state: &mut HarmonicState, windows: &Windows, still_m_s: f64) -> Windowed {
        let ([force, lines, velocity, ..], half_window) = (&windows.coefficients, windows.samples / 2);
        let [force_peak, travel_peak, speed_peak] = &mut state.peaks;
        let force_n = state.fit.apply(Signal::Thrust as usize, force);
        let amplitude_n = force_peak.step(force_n, half_window);
        let position = if self.uses_stage { Signal::Stage } else { Signal::Motor } as usize;
        let speed_m_s = state.fit.apply(position, velocity).abs();
        let with = |force_n, flags| Windowed { force_n, flags, motion: None };
        let lines_m = state.fit.apply(position, lines);
        let travel_m = travel_peak.step(lines_m, half_window);
        let vibration_m_s = (lines_m - state.last_lines_m).abs() * self.rate_hz;
        let fastest_m_s = speed_peak.step(vibration_m_s, half_window);
        state.last_lines_m = lines_m;
        if speed_m_s > still_m_s {
            return with(force_n, Validity::when(fastest_m_s > speed_m_s, Validity::EXTRAPOLATED));
        }
        // Friction is known to a tenth: what shows beyond it by less cannot be told from it.
        let [least_m, most_m] = self.presliding_travel_m;
        let unsure = Validity::when(
            self.friction_n > 0.0 && (least_m..most_m).contains(&travel_m),
            Validity::FRICTION_TRAVEL_UNKNOWN,
        );
        let holds = travel_m < least_m || amplitude_n < 0.1 * self.friction_n;
        if self.friction_n > 0.0 && holds {
            return with(0.0, Validity::BELOW_FRICTION);
        }
        let beyond = 1.0 + self.friction_n / amplitude_n.max(f64::MIN_POSITIVE);
        with(force_n * beyond, Validity::EXTRAPOLATED | unsure)
    }
}

/// What one sample gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Windowed {
    /// Balance (`fitted`) or force (`spectral`), N.
    pub force_n: f64,
    /// What speaks against it.
    pub flags: Validity,
    /// Motion at the instant that it belongs to; `fitted` alone.
    pub motion: Option<AlignedMotion>,
}

/// State of a [`HarmonicEstimator`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HarmonicState {
    fit: SlidingFit<3>,
    current_n: f64,
    last_ref_n: f64,
    presliding: PreslidingState,
    /// Of force, travel and speed (`spectral`).
    peaks: [PeakHold; 3],
    last_lines_m: f64,
}

crate::keyframe::keep!(HarmonicState { fit, current_n, last_ref_n, presliding, peaks, last_lines_m });

/// Largest size of a series over the last window, in two halves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct PeakHold {
    before: f64,
    now: f64,
    count: usize,
}

crate::keyframe::keep!(PeakHold { before, now, count } if |s| s.count < 1 << 32);

impl PeakHold {
    fn step(&mut self, x: f64, half_window: usize) -> f64 {
        self.count += 1;
        if self.count >= half_window {
            (self.before, self.now, self.count) = (self.now, 0.0, 0);
        }
        self.now = self.now.max(x.abs());
        self.before.max(self.now)
    }
}

impl HarmonicEstimator {
    /// That of a method which has one.
    ///
    /// `fitted`: positions replaced by the fitted curve, then the multi-encoder balance (26). Source: Hayashi
    /// et al., V. Deviation: each curve is read at its own delayed instant; the window is given in turns; the
    /// thrust is fitted too, else motion that is no harmonic of the spindle stays in the thrust after it has
    /// been taken out of the accelerations that balance it.
    ///
    /// `spectral`: lines of the thrust divided by the closed loop's response to a cutting force. Constant
    /// force is not estimated: its zero cannot be told from friction. Source: Sato et al., 4.3. Deviation:
    /// the inverse transform of the lines is one sum of weights.
    ///
    /// Errors: no spindle speed, a window that cannot be fitted, positions that the balance needs and the
    /// axis lacks (`fitted`), no controller in the model (`spectral`).
    pub(super) fn of_method(
        method: Method,
        axis: &AxisSignals<'_>,
        settings: &ForceSettings,
    ) -> Result<Option<Self>, ForceError> {
        let need = |needs| ForceError::Structure { method: method.name(), needs };
        let kind = match method {
            Method::Fitted => Kind::Fitted(Fitted {
                balance: measured_balance(method, axis)?.before_friction_learned(settings.guideway),
                alignment: Alignment::new(axis.drive, axis.rate, 0.0)?,
                presliding: Presliding::new(
                    settings.guideway.travel_m(),
                    axis.drive.stage_encoder_resolution_m(),
                ),
            }),
            Method::Spectral => Kind::Spectral(Spectral {
                closed_loop: ClosedLoop::new(
                    axis,
                    settings.controller.ok_or(need("[axes.<axis>.controller]"))?,
                ),
                friction_n: settings.friction_bound_n(axis.drive),
                presliding_travel_m: settings.guideway.bounds_m(),
                uses_stage: axis.signals != Signals::MotorOnly,
                rate_hz: axis.rate.hz(),
            }),
            _ => return Ok(None),
        };
        let harmonic = settings.harmonic.as_ref().ok_or(need("a spindle speed"))?;
        Self::new(kind, axis, harmonic).map(Some)
    }

    fn new(kind: Kind, axis: &AxisSignals<'_>, settings: &HarmonicSettings) -> Result<Self, ForceError> {
        let functionals = match kind {
            Kind::Fitted(_) => FUNCTIONALS,
            Kind::Spectral(_) => 3,
        };
        let mut made = Self {
            kind,
            settings: *settings,
            rate: axis.rate,
            windows: Windows {
                coefficients: std::array::from_fn(|_| Vec::with_capacity(USUAL_UNKNOWNS)),
                energies: [0.0; FUNCTIONALS],
                basis: SlidingBasis::default(),
                condition: f64::INFINITY,
                lag_samples: 0,
                samples: 0,
                line_noise_n: 0.0,
            },
            design: HarmonicDesign::new(functionals),
            next_lag_samples: 0,
            next_line_noise_n: 0.0,
            friction_smoothing_m_s: axis.drive.friction_smoothing_m_s(),
            steps_m: [axis.drive.motor_encoder_resolution_m(), axis.drive.stage_encoder_resolution_m()],
        };
        made.begin_tuning(settings.spindle_speed_rpm)?;
        while !made.advance_tuning(usize::MAX)? {}
        Ok(made)
    }

    /// Begins weights for another spindle speed; those of now stay in use until the others are made.
    /// Errors: a window that cannot be fitted.
    pub fn begin_tuning(&mut self, spindle_speed_rpm: f64) -> Result<(), HarmonicFitError> {
        let settings = HarmonicSettings { spindle_speed_rpm, ..self.settings };
        settings.check(self.rate)?;
        self.settings = settings;
        self.design.begin(self.settings.basis(self.rate))?;
        let (reading, rate) = (self.settings.reading, self.rate);
        self.next_lag_samples = match &self.kind {
            Kind::Fitted(fitted) => fitted.describe(reading, rate, &mut self.design),
            Kind::Spectral(spectral) => {
                self.next_line_noise_n = spectral.line_noise_n(self.steps_m, self.settings.basis(rate));
                spectral.describe(reading, rate, &mut self.design)
            }
        };
        Ok(())
    }

    /// Works on for about so many multiplications; true when the new weights are in use. No allocation.
    /// Errors: harmonics that the window cannot tell apart.
    pub fn advance_tuning(&mut self, multiplications: usize) -> Result<bool, HarmonicFitError> {
        if !self.design.advance(multiplications)? {
            return Ok(false);
        }
        for k in 0..self.design.functionals() {
            let coefficients = &mut self.windows.coefficients[k];
            coefficients.clear();
            coefficients.extend_from_slice(self.design.coefficients(k));
            self.windows.energies[k] = self.design.energy(k);
        }
        self.windows.basis.begin(self.settings.basis(self.rate));
        self.windows.condition = self.design.condition();
        self.windows.samples = self.design.samples();
        self.windows.lag_samples = self.next_lag_samples;
        self.windows.line_noise_n = self.next_line_noise_n;
        Ok(true)
    }

    /// Pieces of the weights in the making that are done, for a keyframe.
    pub(super) fn tuning_pieces(&self) -> usize {
        self.design.pieces()
    }

    /// Does so many pieces. Errors: as [`Self::advance_tuning`].
    pub(super) fn catch_up(&mut self, pieces: usize) -> Result<(), HarmonicFitError> {
        self.design.catch_up(pieces)
    }

    /// State settled on a first sample, with memory for the longest window.
    #[must_use]
    pub fn settled(&self, first: &MotionSample) -> HarmonicState {
        let mut state = HarmonicState::default();
        self.settle(&mut state, first);
        state
    }

    /// Settles a state anew. No allocation.
    pub fn settle(&self, state: &mut HarmonicState, first: &MotionSample) {
        let (motor_m, stage_m) = (first.motor_travel_m.unwrap_or(0.0), first.stage_position_m.unwrap_or(0.0));
        state.fit.settle(&self.windows.basis, [first.thrust_ref_n, motor_m, stage_m]);
        (state.current_n, state.last_ref_n) = (first.thrust_ref_n, first.thrust_ref_n);
        state.presliding = Presliding::settled(stage_m);
        state.peaks = [PeakHold::default(); 3];
        state.last_lines_m = 0.0;
    }

    /// One sample. Cost: in proportion to the harmonics, whatever the length of the window; no allocation.
    #[must_use]
    pub fn step(&self, state: &mut HarmonicState, sample: &MotionSample) -> Windowed {
        let memory = match &self.kind {
            Kind::Fitted(fitted) => fitted.alignment.current_memory,
            Kind::Spectral(_) => 0.0,
        };
        state.current_n = if memory == 0.0 {
            sample.thrust_ref_n
        } else {
            memory * (state.current_n - state.last_ref_n) + state.last_ref_n
        };
        state.last_ref_n = sample.thrust_ref_n;
        let motor_m = sample.motor_travel_m.unwrap_or_else(|| state.fit.last(Signal::Motor as usize));
        let stage_m = sample.stage_position_m.unwrap_or_else(|| state.fit.last(Signal::Stage as usize));
        state.fit.step(&self.windows.basis, [state.current_n, motor_m, stage_m]);
        let ill = Validity::when(self.windows.condition > ILL_CONDITIONED, Validity::ILL_CONDITIONED);
        let windowed = match &self.kind {
            Kind::Fitted(fitted) => fitted.step(state, &self.windows, self.friction_smoothing_m_s),
            // Slower than this the axis stands still.
            Kind::Spectral(spectral) => {
                spectral.step(state, &self.windows, 2.0 * self.friction_smoothing_m_s)
            }
        };
        Windowed { flags: windowed.flags | ill, ..windowed }
    }

    /// Samples by which an estimate lags.
    #[must_use]
    pub fn lag_samples(&self) -> usize {
        self.windows.lag_samples
    }

    /// Samples until the window is full.
    #[must_use]
    pub fn window_samples(&self) -> usize {
        self.windows.samples
    }

    /// First and last line of the speed that windows were last made for, Hz.
    #[must_use]
    pub(super) fn lines_hz(&self) -> [f64; 2] {
        self.settings.lines_hz(self.rate)
    }

    /// Condition number of the window.
    #[must_use]
    pub fn condition(&self) -> f64 {
        self.windows.condition
    }

    /// Standard deviation that the encoders' steps cause before the low-pass, N: sigma^2 = sum q^2/12 w . w;
    /// `spectral`: sigma^2 = sigma_line^2 w . w, w the weights of the lines as they are.
    #[must_use]
    pub(super) fn noise_floor_n(&self) -> f64 {
        match (&self.kind, self.windows.energies) {
            (Kind::Spectral(_), [_, lines, ..]) => self.windows.line_noise_n * lines.sqrt(),
            (Kind::Fitted(_), [_, motor, _, _, stage, ..]) => {
                (motor.sqrt() * self.steps_m[0]).hypot(stage.sqrt() * self.steps_m[1]) / 12f64.sqrt()
            }
        }
    }
}
