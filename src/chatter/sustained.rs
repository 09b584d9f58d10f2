//! Whether a line's amplitude stands: a limit cycle has the statistics of a sine, noise through a mode those
//! of noise.

use super::criteria::{LONGEST, WINDOWS};
use crate::keyframe::keep;
use nalgebra::Complex;

type C = Complex<f64>;
/// Values of a block.
pub(super) const BLOCK: usize = WINDOWS[1];
/// Values that are kept: 1.5 s.
pub(super) const KEPT: usize = 4 * LONGEST;

/// The last 1.5 s of the band without its orders.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Residuals {
    values: Vec<C>,
    next: usize,
}

keep!(Residuals { values, next } if |s| s.next < KEPT);

impl Residuals {
    pub(super) fn new() -> Self {
        Self { values: vec![C::ZERO; KEPT], next: 0 }
    }

    /// True when a block is full.
    pub(super) fn push(&mut self, value: C) -> bool {
        self.values[self.next] = value;
        self.next = (self.next + 1) % KEPT;
        self.next.is_multiple_of(BLOCK)
    }

    /// Blocks, oldest first; the last `n` values likewise.
    pub(super) fn last(&self, n: usize) -> impl Iterator<Item = &C> {
        let from = (self.next + KEPT - n) % KEPT;
        (0..n).map(move |q| &self.values[(from + q) % KEPT])
    }
}

/// Evidence, nats, that the powers stand since some moment: all of them, half of them or a quarter.
pub(super) fn since(powers: &[f64]) -> f64 {
    let of = |part: usize| evidence(&powers[powers.len() - powers.len() / part..]);
    of(1).max(of(2).max(of(4)) - 3f64.ln())
}

/// Evidence, nats, that these powers are those of a line and not of noise: Bartlett's test of what is left of
/// the exponential's spread.
fn evidence(powers: &[f64]) -> f64 {
    let n = powers.len() as f64;
    let mean = powers.iter().sum::<f64>() / n;
    let log = powers.iter().map(|p| p.max(f64::MIN_POSITIVE).ln()).sum::<f64>() / n;
    let spread = (mean.max(f64::MIN_POSITIVE).ln() - log).max(1e-6);
    // 2 n spread / c is chi-squared of n - 1: its lower tail.
    let x = n * spread / (1.0 + (n + 1.0) / (6.0 * n));
    let half = (n - 1.0) / 2.0;
    // Only what spreads less than noise speaks for a line.
    if x < half { (ln_gamma(half + 1.0) + x - half * x.ln()).max(0.0) } else { 0.0 }
}

/// Stirling's series.
fn ln_gamma(x: f64) -> f64 {
    (x - 0.5) * x.ln() - x + 0.919 + 1.0 / (12.0 * x)
}
