//! Noise of an encoder, read off its own recording.

use crate::signal::inner_products::dot;
use std::f64::consts::TAU;

/// Order of the difference that leaves nothing of the motion.
const ORDER: usize = 10;
/// Length over which the noise is looked at, s.
const BLOCK_S: f64 = 0.1;

/// Step of an encoder that would make the noise of a position by rounding, m.
pub(super) fn rounding_m(position_m: &[f64], rate_hz: f64) -> f64 {
    // A step of q is a noise of q^2 / 12.
    (12.0 * variance_m2(position_m, rate_hz)).sqrt()
}

/// Variance of the noise of a position, m2: its tenth differences, the median of blocks.
///
/// The gain of the n-th difference for white noise is the binomial (2 n over n); of a motion below a tenth of
/// the rate it leaves less than 1e-4. Checked by: tests::noise_is_read_off_beside_any_motion.
pub(super) fn variance_m2(position_m: &[f64], rate_hz: f64) -> f64 {
    // Not the mean: an impact is no noise, and an axis at rest inside one step shows none.
    median(block_powers_m2(position_m, rate_hz)).unwrap_or(0.0)
}

/// [`variance_m2`] of blocks in which most samples lie a step apart: only there rounding is the noise of a
/// step. `None`: nowhere.
pub(super) fn variance_across_steps_m2(position_m: &[f64], rate_hz: f64, step_m: f64) -> Option<f64> {
    let crosses = |block: &&[f64]| {
        let apart = block.windows(2).filter(|w| ((w[1] - w[0]) / step_m).round() != 0.0).count();
        2 * apart >= block.len()
    };
    let blocks = position_m.chunks(block(rate_hz)).zip(block_powers_m2(position_m, rate_hz));
    median(blocks.filter(|(x, _)| crosses(x)).map(|(_, power)| power).collect())
}

/// Rows of a block: a difference reaches as many on as its order.
fn block(rate_hz: f64) -> usize {
    ((BLOCK_S * rate_hz) as usize).max(ORDER)
}

/// Power of the tenth differences of each block over what white noise of one unit has there.
fn block_powers_m2(position_m: &[f64], rate_hz: f64) -> Vec<f64> {
    let origin = position_m.first().copied().unwrap_or(0.0);
    let mut x: Vec<f64> = position_m.iter().map(|x| x - origin).collect();
    let mut gain = 1.0;
    for n in 1..=ORDER {
        x = x.windows(2).map(|w| w[1] - w[0]).collect();
        gain *= (2 * n * (2 * n - 1)) as f64 / (n * n) as f64;
    }
    x.chunks(block(rate_hz)).map(|b| dot(b, b) / b.len() as f64 / gain).collect()
}

fn median(mut powers: Vec<f64>) -> Option<f64> {
    powers.sort_by(f64::total_cmp);
    powers.get(powers.len() / 2).copied()
}

/// Speed that steps of an encoder make, as noise of s = q / 12^(1/2), below f:
/// s (2 pi f) (2 f / (3 rate))^(1/2).
///
/// An axis that creeps shows a step whole, q (2 pi f), but only until the next one, and what friction turns
/// too far by it the balance averages. A band narrow enough to hide such steps smears every start and stop.
/// They narrow the band before they widen the speed over which friction turns: that took 10 % of EMPS's
/// viscous friction.
///
/// Checked by: tests::the_speed_that_steps_make_is_that_of_a_rounded_ramp.
pub(super) struct SpeedOfStep {
    pub(super) step_m: f64,
    pub(super) rate_hz: f64,
}

impl SpeedOfStep {
    /// In a band, m/s.
    pub(super) fn at_m_s(&self, hz: f64) -> f64 {
        TAU * hz * self.step_m * (hz / (18.0 * self.rate_hz)).sqrt()
    }

    /// Band in which it is no more than a speed, Hz.
    pub(super) fn band_hz(&self, speed_m_s: f64) -> f64 {
        (speed_m_s / self.at_m_s(1.0).max(1e-300)).powf(2.0 / 3.0)
    }
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

    #[test]
    fn the_speed_that_steps_make_is_that_of_a_rounded_ramp() {
        use super::super::kernel::{Action, Grid, Kernel};
        let (rate_hz, step_m, band_hz) = (1000.0, 1e-4, 20.0);
        let mut uniform = super::super::chance::uniform(2);
        // Several steps a sample, and never the same part of one.
        let (mut x, mut error) = (0.0, Vec::new());
        for _ in 0..40_000 {
            x += step_m * (7.0 + uniform());
            error.push((x / step_m).round() * step_m - x);
        }
        let kernel = Kernel::low_pass(band_hz, rate_hz, Action { derivative: 1, advance_s: 0.0 });
        let first = kernel.half() + 1;
        let v = kernel.apply(&error, Grid { first, step: 1, count: error.len() - 2 * first });
        let found_m_s = (dot(&v, &v) / v.len() as f64).sqrt();
        let of = SpeedOfStep { step_m, rate_hz };
        let said_m_s = of.at_m_s(band_hz);
        // Of a sinc times a Gaussian: (3 / f^3 integral of f^2 |H|^2)^(1/2).
        assert!((found_m_s / said_m_s / 0.870 - 1.0).abs() < 0.07, "{found_m_s} for {said_m_s}");
        assert!((of.band_hz(said_m_s) / band_hz - 1.0).abs() < 1e-9);
    }
}
