//! What a detector reports of the streams of `cut_streams`, counted.

use crate::cut_streams::{Episode, Kind, RATE_HZ, Stream, stream};
use std::f64::consts::TAU;
use stillcut::chatter::{Band, ChatterEvent, ChatterMonitor, ChatterSettings, FALSE_ALARM_S, MeanForce};
use stillcut::units::SampleRate;

/// What was reported of the streams of one kind.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Score {
    /// Stretches of chatter.
    pub(crate) episodes: usize,
    /// Of these, those with an alarm.
    pub(crate) found: usize,
    /// Alarms outside of every episode.
    pub(crate) false_alarms: usize,
    /// Alarms inside of them.
    pub(crate) alarms: usize,
    /// From the onset, s, in order.
    pub(crate) delays_s: Vec<f64>,
    /// The same over the bound, see [`bound_s`].
    pub(crate) over_bound: Vec<f64>,
}

/// Times at which alarms began, and the stream.
fn onsets(kind: Kind, seed: u64) -> (Vec<f64>, Stream) {
    let made = stream(kind, 10 * seed + kind as u64);
    let settings = ChatterSettings {
        sample_rate: SampleRate::new(RATE_HZ).unwrap(),
        band: Band::new(made.band_hz[0], made.band_hz[1]).unwrap(),
        mean: MeanForce::Whole,
        false_alarm_s: FALSE_ALARM_S,
    };
    let monitor = ChatterMonitor::new(settings).unwrap();
    let (mut state, mut found) = (monitor.start(), Vec::new());
    for (n, (force_n, speed_rpm)) in made.force_n.iter().zip(&made.speed_rpm).enumerate() {
        let event = monitor.step(&mut state, *force_n, Some(*speed_rpm));
        if let Some(ChatterEvent::Onset(_)) = event {
            found.push((n + 1) as f64 / RATE_HZ);
        }
    }
    (found, made)
}

/// Counts over seeds: those up to 1000 are for looking at, the others are scored once.
pub(crate) fn score(kind: Kind, seeds: std::ops::Range<u64>) -> Score {
    let mut score = Score::default();
    for seed in seeds {
        let (mut free, made) = onsets(kind, seed);
        for episode in &made.episodes {
            let during = |t: &f64| (episode.unstable_s - 0.05..episode.end_s + 0.5).contains(t);
            score.episodes += 1;
            score.alarms += free.iter().filter(|t| during(t)).count();
            if let Some(first) = free.iter().copied().find(|t| during(t)) {
                score.found += 1;
                score.delays_s.push(first - episode.onset_s);
                score.over_bound.push((first - episode.onset_s) / bound_s(&made, episode));
            }
            free.retain(|t| !during(t));
        }
        score.false_alarms += free.len();
    }
    score.delays_s.sort_by(f64::total_cmp);
    score.over_bound.sort_by(f64::total_cmp);
    score
}

/// From the onset, s, until no test of one false alarm in 1000 h can be surer, not even one that knows the
/// line beforehand: the log-likelihood ratio of a line of amplitude A in noise of one-sided density S gathers
/// as the integral of A^2/(2 S). Its place, its amplitude and the noise of the second before it are measured
/// in the force: the noise by its median in 40 Hz, of which the orders are few.
fn bound_s(made: &Stream, episode: &Episode) -> f64 {
    const NATS: f64 = 24.0;
    const BLOCK_S: f64 = 0.01;
    let sample = |t: f64| (t * RATE_HZ) as usize;
    let power = |from_s: f64, long_s: f64, hz: f64| {
        let values = &made.force_n[sample(from_s)..sample(from_s + long_s)];
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let wave = |(n, x): (usize, &f64)| {
            let (sin, cos) = (TAU * hz * n as f64 / RATE_HZ).sin_cos();
            [(x - mean) * cos, (x - mean) * sin]
        };
        let sum = values.iter().enumerate().map(wave).fold([0.0; 2], |s, w| [s[0] + w[0], s[1] + w[1]]);
        // A^2 of a line of amplitude A.
        4.0 * (sum[0] * sum[0] + sum[1] * sum[1]) / (values.len() as f64).powi(2)
    };
    let [low, high] = made.band_hz;
    let places = (low as u32..high as u32).map(f64::from);
    let grown = |hz: &f64| power(episode.end_s - 1.0, 0.5, *hz);
    let line_hz = places.max_by(|a, b| grown(a).total_cmp(&grown(b))).unwrap_or(low);
    let around = (-20..=20).map(|k| line_hz + f64::from(k));
    let mut noise: Vec<f64> = around.map(|hz| power(episode.unstable_s - 1.05, 1.0, hz)).collect();
    noise.sort_by(f64::total_cmp);
    // A^2 of noise in T seconds is 2 S/T in the mean, and its median ln 2 of that.
    let density = noise[noise.len() / 2] / (2.0 * std::f64::consts::LN_2);
    let (mut nats, mut t) = (0.0, episode.onset_s);
    while nats < NATS && t < episode.end_s {
        let line = power(t, BLOCK_S, line_hz) - 2.0 * density / BLOCK_S;
        nats += line * BLOCK_S / (2.0 * density);
        t += BLOCK_S;
    }
    t - episode.onset_s
}
