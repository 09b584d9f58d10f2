//! What a selection says: findings with intervals, corrections, alternatives, what could not have been seen.

use super::super::criteria::Z95;
use super::super::result::{Alternative, Correction, Estimate, Verdict};
use super::super::selection::{Fitted, Round, Selected, probabilities};
use super::adequacy::whitened_power;
use super::criteria::CRITERIA;
use super::fit::{Problem, STEP};
use super::laws::{Coordinate, Law, Term};
use super::machine::{Number, Point};
use super::observable::Every;
use super::result::{CutDiagnosis, CutFinding, CutFit, CutLocation, CutTried, NotIdentifiable};
use super::scatter::Scattered;
use super::search::{Asked, Defended, Model, visibility};
use crate::plant::cut_effects::{CutEffect, Specification};
use crate::plant::cut_terms::CutReferences;
use crate::plant::effects::Port;
use crate::plant::scenario::Scenario;
use nalgebra::{DMatrix, DVector};
use std::borrow::Cow;

/// A finished selection with what it was made from.
pub(crate) struct Fitting<'a> {
    /// Observed, stated and free.
    pub(crate) problem: &'a Problem<'a>,
    /// Laws that were open.
    pub(crate) laws: &'a [Law],
    /// The stated structure, refitted.
    pub(crate) start: &'a Model,
    /// What happened.
    pub(crate) selected: &'a Selected<Asked, Model>,
    /// Laws that were challenged after others had been taken up.
    pub(crate) defended: &'a [Defended],
    /// Of the model that was selected.
    pub(crate) posterior: Option<Posterior>,
    /// Its stretches are no one machine.
    pub(crate) scattered: Option<&'a Scattered>,
}

/// Point with the covariance of its coordinates.
pub(crate) struct Posterior {
    /// Where.
    pub(crate) point: Point,
    /// Inverse of the information; of coordinates at a bound nothing.
    pub(crate) covariance: DMatrix<f64>,
    bounds: Vec<[f64; 2]>,
}

impl Posterior {
    /// The curvature at a point, and what the stretches disagree in. `None`: no such machine.
    ///
    /// H^-1 holds where the likelihood is exact; H^-1 (sum g g') H^-1, g the slope of each observable, also
    /// where a stretch as a whole is off (White 1982), if there are more of them than coordinates. Of both,
    /// coordinate by coordinate, the wider one, the correlations those of H^-1.
    pub(crate) fn new(problem: &Problem<'_>, point: &Point) -> Option<Self> {
        let each = problem.quadratics(point, Every(1))?;
        let p = point.coordinates().len();
        let mut scatter = DMatrix::zeros(p, p);
        let many = each.iter().filter(|_| each.len() > p);
        many.for_each(|q| scatter += &q.gradient * q.gradient.transpose());
        let information = problem.with_priors(each, point, p).information;
        let inverse = (information + DMatrix::identity(p, p) * 1e-9).cholesky()?.inverse();
        let robust = &inverse * scatter * &inverse;
        let inflated = whitened_power(problem, point);
        let wider = |i: usize| (robust[(i, i)] / inverse[(i, i)].max(f64::MIN_POSITIVE)).max(inflated).sqrt();
        let covariance = DMatrix::from_fn(p, p, |i, j| inverse[(i, j)] * wider(i) * wider(j));
        Some(Self { point: point.clone(), covariance, bounds: problem.frame.bounds(point) })
    }

    /// The first term that no machine has, or of which no size is told from nothing: its 95 % interval holds
    /// zero.
    pub(crate) fn unseen(&self) -> Option<usize> {
        let mut first = self.point.numbers.len();
        self.point.terms.iter().position(|term| {
            let coordinates = term.law.coordinates();
            let own = first..first + coordinates.len();
            first = own.end;
            let told = |((i, value), c): ((usize, &f64), &Coordinate)| {
                c.is_size && value.abs() > Z95 * self.covariance[(i, i)].max(0.0).sqrt()
            };
            term.is_at_bound() || !own.zip(&term.values).zip(coordinates).any(told)
        })
    }

    /// 95 % interval of a function of the coordinates: its values where the ellipsoid of 95 % is highest and
    /// lowest in it, so that what is the inverse of a coordinate gets no symmetric interval.
    pub(crate) fn interval(&self, of: &dyn Fn(&[f64]) -> Option<f64>) -> Option<[f64; 2]> {
        let here = self.point.coordinates();
        let value = of(&here)?;
        let slope = DVector::from_iterator(
            here.len(),
            (0..here.len()).map(|i| {
                let mut moved = here.clone();
                moved[i] += STEP;
                of(&moved).map_or(0.0, |v| (v - value) / STEP)
            }),
        );
        let along = &self.covariance * &slope;
        let sd = slope.dot(&along).max(0.0).sqrt();
        if sd <= 0.0 {
            return Some([value; 2]);
        }
        let end = |sign: f64| {
            let to = here.iter().zip(along.iter()).zip(&self.bounds);
            let to: Vec<f64> =
                to.map(|((x, d), [low, high])| (x + sign * Z95 * d / sd).clamp(*low, *high)).collect();
            of(&to)
        };
        let ends = [end(-1.0).unwrap_or(value), end(1.0).unwrap_or(value)];
        Some([ends[0].min(ends[1]).min(value), ends[0].max(ends[1]).max(value)])
    }
}

/// Everything but what is foretold and what recordings alone can say.
pub(crate) fn diagnosis(fitting: &Fitting<'_>) -> CutDiagnosis {
    let frame = fitting.problem.frame;
    let model = &fitting.selected.model;
    // A number at its bound is no answer, nor is what was fitted beside it.
    let at_bound = frame.at_bound(&model.point);
    let findings = if at_bound.is_some() { Vec::new() } else { findings(fitting) };
    let posterior = fitting.posterior.as_ref().filter(|_| at_bound.is_none());
    let parameter_corrections = posterior.map_or_else(Vec::new, |p| corrections(fitting, p));
    let verdict = if at_bound.is_some() {
        Verdict::UnexplainedMismatch
    } else if !findings.is_empty() {
        Verdict::MissingPhysics
    } else if parameter_corrections.is_empty() {
        Verdict::ModelAdequate
    } else {
        Verdict::ParameterError
    };
    let fitted = frame.machine(&model.point).filter(|_| at_bound.is_none());
    let scenario = with_pitch(fitted.map_or(frame.stated, |m| m.scenario), &parameter_corrections);
    let first = findings.first().map(|f| f.port).or(at_bound.map(|(number, _)| number.port()));
    CutDiagnosis {
        verdict,
        location: first.map(location),
        parameter_corrections,
        residual_band_hz: None,
        noise_floor_n: None,
        recordings: Vec::new(),
        rows: Vec::new(),
        proof: None,
        table: None,
        not_identifiable: not_identifiable(fitting),
        plan: Vec::new(),
        tried: tried(fitting),
        mapped: Vec::new(),
        stated: frame.stated,
        scenario,
        notes: at_bound.and_then(|(n, p)| no_such_machine(n, p, &frame.stated)).into_iter().collect(),
        findings,
    }
}

/// What is told of a number that ends at its bound.
fn no_such_machine(number: Number, p: f64, stated: &Scenario) -> Option<String> {
    let (name, [nominal, value]) = number.stated(stated, p)?;
    Some(format!(
        "{name} would have to be {value:.3e} or beyond ({nominal:.3e} is stated), which no such machine has: \
         these cuts are no cuts of the stated structure, whatever its numbers."
    ))
}

/// A scenario with what a correction adds to its pitch.
fn with_pitch(scenario: Scenario, corrections: &[Correction]) -> Scenario {
    let mut raw = scenario.raw();
    let (name, _) = Number::Pitch.stated(&scenario, 0.0).unwrap_or_default();
    raw.pitch_difference_rad +=
        corrections.iter().filter(|c| c.name == name).map(|c| c.value - c.nominal).sum::<f64>();
    Scenario::new(&raw).unwrap_or(scenario)
}

fn location(port: Port) -> CutLocation {
    CutLocation { port, domain: "outcome", bands_hz: Vec::new(), time: Vec::new() }
}

/// The effects of the model, those first that it would miss most.
fn findings(fitting: &Fitting<'_>) -> Vec<CutFinding> {
    let point = &fitting.selected.model.point;
    let mut found: Vec<(usize, Defended)> = point
        .terms
        .iter()
        .enumerate()
        .filter(|(_, term)| term.law.kind().is_some())
        .filter_map(|(k, term)| Some((k, standing(fitting, term.law)?)))
        .collect();
    found.sort_by(|a, b| b.1.evidence_nats.total_cmp(&a.1.evidence_nats));
    let temper = whitened_power(fitting.problem, point);
    let of = |(rank, (index, standing)): (usize, (usize, Defended))| {
        let specification = standing.law.specification()?;
        let nats: Vec<f64> =
            std::iter::once(standing.evidence_nats).chain(standing.rivals.iter().map(|r| r.1)).collect();
        let p = probabilities(&nats, 0.0, temper);
        let alternatives = alternatives(&standing.rivals, &p[1..]);
        let rival = alternatives.first().filter(|a| a.probability > CRITERIA.alive);
        Some(CutFinding {
            rank: rank + 1,
            effect: specification.kind,
            port: specification.port,
            statement: statement(specification, rival),
            equation: specification.equation.to_owned(),
            parameters: parameters(fitting, index),
            fit: CutFit::default(),
            probability: p[0],
            next_experiment: rival.map(|rival| next_experiment(specification, rival)),
            alternatives,
            contribution: Vec::new(),
            evidence_nats: standing.evidence_nats,
        })
    };
    found.into_iter().enumerate().filter_map(of).collect()
}

/// How a law of the model stands against its rivals: as it was challenged last, or as it was taken up.
pub(crate) fn standing(fitting: &Fitting<'_>, law: Law) -> Option<Defended> {
    // Beside the scatter a law is worth less, its rivals no more than it.
    if let Some((_, nats)) = fitting.scattered.and_then(|s| s.standing.iter().find(|s| s.0 == law)) {
        let mut out = standing_alone(fitting, law)?;
        let less = (out.evidence_nats - nats).max(0.0);
        out.evidence_nats -= less;
        out.rivals.iter_mut().for_each(|r| r.1 -= less);
        return Some(out);
    }
    standing_alone(fitting, law)
}

/// The same of one machine.
fn standing_alone(fitting: &Fitting<'_>, law: Law) -> Option<Defended> {
    stood(fitting.selected, fitting.defended, law)
}

/// How a law stood when it was challenged last, or when it was taken up.
fn stood(selected: &Selected<Asked, Model>, defended: &[Defended], law: Law) -> Option<Defended> {
    let taken =
        |r: &&Round<Asked, Model>| r.accepted && r.fitted.first().is_some_and(|f| f.hypothesis.law == law);
    let challenged = defended.iter().rfind(|d| d.law == law).cloned();
    challenged.or_else(|| {
        let round = selected.rounds.iter().rfind(taken)?;
        let rivals = round.fitted[1..].iter().map(|f| (f.hypothesis.law, f.evidence_nats)).collect();
        Some(Defended { law, evidence_nats: round.fitted[0].evidence_nats, rivals })
    })
}

/// The first law of a model beside which a rival is so much likelier that it is dead itself: one that was not
/// taken up in its place, because it is no machine's either. What it stands for is none of both.
pub(crate) fn defeated(
    problem: &Problem<'_>,
    selected: &Selected<Asked, Model>,
    defended: &[Defended],
) -> Option<usize> {
    let point = &selected.model.point;
    if point.terms.is_empty() {
        return None;
    }
    let temper = whitened_power(problem, point);
    let lost = |term: &Term| {
        let own = stood(selected, defended, term.law)?;
        let best = own.rivals.iter().map(|r| r.1).reduce(f64::max)?;
        let of_both = probabilities(&[own.evidence_nats], best, temper);
        Some(of_both[0] < CRITERIA.alive)
    };
    point.terms.iter().position(|term| lost(term).unwrap_or(false))
}

/// Rivals with their probabilities; of two shapes of one effect the likelier.
fn alternatives(rivals: &[(Law, f64)], p: &[f64]) -> Vec<Alternative> {
    let of = |((law, _), p): (&(Law, f64), &f64)| {
        let specification = law.specification()?;
        Some(Alternative { effect: specification.kind, port: specification.port, probability: *p })
    };
    let mut out: Vec<Alternative> = rivals.iter().zip(p).filter_map(of).collect();
    out.sort_by(|a, b| b.probability.total_cmp(&a.probability));
    out
}

/// One sentence for a person, and another where these cuts do not decide it.
fn statement(found: &Specification, rival: Option<&Alternative>) -> String {
    let own = one_line(found.statement);
    match rival {
        Some(r) => {
            let (name, percent) = (r.effect.name(), 100.0 * r.probability);
            format!("{own} These cuts do not tell it from {name} (probability {percent:.0} %).")
        }
        None => own,
    }
}

/// A text that the source breaks into lines.
fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn next_experiment(found: &Specification, rival: &Alternative) -> String {
    let told = |s: &Specification| one_line(s.told_apart_by);
    let other = Specification::of(rival.effect).map_or_else(String::new, |s| format!("; or {}", told(s)));
    format!("{}{other}.", told(found))
}

/// Numbers of an effect with their intervals, the key first.
fn parameters(fitting: &Fitting<'_>, index: usize) -> Vec<Estimate> {
    let frame = fitting.problem.frame;
    let point = &fitting.selected.model.point;
    let effect = |term: &Term| term.effect(&frame.scales);
    let Some(found) = point.terms.get(index).and_then(effect) else { return Vec::new() };
    let reference = frame
        .machine(point)
        .map_or_else(|| CutReferences::of(&frame.stated), |machine| CutReferences::of(&machine.scenario));
    let named = |effect: CutEffect, name: &str| {
        effect.named_values(&reference).into_iter().find(|(n, _)| *n == name).map(|(_, v)| v)
    };
    let estimate = |(name, value): (&'static str, f64)| {
        let of = |at: &[f64]| named(effect(&point.with(at).terms[index])?, name);
        let ci95 = fitting.posterior.as_ref().and_then(|p| p.interval(&of)).unwrap_or([value; 2]);
        Estimate { name: name.to_owned(), value, unit: unit(found.specification(), name), ci95 }
    };
    found.named_values(&reference).into_iter().map(estimate).collect()
}

fn unit(specification: &Specification, name: &str) -> &'static str {
    let own = specification.parameter(name).map(|p| p.unit);
    let same = specification.equivalents.iter().find(|e| e.name == name).map(|e| e.unit);
    own.or(same).unwrap_or("")
}

/// Stated numbers that lie further off than their interval and than anybody would overlook.
///
/// The interval is that of every machine that is alive: a law that is worth no name may still be there, and
/// with it the numbers are others.
fn corrections(fitting: &Fitting<'_>, posterior: &Posterior) -> Vec<Correction> {
    let frame = fitting.problem.frame;
    let others = alive(fitting);
    let off = |(k, number): (usize, &Number)| {
        let within = |posterior: &Posterior, deviations: f64| {
            let reach = deviations * posterior.covariance[(k, k)].max(0.0).sqrt();
            [posterior.point.numbers[k] - reach, posterior.point.numbers[k] + reach]
        };
        let set = number.set_within();
        let holds_stated = |[low, high]: [f64; 2]| low <= set && high >= -set;
        if holds_stated(within(posterior, CRITERIA.correction_sd)) {
            return None;
        }
        let widest = |[low, high]: [f64; 2], other: &Posterior| {
            let [l, h] = within(other, Z95);
            [low.min(l), high.max(h)]
        };
        let [low, high] = others.iter().fold(within(posterior, Z95), widest);
        if holds_stated([low, high]) {
            return None;
        }
        let at = |p: f64| number.stated(&frame.stated, p);
        let (name, [nominal, value]) = at(posterior.point.numbers[k])?;
        let ends = [at(low)?.1[1], at(high)?.1[1]];
        Some(Correction { name: Cow::Borrowed(name), nominal, value, ci95: ends })
    };
    frame.numbers.iter().enumerate().filter_map(off).collect()
}

/// The machines with a law that was asked last, was not taken up and is not unlikely either.
///
/// Cost: a Jacobian each.
fn alive(fitting: &Fitting<'_>) -> Vec<Posterior> {
    let Some(round) = fitting.selected.rounds.last().filter(|r| !r.accepted) else { return Vec::new() };
    let nats: Vec<f64> = round.fitted.iter().map(|f| f.evidence_nats).collect();
    let temper = whitened_power(fitting.problem, &fitting.selected.model.point);
    let likely = probabilities(&nats, 0.0, temper).into_iter().zip(&round.fitted);
    let likely = likely.filter(|(p, f)| *p > CRITERIA.alive && !f.at_bound);
    likely.filter_map(|(_, f)| Posterior::new(fitting.problem, &f.model.point)).collect()
}

/// What was fitted in the first round, and the stated structure.
fn tried(fitting: &Fitting<'_>) -> Vec<CutTried> {
    let Some(round) = fitting.selected.rounds.first() else { return Vec::new() };
    let of = |f: &Fitted<Asked, Model>| {
        let specification = f.hypothesis.law.specification()?;
        Some(CutTried {
            effect: Some(specification.kind),
            port: specification.port,
            evidence_nats: f.evidence_nats,
        })
    };
    let none = CutTried { effect: None, port: Port::Process, evidence_nats: 0.0 };
    let mut out: Vec<CutTried> = round.fitted.iter().filter_map(of).chain([none]).collect();
    out.sort_by(|a, b| b.evidence_nats.total_cmp(&a.evidence_nats));
    out
}

/// Laws whose size, at three times a typical one, stays below five of its standard deviations.
fn not_identifiable(fitting: &Fitting<'_>) -> Vec<NotIdentifiable> {
    let model = &fitting.selected.model;
    let taken = |law: &Law| model.point.terms.iter().any(|t| t.law == *law);
    let mut out: Vec<NotIdentifiable> = Vec::new();
    let open: Vec<Law> = fitting.laws.iter().copied().filter(|l| !taken(l)).collect();
    for seen in visibility(fitting.problem, model, &open) {
        let law = seen.law;
        let Some(specification) = law.specification() else { continue };
        let largest = CRITERIA.largest_size * seen.of_a_size;
        let known = out.iter().any(|n| n.effect == specification.kind);
        if largest >= CRITERIA.visible_sd || known {
            continue;
        }
        let told = one_line(specification.told_apart_by);
        let why = if seen.alone < CRITERIA.visible_sd {
            format!("it changes nothing that was recorded here; what would show it: {told}")
        } else {
            format!(
                "what it changes here the free numbers of the scenario change as well: {:.1} standard \
                 deviations are left of a large one, {:.0} are needed; what would show it: {told}",
                largest, CRITERIA.visible_sd
            )
        };
        out.push(NotIdentifiable { effect: specification.kind, port: specification.port, why });
    }
    out
}
