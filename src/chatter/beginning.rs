//! How a line began: chatter grows out of the noise, what is struck or switched on is there at once, and what
//! goes with the feed came from elsewhere.

use super::criteria::{GROWTHS_1_S, LONGEST, RINGS_1_S, WINDOWS};
use super::sweep::PAST;
use super::window::Window;
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;
const ZERO: C = C::new(0.0, 0.0);

/// Evidence, nats, that a line grew and may stand since.
pub(super) struct Grew {
    /// Against one that began at once and may have faded since.
    pub(super) began_nats: f64,
    /// Against one that moved; infinite where it is not asked.
    pub(super) moved_nats: f64,
}

impl Window<'_> {
    /// How the line of the window began, by the window and what was before it.
    pub(super) fn grew(&self) -> Grew {
        let n = self.e.len() + self.past.len();
        let rate_hz = self.around.rate_hz;
        let mut line = [ZERO; LONGEST + PAST];
        let line = &mut line[..n];
        let [mut all, mut began, mut grew] = [0.0; 3];
        for k in -2..=2 {
            let turns = self.turns() + f64::from(k) * 0.25 / self.e.len() as f64;
            let (mut wave, back) = (C::new(1.0, 0.0), C::from_polar(1.0, TAU * turns));
            let past = self.past.iter().rev().map(|v| v.white);
            for (to, from) in line.iter_mut().zip(self.e.iter().rev().copied().chain(past)) {
                *to = from * wave;
                wave *= back;
            }
            all = line.iter().map(C::norm_sqr).sum();
            began = at_once(line, rate_hz).max(began);
            grew = growing(line, rate_hz).max(grew);
        }
        let left = |energy: f64| (all - energy).max(1e-12 * all);
        let nats = |other: f64| (n as f64 - 1.0) * (left(other) / left(grew)).ln();
        let moved_nats = if self.around.young { f64::INFINITY } else { nats(self.sweep()) };
        Grew { began_nats: nats(began), moved_nats }
    }
}

/// Most energy of a line at zero that began at once; the newest value is the first.
fn at_once(line: &[C], rate_hz: f64) -> f64 {
    // Some silence before it and some of the line after it.
    let seen = WINDOWS[0] / 2;
    let mut best: f64 = 0.0;
    for ring_1_s in std::iter::once(0.0).chain(RINGS_1_S) {
        let back = (ring_1_s / rate_hz).exp();
        let (mut s, mut sum, mut energy) = (1.0, ZERO, 0.0);
        for (q, x) in line[..line.len() - seen].iter().enumerate() {
            sum += x * s;
            energy += s * s;
            s *= back;
            if q >= seen {
                best = best.max(sum.norm_sqr() / energy);
            }
        }
    }
    best
}

/// The same of one that grew until some moment and stands since.
fn growing(line: &[C], rate_hz: f64) -> f64 {
    let mut best: f64 = 0.0;
    for growth_1_s in GROWTHS_1_S {
        let back = (-growth_1_s / rate_hz).exp();
        let mut stood: C = line.iter().sum();
        let (mut grown, mut energy) = (ZERO, 0.0);
        for (q, x) in line.iter().enumerate().rev() {
            // What is older than this value grew, up to the size at which it stands from here on.
            best = best.max((stood + grown * back).norm_sqr() / ((q + 1) as f64 + energy * back * back));
            stood -= x;
            grown = grown * back + x;
            energy = energy * back * back + 1.0;
        }
        best = best.max(grown.norm_sqr() / energy);
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_grew_is_told_from_one_that_was_there_at_once() {
        // Newest first, 240 values of 2 ms.
        let of = |size: &dyn Fn(f64) -> f64| {
            let line: Vec<C> = (0..240).map(|q| C::new(size(0.002 * f64::from(q)), 0.0)).collect();
            let all: f64 = line.iter().map(C::norm_sqr).sum();
            (at_once(&line, 500.0) / all, growing(&line, 500.0) / all)
        };
        let (at, grew) = of(&|ago_s| (-15.0 * (ago_s - 0.1).max(0.0)).exp());
        assert!(grew > 0.999 && at < 0.95, "{at} {grew}");
        let (at, grew) = of(&|ago_s| if ago_s < 0.1 { 1.0 } else { 0.0 });
        assert!(at > 0.999 && grew < 0.96, "{at} {grew}");
        let (at, grew) = of(&|ago_s| if ago_s < 0.1 { (20.0 * ago_s).exp() } else { 0.0 });
        assert!(at > 0.999 && grew < 0.8, "{at} {grew}");
    }
}
