//! Several cuts in time, one to a lane.

use super::course::Course;
use super::modes::Modes;
use super::{CutModel, CutTrial, FreeRun, LANES, terms_of};
use crate::plant::cut_effects::AtAngle;
use crate::plant::cut_loop::{CutLoop, RANDOM_FORCE_CORNER_HZ};
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::ToolCount;
use crate::signal::dispatch::{Kernel, multiply_add};
use std::f64::consts::TAU;

pub(super) type Lane = [f64; LANES];

/// Places of a turn at which stock and runout are looked up.
const PLACES: usize = 2048;

/// Constants of the law under one condition.
#[derive(Debug, Clone, Default)]
struct Law {
    /// k_j h_r^(1-p).
    chip: [Lane; 2],
    /// p - 1.
    bend: Lane,
    edge: Lane,
    contact: Lane,
    /// C_i/v.
    damping: Lane,
    /// C_f/v, and v tan gamma.
    flank: [Lane; 2],
    advance: [Lane; 2],
    overlap: Lane,
    ahead: Lane,
    /// What is left of the force after a step, and what it takes on of the law a step ago and now: a lag of
    /// first order behind a law that runs straight.
    lagged: [Lane; 3],
    width_1_m: Lane,
}

/// What stock and runout do at each place of the material: width added, m, and factor.
type Turning = Vec<[Lane; 2]>;

/// What a tool meets: the surface at the two steps between which it was left, the share of the newer, and the
/// place of the material.
struct Met<'a> {
    older: &'a Lane,
    newer: &'a Lane,
    part: f64,
    place: usize,
}

/// What the other tool has left, `back` steps ago, at steps `[now, other]`.
#[inline(always)]
fn met(surface: &[[Lane; 2]], [now, other]: [usize; 2], back: f64) -> Met<'_> {
    let whole = back as usize + 1;
    let older = (now + surface.len() - whole) & (surface.len() - 1);
    Met {
        older: &surface[older][other],
        newer: &surface[(older + 1) & (surface.len() - 1)][other],
        part: whole as f64 - back,
        place: 0,
    }
}

/// Place of the material at an angle.
fn place(material_rad: f64) -> usize {
    (material_rad / TAU * PLACES as f64).floor() as i64 as usize & (PLACES - 1)
}

/// Models side by side, in motion.
pub(super) struct Lanes<'a> {
    trial: &'a CutTrial,
    models: [CutModel; LANES],
    /// Coefficients now.
    terms: Option<[CutTerms; LANES]>,
    steps: usize,
    step_s: f64,
    law: Law,
    bent: bool,
    turning: Option<Turning>,
    /// Planes and second mode of the bar, then the holder.
    modes: [Modes; 4],
    /// Which of them any model has.
    there: [bool; 4],
    /// Forces on the bar and on the holder, a step ago and two.
    driving: [[Lane; 2]; 2],
    force: [Lane; 2],
    /// What the law said a step ago.
    said: [Lane; 2],
    /// True where any model has a random force.
    is_random: bool,
    noise: [Lane; 2],
    random: [[u64; LANES]; 2],
    /// How the random force goes on, and what is added to it.
    kept: f64,
    added: Lane,
    /// 1 where tool 2 cuts.
    second: f64,
}

impl<'a> Lanes<'a> {
    pub(super) fn new<'m>(pick: impl Fn(usize) -> &'m CutModel, trial: &'a CutTrial, steps: usize) -> Self {
        let models: [CutModel; LANES] = std::array::from_fn(|l| *pick(l));
        let step_s = trial.period_s / steps as f64;
        let zero = [0.0; LANES];
        let kept = (-TAU * RANDOM_FORCE_CORNER_HZ * step_s).exp();
        // Uniform numbers of variance 1/12 drive it; some ten of them make one force.
        let drive = (12.0 * (1.0 - kept * kept)).sqrt();
        let seeds = |tool: u64| std::array::from_fn(|l| scrambled(2 * models[l].seed + tool));
        let mut lanes = Self {
            trial,
            terms: None,
            steps,
            step_s,
            law: Law::default(),
            bent: false,
            turning: turning(&models),
            modes: <[Modes; 4]>::default(),
            there: [false; 4],
            driving: [[zero; 2]; 2],
            force: [zero; 2],
            said: [zero; 2],
            is_random: models.iter().any(|m| m.random_share > 0.0),
            noise: [zero; 2],
            random: [seeds(0), seeds(1)],
            kept,
            added: std::array::from_fn(|l| drive * models[l].random_share),
            second: f64::from(u8::from(models[0].scenario.tools.count() == ToolCount::Two)),
            models,
        };
        lanes.rest();
        lanes
    }

    /// The quiet cut of the first condition.
    fn rest(&mut self) {
        self.take_on(0);
        for l in 0..LANES {
            let cut = CutLoop::new(&terms_of(&self.models[l], &self.trial.conditions[0]));
            let means = cut.means();
            self.force[0][l] = means.force_n[0];
            self.force[1][l] = means.force_n[1];
            (self.said[0][l], self.said[1][l]) = (self.force[0][l], self.force[1][l]);
            let driving = [self.second * means.force_n[1] - means.force_n[0], -means.force_n[1]];
            for (led, n) in self.driving.iter_mut().zip(driving) {
                led.iter_mut().for_each(|lane| lane[l] = n);
            }
            for (modes, resonance) in self.modes.iter_mut().zip(&cut.bar) {
                modes.at[l] = resonance.compliance_m_n() * driving[0];
            }
            self.modes[3].at[l] = cut.holder.map_or(0.0, |h| h.compliance_m_n() * driving[1]);
        }
    }

    /// Numbers of the condition of a sample.
    fn take_on(&mut self, condition: usize) {
        let at = &self.trial.conditions[condition.min(self.trial.conditions.len() - 1)];
        let terms: [CutTerms; LANES] = std::array::from_fn(|l| terms_of(&self.models[l], at));
        // Of a condition the times alone change mostly, and no number with them.
        let same = |known: &[CutTerms; LANES]| {
            known.iter().zip(&terms).all(|(known, terms)| CutTerms { at: known.at, ..*terms } == *known)
                && CutCondition { time_s: at.time_s, edge_age_s: at.edge_age_s, ..known[0].at } == *at
        };
        if self.terms.as_ref().is_some_and(same) {
            return;
        }
        self.bent = false;
        for (l, terms) in terms.iter().enumerate() {
            let cut = CutLoop::new(terms);
            let law = &mut self.law;
            let reference = if cut.reference_chip_m > 0.0 { cut.reference_chip_m } else { 1.0 };
            for tool in 0..2 {
                law.chip[tool][l] = cut.cutting_n_m[tool] * reference.powf(1.0 - cut.exponent);
                law.advance[tool][l] = cut.advance_m[tool];
            }
            law.bend[l] = cut.exponent - 1.0;
            self.bent |= law.bend[l].abs() > 0.0;
            law.edge[l] = cut.edge_n;
            law.contact[l] = cut.contact_n_m;
            law.damping[l] = cut.damping_n_s_m;
            let surface_m_s = at.surface_speed_m_s();
            law.flank[0][l] = terms.width_ratio * terms.flank_force_n / surface_m_s;
            law.flank[1][l] = surface_m_s * terms.clearance_slope;
            law.overlap[l] = cut.overlap;
            law.ahead[l] = cut.tool2_ahead_m;
            let [left, then, now] = lagged(self.step_s, cut.lag_s);
            (law.lagged[0][l], law.lagged[1][l], law.lagged[2][l]) = (left, then, now);
            law.width_1_m[l] = if at.width_m > 0.0 { 1.0 / at.width_m } else { 0.0 };
            for (k, resonance) in cut.bar.iter().chain(&cut.holder).enumerate() {
                if resonance.gain_1_kg.abs() > 0.0 {
                    self.there[k] = true;
                    self.modes[k].tune(l, resonance, self.step_s);
                }
            }
        }
        self.terms = Some(terms);
    }

    /// The bar at the tools.
    fn bar(&self) -> Lane {
        std::array::from_fn(|l| self.modes[..3].iter().map(|m| m.at[l]).sum())
    }

    /// What each edge leaves where it does not leave the cut.
    fn edges(&self) -> [Lane; 2] {
        let bar = self.bar();
        [bar, std::array::from_fn(|l| self.modes[3].at[l] - bar[l] + self.law.ahead[l])]
    }

    /// The random force goes on by a step.
    #[inline(always)]
    fn draw(&mut self) {
        let (kept, added) = (self.kept, self.added);
        for (random, noise) in self.random.iter_mut().zip(&mut self.noise) {
            for l in 0..LANES {
                let mut x = random[l];
                x ^= x << 13;
                x ^= x >> 7;
                x ^= x << 17;
                random[l] = x;
                let uniform = f64::from_bits((x >> 12) | 0x3FF0_0000_0000_0000) - 1.5;
                noise[l] = kept * noise[l] + added[l] * uniform;
            }
        }
    }

    /// Factors of the chip's force by its exponent, and of the whole force by stock and runout.
    #[inline(always)]
    fn factors(&self, bar: &Lane, holder: &Lane, met_m: &[Lane; 2], places: [usize; 2]) -> [[Lane; 2]; 2] {
        let law = &self.law;
        let (mut bend, mut stock) = ([[1.0; LANES]; 2], [[1.0; LANES]; 2]);
        if self.bent {
            for l in 0..LANES {
                for (tool, into) in [bar[l], holder[l] - bar[l]].into_iter().enumerate() {
                    let chip_m = law.advance[tool][l] + into - law.overlap[l] * met_m[tool][l];
                    bend[tool][l] = chip_m.max(1e-12).powf(law.bend[l]);
                }
            }
        }
        if let Some(turning) = &self.turning {
            for (stock, place) in stock.iter_mut().zip(places) {
                let [added_m, factor] = &turning[place];
                for l in 0..LANES {
                    stock[l] = larger(1.0 + added_m[l] * law.width_1_m[l], 0.0) * factor[l];
                }
            }
        }
        [bend, stock]
    }

    /// One step: forces of now, surfaces of now, and the motion to the next.
    ///
    /// Everything that each step waits for stands in one loop over the lanes.
    #[inline(always)]
    fn step<const FUSED: bool>(&mut self, met: &[Met; 2]) -> [Lane; 2] {
        if self.is_random {
            self.draw();
        }
        let mut met_m = [[0.0; LANES]; 2];
        for (met_m, met) in met_m.iter_mut().zip(met) {
            for l in 0..LANES {
                met_m[l] = multiply_add::<FUSED>(met.part, met.newer[l] - met.older[l], met.older[l]);
            }
        }
        let (mut beside_m, mut beside_m_s) = ([0.0; LANES], [0.0; LANES]);
        for k in 1..3 {
            if self.there[k] {
                for l in 0..LANES {
                    beside_m[l] += self.modes[k].at[l];
                    beside_m_s[l] += self.modes[k].speed[l];
                }
            }
        }
        let mut holder_m = [0.0; LANES];
        for l in 0..LANES {
            holder_m[l] = self.modes[3].at[l] + self.law.ahead[l];
        }
        let mut bar_m = [0.0; LANES];
        for l in 0..LANES {
            bar_m[l] = self.modes[0].at[l] + beside_m[l];
        }
        let [bend, stock] = self.factors(&bar_m, &holder_m, &met_m, [met[0].place, met[1].place]);
        let (mut left_m, mut driving_n) = ([[0.0; LANES]; 2], [0.0; LANES]);
        let law = &self.law;
        for l in 0..LANES {
            let cut = |tool: usize, into: f64, speed: f64| {
                let chip_m = into + (law.advance[tool][l] - law.overlap[l] * met_m[tool][l]);
                let gain = law.chip[tool][l] * bend[tool][l] * (1.0 + self.noise[tool][l]);
                let rubbing = law.flank[0][l] * larger(speed - law.flank[1][l], 0.0);
                let flank = law.edge[l] + multiply_add::<FUSED>(law.damping[l], speed, rubbing);
                let rest = multiply_add::<FUSED>(law.contact[l], into, flank);
                let body = multiply_add::<FUSED>(gain, chip_m, rest);
                let says = if chip_m > 0.0 { larger(body, 0.0) * stock[tool][l] } else { 0.0 };
                // Out of the cut the surface stays as it was.
                (says, into - smaller(chip_m, 0.0))
            };
            let (bar, speed) = (self.modes[0].at[l] + beside_m[l], self.modes[0].speed[l] + beside_m_s[l]);
            let (first, left_1) = cut(0, bar, speed);
            let (second, left_2) = cut(1, holder_m[l] - bar, self.modes[3].speed[l] - speed);
            (left_m[0][l], left_m[1][l]) = (left_1, left_2);
            let second = self.second * second;
            let lagged = |says: f64, said: f64, force: f64| {
                let before = multiply_add::<FUSED>(law.lagged[1][l], said, law.lagged[0][l] * force);
                multiply_add::<FUSED>(law.lagged[2][l], says, before)
            };
            let forces = [
                lagged(first, self.said[0][l], self.force[0][l]),
                lagged(second, self.said[1][l], self.force[1][l]),
            ];
            (self.said[0][l], self.said[1][l]) = (first, second);
            (self.force[0][l], self.force[1][l]) = (forces[0], forces[1]);
            driving_n[l] = forces[1] - forces[0];
            self.modes[0].advance::<FUSED>(l, [driving_n[l], self.driving[0][0][l], self.driving[0][1][l]]);
        }
        for k in 1..3 {
            if self.there[k] {
                for l in 0..LANES {
                    let older = [self.driving[0][0][l], self.driving[0][1][l]];
                    self.modes[k].advance::<FUSED>(l, [driving_n[l], older[0], older[1]]);
                }
            }
        }
        for l in 0..LANES {
            self.driving[0][1][l] = self.driving[0][0][l];
            self.driving[0][0][l] = driving_n[l];
        }
        if self.there[3] {
            for l in 0..LANES {
                let now = -self.force[1][l];
                let [newer, older] = [self.driving[1][0][l], self.driving[1][1][l]];
                self.modes[3].advance::<FUSED>(l, [now, newer, older]);
                (self.driving[1][0][l], self.driving[1][1][l]) = (now, newer);
            }
        }
        left_m
    }
}

/// The smaller of two numbers, neither of which is none.
#[inline(always)]
fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// The larger of two numbers, neither of which is none (`f64::max` asks).
#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// A first-order lag over a step: weights of its last value, and of what it follows, a step ago and now.
fn lagged(step_s: f64, lag_s: f64) -> [f64; 3] {
    if lag_s <= 0.0 {
        return [0.0, 0.0, 1.0];
    }
    let r = step_s / lag_s;
    let left = (-r).exp();
    let mean = (1.0 - left) / r;
    [left, mean - left, 1.0 - mean]
}

/// Seeds that differ by one make other numbers from the first on (SplitMix64; never nought).
fn scrambled(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    (z ^ (z >> 31)).max(1)
}

/// `None`: nothing follows the angle in any model.
fn turning(models: &[CutModel; LANES]) -> Option<Turning> {
    let at = |model: &CutModel, place: usize| {
        let mut now = AtAngle::default();
        let psi_rad = TAU * (place as f64 + 0.5) / PLACES as f64;
        model.scenario.physics.iter().for_each(|effect| effect.modulate(psi_rad, &mut now));
        now
    };
    let varies = |model: &CutModel| (0..PLACES).any(|place| at(model, place) != AtAngle::default());
    models.iter().any(varies).then(|| {
        let of = |place: usize| {
            let each: [AtAngle; LANES] = std::array::from_fn(|l| at(&models[l], place));
            [each.map(|now| now.width_m), each.map(|now| now.factor)]
        };
        (0..PLACES).map(of).collect()
    })
}

/// The whole run of some lanes.
pub(super) struct Run<'a> {
    pub(super) lanes: Lanes<'a>,
    pub(super) course: &'a Course,
}

impl Kernel for Run<'_> {
    type Output = Vec<FreeRun>;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> Vec<FreeRun> {
        let Self { mut lanes, course } = self;
        let (trial, steps) = (lanes.trial, lanes.steps);
        let samples = trial.turned_rad.len();
        let mut out: Vec<FreeRun> = (0..LANES).map(|_| FreeRun::of(samples)).collect();
        let mut block = Vec::with_capacity(trial.held);
        // What was left before the trial is what the quiet cut leaves.
        let edges = lanes.edges();
        let room = ((course.longest().ceil() as usize + 3) * steps).next_power_of_two();
        let mut surface = vec![edges; room];
        let one = course.since[1].is_empty();
        let mut now = 0;
        for k in 0..samples {
            if k % trial.held == 0 {
                lanes.take_on(k / trial.held);
            }
            let next = (k + 1).min(samples - 1);
            if block.len() == trial.held {
                hand_over(&mut block, &mut out);
            }
            block.push([lanes.force[0], lanes.force[1], lanes.bar()]);
            let shift = trial.pitch_difference_rad.get(k).copied().unwrap_or(0.0) / 2.0;
            // Value now, and by how much it changes a step.
            let run =
                |list: &[f64], scale: f64| [list[k] * scale, (list[next] - list[k]) * scale / steps as f64];
            let [turned, turning] = run(&trial.turned_rad, 1.0);
            let back = [0, usize::from(!one)].map(|tool| run(&course.since[tool], steps as f64));
            for step in 0..steps {
                let at = |[value, change]: [f64; 2]| value + step as f64 * change;
                // One tool meets what it left itself; the other, which is not there, meets the same.
                let mut met = [
                    met(&surface, [now, usize::from(!one)], at(back[0])),
                    met(&surface, [now, 0], at(back[1])),
                ];
                if lanes.turning.is_some() {
                    let turned = at([turned, turning]);
                    (met[0].place, met[1].place) = (place(turned - shift), place(turned - 0.5 * TAU));
                }
                let left = lanes.step::<FUSED>(&met);
                surface[now & (room - 1)] = left;
                now = (now + 1) & (room - 1);
            }
        }
        hand_over(&mut block, &mut out);
        out
    }
}

/// Rows of all lanes to the run of each.
fn hand_over(rows: &mut Vec<[Lane; 3]>, out: &mut [FreeRun]) {
    for (l, run) in out.iter_mut().enumerate() {
        let [first, second] = &mut run.force_n;
        for (which, list) in [first, second, &mut run.bar_m].into_iter().enumerate() {
            list.extend(rows.iter().map(|row| row[which][l]));
        }
    }
    rows.clear();
}
