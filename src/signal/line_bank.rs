//! A bank of narrow complex filters over a mixed-down band: how strong is a line at each frequency, heard
//! through a window of a given length that weighs the latest samples most.
//!
//! h(t) = t/tau^2 e^{-t/tau} e^{j w_k t}: two poles in one place. It is the matched filter of a line that
//! grows out of noise, its side falls with the fourth power of frequency, and its memory fades by itself:
//! nothing can drift.

use super::dispatch::{Fast, Kernel, multiply_add, run};
use nalgebra::Complex;
use std::f64::consts::TAU;

/// Frequencies and window of a bank.
#[derive(Debug, Clone, PartialEq)]
pub struct LineBank {
    tau_s: f64,
    rate_hz: f64,
    frequencies_hz: Vec<f64>,
    poles: Vec<Complex<f64>>,
    /// Real and imaginary parts of the poles, for the loop over all of them.
    parts: [Vec<f64>; 2],
    gain: f64,
    fast: Fast,
}

/// State of a [`LineBank`].
#[derive(Debug, Clone, PartialEq)]
pub struct LineBankState {
    /// Real, imaginary.
    first: [Vec<f64>; 2],
    second: [Vec<f64>; 2],
}

crate::keyframe::keep!(LineBankState { first, second });

impl LineBank {
    /// Filters from `-half_width_hz` to `half_width_hz` around the mixed-down zero, as close as `tau_s`
    /// needs: 1.1 dB is lost in the middle between two.
    #[must_use]
    pub fn new(rate_hz: f64, half_width_hz: f64, tau_s: f64) -> Self {
        let spacing_hz = 0.12 / tau_s;
        let to_side = (half_width_hz / spacing_hz).ceil();
        let mut frequencies_hz = Vec::new();
        let mut k = -to_side;
        while k <= to_side {
            frequencies_hz.push(k * half_width_hz / to_side);
            k += 1.0;
        }
        let decay = (-1.0 / (tau_s * rate_hz)).exp();
        let poles: Vec<Complex<f64>> =
            frequencies_hz.iter().map(|f| Complex::from_polar(decay, TAU * f / rate_hz)).collect();
        let parts = [poles.iter().map(|p| p.re).collect(), poles.iter().map(|p| p.im).collect()];
        let gain = (1.0 - decay).powi(2);
        Self { tau_s, rate_hz, frequencies_hz, poles, parts, gain, fast: Fast::detect() }
    }

    /// tau.
    #[must_use]
    pub fn tau_s(&self) -> f64 {
        self.tau_s
    }

    /// Frequencies relative to the band's centre.
    #[must_use]
    pub fn frequencies_hz(&self) -> &[f64] {
        &self.frequencies_hz
    }

    /// Nothing heard yet.
    #[must_use]
    pub fn start(&self) -> LineBankState {
        let zeros = || [vec![0.0; self.poles.len()], vec![0.0; self.poles.len()]];
        LineBankState { first: zeros(), second: zeros() }
    }

    /// Forgets what was heard.
    pub fn clear(&self, state: &mut LineBankState) {
        state.first.iter_mut().chain(&mut state.second).for_each(|part| part.fill(0.0));
    }

    /// Takes one sample of the band. Cost: two complex multiplications a filter.
    #[inline]
    pub fn step(&self, state: &mut LineBankState, value: Complex<f64>) {
        run(self.fast, Turn { parts: &self.parts, state, value: value * self.gain });
    }

    fn first(&self, state: &LineBankState, k: usize) -> Complex<f64> {
        Complex::new(state.first[0][k], state.first[1][k])
    }

    fn second(&self, state: &LineBankState, k: usize) -> Complex<f64> {
        Complex::new(state.second[0][k], state.second[1][k])
    }

    /// Power of a line at filter `k`. Checked by: `a_line_comes_out_with_its_power_and_frequency`.
    #[must_use]
    pub fn power(&self, state: &LineBankState, k: usize) -> f64 {
        self.second(state, k).norm_sqr()
    }

    /// Power at filter `k` of a line of power one that sits on filter `line` and grows at `growth_1_s`:
    ///
    /// 1/(1 + (dw tau/(1 + g tau))^2)^2
    ///
    /// Checked by: `leak_of_a_growing_line`.
    #[must_use]
    pub fn leak(&self, line: usize, growth_1_s: f64, k: usize) -> f64 {
        let slowed = (1.0 + growth_1_s * self.tau_s).max(0.5);
        let apart = TAU * (self.frequencies_hz[k] - self.frequencies_hz[line]) * self.tau_s / slowed;
        let below = 1.0 + apart * apart;
        1.0 / (below * below)
    }

    /// Frequency of the line that filter `k` hears, relative to the band's centre.
    ///
    /// In the steady state of a line off by dw the two poles' outputs stand in the ratio
    /// 1/(1 - p e^{-j w}): its angle and size give dw without waiting for a second look.
    #[must_use]
    pub fn refined_hz(&self, state: &LineBankState, k: usize) -> f64 {
        // second(n) = pole second(n-1) + first(n): the rotation of `second` in one sample.
        let before = (self.second(state, k) - self.first(state, k)) / self.poles[k];
        let turn = self.second(state, k) * before.conj();
        if turn.norm_sqr() > 0.0 { turn.arg() / TAU * self.rate_hz } else { self.frequencies_hz[k] }
    }

    /// Rate of growth of the line that filter `k` hears, 1/s.
    #[must_use]
    pub fn growth_1_s(&self, state: &LineBankState, k: usize) -> f64 {
        let before = (self.second(state, k) - self.first(state, k)) / self.poles[k];
        let (now, then) = (self.second(state, k).norm_sqr(), before.norm_sqr());
        if now > 0.0 && then > 0.0 { 0.5 * (now / then).ln() * self.rate_hz } else { 0.0 }
    }
}

/// One step of all filters: a = a p + x, b = b p + a.
struct Turn<'a> {
    parts: &'a [Vec<f64>; 2],
    state: &'a mut LineBankState,
    value: Complex<f64>,
}

impl Kernel for Turn<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let n = self.parts[0].len();
        let (pr, pi) = (&self.parts[0][..n], &self.parts[1][..n]);
        let [ar, ai] = &mut self.state.first;
        let [br, bi] = &mut self.state.second;
        let (ar, ai, br, bi) = (&mut ar[..n], &mut ai[..n], &mut br[..n], &mut bi[..n]);
        let Complex { re: xr, im: xi } = self.value;
        for k in 0..n {
            let first_re = multiply_add::<FUSED>(ar[k], pr[k], multiply_add::<FUSED>(-ai[k], pi[k], xr));
            let first_im = multiply_add::<FUSED>(ar[k], pi[k], multiply_add::<FUSED>(ai[k], pr[k], xi));
            let second_re =
                multiply_add::<FUSED>(br[k], pr[k], multiply_add::<FUSED>(-bi[k], pi[k], first_re));
            let second_im =
                multiply_add::<FUSED>(br[k], pi[k], multiply_add::<FUSED>(bi[k], pr[k], first_im));
            (ar[k], ai[k]) = (first_re, first_im);
            (br[k], bi[k]) = (second_re, second_im);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_comes_out_with_its_power_and_frequency() {
        let bank = LineBank::new(1000.0, 150.0, 0.025);
        let mut state = bank.start();
        for n in 0..1000 {
            bank.step(&mut state, Complex::from_polar(3.0, TAU * 41.3 * f64::from(n) / 1000.0));
        }
        let powers: Vec<f64> = (0..bank.frequencies_hz().len()).map(|k| bank.power(&state, k)).collect();
        let best = (0..powers.len()).max_by(|a, b| powers[*a].total_cmp(&powers[*b])).unwrap();
        assert!(powers[best] > 6.8 && powers[best] < 9.1);
        assert!((bank.refined_hz(&state, best) - 41.3).abs() < 1e-6);
        assert!(bank.growth_1_s(&state, best).abs() < 1e-6);
    }

    #[test]
    fn leak_of_a_growing_line() {
        let bank = LineBank::new(1000.0, 150.0, 0.025);
        for growth in [0.0, 40.0] {
            let (mut state, line) = (bank.start(), 20);
            for n in 0..600 {
                let t = f64::from(n) / 1000.0;
                bank.step(
                    &mut state,
                    Complex::from_polar((growth * t).exp(), TAU * bank.frequencies_hz()[line] * t),
                );
            }
            for k in [12, 18, 23, 30] {
                let leak = bank.power(&state, k) / bank.power(&state, line);
                assert!((leak / bank.leak(line, growth, k) - 1.0).abs() < 0.1, "{growth} {k} {leak}");
            }
        }
    }

    #[test]
    fn growth_of_a_growing_line() {
        let bank = LineBank::new(1000.0, 150.0, 0.025);
        let mut state = bank.start();
        for n in 0..400 {
            let t = f64::from(n) / 1000.0;
            bank.step(&mut state, Complex::from_polar((30.0 * t).exp(), TAU * 41.3 * t));
        }
        let k = (0..bank.frequencies_hz().len())
            .min_by(|a, b| {
                (bank.frequencies_hz()[*a] - 41.3).abs().total_cmp(&(bank.frequencies_hz()[*b] - 41.3).abs())
            })
            .unwrap();
        assert!((bank.growth_1_s(&state, k) - 30.0).abs() < 0.1);
    }
}
