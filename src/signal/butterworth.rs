//! Butterworth low-pass and high-pass of any order up to 12, as a cascade of second-order sections.

use super::{FilterError, check_frequency};
use crate::units::SampleRate;
use std::f64::consts::{PI, TAU};

/// Sections of the longest cascade.
pub const MAX_SECTIONS: usize = 6;

/// Largest order that is designed.
pub const MAX_ORDER: usize = 2 * MAX_SECTIONS;

/// One second-order section: y = b0 x + b1 x1 + b2 x2 - a1 y1 - a2 y2.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Section {
    /// Numerator.
    pub b: [f64; 3],
    /// Denominator without its leading one.
    pub a: [f64; 2],
}

impl Section {
    const THROUGH: Section = Section { b: [1.0, 0.0, 0.0], a: [0.0, 0.0] };

    /// One sample; transposed direct form II, two numbers of state.
    #[inline(always)]
    #[must_use]
    pub fn step(&self, state: &mut [f64; 2], x: f64) -> f64 {
        let y = self.b[0] * x + state[0];
        state[0] = self.b[1] * x - self.a[0] * y + state[1];
        state[1] = self.b[2] * x - self.a[1] * y;
        y
    }

    /// State in which a constant input `x` gives a constant output.
    #[must_use]
    pub fn settled(&self, x: f64) -> [f64; 2] {
        let gain = self.b.iter().sum::<f64>() / (1.0 + self.a[0] + self.a[1]);
        let y = gain * x;
        let second = self.b[2] * x - self.a[1] * y;
        [self.b[1] * x - self.a[0] * y + second, second]
    }

    /// Transfer function on the unit circle as (real, imaginary).
    #[must_use]
    pub fn response(&self, frequency_hz: f64, rate: SampleRate) -> (f64, f64) {
        let w = TAU * frequency_hz / rate.hz();
        let z = |k: f64| ((k * w).cos(), -(k * w).sin());
        let sum = |c: [f64; 3]| {
            let (mut re, mut im) = (0.0, 0.0);
            for (k, c) in c.iter().enumerate() {
                let (zr, zi) = z(k as f64);
                re += c * zr;
                im += c * zi;
            }
            (re, im)
        };
        let (nr, ni) = sum(self.b);
        let (dr, di) = sum([1.0, self.a[0], self.a[1]]);
        let size = dr * dr + di * di;
        ((nr * dr + ni * di) / size, (ni * dr - nr * di) / size)
    }
}

/// Which side passes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pass {
    /// Below the cutoff.
    Low,
    /// Above the cutoff.
    High,
}

/// A designed cascade; copy it freely.
///
/// |H|^2 = 1 / (1 + (f/f_c)^2n), half power at the cutoff; bilinear transform, prewarped there.
/// Checked by: half_power_at_the_cutoff, the_slope_is_the_order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Butterworth {
    sections: [Section; MAX_SECTIONS],
    count: usize,
    rate: SampleRate,
}

/// State of a [`Butterworth`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ButterworthState {
    sections: [[f64; 2]; MAX_SECTIONS],
}

crate::keyframe::keep!(ButterworthState { sections });

impl Butterworth {
    /// Low-pass. Errors: order outside 1..=12, cutoff not below half the rate.
    pub fn low_pass(order: usize, cutoff_hz: f64, rate: SampleRate) -> Result<Self, FilterError> {
        Self::new(Pass::Low, order, cutoff_hz, rate)
    }

    /// Low- or high-pass. Errors: order outside 1..=12, cutoff not below half the rate.
    pub fn new(pass: Pass, order: usize, cutoff_hz: f64, rate: SampleRate) -> Result<Self, FilterError> {
        if order == 0 || order > MAX_ORDER {
            return Err(FilterError::Order { order, largest: MAX_ORDER });
        }
        check_frequency("cutoff", cutoff_hz, rate.hz() / 2.0)?;
        let warped = (PI * cutoff_hz / rate.hz()).tan();
        let mut sections = [Section::THROUGH; MAX_SECTIONS];
        let count = order.div_ceil(2);
        for (k, section) in sections.iter_mut().take(order / 2).enumerate() {
            // Pole pair at angle theta from the negative real axis: s^2 + 2 cos(theta) s + 1.
            let theta = PI * (2 * k + 1) as f64 / (2 * order) as f64;
            *section = second_order(pass, warped, 2.0 * theta.sin());
        }
        if order % 2 == 1 {
            sections[count - 1] = first_order(pass, warped);
        }
        Ok(Self { sections, count, rate })
    }

    /// State settled on a constant input.
    #[must_use]
    pub fn settled(&self, mut x: f64) -> ButterworthState {
        let mut state = ButterworthState::default();
        for (section, s) in self.sections.iter().zip(&mut state.sections).take(self.count) {
            *s = section.settled(x);
            x *= section.b.iter().sum::<f64>() / (1.0 + section.a[0] + section.a[1]);
        }
        state
    }

    /// One sample. Cost: 5 multiplies a section, no allocation.
    #[inline(always)]
    #[must_use]
    pub fn step(&self, state: &mut ButterworthState, mut x: f64) -> f64 {
        for k in 0..self.count {
            x = self.sections[k].step(&mut state.sections[k], x);
        }
        x
    }

    /// The sections in use.
    #[must_use]
    pub fn sections(&self) -> &[Section] {
        &self.sections[..self.count]
    }

    /// Response at a frequency, as (real, imaginary).
    #[must_use]
    pub fn response(&self, frequency_hz: f64) -> (f64, f64) {
        self.sections().iter().fold((1.0, 0.0), |(re, im), s| {
            let (r, i) = s.response(frequency_hz, self.rate);
            (re * r - im * i, re * i + im * r)
        })
    }

    /// Delay of slow signals in s: -d phase/d omega at (nearly) zero frequency, by difference.
    #[must_use]
    pub fn slow_delay_s(&self) -> f64 {
        let f = self.rate.hz() * 1e-5;
        let (re, im) = self.response(f);
        -im.atan2(re) / (TAU * f)
    }
}

fn second_order(pass: Pass, w: f64, damping: f64) -> Section {
    let a0 = 1.0 + damping * w + w * w;
    let a = [2.0 * (w * w - 1.0) / a0, (1.0 - damping * w + w * w) / a0];
    let b = match pass {
        Pass::Low => [w * w / a0, 2.0 * w * w / a0, w * w / a0],
        Pass::High => [1.0 / a0, -2.0 / a0, 1.0 / a0],
    };
    Section { b, a }
}

fn first_order(pass: Pass, w: f64) -> Section {
    let a0 = 1.0 + w;
    let b = match pass {
        Pass::Low => [w / a0, w / a0, 0.0],
        Pass::High => [1.0 / a0, -1.0 / a0, 0.0],
    };
    Section { b, a: [(w - 1.0) / a0, 0.0] }
}

/// Both ways through the filter: no phase, squared gain; the ends are extended by reflection.
///
/// For offline reference only: it looks into the future.
#[must_use]
pub fn zero_phase(filter: &Butterworth, x: &[f64]) -> Vec<f64> {
    let n = x.len();
    if n < 2 {
        return x.to_vec();
    }
    let pad = (n - 1).min(600);
    let mut y: Vec<f64> = Vec::with_capacity(n + 2 * pad);
    y.extend((1..=pad).rev().map(|i| 2.0 * x[0] - x[i]));
    y.extend_from_slice(x);
    y.extend((1..=pad).map(|i| 2.0 * x[n - 1] - x[n - 1 - i]));
    for _ in 0..2 {
        let mut state = filter.settled(y[0]);
        for v in &mut y {
            *v = filter.step(&mut state, *v);
        }
        y.reverse();
    }
    y[pad..pad + n].to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gain(filter: &Butterworth, f: f64) -> f64 {
        let (re, im) = filter.response(f);
        re.hypot(im)
    }

    #[test]
    fn half_power_at_the_cutoff() {
        let rate = SampleRate::new(9000.0).unwrap();
        for order in 1..=MAX_ORDER {
            let filter = Butterworth::low_pass(order, 700.0, rate).unwrap();
            assert!((gain(&filter, 700.0) - 0.5f64.sqrt()).abs() < 1e-12, "order {order}");
            assert!((gain(&filter, 1e-3) - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn the_slope_is_the_order() {
        // Bilinear: the analog frequency of f is tan(pi f/fs).
        let rate = SampleRate::new(10_000.0).unwrap();
        let analog = |f: f64| (PI * f / 10_000.0).tan();
        for order in [1, 2, 3, 4, 7] {
            for pass in [Pass::Low, Pass::High] {
                let filter = Butterworth::new(pass, order, 500.0, rate).unwrap();
                for f in [10.0, 400.0, 900.0, 3000.0] {
                    let ratio = match pass {
                        Pass::Low => analog(f) / analog(500.0),
                        Pass::High => analog(500.0) / analog(f),
                    };
                    let expected = 1.0 / (1.0 + ratio.powi(2 * order as i32)).sqrt();
                    assert!((gain(&filter, f) / expected - 1.0).abs() < 1e-9, "{pass:?} {order} {f}");
                }
            }
        }
    }

    #[test]
    fn a_settled_state_stays_settled() {
        let rate = SampleRate::new(10_000.0).unwrap();
        let filter = Butterworth::low_pass(5, 150.0, rate).unwrap();
        let mut state = filter.settled(3.5);
        for _ in 0..1000 {
            assert!((filter.step(&mut state, 3.5) - 3.5).abs() < 1e-9);
        }
    }

    #[test]
    fn a_cutoff_at_half_the_rate_is_refused() {
        let rate = SampleRate::new(1000.0).unwrap();
        assert!(Butterworth::low_pass(2, 500.0, rate).is_err());
        assert!(Butterworth::low_pass(0, 50.0, rate).is_err());
    }
}
