//! The pitch before any chatter: what the stability margin asks for while the cut is still silent.

use super::best_pitch::{PitchQuestion, pitch_before_chatter};
use super::decide::{Avoidance, MOST_MOVES_IN_VAIN};
use super::identified::HeardLine;
use super::pitch::pitch_of_shift_rad;
use super::state::AvoidanceState;
use super::{Decision, HoldReason, Situation};
use crate::stability::margin::BLOCK_S;
use crate::units::SpindleSpeed;

impl Avoidance {
    /// The cut is silent. Where its margin runs out the pitch moves on, no farther than the margin asks: as
    /// slowly as the cut drifts, and not before the margin has been read at the pitch that stands.
    pub(super) fn forestall(
        &self,
        state: &mut AvoidanceState,
        now: &Situation,
        spindle: SpindleSpeed,
    ) -> Decision {
        let Some(foreseen) = now.foreseen.filter(|_| self.settings.before_chatter) else {
            state.forestalled = 0;
            return self.renew_or(state, now, HoldReason::NoChatter);
        };
        // The margin of a new pitch: after a block that began before it and one that did not.
        let read = now.now_s - state.forestalled_s >= 2.0 * BLOCK_S;
        if state.trial.is_some() || !read || state.forestalled >= MOST_MOVES_IN_VAIN {
            return self.renew_or(state, now, HoldReason::NoChatter);
        }
        if !now.estimate_valid {
            return self.renew_or(state, now, HoldReason::EstimateNotValid);
        }
        let s = &self.settings;
        let (Some(stated), Some(turret)) = (&s.stated, now.turret) else {
            return self.renew_or(state, now, HoldReason::NoChatter);
        };
        let standing_rad = pitch_of_shift_rad(s.diameter_m, s.turret.shift(&turret.offsets_m));
        let line = HeardLine {
            frequency_hz: foreseen.frequency_hz,
            growth_1_s: Some(-foreseen.margin_1_s),
            turn_s: spindle.period_s(),
            pitch_rad: standing_rad,
        };
        let question = PitchQuestion {
            stated,
            lines: &[line],
            spindle,
            largest_pitch_rad: self.reach_rad,
            fruitless_rad: &[],
        };
        match pitch_before_chatter(&question, self.side * standing_rad) {
            Some(pitch_rad) => self.move_to(state, now, self.side * pitch_rad),
            None => self.renew_or(state, now, HoldReason::NoStablePitch),
        }
    }
}
