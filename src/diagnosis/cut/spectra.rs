//! Spectra of calm stretches.
//!
//! x = (F1, F2 [, y]) of one bin, without the signal's filter E,
//!
//! S = sum_j g_j g_j^H nu^2 F_j^2 S_u + diag(sensor + folded, .., probe)
//! g_j = (Z_1j, Z_2j, -G (Z_1j - Z_2j))
//!
//! Lines of a calm cut are a few hertz wide, not much more than a bin: what the window smears is in S.

use super::criteria::CRITERIA;
use super::input::CutRecording;
use super::machine::Machine;
use super::observable::{Bin, CHANNELS, Every, LeftOver, Matrix, Observable, Origin, OriginKind, Part, ZERO};
use super::stretches::{Stretch, condition, signal_response, stated_filter};
use crate::plant::cut_effects::CutEffect;
use crate::plant::cut_loop::{CutLoop, ToolMatrix, random_force_spectrum_1_hz};
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::effects::EffectKind;
use crate::plant::scenario::{Scenario, ToolCount};
use crate::signal::butterworth::Butterworth;
use crate::units::SampleRate;
use nalgebra::Complex;
use rustfft::FftPlanner;
use std::f64::consts::TAU;

/// Where a spectrum was taken.
#[derive(Debug, Clone)]
pub(super) struct Place {
    /// Condition in the middle.
    pub(super) condition: CutCondition,
    /// One or two.
    pub(super) tools: ToolCount,
    /// Of the samples.
    pub(super) rate: SampleRate,
    /// Low-pass of the force signal as stated.
    pub(super) filter: Option<Butterworth>,
    /// Forces that are there, in order; the probe is index 2.
    pub(super) used: Vec<usize>,
    /// Recording and time.
    pub(super) origin: Origin,
}

impl Place {
    /// Of a stretch, its condition that of sample `at`.
    pub(super) fn new(recording: &CutRecording, stretch: &Stretch, at: usize, scenario: &Scenario) -> Self {
        let two = scenario.tools.count() == ToolCount::Two;
        let mut used: Vec<usize> =
            (0..2).filter(|j| recording.forces_n[*j].is_some() && (two || *j == 0)).collect();
        if recording.displacement_m.is_some() {
            used.push(2);
        }
        let span_s = [recording.time_s(stretch.samples.start), recording.time_s(stretch.samples.end - 1)];
        Self {
            condition: condition(recording, at, scenario),
            tools: scenario.tools.count(),
            rate: recording.sample_rate,
            filter: stated_filter(recording),
            used,
            origin: Origin { kind: OriginKind::Calm, recording: Some(stretch.recording), span_s },
        }
    }

    /// What the true signal path has over the stated one, at f: 1 unless the signal lags.
    pub(super) fn signal_ratio(&self, lag: Option<&SignalLag>, f: f64) -> Complex<f64> {
        let Some(lag) = lag else { return Complex::new(1.0, 0.0) };
        let late = Complex::from_polar(1.0, -TAU * f * lag.extra_delay_s);
        match (&lag.filter, &self.filter) {
            (Some(truth), stated) => {
                let (re, im) = truth.response(f);
                let stated = stated.as_ref().map_or((1.0, 0.0), |s| s.response(f));
                Complex::new(re, im) / Complex::new(stated.0, stated.1) * late
            }
            (None, _) => late,
        }
    }

    /// The signal's lag that a machine has.
    pub(super) fn lag(&self, machine: &Machine) -> Option<SignalLag> {
        let CutEffect::ForceSensorLag(lag) = machine.scenario.physics.get(EffectKind::ForceSensorLag)? else {
            return None;
        };
        let corner = lag.bandwidth_hz.min(0.45 * self.rate.hz());
        let narrow = lag.bandwidth_hz.is_finite();
        let filter = narrow.then(|| Butterworth::low_pass(4, corner, self.rate).ok()).flatten();
        Some(SignalLag { extra_delay_s: lag.extra_delay_s, filter })
    }

    /// nu F_j and the part of the random force that folds back from above half the rate.
    pub(super) fn random(&self, machine: &Machine, cut: &CutLoop) -> [f64; 2] {
        cut.means().force_n.map(|f| (machine.noise.random_share * f).powi(2))
    }

    /// One tool cuts.
    pub(super) fn one_tool(&self) -> bool {
        self.tools == ToolCount::One
    }

    /// What of the random force folds back from above half the rate, over its variance, 1/Hz.
    pub(super) fn folded_1_hz(&self, f: f64) -> f64 {
        let rate = self.rate.hz();
        // Three foldings: the next would add a hundredth of them.
        (1..=3)
            .map(|k| {
                let k = f64::from(k) * rate;
                random_force_spectrum_1_hz(k - f) + random_force_spectrum_1_hz(k + f)
            })
            .sum()
    }

    /// Only the channels that were recorded, in order.
    pub(super) fn select(&self, frequency_hz: f64, x: [Complex<f64>; CHANNELS], s: &Matrix) -> Bin {
        let mut out =
            Bin { x: [ZERO; CHANNELS], frequency_hz, log_jacobian: 0.0, s: [[ZERO; CHANNELS]; CHANNELS] };
        for (i, from_i) in self.used.iter().enumerate() {
            out.x[i] = x[*from_i];
            for (j, from_j) in self.used.iter().enumerate() {
                out.s[i][j] = s[*from_i][*from_j];
            }
        }
        out
    }
}

/// A signal that is later and narrower than stated.
pub(super) struct SignalLag {
    extra_delay_s: f64,
    filter: Option<Butterworth>,
}

/// Unit of the probe in the spectra: micrometres, so that its numbers are of the size of the forces'.
pub(super) const PROBE_UNIT_M: f64 = 1e-6;

/// Bins of a window of Hann of `n` samples: (index, frequency), orders of the spindle left out where there
/// are lines of them (`speed_rpm`).
pub(super) fn bins(n: usize, rate_hz: f64, speed_rpm: Option<f64>, band_hz: [f64; 2]) -> Vec<(usize, f64)> {
    let step = rate_hz / n as f64;
    let first = (band_hz[0] / step).ceil() as usize;
    let last = (band_hz[1].min(0.45 * rate_hz) / step).floor() as usize;
    (first..=last)
        .step_by(2)
        .map(|k| (k, k as f64 * step))
        .filter(|(_, f)| {
            speed_rpm.is_none_or(|speed| {
                let order = speed / 60.0;
                (f / order - (f / order).round()).abs() * order > CRITERIA.order_bins * step
            })
        })
        .collect()
}

/// Distance in bins, and share of the power that a window of Hann takes from there: W(d)^2 with
/// W = sinc(d)/(1 - d^2).
pub(super) const SMEARED: [(f64, f64); 5] =
    [(-1.0, 0.0839), (-0.5, 0.2418), (0.0, 0.3486), (0.5, 0.2418), (1.0, 0.0839)];

/// Window of Hann with the scale that makes |X|^2 a one-sided spectrum.
pub(super) fn hann(n: usize, rate_hz: f64) -> Vec<f64> {
    // Sum of the squares of the window is 3 n/8.
    let scale = (2.0 / (rate_hz * 0.375 * n as f64)).sqrt();
    (0..n).map(|k| scale * 0.5 * (1.0 - (TAU * k as f64 / n as f64).cos())).collect()
}

/// A series less its straight line of least squares: wear and travel are no vibration.
fn without_line(x: &[f64]) -> Vec<f64> {
    let n = x.len() as f64;
    let mean = x.iter().sum::<f64>() / n;
    let middle = (n - 1.0) / 2.0;
    let moment: f64 = x.iter().enumerate().map(|(k, v)| (k as f64 - middle) * v).sum();
    let slope = moment / (n * (n * n - 1.0) / 12.0).max(1.0);
    x.iter().enumerate().map(|(k, v)| v - mean - slope * (k as f64 - middle)).collect()
}

/// Spectra of one calm stretch.
pub(crate) struct CalmSpectra {
    place: Place,
    bins: Vec<CalmBin>,
    /// Below the band of the fit.
    slow: Vec<CalmBin>,
    /// Band that each bin stands for, Hz.
    bin_hz: f64,
    /// Distance of the transform's own bins, Hz.
    step_hz: f64,
}

/// Frequency and amplitudes of a bin.
type CalmBin = (f64, [Complex<f64>; CHANNELS]);

/// What the bins hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Way {
    /// Forces in the closed loop: the innovations are (I + A R) of them.
    Closed,
    /// The innovations themselves.
    Innovations,
}

/// Mean square of the innovations of a tool over the bins, a hertz each.
pub(super) fn innovation_power(place: &Place, cut: &CutLoop, bins: &[Bin], way: Way) -> LeftOver {
    let tools = if place.one_tool() { 1 } else { 2 };
    let mut sum = LeftOver::default();
    for bin in bins {
        let m = match way {
            Way::Innovations => [[1.0, 0.0], [0.0, 1.0]].map(|r| r.map(|x| Complex::new(x, 0.0))),
            Way::Closed => {
                let mut m = force_per_force(cut, Complex::new(0.0, TAU * bin.frequency_hz));
                m[0][0] += 1.0;
                m[1][1] += 1.0;
                m
            }
        };
        for row in m.iter().take(tools) {
            let seen: Complex<f64> = (0..tools).map(|c| row[c] * bin.x[c]).sum();
            let floor: Complex<f64> = (0..tools)
                .flat_map(|a| (0..tools).map(move |b| (a, b)))
                .map(|(a, b)| row[a] * bin.s[a][b] * row[b].conj())
                .sum();
            sum.recorded_n2 += seen.norm_sqr() / tools as f64;
            sum.floor_n2 += floor.re / tools as f64;
        }
    }
    sum
}

impl CalmSpectra {
    /// The spectra of a stretch. Cost: one transform a channel.
    pub(crate) fn new(recording: &CutRecording, stretch: &Stretch, scenario: &Scenario) -> Self {
        let range = stretch.samples.clone();
        let place = Place::new(recording, stretch, usize::midpoint(range.start, range.end), scenario);
        let (n, rate) = (range.len(), recording.sample_rate.hz());
        let window = hann(n, rate);
        let forward = FftPlanner::new().plan_fft_forward(n);
        let spectrum = |x: Option<&Vec<f64>>, unit: f64| {
            let x = x.map_or_else(|| vec![0.0; n], |x| without_line(&x[range.clone()]));
            let windowed = x.iter().zip(&window).map(|(x, w)| Complex::new(x / unit * w, 0.0));
            let mut y: Vec<Complex<f64>> = windowed.collect();
            forward.process(&mut y);
            y
        };
        let forces = [0, 1].map(|j| spectrum(recording.forces_n[j].as_ref(), 1.0));
        let probe = spectrum(recording.displacement_m.as_ref(), PROBE_UNIT_M);
        let (delay_s, filter) = (recording.signal.delay_s, place.filter);
        let speed_rpm = Some(place.condition.speed_rpm);
        let of_band = |band_hz: [f64; 2]| -> Vec<CalmBin> {
            bins(n, rate, speed_rpm, band_hz)
                .into_iter()
                .map(|(k, f)| {
                    let e = signal_response(filter.as_ref(), delay_s, f);
                    (f, [forces[0][k] / e, forces[1][k] / e, probe[k]])
                })
                .collect()
        };
        let slow = of_band([CRITERIA.slow_hz, CRITERIA.band_hz[0]]);
        let bins = of_band(CRITERIA.band_hz);
        let bin_hz = (CRITERIA.band_hz[1] - CRITERIA.band_hz[0]) / bins.len().max(1) as f64;
        Self { place, bins, slow, bin_hz, step_hz: rate / n as f64 }
    }

    /// Spectra and cross-spectra at a frequency, the signal as stated.
    fn foretold(&self, cut: &CutLoop, machine: &Machine, random: [f64; 2], f: f64) -> Matrix {
        let s = Complex::new(0.0, TAU * f);
        let z = cut.closed(s);
        let g = cut.bar_response(s) / PROBE_UNIT_M;
        let spectrum = random_force_spectrum_1_hz(f);
        let mut matrix = [[ZERO; CHANNELS]; CHANNELS];
        for j in 0..2 {
            let column = [z[0][j], z[1][j], -g * (z[0][j] - z[1][j])];
            for a in 0..CHANNELS {
                for b in 0..CHANNELS {
                    matrix[a][b] += column[a] * column[b].conj() * (random[j] * spectrum);
                }
            }
        }
        let (sensor, folded) = (machine.noise.sensor_n2_hz(f), self.place.folded_1_hz(f));
        for j in 0..2 {
            matrix[j][j] += sensor + random[j] * folded;
        }
        matrix[2][2] += (machine.noise.probe_m / PROBE_UNIT_M).powi(2) * 2.0 / self.place.rate.hz();
        matrix
    }

    fn bins_of(&self, bins: &[CalmBin], machine: &Machine, every: Every) -> Part {
        let cut = CutLoop::new(&CutTerms::of(&machine.scenario, &self.place.condition));
        let random = self.place.random(machine, &cut);
        let lag = self.place.lag(machine);
        let spectrum = |f: f64| self.foretold(&cut, machine, random, f);
        let step = self.step_hz;
        let mut last: Option<(f64, Matrix)> = None;
        let bins = bins.iter().step_by(every.0).map(|(f, x)| {
            // The window smears: what a bin of it holds is 1/6, 2/3 and 1/6 of three bins of the spectrum.
            let below = match &last {
                Some((at, known)) if (at - (f - step)).abs() < 1e-6 => *known,
                _ => spectrum(f - step),
            };
            let (here, above) = (spectrum(*f), spectrum(f + step));
            last = Some((f + step, above));
            let ratio = self.place.signal_ratio(lag.as_ref(), *f);
            let mut matrix = [[ZERO; CHANNELS]; CHANNELS];
            for a in 0..CHANNELS {
                let left = if a < 2 { ratio } else { Complex::new(1.0, 0.0) };
                for b in 0..CHANNELS {
                    let right = if b < 2 { ratio.conj() } else { Complex::new(1.0, 0.0) };
                    let smeared = here[a][b] * 4.0 + below[a][b] + above[a][b];
                    matrix[a][b] = smeared * left * right / 6.0;
                }
            }
            self.place.select(*f, *x, &matrix)
        });
        Part::Bins { channels: self.place.used.len(), bins: bins.collect() }
    }
}

impl Observable for CalmSpectra {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        self.bins_of(&self.bins, machine, every)
    }

    fn slow(&self, machine: &Machine) -> Option<Part> {
        Some(self.bins_of(&self.slow, machine, Every(1)))
    }

    fn left_over(&self, machine: &Machine) -> Option<LeftOver> {
        let cut = CutLoop::new(&CutTerms::of(&machine.scenario, &self.place.condition));
        let whole = self.place.used.starts_with(&[0, 1]) || self.place.one_tool();
        let Part::Bins { bins, .. } = self.part(machine, Every(1)) else { return None };
        whole.then(|| innovation_power(&self.place, &cut, &bins, Way::Closed) * self.bin_hz)
    }

    fn origin(&self) -> Origin {
        self.place.origin
    }
}

/// A R, force per force.
pub(super) fn force_per_force(cut: &CutLoop, s: Complex<f64>) -> ToolMatrix {
    let (a, r) = (cut.force_law(s), cut.receptance(s));
    [0, 1].map(|i| [0, 1].map(|j| a[i][0] * r[0][j] + a[i][1] * r[1][j]))
}

#[cfg(test)]
mod tests {
    use super::super::machine::Noise;
    use super::super::synthetic::{RATE_HZ, machine, recording};
    use super::*;

    /// The spectrum of a calm cut is that of its random force through the closed loop: white noise of known
    /// size in, whitened power one out, whatever the seed.
    #[test]
    fn the_window_of_hann_keeps_the_power_of_white_noise() {
        let machine = Machine { noise: Noise { sensor: 1.0, ..machine().noise }, ..machine() };
        let mut random = 7u64;
        let mut uniform = move || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        // Sensor noise of 1e-3 N^2/Hz alone: variance 1e-3 times half the rate, uniform of width sqrt(12).
        let size = (12.0 * 1e-3 * RATE_HZ / 2.0).sqrt();
        let cuts = recording(&machine.scenario, 2.0, |_| [50.0 + size * uniform(), 50.0 + size * uniform()]);
        let stretch = Stretch { recording: 0, samples: 0..18000 };
        let calm = CalmSpectra::new(&cuts, &stretch, &machine.scenario);
        let Part::Bins { bins, channels } = calm.part(&machine, Every(1)) else { panic!("bins") };
        let power: f64 = bins.iter().map(|b| b.x[0].norm_sqr() / b.s[0][0].re).sum::<f64>();
        assert_eq!(channels, 2);
        let n = bins.len() as f64;
        assert!((power / n - 1.0).abs() < 4.0 / n.sqrt(), "{} of {n} bins", power / n);
    }
}
