//! Past cuts as the pipeline thread hears them: stretches at one speed and one pitch, chatter or stable.

use crate::avoidance::pitch::is_same_pitch;
use crate::chatter::ChatterEvent;
use std::collections::VecDeque;

/// When a stretch is told, with the reason of each number.
struct Criteria;

impl Criteria {
    /// Chatter that grows by 5 1/s is 150 times as large after it, and heard.
    const SHORTEST_S: f64 = 1.0;
    /// Speeds this close are the same: drives hold theirs to a few parts in a thousand. Places, too: the bar
    /// gives with the cube of the way from the chuck.
    const SAME: f64 = 0.01;
}

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
        (self.speed_rpm - other.speed_rpm).abs() <= Criteria::SAME * other.speed_rpm
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
    /// The place nearest to the chuck, m.
    pub(super) nearest_m: Option<f64>,
    /// Frequency of its chatter.
    pub(super) chatter_hz: Option<f64>,
    /// The same cut had chattered before.
    pub(super) after_chatter: bool,
}

impl Stretch {
    /// True where the tools are not known to have travelled: what was heard is of one place.
    pub(super) fn is_at_one_place(&self) -> bool {
        let places = self.condition.tool_position_m.zip(self.nearest_m);
        places.is_none_or(|(far, near)| far - near <= Criteria::SAME * far)
    }

    fn is_short(&self) -> bool {
        self.ended_s - self.began_s < Criteria::SHORTEST_S
    }
}

/// The book.
#[derive(Debug, Default)]
pub(super) struct CutBook {
    /// What is being cut, while the tools cut and nothing chatters.
    now: Option<Stretch>,
    newest: Condition,
    chatter: bool,
    /// In what the last chatter of this cut began: what is silent there later differs in something that is
    /// not seen here.
    chattered: Option<Condition>,
    told: VecDeque<Stretch>,
}

impl CutBook {
    /// A look at the stream, once a batch. `in_cut`: whether the tools cut, where that is known.
    pub(super) fn look(&mut self, t_s: f64, condition: Condition, in_cut: Option<bool>) {
        self.newest = condition;
        if in_cut != Some(true) || self.chatter || condition.speed_rpm <= 0.0 {
            self.close();
            self.chattered = self.chattered.filter(|_| in_cut != Some(false));
            return;
        }
        if let Some(stretch) = self.now.as_mut().filter(|s| s.condition.is_like(&condition)) {
            stretch.ended_s = t_s;
            let places = condition.tool_position_m.zip(stretch.condition.tool_position_m);
            stretch.condition.tool_position_m = places.map(|(a, b)| a.max(b));
            stretch.nearest_m = condition.tool_position_m.zip(stretch.nearest_m).map(|(a, b)| a.min(b));
            return;
        }
        self.close();
        let (nearest_m, after_chatter) = (condition.tool_position_m, self.chattered.is_some());
        let (began_s, ended_s) = (t_s, t_s);
        self.now = Some(Stretch { began_s, ended_s, condition, nearest_m, chatter_hz: None, after_chatter });
    }

    /// What the detector says began or ended.
    pub(super) fn hear(&mut self, t_s: f64, event: &ChatterEvent) {
        match event {
            ChatterEvent::Onset(line) => {
                // It grew in the condition that it begins in.
                let began_s = self.now.take().map_or(t_s, |s| s.began_s);
                let chatter_hz = Some(line.frequency_hz);
                let (condition, ended_s, after_chatter) = (self.newest, t_s, self.chattered.is_some());
                let nearest_m = condition.tool_position_m;
                let heard = Stretch { began_s, ended_s, condition, nearest_m, chatter_hz, after_chatter };
                self.told.push_back(heard);
                (self.chatter, self.chattered) = (true, Some(self.newest));
            }
            ChatterEvent::End => self.chatter = false,
            ChatterEvent::CutChanged | ChatterEvent::Dismissed(_) | ChatterEvent::Hop { .. } => {}
        }
    }

    /// The oldest stretch that is over and not taken yet.
    pub(super) fn take(&mut self) -> Option<Stretch> {
        self.told.pop_front()
    }

    /// Nothing is cut any more as it was.
    fn close(&mut self) {
        let silenced = |s: &Stretch| self.chattered.is_some_and(|c| c.is_like(&s.condition));
        self.told.extend(self.now.take().filter(|s| !s.is_short() && !silenced(s)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chatter::Line;

    const CUT: Option<bool> = Some(true);
    const AIR: Option<bool> = Some(false);
    const END: Option<ChatterEvent> = Some(ChatterEvent::End);

    fn onset() -> Option<ChatterEvent> {
        let line = Line { frequency_hz: 650.0, power_n2: 9.0, growth_1_s: 8.0, contrast: 50.0 };
        Some(ChatterEvent::Onset(line))
    }

    /// A stretch: duration in s, speed in rpm, pitch in rad, whether the tools cut, and what the detector
    /// says at its end.
    type Run = (f64, f64, f64, Option<bool>, Option<ChatterEvent>);

    fn told(runs: &[Run]) -> Vec<(f64, f64, Option<f64>)> {
        let (mut book, mut t_s) = (CutBook::default(), 0.0);
        for (lasts_s, speed_rpm, pitch_rad, in_cut, event) in runs {
            for _ in 0..(lasts_s / 0.01).round() as usize {
                t_s += 0.01;
                let tool_position_m = Some(0.18 - 1e-3 * t_s);
                let now = Condition { speed_rpm: *speed_rpm, pitch_rad: *pitch_rad, tool_position_m };
                book.look(t_s, now, *in_cut);
            }
            event.iter().for_each(|e| book.hear(t_s, e));
        }
        let row = |s: Stretch| (s.condition.speed_rpm, s.condition.pitch_rad, s.chatter_hz);
        std::iter::from_fn(|| book.take()).map(row).collect()
    }

    #[test]
    fn stable_cuts_are_told_and_air_and_moments_are_not() {
        let runs = [
            (5.0, 1200.0, 0.0, None, None),
            (5.0, 1200.0, 0.0, AIR, None),
            (8.0, 1200.0, 0.0, CUT, None),
            (3.0, 1500.0, 0.0, CUT, None),
            (3.0, 1500.0, 0.0, AIR, None),
            (0.5, 1500.0, 0.0, CUT, None),
            (5.0, 0.0, 0.0, CUT, None),
            (1.0, 1500.0, 0.0, AIR, None),
        ];
        assert_eq!(told(&runs), [(1200.0, 0.0, None), (1500.0, 0.0, None)]);
    }

    #[test]
    fn a_pitch_that_ends_chatter_is_a_cut_of_its_own() {
        // Entry, chatter, the turret moves by steps, silence, exit, air.
        let mut runs = vec![(5.0, 1200.0, 0.0, AIR, None), (1.5, 1200.0, 0.0, CUT, onset())];
        runs.extend((1..10).map(|k| (0.05, 1200.0, 0.01 * f64::from(k), CUT, None)));
        runs.extend([
            (0.6, 1200.0, 0.1, CUT, END),
            (6.0, 1200.0, 0.1, CUT, None),
            (3.0, 1200.0, 0.1, AIR, None),
        ]);
        assert_eq!(told(&runs), [(1200.0, 0.0, Some(650.0)), (1200.0, 0.1, None)]);
    }

    #[test]
    fn a_stretch_says_whether_its_cut_had_chattered() {
        let (mut book, mut t_s) = (CutBook::default(), 0.0);
        let mut cut = |book: &mut CutBook, lasts_s: f64, pitch_rad: f64, in_cut: Option<bool>| {
            for _ in 0..(lasts_s / 0.01).round() as usize {
                t_s += 0.01;
                let now = Condition { speed_rpm: 1200.0, pitch_rad, tool_position_m: None };
                book.look(t_s, now, in_cut);
            }
            t_s
        };
        let t_s = cut(&mut book, 2.0, 0.0, CUT);
        onset().iter().for_each(|e| book.hear(t_s, e));
        let t_s = cut(&mut book, 1.0, 0.1, CUT);
        book.hear(t_s, &ChatterEvent::End);
        cut(&mut book, 3.0, 0.1, CUT);
        cut(&mut book, 1.0, 0.1, AIR);
        cut(&mut book, 3.0, 0.1, CUT);
        cut(&mut book, 1.0, 0.1, AIR);
        let after: Vec<bool> = std::iter::from_fn(|| book.take()).map(|s| s.after_chatter).collect();
        assert_eq!(after, [false, true, false]);
    }

    #[test]
    fn silence_after_chatter_in_the_same_condition_is_not_told_before_the_next_cut() {
        let runs = [
            (1.5, 1200.0, 0.0, CUT, onset()),
            (2.0, 1200.0, 0.0, CUT, END),
            (6.0, 1200.0, 0.0, CUT, None),
            (2.0, 1200.0, 0.0, AIR, None),
            (6.0, 1200.0, 0.0, CUT, None),
            (2.0, 1200.0, 0.0, AIR, None),
        ];
        assert_eq!(told(&runs), [(1200.0, 0.0, Some(650.0)), (1200.0, 0.0, None)]);
    }
}
