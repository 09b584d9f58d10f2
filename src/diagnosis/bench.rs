//! The bench on which hypotheses are tried: whitened balance, folds, and what is known already.

use super::hypothesis_fit::HypothesisFit;
use super::problem::{Column, Number, Problem, Sides};
use super::regression::{self, Beside, Folds, Gram, Solution};
use super::shape::{Hypothesis, Shape};
use super::two_cores::on_two_cores;
use super::weights::Weights;
use super::whitening::Whitener;
use crate::plant::effects::{EffectKind, Port};

/// A timing error below this share of a sample is how the samples are taken, not a dead time.
const TIMING_LIMIT_SAMPLES: f64 = 0.3;

/// An accepted hypothesis with its thinned columns.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Accepted {
    pub(crate) hypothesis: Hypothesis,
    pub(crate) columns: Vec<Column>,
    /// Derivatives with respect to the logarithm of the constants.
    pub(crate) tangents: Vec<Column>,
    /// Amplitudes; fixed at one for a law whose constants say everything.
    pub(crate) amplitudes: Vec<f64>,
    /// Round of the search that took it.
    pub(crate) round: usize,
}

impl Accepted {
    pub(crate) fn new(p: &Problem, hypothesis: Hypothesis, amplitudes: Vec<f64>) -> Self {
        let columns = hypothesis.columns(p);
        let tangents = hypothesis.tangents(p, &columns, &amplitudes);
        Self { hypothesis, columns, tangents, amplitudes, round: 0 }
    }

    /// Columns whose coefficients are fitted: amplitudes unless fixed, then the tangents.
    fn fitted(&self) -> impl Iterator<Item = &Column> {
        let free = if self.hypothesis.shape.unit() { 0 } else { self.columns.len() };
        self.columns[..free].iter().chain(self.tangents.iter())
    }

    /// Coefficients of the fitted columns as the present amplitudes state them.
    pub(crate) fn stated(&self) -> Vec<f64> {
        let mut list = if self.hypothesis.shape.unit() { Vec::new() } else { self.amplitudes.clone() };
        list.extend(self.tangents.iter().map(|_| 0.0));
        list
    }

    fn width(&self) -> usize {
        (if self.hypothesis.shape.unit() { 0 } else { self.columns.len() }) + self.tangents.len()
    }
}

/// What one hypothesis does for the balance.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Score {
    pub(crate) hypothesis: Hypothesis,
    /// Twice the gain in log-likelihood on held-out blocks.
    pub(crate) evidence: f64,
    /// The same on everything, for comparing constants of one law.
    pub(crate) likelihood: f64,
    /// Amplitudes, in the order of the hypothesis' columns.
    pub(crate) amplitudes: Vec<f64>,
    pub(crate) deviations: Vec<f64>,
    /// Root mean square of the force at amplitude one; zero where the law has no amplitude.
    pub(crate) unit_rms_n: f64,
    pub(crate) plausible: bool,
}

/// Present state of knowledge about the balance.
pub(crate) struct Bench<'a> {
    pub(crate) problem: &'a Problem,
    pub(crate) folds: Folds,
    pub(crate) weights: Weights,
    /// Weighted: numbers, timing, accepted columns.
    base: Vec<Vec<f64>>,
    target: Vec<f64>,
    gram: Gram,
    /// Best solution without a further hypothesis.
    pub(crate) solution: Solution,
    pub(crate) accepted: &'a [Accepted],
    /// A number that the data of this bench cannot hold, and where it is held.
    held: Option<(usize, f64)>,
}

/// Samples of a timing error that still counts as sampling, in s.
pub(crate) fn timing_limit_s(p: &Problem) -> f64 {
    TIMING_LIMIT_SAMPLES / p.motions.first().map_or(1.0, |m| m.rate_hz)
}

impl<'a> Bench<'a> {
    /// Whitens with the noise that `residual` shows.
    pub(crate) fn new(problem: &'a Problem, accepted: &'a [Accepted], residual: &Column) -> Self {
        let whitener = Whitener::fit(residual, &problem.layout(), problem.rate_hz());
        Self::with(problem, accepted, Weights::new(problem, residual, whitener))
    }

    /// Weights all frequencies alike: what it leaves, no choice of the numbers absorbs.
    pub(crate) fn flat(problem: &'a Problem, accepted: &'a [Accepted], residual: &Column) -> Self {
        let whitener = Whitener::flat(residual, &problem.layout());
        Self::with(problem, accepted, Weights::new(problem, residual, whitener))
    }

    fn with(problem: &'a Problem, accepted: &'a [Accepted], weights: Weights) -> Self {
        let folds = Folds::new(&weights.layout, problem.rate_hz());
        let mut base = on_two_cores(&problem.numbers, |n| weights.weigh_number(n));
        let further: Vec<&Column> = further_columns(problem, accepted).collect();
        base.extend(on_two_cores(&further, |c| weights.weigh(c)));
        let mut target = weights.weigh_thrust(&problem.target);
        for (a, tie) in fixed(problem, accepted) {
            let known = weights.weigh(&a.columns[0]);
            match tie {
                Some(tie) => add_series(&mut base[tie.spring], &known, tie.per_stiffness),
                None => add_series(&mut target, &known, -1.0),
            }
        }
        let beside = beside(problem, &weights, &folds);
        let gram = Gram::new(&base, &target, &folds).beside(beside);
        let mut bench = Self {
            problem,
            folds,
            weights,
            base,
            target,
            solution: gram.solve(&[]),
            gram,
            accepted,
            held: None,
        };
        for (k, a) in accepted.iter().enumerate().filter(|(_, a)| a.hypothesis.is_map()) {
            let first = bench.range(k).start;
            bench.gram.mark_knots(first..first + a.columns.len());
        }
        bench.solution = bench.solve(&bench.gram, true);
        bench.hold_scale();
        bench
    }

    /// Holds the stage's mass where the fit shrank the stage balance towards 0 = 0: every term of it scales
    /// together, and beside a large misfit on the motor side that pays.
    fn hold_scale(&mut self) {
        let p = self.problem;
        let lost = |(k, n): (usize, &super::problem::Number)| {
            matches!(n.key, Some("rotary_inertia_kg_m2" | "movable_mass_kg" | "axial_stiffness_n_m"))
                && !(0.25..4.0).contains(&(self.solution.coefficients[k] / n.nominal))
        };
        let Some(mass) = p.numbers.iter().position(|n| n.key == Some("movable_mass_kg")) else {
            return;
        };
        if p.numbers.iter().enumerate().any(lost) {
            self.gram = self.gram.holding(mass, p.mechanics.stage_mass_kg);
            self.held = Some((mass, p.mechanics.stage_mass_kg));
            self.solution = self.solve(&self.gram, true);
        }
    }

    /// The Gram of the base with another target.
    fn retargeted(&self, target: &[f64]) -> Gram {
        let gram = self.gram.retarget(&self.base, target, &self.folds);
        // Retargeting forgets what was held beside the data.
        match self.held {
            Some((column, value)) => gram.holding_target(column, value),
            None => gram,
        }
    }

    /// The Gram of the base with a column of fixed amplitude, `sign` 1 to put it in, -1 to take it out, and
    /// with further columns.
    fn with_fixed(&self, (h, known): (&Hypothesis, &[f64]), more: &[Vec<f64>], sign: f64) -> Gram {
        let mut columns = self.and(more);
        if let Some(tie) = tie(self.problem, h) {
            columns.push(known);
            let gram = self.gram.with(&columns, &self.target, &self.folds);
            return gram.tied_to(tie.spring, sign * tie.per_stiffness);
        }
        let mut target = self.target.clone();
        add_series(&mut target, known, -sign);
        self.retargeted(&target).with(&columns, &target, &self.folds)
    }

    fn without_fixed(&self, a: &Accepted) -> Gram {
        self.with_fixed((&a.hypothesis, &self.weights.weigh(&a.columns[0])), &[], -1.0)
    }

    /// The columns of the base, then others.
    fn and<'b>(&'b self, more: &'b [Vec<f64>]) -> Vec<&'b [f64]> {
        self.base.iter().chain(more).map(Vec::as_slice).collect()
    }

    fn timing_index(&self) -> usize {
        self.problem.numbers.len()
    }

    /// Solves with the timing free, unless it leaves its limit: then it is held at zero.
    fn solve(&self, gram: &Gram, timing: bool) -> Solution {
        let timing = timing && self.timing_is_free();
        self.solve_for(gram, |k| timing || k != self.timing_index())
    }

    /// A dead time in the model is the timing.
    fn timing_is_free(&self) -> bool {
        !self.accepted.iter().any(|a| is_delay(&a.hypothesis))
    }

    /// Solves for some of the columns; the timing is held at zero where it leaves its limit.
    fn solve_for(&self, gram: &Gram, used: impl Fn(usize) -> bool) -> Solution {
        let mut used: Vec<usize> = (0..gram.columns()).filter(|k| used(*k)).collect();
        let free = gram.solve(&used);
        if self.within_limit(&free) {
            return free;
        }
        used.retain(|k| *k != self.timing_index());
        gram.solve(&used)
    }

    fn within_limit(&self, solution: &Solution) -> bool {
        (self.problem.timing_s + solution.coefficients[self.timing_index()]).abs()
            <= timing_limit_s(self.problem)
    }

    /// What the present solution leaves, thinned, not whitened.
    pub(crate) fn residual(&self) -> Column {
        residual_of(self.problem, self.accepted, &self.solution.coefficients)
    }

    /// Residual in which each block is left by a fit to the other blocks; without one accepted hypothesis, if
    /// asked.
    pub(crate) fn heldout_residual(&self, without: Option<usize>) -> Column {
        let gone = without.map_or(0..0, |k| self.range(k));
        let fixed_gone = without.map(|k| &self.accepted[k]).filter(|a| a.hypothesis.shape.unit());
        let gram = fixed_gone.map_or_else(|| self.gram.clone(), |a| self.without_fixed(a));
        let held = self.solution.coefficients[self.timing_index()] == 0.0;
        let used: Vec<usize> = (0..gram.columns())
            .filter(|k| !(gone.contains(k) || held && *k == self.timing_index()))
            .collect();
        let mut out: Option<Column> = None;
        for fold in 0..regression::FOLDS {
            let coefficients = gram.solve_without(fold, &used);
            let mut residual = residual_of(self.problem, self.accepted, &coefficients);
            if let Some(a) = fixed_gone {
                let tie = tie(self.problem, &a.hypothesis);
                add(&mut residual, &a.columns[0], share(tie, &coefficients));
            }
            match &mut out {
                None => out = Some(residual),
                Some(out) => self.folds.copy_fold(fold, &residual, out),
            }
        }
        out.unwrap_or_default()
    }

    /// Whitened residual of the base.
    pub(crate) fn whitened_residual(&self) -> Vec<f64> {
        regression::left(self.target.clone(), &self.base, &self.solution.coefficients)
    }

    /// Coefficients of an accepted hypothesis in the base: amplitudes (if free), then steps of the constants.
    fn range(&self, index: usize) -> std::ops::Range<usize> {
        let first =
            self.timing_index() + 1 + self.accepted[..index].iter().map(Accepted::width).sum::<usize>();
        first..first + self.accepted[index].width()
    }

    /// Amplitudes of an accepted hypothesis and relative steps of its constants, each with its deviation.
    pub(crate) fn accepted_fit(&self, index: usize) -> HypothesisFit {
        let range = self.range(index);
        HypothesisFit::of(
            &self.accepted[index].hypothesis.shape,
            self.accepted[index].columns.len(),
            (&self.solution, range.start),
        )
    }

    /// Coefficients of the base with the constants of what is accepted held as they are.
    pub(crate) fn at_rest(&self) -> Vec<f64> {
        let steps: Vec<std::ops::Range<usize>> = (0..self.accepted.len())
            .map(|index| {
                let range = self.range(index);
                range.end - self.accepted[index].tangents.len()..range.end
            })
            .collect();
        let timing = self.timing_is_free();
        let used = |k: usize| (timing || k != self.timing_index()) && !steps.iter().any(|r| r.contains(&k));
        self.solve_for(&self.gram, used).coefficients
    }

    /// Amplitudes of an accepted hypothesis among coefficients of the base.
    pub(crate) fn amplitudes(&self, index: usize, coefficients: &[f64]) -> Vec<f64> {
        let a = &self.accepted[index];
        if a.hypothesis.shape.unit() {
            return vec![1.0];
        }
        let range = self.range(index);
        coefficients[range.start..range.end - a.tangents.len()].to_vec()
    }

    /// Loss of evidence without an accepted hypothesis.
    pub(crate) fn drop_one(&self, index: usize) -> f64 {
        let a = &self.accepted[index];
        let gone = self.range(index);
        let kept = |k: usize| !gone.contains(&k);
        let n = self.folds.total() as f64;
        let dropped = if a.hypothesis.shape.unit() {
            self.solve_for(&self.without_fixed(a), kept)
        } else {
            self.solve_for(&self.gram, kept)
        };
        n * (dropped.heldout / self.solution.heldout).ln()
    }

    /// Fits amplitudes and constants of a hypothesis that was scored on this bench, by Gauss-Newton on the
    /// constants.
    pub(crate) fn refine(&self, score: &Score) -> Score {
        let shape = &score.hypothesis.shape;
        if shape.constants().is_empty() {
            return score.clone();
        }
        let shape = shape.absorb(score.amplitudes[0]);
        let mut best = self.try_fitted(&Hypothesis { shape, ..score.hypothesis.clone() });
        let mut fit = self.fit(&best);
        let mut damping = 1.0;
        for _ in 0..6 {
            let h = &best.score.hypothesis;
            let trust = h.shape.trust() * damping;
            let constants = h.shape.constants();
            let moved: Vec<f64> =
                constants.iter().zip(&fit.steps).map(|(c, s)| c * s.clamp(-trust, trust).exp()).collect();
            let next = self.try_fitted(&h.with_constants(self.problem, &moved));
            let gain = next.score.likelihood - best.score.likelihood;
            if gain > 0.0 {
                best = next;
                if gain < 0.5 {
                    break;
                }
                fit = self.fit(&best);
            } else {
                damping *= 0.3;
            }
        }
        best.score
    }

    /// Amplitudes and constant steps together.
    fn fit(&self, tried: &Tried) -> HypothesisFit {
        let (h, columns) = (&tried.score.hypothesis, &tried.columns);
        let tangents = h.tangents(self.problem, columns, &tried.score.amplitudes);
        let tangents: Vec<Vec<f64>> = tangents.iter().map(|c| self.weights.weigh(c)).collect();
        let gram = if h.shape.unit() {
            self.with_fixed((h, &tried.weighed[0]), &tangents, 1.0)
        } else {
            let mut columns = self.and(&tried.weighed);
            columns.extend(tangents.iter().map(Vec::as_slice));
            tried.gram.with(&columns, &self.target, &self.folds)
        };
        let solution = self.solve(&gram, !is_delay(h));
        HypothesisFit::of(&h.shape, columns.len(), (&solution, self.base.len()))
    }

    /// Tries one hypothesis on top of the base.
    pub(crate) fn score(&self, hypothesis: &Hypothesis) -> Score {
        // A torsion scales by nothing: its constants say everything from the start.
        if matches!(hypothesis.shape, Shape::Torsion { .. }) {
            return self.try_fitted(hypothesis).score;
        }
        self.try_free(hypothesis).score
    }

    /// Tries one with the amplitude held at one where the law says so.
    fn try_fitted(&self, h: &Hypothesis) -> Tried {
        if !h.shape.unit() {
            return self.try_free(h);
        }
        let columns = h.columns(self.problem);
        let weighed = vec![self.weights.weigh(&columns[0])];
        let gram = self.with_fixed((h, &weighed[0]), &[], 1.0);
        let solution = self.solve(&gram, !is_delay(h));
        let [evidence, likelihood] = self.gains(&solution);
        let score = Score {
            evidence,
            likelihood,
            amplitudes: vec![1.0],
            deviations: vec![0.0],
            unit_rms_n: 0.0,
            plausible: !h.shape.at_limit() && h.shape.constants()[0] > least_timing_s(self.problem, h),
            hypothesis: h.clone(),
        };
        Tried { score, columns, weighed, gram }
    }

    /// Tries one with its amplitudes free.
    fn try_free(&self, h: &Hypothesis) -> Tried {
        let columns = h.columns(self.problem);
        let weighed: Vec<Vec<f64>> = columns.iter().map(|c| self.weights.weigh(c)).collect();
        let first = self.base.len();
        let mut gram = self.gram.with(&self.and(&weighed), &self.target, &self.folds);
        if h.is_map() {
            gram.mark_knots(first..gram.columns());
        }
        let solution = self.solve(&gram, !is_delay(h));
        let amplitudes = solution.coefficients[first..].to_vec();
        let [evidence, likelihood] = self.gains(&solution);
        let score = Score {
            evidence,
            likelihood,
            deviations: solution.deviations[first..].to_vec(),
            plausible: plausible(h, &amplitudes),
            amplitudes,
            unit_rms_n: columns.first().map_or(0.0, |c| rms(c)),
            hypothesis: h.clone(),
        };
        Tried { score, columns, weighed, gram }
    }

    /// Twice the gain in log-likelihood over the base, on held-out blocks and on everything.
    fn gains(&self, with: &Solution) -> [f64; 2] {
        let n = self.folds.total() as f64;
        let gain = |before: f64, after: f64| n * (before / after.max(1e-300)).ln();
        [gain(self.solution.heldout, with.heldout), gain(self.solution.left, with.left)]
    }
}

/// How far a stated number may be off before anything is measured, as a share of it.
const STATED_DEVIATION: f64 = 0.3;

fn beside(problem: &Problem, weights: &Weights, folds: &Folds) -> Beside {
    let stated = problem.numbers.iter().filter(|n| n.key.is_some());
    let known: Vec<[f64; 2]> = stated.map(|n| [(STATED_DEVIATION * n.nominal).powi(-2), n.nominal]).collect();
    let noise = problem.encoder_noise.as_ref().map(|noise| noise.share(problem, weights, known.len()));
    Beside { noise: noise.unwrap_or_default(), instants: folds.instants(), known, knots: Vec::new() }
}

/// A hypothesis that was tried, with what it was tried with.
struct Tried {
    score: Score,
    columns: Vec<Column>,
    /// The columns as they stand in the regression.
    weighed: Vec<Vec<f64>>,
    /// The regression with them.
    gram: Gram,
}

/// What a delay or lag must exceed to be more than how samples are taken, s.
fn least_timing_s(p: &Problem, h: &Hypothesis) -> f64 {
    match h.shape {
        _ if is_timing(h) => timing_limit_s(p),
        // Beside damping and the thrust's own timing, which both bend with it.
        Shape::Delay { .. } => 1.5 * timing_limit_s(p),
        _ => 0.0,
    }
}

/// A hypothesis about the very timing that is otherwise a nuisance.
pub(crate) fn is_timing(h: &Hypothesis) -> bool {
    h.port == Port::Current && matches!(h.shape, Shape::Delay { .. } | Shape::Lag { .. })
}

/// A dead time takes the timing inside a sample with it; a lag leaves it free, or its convention would bend
/// the lag.
pub(crate) fn is_delay(h: &Hypothesis) -> bool {
    h.port == Port::Current && matches!(h.shape, Shape::Delay { .. })
}

/// How a law between the sides goes with the spring that it bends.
struct Tie {
    /// Index of the stiffness among the numbers.
    spring: usize,
    /// One over the stiffness that the law's column was made with.
    per_stiffness: f64,
}

/// The tie of a law of fixed amplitude: a gap or a second spring in series takes its force from the
/// stiffness, so that a step of the stiffness carries it along.
fn tie(p: &Problem, h: &Hypothesis) -> Option<Tie> {
    let spring = p.numbers.iter().position(Number::is_spring)?;
    let tied = h.port == Port::Coupling && h.shape.unit() && p.mechanics.stiffness_n_m > 0.0;
    tied.then_some(Tie { spring, per_stiffness: p.mechanics.stiffness_n_m.recip() })
}

/// How much of its column a law of fixed amplitude adds at these coefficients.
fn share(tie: Option<Tie>, coefficients: &[f64]) -> f64 {
    tie.map_or(1.0, |tie| tie.per_stiffness * coefficients[tie.spring])
}

/// The accepted laws of fixed amplitude, each with its tie.
fn fixed<'b>(p: &'b Problem, accepted: &'b [Accepted]) -> impl Iterator<Item = (&'b Accepted, Option<Tie>)> {
    accepted.iter().filter(|a| a.hypothesis.shape.unit()).map(|a| (a, tie(p, &a.hypothesis)))
}

/// Columns of the base behind those of the numbers, in order.
fn further_columns<'b>(p: &'b Problem, accepted: &'b [Accepted]) -> impl Iterator<Item = &'b Column> {
    std::iter::once(&p.timing).chain(accepted.iter().flat_map(Accepted::fitted))
}

/// target - columns * coefficients.
pub(crate) fn residual_of(p: &Problem, accepted: &[Accepted], coefficients: &[f64]) -> Column {
    let mut out: Column = p
        .target
        .iter()
        .map(|s| {
            let motor = s.motor.clone();
            let n = motor.as_ref().map_or(0, Vec::len);
            Sides { motor, stage: Some(s.stage.clone().unwrap_or_else(|| vec![0.0; n])) }
        })
        .collect();
    let columns = p.numbers.iter().map(|n| &n.column).chain(further_columns(p, accepted));
    for (column, b) in columns.zip(coefficients) {
        add(&mut out, column, -b);
    }
    for (a, tie) in fixed(p, accepted) {
        add(&mut out, &a.columns[0], -share(tie, coefficients));
    }
    out
}

/// Root of the mean of r_m^2 + r_s^2 over all samples.
pub(crate) fn rms(column: &[Sides]) -> f64 {
    let samples: usize =
        column.iter().map(|s| s.motor.as_ref().or(s.stage.as_ref()).map_or(0, Vec::len)).sum();
    let sides = column.iter().flat_map(|s| [&s.motor, &s.stage]).flatten();
    (sides.flatten().map(|v| v * v).sum::<f64>() / samples.max(1) as f64).sqrt()
}

/// out += factor * column.
pub(crate) fn add(out: &mut Column, column: &Column, factor: f64) {
    if factor == 0.0 {
        return;
    }
    for (o, c) in out.iter_mut().zip(column) {
        for (o, c) in [(&mut o.motor, &c.motor), (&mut o.stage, &c.stage)] {
            if let Some(x) = c {
                match o {
                    Some(o) => add_series(o, x, factor),
                    None => *o = Some(x.iter().map(|x| factor * x).collect()),
                }
            }
        }
    }
}

fn add_series(out: &mut [f64], x: &[f64], factor: f64) {
    out.iter_mut().zip(x).for_each(|(o, x)| *o += factor * x);
}

/// Signs and sizes that the law allows; a fit outside is another cause in disguise.
pub(super) fn plausible(h: &Hypothesis, a: &[f64]) -> bool {
    let near_one = |x: f64| (0.4..2.2).contains(&x);
    match (&h.shape, h.effect) {
        (Shape::Stribeck { .. } | Shape::Coulomb | Shape::Viscous, _) => a[0] > 0.0,
        (Shape::Presliding { .. }, _) => (0.15..1.6).contains(&a[0]),
        (Shape::Backlash { .. }, _) => near_one(a[0]),
        (Shape::Torsion { .. }, _) => near_one(a[0]),
        (Shape::Lag { .. }, _) => near_one(a[0]),
        (Shape::Delay { .. }, _) => near_one(a[0]),
        (Shape::Saturation, _) => a[0] > 0.0,
        (Shape::Drift { .. }, EffectKind::FrictionDrift) => a[0].abs() < 2.0,
        _ => true,
    }
}
