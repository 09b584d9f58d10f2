//! A band of a real signal, mixed to zero and sampled only as fast as the band needs.
//!
//! ```text
//! x(n) --*e^{-j w0 n}--> low-pass (windowed sinc) --every D-th--> complex z(m), band at -B/2 .. B/2
//! ```
//! The mixing is done with the filter, once an output: sum h(k) x(n-k) e^{-j w0 (n-k)} = e^{-j w0 n} sum
//! (h(k) e^{j w0 k}) x(n-k). A sample that makes no output is stored and that is all.

use super::dispatch::{Fast, Kernel, multiply_add, run};
use crate::units::SampleRate;
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// Mixer and decimator. `z` of a sine of amplitude A in the band has modulus A/sqrt(2): |z|^2 is its power.
#[derive(Debug, Clone, PartialEq)]
pub struct DownMix {
    centre_hz: f64,
    decimation: usize,
    /// Turn of the mixer from one output to the next.
    step: Complex<f64>,
    /// Taps with the mixer of their age, real and imaginary parts, oldest sample first.
    taps: [Vec<f64>; 2],
    rate: SampleRate,
    fast: Fast,
}

/// State of [`DownMix`].
#[derive(Debug, Clone, PartialEq)]
pub struct DownMixState {
    rotor: Complex<f64>,
    /// Twice the filter's length, written in both halves: a window is always in one piece.
    history: Vec<f64>,
    at: usize,
    until_output: usize,
}

crate::keyframe::keep!(DownMixState { rotor, history, at, until_output }
    if |s| s.at < s.history.len() / 2 && s.until_output > 0);

impl DownMix {
    /// A band around `centre_hz`, `half_width_hz` to each side kept flat.
    ///
    /// The output rate is at least three times the band's width. Requires: band inside 0..rate/2, which the
    /// caller has checked.
    #[must_use]
    pub fn new(rate: SampleRate, centre_hz: f64, half_width_hz: f64) -> Self {
        let fs = rate.hz();
        let decimation = (fs / (6.0 * half_width_hz)).floor().max(1.0);
        // What must be gone: what decimation would fold into the band, the constant at -centre, the mirror.
        let stop_hz =
            (fs / decimation - half_width_hz).min(centre_hz).min(fs - 2.0 * centre_hz - half_width_hz);
        let transition = ((stop_hz - half_width_hz) / fs).max(0.004);
        // Kaiser's formula for 70 dB: (A - 8)/(2.285 * 2 pi * df) taps.
        let length = ((70.0 - 8.0) / (2.285 * TAU * transition)).ceil().max(3.0);
        let cut = (half_width_hz + stop_hz.max(half_width_hz)) / 2.0 / fs;
        let middle = (length - 1.0) / 2.0;
        let (mut taps, mut null, mut n) = (Vec::new(), Vec::new(), 0.0);
        while n < length {
            let x: f64 = n - middle;
            let sinc = if x.abs() < 1e-9 { 2.0 * cut } else { (TAU * cut * x).sin() / (PI * x) };
            let inside = 1.0 - (x / (middle + 1.0)).powi(2);
            let window = bessel_i0(6.755 * inside.max(0.0).sqrt());
            taps.push(sinc * window);
            null.push(((TAU * centre_hz / fs * x).cos(), window));
            n += 1.0;
        }
        // The constant may be a thousand times the line: the response there is made exactly zero.
        let at_constant: f64 = taps.iter().zip(&null).map(|(t, (c, _))| t * c).sum();
        let reach: f64 = null.iter().map(|(c, w)| c * c * w).sum();
        for (tap, (c, w)) in taps.iter_mut().zip(&null) {
            *tap -= at_constant / reach * c * w;
        }
        let sum: f64 = taps.iter().sum();
        // sqrt(2): half of a real line's power lies at the negative frequency, which is filtered away.
        taps.iter_mut().for_each(|t| *t *= std::f64::consts::SQRT_2 / sum);
        let step = Complex::from_polar(1.0, -TAU * (centre_hz * decimation / fs).fract());
        let last = taps.len() as f64 - 1.0;
        let mixed = taps.iter().enumerate().map(|(i, tap)| {
            let turns = (centre_hz * (last - i as f64) / fs).fract();
            Complex::from_polar(*tap, TAU * turns)
        });
        let (re, im) = mixed.map(|t| (t.re, t.im)).unzip();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        Self { centre_hz, decimation: decimation as usize, step, taps: [re, im], rate, fast: Fast::detect() }
    }

    /// Frequency that is mixed to zero.
    #[must_use]
    pub fn centre_hz(&self) -> f64 {
        self.centre_hz
    }

    /// Rate of the output in Hz.
    #[must_use]
    pub fn output_rate_hz(&self) -> f64 {
        self.rate.hz() / self.decimation as f64
    }

    /// Input samples for one output.
    #[must_use]
    pub fn decimation(&self) -> usize {
        self.decimation
    }

    /// How far the output lags the input.
    #[must_use]
    pub fn delay_s(&self) -> f64 {
        (self.taps[0].len() - 1) as f64 / 2.0 * self.rate.period_s()
    }

    /// Nothing heard yet.
    #[must_use]
    pub fn start(&self) -> DownMixState {
        DownMixState {
            rotor: Complex::from_polar(
                1.0,
                -TAU * (self.centre_hz * (self.decimation as f64 - 1.0) / self.rate.hz()).fract(),
            ),
            history: vec![0.0; 2 * self.taps[0].len()],
            at: 0,
            until_output: self.decimation,
        }
    }

    /// Takes one sample; true with every `decimation`-th, when there is an [`DownMix::output`]. Cost: two
    /// stores.
    #[inline]
    pub fn push(&self, state: &mut DownMixState, x: f64) -> bool {
        let length = self.taps[0].len();
        state.history[state.at] = x;
        state.history[state.at + length] = x;
        state.at += 1;
        if state.at == length {
            state.at = 0;
        }
        state.until_output -= 1;
        state.until_output == 0
    }

    /// The band now. Requires: asked for when [`DownMix::push`] says so. Cost: no allocation.
    /// Checked by: `a_line_keeps_its_power_and_its_place`, `what_is_outside_is_gone`.
    pub fn output(&self, state: &mut DownMixState) -> Complex<f64> {
        state.until_output = self.decimation;
        let window = &state.history[state.at..state.at + self.taps[0].len()];
        let sum = run(self.fast, Sum { window, taps: &self.taps });
        let value = state.rotor * sum;
        state.rotor *= self.step;
        // One Newton step toward modulus one: the rotor neither grows nor fades.
        state.rotor *= 1.5 - 0.5 * state.rotor.norm_sqr();
        value
    }
}

/// Sum of samples times complex taps.
struct Sum<'a> {
    window: &'a [f64],
    taps: &'a [Vec<f64>; 2],
}

impl Kernel for Sum<'_> {
    type Output = Complex<f64>;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> Complex<f64> {
        const LANES: usize = 8;
        let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
        let parts = self.window.chunks_exact(LANES);
        let rest = parts.remainder();
        let taps = self.taps[0].chunks_exact(LANES).zip(self.taps[1].chunks_exact(LANES));
        for (x, (a, b)) in parts.zip(taps) {
            for lane in 0..LANES {
                re[lane] = multiply_add::<FUSED>(x[lane], a[lane], re[lane]);
                im[lane] = multiply_add::<FUSED>(x[lane], b[lane], im[lane]);
            }
        }
        let mut sum = Complex::new(re.iter().sum(), im.iter().sum());
        let done = self.window.len() - rest.len();
        for (x, (a, b)) in rest.iter().zip(self.taps[0][done..].iter().zip(&self.taps[1][done..])) {
            sum += Complex::new(*a, *b) * *x;
        }
        sum
    }
}

/// Modified Bessel function I0 by its power series; the argument here is below 10.
fn bessel_i0(x: f64) -> f64 {
    let quarter = x * x / 4.0;
    let (mut sum, mut term) = (1.0, 1.0);
    for k in 1..40 {
        term *= quarter / f64::from(k * k);
        sum += term;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn last_output(rate_hz: f64, line_hz: f64) -> (DownMix, Vec<Complex<f64>>) {
        let mix = DownMix::new(SampleRate::new(rate_hz).unwrap(), 650.0, 150.0);
        let mut state = mix.start();
        let wave = |n: u32| 2.0 * (TAU * line_hz * f64::from(n) / rate_hz).sin() + 40.0;
        let mut out = Vec::new();
        for n in 0..6000 {
            if mix.push(&mut state, wave(n)) {
                out.push(mix.output(&mut state));
            }
        }
        (mix, out)
    }

    #[test]
    fn a_line_keeps_its_power_and_its_place() {
        for (rate_hz, line_hz) in [(9000.0, 700.0), (9000.0, 520.0), (20000.0, 640.0), (1900.0, 700.0)] {
            let (mix, out) = last_output(rate_hz, line_hz);
            let (a, b) = (out[out.len() - 2], out[out.len() - 1]);
            assert!((b.norm_sqr() - 2.0).abs() < 0.06, "{} at {rate_hz} Hz", b.norm_sqr());
            let f = (b * a.conj()).arg() / TAU * mix.output_rate_hz() + mix.centre_hz();
            assert!((f - line_hz).abs() < 0.1, "{f} for {line_hz}");
        }
    }

    #[test]
    fn what_is_outside_is_gone() {
        let (mix, out) = last_output(9000.0, 2000.0);
        assert!(mix.decimation() >= 9);
        // 70 dB of the line's power 2 and of the constant's 2 * 40^2.
        assert!(out[out.len() - 1].norm_sqr() < (2.0 + 3200.0) * 1e-7 * 2.0);
    }
}
