//! The exponential without a branch or a library call, so that lanes stay side by side.

use super::dispatch::multiply_add;

/// log2 e.
const LOG2_E: f64 = std::f64::consts::LOG2_E;
/// ln 2 in two parts; the first has zeros at its end, so that k times it is exact.
const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
/// Adding 1.5 * 2^52 rounds to a whole number and leaves it in the low bits.
pub(crate) const ROUND: f64 = 6_755_399_441_055_744.0;
/// 1/k! from k = 12 down to 0.
const TAYLOR: [f64; 13] = [
    1.0 / 479_001_600.0,
    1.0 / 39_916_800.0,
    1.0 / 3_628_800.0,
    1.0 / 362_880.0,
    1.0 / 40_320.0,
    1.0 / 5_040.0,
    1.0 / 720.0,
    1.0 / 120.0,
    1.0 / 24.0,
    1.0 / 6.0,
    0.5,
    1.0,
    1.0,
];

/// exp(x) for |x| <= 700: 2^k exp(r), |r| < 0.35, a Taylor sum of twelve terms (4e-16 of the value).
///
/// Checked by: tests::it_is_the_library_s.
#[inline(always)]
pub(crate) fn exp<const FUSED: bool>(x: f64) -> f64 {
    let shifted = multiply_add::<FUSED>(x, LOG2_E, ROUND);
    let k = shifted - ROUND;
    let r = multiply_add::<FUSED>(k, -LN_2[1], multiply_add::<FUSED>(k, -LN_2[0], x));
    let mut sum = TAYLOR[0];
    for c in &TAYLOR[1..] {
        sum = multiply_add::<FUSED>(sum, r, *c);
    }
    f64::from_bits(sum.to_bits().wrapping_add(shifted.to_bits() << 52))
}

#[cfg(test)]
mod tests {
    use super::exp;

    #[test]
    fn it_is_the_library_s() {
        for k in -70_000..=70_000 {
            let x = f64::from(k) * 1e-2;
            assert!((exp::<true>(x) / x.exp() - 1.0).abs() < 1e-15, "{x}");
            assert!((exp::<false>(x) / x.exp() - 1.0).abs() < 1e-15, "{x}");
        }
    }
}
