//! The cut as a subject of the one selection: screening by projected gain, fits with every number free.
//!
//! To first order, with N the whitened derivatives by the free numbers, j those of an effect's sizes and r
//! what the model leaves,
//!
//! gain = g' C^-1 g/2,  C = H_cc - H_cn H_nn^-1 H_nc,  g = g_c - H_cn H_nn^-1 g_n
//!
//! One Jacobian of the model serves all effects; only what an effect's own columns add is computed for each.

use super::super::selection::{Fitted, Screened, Subject, Work};
use super::super::two_cores::on_two_cores;
use super::adequacy::peaks;
use super::criteria::CRITERIA;
use super::fit::{Effort, Ended, Problem, Quadratic};
use super::laws::{Law, Term};
use super::machine::{Machine, Number, Point};
use super::observable::{Every, Observed, Part};
use crate::plant::effects::Port;
use nalgebra::{DMatrix, DVector};
use std::cell::{Cell, RefCell};

/// A model: a point of the fit with what it is worth.
#[derive(Debug, Clone)]
pub(crate) struct Model {
    /// Numbers and effects.
    pub(crate) point: Point,
    /// -ln L with priors, nats.
    pub(crate) value: f64,
    /// Of each effect how many of its coordinates the data determine.
    determined: Vec<f64>,
}

impl Model {
    fn of(ended: Ended) -> Self {
        Self { point: ended.point, value: ended.value, determined: ended.determined }
    }

    /// Price of effect `k`, nats: of each coordinate that the data determine, one at least, and of every
    /// further shape that was looked at.
    fn price_nats(&self, k: usize) -> f64 {
        let (Some(term), Some(of)) = (self.point.terms.get(k), self.determined.get(k)) else { return 0.0 };
        // A law that these cuts do not show at all is still a number more.
        CRITERIA.price_nats * of.max(1.0) + shapes_nats(term.law)
    }

    /// The same of the effect of a law.
    pub(crate) fn price_of(&self, law: Law) -> f64 {
        self.point.terms.iter().position(|t| t.law == law).map_or(0.0, |k| self.price_nats(k))
    }

    /// Price of its last effect.
    fn last_price_nats(&self) -> f64 {
        self.price_nats(self.point.terms.len().saturating_sub(1))
    }
}

/// Logarithm of the shapes from which a law is looked for.
fn shapes_nats(law: Law) -> f64 {
    (law.feet().len() as f64).ln()
}

/// What a law costs before it is fitted: all of its coordinates.
fn full_price_nats(law: Law) -> f64 {
    CRITERIA.price_nats * law.coordinates().len() as f64 + shapes_nats(law)
}

/// A law with the coordinates from which it is to be fitted, best first.
#[derive(Debug, Clone)]
pub(crate) struct Asked {
    /// Law.
    pub(crate) law: Law,
    /// Coordinates; once fitted those of the fit alone.
    pub(crate) starts: Vec<Vec<f64>>,
}

/// The cut as a subject of selection.
pub(crate) struct Cut<'a> {
    pub(crate) problem: &'a Problem<'a>,
    laws: Vec<Law>,
    pub(crate) rivals: usize,
    /// What every fit of a round is compared with: the model before it, refitted from wherever a hypothesis
    /// led.
    before: RefCell<Vec<Model>>,
    defended: RefCell<Vec<Defended>>,
    /// The most that a law of this round is worth so far, nats.
    leading_nats: Cell<f64>,
}

/// A law of a model against every rival in its place, all others of the model kept.
#[derive(Debug, Clone)]
pub(crate) struct Defended {
    /// Law.
    pub(crate) law: Law,
    /// What the model loses without it, less its price, nats.
    pub(crate) evidence_nats: f64,
    /// Rivals in its place with theirs.
    pub(crate) rivals: Vec<(Law, f64)>,
}

/// Screening looks at every second bin.
pub(crate) const SCREENED: Every = Every(2);
/// A first look: a few steps on every fourth bin from each start.
const LOOK: Effort = Effort { steps: 4, every: Every(4) };
/// The stated structure again, from the numbers that a hypothesis found.
pub(crate) const AGAIN: Effort = Effort { steps: 5, every: Every(1) };
/// Starts that are looked at of a law with several shapes.
const STARTS: usize = 4;

impl<'a> Cut<'a> {
    /// `laws`: those that are open; `rivals`: of how many a law that was taken up is challenged.
    pub(crate) fn new(problem: &'a Problem<'a>, laws: Vec<Law>, rivals: usize) -> Self {
        Self {
            problem,
            laws,
            rivals,
            before: RefCell::default(),
            defended: RefCell::default(),
            leading_nats: Cell::new(0.0),
        }
    }

    /// Laws that stood their ground after others had been taken up; of each the last time counts.
    pub(crate) fn defended(&self) -> Vec<Defended> {
        self.defended.borrow().clone()
    }

    /// The best that is known of the structure of a point: its value and where.
    fn before(&self, structure: &Point) -> Model {
        let laws = |p: &Point| p.terms.iter().map(|t| t.law).collect::<Vec<Law>>();
        let same = laws(structure);
        let known = self.before.borrow();
        let best = known.iter().filter(|b| laws(&b.point) == same).min_by(|a, b| a.value.total_cmp(&b.value));
        best.map_or_else(
            || Model { point: structure.clone(), value: f64::INFINITY, determined: Vec::new() },
            Model::clone,
        )
    }

    fn note(&self, model: &Model) {
        self.before.borrow_mut().push(model.clone());
    }

    /// The stated structure on every fourth bin.
    pub(crate) fn rough(&self, point: &Point, work: &mut Work) -> Option<Point> {
        let rough = self.problem.fit(point, &Effort { steps: 12, ..LOOK })?;
        work.spend(rough.evaluations / LOOK.every.0 as u64);
        Some(rough.point)
    }

    /// The stated structure fitted: where the selection begins.
    pub(crate) fn start(&self, point: &Point, work: &mut Work) -> Option<Model> {
        let rough = self.rough(point, work)?;
        let ended = self.problem.fit(&rough, &Effort::FULL)?;
        work.spend(ended.evaluations);
        let model = Model::of(ended);
        self.note(&model);
        Some(model)
    }

    /// What a law must be worth to be named, nats.
    pub(crate) fn level_nats(&self) -> f64 {
        let frame = self.problem.frame;
        if frame.has_table() && !frame.has_recordings() { CRITERIA.table_level_nats } else { level_nats() }
    }

    /// True where recordings may show what no screening of first order tells.
    fn unscreened(&self, law: Law) -> bool {
        law.is_of_second_order() && self.problem.frame.has_recordings()
    }

    /// The best that is known of a structure, fitted to the end.
    pub(crate) fn refined(&self, structure: &Point, work: &mut Work) -> Model {
        let best = self.before(structure);
        if work.is_spent() && best.value.is_finite() {
            return best;
        }
        let Some(ended) = self.problem.fit(&best.point, &Effort::FULL) else { return best };
        work.spend(ended.evaluations);
        let model = Model::of(ended);
        self.note(&model);
        model
    }

    /// A law of a model against its rivals. What to go on from, if it does not stand: without it where it is
    /// no longer worth its level, with the rival where that is worth more.
    fn challenged(&self, model: &Model, k: usize, work: &mut Work) -> Option<Point> {
        let law = model.point.terms[k].law;
        let mut without = model.point.clone();
        without.terms.remove(k);
        let without = self.refined(&without, work);
        let evidence_nats = without.value - model.value - model.price_nats(k);
        let asked = self.screen(&without, work)?;
        self.leading_nats.set(evidence_nats.max(0.0));
        let mut rivals: Vec<(Law, f64)> = Vec::new();
        let mut best: Option<(f64, Point)> = None;
        for asked in asked.iter().filter(|s| s.hypothesis.law != law).take(self.rivals) {
            let Some(ended) = self.fit_law(&without, &asked.hypothesis, work) else { continue };
            let rival = Model::of(ended);
            let nats = without.value - rival.value - rival.last_price_nats();
            rivals.push((asked.hypothesis.law, nats));
            if !rival.point.terms.last()?.is_at_bound() && best.as_ref().is_none_or(|b| nats > b.0) {
                best = Some((nats, rival.point));
            }
        }
        let mut known = self.defended.borrow_mut();
        known.retain(|d| d.law != law);
        if let Some((nats, point)) = best.filter(|b| b.0 > evidence_nats.max(self.level_nats()) + 1.0) {
            let rivals = rivals.into_iter().filter(|r| r.1 < nats).chain([(law, evidence_nats)]).collect();
            let mut point = point;
            let term = point.terms.pop()?;
            known.retain(|d| d.law != term.law);
            known.push(Defended { law: term.law, evidence_nats: nats, rivals });
            point.terms.insert(k, term);
            return Some(point);
        }
        if evidence_nats < self.level_nats() {
            return Some(without.point);
        }
        known.push(Defended { law, evidence_nats, rivals });
        None
    }

    /// Two planes that have changed places: which of them is the stated one its stated frequency says alone.
    fn mirrored(&self, point: &Point) -> Option<Point> {
        let [share, other] = point.terms.last()?.planes()?;
        let own = self.frequency(point)?;
        let mut out = self.at_frequency(point, other)?;
        *out.terms.last_mut()? = Term::of_planes(1.0 - share, own);
        Some(out)
    }

    /// A model with one plane split in two of the same mean frequency. The likelihood has a hill for each way
    /// in which two planes may stand (either acting with or against the other, far or near, on either side):
    /// the starts that one step of the fit, numbers and all, makes worth most.
    fn split(&self, model: &Point, work: &mut Work) -> Vec<Point> {
        let of = |share: f64, apart: f64| {
            let own = self.frequency(model)? / (1.0 + share * apart);
            let mut out = self.at_frequency(model, own)?;
            out.terms.push(Term::of_planes(share, own * (1.0 + apart)));
            Some(out)
        };
        let (shares, apart) = ([-0.45, -0.2, 0.2, 0.45], [-0.06, -0.03, 0.03, 0.06]);
        let starts = shares.iter().flat_map(|share| apart.iter().filter_map(move |apart| of(*share, *apart)));
        let mut stepped: Vec<(f64, Point)> = Vec::new();
        for start in starts {
            let Some(ended) = self.problem.fit(&start, &Effort { steps: 1, ..LOOK }) else { continue };
            work.spend(ended.evaluations / LOOK.every.0 as u64);
            stepped.push((ended.value, start));
        }
        stepped.sort_by(|a, b| a.0.total_cmp(&b.0));
        stepped.into_iter().take(STARTS).map(|s| s.1).collect()
    }

    /// Where a resonance of a size that machines have is worth most, the numbers as they are: the two best
    /// hills over its frequency. At no size its line is not where it is at that of a machine.
    fn hills(&self, model: &Point, law: Law, work: &mut Work) -> Vec<Promise> {
        let feet = law.feet();
        let sizes = [0.3, 1.0];
        work.spend((feet.len() * sizes.len() / LOOK.every.0) as u64);
        let base = self.problem.value(model, LOOK.every);
        let of = |foot: &Vec<f64>| {
            let sized = |size: f64| {
                let mut values = foot.clone();
                values[0] = size;
                let mut point = model.clone();
                point.terms.push(Term { law, values: values.clone() });
                let nats = LOOK.every.0 as f64 * (base - self.problem.value(&point, LOOK.every));
                Promise { law, values, nats }
            };
            sizes.map(sized).into_iter().max_by(|a, b| a.nats.total_cmp(&b.nats)).expect("a size")
        };
        let over: Vec<Promise> = on_two_cores(&feet, of);
        let nats = |k: usize| over.get(k).map_or(f64::NEG_INFINITY, |p| p.nats);
        let is_hill: Vec<bool> =
            (0..over.len()).map(|k| nats(k) >= nats(k + 1) && (k == 0 || nats(k) > nats(k - 1))).collect();
        let mut hills: Vec<Promise> =
            over.into_iter().zip(is_hill).filter_map(|(p, is)| is.then_some(p)).collect();
        hills.sort_by(|a, b| b.nats.total_cmp(&a.nats));
        hills.truncate(2);
        hills
    }

    fn frequency_at(&self) -> Option<usize> {
        self.problem.frame.numbers.iter().position(|n| *n == Number::Frequency)
    }

    /// Frequency of the bar over the stated one; `None`: it is not free.
    fn frequency(&self, point: &Point) -> Option<f64> {
        Some((point.numbers[self.frequency_at()?] * Number::Frequency.log_sd()).exp())
    }

    /// The same point with another one.
    fn at_frequency(&self, point: &Point, over_stated: f64) -> Option<Point> {
        let mut out = point.clone();
        out.numbers[self.frequency_at()?] = over_stated.ln() / Number::Frequency.log_sd();
        Some(out)
    }

    /// The better of a few starts, then to the end.
    fn fit_law(&self, model: &Model, asked: &Asked, work: &mut Work) -> Option<Ended> {
        if work.is_spent() {
            return None;
        }
        let mut best: Option<Ended> = None;
        // A likelihood with several hills (few cuts of a shop) is climbed from the model as it was handed in,
        // from the best point that any hypothesis has led to (the order of the laws must not decide), and
        // from the numbers as they are stated: without the law the fit may have bent them far.
        let mut bases = vec![model.point.clone()];
        let known = self.before(&model.point).point;
        if known != model.point {
            bases.push(known);
        }
        let mut starts: Vec<Vec<f64>> = asked.starts.iter().take(STARTS).cloned().collect();
        if self.problem.frame.has_table() {
            bases.push(self.problem.frame.as_stated(&model.point));
            // From a bent model a law promises nothing at no size; of a typical size it may stand on a hill.
            starts.extend(asked.starts.first().map(|start| asked.law.typical(start)));
        }
        for base in &bases {
            let with = |start: &Vec<f64>| {
                let mut point = base.clone();
                point.terms.push(Term { law: asked.law, values: start.clone() });
                point
            };
            let points = if self.unscreened(asked.law) {
                self.split(base, work)
            } else {
                starts.iter().map(with).collect()
            };
            for point in points {
                let Some(looked) = self.problem.fit(&point, &LOOK) else { continue };
                work.spend(looked.evaluations / LOOK.every.0 as u64);
                if best.as_ref().is_none_or(|b| looked.value < b.value) {
                    best = Some(looked);
                }
            }
        }
        let best = best?;
        // A rival that after a first look is not worth a third of what leads is none. Where nothing leads,
        // every law is fitted to the end: what numbers are bent to hide, neither screening nor a look shows.
        let all_nats = LOOK.every.0 as f64 * (self.problem.value(&model.point, LOOK.every) - best.value);
        if self.leading_nats.get() > self.level_nats()
            && !self.problem.frame.has_table()
            && CRITERIA.promise_factor * (all_nats - full_price_nats(asked.law)) < self.leading_nats.get()
        {
            return None;
        }
        let mut ended = self.problem.fit(&best.point, &Effort::FULL)?;
        if let Some(other) = self.mirrored(&ended.point).and_then(|p| self.problem.fit(&p, &Effort::FULL)) {
            let evaluations = ended.evaluations + other.evaluations;
            ended = if other.value < ended.value { other } else { ended };
            ended.evaluations = evaluations;
        }
        work.spend(ended.evaluations);
        Some(ended)
    }
}

/// Projected gain of a law from one foot, with the sizes that it promises.
fn promise(problem: &Problem, model: &Model, base: &Screening, law: Law, foot: &[f64]) -> Option<Promise> {
    let sizes = law.sizes();
    let term = Term { law, values: foot.to_vec() };
    let mut with = model.point.clone();
    with.terms.push(term);
    let quadratic = base.extended(problem, &with, sizes)?;
    let n = base.columns();
    let h = |r: std::ops::Range<usize>, c: std::ops::Range<usize>| {
        quadratic.information.view((r.start, c.start), (r.len(), c.len())).into_owned()
    };
    let g = |r: std::ops::Range<usize>| quadratic.gradient.rows(r.start, r.len()).into_owned();
    let own = h(0..n, 0..n).cholesky()?;
    let cross = h(0..n, n..n + sizes);
    let c: DMatrix<f64> = h(n..n + sizes, n..n + sizes) - cross.transpose() * own.solve(&cross);
    let force: DVector<f64> = g(n..n + sizes) - cross.transpose() * own.solve(&g(0..n));
    let solved = (c + DMatrix::identity(sizes, sizes) * 1e-9).cholesky()?.solve(&(-&force));
    let mut values = foot.to_vec();
    let mut gain = 0.0;
    for i in 0..sizes {
        let [low, high] = law.coordinates()[i].bounds;
        // A start of a whole size at most: the promise is of first order.
        let size = (foot[i] + solved[i]).clamp(low, high).clamp(-1.0, 1.0);
        let allowed = foot[i] + solved[i] >= low && foot[i] + solved[i] <= high.max(1e9);
        gain -= if allowed { 0.5 * solved[i] * force[i] } else { 0.0 };
        values[i] = if size.abs() < 0.05 { 0.05_f64.copysign(size).clamp(low, high) } else { size };
    }
    Some(Promise { law, values, nats: gain * SCREENED.0 as f64 })
}

struct Promise {
    law: Law,
    values: Vec<f64>,
    nats: f64,
}

/// The Jacobian of a model, kept for all effects.
struct Screening {
    every: Every,
    steps: Vec<f64>,
    /// By observable: at the model, and at its neighbours.
    parts: Vec<Vec<Part>>,
}

impl Screening {
    fn new(problem: &Problem, point: &Point, every: Every) -> Option<Self> {
        let (steps, parts) = problem.jacobian(point, every)?;
        Some(Self { every, steps, parts })
    }

    fn columns(&self) -> usize {
        self.steps.len()
    }

    /// Gradient and information with the sizes of the last term of `with` beside the model's own columns.
    fn extended(&self, problem: &Problem, with: &Point, sizes: usize) -> Option<Quadratic> {
        let at = with.coordinates();
        let n = self.columns();
        let moved = (0..sizes).map(|i| {
            let mut there = at.clone();
            // A hundredth of a size: larger than what is lost to the foot's own rounding.
            there[n + i] += SIZE_STEP;
            problem.frame.machine(&with.with(&there))
        });
        let machines: Option<Vec<Machine>> =
            std::iter::once(problem.frame.machine(with)).chain(moved).collect();
        let machines = machines?;
        let steps: Vec<f64> =
            self.steps.iter().copied().chain(std::iter::repeat_n(SIZE_STEP, sizes)).collect();
        let of_observable = |(o, own): (&Observed<'_>, &Vec<Part>)| {
            let parts = o.parts(&machines, self.every);
            let moved: Vec<&Part> = own[1..].iter().chain(&parts[1..]).collect();
            Quadratic::of_part(&parts[0], &moved, &steps)
        };
        let each = problem.observables.iter().zip(&self.parts).map(of_observable).collect();
        Some(problem.with_priors(each, with, steps.len()))
    }
}

/// Step of a size in the screening.
const SIZE_STEP: f64 = 0.01;

impl Subject for Cut<'_> {
    type Model = Model;
    type Hypothesis = Asked;

    fn name(&self, hypothesis: &Asked) -> (&'static str, Port) {
        (hypothesis.law.name(), hypothesis.law.specification().map_or(Port::Process, |s| s.port))
    }

    fn screen(&self, model: &Model, work: &mut Work) -> Option<Vec<Screened<Asked>>> {
        self.leading_nats.set(0.0);
        let base = Screening::new(self.problem, &model.point, SCREENED)?;
        let peaks = peaks(base.parts.iter().map(|p| &p[0]), self.problem.frame.scales.frequency_hz);
        let taken: Vec<Law> = model.point.terms.iter().map(|t| t.law).collect();
        let open = || self.laws.iter().copied().filter(|l| !taken.contains(l));
        let feet = |l: Law| if l.is_resonance() { l.peaked(&peaks) } else { l.feet() };
        let asked: Vec<(Law, Vec<f64>)> =
            open().flat_map(|l| feet(l).into_iter().map(move |f| (l, f))).collect();
        // Foot and sizes of each.
        let evaluations =
            asked.iter().map(|(l, _)| 1 + l.sizes() as u64).sum::<u64>() + base.columns() as u64;
        work.take(evaluations / SCREENED.0 as u64).then_some(())?;
        let problem = self.problem;
        let promises = on_two_cores(&asked, |(law, foot)| promise(problem, model, &base, *law, foot));
        let mut out: Vec<Screened<Asked>> = Vec::new();
        let mut promises: Vec<Promise> = promises.into_iter().flatten().collect();
        promises.extend(open().filter(|l| l.is_resonance()).flat_map(|l| self.hills(&model.point, l, work)));
        promises.sort_by(|a, b| b.nats.total_cmp(&a.nats));
        for promise in promises {
            match out.iter_mut().find(|s| s.hypothesis.law == promise.law) {
                Some(known) => known.hypothesis.starts.push(promise.values),
                None => out.push(Screened {
                    // Asked before whatever promises less than a name.
                    promise_nats: if self.unscreened(promise.law) {
                        self.level_nats()
                    } else {
                        promise.nats - full_price_nats(promise.law)
                    },
                    hypothesis: Asked { law: promise.law, starts: vec![promise.values] },
                }),
            }
        }
        Some(out)
    }

    fn fit(&self, model: &Model, asked: &Asked, work: &mut Work) -> Option<Fitted<Asked, Model>> {
        let ended = self.fit_law(model, asked, work)?;
        // The model without it from the numbers that it found: "nothing" must not sit in a poorer minimum.
        let mut without = ended.point.clone();
        without.terms.pop();
        if ended.value < self.before(&without).value - CRITERIA.price_nats
            && let Some(again) = self.problem.fit(&without, &AGAIN)
        {
            work.spend(again.evaluations);
            self.note(&Model::of(again));
        }
        let before = self.before(&without).value;
        let term = ended.point.terms.last()?.clone();
        let at_bound = term.is_at_bound();
        let fitted = Model::of(ended);
        let evidence_nats = before - fitted.value - fitted.last_price_nats();
        self.note(&fitted);
        if !at_bound {
            self.leading_nats.set(self.leading_nats.get().max(evidence_nats));
        }
        Some(Fitted {
            hypothesis: Asked { law: asked.law, starts: vec![term.values] },
            model: fitted,
            evidence_nats,
            level_nats: self.level_nats(),
            at_bound,
        })
    }

    fn compare(&self, model: &Model, fitted: &mut [Fitted<Asked, Model>]) {
        let before = self.before(&model.point).value;
        for fit in fitted {
            fit.evidence_nats = before - fit.model.value - fit.model.last_price_nats();
        }
    }

    /// Numbers to the end; then each law again that was there before: what was taken up first had to stand
    /// for all that was missing, and may be a rival's.
    /// A settled model has no poorer value than the one it came from: all that was gained stands.
    fn settle(&self, _: &Model, model: Model, work: &mut Work) -> (Model, f64) {
        let mut model = self.refined(&model.point, work);
        let mut k = 0;
        while k + 1 < model.point.terms.len() {
            let laws = model.point.terms.len();
            if let Some(other) = self.challenged(&model, k, work) {
                model = self.refined(&other, work);
            }
            k += usize::from(model.point.terms.len() == laws);
        }
        (model, f64::INFINITY)
    }
}

/// What a law of recordings must be worth to be named, nats: a law of one number is named from where a size
/// is seen, five standard deviations; chance gives one of 33 looks that once in a hundred thousand cases.
pub(crate) fn level_nats() -> f64 {
    0.5 * CRITERIA.visible_sd.powi(2) - CRITERIA.price_nats
}

/// How an effect shows, in standard deviations of its first size: |dperp| of one typical size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Seen {
    /// Law.
    pub(crate) law: Law,
    /// With every free number of the model moved against it.
    pub(crate) of_a_size: f64,
    /// With the model's numbers known.
    pub(crate) alone: f64,
}

/// How each law would show in these cuts, best of its feet; no evaluation of data that is not there.
pub(crate) fn visibility(problem: &Problem, model: &Model, laws: &[Law]) -> Vec<Seen> {
    let Some(base) = Screening::new(problem, &model.point, SCREENED) else { return Vec::new() };
    let whole = (SCREENED.0 as f64).sqrt();
    let of_foot = |law: Law, foot: &[f64]| -> Option<Seen> {
        let mut with = model.point.clone();
        with.terms.push(Term { law, values: foot.to_vec() });
        let q = base.extended(problem, &with, law.sizes())?;
        let (n, all) = (base.columns(), q.information.nrows());
        let own = q.information.view((0, 0), (n, n)).into_owned().cholesky()?;
        let cross = q.information.view((0, n), (n, all - n)).into_owned();
        let bare = q.information.view((n, n), (all - n, all - n)).into_owned();
        let left = &bare - cross.transpose() * own.solve(&cross);
        let deviations = |h: f64| whole * h.max(0.0).sqrt();
        Some(Seen { law, of_a_size: deviations(left[(0, 0)]), alone: deviations(bare[(0, 0)]) })
    };
    let of_law = |law: &Law| {
        let feet = law.feet();
        let seen = feet.iter().filter_map(|foot| of_foot(*law, foot));
        seen.max_by(|a, b| a.of_a_size.total_cmp(&b.of_a_size))
    };
    on_two_cores(laws, of_law).into_iter().flatten().collect()
}
