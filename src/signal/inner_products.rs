//! Inner products and short filters over long series, with vector instructions where the processor has them.
//!
//! All copies of a kernel add in the same order, so results of one processor are equal from run to run.

use super::dispatch::{Fast, Kernel, multiply_add, run};

/// Partial sums that are kept side by side: four vectors of four.
const LANES: usize = 16;
/// One vector.
const VECTOR: usize = 4;

/// sum_k a[k] b[k] over the shorter of both.
#[must_use]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    run(Fast::detect(), Dot { a, b })
}

/// sum_k a[k] b[k] of four a beside one b, over the shortest of all.
#[must_use]
pub fn dots(a: [&[f64]; 4], b: &[f64]) -> [f64; 4] {
    run(Fast::detect(), Dots { a, b })
}

/// Root mean square; 0 of nothing.
#[must_use]
pub fn rms(x: &[f64]) -> f64 {
    (dot(x, x) / x.len().max(1) as f64).sqrt()
}

/// out[j] = sum_k taps[k] x[first + j step + k]: correlation with `taps` on a thinned grid.
/// The caller keeps `first + (out.len() - 1) step + taps.len() <= x.len()`.
pub fn correlate(x: &[f64], taps: &[f64], (first, step): (usize, usize), out: &mut [f64]) {
    run(Fast::detect(), Correlate { x, taps, first, step, out });
}

/// out[t] += sum_k taps[k] x[t - k] for t from `taps.len() - 1`.
pub fn add_filtered(out: &mut [f64], x: &[f64], taps: &[f64]) {
    run(Fast::detect(), AddFiltered { out, x, taps });
}

struct Dot<'a> {
    a: &'a [f64],
    b: &'a [f64],
}

struct Dots<'a> {
    a: [&'a [f64]; 4],
    b: &'a [f64],
}

struct Correlate<'a> {
    x: &'a [f64],
    taps: &'a [f64],
    first: usize,
    step: usize,
    out: &'a mut [f64],
}

struct AddFiltered<'a> {
    out: &'a mut [f64],
    x: &'a [f64],
    taps: &'a [f64],
}

impl Kernel for Dot<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> f64 {
        dot_of::<FUSED>(self.a, self.b)
    }
}

impl Kernel for Dots<'_> {
    type Output = [f64; 4];

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> [f64; 4] {
        let Self { a, b } = self;
        let n = a.iter().fold(b.len(), |n, a| n.min(a.len()));
        let (a, b) = (a.map(|a| &a[..n]), &b[..n]);
        let mut sums = [[0.0f64; 2 * VECTOR]; 4];
        let whole = n / (2 * VECTOR) * (2 * VECTOR);
        for t in (0..whole).step_by(2 * VECTOR) {
            let y = &b[t..t + 2 * VECTOR];
            for (sums, a) in sums.iter_mut().zip(&a) {
                let x = &a[t..t + 2 * VECTOR];
                for k in 0..2 * VECTOR {
                    sums[k] = multiply_add::<FUSED>(x[k], y[k], sums[k]);
                }
            }
        }
        std::array::from_fn(|j| {
            let rest = dot_of::<FUSED>(&a[j][whole..], &b[whole..]);
            sums[j].iter().sum::<f64>() + rest
        })
    }
}

impl Kernel for Correlate<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self { x, taps, first, step, out } = self;
        for (j, o) in out.iter_mut().enumerate() {
            let start = first + j * step;
            *o = dot_of::<FUSED>(&x[start..start + taps.len()], taps);
        }
    }
}

impl Kernel for AddFiltered<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Self { out, x, taps } = self;
        let past = taps.len().saturating_sub(1);
        let mut t = past;
        while t + LANES <= x.len() {
            let mut sums = [0.0f64; LANES];
            for (k, tap) in taps.iter().enumerate() {
                let piece = &x[t - k..t - k + LANES];
                for j in 0..LANES {
                    sums[j] = multiply_add::<FUSED>(*tap, piece[j], sums[j]);
                }
            }
            for (o, s) in out[t..t + LANES].iter_mut().zip(&sums) {
                *o += s;
            }
            t += LANES;
        }
        for t in t..x.len() {
            out[t] += taps.iter().enumerate().map(|(k, tap)| tap * x[t - k]).sum::<f64>();
        }
    }
}

#[inline(always)]
fn dot_of<const FUSED: bool>(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0f64; LANES];
    let mut xs = a.chunks_exact(LANES);
    let mut ys = b.chunks_exact(LANES);
    for (x, y) in (&mut xs).zip(&mut ys) {
        for k in 0..LANES {
            sums[k] = multiply_add::<FUSED>(x[k], y[k], sums[k]);
        }
    }
    let mut vector = [0.0f64; VECTOR];
    for k in 0..LANES {
        vector[k % VECTOR] += sums[k];
    }
    let done = a.len().min(b.len()) / LANES * LANES;
    let mut xs = a[done..].chunks_exact(VECTOR);
    let mut ys = b[done..].chunks_exact(VECTOR);
    for (x, y) in (&mut xs).zip(&mut ys) {
        for k in 0..VECTOR {
            vector[k] = multiply_add::<FUSED>(x[k], y[k], vector[k]);
        }
    }
    let done = a.len().min(b.len()) / VECTOR * VECTOR;
    let mut rest = 0.0;
    for (x, y) in a[done..].iter().zip(&b[done..]) {
        rest = multiply_add::<FUSED>(*x, *y, rest);
    }
    vector.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_copy_agrees_with_the_plain_one() {
        let a: Vec<f64> = (0..1003).map(|k| (k as f64 * 0.37).sin()).collect();
        let b: Vec<f64> = (0..1003).map(|k| (k as f64 * 0.11).cos()).collect();
        let plain: f64 = a.iter().zip(&b).map(|(x, y)| x * y).sum();
        assert!((dot(&a, &b) - plain).abs() < 1e-10);
        let four = dots([&a, &b, &a[1..], &b[..7]], &b);
        let plain = [&a[..], &b, &a[1..], &b[..7]].map(|a| dot(a, &b[..7]));
        assert!(four.iter().zip(&plain).all(|(x, y)| (x - y).abs() < 1e-10));
        let long = [&a[..], &b, &a[5..], &b[3..]];
        let plain = long.map(|a| dot(&a[..998], &b[..998]));
        assert!(dots(long, &b[..998]).iter().zip(&plain).all(|(x, y)| (x - y).abs() < 1e-10));
        let taps = [0.5, -0.2, 0.1];
        let mut out = vec![0.0; 1003];
        add_filtered(&mut out, &a, &taps);
        for t in 2..1003 {
            assert!((out[t] - (0.5 * a[t] - 0.2 * a[t - 1] + 0.1 * a[t - 2])).abs() < 1e-12);
        }
        let mut thin = vec![0.0; 100];
        correlate(&a, &taps, (5, 4), &mut thin);
        assert!((thin[7] - (0.5 * a[33] - 0.2 * a[34] + 0.1 * a[35])).abs() < 1e-12);
    }
}
