//! Noise of an encoder, read off its own recording.

use crate::signal::inner_products::dot;

/// Order of the difference that leaves nothing of the motion.
const ORDER: usize = 10;
/// Length over which the noise is looked at, s.
const BLOCK_S: f64 = 0.1;

/// Step of an encoder that would make the noise of a position by rounding, m.
pub(super) fn rounding_m(position_m: &[f64], rate_hz: f64) -> f64 {
    // A step of q is a noise of q^2 / 12.
    (12.0 * variance_m2(position_m, rate_hz, 0.5)).sqrt()
}

/// Variance of the noise of a position, m2: its tenth differences, a quantile over blocks.
///
/// The gain of the n-th difference for white noise is the binomial (2 n over n); of a motion below a tenth of
/// the rate it leaves less than 1e-4. Checked by: tests::noise_is_read_off_beside_any_motion.
pub(super) fn variance_m2(position_m: &[f64], rate_hz: f64, quantile: f64) -> f64 {
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
    powers.get((quantile * powers.len() as f64) as usize).copied().unwrap_or(0.0)
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
        let found = variance_m2(&noisy, 10_000.0, 0.5);
        // The median of 200 blocks, each good to 8 %.
        assert!((found * 12.0 / 1e-18 - 1.0).abs() < 0.05, "{found}");
    }
}
