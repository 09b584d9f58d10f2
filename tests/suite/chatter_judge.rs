//! The frozen judge of the chatter detector: streams of `cut_streams`, which shares nothing with it.
//!
//! The counts are exact. Seeds from 1001 on are not for looking at: they are scored once, when a detector is
//! finished.

use crate::cut_streams::{Kind, RATE_HZ, stream};
use stillcut::chatter::{Band, ChatterEvent, ChatterMonitor, ChatterSettings, FALSE_ALARM_S, MeanForce};
use stillcut::units::SampleRate;

/// What was reported of the streams of one kind.
#[derive(Debug, Default, PartialEq)]
struct Score {
    episodes: usize,
    found: usize,
    /// Alarms outside of every episode.
    false_alarms: usize,
    /// Alarms inside of them.
    alarms: usize,
    /// From the onset, s; the later of the two middle ones.
    median_delay_s: f64,
}

/// Times at which alarms began.
fn onsets(kind: Kind, seed: u64) -> (Vec<f64>, Vec<crate::cut_streams::Episode>) {
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

fn score(kind: Kind, seeds: std::ops::Range<u64>) -> Score {
    let (mut score, mut delays) = (Score::default(), Vec::new());
    for seed in seeds {
        let (mut free, episodes) = onsets(kind, seed);
        for episode in &episodes {
            let during = |t: &f64| (episode.unstable_s - 0.05..episode.end_s + 0.5).contains(t);
            score.episodes += 1;
            score.alarms += free.iter().filter(|t| during(t)).count();
            if let Some(first) = free.iter().copied().find(|t| during(t)) {
                score.found += 1;
                delays.push(first - episode.onset_s);
            }
            free.retain(|t| !during(t));
        }
        score.false_alarms += free.len();
    }
    delays.sort_by(f64::total_cmp);
    score.median_delay_s = delays.get(delays.len() / 2).copied().unwrap_or(0.0);
    score
}

/// Kind, episodes found of six, alarms in them, false alarms, and what the median delay is below, s.
const EXPECTED: [(Kind, [usize; 3], f64); 6] = [
    (Kind::Stable, [0, 0, 0], 0.0),
    (Kind::Chatter, [6, 11, 1], 0.1),
    (Kind::ChatterAtEntry, [6, 10, 0], 0.34),
    (Kind::Hits, [0, 0, 0], 0.0),
    (Kind::Orders, [0, 0, 0], 0.0),
    (Kind::Servo, [0, 0, 1], 0.0),
];

#[test]
fn the_frozen_streams_are_scored_as_they_were() {
    for (kind, [found, alarms, false_alarms], below_s) in EXPECTED {
        let score = score(kind, 1..7);
        let counts = [score.found, score.alarms, score.false_alarms];
        assert_eq!(counts, [found, alarms, false_alarms], "{kind:?}: {score:?}");
        assert!(score.median_delay_s <= below_s, "{kind:?}: {score:?}");
        assert_eq!(score.episodes, if found > 0 { 6 } else { 0 }, "{kind:?}");
    }
}
