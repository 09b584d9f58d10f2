//! Several cuts in time, one to a lane.

use super::course::Course;
use super::modes::{Led, Modes};
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
    driving: [Led; 2],
    force: [Lane; 2],
    /// What the law said a step ago.
    said: [Lane; 2],
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
            driving: [[zero; 3]; 2],
            force: [zero; 2],
            said: [zero; 2],
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

    /// Motion and speed of both edges into the work.
    #[inline(always)]
    fn edges(&self) -> [[Lane; 2]; 2] {
        let mut out = [[[0.0; LANES]; 2]; 2];
        for (modes, _) in self.modes[..3].iter().zip(&self.there).filter(|m| *m.1) {
            for l in 0..LANES {
                out[0][0][l] += modes.at[l];
                out[0][1][l] += modes.speed[l];
            }
        }
        let holder = &self.modes[3];
        for l in 0..LANES {
            out[1][0][l] = holder.at[l] - out[0][0][l] + self.law.ahead[l];
            out[1][1][l] = holder.speed[l] - out[0][1][l];
        }
        out
    }

    /// The random force goes on by a step.
    #[inline(always)]
    fn draw(&mut self) {
        for tool in 0..2 {
            for l in 0..LANES {
                let mut x = self.random[tool][l];
                x ^= x << 13;
                x ^= x >> 7;
                x ^= x << 17;
                self.random[tool][l] = x;
                let uniform = f64::from_bits((x >> 12) | 0x3FF0_0000_0000_0000) - 1.5;
                self.noise[tool][l] = self.kept * self.noise[tool][l] + self.added[l] * uniform;
            }
        }
    }

    /// Force of one tool and the surface that it leaves, from what it meets.
    #[inline(always)]
    fn cut<const FUSED: bool>(
        &self,
        tool: usize,
        [into, speed]: &[Lane; 2],
        met: &Lane,
        place: usize,
    ) -> (Lane, Lane) {
        let law = &self.law;
        let (mut force, mut left) = ([0.0; LANES], [0.0; LANES]);
        let mut bend = [1.0; LANES];
        let mut chip = [0.0; LANES];
        for l in 0..LANES {
            chip[l] = law.advance[tool][l] + into[l] - law.overlap[l] * met[l];
            left[l] = into[l] - chip[l].min(0.0);
        }
        if self.bent {
            for l in 0..LANES {
                bend[l] = chip[l].max(1e-12).powf(law.bend[l]);
            }
        }
        let mut body = [0.0; LANES];
        for l in 0..LANES {
            let plain = law.chip[tool][l] * chip[l] * bend[l] * (1.0 + self.noise[tool][l]);
            let rubbing = law.flank[0][l] * (speed[l] - law.flank[1][l]).max(0.0);
            let flank = multiply_add::<FUSED>(law.damping[l], speed[l], rubbing);
            body[l] = plain + law.edge[l] + multiply_add::<FUSED>(law.contact[l], into[l], flank);
        }
        if let Some(turning) = &self.turning {
            let [added_m, factor] = &turning[place];
            for l in 0..LANES {
                body[l] *= (1.0 + added_m[l] * law.width_1_m[l]).max(0.0) * factor[l];
            }
        }
        for l in 0..LANES {
            force[l] = if chip[l] > 0.0 { body[l].max(0.0) } else { 0.0 };
        }
        (force, left)
    }

    /// One step: forces of now, surfaces of now, and the motion to the next.
    #[inline(always)]
    fn step<const FUSED: bool>(&mut self, met: &[Lane; 2], places: [usize; 2]) -> [Lane; 2] {
        self.draw();
        let edges = self.edges();
        let (first, left_1) = self.cut::<FUSED>(0, &edges[0], &met[0], places[0]);
        let (second, left_2) = self.cut::<FUSED>(1, &edges[1], &met[1], places[1]);
        for led in &mut self.driving {
            led[2] = led[1];
            led[1] = led[0];
        }
        let says = [first, second.map(|f| self.second * f)];
        for (tool, says) in says.iter().enumerate() {
            for l in 0..LANES {
                let [left, then, now] = [0, 1, 2].map(|k| self.law.lagged[k][l]);
                let taken = multiply_add::<FUSED>(then, self.said[tool][l], now * says[l]);
                self.force[tool][l] = multiply_add::<FUSED>(left, self.force[tool][l], taken);
                self.said[tool][l] = says[l];
            }
        }
        for l in 0..LANES {
            self.driving[0][0][l] = self.force[1][l] - self.force[0][l];
            self.driving[1][0][l] = -self.force[1][l];
        }
        for k in 0..4 {
            if self.there[k] {
                self.modes[k].advance::<FUSED>(&self.driving[usize::from(k == 3)]);
            }
        }
        [left_1, left_2]
    }
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
        let mut out = vec![FreeRun::default(); LANES];
        for run in &mut out {
            run.force_n.iter_mut().chain([&mut run.bar_m]).for_each(|x| x.reserve(samples));
        }
        // What was left before the trial is what the quiet cut leaves.
        let edges = lanes.edges();
        let room = ((course.longest().ceil() as usize + 3) * steps).next_power_of_two();
        let mut surface = vec![[edges[0][0], edges[1][0]]; room];
        let one = course.since[1].is_empty();
        let mut now = 0;
        for k in 0..samples {
            if k % trial.held == 0 {
                lanes.take_on(k / trial.held);
            }
            let next = (k + 1).min(samples - 1);
            for (l, run) in out.iter_mut().enumerate() {
                run.force_n[0].push(lanes.force[0][l]);
                run.force_n[1].push(lanes.force[1][l]);
                run.bar_m.push(lanes.modes[..3].iter().map(|m| m.at[l]).sum());
            }
            let shift = trial.pitch_difference_rad.get(k).copied().unwrap_or(0.0) / 2.0;
            for step in 0..steps {
                let share = step as f64 / steps as f64;
                let mut met = [[0.0; LANES]; 2];
                let mut places = [0; 2];
                let turned = trial.turned_rad[k] + share * (trial.turned_rad[next] - trial.turned_rad[k]);
                for tool in 0..2 - usize::from(one) {
                    let since = &course.since[tool];
                    let back = (since[k] + share * (since[next] - since[k])) * steps as f64;
                    let whole = back.ceil();
                    let part = whole - back;
                    let older = (now + room - whole as usize) & (room - 1);
                    let other = if one { 0 } else { 1 - tool };
                    let (a, b) = (&surface[older][other], &surface[(older + 1) & (room - 1)][other]);
                    for l in 0..LANES {
                        met[tool][l] = multiply_add::<FUSED>(part, b[l] - a[l], a[l]);
                    }
                    let turns = (turned - if tool == 0 { shift } else { 0.5 * TAU }) / TAU;
                    places[tool] = ((turns - turns.floor()) * PLACES as f64) as usize & (PLACES - 1);
                }
                surface[now & (room - 1)] = lanes.step::<FUSED>(&met, places);
                now = (now + 1) & (room - 1);
            }
        }
        out
    }
}
