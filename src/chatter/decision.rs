//! From evidence to an alarm and its end.

use super::criteria::CRITERIA;
use crate::keyframe::keep;

/// What stands decided.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Decision {
    pub(super) alarm: bool,
    pub(super) since_s: f64,
    usual: [f64; 4],
    silent_s: f64,
    peak_n2: f64,
}

keep!(Decision { alarm, since_s, usual, silent_s, peak_n2 });

/// What a step brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    Begins,
    Ends,
}

impl Decision {
    /// Takes the evidence of each window; `period_s` since the last time.
    pub(super) fn step(
        &mut self,
        t_s: f64,
        (evidence, power_n2): ([f64; 4], f64),
        period_s: f64,
    ) -> Option<Turn> {
        if !self.alarm {
            if evidence.into_iter().fold(0.0, f64::max) < 1.0 {
                return None;
            }
            *self = Self { alarm: true, since_s: t_s, usual: evidence, silent_s: 0.0, peak_n2: power_n2 };
            return Some(Turn::Begins);
        }
        self.peak_n2 = power_n2.max(self.peak_n2);
        let share = period_s / CRITERIA.usual_s;
        for (usual, now) in self.usual.iter_mut().zip(evidence) {
            *usual += (now.min(2.0) - *usual) * share;
        }
        // The shortest window that usually hears the line says when it has gone; else the clearest.
        let ruling = self.usual.iter().position(|u| *u > CRITERIA.usual);
        let now = ruling.map_or_else(|| evidence.into_iter().fold(0.0, f64::max), |w| evidence[w]);
        self.silent_s = if now < CRITERIA.hold || power_n2 < 0.003 * self.peak_n2 {
            self.silent_s + period_s
        } else {
            0.0
        };
        if self.silent_s > CRITERIA.end_s {
            *self = Self::default();
            return Some(Turn::Ends);
        }
        None
    }
}
