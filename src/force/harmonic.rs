//! Two estimators that know the spindle: positions fitted by spindle harmonics before the balance
//! (`fitted`), and spectral lines of the thrust corrected by the drive's response (`spectral`).
//!
//! Both are windows of fixed weights for the spindle speed that they were designed for;
//! [`super::observer`] flags another speed and makes a new design where the spindle has settled at one.

use super::alignment::Alignment;
use super::balance::{ForceBalance, Method, MotionFactors};
use super::estimator::{AlignedMotion, AxisSignals, ForceError, MotionSample, Signals};
use super::friction::{Presliding, PreslidingState};
use super::response::Chain;
use super::validity::Validity;
use crate::plant::drive::DriveParams;
use crate::plant::machine::Controller;
use crate::signal::harmonic_fit::{HarmonicBasis, HarmonicFit, LongLine};
use crate::units::SampleRate;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// What the two estimators must know besides the drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HarmonicSettings {
    /// Spindle speed that the weights are made for.
    pub spindle_speed_rpm: f64,
    /// Lines per turn that the first harmonic stands for: 1, or the number of teeth.
    pub lines_per_turn: f64,
    /// Harmonics; `None`: as many as lie below `band_hz`, at most 40.
    pub harmonics: Option<usize>,
    /// Length of the window in turns; half a turn or less cannot tell the harmonics apart.
    pub turns: f64,
    /// Where the fitted curve is read: in the middle of the window, or close to its young end.
    pub reading: Reading,
    /// Upper end of the band that is wanted, Hz.
    pub band_hz: f64,
}

/// Where a window is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reading {
    /// In the middle: least noise, delay of half the window.
    Middle,
    /// Three samples from the young end: shortest delay, more noise.
    Young,
}

impl Reading {
    /// `middle` or `young`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "middle" => Some(Self::Middle),
            "young" => Some(Self::Young),
            _ => None,
        }
    }
}

impl HarmonicSettings {
    /// One turn, read in the middle, every harmonic of the spindle below 500 Hz.
    ///
    /// Longer windows hold less noise but let slow motion of the axis leak into the harmonics, whose
    /// accelerations magnify it.
    #[must_use]
    pub fn at_speed(spindle_speed_rpm: f64) -> Self {
        Self {
            spindle_speed_rpm,
            lines_per_turn: 1.0,
            harmonics: None,
            turns: 1.0,
            reading: Reading::Middle,
            band_hz: 500.0,
        }
    }

    fn basis(&self, rate: SampleRate) -> HarmonicBasis {
        let line_hz = self.lines_per_turn * self.spindle_speed_rpm / 60.0;
        let below = (self.band_hz.min(0.45 * rate.hz()) / line_hz).floor().clamp(1.0, 40.0);
        HarmonicBasis {
            half_window: (0.5 * self.turns * 60.0 / self.spindle_speed_rpm * rate.hz()).round().min(1e9)
                as usize,
            fundamental_rad: TAU * line_hz / rate.hz(),
            harmonics: self.harmonics.unwrap_or(below as usize),
        }
    }
}

/// Beyond this condition number the harmonics of a window are told apart by rounding only.
const ILL_CONDITIONED: f64 = 1e3;
/// Relative deviation of the spindle's speed from the design's up to which the weights hold: over two
/// turns the phase of harmonic 10 then errs by less than 0.1 rad.
pub(super) const SPEED_TOLERANCE: f64 = 1e-3;

/// A designed harmonic estimator.
#[derive(Debug, Clone, PartialEq)]
pub struct HarmonicEstimator {
    kind: Kind,
    condition: f64,
    lag_samples: usize,
    line_samples: usize,
    friction_smoothing_m_s: f64,
}

#[derive(Debug, Clone, PartialEq)]
enum Kind {
    Fitted(Fitted),
    Spectral(Spectral),
}

/// Weights of the window for each signal, oldest sample first.
#[derive(Debug, Clone, PartialEq)]
struct Fitted {
    balance: ForceBalance,
    current: Vec<f64>,
    current_memory: f64,
    /// Force, position, velocity.
    motor: [Vec<f64>; 3],
    /// Force, position, velocity.
    stage: [Vec<f64>; 3],
    signals: Signals,
    presliding: Presliding,
}

impl Fitted {
    fn step(&self, state: &mut HarmonicState, friction_smoothing_m_s: f64) -> Windowed {
        let [motor_n, motor_m, motor_m_s] = [0, 1, 2].map(|k| state.motor.apply(&self.motor[k]));
        let [stage_n, stage_m, stage_m_s] = [0, 1, 2].map(|k| state.stage.apply(&self.stage[k]));
        let share = self.presliding.step(&mut state.presliding, stage_m);
        let motion = AlignedMotion {
            thrust_n: state.current.apply(&self.current),
            motor_velocity_m_s: motor_m_s,
            stage_velocity_m_s: stage_m_s,
            position_m: if self.signals == Signals::MotorOnly { motor_m } else { stage_m },
        };
        let force_n = self.balance.thrust * motion.thrust_n + motor_n + stage_n
            - self.balance.motor_friction_n * (motor_m_s / friction_smoothing_m_s).tanh()
            - self.balance.stage_friction_n * share;
        Windowed { force_n, flags: Validity::VALID, motion: Some((motion, motor_m)) }
    }
}

/// Weights of the window for each signal, oldest sample first.
#[derive(Debug, Clone, PartialEq)]
struct Spectral {
    /// On the thrust: its lines through the inverse of the closed loop.
    force: Vec<f64>,
    /// On thrust or position: the lines as they are.
    lines: Vec<f64>,
    /// On the position: the motion of the window as a whole.
    velocity: Vec<f64>,
    friction_n: f64,
    /// Travel within which a guideway holds instead of sliding.
    presliding_travel_m: f64,
    uses_stage: bool,
}

impl Spectral {
    /// On an axis that stands still the friction holds the force: what shows in the thrust is what is
    /// beyond friction, so friction is added to its amplitude. Where the guideway does not slide (the axis
    /// moves by less than the travel over which friction turns), nothing is known but that the force is
    /// below friction.
    fn step(&self, state: &mut HarmonicState, (half_window, still_m_s): (usize, f64)) -> Windowed {
        let force_n = state.current.apply(&self.force);
        let amplitude_n = state.thrust_peak.step(state.current.apply(&self.lines), half_window);
        let position = if self.uses_stage { &state.stage } else { &state.motor };
        let travel_m = state.travel_peak.step(position.apply(&self.lines), half_window);
        let speed_m_s = position.apply(&self.velocity).abs();
        let with = |force_n, flags| Windowed { force_n, flags, motion: None };
        if speed_m_s > still_m_s {
            return with(force_n, Validity::VALID);
        }
        // Friction is known to a tenth: what shows beyond it by less cannot be told from it.
        let holds = travel_m < self.presliding_travel_m || amplitude_n < 0.1 * self.friction_n;
        if self.friction_n > 0.0 && holds {
            return with(0.0, Validity::BELOW_FRICTION);
        }
        with(force_n * (1.0 + self.friction_n / amplitude_n.max(f64::MIN_POSITIVE)), Validity::EXTRAPOLATED)
    }
}

/// What one sample gave.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Windowed {
    /// Balance (`fitted`) or force (`spectral`), N.
    pub force_n: f64,
    /// What speaks against it.
    pub flags: Validity,
    /// Motion at the instant that it belongs to, and the motor's travel there in m; `fitted` alone.
    pub motion: Option<(AlignedMotion, f64)>,
}

/// State of a [`HarmonicEstimator`].
#[derive(Debug, Clone, PartialEq)]
pub struct HarmonicState {
    current: LongLine,
    motor: LongLine,
    stage: LongLine,
    current_n: f64,
    last_ref_n: f64,
    presliding: PreslidingState,
    thrust_peak: PeakHold,
    travel_peak: PeakHold,
}

crate::keyframe::keep!(HarmonicState {
    current,
    motor,
    stage,
    current_n,
    last_ref_n,
    presliding,
    thrust_peak,
    travel_peak
});

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
    /// `fitted`: positions replaced by the fitted curve, then the multi-encoder balance (26).
    ///
    /// Errors: a window that cannot be fitted, positions that the balance needs and the axis lacks.
    /// Source: Hayashi et al., V. Deviation: each curve is read at its own delayed instant; the window is
    /// given in turns; the thrust is fitted too, else motion that is no harmonic of the spindle stays in the
    /// thrust after it has been taken out of the accelerations that balance it.
    pub fn fitted(
        axis: &AxisSignals<'_>,
        (balance, presliding_travel_m): (ForceBalance, f64),
        settings: &HarmonicSettings,
    ) -> Result<Self, ForceError> {
        let rate = axis.rate;
        let basis = settings.basis(rate);
        let fit = HarmonicFit::new(basis)?;
        let alignment = Alignment::new(axis.drive, rate)?;
        // The alignment's own lag (three samples and the encoders' delays) stays; the window's comes on top.
        let middle_age = match settings.reading {
            Reading::Middle => basis.half_window,
            Reading::Young => 0,
        };
        let n = basis.half_window as f64;
        let side = |age: f64, factors: [f64; 3]| {
            let at = n - (middle_age as f64 + age);
            let scale = [1.0, rate.hz(), rate.hz() * rate.hz()];
            let mut force = vec![0.0; 2 * basis.half_window + 1];
            for (k, factor) in factors.iter().enumerate() {
                for (sum, w) in force.iter_mut().zip(fit.weights(at, k)) {
                    *sum += factor * scale[k] * w;
                }
            }
            let derivative =
                |k: usize| fit.weights(at, k).into_iter().map(|w| w * scale[k]).collect::<Vec<f64>>();
            [force, derivative(0), derivative(1)]
        };
        Ok(Self {
            kind: Kind::Fitted(Fitted {
                balance,
                current: fit.weights(n - middle_age as f64 - alignment.current, 0),
                current_memory: alignment.current_memory,
                motor: side(alignment.motor, balance.motor.as_array()),
                stage: side(alignment.stage, balance.stage.as_array()),
                signals: axis.signals,
                presliding: Presliding::new(presliding_travel_m, axis.drive.stage_encoder_resolution_m()),
            }),
            condition: fit.condition(),
            lag_samples: middle_age + alignment.lag_samples,
            line_samples: 2 * basis.half_window + 1,
            friction_smoothing_m_s: axis.drive.friction_smoothing_m_s(),
        })
    }

    /// `spectral`: lines of the thrust divided by the closed loop's response to a cutting force.
    ///
    /// Constant force is not estimated: its zero cannot be told from friction.
    /// Errors: no controller in the model, a window that cannot be fitted.
    /// Source: Sato et al., 4.3. Deviation: the inverse transform of the lines is one sum of weights.
    pub fn spectral(
        axis: &AxisSignals<'_>,
        (controller, presliding_travel_m): (Option<&Controller>, f64),
        settings: &HarmonicSettings,
    ) -> Result<Self, ForceError> {
        let missing =
            ForceError::Structure { method: Method::Spectral.name(), needs: "[axes.<axis>.controller]" };
        let loop_response =
            ClosedLoop { drive: axis.drive, controller: *controller.ok_or(missing)?, rate: axis.rate };
        let rate = axis.rate;
        let basis = settings.basis(rate);
        let fit = HarmonicFit::new(basis)?;
        let at = match settings.reading {
            Reading::Middle => 0.0,
            Reading::Young => basis.half_window as f64 - 3.0,
        };
        let line_hz = basis.fundamental_rad * rate.hz() / TAU;
        let response = |i: usize| 1.0 / loop_response.thrust_per_cutting(i as f64 * line_hz);
        Ok(Self {
            kind: Kind::Spectral(Spectral {
                force: fit.filtered_weights(at, response),
                lines: fit.filtered_weights(at, |_| Complex64::new(1.0, 0.0)),
                velocity: fit.slope_weights().into_iter().map(|w| w * rate.hz()).collect(),
                friction_n: axis.drive.stage_coulomb_friction_n() + axis.drive.motor_coulomb_friction_n(),
                presliding_travel_m,
                uses_stage: axis.signals != Signals::MotorOnly,
            }),
            condition: fit.condition(),
            lag_samples: (basis.half_window as f64 - at) as usize,
            line_samples: 2 * basis.half_window + 1,
            friction_smoothing_m_s: axis.drive.friction_smoothing_m_s(),
        })
    }

    /// State settled on a first sample.
    #[must_use]
    pub fn settled(&self, first: &MotionSample) -> HarmonicState {
        let line = |x: f64| LongLine::filled(self.line_samples, x);
        HarmonicState {
            current: line(first.thrust_ref_n),
            motor: line(first.motor_travel_m.unwrap_or(0.0)),
            stage: line(first.stage_position_m.unwrap_or(0.0)),
            current_n: first.thrust_ref_n,
            last_ref_n: first.thrust_ref_n,
            presliding: Presliding::settled(first.stage_position_m.unwrap_or(0.0)),
            thrust_peak: PeakHold::default(),
            travel_peak: PeakHold::default(),
        }
    }

    /// One sample. Cost: six weights a sample of the window at most; no allocation.
    #[must_use]
    pub fn step(&self, state: &mut HarmonicState, sample: &MotionSample) -> Windowed {
        let memory = match &self.kind {
            Kind::Fitted(fitted) => fitted.current_memory,
            Kind::Spectral(_) => 0.0,
        };
        state.current_n = if memory == 0.0 {
            sample.thrust_ref_n
        } else {
            memory * (state.current_n - state.last_ref_n) + state.last_ref_n
        };
        state.last_ref_n = sample.thrust_ref_n;
        state.current.push(state.current_n);
        state.motor.push(sample.motor_travel_m.unwrap_or_else(|| state.motor.last()));
        state.stage.push(sample.stage_position_m.unwrap_or_else(|| state.stage.last()));
        let ill = Validity::when(self.condition > ILL_CONDITIONED, Validity::ILL_CONDITIONED);
        let windowed = match &self.kind {
            Kind::Fitted(fitted) => fitted.step(state, self.friction_smoothing_m_s),
            Kind::Spectral(spectral) => {
                // Slower than this the axis stands still.
                spectral.step(state, (self.line_samples / 2, 2.0 * self.friction_smoothing_m_s))
            }
        };
        Windowed { flags: windowed.flags | ill, ..windowed }
    }

    /// Samples by which an estimate lags.
    #[must_use]
    pub fn lag_samples(&self) -> usize {
        self.lag_samples
    }

    /// Samples until the window is full.
    #[must_use]
    pub fn window_samples(&self) -> usize {
        self.line_samples
    }

    /// Condition number of the window.
    #[must_use]
    pub fn condition(&self) -> f64 {
        self.condition
    }

    /// Output noise for white noise of unit size on motor and stage position, N/m.
    #[must_use]
    pub(super) fn noise_gains(&self) -> [f64; 2] {
        let norm = |w: &[f64]| w.iter().map(|x| x * x).sum::<f64>().sqrt();
        match &self.kind {
            Kind::Fitted(fitted) => [norm(&fitted.motor[0]), norm(&fitted.stage[0])],
            Kind::Spectral(_) => [0.0, 0.0],
        }
    }
}

/// Position and velocity loop around a drive.
pub(super) struct ClosedLoop<'a> {
    pub(super) drive: &'a DriveParams,
    pub(super) controller: Controller,
    pub(super) rate: SampleRate,
}

impl ClosedLoop<'_> {
    /// Thrust reference per cutting force.
    ///
    ///   u = -M_a K_v (1 + K_i/s) [ K_p x_t e^{-s T_t} + s w_f/(s + w_f) x_m e^{-s T_m} ],
    ///   x = G u w_cc/(s + w_cc) e^{-s (T_s + T/2)} + G_F F
    ///
    /// solved for u/F. Checked by: force::spectral_gain_is_that_of_the_recorded_loop.
    pub(super) fn thrust_per_cutting(&self, frequency_hz: f64) -> Complex64 {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let (d, c) = (self.drive, &self.controller);
        let delay = |t_s: f64| (-s * t_s).exp();
        let velocity_loop = d.total_mass_kg() * c.velocity_gain_1_s * (1.0 + c.velocity_integral_1_s / s);
        let filter = c.velocity_filter_rad_s / (s + c.velocity_filter_rad_s);
        let on_motor = velocity_loop * s * filter * delay(d.motor_encoder_delay_s());
        let on_stage = velocity_loop * c.position_gain_1_s * delay(d.stage_encoder_delay_s());
        let lag = d.current_loop_bandwidth_rad_s().map_or(Complex64::new(1.0, 0.0), |w| w / (s + w));
        let drive = lag * delay(d.amplifier_dead_time_s() + 0.5 * self.rate.period_s());
        let x = Chain::of_drive(d).receptance(frequency_hz);
        -(on_motor * x.motor_per_cutting + on_stage * x.stage_per_cutting)
            / (1.0 + drive * (on_motor * x.motor_per_thrust + on_stage * x.stage_per_thrust))
    }
}

/// The multi-encoder balance, or the rigid one where a position is missing.
pub(super) fn fitted_balance(axis: &AxisSignals<'_>) -> ForceBalance {
    let both = matches!(axis.signals, Signals::Both | Signals::Three);
    let method = if both { Method::Medob } else { Method::Dob };
    let mut balance = ForceBalance::new(method, axis.drive);
    if axis.signals == Signals::StageOnly {
        balance.stage = balance.motor;
        balance.stage_friction_n += balance.motor_friction_n;
        balance.motor = MotionFactors::default();
        balance.motor_friction_n = 0.0;
    }
    balance
}
