//! The frequency of a line, finer than the bins of a spectrum.

use super::signals::Signals;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// A series about a frequency: sums of short stretches, over which every fine frequency is quick.
pub(super) struct Demodulated {
    pub(super) sums: Vec<Complex<f64>>,
    /// Begin of the first, length of each, of all, s.
    pub(super) first_s: f64,
    pub(super) each_s: f64,
    total_s: f64,
}

impl Demodulated {
    pub(super) fn new(s: &Signals, x: &[f64], (hz, recording): (f64, usize)) -> Self {
        let rate_hz = s.thin_rate_hz();
        let first_s = s.tracks[recording].thin_s(0, s.step);
        let length = ((0.1_f64.max(3.0 / hz) * rate_hz) as usize).clamp(4, (x.len() / 4).max(4));
        let turned =
            |(k, v): (usize, &f64)| Complex::from_polar(*v, -TAU * hz * (first_s + k as f64 / rate_hz));
        let all: Vec<Complex<f64>> = x.iter().enumerate().map(turned).collect();
        Self {
            sums: all.chunks(length).map(|c| c.iter().sum()).collect(),
            first_s,
            each_s: length as f64 / rate_hz,
            total_s: x.len() as f64 / rate_hz,
        }
    }

    fn power_at(&self, off_hz: f64) -> f64 {
        let middle = |c: usize| self.first_s + (c as f64 + 0.5) * self.each_s;
        let turned = |(c, v): (usize, &Complex<f64>)| v * Complex::from_polar(1.0, -TAU * off_hz * middle(c));
        self.sums.iter().enumerate().map(turned).sum::<Complex<f64>>().norm_sqr()
    }
}

/// By how much the strongest line of all of these is off, within a reach, Hz.
pub(super) fn strongest_off(all: &[Demodulated], reach_hz: f64) -> f64 {
    let longest_s = all.iter().map(|d| d.total_s).fold(1e-9, f64::max);
    let fine_hz = 0.2 / longest_s;
    let steps = (reach_hz / fine_hz) as i32;
    let power = |off_hz: f64| all.iter().map(|d| d.power_at(off_hz)).sum::<f64>();
    (-steps..=steps)
        .map(|k| f64::from(k) * fine_hz)
        .map(|off_hz| (off_hz, power(off_hz)))
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map_or(0.0, |best| best.0)
}
