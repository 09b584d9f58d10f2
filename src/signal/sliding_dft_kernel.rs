//! The two inner loops of the sliding DFT, each compiled twice: for any processor, and with AVX2 and
//! fused multiply-add, chosen at run time. Without the second copy `mul_add` would be a library call.

#![allow(unsafe_code)]

/// A real number type of the sliding DFT: f64, or f32 where half the memory counts.
pub trait Real: Copy + Default + Send + Sync + PartialEq + std::fmt::Debug + 'static {
    /// Rounds to this type.
    fn from_f64(value: f64) -> Self;
    /// Widens, exactly.
    fn to_f64(self) -> f64;
    /// Sum.
    fn plus(self, other: Self) -> Self;
    /// Difference.
    fn minus(self, other: Self) -> Self;
    /// `self * factor + addend`, rounded once if `FUSED`.
    fn multiply_add<const FUSED: bool>(self, factor: Self, addend: Self) -> Self;
}

macro_rules! real {
    ($type:ty) => {
        impl Real for $type {
            #[inline(always)]
            #[allow(clippy::cast_possible_truncation)]
            fn from_f64(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn plus(self, other: Self) -> Self {
                self + other
            }
            #[inline(always)]
            fn minus(self, other: Self) -> Self {
                self - other
            }
            #[inline(always)]
            fn multiply_add<const FUSED: bool>(self, factor: Self, addend: Self) -> Self {
                if FUSED { self.mul_add(factor, addend) } else { self * factor + addend }
            }
        }
    };
}
real!(f64);
real!(f32);

/// Columns that one pass of the inner loop holds in registers for every axis.
pub(super) const TILE: usize = 8;

/// `partial[axis][column] = sum over j of samples[j][axis] * table[j][column]`.
pub(super) struct BlockProduct<'a, T> {
    /// `[block][axis]`.
    pub(super) samples: &'a [T],
    /// `[block][columns]`, columns a multiple of `TILE`.
    pub(super) table: &'a [T],
    /// `[axis][columns]`.
    pub(super) partial: &'a mut [T],
    pub(super) axes: usize,
    pub(super) columns: usize,
}

/// One rotor step and the rotation of a block's partial sums into the prefix of one axis.
pub(super) struct Rotate<'a, T> {
    /// `[re.., im..]` of the block's sums.
    pub(super) partial: &'a [T],
    /// `[re.., im..]` of the rotor at the block's first sample.
    pub(super) rotor: &'a [T],
    /// `[re.., im..]` prefix since the restart.
    pub(super) prefix: &'a mut [T],
    /// Half the columns.
    pub(super) bins: usize,
}

/// True where the fast copies may run.
pub(super) fn fast_available() -> bool {
    #[cfg(target_arch = "x86_64")]
    {
        std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma")
    }
    #[cfg(not(target_arch = "x86_64"))]
    {
        false
    }
}

pub(super) fn block_product<T: Real>(fast: bool, job: &mut BlockProduct<'_, T>) {
    #[cfg(target_arch = "x86_64")]
    if fast {
        // SAFETY: `fast` is only ever the answer of `fast_available`, which asked for avx2 and fma.
        return unsafe { block_product_fast(job) };
    }
    let _ = fast;
    block_product_body::<T, false>(job);
}

pub(super) fn rotate<T: Real>(fast: bool, job: &mut Rotate<'_, T>) {
    #[cfg(target_arch = "x86_64")]
    if fast {
        // SAFETY: as in `block_product`.
        return unsafe { rotate_fast(job) };
    }
    let _ = fast;
    rotate_body::<T, false>(job);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn block_product_fast<T: Real>(job: &mut BlockProduct<'_, T>) {
    block_product_body::<T, true>(job);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn rotate_fast<T: Real>(job: &mut Rotate<'_, T>) {
    rotate_body::<T, true>(job);
}

#[inline(always)]
fn block_product_body<T: Real, const FUSED: bool>(job: &mut BlockProduct<'_, T>) {
    let mut first = 0;
    // Six axes share each load of the table; what is left goes in threes and ones.
    while first + 6 <= job.axes {
        rows::<T, FUSED, 6>(job, first);
        first += 6;
    }
    while first + 3 <= job.axes {
        rows::<T, FUSED, 3>(job, first);
        first += 3;
    }
    while first < job.axes {
        rows::<T, FUSED, 1>(job, first);
        first += 1;
    }
}

#[inline(always)]
fn rows<T: Real, const FUSED: bool, const ROWS: usize>(job: &mut BlockProduct<'_, T>, first: usize) {
    let columns = job.columns;
    let mut column = 0;
    while column + TILE <= columns {
        let mut sums = [[T::default(); TILE]; ROWS];
        let lines = job.samples.chunks_exact(job.axes).zip(job.table.chunks_exact(columns));
        for (instant, line) in lines {
            let (Some(entries), Some(instant)) =
                (line[column..].first_chunk::<TILE>(), instant[first..].first_chunk::<ROWS>())
            else {
                return;
            };
            for (sum, x) in sums.iter_mut().zip(instant) {
                for (s, entry) in sum.iter_mut().zip(entries) {
                    *s = x.multiply_add::<FUSED>(*entry, *s);
                }
            }
        }
        for (row, sum) in sums.iter().enumerate() {
            let place = (first + row) * columns + column;
            job.partial[place..place + TILE].copy_from_slice(sum);
        }
        column += TILE;
    }
}

#[inline(always)]
fn rotate_body<T: Real, const FUSED: bool>(job: &mut Rotate<'_, T>) {
    let bins = job.bins;
    let (u_re, u_im) = job.partial[..2 * bins].split_at(bins);
    let (r_re, r_im) = job.rotor[..2 * bins].split_at(bins);
    let (p_re, p_im) = job.prefix[..2 * bins].split_at_mut(bins);
    for k in 0..bins {
        let minus_im = T::default().minus(u_im[k]);
        p_re[k] = u_re[k].multiply_add::<FUSED>(r_re[k], minus_im.multiply_add::<FUSED>(r_im[k], p_re[k]));
        p_im[k] = u_re[k].multiply_add::<FUSED>(r_im[k], u_im[k].multiply_add::<FUSED>(r_re[k], p_im[k]));
    }
}
