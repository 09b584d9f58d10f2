//! Inner products and short filters over long series, with vector instructions where the processor has them.
//!
//! The default target has no fused multiply-add, and `f64::mul_add` without it is a library call. Each kernel
//! is one generic body, compiled twice; the fast copy is chosen at run time. Both add in the same order, so
//! results of one processor are equal from run to run.

/// Partial sums that are kept side by side: four vectors of four.
const LANES: usize = 16;
/// One vector.
const VECTOR: usize = 4;

/// sum_k a[k] b[k] over the shorter of both.
#[must_use]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        return fast::call_dot(a, b);
    }
    dot_body::<false>(a, b)
}

/// Root mean square; 0 of nothing.
#[must_use]
pub fn rms(x: &[f64]) -> f64 {
    (dot(x, x) / x.len().max(1) as f64).sqrt()
}

/// out[j] = sum_k taps[k] x[first + j step + k]: correlation with `taps` on a thinned grid.
/// The caller keeps `first + (out.len() - 1) step + taps.len() <= x.len()`.
pub fn correlate(x: &[f64], taps: &[f64], (first, step): (usize, usize), out: &mut [f64]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        return fast::call_correlate(x, taps, (first, step), out);
    }
    correlate_body::<false>(x, taps, (first, step), out);
}

/// out[t] += sum_k taps[k] x[t - k] for t from `taps.len() - 1`.
pub fn add_filtered(out: &mut [f64], x: &[f64], taps: &[f64]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        return fast::call_add_filtered(out, x, taps);
    }
    add_filtered_body::<false>(out, x, taps);
}

#[inline(always)]
fn multiply_add<const FUSED: bool>(a: f64, b: f64, c: f64) -> f64 {
    if FUSED { a.mul_add(b, c) } else { a * b + c }
}

#[inline(always)]
fn dot_body<const FUSED: bool>(a: &[f64], b: &[f64]) -> f64 {
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

#[inline(always)]
fn correlate_body<const FUSED: bool>(
    x: &[f64],
    taps: &[f64],
    (first, step): (usize, usize),
    out: &mut [f64],
) {
    for (j, o) in out.iter_mut().enumerate() {
        let start = first + j * step;
        *o = dot_body::<FUSED>(&x[start..start + taps.len()], taps);
    }
}

#[inline(always)]
fn add_filtered_body<const FUSED: bool>(out: &mut [f64], x: &[f64], taps: &[f64]) {
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

#[cfg(target_arch = "x86_64")]
#[expect(unsafe_code, reason = "calls of functions compiled for instructions that were found at run time")]
mod fast {
    #[target_feature(enable = "avx2,fma")]
    fn dot(a: &[f64], b: &[f64]) -> f64 {
        super::dot_body::<true>(a, b)
    }

    #[target_feature(enable = "avx2,fma")]
    fn correlate(x: &[f64], taps: &[f64], grid: (usize, usize), out: &mut [f64]) {
        super::correlate_body::<true>(x, taps, grid, out);
    }

    #[target_feature(enable = "avx2,fma")]
    fn add_filtered(out: &mut [f64], x: &[f64], taps: &[f64]) {
        super::add_filtered_body::<true>(out, x, taps);
    }

    pub(super) fn call_dot(a: &[f64], b: &[f64]) -> f64 {
        // SAFETY: the caller has found AVX2 and FMA on this processor.
        unsafe { dot(a, b) }
    }

    pub(super) fn call_correlate(x: &[f64], taps: &[f64], grid: (usize, usize), out: &mut [f64]) {
        // SAFETY: the caller has found AVX2 and FMA on this processor.
        unsafe { correlate(x, taps, grid, out) }
    }

    pub(super) fn call_add_filtered(out: &mut [f64], x: &[f64], taps: &[f64]) {
        // SAFETY: the caller has found AVX2 and FMA on this processor.
        unsafe { add_filtered(out, x, taps) }
    }
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
