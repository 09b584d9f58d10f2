//! What the band's noise is made of, learned while nothing stands out: a complex autoregressive model.
//!
//! e_i = sum_m a_m r_{i-m} / s: whatever stood long ago, the noise of the mode, steady lines that are not the
//! cut's, becomes white; a hit becomes one short pulse. Levinson's recursion on the autocovariances of a
//! guard time ago.

use super::criteria::{CRITERIA, FIRST, MEMORY};
use crate::keyframe::keep;
use nalgebra::Complex;

type C = Complex<f64>;
/// Snapshots within the guard time.
const GUARD: usize = (CRITERIA.guard_s * CRITERIA.rate_hz) as usize / MEMORY + 1;

/// Autocovariances of one state of the machine, in air or in the cut.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Noise {
    covariance: [C; MEMORY + 1],
    /// Values learned.
    known: f64,
    /// Of the last 0.26 s, the oldest at `oldest`.
    past: [[C; MEMORY + 1]; GUARD],
    past_known: [f64; GUARD],
    oldest: usize,
    since: usize,
}

keep!(Noise { covariance, known, past, past_known, oldest, since }
    if |s| s.oldest < GUARD && s.since <= MEMORY);

impl Noise {
    pub(super) const NEW: Self = Self {
        covariance: [C::ZERO; MEMORY + 1],
        known: 0.0,
        past: [[C::ZERO; MEMORY + 1]; GUARD],
        past_known: [0.0; GUARD],
        oldest: 0,
        since: 0,
    };

    /// Values learned a guard time ago.
    pub(super) fn known(&self) -> f64 {
        self.past_known[self.oldest]
    }

    /// Learns from the newest of the values, `r[0]`, the others before it. True when there is a model to be
    /// made.
    pub(super) fn learn(&mut self, r: &[C; MEMORY + 1], trust: f64) -> bool {
        let mean = r.iter().map(|x| x.norm_sqr()).sum::<f64>() / (MEMORY + 1) as f64;
        let weight = if self.known > FIRST as f64 && mean > 0.0 {
            (CRITERIA.most * self.covariance[0].re / mean).min(1.0)
        } else {
            1.0
        };
        self.known = (self.known + weight).min(trust);
        let share = weight / self.known.max(1.0);
        for (to, old) in self.covariance.iter_mut().zip(r) {
            *to += (r[0] * old.conj() - *to) * share;
        }
        self.since += 1;
        // As many new ones as there are coefficients: 20 ms.
        if self.since < MEMORY {
            return false;
        }
        self.since = 0;
        self.past[self.oldest] = self.covariance;
        self.past_known[self.oldest] = self.known;
        self.oldest = (self.oldest + 1) % GUARD;
        true
    }

    /// What was learned in the last guard time is forgotten: it was no noise.
    pub(super) fn revert(&mut self) {
        (self.covariance, self.known) = (self.past[self.oldest], self.past_known[self.oldest]);
        self.accept_all();
    }

    /// All that was learned counts: what came since is somewhere else.
    pub(super) fn accept_all(&mut self) {
        self.past = [self.covariance; GUARD];
        self.past_known = [self.known; GUARD];
    }

    /// Known as well as after so many values only.
    pub(super) fn shrink(&mut self, values: f64) {
        self.known = self.known.min(values);
        self.past_known.iter_mut().for_each(|k| *k = k.min(values));
    }

    /// The model of a guard time ago.
    pub(super) fn whitener(&self) -> Whitener {
        Whitener::new(&self.past[self.oldest])
    }
}

/// A whitening filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Whitener {
    taps: [C; MEMORY + 1],
}

keep!(Whitener { taps });

impl Whitener {
    pub(super) const NONE: Self = Self { taps: [C::ZERO; MEMORY + 1] };

    /// Nothing is known: all as it is.
    pub(super) fn plain() -> Self {
        let mut taps = [C::ZERO; MEMORY + 1];
        taps[0] = C::ONE;
        Self { taps }
    }

    /// Levinson's recursion. Without power nothing passes.
    fn new(covariance: &[C; MEMORY + 1]) -> Self {
        let mut a = [C::ZERO; MEMORY + 1];
        a[0] = C::ONE;
        // White noise of a thousandth is added: no innovation is less than that.
        let floor = CRITERIA.white_share * covariance[0].re;
        let mut power = covariance[0].re + floor;
        if floor <= f64::MIN_POSITIVE {
            return Self::NONE;
        }
        for k in 1..=MEMORY {
            let miss: C = (0..k).map(|m| a[m] * covariance[k - m]).sum();
            let turn = -miss / power;
            let less = power * (1.0 - turn.norm_sqr());
            if less < floor {
                break;
            }
            let before = a;
            for m in 1..=k {
                a[m] += turn * before[k - m].conj();
            }
            power = less;
        }
        let scale = 1.0 / power.sqrt();
        Self { taps: a.map(|x| x * scale) }
    }

    /// What each tap makes of a line at a frequency, in turns a value.
    pub(super) fn at(&self, turns: f64) -> [C; MEMORY + 1] {
        let angle = -std::f64::consts::TAU * turns;
        std::array::from_fn(|m| self.taps[m] * C::from_polar(1.0, angle * m as f64))
    }

    /// Power of the noise at a frequency, in turns a value.
    pub(super) fn known(&self, turns: f64) -> f64 {
        let back = C::from_polar(1.0, -std::f64::consts::TAU * turns);
        let answer = self.taps.iter().rev().fold(C::ZERO, |sum, a| sum * back + a);
        1.0 / answer.norm_sqr().max(f64::MIN_POSITIVE)
    }

    /// Innovation of the newest value, `r[0]`, in units of the noise.
    pub(super) fn white(&self, r: &[C; MEMORY + 1]) -> C {
        self.taps.iter().zip(r).map(|(a, x)| a * x).sum()
    }
}
