//! The frozen judge of the chatter detector: streams of `cut_streams`, which shares nothing with it.
//!
//! The counts are exact. Seeds from 1001 on are not for looking at: they are scored once, when a detector is
//! finished (`cargo run --release --example results -- chatter --first-seed N`).

use crate::cut_streams::Kind;
use crate::stream_score::score;

/// Kind, episodes found of six, alarms in them, false alarms, and what the median delay is below, s.
const EXPECTED: [(Kind, [usize; 3], f64); 6] = [
    (Kind::Stable, [0, 0, 0], 0.0),
    (Kind::Chatter, [6, 9, 0], 0.1),
    (Kind::ChatterAtEntry, [6, 9, 0], 0.2),
    (Kind::Hits, [0, 0, 0], 0.0),
    (Kind::Orders, [0, 0, 0], 0.0),
    (Kind::Servo, [0, 0, 0], 0.0),
];

#[test]
fn the_frozen_streams_are_scored_as_they_were() {
    for (kind, [found, alarms, false_alarms], below_s) in EXPECTED {
        let score = score(kind, 1..7);
        let counts = [score.found, score.alarms, score.false_alarms];
        assert_eq!(counts, [found, alarms, false_alarms], "{kind:?}: {score:?}");
        let median_s = score.delays_s.get(score.delays_s.len() / 2).copied().unwrap_or(0.0);
        assert!(median_s <= below_s, "{kind:?}: {score:?}");
        println!("{kind:?}: delays over the bound {:.2?}", score.over_bound);
        assert_eq!(score.episodes, if found > 0 { 6 } else { 0 }, "{kind:?}");
    }
}
