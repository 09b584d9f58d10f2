//! The one selection: ask every hypothesis, fit the best, take what exceeds the level, ask again.
//!
//! It knows neither drive nor cut. A [`Subject`] (the force balance of a drive, the cuts of a lathe) says
//! which hypotheses there are, screens them cheaply, fits one with every number of the model free beside it,
//! and says what level chance reaches. Work is counted in evaluations, never in seconds: a busy machine
//! answers later, not differently.

use super::Progress;
use super::two_cores::on_two_cores;
use crate::plant::effects::Port;

/// Evaluations that may still be made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Work {
    limit: u64,
    spent: u64,
    refused: bool,
}

impl Work {
    /// A budget of that many evaluations.
    pub(crate) fn new(limit: u64) -> Self {
        Self { limit, spent: 0, refused: false }
    }

    /// Half of what is left, taken off.
    pub(crate) fn half(&mut self) -> Self {
        let half = self.limit.saturating_sub(self.spent) / 2;
        self.spend(half);
        Self::new(half)
    }

    /// Pieces of work on two threads, each within its share of what is left; results in order. One for which
    /// that was too little is done again with what the others did not need.
    pub(crate) fn on_two_cores<T: Sync, R: Send>(
        &mut self,
        items: &[T],
        of: impl Fn(&T, &mut Self) -> R + Sync,
    ) -> Vec<R> {
        let left = |work: &Self| work.limit.saturating_sub(work.spent);
        let share = left(self) / (items.len() as u64).max(1);
        let within = |item: &T, limit: u64| {
            let mut own = Self::new(limit);
            (of(item, &mut own), own)
        };
        let done = on_two_cores(items, |item| within(item, share));
        done.iter().filter(|(_, own)| !own.refused).for_each(|(_, own)| self.spend(own.spent));
        let finish = |(item, (result, own)): (&T, (R, Self))| {
            if !own.refused {
                return result;
            }
            let (result, own) = if left(self) > share { within(item, left(self)) } else { (result, own) };
            self.spend(own.spent);
            self.refused |= own.refused;
            result
        };
        items.iter().zip(done).map(finish).collect()
    }

    /// Takes `evaluations` off the budget; false where they are not there: then nothing may be computed.
    pub(crate) fn take(&mut self, evaluations: u64) -> bool {
        let there = self.spent.saturating_add(evaluations) <= self.limit;
        if there {
            self.spent += evaluations;
        }
        self.refused |= !there;
        there
    }

    /// Takes off what turned out to be needed.
    pub(crate) fn spend(&mut self, evaluations: u64) {
        self.spent = self.spent.saturating_add(evaluations);
    }

    /// True where nothing more may be begun.
    pub(crate) fn is_spent(&self) -> bool {
        self.spent >= self.limit
    }

    /// True where something was not computed for want of work.
    pub(crate) fn has_refused(&self) -> bool {
        self.refused
    }

    /// What others have not needed.
    pub(crate) fn take_over(&mut self, others: [&Self; 2]) {
        for other in others {
            self.limit += other.limit.saturating_sub(other.spent);
        }
    }

    /// Share of the budget that is spent, 0 to 1.
    pub(crate) fn share(&self) -> f64 {
        (self.spent as f64 / self.limit.max(1) as f64).min(1.0)
    }
}

/// A hypothesis with what its screening promises.
#[derive(Debug, Clone)]
pub(crate) struct Screened<H> {
    /// What is asked.
    pub(crate) hypothesis: H,
    /// Gain in log-likelihood less its price, nats.
    pub(crate) promise_nats: f64,
}

/// A hypothesis fitted with every number of the model free beside it.
#[derive(Debug, Clone)]
pub(crate) struct Fitted<H, M> {
    /// What was asked, its shape as fitted.
    pub(crate) hypothesis: H,
    /// The model with it.
    pub(crate) model: M,
    /// The one statistic, nats: the worst of the gain less its price and of the held-out gains.
    pub(crate) evidence_nats: f64,
    /// What chance reaches in these recordings, nats.
    pub(crate) level_nats: f64,
    /// A parameter ended at a bound, or has a sign that physics does not allow.
    pub(crate) at_bound: bool,
}

impl<H, M> Fitted<H, M> {
    /// True where it may be asserted.
    pub(crate) fn qualifies(&self) -> bool {
        !self.at_bound && self.evidence_nats > self.level_nats
    }
}

/// What is diagnosed: recordings of one machine beside its model.
pub(crate) trait Subject {
    /// A model: numbers, and what was taken up.
    type Model: Clone;
    /// One law with its shape.
    type Hypothesis: Clone;

    /// Name of the effect and port of a hypothesis.
    fn name(&self, hypothesis: &Self::Hypothesis) -> (&'static str, Port);

    /// Every hypothesis that the model leaves open, best promise first. `None`: the budget is spent.
    fn screen(&self, model: &Self::Model, work: &mut Work) -> Option<Vec<Screened<Self::Hypothesis>>>;

    /// One hypothesis fitted to the end. `None`: the budget is spent, or no such model exists.
    fn fit(
        &self,
        model: &Self::Model,
        hypothesis: &Self::Hypothesis,
        work: &mut Work,
    ) -> Option<Fitted<Self::Hypothesis, Self::Model>>;

    /// Several, in order, without those that have no fit; tells the effect of each that it begins.
    fn fit_each(
        &self,
        model: &Self::Model,
        hypotheses: &[Self::Hypothesis],
        work: &mut Work,
        begins: &(dyn Fn(&Work, &str) + Sync),
    ) -> Vec<Fitted<Self::Hypothesis, Self::Model>> {
        let of = |h| {
            begins(work, self.name(h).0);
            self.fit(model, h, work)
        };
        hypotheses.iter().filter_map(of).collect()
    }

    /// A round is complete: evidence against the best that "nothing more" came to in it. A fit that found
    /// better numbers for the model itself lowers what every other one has gained.
    fn compare(&self, _model: &Self::Model, _fitted: &mut [Fitted<Self::Hypothesis, Self::Model>]) {}

    /// The model after something was taken up: numbers moved, shapes refined again. With it the gain of what
    /// was taken up over `before` once numbers and shapes stand, less its price, nats.
    fn settle(&self, before: &Self::Model, model: Self::Model, work: &mut Work) -> (Self::Model, f64);
}

/// How far the selection goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Reach {
    /// Effects that are taken up at most: more are a different machine.
    pub(crate) most_findings: usize,
    /// Screened hypotheses that are fitted in a round; of one effect and port the best only.
    pub(crate) fitted: usize,
}

impl Default for Reach {
    fn default() -> Self {
        Self { most_findings: 4, fitted: 5 }
    }
}

/// One round: what was fitted, best first, and whether its first was taken up.
#[derive(Debug, Clone)]
pub(crate) struct Round<H, M> {
    /// Fitted, those that qualify first, then by evidence.
    pub(crate) fitted: Vec<Fitted<H, M>>,
    /// Screened, best promise first; one an effect and port.
    pub(crate) screened: Vec<Screened<H>>,
    /// The first of `fitted` is in the model now.
    pub(crate) accepted: bool,
}

/// Where the selection ended.
#[derive(Debug, Clone)]
pub(crate) struct Selected<H, M> {
    /// The model in the end.
    pub(crate) model: M,
    /// What happened, in order.
    pub(crate) rounds: Vec<Round<H, M>>,
    /// The budget ended before the question did.
    pub(crate) out_of_budget: bool,
}

/// Forward selection until nothing qualifies, the reach is used up or the budget is spent.
///
/// Errors: none. Deterministic. Cost: one screening and `reach.fitted` fits a round.
/// Checked by: `selection::tests`.
pub(crate) fn select<S: Subject>(
    subject: &S,
    start: S::Model,
    reach: Reach,
    work: &mut Work,
    progress: Progress<'_>,
) -> Selected<S::Hypothesis, S::Model> {
    let mut out = Selected { model: start, rounds: Vec::new(), out_of_budget: false };
    for taken in 0..=reach.most_findings {
        progress(work.share(), "screening hypotheses");
        let Some(screened) = subject.screen(&out.model, work) else {
            out.out_of_budget = true;
            break;
        };
        let screened = one_each(subject, screened);
        let asked: Vec<_> = screened.iter().take(reach.fitted).map(|s| s.hypothesis.clone()).collect();
        let begins = |work: &Work, effect: &str| progress(work.share(), effect);
        let mut fitted = subject.fit_each(&out.model, &asked, work, &begins);
        out.out_of_budget |= fitted.len() < asked.len() && work.refused;
        subject.compare(&out.model, &mut fitted);
        best_first(&mut fitted);
        let open = if taken < reach.most_findings { &mut fitted[..] } else { &mut [] };
        let settled = settled(subject, &out.model, open, work);
        out.out_of_budget |= settled.is_none() && work.refused;
        let accepted = settled.is_some();
        out.model = settled.unwrap_or(out.model);
        best_first(&mut fitted);
        out.rounds.push(Round { fitted, screened, accepted });
        if !accepted {
            break;
        }
    }
    out
}

fn best_first<H, M>(fitted: &mut [Fitted<H, M>]) {
    fitted
        .sort_by(|a, b| b.qualifies().cmp(&a.qualifies()).then(b.evidence_nats.total_cmp(&a.evidence_nats)));
}

/// The model with the first of these that gains what it must once all has settled beside it: a law may have
/// been fitted beside numbers that the model does not have with it. One that does not gain has no more
/// evidence than that.
fn settled<S: Subject>(
    subject: &S,
    before: &S::Model,
    fitted: &mut [Fitted<S::Hypothesis, S::Model>],
    work: &mut Work,
) -> Option<S::Model> {
    for fit in fitted.iter_mut().filter(|fit| fit.qualifies()) {
        let (model, gained) = subject.settle(before, fit.model.clone(), work);
        if gained > fit.level_nats {
            return Some(model);
        }
        // What is no number is no evidence.
        fit.evidence_nats = if gained.is_nan() { f64::NEG_INFINITY } else { gained.min(fit.evidence_nats) };
    }
    None
}

/// Of each effect and port the shape that promises most.
fn one_each<S: Subject>(
    subject: &S,
    mut screened: Vec<Screened<S::Hypothesis>>,
) -> Vec<Screened<S::Hypothesis>> {
    screened.sort_by(|a, b| b.promise_nats.total_cmp(&a.promise_nats));
    let mut seen = Vec::new();
    screened.retain(|s| {
        let name = subject.name(&s.hypothesis);
        let new = !seen.contains(&name);
        seen.push(name);
        new
    });
    screened
}

/// Probabilities of hypotheses of these evidences, nats, "nothing of these" with `none_nats` among them; they
/// sum to one with what "nothing" has. `temper`: whitened chi-square of the fit, 1 for an exact likelihood.
///
/// p_i = exp(T_i / temper) / sum: equal prior odds; the price is in the evidence already.
pub(crate) fn probabilities(evidence_nats: &[f64], none_nats: f64, temper: f64) -> Vec<f64> {
    let top = evidence_nats.iter().copied().fold(none_nats, f64::max);
    let weight = |t: f64| ((t - top) / temper.max(1.0)).exp();
    let total: f64 = evidence_nats.iter().map(|t| weight(*t)).sum::<f64>() + weight(none_nats);
    evidence_nats.iter().map(|t| weight(*t) / total).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Columns of known gain; each may be taken once.
    struct Toy;

    impl Subject for Toy {
        type Model = Vec<usize>;
        type Hypothesis = usize;

        fn name(&self, h: &usize) -> (&'static str, Port) {
            (["a", "b", "c", "d", "e"][*h], Port::Stage)
        }

        fn screen(&self, model: &Vec<usize>, work: &mut Work) -> Option<Vec<Screened<usize>>> {
            work.take(5).then(|| {
                let open = (0..5).filter(|h| !model.contains(h));
                open.map(|h| Screened { hypothesis: h, promise_nats: 100.0 * h as f64 }).collect()
            })
        }

        fn fit(&self, model: &Vec<usize>, h: &usize, work: &mut Work) -> Option<Fitted<usize, Vec<usize>>> {
            let model = model.iter().copied().chain([*h]).collect();
            let evidence_nats = 100.0 * *h as f64;
            let at_bound = *h == 3;
            work.take(1).then_some(Fitted {
                hypothesis: *h,
                model,
                evidence_nats,
                level_nats: 150.0,
                at_bound,
            })
        }

        /// The law 4 gains nothing once it stands.
        fn settle(&self, _: &Vec<usize>, model: Vec<usize>, _: &mut Work) -> (Vec<usize>, f64) {
            let gained = model.last().map_or(0.0, |h| if *h == 4 { f64::NAN } else { 100.0 * *h as f64 });
            (model, gained)
        }
    }

    #[test]
    fn only_what_exceeds_the_level_and_ends_at_no_bound_is_taken_up() {
        let out = select(&Toy, Vec::new(), Reach::default(), &mut Work::new(1000), &|_, _| {});
        assert_eq!(out.model, [2]);
        // What promised most was refused once it stood.
        let refused = out.rounds[0].fitted.iter().find(|f| f.hypothesis == 4).unwrap();
        assert!(!refused.qualifies() && out.rounds[0].fitted[0].hypothesis == 2);
        assert_eq!(out.rounds.iter().map(|r| r.accepted).collect::<Vec<_>>(), [true, false]);
        assert!(!out.out_of_budget);
    }

    #[test]
    fn pieces_of_work_have_what_the_others_do_not_need() {
        for (pieces, all, spent) in [([10, 70], true, 80), ([40, 45], true, 85), ([10, 95], false, 100)] {
            let mut work = Work::new(100);
            let done = work.on_two_cores(&pieces, |n: &u64, work| (0..*n).all(|_| work.take(1)));
            assert_eq!((done, work.refused, work.spent), (vec![true, all], !all, spent), "{pieces:?}");
        }
    }

    #[test]
    fn a_spent_budget_keeps_what_was_found() {
        let out = select(&Toy, Vec::new(), Reach::default(), &mut Work::new(9), &|_, _| {});
        assert_eq!(out.model, [2]);
        assert!(out.out_of_budget);
    }

    #[test]
    fn probabilities_leave_room_for_nothing() {
        let p = probabilities(&[20.0, 20.0], 20.0, 1.0);
        assert!((p[0] - 1.0 / 3.0).abs() < 1e-12 && (p[1] - p[0]).abs() < 1e-12);
        let [one, other] = probabilities(&[40.0, 20.0], 0.0, 1.0)[..] else { panic!("two") };
        assert!(one > 0.999_999 && other < 1e-8);
    }
}
