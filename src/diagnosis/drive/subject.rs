//! The drive as a subject of the selection: screening on the grid, refinement by Gauss-Newton, the statistic.

use super::bank::candidates;
use super::columns::{DIFFERENCE, TimeColumn};
use super::criteria::Criteria;
use super::evidence::{Asked, ask, level, price, statistic};
use super::gram::{Gram, Part};
use super::laws::position_dependent_force::{Map, Over};
use super::laws::{Constant, Hypothesis, Shape};
use super::likelihood::{Design, FREE, values};
use super::state::{Accepted, Balance, State};
use crate::diagnosis::selection::{Fitted, Screened, Subject, Work};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::effects::Port;
use std::sync::Mutex;

/// Largest step of a constant, as a logarithm, and how often it is halved.
const LONGEST_STEP: f64 = 0.5;
const HALVINGS: usize = 4;
/// Gauss-Newton steps at most.
const STEPS: usize = 8;
/// Passes in which numbers and shapes follow one another after something was taken up.
pub(super) const PASSES: usize = 6;

/// One axis.
pub(super) struct Drive<'a> {
    pub(super) balance: &'a Balance,
    /// Of the last screening: hypotheses that were asked, largest score of the knockoffs, nats.
    screening: Mutex<(usize, f64)>,
}

impl<'a> Drive<'a> {
    pub(super) fn new(balance: &'a Balance) -> Self {
        Self::beside_chance(balance, 0.0)
    }

    /// With what chance has reached already.
    pub(super) fn beside_chance(balance: &'a Balance, chance_nats: f64) -> Self {
        Self { balance, screening: Mutex::new((1, chance_nats)) }
    }

    /// What a finding beside a state must exceed, nats.
    fn level(&self, state: &State) -> f64 {
        self.screening.lock().map_or(f64::INFINITY, |s| level(state, *s))
    }

    /// Refines the constants of a hypothesis beside a state.
    fn refined(&self, state: &State, start: &Hypothesis, work: &mut Work) -> Option<(Hypothesis, Asked)> {
        let mut h = *start;
        let mut asked = work.take(1).then(|| ask(self.balance, state, &h, false))?;
        // On the grid the amplitude made up for a shape of another size.
        if asked.score < 0.0 && !h.has_dose() {
            return Some((h, asked));
        }
        if let Shape::Map(map) = h.shape {
            return Some(self.finest(state, (h, map), asked, work));
        }
        (h, asked) = self.best_start(state, h, asked, work);
        (h, asked) = self.shortest_period(state, h, asked, work);
        if h.window_s().is_some() {
            (h, asked) = self.edges(state, h, asked, work);
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
        Some(self.better_form(&state, h, asked, work))
    }

    /// A map of as many pieces as score best.
    fn finest(
        &self,
        state: &State,
        (mut h, map): (Hypothesis, Map),
        mut asked: Asked,
        work: &mut Work,
    ) -> (Hypothesis, Asked) {
        for finer in map.finer() {
            if !work.take(u64::try_from(finer.pieces).unwrap_or(1) / 8) {
                break;
            }
            let other = h.by(finer.into());
            let of_other = ask(self.balance, state, &other, false);
            if of_other.score > asked.score {
                (h, asked) = (other, of_other);
            }
        }
        (h, asked)
    }

    /// Of two forms with the same constants the better one.
    fn better_form(
        &self,
        state: &State,
        h: Hypothesis,
        asked: Asked,
        work: &mut Work,
    ) -> (Hypothesis, Asked) {
        if let Some(twin) = h.law().twin().filter(|_| self.balance.signals.sides() == 2)
            && work.take(1)
        {
            let other = h.by(twin);
            let of_other = ask(self.balance, state, &other, false);
            if of_other.score > asked.score {
                return (other, of_other);
            }
        }
        (h, asked)
    }

    /// The best of several starts, the numbers moved beside each before it is judged.
    fn best_start(
        &self,
        state: &State,
        mut h: Hypothesis,
        mut asked: Asked,
        work: &mut Work,
    ) -> (Hypothesis, Asked) {
        for shape in h.law().starts(self.balance) {
            if !work.take(3) {
                break;
            }
            let next = h.by(shape);
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
        (h, asked)
    }

    /// What repeats after a period does so after two of them: the longer one must earn the price of its
    /// further harmonics.
    fn shortest_period(
        &self,
        state: &State,
        mut h: Hypothesis,
        mut asked: Asked,
        work: &mut Work,
    ) -> (Hypothesis, Asked) {
        let harmonic = price(2, values(&asked.gram.sum(&self.balance.plan, Part::All)));
        for part in [2.0, 2.0, 3.0] {
            let Some(shape) = h.law().repeated(part) else { return (h, asked) };
            if !work.take(1) {
                break;
            }
            let next = h.by(shape);
            let other = ask(self.balance, state, &next, false);
            if other.score > asked.score - harmonic {
                (h, asked) = (next, other);
            }
        }
        (h, asked)
    }

    /// Begin and end of a cut: steps that grow while they gain, then finer ones.
    fn edges(
        &self,
        state: &State,
        mut h: Hypothesis,
        mut asked: Asked,
        work: &mut Work,
    ) -> (Hypothesis, Asked) {
        let last_s = self.balance.signals.longest_s();
        let inside = |s: f64| s > 0.0 && s < last_s;
        let Some(given) = h.window_s() else { return (h, asked) };
        let steps = [0.3, 0.1, 0.04, 0.015].into_iter().flat_map(|by| [(by, 0), (by, 1)]);
        for (by, which) in steps.filter(|(_, which)| inside(given[*which])) {
            for sign in [-1.0, 1.0] {
                let mut step = sign * by;
                while let Some(mut ends) = h.window_s() {
                    ends[which] += step;
                    if ends[1] - ends[0] < 0.1 || !inside(ends[which]) || !work.take(1) {
                        break;
                    }
                    let next = h.within(ends);
                    let other = ask(self.balance, state, &next, false);
                    if other.score <= asked.score {
                        break;
                    }
                    (h, asked, step) = (next, other, 1.5 * step);
                }
            }
        }
        // A cut that ends inside of the recording has a number more.
        let price = price(1, values(&asked.gram.sum(&self.balance.plan, Part::All)));
        for (which, end_s) in [(0, 0.0), (1, last_s)] {
            let Some(mut ends) = h.window_s() else { break };
            if inside(std::mem::replace(&mut ends[which], end_s)) && work.take(1) {
                let next = h.within(ends);
                let other = ask(self.balance, state, &next, false);
                if other.score > asked.score - price {
                    (h, asked) = (next, other);
                }
            }
        }
        (h, asked)
    }

    /// Most that a free function of the motion explains where there is one position, nats: no model states
    /// how friction grows with speed, and a law that explains less than one of them stands in for it.
    ///
    /// Of two positions a function of the speed is a damper without a Jacobian, and sweeps tell it apart.
    fn without_name(&self, state: &State, h: &Hypothesis, work: &mut Work) -> f64 {
        let others = if self.balance.signals.sides() == 2 { &[] } else { h.law().rivals() };
        let mut most = 0.0_f64;
        for &(over, flips) in others {
            let h = Map::free(over, flips);
            most = self.refined(state, &h, work).map_or(most, |(_, asked)| most.max(asked.score));
        }
        most
    }

    /// A state with free functions of the speed and of the way since the axis turned round, where a map over
    /// position is asked about: in strokes that repeat all three are functions of position, and a map is told
    /// by what it explains beside the others.
    fn beside_motion(&self, state: &State, flips: bool, work: &mut Work) -> State {
        let mut beside = state.clone();
        for (over, flips) in [(Over::Way, true), (Over::Way, false), (Over::Speed, flips)] {
            let h = Map::free(over, flips);
            if !work.take(2) {
                break;
            }
            let asked = ask(self.balance, &beside, &h, false);
            if asked.score > 0.0 {
                let amplitudes = asked.amplitudes().to_vec();
                beside = beside.with_numbers(&asked.fit.beta);
                beside.take_up(self.balance, Accepted::found(h, amplitudes));
                beside = beside.rebuilt(self.balance);
            }
        }
        beside
    }

    /// A Gauss-Newton step of the logarithms of the constants.
    fn shape_step(&self, state: &State, h: &Hypothesis, asked: &Asked) -> Option<Vec<f64>> {
        let slopes = slopes(self.balance, state, h, asked.amplitudes());
        let step = self.free_step((&asked.gram, &asked.design, &asked.fit.beta), &slopes)?;
        Some(step.iter().map(|s| s.clamp(-LONGEST_STEP, LONGEST_STEP)).collect())
    }

    /// Shapes and numbers follow one another until they stand; a step that loses is taken shorter.
    pub(super) fn settled(&self, state: State, passes: usize, work: &mut Work) -> State {
        let mut best = state.rebuilt(self.balance);
        let mut share = 1.0;
        for _ in 0..passes {
            let Some(next) = self.moved(best.clone(), share, work) else { break };
            let next = next.rebuilt(self.balance);
            let gained = best.base.fit.nats - next.base.fit.nats;
            if gained > 0.0 {
                best = next;
            } else {
                share *= 0.2;
            }
            if gained.abs() < Criteria::STANDARD.converged_nats {
                break;
            }
        }
        best
    }

    /// What was taken up before its cause was known may have stood in for it: laws that the others do without
    /// are dropped.
    fn without_stand_ins(&self, mut state: State, work: &mut Work) -> State {
        let total = values(&state.base.all);
        let level = self.level(&state);
        let mut k = 0;
        // The newest was just asked about, beside all of these.
        while k + 1 < state.accepted.len() {
            let law = &state.accepted[k];
            if law.given.is_some() || !work.take(2 * (1 + law.coefficients() as u64)) {
                k += 1;
                continue;
            }
            let cost = price(law.coefficients() + law.hypothesis.constants().len(), total);
            let mut others = state.clone();
            others.accepted.remove(k);
            let others = self.settled(others, PASSES / 2, work);
            if others.base.fit.nats - state.base.fit.nats - cost < level {
                (state, k) = (others, 0);
            } else {
                k += 1;
            }
        }
        state
    }

    /// One step of every shape. `None`: the budget is spent.
    fn moved(&self, mut state: State, share: f64, work: &mut Work) -> Option<State> {
        for a in state.accepted.iter_mut().filter(|a| a.given.is_none()) {
            a.hypothesis.law_mut().follow(&a.amplitudes);
        }
        for k in 0..state.accepted.len() {
            let a = state.accepted[k].clone();
            if a.hypothesis.constants().is_empty() || a.is_one_column() {
                continue;
            }
            let count = a.hypothesis.constants().len() as u64;
            if !work.take(1 + count) {
                return None;
            }
            let values = self.stepped(&state, k, share);
            if let Some(values) = values {
                state.accepted[k].hypothesis = a.hypothesis.with(&values);
            }
        }
        Some(state)
    }

    /// One Gauss-Newton step of an accepted law.
    fn stepped(&self, state: &State, k: usize, share: f64) -> Option<Vec<f64>> {
        let (base, a) = (&state.base, &state.accepted[k]);
        let slopes = slopes(self.balance, state, &a.hypothesis, &a.amplitudes);
        let step = self.free_step((&base.gram, &base.design, &base.fit.beta), &slopes)?;
        let moved = |(c, s): (&Constant, &f64)| {
            (c.value * (share * s.clamp(-0.1, 0.1)).exp()).clamp(c.bounds[0], c.bounds[1])
        };
        Some(a.hypothesis.constants().iter().zip(&step).map(moved).collect())
    }

    /// Coefficients of further columns beside a fit.
    fn free_step(
        &self,
        (gram, design, beta): (&Gram, &Design, &[f64]),
        columns: &[TimeColumn],
    ) -> Option<Vec<f64>> {
        let plan = &self.balance.plan;
        let (old, count) = (gram.len(), columns.len());
        let gram = gram.with(plan, columns.iter().map(|c| self.balance.column(c)).collect());
        let bands = gram.sum(plan, Part::All);
        let mut design = design.clone();
        design.add(&gram, old..old + count, vec![FREE; count]);
        let start: Vec<f64> = beta.iter().copied().chain(vec![0.0; count]).collect();
        let weights = design.weights(&bands, &start);
        let step = design.fit(&bands, start, weights).beta.split_off(beta.len());
        step.iter().all(|s| s.is_finite()).then_some(step)
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
    let here = h.columns(&ground);
    (0..values.len())
        .map(|k| {
            let mut moved = values.clone();
            moved[k] *= 1.0 + DIFFERENCE;
            let there = h.with(&moved).columns(&ground);
            let part = |amplitude: &f64| amplitude / DIFFERENCE;
            let of = |((a, b), amplitude)| [(a, -part(amplitude)), (b, part(amplitude))];
            TimeColumn::sum(here.iter().zip(&there).zip(amplitudes).flat_map(of))
        })
        .collect()
}

impl Subject for Drive<'_> {
    type Model = State;
    type Hypothesis = Hypothesis;

    fn name(&self, hypothesis: &Hypothesis) -> (&'static str, Port) {
        (hypothesis.effect.name(), hypothesis.port)
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
        if let Ok(mut screening) = self.screening.lock() {
            *screening = (list.len(), asked.iter().map(|a| a.1).fold(0.0, f64::max));
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
        let other = self.without_name(state, &h, work);
        evidence_nats = evidence_nats.min(asked.score - other);
        if let Shape::Map(Map { flips, .. }) = h.shape {
            let beside = self.beside_motion(state, flips, work);
            evidence_nats = evidence_nats.min(ask(self.balance, &beside, &h, false).score);
            if flips {
                // Its mean is dry friction, which the numbers hold.
                let mean = amplitudes.iter().sum::<f64>() / amplitudes.len().max(1) as f64;
                amplitudes.iter_mut().for_each(|a| *a -= mean);
            }
        }
        let mut model = state.with_numbers(&asked.fit.beta);
        let at_bound = asked.held() && !h.is_whole()
            || h.is_at_bound()
            || h.law().is_usual(self.balance, &state.standing(), &amplitudes)
            || h.law().is_void(&model.ground(self.balance));
        model.take_up(self.balance, Accepted::found(h, amplitudes));
        Some(Fitted { hypothesis: h, model, evidence_nats, level_nats: self.level(state), at_bound })
    }

    fn settle(&self, state: State, work: &mut Work) -> State {
        let state = self.settled(state, PASSES, work);
        let state = self.without_faults(state, work);
        self.without_stand_ins(state, work)
    }
}

impl State {
    /// Puts a law into the state; what is of the path or a number moves that instead.
    fn take_up(&mut self, balance: &Balance, law: Accepted) {
        let h = law.hypothesis;
        let mut now = self.standing();
        if h.law().move_number(&mut now, balance) {
            self.stand(now);
        } else {
            self.accepted.push(law);
        }
        debug_assert!(!h.facts().is_of_path || self.found_delay || self.found_loop);
    }
}
