//! The axis in its control loop: encoders with delay, errors and steps; P position, PI velocity; a
//! drive with dead time. What the drive was told and what the encoders said is the recording.

use super::motion::Motion;
use super::plant::{Drivers, Plant, STATES, Wave, at};
use crate::plant::machine::Controller;
use rand::{Rng, RngExt};
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// Longest integration step, s: a hundredth of the period of a 1 kHz mode.
const LONGEST_STEP_S: f64 = 1.0e-5;

/// Step of the current reference, A: what a drive's bus carries.
const CURRENT_STEP_A: f64 = 1.0e-4;

/// What stands between the axis and the recording.
#[derive(Debug, Clone, PartialEq)]
#[expect(missing_docs, reason = "each field is its own unit-carrying name; meaning in docs/symbols.md")]
pub struct Instruments {
    pub travel_m_rad: f64,
    pub dead_time_s: f64,
    pub motor_encoder_delay_s: f64,
    pub stage_encoder_delay_s: f64,
    pub motor_step_m: f64,
    pub stage_step_m: f64,
    pub motor_error: Option<Wave>,
    pub stage_error: Option<Wave>,
    /// Outsider: the scale wanders off, m/s.
    pub stage_drift_m_s: f64,
    pub controller: Controller,
    /// Acceleration command to current, A s2/m.
    pub current_per_accel: f64,
}

/// Small disturbances that no model is asked to explain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Background {
    /// White force at the motor, N rms per sample.
    pub motor_white_n: f64,
    /// White force at the stage, N rms per sample.
    pub stage_white_n: f64,
    /// Force of about 10 Hz at the stage, N rms.
    pub coloured_n: f64,
    /// Outsider: random walk at the stage, N per square root of a second.
    pub random_walk_n: f64,
}

/// Everything of one machine.
#[derive(Debug, Clone)]
pub(super) struct Bench {
    pub(super) plant: Plant,
    pub(super) instruments: Instruments,
    pub(super) background: Background,
    pub(super) period_s: f64,
}

/// What was recorded, one value a sample, and what caused the difference.
#[derive(Debug, Clone, Default)]
pub(super) struct Trace {
    pub(super) current_ref_a: Vec<f64>,
    pub(super) motor_angle_rad: Vec<f64>,
    pub(super) stage_position_m: Vec<f64>,
    /// Forces beyond the structure: motor, coupling, stage, N.
    pub(super) hidden_n: [Vec<f64>; 3],
}

/// The last positions on the fine grid, for reading an encoder some time ago.
struct Past {
    ring: Vec<f64>,
    newest: usize,
    step_s: f64,
}

impl Past {
    fn new(longest_s: f64, step_s: f64, value: f64) -> Self {
        let length = (longest_s / step_s).ceil() as usize + 3;
        Self { ring: vec![value; length], newest: 0, step_s }
    }

    fn push(&mut self, value: f64) {
        self.newest = (self.newest + 1) % self.ring.len();
        self.ring[self.newest] = value;
    }

    /// Value `ago_s` before the newest, linear between the grid's points.
    fn at(&self, ago_s: f64) -> f64 {
        let steps = ago_s / self.step_s;
        let whole = steps.floor();
        let part = steps - whole;
        let n = self.ring.len();
        let index = |back: usize| self.ring[(self.newest + n - back.min(n - 1)) % n];
        let back = whole as usize;
        index(back) * (1.0 - part) + index(back + 1) * part
    }
}

/// Position and velocity loop, once a sample.
#[derive(Debug, Clone, Copy, Default)]
struct LoopState {
    last_motor_m: f64,
    last_cmd_m: f64,
    velocity_m_s: f64,
    integral_m: f64,
}

impl Instruments {
    fn rounded(value: f64, step: f64) -> f64 {
        if step > 0.0 { (value / step).round() * step } else { value }
    }

    /// Current reference from command and encoders.
    ///
    /// e = v_cmd + K_p (x_cmd - x_t) - v_filtered;  i = g K_v (e + K_i sum e T),  g: current per acceleration
    ///
    /// v_filtered: backward-Euler first-order filter of the difference quotient of the motor encoder.
    /// Checked by: `conceal::the_control_law_replays_from_the_recording`.
    fn control(
        &self,
        state: &mut LoopState,
        (cmd_m, motor_m, stage_m): (f64, f64, f64),
        period_s: f64,
    ) -> f64 {
        let c = &self.controller;
        let raw = (motor_m - state.last_motor_m) / period_s;
        let w = c.velocity_filter_rad_s * period_s;
        let share = if w > 0.0 { w / (1.0 + w) } else { 1.0 };
        state.velocity_m_s += share * (raw - state.velocity_m_s);
        let feed = (cmd_m - state.last_cmd_m) / period_s;
        (state.last_motor_m, state.last_cmd_m) = (motor_m, cmd_m);
        let error = feed + c.position_gain_1_s * (cmd_m - stage_m) - state.velocity_m_s;
        state.integral_m += error * period_s;
        self.current_per_accel * c.velocity_gain_1_s * (error + c.velocity_integral_1_s * state.integral_m)
    }
}

impl Bench {
    /// Runs the commands and records.
    ///
    /// Fourth-order Runge-Kutta on a grid of at most 10 us; the held current is averaged over each step,
    /// so a dead time need not be whole steps.
    pub(super) fn run(&self, motion: &Motion, rng: &mut impl Rng) -> Trace {
        let steps = (self.period_s / LONGEST_STEP_S).ceil().max(1.0);
        let h = self.period_s / steps;
        let start = motion.position_m.first().copied().unwrap_or(0.0);
        let mut state = [0.0; STATES];
        (state[at::MOTOR], state[at::SCREW], state[at::STAGE]) = (start, start, start);
        let i = &self.instruments;
        let mut motor_past = Past::new(i.motor_encoder_delay_s, h, start);
        let mut stage_past = Past::new(i.stage_encoder_delay_s, h, start);
        let mut told =
            HeldCurrent { values: Vec::with_capacity(motion.position_m.len()), period_s: self.period_s };
        let mut loop_state = LoopState { last_motor_m: start, last_cmd_m: start, ..LoopState::default() };
        let mut noise = Noise::default();
        let mut trace = Trace::default();
        let bare = self.plant.bare();
        for (k, (&cmd_m, &injected_a)) in motion.position_m.iter().zip(&motion.injected_a).enumerate() {
            let t_s = k as f64 * self.period_s;
            let motor_m = i.read_motor(motor_past.at(i.motor_encoder_delay_s));
            let stage_m = i.read_stage(stage_past.at(i.stage_encoder_delay_s), t_s);
            let asked = i.control(&mut loop_state, (cmd_m, motor_m, stage_m), self.period_s) + injected_a;
            let current_ref = Instruments::rounded(asked, CURRENT_STEP_A);
            told.values.push(current_ref);
            let (motor_noise_n, stage_noise_n) = noise.next(&self.background, self.period_s, rng);
            let mut drivers = Drivers { current_a: 0.0, motor_noise_n, stage_noise_n };
            drivers.current_a = told.mean(t_s - i.dead_time_s, h);
            let hidden = self.plant.hidden_forces(&bare, (t_s, &state, &drivers));
            trace.push(current_ref, motor_m / i.travel_m_rad, stage_m, hidden);
            for step in 0..steps as usize {
                let now = t_s + step as f64 * h;
                drivers.current_a = told.mean(now - i.dead_time_s, h);
                state = self.plant.advance(now, &state, &drivers, h);
                motor_past.push(state[at::MOTOR]);
                stage_past.push(state[at::STAGE] + state[at::BASE]);
            }
        }
        trace
    }
}

impl Instruments {
    fn read_motor(&self, x: f64) -> f64 {
        Self::rounded(x + self.motor_error.map_or(0.0, |w| w.at(x)), self.motor_step_m)
    }

    fn read_stage(&self, x: f64, t_s: f64) -> f64 {
        let error = self.stage_error.map_or(0.0, |w| w.at(x)) + self.stage_drift_m_s * t_s;
        Self::rounded(x + error, self.stage_step_m)
    }
}

impl Trace {
    fn push(&mut self, current_ref_a: f64, motor_angle_rad: f64, stage_position_m: f64, hidden: [f64; 3]) {
        self.current_ref_a.push(current_ref_a);
        self.motor_angle_rad.push(motor_angle_rad);
        self.stage_position_m.push(stage_position_m);
        for (column, value) in self.hidden_n.iter_mut().zip(hidden) {
            column.push(value);
        }
    }
}

/// Current references, each held for one sample.
struct HeldCurrent {
    values: Vec<f64>,
    period_s: f64,
}

impl HeldCurrent {
    /// Mean of the held reference over `[from_s, from_s + length_s]`; zero before the start.
    fn mean(&self, from_s: f64, length_s: f64) -> f64 {
        let hold = |t: f64| {
            let k = (t / self.period_s + 1.0e-9).floor();
            if k < 0.0 {
                0.0
            } else {
                self.values.get(k as usize).or(self.values.last()).copied().unwrap_or(0.0)
            }
        };
        let (a, b) = (from_s, from_s + length_s);
        let edge = ((a / self.period_s + 1.0e-9).floor() + 1.0) * self.period_s;
        if edge >= b {
            return hold(a);
        }
        let early = (edge - a) / length_s;
        early * hold(a) + (1.0 - early) * hold(b)
    }
}

/// Disturbances from one sample to the next.
#[derive(Debug, Default)]
struct Noise {
    coloured: [f64; 2],
    walk: f64,
}

impl Noise {
    /// White at both ends; at the stage also a resonance of 10 Hz (damping 0.5) driven by noise, and a walk.
    fn next(&mut self, b: &Background, period_s: f64, rng: &mut impl Rng) -> (f64, f64) {
        let mut normal = || -> f64 { StandardNormal.sample(rng) };
        let motor = b.motor_white_n * normal();
        let w = TAU * 10.0;
        // Oscillator driven by white noise of intensity q: variance q/(4 zeta w^3) = 1, zeta = 0.5.
        let push = (2.0 * w.powi(3) / period_s).sqrt() * normal();
        let [x, v] = self.coloured;
        let v = v + period_s * (push - w * v - w * w * x);
        self.coloured = [x + period_s * v, v];
        self.walk += b.random_walk_n * period_s.sqrt() * normal();
        let stage = b.stage_white_n * normal() + b.coloured_n * self.coloured[0] + self.walk;
        (motor, stage)
    }
}

/// A uniform phase.
pub(super) fn phase(rng: &mut impl Rng) -> f64 {
    rng.random_range(0.0..TAU)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_held_current_may_change_inside_a_step() {
        let told = HeldCurrent { values: vec![1.0, 3.0], period_s: 1.0e-4 };
        assert!((told.mean(0.95e-4, 1.0e-5) - 2.0).abs() < 1.0e-6);
        assert!((told.mean(0.3e-4, 1.0e-5) - 1.0).abs() < 1.0e-12);
        assert!(told.mean(-0.5e-4, 1.0e-5).abs() < 1.0e-12);
    }

    #[test]
    fn the_past_is_read_between_its_points() {
        let mut past = Past::new(1.0e-4, 1.0e-5, 0.0);
        for k in 1..=30 {
            past.push(f64::from(k));
        }
        assert!((past.at(2.5e-5) - 27.5).abs() < 1.0e-9);
        assert!((past.at(1.0e-4) - 20.0).abs() < 1.0e-9);
    }

    #[test]
    fn coloured_noise_has_the_size_it_says() {
        let mut rng = <rand_chacha::ChaCha8Rng as rand::SeedableRng>::seed_from_u64(1);
        let b = Background { motor_white_n: 0.0, stage_white_n: 0.0, coloured_n: 2.0, random_walk_n: 0.0 };
        let mut noise = Noise::default();
        let values: Vec<f64> = (0..400_000).map(|_| noise.next(&b, 1.0e-4, &mut rng).1).collect();
        let rms = (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt();
        assert!((rms - 2.0).abs() < 0.4, "{rms}"); // 40 s of a 10 Hz process: some 10 % of scatter
    }
}
