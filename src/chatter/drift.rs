//! Where a line is now that a window placed some time ago. Within a lobe chatter goes with the speed of the
//! spindle: while that changes, what a window heard is behind by as much as its age.

/// Time over which the move of a line is taken.
const OVER_S: f64 = 0.3;
/// A line that stands farther than this from where it was is another.
const ANOTHER_HZ: f64 = 12.0;

/// Where a line was.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Drift {
    /// Exponential mean of its places over `OVER_S`.
    was_hz: f64,
    followed_s: f64,
}

crate::keyframe::keep!(Drift { was_hz, followed_s });

impl Drift {
    /// Takes the line that a window of this age placed; gives how far it has moved since then, Hz. Nothing
    /// before it was followed for half of `OVER_S`.
    pub(super) fn since_hz(&mut self, heard_hz: f64, period_s: f64, age_s: f64) -> f64 {
        if self.followed_s <= 0.0 || (heard_hz - self.was_hz).abs() > ANOTHER_HZ {
            *self = Self { was_hz: heard_hz, followed_s: 0.0 };
        }
        self.followed_s += period_s;
        self.was_hz += (heard_hz - self.was_hz) * (period_s / OVER_S).min(1.0);
        if self.followed_s < 0.5 * OVER_S {
            return 0.0;
        }
        // The mean of a steady move lags by OVER_S once it has forgotten the start.
        let lag_s = OVER_S * (1.0 - (-self.followed_s / OVER_S).exp());
        (heard_hz - self.was_hz) / lag_s * age_s
    }

    /// There is no line.
    pub(super) fn forget(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Error of the place of a line that moves by `move_hz_s` and is heard `age_s` late, after `steps`.
    fn error_hz(move_hz_s: f64, age_s: f64, steps: u32) -> f64 {
        let mut drift = Drift::default();
        let mut error = 0.0;
        for k in 0..steps {
            let t_s = 0.004 * f64::from(k);
            let heard = 650.0 + move_hz_s * (t_s - age_s);
            error = heard + drift.since_hz(heard, 0.004, age_s) - (650.0 + move_hz_s * t_s);
        }
        error
    }

    #[test]
    fn a_steady_move_is_told_for_now() {
        assert!((error_hz(15.0, 0.13, 20) + 15.0 * 0.13).abs() < 1e-9, "nothing is added at first");
        assert!(error_hz(15.0, 0.13, 60).abs() < 0.1, "{}", error_hz(15.0, 0.13, 60));
        assert!(error_hz(15.0, 0.13, 500).abs() < 0.05, "{}", error_hz(15.0, 0.13, 500));
        assert!(error_hz(0.0, 0.13, 500).abs() < 1e-12);
    }

    #[test]
    fn a_line_that_jumped_has_not_moved() {
        let mut drift = Drift::default();
        (0..200).for_each(|_| _ = drift.since_hz(652.0, 0.004, 0.1));
        assert!(drift.since_hz(612.0, 0.004, 0.1).abs() < 1e-12);
    }
}
