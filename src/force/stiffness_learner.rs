//! The axial stiffness learned while the axis cuts: the check of [`super::stiffness`] made causal, at
//! constant cost, for the estimate that stands on it (`vibration_mode`).
//!
//! ```text
//!  a = u - M_r a_m - C_r v_m - friction         the axial force from the motor side
//!  b = K_r (x_m - x_t) + C_k (v_m - v_t)        the same from the stretch of the screw
//!  both through the same band (5 Hz to a fifth of the first resonance), then
//!  k = sqrt(<a a>/<b b>) where <a b>^2 / (<a a><b b>) > 0.995, <.> with a memory of 2 s,
//!  F += (k - 1) K_r-part of the balance x stretch above 1 Hz
//! ```
//! The band ends low because the compliance behind k is that of a mode, which makes k a function of
//! frequency: 0.92 to 0.95 below 90 Hz, 1.0 to 1.1 at 130 to 170 Hz in the simulated cuts. Nothing is
//! learned while the stretch varies by less than 12 nm or three encoder steps rms, while filters settle or a
//! signal is missing, or where k is beyond 0.8 to 1.25: an error of the motor's encoder alone has
//! k = (f / f_motor)^2 < 0.64 in
//! the band. The mean stays that of the model, which idle runs are taken off with; encoders need no common
//! zero.
//! Checked by: force_trust::vibration_mode_learns_the_stiffness_while_it_cuts.

use super::balance::{ForceBalance, motor_side_mass_kg};
use super::motion::Aligned;
use super::response::Chain;
use super::signals::{AxisSignals, Signals};
use super::stiffness::{motor_side_balance, stretch_balance};
use super::thinned::{HIGH_PASS_HZ, SeenThinned, Thinned};
use crate::plant::drive::Structure;
use crate::signal::FilterError;
use crate::signal::butterworth::{Butterworth, ButterworthState, Pass};
use crate::signal::finite_difference::{Stencil, stencils};
use std::f64::consts::TAU;

/// Below this the estimate keeps the stiffness of the model.
const MEAN_HZ: f64 = 1.0;
/// Memory of the mean squares.
pub(super) const MEMORY_S: f64 = 2.0;
/// Least time that must have been seen, s: of what is said of an estimate too.
pub(super) const LEAST_S: f64 = 0.5;
const LEAST_STRETCH_M: f64 = 12e-9;
const LEAST_STEPS: f64 = 3.0;
const LEAST_R_SQUARED: f64 = 0.995;
/// Stiffness over the model's that can be.
pub(super) const BELIEVED: std::ops::RangeInclusive<f64> = 0.8..=1.25;

/// Design; immutable.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct StiffnessLearner {
    motor_force: Stencil,
    motor_friction_n: f64,
    /// Stiffness and damping of the coupling, N/m and N s/m.
    stretch: [f64; 2],
    /// Weights of a - b over the lines of motor and stage.
    contradiction: [Stencil; 2],
    thinned: Thinned,
    low: Butterworth,
    above_mean: Butterworth,
    /// Position factors of the balance that is corrected, N/m.
    position_n_m: [f64; 2],
    least_square_n2: f64,
    forget: f64,
    /// Whether what is learned goes into the estimate; it is learned for `two_sides` all the same.
    applies: bool,
    /// Thinned samples before which nothing is learned: filters, then enough of a mean.
    warm_up: [u32; 2],
}

/// What has been learned; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct LearnedStiffness {
    thinned: SeenThinned,
    low: [ButterworthState; 2],
    motor2: f64,
    both: f64,
    stretch2: f64,
    weight: f64,
    above_mean: ButterworthState,
    /// Stiffness over the model's, where any was learned.
    pub(super) ratio: Option<f64>,
    begun: bool,
    seen: u32,
}

crate::keyframe::keep!(LearnedStiffness {
    thinned,
    low,
    motor2,
    both,
    stretch2,
    weight,
    above_mean,
    ratio,
    begun,
    seen
});

impl StiffnessLearner {
    /// Ages of both encoders in samples; upper end of the band, Hz; whether what is learned goes into the
    /// estimate. `None`: not a flexible axis with two encoders. Errors: a rate too low for the band.
    pub(super) fn new(
        axis: &AxisSignals<'_>,
        balance: &ForceBalance,
        ([motor_age, stage_age], band_hz, applies): ([f64; 2], f64, bool),
    ) -> Result<Option<Self>, FilterError> {
        if axis.signals != Signals::Both || axis.drive.structure() == Structure::Rigid {
            return Ok(None);
        }
        let (drive, rate) = (axis.drive, axis.rate);
        let resonance_hz = Chain::of_drive(drive).modes().frequencies_hz.get(1).copied().unwrap_or(0.0);
        let motor_hz = (drive.axial_stiffness_n_m() / motor_side_mass_kg(drive)).sqrt() / TAU;
        let thinned = Thinned::new(band_hz, rate)?;
        let seldom = thinned.rate();
        let top_hz = (0.2 * resonance_hz).min(0.8 * motor_hz).max(4.0 * HIGH_PASS_HZ);
        let top_hz = top_hz.min(0.1 * rate.hz()).min(0.25 * seldom.hz());
        let (motor, stage) = (stencils(motor_age, rate.period_s()), stencils(stage_age, rate.period_s()));
        let (motor_side, stretch) = (motor_side_balance(drive), stretch_balance(drive));
        let motor_force = Stencil::combined(&motor, motor_side.motor.as_array());
        let of_stretch = Stencil::combined(&motor, stretch.motor.as_array());
        let mut difference = motor_force;
        let pairs = difference.weights.iter_mut().zip(&of_stretch.weights);
        pairs.for_each(|(force, stretch)| *force -= stretch);
        let samples = |seconds: f64| seconds * seldom.hz();
        let step_m = drive.motor_encoder_resolution_m().max(drive.stage_encoder_resolution_m());
        let least_m = LEAST_STRETCH_M.max(LEAST_STEPS * step_m);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "seconds of samples")]
        let warm_up = [samples(3.0 / HIGH_PASS_HZ), samples(LEAST_S)].map(|n| n as u32);
        Ok(Some(Self {
            motor_force,
            motor_friction_n: motor_side.motor_friction_n,
            stretch: [stretch.motor.position_n_m, stretch.motor.velocity_n_s_m],
            contradiction: [difference, Stencil::combined(&stage, stretch.stage.as_array())],
            thinned,
            low: Butterworth::new(Pass::Low, 4, top_hz, seldom)?,
            above_mean: Butterworth::new(Pass::High, 2, MEAN_HZ, rate)?,
            position_n_m: [balance.motor.position_n_m, balance.stage.position_n_m],
            least_square_n2: (least_m * drive.axial_stiffness_n_m()).powi(2),
            forget: (-1.0 / samples(MEMORY_S)).exp(),
            applies,
            warm_up,
        }))
    }

    /// What the learned stiffness adds to the estimate, N. Every sample.
    #[inline]
    pub(super) fn added_n(&self, state: &mut LearnedStiffness, now: &Aligned) -> f64 {
        if !self.applies {
            return 0.0;
        }
        let [motor_n_m, stage_n_m] = self.position_n_m;
        let spring_n = motor_n_m * now.motion.motor_m + stage_n_m * now.motion.stage_m;
        if !std::mem::replace(&mut state.begun, true) {
            state.above_mean = self.above_mean.settled(spring_n);
        }
        let varies_n = self.above_mean.step(&mut state.above_mean, spring_n);
        state.ratio.map_or(0.0, |ratio| (ratio - 1.0) * varies_n)
    }

    /// Learns from an instant; `force_n`: the estimate; `learn`: nothing speaks against the sample. Both
    /// sides and the estimate between 5 Hz and the low-pass where this one is looked at, N.
    #[inline]
    pub(super) fn step(
        &self,
        state: &mut LearnedStiffness,
        (now, force_n): (&Aligned, f64),
        learn: bool,
    ) -> Option<[f64; 3]> {
        let [stiffness_n_m, damping_n_s_m] = self.stretch;
        let motion = &now.motion;
        let motor_n = motion.thrust_n + now.inertia_n - self.motor_friction_n * now.friction;
        let stretch_n = stiffness_n_m * (motion.motor_m - motion.stage_m)
            + damping_n_s_m * (motion.motor_velocity_m_s - motion.stage_velocity_m_s);
        if !learn {
            state.seen = 0;
        }
        let banded_n = self.thinned.step(&mut state.thinned, motor_n, stretch_n, force_n)?;
        if learn {
            state.seen = state.seen.saturating_add(1);
        }
        let low_n = [0, 1].map(|side| self.low.step(&mut state.low[side], banded_n[side]));
        if self.counts(state) {
            self.learn(state, low_n);
        }
        Some(banded_n)
    }

    #[inline]
    fn learn(&self, state: &mut LearnedStiffness, [motor_n, stretch_n]: [f64; 2]) {
        let mean = |old: f64, new: f64| self.forget * old + new;
        state.motor2 = mean(state.motor2, motor_n * motor_n);
        state.both = mean(state.both, motor_n * stretch_n);
        state.stretch2 = mean(state.stretch2, stretch_n * stretch_n);
        state.weight = mean(state.weight, 1.0);
        let one =
            state.both > 0.0 && state.both * state.both > LEAST_R_SQUARED * state.motor2 * state.stretch2;
        if one
            && state.weight > f64::from(self.warm_up[1])
            && state.stretch2 > self.least_square_n2 * state.weight
        {
            let seen = (state.motor2 / state.stretch2).sqrt();
            state.ratio = Some(seen).filter(|k| BELIEVED.contains(k)).or(state.ratio);
        }
    }

    /// Stiffness in use over that of the model, where what is learned is used.
    pub(super) fn ratio_in_use(&self, state: &LearnedStiffness) -> Option<f64> {
        self.applies.then(|| state.ratio.unwrap_or(1.0))
    }

    /// Whether the filters have forgotten their start and nothing spoke against the samples since.
    pub(super) fn counts(&self, state: &LearnedStiffness) -> bool {
        state.seen > self.warm_up[0]
    }

    /// Weights of a - b over the lines of motor and stage.
    pub(super) fn contradiction(&self) -> &[Stencil; 2] {
        &self.contradiction
    }

    /// Weights of the motor's own inertia and damping over its line.
    pub(super) fn motor_force(&self) -> Stencil {
        self.motor_force
    }

    /// The samples that are looked at.
    pub(super) fn thinned(&self) -> &Thinned {
        &self.thinned
    }
}
