//! The inner loops of the sliding DFT.

use super::dispatch::Kernel;

/// A real number type of the sliding DFT: f64, or f32 where half the memory counts.
pub trait Real: Copy + Default + Send + Sync + PartialEq + std::fmt::Debug + 'static {
    /// Distance of one to the next number.
    const ROUNDING: f64;
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
            const ROUNDING: f64 = <$type>::EPSILON as f64;
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

/// `partial[axis][column] = sum over j of samples[j][axis] * table[j][column]`; rows of any kind for axes.
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

/// The spectrum of a block, turned to its place and taken into the sums of one axis.
pub(super) struct Advance<'a, T> {
    /// `[re.., im..]` of the block.
    pub(super) block: &'a [T],
    /// `[re.., im..]` of the rotor at this place of the window.
    pub(super) rotor: &'a [T],
    pub(super) sums: &'a mut [T],
    /// `[re.., im..]`: another turn on top; `None`: by whole turns.
    pub(super) phase: Option<&'a [T]>,
    /// Half the columns.
    pub(super) bins: usize,
}

/// The rotor of a block as `T`, then on to the next block.
pub(super) struct Turn<'a, T> {
    /// `[re.., im..]`
    pub(super) rotor: &'a mut [f64],
    /// `[re.., im..]` of one block.
    pub(super) step: &'a [f64],
    pub(super) values: &'a mut [T],
    /// Half the columns.
    pub(super) bins: usize,
}

impl<T: Real> Kernel for Turn<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let bins = self.bins;
        let (re, im) = self.rotor[..2 * bins].split_at_mut(bins);
        let (step_re, step_im) = self.step[..2 * bins].split_at(bins);
        let (to_re, to_im) = self.values[..2 * bins].split_at_mut(bins);
        for k in 0..bins {
            (to_re[k], to_im[k]) = (T::from_f64(re[k]), T::from_f64(im[k]));
            (re[k], im[k]) =
                (re[k] * step_re[k] - im[k] * step_im[k], re[k] * step_im[k] + im[k] * step_re[k]);
        }
    }
}

impl<T: Real> Kernel for BlockProduct<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(mut self) {
        let mut first = 0;
        // Axes share each load of the table; what is left goes in threes and ones.
        while first + 6 <= self.axes {
            rows::<T, FUSED, 6>(&mut self, first);
            first += 6;
        }
        while first + 3 <= self.axes {
            rows::<T, FUSED, 3>(&mut self, first);
            first += 3;
        }
        while first < self.axes {
            rows::<T, FUSED, 1>(&mut self, first);
            first += 1;
        }
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

impl<T: Real> Kernel for Advance<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        advance::<T, FUSED>(self);
    }
}

/// Complex product.
#[inline(always)]
fn product<T: Real, const FUSED: bool>([ar, ai]: [T; 2], [br, bi]: [T; 2]) -> [T; 2] {
    let (zero, minus_im) = (T::default(), T::default().minus(ai));
    [
        ar.multiply_add::<FUSED>(br, minus_im.multiply_add::<FUSED>(bi, zero)),
        ar.multiply_add::<FUSED>(bi, ai.multiply_add::<FUSED>(br, zero)),
    ]
}

#[inline(always)]
fn advance<T: Real, const FUSED: bool>(job: Advance<'_, T>) {
    let bins = job.bins;
    let (re, im) = job.block[..2 * bins].split_at(bins);
    let (r_re, r_im) = job.rotor[..2 * bins].split_at(bins);
    let (s_re, s_im) = job.sums[..2 * bins].split_at_mut(bins);
    let phase = job.phase.map(|phase| phase[..2 * bins].split_at(bins));
    for k in 0..bins {
        let mut turned = product::<T, FUSED>([re[k], im[k]], [r_re[k], r_im[k]]);
        if let Some((re, im)) = phase {
            turned = product::<T, FUSED>(turned, [re[k], im[k]]);
        }
        (s_re[k], s_im[k]) = (s_re[k].plus(turned[0]), s_im[k].plus(turned[1]));
    }
}
