//! A line that jumps to another lobe: the tools travel, the bar bends at another frequency, and chatter goes
//! over to the next place at which the waves on the surface fit.

/// A line within this of where it was has drifted.
const DRIFT_HZ: f64 = 8.0;
/// It must stay at its new place for so many decisions (40 ms): two lobes beat for a moment.
const LOOKS: u32 = 10;

/// Where the line is believed to be.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct HopWatch {
    at_hz: Option<f64>,
    elsewhere: Option<(f64, u32)>,
}

crate::keyframe::keep!(HopWatch { at_hz, elsewhere });

impl HopWatch {
    /// Takes the line at one decision (`None`: there is no chatter); gives from where to where it jumped.
    pub(super) fn look(&mut self, line_hz: Option<f64>) -> Option<(f64, f64)> {
        let Some(now_hz) = line_hz else {
            *self = Self::default();
            return None;
        };
        let at_hz = *self.at_hz.get_or_insert(now_hz);
        if (now_hz - at_hz).abs() < DRIFT_HZ {
            (self.at_hz, self.elsewhere) = (Some(now_hz), None);
            return None;
        }
        let seen = match self.elsewhere {
            Some((hz, seen)) if (now_hz - hz).abs() < DRIFT_HZ => seen + 1,
            _ => 1,
        };
        self.elsewhere = Some((now_hz, seen));
        if seen < LOOKS {
            return None;
        }
        (self.at_hz, self.elsewhere) = (Some(now_hz), None);
        Some((at_hz, now_hz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_jump_is_told_once_and_drift_is_none() {
        let mut watch = HopWatch::default();
        let line = |k: u32| if k < 200 { 652.0 - 0.05 * f64::from(k) } else { 612.0 };
        let hops: Vec<_> = (0..400).filter_map(|k| watch.look(Some(line(k)))).collect();
        assert_eq!(hops.len(), 1, "{hops:?}");
        assert!((hops[0].0 - 642.0).abs() < 0.2 && (hops[0].1 - 612.0).abs() < 1e-9);
        // A glance at another lobe is no hop.
        let mut watch = HopWatch::default();
        assert!((0..100).all(|k| watch.look(Some(if k == 50 { 612.0 } else { 652.0 })).is_none()));
    }
}
