//! The ruler of the benches: the plain recursion of 201 bins over a window of 9000 samples.
#![allow(clippy::disallowed_methods)] // a bench asks the time

use std::hint::black_box;
use std::time::Instant;

pub(crate) const BINS: usize = 201;
pub(crate) const WINDOW: usize = 9000;

/// The plain recursion (6-12): rotate, new sample on, old one off.
struct Plain {
    re: Vec<f64>,
    im: Vec<f64>,
    cos: Vec<f64>,
    sin: Vec<f64>,
    history: Vec<f64>,
    at: usize,
}

impl Plain {
    fn new() -> Self {
        let angle = |k: usize| std::f64::consts::TAU * (500.0 + k as f64) / 9000.0;
        Self {
            re: vec![0.0; BINS],
            im: vec![0.0; BINS],
            cos: (0..BINS).map(|k| angle(k).cos()).collect(),
            sin: (0..BINS).map(|k| angle(k).sin()).collect(),
            history: vec![0.0; WINDOW],
            at: 0,
        }
    }

    fn step(&mut self, x: f64) {
        let change = x - std::mem::replace(&mut self.history[self.at], x);
        self.at = (self.at + 1) % WINDOW;
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("fma") && std::arch::is_x86_feature_detected!("avx2") {
            #[allow(unsafe_code)]
            // SAFETY: both features were asked for in the line before.
            return unsafe { self.fast(change) };
        }
        self.body::<false>(change);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn fast(&mut self, change: f64) {
        self.body::<true>(change);
    }

    #[inline(always)]
    fn body<const FUSED: bool>(&mut self, change: f64) {
        let (re, im) = (&mut self.re[..BINS], &mut self.im[..BINS]);
        let (cos, sin) = (&self.cos[..BINS], &self.sin[..BINS]);
        for k in 0..BINS {
            let (a, b) = (re[k] + change, im[k]);
            if FUSED {
                re[k] = a.mul_add(cos[k], -(b * sin[k]));
                im[k] = a.mul_add(sin[k], b * cos[k]);
            } else {
                re[k] = a * cos[k] - b * sin[k];
                im[k] = a * sin[k] + b * cos[k];
            }
        }
    }
}

/// Nanoseconds of one step of one bin.
pub(crate) fn plain(input: &[f64]) -> f64 {
    let mut plain = Plain::new();
    let begin = Instant::now();
    input.iter().for_each(|x| plain.step(*x));
    let spent = begin.elapsed().as_secs_f64();
    black_box((&plain.re, &plain.im));
    spent * 1e9 / (input.len() * BINS) as f64
}
