//! A line that jumps to another lobe goes on as the same chatter.

use super::criteria::{FOLLOWS, SAME_LINE_HZ, WINDOWS};
use crate::keyframe::keep;

/// Where the line stands.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Hop {
    line_hz: Option<f64>,
    away: usize,
}

keep!(Hop { line_hz, away });

impl Hop {
    /// Takes the line of declared chatter, or none; answers a jump, from where to where.
    pub(super) fn look(&mut self, line_hz: Option<f64>) -> Option<(f64, f64)> {
        let (Some(from_hz), Some(now_hz)) = (self.line_hz, line_hz) else {
            *self = Self { line_hz, away: 0 };
            return None;
        };
        if (now_hz - from_hz).abs() < SAME_LINE_HZ {
            *self = Self { line_hz: Some(from_hz + FOLLOWS * (now_hz - from_hz)), away: 0 };
            return None;
        }
        self.away += 1;
        // So long that the shortest window holds nothing else.
        if self.away < WINDOWS[0] {
            return None;
        }
        *self = Self { line_hz, away: 0 };
        Some((from_hz, now_hz))
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
