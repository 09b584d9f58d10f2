//! How the lines that are heard began, as it was seen best: while the beginning is in sight each look judges
//! anew; after that the judgement stands until the line is silent for a while or has grown.

use super::Reason;
use super::criteria::{CRITERIA, LONGEST, PAST, SAME_LINE_HZ, WINDOWS};
use super::window::{Context, Detection};
use crate::keyframe::keep;

/// One line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Heard {
    offset_hz: f64,
    /// For so long it is still looked for, s; 0: there is none.
    left_s: f64,
    /// Values since it began: it has filled the window that heard it first.
    age: usize,
    power_n2: f64,
    /// The window that judged, and the evidence that it grew and was not switched on.
    which: usize,
    grown_nats: f64,
    /// Whether it moved here from elsewhere.
    moved: bool,
}

keep!(Heard { offset_hz, left_s, age, power_n2, which, grown_nats, moved });

impl Heard {
    /// Whether the judgement stands: the beginning is out of sight.
    fn stands(&self) -> bool {
        self.age > (LONGEST + PAST) * 3 / 4
    }

    /// Takes what window `which` says of it. What stood in an alarm is not judged anew when it is heard again
    /// after a while in which noise hid it.
    fn look(&mut self, detection: &Detection, which: usize, context: &Context) {
        let least_nats = context.beginning_nats();
        let Detection { offset_hz, power_n2, over_noise, grown_nats, moved, .. } = *detection;
        let left_s = if context.alarm { CRITERIA.before_s } else { CRITERIA.usual_s };
        let now =
            |age, power_n2, grown_nats| Heard { offset_hz, left_s, age, power_n2, which, grown_nats, moved };
        let tells = |nats: f64| nats.abs() >= least_nats;
        // What tells is no more doubtful for a look that tells nothing.
        let in_sight = !self.stands() && which >= self.which && !self.moved;
        let anew = |nats: f64| in_sight && (tells(nats) || !tells(self.grown_nats));
        match grown_nats {
            Some(nats) if power_n2 > CRITERIA.louder * self.power_n2 => {
                *self = now(WINDOWS[which], power_n2, nats);
            }
            Some(nats) if anew(nats) => *self = now(self.age, power_n2.max(self.power_n2), nats),
            _ if over_noise > 1.0 => (self.offset_hz, self.left_s) = (offset_hz, left_s),
            _ => {}
        }
    }

    /// Whether it is no chatter. All else that begins with a cut is there at once, too.
    fn is_refused(&self, context: &Context) -> bool {
        let least_nats = context.beginning_nats();
        let passes_nats = match (context.is_young(), self.stands()) {
            (true, _) => -least_nats,
            (false, true) => -CRITERIA.unseen_nats,
            (false, false) => least_nats,
        };
        self.moved || self.grown_nats <= passes_nats
    }
}

/// The lines that are heard.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Interference {
    /// As many as windows hear at a time.
    lines: [Heard; WINDOWS.len()],
}

keep!(Interference { lines });

impl Interference {
    pub(super) fn age(&mut self, period_s: f64) {
        for line in &mut self.lines {
            line.left_s = (line.left_s - period_s).max(0.0);
            line.age += 1;
        }
    }

    /// Another cut begins: what grew in the last one may be another line in this.
    pub(super) fn enter(&mut self) {
        let grew = |line: &&mut Heard| !line.moved && line.grown_nats > 0.0;
        self.lines.iter_mut().filter(grew).for_each(|line| line.left_s = 0.0);
    }

    /// Place of the line that is followed there.
    fn near(&self, offset_hz: f64) -> Option<usize> {
        let apart = |line: &Heard| (line.offset_hz - offset_hz).abs();
        let near = self.lines.iter().enumerate().filter(|(_, l)| l.left_s > 0.0 && apart(l) < SAME_LINE_HZ);
        near.min_by(|(_, a), (_, b)| apart(a).total_cmp(&apart(b))).map(|(place, _)| place)
    }

    /// The line that was detected, followed anew where none is followed there; nothing where it is not heard.
    fn followed(&mut self, detection: &Detection) -> Option<&mut Heard> {
        if let Some(place) = self.near(detection.offset_hz) {
            return self.lines.get_mut(place);
        }
        if detection.over_noise <= 1.0 || detection.grown_nats.is_none() {
            return None;
        }
        let longest_silent = self.lines.iter_mut().min_by(|a, b| a.left_s.total_cmp(&b.left_s))?;
        *longest_silent = Heard::default();
        Some(longest_silent)
    }

    /// Takes what window `which` detected, and refuses it where it is a line that was switched on. In an
    /// alarm lines are followed alone.
    pub(super) fn judge(&mut self, detection: &mut Detection, which: usize, context: &Context) {
        let least_nats = context.beginning_nats();
        let Some(line) = self.followed(detection) else { return };
        line.look(detection, which, context);
        if !context.alarm && line.is_refused(context) {
            let share = if line.moved { -1.0 } else { line.grown_nats / least_nats };
            detection.least(CRITERIA.hold * (1.0 + share), Reason::Interference);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::criteria::{FALSE_ALARM_S, Levels};
    use super::super::whitening::Whitener;
    use super::super::window::{Knowledge, Tools};
    use super::*;

    fn context() -> Context {
        Context {
            levels: Levels::of(FALSE_ALARM_S),
            centre_hz: 650.0,
            rate_hz: 500.0,
            speed_hz: 20.0,
            pitch_rad: None,
            sweep_hz_s: 0.0,
            watched_hz: [-100.0, 100.0],
            seen: LONGEST + PAST,
            noise: Knowledge::Known,
            orders: true,
            alarm: false,
            tools: Tools::Cutting,
            stable_n2: f64::INFINITY,
            whitener: Whitener::plain(),
        }
    }

    /// Evidence that is left of a line at `offset_hz` with evidence of its beginning.
    fn left(lines: &mut Interference, offset_hz: f64, which: usize, grown_nats: Option<f64>) -> f64 {
        let (evidence, over_noise, power_n2) = (2.0, 2.0, 1.0);
        let mut heard =
            Detection { evidence, over_noise, power_n2, offset_hz, grown_nats, ..Detection::default() };
        lines.judge(&mut heard, which, &context());
        heard.evidence
    }

    fn later(lines: &mut Interference, values: usize) {
        (0..values).for_each(|_| lines.age(0.002));
    }

    #[test]
    fn a_judgement_follows_the_looks_while_the_beginning_is_in_sight_and_stands_then() {
        let mut lines = Interference::default();
        // A short window that hears a burst says the line was switched on; a longer one sees it grow.
        assert!(left(&mut lines, 10.0, 0, Some(-20.0)) < CRITERIA.hold);
        later(&mut lines, 60);
        assert!(left(&mut lines, 12.0, 2, Some(5.0)) > 1.0);
        // A shorter one says nothing any more, nor one that tells nothing.
        assert!(left(&mut lines, 12.0, 0, Some(-20.0)) > 1.0);
        assert!(left(&mut lines, 12.0, 3, Some(0.5)) > 1.0);
        later(&mut lines, 200);
        assert!(left(&mut lines, 12.0, 3, Some(-9.0)) > 1.0);
    }

    #[test]
    fn what_was_an_alarm_is_heard_again_without_another_beginning() {
        let mut lines = Interference::default();
        let mut heard = |alarm: bool, grown_nats: Option<f64>| {
            let line = Detection { evidence: 2.0, over_noise: 2.0, power_n2: 1.0, ..Detection::default() };
            let mut heard = Detection { grown_nats, ..line };
            lines.judge(&mut heard, 3, &Context { alarm, ..context() });
            later(&mut lines, 1500);
            heard.evidence
        };
        assert!(heard(false, Some(9.0)) > 1.0);
        assert!(heard(true, Some(9.0)) > 1.0);
        // Three seconds later, and then six seconds later than that.
        assert!(heard(false, Some(-9.0)) > 1.0);
        assert!(heard(false, Some(-9.0)) < CRITERIA.hold);
    }

    #[test]
    fn a_line_whose_beginning_nobody_saw_well_counts_unless_a_nat_is_against_it() {
        for (grown_nats, counts) in [(0.2, true), (-0.8, true), (-1.2, false), (-5.0, false)] {
            let mut lines = Interference::default();
            // While its beginning is in sight it is listened to.
            assert!(left(&mut lines, 0.0, 3, Some(grown_nats)) < 1.0);
            later(&mut lines, 100);
            assert_eq!(left(&mut lines, 0.0, 3, None) > 1.0, counts, "{grown_nats}");
        }
    }

    #[test]
    fn a_tone_stays_one_beside_as_many_others_as_there_are_windows_until_it_is_silent() {
        let mut lines = Interference::default();
        let tones = [-60.0, -20.0, 20.0, 60.0];
        for _ in 0..20 {
            for offset_hz in tones {
                assert!(left(&mut lines, offset_hz, 3, Some(-8.0)) < CRITERIA.hold);
            }
            later(&mut lines, 50);
        }
        lines.enter();
        assert!(tones.iter().all(|hz| left(&mut lines, *hz, 0, Some(9.0)) < CRITERIA.hold));
        later(&mut lines, 251);
        assert!(left(&mut lines, 20.0, 0, Some(9.0)) > 1.0);
    }
}
