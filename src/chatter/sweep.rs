//! A line that moved here from elsewhere: encoder lines go with the feed, chatter stays within its lobe.

use super::criteria::CRITERIA;
use super::window::{Context, Window};
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;

impl Window<'_> {
    /// Energy, of these values, of a line as strong as it was that moved and may have come to rest.
    pub(super) fn sweep(&self, values: &[C]) -> f64 {
        let Context { rate_hz, .. } = *self.context;
        let dt = 1.0 / rate_hz;
        let n = self.e.len();
        let mut best: f64 = 0.0;
        for rest in [0, 24, 48, 96].into_iter().filter(|r| *r <= n) {
            for side in [-1.0, 1.0] {
                for k in 2..=16 {
                    let rate = side * f64::from(k) * CRITERIA.sweep_hz_s;
                    for shift in -1..=1 {
                        // Resting, its place is the line's; moving, the line's is that of the middle.
                        let late = if rest == 0 { 0.5 * n as f64 * dt * rate } else { 0.0 };
                        let hz = self.line.offset_hz + late + f64::from(shift) * 0.5 * rate_hz / n as f64;
                        best = best.max(moved(values, [hz * dt, rate * dt * dt], rest));
                    }
                }
            }
        }
        best
    }
}

/// Energy of a line that stands at so many turns a value for the last `rest` values and moved before.
fn moved(values: &[C], [turns, bent]: [f64; 2], rest: usize) -> f64 {
    let (mut wave, mut sum) = (C::ONE, C::ZERO);
    let steady = C::from_polar(1.0, -TAU * turns);
    let mut turn = steady * C::from_polar(1.0, 0.5 * TAU * bent);
    let bend = C::from_polar(1.0, TAU * bent);
    for (q, value) in values.iter().rev().enumerate() {
        sum += wave.conj() * value;
        if q < rest {
            wave *= steady;
        } else {
            wave *= turn;
            turn *= bend;
        }
    }
    sum.norm_sqr() / values.len() as f64
}
