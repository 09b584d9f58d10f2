//! Noise of the encoders, read off the recordings, and what it does to the sums of the regression.
//!
//! A position that is measured with noise makes columns with noise: x = x_0 + e. Least squares answers with
//! coefficients that are too small, by the share of the noise in the power of the column (errors in
//! variables): at 1 mm/s a screw's acceleration is less than the noise of its encoder, differentiated twice,
//! and its inertia comes out a third low. The sums X'X hold n times the covariance of e too much; that is
//! known, and is taken out (Fuller, Measurement Error Models, 1987, section 2.2).

use super::motion::{self, Motion};
use super::problem::{Number, Problem, Sides};
use super::weights::Weights;
use crate::plant::drive::DriveParams;
use crate::signal::inner_products::dot;
use nalgebra::{DMatrix, DVector};

/// Order of the difference that leaves nothing of the motion.
const ORDER: usize = 10;
/// Length over which the noise is looked at, s.
const BLOCK_S: f64 = 0.1;
/// Samples that a filter of the balance remembers, and the whitening behind it, at most.
const MEMORY_SAMPLES: usize = 700;

/// Variances of the positions of motor and stage, and the columns that an impulse of either makes.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct EncoderNoise {
    variances_m2: [f64; 2],
    /// Two recordings: impulses of one metre on the motor's position, on the stage's; one at each place
    /// that a sample may have between two of the thinned grid.
    impulses: Box<Problem>,
}

/// Covariance of the noise of the weighted columns and of the target, per instant.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct NoiseShare {
    pub(crate) columns: DMatrix<f64>,
    pub(crate) target: DVector<f64>,
}

impl EncoderNoise {
    /// Reads the noise off `motions`.
    pub(crate) fn new(drive: &DriveParams, motions: &[Motion], step: usize) -> Self {
        let variance = |raw: &dyn Fn(&Motion) -> &[f64]| {
            motions.iter().map(|m| variance_m2(raw(m), m.rate_hz)).fold(f64::INFINITY, f64::min)
        };
        let variances_m2 = [variance(&|m| &m.motor.raw_m), variance(&|m| &m.stage.raw_m)];
        let rate_hz = motions.first().map_or(1.0, |m| m.rate_hz);
        let apart = MEMORY_SAMPLES.next_multiple_of(step) + 1;
        let mut pulses = vec![0.0; apart * (step + 2)];
        (1..=step).for_each(|k| pulses[k * apart] = 1.0);
        let still = vec![0.0; pulses.len()];
        let motions = [[&pulses, &still], [&still, &pulses]]
            .map(|[motor_m, stage_m]| motion::of_positions(drive, rate_hz, [motor_m, stage_m]));
        let mut impulses = Problem::new(drive, motions.to_vec());
        let silenced = impulses.numbers.iter().cloned().map(|number| {
            // Bounded, and of noise far below the speed at which it turns: nothing.
            let coulomb = number.key.is_some_and(|key| key.contains("coulomb"));
            if coulomb { Number { column: vec![Sides::default(); 2], ..number } } else { number }
        });
        impulses.numbers = silenced.collect();
        Self { variances_m2, impulses: Box::new(impulses) }
    }

    /// Steps of encoders that would make as much noise by rounding, m.
    pub(crate) fn steps_m(&self) -> [f64; 2] {
        self.variances_m2.map(step_m)
    }

    /// What the noise adds to the products of the numbers' columns in an instant, among `columns` in all.
    ///
    /// White noise of variance s^2 through a filter with impulse response h has the variance s^2 sum h^2: the
    /// sums over one impulse at every place of the grid.
    pub(crate) fn share(&self, problem: &Problem, weights: &Weights, columns: usize) -> NoiseShare {
        let p = &self.impulses;
        let left = self.stage_residual(problem);
        let weights = weights.beside(p.layout(), &left);
        let known = p.numbers.iter().take_while(|n| n.key.is_some()).count();
        let mut weighed: Vec<Vec<f64>> = p.numbers[..known].iter().map(|n| weights.weigh_number(n)).collect();
        weighed.push(weights.weigh_thrust(&p.target));
        let ends = [0, weights.layout.start(1, 0), weights.layout.total()];
        let product = |a: &[f64], b: &[f64]| -> f64 {
            let of = |k: usize| dot(&a[ends[k]..ends[k + 1]], &b[ends[k]..ends[k + 1]]);
            self.variances_m2[0] * of(0) + self.variances_m2[1] * of(1)
        };
        let mut share =
            NoiseShare { columns: DMatrix::zeros(columns, columns), target: DVector::zeros(columns) };
        for a in 0..known {
            for b in 0..known {
                share.columns[(a, b)] = product(&weighed[a], &weighed[b]);
            }
            share.target[a] = product(&weighed[a], &weighed[known]);
        }
        share
    }

    /// What the impulses leave of the stage balance at the present numbers.
    fn stage_residual(&self, problem: &Problem) -> Vec<Sides> {
        let m = &problem.mechanics;
        let mut out = vec![Sides::default(); 2];
        for Number { key, column, .. } in self.impulses.numbers.iter() {
            let b = match key {
                Some("axial_stiffness_n_m") => problem.fitted_stiffness_n_m,
                Some("structural_damping_n_s_m") => m.structural_damping_n_s_m,
                Some("movable_mass_kg") => m.stage_mass_kg,
                Some("translational_damping_n_s_m") => m.stage_damping_n_s_m,
                _ => continue,
            };
            super::bench::add(&mut out, column, -b);
        }
        out.iter_mut().for_each(|s| s.motor = None);
        out
    }
}

/// Step of an encoder that makes noise of a variance by rounding, m.
fn step_m(variance_m2: f64) -> f64 {
    (12.0 * variance_m2).sqrt()
}

/// Step of an encoder that would make the noise of a position by rounding, m.
pub(super) fn rounding_m(position_m: &[f64], rate_hz: f64) -> f64 {
    step_m(variance_m2(position_m, rate_hz))
}

/// Variance of the noise of a position, m2: its tenth differences, the median over blocks.
///
/// The gain of the n-th difference for white noise is the binomial (2 n over n); of a motion below a tenth of
/// the rate it leaves less than 1e-4. Checked by: tests::noise_is_read_off_beside_any_motion.
pub(super) fn variance_m2(position_m: &[f64], rate_hz: f64) -> f64 {
    let origin = position_m.first().copied().unwrap_or(0.0);
    let mut x: Vec<f64> = position_m.iter().map(|x| x - origin).collect();
    let mut gain = 1.0;
    for n in 1..=ORDER {
        x = x.windows(2).map(|w| w[1] - w[0]).collect();
        gain *= (2 * n * (2 * n - 1)) as f64 / (n * n) as f64;
    }
    let block = ((BLOCK_S * rate_hz) as usize).max(1);
    let mut powers: Vec<f64> = x.chunks(block).map(|b| dot(b, b) / b.len() as f64 / gain).collect();
    powers.sort_by(f64::total_cmp);
    // Not the mean: an impact is no noise, and an axis at rest inside one step shows none.
    powers.get(powers.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_read_off_beside_any_motion() {
        let mut uniform = super::super::chance::uniform(1);
        let noisy: Vec<f64> = (0..200_000)
            .map(|k| 1e-2 * (k as f64 * 1e-3).sin() + 1e-6 * (k as f64 * 0.2).sin() + 1e-9 * uniform())
            .collect();
        let found = variance_m2(&noisy, 10_000.0);
        // The median of 200 blocks, each good to 8 %.
        assert!((found * 12.0 / 1e-18 - 1.0).abs() < 0.05, "{found}");
    }
}
