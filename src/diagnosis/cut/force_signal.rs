//! Force signals as recorded: the response of the sensor's low-pass and delay, a series through a frequency
//! response, a series without its trend.

use super::input::CutRecording;
use crate::signal::butterworth::Butterworth;
use nalgebra::Complex;
use rustfft::FftPlanner;
use std::f64::consts::TAU;

/// E(f): the force signal over the force, as stated.
pub(crate) fn signal_response(filter: Option<&Butterworth>, delay_s: f64, frequency_hz: f64) -> Complex<f64> {
    let late = Complex::from_polar(1.0, -TAU * frequency_hz * delay_s);
    filter.map_or(late, |f| {
        let (re, im) = f.response(frequency_hz);
        Complex::new(re, im) * late
    })
}

/// The low-pass of a recording's force signal, as stated.
pub(crate) fn stated_filter(recording: &CutRecording) -> Option<Butterworth> {
    let corner = recording.signal.bandwidth_hz?;
    Butterworth::low_pass(4, corner, recording.sample_rate).ok()
}

/// A series through a frequency response, its ends led on.
pub(crate) fn filtered(x: &[f64], rate_hz: f64, gain: &dyn Fn(f64) -> Complex<f64>) -> Vec<f64> {
    let n = x.len();
    if n == 0 {
        return Vec::new();
    }
    let mut planner = FftPlanner::new();
    // The ends are led on, so that what is late does not come from the other end.
    let length = (n + n / 8 + 512).next_power_of_two();
    let at = |k: usize| {
        if k < n {
            x[k]
        } else if k < (n + length) / 2 {
            x[n - 1]
        } else {
            x[0]
        }
    };
    let mut y: Vec<Complex<f64>> = (0..length).map(|k| Complex::new(at(k), 0.0)).collect();
    planner.plan_fft_forward(length).process(&mut y);
    for k in 0..=length / 2 {
        let g = gain(k as f64 * rate_hz / length as f64) / length as f64;
        y[k] *= g;
        if k > 0 && k < length - k {
            y[length - k] *= g.conj();
        }
    }
    planner.plan_fft_inverse(length).process(&mut y);
    y[..n].iter().map(|v| v.re).collect()
}

/// A series less its straight line of least squares: wear and travel are no vibration.
pub(crate) fn without_line(x: &[f64]) -> Vec<f64> {
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    let middle = (n - 1.0) / 2.0;
    let moment: f64 = x.iter().enumerate().map(|(k, v)| (k as f64 - middle) * v).sum();
    let slope = moment / (n * (n * n - 1.0) / 12.0).max(1.0);
    x.iter().enumerate().map(|(k, v)| v - mean - slope * (k as f64 - middle)).collect()
}
