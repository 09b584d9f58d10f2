//! What the estimate takes off for friction.
//!
//! At the motor: F tanh(v/v_s), the law of the model file. At the stage: the same size, but turned by
//! travel instead of velocity (Dahl), because a guideway that vibrates in place by less than a
//! micrometre sticks: its friction is a spring, and sign(v) would subtract a square wave that is not
//! there. In motion both laws are one.

/// Travel over which guideway friction turns, where no pre-sliding stiffness is stated. Rolling
/// guideways and ball screws: a few micrometres (Armstrong-Helouvry et al., Automatica 30, 1994).
pub const PRESLIDING_TRAVEL_M: f64 = 3.0e-6;

/// Friction that turns over a stretch of travel (Dahl 1968).
///
/// dz/dx = (1 - sign(dx) z) / delta, friction = F z; exact for each straight step with
/// exp(-u) = 1/(1 + u + u^2/2 + ...). Moves smaller than the encoder's step are noise and are not followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Presliding {
    per_travel_1_m: f64,
    play_m: f64,
}

/// State of [`Presliding`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PreslidingState {
    position_m: f64,
    /// Friction over its full size, -1 to 1.
    share: f64,
}

crate::keyframe::keep!(PreslidingState { position_m, share });

impl Presliding {
    /// Friction that turns over `travel_m`, on an encoder of step `step_m`.
    #[must_use]
    pub fn new(travel_m: f64, step_m: f64) -> Self {
        Self { per_travel_1_m: 1.0 / travel_m.max(1e-9), play_m: step_m }
    }

    /// At rest, no friction stored.
    #[must_use]
    pub fn settled(position_m: f64) -> PreslidingState {
        PreslidingState { position_m, share: 0.0 }
    }

    /// Share of the full friction, -1 to 1, at a new position. Cost: one division.
    #[inline(always)]
    #[must_use]
    pub fn step(&self, state: &mut PreslidingState, position_m: f64) -> f64 {
        let moved = position_m - state.position_m;
        let beyond = (moved.abs() - self.play_m).max(0.0);
        let u = beyond * self.per_travel_1_m;
        let keep = 1.0 / (1.0 + u * (1.0 + 0.5 * u * (1.0 + u / 3.0)));
        let direction = moved.signum();
        state.share = direction + (state.share - direction) * keep;
        state.position_m += direction * beyond;
        state.share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_move_gives_full_friction_and_a_small_swing_almost_none() {
        let law = Presliding::new(3e-6, 1e-9);
        let mut state = Presliding::settled(0.0);
        let far = (1..=1000).map(|i| law.step(&mut state, 1e-7 * f64::from(i))).last();
        assert!((far.unwrap() - 1.0).abs() < 1e-3);
        let mut state = Presliding::settled(0.0);
        let largest = (0..2000)
            .map(|i| law.step(&mut state, 50e-9 * (0.4 * f64::from(i)).sin()).abs())
            .fold(0.0, f64::max);
        assert!(largest < 0.02, "{largest}");
    }
}
