//! How an answer stands on stretches that no number was fitted to, and where its likelihood comes from.
//!
//! The stretches are held out in parts, one after the other: every stretch is foretold once, by fits to the
//! others. Beside the answer stand the scenario as stated and its structure with other numbers alone, and
//! for each finding the answer without it, all numbers fitted anew. Most of what forces show is random, and
//! the structure with other numbers foretells it as well; what separates is ln L, growth and line.

use super::super::result::{Fit, TimeSpans};
use super::super::selection::Work;
use super::adequacy::{joined, spans};
use super::answer::Fitting;
use super::criteria::CRITERIA;
use super::fit::{Effort, Problem, bin_value, part_value};
use super::machine::{Frame, Machine, Point};
use super::observable::{Every, LeftOver, Lent, Observable, Observed, Origin, OriginKind, Part};
use super::result::{CutDiagnosis, CutFinding, CutFit, CutProof, ProvenLine, Sides};
use super::search::{AGAIN, SCREENED};

/// Parts in which the stretches are held out: the fits to the others have two thirds of them.
pub(super) const HELD_OUT: usize = 3;
/// The fits to the others begin where all of them have led.
const PART: Effort = Effort { every: SCREENED, ..AGAIN };

/// The stretch that each observable is of, counted over the recordings; spectra of a piece are of the stretch
/// of its means. `None`: rows of a table, which no recording foretells.
fn groups(observables: &[Observed<'_>]) -> Vec<Option<usize>> {
    let mut order: Vec<usize> = (0..observables.len()).collect();
    let origin: Vec<Origin> = observables.iter().map(|o| o.origin()).collect();
    let angle = |k: usize| origin[k].kind == OriginKind::Angle;
    order.sort_by(|a, b| {
        let key = |k: usize| (angle(k), origin[k].recording);
        key(*a).cmp(&key(*b)).then(origin[*a].span_s[0].total_cmp(&origin[*b].span_s[0]))
    });
    let mut out = vec![None; observables.len()];
    let (mut count, mut last): (usize, Option<(usize, f64)>) = (0, None);
    for k in order {
        if origin[k].kind == OriginKind::Table {
            continue;
        }
        let [begin, end] = origin[k].span_s;
        let same = |(known, until): (usize, f64)| {
            (angle(k), origin[k].recording) == (angle(known), origin[known].recording) && begin < until
        };
        let until = last.filter(|l| same(*l)).map(|l| l.1);
        count += usize::from(until.is_none());
        last = Some((k, until.map_or(end, |until| until.max(end))));
        out[k] = Some(count - 1);
    }
    out
}

/// How many stretches can be held out of fits to the others.
pub(super) fn held_out_groups(observables: &[Observed<'_>]) -> usize {
    groups(observables).into_iter().flatten().max().map_or(0, |last| last + 1)
}

/// What is left over, summed.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct LeftSum {
    sum: LeftOver,
    /// Of spectra, and of means: without a random force there are no spectra.
    seconds: [f64; 2],
}

impl LeftSum {
    fn add(&mut self, observable: &dyn Observable, machine: &Machine) {
        let Some(left) = observable.left_over(machine) else { return };
        let origin = observable.origin();
        let length = origin.span_s[1] - origin.span_s[0];
        self.sum.recorded_n2 += left.recorded_n2 * length;
        self.sum.floor_n2 += left.floor_n2 * length;
        match origin.kind {
            OriginKind::Calm | OriginKind::Followed => self.seconds[0] += length,
            OriginKind::Means => self.seconds[1] += length,
            _ => {}
        }
    }

    /// A second of it: what different observables of a stretch leave adds.
    pub(super) fn mean(&self) -> LeftOver {
        self.sum * (1.0 / self.seconds[0].max(self.seconds[1]).max(1e-9))
    }
}

/// What a machine leaves over.
pub(super) fn left_over<'a>(
    observables: impl Iterator<Item = &'a dyn Observable>,
    machine: &Machine,
) -> LeftSum {
    let mut sum = LeftSum::default();
    observables.for_each(|o| sum.add(o, machine));
    sum
}

/// How one model stands on what was held out so far.
#[derive(Debug, Clone, Default)]
struct Standing {
    loss_nats: f64,
    left: LeftSum,
}

impl Standing {
    fn add(&mut self, observable: &dyn Observable, machine: &Machine) {
        self.loss_nats += part_value(&observable.part(machine, Every(1)));
        self.left.add(observable, machine);
    }
}

/// The finding's law in the model.
fn term_of(fitting: &Fitting<'_>, finding: &CutFinding) -> Option<usize> {
    let scales = &fitting.problem.frame.scales;
    let terms = &fitting.selected.model.point.terms;
    terms.iter().position(|term| term.effect(scales).is_some_and(|e| finding.is(&e)))
}

/// The model without one of its laws, numbers fitted anew; the better of two beginnings where none is left.
fn without(fitting: &Fitting<'_>, term: usize, work: &mut Work) -> Option<Point> {
    let mut point = fitting.selected.model.point.clone();
    point.terms.remove(term);
    let alone = point.terms.is_empty();
    let again = fitting.problem.fit_within(&point, &AGAIN, work)?;
    let start = fitting.start;
    Some(if alone && start.value < again.value { start.point.clone() } else { again.point })
}

/// Where and when the likelihood of a finding comes from.
pub(super) struct Gained {
    /// Bands with half of it; none where means and lines of the spindle tell more than spectra.
    pub(super) bands_hz: Vec<[f64; 2]>,
    /// Stretches with half of it.
    pub(super) time: Vec<TimeSpans>,
}

/// What the first finding gains, over frequency and over stretches.
pub(super) fn gained(fitting: &Fitting<'_>, models: &Models) -> Option<Gained> {
    let problem = fitting.problem;
    let other = problem.frame.machine(models.without.first()?.as_ref()?)?;
    let with = problem.frame.machine(&fitting.selected.model.point)?;
    let mut cells: Vec<f64> = Vec::new();
    let mut origins: Vec<(f64, Origin)> = Vec::new();
    let mut rest = 0.0;
    for observable in problem.observables {
        let [before, after] = [&other, &with].map(|machine| observable.part(machine, Every(1)));
        origins.push((part_value(&before) - part_value(&after), observable.origin()));
        match (&before, &after) {
            (Part::Bins { channels, bins }, Part::Bins { bins: others, .. }) => {
                for (before, after) in bins.iter().zip(others) {
                    let cell = (after.frequency_hz / CRITERIA.left_band_hz) as usize;
                    cells.resize(cells.len().max(cell + 1), 0.0);
                    cells[cell] += bin_value(before, *channels) - bin_value(after, *channels);
                }
            }
            _ => rest += part_value(&before) - part_value(&after),
        }
    }
    let whole: f64 = cells.iter().sum();
    let mut order: Vec<usize> = (0..cells.len()).filter(|_| whole > rest).collect();
    order.sort_by(|a, b| cells[*b].total_cmp(&cells[*a]));
    let mut sum = 0.0;
    order.retain(|cell| {
        let kept = sum < 0.5 * whole;
        sum += cells[*cell];
        kept
    });
    let edges = |cell: usize| [cell, cell + 1].map(|edge| edge as f64 * CRITERIA.left_band_hz);
    Some(Gained { bands_hz: joined(order.into_iter().map(edges)), time: spans(&origins) })
}

/// The models that are put to the proof, as points from which to fit.
pub(super) struct Models {
    refitted: Point,
    /// Findings and numbers; none where nothing was found.
    answer: Option<Point>,
    /// Of each finding the answer without it.
    without: Vec<Option<Point>>,
}

impl Models {
    pub(super) fn of(fitting: &Fitting<'_>, findings: &[CutFinding], work: &mut Work) -> Self {
        let start = fitting.start.point.clone();
        let one = |f: &CutFinding| without(fitting, term_of(fitting, f)?, work);
        let without: Vec<Option<Point>> = findings.iter().map(one).collect();
        // With one law the structure without it is the stated one.
        let stated = |p: &Point| p.terms.is_empty().then(|| p.clone());
        let refitted = without.iter().flatten().find_map(stated).unwrap_or(start);
        let answer = (!findings.is_empty()).then(|| fitting.selected.model.point.clone());
        Self { refitted, answer, without }
    }
}

/// What the fits to all other parts say of one part.
struct Proving {
    stated: Standing,
    refitted: Standing,
    answer: Standing,
    /// Of the findings.
    without: Vec<Standing>,
    lines: Vec<ProvenLine>,
}

impl Proving {
    fn add(
        &mut self,
        problem: &Problem<'_>,
        models: &Models,
        part: &[Option<usize>],
        number: usize,
        work: &mut Work,
    ) -> Option<()> {
        let frame = problem.frame;
        let held: Vec<&Observed<'_>> = problem
            .observables
            .iter()
            .zip(part)
            .filter(|(_, p)| **p == Some(number))
            .map(|(o, _)| o)
            .collect();
        let lent: Vec<Observed<'_>> = problem
            .observables
            .iter()
            .zip(part)
            .filter(|(_, p)| **p != Some(number))
            .map(|(o, _)| Box::new(Lent(o.as_ref())) as Observed<'_>)
            .collect();
        let others = Problem { frame, observables: &lent };
        let mut fitted = |point: &Point| frame.machine(&others.fit_within(point, &PART, work)?.point);
        let refitted = fitted(&models.refitted)?;
        let answer = models.answer.as_ref().map_or(Some(refitted), &mut fitted)?;
        let stated = frame.stated_in(answer.noise)?;
        let own = models.without.iter().map(|p| p.as_ref().and_then(&mut fitted));
        let without: Vec<Option<Machine>> = own.collect();
        // What was not fitted for want of work is no model without its finding.
        if work.has_refused() {
            return None;
        }
        for observable in held {
            let observable = observable.as_ref();
            self.stated.add(observable, &stated);
            self.refitted.add(observable, &refitted);
            self.answer.add(observable, &answer);
            for (standing, machine) in self.without.iter_mut().zip(&without) {
                standing.add(observable, machine.as_ref().unwrap_or(&refitted));
            }
            let root = |machine: &Machine| observable.line(machine);
            let (Some(line), Some(recording)) = (root(&answer), observable.origin().recording) else {
                continue;
            };
            let at = |machine: &Machine| root(machine).map_or(line.foretold, |l| l.foretold);
            self.lines.push(ProvenLine {
                recording,
                span_s: observable.origin().span_s,
                measured: line.measured,
                deviation_1_s: line.deviation_1_s,
                foretold: Sides { stated: at(&stated), refitted: at(&refitted), answer: line.foretold },
            });
        }
        Some(())
    }
}

/// Puts the answer to the proof. A diagnosis without room to hold anything out is left as it is, and so is
/// one whose budget ends before.
pub(super) fn prove(
    frame: &Frame,
    models: &Models,
    observables: &[Observed<'_>],
    work: &mut Work,
    diagnosis: &mut CutDiagnosis,
) {
    let group = groups(observables);
    let stretches = held_out_groups(observables);
    let parts = stretches.min(HELD_OUT);
    if parts < 2 {
        return;
    }
    let part: Vec<Option<usize>> = group.iter().map(|g| g.map(|g| g % parts)).collect();
    let problem = Problem { frame, observables };
    let [stated, refitted, answer] = [(); 3].map(|()| Standing::default());
    let without = vec![Standing::default(); models.without.len()];
    let mut proving = Proving { stated, refitted, answer, without, lines: Vec::new() };
    if (0..parts).any(|number| proving.add(&problem, models, &part, number, work).is_none()) {
        return;
    }
    let all = [&proving.stated, &proving.refitted, &proving.answer];
    // A spectrum that cannot be told leaves no likelihood to compare.
    if !all.into_iter().chain(&proving.without).all(|s| s.loss_nats.is_finite()) {
        return;
    }
    let rms = |standing: &Standing| standing.left.mean().recorded_n2.sqrt();
    let noise_floor_n = proving.answer.left.mean().floor_n2.sqrt();
    diagnosis.noise_floor_n = Some(noise_floor_n);
    for (finding, without) in diagnosis.findings.iter_mut().zip(&proving.without) {
        let forces = Fit {
            heldout_rms_before_n: rms(without),
            heldout_rms_after_n: rms(&proving.answer),
            noise_floor_n,
        };
        let gain_nats = Some(without.loss_nats - proving.answer.loss_nats);
        finding.fit = CutFit { forces: Some(forces), gain_nats, ..finding.fit };
    }
    let sides = |of: &dyn Fn(&Standing) -> f64| Sides {
        stated: of(&proving.stated),
        refitted: of(&proving.refitted),
        answer: of(&proving.answer),
    };
    diagnosis.proof = Some(CutProof {
        stretches,
        parts,
        loss_nats: sides(&|s| s.loss_nats),
        rms_n: sides(&rms),
        noise_floor_n,
        lines: proving.lines,
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Span(Origin);

    impl Observable for Span {
        fn part(&self, _: &Machine, _: Every) -> Part {
            Part::Rows(Vec::new())
        }

        fn origin(&self) -> Origin {
            self.0
        }
    }

    /// Pieces go with the stretch of their means, neighbours that only touch do not, a table with nothing.
    #[test]
    fn what_overlaps_is_one_stretch() {
        use OriginKind::{Angle, Calm, Followed, Means, Table};
        let of = |kind, recording, span_s| {
            Box::new(Span(Origin { kind, recording: Some(recording), span_s })) as Observed<'static>
        };
        let all = [
            of(Calm, 1, [0.5, 1.0]),
            of(Means, 0, [0.0, 1.0]),
            of(Calm, 0, [0.0, 0.5]),
            of(Calm, 0, [0.5, 1.0]),
            of(Followed, 0, [1.0, 1.2]),
            of(Angle, 0, [0.0, 2.0]),
            of(Table, 0, [0.0, 0.0]),
        ];
        let [own, other, swelling, angle] = [Some(2), Some(0), Some(1), Some(3)];
        assert_eq!(groups(&all), [own, other, other, other, swelling, angle, None]);
        assert_eq!(held_out_groups(&all), 4);
    }
}
