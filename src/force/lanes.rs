//! Up to eight axes side by side: the same chain as [`super::estimator::ForceEstimator`], one axis a
//! lane of a vector register.
//!
//! For axes of one rate with a Butterworth low-pass of one order, without idle maps, notches and
//! windows; anything else runs axis by axis. A library part with its bench (six axes for the time of two):
//! the service steps its axes one after the other, because each has an observer of its own choosing and six
//! take 1 to 3 % of a sample's time as they are (balances). Checked by:
//! lanes_give_the_numbers_of_single_axes.

use super::balance::Method;
use super::estimator::{AxisSignals, ForceEstimator, ForceSettings, LowPass, Signals};
use crate::signal::butterworth::{Butterworth, MAX_SECTIONS};
use crate::signal::dispatch::{Fast, Kernel, multiply_add, run};
use crate::signal::finite_difference::{STENCIL_NODES, Stencil};
use thiserror::Error;

/// Axes of one estimator.
pub const LANES: usize = 8;

/// One value a lane.
pub type Lane = [f64; LANES];

/// Samples that a line of lanes remembers.
const LINE: usize = 32;

/// Why axes cannot run side by side.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum LaneError {
    /// Too many or no axes.
    #[error("{axes} axes, expected 1 to {LANES}")]
    Axes {
        /// How many were given.
        axes: usize,
    },
    /// An axis has something that the lanes do not: an idle map, notches, a window, another low-pass.
    #[error(
        "axis {axis} differs from the first in rate or low-pass, or has an idle map, notches or a window"
    )]
    Unlike {
        /// Which.
        axis: usize,
    },
    /// A delay beyond what the lanes remember.
    #[error("axis {axis} needs samples of {age} ago, the lanes remember {LINE}")]
    TooLate {
        /// Which.
        axis: usize,
        /// Age in samples.
        age: usize,
    },
}

/// Weights of all lanes over a common stretch of samples.
#[derive(Debug, Clone, PartialEq)]
struct LaneStencil {
    youngest: usize,
    weights: Vec<Lane>,
}

/// A designed estimator of several axes.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceLanes {
    axes: usize,
    current: LaneStencil,
    motor_force: LaneStencil,
    motor_velocity: LaneStencil,
    stage_force: LaneStencil,
    stage_position: LaneStencil,
    current_memory: Lane,
    motor_friction_n: Lane,
    stage_friction_n: Lane,
    smoothing_s_m: Lane,
    per_travel_1_m: Lane,
    play_m: Lane,
    sections: Vec<[Lane; 5]>,
    delay_s: Lane,
    fast: Fast,
}

/// A line of samples of all lanes, each stored twice.
#[derive(Debug, Clone, PartialEq)]
struct LaneLine {
    values: [Lane; 2 * LINE],
    head: usize,
}

/// State of a [`ForceLanes`].
#[derive(Debug, Clone, PartialEq)]
pub struct LaneState {
    current: LaneLine,
    motor: LaneLine,
    stage: LaneLine,
    current_n: Lane,
    last_ref_n: Lane,
    slip_m: Lane,
    share: Lane,
    filter: [[Lane; 2]; MAX_SECTIONS],
}

/// One instant of all axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LaneSample {
    /// Thrust references, N.
    pub thrust_ref_n: Lane,
    /// Motor angles as travel, m.
    pub motor_travel_m: Lane,
    /// Stage positions, m.
    pub stage_position_m: Lane,
}

impl LaneLine {
    fn filled(value: Lane) -> Self {
        Self { values: [value; 2 * LINE], head: 0 }
    }

    #[inline(always)]
    fn push(&mut self, value: Lane) {
        self.head = if self.head == 0 { LINE - 1 } else { self.head - 1 };
        self.values[self.head] = value;
        self.values[self.head + LINE] = value;
    }

    #[inline(always)]
    fn apply<const FUSED: bool>(&self, stencil: &LaneStencil) -> Lane {
        let mut sum = [0.0; LANES];
        let start = self.head + stencil.youngest;
        for (weights, values) in stencil.weights.iter().zip(&self.values[start..]) {
            for lane in 0..LANES {
                sum[lane] = multiply_add::<FUSED>(weights[lane], values[lane], sum[lane]);
            }
        }
        sum
    }
}

impl ForceLanes {
    /// Puts axes side by side. Errors: none or too many axes, unlike settings, delays too long, and
    /// what [`ForceEstimator::new`] refuses (named by axis as unlike).
    pub fn new(axes: &[(Method, AxisSignals<'_>)], settings: &ForceSettings) -> Result<Self, LaneError> {
        let Some(first) = axes.first().filter(|_| axes.len() <= LANES) else {
            return Err(LaneError::Axes { axes: axes.len() });
        };
        let LowPass::Butterworth { order, cutoff_hz } = settings.low_pass else {
            return Err(LaneError::Unlike { axis: 0 });
        };
        let plain = settings.idle_map.is_none()
            && settings.notches.is_empty()
            && settings.physics.is_none()
            && !settings.learn_stiffness;
        let mut parts = Vec::with_capacity(LANES);
        for (axis, (method, signals)) in axes.iter().enumerate() {
            let unlike = LaneError::Unlike { axis };
            let windowed = matches!(method, Method::Fitted | Method::Spectral);
            if !plain || windowed || signals.rate != first.1.rate || signals.signals != Signals::Both {
                return Err(unlike);
            }
            let part = ForceEstimator::new(*method, signals, settings.clone()).map_err(|_| unlike)?;
            parts.push((part, signals));
        }
        // Idle lanes repeat the first axis: no special case in the loop.
        while parts.len() < LANES {
            parts.push((parts[0].0.clone(), parts[0].1));
        }
        let filter = Butterworth::low_pass(order, cutoff_hz, first.1.rate);
        let filter = filter.map_err(|_| LaneError::Unlike { axis: 0 })?;
        let lane = |f: &dyn Fn(&ForceEstimator, &AxisSignals<'_>) -> f64| {
            std::array::from_fn(|k| f(&parts[k].0, parts[k].1))
        };
        let stencil = |pick: &dyn Fn(&ForceEstimator) -> Stencil| {
            let all: Vec<Stencil> = parts.iter().map(|(e, _)| pick(e)).collect();
            LaneStencil::new(&all)
        };
        Ok(Self {
            axes: axes.len(),
            current: stencil(&|e| e.scaled_current())?,
            motor_force: stencil(&|e| e.motor.force)?,
            motor_velocity: stencil(&|e| e.motor.velocity)?,
            stage_force: stencil(&|e| e.stage.force)?,
            stage_position: stencil(&|e| e.stage.position)?,
            current_memory: lane(&|e, _| e.alignment.current_memory),
            motor_friction_n: lane(&|e, _| e.balance().motor_friction_n),
            stage_friction_n: lane(&|e, _| e.balance().stage_friction_n),
            smoothing_s_m: lane(&|_, a| 1.0 / a.drive.friction_smoothing_m_s()),
            per_travel_1_m: [1.0 / settings.presliding_travel_m; LANES],
            play_m: lane(&|_, a| a.drive.stage_encoder_resolution_m()),
            sections: filter
                .sections()
                .iter()
                .map(|s| [s.b[0], s.b[1], s.b[2], s.a[0], s.a[1]].map(|c| [c; LANES]))
                .collect(),
            delay_s: lane(&|e, _| e.delay_s()),
            fast: Fast::detect(),
        })
    }

    /// The same without the processor's fast instructions, for comparison.
    #[must_use]
    pub fn without_fast(mut self) -> Self {
        self.fast = Fast::off();
        self
    }

    /// Number of axes.
    #[must_use]
    pub fn axes(&self) -> usize {
        self.axes
    }

    /// By how much each estimate lags, s.
    #[must_use]
    pub fn delay_s(&self) -> Lane {
        self.delay_s
    }

    /// State settled on a first sample (the low-pass at zero force).
    #[must_use]
    pub fn settled(&self, first: &LaneSample) -> LaneState {
        LaneState {
            current: LaneLine::filled(first.thrust_ref_n),
            motor: LaneLine::filled(first.motor_travel_m),
            stage: LaneLine::filled(first.stage_position_m),
            current_n: first.thrust_ref_n,
            last_ref_n: first.thrust_ref_n,
            slip_m: first.stage_position_m,
            share: [0.0; LANES],
            filter: [[[0.0; LANES]; 2]; MAX_SECTIONS],
        }
    }

    /// One sample of all axes. No allocation.
    #[inline]
    #[must_use]
    pub fn step(&self, state: &mut LaneState, sample: &LaneSample) -> Lane {
        run(self.fast, Step { design: self, state, sample })
    }
}

struct Step<'a> {
    design: &'a ForceLanes,
    state: &'a mut LaneState,
    sample: &'a LaneSample,
}

impl Kernel for Step<'_> {
    type Output = Lane;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> Lane {
        let (d, s, x) = (self.design, self.state, self.sample);
        for lane in 0..LANES {
            let memory = d.current_memory[lane];
            let lagged =
                multiply_add::<FUSED>(memory, s.current_n[lane] - s.last_ref_n[lane], s.last_ref_n[lane]);
            s.current_n[lane] = if memory == 0.0 { x.thrust_ref_n[lane] } else { lagged };
        }
        s.last_ref_n = x.thrust_ref_n;
        s.current.push(s.current_n);
        s.motor.push(x.motor_travel_m);
        s.stage.push(x.stage_position_m);
        let current = s.current.apply::<FUSED>(&d.current);
        let motor = s.motor.apply::<FUSED>(&d.motor_force);
        let velocity = s.motor.apply::<FUSED>(&d.motor_velocity);
        let stage = s.stage.apply::<FUSED>(&d.stage_force);
        let position = s.stage.apply::<FUSED>(&d.stage_position);
        let mut force = [0.0; LANES];
        for lane in 0..LANES {
            // The laws of `friction`, written without branches.
            let moved = position[lane] - s.slip_m[lane];
            let beyond = (moved.abs() - d.play_m[lane]).max(0.0);
            let u = beyond * d.per_travel_1_m[lane];
            let keep = 1.0 / (1.0 + u * (1.0 + 0.5 * u * (1.0 + u / 3.0)));
            let direction = moved.signum();
            s.share[lane] = multiply_add::<FUSED>(s.share[lane] - direction, keep, direction);
            s.slip_m[lane] = multiply_add::<FUSED>(direction, beyond, s.slip_m[lane]);
            let friction = d.motor_friction_n[lane]
                * rational_tanh::<FUSED>(velocity[lane] * d.smoothing_s_m[lane])
                + d.stage_friction_n[lane] * s.share[lane];
            force[lane] = current[lane] + motor[lane] + stage[lane] - friction;
        }
        for (section, state) in d.sections.iter().zip(&mut s.filter) {
            let [b0, b1, b2, a1, a2] = section;
            for lane in 0..LANES {
                let input = force[lane];
                let y = multiply_add::<FUSED>(b0[lane], input, state[0][lane]);
                let inner = multiply_add::<FUSED>(b1[lane], input, state[1][lane]);
                state[0][lane] = multiply_add::<FUSED>(-a1[lane], y, inner);
                state[1][lane] = multiply_add::<FUSED>(b2[lane], input, -a2[lane] * y);
                force[lane] = y;
            }
        }
        force
    }
}

/// tanh by a rational function of degree 13 over 6, within 4e-7: no branch, no call.
///
/// Coefficients: the single-precision minimax of the Eigen library (MathFunctionsImpl.h).
/// Checked by: lanes::rational_tanh_is_close.
#[inline(always)]
fn rational_tanh<const FUSED: bool>(x: f64) -> f64 {
    const NUMERATOR: [f64; 7] = [
        -2.760_768_477_423_55e-16,
        2.000_187_904_824_77e-13,
        -8.604_671_522_137_35e-11,
        5.122_297_090_371_14e-8,
        1.485_722_357_179_79e-5,
        6.372_619_288_754_36e-4,
        4.893_524_558_917_86e-3,
    ];
    const DENOMINATOR: [f64; 4] =
        [1.198_258_394_667_02e-6, 1.185_347_056_866_54e-4, 2.268_434_632_439_00e-3, 4.893_525_185_543_85e-3];
    let x = x.clamp(-7.905_311, 7.905_311);
    let x2 = x * x;
    let mut p = NUMERATOR[0];
    for c in &NUMERATOR[1..] {
        p = multiply_add::<FUSED>(p, x2, *c);
    }
    let mut q = DENOMINATOR[0];
    for c in &DENOMINATOR[1..] {
        q = multiply_add::<FUSED>(q, x2, *c);
    }
    x * p / q
}

impl LaneStencil {
    fn new(stencils: &[Stencil]) -> Result<Self, LaneError> {
        let youngest = stencils.iter().map(|s| s.youngest).min().unwrap_or(0);
        let oldest = stencils.iter().map(|s| s.youngest + STENCIL_NODES).max().unwrap_or(0);
        if oldest > LINE {
            let axis = stencils.iter().position(|s| s.youngest + STENCIL_NODES > LINE).unwrap_or(0);
            return Err(LaneError::TooLate { axis, age: oldest });
        }
        let mut weights = vec![[0.0; LANES]; oldest - youngest];
        for (lane, stencil) in stencils.iter().enumerate().take(LANES) {
            for (k, w) in stencil.weights.iter().enumerate() {
                weights[stencil.youngest - youngest + k][lane] = *w;
            }
        }
        Ok(Self { youngest, weights })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::force::estimator::MotionSample;
    use crate::plant::drive::{DriveParams, RawDriveParams};
    use crate::units::SampleRate;

    #[test]
    fn rational_tanh_is_close() {
        for i in -2000..=2000 {
            let x = f64::from(i) * 0.01;
            assert!((rational_tanh::<false>(x) - x.tanh()).abs() < 1e-6, "{x}");
        }
    }

    fn drive(delay_s: f64) -> DriveParams {
        DriveParams::new(RawDriveParams {
            movable_mass_kg: Some(7.0),
            screw_lead_m: Some(0.005),
            rotary_inertia_kg_m2: Some(5e-5),
            axial_stiffness_n_m: Some(4e7),
            structural_damping_n_s_m: Some(1500.0),
            stage_coulomb_friction_n: Some(50.0),
            motor_coulomb_friction_n: Some(30.0),
            current_loop_bandwidth_rad_s: Some(5000.0),
            amplifier_dead_time_s: Some(delay_s),
            stage_encoder_resolution_m: Some(1e-9),
            ..RawDriveParams::default()
        })
        .unwrap()
    }

    #[test]
    fn lanes_give_the_numbers_of_single_axes() {
        let rate = SampleRate::new(9000.0).unwrap();
        let drives: Vec<DriveParams> = (0..6).map(|k| drive(1e-4 * f64::from(k))).collect();
        let methods =
            [Method::Medob, Method::VibrationMode, Method::Medob, Method::Dob, Method::Thrust, Method::Medob];
        let axes: Vec<(Method, AxisSignals<'_>)> = drives
            .iter()
            .zip(methods)
            .map(|(drive, method)| (method, AxisSignals { drive, rate, signals: Signals::Both }))
            .collect();
        let settings = ForceSettings::default();
        let lanes = ForceLanes::new(&axes, &settings).unwrap();
        let singles: Vec<ForceEstimator> =
            axes.iter().map(|(m, a)| ForceEstimator::new(*m, a, settings.clone()).unwrap()).collect();
        let mut state = lanes.settled(&LaneSample::default());
        let zero = MotionSample {
            motor_travel_m: Some(0.0),
            stage_position_m: Some(0.0),
            ..MotionSample::default()
        };
        let mut states: Vec<_> = singles.iter().map(|e| e.settled(&zero)).collect();
        for i in 0..3000 {
            let t = f64::from(i) / 9000.0;
            let wave = |k: usize, f: f64| (std::f64::consts::TAU * f * t + k as f64).sin() - (k as f64).sin();
            let mut sample = LaneSample::default();
            for k in 0..6 {
                sample.thrust_ref_n[k] = 80.0 * wave(k, 40.0);
                sample.motor_travel_m[k] = 1e-4 * wave(k, 9.0) + 1e-8 * wave(k, 600.0);
                sample.stage_position_m[k] = 1e-4 * wave(k, 9.0) + 3e-8 * wave(k, 600.0);
            }
            let together = lanes.step(&mut state, &sample);
            for k in 0..6 {
                let alone = MotionSample {
                    thrust_ref_n: sample.thrust_ref_n[k],
                    motor_travel_m: Some(sample.motor_travel_m[k]),
                    stage_position_m: Some(sample.stage_position_m[k]),
                    spindle_speed_rpm: None,
                    nut_position_m: None,
                    accel_m_s2: None,
                };
                let single = singles[k].step(&mut states[k], &alone).force_n;
                // tanh within 1e-6 of 30 N, and rounding of positions times 1e9 N/m.
                assert!((single - together[k]).abs() < 2e-4, "lane {k} sample {i}: {single} {}", together[k]);
            }
        }
    }
}
