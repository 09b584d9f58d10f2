//! Discrete Fourier transform of a few hundred complex values: radix 2, in place, no allocation.

use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;

/// Turns of all sizes up to one.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fourier {
    turns: Vec<C>,
}

impl Fourier {
    /// For up to `size` points, a power of two.
    pub(super) fn new(size: usize) -> Self {
        Self { turns: (0..size / 2).map(|k| C::from_polar(1.0, -TAU * k as f64 / size as f64)).collect() }
    }

    /// sum_q x_q e^{-j 2 pi k q / n} for all k, n the length of `x`. Requires: a power of two, not above the
    /// size.
    pub(super) fn transform(&self, x: &mut [C]) {
        let n = x.len();
        let bits = n.trailing_zeros();
        for i in 0..n {
            let j = i.reverse_bits() >> (usize::BITS - bits);
            if j > i {
                x.swap(i, j);
            }
        }
        let mut half = 1;
        while half < n {
            let stride = self.turns.len() / half;
            for block in x.chunks_exact_mut(2 * half) {
                let (low, high) = block.split_at_mut(half);
                for ((a, b), turn) in low.iter_mut().zip(high).zip(self.turns.iter().step_by(stride)) {
                    let y = *b * turn;
                    (*a, *b) = (*a + y, *a - y);
                }
            }
            half *= 2;
        }
    }
}
