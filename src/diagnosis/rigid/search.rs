//! Forward selection over the laws of one position, judged on stretches that were not fitted.

use super::fit::{Fit, Judged, Rows, Sums, correlation_rows};
use super::laws::{Law, Scales, Slider, candidates, drifts, gaps};
use super::signals::Series;
use crate::diagnosis::bank::{strongest_lines, when};
use crate::diagnosis::search::MAP_CREDIT;
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::effects::{EffectKind, Port};
use std::borrow::Cow;

/// Findings of one diagnosis.
const MOST_FINDINGS: usize = 7;
/// Chance at which a law may enter a model that needs none: the evidence it must bring is 2 ln(laws tried /
/// this).
const CHANCE: f64 = 1.0e-3;
/// Share by which the held-out residual must fall.
const LEAST_SHARE: f64 = 0.01;
/// The same where an axis of two sides is seen from one: the other side's own motion stands in the residual,
/// and what imitates a part of it is no finding.
const LEAST_SHARE_LUMPED: f64 = 0.1;

/// Columns of the terms in the model, with their products.
struct Beside {
    columns: Vec<Vec<f64>>,
    sums: Sums,
}

/// A law in the model with where it comes from.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Term {
    pub(super) law: Law,
    pub(super) origin: Origin,
}

/// Why a law is in the model.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Origin {
    /// A number of the drive.
    Number(&'static str),
    /// A physics table of the model, by its place.
    Given(usize),
    /// Something that every balance has and nobody asks about.
    Nuisance,
    /// Found here.
    Found(Found),
}

/// How a law was found.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Found {
    pub(super) evidence: f64,
    pub(super) heldout_before_n: f64,
    pub(super) probability: f64,
    pub(super) alternatives: Vec<(EffectKind, Port, f64)>,
}

/// The search and everything it knows.
pub(super) struct Search {
    pub(super) series: Vec<Series>,
    pub(super) scales: Scales,
    pub(super) rows: Rows,
    pub(super) terms: Vec<Term>,
    pub(super) locked: bool,
    /// Stated stiffness of a locked axis.
    pub(super) stiffness_n_m: f64,
    pub(super) tried: Vec<(EffectKind, Port, f64)>,
    /// Rows that count as independent; see [`Search::count_independent`].
    pub(super) independent: f64,
    /// Evidence that a law must bring.
    pub(super) least_evidence: f64,
}

impl Search {
    /// Columns of one law over all recordings, end to end.
    pub(super) fn columns(&self, law: Law) -> Vec<Vec<f64>> {
        let mut all: Vec<Vec<f64>> = Vec::new();
        for s in &self.series {
            let part = law.columns(s, &self.scales);
            if all.is_empty() {
                all = part;
            } else {
                for (whole, new) in all.iter_mut().zip(part) {
                    whole.extend(new);
                }
            }
        }
        all
    }

    fn all_columns(&self, terms: &[Term]) -> Vec<Vec<f64>> {
        terms.iter().flat_map(|t| self.columns(t.law)).collect()
    }

    /// Target and free columns of a set of terms, and the place of a spring that is not free.
    ///
    /// Where the output is locked, the spring keeps the stiffness that the model states: left free, a spring
    /// twenty times too soft would stand in for play.
    fn free(&self, terms: &[Term]) -> (Cow<'_, [f64]>, Vec<Vec<f64>>, Option<usize>) {
        let spring = terms.iter().position(|t| matches!(t.law, Law::Spring { .. })).filter(|_| self.locked);
        let Some(index) = spring else {
            return (Cow::Borrowed(&self.rows.target), self.all_columns(terms), None);
        };
        let mut target = self.rows.target.clone();
        for column in self.columns(terms[index].law).iter().take(1) {
            target.iter_mut().zip(column).for_each(|(y, x)| *y -= x * self.stiffness_n_m);
        }
        let mut others = terms.to_vec();
        others.remove(index);
        (Cow::Owned(target), self.all_columns(&others), spring)
    }

    /// Fit of a set of terms.
    pub(super) fn fit(&self, terms: &[Term]) -> Fit {
        let (target, columns, spring) = self.free(terms);
        let mut fit = self.rows.fit_to(&target, &columns);
        if let Some(index) = spring {
            // Terms before the spring have one column each; waves, which have two, a locked output has not.
            fit.coefficients.insert(index, self.stiffness_n_m);
            fit.deviations.insert(index, 0.0);
        }
        fit
    }

    /// What is left of each stretch by a fit of the terms to the others.
    pub(super) fn heldout(&self, terms: &[Term]) -> Vec<f64> {
        let (target, columns, _) = self.free(terms);
        self.rows.heldout(&target, &columns)
    }

    /// Columns of terms with their products, beside which a law is tried.
    fn beside(&self, terms: &[Term]) -> Beside {
        let columns = self.all_columns(terms);
        Beside { sums: self.rows.sums(&self.rows.target, &columns), columns }
    }

    /// The fit of the terms with a law, whose coefficients stand last.
    fn judged(&self, beside: &Beside, law: Law) -> Judged {
        if self.locked || self.terms.iter().any(|t| law.replaces(t.law)) {
            let Fit { coefficients, heldout_rms, rms, .. } = self.fit(&self.with(law));
            return Judged { coefficients, heldout_rms, rms };
        }
        let new = self.columns(law);
        self.rows.more(&beside.sums, &self.rows.target, (&beside.columns, &new)).judged()
    }

    /// Amplitudes of term `index` inside a fit of `terms`.
    pub(super) fn amplitudes(&self, terms: &[Term], values: &[f64], index: usize) -> Vec<f64> {
        let start: usize = terms[..index].iter().map(|t| t.law.width()).sum();
        values[start..start + terms[index].law.width()].to_vec()
    }

    fn slider(&self) -> Slider {
        let mut states =
            self.terms.iter().filter_map(|t| if let Law::Friction(s) = t.law { Some(s) } else { None });
        states.next_back().unwrap_or(Slider::STEP)
    }

    /// The terms with `law` added, and without what it replaces.
    fn with(&self, law: Law) -> Vec<Term> {
        let mut terms: Vec<Term> = self.terms.iter().filter(|t| !law.replaces(t.law)).cloned().collect();
        terms.push(found(law));
        terms
    }

    /// Adds laws until none earns its place, then drops what the later ones made idle.
    pub(super) fn run(&mut self) {
        self.count_independent();
        for round in 0..MOST_FINDINGS {
            if !self.round(round == 0) {
                break;
            }
        }
        self.prune();
    }

    /// Independent rows, from what is left when every family of laws is in the model at once.
    ///
    /// Counted on a residual that still holds an effect, neighbouring rows would look like one row and the
    /// effect would hide itself.
    fn count_independent(&mut self) {
        let (fast, stroke) = (self.scales.fastest_m_s, self.scales.stroke_m);
        let mut laws = vec![Law::Constant, Law::Friction(Slider::STEP)];
        laws.extend([0.01, 0.03, 0.1].map(|y| Law::Friction(Slider::soft(y * stroke, false))));
        laws.extend([0.1, 0.2].map(|g| Law::Friction(Slider::behind_gap(0.05 * stroke, g * stroke))));
        if self.locked {
            laws.push(Law::Cubic { centre_m: self.centre() });
            laws.extend((1..=6).map(|k| Law::Wave { wavelength_m: 2.0 * stroke / f64::from(k) }));
        } else {
            laws.extend([
                Law::Viscous,
                Law::DirectionalDry(Slider::STEP),
                Law::DirectionalViscous,
                Law::Square,
            ]);
            laws.extend([0.02, 0.06, 0.2].map(|v| Law::Stribeck { velocity_m_s: v * fast }));
        }
        let mut terms = self.terms.clone();
        if self.locked {
            self.closest_gap(&mut terms);
        }
        terms.extend(laws.into_iter().map(|law| Term { law, origin: Origin::Nuisance }));
        let residual = self.fit(&terms).residual;
        self.independent = self.rows.target.len() as f64 / correlation_rows(&residual);
    }

    /// Puts the gap that leaves least in the place of the spring without one.
    fn closest_gap(&self, terms: &mut [Term]) {
        let Some(index) = terms.iter().position(|t| matches!(t.law, Law::Spring { .. })) else { return };
        let mut trial = terms.to_vec();
        trial.push(found(Law::Friction(Slider::STEP)));
        let mut best = (self.fit(&trial).rms, terms[index].law);
        for law in gaps(self.scales.stroke_m, self.centre()) {
            trial[index].law = law;
            let left = self.fit(&trial).rms;
            if left < best.0 {
                best = (left, law);
            }
        }
        terms[index].law = best.1;
    }

    fn round(&mut self, first: bool) -> bool {
        let before = self.fit(&self.terms);
        let centre = self.centre();
        let mut laws = candidates(&self.scales, self.slider(), self.locked, centre);
        if !self.locked && self.terms.iter().any(|t| matches!(t.law, Law::Friction(_))) {
            laws.extend(drifts(self.slider()));
        }
        if !self.locked {
            laws.extend(self.cuts(&before.residual));
        }
        self.least_evidence = 2.0 * (laws.len() as f64 / CHANCE).ln();
        laws.retain(|law| !self.terms.iter().any(|t| t.law == *law || poorer(*law, t.law)));
        let beside = self.beside(&self.terms);
        let fits = on_two_cores(&laws, |law| self.judged(&beside, *law));
        let mut scored: Vec<(Law, Judged)> = laws.into_iter().zip(fits).collect();
        scored.retain(|(law, fit)| law.plausible(&fit.coefficients[fit.coefficients.len() - law.width()..]));
        // Friction that turns at once is no presliding, however much sharper that is than the stated turn.
        let at_once = Law::Friction(Slider::soft(0.01 * self.scales.least_yield_m(), true));
        let at_once_n = self.judged(&beside, at_once).heldout_rms;
        scored.retain(|(law, fit)| {
            !matches!(law, Law::Friction(s) if s.yield_m > 0.0 && s.gap_m <= 0.0)
                || fit.heldout_rms < (1.0 - LEAST_SHARE) * at_once_n
        });
        let left = |(law, fit): &(Law, Judged)| (fit.heldout_rms / before.heldout_rms).powf(credit(*law));
        scored.sort_by(|a, b| left(a).total_cmp(&left(b)));
        let Some((best, fit)) = scored.first() else { return self.pair(&before) };
        let independent = self.independent;
        let evidence = |f: &Judged| 2.0 * independent * (before.heldout_rms / f.heldout_rms).ln();
        let ranking = by_effect(scored.iter().map(|(law, f)| (law.effect(), credit(*law) * evidence(f))));
        if first {
            self.tried = ranking.iter().map(|((e, p), v)| (*e, *p, v.max(0.0))).collect();
        }
        if evidence(fit) < self.least_evidence
            || fit.heldout_rms > (1.0 - self.least_share()) * before.heldout_rms
        {
            return self.pair(&before);
        }
        let law = self.refined(*best);
        let (probability, alternatives) = shares(&ranking, law.effect());
        let found = Found {
            evidence: evidence(fit),
            heldout_before_n: before.heldout_rms,
            probability,
            alternatives,
        };
        let mut terms = self.with(law);
        if let Some(last) = terms.last_mut() {
            last.origin = Origin::Found(found);
        }
        self.keep_history(&mut terms);
        self.terms = terms;
        true
    }

    fn least_share(&self) -> f64 {
        if self.stiffness_n_m > 0.0 && !self.locked { LEAST_SHARE_LUMPED } else { LEAST_SHARE }
    }

    /// Cuts whose lines stand in a residual.
    fn cuts(&self, residual: &[f64]) -> Vec<Law> {
        /// A line throughout a recording is not told from what is wrong about its own motion.
        const MOST_OF_IT: f64 = 0.9;
        /// Harmonics that are tried.
        const HARMONICS: [usize; 2] = [1, 4];
        let mut start = 0;
        let mut list = Vec::new();
        for s in &self.series {
            let part = &residual[start..start + s.t_s.len()];
            start += part.len();
            for (_, fundamental_hz) in strongest_lines(part, s.rate_hz) {
                let Some((from, to)) = when(part, s.rate_hz, fundamental_hz) else { continue };
                let whole_s = s.t_s.len() as f64 / s.rate_hz;
                if to - from > MOST_OF_IT * whole_s {
                    continue;
                }
                let window_s = [s.t_s[0] + from, s.t_s[0] + to];
                for harmonics in HARMONICS.into_iter().filter(|h| *h as f64 * fundamental_hz < s.band_hz) {
                    let of = |recording| Law::Cut { fundamental_hz, harmonics, window_s, recording };
                    list.extend([of(Some(s.recording)), of(None)]);
                }
            }
        }
        list
    }

    /// Two plain laws at once, where neither alone shows: friction that is there in one direction only.
    fn pair(&mut self, before: &Fit) -> bool {
        if self.locked {
            return false;
        }
        let slider = self.slider();
        let plain = [
            Law::Friction(Slider::STEP),
            Law::Constant,
            Law::DirectionalDry(slider),
            Law::Viscous,
            Law::DirectionalViscous,
        ];
        let absent = |l: &Law| !self.terms.iter().any(|t| t.law == *l || poorer(*l, t.law));
        let plain: Vec<Law> = plain.into_iter().filter(absent).collect();
        let mut scored: Vec<([Law; 2], Fit)> = Vec::new();
        for (k, a) in plain.iter().enumerate() {
            for b in &plain[k + 1..] {
                let terms: Vec<Term> = self.terms.iter().cloned().chain([found(*a), found(*b)]).collect();
                let fit = self.fit(&terms);
                let n = terms.len();
                let good = |i: usize, law: Law| law.plausible(&self.amplitudes(&terms, &fit.coefficients, i));
                if good(n - 2, *a) && good(n - 1, *b) {
                    scored.push(([*a, *b], fit));
                }
            }
        }
        scored.sort_by(|a, b| a.1.heldout_rms.total_cmp(&b.1.heldout_rms));
        let Some(([a, b], fit)) = scored.first() else { return false };
        let evidence = |f: &Fit| 2.0 * self.independent * (before.heldout_rms / f.heldout_rms).ln();
        let least = 2.0 * (plain.len() as f64 * plain.len() as f64 / CHANCE).ln();
        if evidence(fit) < least || fit.heldout_rms > (1.0 - self.least_share()) * before.heldout_rms {
            return false;
        }
        let top = evidence(fit);
        // What stands in for one of the two while the other stays.
        let rivals = |keep: Law, instead_of: Law| -> Vec<Scored> {
            let with = scored.iter().filter(|(p, _)| p.contains(&keep));
            let other = |p: &[Law; 2]| if p[0] == keep { p[1] } else { p[0] };
            let list = with.map(|(p, f)| (other(p).effect(), evidence(f)));
            by_effect(list.chain([(instead_of.effect(), top)]))
        };
        let new: Vec<Term> = [(*a, *b), (*b, *a)]
            .map(|(law, keep)| {
                let (probability, alternatives) = shares(&rivals(keep, law), law.effect());
                let heldout_before_n = before.heldout_rms;
                Term {
                    law,
                    origin: Origin::Found(Found {
                        evidence: top,
                        heldout_before_n,
                        probability,
                        alternatives,
                    }),
                }
            })
            .into();
        self.terms.extend(new);
        true
    }

    /// A slider that takes the place of a poorer one inherits what that one had shown.
    fn keep_history(&self, terms: &mut [Term]) {
        let Some(last) = terms.last_mut() else { return };
        let replaced = self.terms.iter().find(|t| last.law.replaces(t.law));
        if let (Some(Term { origin: Origin::Found(old), .. }), Origin::Found(new)) =
            (replaced, &mut last.origin)
        {
            new.evidence += old.evidence;
            new.heldout_before_n = old.heldout_before_n;
        }
    }

    /// Inner constants moved in shrinking steps while the fit improves.
    fn refined(&self, law: Law) -> Law {
        let beside = self.beside(&self.terms);
        let mut best = (law, self.judged(&beside, law).rms);
        for by in [0.4, 0.2, 0.1, 0.05, 0.02] {
            for _ in 0..6 {
                let better = best
                    .0
                    .neighbours(by)
                    .into_iter()
                    .map(|n| (n, self.judged(&beside, n).rms))
                    .filter(|(_, r)| *r < best.1)
                    .min_by(|a, b| a.1.total_cmp(&b.1));
                let Some(found) = better else { break };
                best = found;
            }
        }
        best.0
    }

    fn prune(&mut self) {
        let mut index = 0;
        while index < self.terms.len() {
            let is_found = matches!(self.terms[index].origin, Origin::Found(_));
            if is_found && self.idle(index) {
                self.terms.remove(index);
            } else {
                index += 1;
            }
        }
    }

    fn idle(&self, index: usize) -> bool {
        let with = self.fit(&self.terms);
        let mut fewer = self.terms.clone();
        fewer.remove(index);
        let without = self.fit(&fewer);
        2.0 * self.independent * (without.heldout_rms / with.heldout_rms).ln() < 0.5 * self.least_evidence
    }

    /// Middle of the travel, where a locked output has its gap.
    fn centre(&self) -> f64 {
        let [a, b] = self
            .series
            .iter()
            .flat_map(|s| &s.position_m)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |e, x| [e[0].min(*x), e[1].max(*x)]);
        0.5 * (a + b)
    }

    /// Values of an inner constant that the data cannot refuse: twice the loss in log-likelihood below 3.84.
    ///
    /// A profile, not a curvature: a gap or a yield is no smooth parameter.
    pub(super) fn profile(&self, index: usize, make: impl Fn(f64) -> Law, at: f64) -> [f64; 2] {
        let best = self.fit(&self.terms);
        // The interval is about the answer as it stands: what is still left in it makes rows alike.
        let independent = self.rows.target.len() as f64 / correlation_rows(&best.residual);
        let loss = |value: f64| {
            let mut terms = self.terms.clone();
            terms[index].law = make(value);
            2.0 * independent * (self.fit(&terms).rms / best.rms).ln()
        };
        let edge = |up: bool| {
            let mut last = at;
            for k in 1..=40 {
                let factor = 1.0 + 0.01 * 1.12_f64.powi(k);
                let value = if up { at * factor } else { at / factor };
                if loss(value) > 3.84 {
                    return value;
                }
                last = value;
            }
            last
        };
        [edge(false), edge(true)]
    }
}

/// Share of its evidence that counts.
fn credit(law: Law) -> f64 {
    if matches!(law, Law::Map { .. }) { MAP_CREDIT } else { 1.0 }
}

/// A law that is tried.
fn found(law: Law) -> Term {
    let found = Found { evidence: 0.0, heldout_before_n: 0.0, probability: 1.0, alternatives: Vec::new() };
    Term { law, origin: Origin::Found(found) }
}

/// True where `law` is a poorer form of one that is already in the model.
fn poorer(law: Law, present: Law) -> bool {
    match (law, present) {
        (Law::Friction(a), Law::Friction(b)) => b.gap_m > 0.0 || (b.yield_m > 0.0 && a.gap_m <= 0.0),
        (Law::Spring { .. }, Law::Spring { gap_m, .. }) => gap_m > 0.0,
        (Law::Stribeck { .. }, Law::Stribeck { .. }) | (Law::Drift { .. }, Law::Drift { .. }) => true,
        (Law::Interpolation { .. }, Law::Interpolation { .. }) => true,
        (Law::Slow { .. } | Law::Late { .. }, Law::Slow { .. } | Law::Late { .. }) => true,
        (Law::DirectionalDry(_), Law::DirectionalDry(_)) | (Law::Map { .. }, Law::Map { .. }) => true,
        (Law::Cut { fundamental_hz: a, .. }, Law::Cut { fundamental_hz: b, .. }) => {
            (a / b - 1.0).abs() < 0.02
        }
        (Law::Wave { wavelength_m: a }, Law::Wave { wavelength_m: b }) => (a / b - 1.0).abs() < 0.02,
        _ => false,
    }
}

type Scored = ((EffectKind, Port), f64);

/// The best of each effect, best first.
fn by_effect(scores: impl Iterator<Item = Scored>) -> Vec<Scored> {
    let mut best: Vec<Scored> = Vec::new();
    for (effect, value) in scores {
        match best.iter_mut().find(|(e, _)| *e == effect) {
            Some((_, v)) => *v = v.max(value),
            None => best.push((effect, value)),
        }
    }
    best.sort_by(|a, b| b.1.total_cmp(&a.1));
    best
}

/// Probability of the chosen effect and of its alternatives: likelihood ratios among the best of each effect.
fn shares(ranking: &[Scored], chosen: (EffectKind, Port)) -> (f64, Vec<(EffectKind, Port, f64)>) {
    let top = ranking.first().map_or(0.0, |r| r.1);
    let weight = |v: f64| (0.5 * (v - top)).exp();
    let sum: f64 = ranking.iter().map(|r| weight(r.1)).sum();
    let share = |v: f64| weight(v) / sum.max(1.0e-300);
    let own = ranking.iter().find(|r| r.0 == chosen).map_or(1.0, |r| share(r.1));
    // A weight and a difference between the directions are told apart by little: the other is always named.
    // So are a delay and a lag, a wave and a map.
    let pairs = [
        [EffectKind::GravityLoad, EffectKind::AsymmetricFriction],
        [EffectKind::DeadTime, EffectKind::CurrentLoopLag],
        [EffectKind::PositionPeriodicForce, EffectKind::PositionDependentForce],
    ];
    let twin = |e: EffectKind| pairs.iter().any(|pair| pair.contains(&e) && pair.contains(&chosen.0));
    let others = ranking.iter().filter(|r| r.0 != chosen && (share(r.1) > 0.02 || twin(r.0.0)));
    (own, others.map(|r| (r.0.0, r.0.1, share(r.1))).collect())
}
