//! Innovations of stretches that are followed in time: the random force itself,
//!
//! n = F + A R F  (and the probe less -G (F1 - F2)),
//!
//! computed from the measured forces in time and windowed afterwards. It is stationary whether the cut is
//! stable or not, so that growth, line and the phase of every phasor are in it. Its spectrum has what the
//! noise of the sensor becomes on that way:
//!
//! S = diag(nu^2 F_j^2 S_u, 0) + M diag(sensor + folded, probe) M^H + (share F)^2
//! M = [[I + A R, 0], [(G, -G), 1]]
//!
//! In a stable cut M = Z^-1 and both ways say the same, once ln |det M|^2 is taken off, and of each force
//! ln |E/E_stated|^2: n is made of the recorded forces with the numbers that are asked for
//! ([`super::observable::Bin::log_jacobian`]). Behind a
//! taper that holds where the random force rules only. About the bar's own frequency the noise of the sensor
//! comes through the bar, Q times, as narrow as a bin: with those bins the damping ratio came out half too
//! high (expected score over a cut, 0.6 nats a tenth of it; 0.01 to 0.03 without). They are left out, by the
//! best that is known of the machine; what the line itself tells is in [`super::line`].

use super::criteria::CRITERIA;
use super::force_signal::signal_response;
use super::input::CutRecording;
use super::known::Reference;
use super::machine::Machine;
use super::matrix::{CHANNELS, Matrix, ZERO, cholesky, forward};
use super::observable::{Every, LeftOver, Observable, Origin, OriginKind, Part};
use super::source::Sources;
use super::spectra::{PROBE_UNIT_M, Place, SHARE_OF_BINS, SignalLag, TAPERS, bins, taken, taper};
use super::stretches::Stretch;
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::CutTerms;
use crate::plant::scenario::{Scenario, ToolCount};
use crate::stability::{Root, cut_root_near};
use nalgebra::Complex;
use rustfft::{Fft, FftPlanner};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Innovations of one stretch that is followed in time.
pub(crate) struct FollowedSpectra {
    place: Place,
    /// Transforms of the forces over and times the relative shape of the bar along the travel, without the
    /// signal's filter; positive frequencies below the roll-off.
    over_shape: Vec<[Complex<f64>; 2]>,
    times_shape: Vec<[Complex<f64>; 2]>,
    /// At the same frequencies, the signal's low-pass as stated.
    stated: Vec<Complex<f64>>,
    /// Relative shape times taper, in the window.
    shaped: [Vec<f64>; TAPERS],
    /// What each taper takes from a bin and from its neighbours.
    taken: [[f64; 3]; TAPERS],
    /// First sample of the window in the segment.
    offset: usize,
    bins: Vec<FollowedBin>,
    /// Strongest line of the forces, Hz.
    line_hz: f64,
    /// The growing line is among the bins.
    line_in: bool,
    length: usize,
    inverse: Arc<dyn Fft<f64>>,
    forward: Arc<dyn Fft<f64>>,
}

/// One bin of the window.
struct FollowedBin {
    index: usize,
    frequency_hz: f64,
    /// The signal's low-pass as stated.
    stated: Complex<f64>,
    /// Power of the forces themselves.
    power: [f64; 2],
    /// The probe through each taper.
    probe: [Complex<f64>; TAPERS],
}

/// Largest number not above `n` without prime factors beyond 5: a length with a fast transform.
fn smooth_below(n: usize) -> usize {
    let smooth = |mut m: usize| {
        for p in [2, 3, 5] {
            while m.is_multiple_of(p) {
                m /= p;
            }
        }
        m == 1
    };
    (1..=n).rev().find(|m| smooth(*m)).unwrap_or(1)
}

/// Samples of a recording that are transformed, and those in them that are looked at.
struct Window {
    begin: usize,
    end: usize,
    /// First sample that is looked at, and how many.
    from: usize,
    len: usize,
    /// Samples in which the forces rise from the begin on.
    rise: usize,
    /// Of the transform.
    length: usize,
}

impl Window {
    fn of(recording: &CutRecording, stretch: &Stretch, scenario: &Scenario) -> Self {
        let rate = recording.sample_rate.hz();
        let len = smooth_below(stretch.samples.len());
        let from = stretch.samples.end - len;
        // The signal is late: what it shows of the stretch's end comes after it.
        let after = (recording.signal.delay_s * rate).ceil() as usize + (0.012 * rate) as usize;
        let end = (stretch.samples.end + after).min(recording.len());
        let turn_s = 60.0 / recording.spindle_speed_rpm[from];
        // The forces rise before what the bar remembers of them, not in it, over some ten periods.
        let remembered_s = memory_s(scenario);
        let rising_s = remembered_s / 4.0;
        let before = ((rising_s + remembered_s + turn_s) * rate) as usize;
        let begin = from.saturating_sub(before);
        let rise = ((rising_s * rate) as usize).clamp(1, (from - begin).max(1));
        let length = smooth_below((end - begin) * 11 / 10 + 256);
        let length = if length < end - begin { (end - begin).next_power_of_two() } else { length };
        Self { begin, end, from, len, rise, length }
    }
}

/// Bins of a window without anything in them yet; `lines`: without those of the spindle's lines.
fn bins_of(place: &Place, window_len: usize, lines: bool) -> Vec<FollowedBin> {
    let speed_rpm = lines.then_some(place.condition.speed_rpm);
    let bins = bins(window_len, place.rate.hz(), speed_rpm, place.band_hz).into_iter();
    let empty = |(index, frequency_hz)| {
        let stated = signal_response(place.filter.as_ref(), 0.0, frequency_hz);
        FollowedBin { index, frequency_hz, stated, power: [0.0; 2], probe: [ZERO; TAPERS] }
    };
    bins.map(empty).collect()
}

/// The probe's transform through a taper, its mean taken off.
fn of_probe(y_m: &[f64], taper: &[f64], forward: &dyn Fft<f64>) -> Vec<Complex<f64>> {
    let mean_m = y_m.iter().sum::<f64>() / y_m.len() as f64;
    let tapered = y_m.iter().zip(taper).map(|(y, w)| (y - mean_m) / PROBE_UNIT_M * w);
    let mut y: Vec<Complex<f64>> = tapered.map(|y| Complex::new(y, 0.0)).collect();
    forward.process(&mut y);
    y
}

impl FollowedSpectra {
    /// `None`: a force is not there, or nothing is left of the band. `lines`: there are lines of the spindle,
    /// which no random force makes; a window of some turns has little left beside them.
    pub(crate) fn new(
        recording: &CutRecording,
        stretch: &Stretch,
        known: &Reference,
        (lines, taken_hz): (bool, Option<[f64; 2]>),
    ) -> Option<Self> {
        let scenario = &known.machine.scenario;
        let rate = recording.sample_rate.hz();
        let mut forces: [&[f64]; 2] = [recording.forces_n[0].as_ref()?, &[]];
        let two = scenario.tools.count() == ToolCount::Two;
        if two {
            forces[1] = recording.forces_n[1].as_ref()?;
        }
        let window = Window::of(recording, stretch, scenario);
        let Window { begin, from: window_from, len: window_len, length, .. } = window;
        let centre = loudest(forces, window_from..stretch.samples.end);
        let mut place = Place::new(recording, stretch, centre, known);
        let bar = &scenario.workpiece;
        let own = bar.mode_shape(place.condition.position_m).max(1e-3);
        let shape: Vec<f64> = (begin..window.end)
            .map(|k| (bar.mode_shape(recording.tool_position_m[k]) / own).max(1e-3))
            .collect();
        let mut planner = FftPlanner::new();
        let long = planner.plan_fft_forward(length);
        let tapered = led(forces, begin..window.end, window_from..stretch.samples.end, window.rise);
        let [roll_from, roll_to] = roll_off_hz(place.band_hz, rate);
        let keep = (roll_to / rate * length as f64) as usize;
        let transform = |weight: &dyn Fn(f64) -> f64| {
            let of = tapered.each_ref().map(|force| {
                let mut x = vec![ZERO; length];
                for (x, (v, p)) in x.iter_mut().zip(force.iter().zip(&shape)) {
                    *x = Complex::new(v * weight(*p), 0.0);
                }
                long.process(&mut x);
                x
            });
            let without_path = |k: usize| {
                let f = k as f64 * rate / length as f64;
                let e = signal_response(place.filter.as_ref(), recording.signal.delay_s, f);
                let gain = e.inv() * (roll_off(f, [roll_from, roll_to]) / length as f64);
                [of[0][k] * gain, of[1][k] * gain]
            };
            (0..=keep.min(length / 2)).map(without_path).collect::<Vec<_>>()
        };
        let (over_shape, times_shape) = (transform(&|p| 1.0 / p), transform(&|p| p));
        let at = |k: usize| k as f64 * rate / length as f64;
        let stated: Vec<Complex<f64>> =
            (0..over_shape.len()).map(|k| signal_response(place.filter.as_ref(), 0.0, at(k))).collect();
        let offset = window_from - begin;
        let tapers = [0, 1].map(|k| taper(k, window_len, rate));
        let shaped = tapers
            .each_ref()
            .map(|t| (0..window_len).map(|k| t[k] * shape[offset + k]).collect::<Vec<f64>>());
        let bins = bins_of(&place, window_len, lines);
        place.origin.kind = OriginKind::Followed;
        let forward = planner.plan_fft_forward(window_len);
        let probe = recording.displacement_m.as_ref().map(|y| {
            tapers.each_ref().map(|taper| of_probe(&y[window_from..][..window_len], taper, forward.as_ref()))
        });
        let inverse = planner.plan_fft_inverse(length);
        let mut out = Self {
            place,
            over_shape,
            times_shape,
            stated,
            shaped,
            taken: taken([-1.0, 0.0, 1.0]),
            offset,
            bins,
            length,
            inverse,
            forward,
            line_hz: 0.0,
            line_in: true,
        };
        out.see(probe.as_ref());
        out.keep_random(&known.machine, taken_hz);
        (!out.bins.is_empty()).then_some(out)
    }

    /// Power of the forces in each bin, and the probe's transforms.
    fn see(&mut self, probe: Option<&[Vec<Complex<f64>>; TAPERS]>) {
        let alone = self.windowed(&self.over_shape);
        let at = |k: usize, j: usize| alone.iter().map(|t| t[k][j].norm_sqr()).sum::<f64>() / TAPERS as f64;
        for bin in &mut self.bins {
            let k = bin.index;
            bin.power = [0, 1].map(|j| (k - 1..=k + 1).map(|k| at(k, j)).fold(0.0, f64::max));
            if let Some(y) = probe {
                bin.probe = y.each_ref().map(|t| t[k]);
            }
        }
    }

    /// Two spectra at positive frequencies, brought to time, tapered, and back, for each taper; index: bin of
    /// the window.
    fn windowed(&self, spectra: &[[Complex<f64>; 2]]) -> [Vec<[Complex<f64>; 2]>; TAPERS] {
        let i = Complex::new(0.0, 1.0);
        let mut x = vec![ZERO; self.length];
        for (k, [a, b]) in spectra.iter().enumerate().skip(1) {
            // Both are real in time: one rides on the imaginary axis.
            x[k] += a + i * b;
            x[self.length - k] += a.conj() + i * b.conj();
        }
        self.inverse.process(&mut x);
        self.shaped.each_ref().map(|shaped| {
            let n = shaped.len();
            let mut y: Vec<Complex<f64>> =
                shaped.iter().enumerate().map(|(k, w)| x[self.offset + k] * *w).collect();
            self.forward.process(&mut y);
            let last = self.bins.last().map_or(0, |b| b.index) + 2;
            (0..last.min(n / 2))
                .map(|k| {
                    let (plus, minus) = (y[k], y[(n - k) % n].conj());
                    [(plus + minus) * 0.5, (plus - minus) * (-0.5 * i)]
                })
                .collect()
        })
    }

    /// Finds the line, and keeps the bins in which the random force rules in what the bar amplifies.
    fn keep_random(&mut self, machine: &Machine, taken_hz: Option<[f64; 2]>) {
        let cut = CutLoop::new(&machine.terms(&self.place.condition));
        let random = self.place.random(machine, &cut);
        let step = self.place.rate.hz() / self.shaped[0].len() as f64;
        let lag = self.place.lag(machine);
        let rules = |f: f64, stated: Complex<f64>| {
            if taken_hz.is_some_and(|[from, to]| (from..to).contains(&f)) {
                return false;
            }
            let noise = self.place.noise(machine, random, (f, path(lag.as_ref(), f, stated)));
            let near = [-1.0, 0.0, 1.0].map(|d| Way::at(&cut, f + d * step));
            let known = random.map(|r| r * machine.random_1_hz(f));
            let own = [0.0; CHANNELS];
            self.taken.iter().all(|weights| {
                let matrix = spectrum(&near, weights, &noise, known, own);
                share_along(&self.place, &matrix, amplified(&cut, f), known) > RULING_SHARE
            })
        };
        let kept: Vec<bool> = self.bins.iter().map(|b| rules(b.frequency_hz, b.stated)).collect();
        let power = |b: &FollowedBin| b.power[0] + b.power[1];
        let loudest = self.bins.iter().zip(&kept).max_by(|a, b| power(a.0).total_cmp(&power(b.0)));
        (self.line_hz, self.line_in) = loudest.map_or((0.0, false), |(bin, kept)| (bin.frequency_hz, *kept));
        let mut keep = kept.iter();
        self.bins.retain(|_| keep.next().copied().unwrap_or(true));
    }

    /// Share of a bin in what a root right of the axis takes from the Jacobian.
    ///
    /// Over all frequencies ln |det M|^2 sums to 2 sigma T, T the window, for each pair of roots right of
    /// the axis, and to nought without; the map from forces to n is causal with a leading one, its Jacobian
    /// over all frequencies is one. Of that the values have their share.
    fn growth_share(&self, cut: &CutLoop) -> f64 {
        let near = |f: f64| cut_root_near(cut, Root { growth_1_s: 10.0, frequency_hz: f });
        if !self.line_in {
            return 0.0;
        }
        let growth_1_s = near(self.line_hz).map_or(0.0, |r| r.growth_1_s.max(0.0));
        let window_s = self.shaped[0].len() as f64 / self.place.rate.hz();
        2.0 * growth_1_s * window_s * SHARE_OF_BINS / (TAPERS * self.bins.len().max(1)) as f64
    }
}

/// The signal's path by its lag, of the low-pass as stated at a frequency.
fn path(lag: Option<&SignalLag>, f: f64, stated: Complex<f64>) -> Complex<f64> {
    lag.map_or(stated, |lag| stated * Place::signal_ratio(lag, f, stated))
}

/// What noise of forces and probe becomes on the way to the innovations, at one frequency.
struct Way {
    /// M, and the probe's row below.
    matrix: Matrix,
    /// ln |det M|^2.
    log_det: f64,
    /// |G|^2, in units of the probe.
    bar: f64,
}

impl Way {
    fn at(cut: &CutLoop, frequency_hz: f64) -> Self {
        let s = Complex::new(0.0, TAU * frequency_hz);
        let (a_r, g) = (cut.force_per_force(s), cut.bar_response(s) / PROBE_UNIT_M);
        let one = Complex::new(1.0, 0.0);
        let matrix: Matrix =
            [[one + a_r[0][0], a_r[0][1], ZERO], [a_r[1][0], one + a_r[1][1], ZERO], [g, -g, one]];
        let det = matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0];
        Self { matrix, log_det: det.norm_sqr().ln(), bar: g.norm_sqr() }
    }
}

/// Spectra of innovations and probe through one taper. `random`: of the random forces, `own`: inaccuracy of
/// the recorded forces' own law, and of the motion that they drive.
fn spectrum(
    near: &[Way; 3],
    weights: &[f64; 3],
    noise: &[f64; CHANNELS],
    random: [f64; 2],
    own: [f64; CHANNELS],
) -> Matrix {
    let mut out = [[ZERO; CHANNELS]; CHANNELS];
    for a in 0..CHANNELS {
        for b in 0..CHANNELS {
            let through = |n: &Way| -> Complex<f64> {
                (0..CHANNELS).map(|c| n.matrix[a][c] * n.matrix[b][c].conj() * noise[c]).sum()
            };
            out[a][b] = near.iter().zip(weights).map(|(n, w)| through(n) * w).sum();
        }
        out[a][a] += own[a] + random.get(a).copied().unwrap_or(0.0);
    }
    out
}

/// Share of the random force in what the bar amplifies from which on it rules.
const RULING_SHARE: f64 = 0.5;

/// A (1, -1): what the bar amplifies in the forces.
fn amplified(cut: &CutLoop, f: f64) -> [Complex<f64>; 2] {
    cut.force_law(Complex::new(0.0, TAU * f)).map(|row| row[0] - row[1])
}

/// p^H S^-1 diag(random) p/p^H p.
fn share_along(place: &Place, s: &Matrix, p: [Complex<f64>; 2], random: [f64; 2]) -> f64 {
    let wanted = [p[0], p[1], ZERO];
    let driven = [p[0] * random[0], p[1] * random[1], ZERO];
    let n = place.used.len();
    let [left, right] = [wanted, driven].map(|x| place.select(0.0, x, s));
    let Some(l) = cholesky(&left.s, n) else { return 1.0 };
    let (a, b) = (forward(&l, &left.x, n), forward(&l, &right.x, n));
    let both: Complex<f64> = (0..n).map(|i| a[i].conj() * b[i]).sum();
    let size: f64 = left.x[..n].iter().map(Complex::norm_sqr).sum();
    (both.re / size.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
}

/// What the bar remembers, s: until its own ringing is a ten-thousandth; some hundred periods at most.
fn memory_s(scenario: &Scenario) -> f64 {
    let bar = &scenario.workpiece;
    let decay_1_s = bar.raw().damping_ratio * TAU * bar.bending_frequency_hz();
    (1e4f64.ln() / decay_1_s.max(1e-3)).clamp(0.2, 1.0)
}

/// Where the signal is given up, Hz: from the end of the band on, over a third of it.
fn roll_off_hz(band_hz: [f64; 2], rate_hz: f64) -> [f64; 2] {
    let from = 1.03 * band_hz[1];
    [from, (1.33 * from).min(0.49 * rate_hz).max(from + 1.0)]
}

fn roll_off(f: f64, [from, to]: [f64; 2]) -> f64 {
    if f <= from {
        1.0
    } else if f >= to {
        0.0
    } else {
        0.5 * (1.0 + (PI * (f - from) / (to - from)).cos())
    }
}

/// Sample about which the power of the forces lies in a range.
fn loudest(forces: [&[f64]; 2], range: std::ops::Range<usize>) -> usize {
    let mean = forces
        .map(|f| if f.is_empty() { 0.0 } else { f[range.clone()].iter().sum::<f64>() / range.len() as f64 });
    let (mut power, mut moment) = (1e-12, 0.0);
    for k in range.clone() {
        let p: f64 =
            (0..2).filter(|j| !forces[*j].is_empty()).map(|j| (forces[j][k] - mean[j]).powi(2)).sum();
        power += p;
        moment += p * (k - range.start) as f64;
    }
    range.start + (moment / power) as usize
}

/// The forces of a segment without the mean of the window, risen over `rise` samples and fallen smoothly.
fn led(
    forces: [&[f64]; 2],
    segment: std::ops::Range<usize>,
    window: std::ops::Range<usize>,
    rise: usize,
) -> [Vec<f64>; 2] {
    let fall = (segment.end.saturating_sub(window.end) / 2).max(1);
    forces.map(|f| {
        if f.is_empty() {
            return vec![0.0; segment.len()];
        }
        let mean = f[window.clone()].iter().sum::<f64>() / window.len() as f64;
        let ramp = |k: usize, over: usize| 0.5 * (1.0 - (PI * (k as f64 / over as f64).min(1.0)).cos());
        let n = segment.len();
        (0..n).map(|k| (f[segment.start + k] - mean) * ramp(k, rise) * ramp(n - 1 - k, fall)).collect()
    })
}

/// Innovations and what noise becomes on the way to them, of one cut.
struct Undone {
    cut: CutLoop,
    innovations: [Vec<[Complex<f64>; 2]>; TAPERS],
    moved: Option<[Vec<[Complex<f64>; 2]>; TAPERS]>,
    ways: Vec<[Way; 3]>,
    unstable: f64,
}

impl FollowedSpectra {
    /// The recorded forces undone by the cut of a machine.
    fn undone(&self, machine: &Machine, terms: &CutTerms, every: Every) -> Undone {
        let cut = CutLoop::new(terms);
        let lag = self.place.lag(machine);
        let rate = self.place.rate.hz();
        let probe = self.place.used.contains(&2);
        let mut seen = Vec::with_capacity(self.over_shape.len());
        let mut moved = Vec::with_capacity(if probe { self.over_shape.len() } else { 0 });
        for (k, (over, times)) in self.over_shape.iter().zip(&self.times_shape).enumerate() {
            let f = k as f64 * rate / self.length as f64;
            let s = Complex::new(0.0, TAU * f);
            let undo = lag
                .as_ref()
                .map_or(Complex::new(1.0, 0.0), |lag| Place::signal_ratio(lag, f, self.stated[k]).inv());
            let m = cut.force_per_force(s);
            let add = |j: usize| (over[j] + m[j][0] * times[0] + m[j][1] * times[1]) * undo;
            seen.push([add(0), add(1)]);
            if probe {
                moved.push([cut.bar_response(s) * (times[0] - times[1]) * undo / PROBE_UNIT_M, ZERO]);
            }
        }
        // The tapers smear what the noise becomes near the bar's own frequency, where it is narrow.
        let step = rate / self.shaped[0].len() as f64;
        let near = |bin: &FollowedBin| [-1.0, 0.0, 1.0].map(|d| Way::at(&cut, bin.frequency_hz + d * step));
        Undone {
            innovations: self.windowed(&seen),
            moved: probe.then(|| self.windowed(&moved)),
            ways: self.bins.iter().step_by(every.0).map(near).collect(),
            unstable: self.growth_share(&cut),
            cut,
        }
    }

    fn seen(&self, machine: &Machine, undone: &Undone, every: Every) -> Part {
        let random = self.place.random(machine, &undone.cut);
        let share = CRITERIA.followed_share.powi(2);
        let mut out = Vec::with_capacity(TAPERS * undone.ways.len());
        let lag = self.place.lag(machine);
        for (at, near) in self.bins.iter().step_by(every.0).zip(&undone.ways) {
            let (k, f, power) = (at.index, at.frequency_hz, at.power);
            let path = path(lag.as_ref(), f, at.stated);
            let noise = self.place.noise(machine, random, (f, path));
            let known = random.map(|r| r * machine.random_1_hz(f));
            // The recorded forces are divided by the path: its Jacobian, over that of the path as stated.
            let passed = self.place.forces() as f64 * (path / at.stated).norm_sqr().ln();
            for (t, weights) in self.taken.iter().enumerate() {
                let own = [share * power[0], share * power[1], near[1].bar * share * (power[0] + power[1])];
                let matrix = spectrum(near, weights, &noise, known, own);
                let third = undone.moved.as_ref().map_or(ZERO, |m| at.probe[t] + m[t][k][0]);
                let [one, two] = undone.innovations[t][k];
                let mut bin = self.place.select(f, [one, two, third], &matrix);
                let logs: f64 = near.iter().zip(weights).map(|(n, w)| n.log_det * w).sum();
                bin.log_jacobian = logs - passed - undone.unstable;
                out.push(bin);
            }
        }
        Part::Bins { channels: self.place.used.len(), bins: out }
    }
}

impl Observable for FollowedSpectra {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        let terms = machine.terms(&self.place.condition);
        self.seen(machine, &self.undone(machine, &terms, every), every)
    }

    fn parts(&self, machines: &[Machine], every: Every) -> Vec<Part> {
        let key = |machine: &Machine| (machine.terms(&self.place.condition), self.place.lag(machine));
        let Some(first) = machines.first() else { return Vec::new() };
        let (own, lag) = key(first);
        let undone = self.undone(first, &own, every);
        let of = |machine: &Machine| {
            let (terms, its) = key(machine);
            if terms == own && its == lag {
                return self.seen(machine, &undone, every);
            }
            self.seen(machine, &self.undone(machine, &terms, every), every)
        };
        machines.iter().map(of).collect()
    }

    fn left_over(&self, machine: &Machine) -> Option<LeftOver> {
        let Part::Bins { bins, .. } = self.part(machine, Every(1)) else { return None };
        let [low, high] = self.place.band_hz;
        Some(LeftOver::of_bins(&bins, self.place.forces(), high - low))
    }

    fn sources(&self, machine: &Machine, frequency_hz: f64) -> Option<Sources> {
        self.place.sources(machine, frequency_hz, true)
    }

    fn origin(&self) -> Origin {
        self.place.origin
    }
}

#[cfg(test)]
mod tests {
    use super::super::fit::part_value;
    use super::super::machine::Noise;
    use super::super::synthetic::{RATE_HZ, machine, recording};
    use super::*;
    use crate::plant::cut_loop::RANDOM_FORCE_CORNER_HZ;
    use crate::plant::cut_terms::CutCondition;
    use crate::signal::butterworth::Butterworth;
    use crate::stability::rightmost_cut_root;
    use crate::units::SampleRate;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Forces that swell at the root of the cut, in its own ratio, are no random force: nothing is left of
    /// them, from 40 times the window's end down.
    #[test]
    fn a_mode_that_swells_at_its_root_leaves_no_innovation() {
        let machine = machine();
        let at = CutCondition::of(&machine.scenario);
        let cut = CutLoop::new(&CutTerms::of(&machine.scenario, &at));
        let root = rightmost_cut_root(&cut);
        assert!(root.growth_1_s > 20.0, "{root:?}");
        let s = Complex::new(root.growth_1_s, TAU * root.frequency_hz);
        // F1 + sum_j (A R)_1j F_j = 0 at the root.
        let m = cut.force_per_force(s);
        let ratio = -(m[0][0] + 1.0) / m[0][1];
        let force = |t: f64| {
            let swell = (s * (t - 0.8)).exp() * 20.0;
            [50.0 + swell.re, 50.0 + (swell * ratio).re]
        };
        let cuts = recording(&machine.scenario, 0.9, force);
        let stretch = Stretch { recording: 0, samples: 5000..7200 };
        let followed =
            FollowedSpectra::new(&cuts, &stretch, &Reference::of(machine), (false, None)).expect("followed");
        let Part::Bins { bins, .. } = followed.part(&machine, Every(1)) else { panic!("bins") };
        let left: f64 = bins.iter().map(|b| b.x[0].norm_sqr() + b.x[1].norm_sqr()).sum();
        let had: f64 = followed.bins.iter().map(|b| b.power[0] + b.power[1]).sum();
        assert!(had > 0.01 && left < 1e-4 * had, "{left:e} of {had:e}");
    }

    /// Random forces through a low-pass, in a cut too soft to feed back: the corner that they were made with
    /// is likelier than one a tenth off either way. A wider one leaves smaller forces, and without the
    /// Jacobian of that the likelihood would rise with it for ever.
    #[test]
    fn the_corner_of_the_signal_is_likeliest_where_it_is() {
        let mut machine = machine();
        let mut raw = machine.scenario.raw();
        raw.cutting.radial_stiffness_pa *= 1e-3;
        raw.cutting.process_damping_n = 0.0;
        machine.scenario = Scenario::new(&raw).expect("a scenario");
        let at = CutCondition::of(&machine.scenario);
        let mean_n = CutLoop::new(&CutTerms::of(&machine.scenario, &at)).means().force_n[0];
        machine.noise.random_share = 1.0 / mean_n;
        let rate = SampleRate::new(RATE_HZ).expect("a rate");
        let low_pass = Butterworth::low_pass(4, 1000.0, rate).expect("a low-pass");
        let mut state = [low_pass.settled(0.0); 2];
        let mut generator = ChaCha8Rng::seed_from_u64(3);
        // Samples of noise of the first order, sd 1 N.
        let kept = (-TAU * RANDOM_FORCE_CORNER_HZ / RATE_HZ).exp();
        let mut random_n = [0.0; 2];
        let mut cuts = recording(&machine.scenario, 2.0, |_| {
            [0, 1].map(|j| {
                let fresh: f64 = StandardNormal.sample(&mut generator);
                random_n[j] = kept * random_n[j] + (1.0 - kept * kept).sqrt() * fresh;
                mean_n + low_pass.step(&mut state[j], random_n[j])
            })
        });
        cuts.signal.bandwidth_hz = Some(1000.0);
        let stretch = Stretch { recording: 0, samples: 7000..16000 };
        let followed =
            FollowedSpectra::new(&cuts, &stretch, &Reference::of(machine), (false, None)).expect("followed");
        let value = |factor: f64| {
            let noise = Noise { bandwidth_factor: factor, ..machine.noise };
            part_value(&followed.part(&Machine { noise, ..machine }, Every(1)))
        };
        let [narrow, true_corner, wide] = [0.9, 1.0, 1.1].map(value);
        assert!(true_corner < narrow - 5.0 && true_corner < wide - 5.0, "{narrow} {true_corner} {wide}");
    }
}
