//! Is it one machine in every stretch? A number that is another one in each of them scatters, and any law of
//! place, speed or time that happens to follow the scatter takes the credit for it.
//!
//! The stretch e has the number p + d_e, d_e normal of variance t. With the mode d of each stretch, g its
//! slope and h its information there, the offset is integrated out (Laplace):
//!
//! -ln L = sum_e [ L_e(p + d_e) + d_e^2/2t + 1/2 ln(1 + t h_e) ]
//!
//! t is what makes this least: with y = d - g/h, what a stretch by itself would say, and its variance 1/h,
//! y is normal of variance t + 1/h. The gain over t = 0 is what one machine does not explain.

use super::super::selection::Work;
use super::super::two_cores::on_two_cores;
use super::adequacy::{Left, spans};
use super::criteria::CRITERIA;
use super::fit::{Effort, LONGEST_STEP, Problem, Quadratic, STEP, part_value};
use super::laws::Law;
use super::machine::{Machine, Number, Point};
use super::observable::{Every, Observable, Observed, Origin, Part};
use super::result::CutLocation;
use super::search::{AGAIN, Cut, Model};

/// A number that is another one in every stretch.
#[derive(Debug, Clone)]
struct Scatter {
    /// Which.
    number: Number,
    /// -ln L with the offsets integrated out, without priors, nats.
    value: f64,
    /// What that gains over the same number in every stretch, nats.
    gain_nats: f64,
    /// Of it each stretch.
    gains: Vec<(f64, Origin)>,
    /// By observable: the offset of its stretch.
    offsets: Vec<f64>,
}

/// What a stretch says of its own offset.
#[derive(Debug, Clone, Copy, Default)]
struct Mode {
    /// The mode under a variance.
    offset: f64,
    /// -ln L there and at no offset, nats.
    value: f64,
    at_none: f64,
    slope: f64,
    information: f64,
    evaluations: u64,
}

impl Mode {
    /// What the stretch would say by itself, and how well, as deviation from none and information.
    fn alone(&self) -> [f64; 2] {
        let h = self.information;
        [if h > 0.0 { self.offset - self.slope / h } else { 0.0 }, h]
    }

    /// What the stretch costs with its offset integrated out.
    fn marginal(&self, variance: f64) -> f64 {
        self.value + 0.5 * self.offset.powi(2) / variance + 0.5 * (variance * self.information).ln_1p()
    }
}

/// -ln L of `alone` under a variance, less that of none: y is normal of variance t + 1/h.
fn loss(alone: &[[f64; 2]], variance: f64) -> f64 {
    let of = |[y, h]: &[f64; 2]| {
        let spread = (variance * h).ln_1p();
        0.5 * (spread - y * y * h * variance * h / (1.0 + variance * h))
    };
    alone.iter().map(of).sum()
}

/// The variance that makes [`loss`] least; 0: none.
fn likeliest(alone: &[[f64; 2]]) -> f64 {
    // Deviations from a thousandth of what the number is stated to up to ten of it, eight a factor of ten.
    let tried = (-48..=16).map(|k| 10f64.powf(f64::from(k) / 8.0));
    let best = tried.map(|t| (loss(alone, t), t)).min_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|b| b.0 < 0.0).map_or(0.0, |b| b.1)
}

/// Observables of one stretch, by index.
fn stretches(problem: &Problem<'_>) -> Vec<Vec<usize>> {
    let key = |o: &Origin| (o.recording, o.span_s);
    let mut out: Vec<(Origin, Vec<usize>)> = Vec::new();
    for (k, observable) in problem.observables.iter().enumerate() {
        let origin = observable.origin();
        match out.iter_mut().find(|(known, _)| key(known) == key(&origin)) {
            Some((_, of)) => of.push(k),
            None => out.push((origin, vec![k])),
        }
    }
    out.into_iter().map(|(_, of)| of).collect()
}

/// One stretch of a machine whose number may be off.
struct Own<'a> {
    observables: Vec<&'a Observed<'a>>,
    machine: &'a Machine,
    number: Number,
}

impl Own<'_> {
    fn value(&self, offset: f64) -> Option<f64> {
        let machine = self.machine.off(self.number, offset)?;
        Some(self.observables.iter().map(|o| part_value(&o.part(&machine, Every(1)))).sum())
    }

    fn quadratic(&self, offset: f64) -> Option<[f64; 3]> {
        let machines =
            [self.machine.off(self.number, offset)?, self.machine.off(self.number, offset + STEP)?];
        Some(self.observables.iter().fold([0.0; 3], |[v, g, h], o| {
            let parts = o.parts(&machines, Every(1));
            let q = Quadratic::of_part(&parts[0], &[&parts[1]], &[STEP]);
            [v + q.value, g + q.gradient[0], h + q.information[(0, 0)]]
        }))
    }

    /// The mode of the offset under a variance, downhill from `start`.
    fn mode(&self, start: f64, variance: f64) -> Option<Mode> {
        let at_none = self.value(0.0)?;
        let whole = |offset: f64, value: f64| value + 0.5 * offset * offset / variance;
        let [mut value, mut slope, mut information] = self.quadratic(start)?;
        let (mut offset, mut evaluations) = (start, 3);
        for _ in 0..Effort::FULL.steps {
            let before = whole(offset, value);
            let step = -(slope + offset / variance) / (information + 1.0 / variance);
            let step = step.clamp(-LONGEST_STEP, LONGEST_STEP);
            let next = (0..4).map(|k| offset + step * 0.25f64.powi(k)).find(|next| {
                evaluations += 1;
                self.value(*next).is_some_and(|v| whole(*next, v) < before)
            });
            let Some(next) = next else { break };
            offset = next;
            [value, slope, information] = self.quadratic(offset)?;
            evaluations += 2;
            if before - whole(offset, value) < CRITERIA.decides_nothing_nats {
                break;
            }
        }
        Some(Mode { offset, value, at_none, slope, information, evaluations })
    }
}

/// An observable of a stretch whose number is off.
struct Off<'a> {
    observable: &'a Observed<'a>,
    number: Number,
    offset: f64,
}

impl Observable for Off<'_> {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        // Where there is no such machine, that as it is: the offset is one that a fit has found.
        let own = machine.off(self.number, self.offset);
        self.observable.part(own.as_ref().unwrap_or(machine), every)
    }

    fn parts(&self, machines: &[Machine], every: Every) -> Vec<Part> {
        let own = |m: &Machine| m.off(self.number, self.offset).unwrap_or(*m);
        self.observable.parts(&machines.iter().map(own).collect::<Vec<Machine>>(), every)
    }

    fn origin(&self) -> Origin {
        self.observable.origin()
    }
}

impl Scatter {
    /// How much a number scatters from stretch to stretch of the machine of a point; `None`: not at all.
    ///
    /// Cost: some evaluations of two machines.
    fn of(problem: &Problem<'_>, point: &Point, number: Number, work: &mut Work) -> Option<Self> {
        let machine = problem.frame.machine(point)?;
        let stretches = stretches(problem);
        let own = |of: &Vec<usize>| {
            let observables = of.iter().map(|k| &problem.observables[*k]).collect();
            Own { observables, machine: &machine, number }
        };
        let own: Vec<Own<'_>> = stretches.iter().map(own).collect();
        // What is stated is a first guess of how far a stretch may be off.
        let (mut variance, mut modes) = (1.0, vec![Mode::default(); own.len()]);
        // It changes the modes, and they it.
        for _ in 0..Effort::FULL.steps {
            let started: Vec<(&Own<'_>, f64)> = own.iter().zip(modes.iter().map(|m| m.offset)).collect();
            let each = on_two_cores(&started, |(own, start)| own.mode(*start, variance));
            modes = each.into_iter().collect::<Option<Vec<Mode>>>()?;
            work.spend(modes.iter().map(|m| m.evaluations).max().unwrap_or(0));
            let alone: Vec<[f64; 2]> = modes.iter().map(Mode::alone).collect();
            let before = std::mem::replace(&mut variance, likeliest(&alone));
            if variance <= 0.0 {
                return None;
            }
            if (variance - before).abs() < STEP * before || work.is_spent() {
                break;
            }
        }
        let gain = |m: &Mode| m.at_none - m.marginal(variance);
        let origin = |of: &Vec<usize>| problem.observables[of[0]].origin();
        let mut offsets = vec![0.0; problem.observables.len()];
        stretches.iter().zip(&modes).for_each(|(of, m)| of.iter().for_each(|k| offsets[*k] = m.offset));
        Some(Self {
            number,
            value: modes.iter().map(|m| m.marginal(variance)).sum(),
            gain_nats: modes.iter().map(gain).sum(),
            gains: stretches.iter().zip(&modes).map(|(of, m)| (gain(m), origin(of))).collect(),
            offsets,
        })
    }

    /// The same with the machine's numbers fitted beside the offsets: in turns, each with the other kept.
    /// The point, and -ln L with the offsets integrated out and the priors of the point.
    fn fitted(problem: &Problem<'_>, start: &Point, number: Number, work: &mut Work) -> (Point, f64) {
        let mut best = (start.clone(), problem.value(start, Every(1)));
        let mut point = start.clone();
        for _ in 0..Effort::FULL.steps {
            let Some(scatter) = Self::of(problem, &point, number, work) else { break };
            let value = scatter.value + problem.prior(&point);
            let gained = best.1 - value;
            if gained > 0.0 {
                best = (point.clone(), value);
            }
            if gained < CRITERIA.decides_nothing_nats || work.is_spent() {
                break;
            }
            let off = |(observable, offset): (_, &f64)| {
                Box::new(Off { observable, number, offset: *offset }) as Observed<'_>
            };
            let shifted: Vec<Observed<'_>> =
                problem.observables.iter().zip(&scatter.offsets).map(off).collect();
            let part = Problem { frame: problem.frame, observables: &shifted };
            let Some(ended) = part.fit(&point, &AGAIN) else { break };
            work.spend(ended.evaluations);
            point = ended.point;
        }
        best
    }

    /// As something that is left.
    fn left(&self, worth_nats: f64) -> Left {
        let location = CutLocation {
            port: self.number.port(),
            domain: "time",
            bands_hz: Vec::new(),
            time: spans(&self.gains),
        };
        Left { location, excess_nats: worth_nats }
    }
}

/// What no law explains of a model whose stretches are no one machine.
#[derive(Debug, Clone)]
pub(crate) struct Scattered {
    /// The model without the laws that only follow the scatter.
    pub(crate) point: Point,
    /// Laws that stand beside it, with what they are worth there, nats.
    pub(crate) standing: Vec<(Law, f64)>,
    /// The scatter.
    pub(crate) left: Left,
}

/// The number of a machine that scatters most from stretch to stretch, and what it is worth.
///
/// Screened by the slopes: a stretch that is off by a few of its deviations is as good as a parabola.
fn worst(cut: &Cut<'_>, point: &Point, work: &mut Work) -> Option<(Scatter, f64)> {
    let problem = cut.problem;
    let each = problem.quadratics(point, Every(1))?;
    work.spend(1 + point.coordinates().len() as u64);
    let stretches = stretches(problem);
    let numbers = || problem.frame.numbers.iter().enumerate().filter(|(_, n)| n.is_stated());
    let promise = |k: usize| {
        let sum = |of: &Vec<usize>| {
            let [g, h] = of
                .iter()
                .fold([0.0, 0.0], |[g, h], o| [g + each[*o].gradient[k], h + each[*o].information[(k, k)]]);
            [if h > 0.0 { -g / h } else { 0.0 }, h]
        };
        let alone: Vec<[f64; 2]> = stretches.iter().map(sum).collect();
        -loss(&alone, likeliest(&alone))
    };
    let price = CRITERIA.price_nats + (numbers().count() as f64).ln();
    let asked = numbers().filter(|(k, _)| promise(*k) - price > cut.level_nats());
    let of = |(_, number): (usize, &Number)| {
        let scatter = Scatter::of(problem, point, *number, work)?;
        let worth = scatter.gain_nats - price;
        Some((scatter, worth))
    };
    asked.filter_map(of).max_by(|a, b| a.1.total_cmp(&b.1)).filter(|s| s.1 > cut.level_nats())
}

/// Asks whether the stretches of a model are of one machine; where they are not, every law must be worth its
/// level beside the scatter, those that are not are taken out. `None`: one machine.
pub(crate) fn scattered(cut: &Cut<'_>, model: &Model, work: &mut Work) -> Option<Scattered> {
    let (mut scatter, mut worth) = worst(cut, &model.point, work)?;
    let mut point = model.point.clone();
    let mut standing: Vec<(Law, f64)> = Vec::new();
    while !point.terms.is_empty() && !work.is_spent() {
        let number = scatter.number;
        let (_, with) = Scatter::fitted(cut.problem, &point, number, work);
        let mut of = |k: usize| {
            let mut without = point.clone();
            let term = without.terms.remove(k);
            let (without, value) = Scatter::fitted(cut.problem, &without, number, work);
            (k, value - with - model.price_of(term.law), without)
        };
        let each: Vec<(usize, f64, Point)> = (0..point.terms.len()).map(&mut of).collect();
        standing = each.iter().map(|(k, nats, _)| (point.terms[*k].law, *nats)).collect();
        let weakest = each.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
        let Some((_, _, without)) = weakest.filter(|w| w.1 < cut.level_nats()) else { break };
        point = without;
        standing.clear();
        if let Some(again) = worst(cut, &point, work) {
            (scatter, worth) = again;
        }
    }
    Some(Scattered { point, standing, left: scatter.left(worth) })
}

#[cfg(test)]
mod tests {
    use super::super::input::CutEvidence;
    use super::super::machine::Frame;
    use super::super::observable::OriginKind;
    use super::*;
    use crate::plant::scenario::Scenario;
    use nalgebra::{DMatrix, DVector};

    /// A stretch that says, some times over and give or take one, where the coordinate of the frequency is.
    struct Said {
        from_s: f64,
        coordinates: Vec<f64>,
        stated_hz: f64,
    }

    impl Observable for Said {
        fn part(&self, machine: &Machine, _: Every) -> Part {
            let over = machine.scenario.workpiece.bending_frequency_hz() / self.stated_hz;
            let at = over.ln() / Number::Frequency.log_sd();
            Part::Rows(self.coordinates.iter().map(|c| at - c).collect())
        }

        fn origin(&self) -> Origin {
            let span_s = [self.from_s, self.from_s + 1.0];
            Origin { kind: OriginKind::Means, recording: Some(0), span_s }
        }
    }

    /// -ln of the density of all values less that of values without scatter, by the whole matrix.
    fn dense(stretches: &[Vec<f64>], variance: f64) -> f64 {
        let of = |x: &Vec<f64>| {
            let n = x.len();
            let own = |a: usize, b: usize| if a == b { 1.0 } else { 0.0 };
            let matrix = DMatrix::from_fn(n, n, |a, b| own(a, b) + variance);
            let x = DVector::from_column_slice(x);
            0.5 * (x.dot(&matrix.clone().lu().solve(&x).unwrap()) + matrix.determinant().ln())
        };
        stretches.iter().map(of).sum()
    }

    fn found(stretches: &[Vec<f64>]) -> Option<Scatter> {
        let scenario = Scenario::default();
        let frame = Frame::of(&scenario, &CutEvidence { recordings: &[], table: None });
        let stated_hz = scenario.workpiece.bending_frequency_hz();
        let said = |(k, x): (usize, &Vec<f64>)| {
            Box::new(Said { from_s: k as f64, coordinates: x.clone(), stated_hz }) as Observed<'_>
        };
        let observables: Vec<Observed<'_>> = stretches.iter().enumerate().map(said).collect();
        let problem = Problem { frame: &frame, observables: &observables };
        Scatter::of(&problem, &frame.origin(), Number::Frequency, &mut Work::new(u64::MAX))
    }

    /// What is normal in its number is integrated exactly: the value is that of the dense normal density of
    /// all values, and no other variance makes it less by more than the steps of the search do.
    #[test]
    fn an_offset_that_is_integrated_out_is_a_dense_normal_density() {
        let stretches =
            [vec![1.9, 2.4, 1.2], vec![-1.6, -2.7], vec![0.3, 1.1, -0.4, 0.2], vec![2.9], vec![-3.1, -1.9]];
        let scatter = found(&stretches).expect("they scatter");
        let tried = (1..400).map(|k| 0.05 * f64::from(k));
        let least = tried.map(|t| dense(&stretches, t)).fold(f64::INFINITY, f64::min);
        assert!((scatter.value - least).abs() < 0.02, "{} {least}", scatter.value);
        let gain = dense(&stretches, 0.0) - least;
        assert!(gain > 5.0 && (scatter.gain_nats - gain).abs() < 0.02, "{} {gain}", scatter.gain_nats);
    }

    /// Stretches that differ by no more than they are known to scatter are of one machine.
    #[test]
    fn noise_is_no_scatter() {
        assert!(found(&[vec![0.6, -0.9], vec![-0.2, 0.8], vec![1.1, -1.3], vec![-0.4, 0.3]]).is_none());
    }
}
