//! Notch whose frequency may follow something while it runs.

use super::{FilterError, check_frequency};
use crate::units::SampleRate;
use std::f64::consts::{PI, TAU};

/// A notch of fixed width; its centre is given with each sample.
///
/// H(z) = g (1 - 2 cos(w) z^-1 + z^-2) / (1 - (1 + r^2) cos(w) z^-1 + r^2 z^-2), g = (1 + r^2)/2:
/// zero at w, one at 0 and at half the rate, half power at w +- width/2 for r^2 = (1 - t)/(1 + t),
/// t = tan(pi width/fs). A lattice keeps the state meaningful while w moves.
///
/// Source: P. Regalia, S. Mitra, P. Vaidyanathan, The digital all-pass filter, Proc. IEEE 76 (1988).
/// Checked by: it_is_zero_at_its_centre_and_one_far_away, it_follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Notch {
    /// k2 of the all-pass: (1 - t)/(1 + t).
    width: f64,
    rate: SampleRate,
}

/// State of a [`Notch`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct NotchState {
    x: [f64; 2],
}

crate::keyframe::keep!(NotchState { x });

impl Notch {
    /// A notch that is `width_hz` wide at half power. Errors: a width that is not below half the rate.
    pub fn new(width_hz: f64, rate: SampleRate) -> Result<Self, FilterError> {
        check_frequency("notch width", width_hz, rate.hz() / 2.0)?;
        let t = (PI * width_hz / rate.hz()).tan();
        Ok(Self { width: (1.0 - t) / (1.0 + t), rate })
    }

    /// One sample with the notch at `centre_hz`; outside of 0 .. half the rate the sample goes through.
    #[inline]
    #[must_use]
    pub fn step(&self, state: &mut NotchState, x: f64, centre_hz: f64) -> f64 {
        let share = centre_hz / self.rate.hz();
        let inside = share > 0.0 && share < 0.5;
        // The state runs on while the notch is off, so that it does not jump when it comes on.
        let k1 = if inside { -(TAU * share).cos() } else { 0.0 };
        let k2 = self.width;
        // Normalised lattice all-pass: outer section k2, inner section k1.
        let f1 = x - k2 * state.x[1];
        let a = k2 * f1 + state.x[1];
        let f0 = f1 - k1 * state.x[0];
        state.x[1] = k1 * f0 + state.x[0];
        state.x[0] = f0;
        if inside { 0.5 * (x + a) } else { x }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gain(notch: &Notch, centre: f64, f: f64) -> f64 {
        let mut state = NotchState::default();
        let y: Vec<f64> = (0..40_000)
            .map(|i| notch.step(&mut state, (TAU * f * f64::from(i) / 10_000.0).sin(), centre))
            .collect();
        let power = y[20_000..].iter().map(|x| x * x).sum::<f64>() / 20_000.0;
        (2.0 * power).sqrt()
    }

    #[test]
    fn it_is_zero_at_its_centre_and_one_far_away() {
        let notch = Notch::new(10.0, SampleRate::new(10_000.0).unwrap()).unwrap();
        assert!(gain(&notch, 400.0, 400.0) < 1e-6);
        assert!((gain(&notch, 400.0, 300.0) - 1.0).abs() < 0.01);
        assert!((gain(&notch, 400.0, 405.0) - 0.5f64.sqrt()).abs() < 0.02);
    }

    #[test]
    fn it_follows() {
        let notch = Notch::new(20.0, SampleRate::new(10_000.0).unwrap()).unwrap();
        let mut state = NotchState::default();
        let (mut phase, mut largest) = (0.0, 0.0f64);
        for i in 0..20_000 {
            let f = 200.0 + 0.01 * f64::from(i);
            phase += TAU * f / 10_000.0;
            let y = notch.step(&mut state, f64::sin(phase), f);
            if i > 5000 {
                largest = largest.max(y.abs());
            }
        }
        assert!(largest < 0.1, "{largest}");
    }
}
