//! What is near a line: orders of the spindle, and noise through a damped mode, which in a short while looks
//! like a line. Its spectrum falls off to both sides as 1/(damping^2 + distance^2), that of a line over white
//! noise at once.

use super::criteria::{CRITERIA, LONGEST, RATES_1_S, WINDOWS};
use super::window::{Context, Tools, Window, fit};
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;

impl Window<'_> {
    /// Templates of both orders beside the line, where the window tells them apart; where a cut begins they
    /// may change steadily in the longest window, which alone has cells enough for that.
    pub(super) fn beside(&self) -> usize {
        let resolved = self.turns_of_spindle() >= CRITERIA.resolved_turns;
        match (self.context.is_young() && resolved, self.context.tools) {
            (false, _) => 0,
            (true, Tools::Cutting | Tools::Left | Tools::Unseen) if self.e.len() == LONGEST => 4,
            (true, _) => 2,
        }
    }

    /// The line beside what the orders next to it explain: one after the other, each without the ones before.
    pub(super) fn near(&self, orders: usize) -> Near {
        let n = self.e.len();
        let mut basis = [[C::ZERO; LONGEST]; 5];
        self.templates(&mut basis, orders);
        let mut rest = [C::ZERO; LONGEST];
        rest[..n].copy_from_slice(self.e);
        let mut alone = 0.0;
        for k in 0..=orders {
            let (done, left) = basis.split_at_mut(k);
            let now = &mut left[0][..n];
            for b in done.iter() {
                let share: C = b[..n].iter().zip(now.iter()).map(|(b, y)| b.conj() * y).sum();
                now.iter_mut().zip(&b[..n]).for_each(|(y, b)| *y -= share * b);
            }
            let size = now.iter().map(C::norm_sqr).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
            now.iter_mut().for_each(|y| *y /= size);
            let share: C = now.iter().zip(&rest[..n]).map(|(b, x)| b.conj() * x).sum();
            rest[..n].iter_mut().zip(now.iter()).for_each(|(x, b)| *x -= share * b);
            alone = share.norm_sqr();
        }
        let cells = Cells::near(&rest[..n], self);
        Near { alone, rest: cells.energies().iter().sum(), values: cells.energies().len() as f64 }
    }

    /// By how much noise through a mode of 10 1/s dies out within the window, natural logarithm.
    pub(super) fn mode_decay(&self) -> f64 {
        RATES_1_S[0] * self.e.len() as f64 / self.context.rate_hz
    }

    /// Evidence, nats, for a line over white noise against noise through a mode of 10 1/s over white noise.
    /// `near`: without orders.
    pub(super) fn over_mode_nats(&self, near: &Near) -> f64 {
        let rest = near.rest.max(1e-6 * self.line.contrast);
        over_mode_nats(Cells::near(self.e, self).energies(), rest, self.mode_decay())
    }

    /// The `orders` next to the line, then the line.
    fn templates(&self, basis: &mut [[C; LONGEST]; 5], orders: usize) {
        let Context { speed_hz, centre_hz, rate_hz, .. } = *self.context;
        let n = self.e.len();
        let below = ((centre_hz + self.line.offset_hz) / speed_hz.max(f64::MIN_POSITIVE)).floor();
        for (k, b) in basis[..orders].iter_mut().enumerate() {
            for (q, y) in b[..n].iter_mut().enumerate() {
                let value = &self.history.last(n)[q];
                let turn = (below + (k % 2) as f64) * value.angle_turns;
                let size = if k < 2 { 1.0 } else { q as f64 };
                *y = value.mixer * C::from_polar(size, TAU * turn.fract()) * self.chirp[q];
            }
        }
        let back = C::from_polar((-self.line.growth_1_s / rate_hz).exp(), -TAU * self.turns());
        let mut line = C::ONE;
        for y in basis[orders][..n].iter_mut().rev() {
            *y = line;
            line *= back;
        }
    }
}

/// What is near the line.
pub(super) struct Near {
    /// Energy of the line beside what the orders explain.
    alone: f64,
    /// Energy near it that neither explains.
    pub(super) rest: f64,
    /// Values that hold it.
    pub(super) values: f64,
}

impl Near {
    /// ln of what there is over what the line leaves.
    pub(super) fn coherence(&self) -> f64 {
        (1.0 + self.alone / self.rest.max(1e-6 * self.alone)).ln()
    }
}

/// Energies in cells of a window, the line's in the middle.
struct Cells {
    /// Fewer than the shortest window has values.
    energies: [f64; WINDOWS[0]],
    /// To each side.
    side: usize,
}

impl Cells {
    /// Of the values `x` of a window, as far as is near its line.
    fn near(x: &[C], window: &Window) -> Self {
        let n = x.len() as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few")]
        let side = ((CRITERIA.line_hz * n / window.context.rate_hz) as usize).clamp(2, WINDOWS[0] / 2 - 1);
        let mut cells = Self { energies: [0.0; WINDOWS[0]], side };
        for (k, to) in cells.energies[..=2 * side].iter_mut().enumerate() {
            *to = fit(x, window.turns() + (k as f64 - side as f64) / n, 0.0);
        }
        cells
    }

    fn energies(&self) -> &[f64] {
        &self.energies[..=2 * self.side]
    }
}

/// Evidence, nats, of these `energies` in cells around a line, `rest` of them without it, for a line over
/// white noise against noise through a mode and white noise: Whittle's likelihoods, all levels fitted. A mode
/// below the white noise is left to the tests against noise.
/// Checked by: `a_line_is_told_from_noise_through_a_mode`.
fn over_mode_nats(energies: &[f64], rest: f64, decay: f64) -> f64 {
    let middle = energies.len() / 2;
    let mut mode = [0.0; WINDOWS[0]];
    let mode = &mut mode[..energies.len()];
    mode.iter_mut().enumerate().for_each(|(k, to)| *to = expected(decay, k as f64 - middle as f64));
    let of = |white: f64| {
        let ratios = energies.iter().zip(&*mode).map(|(energy, mode)| energy / (mode + white));
        let logs = mode.iter().map(|mode| (mode + white).ln()).sum::<f64>();
        logs + energies.len() as f64 * (ratios.sum::<f64>() / rest).ln()
    };
    (0..12).map(|k| of(mode[middle] * 0.5f64.powi(k))).fold(of(0.0), f64::min)
}

/// Expected energy, in cell `k` from its middle, of noise through a mode that dies out by exp(-`decay`)
/// within the window: that of exp(-s |t|) under a triangle.
/// Checked by: `noise_through_a_mode_has_the_expected_energies`.
fn expected(decay: f64, k: f64) -> f64 {
    let a = C::new(decay, TAU * k);
    let fade = (-decay).exp();
    2.0 * (C::ONE / a - (C::ONE - fade) / (a * a)).re
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the mean of the energies that noise through a mode has: an autoregressive process of one
    /// value with many seeds.
    #[test]
    fn noise_through_a_mode_has_the_expected_energies() {
        const N: usize = 96;
        let (decay, streams) = (2.0, 4000);
        let keeps = (-decay / N as f64).exp();
        let mut state = 12345u64;
        let mut uniform = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        };
        let mut normal = || {
            let (a, b) = (uniform(), uniform());
            C::from_polar((-a.ln()).sqrt(), TAU * b)
        };
        let mut means = [0.0; 4];
        for _ in 0..streams {
            let mut x = normal();
            let mut sums = [C::ZERO; 4];
            for q in 0..N {
                for (k, sum) in sums.iter_mut().enumerate() {
                    *sum += x * C::from_polar(1.0, -TAU * (k * q) as f64 / N as f64);
                }
                x = x * keeps + normal() * (1.0 - keeps * keeps).sqrt();
            }
            means.iter_mut().zip(sums).for_each(|(m, s)| *m += s.norm_sqr() / f64::from(streams));
        }
        for (k, mean) in means.into_iter().enumerate() {
            let foretold = expected(decay, k as f64) * (N * N) as f64;
            assert!((mean / foretold - 1.0).abs() < 0.08, "{k}: {mean} {foretold}");
        }
    }

    /// What is as the mode foretells speaks for it, a line over a flat rest against it, whatever the level.
    #[test]
    fn a_line_is_told_from_noise_through_a_mode() {
        let decay = 3.84;
        let (mode, middle) = ((-7..=7).map(|k| expected(decay, f64::from(k))).collect::<Vec<f64>>(), 7);
        let line: Vec<f64> = (0..15).map(|k| if k == middle { 1000.0 } else { 1.0 }).collect();
        for level in [1e-3, 1.0, 1e6] {
            let of = |energies: &[f64]| {
                let energies: Vec<f64> = energies.iter().map(|energy| level * energy).collect();
                over_mode_nats(&energies, energies.iter().sum::<f64>() - energies[middle], decay)
            };
            assert!(of(&mode) < 0.0 && of(&line) > 20.0, "{level}: {} {}", of(&mode), of(&line));
        }
    }
}
