//! The drive as a subject of the selection: screening on the grid, refinement by Gauss-Newton, the statistic.

use super::bank::{PIECES, candidates};
use super::columns::TimeColumn;
use super::criteria::Criteria;
use super::evidence::{Asked, ask, level, statistic};
use super::gram::Part;
use super::likelihood::FREE;
use super::shape::{Hypothesis, Shape};
use super::state::{Accepted, Balance, State, is_of_path};
use crate::diagnosis::selection::{Fitted, Screened, Subject, Work};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::effects::{EffectKind, Port};
use std::sync::Mutex;

/// A relative step over which a law is differentiated by a constant.
const DIFFERENCE: f64 = 1e-3;
/// Largest step of a constant, as a logarithm, and how often it is halved.
const LONGEST_STEP: f64 = 0.5;
const HALVINGS: usize = 4;
/// Gauss-Newton steps at most.
const STEPS: usize = 8;
/// Passes in which numbers and shapes follow one another after something was taken up.
const PASSES: usize = 4;
/// A constant within this share of its bound is at it.
const NEAR_BOUND: f64 = 0.02;

/// One axis.
pub(super) struct Drive<'a> {
    pub(super) balance: &'a Balance,
    /// Largest score of the knockoffs in the last screening, nats.
    chance: Mutex<f64>,
}

impl<'a> Drive<'a> {
    pub(super) fn new(balance: &'a Balance) -> Self {
        Self { balance, chance: Mutex::new(0.0) }
    }

    fn chance_nats(&self) -> f64 {
        self.chance.lock().map_or(f64::INFINITY, |c| *c)
    }

    /// Refines the constants of a hypothesis beside a state.
    fn refined(&self, state: &State, start: &Hypothesis, work: &mut Work) -> Option<(Hypothesis, Asked)> {
        let mut h = *start;
        let mut asked = work.take(1).then(|| ask(self.balance, state, &h, false))?;
        let torsion = matches!(h.shape, Shape::Torsion { .. });
        if asked.score < 0.0 && !torsion {
            return Some((h, asked));
        }
        if let Shape::Map { flips, .. } = h.shape {
            for pieces in &PIECES[1..] {
                let finer = Hypothesis { shape: Shape::Map { pieces: *pieces, flips }, ..h };
                if !work.take(u64::try_from(*pieces).unwrap_or(1) / 8) {
                    break;
                }
                let other = ask(self.balance, state, &finer, false);
                if other.score > asked.score {
                    (h, asked) = (finer, other);
                }
            }
            return Some((h, asked));
        }
        if let Shape::Cut { .. } = h.shape {
            (h, asked) = self.edges(state, h, asked, work);
        }
        if let Shape::Torsion { .. } = h.shape {
            (h, asked) = self.splits(state, h, asked, work);
        }
        // Laws that are made of the numbers follow them as they move beside the law.
        let mut state = state.clone();
        for _ in 0..STEPS {
            let count = h.constants().len();
            if count == 0 || !work.take(2 + count as u64) {
                break;
            }
            state = state.with_numbers(&asked.fit.beta);
            let again = ask(self.balance, &state, &h, false);
            if again.score > asked.score {
                asked = again;
            }
            let Some(mut step) = self.shape_step(&state, &h, &asked) else { break };
            let before = asked.score;
            let mut moved = false;
            for _ in 0..HALVINGS {
                let values: Vec<f64> = h
                    .constants()
                    .iter()
                    .zip(&step)
                    .map(|(c, s)| (c.value * s.exp()).clamp(c.bounds[0], c.bounds[1]))
                    .collect();
                let next = h.with(&values);
                if !work.take(1) {
                    break;
                }
                let other = ask(self.balance, &state, &next, false);
                if other.score > asked.score {
                    (h, asked, moved) = (next, other, true);
                    break;
                }
                step.iter_mut().for_each(|s| *s *= 0.4);
            }
            if !moved || asked.score - before < Criteria::STANDARD.converged_nats {
                break;
            }
        }
        Some((h, asked))
    }

    /// How a third inertia may be split off: its frequency and its share trade along a valley with two ends.
    fn splits(
        &self,
        state: &State,
        mut h: Hypothesis,
        mut asked: Asked,
        work: &mut Work,
    ) -> (Hypothesis, Asked) {
        let Shape::Torsion { frequency_hz, .. } = h.shape else { return (h, asked) };
        for share in [0.2, 0.35, 0.5] {
            for factor in [0.85, 0.92, 1.0, 1.08] {
                let shape = Shape::Torsion { frequency_hz: factor * frequency_hz, share, damping: 0.02 };
                if !work.take(3) {
                    return (h, asked);
                }
                let next = Hypothesis { shape, ..h };
                // The numbers move beside it before it is judged.
                let mut beside = state.clone();
                let mut other = ask(self.balance, &beside, &next, false);
                for _ in 0..2 {
                    beside = beside.with_numbers(&other.fit.beta);
                    other = ask(self.balance, &beside, &next, false);
                }
                if other.score > asked.score {
                    (h, asked) = (next, other);
                }
            }
        }
        (h, asked)
    }

    /// Begin and end of a cut by halving steps.
    fn edges(
        &self,
        state: &State,
        mut h: Hypothesis,
        mut asked: Asked,
        work: &mut Work,
    ) -> (Hypothesis, Asked) {
        for by in [0.1, 0.04, 0.015] {
            for which in [0, 1] {
                for sign in [-1.0, 1.0] {
                    let Shape::Cut { hz, start_s, end_s } = h.shape else { continue };
                    let mut ends = [start_s, end_s];
                    ends[which] += sign * by;
                    if ends[1] - ends[0] < 0.1 || !work.take(1) {
                        continue;
                    }
                    let shape = Shape::Cut { hz, start_s: ends[0], end_s: ends[1] };
                    let next = Hypothesis { shape, ..h };
                    let other = ask(self.balance, state, &next, false);
                    if other.score > asked.score {
                        (h, asked) = (next, other);
                    }
                }
            }
        }
        (h, asked)
    }

    /// What a free function of the speed explains where a map over position is asked about, nats: in
    /// strokes that repeat, speed is a function of position, and nothing tells which of the two it is.
    fn as_of_speed(&self, state: &State, flips: bool, work: &mut Work) -> f64 {
        if !work.take(1) {
            return 0.0;
        }
        let shape = Shape::SpeedMap { pieces: PIECES[0], flips };
        let h = Hypothesis::named(EffectKind::PositionDependentForce, Port::Stage, shape);
        ask(self.balance, state, &h, false).score.max(0.0)
    }

    /// A Gauss-Newton step of the logarithms of the constants.
    fn shape_step(&self, state: &State, h: &Hypothesis, asked: &Asked) -> Option<Vec<f64>> {
        let amplitudes = asked.amplitudes().to_vec();
        let slopes = slopes(self.balance, state, h, &amplitudes);
        let count = slopes.len();
        let old = asked.gram.len();
        let plan = &self.balance.plan;
        let columns = slopes.iter().map(|s| self.balance.column(s)).collect();
        let gram = asked.gram.with(plan, columns);
        let bands = gram.sum(plan, Part::All);
        let mut design = asked.design.clone();
        design.columns.extend(old..old + count);
        design.bounds.extend(vec![FREE; count]);
        let mut start = asked.fit.beta.clone();
        start.extend(vec![0.0; count]);
        let weights = design.weights(&bands, &start);
        let fit = design.fit(&bands, start, weights);
        let from = fit.beta.len() - count;
        let step: Vec<f64> = fit.beta[from..].iter().map(|s| s.clamp(-LONGEST_STEP, LONGEST_STEP)).collect();
        step.iter().all(|s| s.is_finite()).then_some(step)
    }

    /// Path, shapes and numbers follow one another until they stand.
    fn settled(&self, mut state: State, work: &mut Work) -> State {
        for _ in 0..PASSES {
            state = state.rebuilt(self.balance);
            for a in &mut state.accepted {
                if let Shape::EncoderError { sine_m, cosine_m, .. } = &mut a.hypothesis.shape
                    && a.given.is_none()
                {
                    (*sine_m, *cosine_m) = (a.amplitudes[0], a.amplitudes[1]);
                }
            }
            for k in 0..state.accepted.len() {
                let a = state.accepted[k].clone();
                if a.hypothesis.constants().is_empty() || a.is_one_column() {
                    continue;
                }
                let count = a.hypothesis.constants().len() as u64;
                if !work.take(1 + count) {
                    return state;
                }
                let values = self.stepped(&state, k);
                if let Some(values) = values {
                    state.accepted[k].hypothesis = a.hypothesis.with(&values);
                }
            }
            state = self.path_settled(state, work);
        }
        state.rebuilt(self.balance)
    }

    /// One Gauss-Newton step of an accepted law.
    fn stepped(&self, state: &State, k: usize) -> Option<Vec<f64>> {
        let base = &state.base;
        let asked = Asked {
            gram: base.gram.clone(),
            design: base.design.clone(),
            fit: base.fit.clone(),
            score: 0.0,
            chance: 0.0,
            first: 0,
        };
        let a = &state.accepted[k];
        let slopes = slopes(self.balance, state, &a.hypothesis, &a.amplitudes);
        let step = self.free_step(&asked, &slopes)?;
        let moved = |(c, s): (&super::shape::Constant, &f64)| {
            (c.value * s.clamp(-0.1, 0.1).exp()).clamp(c.bounds[0], c.bounds[1])
        };
        Some(a.hypothesis.constants().iter().zip(&step).map(moved).collect())
    }

    /// Coefficients of further columns beside a fit.
    fn free_step(&self, asked: &Asked, columns: &[TimeColumn]) -> Option<Vec<f64>> {
        let plan = &self.balance.plan;
        let (old, count) = (asked.gram.len(), columns.len());
        let gram = asked.gram.with(plan, columns.iter().map(|c| self.balance.column(c)).collect());
        let bands = gram.sum(plan, Part::All);
        let mut design = asked.design.clone();
        design.columns.extend(old..old + count);
        design.bounds.extend(vec![FREE; count]);
        let mut start = asked.fit.beta.clone();
        start.extend(vec![0.0; count]);
        let weights = design.weights(&bands, &start);
        let fit = design.fit(&bands, start, weights);
        let step = fit.beta[fit.beta.len() - count..].to_vec();
        step.iter().all(|s| s.is_finite()).then_some(step)
    }

    /// Delay and bandwidth that were found, moved to where the balance has them.
    fn path_settled(&self, mut state: State, work: &mut Work) -> State {
        let [delay, bandwidth] = state.found_path();
        if !(delay || bandwidth) || !work.take(2) {
            return state;
        }
        let by_s = 0.05 / self.balance.signals.rate_hz;
        let mut asked = Vec::new();
        if delay {
            asked.push(Shape::Delay { extra_s: by_s, early: false });
        }
        if let Some(w) = state.path.loop_rad_s.filter(|_| bandwidth) {
            asked.push(Shape::Loop { rad_s: 0.98 * w });
        }
        let ground = state.ground(self.balance);
        let columns: Vec<TimeColumn> = asked
            .iter()
            .flat_map(|shape| ground.columns(&Hypothesis::named(EffectKind::DeadTime, Port::Current, *shape)))
            .collect();
        let beside = Asked {
            gram: state.base.gram.clone(),
            design: state.base.design.clone(),
            fit: state.base.fit.clone(),
            score: 0.0,
            chance: 0.0,
            first: 0,
        };
        if let Some(step) = self.free_step(&beside, &columns) {
            for (shape, s) in asked.iter().zip(step) {
                match shape {
                    Shape::Loop { .. } => {
                        let factor = 0.98_f64.powf(s.clamp(-8.0, 8.0));
                        state.path.loop_rad_s = state.path.loop_rad_s.map(|w| w * factor);
                    }
                    _ => state.path.delay_s += (s.clamp(-8.0, 8.0)) * by_s,
                }
            }
        }
        state
    }
}

/// Derivatives of a law by the logarithms of its constants, its amplitudes given.
pub(super) fn slopes(
    balance: &Balance,
    state: &State,
    h: &Hypothesis,
    amplitudes: &[f64],
) -> Vec<TimeColumn> {
    let ground = state.ground(balance);
    let values: Vec<f64> = h.constants().iter().map(|c| c.value).collect();
    let here = ground.columns(h);
    (0..values.len())
        .map(|k| {
            let mut moved = values.clone();
            moved[k] *= 1.0 + DIFFERENCE;
            let there = ground.columns(&h.with(&moved));
            let mut out = TimeColumn::default();
            for side in 0..2 {
                for ((a, b), amplitude) in here.iter().zip(&there).zip(amplitudes) {
                    let (Some(a), Some(b)) = (&a.sides[side], &b.sides[side]) else { continue };
                    let factor = amplitude / DIFFERENCE;
                    let sum =
                        out.sides[side].get_or_insert_with(|| a.iter().map(|x| vec![0.0; x.len()]).collect());
                    for ((s, a), b) in sum.iter_mut().zip(a).zip(b) {
                        s.iter_mut().zip(a).zip(b).for_each(|((s, a), b)| *s += factor * (b - a));
                    }
                }
            }
            out
        })
        .collect()
}

impl Subject for Drive<'_> {
    type Model = State;
    type Hypothesis = Hypothesis;

    fn name(&self, hypothesis: &Hypothesis) -> (EffectKind, Port) {
        (hypothesis.effect, hypothesis.port)
    }

    fn screen(&self, state: &State, work: &mut Work) -> Option<Vec<Screened<Hypothesis>>> {
        let list = candidates(self.balance, state);
        if !work.take(list.len() as u64) {
            return None;
        }
        let asked = on_two_cores(&list, |h| {
            let asked = ask(self.balance, state, h, true);
            (asked.score, asked.chance)
        });
        if let Ok(mut chance) = self.chance.lock() {
            *chance = asked.iter().map(|a| a.1).fold(0.0, f64::max);
        }
        let screened = list.iter().zip(asked);
        Some(screened.map(|(h, a)| Screened { hypothesis: *h, promise_nats: a.0 }).collect())
    }

    fn fit(&self, state: &State, h: &Hypothesis, work: &mut Work) -> Option<Fitted<Hypothesis, State>> {
        let (h, asked) = self.refined(state, h, work)?;
        let parts = state.base.held_out.len() as u64;
        if !work.take(parts / 2) {
            return None;
        }
        let mut evidence_nats = statistic(self.balance, state, &h, &asked);
        let mut amplitudes = asked.amplitudes().to_vec();
        if let Shape::Map { flips, .. } = h.shape {
            evidence_nats -= self.as_of_speed(state, flips, work);
            if flips {
                // Its mean is dry friction, which the numbers hold.
                let mean = amplitudes.iter().sum::<f64>() / amplitudes.len().max(1) as f64;
                amplitudes.iter_mut().for_each(|a| *a -= mean);
            }
        }
        let near = |c: &super::shape::Constant| {
            c.value < c.bounds[0] * (1.0 + NEAR_BOUND) || c.value > c.bounds[1] * (1.0 - NEAR_BOUND)
        };
        let at_bound =
            asked.held() && !matches!(h.shape, Shape::Torsion { .. }) || h.constants().iter().any(near);
        let mut model = state.with_numbers(&asked.fit.beta);
        model.take_up(self.balance, Accepted::found(h, amplitudes));
        Some(Fitted { hypothesis: h, model, evidence_nats, level_nats: level(self.chance_nats()), at_bound })
    }

    fn settle(&self, state: State, work: &mut Work) -> State {
        self.settled(state, work)
    }
}

impl State {
    /// Puts a law into the state; what is of the path or a number moves that instead.
    fn take_up(&mut self, balance: &Balance, law: Accepted) {
        let h = law.hypothesis;
        match h.shape {
            Shape::Delay { extra_s, early } => {
                self.path.delay_s += if early { -extra_s } else { extra_s };
                self.found_delay = true;
                self.timing_s = Criteria::STANDARD.timing_usual / balance.signals.rate_hz;
            }
            Shape::Loop { rad_s } => {
                self.path.loop_rad_s = Some(rad_s);
                self.found_loop = true;
            }
            Shape::Smoothing { speed_m_s } => {
                self.smoothing_m_s = speed_m_s;
                self.found_smoothing = true;
            }
            _ => self.accepted.push(law),
        }
        debug_assert!(!is_of_path(&h) || self.found_delay || self.found_loop);
    }

    /// Whether delay and bandwidth were found.
    pub(super) fn found_path(&self) -> [bool; 2] {
        [self.found_delay, self.found_loop]
    }
}
