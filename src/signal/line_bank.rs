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
    /// Real and imaginary parts of the poles, for the loop over all of them; zeros fill the last chunk.
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
        let chunks = poles.len().next_multiple_of(CHUNK);
        let padded = |part: fn(&Complex<f64>) -> f64| {
            poles.iter().map(part).chain(std::iter::repeat(0.0)).take(chunks).collect()
        };
        let parts = [padded(|p| p.re), padded(|p| p.im)];
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

    /// The filter nearest to a frequency relative to the band's centre.
    #[must_use]
    pub fn nearest(&self, frequency_hz: f64) -> usize {
        let last = self.frequencies_hz.len().saturating_sub(1);
        let (low_hz, high_hz) = (self.frequencies_hz[0], self.frequencies_hz[last]);
        let place = (frequency_hz - low_hz) / (high_hz - low_hz).max(f64::MIN_POSITIVE) * last as f64;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "clamped to the bank")]
        let nearest = place.round().clamp(0.0, last as f64) as usize;
        nearest
    }

    /// Nothing heard yet.
    #[must_use]
    pub fn start(&self) -> LineBankState {
        let zeros = || [(); 2].map(|()| vec![0.0; self.parts[0].len()]);
        LineBankState { first: zeros(), second: zeros() }
    }

    /// Forgets what was heard.
    pub fn clear(&self, state: &mut LineBankState) {
        state.first.iter_mut().chain(&mut state.second).for_each(|part| part.fill(0.0));
    }

    /// Takes samples of the band, oldest first. Cost: two complex multiplications a filter and sample; the
    /// filters are fetched and put back once.
    #[inline]
    pub fn step(&self, state: &mut LineBankState, values: &[Complex<f64>]) {
        run(self.fast, Turn { parts: &self.parts, state, values, gain: self.gain });
    }

    /// Powers of all filters. Checked by: `a_line_comes_out_with_its_power_and_frequency`.
    pub fn powers(&self, state: &LineBankState, to: &mut [f64]) {
        run(self.fast, Powers { state, to });
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

    /// What a line of this power on filter `line` that grows at `growth_1_s` puts on the others:
    ///
    /// 1/(1 + (dw tau/(1 + g tau))^2)^2
    ///
    /// Checked by: `leak_of_a_growing_line`.
    #[must_use]
    pub fn leak(&self, line: usize, growth_1_s: f64, power: f64) -> Leak {
        let slowed = (1.0 + growth_1_s * self.tau_s).max(0.5);
        let apart_hz = match self.frequencies_hz[..] {
            [first, second, ..] => second - first,
            _ => 0.0,
        };
        Leak { power, line: line as f64, per_filter: TAU * apart_hz * self.tau_s / slowed }
    }

    /// Sum of the powers of all filters over that of what they hear, line or noise: the integral of
    /// 1/(1 + (w tau)^2)^2 over their distance. Checked by: `the_filters_together_hear_the_power_once`.
    #[must_use]
    pub fn overlap(&self) -> f64 {
        std::f64::consts::FRAC_PI_2 / self.leak(0, 0.0, 1.0).per_filter.max(f64::MIN_POSITIVE)
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

/// What a line puts on the filters beside its own.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leak {
    /// Power of the line.
    pub power: f64,
    /// Its filter.
    pub line: f64,
    /// dw tau/(1 + g tau) from one filter to the next.
    pub per_filter: f64,
}

impl Leak {
    /// No line.
    pub const NONE: Self = Self { power: 0.0, line: 0.0, per_filter: 0.0 };

    /// By how much it is down at a filter: power over what it puts there.
    #[inline(always)]
    #[must_use]
    pub fn below(&self, filter: f64) -> f64 {
        let apart = (filter - self.line) * self.per_filter;
        let root = 1.0 + apart * apart;
        root * root
    }
}

/// |b|^2 of all filters.
struct Powers<'a> {
    state: &'a LineBankState,
    to: &'a mut [f64],
}

impl Kernel for Powers<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let [re, im] = &self.state.second;
        for (power, (re, im)) in self.to.iter_mut().zip(re.iter().zip(im)) {
            *power = re * re + im * im;
        }
    }
}

/// Filters that are turned together, in registers.
const CHUNK: usize = 8;

/// Steps of all filters: a = a p + x, b = b p + a.
struct Turn<'a> {
    parts: &'a [Vec<f64>; 2],
    state: &'a mut LineBankState,
    values: &'a [Complex<f64>],
    gain: f64,
}

impl Kernel for Turn<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let [pr, pi] = self.parts.each_ref().map(|part| part.as_chunks::<CHUNK>().0);
        let [ar, ai] = self.state.first.each_mut().map(|part| part.as_chunks_mut::<CHUNK>().0);
        let [br, bi] = self.state.second.each_mut().map(|part| part.as_chunks_mut::<CHUNK>().0);
        let chunks = pr.iter().zip(pi).zip(ar.iter_mut().zip(ai)).zip(br.iter_mut().zip(bi));
        for (((pr, pi), (a_re, a_im)), (b_re, b_im)) in chunks {
            let (mut ar, mut ai, mut br, mut bi) = (*a_re, *a_im, *b_re, *b_im);
            for value in self.values {
                let (xr, xi) = (value.re * self.gain, value.im * self.gain);
                for k in 0..CHUNK {
                    let (re, im) = (ar[k], ai[k]);
                    ar[k] = multiply_add::<FUSED>(re, pr[k], multiply_add::<FUSED>(-im, pi[k], xr));
                    ai[k] = multiply_add::<FUSED>(re, pi[k], multiply_add::<FUSED>(im, pr[k], xi));
                    let (re, im) = (br[k], bi[k]);
                    br[k] = multiply_add::<FUSED>(re, pr[k], multiply_add::<FUSED>(-im, pi[k], ar[k]));
                    bi[k] = multiply_add::<FUSED>(re, pi[k], multiply_add::<FUSED>(im, pr[k], ai[k]));
                }
            }
            (*a_re, *a_im, *b_re, *b_im) = (ar, ai, br, bi);
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
            bank.step(&mut state, &[Complex::from_polar(3.0, TAU * 41.3 * f64::from(n) / 1000.0)]);
        }
        let mut powers = vec![0.0; bank.frequencies_hz().len()];
        bank.powers(&state, &mut powers);
        let best = (0..powers.len()).max_by(|a, b| powers[*a].total_cmp(&powers[*b])).unwrap();
        assert!(powers[best] > 6.8 && powers[best] < 9.1);
        assert!((bank.refined_hz(&state, best) - 41.3).abs() < 1e-6);
        assert!(bank.growth_1_s(&state, best).abs() < 1e-6);
    }

    #[test]
    fn the_filters_together_hear_the_power_once() {
        let bank = LineBank::new(1000.0, 150.0, 0.025);
        for line_hz in [0.0, 41.3, -77.7] {
            let mut state = bank.start();
            for n in 0..1000 {
                bank.step(&mut state, &[Complex::from_polar(3.0, TAU * line_hz * f64::from(n) / 1000.0)]);
            }
            let sum: f64 = (0..bank.frequencies_hz().len()).map(|k| bank.power(&state, k)).sum();
            assert!((sum / bank.overlap() / 9.0 - 1.0).abs() < 0.05, "{line_hz}: {sum}");
        }
    }

    #[test]
    fn leak_of_a_growing_line() {
        let bank = LineBank::new(1000.0, 150.0, 0.025);
        for growth in [0.0, 40.0] {
            let (mut state, line) = (bank.start(), 20);
            for n in 0..600 {
                let t = f64::from(n) / 1000.0;
                let value = Complex::from_polar((growth * t).exp(), TAU * bank.frequencies_hz()[line] * t);
                bank.step(&mut state, &[value]);
            }
            for k in [12, 18, 23, 30] {
                let below = bank.power(&state, line) / bank.power(&state, k);
                let expected = bank.leak(line, growth, 1.0).below(k as f64);
                assert!((below / expected - 1.0).abs() < 0.1, "{growth} {k} {below}");
            }
        }
    }

    #[test]
    fn growth_of_a_growing_line() {
        let bank = LineBank::new(1000.0, 150.0, 0.025);
        let mut state = bank.start();
        let value = |n: u32| {
            let t = f64::from(n) / 1000.0;
            Complex::from_polar((30.0 * t).exp(), TAU * 41.3 * t)
        };
        // Four at a time are the same as one by one.
        for n in 0..100 {
            bank.step(&mut state, &[4 * n, 4 * n + 1, 4 * n + 2, 4 * n + 3].map(value));
        }
        let mut alone = bank.start();
        (0..400).for_each(|n| bank.step(&mut alone, &[value(n)]));
        assert_eq!(state, alone);
        let k = (0..bank.frequencies_hz().len())
            .min_by(|a, b| {
                (bank.frequencies_hz()[*a] - 41.3).abs().total_cmp(&(bank.frequencies_hz()[*b] - 41.3).abs())
            })
            .unwrap();
        assert!((bank.growth_1_s(&state, k) - 30.0).abs() < 0.1);
    }
}
