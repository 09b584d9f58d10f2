//! Runs a concealed cut: Runge and Kutta's fourth-order steps, and the surface as the history of both tools.
//!
//! The work's angle psi meets a tool at alpha_1 = d/2 and alpha_2 = pi. What stands before a tool is the
//! least material that any pass before it has left there: depth(t') = feed up to t' + motion of that tool
//! into the work at t', looked up where the same psi met a tool before. What lies before the start is a
//! quiet cut.

use super::machine::{Bending, Contact, Moment, TrueCut};
use std::f64::consts::{PI, TAU};

/// Steps a sample of 9 kHz.
pub(super) const SUBSTEPS: usize = 4;
/// Passes that are looked back on: after lost contact the last but one may be the deeper.
const PASSES: usize = 3;
/// States: two planes, second mode, holder (position, speed each), lagged forces, remembered
/// chips.
const STATES: usize = 12;

type State = [f64; STATES];

/// Whole steps in a stretch of time.
pub(super) fn steps_in(seconds: f64, step_s: f64) -> usize {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a stretch of seconds")]
    let steps = (seconds / step_s).round().max(0.0) as usize;
    steps
}

/// What one step shows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Shown {
    pub(super) force_n: [f64; 2],
    pub(super) bar_m: f64,
    pub(super) angle_rad: f64,
}

/// One run.
pub(super) struct Run<'a> {
    cut: &'a TrueCut,
    step_s: f64,
    state: State,
    bending: Bending,
    /// By step: angle of the work, feed up to then, motion of each tool into the work (NaN: not in the cut).
    angle_rad: Vec<f64>,
    fed_m: Vec<f64>,
    into_m: [Vec<f64>; 2],
    first: Moment,
    quiet_m: [f64; 2],
    noise: [f64; 2],
    tangle_n: f64,
    /// Pressure over what the cut says.
    pressure: f64,
}

impl<'a> Run<'a> {
    /// A run from a quiet cut at its first moment.
    pub(super) fn new(cut: &'a TrueCut, first: &Moment, steps: usize, step_s: f64) -> Self {
        let bending = cut.bending(first);
        let mut run = Self {
            cut,
            step_s,
            state: [0.0; STATES],
            bending,
            angle_rad: Vec::with_capacity(steps + 1),
            fed_m: Vec::with_capacity(steps + 1),
            into_m: [Vec::with_capacity(steps + 1), Vec::with_capacity(steps + 1)],
            first: *first,
            quiet_m: [0.0; 2],
            noise: [0.0; 2],
            tangle_n: 0.0,
            pressure: 1.0,
        };
        run.rest();
        run.keep(first, 0.0, 0.0);
        run
    }

    /// Strikes the bar, m/s.
    pub(super) fn strike(&mut self, speed_m_s: f64) {
        self.state[1] += speed_m_s;
    }

    /// Static balance under the first moment, found by letting the springs creep to it.
    fn rest(&mut self) {
        let at = self.first;
        for _ in 0..300 {
            let (into, _) = self.edges(&self.state, &at);
            self.quiet_m = into;
            let (force, chip_m) = self.law(&self.state, &at, [0.0, self.rate_rad_s(&at, 0.0)]);
            let pulled = self.accelerations(&self.state, force, &at);
            for (k, stiffness) in self.stiffness_1_s2().into_iter().enumerate() {
                self.state[2 * k] += 0.3 * pulled[k] / stiffness;
                self.state[2 * k + 1] = 0.0;
            }
            [self.state[8], self.state[9]] = force;
            [self.state[10], self.state[11]] = chip_m;
        }
        self.quiet_m = self.edges(&self.state, &at).0;
    }

    fn stiffness_1_s2(&self) -> [f64; 4] {
        let h = &self.cut.hidden;
        let of = |mode: Option<super::machine::Mode>| mode.map_or(1e6, |m| (TAU * m.frequency_hz).powi(2));
        let [a, b] = self.bending.rad_s;
        [a * a, b * b, of(h.second_mode), of(h.turret)]
    }

    /// Motion and speed of each edge into the work.
    fn edges(&self, state: &State, at: &Moment) -> ([f64; 2], [f64; 2]) {
        let h = &self.cut.hidden;
        let (sin, cos) = if h.plane_hz.is_some() { h.orientation_rad.sin_cos() } else { (0.0, 1.0) };
        let along = |q1: f64, q2: f64, q3: f64| {
            self.bending.shape * (cos * q1 - sin * q2) + self.bending.straight * q3
        };
        let y = along(state[0], state[2], state[4]);
        let speed = along(state[1], state[3], state[5]);
        let ahead = if h.runout_order < 0.5 && at.width_m > 0.0 { h.runout_m } else { 0.0 };
        ([y, state[6] + ahead - y], [speed, state[7] - speed])
    }

    fn rate_rad_s(&self, at: &Moment, commanded_rad: f64) -> f64 {
        let h = &self.cut.hidden;
        let ripple = 1.0 + h.speed_ripple * (h.ripple_order * commanded_rad + h.ripple_phase_rad).cos();
        TAU * at.speed_rpm / 60.0 * ripple
    }

    fn alpha_rad(tool: usize, pitch_rad: f64) -> f64 {
        if tool == 0 { pitch_rad / 2.0 } else { PI }
    }

    /// Depth that a tool had left when the work stood at `angle_rad`: feed and motion.
    fn left_m(&self, tool: usize, angle_rad: f64) -> f64 {
        if angle_rad <= 0.0 {
            let per_rad = self.first.feed_m_rev / TAU;
            return per_rad * angle_rad + self.cut.memory * self.quiet_m[tool];
        }
        let newest = self.angle_rad.len() - 1;
        let back = self.angle_rad[newest] - angle_rad;
        let rate = self.angle_rad[newest] - self.angle_rad[newest.saturating_sub(1)];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the history")]
        let steps = (back / rate.max(1e-12)).clamp(0.0, newest as f64) as usize;
        let mut k = newest - steps;
        while k > 0 && self.angle_rad[k] > angle_rad {
            k -= 1;
        }
        while k + 2 < newest && self.angle_rad[k + 1] <= angle_rad {
            k += 1;
        }
        let k = k.clamp(1, newest.saturating_sub(2).max(1));
        if k + 2 > newest {
            return self.fed_m[newest] + self.cut.memory * self.into_m[tool][newest];
        }
        let t = (angle_rad - self.angle_rad[k]) / (self.angle_rad[k + 1] - self.angle_rad[k]);
        let into = &self.into_m[tool];
        // Newton's cubic through four steps.
        let [a, b, c, d] = [into[k - 1], into[k], into[k + 1], into[k + 2]];
        let cubic = b + t
            * ((c - b)
                + (t - 1.0) * ((c - 2.0 * b + a) / 2.0 + (t + 1.0) * (d - 3.0 * c + 3.0 * b - a) / 6.0));
        let fed = self.fed_m[k] + t * (self.fed_m[k + 1] - self.fed_m[k]);
        fed + self.cut.memory * cubic
    }

    /// Chip of a tool: its depth now over the greatest that was left where it stands.
    fn chip_m(&self, tool: usize, into_m: f64, at: &Moment, [angle_rad, fed_m]: [f64; 2]) -> f64 {
        let psi = angle_rad - Self::alpha_rad(tool, at.pitch_rad);
        let tools = if self.cut.two_tools { 2 } else { 1 };
        let mut deepest = f64::NEG_INFINITY;
        for other in 0..tools {
            let meets = psi + Self::alpha_rad(other, at.pitch_rad);
            let behind = if other == tool { TAU } else { (angle_rad - meets).rem_euclid(TAU) };
            for pass in 0..PASSES {
                deepest = deepest.max(self.left_m(other, angle_rad - behind - TAU * pass as f64));
            }
        }
        fed_m + into_m - deepest
    }

    /// Forces of the law, and the chips.
    fn law(&self, state: &State, at: &Moment, [angle_rad, rate_rad_s]: [f64; 2]) -> ([f64; 2], [f64; 2]) {
        let (into, speed) = self.edges(state, at);
        let base = self.fed_m.last().copied().unwrap_or(0.0);
        let from = self.angle_rad.last().copied().unwrap_or(0.0);
        let fed = base + at.feed_m_rev / TAU * (angle_rad - from);
        let chips: [f64; 2] = std::array::from_fn(|tool| self.chip_m(tool, into[tool], at, [angle_rad, fed]));
        let force_n = std::array::from_fn(|tool| {
            if tool == 1 && !self.cut.two_tools {
                return 0.0;
            }
            let overshoots = self.cut.hidden.overshoot * (chips[tool] - state[10 + tool]);
            let contact = Contact {
                chip_m: if chips[tool] > 0.0 { chips[tool] + overshoots } else { chips[tool] },
                into_m: into[tool],
                into_m_s: speed[tool],
                psi_rad: angle_rad - Self::alpha_rad(tool, at.pitch_rad),
                rpm: rate_rad_s * 60.0 / TAU,
                noise: self.noise[tool],
            };
            self.pressure * self.cut.force_n(tool, at, &contact)
        });
        (force_n, chips)
    }

    /// Accelerations of planes, second mode and holder.
    fn accelerations(&self, state: &State, force: [f64; 2], at: &Moment) -> [f64; 4] {
        let h = &self.cut.hidden;
        let tone = h.tone_n * (TAU * h.tone_hz * at.t_s).sin();
        let b = &self.bending;
        let y = b.shape * state[0];
        let turned = 2.0 * self.angle_rad.last().copied().unwrap_or(0.0);
        let stiffer = 1.0 + h.stiffening_1_m2 * y * y + h.unround * turned.cos();
        let along_y = force[1] - force[0] + self.tangle_n + tone;
        let along_x = self.cut.tangential_ratio * (force[0] - force[1]);
        let (sin, cos) = if h.plane_hz.is_some() { h.orientation_rad.sin_cos() } else { (0.0, 1.0) };
        let modal = [
            b.shape * (cos * along_y + sin * along_x) / b.mass_kg,
            if h.plane_hz.is_some() { b.shape * (cos * along_x - sin * along_y) / b.mass_kg } else { 0.0 },
        ];
        let swing = |q: f64, v: f64, w: f64, zeta: f64| -w * w * q - 2.0 * zeta * w * v;
        let own = |mode: Option<super::machine::Mode>, pull: f64, k: usize| {
            mode.map_or(0.0, |m| {
                let w = TAU * m.frequency_hz;
                pull * w * w / m.n_m + swing(state[2 * k], state[2 * k + 1], w, m.damping_ratio)
            })
        };
        let zeta = self.cut.damping_ratio;
        [
            modal[0] + swing(stiffer * state[0], state[1], b.rad_s[0], zeta),
            modal[1] + swing(state[2], state[3], b.rad_s[1], zeta),
            own(h.second_mode, b.straight * along_y, 2),
            own(h.turret, -force[1], 3),
        ]
    }

    fn slope(&self, state: &State, at: &Moment, turn: [f64; 2]) -> State {
        let (law, chip_m) = self.law(state, at, turn);
        let lag = self.cut.hidden.force_lag_s;
        let force = if lag > 0.0 { [state[8], state[9]] } else { law };
        let a = self.accelerations(state, force, at);
        let follow = |k: usize| if lag > 0.0 { (law[k] - state[8 + k]) / lag } else { 0.0 };
        let fade = |k: usize| (chip_m[k] - state[10 + k]) / self.cut.hidden.fading_s;
        let [lagged, faded] = [[follow(0), follow(1)], [fade(0), fade(1)]];
        [
            state[1], a[0], state[3], a[1], state[5], a[2], state[7], a[3], lagged[0], lagged[1], faded[0],
            faded[1],
        ]
    }

    fn keep(&mut self, at: &Moment, angle_rad: f64, fed_m: f64) {
        let (into, _) = self.edges(&self.state, at);
        self.angle_rad.push(angle_rad);
        self.fed_m.push(fed_m);
        for (tool, history) in self.into_m.iter_mut().enumerate() {
            // In the air a tool leaves what a quiet cut would leave.
            history.push(if at.width_m > 0.0 { into[tool] } else { 0.0 });
        }
    }

    /// Sets what the bar is like now; a few hundred times a second is enough.
    /// `wandered`: its frequency, and the pressure, over what the cut says.
    pub(super) fn refresh(&mut self, at: &Moment, [wandered, pressure]: [f64; 2]) {
        self.pressure = pressure;
        self.bending = self.cut.bending(at);
        self.bending.rad_s.iter_mut().for_each(|w| *w *= wandered);
    }

    /// One step at a moment. `noise`: random part of each force; `tangle_n`: force on the bar.
    pub(super) fn step(&mut self, at: &Moment, commanded_rad: f64, noise: [f64; 2], tangle_n: f64) -> Shown {
        // The random part runs straight from one step to the next: held, it would be half a step late.
        self.tangle_n = tangle_n;
        let middle_noise = [(self.noise[0] + noise[0]) / 2.0, (self.noise[1] + noise[1]) / 2.0];
        let h = self.step_s;
        let angle = self.angle_rad.last().copied().unwrap_or(0.0);
        let rates = [0.0, 0.5, 1.0]
            .map(|part: f64| self.rate_rad_s(at, commanded_rad + part * h * TAU * at.speed_rpm / 60.0));
        let turned = [0.0, h * (rates[0] + rates[1]) / 4.0, h * (rates[0] + 4.0 * rates[1] + rates[2]) / 6.0];
        let at_part = |part: usize| Moment { t_s: at.t_s + 0.5 * h * part as f64, ..*at };
        let moved =
            |by: &State, part: f64| -> State { std::array::from_fn(|k| self.state[k] + part * h * by[k]) };
        let k1 = self.slope(&self.state, &at_part(0), [angle, rates[0]]);
        let middle = [angle + turned[1], rates[1]];
        self.noise = middle_noise;
        let k2 = self.slope(&moved(&k1, 0.5), &at_part(1), middle);
        let k3 = self.slope(&moved(&k2, 0.5), &at_part(1), middle);
        let end = [angle + turned[2], rates[2]];
        self.noise = noise;
        let k4 = self.slope(&moved(&k3, 1.0), &at_part(2), end);
        self.state =
            std::array::from_fn(|k| self.state[k] + h / 6.0 * (k1[k] + 2.0 * k2[k] + 2.0 * k3[k] + k4[k]));
        let (law, _) = self.law(&self.state, at, end);
        let lagged = self.cut.hidden.force_lag_s > 0.0;
        let force_n = if lagged { [self.state[8], self.state[9]] } else { law };
        let fed = self.fed_m.last().copied().unwrap_or(0.0) + at.feed_m_rev / TAU * turned[2];
        self.keep(at, end[0], fed);
        let bar_m = self.edges(&self.state, at).0[0];
        Shown { force_n, bar_m, angle_rad: end[0] }
    }
}
