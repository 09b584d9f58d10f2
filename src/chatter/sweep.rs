//! A line that moved here from elsewhere: encoder lines go with the feed, chatter stays within its lobe.

use super::window::{Around, Window};
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;
const ZERO: C = C::new(0.0, 0.0);

/// Values before a window in which a line that moves is looked for: 192 ms.
pub(super) const PAST: usize = 96;
/// Rates at which a line may move that is no chatter, Hz/s, and their distance: what half a second resolves.
const SWEEPS_HZ_S: [f64; 2] = [30.0, 240.0];
const SWEEP_STEP_HZ_S: f64 = 15.0;

impl Window<'_> {
    /// Energy, over the past too, of a line as strong as it was that moved and may have come to rest.
    pub(super) fn sweep(&self) -> f64 {
        let Around { rate_hz, .. } = *self.around;
        let dt = 1.0 / rate_hz;
        let n = self.e.len();
        #[expect(clippy::cast_possible_truncation, reason = "a dozen")]
        let steps = ((SWEEPS_HZ_S[1] - SWEEPS_HZ_S[0]) / SWEEP_STEP_HZ_S) as i32;
        let mut best: f64 = 0.0;
        for rest in [0, 24, 48, 96].into_iter().filter(|r| *r <= n) {
            for side in [-1.0, 1.0] {
                for k in 0..=steps {
                    let rate = side * (SWEEPS_HZ_S[0] + f64::from(k) * SWEEP_STEP_HZ_S);
                    for shift in -1..=1 {
                        // Resting, its place is the line's; moving, the line's is that of the middle.
                        let late = if rest == 0 { 0.5 * n as f64 * dt * rate } else { 0.0 };
                        let hz = self.heard.offset_hz + late + f64::from(shift) * 0.5 * rate_hz / n as f64;
                        best = best.max(self.moved(hz, rate, rest));
                    }
                }
            }
        }
        best
    }

    /// Energy of a line that stands at `hz` for the last `rest` values and moved at `rate` before.
    fn moved(&self, hz: f64, rate: f64, rest: usize) -> f64 {
        let dt = 1.0 / self.around.rate_hz;
        let (mut wave, mut sum) = (C::new(1.0, 0.0), ZERO);
        let steady = C::from_polar(1.0, -TAU * hz * dt);
        let mut turn = steady * C::from_polar(1.0, 0.5 * TAU * rate * dt * dt);
        let bend = C::from_polar(1.0, TAU * rate * dt * dt);
        let now = self.e.iter().rev().copied();
        let past = self.past.iter().rev().map(|v| v.white);
        for (q, x) in now.chain(past).enumerate() {
            sum += wave.conj() * x;
            if q < rest {
                wave *= steady;
            } else {
                wave *= turn;
                turn *= bend;
            }
        }
        sum.norm_sqr() / (self.e.len() + self.past.len()) as f64
    }
}
