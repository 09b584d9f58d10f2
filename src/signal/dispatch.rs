//! One body of code, compiled for any processor, for AVX2 with fused multiply-add and for AVX-512; chosen
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

/// Which copy runs; can only be had by asking the processor. The fused copies give the same bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fast(Copies);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Copies {
    Plain,
    Fused,
    Wide,
}

impl Fast {
    /// Asks for AVX2: what runs a little at a time between other work, which wide registers would slow down.
    #[must_use]
    pub fn detect() -> Self {
        Self(if can_fuse() { Copies::Fused } else { Copies::Plain })
    }

    /// Asks for the widest registers: long work in one piece.
    #[must_use]
    pub fn detect_wide() -> Self {
        if is_wide() { Self(Copies::Wide) } else { Self::detect() }
    }

    /// The plain copy, for comparison.
    #[must_use]
    pub fn off() -> Self {
        Self(Copies::Plain)
    }
}

#[cfg(target_arch = "x86_64")]
fn can_fuse() -> bool {
    std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
}

#[cfg(target_arch = "x86_64")]
fn is_wide() -> bool {
    can_fuse()
        && std::arch::is_x86_feature_detected!("avx512f")
        && std::arch::is_x86_feature_detected!("avx512dq")
        && std::arch::is_x86_feature_detected!("avx512vl")
}

#[cfg(not(target_arch = "x86_64"))]
fn can_fuse() -> bool {
    false
}

#[cfg(not(target_arch = "x86_64"))]
fn is_wide() -> bool {
    false
}

/// Runs the copy that fits the processor.
#[inline]
pub fn run<K: Kernel>(fast: Fast, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    match fast.0 {
        // SAFETY: comes only from `detect`, which asked for avx2 and fma.
        Copies::Fused => return unsafe { run_fused(kernel) },
        // SAFETY: comes only from `detect_wide`, which asked for all of them.
        Copies::Wide => return unsafe { run_wide(kernel) },
        Copies::Plain => {}
    }
    let _ = fast;
    kernel.run::<false>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn run_fused<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<true>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,avx512f,avx512dq,avx512vl")]
fn run_wide<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<true>()
}

/// a b + c, fused where that is one instruction.
#[inline(always)]
#[must_use]
pub fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}
