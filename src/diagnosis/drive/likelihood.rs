//! Profile likelihood of a balance: noise spectrum free and constant within a band, numbers free, with the
//! Jacobian of the force balance.
//!
//! ```text
//! L(beta) = sum_rb N_rb log det S_rb(beta) - sum_w log |det P(w; beta)|^2,   S_rb = mean of r r^T in a band
//! ```
//! What is left unexplained raises S and so lowers the evidence of everything in its band. The
//! Jacobian P (see [`super::dynamics`]; of one position it is the mass) makes it the likelihood of motion:
//! without it an equation whose thrust is filtered away becomes zero by making its masses zero.

use super::dynamics::Dynamics;
use super::gram::{BandGram, Gram};
use super::number::Number;
use crate::diagnosis::criteria::{Criteria, Z95};
use crate::signal::inner_products::dot;
use nalgebra::{DMatrix, DVector};
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Iterations of the reweighted fit at most.
pub(super) const ITERATIONS: usize = 60;
/// Share of a band's own power below which no residual is told from rounding.
const ROUNDING: f64 = 1e-11;
/// A mass changes by no more than this factor in a step.
const MASS_STEP: f64 = 0.4;

/// What is fitted: places in the Gram matrices.
#[derive(Debug, Clone)]
pub(super) struct Design {
    /// Past the last column: nothing is fitted to.
    pub(super) target: usize,
    pub(super) columns: Vec<usize>,
    /// Bounds of each coefficient.
    pub(super) bounds: Vec<[f64; 2]>,
    /// Columns that are masses, by place in `columns`, with what the target holds of them already.
    pub(super) masses: Vec<(usize, f64)>,
    /// Dry friction of motor and stage.
    pub(super) dry: Vec<DryFriction>,
    /// The axis as the coefficients make it.
    pub(super) dynamics: Dynamics,
    /// 1 or 2.
    pub(super) sides: usize,
}

/// A dry friction, by places in [`Design::columns`].
#[derive(Debug, Clone)]
pub(super) struct DryFriction {
    pub(super) level: usize,
    /// Forms in which parts of it turn: together no more than the level.
    pub(super) parts: Vec<usize>,
}

impl DryFriction {
    /// True where the level may move, and is bounded below.
    fn is_free(&self, bounds: &[[f64; 2]]) -> bool {
        let [low, high] = bounds[self.level];
        low < high && low.is_finite()
    }
}

/// A coefficient without bounds.
pub(super) const FREE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// One that physics allows no sign to.
pub(super) const POSITIVE: [f64; 2] = [0.0, f64::INFINITY];

/// Symmetric 2x2: motor, both, stage.
pub(super) type Spread = [f64; 3];

/// Coefficients at the least L.
#[derive(Debug, Clone)]
pub(super) struct Fit {
    pub(super) beta: Vec<f64>,
    /// L, nats.
    pub(super) nats: f64,
    /// True where a coefficient is held at a bound.
    pub(super) held: Vec<bool>,
    /// Half the curvature of L: the inverse covariance.
    pub(super) information: DMatrix<f64>,
}

impl Design {
    fn coefficients(&self, beta: &[f64], n: usize) -> Vec<f64> {
        let mut c = vec![0.0; n];
        if let Some(target) = c.get_mut(self.target) {
            *target = 1.0;
        }
        self.columns.iter().zip(beta).for_each(|(k, b)| c[*k] -= b);
        c
    }

    /// Mean square residual of a band, N2 per value.
    pub(super) fn spread(&self, band: &BandGram, beta: &[f64]) -> Spread {
        let n = band.order;
        let c = self.coefficients(beta, n);
        let used: Vec<usize> = (0..n).filter(|k| c[*k] != 0.0 && band.acts(*k)).collect();
        let quadratic = |kind: usize| {
            let row = |i: usize| &band.products[kind][i * n..(i + 1) * n];
            used.iter().map(|i| c[*i] * dot(row(*i), &c)).sum::<f64>()
        };
        let scale = |kind: usize| {
            used.iter().map(|i| c[*i].powi(2) * band.products[kind][i * n + i]).sum::<f64>() * ROUNDING
        };
        let kinds = [0, 1, 2].map(|k| if self.sides == 2 || k == 0 { quadratic(k) } else { 0.0 });
        let floor = [scale(0), if self.sides == 2 { scale(2) } else { 0.0 }];
        [
            (kinds[0].max(0.0) + floor[0]).max(1e-300) / band.values,
            kinds[1] / band.values,
            (kinds[2].max(0.0) + floor[1]).max(1e-300) / band.values,
        ]
    }

    /// Bands, `(recording, band)`, in which the recorded force, friction and further laws taken off, is more
    /// than three times what the motor's motion needs. A disturbance that moves the axis adds to the motion.
    pub(super) fn idle(&self, bands: &[BandGram], numbers: &[Number], beta: &[f64]) -> Vec<(usize, usize)> {
        let part = |moves: bool| -> Vec<f64> {
            let is = |k: usize| numbers.get(k).is_some_and(|n| n.is_linear_in_motion());
            beta.iter().enumerate().map(|(k, b)| if is(k) == moves { *b } else { 0.0 }).collect()
        };
        let [others, motion] = [false, true].map(part);
        let is_idle = |b: &&BandGram| {
            let needed = Self { target: b.order, ..self.clone() }.spread(b, &motion)[0];
            self.spread(b, &others)[0].sqrt() > Criteria::STANDARD.idle * needed.sqrt()
        };
        bands.iter().filter(is_idle).map(|b| (b.recording, b.band)).collect()
    }

    fn log_det(&self, s: Spread) -> f64 {
        if self.sides == 1 { s[0].ln() } else { determinant(s).ln() }
    }

    /// L of these coefficients, nats.
    pub(super) fn nats(&self, bands: &[BandGram], beta: &[f64]) -> f64 {
        self.nats_of(bands, &self.spreads(bands, beta), beta)
    }

    fn spreads(&self, bands: &[BandGram], beta: &[f64]) -> Vec<Spread> {
        bands.iter().map(|b| self.spread(b, beta)).collect()
    }

    fn nats_of(&self, bands: &[BandGram], spreads: &[Spread], beta: &[f64]) -> f64 {
        let of = |(b, s): (&BandGram, &Spread)| 0.5 * b.values * self.log_det(*s);
        bands.iter().zip(spreads).map(of).sum::<f64>() - self.jacobian(bands, beta)
    }

    /// Log of the Jacobian from forces to motion, nats.
    fn jacobian(&self, bands: &[BandGram], beta: &[f64]) -> f64 {
        if self.dynamics.is_rigid() {
            return 2.0 * values(bands) * self.log_masses(beta);
        }
        self.dynamics.log_det(bands, beta)
    }

    /// Further columns of the Gram matrices, free or between bounds.
    pub(super) fn add(&mut self, gram: &Gram, columns: std::ops::Range<usize>, bounds: Vec<[f64; 2]>) {
        for column in columns {
            self.dynamics.add(self.columns.len(), gram.column(column));
            self.columns.push(column);
        }
        self.bounds.extend(bounds);
    }

    fn log_masses(&self, beta: &[f64]) -> f64 {
        self.masses.iter().map(|(k, held)| (held + beta[*k]).max(1e-12).ln()).sum()
    }

    /// Inverse of a spread; a single side has the first alone.
    pub(super) fn weight(&self, s: Spread) -> Spread {
        if self.sides == 1 {
            return [1.0 / s[0], 0.0, 0.0];
        }
        let det = determinant(s);
        [s[2] / det, -s[1] / det, s[0] / det]
    }

    /// Weights that the residuals of these coefficients give.
    pub(super) fn weights(&self, bands: &[BandGram], beta: &[f64]) -> Vec<Spread> {
        self.spreads(bands, beta).into_iter().map(|s| self.weight(s)).collect()
    }

    /// Fits from `beta`; the first step is taken with `weights`.
    pub(super) fn fit(&self, bands: &[BandGram], beta: Vec<f64>, weights: Vec<Spread>) -> Fit {
        let weights_of = |s: &[Spread]| s.iter().map(|s| self.weight(*s)).collect::<Vec<_>>();
        self.iterated(bands, beta, &weights, |spreads| Some(self.normal(bands, &weights_of(spreads))))
    }

    /// Fits a part from `beta` under weights that stay: the noise spectrum is known from all. A part alone
    /// may give up what is slow for a spectrum of its own, and foretell nothing.
    pub(super) fn fit_under(&self, bands: &[BandGram], beta: &[f64], weights: &[Spread]) -> Vec<f64> {
        self.iterated(bands, beta.to_vec(), weights, |_| None).beta
    }

    /// Newton steps until L stands; `reweighted`: the normal equations under the weights of what new
    /// coefficients leave.
    fn iterated(
        &self,
        bands: &[BandGram],
        mut beta: Vec<f64>,
        weights: &[Spread],
        reweighted: impl Fn(&[Spread]) -> Option<(DMatrix<f64>, DVector<f64>)>,
    ) -> Fit {
        let mut nats = f64::INFINITY;
        let mut held = vec![None; beta.len()];
        // Where not even the first step is finite nothing is known: no information about any number.
        let mut information = DMatrix::zeros(beta.len(), beta.len());
        let mut normal = self.normal(bands, weights);
        for _ in 0..ITERATIONS {
            let (next, bound, curved) = self.step(bands, (&normal.0, &normal.1), &beta, &held);
            let left = self.spreads(bands, &next);
            let now = self.nats_of(bands, &left, &next);
            if !now.is_finite() {
                break;
            }
            let gained = nats - now;
            (beta, held, information, nats) = (next, bound, curved, now);
            if gained.abs() < Criteria::STANDARD.converged_nats {
                break;
            }
            normal = reweighted(&left).unwrap_or(normal);
        }
        let mut held: Vec<bool> = held.iter().map(Option::is_some).collect();
        // The rest of a level is held where its parts are all of it.
        for dry in self.dry.iter().filter(|dry| dry.is_free(&self.bounds)) {
            held[dry.level] &= dry.parts.iter().all(|part| held[*part]);
        }
        Fit { beta, nats, held, information }
    }

    /// Half the gradient of L on a part of the values, under weights.
    pub(super) fn score(&self, bands: &[BandGram], weights: &[Spread], beta: &[f64]) -> DVector<f64> {
        let (a, b) = self.normal(bands, weights);
        let mut slope = DVector::zeros(beta.len());
        let mut unused = DMatrix::zeros(beta.len(), beta.len());
        self.dynamics.curve(bands, beta, &mut unused, &mut slope);
        if self.dynamics.is_rigid() {
            let total = values(bands);
            self.masses.iter().for_each(|(k, held)| slope[*k] -= total / (held + beta[*k]).max(1e-12));
        }
        a * DVector::from_column_slice(beta) - b + slope
    }

    /// ln det of an information about the coefficients that are free to move. `None`: it is none.
    pub(super) fn log_det_free(&self, a: &DMatrix<f64>) -> Option<f64> {
        let (_, scale, m) = scaled(a, |k| self.bounds[k][0] >= self.bounds[k][1]);
        let of_scaled: f64 = m.cholesky()?.l_dirty().diagonal().iter().map(|d| d.ln()).sum();
        Some(2.0 * (of_scaled - scale.iter().map(|s| s.ln()).sum::<f64>()))
    }

    /// What the values tell of the coefficients under weights, without the Jacobian.
    pub(super) fn told_by_values(&self, bands: &[BandGram], weights: &[Spread]) -> DMatrix<f64> {
        self.normal(bands, weights).0
    }

    /// Normal equations under weights.
    fn normal(&self, bands: &[BandGram], weights: &[Spread]) -> (DMatrix<f64>, DVector<f64>) {
        let p = self.columns.len();
        let (mut a, mut b) = (DMatrix::zeros(p, p), DVector::zeros(p));
        for (band, w) in bands.iter().zip(weights) {
            let n = band.order;
            let [mm, ms, ss] = &band.products;
            let both = self.sides == 2;
            let at = |i: usize, j: usize| {
                let k = i * n + j;
                let first = w[0] * mm[k];
                if both { first + w[2] * ss[k] + 2.0 * w[1] * ms[k] } else { first }
            };
            // N_rb over the values of the mean: a half, since blocks overlap by half.
            let acting: Vec<usize> = (0..p).filter(|k| band.acts(self.columns[*k])).collect();
            for (place, k) in acting.iter().enumerate() {
                for l in &acting[..=place] {
                    a[(*k, *l)] += 0.5 * at(self.columns[*k], self.columns[*l]);
                }
                b[*k] += 0.5 * at(self.columns[*k], self.target);
            }
        }
        for k in 0..p {
            for l in 0..k {
                a[(l, k)] = a[(k, l)];
            }
        }
        (a, b)
    }

    /// What the noise of each band makes of the normal equations more than the one level does under which all
    /// bands were fitted: X^H W (S_b - S) W X. Zero where every band has its own level.
    pub(super) fn noise_by_band(
        &self,
        by_band: &[BandGram],
        (bands, weights): (&[BandGram], &[Spread]),
        beta: &[f64],
    ) -> DMatrix<f64> {
        if self.sides == 2 {
            return DMatrix::zeros(beta.len(), beta.len());
        }
        let level = |b: &BandGram| bands.iter().position(|o| o.recording == b.recording);
        let of = |b: &BandGram| {
            level(b).map_or([0.0; 3], |k| [weights[k][0].powi(2) * self.spread(b, beta)[0], 0.0, 0.0])
        };
        let seen: Vec<Spread> = by_band.iter().map(of).collect();
        self.normal(by_band, &seen).0 - self.normal(bands, weights).0
    }

    /// One Newton step of the weighted squares and the mass term, bounds held. `at`: coefficients, and where
    /// the last step held them.
    fn step(
        &self,
        bands: &[BandGram],
        (a, b): (&DMatrix<f64>, &DVector<f64>),
        beta: &[f64],
        at: &[Option<f64>],
    ) -> (Vec<f64>, Vec<Option<f64>>, DMatrix<f64>) {
        let p = self.columns.len();
        let total = values(bands);
        let mut curved = a.clone();
        let mut pull = b.clone();
        if !self.dynamics.is_rigid() {
            let mut slope = DVector::zeros(p);
            let before = curved.clone();
            self.dynamics.curve(bands, beta, &mut curved, &mut slope);
            pull += (&curved - before) * DVector::from_column_slice(beta) - slope;
        }
        for (k, held) in self.masses.iter().filter(|_| self.dynamics.is_rigid()) {
            // -2 N log M against 2 A in half units: gradient N / M, curvature N / M2.
            let m = (held + beta[*k]).max(1e-12);
            let c = total / (m * m);
            curved[(*k, *k)] += c;
            pull[*k] += total / m + c * beta[*k];
        }
        let (mut next, held) = within_levels((&curved, &pull), (&self.bounds, &self.dry), at);
        for (k, held) in &self.masses {
            let m = (held + beta[*k]).max(1e-12);
            next[*k] = (held + next[*k]).clamp(MASS_STEP * m, m / MASS_STEP) - held;
        }
        (next, held, curved)
    }
}

/// Weights of the bands of a part, by those of all.
pub(super) fn weights_of(part: &[BandGram], (all, weights): (&[BandGram], &[Spread])) -> Vec<Spread> {
    let of = |b: &BandGram| {
        let same = |o: &BandGram| (o.recording, o.band) == (b.recording, b.band);
        all.iter().position(same).map_or([0.0; 3], |k| weights[k])
    };
    part.iter().map(of).collect()
}

/// Complex values in all bands, halved for the overlap.
pub(super) fn values(bands: &[BandGram]) -> f64 {
    0.5 * bands.iter().map(|b| b.values).sum::<f64>()
}

fn determinant(s: Spread) -> f64 {
    (s[0] * s[2] - s[1] * s[1]).max(1e-12 * s[0] * s[2])
}

/// The places that are free, their columns' scales to one, and their part of a matrix so scaled.
fn scaled(a: &DMatrix<f64>, is_held: impl Fn(usize) -> bool) -> (Vec<usize>, Vec<f64>, DMatrix<f64>) {
    let free: Vec<usize> = (0..a.nrows()).filter(|k| !is_held(*k)).collect();
    let scale: Vec<f64> = free.iter().map(|k| a[(*k, *k)].max(1e-300).sqrt().recip()).collect();
    let m = DMatrix::from_fn(free.len(), free.len(), |i, j| {
        let ridge = if i == j { 1e-13 } else { 0.0 };
        a[(free[i], free[j])] * scale[i] * scale[j] + ridge
    });
    (free, scale, m)
}

/// Coefficients at the least of half b'Ab - b'p between their bounds, and which are held at one: the first
/// that is outside is held, or of those that are held the first that is drawn inside is let go, until there
/// is none (Murty's least index, finite for a convex form from any beginning: `at`, what was held before).
///
/// Checked by: tests::coefficients_between_bounds_are_those_of_coordinate_descent.
fn between_bounds(
    (a, pull): (&DMatrix<f64>, &DVector<f64>),
    bounds: &[[f64; 2]],
    at: &[Option<f64>],
) -> (Vec<f64>, Vec<Option<f64>>) {
    let fixed = |[low, high]: &[f64; 2]| (low >= high).then_some(*low);
    let mut held: Vec<Option<f64>> = bounds.iter().zip(at).map(|(b, at)| fixed(b).or(*at)).collect();
    let mut next = solve(a, pull, &held);
    for _ in 0..4 * bounds.len() {
        let flipped = |(k, [low, high]): (usize, &[f64; 2])| match held[k] {
            None if next[k] < *low => Some((k, Some(*low))),
            None if next[k] > *high => Some((k, Some(*high))),
            Some(at) if low < high => {
                let parts = || next.iter().enumerate().map(|(j, x)| a[(k, j)] * x);
                let inside = pull[k] - parts().sum::<f64>();
                let drawn = if at == *low { inside } else { -inside };
                let rounding = 1e-9 * (pull[k].abs() + parts().map(f64::abs).sum::<f64>());
                (drawn > rounding).then_some((k, None))
            }
            _ => None,
        };
        let Some((k, to)) = bounds.iter().enumerate().find_map(flipped) else { return (next, held) };
        held[k] = to;
        next = solve(a, pull, &held);
    }
    // Out of turns: what is outside is held, too.
    for (k, [low, high]) in bounds.iter().enumerate() {
        let inside = next[k].max(*low).min(*high);
        if inside != next[k] {
            (next[k], held[k]) = (inside, Some(inside));
        }
    }
    (next, held)
}

/// The same where parts of a level that is free are no more than it, `b_l >= sum b_k`: beside them the rest
/// of the level, `b_l - sum b_k`, is what has a bound. It is held where the parts are all of the level.
///
/// Checked by: tests::parts_of_a_level_are_no_more_than_it.
fn within_levels(
    (a, pull): (&DMatrix<f64>, &DVector<f64>),
    (bounds, dry): (&[[f64; 2]], &[DryFriction]),
    at: &[Option<f64>],
) -> (Vec<f64>, Vec<Option<f64>>) {
    let dry: Vec<&DryFriction> = dry.iter().filter(|dry| dry.is_free(bounds)).collect();
    let (mut a, mut pull, mut bounds) = (a.clone(), pull.clone(), bounds.to_vec());
    for DryFriction { level, parts } in &dry {
        for part in parts {
            (0..a.nrows()).for_each(|k| a[(k, *part)] += a[(k, *level)]);
            (0..a.ncols()).for_each(|k| a[(*part, k)] += a[(*level, k)]);
            pull[*part] += pull[*level];
            bounds[*level][0] -= bounds[*part][0];
            if bounds[*part][0] < bounds[*part][1] {
                bounds[*part][1] = f64::INFINITY;
            }
        }
    }
    let (mut next, held) = between_bounds((&a, &pull), &bounds, at);
    for DryFriction { level, parts } in dry {
        next[*level] += parts.iter().map(|part| next[*part]).sum::<f64>();
    }
    (next, held)
}

/// Solves with columns scaled to one; held coefficients keep their value.
fn solve(a: &DMatrix<f64>, b: &DVector<f64>, held: &[Option<f64>]) -> Vec<f64> {
    let (free, scale, m) = scaled(a, |k| held[k].is_some());
    let mut beta: Vec<f64> = held.iter().map(|h| h.unwrap_or(0.0)).collect();
    let v = DVector::from_fn(free.len(), |i, _| {
        let fixed: f64 = held.iter().enumerate().filter_map(|(k, h)| h.map(|h| a[(free[i], k)] * h)).sum();
        (b[free[i]] - fixed) * scale[i]
    });
    let solution = match m.clone().cholesky() {
        Some(c) => Some(c.solve(&v)),
        None => m.lu().solve(&v),
    };
    if let Some(x) = solution {
        free.iter().enumerate().for_each(|(i, k)| beta[*k] = x[i] * scale[i]);
    }
    beta
}

impl Fit {
    /// Variances of the coefficients by the curvature of L under the noise that each band has (`by_band`, see
    /// [`Design::noise_by_band`]), and by how the parts of the recordings differ (`scores`: half the gradient
    /// of L on each): what is wrong with the model is not the same in all of them. The larger counts. Held
    /// ones have none of their own.
    pub(super) fn variances(&self, scores: &[DVector<f64>], by_band: &DMatrix<f64>) -> Vec<f64> {
        let inverse = self.inverse();
        let seen = &inverse + &inverse * by_band * &inverse;
        let parts = scores.len().max(2) as f64;
        // Few parts tell their own spread badly.
        let few = StudentsT::new(0.0, 1.0, parts - 1.0).map_or(1.0, |t| t.inverse_cdf(0.975) / Z95);
        let apart: Vec<DVector<f64>> = scores.iter().map(|s| &inverse * s).collect();
        let of = |k: usize| {
            let between = apart.iter().map(|a| a[k] * a[k]).sum::<f64>() * few * few * parts / (parts - 1.0);
            // L has twice the information as its second derivative, and exp(-L) is the likelihood.
            between.max(0.5 * Criteria::STANDARD.serial.powi(2) * seen[(k, k)])
        };
        (0..self.beta.len()).map(of).collect()
    }

    /// Inverse of the information; zero for what is held.
    pub(super) fn inverse(&self) -> DMatrix<f64> {
        let p = self.beta.len();
        let (free, scale, m) = scaled(&self.information, |k| self.held[k]);
        let inverse = m.try_inverse().unwrap_or_else(|| DMatrix::identity(free.len(), free.len()) * 1e12);
        let mut out = DMatrix::zeros(p, p);
        for (i, k) in free.iter().enumerate() {
            for (j, l) in free.iter().enumerate() {
                out[(*k, *l)] = inverse[(i, j)] * scale[i] * scale[j];
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Least of half b'Ab - b'p by one coefficient after another, each between its bounds.
    fn descended(a: &DMatrix<f64>, pull: &DVector<f64>, bounds: &[[f64; 2]]) -> Vec<f64> {
        let mut x: Vec<f64> = bounds.iter().map(|[low, high]| low.max(0.0).min(*high)).collect();
        for _ in 0..20_000 {
            for k in 0..x.len() {
                let others: f64 = (0..x.len()).filter(|j| *j != k).map(|j| a[(k, j)] * x[j]).sum();
                x[k] = ((pull[k] - others) / a[(k, k)]).max(bounds[k][0]).min(bounds[k][1]);
            }
        }
        x
    }

    #[test]
    fn coefficients_between_bounds_are_those_of_coordinate_descent() {
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..200 {
            let p = 6;
            let m = DMatrix::from_fn(p + 2, p, |_, _| rng.random_range(-1.0..1.0));
            let a = m.transpose() * &m + DMatrix::identity(p, p) * 0.05;
            let pull = DVector::from_fn(p, |_, _| rng.random_range(-1.0..1.0));
            let kinds = [FREE, POSITIVE, [0.0, 0.3], [0.2, 0.2]];
            let bounds: Vec<[f64; 2]> = (0..p).map(|_| kinds[rng.random_range(0..4)]).collect();
            let (found, held) = between_bounds((&a, &pull), &bounds, &vec![None; p]);
            let again = between_bounds((&a, &pull), &bounds, &held);
            let at_low: Vec<_> = bounds.iter().map(|b| (b[0] > f64::NEG_INFINITY).then_some(b[0])).collect();
            assert_eq!(between_bounds((&a, &pull), &bounds, &at_low), again);
            assert_eq!(again, (found.clone(), held.clone()), "{bounds:?}");
            let apart = found.iter().zip(descended(&a, &pull, &bounds)).map(|(x, y)| (x - y).abs());
            assert!(apart.fold(0.0, f64::max) < 1e-6, "{bounds:?}");
            let at = held.iter().zip(&found).all(|(h, x)| h.is_none_or(|h| h == *x));
            assert!(at, "{held:?} {found:?}");
        }
    }

    #[test]
    fn parts_of_a_level_are_no_more_than_it() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let levels = [DryFriction { level: 1, parts: vec![2, 3] }];
        for _ in 0..200 {
            let p = 5;
            let m = DMatrix::from_fn(p + 2, p, |_, _| rng.random_range(-1.0..1.0));
            let a = m.transpose() * &m + DMatrix::identity(p, p) * 0.05;
            let pull = DVector::from_fn(p, |_, _| rng.random_range(-1.0..1.0));
            let bounds = [FREE, POSITIVE, [0.0, 0.3], [0.0, 0.3], FREE];
            let (found, held) = within_levels((&a, &pull), (&bounds, &levels), &vec![None; p]);
            assert_eq!(within_levels((&a, &pull), (&bounds, &levels), &held).0, found);
            // The same from where it stands, as a knockoff has it.
            let shifted: Vec<_> = bounds.iter().zip(&found).map(|(b, x)| b.map(|b| b - x)).collect();
            let beside = &pull - &a * DVector::from_column_slice(&found);
            let (none, _) = within_levels((&a, &beside), (&shifted, &levels), &vec![None; p]);
            assert!(none.iter().all(|x| x.abs() < 1e-8), "{none:?}");
            let is_allowed = |x: &[f64]| x[2] >= 0.0 && x[3] >= 0.0 && x[1] - x[2] - x[3] >= -1e-12;
            let form = |x: &[f64]| {
                let x = DVector::from_column_slice(x);
                0.5 * x.dot(&(&a * &x)) - pull.dot(&x)
            };
            assert!(is_allowed(&found), "{found:?}");
            for _ in 0..300 {
                let other: Vec<f64> = found.iter().map(|x| x + rng.random_range(-0.1..0.1)).collect();
                assert!(!is_allowed(&other) || form(&other) >= form(&found) - 1e-9, "{other:?} {found:?}");
            }
        }
    }
}
