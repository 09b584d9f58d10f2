//! The model as the search has it at a moment: numbers, timing, what is accepted, and what they leave.

use super::bench::{Accepted, Bench, Score, is_delay, residual_of, rms};
use super::floor::noise_n2;
use super::hypothesis_fit::HypothesisFit;
use super::problem::{Column, Mechanics, Problem};
use super::shape::{Hypothesis, Shape};
use crate::plant::effects::{EffectKind, Port};

/// Power over that of the floor from which on what is left is a mismatch, not noise.
const LOUD: f64 = 9.0;
/// The same from which on a fit may stand beside its place, and what one at its place leaves at most.
const UNEASY: f64 = 1.5;
const LESS: f64 = 0.95;
/// A fit may leave more force than another one, where the noise is low; not this many times.
pub(super) const RUNAWAY: f64 = 1.5;
/// Passes in which the noise of a model without findings is found.
const NOISE_PASSES: usize = 4;
/// Passes after which nothing is waited for any longer.
pub(super) const PASSES: usize = 20;
/// Share by which the residual must fall for passes to have been worth it.
const WORTH_A_PASS: f64 = 0.002;
/// Passes that are compared with as many before them.
const IDLE_PASSES: usize = 5;

/// See the module.
#[derive(Debug, Clone)]
pub(crate) struct State {
    pub(crate) problem: Problem,
    pub(crate) accepted: Vec<Accepted>,
    /// How many of the accepted were in the model that was handed in.
    pub(crate) given: usize,
    /// What is left, from which the noise is taken.
    pub(crate) residual: Column,
    /// The numbers that leave it, whether they say something of the machine or not.
    pub(crate) fitted: Mechanics,
}

impl State {
    /// The model as stated, and what it leaves. Wrong numbers are no noise: the first estimate of it is what
    /// no choice of them absorbs.
    pub(super) fn new(problem: Problem, given: Vec<Accepted>, nominal: &Column) -> Self {
        let residual = Bench::flat(&problem, &given, nominal).residual();
        let fitted = problem.mechanics;
        Self { problem, given: given.len(), accepted: given, residual, fitted }
    }

    /// How many were found here.
    pub(super) fn findings(&self) -> usize {
        self.accepted.len() - self.given
    }

    /// True where what is left is a mismatch, not noise.
    ///
    /// Weighted by its own spectrum a mismatch counts nothing where it is loudest: the fit lets it grow, and
    /// it is noise all the more. Then all frequencies count alike.
    pub(super) fn is_loud(&self) -> bool {
        rms(&self.residual).powi(2) > LOUD * self.noise_n2()
    }

    fn noise_n2(&self) -> f64 {
        [false, true].map(|stage| noise_n2(&self.problem, &self.residual, stage)).iter().sum()
    }

    /// The balance weighted by the noise that is left.
    pub(super) fn weighted_bench(&self) -> Bench<'_> {
        Bench::new(&self.problem, &self.accepted, &self.residual)
    }

    /// The balance with all frequencies alike.
    pub(super) fn flat_bench(&self) -> Bench<'_> {
        Bench::flat(&self.problem, &self.accepted, &self.residual)
    }

    /// The balance as what is left allows.
    pub(super) fn bench(&self) -> Bench<'_> {
        if self.is_loud() { self.flat_bench() } else { self.weighted_bench() }
    }

    /// Numbers, noise and the constants of what is accepted, fitted together until they stand still.
    ///
    /// What a fit leaves is noise to the next one, so it can come to rest beside its place: a delay that is
    /// still too short rings at the resonance, and there nothing counts any longer. Passes in which all
    /// frequencies count alike lead out of there, where there is something to find.
    pub(super) fn settle(&mut self, passes: usize) {
        self.settle_as(passes, false);
        if self.findings() == 0 || rms(&self.residual).powi(2) < UNEASY * self.noise_n2() {
            return;
        }
        let mut other = self.clone();
        other.settle_as(passes, true);
        other.settle_as(passes, false);
        if rms(&other.residual) < LESS * rms(&self.residual) {
            *self = other;
        }
    }

    /// Passes can run away: then the one that left least stands. `flat`: all frequencies count alike.
    pub(super) fn settle_as(&mut self, passes: usize, flat: bool) {
        let passes = if self.accepted.is_empty() { NOISE_PASSES } else { passes };
        let mut left_n: Vec<f64> = Vec::new();
        let mut best: Option<(f64, Self)> = None;
        for _ in 0..passes {
            let moved = self.pass(flat);
            let now_n = rms(&self.residual);
            left_n.push(now_n);
            if best.as_ref().is_none_or(|(least_n, _)| now_n < *least_n) {
                best = Some((now_n, self.clone()));
            }
            if !self.accepted.is_empty() && (moved < 0.3 || wanders(&left_n)) {
                break;
            }
        }
        let now_n = rms(&self.residual);
        if let Some((_, best)) = best.filter(|(least_n, _)| now_n > RUNAWAY * least_n) {
            *self = best;
        }
    }

    /// One fit of everything in the noise that the last one left; returns the largest step of a constant in
    /// deviations.
    ///
    /// A step of a constant that is too long to be taken whole says nothing of the numbers and amplitudes at
    /// its end: they are then those of the constants as they are.
    fn pass(&mut self, flat: bool) -> f64 {
        let bench = if flat { self.flat_bench() } else { self.bench() };
        let fits: Vec<_> = (0..self.accepted.len()).map(|k| bench.accepted_fit(k)).collect();
        let whole = self.accepted.iter().zip(&fits).all(|(a, fit)| fit.is_whole(&a.hypothesis.shape));
        let coefficients = if whole { bench.solution.coefficients.clone() } else { bench.at_rest() };
        let amplitudes: Vec<_> =
            (0..self.accepted.len()).map(|k| bench.amplitudes(k, &coefficients)).collect();
        drop(bench);
        self.residual = residual_of(&self.problem, &self.accepted, &coefficients);
        self.problem.update_free_stretch(&coefficients);
        self.fitted = mechanics_of(&self.problem, &coefficients);
        // Numbers that were fitted to a mismatch say nothing of the machine: laws keep the stated ones.
        if self.accepted.len() > self.given || !self.is_loud() {
            self.problem.mechanics = self.fitted;
        }
        self.problem.shift_timing(coefficients[self.problem.numbers.len()]);
        let p = &self.problem;
        let steps = self.accepted.iter_mut().zip(fits.iter().zip(amplitudes));
        steps.map(|(a, (fit, amplitudes))| move_constants(p, a, (fit, amplitudes))).fold(0.0, f64::max)
    }

    /// Takes a hypothesis into the model.
    pub(super) fn take(&mut self, score: Score, round: usize) {
        let p = &mut self.problem;
        if is_delay(&score.hypothesis) {
            // From here on the finding is the timing.
            p.shift_timing(-p.timing_s);
        }
        self.accepted.push(Accepted { round, ..Accepted::new(p, score.hypothesis, score.amplitudes) });
        self.join_delays();
    }

    /// Takes one out again.
    pub(super) fn remove(&mut self, index: usize) {
        self.accepted.remove(index);
        self.settle(PASSES);
    }

    /// Both encoders later by the same time are one dead time of the thrust that is longer: a single cause.
    ///
    /// u(t) against x(t + T) on either side is u(t - T) against x(t).
    fn join_delays(&mut self) {
        /// Delays apart by more than this share are two causes.
        const ALIKE: f64 = 0.3;
        let late = |port: Port| {
            let found =
                self.accepted.iter().enumerate().skip(self.given).find(|(_, a)| a.hypothesis.port == port);
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
        let round = self.accepted[a].round.max(self.accepted[b].round);
        self.accepted.remove(a.max(b));
        self.accepted.remove(a.min(b));
        self.problem.shift_timing(-self.problem.timing_s);
        let shape = Shape::Delay { extra_s: 0.5 * (motor_s + stage_s) };
        let whole = Hypothesis::new(EffectKind::DeadTime, Port::Current, shape);
        self.accepted.push(Accepted { round, ..Accepted::new(&self.problem, whole, vec![1.0]) });
    }
}

/// Numbers of the problem from the coefficients of the bench.
fn mechanics_of(p: &Problem, coefficients: &[f64]) -> Mechanics {
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
    m
}

/// What the model as stated leaves.
pub(super) fn nominal_residual(p: &Problem, given: &[Accepted]) -> Column {
    let mut coefficients: Vec<f64> = p.numbers.iter().map(|n| n.nominal).collect();
    coefficients.push(0.0);
    for a in given {
        coefficients.extend(a.stated());
    }
    residual_of(p, given, &coefficients)
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
fn move_constants(p: &Problem, a: &mut Accepted, (fit, amplitudes): (&HypothesisFit, Vec<f64>)) -> f64 {
    let shape = &a.hypothesis.shape;
    let trust = shape.trust();
    let constants: Vec<f64> =
        shape.constants().iter().zip(&fit.steps).map(|(c, s)| c * s.clamp(-trust, trust).exp()).collect();
    // A step far below what the law is linear in is none, however sharp the data.
    let moved = fit.steps.iter().zip(&fit.step_deviations).map(|(s, d)| s.abs() / d.max(0.01 * trust));
    let moved = moved.fold(0.0, f64::max);
    let hypothesis = a.hypothesis.with_constants(p, &constants);
    *a = Accepted { round: a.round, ..Accepted::new(p, hypothesis, amplitudes) };
    moved
}
