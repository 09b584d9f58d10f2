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
    usual_n2: f64,
    peak_n2: f64,
}

keep!(Decision { alarm, since_s, usual, silent_s, usual_n2, peak_n2 });

/// What a step brought.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turn {
    Begins,
    Ends,
}

impl Decision {
    /// Whether a line of this power elsewhere is not the alarm's: chatter that jumps to another lobe is as
    /// loud there, what stands in a stable cut is not.
    pub(super) fn is_fainter(&self, power_n2: f64) -> bool {
        power_n2 * CRITERIA.louder < self.usual_n2
    }

    /// Takes the evidence of each window, the power of the line and whether it is another than that of the
    /// alarm, see [`Self::is_fainter`]; `period_s` since the last time.
    pub(super) fn step(
        &mut self,
        t_s: f64,
        evidence: [f64; 4],
        (power_n2, another): (f64, bool),
        period_s: f64,
    ) -> Option<Turn> {
        if !self.alarm {
            if evidence.into_iter().fold(0.0, f64::max) < 1.0 {
                return None;
            }
            let (usual_n2, peak_n2) = (power_n2, power_n2);
            *self = Self { alarm: true, since_s: t_s, usual: evidence, silent_s: 0.0, usual_n2, peak_n2 };
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
        if !another {
            let ratio = power_n2 / self.usual_n2.max(f64::MIN_POSITIVE);
            self.usual_n2 = self.usual_n2.max(f64::MIN_POSITIVE) * ratio.max(f64::MIN_POSITIVE).powf(share);
        }
        self.silent_s = if now < CRITERIA.hold || another || power_n2 < 0.003 * self.peak_n2 {
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

#[cfg(test)]
mod tests {
    use super::*;

    /// When the alarm ends that a line of 10 N^2 raised which gives way after a second to one of `power_n2`.
    fn ends_s(power_n2: f64) -> Option<f64> {
        let (mut decision, period_s) = (Decision::default(), 0.002);
        (0..2000).map(|k| period_s * f64::from(k)).find(|t_s| {
            let gone = *t_s > 1.0;
            let power_n2 = if gone { power_n2 } else { 10.0 };
            let another = gone && decision.is_fainter(power_n2);
            decision.step(*t_s, [2.0; 4], (power_n2, another), period_s) == Some(Turn::Ends)
        })
    }

    #[test]
    fn a_fainter_line_elsewhere_keeps_no_alarm_and_one_as_loud_does() {
        assert!((ends_s(1.0).unwrap() - 1.0 - CRITERIA.end_s).abs() < 0.01);
        assert_eq!(ends_s(6.0), None);
    }
}
