//! Spectra of calm stretches.
//!
//! x = (F1, F2 [, y]) of one bin, without the signal's filter E,
//!
//! S = sum_j g_j g_j^H nu^2 F_j^2 S_u + diag(sensor + folded + behind/|E|^2, .., probe)
//! g_j = (Z_1j, Z_2j, -G (Z_1j - Z_2j))
//!
//! Two sine tapers, every third bin: values that are as good as independent and hold two thirds of the
//! information of all samples (one window of Hann, every second bin: 0.47). Lines of a calm cut are a few
//! hertz wide, not much more than a bin: what the tapers smear is in S, on half bins where it is narrow.
//!
//! The tools travel, and the line with them, by some hertz a second: a spectrum is one of a piece in which
//! the line moves by no more than a bin ([`pieces`]). Of a longer one the line is broader than its damping,
//! and its bins hang together.

use super::criteria::CRITERIA;
use super::force_signal::{signal_response, stated_filter, without_line};
use super::input::CutRecording;
use super::known::Reference;
use super::machine::Machine;
use super::matrix::{CHANNELS, Matrix, ZERO};
use super::observable::{Bin, Every, LeftOver, Observable, Origin, OriginKind, Part};
use super::rows::turned_angle;
use super::source::Sources;
use super::stretches::{Stretch, band_hz, condition};
use crate::plant::cut_effects::CutEffect;
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::effects::EffectKind;
use crate::plant::scenario::ToolCount;
use crate::signal::butterworth::Butterworth;
use crate::stability::{cut_root_near, rightmost_cut_root};
use crate::units::SampleRate;
use nalgebra::Complex;
use rustfft::FftPlanner;
use std::f64::consts::{PI, TAU};

/// Where a spectrum was taken.
#[derive(Debug, Clone)]
pub(super) struct Place {
    /// Condition in the middle.
    pub(super) condition: CutCondition,
    /// Of the samples.
    pub(super) rate: SampleRate,
    /// Low-pass of the force signal as stated, and its corner.
    pub(super) filter: Option<Butterworth>,
    bandwidth_hz: Option<f64>,
    /// Noise of this recording's sensor over that of the machine.
    sensor_level: f64,
    /// Forces that are there, in order; the probe is index 2.
    pub(super) used: Vec<usize>,
    /// Band in which it is looked at, Hz.
    pub(super) band_hz: [f64; 2],
    /// Recording and time.
    pub(super) origin: Origin,
}

impl Place {
    /// Of a stretch, its condition that of sample `at`.
    pub(super) fn new(recording: &CutRecording, stretch: &Stretch, at: usize, known: &Reference) -> Self {
        let scenario = &known.machine.scenario;
        let two = scenario.tools.count() == ToolCount::Two;
        let mut used: Vec<usize> =
            (0..2).filter(|j| recording.forces_n[*j].is_some() && (two || *j == 0)).collect();
        if recording.displacement_m.is_some() {
            used.push(2);
        }
        let span_s = [recording.time_s(stretch.samples.start), recording.time_s(stretch.samples.end - 1)];
        Self {
            condition: condition(recording, at, scenario),
            rate: recording.sample_rate,
            filter: stated_filter(recording),
            bandwidth_hz: recording.signal.bandwidth_hz,
            sensor_level: known.sensor_levels.get(stretch.recording).copied().unwrap_or(1.0),
            used,
            band_hz: band_hz(recording, scenario),
            origin: Origin { kind: OriginKind::Calm, recording: Some(stretch.recording), span_s },
        }
    }

    /// What forces elsewhere make of the forces here; `undone`: of those undone by the cut. `None`: one tool.
    pub(super) fn sources(&self, machine: &Machine, frequency_hz: f64, undone: bool) -> Option<Sources> {
        let cut = CutLoop::new(&machine.terms(&self.condition));
        let s = Complex::new(0.0, TAU * frequency_hz);
        (self.forces() == 2).then(|| Sources::of(&cut, s, undone))
    }

    /// What the true signal path has over the stated one, at f: 1 unless the signal lags.
    /// `stated`: of the low-pass as stated.
    pub(super) fn signal_ratio(lag: &SignalLag, f: f64, stated: Complex<f64>) -> Complex<f64> {
        let late = Complex::from_polar(1.0, -TAU * f * lag.extra_delay_s);
        lag.filter.map_or(late, |truth| {
            let (re, im) = truth.response(f);
            Complex::new(re, im) / stated * late
        })
    }

    /// The signal's lag that a machine has.
    pub(super) fn lag(&self, machine: &Machine) -> Option<SignalLag> {
        let noise = &machine.noise;
        let lag = match machine.scenario.physics.get(EffectKind::ForceSensorLag) {
            Some(CutEffect::ForceSensorLag(lag)) => Some(lag),
            _ => None,
        };
        let known = noise.signal_late_s.abs() <= 0.0 && (noise.bandwidth_factor - 1.0).abs() <= 0.0;
        if lag.is_none() && known {
            return None;
        }
        let least_hz = lag.map_or(f64::INFINITY, |l| l.bandwidth_hz);
        let bandwidth_hz = least_hz.min(self.bandwidth_hz.unwrap_or(f64::INFINITY)) * noise.bandwidth_factor;
        let corner = bandwidth_hz.min(0.45 * self.rate.hz());
        let filter =
            bandwidth_hz.is_finite().then(|| Butterworth::low_pass(4, corner, self.rate).ok()).flatten();
        Some(SignalLag { extra_delay_s: lag.map_or(0.0, |l| l.extra_delay_s) + noise.signal_late_s, filter })
    }

    /// nu F_j and the part of the random force that folds back from above half the rate.
    pub(super) fn random(&self, machine: &Machine, cut: &CutLoop) -> [f64; 2] {
        cut.means().force_n.map(|f| (machine.noise.random_share * f).powi(2))
    }

    /// Noise of both forces, as the signal's `path` undone shows it, what of their random part folds back
    /// with it, and that of the probe; one-sided.
    pub(super) fn noise(
        &self,
        machine: &Machine,
        random: [f64; 2],
        (f, path): (f64, Complex<f64>),
    ) -> [f64; CHANNELS] {
        let noise = &machine.noise;
        let undone = noise.before_filter_n2_hz(f) + noise.behind_filter_n2_hz() / path.norm_sqr();
        let sensor = undone * self.sensor_level.powi(2);
        let folded = self.folded_1_hz(machine, f);
        let probe = (noise.probe_m / PROBE_UNIT_M).powi(2) * 2.0 / self.rate.hz();
        [sensor + random[0] * folded, sensor + random[1] * folded, probe]
    }

    /// Force signals in use.
    pub(super) fn forces(&self) -> usize {
        self.used.iter().filter(|j| **j < 2).count()
    }

    /// What of the random force folds back from above half the rate, over its variance, 1/Hz.
    fn folded_1_hz(&self, machine: &Machine, f: f64) -> f64 {
        let rate = self.rate.hz();
        // Three foldings: the next would add a hundredth of them.
        (1..=3)
            .map(|k| {
                let k = f64::from(k) * rate;
                machine.random_1_hz(k - f) + machine.random_1_hz(k + f)
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
#[derive(Clone, Copy, PartialEq)]
pub(super) struct SignalLag {
    extra_delay_s: f64,
    filter: Option<Butterworth>,
}

/// Unit of the probe in the spectra: micrometres, so that its numbers are of the size of the forces'.
pub(super) const PROBE_UNIT_M: f64 = 1e-6;

/// Tapers that are used beside each other.
pub(super) const TAPERS: usize = 2;
/// Of these bins every one: the values of both tapers are then uncorrelated to two in a thousand.
const SPACING: usize = 3;

/// Share of all bins that values of [`TAPERS`] at a [`SPACING`] are.
pub(super) const SHARE_OF_BINS: f64 = TAPERS as f64 / SPACING as f64;

/// What each taper takes from frequencies that lie so many bins off: the square of its transform,
/// sinc(d - k/2) and sinc(d + k/2) joined; together one.
pub(super) fn taken<const N: usize>(bins_off: [f64; N]) -> [[f64; N]; TAPERS] {
    let sinc = |x: f64| if x.abs() > 0.0 { (PI * x).sin() / (PI * x) } else { 1.0 };
    [1.0, -1.0].map(|parity: f64| {
        let half = if parity > 0.0 { 0.5 } else { 1.0 };
        let power = bins_off.map(|d| (sinc(d - half) + parity * sinc(d + half)).powi(2));
        let sum: f64 = power.iter().sum();
        power.map(|p| p / sum)
    })
}

/// Bins of `n` samples in a band: (index, frequency), those next to orders of the spindle left out where
/// lines of them were taken away (`speed_rpm`).
pub(super) fn bins(n: usize, rate_hz: f64, speed_rpm: Option<f64>, band_hz: [f64; 2]) -> Vec<(usize, f64)> {
    let step = rate_hz / n as f64;
    let first = ((band_hz[0] / step).ceil() as usize).max(2);
    let last = (band_hz[1].min(0.45 * rate_hz) / step).floor() as usize;
    (first..=last)
        .step_by(SPACING)
        .map(|k| (k, k as f64 * step))
        .filter(|(_, f)| {
            speed_rpm.is_none_or(|speed| {
                let order = speed / 60.0;
                (f / order - (f / order).round()).abs() * order > CRITERIA.order_bins * step
            })
        })
        .collect()
}

/// Sine taper number `k` (from 0; Riedel and Sidorenko 1995) of `n` samples, with the scale that makes |X|^2
/// a one-sided spectrum.
pub(super) fn taper(k: usize, n: usize, rate_hz: f64) -> Vec<f64> {
    let (length, k) = (n as f64 + 1.0, k as f64 + 1.0);
    let scale = (2.0 / length).sqrt() * (2.0 / rate_hz).sqrt();
    (1..=n).map(|i| scale * (PI * k * i as f64 / length).sin()).collect()
}

/// A series less the lines of the spindle's orders up to a frequency; `turned`: angle of each sample, rad.
///
/// Each by itself through a window of Hann: orders stand many bins apart.
pub(super) fn without_orders(x: &mut [f64], turned: &[f64], turn_hz: f64, highest_hz: f64) {
    let n = x.len();
    let window: Vec<f64> = (0..n).map(|k| 1.0 - (TAU * (k as f64 + 0.5) / n as f64).cos()).collect();
    let turn: Vec<Complex<f64>> = turned.iter().map(|a| Complex::from_polar(1.0, *a)).collect();
    let mut power = vec![Complex::new(1.0, 0.0); n];
    let last = (highest_hz / turn_hz) as usize;
    for _ in 1..=last {
        power.iter_mut().zip(&turn).for_each(|(p, t)| *p *= t);
        let sum: Complex<f64> = (0..n).map(|k| power[k].conj() * (x[k] * window[k])).sum();
        let line = sum * (2.0 / n as f64);
        x.iter_mut().zip(&power).for_each(|(x, p)| *x -= (line * p).re);
    }
}

/// Half bins on which what changes within a bin is foretold.
const HALF_BINS: [f64; 7] = [-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5];

/// The pieces of a calm stretch in which the line of a machine moves by a bin at most.
///
/// A piece of T has bins of 1/T; at r hertz a second it is 1/sqrt(r) long, but no shorter than a stretch
/// that is followed.
pub(crate) fn pieces(recording: &CutRecording, stretch: &Stretch, reference: &Machine) -> Vec<Stretch> {
    let range = stretch.samples.clone();
    let cut = |at: usize| CutLoop::new(&reference.terms(&condition(recording, at, &reference.scenario)));
    let seconds = range.len() as f64 / recording.sample_rate.hz();
    let first = rightmost_cut_root(&cut(range.start));
    let last = cut_root_near(&cut(range.end - 1), first).unwrap_or(first);
    let hz_per_s = (last.frequency_hz - first.frequency_hz).abs() / seconds;
    let most = (seconds / CRITERIA.shortest_followed_s).floor().max(1.0);
    let count = (seconds * hz_per_s.sqrt()).ceil().clamp(1.0, most) as usize;
    let edge = |k: usize| range.start + range.len() * k / count;
    (0..count).map(|k| Stretch { recording: stretch.recording, samples: edge(k)..edge(k + 1) }).collect()
}

/// Spectra of a piece of a calm stretch.
pub(crate) struct CalmSpectra {
    place: Place,
    bins: Vec<CalmBin>,
    /// Below the band of the fit.
    slow: Vec<CalmBin>,
    /// Distance of the transform's own bins, Hz.
    step_hz: f64,
    taken: Taken,
}

/// Weights of half bins in each taper.
type Taken = [[f64; HALF_BINS.len()]; TAPERS];

/// One bin.
struct CalmBin {
    frequency_hz: f64,
    /// The signal's low-pass as stated.
    stated: Complex<f64>,
    /// Through each taper.
    amplitudes: [[Complex<f64>; CHANNELS]; TAPERS],
    /// What is foretold changes within it.
    narrow: bool,
}

/// What random forces of unit size make of a bin: of each taper, of the force of each tool.
type DrivenBin = [[Matrix; 2]; TAPERS];

/// The same of all bins that are looked at.
struct Driven {
    cut: CutLoop,
    every: Every,
    bins: Vec<DrivenBin>,
}

/// Forces and motion that each tool's random force of unit size makes at a frequency.
fn columns(cut: &CutLoop, frequency_hz: f64) -> [[Complex<f64>; CHANNELS]; 2] {
    let s = Complex::new(0.0, TAU * frequency_hz);
    let z = cut.closed(s);
    let g = cut.bar_response(s) / PROBE_UNIT_M;
    [0, 1].map(|j| [z[0][j], z[1][j], -g * (z[0][j] - z[1][j])])
}

impl CalmSpectra {
    /// The spectra of a piece. `lines`: there are lines of the spindle, which no random force makes.
    /// Cost: two transforms a channel.
    pub(crate) fn new(recording: &CutRecording, stretch: &Stretch, known: &Reference, lines: bool) -> Self {
        let range = stretch.samples.clone();
        let middle = usize::midpoint(range.start, range.end);
        let place = Place::new(recording, stretch, middle, known);
        let (n, rate) = (range.len(), recording.sample_rate.hz());
        let tapers = [0, 1].map(|k| taper(k, n, rate));
        let forward = FftPlanner::new().plan_fft_forward(n);
        let speed_rpm = lines.then_some(place.condition.speed_rpm);
        let turned = turned_angle(recording, range.clone());
        let spectra = |x: Option<&Vec<f64>>, unit: f64| {
            let mut x = x.map_or_else(|| vec![0.0; n], |x| without_line(&x[range.clone()]));
            if let Some(speed_rpm) = speed_rpm {
                without_orders(&mut x, &turned, speed_rpm / 60.0, place.band_hz[1]);
            }
            tapers.each_ref().map(|taper| {
                let tapered = x.iter().zip(taper).map(|(x, w)| Complex::new(x / unit * w, 0.0));
                let mut y: Vec<Complex<f64>> = tapered.collect();
                forward.process(&mut y);
                y
            })
        };
        let forces = [0, 1].map(|j| spectra(recording.forces_n[j].as_ref(), 1.0));
        let probe = spectra(recording.displacement_m.as_ref(), PROBE_UNIT_M);
        let (delay_s, filter) = (recording.signal.delay_s, place.filter);
        let cut = CutLoop::new(&known.machine.terms(&place.condition));
        let (step_hz, taken) = (rate / n as f64, taken(HALF_BINS));
        let of_band = |band_hz: [f64; 2]| -> Vec<CalmBin> {
            bins(n, rate, speed_rpm, band_hz)
                .into_iter()
                .map(|(k, f)| {
                    let e = signal_response(filter.as_ref(), delay_s, f);
                    let amplitudes = [0, 1].map(|t| [forces[0][t][k] / e, forces[1][t][k] / e, probe[t][k]]);
                    let stated = signal_response(filter.as_ref(), 0.0, f);
                    CalmBin { frequency_hz: f, stated, amplitudes, narrow: narrow(&cut, f, step_hz, &taken) }
                })
                .collect()
        };
        let slow = of_band([CRITERIA.slow_hz, place.band_hz[0]]);
        let bins = of_band(place.band_hz);
        Self { place, bins, slow, step_hz, taken }
    }

    /// What random forces of unit size make of the bins under a cut, the signal as stated.
    fn driven(&self, terms: &CutTerms, bins: &[CalmBin], every: Every) -> Driven {
        let cut = CutLoop::new(terms);
        let of_bin = |bin: &CalmBin| {
            if bin.narrow {
                let near = HALF_BINS.map(|d| columns(&cut, bin.frequency_hz + d * self.step_hz));
                self.taken.map(|weights| self.outer(&near, &weights))
            } else {
                [self.outer(&[columns(&cut, bin.frequency_hz)], &[1.0]); TAPERS]
            }
        };
        Driven { bins: bins.iter().step_by(every.0).map(of_bin).collect(), cut, every }
    }

    /// Weighted sums of the products of columns with themselves, of each tool.
    fn outer(&self, near: &[[[Complex<f64>; CHANNELS]; 2]], weights: &[f64]) -> [Matrix; 2] {
        let mut sums = [[[ZERO; CHANNELS]; CHANNELS]; 2];
        for (columns, weight) in near.iter().zip(weights).filter(|(_, w)| **w > 0.0) {
            for (sum, column) in sums.iter_mut().zip(columns) {
                for a in &self.place.used {
                    for b in &self.place.used {
                        sum[*a][*b] += column[*a] * column[*b].conj() * *weight;
                    }
                }
            }
        }
        sums
    }

    /// Bins of a machine whose cut drives them so.
    fn seen(&self, bins: &[CalmBin], driven: &Driven, machine: &Machine) -> Part {
        let random = self.place.random(machine, &driven.cut);
        let lag = self.place.lag(machine);
        let mut out = Vec::with_capacity(TAPERS * driven.bins.len());
        for (bin, driven) in bins.iter().step_by(driven.every.0).zip(&driven.bins) {
            let f = bin.frequency_hz;
            let ratio = lag.as_ref().map(|lag| Place::signal_ratio(lag, f, bin.stated));
            let path = ratio.map_or(bin.stated, |ratio| bin.stated * ratio);
            let noise = self.place.noise(machine, random, (f, path));
            let known = random.map(|r| r * machine.random_1_hz(f));
            for (x, [one, two]) in bin.amplitudes.iter().zip(driven) {
                let mut matrix = [[ZERO; CHANNELS]; CHANNELS];
                for a in &self.place.used {
                    for b in &self.place.used {
                        matrix[*a][*b] = one[*a][*b] * known[0] + two[*a][*b] * known[1];
                    }
                    matrix[*a][*a] += noise[*a];
                }
                if let Some(ratio) = ratio {
                    for force in 0..2 {
                        for other in 0..CHANNELS {
                            matrix[force][other] *= ratio;
                            matrix[other][force] *= ratio.conj();
                        }
                    }
                }
                out.push(self.place.select(f, *x, &matrix));
            }
        }
        Part::Bins { channels: self.place.used.len(), bins: out }
    }

    /// Bins of machines; what drives them is computed once where the cut is that of the first.
    fn bins_of(&self, bins: &[CalmBin], machines: &[Machine], every: Every) -> Vec<Part> {
        let terms = |machine: &Machine| machine.terms(&self.place.condition);
        let Some(first) = machines.first().map(terms) else { return Vec::new() };
        let driven = self.driven(&first, bins, every);
        let of = |machine: &Machine| {
            let own = terms(machine);
            if own == first {
                return self.seen(bins, &driven, machine);
            }
            self.seen(bins, &self.driven(&own, bins, every), machine)
        };
        machines.iter().map(of).collect()
    }
}

/// True where a taper smears what a cut makes of a bin.
fn narrow(cut: &CutLoop, frequency_hz: f64, step_hz: f64, taken: &Taken) -> bool {
    let power = |d: f64| -> f64 {
        columns(cut, frequency_hz + d * step_hz).iter().flatten().map(Complex::norm_sqr).sum()
    };
    let at = HALF_BINS.map(power);
    let smeared = |weights: &[f64]| at.iter().zip(weights).map(|(p, w)| p * w).sum::<f64>();
    taken.iter().any(|weights| (smeared(weights) / at[at.len() / 2] - 1.0).abs() > CRITERIA.smooth_share)
}

impl Observable for CalmSpectra {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        let driven = self.driven(&machine.terms(&self.place.condition), &self.bins, every);
        self.seen(&self.bins, &driven, machine)
    }

    fn parts(&self, machines: &[Machine], every: Every) -> Vec<Part> {
        self.bins_of(&self.bins, machines, every)
    }

    fn slow(&self, machine: &Machine) -> Option<Part> {
        self.bins_of(&self.slow, std::slice::from_ref(machine), Every(1)).pop()
    }

    fn left_over(&self, machine: &Machine) -> Option<LeftOver> {
        let Part::Bins { bins, .. } = self.part(machine, Every(1)) else { return None };
        let [low, high] = self.place.band_hz;
        Some(LeftOver::of_bins(&bins, self.place.forces(), high - low))
    }

    fn sources(&self, machine: &Machine, frequency_hz: f64) -> Option<Sources> {
        self.place.sources(machine, frequency_hz, false)
    }

    fn origin(&self) -> Origin {
        self.place.origin
    }
}

#[cfg(test)]
mod tests {
    use super::super::machine::Noise;
    use super::super::synthetic::{RATE_HZ, machine, recording};
    use super::*;

    /// Whitened power of white noise of 1e-3 N^2/Hz in the signal, give or take a standard deviation.
    fn power_of_white_noise(noise: Noise, bandwidth_hz: Option<f64>) -> [f64; 2] {
        let machine = Machine { noise, ..machine() };
        let mut random = 7u64;
        let mut uniform = move || {
            random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (random >> 11) as f64 / (1u64 << 53) as f64 - 0.5
        };
        // Sensor noise of 1e-3 N^2/Hz alone: variance 1e-3 times half the rate, uniform of width sqrt(12).
        let size = (12.0 * 1e-3 * RATE_HZ / 2.0).sqrt();
        let mut cuts =
            recording(&machine.scenario, 2.0, |_| [50.0 + size * uniform(), 50.0 + size * uniform()]);
        cuts.signal.bandwidth_hz = bandwidth_hz;
        let stretch = Stretch { recording: 0, samples: 0..18000 };
        let calm = CalmSpectra::new(&cuts, &stretch, &Reference::of(machine), false);
        let Part::Bins { bins, channels } = calm.part(&machine, Every(1)) else { panic!("bins") };
        let power: f64 = bins.iter().map(|b| b.x[0].norm_sqr() / b.s[0][0].re).sum::<f64>();
        assert_eq!(channels, 2);
        let n = bins.len() as f64;
        [power / n, 1.0 / n.sqrt()]
    }

    /// The spectrum of a calm cut is that of its random force through the closed loop: white noise of known
    /// size in, whitened power one out, whatever the seed.
    #[test]
    fn the_tapers_keep_the_power_of_white_noise() {
        let [power, sd] = power_of_white_noise(Noise { sensor: 1.0, ..machine().noise }, None);
        assert!((power - 1.0).abs() < 4.0 * sd, "{power}");
    }

    /// Noise behind the low-pass is white in the signal, up to where the low-pass leaves a third.
    #[test]
    fn noise_behind_the_filter_is_not_filtered() {
        let behind = Noise { sensor: 1.0, sensor_behind: 1.0, ..machine().noise };
        let [power, sd] = power_of_white_noise(behind, Some(800.0));
        assert!((power - 1.0).abs() < 4.0 * sd, "{power}");
        let [before, _] = power_of_white_noise(Noise { sensor_behind: 0.0, ..behind }, Some(800.0));
        assert!(before > 1.0 + 20.0 * sd, "{before}");
    }
}
