//! Forces and encoder errors that repeat in position.

use std::f64::consts::TAU;

/// Sine and cosine of a position at a wavelength: a sin + b cos is any amplitude and phase.
#[must_use]
pub fn wave(position_m: f64, wavelength_m: f64) -> (f64, f64) {
    (TAU * (position_m / wavelength_m).fract()).sin_cos()
}

/// Amplitude and phase of a sin(x) + b cos(x) = A sin(x + phase).
#[must_use]
pub fn amplitude_phase(sine: f64, cosine: f64) -> (f64, f64) {
    (sine.hypot(cosine), cosine.atan2(sine))
}

/// A sin(2 pi x / wavelength + phase).
#[must_use]
pub fn ripple(position_m: f64, wavelength_m: f64, phase_rad: f64) -> f64 {
    (TAU * (position_m / wavelength_m).fract() + phase_rad).sin()
}

/// Hat functions on equidistant knots: the two knots beside `position_m` and the share of the right one.
#[must_use]
pub fn knot(position_m: f64, first_m: f64, spacing_m: f64, knots: usize) -> (usize, f64) {
    let place = ((position_m - first_m) / spacing_m).clamp(0.0, knots.saturating_sub(1) as f64);
    let left = (place as usize).min(knots.saturating_sub(2));
    (left, place - left as f64)
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
            assert!((a * s + b * c - amplitude * ripple(x, 0.005, phase)).abs() < 1e-12);
        }
    }

    #[test]
    fn a_knot_map_is_linear_between_knots() {
        let (left, share) = knot(0.0125, 0.0, 0.005, 4);
        assert_eq!(left, 2);
        assert!((share - 0.5).abs() < 1e-12);
        assert_eq!(knot(1.0, 0.0, 0.005, 4), (2, 1.0));
    }
}
