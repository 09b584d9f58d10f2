//! A line that was switched on stays one when that is out of sight, until it has been silent for a while or
//! has grown.

use super::criteria::{CRITERIA, SAME_LINE_HZ};
use super::window::{Detection, Reason};
use crate::keyframe::keep;

/// The newest line that was switched on.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Interference {
    offset_hz: f64,
    /// For so long it is still looked for, s.
    left_s: f64,
    power_n2: f64,
}

keep!(Interference { offset_hz, left_s, power_n2 });

impl Interference {
    pub(super) fn age(&mut self, period_s: f64) {
        self.left_s = (self.left_s - period_s).max(0.0);
    }

    /// Takes what a window detected, and refuses it where it is the same line, as loud as it was.
    pub(super) fn judge(&mut self, detection: &mut Detection) {
        let near = (detection.offset_hz - self.offset_hz).abs() < SAME_LINE_HZ && self.left_s > 0.0;
        let grows = near && detection.power_n2 > CRITERIA.louder * self.power_n2;
        if detection.switched_on {
            let before_n2 = if near { self.power_n2 } else { 0.0 };
            self.power_n2 = detection.power_n2.max(before_n2);
        }
        if detection.switched_on || (near && !grows && detection.over_noise > 1.0) {
            (self.offset_hz, self.left_s) = (detection.offset_hz, CRITERIA.usual_s);
        }
        if near && !grows && detection.evidence > 0.0 {
            (detection.evidence, detection.reason) = (0.0, Reason::Interference);
        }
    }
}
