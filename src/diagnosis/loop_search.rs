//! Forward selection in closed loop: every hypothesis is run, none is differentiated.
//!
//! Where speed hardly changes, a balance asks for less than the noise of what it differentiates, and a law
//! that bends the noise can outweigh the law that is missing. Here each hypothesis runs under the recorded
//! command, beside the model with its numbers, and what it changes is a column for what the model leaves of
//! reference and stretch (output error; Ljung, System Identification, 2nd ed., 1999, 7.2; generalised
//! likelihood ratio with all numbers projected out). It costs a simulation an amplitude, so it is asked where
//! the loop contradicts the balance.

use super::bank;
use super::bench::{Bench, Score, plausible, rms};
use super::hypothesis_fit::HypothesisFit;
use super::in_loop::Rig;
use super::loop_fit::{self, Bed, How, Knob, LoopFit, Noise};
use super::problem::{Column, Proof};
use super::regression::{Gram, Solution};
use super::result::Estimate;
use super::search::{MOST_FINDINGS, RIVAL_SHARE, RIVALS, keep_best_of_kind, least_evidence_of, same_kind};
use super::shape::{Hypothesis, Shape};
use super::terms;
use super::two_cores::on_two_cores;
use crate::plant::effects::{ParameterValue, PhysicsTerm};
use crate::plant::machine::AxisModel;
use crate::simulation::model_axis::{LANES, not_simulated};

/// What leaves less than this share of what the best one leaves is preferred to it.
const CLEARLY_LESS: f64 = 0.95;
/// Share of what is left that a finding must take to be one.
const LEAST_TAKEN: f64 = 0.03;
/// The same of all that the model as stated leaves: no law of a loud effect is exact.
const INEXACT: f64 = 2e-4;
/// A map can imitate a constant, a wave and more: it must leave this share of what those leave.
const MAP_LEAVES: f64 = 0.6;
/// A wave that turns with the direction is one that does not where the axis goes one way.
const TURNS: f64 = 0.95;
/// Times that a mass or stiffness can be off.
const MOST_OFF: f64 = 1.6;
/// Waves read off what is left, of each kind, and how often one must be passed to be a wave.
const WAVES: usize = 4;
const PASSED: f64 = 3.0;
/// Times the noise to which on nothing is exchanged, and the share of what the stated model leaves from which
/// on it would not help.
const NEAR_NOISE: f64 = 3.0;
const WORTH_MORE: f64 = 0.4;

/// A finding of the loop.
pub(super) struct Finding {
    /// The law and its amplitudes.
    pub(super) hypothesis: Hypothesis,
    pub(super) amplitudes: Vec<f64>,
    pub(super) term: PhysicsTerm,
    pub(super) parameters: Vec<Estimate>,
    /// Everything that was tried in its round, best first.
    pub(super) scores: Vec<Score>,
    /// What the loop leaves of the thrust without it and with it, N.
    pub(super) left_n: [f64; 2],
}

/// What the loop says is missing.
pub(super) struct Told {
    pub(super) axis: AxisModel,
    /// Numbers: key, value, standard deviation.
    pub(super) numbers: Vec<(&'static str, f64, f64)>,
    pub(super) findings: Vec<Finding>,
}

/// What a round tries.
#[derive(Clone, Copy, PartialEq)]
enum Bank {
    All,
    Waves,
}

/// A law that was taken up.
#[derive(Clone)]
struct Law {
    hypothesis: Hypothesis,
    scores: Vec<Score>,
}

/// A model fitted in the loop with the laws that were taken up, which stand last among its terms.
#[derive(Clone)]
struct Model {
    fit: LoopFit,
    laws: Vec<Law>,
    /// Weighted sum of squares that it leaves.
    loss: f64,
}

/// Looks for what is missing until only `noise_n` of thrust and stretch is left, or nothing takes more of
/// what is. `balance`: for waves to be read off, what it found as a model, and what was tried beside each.
/// `None`: the models ran away, or nothing was found.
pub(super) fn search(
    rig: &Rig<'_>,
    stated: &AxisModel,
    (balance, found, laws): (&Bench<'_>, &AxisModel, Vec<Vec<Score>>),
    noise_n: [f64; 2],
) -> Option<Told> {
    let bed = Bed::new(rig.problem(), true);
    let errors = rig.errors(&[loop_fit::finely_counted(stated)])?;
    let scales = noise_scales(errors.first()?);
    let noise = Noise::of_scales(&bed, scales);
    let stated_loss = bed.loss(&noise, errors.first()?);
    let eye = Eye { rig, stated, bed: &bed, noise, balance, stated_loss };
    let mut model = eye.started(found, laws)?;
    let stated_n = eye.thrust_left_n(stated)?;
    for _ in 0..2 {
        while model.laws.len() < MOST_FINDINGS && !rig.says_all(&model.fit.axis, Some(noise_n)) {
            let Some(next) = eye.round(&model, Bank::All) else { break };
            model = next;
        }
        model = eye.without_needless(model);
        let left_n = eye.thrust_left_n(&model.fit.axis)?;
        if !(NEAR_NOISE * noise_n[0]..WORTH_MORE * stated_n).contains(&left_n) {
            break;
        }
        let Some(other) = eye.exchanged(&model) else { break };
        model = other;
    }
    (!model.laws.is_empty()).then(|| eye.told(&model))?
}

/// Noise of thrust and stretch, of which neighbouring values share little: that of their differences.
fn noise_scales(errors: &Column) -> [f64; 2] {
    [0, 1].map(|side| {
        let series =
            errors.iter().filter_map(|s| if side == 0 { s.motor.as_ref() } else { s.stage.as_ref() });
        let (mut sum, mut count) = (0.0, 0.0);
        for x in series {
            sum += x.windows(2).map(|w| (w[1] - w[0]).powi(2)).sum::<f64>();
            count += x.len() as f64;
        }
        (0.5 * sum / f64::max(count, 1.0)).sqrt().max(f64::MIN_POSITIVE)
    })
}

/// What stays the same from round to round.
struct Eye<'a> {
    rig: &'a Rig<'a>,
    stated: &'a AxisModel,
    bed: &'a Bed,
    noise: Noise,
    balance: &'a Bench<'a>,
    /// What the model as stated leaves, weighted sum of squares.
    stated_loss: f64,
}

/// What a model leaves, beside what its numbers and laws would do.
struct Left {
    knobs: Vec<Knob>,
    errors: Column,
    columns: Vec<Vec<f64>>,
    target: Vec<f64>,
    gram: Gram,
    solution: Solution,
}

impl Model {
    fn ends_in_map(&self) -> bool {
        self.laws.last().is_some_and(|l| l.hypothesis.is_map())
    }
}

impl Eye<'_> {
    /// `axis` with its numbers and the last `laws.len()` of its terms fitted.
    fn fitted(&self, axis: &AxisModel, mut laws: Vec<Law>) -> Option<Model> {
        if !not_simulated(axis).is_empty() {
            return None;
        }
        // Weighted as its own errors ask for, a fit heeds a start from rest less, and a loud law, too.
        let fits = [None, Some(&self.noise)].map(|noise| {
            let fit = loop_fit::fit(self.rig, (self.stated, &[]), axis, How { noise, far: true })?;
            let errors = self.rig.errors(&[loop_fit::finely_counted(&fit.axis)])?;
            Some((self.bed.loss(&self.noise, errors.first()?), fit))
        });
        let fits = fits.into_iter().flatten().filter(|(_, fit)| self.is_this_machine(&fit.axis));
        let (loss, fit) = fits.min_by(|a, b| a.0.total_cmp(&b.0))?;
        for (law, term) in laws.iter_mut().zip(&fit.axis.physics[self.stated.physics.len()..]) {
            law.hypothesis = terms::hypothesis(self.rig.problem(), term)?.0;
        }
        Some(Model { fit, laws, loss })
    }

    /// True where masses and stiffness are not another machine's.
    fn is_this_machine(&self, axis: &AxisModel) -> bool {
        let near = |key: &&str| {
            let numbers = axis.drive.number(key).zip(self.stated.drive.number(key));
            numbers.is_none_or(|(now, stated)| (1.0 / MOST_OFF..MOST_OFF).contains(&(now / stated)))
        };
        ["rotary_inertia_kg_m2", "movable_mass_kg", "axial_stiffness_n_m"].iter().all(near)
    }

    /// The model as stated, or what the balance found where that leaves less.
    fn started(&self, found: &AxisModel, scores: Vec<Vec<Score>>) -> Option<Model> {
        let terms = &found.physics[self.stated.physics.len()..];
        let laws: Option<Vec<Law>> = terms
            .iter()
            .zip(scores)
            .map(|(t, scores)| Some(Law { hypothesis: terms::hypothesis(self.rig.problem(), t)?.0, scores }))
            .collect();
        let bare = (self.stated, Vec::new());
        let starts = [Some(bare), laws.filter(|l| l.len() == terms.len()).map(|laws| (found, laws))];
        let models = starts.into_iter().flatten().flat_map(|(axis, laws)| {
            [self.unfitted(axis, laws.clone()), self.fitted(axis, laws)].into_iter().flatten()
        });
        models.min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    fn unfitted(&self, axis: &AxisModel, laws: Vec<Law>) -> Option<Model> {
        if !not_simulated(axis).is_empty() {
            return None;
        }
        let errors = self.rig.errors(&[loop_fit::finely_counted(axis)])?;
        let fit = LoopFit { axis: axis.clone(), numbers: Vec::new(), pointless: Vec::new() };
        Some(Model { fit, laws, loss: self.bed.loss(&self.noise, errors.first()?) })
    }

    /// The model with another wave in the place of one: taken up before the others it may stand for its
    /// sibling at the other port.
    fn exchanged(&self, model: &Model) -> Option<Model> {
        let is_wave = |k: &usize| matches!(model.laws[*k].hypothesis.shape, Shape::Periodic { .. });
        let waves = (0..model.laws.len()).filter(is_wave);
        let others = waves.filter_map(|k| self.round(&self.without(model, k)?, Bank::Waves));
        others.filter(|m| self.takes_more(model, m)).min_by(|a, b| a.loss.total_cmp(&b.loss))
    }

    fn left(&self, axis: &AxisModel) -> Option<Left> {
        let knobs = loop_fit::knobs(axis, self.stated.physics.len(), true);
        let mut axes = vec![axis.clone()];
        axes.extend(knobs.iter().map(|k| k.turned(axis, k.change(axis))));
        let axes: Vec<AxisModel> = axes.iter().map(loop_fit::finely_counted).collect();
        let errors = self.rig.errors(&axes)?;
        let slopes = loop_fit::slopes(&knobs, axis, &errors);
        let known = knobs.iter().map(|k| k.known(self.stated, axis)).collect();
        let columns = self.bed.weighed(&self.noise, &slopes);
        let target = self.bed.weigh(&self.noise, &errors[0]);
        let gram = self.bed.gram(&columns, &target, known);
        let solution = gram.solve(&(0..columns.len()).collect::<Vec<_>>());
        let errors = errors.into_iter().next()?;
        Some(Left { knobs, errors, columns, target, gram, solution })
    }

    /// The model with one law more; `None`: nothing takes more of what is left.
    fn round(&self, model: &Model, from: Bank) -> Option<Model> {
        let axis = &model.fit.axis;
        let left = self.left(axis)?;
        let scores = self.scores(axis, &left, (&model.laws, from));
        let least = least_evidence_of(self.bed.samples(), Proof::Usual);
        let most = scores.first().filter(|s| s.plausible).map_or(0.0, |s| s.evidence);
        let near = |s: &&Score| s.plausible && s.evidence > least.max(RIVAL_SHARE * most);
        let rivals: Vec<Score> = scores.iter().filter(near).take(RIVALS).cloned().collect();
        let fits = rivals.iter().filter_map(|score| {
            let mut with = self.moved(axis, &left, &score.hypothesis);
            with.physics.push(self.term(score));
            let law = Law { hypothesis: score.hypothesis.clone(), scores: Vec::new() };
            let model = self.fitted(&with, [model.laws.as_slice(), &[law]].concat())?;
            model.fit.pointless.is_empty().then_some((score, model))
        });
        let fits: Vec<(&Score, Model)> = fits.collect();
        let ranked = |m: &Model| if m.ends_in_map() { m.loss / MAP_LEAVES } else { m.loss };
        let least = fits.iter().map(|f| ranked(&f.1)).fold(f64::INFINITY, f64::min);
        let best = fits.iter().position(|f| CLEARLY_LESS * ranked(&f.1) <= least)?;
        let losses: Vec<(&Score, f64)> = fits.iter().map(|(score, m)| (*score, ranked(m))).collect();
        let tried = self.restated(&scores, &losses, best);
        let (_, mut next) = fits.into_iter().nth(best)?;
        next.laws.last_mut()?.scores = tried;
        self.takes_more(model, &next).then_some(next)
    }

    /// Scores with the best of those that were fitted in front, and these as far behind as they leave more.
    fn restated(&self, scores: &[Score], fitted: &[(&Score, f64)], best: usize) -> Vec<Score> {
        let most = scores.iter().map(|s| s.evidence).fold(0.0, f64::max);
        let n = self.bed.samples() as f64;
        let (chosen, loss) = fitted[best];
        let others = scores.iter().filter(|s| !same_kind(&s.hypothesis, &chosen.hypothesis)).map(|s| {
            let behind = fitted.iter().find(|f| same_kind(&f.0.hypothesis, &s.hypothesis));
            let evidence = behind.map_or(s.evidence, |f| (most - n * (f.1 / loss).ln()).clamp(0.0, most));
            Score { evidence, ..s.clone() }
        });
        std::iter::once(Score { evidence: most, ..chosen.clone() }).chain(others).collect()
    }

    /// True where `next` leaves less than `model` by more than a share of it, and than how exact the laws of
    /// all that was loud are.
    fn takes_more(&self, model: &Model, next: &Model) -> bool {
        let taken = model.loss - next.loss;
        taken > LEAST_TAKEN * model.loss && taken > INEXACT * self.stated_loss
    }

    /// Hypotheses that run in this loop, each with what it takes of what is left; best first.
    fn scores(&self, axis: &AxisModel, left: &Left, (laws, from): (&[Law], Bank)) -> Vec<Score> {
        let p = self.rig.problem();
        let mut bank = bank::of(self.balance);
        bank.extend(bank::wavelengths(p, &left.errors, WAVES));
        let longest_m = (terms::travel_m(p) / PASSED).max(1.01 * p.drive.screw_lead_m().unwrap_or(0.0));
        bank.retain(|h| !matches!(h.shape, Shape::Periodic { wavelength_m, .. } if wavelength_m > longest_m));
        bank.retain(|h| {
            let number = matches!(h.shape, Shape::Smoothing { .. } | Shape::Lines { .. })
                || matches!(h.shape, Shape::Delay { extra_s } if extra_s < 0.0);
            let asked = from == Bank::All || matches!(h.shape, Shape::Periodic { .. });
            asked && !number && !laws.iter().any(|law| same_kind(&law.hypothesis, h))
        });
        let (sizes, columns) = self.columns(axis, &left.errors, &bank);
        let tried = bank.iter().zip(sizes.iter().zip(&columns)).filter(|(_, (s, c))| c.len() == s.len());
        let mut scores: Vec<Score> =
            tried.map(|(h, (sizes, columns))| self.score(left, h, (sizes, columns))).collect();
        keep_best_of_kind(&mut scores);
        scores
    }

    /// Of each hypothesis the amplitudes that it is run with, and what each of them changes, weighed; fewer
    /// where it does not run in this loop.
    fn columns(
        &self,
        axis: &AxisModel,
        errors: &Column,
        bank: &[Hypothesis],
    ) -> (Vec<Vec<f64>>, Vec<Vec<Vec<f64>>>) {
        let p = self.rig.problem();
        let left_n = rms(errors);
        let sizes: Vec<Vec<f64>> = bank.iter().map(|h| self.sizes(h, left_n)).collect();
        let mut runs: Vec<(usize, AxisModel)> = Vec::new();
        for (at, (h, sizes)) in bank.iter().zip(&sizes).enumerate() {
            for k in 0..sizes.len() {
                let mut alone = vec![0.0; sizes.len()];
                alone[k] = sizes[k];
                let mut with = loop_fit::finely_counted(axis);
                with.physics.push(terms::term(p, h, &HypothesisFit::exact(h, alone)));
                if not_simulated(&with).is_empty() {
                    runs.push((at, with));
                }
            }
        }
        let chunks: Vec<&[(usize, AxisModel)]> = runs.chunks(LANES).collect();
        let changes = on_two_cores(&chunks, |chunk| self.changes(chunk, errors));
        let mut columns: Vec<Vec<Vec<f64>>> = vec![Vec::new(); bank.len()];
        for (at, change) in changes.into_iter().flatten() {
            columns[at].push(change);
        }
        (sizes, columns)
    }

    /// The model with its numbers and laws where they are best beside a further law.
    fn moved(&self, axis: &AxisModel, left: &Left, h: &Hypothesis) -> AxisModel {
        let (_, columns) = self.columns(axis, &left.errors, std::slice::from_ref(h));
        let solution = left.beside(&columns[0], self.bed);
        let steps = left.knobs.iter().zip(&solution.coefficients);
        steps.fold(axis.clone(), |axis, (knob, step)| {
            let trust = knob.trust(&axis, self.bed);
            knob.turned(&axis, step.clamp(-trust, trust))
        })
    }

    /// Amplitudes that move about as much force as is left.
    fn sizes(&self, h: &Hypothesis, left_n: f64) -> Vec<f64> {
        if h.shape.unit() || matches!(h.shape, Shape::Presliding { .. }) {
            return vec![1.0];
        }
        let columns = h.columns(self.rig.problem());
        columns.iter().map(|c| left_n / rms(c).max(1e-300)).collect()
    }

    /// What models change of the errors, weighed; without those that run away.
    fn changes(&self, runs: &[(usize, AxisModel)], errors: &Column) -> Vec<(usize, Vec<f64>)> {
        let axes: Vec<AxisModel> = runs.iter().map(|r| r.1.clone()).collect();
        let all = self.rig.errors(&axes).map_or_else(
            || axes.iter().map(|a| Some(self.rig.errors(std::slice::from_ref(a))?.remove(0))).collect(),
            |all| all.into_iter().map(Some).collect::<Vec<_>>(),
        );
        let change = |with: &Column| {
            let mut change = errors.clone();
            super::bench::add(&mut change, with, -1.0);
            self.bed.weigh(&self.noise, &change)
        };
        runs.iter().zip(&all).filter_map(|((at, _), with)| Some((*at, change(with.as_ref()?)))).collect()
    }

    fn score(&self, left: &Left, h: &Hypothesis, (sizes, columns): (&[f64], &[Vec<f64>])) -> Score {
        let known = left.columns.len();
        let solution = left.beside(columns, self.bed);
        let n = self.bed.samples() as f64;
        let gain = |before: f64, after: f64| n * (before / after.max(1e-300)).ln();
        let of =
            |values: &[f64]| -> Vec<f64> { values[known..].iter().zip(sizes).map(|(c, s)| c * s).collect() };
        let amplitudes = of(&solution.coefficients);
        let turns = matches!(h.shape, Shape::Periodic { flips: true, .. });
        let evidence = gain(left.solution.heldout, solution.heldout);
        Score {
            evidence: if turns { TURNS * evidence } else { evidence },
            likelihood: gain(left.solution.left, solution.left),
            plausible: plausible(h, &amplitudes),
            deviations: of(&solution.deviations),
            unit_rms_n: 0.0,
            hypothesis: h.clone(),
            amplitudes,
        }
    }

    /// The law of a score, as it is tried, as a term.
    fn term(&self, score: &Score) -> PhysicsTerm {
        let (h, amplitudes) = (&score.hypothesis, &score.amplitudes);
        let shape = h.shape.absorb(amplitudes[0]);
        let amplitudes = if h.shape.unit() { vec![1.0] } else { amplitudes.clone() };
        let h = Hypothesis { shape, ..h.clone() };
        terms::term(self.rig.problem(), &h, &HypothesisFit::exact(&h, amplitudes))
    }

    /// Takes out what the others do as well without.
    fn without_needless(&self, mut model: Model) -> Model {
        while model.laws.len() > 1 {
            let places: Vec<usize> = (0..model.laws.len()).collect();
            let fits = places.iter().filter_map(|k| self.without(&model, *k));
            let Some(best) = fits.min_by(|a, b| a.loss.total_cmp(&b.loss)) else { break };
            if self.takes_more(&best, &model) {
                break;
            }
            model = best;
        }
        model
    }

    fn without(&self, model: &Model, k: usize) -> Option<Model> {
        let (mut axis, mut laws) = (model.fit.axis.clone(), model.laws.clone());
        axis.physics.remove(self.stated.physics.len() + k);
        laws.remove(k);
        self.fitted(&axis, laws)
    }

    fn thrust_left_n(&self, axis: &AxisModel) -> Option<f64> {
        let mut errors = self.rig.errors(&[loop_fit::finely_counted(axis)])?.remove(0);
        errors.iter_mut().for_each(|s| s.stage = None);
        Some(rms(&errors))
    }

    fn told(&self, model: &Model) -> Option<Told> {
        let p = self.rig.problem();
        let axis = &model.fit.axis;
        let left = self.left(axis)?;
        let with_n = self.thrust_left_n(axis)?;
        let given = self.stated.physics.len();
        let mut findings = Vec::new();
        for (k, law) in model.laws.iter().enumerate() {
            let term = axis.physics[given + k].clone();
            let (hypothesis, amplitudes) = terms::hypothesis(p, &term)?;
            let without_n = self.thrust_left_n(&self.without(model, k)?.fit.axis)?;
            let mut parameters =
                terms::estimates(p, &hypothesis, &HypothesisFit::exact(&hypothesis, amplitudes.clone()));
            for e in &mut parameters {
                widen(e, left.deviation(axis, (given + k, &e.name)));
            }
            findings.push(Finding {
                hypothesis,
                amplitudes,
                term,
                parameters,
                scores: law.scores.clone(),
                left_n: [without_n, with_n],
            });
        }
        Some(Told { axis: axis.clone(), numbers: model.fit.numbers.clone(), findings })
    }
}

impl Left {
    /// The fit with further columns, whose amplitudes stand last.
    fn beside(&self, columns: &[Vec<f64>], bed: &Bed) -> Solution {
        let all: Vec<&[f64]> = self.columns.iter().chain(columns).map(Vec::as_slice).collect();
        let gram = self.gram.with(&all, &self.target, bed.folds());
        gram.solve(&(0..all.len()).collect::<Vec<_>>())
    }

    /// Deviation of a parameter of a term; zero where it was not fitted.
    fn deviation(&self, axis: &AxisModel, (term, name): (usize, &str)) -> f64 {
        let of = |(knob, deviation): (&Knob, &f64)| match knob {
            Knob::Law(t, place, unit) if *t == term && axis.physics[term].parameters[*place].0 == name => {
                let ParameterValue::Number(value) = axis.physics[term].parameters[*place].1 else {
                    return None;
                };
                Some(deviation * unit.unwrap_or(if name == "phase_rad" { 1.0 } else { value }).abs())
            }
            _ => None,
        };
        self.knobs.iter().zip(&self.solution.deviations).find_map(of).unwrap_or(0.0)
    }
}

/// Widens an interval by a deviation.
fn widen(e: &mut Estimate, deviation: f64) {
    let more = terms::half_width(deviation);
    let half = (e.ci95[1] - e.value).hypot(more);
    e.ci95 = [e.value - half, e.value + half];
}

#[cfg(test)]
mod tests {
    use super::super::problem::Sides;
    use super::*;

    #[test]
    fn a_slow_error_is_no_noise() {
        let mut noise = super::super::chance::normal(11);
        let series: Vec<f64> =
            (0..20_000).map(|k| 9.0 * (0.01 * f64::from(k)).sin() + 0.3 * noise()).collect();
        let quiet = series.iter().map(|x| 0.1 * x).collect();
        let [thrust_n, stretch_n] = noise_scales(&vec![Sides { motor: Some(series), stage: Some(quiet) }]);
        // The wave's own differences add (9 * 0.01)^2 / 4 to 0.3^2.
        let expected_n = (0.09_f64 + 0.25 * 0.09 * 0.09).sqrt();
        assert!((thrust_n / expected_n - 1.0).abs() < 0.02, "{thrust_n} N");
        assert!((stretch_n / thrust_n - 0.1).abs() < 1e-9);
    }

    #[test]
    fn a_deviation_widens_an_interval_by_its_share() {
        let mut e = Estimate { name: "force_n".to_owned(), value: 5.0, unit: "N", ci95: [4.7, 5.3] };
        widen(&mut e, 0.4 / terms::half_width(1.0));
        assert!((e.ci95[0] - 4.5).abs() < 1e-12 && (e.ci95[1] - 5.5).abs() < 1e-12, "{e:?}");
    }
}
