//! Discrete Fourier transform of a few hundred complex values: radix 2, no allocation.

use crate::signal::dispatch::{Fast, Kernel, run};
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;
/// Most points.
pub(super) const MOST_POINTS: usize = 512;

/// Turns of all sizes up to one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fourier {
    /// Real and imaginary parts of the turns of the stage that joins transforms of `half` values: from `half`
    /// on.
    turns: [Vec<f64>; 2],
    fast: Fast,
}

impl Fourier {
    pub(super) fn new() -> Self {
        let stage =
            |half: usize| (0..half).map(move |k| C::from_polar(1.0, -TAU * k as f64 / (2 * half) as f64));
        let halves = std::iter::successors(Some(1), |half| Some(2 * half)).take_while(|h| *h < MOST_POINTS);
        let all = std::iter::once(C::new(0.0, 0.0)).chain(halves.flat_map(stage));
        let (re, im) = all.map(|t| (t.re, t.im)).unzip();
        Self { turns: [re, im], fast: Fast::detect() }
    }

    /// sum_q x_q e^{-j 2 pi k q / n} for all k, n the length of `x`. Requires: a power of two, at most
    /// [`MOST_POINTS`].
    pub(super) fn transform(&self, x: &mut [C]) {
        let n = x.len();
        let mut run = |re: &mut [f64], im: &mut [f64]| {
            let (re, im) = (&mut re[..n], &mut im[..n]);
            run(self.fast, Transform { turns: &self.turns, x: &mut *x, re, im });
        };
        // No more is cleared than is needed.
        match n {
            0..=64 => run(&mut [0.0; 64], &mut [0.0; 64]),
            65..=128 => run(&mut [0.0; 128], &mut [0.0; 128]),
            129..=256 => run(&mut [0.0; 256], &mut [0.0; 256]),
            _ => run(&mut [0.0; MOST_POINTS], &mut [0.0; MOST_POINTS]),
        }
    }
}

struct Transform<'a> {
    turns: &'a [Vec<f64>; 2],
    x: &'a mut [C],
    re: &'a mut [f64],
    im: &'a mut [f64],
}

impl Kernel for Transform<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self { turns: [turns_re, turns_im], x, re, im } = self;
        let n = x.len();
        let shift = usize::BITS - n.trailing_zeros();
        for (i, x) in x.iter().enumerate() {
            let j = i.reverse_bits() >> shift;
            (re[j], im[j]) = (x.re, x.im);
        }
        let mut half = 1;
        while half < n {
            let (c, s) = (&turns_re[half..2 * half], &turns_im[half..2 * half]);
            for (re, im) in re.chunks_exact_mut(2 * half).zip(im.chunks_exact_mut(2 * half)) {
                let ((a_re, b_re), (a_im, b_im)) = (re.split_at_mut(half), im.split_at_mut(half));
                for k in 0..half {
                    let y = [b_re[k] * c[k] - b_im[k] * s[k], b_re[k] * s[k] + b_im[k] * c[k]];
                    (a_re[k], b_re[k]) = (a_re[k] + y[0], a_re[k] - y[0]);
                    (a_im[k], b_im[k]) = (a_im[k] + y[1], a_im[k] - y[1]);
                }
            }
            half *= 2;
        }
        for (x, (re, im)) in x.iter_mut().zip(re.iter().zip(im.iter())) {
            *x = C::new(*re, *im);
        }
    }
}
