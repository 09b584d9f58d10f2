//! Forward selection: try every hypothesis, take the best, project it out, try again.

use super::bank;
use super::bench::{Accepted, Bench, HypothesisFit, Score, is_delay, rms};
use super::problem::{Column, Mechanics, Problem, Sides};
use super::shape::{Hypothesis, Shape};
use super::strangers;
use super::two_cores::on_two_cores;
use crate::plant::effects::{EffectKind, Port};

/// More findings than this are a different machine.
const MOST_FINDINGS: usize = 4;
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
/// A weighted fit may leave more force than one without the finding, where the noise is low; not this many
/// times.
const RUNAWAY: f64 = 1.5;
/// Hypotheses with this share of the best one's evidence are told apart by what they leave when fitted.
const RIVAL_SHARE: f64 = 0.4;
/// So many of them.
const RIVALS: usize = 4;
/// What leaves less than this share of what the best one leaves is preferred to it.
const CLEARLY_LESS: f64 = 0.9;
/// Share by which the residual must fall for passes to have been worth it.
const WORTH_A_PASS: f64 = 0.002;
/// Passes that are compared with as many before them.
const IDLE_PASSES: usize = 5;
/// A free form can imitate what has a name: it must beat everything named by a quarter.
const STRANGER_SHARE: f64 = 0.8;

/// One round of the search.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Round {
    /// Everything tried, best first; one entry per effect and port.
    pub(crate) scores: Vec<Score>,
    /// Index of what was taken into the model.
    pub(crate) taken: Option<usize>,
}

/// What the search ends with.
pub(crate) struct Outcome {
    pub(crate) problem: Problem,
    pub(crate) accepted: Vec<Accepted>,
    pub(crate) rounds: Vec<Round>,
    /// How many of the accepted were in the model that was handed in.
    pub(crate) given: usize,
    /// Residual of the model as stated.
    pub(crate) nominal: Column,
    /// The last residual, from which the noise is taken.
    pub(crate) residual: Column,
    /// Residual with numbers re-estimated, no finding.
    pub(crate) before: Column,
    /// Those numbers.
    pub(crate) recalibrated: Mechanics,
    /// A free form that explains more than everything named does together.
    pub(crate) stranger: Option<Score>,
}

/// Numbers of the problem from the coefficients of the bench.
fn update_mechanics(p: &mut Problem, coefficients: &[f64]) {
    let mut m = Mechanics::nominal(&p.drive);
    for (number, &b) in p.numbers.iter().zip(coefficients) {
        // A number that the recording cannot tell stays nominal.
        let b = if b > 0.2 * number.nominal && b < 5.0 * number.nominal { b } else { number.nominal };
        match number.key {
            Some("rotary_inertia_kg_m2") => m.motor_mass_kg = b,
            Some("rotary_damping_nm_s_rad") => m.motor_damping_n_s_m = b,
            Some("motor_coulomb_friction_n") => m.motor_coulomb_n = b,
            Some("axial_stiffness_n_m") => m.stiffness_n_m = b,
            Some("structural_damping_n_s_m") => m.structural_damping_n_s_m = b,
            Some("movable_mass_kg") => m.stage_mass_kg = b,
            Some("translational_damping_n_s_m") => m.stage_damping_n_s_m = b,
            Some("stage_coulomb_friction_n") => m.stage_coulomb_n = b,
            _ => {}
        }
    }
    p.mechanics = m;
    p.update_free_stretch(coefficients);
}

fn nominal_residual(p: &Problem, given: &[Accepted]) -> Column {
    let mut coefficients: Vec<f64> = p.numbers.iter().map(|n| n.nominal).collect();
    coefficients.push(0.0);
    for a in given {
        coefficients.extend(a.stated());
    }
    super::bench::residual_of(p, given, &coefficients)
}

/// Numbers, noise and the constants of what is accepted, fitted together until they stand still.
fn settle(p: &mut Problem, accepted: &mut [Accepted], residual: &mut Column) {
    let passes = if accepted.is_empty() { 2 } else { 40 };
    let mut left_n = Vec::new();
    for _ in 0..passes {
        // The noise of one fit weights the next.
        *residual = Bench::new(p, accepted, residual).residual();
        let mut bench = Bench::new(p, accepted, residual);
        *residual = bench.residual();
        if !accepted.is_empty()
            && let Some(flat) = calmed(p, accepted, residual)
        {
            *residual = flat.residual();
            bench = flat;
        }
        let fits: Vec<_> = (0..accepted.len()).map(|k| bench.accepted_fit(k)).collect();
        let (coefficients, timing_s) = (bench.solution.coefficients.clone(), bench.timing_s());
        drop(bench);
        update_mechanics(p, &coefficients);
        p.shift_timing(timing_s);
        let moved =
            accepted.iter_mut().zip(&fits).map(|(a, fit)| move_constants(p, a, fit)).fold(0.0, f64::max);
        left_n.push(rms(residual));
        if !accepted.is_empty() && (moved < 0.3 || wanders(&left_n)) {
            break;
        }
    }
}

/// Takes a hypothesis into the model.
fn take(p: &mut Problem, (accepted, given): (&mut Vec<Accepted>, usize), score: Score, round: usize) {
    if is_delay(&score.hypothesis) {
        // From here on the finding is the timing.
        p.shift_timing(-p.timing_s);
    }
    let new = Accepted::new(p, score.hypothesis, score.amplitudes);
    accepted.push(Accepted { round, ..new });
    join_delays(p, accepted, given);
}

/// Of hypotheses that promise about as much, puts the one first that leaves least once everything is fitted
/// with it.
///
/// A first score weighs by noise that still holds the whole mismatch, at constants that are not settled: a
/// slow current loop can promise more than the torsional mode that is there. Same effort for each, then the
/// force that is left. The others' evidence is restated in the noise that the first one leaves.
fn prefer_least_left(
    p: &Problem,
    (accepted, given): (&[Accepted], usize),
    residual: &Column,
    (scores, total): (&mut Vec<Score>, f64),
) {
    let most = scores.first().map_or(0.0, |s| s.evidence);
    let near = |s: &&Score| s.plausible && s.evidence > RIVAL_SHARE * most;
    let rivals: Vec<Score> = scores.iter().take(RIVALS).filter(near).cloned().collect();
    if rivals.len() < 2 {
        return;
    }
    let left_n = on_two_cores(&rivals, |score| {
        let (mut p, mut accepted, mut residual) = (p.clone(), accepted.to_vec(), residual.clone());
        take(&mut p, (&mut accepted, given), score.clone(), 0);
        settle(&mut p, &mut accepted, &mut residual);
        rms(&residual)
    });
    let least_n = left_n.iter().copied().fold(f64::INFINITY, f64::min);
    if left_n[0] <= least_n / CLEARLY_LESS {
        return;
    }
    for (score, left_n) in rivals.iter().zip(&left_n) {
        let behind = total * 2.0 * (left_n / least_n).ln();
        if let Some(s) = scores.iter_mut().find(|s| s.hypothesis == score.hypothesis) {
            s.evidence = if behind > 0.0 { (most - behind).max(0.0) } else { most };
        }
    }
    sort(scores);
}

/// Both encoders later by the same time are one dead time of the thrust that is longer: a single cause.
///
/// u(t) against x(t + T) on either side is u(t - T) against x(t).
fn join_delays(p: &mut Problem, accepted: &mut Vec<Accepted>, given: usize) {
    /// Delays apart by more than this share are two causes.
    const ALIKE: f64 = 0.3;
    let late = |port: Port| {
        let found = accepted.iter().enumerate().skip(given).find(|(_, a)| a.hypothesis.port == port);
        found.and_then(|(k, a)| match a.hypothesis.shape {
            Shape::Delay { extra_s } => Some((k, extra_s)),
            _ => None,
        })
    };
    let (Some((a, motor_s)), Some((b, stage_s))) = (late(Port::MotorEncoder), late(Port::StageEncoder))
    else {
        return;
    };
    if (motor_s / stage_s - 1.0).abs() > ALIKE {
        return;
    }
    let round = accepted[a].round.max(accepted[b].round);
    accepted.remove(a.max(b));
    accepted.remove(a.min(b));
    p.shift_timing(-p.timing_s);
    let shape = Shape::Delay { extra_s: 0.5 * (motor_s + stage_s) };
    let whole = Hypothesis::new(EffectKind::DeadTime, Port::Current, shape);
    accepted.push(Accepted { round, ..Accepted::new(p, whole, vec![1.0]) });
}

/// The bench with all frequencies alike, where the weighted fit leaves far more: a mismatch taken for noise
/// loses its weight, grows and is noise all the more.
fn calmed<'a>(p: &'a Problem, accepted: &'a [Accepted], residual: &Column) -> Option<Bench<'a>> {
    let flat = Bench::flat(p, accepted, residual);
    (rms(residual) > RUNAWAY * rms(&flat.residual())).then_some(flat)
}

/// True where the last passes gained nothing over those before them: constants that trade with each other, or
/// that imitate another cause, wander on.
fn wanders(left_n: &[f64]) -> bool {
    let least = |x: &[f64]| x.iter().copied().fold(f64::INFINITY, f64::min);
    let Some(start) = left_n.len().checked_sub(2 * IDLE_PASSES) else { return false };
    let (before, last) = left_n[start..].split_at(IDLE_PASSES);
    least(last) > (1.0 - WORTH_A_PASS) * least(before)
}

/// Moves the constants of an accepted hypothesis by its fit; returns the largest step in deviations.
fn move_constants(p: &Problem, a: &mut Accepted, fit: &HypothesisFit) -> f64 {
    let shape = &a.hypothesis.shape;
    let trust = shape.trust();
    let constants: Vec<f64> =
        shape.constants().iter().zip(&fit.steps).map(|(c, s)| c * s.clamp(-trust, trust).exp()).collect();
    // A step far below what the law is linear in is none, however sharp the data.
    let moved = fit.steps.iter().zip(&fit.step_deviations).map(|(s, d)| s.abs() / d.max(0.01 * trust));
    let moved = moved.fold(0.0, f64::max);
    let hypothesis = Hypothesis { shape: shape.with_constants(&constants), ..a.hypothesis.clone() };
    *a = Accepted { round: a.round, ..Accepted::new(p, hypothesis, fit.amplitudes.clone()) };
    moved
}

/// The whole search.
pub(crate) fn search(mut p: Problem, given: Vec<Accepted>, progress: super::Progress<'_>) -> Outcome {
    let mut accepted = given;
    let given = accepted.len();
    let mut rounds = Vec::new();
    let mut residual = nominal_residual(&p, &accepted);
    let nominal = residual.clone();
    // Wrong numbers are no noise: the first estimate of it is what no choice of them absorbs.
    residual = Bench::flat(&p, &accepted, &residual).residual();
    let mut before = residual.clone();
    let mut recalibrated = p.mechanics;
    let mut stranger = None;
    for round in 0..=MOST_FINDINGS {
        progress(round as f64 / (MOST_FINDINGS + 1) as f64, "re-estimating the numbers");
        settle(&mut p, &mut accepted, &mut residual);
        if round > 0 && rms(&residual) > RUNAWAY * rms(&before) {
            // A mismatch taken for noise loses its weight, grows, and is noise all the more.
            accepted.pop();
            residual.clone_from(&before);
            settle(&mut p, &mut accepted, &mut residual);
            break;
        }
        if round == 0 {
            let bench = Bench::new(&p, &accepted, &residual);
            residual = bench.residual();
            progress(0.1, "trying forms outside the vocabulary");
            let unnamed = if bench.problem.coarse { None } else { strangers::best(&bench) };
            stranger = unnamed.filter(|s| s.evidence > STRANGER_LEAST_SHARE * bench.folds.total() as f64);
            drop(bench);
            let calm = calmed(&p, &accepted, &residual)
                .map(|flat| (flat.solution.coefficients.clone(), flat.residual()));
            if let Some((coefficients, left)) = calm {
                update_mechanics(&mut p, &coefficients);
                residual = left;
            }
            before.clone_from(&residual);
            recalibrated = p.mechanics;
        }
        let bench = Bench::new(&p, &accepted, &residual);
        if round > 0 {
            residual = bench.residual();
        }
        progress(round as f64 / (MOST_FINDINGS + 1) as f64, "trying hypotheses");
        let mut result = one_round(&bench, &accepted);
        let enough = round < MOST_FINDINGS
            && result.scores.first().is_some_and(|s| s.plausible && significant(s.evidence, &bench));
        result.taken = enough.then_some(0);
        let total = bench.folds.total() as f64;
        drop(bench);
        if enough {
            prefer_least_left(&p, (&accepted, given), &residual, (&mut result.scores, total));
        }
        let taken = result.taken.map(|k| result.scores[k].clone());
        rounds.push(result);
        match taken {
            Some(score) => take(&mut p, (&mut accepted, given), score, round),
            None => break,
        }
    }
    prune(&mut p, &mut accepted, &mut residual, given);
    let stranger = stranger.filter(|s| beats_named(&p, (&accepted, given), &residual, s));
    Outcome { problem: p, accepted, rounds, given, nominal, residual, before, recalibrated, stranger }
}

/// True when a free form leaves less than everything named does, both measured in the noise that is left at
/// the end.
///
/// In the first round a loud cause is itself the noise that everything is measured in, and what it moves
/// follows it.
fn beats_named(
    p: &Problem,
    (accepted, given): (&[Accepted], usize),
    residual: &Column,
    stranger: &Score,
) -> bool {
    if accepted.len() == given {
        return true;
    }
    let full = Bench::new(p, accepted, residual);
    let bare = Bench::new(p, &accepted[..given], residual);
    let named = full.folds.total() as f64 * (bare.solution.heldout / full.solution.heldout).ln();
    STRANGER_SHARE * bare.refine(stranger).evidence > named
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
fn prune(p: &mut Problem, accepted: &mut Vec<Accepted>, residual: &mut Column, given: usize) {
    drop_harmful(p, accepted, residual, given);
    let mut index = given;
    while index < accepted.len() {
        // An encoder's error has the period of its own signal: no inexactness of the mechanics imitates that.
        let port = accepted[index].hypothesis.port;
        let encoder = matches!(port, Port::MotorEncoder | Port::StageEncoder);
        if !encoder && weight(p, &accepted[index]) < LEAST_WEIGHT {
            accepted.remove(index);
            settle(p, accepted, residual);
        } else {
            index += 1;
        }
    }
    loop {
        let (weakest, strongest) = {
            let bench = Bench::new(p, accepted, residual);
            let losses: Vec<(f64, usize)> = (given..accepted.len()).map(|k| (bench.drop_one(k), k)).collect();
            let strongest = losses.iter().map(|l| l.0).fold(0.0, f64::max);
            (losses.into_iter().min_by(|a, b| a.0.total_cmp(&b.0)), strongest)
        };
        match weakest {
            Some((evidence, k)) if evidence < LEAST_EVIDENCE.max(SECOND_SHARE * strongest) => {
                accepted.remove(k);
                settle(p, accepted, residual);
            }
            _ => break,
        }
    }
}

/// Takes out what leaves more force on held-out stretches than there is without it.
///
/// The noise is estimated from what is left, so a cause that ruins one band buys evidence in all others.
fn drop_harmful(p: &mut Problem, accepted: &mut Vec<Accepted>, residual: &mut Column, given: usize) {
    loop {
        let worst = {
            let bench = Bench::new(p, accepted, residual);
            let with = rms(&bench.heldout_residual(None));
            (given..accepted.len())
                .map(|k| (with / rms(&bench.heldout_residual(Some(k))).max(1e-300), k))
                .filter(|(ratio, _)| *ratio > 1.0)
                .max_by(|a, b| a.0.total_cmp(&b.0))
        };
        let Some((_, k)) = worst else { return };
        accepted.remove(k);
        settle(p, accepted, residual);
    }
}

fn significant(evidence: f64, bench: &Bench<'_>) -> bool {
    evidence > least_evidence(bench)
}

/// Evidence from which on a finding is claimed.
pub(crate) fn least_evidence(bench: &Bench<'_>) -> f64 {
    let share = if bench.problem.coarse { LEAST_SHARE_COARSE } else { LEAST_SHARE };
    LEAST_EVIDENCE.max(share * bench.folds.total() as f64)
}

/// Scores the whole bank and refines the leaders of each effect.
fn one_round(bench: &Bench<'_>, accepted: &[Accepted]) -> Round {
    let mut bank = bank::fixed(bench.problem);
    bank.extend(bank::adaptive(bench));
    bank.retain(|h| !accepted.iter().any(|a| same_kind(&a.hypothesis, h)));
    let mut scores = on_two_cores(&bank, |h| bench.score(h));
    keep_best_of_kind(&mut scores);
    let leaders: Vec<Score> = scores.iter().take(8).cloned().collect();
    let refined = on_two_cores(&leaders, |s| refine(bench, s));
    scores.splice(0..leaders.len(), refined);
    sort(&mut scores);
    keep_best_of_kind(&mut scores);
    Round { scores, taken: None }
}

/// True when two hypotheses are the same physics, so that one in the model makes the other pointless.
fn same_kind(a: &Hypothesis, b: &Hypothesis) -> bool {
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

/// What a hypothesis is ranked by. A free map can imitate a constant, a wave and more: it must beat them by a
/// quarter.
pub(crate) fn rank(s: &Score) -> f64 {
    let evidence =
        if matches!(s.hypothesis.shape, Shape::Map { .. }) { 0.8 * s.evidence } else { s.evidence };
    if s.plausible { evidence } else { evidence.min(0.0) - 1.0 }
}

fn sort(scores: &mut [Score]) {
    scores.sort_by(|a, b| rank(b).total_cmp(&rank(a)));
}

/// Of each kind the best stays; best first.
fn keep_best_of_kind(scores: &mut Vec<Score>) {
    sort(scores);
    let mut kept: Vec<Score> = Vec::new();
    for s in scores.drain(..) {
        if !kept.iter().any(|k| same_kind(&k.hypothesis, &s.hypothesis)) {
            kept.push(s);
        }
    }
    *scores = kept;
}

/// Fits the constants; for waves also how many harmonics the held-out blocks pay for.
fn refine(bench: &Bench<'_>, score: &Score) -> Score {
    let mut best = bench.refine(score);
    if matches!(best.hypothesis.shape, Shape::Lines { .. }) {
        return refine_window(bench, best);
    }
    for more in [2, 3] {
        let mut shape = best.hypothesis.shape.clone();
        match &mut shape {
            Shape::Periodic { harmonics, .. } | Shape::EncoderError { harmonics, .. } => *harmonics = more,
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
