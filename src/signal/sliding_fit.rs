//! Inner products of a moving window with constant, ramp and harmonics, at a cost that the length of the
//! window has no part in.
//!
//! ```text
//!  S_0 = sum x[a],  S_1 = sum a x[a],  Z_i = sum x[a] e^{-j i w a},   a counted from an epoch
//!  a sample comes in:  Z_i += x[a] p_i - x[a - m] p_i e^{j i w m},   p_i = e^{-j i w a}, turned each step
//!  about the middle c of the window:  sum x cos + j sum x sin = conj(Z_i) e^{-j i w c}
//! ```
//! What the sliding difference leaves of rounding would stay for ever. So beside each window that slides a
//! second one grows from nothing; when it is full, after m samples, it takes the other's place (there is no
//! step: both hold the same samples) and the epoch moves on by m, which starts the phasors anew from one.
//! Rounding is that of two windows, however long the stream.
//!
//! Any weighted sum of the window whose weights are a combination of those functions, as all least-squares
//! weights are, is the same combination of the inner products ([`super::harmonic_fit`]).
//! Checked by: sums_are_those_of_the_window_however_long_it_runs.

use super::harmonic_fit::{HarmonicBasis, LONGEST_WINDOW, LongLine, USUAL_HARMONICS, USUAL_UNKNOWNS};
use rustfft::num_complex::Complex64;

/// Numbers of one window and one speed; immutable but for [`SlidingBasis::begin`].
#[derive(Debug, Clone, PartialEq)]
pub struct SlidingBasis {
    basis: HarmonicBasis,
    /// e^{-j i w}, e^{j i w m}, e^{j i w (N + 1)}.
    step: Phasors,
    window: Phasors,
    middle: Phasors,
}

/// One complex number for each harmonic.
#[derive(Debug, Clone, PartialEq)]
struct Phasors {
    re: Vec<f64>,
    im: Vec<f64>,
}

crate::keyframe::keep!(Phasors { re, im });

impl Phasors {
    fn roomy() -> Self {
        Self { re: Vec::with_capacity(USUAL_HARMONICS), im: Vec::with_capacity(USUAL_HARMONICS) }
    }

    fn fill(&mut self, values: impl Iterator<Item = Complex64>) {
        self.re.clear();
        self.im.clear();
        for value in values {
            self.re.push(value.re);
            self.im.push(value.im);
        }
    }

    fn zero(&mut self, count: usize) {
        self.fill(std::iter::repeat_n(Complex64::default(), count));
    }
}

/// Sums of one signal over one window.
#[derive(Debug, Clone, PartialEq)]
struct Sums {
    constant: f64,
    ramp: f64,
    lines: Phasors,
}

crate::keyframe::keep!(Sums { constant, ramp, lines });

impl Sums {
    fn roomy() -> Self {
        Self { constant: 0.0, ramp: 0.0, lines: Phasors::roomy() }
    }

    fn zero(&mut self, harmonics: usize) {
        (self.constant, self.ramp) = (0.0, 0.0);
        self.lines.zero(harmonics);
    }
}

/// One signal: its last samples, the window that slides and the one that grows.
#[derive(Debug, Clone, PartialEq)]
struct Signal {
    line: LongLine,
    slid: Sums,
    grown: Sums,
}

crate::keyframe::keep!(Signal { line, slid, grown });

/// `N` signals under one window; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub struct SlidingFit<const N: usize> {
    signals: [Signal; N],
    /// e^{-j i w a} of the sample that comes next.
    phasor: Phasors,
    /// Samples since the epoch.
    age: usize,
    /// Inner products of each signal: constant, ramp, sine and cosine of each harmonic.
    products: [Vec<f64>; N],
}

crate::keyframe::keep!(SlidingFit<N> { signals, phasor, age, products } if |s| s.age <= LONGEST_WINDOW);

impl Default for SlidingBasis {
    /// No harmonic.
    fn default() -> Self {
        Self {
            basis: HarmonicBasis { half_window: 0, fundamental_rad: 0.0, harmonics: 0 },
            step: Phasors::roomy(),
            window: Phasors::roomy(),
            middle: Phasors::roomy(),
        }
    }
}

impl SlidingBasis {
    /// Another window. No allocation up to 40 harmonics.
    pub fn begin(&mut self, basis: HarmonicBasis) {
        self.basis = basis;
        let turned = |samples: f64| {
            (1..=basis.harmonics)
                .map(move |i| Complex64::from_polar(1.0, i as f64 * basis.fundamental_rad * samples))
        };
        self.step.fill(turned(-1.0));
        self.window.fill(turned(basis.samples() as f64));
        self.middle.fill(turned(basis.half_window as f64 + 1.0));
    }
}

impl<const N: usize> Default for SlidingFit<N> {
    /// Nothing seen, with memory for the longest window.
    fn default() -> Self {
        let signal = || Signal { line: LongLine::roomy(1, 0.0), slid: Sums::roomy(), grown: Sums::roomy() };
        Self {
            signals: std::array::from_fn(|_| signal()),
            phasor: Phasors::roomy(),
            age: 0,
            products: std::array::from_fn(|_| Vec::with_capacity(USUAL_UNKNOWNS)),
        }
    }
}

impl<const N: usize> SlidingFit<N> {
    /// As if each signal had always had its value. No allocation up to 40 harmonics.
    ///
    ///   sum of e^{-j i w a} over a = -m..-1 = e^{j i w (N + 1)} sin(m i w/2)/sin(i w/2)
    pub fn settle(&mut self, basis: &SlidingBasis, values: [f64; N]) {
        let window = &basis.basis;
        let (samples, harmonics) = (window.samples(), window.harmonics);
        self.age = 0;
        self.phasor.fill(std::iter::repeat_n(Complex64::new(1.0, 0.0), harmonics));
        for ((signal, products), value) in self.signals.iter_mut().zip(&mut self.products).zip(values) {
            signal.line.refill(samples, value);
            let count = samples as f64;
            signal.slid.constant = value * count;
            signal.slid.ramp = -value * 0.5 * count * (count + 1.0);
            signal.slid.lines.fill((1..=harmonics).map(|i| {
                let half = 0.5 * i as f64 * window.fundamental_rad;
                let size = value * (half * count).sin() / half.sin();
                Complex64::from_polar(1.0, 2.0 * half * (window.half_window as f64 + 1.0)) * size
            }));
            signal.grown.zero(harmonics);
            products.clear();
            products.resize(window.unknowns(), 0.0);
        }
        self.read(basis);
    }

    /// The youngest sample of a signal.
    #[must_use]
    pub fn last(&self, signal: usize) -> f64 {
        self.signals[signal].line.last()
    }

    /// One sample of each signal in. Cost: about twenty multiplications a harmonic and signal.
    #[inline]
    pub fn step(&mut self, basis: &SlidingBasis, values: [f64; N]) {
        let age = self.age as f64;
        let samples = basis.basis.samples();
        let count = basis.basis.harmonics;
        let (p_re, p_im) = (&self.phasor.re[..count], &self.phasor.im[..count]);
        let (q_re, q_im) = (&basis.window.re[..count], &basis.window.im[..count]);
        for (signal, value) in self.signals.iter_mut().zip(values) {
            let old = signal.line.oldest();
            signal.line.push(value);
            signal.slid.constant += value - old;
            signal.slid.ramp += age * value - (age - samples as f64) * old;
            signal.grown.constant += value;
            signal.grown.ramp += age * value;
            let (re, im) = (&mut signal.slid.lines.re[..count], &mut signal.slid.lines.im[..count]);
            for i in 0..count {
                let out_re = p_re[i] * q_re[i] - p_im[i] * q_im[i];
                let out_im = p_re[i] * q_im[i] + p_im[i] * q_re[i];
                re[i] += value * p_re[i] - old * out_re;
                im[i] += value * p_im[i] - old * out_im;
            }
            let (re, im) = (&mut signal.grown.lines.re[..count], &mut signal.grown.lines.im[..count]);
            for i in 0..count {
                re[i] += value * p_re[i];
                im[i] += value * p_im[i];
            }
        }
        turn(&mut self.phasor, &basis.step);
        self.age += 1;
        if self.age >= samples {
            self.move_epoch(basis);
        }
        self.read(basis);
    }

    /// The grown window takes the place of the slid one; ages are counted from m samples later.
    fn move_epoch(&mut self, basis: &SlidingBasis) {
        let samples = basis.basis.samples() as f64;
        for signal in &mut self.signals {
            std::mem::swap(&mut signal.slid, &mut signal.grown);
            signal.slid.ramp -= samples * signal.slid.constant;
            turn(&mut signal.slid.lines, &basis.window);
            signal.grown.zero(basis.basis.harmonics);
        }
        self.age = 0;
        self.phasor.re.fill(1.0);
        self.phasor.im.fill(0.0);
    }

    #[inline]
    fn read(&mut self, basis: &SlidingBasis) {
        let count = basis.basis.harmonics;
        let middle_age = self.age as f64 - 1.0 - basis.basis.half_window as f64;
        let (p_re, p_im) = (&self.phasor.re[..count], &self.phasor.im[..count]);
        let (r_re, r_im) = (&basis.middle.re[..count], &basis.middle.im[..count]);
        for (signal, products) in self.signals.iter().zip(&mut self.products) {
            let sums = &signal.slid;
            products[0] = sums.constant;
            products[1] = sums.ramp - middle_age * sums.constant;
            let (z_re, z_im) = (&sums.lines.re[..count], &sums.lines.im[..count]);
            for (i, pair) in products[2..].chunks_exact_mut(2).enumerate().take(count) {
                let c_re = p_re[i] * r_re[i] - p_im[i] * r_im[i];
                let c_im = p_re[i] * r_im[i] + p_im[i] * r_re[i];
                // conj(Z) e^{-j i w c}: its imaginary part is the sum with the sine.
                pair[0] = z_re[i] * c_im - z_im[i] * c_re;
                pair[1] = z_re[i] * c_re + z_im[i] * c_im;
            }
        }
    }

    /// Sum of coefficients (constant, ramp, sine and cosine of each harmonic) times the inner products of a
    /// signal.
    #[inline]
    #[must_use]
    pub fn apply(&self, signal: usize, coefficients: &[f64]) -> f64 {
        super::inner_products::dot(&self.products[signal], coefficients)
    }
}

#[inline]
fn turn(what: &mut Phasors, by: &Phasors) {
    let count = by.re.len();
    let (re, im) = (&mut what.re[..count], &mut what.im[..count]);
    let (b_re, b_im) = (&by.re[..count], &by.im[..count]);
    for i in 0..count {
        let (x, y) = (re[i], im[i]);
        re[i] = x * b_re[i] - y * b_im[i];
        im[i] = x * b_im[i] + y * b_re[i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    /// A position that is far from zero and moves, beside sums over the window made anew each time.
    #[test]
    fn sums_are_those_of_the_window_however_long_it_runs() {
        let basis = HarmonicBasis { half_window: 225, fundamental_rad: TAU / 450.3, harmonics: 25 };
        let (m, n) = (basis.samples(), basis.unknowns());
        let x = |i: usize| {
            let t = i as f64;
            0.3 + 1e-6 * t + 1e-6 * (basis.fundamental_rad * 3.0 * t).sin() + 1e-7 * (0.31 * t * t).cos()
        };
        let mut sliding = SlidingBasis::default();
        sliding.begin(basis);
        let mut fit = SlidingFit::<1>::default();
        fit.settle(&sliding, [0.3]);
        let window = |values: &dyn Fn(usize) -> f64, k: usize| -> f64 {
            (0..m)
                .map(|j| {
                    let mut row = vec![0.0; n];
                    basis.add_row((j as f64 - basis.half_window as f64, 0), 1.0, &mut row);
                    values(j) * row[k]
                })
                .sum()
        };
        let unit = |k: usize| (0..n).map(|i| if i == k { 1.0 } else { 0.0 }).collect::<Vec<f64>>();
        for k in [0, 1, 2, 3, 51] {
            assert!((fit.apply(0, &unit(k)) - window(&|_| 0.3, k)).abs() < 1e-9, "settled {k}");
        }
        for i in 0..100_000 {
            fit.step(&sliding, [x(i)]);
            if [449, 450, 451, 5000, 99_999].contains(&i) {
                let at = |j: usize| if i + 1 + j >= m { x(i + 1 + j - m) } else { 0.3 };
                for k in [0, 1, 2, 3, 6, 7, 50, 51] {
                    let (is, expected) = (fit.apply(0, &unit(k)), window(&at, k));
                    // Two hundred and fifty samples of 0.3 times rounding, the ramp's grow with its length.
                    let scale = if k == 1 { 1e-8 } else { 2e-12 * 0.5 * m as f64 };
                    assert!((is - expected).abs() < scale, "{i}, {k}: {is} {expected}");
                }
            }
        }
    }
}
