//! Chance for tests: the same on every machine.

/// Values from -1/2 to 1/2, all alike likely (linear congruence: Knuth, volume 2, section 3.3).
pub(crate) fn uniform(mut seed: u64) -> impl FnMut() -> f64 {
    move || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        (seed >> 11) as f64 / (1u64 << 53) as f64 - 0.5
    }
}

/// Values of mean 0 and variance 1: sums of twelve.
pub(crate) fn normal(seed: u64) -> impl FnMut() -> f64 {
    let mut next = uniform(seed);
    move || (0..12).map(|_| next()).sum()
}
