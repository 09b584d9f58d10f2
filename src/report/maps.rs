//! Where a residual sits: means over bins of a coordinate, and its spectrum.

use realfft::RealFftPlanner;
use std::f64::consts::TAU;

/// Mean of a bin with twice its standard error.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Bin {
    pub(super) at: f64,
    pub(super) mean: f64,
    pub(super) spread: f64,
}

/// Means of `y` over `count` equal bins of `x` in `range`; bins with fewer than `least` values are left out.
///
/// spread = 2 s / sqrt(n / correlation): neighbouring values of a band-limited series are not independent, so
/// only every `correlation`-th counts.
pub(super) fn binned(pairs: impl Iterator<Item = (f64, f64)>, range: [f64; 2], count: usize) -> Vec<Bin> {
    const LEAST: f64 = 8.0;
    const CORRELATION: f64 = 3.0;
    let mut sums = vec![[0.0_f64; 3]; count];
    let width = (range[1] - range[0]) / count as f64;
    for (x, y) in pairs {
        let place = (x - range[0]) / width;
        if place >= 0.0 && place < count as f64 && y.is_finite() {
            let slot = &mut sums[place as usize];
            *slot = [slot[0] + 1.0, slot[1] + y, slot[2] + y * y];
        }
    }
    let full = sums.iter().enumerate().filter(|(_, s)| s[0] >= LEAST);
    full.map(|(k, [n, sum, squares])| {
        let mean = sum / n;
        let variance = (squares / n - mean * mean).max(0.0);
        Bin {
            at: range[0] + (k as f64 + 0.5) * width,
            mean,
            spread: 2.0 * (variance * CORRELATION / n).sqrt(),
        }
    })
    .collect()
}

/// One-sided amplitude density, unit per root hertz, by averaging Hann-windowed halves-overlapping pieces.
///
/// Checked by: tests::white_noise_has_a_flat_density_of_the_right_height.
pub(super) fn amplitude_density(values: &[f64], rate_hz: f64, piece: usize) -> Vec<[f64; 2]> {
    let piece = piece.min(values.len()) & !1;
    if piece < 16 {
        return Vec::new();
    }
    let mut planner = RealFftPlanner::<f64>::new();
    let transform = planner.plan_fft_forward(piece);
    let window: Vec<f64> = (0..piece).map(|k| 0.5 - 0.5 * (TAU * k as f64 / piece as f64).cos()).collect();
    let energy: f64 = window.iter().map(|w| w * w).sum();
    let mut power = vec![0.0; piece / 2 + 1];
    let mut pieces = 0.0;
    let mut spectrum = transform.make_output_vec();
    for start in (0..=values.len() - piece).step_by(piece / 2) {
        let part = &values[start..start + piece];
        let mean = part.iter().sum::<f64>() / piece as f64;
        let mut input: Vec<f64> = part.iter().zip(&window).map(|(v, w)| (v - mean) * w).collect();
        if transform.process(&mut input, &mut spectrum).is_err() {
            return Vec::new(); // lengths are the planner's own
        }
        for (p, s) in power.iter_mut().zip(&spectrum) {
            *p += 2.0 * s.norm_sqr() / (energy * rate_hz);
        }
        pieces += 1.0;
    }
    let step = rate_hz / piece as f64;
    power.iter().enumerate().skip(1).map(|(k, p)| [k as f64 * step, (p / pieces).sqrt()]).collect()
}

/// Travel since the last reversal of the velocity, and the direction of travel, one value a sample.
///
/// A reversal counts when the velocity has left a dead band around zero on the other side.
pub(super) fn since_reversal(position_m: &[f64], velocity_m_s: &[f64]) -> Vec<[f64; 2]> {
    let fastest = velocity_m_s.iter().fold(0.0_f64, |a, v| a.max(v.abs()));
    let dead = 1.0e-3 * fastest;
    let (mut direction, mut turned_at) = (0.0, position_m.first().copied().unwrap_or(0.0));
    let mut extreme = turned_at;
    let mut out = Vec::with_capacity(position_m.len());
    for (&x, &v) in position_m.iter().zip(velocity_m_s) {
        let heading = if v.abs() > dead { v.signum() } else { direction };
        if heading != direction {
            (direction, turned_at, extreme) = (heading, extreme, x);
        }
        if (x - extreme) * direction > 0.0 {
            extreme = x;
        }
        out.push([(x - turned_at).abs(), direction]);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn white_noise_has_a_flat_density_of_the_right_height() {
        // Variance 1/12 spread over half the rate: density sqrt(1/12 / (rate/2)).
        let mut state = 1_u64;
        let values: Vec<f64> = (0..200_000)
            .map(|_| {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
            })
            .collect();
        let density = amplitude_density(&values, 1000.0, 1024);
        let expected = (1.0 / 12.0 / 500.0_f64).sqrt();
        for [f, a] in &density[5..500] {
            assert!((a / expected - 1.0).abs() < 0.3, "{a} at {f} Hz, expected {expected}");
        }
    }

    #[test]
    fn bins_hold_the_mean_of_what_falls_in_them() {
        let pairs = (0..1000).map(|k| (f64::from(k) / 1000.0, if k < 500 { 1.0 } else { 3.0 }));
        let bins = binned(pairs, [0.0, 1.0], 4);
        let means: Vec<f64> = bins.iter().map(|b| b.mean).collect();
        assert_eq!(means, vec![1.0, 1.0, 3.0, 3.0]);
    }

    #[test]
    fn travel_starts_again_at_each_reversal() {
        let position: Vec<f64> = vec![0.0, 1.0, 2.0, 3.0, 2.0, 1.0];
        let velocity = vec![1.0, 1.0, 1.0, 1.0, -1.0, -1.0];
        let seen = since_reversal(&position, &velocity);
        assert_eq!(seen[3], [3.0, 1.0]);
        assert_eq!(seen[5], [2.0, -1.0]);
    }
}
