//! The noise floor of a force balance, from the encoders' steps and the recording itself, and what stands
//! above it.

use super::problem::{Column, Problem, Sides};
use rustfft::{FftPlanner, num_complex::Complex};
use std::f64::consts::{PI, TAU};

/// Most and fewest samples of one segment of the averaged spectrum.
const SEGMENT: [usize; 2] = [1024, 64];
/// Length over which a residual is loud or quiet, s.
const QUIET_BLOCK_S: f64 = 0.1;
/// Power above the floor that noise of any smooth shape does not reach.
const EXCESS: f64 = 5.0;

/// Spectrum of one side of the balance.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct SideSpectrum {
    /// Power density, N2/Hz, at `k step_hz`.
    pub(crate) density: Vec<f64>,
    /// Floor in the same units.
    pub(crate) floor: Vec<f64>,
    /// Resolution, Hz.
    pub(crate) step_hz: f64,
}

impl SideSpectrum {
    /// Root mean square of the floor up to `band_hz`.
    pub(crate) fn floor_rms_n(&self, band_hz: f64) -> f64 {
        let last = ((band_hz / self.step_hz) as usize).min(self.floor.len());
        (self.floor[1..last].iter().sum::<f64>() * self.step_hz).sqrt()
    }

    /// Density of the floor at low frequencies, N2/Hz: of a white force.
    pub(crate) fn white_n2_hz(&self) -> f64 {
        self.floor.get(2).copied().unwrap_or(0.0)
    }

    /// Bands in which the residual stands above the floor, with the power that does.
    pub(crate) fn excess(&self, band_hz: f64) -> Vec<([f64; 2], f64)> {
        let mut out: Vec<([f64; 2], f64)> = Vec::new();
        let mut low = 1usize;
        while (low as f64) * self.step_hz < 0.9 * band_hz {
            let high = ((low as f64 * 1.4) as usize).max(low + 1).min(self.density.len());
            let power: f64 = self.density[low..high].iter().sum();
            let floor: f64 = self.floor[low..high].iter().sum();
            if power > EXCESS * floor {
                let band = [low as f64 * self.step_hz, high as f64 * self.step_hz];
                let above = (power - floor) * self.step_hz;
                match out.last_mut() {
                    Some((b, p)) if (b[1] - band[0]).abs() < 1e-9 => {
                        b[1] = band[1];
                        *p += above;
                    }
                    _ => out.push((band, above)),
                }
            }
            low = high;
        }
        out
    }
}

/// Length of a segment: two of them fit into the longest recording.
fn segment(residual: &Column, stage: bool) -> usize {
    let longest = residual.iter().filter_map(|s| pick(s, stage)).map(Vec::len).max().unwrap_or(0);
    let [most, least] = SEGMENT;
    std::iter::successors(Some(most), |n| Some(n / 2))
        .find(|n| 2 * n <= longest || *n <= least)
        .unwrap_or(least)
}

/// Averaged spectrum (Hann, half overlapping) of one side over all recordings.
fn density(residual: &Column, stage: bool, (segment, rate_hz): (usize, f64)) -> Vec<f64> {
    let window: Vec<f64> = (0..segment).map(|k| (PI * k as f64 / segment as f64).sin().powi(2)).collect();
    let gain: f64 = window.iter().map(|w| w * w).sum::<f64>() * rate_hz;
    let fft = FftPlanner::new().plan_fft_forward(segment);
    let mut sum = vec![0.0; segment / 2];
    let mut count = 0.0;
    for sides in residual {
        let Some(x) = pick(sides, stage) else { continue };
        let mut start = 0;
        while start + segment <= x.len() {
            let piece = &x[start..start + segment];
            let mean = piece.iter().sum::<f64>() / segment as f64;
            let mut bins: Vec<Complex<f64>> =
                piece.iter().zip(&window).map(|(v, w)| Complex::new((v - mean) * w, 0.0)).collect();
            fft.process(&mut bins);
            for (s, b) in sum.iter_mut().zip(&bins) {
                *s += 2.0 * b.norm_sqr() / gain;
            }
            count += 1.0;
            start += segment / 2;
        }
    }
    sum.iter().map(|s| s / f64::max(count, 1.0)).collect()
}

fn pick(sides: &Sides, stage: bool) -> Option<&Vec<f64>> {
    if stage { sides.stage.as_ref() } else { sides.motor.as_ref() }
}

/// Spectrum and floor of one side.
///
/// Floor: a white force at the level that most of the band shows, and the encoders' noise as that of steps q
/// through masses and springs, S(f) = q^2/12 / (rate/2) |K - M w^2|^2 (own side) + q^2/12 / (rate/2) K^2
/// (other side), all through the squared low-pass of the band.
pub(crate) fn spectrum(p: &Problem, residual: &Column, stage: bool) -> SideSpectrum {
    let rate_hz = p.rate_hz();
    let full_rate = p.motions.first().map_or(1.0, |m| m.rate_hz);
    let segment = segment(residual, stage);
    let density = density(residual, stage, (segment, rate_hz));
    let step_hz = rate_hz / segment as f64;
    let m = &p.mechanics;
    let [motor_step, stage_step] = p.noise_steps_m();
    let (near, far) = if stage { (stage_step, motor_step) } else { (motor_step, stage_step) };
    let mass = if stage { m.stage_mass_kg } else { m.motor_mass_kg };
    let band = super::motion::band_hz(full_rate);
    let shape = |f: f64| band_gain(f, band).powi(4).max(1e-12);
    let steps = |f: f64| {
        let w2 = (TAU * f).powi(2);
        let per_hz = |q: f64| q * q / 12.0 / (0.5 * full_rate);
        per_hz(near) * (m.stiffness_n_m - mass * w2).powi(2) + per_hz(far) * m.stiffness_n_m.powi(2)
    };
    let inside = |f: f64| f > 0.03 * band && f < 0.8 * band;
    let mut levels: Vec<f64> = density
        .iter()
        .enumerate()
        .map(|(k, d)| (k as f64 * step_hz, d))
        .filter(|(f, _)| inside(*f))
        .map(|(f, d)| (d / shape(f) - steps(f)).max(0.0))
        .collect();
    levels.sort_by(f64::total_cmp);
    let white = levels.get(levels.len() * 2 / 5).copied().unwrap_or(0.0);
    let floor =
        (0..density.len()).map(|k| k as f64 * step_hz).map(|f| (white + steps(f)) * shape(f)).collect();
    SideSpectrum { density, floor, step_hz }
}

/// Mean square of the noise of one side, N2: what most of the spectrum shows, or the quiet half of the time
/// where that is less.
pub(crate) fn noise_n2(p: &Problem, residual: &Column, stage: bool) -> f64 {
    let spectral = spectrum(p, residual, stage).floor_rms_n(f64::MAX).powi(2);
    let block = ((QUIET_BLOCK_S * p.rate_hz()) as usize).max(1);
    let blocks = residual.iter().filter_map(|s| pick(s, stage)).flat_map(|x| x.chunks_exact(block));
    let mut powers: Vec<f64> = blocks.map(|b| b.iter().map(|v| v * v).sum::<f64>() / block as f64).collect();
    powers.sort_by(f64::total_cmp);
    let quiet = &powers[..powers.len().div_ceil(2)];
    spectral.min(quiet.iter().sum::<f64>() / quiet.len().max(1) as f64)
}

/// Gain of one pass of the band's low-pass: a step at the band's edge smoothed by the kernel's Gaussian.
pub(crate) fn band_gain(f: f64, band: f64) -> f64 {
    let sigma = band / (TAU * 0.72);
    let z = (f - band) / (sigma * std::f64::consts::SQRT_2);
    0.5 * statrs::function::erf::erfc(z)
}
