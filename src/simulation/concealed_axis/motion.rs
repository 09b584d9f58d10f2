//! What the axis is told to do: a sweep, slow strokes to and fro, and a run of quick moves.

use rand::{Rng, RngExt};
use std::f64::consts::TAU;

/// Commands of one recording, one value a sample.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Motion {
    /// Free word for the file.
    pub(super) experiment: &'static str,
    /// Position command, m.
    pub(super) position_m: Vec<f64>,
    /// Current added to what the controller asks for, A.
    pub(super) injected_a: Vec<f64>,
}

/// Builds a position command move by move.
struct Track {
    period_s: f64,
    position_m: Vec<f64>,
}

impl Track {
    fn new(period_s: f64, start_m: f64) -> Self {
        Self { period_s, position_m: vec![start_m] }
    }

    fn last(&self) -> f64 {
        self.position_m.last().copied().unwrap_or(0.0)
    }

    fn dwell(&mut self, seconds: f64) {
        let samples = (seconds / self.period_s).round() as usize;
        let here = self.last();
        self.position_m.extend(std::iter::repeat_n(here, samples));
    }

    /// One move at `speed` with raised-cosine acceleration up to `accel`; slower where the way is short.
    ///
    /// Ramp: a(t) = a_max (1 - cos(2 pi t/T))/2, so v = a_max T/2 and the ramp covers v T/2.
    fn go(&mut self, target_m: f64, speed_m_s: f64, accel_m_s2: f64) {
        let (start, way) = (self.last(), target_m - self.last());
        let length = way.abs();
        if length == 0.0 {
            return;
        }
        // Both ramps together cover v T = 2 v^2 / a.
        let speed = speed_m_s.min((0.5 * length * accel_m_s2).sqrt());
        let ramp = 2.0 * speed / accel_m_s2;
        let cruise = length / speed - ramp;
        let total = 2.0 * ramp + cruise;
        let samples = (total / self.period_s).ceil() as usize;
        let covered = |t: f64| {
            let u = t / ramp;
            speed * ramp * (0.5 * u * u + ((TAU * u).cos() - 1.0) / (TAU * TAU))
        };
        for k in 1..=samples {
            let t = (k as f64 * self.period_s).min(total);
            let s = if t < ramp {
                covered(t)
            } else if t < ramp + cruise {
                0.5 * speed * ramp + speed * (t - ramp)
            } else {
                length - covered(total - t)
            };
            self.position_m.push(start + way.signum() * s);
        }
    }
}

/// Scales of the experiments, from the axis itself.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scales {
    /// Sample period, s.
    pub(super) period_s: f64,
    /// Amplitude of the swept sine, A.
    pub(super) sweep_a: f64,
    /// Highest frequency of the swept sine, Hz.
    pub(super) sweep_hz: f64,
    /// Half of the stroke, m.
    pub(super) reach_m: f64,
}

/// Swept sine in current on top of a stroke at constant speed, forth and back.
pub(super) fn sweep(scales: &Scales, rng: &mut impl Rng) -> Motion {
    let speed = 10.0e-3 * rng.random_range(0.85..1.15);
    let mut track = Track::new(scales.period_s, -scales.reach_m);
    let mut bursts = Vec::new();
    for (target, share) in [(scales.reach_m, 1.0), (-scales.reach_m, rng.random_range(0.6..0.9))] {
        let start = track.position_m.len();
        track.go(target, speed, 0.4);
        let stop = track.position_m.len();
        bursts.push((start, stop, share * scales.sweep_a));
        track.dwell(0.05);
    }
    let mut injected_a = vec![0.0; track.position_m.len()];
    for (start, stop, amplitude) in bursts {
        let lead = (0.4 / scales.period_s) as usize;
        let (from, to) = (start + lead, stop - lead.min(stop) / 2);
        let seconds = (to - from) as f64 * scales.period_s;
        // Exponential sweep from 5 Hz: phase = 2 pi f0 T / ln(f1/f0) (exp(t ln(f1/f0)/T) - 1).
        let ratio = (scales.sweep_hz / 5.0).ln();
        for (k, value) in injected_a[from..to].iter_mut().enumerate() {
            let t = k as f64 * scales.period_s;
            *value = amplitude * (TAU * 5.0 * seconds / ratio * ((t / seconds * ratio).exp() - 1.0)).sin();
        }
    }
    Motion { experiment: "sweep", position_m: track.position_m, injected_a }
}

/// Strokes to and fro at six speeds, from creep to traverse.
pub(super) fn idle(scales: &Scales, rng: &mut impl Rng) -> Motion {
    let mut track = Track::new(scales.period_s, 0.0);
    let first = 0.9e-3_f64.min(scales.reach_m);
    track.position_m[0] = -first;
    for speed_mm_s in [1.0, 2.0, 5.0, 10.0, 20.0, 40.0] {
        let speed: f64 = speed_mm_s * 1.0e-3 * rng.random_range(0.85..1.15);
        let reach = (0.9 * speed).min(scales.reach_m);
        track.go(-reach, 15.0e-3, 0.4);
        track.dwell(0.02);
        track.go(reach, speed, 0.8);
        track.dwell(0.05);
        track.go(-reach, speed, 0.8);
        track.dwell(0.02);
    }
    let injected_a = vec![0.0; track.position_m.len()];
    Motion { experiment: "idle", position_m: track.position_m, injected_a }
}

/// Some twenty moves of random length with short pauses.
pub(super) fn moves(scales: &Scales, rng: &mut impl Rng) -> Motion {
    let mut track = Track::new(scales.period_s, 0.0);
    while (track.position_m.len() as f64) * scales.period_s < 2.9 {
        let length = 10.0e-3 * rng.random_range(0.0_f64..1.0).powi(2);
        let sign = if rng.random_bool(0.5) { 1.0 } else { -1.0 };
        let mut target = track.last() + sign * length;
        if target.abs() > 1.1 * scales.reach_m {
            target = track.last() - sign * length;
        }
        track.go(target, 60.0e-3, 2.0 * rng.random_range(0.9..1.1));
        track.dwell(rng.random_range(0.01..0.06));
    }
    let injected_a = vec![0.0; track.position_m.len()];
    Motion { experiment: "moves", position_m: track.position_m, injected_a }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_ends_where_it_was_sent_and_keeps_its_limits() {
        for target in [3.0e-3, 20.0e-6, -15.0e-3] {
            let mut track = Track::new(1.0e-4, 0.0);
            track.go(target, 60.0e-3, 2.0);
            let x = &track.position_m;
            assert!((track.last() - target).abs() < 1.0e-15);
            let fastest = x.windows(2).map(|w| (w[1] - w[0]).abs() / 1.0e-4).fold(0.0, f64::max);
            assert!(fastest <= 60.0e-3 * 1.0001, "{fastest}");
            let strongest =
                x.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).abs() / 1.0e-8).fold(0.0, f64::max);
            assert!(strongest < 2.0 * 1.02, "{strongest} m/s2 towards {target}");
        }
    }
}
