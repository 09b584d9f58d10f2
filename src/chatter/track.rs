//! A line in time: which one it is, and whether it jumped to another lobe as the same chatter.

use super::criteria::{FOLLOWS, SAME_LINE_HZ, WINDOWS};
use crate::keyframe::keep;

/// Where a line stands, Hz; none: there is no line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Track {
    pub(super) line_hz: Option<f64>,
}

keep!(Track { line_hz });

impl Track {
    /// Whether this is the same line, which is followed then.
    pub(super) fn follow(&mut self, now_hz: Option<f64>) -> bool {
        let (Some(line_hz), Some(now_hz)) = (&mut self.line_hz, now_hz) else { return false };
        let same = (now_hz - *line_hz).abs() < SAME_LINE_HZ;
        if same {
            *line_hz += FOLLOWS * (now_hz - *line_hz);
        }
        same
    }
}

/// Jumps of a line.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Hop {
    track: Track,
    away: usize,
}

keep!(Hop { track, away });

impl Hop {
    /// Whether this is not the line that is followed.
    pub(super) fn leaves(&self, now_hz: f64) -> bool {
        self.track.line_hz.is_some_and(|line_hz| (now_hz - line_hz).abs() >= SAME_LINE_HZ)
    }

    /// Takes the line of declared chatter, or none; answers a jump, from where to where.
    pub(super) fn look(&mut self, line_hz: Option<f64>) -> Option<(f64, f64)> {
        if self.track.follow(line_hz) {
            self.away = 0;
            return None;
        }
        self.away += 1;
        let jump = self.track.line_hz.zip(line_hz);
        // So long that the shortest window holds nothing else.
        if jump.is_some() && self.away < WINDOWS[0] {
            return None;
        }
        *self = Self { track: Track { line_hz }, away: 0 };
        jump
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_that_stays_is_told_once() {
        let mut hop = Hop::default();
        let mut jumps = Vec::new();
        for k in 0..100 {
            let hz = if k < 50 || k == 60 { 652.0 } else { 612.0 };
            jumps.extend(hop.look(Some(hz)));
        }
        assert_eq!(jumps.len(), 1);
        assert!((jumps[0].0 - 652.0).abs() < 0.1 && (jumps[0].1 - 612.0).abs() < 0.1);
    }
}
