//! Past cuts as the pipeline thread hears them: stretches at one speed and one pitch, chatter or stable.
//!
//! The servo stream does not say whether the tools cut. What changes the mean force or the noise at once, and
//! chatter that begins or ends, divides the time into runs; one that does not chatter is a cut where it is
//! louder than what stood before and after it, or stands beside chatter. What these cannot tell is not told.

use super::engine::is_same_pitch;
use crate::chatter::ChatterEvent;
use std::collections::VecDeque;

/// When a stretch is told, with the reason of each number.
struct Criteria;

impl Criteria {
    /// Chatter that grows by 5 1/s is 150 times as large after it, and heard.
    const SHORTEST_S: f64 = 1.0;
    /// Speeds this close are the same: drives hold theirs to a few parts in a thousand.
    const SAME_SPEED: f64 = 0.01;
    /// Every axis hears a change for itself within the detector's window of the mean force.
    const ONE_CHANGE_S: f64 = 0.34;
}

/// Most stretches that wait for the end of their run: a pitch is tried once a second.
const WAITING: usize = 64;

/// What the cut is made with at a moment.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Condition {
    pub(super) speed_rpm: f64,
    pub(super) pitch_rad: f64,
    /// Tools from the chuck, where an axis of the stream tells it, m.
    pub(super) tool_position_m: Option<f64>,
}

impl Condition {
    fn is_like(&self, other: &Self) -> bool {
        (self.speed_rpm - other.speed_rpm).abs() <= Criteria::SAME_SPEED * other.speed_rpm
            && is_same_pitch(self.pitch_rad, other.pitch_rad)
    }
}

/// A stretch that is over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Stretch {
    /// Machine's clock, s.
    pub(super) began_s: f64,
    pub(super) ended_s: f64,
    /// Of a stable cut where the bar gives most, of chatter where it began.
    pub(super) condition: Condition,
    /// Frequency of its chatter.
    pub(super) chatter_hz: Option<f64>,
}

impl Stretch {
    fn is_short(&self) -> bool {
        self.ended_s - self.began_s < Criteria::SHORTEST_S
    }
}

/// Time between two changes.
#[derive(Debug, Default)]
struct Run {
    stretches: Vec<Stretch>,
    chatter: bool,
    /// Sum of the logarithms of the loudest line's power, and of how many.
    loudness: (f64, u32),
}

impl Run {
    fn loudness(&self) -> f64 {
        if self.chatter { f64::INFINITY } else { self.loudness.0 / f64::from(self.loudness.1.max(1)) }
    }

    /// Goes on with the stretch at hand, or begins one where the condition is another.
    fn look(&mut self, t_s: f64, now: Condition, power_n2: f64) {
        if power_n2 > 0.0 {
            self.loudness = (self.loudness.0 + power_n2.ln(), self.loudness.1.saturating_add(1));
        }
        if let Some(stretch) = self.stretches.last_mut().filter(|s| s.condition.is_like(&now)) {
            stretch.ended_s = t_s;
            let places = now.tool_position_m.zip(stretch.condition.tool_position_m);
            stretch.condition.tool_position_m = places.map(|(a, b)| a.max(b));
            return;
        }
        // What was too short on the way to this condition makes room.
        if self.stretches.last().is_some_and(Stretch::is_short) || self.stretches.len() >= WAITING {
            self.stretches.pop();
        }
        self.stretches.push(Stretch { began_s: t_s, ended_s: t_s, condition: now, chatter_hz: None });
    }
}

/// The book.
#[derive(Debug, Default)]
pub(super) struct CutBook {
    /// How loud the run before the last was.
    before: Option<f64>,
    /// The last run, which waits for how loud this one is.
    last: Option<Run>,
    now: Run,
    newest: Condition,
    /// In what the last chatter began: what is silent there later differs in something that is not seen here.
    chattered: Option<Condition>,
    changed_s: Option<f64>,
    told: VecDeque<Stretch>,
}

impl CutBook {
    /// A look at the stream, once a batch: time, condition and power of the loudest line.
    pub(super) fn look(&mut self, t_s: f64, condition: Condition, power_n2: f64) {
        if condition.speed_rpm > 0.0 {
            self.now.look(t_s, condition, power_n2);
            self.newest = condition;
        }
    }

    /// What the detector says began or ended.
    pub(super) fn hear(&mut self, t_s: f64, event: &ChatterEvent) {
        match event {
            ChatterEvent::Onset(line) => {
                self.turn();
                self.now.chatter = true;
                // It grew in the condition of the stretch that ends here.
                let grew = self.last.as_mut().and_then(|run| run.stretches.pop());
                self.told.extend(grew.map(|stretch| Stretch {
                    ended_s: t_s,
                    condition: Condition {
                        tool_position_m: self.newest.tool_position_m,
                        ..stretch.condition
                    },
                    chatter_hz: Some(line.frequency_hz),
                    ..stretch
                }));
                self.chattered = grew.map(|stretch| stretch.condition);
            }
            ChatterEvent::End => self.turn(),
            ChatterEvent::CutChanged => {
                let same = self.changed_s.replace(t_s).is_some_and(|at| t_s - at < Criteria::ONE_CHANGE_S);
                if !same && !self.now.chatter {
                    self.turn();
                }
            }
            ChatterEvent::Dismissed(_) | ChatterEvent::Hop { .. } => {}
        }
    }

    /// The oldest stretch that was found to be a cut and not taken yet.
    pub(super) fn take(&mut self) -> Option<Stretch> {
        self.told.pop_front()
    }

    /// A run is over: the one before it is judged.
    fn turn(&mut self) {
        let ended = std::mem::take(&mut self.now);
        let follows = ended.loudness();
        let Some(last) = self.last.replace(ended) else { return };
        let loudness = last.loudness();
        let stands_out = |beside: f64| beside == f64::INFINITY || loudness > beside;
        if !last.chatter && self.before.is_some_and(stands_out) && stands_out(follows) {
            let after_chatter = self.before == Some(f64::INFINITY);
            let silenced =
                |s: &Stretch| after_chatter && self.chattered.is_some_and(|c| c.is_like(&s.condition));
            self.told.extend(last.stretches.iter().filter(|s| !s.is_short() && !silenced(s)));
        }
        self.before = Some(loudness);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chatter::Line;

    /// Runs of (duration, speed, pitch, power), each with what the detector says at its end.
    fn told(runs: &[(f64, f64, f64, f64, Option<ChatterEvent>)]) -> Vec<(f64, f64, Option<f64>)> {
        let (mut book, mut t_s) = (CutBook::default(), 0.0);
        for (lasts_s, speed, pitch, power, event) in runs {
            for _ in 0..(lasts_s / 0.01).round() as usize {
                t_s += 0.01;
                let now = Condition {
                    speed_rpm: *speed,
                    pitch_rad: *pitch,
                    tool_position_m: Some(0.18 - 1e-3 * t_s),
                };
                book.look(t_s, now, *power);
            }
            event.iter().for_each(|e| book.hear(t_s, e));
        }
        let row = |s: Stretch| (s.condition.speed_rpm, s.condition.pitch_rad, s.chatter_hz);
        std::iter::from_fn(|| book.take()).map(row).collect()
    }

    fn onset() -> Option<ChatterEvent> {
        let line = Line { frequency_hz: 650.0, power_n2: 9.0, growth_1_s: 8.0, contrast: 50.0 };
        Some(ChatterEvent::Onset(line))
    }

    const CHANGED: Option<ChatterEvent> = Some(ChatterEvent::CutChanged);
    const END: Option<ChatterEvent> = Some(ChatterEvent::End);

    #[test]
    fn cuts_are_told_and_the_air_between_them_is_not() {
        // Air, cut, air, cut at another speed, air; the last air is heard as such when it ends.
        let (air, cut) = (1e-3, 4e-2);
        let runs = [
            (5.0, 1200.0, 0.0, air, CHANGED),
            (8.0, 1200.0, 0.0, cut, CHANGED),
            (3.0, 1500.0, 0.0, air, CHANGED),
            (8.0, 1500.0, 0.0, cut, CHANGED),
            (3.0, 1500.0, 0.0, air, CHANGED),
        ];
        assert_eq!(told(&runs), [(1200.0, 0.0, None), (1500.0, 0.0, None)]);
    }

    #[test]
    fn a_pitch_that_ends_chatter_is_a_cut_of_its_own() {
        // Entry, chatter, the turret moves by steps, silence, exit, air.
        let moving: Vec<_> = (1..10).map(|k| (0.05, 1200.0, 0.01 * f64::from(k), 5.0, None)).collect();
        let mut runs = vec![(5.0, 1200.0, 0.0, 1e-3, CHANGED), (1.5, 1200.0, 0.0, 4e-2, onset())];
        runs.extend(moving);
        runs.extend([(0.6, 1200.0, 0.1, 1.0, END), (6.0, 1200.0, 0.1, 4e-2, CHANGED)]);
        runs.extend([(3.0, 1200.0, 0.1, 1e-3, CHANGED), (1.0, 1200.0, 0.1, 4e-2, CHANGED)]);
        assert_eq!(told(&runs), [(1200.0, 0.0, Some(650.0)), (1200.0, 0.1, None)]);
    }

    #[test]
    fn chatter_that_ends_with_the_cut_leaves_air_untold() {
        let runs = [
            (5.0, 1200.0, 0.0, 1e-3, CHANGED),
            (1.5, 1200.0, 0.0, 4e-2, onset()),
            (2.0, 1200.0, 0.0, 9.0, END),
            (6.0, 1200.0, 0.0, 1e-3, CHANGED),
            (5.0, 1200.0, 0.0, 4e-2, CHANGED),
            (5.0, 1200.0, 0.0, 1e-3, CHANGED),
        ];
        assert_eq!(told(&runs), [(1200.0, 0.0, Some(650.0)), (1200.0, 0.0, None)]);
    }

    #[test]
    fn chatter_that_ends_where_nothing_seen_changed_leaves_no_stable_cut() {
        let runs = [
            (5.0, 1200.0, 0.0, 1e-3, CHANGED),
            (1.5, 1200.0, 0.0, 4e-2, onset()),
            (2.0, 1200.0, 0.0, 9.0, END),
            (6.0, 1200.0, 0.0, 4e-2, CHANGED),
            (5.0, 1200.0, 0.0, 1e-3, CHANGED),
            (5.0, 1200.0, 0.0, 4e-2, CHANGED),
        ];
        assert_eq!(told(&runs), [(1200.0, 0.0, Some(650.0))]);
    }

    #[test]
    fn a_spindle_that_stands_and_a_run_of_a_moment_are_no_cuts() {
        let runs = [
            (5.0, 1200.0, 0.0, 1e-3, CHANGED),
            (0.5, 1200.0, 0.0, 4e-2, CHANGED),
            (5.0, 1200.0, 0.0, 1e-3, CHANGED),
            (5.0, 0.0, 0.0, 4e-2, CHANGED),
            (5.0, 1200.0, 0.0, 1e-3, CHANGED),
        ];
        assert_eq!(told(&runs), []);
    }
}
