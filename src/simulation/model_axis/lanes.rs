//! Equations of motion and integration of several models side by side.
//!
//! ```text
//!   m_1 x_m'' = F(i) - C_r x_m' - F_m - T          T = -(k e + c e'),  e = x_c - x_m
//!   m_2 x_c'' = T - S                              S: spring with gap, slope and cube, C_k beside it
//!   M_t x_s'' = S - C_t x_s' - F_s
//! ```
//! Without a torsional spring the screw belongs to the motor and T = S; on a rigid axis there is m_1 alone.

use super::constants::{Constants, Lane};
use super::control::LawState;
use super::further::{Further, Waves};
use super::tanh::tanh;
use super::{Response, Trial};
use crate::signal::dispatch::{Kernel, multiply_add};

/// States: motor x, v; stage x, v; screw behind the motor e, e'; current; bristle's force.
const STATES: usize = 8;
const MOTOR: usize = 0;
const MOTOR_V: usize = 1;
const STAGE: usize = 2;
const STAGE_V: usize = 3;
const TWIST: usize = 4;
const TWIST_V: usize = 5;
const CURRENT: usize = 6;
const BRISTLE: usize = 7;

type State<const L: usize> = [Lane<L>; STATES];

/// Constants of several models, and what few of them have.
pub(super) struct Lanes<const L: usize> {
    models: [Constants; L],
    rigid: bool,
    bristled: bool,
    /// 1 where the screw belongs to the motor.
    joined: Lane<L>,
    motor_1_kg: Lane<L>,
    screw_1_kg: Lane<L>,
    stage_1_kg: Lane<L>,
    torsion: [Lane<L>; 2],
    thrust_per_unit: Lane<L>,
    saturation: Lane<L>,
    parabolic: Lane<L>,
    stiffness: Lane<L>,
    slope: Lane<L>,
    half_gap: Lane<L>,
    cubic: Lane<L>,
    structural: Lane<L>,
    viscous: [Lane<L>; 2],
    coulomb: [Lane<L>; 2],
    smoothing_1: Lane<L>,
    bristle: Lane<L>,
    bristle_share: Lane<L>,
    loop_rad_s: Lane<L>,
    /// 1 where the current follows at once.
    at_once: Lane<L>,
    /// Difference of the two positions at which the spring is free, m.
    free_m: f64,
    /// Further forces against the motion of motor and stage.
    further: [Option<Further<L>>; 2],
}

impl<const L: usize> Lanes<L> {
    pub(super) fn new<'a>(pick: impl Fn(usize) -> &'a Constants, start_m: [f64; 2]) -> Self {
        let models: [Constants; L] = std::array::from_fn(|l| pick(l).clone());
        let of = |f: &dyn Fn(&Constants) -> f64| -> Lane<L> { std::array::from_fn(|l| f(&models[l])) };
        let flag = |b: bool| f64::from(u8::from(b));
        let further = [0, 1].map(|side| Further::of(&models, side));
        Self {
            rigid: models[0].rigid,
            bristled: models.iter().any(|m| m.bristle_n_m > 0.0),
            joined: of(&|m| flag(m.screw_kg.is_none())),
            motor_1_kg: of(&|m| 1.0 / m.motor_kg),
            screw_1_kg: of(&|m| m.screw_kg.map_or(0.0, |kg| 1.0 / kg)),
            stage_1_kg: of(&|m| 1.0 / m.stage_kg),
            torsion: [of(&|m| m.torsion_n_m), of(&|m| m.torsion_n_s_m)],
            thrust_per_unit: of(&|m| m.thrust_per_unit),
            saturation: of(&|m| m.saturation),
            parabolic: of(&|m| m.parabolic),
            stiffness: of(&|m| m.stiffness_n_m),
            slope: of(&|m| m.stiffness_slope_1_m),
            half_gap: of(&|m| m.half_gap_m),
            cubic: of(&|m| m.cubic_n_m3),
            structural: of(&|m| m.structural_n_s_m),
            viscous: [0, 1].map(|side| of(&|m| m.viscous_n_s_m[side])),
            coulomb: [0, 1].map(|side| of(&|m| m.coulomb_n[side])),
            smoothing_1: of(&|m| 1.0 / m.smoothing_m_s),
            bristle: of(&|m| m.bristle_n_m),
            bristle_share: of(&|m| m.bristle_share),
            loop_rad_s: of(&|m| m.loop_rad_s.unwrap_or(0.0)),
            at_once: of(&|m| flag(m.loop_rad_s.is_none())),
            free_m: start_m[0] - start_m[1],
            further,
            models,
        }
    }

    /// Time derivative of the state. `told`: reference that the drive holds now.
    #[inline(always)]
    fn derivative<const FUSED: bool>(&self, t_s: f64, s: &State<L>, told: &Lane<L>) -> State<L> {
        let mut out = [[0.0; L]; STATES];
        let mut motor_n = [0.0; L];
        let (motor_slides, further) = self.sliding::<FUSED>(0, t_s, s);
        for l in 0..L {
            let i = self.at_once[l] * told[l] + (1.0 - self.at_once[l]) * s[CURRENT][l];
            out[CURRENT][l] = self.loop_rad_s[l] * (told[l] - s[CURRENT][l]);
            let bent = self.saturation[l] * i * i;
            let kept = 1.0 - bent / (1.0 + (1.0 - self.parabolic[l]) * bent);
            let thrust = self.thrust_per_unit[l] * i * kept;
            let friction = multiply_add::<FUSED>(
                self.viscous[0][l],
                s[MOTOR_V][l],
                self.coulomb[0][l] * motor_slides[l],
            );
            motor_n[l] = thrust - friction - further[l];
        }
        if self.rigid {
            return self.rigid_derivative(s, (&motor_n, &motor_slides), out);
        }
        let (stage_slides, further) = self.sliding::<FUSED>(1, t_s, s);
        for l in 0..L {
            let (x, v) = (s[STAGE][l], s[STAGE_V][l]);
            let stretch = s[MOTOR][l] + s[TWIST][l] - x - self.free_m;
            let rate = s[MOTOR_V][l] + s[TWIST_V][l] - v;
            let pressed = stretch - stretch.max(-self.half_gap[l]).min(self.half_gap[l]);
            let more = self.cubic[l] * stretch * stretch + self.stiffness[l] * self.slope[l] * x;
            let spring = multiply_add::<FUSED>(
                self.stiffness[l],
                pressed,
                multiply_add::<FUSED>(more, stretch, self.structural[l] * rate),
            );
            let torsion =
                -multiply_add::<FUSED>(self.torsion[0][l], s[TWIST][l], self.torsion[1][l] * s[TWIST_V][l]);
            let apart = 1.0 - self.joined[l];
            let behind = self.joined[l] * spring + apart * torsion;
            let motor_accel = (motor_n[l] - behind) * self.motor_1_kg[l];
            let sliding = stage_slides[l];
            let friction = multiply_add::<FUSED>(self.viscous[1][l], v, self.coulomb[1][l] * sliding);
            let bristle = self.bristle_share[l] * (s[BRISTLE][l] - self.coulomb[1][l] * sliding);
            out[MOTOR][l] = s[MOTOR_V][l];
            out[MOTOR_V][l] = motor_accel;
            out[STAGE][l] = v;
            out[STAGE_V][l] = (spring - friction - bristle - further[l]) * self.stage_1_kg[l];
            out[TWIST][l] = apart * s[TWIST_V][l];
            out[TWIST_V][l] = apart * ((torsion - spring) * self.screw_1_kg[l] - motor_accel);
        }
        if self.bristled {
            self.bristle_rates(1, s, &mut out);
        }
        out
    }

    /// Direction of sliding of motor (0) or stage (1), and the further forces against its motion.
    #[inline(always)]
    fn sliding<const FUSED: bool>(&self, side: usize, t_s: f64, s: &State<L>) -> (Lane<L>, Lane<L>) {
        let (x, v) = (&s[2 * side], &s[2 * side + 1]);
        let mut slides = [0.0; L];
        for l in 0..L {
            slides[l] = tanh::<FUSED>(v[l] * self.smoothing_1[l]);
        }
        let further = match &self.further[side] {
            Some(further) => further.force_n::<FUSED>(t_s, (x, v), &slides),
            None => [0.0; L],
        };
        (slides, further)
    }

    #[inline(always)]
    fn rigid_derivative(
        &self,
        s: &State<L>,
        (motor_n, slides): (&Lane<L>, &Lane<L>),
        mut out: State<L>,
    ) -> State<L> {
        for l in 0..L {
            let bristle = self.bristle_share[l] * (s[BRISTLE][l] - self.coulomb[0][l] * slides[l]);
            out[MOTOR][l] = s[MOTOR_V][l];
            out[MOTOR_V][l] = (motor_n[l] - bristle) * self.motor_1_kg[l];
            (out[STAGE][l], out[STAGE_V][l]) = (out[MOTOR][l], out[MOTOR_V][l]);
        }
        if self.bristled {
            self.bristle_rates(0, s, &mut out);
        }
        out
    }

    /// Dahl: dF = s_0 (v - |v| F / F_c).
    fn bristle_rates(&self, side: usize, s: &State<L>, out: &mut State<L>) {
        for l in 0..L {
            let v = s[2 * side + 1][l];
            let yielded = s[BRISTLE][l] / self.coulomb[side][l].max(1.0e-3);
            out[BRISTLE][l] = self.bristle[l] * (v - v.abs() * yielded);
        }
    }

    /// One step of the classical Runge-Kutta method. A loop, not four copies of the derivative: the code of
    /// four does not fit the cache of instructions.
    #[inline(always)]
    fn advance<const FUSED: bool>(&self, t_s: f64, s: &State<L>, (told, h): (&Lane<L>, f64)) -> State<L> {
        /// Where in the step each derivative is taken, and its share of the step.
        const STAGES: [(f64, f64); 4] =
            [(0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0)];
        let mut rate = [[0.0; L]; STATES];
        let mut out = *s;
        for (place, share) in STAGES {
            rate = self.derivative::<FUSED>(t_s + place * h, &moved(s, &rate, place * h), told);
            out = moved(&out, &rate, share * h);
        }
        out
    }
}

/// The nearest whole number of a size below 2^51, without a library call.
#[inline(always)]
fn whole(x: f64) -> f64 {
    /// 1.5 * 2^52.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    if x.abs() < 2.0e15 { (x + ROUND) - ROUND } else { x }
}

#[inline(always)]
fn moved<const L: usize>(s: &State<L>, k: &State<L>, by: f64) -> State<L> {
    let mut out = *s;
    for i in 0..STATES {
        for l in 0..L {
            out[i][l] += by * k[i][l];
        }
    }
    out
}

/// Where in the past an encoder looks: whole steps and the part of one.
struct Look<const L: usize> {
    whole: [usize; L],
    part: Lane<L>,
}

impl<const L: usize> Look<L> {
    fn new(delay_s: impl Fn(usize) -> f64, step_s: f64) -> Self {
        let steps: Lane<L> = std::array::from_fn(|l| delay_s(l) / step_s);
        Self { whole: steps.map(|s| s.floor() as usize), part: steps.map(|s| s - s.floor()) }
    }

    fn reach(&self) -> usize {
        self.whole.iter().max().map_or(0, |w| w + 2)
    }

    /// Value of each lane that long ago; `newest`: steps so far. The ring's length is a power of two.
    #[inline(always)]
    fn at(&self, ring: &[Lane<L>], newest: usize) -> Lane<L> {
        let mask = ring.len() - 1;
        let mut out = [0.0; L];
        for l in 0..L {
            let back = newest.wrapping_sub(self.whole[l]);
            let (near, far) = (ring[back & mask][l], ring[back.wrapping_sub(1) & mask][l]);
            out[l] = near + self.part[l] * (far - near);
        }
        out
    }
}

/// The reference that is held during one step: mean of two held values, so many samples ago.
struct Held<const L: usize> {
    ago: [usize; L],
    /// Share of the older of the two.
    older: Lane<L>,
}

impl<const L: usize> Held<L> {
    /// Step `j` of a sample covers `[j h, (j + 1) h]` less the dead time.
    fn new(dead_s: impl Fn(usize) -> f64, (j, step_s, period_s): (usize, f64, f64)) -> Self {
        let from: Lane<L> = std::array::from_fn(|l| (j as f64 * step_s - dead_s(l)) / period_s + 1.0e-9);
        let edge_s: Lane<L> = from.map(|f| (f.floor() + 1.0 - f) * period_s);
        Self {
            ago: from.map(|f| (-f.floor()).max(0.0) as usize),
            older: edge_s.map(|e| (e / step_s).min(1.0)),
        }
    }

    /// `told`: a ring whose length is a power of two; `newest`: the sample that was told last.
    #[inline(always)]
    fn mean(&self, told: &[Lane<L>], newest: usize) -> Lane<L> {
        let mask = told.len() - 1;
        let mut out = [0.0; L];
        for l in 0..L {
            let old = told[newest.wrapping_sub(self.ago[l]) & mask][l];
            let new = told[newest.wrapping_sub(self.ago[l].saturating_sub(1)) & mask][l];
            out[l] = new + self.older[l] * (old - new);
        }
        out
    }
}

/// One trial of several models.
pub(super) struct Run<'a, const L: usize> {
    pub(super) lanes: Lanes<L>,
    pub(super) trial: &'a Trial,
    /// Steps in a sample.
    pub(super) steps: usize,
}

impl<const L: usize> Kernel for Run<'_, L> {
    type Output = Vec<Response>;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> Vec<Response> {
        let (trial, models) = (self.trial, &self.lanes.models);
        let h = trial.period_s / self.steps as f64;
        let looks: [Look<L>; 2] = [0, 1].map(|e| Look::new(|l| models[l].delay_s[e], h));
        let held: Vec<Held<L>> = (0..self.steps)
            .map(|j| {
                Held::new(|l| (models[l].dead_time_s + trial.taken_up_s).max(0.0), (j, h, trial.period_s))
            })
            .collect();
        let mut state = [[0.0; L]; STATES];
        state[MOTOR_V] = [trial.start_m_s; L];
        state[STAGE_V] = [trial.start_m_s; L];
        let origin = if self.lanes.rigid { [trial.start_m[0]; 2] } else { trial.start_m };
        (state[MOTOR], state[STAGE]) = ([origin[0]; L], [origin[1]; L]);
        let length = (looks[0].reach().max(looks[1].reach()) + 1).next_power_of_two();
        let before = |k: usize| -((length - 1 - k) as f64) * h * trial.start_m_s;
        let mut rings: [Vec<Lane<L>>; 2] =
            [0, 1].map(|e| (0..length).map(|k| [origin[e] + before(k); L]).collect());
        let mut newest = length - 1;
        let first = trial.command_m.first().copied().unwrap_or(0.0);
        let errors = [0, 1].map(|side| Waves::of_encoder(models, side));
        let read = |side: usize, x: Lane<L>| {
            let mut read = x;
            for waves in &errors[side] {
                let error = waves.at::<FUSED>(&x);
                (0..L).for_each(|l| read[l] += error[l]);
            }
            for (read, model) in read.iter_mut().zip(models) {
                let step = model.step_m[side];
                *read = if step > 0.0 { whole(*read / step) * step } else { *read };
            }
            read
        };
        let gain = trial.law.gain();
        let began = read(0, looks[0].at(&rings[0], newest));
        let mut laws: [LawState; L] =
            std::array::from_fn(|l| LawState::new(first, began[l], (trial.start_m_s, trial.integral_m)));
        let samples = trial.command_m.len();
        let longest = held.iter().flat_map(|h| h.ago).max().unwrap_or(0) + 1;
        let mut told = vec![[0.0; L]; longest.next_power_of_two()];
        let empty = || Vec::with_capacity(samples);
        let mut responses: Vec<Response> =
            (0..L).map(|_| Response { reference: empty(), motor_m: empty(), stage_m: empty() }).collect();
        for (k, command) in trial.command_m.iter().enumerate() {
            let now = [0, 1].map(|e| read(e, looks[e].at(&rings[e], newest)));
            let injected = trial.injected.get(k).copied().unwrap_or(0.0);
            let mut asked = [0.0; L];
            for (l, response) in responses.iter_mut().enumerate() {
                let places = [*command, now[0][l], now[1][l]];
                asked[l] = gain * trial.law.error_m_s(&mut laws[l], places, trial.period_s) + injected;
                response.reference.push(asked[l]);
                response.motor_m.push(now[0][l]);
                response.stage_m.push(now[1][l]);
            }
            if k == 0 {
                told.fill(asked);
            }
            let latest = k & (told.len() - 1);
            told[latest] = asked;
            if k == 0 {
                state[CURRENT] = asked;
            }
            for (j, held) in held.iter().enumerate() {
                let t_s = k as f64 * trial.period_s + j as f64 * h;
                state = self.lanes.advance::<FUSED>(t_s, &state, (&held.mean(&told, k), h));
                newest += 1;
                rings[0][newest & (length - 1)] = state[MOTOR];
                rings[1][newest & (length - 1)] = state[STAGE];
            }
        }
        responses
    }
}
