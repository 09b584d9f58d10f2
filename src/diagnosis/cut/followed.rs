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
//! In a stable cut M = Z^-1 and both ways say the same, once ln |det M|^2 is taken off: n is made of the
//! recorded forces with the numbers that are asked for ([`super::observable::Bin::log_jacobian`]).

use super::criteria::CRITERIA;
use super::input::CutRecording;
use super::machine::Machine;
use super::observable::{CHANNELS, Every, LeftOver, Matrix, Observable, Origin, OriginKind, Part, ZERO};
use super::spectra::{PROBE_UNIT_M, Place, SMEARED, Way, bins, force_per_force, hann, innovation_power};
use super::stretches::{Stretch, signal_response};
use crate::plant::cut_loop::{CutLoop, ToolMatrix, random_force_spectrum_1_hz};
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
    /// Relative shape times window, in the window.
    shaped_window: Vec<f64>,
    /// First sample of the window in the segment.
    offset: usize,
    bins: Vec<(usize, f64)>,
    /// Power of the forces themselves in each bin, and the windowed probe.
    measured: Vec<([f64; 2], Complex<f64>)>,
    /// Strongest line of the forces, Hz.
    line_hz: f64,
    length: usize,
    inverse: Arc<dyn Fft<f64>>,
    forward: Arc<dyn Fft<f64>>,
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

impl FollowedSpectra {
    /// `None`: a force is not there, or nothing is left of the band. `lines`: there are lines of the spindle,
    /// which no random force makes; a window of some turns has little left beside them.
    pub(crate) fn new(
        recording: &CutRecording,
        stretch: &Stretch,
        scenario: &Scenario,
        lines: bool,
    ) -> Option<Self> {
        let rate = recording.sample_rate.hz();
        let mut forces: [&[f64]; 2] = [recording.forces_n[0].as_ref()?, &[]];
        let two = scenario.tools.count() == ToolCount::Two;
        if two {
            forces[1] = recording.forces_n[1].as_ref()?;
        }
        let window_len = smooth_below(stretch.samples.len());
        let window_from = stretch.samples.end - window_len;
        // The signal is late: what it shows of the stretch's end comes after it.
        let after = (recording.signal.delay_s * rate).ceil() as usize + (0.012 * rate) as usize;
        let end = (stretch.samples.end + after).min(recording.len());
        let before = ((CRITERIA.memory_s + 60.0 / recording.spindle_speed_rpm[window_from]) * rate) as usize;
        let begin = window_from.saturating_sub(before);
        let length = smooth_below((end - begin) * 11 / 10 + 256);
        let length = if length < end - begin { (end - begin).next_power_of_two() } else { length };
        let centre = loudest(forces, window_from..stretch.samples.end);
        let mut place = Place::new(recording, stretch, centre, scenario);
        let bar = &scenario.workpiece;
        let own = bar.mode_shape(place.condition.position_m).max(1e-3);
        let shape: Vec<f64> =
            (begin..end).map(|k| (bar.mode_shape(recording.tool_position_m[k]) / own).max(1e-3)).collect();
        let mut planner = FftPlanner::new();
        let long = planner.plan_fft_forward(length);
        let tapered = taper(forces, begin..end, window_from..stretch.samples.end);
        let keep = (ROLL_OFF_HZ[1] / rate * length as f64) as usize;
        let transform = |weight: &dyn Fn(f64) -> f64| {
            let of = [0, 1].map(|j| {
                let mut x = vec![ZERO; length];
                for (k, v) in tapered[j].iter().enumerate() {
                    x[k] = Complex::new(v * weight(shape[k]), 0.0);
                }
                long.process(&mut x);
                x
            });
            (0..=keep.min(length / 2))
                .map(|k| {
                    let f = k as f64 * rate / length as f64;
                    let e = signal_response(place.filter.as_ref(), recording.signal.delay_s, f);
                    let gain = e.finv() * (roll_off(f) / length as f64);
                    [of[0][k] * gain, of[1][k] * gain]
                })
                .collect::<Vec<_>>()
        };
        let (over_shape, times_shape) = (transform(&|p| 1.0 / p), transform(&|p| p));
        let offset = window_from - begin;
        let window = hann(window_len, rate);
        let shaped_window = (0..window_len).map(|k| window[k] * shape[offset + k]).collect();
        let bins = bins(window_len, rate, lines.then_some(place.condition.speed_rpm), CRITERIA.band_hz);
        place.origin.kind = OriginKind::Followed;
        let forward = planner.plan_fft_forward(window_len);
        let probe = recording.displacement_m.as_ref().map(|y| {
            let mean = y[window_from..stretch.samples.end].iter().sum::<f64>() / window_len as f64;
            let mut y: Vec<Complex<f64>> = (0..window_len)
                .map(|k| Complex::new((y[window_from + k] - mean) / PROBE_UNIT_M * window[k], 0.0))
                .collect();
            forward.process(&mut y);
            y
        });
        let inverse = planner.plan_fft_inverse(length);
        let mut out = Self {
            place,
            over_shape,
            times_shape,
            shaped_window,
            offset,
            bins,
            length,
            inverse,
            forward,
            measured: Vec::new(),
            line_hz: 0.0,
        };
        let alone = out.windowed(&out.over_shape);
        out.measured = out
            .bins
            .iter()
            .map(|(k, _)| {
                let near = |j: usize| (k - 1..=k + 1).map(|k| alone[k][j].norm_sqr()).fold(0.0, f64::max);
                ([near(0), near(1)], probe.as_ref().map_or(ZERO, |y| y[*k]))
            })
            .collect();
        let power = |m: &([f64; 2], Complex<f64>)| m.0[0] + m.0[1];
        let loudest = out.bins.iter().zip(&out.measured).max_by(|a, b| power(a.1).total_cmp(&power(b.1)));
        out.line_hz = loudest.map_or(0.0, |(bin, _)| bin.1);
        Some(out)
    }

    /// Two spectra at positive frequencies, brought to time, windowed, and back; index: bin of the window.
    fn windowed(&self, spectra: &[[Complex<f64>; 2]]) -> Vec<[Complex<f64>; 2]> {
        let i = Complex::new(0.0, 1.0);
        let mut x = vec![ZERO; self.length];
        for (k, [a, b]) in spectra.iter().enumerate().skip(1) {
            // Both are real in time: one rides on the imaginary axis.
            x[k] += a + i * b;
            x[self.length - k] += a.conj() + i * b.conj();
        }
        self.inverse.process(&mut x);
        let n = self.shaped_window.len();
        let mut y: Vec<Complex<f64>> =
            self.shaped_window.iter().enumerate().map(|(k, w)| x[self.offset + k] * *w).collect();
        self.forward.process(&mut y);
        let last = self.bins.last().map_or(0, |b| b.0) + 2;
        (0..last.min(n / 2))
            .map(|k| {
                let (plus, minus) = (y[k], y[(n - k) % n].conj());
                [(plus + minus) * 0.5, (plus - minus) * (-0.5 * i)]
            })
            .collect()
    }

    /// Share of a bin in what a root right of the axis takes from the Jacobian.
    ///
    /// Over all frequencies ln |det M|^2 sums to 2 sigma T, T the window, for each pair of roots right of
    /// the axis, and to nought without; the map from forces to n is causal with a leading one, its Jacobian
    /// over all frequencies is one. Every second bin is looked at: half of it.
    fn growth_share(&self, cut: &CutLoop) -> f64 {
        let near = |f: f64| cut_root_near(cut, Root { growth_1_s: 10.0, frequency_hz: f });
        let growth_1_s = near(self.line_hz).map_or(0.0, |r| r.growth_1_s.max(0.0));
        let window_s = self.shaped_window.len() as f64 / self.place.rate.hz();
        growth_1_s * window_s / self.bins.len().max(1) as f64
    }

    /// M: what becomes of noise in forces and probe on the way to the innovations.
    fn way(a_r: &ToolMatrix, g: Complex<f64>) -> Matrix {
        let one = Complex::new(1.0, 0.0);
        [[one + a_r[0][0], a_r[0][1], ZERO], [a_r[1][0], one + a_r[1][1], ZERO], [g, -g, one]]
    }
}

/// Where the signal is given up, Hz: beyond the band, where the inverse of its filter is still mild.
const ROLL_OFF_HZ: [f64; 2] = [1000.0, 1300.0];

fn roll_off(f: f64) -> f64 {
    let [from, to] = ROLL_OFF_HZ;
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

/// The forces of a segment without the mean of the window, risen and fallen smoothly at its ends.
fn taper(
    forces: [&[f64]; 2],
    segment: std::ops::Range<usize>,
    window: std::ops::Range<usize>,
) -> [Vec<f64>; 2] {
    let rise = (segment.len() / 12).max(1);
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

impl Observable for FollowedSpectra {
    fn part(&self, machine: &Machine, every: Every) -> Part {
        let cut = CutLoop::new(&CutTerms::of(&machine.scenario, &self.place.condition));
        let random = self.place.random(machine, &cut);
        let lag = self.place.lag(machine);
        let rate = self.place.rate.hz();
        let probe = self.place.used.contains(&2);
        let mut seen = Vec::with_capacity(self.over_shape.len());
        let mut moved = Vec::with_capacity(if probe { self.over_shape.len() } else { 0 });
        for (k, (over, times)) in self.over_shape.iter().zip(&self.times_shape).enumerate() {
            let f = k as f64 * rate / self.length as f64;
            let s = Complex::new(0.0, TAU * f);
            let undo = if lag.is_some() {
                self.place.signal_ratio(lag.as_ref(), f).finv()
            } else {
                Complex::new(1.0, 0.0)
            };
            let m = force_per_force(&cut, s);
            let add = |j: usize| (over[j] + m[j][0] * times[0] + m[j][1] * times[1]) * undo;
            seen.push([add(0), add(1)]);
            if probe {
                moved.push([cut.bar_response(s) * (times[0] - times[1]) * undo / PROBE_UNIT_M, ZERO]);
            }
        }
        let innovations = self.windowed(&seen);
        let moved = if probe { self.windowed(&moved) } else { Vec::new() };
        let share = CRITERIA.followed_share.powi(2);
        let step = rate / self.shaped_window.len() as f64;
        let unstable = self.growth_share(&cut);
        let bins = self.bins.iter().zip(&self.measured).step_by(every.0).map(|((k, f), (power, y))| {
            let s = Complex::new(0.0, TAU * f);
            let (sensor, folded) = (machine.noise.sensor_n2_hz(*f), self.place.folded_1_hz(*f));
            let noise = [
                sensor + random[0] * folded,
                sensor + random[1] * folded,
                (machine.noise.probe_m / PROBE_UNIT_M).powi(2) * 2.0 / rate,
            ];
            // The window smears what the noise becomes near the bar's own frequency, where it is narrow.
            let mut matrix = [[ZERO; CHANNELS]; CHANNELS];
            let mut jacobian = 0.0;
            for (offset, weight) in SMEARED {
                let s = Complex::new(0.0, TAU * (f + offset * step));
                let way = Self::way(&force_per_force(&cut, s), cut.bar_response(s) / PROBE_UNIT_M);
                jacobian += (way[0][0] * way[1][1] - way[0][1] * way[1][0]).norm_sqr() * weight;
                for a in 0..CHANNELS {
                    for b in 0..CHANNELS {
                        let sum: Complex<f64> =
                            (0..CHANNELS).map(|c| way[a][c] * way[b][c].conj() * noise[c]).sum();
                        matrix[a][b] += sum * weight;
                    }
                }
            }
            let spectrum = random_force_spectrum_1_hz(*f);
            for j in 0..2 {
                matrix[j][j] += random[j] * spectrum + share * power[j];
            }
            let g = cut.bar_response(s).norm_sqr() / PROBE_UNIT_M.powi(2);
            matrix[2][2] += g * share * (power[0] + power[1]);
            let third = if probe { *y + moved[*k][0] } else { ZERO };
            let mut bin = self.place.select(*f, [innovations[*k][0], innovations[*k][1], third], &matrix);
            bin.log_jacobian = jacobian.ln() - unstable;
            bin
        });
        Part::Bins { channels: self.place.used.len(), bins: bins.collect() }
    }

    fn left_over(&self, machine: &Machine) -> Option<LeftOver> {
        let cut = CutLoop::new(&CutTerms::of(&machine.scenario, &self.place.condition));
        let Part::Bins { bins, .. } = self.part(machine, Every(1)) else { return None };
        let bin_hz = (CRITERIA.band_hz[1] - CRITERIA.band_hz[0]) / bins.len().max(1) as f64;
        Some(innovation_power(&self.place, &cut, &bins, Way::Innovations) * bin_hz)
    }

    fn origin(&self) -> Origin {
        self.place.origin
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::{machine, recording};
    use super::*;
    use crate::plant::cut_terms::CutCondition;
    use crate::stability::rightmost_cut_root;

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
        let m = force_per_force(&cut, s);
        let ratio = -(m[0][0] + 1.0) / m[0][1];
        let force = |t: f64| {
            let swell = (s * (t - 0.8)).exp() * 20.0;
            [50.0 + swell.re, 50.0 + (swell * ratio).re]
        };
        let cuts = recording(&machine.scenario, 0.9, force);
        let stretch = Stretch { recording: 0, samples: 5000..7200 };
        let followed = FollowedSpectra::new(&cuts, &stretch, &machine.scenario, false).expect("followed");
        let Part::Bins { bins, .. } = followed.part(&machine, Every(1)) else { panic!("bins") };
        let left: f64 = bins.iter().map(|b| b.x[0].norm_sqr() + b.x[1].norm_sqr()).sum();
        let had: f64 = followed.measured.iter().map(|m| m.0[0] + m.0[1]).sum();
        assert!(had > 0.01 && left < 1e-4 * had, "{left:e} of {had:e}");
    }
}
