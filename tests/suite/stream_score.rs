//! What a detector reports of the streams of `cut_streams`, counted.

use crate::cut_streams::{Episode, Kind, RATE_HZ, stream};
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
}

/// Times at which alarms began.
fn onsets(kind: Kind, seed: u64) -> (Vec<f64>, Vec<Episode>) {
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
    (found, made.episodes)
}

/// Counts over seeds: those up to 1000 are for looking at, the others are scored once.
pub(crate) fn score(kind: Kind, seeds: std::ops::Range<u64>) -> Score {
    let mut score = Score::default();
    for seed in seeds {
        let (mut free, episodes) = onsets(kind, seed);
        for episode in &episodes {
            let during = |t: &f64| (episode.unstable_s - 0.05..episode.end_s + 0.5).contains(t);
            score.episodes += 1;
            score.alarms += free.iter().filter(|t| during(t)).count();
            if let Some(first) = free.iter().copied().find(|t| during(t)) {
                score.found += 1;
                score.delays_s.push(first - episode.onset_s);
            }
            free.retain(|t| !during(t));
        }
        score.false_alarms += free.len();
    }
    score.delays_s.sort_by(f64::total_cmp);
    score
}
