//! Spectra of the steady stretches of a sweep.

use super::sweep_recording::{Sweep, SweepError};
use crate::units::SampleRate;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex64;
use std::f64::consts::PI;
use std::ops::Range;

pub(super) const LOW_HZ: f64 = 8.0;
pub(super) const LEAST_STRETCH_S: f64 = 0.5;
pub(super) const EDGE_S: f64 = 0.05;

/// Spectra of one recording over all its stretches; accelerations by central second difference.
pub(super) struct Lines {
    pub(super) frequency_hz: Vec<f64>,
    pub(super) thrust: Vec<Complex64>,
    pub(super) outputs: [Vec<Complex64>; 2],
    pub(super) rate: SampleRate,
}

/// Stretches where the slow velocity keeps to nine tenths or more of its largest size (or the whole
/// recording, when the axis stands still), without their ends.
pub(super) fn steady_stretches(sweep: &Sweep) -> Vec<Range<usize>> {
    let position =
        if sweep.stage_position_m.is_empty() { &sweep.motor_travel_m } else { &sweep.stage_position_m };
    let n = position.len();
    // Mean velocity over a fifth of a second: the sweep's own motion averages out.
    let half = (0.1 * sweep.rate.hz()) as usize;
    if n < 4 * half + 2 {
        return Vec::new();
    }
    let slow = |i: usize| {
        let (a, b) = (i.saturating_sub(half), (i + half).min(n - 1));
        (position[b] - position[a]) / ((b - a) as f64 / sweep.rate.hz())
    };
    let mut speeds: Vec<f64> = (0..n).step_by(half.max(1)).map(|i| slow(i).abs()).collect();
    speeds.sort_by(f64::total_cmp);
    let typical = speeds[speeds.len() / 2];
    let travel = position.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
    let moves = typical * n as f64 / sweep.rate.hz() > 0.3 * (travel.1 - travel.0);
    let edge = (EDGE_S * sweep.rate.hz()) as usize;
    let least = (LEAST_STRETCH_S * sweep.rate.hz()) as usize;
    if !moves {
        return if n > least + 2 * edge { vec![edge..n - edge] } else { Vec::new() };
    }
    let mut stretches = Vec::new();
    let mut start = None;
    for i in 0..=n {
        let steady = i < n && slow(i).abs() > 0.6 * typical && slow(i).abs() < 1.6 * typical;
        match (steady, start) {
            (true, None) => start = Some(i),
            (false, Some(from)) => {
                let range = from + half + edge..i.saturating_sub(half);
                if range.end > range.start + least {
                    stretches.push(range);
                }
                start = None;
            }
            _ => {}
        }
    }
    stretches
}

impl Lines {
    pub(super) fn new(sweep: &Sweep, stretches: &[Range<usize>]) -> Result<Self, SweepError> {
        let rate = sweep.rate;
        let mut lines =
            Lines { frequency_hz: Vec::new(), thrust: Vec::new(), outputs: Default::default(), rate };
        let high_hz = 0.15 * rate.hz();
        for range in stretches {
            let thrust = spectrum(&sweep.thrust_ref_n[range.clone()], Kind::Value, rate);
            let motor =
                spectrum(sweep.motor_travel_m.get(range.clone()).unwrap_or(&[]), Kind::Acceleration, rate);
            let stage =
                spectrum(sweep.stage_position_m.get(range.clone()).unwrap_or(&[]), Kind::Acceleration, rate);
            let bin_hz = rate.hz() / range.len() as f64;
            let from = (LOW_HZ / bin_hz).ceil() as usize;
            let to = (high_hz / bin_hz).floor() as usize;
            // Too low a rate has nothing between the lowest line and the end of the band.
            if from >= to || to > thrust.len() {
                continue;
            }
            let largest = thrust[from..to].iter().map(|x| x.norm()).fold(0.0, f64::max);
            for k in from..to {
                // Lines that the sweep does not reach carry no information and could be pure feedback.
                if thrust[k].norm() < 0.02 * largest {
                    continue;
                }
                lines.frequency_hz.push(k as f64 * bin_hz);
                lines.thrust.push(thrust[k]);
                let zero = Complex64::new(0.0, 0.0);
                lines.outputs[0].push(motor.get(k).copied().unwrap_or(zero));
                lines.outputs[1].push(stage.get(k).copied().unwrap_or(zero));
            }
        }
        let bins = lines.frequency_hz.len();
        if bins < 200 {
            return Err(SweepError::NotExcited { bins, low_hz: LOW_HZ, high_hz });
        }
        lines.sort();
        Ok(lines)
    }

    fn sort(&mut self) {
        let mut order: Vec<usize> = (0..self.frequency_hz.len()).collect();
        order.sort_by(|a, b| self.frequency_hz[*a].total_cmp(&self.frequency_hz[*b]));
        let pick = |v: &[Complex64]| order.iter().map(|i| v[*i]).collect::<Vec<_>>();
        self.thrust = pick(&self.thrust);
        self.outputs = [pick(&self.outputs[0]), pick(&self.outputs[1])];
        self.frequency_hz = order.iter().map(|i| self.frequency_hz[*i]).collect();
    }

    pub(super) fn highest_hz(&self) -> f64 {
        self.frequency_hz.last().copied().unwrap_or(0.0)
    }
}

enum Kind {
    Value,
    Acceleration,
}

/// Spectrum of one stretch: mean off, cosine edges of 50 ms.
fn spectrum(x: &[f64], kind: Kind, rate: SampleRate) -> Vec<Complex64> {
    let n = x.len();
    if n < 4 {
        return Vec::new();
    }
    let mean = x.iter().sum::<f64>() / n as f64;
    let edge = ((EDGE_S * rate.hz()) as usize).clamp(1, n / 4);
    let mut buffer: Vec<Complex64> = (0..n)
        .map(|i| {
            let value = match kind {
                Kind::Value => x[i] - mean,
                Kind::Acceleration if i == 0 || i + 1 == n => 0.0,
                Kind::Acceleration => (x[i - 1] - 2.0 * x[i] + x[i + 1]) * rate.hz() * rate.hz(),
            };
            let from_end = i.min(n - 1 - i);
            let window =
                if from_end < edge { 0.5 - 0.5 * (PI * from_end as f64 / edge as f64).cos() } else { 1.0 };
            Complex64::new(value * window, 0.0)
        })
        .collect();
    FftPlanner::new().plan_fft_forward(n).process(&mut buffer);
    buffer.truncate(n / 2 + 1);
    buffer
}
