//! Forward selection: try every hypothesis, take the best, project it out, try again.

use super::bank;
use super::bench::{Accepted, Bench, Score, rms};
use super::floor::spectrum;
use super::loop_search::Told;
use super::problem::{Column, Mechanics, Problem, Proof, Sides};
use super::shape::{Hypothesis, Shape};
use super::state::{PASSES, RUNAWAY, State, nominal_residual};
use super::strangers;
use super::two_cores::on_two_cores;
use crate::plant::effects::Port;
use crate::plant::effects::periodic::knots_at;
use crate::signal::inner_products::dot;

/// More findings than this are a different machine.
pub(super) const MOST_FINDINGS: usize = 4;
/// Rounds in which they are looked for: what a later one makes needless leaves its place to another.
const MOST_ROUNDS: usize = 6;
/// Twice the log-likelihood gain a finding needs; see `docs/results.md` for its calibration.
const LEAST_EVIDENCE: f64 = 60.0;
/// Least relative drop of the held-out sum of squares.
const LEAST_SHARE: f64 = 0.006;

/// The same where an encoder's step is coarser than stated: its error is not noise, it follows the motion.
const LEAST_SHARE_COARSE: f64 = 0.05;
/// The same for a free form: the axis' own motion follows every force on it, and a free form follows that
/// motion.
const STRANGER_LEAST_SHARE: f64 = 0.1;
/// No model of a loud effect is exact: what explains less than this share of its evidence is its rest, not
/// physics.
const SECOND_SHARE: f64 = 0.005;
/// Least size of a finding beside the thrust, both as root mean squares.
const LEAST_WEIGHT: f64 = 5e-4;
/// A gap is crossed where the stage's friction turns. What the spring would take up in it must be more than
/// this share of that friction: no model of the turn is better.
const LEAST_GAP_OF_FRICTION: f64 = 0.04;
/// Hypotheses with this share of the best one's evidence are told apart by what they leave when fitted.
pub(super) const RIVAL_SHARE: f64 = 0.4;
/// So many of them.
pub(super) const RIVALS: usize = 3;
/// Passes that each of them is fitted in.
const RIVAL_PASSES: usize = 10;
/// A map that needs more knots than this is no map but a wave.
const MOST_KNOTS: usize = 50;
/// Once it is taken up it may have more.
const FINEST_KNOTS: usize = 200;
/// So many times what is left without it, what is left with a finding is more than a fit in another noise.
const HARM: f64 = 1.02;
/// Least share of a loud rest, all frequencies alike, that makes a hypothesis a rival.
const LOUD_SHARE: f64 = 0.1;
/// So many of those, of so many that are fitted.
const LOUDEST: usize = 2;
const LOUD_CANDIDATES: usize = 6;
/// What leaves less than this share of what the best one leaves is preferred to it.
const CLEARLY_LESS: f64 = 0.9;
/// Share of its evidence that counts of a map: it can imitate a constant, a wave and more, and must beat them
/// by a quarter.
pub(super) const MAP_CREDIT: f64 = 0.8;
/// A free form can imitate what has a name: it must beat everything named by a quarter.
const STRANGER_SHARE: f64 = 0.8;

/// What says the recordings down to their noise in the loop, whatever a balance makes of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Complete {
    /// Neither of the two.
    No,
    /// The model with its numbers re-estimated.
    Numbers,
    /// The model as stated.
    Stated,
}

/// What the search ends with.
pub(crate) struct Outcome {
    /// The model in the end.
    pub(crate) state: State,
    /// Of each round everything that was tried, best first; one entry per effect and port.
    pub(crate) rounds: Vec<Vec<Score>>,
    /// Residual of the model as stated.
    pub(crate) nominal: Column,
    /// Residual with numbers re-estimated, no finding.
    pub(crate) before: Column,
    /// Those numbers.
    pub(crate) recalibrated: Mechanics,
    /// A free form that explains more than everything named does together.
    pub(crate) stranger: Option<Score>,
    /// What the loop says of the model without findings.
    pub(crate) complete: Complete,
    /// What the loop found, where it contradicts the balance.
    pub(crate) told: Option<Told>,
}

/// What a search starts from.
#[derive(Clone)]
pub(crate) struct Start {
    pub(super) state: State,
    /// Residual of the model as stated.
    nominal: Column,
}

impl Outcome {
    /// What a search says where neither a free form nor the loop has a word.
    fn new(
        state: State,
        rounds: Vec<Vec<Score>>,
        (nominal, before, recalibrated): (Column, Column, Mechanics),
    ) -> Self {
        let (stranger, complete, told) = (None, Complete::No, None);
        Self { state, rounds, nominal, before, recalibrated, stranger, complete, told }
    }
}

impl Start {
    pub(super) fn new(problem: Problem, given: Vec<Accepted>) -> Self {
        let nominal = nominal_residual(&problem, &given);
        Self { state: State::new(problem, given, &nominal), nominal }
    }

    /// The same where the loop has the last word on what is found; `None`: steps are coarse, and where they
    /// round is chance, which no loop repeats.
    pub(super) fn asking_the_loop(&self) -> Option<Self> {
        let mut start = self.clone();
        let usual = std::mem::replace(&mut start.state.problem.proof, Proof::LoopDecides) == Proof::Usual;
        usual.then_some(start)
    }

    /// Density of the white force that no choice of the numbers takes from the stage's balance, N2/Hz.
    pub(super) fn white_force_n2_hz(&self) -> f64 {
        spectrum(&self.state.problem, &self.state.residual, true).white_n2_hz()
    }
}

/// The whole search. Of a complete model only the numbers are looked at.
pub(crate) fn search(start: Start, (complete, progress): (Complete, super::Progress<'_>)) -> Outcome {
    let most = if complete == Complete::No { MOST_ROUNDS } else { 0 };
    let Start { mut state, nominal } = start;
    let mut rounds = Vec::new();
    let mut before = state.residual.clone();
    let mut recalibrated = state.fitted;
    let mut stranger = None;
    // The model before its last finding, and findings that did harm.
    let mut back: Option<State> = None;
    let mut refused: Vec<Hypothesis> = Vec::new();
    let mut pruned = false;
    for round in 0..=most {
        progress(round as f64 / (MOST_ROUNDS + 1) as f64, "re-estimating the numbers");
        state.settle(PASSES);
        add_overtones(&mut state);
        add_knots(&mut state);
        if let Some(back) = back.take_if(|b| rms(&state.residual) > RUNAWAY * rms(&b.residual)) {
            refused.extend(state.accepted.pop().map(|a| a.hypothesis));
            state = back;
        }
        if round == 0 {
            progress(0.1, "trying forms outside the vocabulary");
            stranger = if most == 0 { None } else { best_stranger(&state) };
            before.clone_from(&state.residual);
            recalibrated = state.fitted;
        }
        if state.findings() >= MOST_FINDINGS {
            let all: Vec<Hypothesis> = state.accepted.iter().map(|a| a.hypothesis.clone()).collect();
            prune(&mut state);
            pruned = true;
            let stays = |h: &Hypothesis| state.accepted.iter().any(|a| same_kind(&a.hypothesis, h));
            refused.extend(all.into_iter().filter(|h| !stays(h)));
        }
        progress(round as f64 / (MOST_ROUNDS + 1) as f64, "trying hypotheses");
        let bench = state.weighted_bench();
        let known: Vec<Hypothesis> =
            state.accepted.iter().map(|a| &a.hypothesis).chain(&refused).cloned().collect();
        let mut scores = one_round(&bench, &known);
        let more = round < most && state.findings() < MOST_FINDINGS;
        let rivals = if more { rivals(&state, &bench, (&scores, &known)) } else { Vec::new() };
        drop(bench);
        let with = (!rivals.is_empty()).then(|| least_left(&state, &mut scores, (rivals, round)));
        rounds.push(scores);
        let Some(with) = with else { break };
        back = Some(std::mem::replace(&mut state, with));
        pruned = false;
    }
    if !pruned {
        prune(&mut state);
    }
    let stranger = stranger.filter(|s| beats_named(&state, s));
    Outcome { stranger, complete, ..Outcome::new(state, rounds, (nominal, before, recalibrated)) }
}

/// The findings of one recording, fitted to all of them.
pub(crate) fn with_findings_of(start: Start, alone: Outcome) -> Outcome {
    let Start { mut state, nominal } = start;
    state.settle(PASSES);
    let (before, recalibrated) = (state.residual.clone(), state.fitted);
    for a in &alone.state.accepted[alone.state.given..] {
        let again = Accepted::new(&state.problem, a.hypothesis.clone(), a.amplitudes.clone());
        state.accepted.push(Accepted { round: a.round, ..again });
    }
    state.settle(PASSES);
    add_overtones(&mut state);
    add_knots(&mut state);
    prune(&mut state);
    Outcome::new(state, alone.rounds, (nominal, before, recalibrated))
}

/// What the loop found. The balance says beside it what it leaves of its forces.
pub(crate) fn as_told(start: Start, told: Told) -> Outcome {
    let Start { mut state, nominal } = start;
    state.settle(PASSES);
    let (before, recalibrated) = (state.residual.clone(), state.fitted);
    state.problem.mechanics = Mechanics::nominal(&told.axis.drive);
    for f in &told.findings {
        let law = Accepted::new(&state.problem, f.hypothesis.clone(), f.amplitudes.clone());
        state.accepted.push(law);
    }
    state.residual = state.flat_bench().residual();
    let rounds = told.findings.iter().map(|f| f.scores.clone()).collect();
    Outcome { told: Some(told), ..Outcome::new(state, rounds, (nominal, before, recalibrated)) }
}

/// Waves whose next overtone shows once the rest is explained get it. A wave and its overtones are one cause,
/// so no later round would take them up.
fn add_overtones(state: &mut State) {
    loop {
        let accepted = state.accepted.iter().enumerate().skip(state.given);
        let overtones: Vec<_> = accepted.filter_map(|(k, a)| Some((k, a.hypothesis.overtone()?))).collect();
        if overtones.is_empty() {
            return;
        }
        let grown = {
            let bench = state.bench();
            let least = least_evidence(&bench);
            let shown = overtones.into_iter().map(|(k, (whole, alone))| (k, whole, bench.score(&alone)));
            shown
                .filter(|(_, _, s)| s.plausible && s.evidence > least)
                .max_by(|a, b| a.2.evidence.total_cmp(&b.2.evidence))
        };
        let Some((k, hypothesis, score)) = grown else { return };
        let Accepted { amplitudes, round, .. } = &state.accepted[k];
        let (amplitudes, round) = ([amplitudes.as_slice(), &score.amplitudes].concat(), *round);
        state.accepted[k] = Accepted { round, ..Accepted::new(&state.problem, hypothesis, amplitudes) };
        state.settle(PASSES);
    }
}

/// A map whose knots lie too far apart to follow what shows once it is explained gets twice as many.
///
/// When it is taken up the whole mismatch is the noise, and what lies between its knots counts nothing.
fn add_knots(state: &mut State) {
    for k in state.given..state.accepted.len() {
        while let Some((finer, amplitudes)) = finer_map(&state.accepted[k]) {
            let mut fine = state.clone();
            let round = state.accepted[k].round;
            fine.accepted[k] = Accepted { round, ..Accepted::new(&state.problem, finer, amplitudes) };
            fine.settle(PASSES);
            let gain = losses(&fine, std::slice::from_ref(state))[0];
            if gain < least_evidence_of(state.problem.lengths().iter().sum(), state.problem.proof) {
                break;
            }
            *state = fine;
        }
    }
}

/// The same map with a knot more in each interval.
fn finer_map(map: &Accepted) -> Option<(Hypothesis, Vec<f64>)> {
    let Shape::Map { first_m, spacing_m, knots, flips } = map.hypothesis.shape else { return None };
    let more = 2 * knots - 1;
    let at = |k: usize| {
        let (first, parts) = knots_at(0.5 * k as f64, 0.0, 1.0, knots);
        map.amplitudes[first..].iter().zip(parts).map(|(f, part)| f * part).sum()
    };
    let shape = Shape::Map { first_m, spacing_m: 0.5 * spacing_m, knots: more, flips };
    let hypothesis = Hypothesis { shape, ..map.hypothesis.clone() };
    (more <= FINEST_KNOTS).then(|| (hypothesis, (0..more).map(at).collect()))
}

/// Evidence that would be lost with each of the others in the place of `best`, in the noise that it leaves.
fn losses(best: &State, others: &[State]) -> Vec<f64> {
    let bench = best.bench();
    let left = |residual: &Column| {
        let z = bench.weights.weigh(residual);
        dot(&z, &z)
    };
    let (least, total) = (left(&best.residual), bench.folds.total() as f64);
    others.iter().map(|other| total * (left(&other.residual) / least).ln()).collect()
}

/// The free form that explains more than noise, if there is one.
fn best_stranger(state: &State) -> Option<Score> {
    let bench = state.weighted_bench();
    let unnamed = if bench.problem.proof == Proof::Usual { strangers::best(&bench) } else { None };
    unnamed.filter(|s| s.evidence > STRANGER_LEAST_SHARE * bench.folds.total() as f64)
}

/// Hypotheses that promise about as much as the best one, and what explains most of a loud rest with all
/// frequencies alike: the weighted evidence takes that for noise, and beside it a cause in another band
/// counts nothing. Best first; empty: nothing that noise would not bring.
fn rivals(state: &State, bench: &Bench<'_>, (scores, known): (&[Score], &[Hypothesis])) -> Vec<Score> {
    let best = scores.first().filter(|s| s.plausible && s.evidence > least_evidence(bench));
    let most = best.map_or(f64::INFINITY, |s| s.evidence);
    let near = |s: &&Score| s.plausible && s.evidence > RIVAL_SHARE * most;
    let mut rivals: Vec<Score> = scores.iter().take(RIVALS).filter(near).cloned().collect();
    for loud in loudest(state, known) {
        if !rivals.iter().any(|r| same_kind(&r.hypothesis, &loud.hypothesis)) {
            rivals.push(loud);
        }
    }
    rivals
}

/// What explains most with all frequencies alike, where what is left is louder than noise.
fn loudest(state: &State, known: &[Hypothesis]) -> Vec<Score> {
    if !state.is_loud() {
        return Vec::new();
    }
    let bench = state.flat_bench();
    let mut scores = scored(&bench, known);
    let least = bench.folds.total() as f64 * -(1.0 - LOUD_SHARE).ln();
    scores.retain(|s| s.plausible && s.evidence > least);
    scores.truncate(LOUD_CANDIDATES);
    // A law of fixed amplitude promises with a free one what it does not keep.
    let mut refined = on_two_cores(&scores, |s| refine(&bench, s));
    refined.retain(|s| s.plausible && s.evidence > least);
    sort(&mut refined);
    refined.truncate(LOUDEST);
    refined
}

/// The model with that rival that leaves least once everything is fitted with it; puts it first.
///
/// A first score weighs by noise that still holds the whole mismatch, at constants that are not settled: a
/// slow current loop can promise more than the torsional mode that is there. Same effort for each, then the
/// force that is left. The others' evidence is restated in the noise that the best one leaves.
fn least_left(state: &State, scores: &mut Vec<Score>, (rivals, round): (Vec<Score>, usize)) -> State {
    let alone = rivals.len() == 1;
    let mut settled = on_two_cores(&rivals, |score| {
        let mut state = state.clone();
        state.take(score.clone(), round);
        if !alone {
            state.settle_as(RIVAL_PASSES, false);
        }
        state
    });
    let left_n: Vec<f64> = settled.iter().map(|s| rms(&s.residual)).collect();
    let least_n = left_n.iter().copied().fold(f64::INFINITY, f64::min);
    // The first that none leaves clearly less than: a free form beats what it imitates by a little.
    let best = left_n.iter().position(|l| CLEARLY_LESS * l <= least_n).unwrap_or(0);
    if scores.first().is_none_or(|s| s.hypothesis != rivals[best].hypothesis) {
        let most = scores.first().map_or(0.0, |s| s.evidence).max(rivals[best].evidence);
        let total = 2.0 * state.problem.lengths().iter().sum::<usize>() as f64;
        for (rival, left_n) in rivals.into_iter().zip(&left_n) {
            let behind = (2.0 * total * (left_n / least_n).ln()).max(0.0);
            scores.retain(|s| !same_kind(&s.hypothesis, &rival.hypothesis));
            scores.push(Score { evidence: (most - behind).max(0.0), ..rival });
        }
        sort(scores);
    }
    settled.swap_remove(best)
}

/// True when a free form leaves less than everything named does, both measured in the noise that is left at
/// the end.
///
/// In the first round a loud cause is itself the noise that everything is measured in, and what it moves
/// follows it.
fn beats_named(state: &State, stranger: &Score) -> bool {
    let State { problem, accepted, given, residual, .. } = state;
    if accepted.len() == *given {
        return true;
    }
    let full = Bench::new(problem, accepted, residual);
    let bare = Bench::new(problem, &accepted[..*given], residual);
    let named = full.folds.total() as f64 * (bare.solution.heldout / full.solution.heldout).ln();
    let unnamed = bare.refine(&bare.score(&stranger.hypothesis));
    STRANGER_SHARE * unnamed.evidence > named
}

/// Root mean square of what an accepted hypothesis adds, over that of the thrust.
fn weight(p: &Problem, a: &Accepted) -> f64 {
    let mut sum: Column = vec![Sides::default(); p.motions.len()];
    for (column, amplitude) in a.columns.iter().zip(&a.amplitudes) {
        super::bench::add(&mut sum, column, *amplitude);
    }
    rms(&sum) / rms(&p.target)
}

/// Takes out what later findings have made pointless, and what is too small beside the thrust to be told from
/// the model's own inexactness.
fn prune(state: &mut State) {
    drop_harmful(state);
    let mut index = state.given;
    while index < state.accepted.len() {
        let Mechanics { stiffness_n_m, stage_coulomb_n, .. } = state.problem.mechanics;
        let Hypothesis { port, shape, .. } = &state.accepted[index].hypothesis;
        let too_small = match (port, shape) {
            // An encoder's error has the period of its own signal: no inexactness of the mechanics has that.
            (Port::MotorEncoder | Port::StageEncoder, _) => false,
            (_, Shape::Backlash { gap_m }) => stiffness_n_m * gap_m < LEAST_GAP_OF_FRICTION * stage_coulomb_n,
            _ => weight(&state.problem, &state.accepted[index]) < LEAST_WEIGHT,
        };
        if too_small {
            state.remove(index);
        } else {
            index += 1;
        }
    }
    loop {
        let losses: Vec<f64> = {
            let bench = state.bench();
            (state.given..state.accepted.len()).map(|k| bench.drop_one(k)).collect()
        };
        let Some(k) = needless(&losses) else { break };
        state.remove(state.given + k);
    }
    drop_needless(state);
}

/// The weakest of the evidences that would be lost, where it is no more than noise or the rest of the
/// strongest.
fn needless(losses: &[f64]) -> Option<usize> {
    let strongest = losses.iter().copied().fold(0.0, f64::max);
    let (k, least) = losses.iter().enumerate().min_by(|a, b| a.1.total_cmp(b.1))?;
    (*least < LEAST_EVIDENCE.max(SECOND_SHARE * strongest)).then_some(k)
}

/// Takes out what the others do as well without, once all of them are fitted anew.
///
/// A cause taken up early, in another's place, is held by what was fitted beside it: one linear step without
/// it leaves much, the fit that follows leaves nothing.
fn drop_needless(state: &mut State) {
    loop {
        let places: Vec<usize> = (state.given..state.accepted.len()).collect();
        if places.len() < 2 {
            return;
        }
        let mut without = on_two_cores(&places, |k| {
            let mut state = state.clone();
            state.remove(*k);
            state
        });
        let Some(k) = needless(&losses(state, &without)) else { return };
        *state = without.swap_remove(k);
    }
}

/// Takes out what leaves more force on held-out stretches than there is without it.
///
/// The noise is estimated from what is left, so a cause that ruins one band buys evidence in all others.
fn drop_harmful(state: &mut State) {
    loop {
        let worst = {
            let bench = state.bench();
            let with = rms(&bench.heldout_residual(None));
            (state.given..state.accepted.len())
                .map(|k| (with / rms(&bench.heldout_residual(Some(k))).max(1e-300), k))
                .filter(|(ratio, _)| *ratio > HARM)
                .max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let Some((_, k)) = worst else { return };
        state.remove(k);
    }
}

/// Evidence from which on a finding is claimed.
pub(crate) fn least_evidence(bench: &Bench<'_>) -> f64 {
    least_evidence_of(bench.folds.total(), bench.problem.proof)
}

/// The same of so many samples.
pub(super) fn least_evidence_of(samples: usize, proof: Proof) -> f64 {
    let share = match proof {
        Proof::Usual => LEAST_SHARE,
        Proof::Coarse => LEAST_SHARE_COARSE,
        Proof::LoopDecides => 0.0,
    };
    LEAST_EVIDENCE.max(share * samples as f64)
}

/// Scores the bank and refines the leaders of each effect; best first.
fn one_round(bench: &Bench<'_>, known: &[Hypothesis]) -> Vec<Score> {
    let mut scores = scored(bench, known);
    let leaders: Vec<Score> = scores.iter().take(8).cloned().collect();
    let refined = on_two_cores(&leaders, |s| refine(bench, s));
    scores.splice(0..leaders.len(), refined);
    keep_best_of_kind(&mut scores);
    scores
}

/// Scores of the bank without what is `known`, of each kind the best.
fn scored(bench: &Bench<'_>, known: &[Hypothesis]) -> Vec<Score> {
    let mut bank = bank::of(bench);
    bank.retain(|h| !known.iter().any(|k| same_kind(k, h)));
    let mut scores = on_two_cores(&bank, |h| bench.score(h));
    keep_best_of_kind(&mut scores);
    scores
}

/// True when two hypotheses are the same physics, so that one in the model makes the other pointless.
pub(super) fn same_kind(a: &Hypothesis, b: &Hypothesis) -> bool {
    if a.effect != b.effect || a.port != b.port {
        return false;
    }
    match (&a.shape, &b.shape) {
        (Shape::Periodic { wavelength_m: x, .. }, Shape::Periodic { wavelength_m: y, .. }) => {
            [1.0, 2.0, 3.0].iter().any(|h| (x / y / h - 1.0).abs() < 0.03)
        }
        (Shape::Smoothing { .. }, Shape::Coulomb) | (Shape::Coulomb, Shape::Smoothing { .. }) => false,
        (Shape::EncoderError { period_m: x, .. }, Shape::EncoderError { period_m: y, .. }) => {
            (x / y - 1.0).abs() < 0.02
        }
        (Shape::Lines { fundamental_hz: x, .. }, Shape::Lines { fundamental_hz: y, .. }) => {
            (1..=20).any(|h| {
                (x / y / f64::from(h) - 1.0).abs() < 0.005 || (y / x / f64::from(h) - 1.0).abs() < 0.005
            })
        }
        _ => true,
    }
}

/// What a hypothesis is ranked by.
pub(crate) fn rank(s: &Score) -> f64 {
    let evidence = if s.hypothesis.is_map() { MAP_CREDIT * s.evidence } else { s.evidence };
    if s.plausible { evidence } else { evidence.min(0.0) - 1.0 }
}

fn sort(scores: &mut [Score]) {
    scores.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
}

/// Of each kind the best stays; best first.
pub(super) fn keep_best_of_kind(scores: &mut Vec<Score>) {
    sort(scores);
    let mut kept: Vec<Score> = Vec::new();
    for s in scores.drain(..) {
        if !kept.iter().any(|k| same_kind(&k.hypothesis, &s.hypothesis)) {
            kept.push(s);
        }
    }
    *scores = kept;
}

/// Fits the constants; for waves also how many harmonics, for a map how many knots the held-out blocks pay
/// for.
fn refine(bench: &Bench<'_>, score: &Score) -> Score {
    let mut best = bench.refine(score);
    if matches!(best.hypothesis.shape, Shape::Lines { .. }) {
        return refine_window(bench, best);
    }
    for more in [2, 3] {
        let mut shape = best.hypothesis.shape.clone();
        match &mut shape {
            Shape::Periodic { harmonics, .. } | Shape::EncoderError { harmonics, .. } => *harmonics = more,
            Shape::Map { spacing_m, knots, .. } if 2 * *knots <= MOST_KNOTS => {
                (*spacing_m, *knots) = (0.5 * *spacing_m, 2 * *knots - 1);
            }
            _ => break,
        }
        let start = bench.score(&Hypothesis { shape, ..best.hypothesis.clone() });
        let fine = bench.refine(&start);
        if fine.evidence < best.evidence + 20.0 {
            break;
        }
        best = fine;
    }
    best
}

/// Moves the window of a cut to where its waves are.
fn refine_window(bench: &Bench<'_>, mut best: Score) -> Score {
    let residual = bench.residual();
    for _ in 0..2 {
        let Some(window) = bank::best_window(bench.problem, &residual, (&best.hypothesis, &best.amplitudes))
        else {
            break;
        };
        let mut hypothesis = best.hypothesis.clone();
        if let Shape::Lines { window_s, .. } = &mut hypothesis.shape {
            *window_s = window;
        }
        let moved = bench.score(&hypothesis);
        let moved = bench.refine(&moved);
        if moved.likelihood <= best.likelihood {
            break;
        }
        best = moved;
    }
    best
}
