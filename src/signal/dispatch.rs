//! One body of code, compiled twice: for any processor and for AVX2 with fused multiply-add; chosen
//! when running. The only place here that calls a function by what the processor can do.
#![allow(unsafe_code)]

/// Work that is written once.
pub trait Kernel {
    /// What comes out.
    type Output;

    /// The work; must be `#[inline(always)]`. With `FUSED`, `mul_add` is one instruction; without, it
    /// would be a slow library call and must be avoided.
    fn run<const FUSED: bool>(self) -> Self::Output;
}

/// True where the fast copy may run. Ask once, keep the answer.
#[must_use]
pub fn fast_available() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
}

/// Whether the processor has what the fast copies need; can only be had by asking it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fast(bool);

impl Fast {
    /// Asks the processor.
    #[must_use]
    pub fn detect() -> Self {
        Self(fast_available())
    }

    /// The plain copy, for comparison.
    #[must_use]
    pub fn off() -> Self {
        Self(false)
    }
}

/// Runs the copy that fits the processor.
#[inline]
pub fn run<K: Kernel>(fast: Fast, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if fast.0 {
        // SAFETY: a `Fast` that is true comes only from `detect`, which asked for avx2 and fma.
        return unsafe { run_fast(kernel) };
    }
    let _ = fast;
    kernel.run::<false>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn run_fast<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<true>()
}

/// a b + c, fused where that is one instruction.
#[inline(always)]
#[must_use]
pub fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}
