//! Forces and encoder errors that repeat in position.

use std::f64::consts::TAU;

/// Sine and cosine of a position at a wavelength: a sin + b cos is any amplitude and phase.
#[must_use]
pub fn wave(position_m: f64, wavelength_m: f64) -> (f64, f64) {
    (TAU * (position_m / wavelength_m).fract()).sin_cos()
}

/// Sine and cosine of one and two turns per wavelength.
#[must_use]
pub fn waves(x: &[f64], wavelength_m: f64) -> Vec<Vec<f64>> {
    let mut out: Vec<Vec<f64>> = (0..4).map(|_| Vec::with_capacity(x.len())).collect();
    for x in x {
        let (s, c) = (TAU * (x / wavelength_m).fract()).sin_cos();
        out[0].push(s);
        out[1].push(c);
        out[2].push(2.0 * s * c);
        out[3].push(c * c - s * s);
    }
    out
}

/// Amplitude and phase of a sin(x) + b cos(x) = A sin(x + phase).
#[must_use]
pub fn amplitude_phase(sine: f64, cosine: f64) -> (f64, f64) {
    (sine.hypot(cosine), cosine.atan2(sine))
}

/// Of a table on equidistant knots: the first of the knots that a position has a part of, and their parts.
///
/// Cubic convolution (Keys, IEEE Trans. ASSP 29, 1981, a = -1/2): the table's values at the knots, smooth
/// slopes, exact for straight lines, and inside for parabolas. Beyond the ends the last value holds.
#[must_use]
pub fn knots_at(position: f64, first: f64, spacing: f64, knots: usize) -> (usize, [f64; 4]) {
    if knots < 2 {
        return (0, [1.0, 0.0, 0.0, 0.0]);
    }
    let place = ((position - first) / spacing).clamp(0.0, (knots - 1) as f64);
    let left = (place as usize).min(knots - 2);
    let t = place - left as f64;
    let mut parts = [
        0.5 * t * (t * (2.0 - t) - 1.0),
        0.5 * (t * t * (3.0 * t - 5.0) + 2.0),
        0.5 * t * (t * (4.0 - 3.0 * t) + 1.0),
        0.5 * t * t * (t - 1.0),
    ];
    // Beyond the table its ends go on as straight lines.
    if left + 2 == knots {
        parts[2] += 2.0 * parts[3];
        parts[1] -= parts[3];
        parts[3] = 0.0;
    }
    if left == 0 {
        parts[1] += 2.0 * parts[0];
        parts[2] -= parts[0];
        return (0, [parts[1], parts[2], parts[3], 0.0]);
    }
    (left - 1, parts)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_and_a_cosine_are_one_ripple() {
        let (a, b) = (0.3, -1.1);
        let (amplitude, phase) = amplitude_phase(a, b);
        for x in [-0.0123, 0.0, 0.0049] {
            let (s, c) = wave(x, 0.005);
            assert!((a * s + b * c - amplitude * (TAU * x / 0.005 + phase).sin()).abs() < 1e-12);
        }
    }

    fn table(f: impl Fn(f64) -> f64, x: f64, knots: usize) -> f64 {
        let (first, parts) = knots_at(x, -0.02, 0.005, knots);
        (0..4).map(|k| parts[k] * f(-0.02 + 0.005 * (first + k) as f64)).sum()
    }

    #[test]
    fn a_table_has_its_values_at_the_knots_and_is_exact_for_lines_and_inside_for_parabolas() {
        for k in 0..9 {
            let x = -0.02 + 0.005 * f64::from(k);
            assert!((table(f64::cos, x, 9) - x.cos()).abs() < 1e-14);
        }
        for k in 0..=100 {
            let x = -0.02 + 0.0004 * f64::from(k);
            for knots in [2, 3, 4, 9] {
                let inside = x.min(-0.02 + 0.005 * (knots - 1) as f64);
                assert!((table(|x| 3.0 - 7.0 * x, x, knots) - (3.0 - 7.0 * inside)).abs() < 1e-14);
            }
            if (-0.015..=0.015).contains(&x) {
                assert!((table(|x| x * x, x, 9) - x * x).abs() < 1e-17, "{x}");
            }
        }
        assert_eq!(knots_at(1.0, 0.0, 0.005, 4), (1, [0.0, 0.0, 1.0, 0.0]));
        assert_eq!(knots_at(-1.0, 0.0, 0.005, 1), (0, [1.0, 0.0, 0.0, 0.0]));
    }
}
