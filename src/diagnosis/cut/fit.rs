//! Fisher scoring of the likelihood: spectra by their whitened derivatives, residuals by their Jacobian.
//!
//! H = sum [ tr(S^-1 S_i S^-1 S_k) + 2 Re x_i^H S^-1 x_k ] + J'J + priors, differences of 2e-3 of a
//! coordinate, Levenberg's damping, steps clipped, coordinates held at their bounds.

use super::super::selection::Work;
use super::super::two_cores::on_two_cores;
use super::criteria::CRITERIA;
use super::laws::{Coordinate, Term};
use super::machine::{Frame, Machine, Number, Point};
use super::matrix::{CHANNELS, Matrix, ZERO, cholesky, forward};
use super::observable::{Bin, Every, Observed, OriginKind, Part};
use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::SQRT_2;

/// Step of the difference quotients, in units of a coordinate.
pub(crate) const STEP: f64 = 2e-3;
/// How often a fit to a table is searched coordinate by coordinate.
const SWEEPS: usize = 6;
/// A step of the fit is no longer than this in any coordinate.
pub(crate) const LONGEST_STEP: f64 = 2.5;

/// Everything observed, and what is free.
pub(crate) struct Problem<'a> {
    /// What is stated and free.
    pub(crate) frame: &'a Frame,
    /// What was observed.
    pub(crate) observables: &'a [Observed<'a>],
}

/// How a fit is run.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Effort {
    /// Steps at most.
    pub(crate) steps: usize,
    /// Bins that are looked at.
    pub(crate) every: Every,
}

impl Effort {
    /// To the end on all bins.
    pub(crate) const FULL: Effort = Effort { steps: 25, every: Every(1) };
}

/// Value, gradient and Fisher information at a point.
#[derive(Debug, Clone)]
pub(crate) struct Quadratic {
    /// -ln L with priors.
    pub(crate) value: f64,
    /// Its gradient.
    pub(crate) gradient: DVector<f64>,
    /// Fisher information.
    pub(crate) information: DMatrix<f64>,
}

impl Quadratic {
    fn empty(p: usize) -> Self {
        Self { value: 0.0, gradient: DVector::zeros(p), information: DMatrix::zeros(p, p) }
    }

    /// Of one part with its neighbours, without priors; of the information the lower half.
    pub(crate) fn of_part(base: &Part, moved: &[&Part], steps: &[f64]) -> Self {
        let mut out = Self { value: part_value(base), ..Self::empty(steps.len()) };
        accumulate(base, moved, steps, &mut out);
        out
    }
}

/// Where a fit ended.
#[derive(Debug, Clone)]
pub(crate) struct Ended {
    /// Point.
    pub(crate) point: Point,
    /// -ln L there.
    pub(crate) value: f64,
    /// Evaluations used.
    pub(crate) evaluations: u64,
    /// Of each effect how many of its coordinates the data determine.
    pub(crate) determined: Vec<f64>,
}

/// rho(r) = r^2 to `outlying_sd`, from there on 2 c |r| - c^2.
fn rho(r: f64) -> f64 {
    let c = CRITERIA.outlying_sd;
    if r.abs() <= c { r * r } else { 2.0 * c * r.abs() - c * c }
}

/// Weight of a residual in gradient and information: rho'(r)/(2 r).
fn influence(r: f64) -> f64 {
    (CRITERIA.outlying_sd / r.abs()).min(1.0)
}

/// Outlying power of a bin of `n` channels; its mean is n, its logarithm falls by one a unit.
fn outlying_power(channels: usize) -> f64 {
    CRITERIA.outlying_sd.powi(2) + channels as f64
}

/// L^-1 dS L^-H, Hermitian, as real numbers whose products are the trace of the product: diagonal, then
/// real and imaginary parts below it times the root of two.
fn whitened(l: &Matrix, ds: &Matrix, n: usize, out: &mut Vec<f64>) {
    let mut half = [[ZERO; CHANNELS]; CHANNELS];
    for c in 0..n {
        let column = forward(l, &[ds[0][c], ds[1][c], ds[2][c]], n);
        for r in 0..n {
            half[r][c] = column[r].conj();
        }
    }
    let rows = [0, 1, 2].map(|r| if r < n { forward(l, &half[r], n) } else { [ZERO; CHANNELS] });
    out.extend((0..n).map(|r| rows[r][r].re));
    for r in 0..n {
        for c in 0..r {
            out.extend([SQRT_2 * rows[r][c].re, -SQRT_2 * rows[r][c].im]);
        }
    }
}

/// u u^H in the same numbers.
fn product(u: &[Complex<f64>; CHANNELS], n: usize, out: &mut Vec<f64>) {
    out.extend((0..n).map(|r| u[r].norm_sqr()));
    for r in 0..n {
        for c in 0..r {
            let both = u[r] * u[c].conj();
            out.extend([SQRT_2 * both.re, SQRT_2 * both.im]);
        }
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// -ln L of a part and of its bins alone, without priors. Infinite: not to be had.
pub(crate) fn part_value(part: &Part) -> f64 {
    match part {
        Part::Rows(rows) => 0.5 * rows.iter().map(|r| rho(*r)).sum::<f64>(),
        Part::Bins { channels, bins } => bins.iter().map(|bin| bin_value(bin, *channels)).sum::<f64>(),
    }
}

/// The same of one bin of `n` channels.
pub(crate) fn bin_value(bin: &Bin, n: usize) -> f64 {
    let c = outlying_power(n);
    let Some(l) = cholesky(&bin.s, n) else { return f64::INFINITY };
    let u = forward(&l, &bin.x, n);
    let power: f64 = u[..n].iter().map(Complex::norm_sqr).sum();
    let log_det: f64 = (0..n).map(|i| 2.0 * l[i][i].re.ln()).sum::<f64>() - bin.log_jacobian;
    (if power <= c { power } else { 2.0 * (c * power).sqrt() - c }) + log_det
}

/// Gradient and information of one part from its neighbours, one a coordinate.
fn accumulate(base: &Part, moved: &[&Part], steps: &[f64], into: &mut Quadratic) {
    let p = moved.len();
    match base {
        Part::Rows(rows) => {
            for (k, r) in rows.iter().enumerate() {
                let slope: Vec<f64> = (0..p)
                    .map(|i| match moved[i] {
                        Part::Rows(other) => (other[k] - r) / steps[i],
                        Part::Bins { .. } => 0.0,
                    })
                    .collect();
                let weight = influence(*r);
                for i in 0..p {
                    into.gradient[i] += weight * r * slope[i];
                    for j in 0..=i {
                        into.information[(i, j)] += weight * slope[i] * slope[j];
                    }
                }
            }
        }
        Part::Bins { channels, bins } => accumulate_bins(*channels, bins, moved, steps, into),
    }
}

fn bins_of(part: &Part) -> &[Bin] {
    match part {
        Part::Bins { bins, .. } => bins,
        Part::Rows(_) => &[],
    }
}

/// The same of bins: tr(S^-1 S_i S^-1 S_k) + 2 Re x_i^H S^-1 x_k.
fn accumulate_bins(n: usize, bins: &[Bin], moved: &[&Part], steps: &[f64], into: &mut Quadratic) {
    let c = outlying_power(n);
    let others: Vec<&[Bin]> = moved.iter().map(|part| bins_of(part)).collect();
    // Numbers of a slope: those of the spectrum, then those of the values, 2 n.
    let (own, width) = (n * n, n * n + 2 * n);
    let mut slopes: Vec<f64> = Vec::with_capacity(width * moved.len());
    let mut power_of: Vec<f64> = Vec::with_capacity(own);
    for (k, bin) in bins.iter().enumerate() {
        let Some(l) = cholesky(&bin.s, n) else { continue };
        let u = forward(&l, &bin.x, n);
        let power: f64 = u[..n].iter().map(Complex::norm_sqr).sum();
        let weight = (c / power).sqrt().min(1.0);
        power_of.clear();
        product(&u, n, &mut power_of);
        slopes.clear();
        for (i, other) in others.iter().enumerate() {
            let (other, over) = (&other[k], 1.0 / steps[i]);
            let mut ds = [[ZERO; CHANNELS]; CHANNELS];
            let mut dx = [ZERO; CHANNELS];
            for r in 0..n {
                dx[r] = (other.x[r] - bin.x[r]) * over;
                for q in 0..n {
                    ds[r][q] = (other.s[r][q] - bin.s[r][q]) * over;
                }
            }
            whitened(&l, &ds, n, &mut slopes);
            let v = forward(&l, &dx, n);
            let scale = (2.0 * weight).sqrt();
            slopes.extend(v[..n].iter().flat_map(|z| [z.re * scale, z.im * scale]));
            let slope = &slopes[i * width..(i + 1) * width];
            let along: f64 = (0..n).map(|r| (v[r].conj() * u[r]).re).sum();
            let trace: f64 = slope[..n].iter().sum();
            into.gradient[i] += (bin.log_jacobian - other.log_jacobian) * over
                + trace
                + weight * (2.0 * along - dot(&slope[..own], &power_of));
        }
        for i in 0..others.len() {
            for j in 0..=i {
                into.information[(i, j)] +=
                    dot(&slopes[i * width..(i + 1) * width], &slopes[j * width..(j + 1) * width]);
            }
        }
    }
}

impl Problem<'_> {
    /// What the machine of a point says of everything; `None`: there is no such machine.
    pub(crate) fn parts(&self, point: &Point, every: Every) -> Option<Vec<Part>> {
        let machine = self.frame.machine(point)?;
        Some(self.observables.iter().map(|o| o.part(&machine, every)).collect())
    }

    /// Priors of a point, nats.
    pub(crate) fn prior(&self, point: &Point) -> f64 {
        let values = point.coordinates();
        let priors = self.frame.priors(point);
        let numbers = point.numbers.len();
        let rho = |(i, (x, [mid, sd])): (usize, (&f64, &[f64; 2]))| Prior::of(i, numbers).rho((x - mid) / sd);
        0.5 * values.iter().zip(&priors).enumerate().map(rho).sum::<f64>()
    }

    /// -ln L with priors.
    pub(crate) fn value(&self, point: &Point, every: Every) -> f64 {
        let Some(parts) = self.parts(point, every) else { return f64::INFINITY };
        parts.iter().map(part_value).sum::<f64>() + self.prior(point)
    }

    /// Steps of the difference quotients; the machines at a point and at its neighbours, one a coordinate.
    fn neighbours(&self, point: &Point) -> Option<(Vec<f64>, Vec<Machine>)> {
        let values = point.coordinates();
        let bounds = self.frame.bounds(point);
        let steps: Vec<f64> =
            values.iter().zip(&bounds).map(|(x, b)| if x + STEP > b[1] { -STEP } else { STEP }).collect();
        let moved = (0..values.len()).map(|i| {
            let mut at = values.clone();
            at[i] += steps[i];
            self.frame.machine(&point.with(&at))
        });
        let machines: Option<Vec<Machine>> =
            std::iter::once(self.frame.machine(point)).chain(moved).collect();
        Some((steps, machines?))
    }

    /// Steps of the difference quotients; by observable its parts at a point and at its neighbours.
    pub(crate) fn jacobian(&self, point: &Point, every: Every) -> Option<(Vec<f64>, Vec<Vec<Part>>)> {
        let (steps, machines) = self.neighbours(point)?;
        Some((steps, on_two_cores(self.observables, |o| o.parts(&machines, every))))
    }

    /// Value, gradient and information; `None`: no such machine.
    ///
    /// Cost: one evaluation and one a coordinate.
    pub(crate) fn quadratic(&self, point: &Point, every: Every) -> Option<Quadratic> {
        let each = self.quadratics(point, every)?;
        let sum = self.with_priors(each, point, point.coordinates().len());
        sum.value.is_finite().then_some(sum)
    }

    /// The same of each observable, without priors; of the information the lower half.
    pub(crate) fn quadratics(&self, point: &Point, every: Every) -> Option<Vec<Quadratic>> {
        let (steps, machines) = self.neighbours(point)?;
        let of_observable = |o: &Observed<'_>| {
            let parts = o.parts(&machines, every);
            let moved: Vec<&Part> = parts[1..].iter().collect();
            Quadratic::of_part(&parts[0], &moved, &steps)
        };
        Some(on_two_cores(self.observables, of_observable))
    }

    /// The sum of what each observable says, with the priors of the coordinates.
    pub(crate) fn with_priors(&self, each: Vec<Quadratic>, point: &Point, p: usize) -> Quadratic {
        let mut sum = each.into_iter().fold(Quadratic::empty(p), |mut sum, q| {
            sum.value += q.value;
            sum.gradient += q.gradient;
            sum.information += q.information;
            sum
        });
        sum.value += self.prior(point);
        let values = point.coordinates();
        for (i, (x, [mid, sd])) in values.iter().zip(self.frame.priors(point)).take(p).enumerate() {
            let r = (x - mid) / sd;
            let weight = Prior::of(i, point.numbers.len()).influence(r);
            sum.gradient[i] += weight * r / sd;
            sum.information[(i, i)] += weight / (sd * sd);
            for j in 0..i {
                sum.information[(j, i)] = sum.information[(i, j)];
            }
        }
        sum
    }

    /// Noise of the force sensor in one recording over that in all, by its own spectra; `None`: it has none.
    pub(crate) fn sensor_level(&self, point: &Point, recording: usize) -> Option<f64> {
        let at = self.frame.numbers.iter().position(|n| *n == Number::Sensor)?;
        let own = |o: &&Observed<'_>| {
            let origin = o.origin();
            let spectra = matches!(origin.kind, OriginKind::Calm | OriginKind::Followed);
            spectra && origin.recording == Some(recording)
        };
        let own: Vec<&Observed<'_>> = self.observables.iter().filter(own).collect();
        let (mut point, before) = (point.clone(), point.numbers[at]);
        for _ in 0..Effort::FULL.steps {
            let mut next = point.clone();
            next.numbers[at] += STEP;
            let machines = [self.frame.machine(&point)?, self.frame.machine(&next)?];
            let each = on_two_cores(&own, |o| {
                let parts = o.parts(&machines, Every(2));
                let q = Quadratic::of_part(&parts[0], &[&parts[1]], &[STEP]);
                [q.gradient[0], q.information[(0, 0)]]
            });
            let [slope, curvature] = each.iter().fold([0.0, 0.0], |s, q| [s[0] + q[0], s[1] + q[1]]);
            if curvature <= 0.0 {
                return None;
            }
            let step = (-slope / curvature).clamp(-LONGEST_STEP, LONGEST_STEP);
            point.numbers[at] += step;
            if step.abs() < STEP {
                break;
            }
        }
        Some(((point.numbers[at] - before) * Number::Sensor.log_sd()).exp())
    }

    /// [`Problem::fit`] while there is work left, taken off it. `None`: it is spent, or no such machine.
    pub(crate) fn fit_within(&self, start: &Point, effort: &Effort, work: &mut Work) -> Option<Ended> {
        if !work.take(1) {
            return None;
        }
        let ended = self.fit(start, effort)?;
        work.spend(ended.evaluations.saturating_sub(1));
        Some(ended)
    }

    /// From a point downhill.
    ///
    /// Where rows of a table take part, the slope is that of the roots next to the measured lines, and jumps
    /// when another root is next: what Fisher scoring leaves is searched coordinate by coordinate, and again.
    pub(crate) fn fit(&self, start: &Point, effort: &Effort) -> Option<Ended> {
        let mut ended = self.descend(start, effort)?;
        if self.frame.has_table() && effort.steps >= Effort::FULL.steps {
            for _ in 0..SWEEPS {
                let before = ended.value;
                self.sweep(&mut ended, effort);
                let again = self.descend(&ended.point, effort)?;
                let evaluations = ended.evaluations + again.evaluations;
                ended = if again.value < ended.value { again } else { ended };
                ended.evaluations = evaluations;
                if before - ended.value < CRITERIA.decides_nothing_nats {
                    break;
                }
            }
        }
        Some(ended)
    }

    /// Each coordinate by itself, a large and a small step either way.
    fn sweep(&self, ended: &mut Ended, effort: &Effort) {
        let bounds = self.frame.bounds(&ended.point);
        let places: Vec<(usize, f64)> =
            (0..bounds.len()).flat_map(|i| [1.0, -1.0, 0.3, -0.3].map(|step| (i, step))).collect();
        let here = ended.point.coordinates();
        let tried = on_two_cores(&places, |(i, step)| {
            let mut to = here.clone();
            to[*i] = (to[*i] + step).clamp(bounds[*i][0], bounds[*i][1]);
            let point = ended.point.with(&to);
            (self.value(&point, effort.every), point)
        });
        ended.evaluations += tried.len() as u64;
        if let Some((value, point)) = tried.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))
            && value < ended.value
        {
            (ended.value, ended.point) = (value, point);
        }
    }

    fn descend(&self, start: &Point, effort: &Effort) -> Option<Ended> {
        let bounds = self.frame.bounds(start);
        let mut point = start.clone();
        let p = bounds.len();
        let (mut damping, mut evaluations) = (1e-3, 0);
        let mut value = f64::INFINITY;
        let mut information = None;
        for _ in 0..effort.steps {
            let q = self.quadratic(&point, effort.every)?;
            evaluations += 1 + p as u64;
            value = q.value;
            let here = point.coordinates();
            let mut better = None;
            for _ in 0..6 {
                let Some(step) = damped_step(&q, &here, &bounds, damping) else { break };
                let to: Vec<f64> =
                    (0..p).map(|i| (here[i] + step[i]).clamp(bounds[i][0], bounds[i][1])).collect();
                let next = point.with(&to);
                let there = self.value(&next, effort.every);
                evaluations += 1;
                if there < value {
                    damping = (damping / 8.0).max(1e-6);
                    better = Some((next, there));
                    break;
                }
                damping = (damping * 6.0).max(1e-3);
            }
            information = Some(q.information);
            let Some((next, there)) = better else { break };
            let gained = value - there;
            point = next;
            value = there;
            if gained < CRITERIA.decides_nothing_nats {
                break;
            }
        }
        let determined = information.map_or_else(Vec::new, |h| self.determined(&point, &h));
        value.is_finite().then_some(Ended { point, value, evaluations, determined })
    }

    /// Of each effect of a point how many of its coordinates the data determine: what a prior holds is free.
    ///
    /// gamma = sum_i (1 - C_ii/sd_i^2), C = H^-1 with the priors in it (MacKay 1992); a mode far above the
    /// band is one number, the yield, whatever the frequency.
    fn determined(&self, point: &Point, information: &DMatrix<f64>) -> Vec<f64> {
        let p = information.nrows();
        let covariance = (information + DMatrix::identity(p, p) * 1e-9).cholesky().map(|c| c.inverse());
        let mut at = point.numbers.len();
        let of_term = |term: &Term| {
            let coordinates = term.law.coordinates();
            let first = at;
            at += coordinates.len();
            let own = |(k, c): (usize, &Coordinate)| {
                let left = covariance.as_ref().map_or(0.0, |h| h[(first + k, first + k)]);
                1.0 - (left / c.prior[1].powi(2)).clamp(0.0, 1.0)
            };
            coordinates.iter().enumerate().map(own).sum()
        };
        point.terms.iter().map(of_term).collect()
    }
}

/// What a coordinate is: its prior is that of a stated number or of an effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Prior {
    /// Student's t with three degrees of freedom: how well a number is stated is itself a statement, and one
    /// that is wrong by a factor is no reason to look for physics.
    Number,
    /// Normal to two standard deviations, then as the root: larger is rare.
    Effect,
}

impl Prior {
    fn of(index: usize, numbers: usize) -> Self {
        if index < numbers { Prior::Number } else { Prior::Effect }
    }

    /// Twice the price, nats.
    fn rho(self, r: f64) -> f64 {
        let c = 2.0;
        match self {
            Prior::Number => 4.0 * (r * r / 3.0).ln_1p(),
            Prior::Effect if r.abs() <= c => r * r,
            Prior::Effect => 2.0 * c * r.abs() - c * c,
        }
    }

    /// rho'(r)/(2 r).
    fn influence(self, r: f64) -> f64 {
        match self {
            Prior::Number => 4.0 / (3.0 + r * r),
            Prior::Effect => (2.0 / r.abs()).min(1.0),
        }
    }
}

/// Solution of (H + damping diag H) step = -g with coordinates at a bound held; clipped.
fn damped_step(q: &Quadratic, here: &[f64], bounds: &[[f64; 2]], damping: f64) -> Option<Vec<f64>> {
    let p = here.len();
    let mut held: Vec<bool> = (0..p)
        .map(|i| {
            (here[i] <= bounds[i][0] && q.gradient[i] > 0.0)
                || (here[i] >= bounds[i][1] && q.gradient[i] < 0.0)
        })
        .collect();
    // A step may run into a bound that the others lean on: hold it and solve again, at most once each.
    for _ in 0..=p {
        let free: Vec<usize> = (0..p).filter(|i| !held[*i]).collect();
        let h = DMatrix::from_fn(free.len(), free.len(), |a, b| {
            let x = q.information[(free[a], free[b])];
            if a == b { x * (1.0 + damping) + 1e-9 } else { x }
        });
        let g = DVector::from_fn(free.len(), |a, _| -q.gradient[free[a]]);
        let solved = h.cholesky()?.solve(&g);
        let mut step = vec![0.0; p];
        for (a, i) in free.iter().enumerate() {
            step[*i] = solved[a].clamp(-LONGEST_STEP, LONGEST_STEP);
        }
        let into = (0..p).find(|i| {
            !held[*i]
                && ((here[*i] <= bounds[*i][0] && step[*i] < 0.0)
                    || (here[*i] >= bounds[*i][1] && step[*i] > 0.0))
        });
        match into {
            Some(i) => held[i] = true,
            None => return Some(step),
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The gradient of the spectra is the slope of their likelihood.
    #[test]
    fn the_gradient_is_the_slope() {
        let z = |re: f64, im: f64| Complex::new(re, im);
        let part = |p: f64| {
            let s = [
                [z(2.0 + p, 0.0), z(0.3, 0.2 * p), ZERO],
                [z(0.3, -0.2 * p), z(1.0 + 0.5 * p * p, 0.0), ZERO],
                [ZERO; CHANNELS],
            ];
            let x = [z(1.0 + p, 0.5), z(-0.7, 0.4 * p), ZERO];
            Part::Bins {
                channels: 2,
                bins: vec![Bin { x, frequency_hz: 100.0, log_jacobian: 0.3 * p * p, s }],
            }
        };
        let (at, step) = (0.3, 1e-6);
        let slope = (part_value(&part(at + step)) - part_value(&part(at - step))) / (2.0 * step);
        let mut q = Quadratic { value: 0.0, gradient: DVector::zeros(1), information: DMatrix::zeros(1, 1) };
        accumulate(&part(at), &[&part(at + step)], &[step], &mut q);
        assert!((q.gradient[0] - slope).abs() < 1e-4 * slope.abs().max(1.0), "{} {slope}", q.gradient[0]);
        assert!(q.information[(0, 0)] > 0.0);
    }

    #[test]
    fn a_residual_beyond_four_deviations_counts_as_its_root() {
        assert!((rho(4.0) - 16.0).abs() < 1e-12 && (rho(10.0) - 64.0).abs() < 1e-12);
        let slope = (rho(10.0 + 1e-6) - rho(10.0)) / 1e-6;
        assert!((slope - 2.0 * influence(10.0) * 10.0).abs() < 1e-4);
    }
}
