//! The drive as a subject of the selection: screening on the grid, refinement by Gauss-Newton, the statistic.

use super::bank::candidates;
use super::columns::{DIFFERENCE, TimeColumn};
use super::evidence::{Asked, Wider, ask, ask_within, evaluations, level, price, statistic, wider};
use super::gram::Gram;
use super::laws::position_dependent_force::Map;
use super::laws::{Hypothesis, Shape};
use super::likelihood::{Design, FREE, values};
use super::state::{Accepted, Balance, State, stated_mechanics};
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::selection::{Fitted, Round, Screened, Subject, Work};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::effects::{EffectKind, Port};
use crate::signal::inner_products::dot;
use std::sync::Mutex;

/// Largest step of a constant, as a logarithm, and how often it is halved.
const LONGEST_STEP: f64 = 0.5;
const HALVINGS: usize = 4;
/// A step of all shapes that loses, taken shorter.
const SHORTER: f64 = 0.2;
/// Gauss-Newton steps of one law, and passes in which numbers and balance follow one another before anything
/// is asked; three times as many after something was taken up. At most.
pub(super) const PASSES: usize = 8;

/// One axis.
pub(super) struct Drive<'a> {
    pub(super) balance: &'a Balance,
    /// Of the last screening: hypotheses that were asked, largest score of the knockoffs, nats.
    screening: Mutex<(usize, f64)>,
    /// What moves a number, and is no law of the machine, alone is asked about.
    numbers_alone: bool,
}

impl<'a> Drive<'a> {
    pub(super) fn new(balance: &'a Balance) -> Self {
        Self::beside_chance(balance, 0.0)
    }

    /// With what chance has reached already.
    pub(super) fn beside_chance(balance: &'a Balance, chance_nats: f64) -> Self {
        Self { balance, screening: Mutex::new((1, chance_nats)), numbers_alone: false }
    }

    /// With what lies between command and thrust, and the speed over which friction turns, alone.
    pub(super) fn of_numbers(balance: &'a Balance) -> Self {
        Self { numbers_alone: true, ..Self::new(balance) }
    }

    /// What a finding beside a state must exceed, nats.
    fn level(&self, state: &State) -> f64 {
        self.screening.lock().map_or(f64::INFINITY, |s| level(state, *s))
    }

    /// Refines the constants of a hypothesis beside a state.
    fn refined(&self, state: &State, start: &Hypothesis, work: &mut Work) -> Option<(Hypothesis, Asked)> {
        let asked = ask_within(self.balance, state, start, work)?;
        let mut best = Best { balance: self.balance, state: state.clone(), h: *start, asked };
        // On the grid the amplitude made up for a shape of another size. Friction that takes the place of
        // another one begins behind what its forms over speed made up for.
        if best.asked.score < 0.0 && !start.has_dose() && !start.facts().replaces_friction {
            return Some((best.h, best.asked));
        }
        best.start(work);
        best.shortest_period(work);
        best.size(work);
        best.edges(work);
        // Laws that are made of the numbers follow them as they move beside the law.
        for _ in 0..PASSES {
            let count = best.h.constants();
            if count == 0 || !work.take(evaluations(count)) {
                break;
            }
            best.state = best.state.with_numbers(&best.asked.fit.beta);
            best.take(best.h, 0.0, work);
            let before = best.asked.score;
            let moved = self.shape_step(&best).is_some_and(|step| best.step(step, work));
            if !moved || best.asked.score - before < Criteria::STANDARD.converged_nats {
                break;
            }
        }
        best.better_form(work);
        Some((best.h, best.asked))
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

    /// A state with further laws, those that say anything.
    fn beside(&self, state: &State, laws: &[Hypothesis], work: &mut Work) -> State {
        let mut beside = state.clone();
        for h in laws {
            let Some(asked) = ask_within(self.balance, &beside, h, work) else { break };
            if asked.score > 0.0 {
                let amplitudes = asked.amplitudes().to_vec();
                beside = beside.with_numbers(&asked.fit.beta);
                beside.take_up(self.balance, Accepted::found(*h, amplitudes));
                beside = beside.rebuilt(self.balance);
            }
        }
        beside
    }

    /// A Gauss-Newton step of the logarithms of the constants. Where these are all of the size an amplitude
    /// made up for what the grid is off: the step is taken from one on. Not of one position, where a spring
    /// that nobody sees is later than the force, as what is asked here is.
    fn shape_step(&self, best: &Best<'_>) -> Option<Vec<f64>> {
        let Best { state, h, asked, .. } = best;
        let (mut design, mut beta) = (asked.design.clone(), asked.fit.beta.clone());
        if h.has_dose() && self.balance.signals.sides() == 2 {
            beta[asked.first] = 1.0;
            design.bounds[asked.first] = [1.0; 2];
        }
        let slopes = slopes(self.balance, state, h, &beta[asked.first..]);
        let step = self.free_step((&asked.gram, &design, &beta), &slopes)?;
        Some(step.iter().map(|s| s.clamp(-LONGEST_STEP, LONGEST_STEP)).collect())
    }

    /// Shapes and numbers follow one another until they stand; a step that loses is taken shorter.
    pub(super) fn settled(&self, state: State, passes: usize, work: &mut Work) -> State {
        let mut best = state.rebuilt(self.balance);
        let (mut share, mut lost) = (1.0, f64::NEG_INFINITY);
        for _ in 0..passes {
            let Some(next) = self.moved(best.clone(), share, work).filter(|_| work.take(1)) else { break };
            let next = next.rebuilt(self.balance);
            let gained = best.base.fit.nats - next.base.fit.nats;
            // Where a shorter step of the shapes changes nothing it is the numbers that lose.
            if gained.abs().min((gained - lost).abs()) < Criteria::STANDARD.converged_nats {
                break;
            }
            if gained > 0.0 {
                (best, share, lost) = (next, (share / SHORTER).min(1.0), f64::NEG_INFINITY);
            } else {
                (share, lost) = (share * SHORTER, gained);
            }
        }
        best
    }

    /// As settled from the numbers as they are or as stated, whichever is nearer: what was left out before
    /// may have bent them to where no step leads back.
    fn settled_from_both(&self, state: State, work: &mut Work) -> State {
        let mut stated = state.clone();
        stated.now.mechanics = stated_mechanics(self.balance);
        let settled = |state: &State, work: &mut Work| self.settled(state.clone(), 3 * PASSES, work);
        let starts = [state, stated];
        let both = work.on_two_cores(&starts, settled).into_iter();
        let nearer = both.min_by(|a, b| a.base.fit.nats.total_cmp(&b.base.fit.nats));
        let [own, _] = starts;
        nearer.unwrap_or(own)
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
            if law.given.is_some() || !work.take(1) {
                k += 1;
                continue;
            }
            let cost = price(law.amplitudes.len() + law.hypothesis.constants(), total);
            let mut others = state.clone();
            others.accepted.remove(k);
            let others = self.settled(others, PASSES, work);
            if others.base.fit.nats - state.base.fit.nats - cost < level {
                (state, k) = (others, 0);
            } else {
                k += 1;
            }
        }
        state
    }

    /// Another law in place of one that stands, and that one behind it: which of two was taken was told
    /// beside less than stands now. Asked are, of two positions, the next best of the round in which it was
    /// taken, which must say more by what a finding needs (of one, an axis without the law that bends its
    /// spring may be nothing at all); and in place of a force over position, which has the price of all its
    /// pieces, the waves, which must say more. `None`: none does, or the budget is spent.
    pub(super) fn exchanged(
        &self,
        state: &State,
        rounds: &[Round<Hypothesis, State>],
        work: &mut Work,
    ) -> Option<Vec<Fitted<Hypothesis, State>>> {
        for (k, law) in state.accepted.iter().enumerate().filter(|(_, law)| law.given.is_none()) {
            let is_map = law.hypothesis.is_map();
            let rival =
                next_best(state, rounds, law).filter(|_| !is_map && self.balance.signals.sides() == 2);
            if rival.is_none() && !is_map {
                continue;
            }
            let mut others = state.clone();
            others.accepted.remove(k);
            let others = self.settled(others, PASSES, work);
            let waves = if is_map { candidates(self.balance, &others) } else { Vec::new() };
            let waves = waves.into_iter().filter(|h| h.effect == EffectKind::PositionPeriodicForce);
            let asked: Vec<Hypothesis> = rival.into_iter().chain(waves).collect();
            let fitted = work.on_two_cores(&asked, |h, own| self.fit(&others, h, own));
            let fitted = fitted.into_iter().flatten().filter(Fitted::qualifies);
            let Some(best) = fitted.max_by(|a, b| a.evidence_nats.total_cmp(&b.evidence_nats)) else {
                continue;
            };
            let (model, gained) = self.settle(&others, best.model, work);
            let (more_nats, level_nats) = (model.gain_nats(state), best.level_nats);
            let comparable = model.now.inertial == state.now.inertial && gained > level_nats;
            if comparable && more_nats > if is_map { 0.0 } else { level_nats } {
                let evidence_nats = best.evidence_nats - more_nats;
                let before =
                    Fitted { hypothesis: law.hypothesis, model: state.clone(), evidence_nats, ..best };
                return Some(vec![Fitted { model, ..best }, before]);
            }
        }
        None
    }

    /// One step of every shape. `None`: the budget is spent.
    fn moved(&self, mut state: State, share: f64, work: &mut Work) -> Option<State> {
        for a in state.accepted.iter_mut().filter(|a| a.given.is_none()) {
            a.hypothesis.law_mut().follow(&a.amplitudes);
        }
        for k in 0..state.accepted.len() {
            let a = &state.accepted[k];
            if a.is_one_column() && a.given.is_none() {
                if !work.take(evaluations(a.amplitudes.len())) {
                    return None;
                }
                if let Some(amplitudes) = self.amplitudes_beside(&state, k, share) {
                    state.accepted[k].amplitudes = amplitudes;
                }
            }
            let a = &state.accepted[k];
            if a.hypothesis.constants() == 0 || a.is_one_column() {
                continue;
            }
            if !work.take(evaluations(a.hypothesis.constants())) {
                return None;
            }
            if let Some(moved) = self.stepped(&state, k, share) {
                state.accepted[k].hypothesis = moved;
            }
        }
        Some(state)
    }

    /// Amplitudes of a law that enters as one column, a share of the way to where they are free beside all.
    /// It was found beside less than stands now.
    fn amplitudes_beside(&self, state: &State, k: usize, share: f64) -> Option<Vec<f64>> {
        let (a, own) = (&state.accepted[k], state.place(k));
        let (gram, design, beta) = state.base.fitted();
        let mut design = design.clone();
        design.bounds[own] = [beta[own]; 2];
        let more =
            self.free_step((gram, &design, beta), &a.hypothesis.columns(&state.ground(self.balance)))?;
        let mut out: Vec<f64> = a.amplitudes.iter().zip(more).map(|(a, more)| a + share * more).collect();
        leave_mean(self.balance, state, &a.hypothesis, &mut out);
        Some(out)
    }

    /// One Gauss-Newton step of an accepted law.
    fn stepped(&self, state: &State, k: usize, share: f64) -> Option<Hypothesis> {
        let (base, a) = (&state.base, &state.accepted[k]);
        let slopes = slopes(self.balance, state, &a.hypothesis, &a.amplitudes);
        let step = self.free_step(base.fitted(), &slopes)?;
        let short: Vec<f64> = step.iter().map(|s| share * s.clamp(-LONGEST_STEP, LONGEST_STEP)).collect();
        Some(a.hypothesis.moved(&short))
    }

    /// Coefficients of further columns beside a fit.
    fn free_step(
        &self,
        (gram, design, beta): (&Gram, &Design, &[f64]),
        columns: &[TimeColumn],
    ) -> Option<Vec<f64>> {
        let free = vec![FREE; columns.len()];
        let Wider { bands, design, start, .. } = wider(self.balance, (gram, design, beta), (columns, free));
        let weights = design.weights(&bands, &start);
        let step = design.fit(&bands, start, weights).beta.split_off(beta.len());
        step.iter().all(|s| s.is_finite()).then_some(step)
    }
}

/// True for the round in which a law was taken up.
pub(super) fn takes(round: &Round<Hypothesis, State>, effect: EffectKind, port: Port) -> bool {
    let is_of = |h: &Hypothesis| h.effect == effect && h.port == port;
    round.accepted && round.fitted.first().is_some_and(|f| is_of(&f.hypothesis))
}

/// What came next to a law in the round in which that was taken, and has not been taken since.
fn next_best(state: &State, rounds: &[Round<Hypothesis, State>], law: &Accepted) -> Option<Hypothesis> {
    let name = |h: &Hypothesis| (h.effect, h.port);
    let stands = |h: &Hypothesis| {
        state.accepted.iter().any(|a| name(&a.hypothesis) == name(h))
            || rounds.iter().any(|r| takes(r, h.effect, h.port))
    };
    let round = rounds.iter().rev().find(|r| takes(r, law.hypothesis.effect, law.hypothesis.port))?;
    let open = |f: &&Fitted<Hypothesis, State>| f.qualifies() && !stands(&f.hypothesis);
    round.fitted[1..].iter().find(open).map(|f| f.hypothesis)
}

/// Takes off a map the mean that something else in the state is: dry friction of one with direction, a load.
fn leave_mean(balance: &Balance, state: &State, h: &Hypothesis, amplitudes: &mut [f64]) {
    let Shape::Map(map) = h.shape else { return };
    let is_load = |a: &Accepted| a.hypothesis.effect == EffectKind::GravityLoad;
    let mean = if map.flips {
        dot(amplitudes, &map.means(&balance.signals))
    } else if state.accepted.iter().any(is_load) {
        amplitudes.iter().sum::<f64>() / amplitudes.len().max(1) as f64
    } else {
        return;
    };
    amplitudes.iter_mut().for_each(|a| *a -= mean);
}

/// What scores best of all that was asked for one hypothesis.
struct Best<'a> {
    balance: &'a Balance,
    /// Beside what it is asked.
    state: State,
    h: Hypothesis,
    asked: Asked,
}

impl Best<'_> {
    /// Asks another form, which takes its place where it scores no worse than by `less_nats`; false where it
    /// does not, or the budget is spent.
    fn take(&mut self, other: Hypothesis, less_nats: f64, work: &mut Work) -> bool {
        let asked = ask_within(self.balance, &self.state, &other, work);
        let better = asked.filter(|asked| asked.score > self.asked.score - less_nats);
        let is_better = better.is_some();
        if let Some(asked) = better {
            (self.h, self.asked) = (other, asked);
        }
        is_better
    }

    /// Price of further constants, nats.
    fn price(&self, constants: usize) -> f64 {
        price(constants, values(&self.state.base.all))
    }

    /// A step of the logarithms of the constants, taken shorter until it gains.
    fn step(&mut self, mut step: Vec<f64>, work: &mut Work) -> bool {
        for _ in 0..HALVINGS {
            if self.take(self.h.moved(&step), 0.0, work) {
                return true;
            }
            step.iter_mut().for_each(|s| *s *= 0.4);
        }
        false
    }

    /// As many columns as score best.
    fn size(&mut self, work: &mut Work) {
        for shape in self.h.law().sizes(&self.balance.signals) {
            self.take(self.h.by(shape), 0.0, work);
        }
    }

    /// Of two forms with the same constants the better one.
    fn better_form(&mut self, work: &mut Work) {
        if let Some(twin) = self.h.law().twin().filter(|_| self.balance.signals.sides() == 2) {
            self.take(self.h.by(twin), 0.0, work);
        }
    }

    /// The best of several starts.
    fn start(&mut self, work: &mut Work) {
        for shape in self.h.law().starts(self.balance) {
            self.take(self.h.by(shape), 0.0, work);
        }
    }

    /// What repeats after a period does so after two of them: the longer one must earn the price of its
    /// further harmonics.
    fn shortest_period(&mut self, work: &mut Work) {
        let harmonic = self.price(2);
        for part in [2.0, 2.0, 3.0] {
            let Some(shape) = self.h.law().repeated(part, &self.balance.signals) else { return };
            self.take(self.h.by(shape), harmonic, work);
        }
    }

    /// Begins and ends of a cut in each recording: as in another one, then steps that grow while they gain,
    /// and finer ones.
    fn edges(&mut self, work: &mut Work) {
        let windows = self.h.windows_s().len().min(self.balance.signals.tracks.len());
        for (window, other) in (0..windows).flat_map(|k| (0..windows).map(move |other| (k, other))) {
            let all = self.h.windows_s();
            if all[window] != all[other] {
                self.take(self.h.within(window, all[other]), 0.0, work);
            }
        }
        (0..windows).for_each(|window| self.edges_of(window, work));
    }

    fn edges_of(&mut self, window: usize, work: &mut Work) {
        let ends_s = |best: &Self| best.h.windows_s()[window];
        let given = ends_s(self);
        let last_s = self.balance.signals.longest_s();
        let inside = |s: f64| s > 0.0 && s < last_s;
        let steps = [0.1, 0.04, 0.015].into_iter().flat_map(|by| [(by, 0), (by, 1)]);
        for (by, which) in steps.filter(|(_, which)| inside(given[*which])) {
            for sign in [-1.0, 1.0] {
                let mut step = sign * by;
                loop {
                    let mut ends = ends_s(self);
                    ends[which] += step;
                    let is_one = ends[1] - ends[0] >= 0.1 && inside(ends[which]);
                    if !is_one || !self.take(self.h.within(window, ends), 0.0, work) {
                        break;
                    }
                    step *= 1.5;
                }
            }
        }
        // A cut that ends inside of the recording has a number more.
        let price = self.price(1);
        for (which, end_s) in [(0, 0.0), (1, last_s)] {
            let mut ends = ends_s(self);
            if inside(std::mem::replace(&mut ends[which], end_s)) {
                self.take(self.h.within(window, ends), price, work);
            }
        }
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
    let here = h.columns(&ground);
    let slope = |k: usize| {
        let there = h.scaled(k, 1.0 + DIFFERENCE).columns(&ground);
        let part = |amplitude: &f64| amplitude / DIFFERENCE;
        let of = |((a, b), amplitude)| [(a, -part(amplitude)), (b, part(amplitude))];
        TimeColumn::sum(here.iter().zip(&there).zip(amplitudes).flat_map(of))
    };
    (0..h.constants()).map(slope).collect()
}

impl Subject for Drive<'_> {
    type Model = State;
    type Hypothesis = Hypothesis;

    fn name(&self, hypothesis: &Hypothesis) -> (&'static str, Port) {
        (hypothesis.effect.name(), hypothesis.port)
    }

    fn screen(&self, state: &State, work: &mut Work) -> Option<Vec<Screened<Hypothesis>>> {
        let mut list = candidates(self.balance, state);
        if self.numbers_alone {
            list.retain(|h| h.law().move_number(&mut state.now.clone(), self.balance));
        }
        if !work.take(list.len() as u64) {
            return None;
        }
        let asked = on_two_cores(&list, |h| {
            let asked = ask(self.balance, state, h, true);
            (asked.score, asked.chance, evaluations(asked.amplitudes().len()) - 1)
        });
        work.spend(asked.iter().map(|a| a.2).sum());
        if let Ok(mut screening) = self.screening.lock() {
            *screening = (list.len(), asked.iter().map(|a| a.1).fold(0.0, f64::max));
        }
        let screened = list.iter().zip(asked);
        Some(screened.map(|(h, a)| Screened { hypothesis: *h, promise_nats: a.0 }).collect())
    }

    fn fit(&self, state: &State, h: &Hypothesis, work: &mut Work) -> Option<Fitted<Hypothesis, State>> {
        let (h, asked) = self.refined(state, h, work)?;
        let parts = state.base.held_out_nats.len() as u64;
        if !work.take(parts / 2) {
            return None;
        }
        let mut evidence_nats = statistic(self.balance, state, &h, &asked);
        let mut amplitudes = asked.amplitudes().to_vec();
        let other = self.without_name(state, &h, work);
        evidence_nats = evidence_nats.min(asked.score - other);
        let others = h.law().told_beside(&self.balance.signals);
        if !others.is_empty() {
            let beside = self.beside(state, &others, work);
            evidence_nats = evidence_nats.min(ask_within(self.balance, &beside, &h, work)?.score);
        }
        leave_mean(self.balance, state, &h, &mut amplitudes);
        let mut model = state.with_numbers(&asked.fit.beta);
        let at_bound = asked.held() && !h.is_whole()
            || h.is_at_bound()
            || h.law().is_usual(&state.ground(self.balance), state.dry_n(), &amplitudes)
            || h.law().is_void(&model.ground(self.balance), &amplitudes);
        model.take_up(self.balance, Accepted::found(h, amplitudes));
        Some(Fitted { hypothesis: h, model, evidence_nats, level_nats: self.level(state), at_bound })
    }

    fn fit_each(
        &self,
        state: &State,
        hypotheses: &[Hypothesis],
        work: &mut Work,
        begins: &(dyn Fn(&Work, &str) + Sync),
    ) -> Vec<Fitted<Hypothesis, State>> {
        let at = work.clone();
        let fitted = work.on_two_cores(hypotheses, |h, own| {
            begins(&at, self.name(h).0);
            self.fit(state, h, own)
        });
        fitted.into_iter().flatten().collect()
    }

    /// A load and a friction that differs between the directions are one but where the axis turns round, a
    /// load and the mean of a cut but where that begins and ends. Where less than a finding needs tells them
    /// apart it is a load, which takes nothing else.
    fn compare(&self, _: &State, fitted: &mut [Fitted<Hypothesis, State>]) {
        let of = |effect: EffectKind| fitted.iter().position(|f| f.hypothesis.effect == effect);
        let Some(load) = of(EffectKind::GravityLoad).filter(|load| !fitted[*load].at_bound) else { return };
        let others = [of(EffectKind::AsymmetricFriction), of(EffectKind::CuttingForce)];
        let (load_nats, level_nats) = (fitted[load].evidence_nats, fitted[load].level_nats);
        for other in others.into_iter().flatten() {
            let other_nats = fitted[other].evidence_nats;
            if (0.0..level_nats).contains(&(other_nats - load_nats)) {
                fitted[load].evidence_nats = fitted[load].evidence_nats.max(other_nats);
                fitted[other].evidence_nats = load_nats;
            }
        }
    }

    fn settle(&self, before: &State, state: State, work: &mut Work) -> (State, f64) {
        let state = self.settled_from_both(state, work);
        let newest = state.accepted.last().filter(|_| state.accepted.len() > before.accepted.len());
        let ground = state.ground(self.balance);
        if newest.is_some_and(|a| a.hypothesis.law().is_void(&ground, &a.amplitudes)) {
            return (state, f64::NEG_INFINITY);
        }
        let gained = state.gain_nats(before);
        let state = state.with_told_inertia(self.balance, PASSES);
        let state = self.without_faults(state, work);
        (self.without_stand_ins(state, work), gained)
    }
}

impl State {
    /// Gain over another state, less the price of what this one has taken up more, nats.
    pub(super) fn gain_nats(&self, before: &Self) -> f64 {
        let constants =
            |s: &Self| s.accepted.iter().map(|a| a.amplitudes.len() + a.hypothesis.constants()).sum();
        let of = |s: &Self| s.base.fit.nats + price(constants(s), values(&s.base.all));
        of(before) - of(self)
    }

    /// Puts a law into the state; what is of the path or a number moves that instead.
    fn take_up(&mut self, balance: &Balance, law: Accepted) {
        if !law.hypothesis.law().move_number(&mut self.now, balance) {
            self.accepted.push(law);
        }
    }
}
