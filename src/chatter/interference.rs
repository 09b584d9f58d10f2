//! How the lines that are heard began, as it was seen best: while the beginning is in sight each look judges
//! anew; after that the judgement stands until the line is silent for a while or has grown.

use super::criteria::{CRITERIA, LONGEST, PAST, SAME_LINE_HZ, WINDOWS};
use super::window::{Detection, Reason};
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
    /// The window that judged, and what of the beginning: -1 that it was switched on, 1 that it grew.
    which: usize,
    grew: f64,
    /// Whether it moved here from elsewhere.
    moved: bool,
}

keep!(Heard { offset_hz, left_s, age, power_n2, which, grew, moved });

impl Heard {
    /// Whether the judgement stands: the beginning is out of sight.
    fn stands(&self) -> bool {
        self.age > (LONGEST + PAST) * 3 / 4
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

    fn near(&mut self, offset_hz: f64) -> Option<&mut Heard> {
        let apart = |line: &Heard| (line.offset_hz - offset_hz).abs();
        let near = self.lines.iter_mut().filter(|l| l.left_s > 0.0 && apart(l) < SAME_LINE_HZ);
        near.min_by(|a, b| apart(a).total_cmp(&apart(b)))
    }

    /// Takes what window `which` detected, and refuses it where it is a line that was switched on.
    pub(super) fn judge(&mut self, detection: &mut Detection, which: usize, learning: bool) {
        let Detection { offset_hz, power_n2, over_noise, grew, moved, .. } = *detection;
        let now = |age: usize, power_n2: f64, grew: f64| Heard {
            offset_hz,
            left_s: CRITERIA.usual_s,
            age,
            power_n2,
            which,
            grew,
            moved,
        };
        let line = match self.near(offset_hz) {
            Some(line) => line,
            None if over_noise > 1.0 && grew.is_some() => {
                let newest = |a: &Heard, b: &Heard| a.left_s.total_cmp(&b.left_s);
                let Some(line) = self.lines.iter_mut().min_by(|a, b| newest(a, b)) else { return };
                *line = Heard::default();
                line
            }
            None => return,
        };
        let grows = power_n2 > CRITERIA.louder * line.power_n2;
        match grew {
            Some(grew) if grows => *line = now(WINDOWS[which], power_n2, grew),
            // What is told is no more doubtful for a look that tells nothing.
            Some(grew)
                if !line.stands()
                    && which >= line.which
                    && !line.moved
                    && (line.grew.abs() < 1.0 || grew.abs() >= 1.0) =>
            {
                *line = now(line.age, power_n2.max(line.power_n2), grew);
            }
            _ if over_noise > 1.0 => (line.offset_hz, line.left_s) = (offset_hz, CRITERIA.usual_s),
            _ => {}
        }
        let least = if learning {
            -1.0
        } else if line.stands() {
            -CRITERIA.unseen
        } else {
            1.0
        };
        let grew = if line.moved { -1.0 } else { line.grew };
        if grew < 1.0 && grew <= least {
            detection.least(CRITERIA.hold * (1.0 + grew), Reason::Interference);
        }
    }
}
