//! The pitch before any chatter: what the stability margin asks for while the cut is still silent.

use super::best_pitch::{PitchQuestion, pitch_before_chatter};
use super::decide::{Avoidance, MOST_MOVES_IN_VAIN};
use super::identified::HeardLine;
use super::pitch::pitch_of_shift_rad;
use super::state::AvoidanceState;
use super::{Decision, HoldReason, Situation, TurretMotion};
use crate::stability::margin::BLOCK_S;
use crate::units::SpindleSpeed;
use std::f64::consts::PI;

/// Without a target for so long the count of them begins anew, s: what the rule of reversals calls a minute.
const FORESTALLED_S: f64 = 60.0;
/// Phase of the line up to which a pitch without whole waves is chosen.
const MOST_PHASE_RAD: f64 = 1.19 * PI;

impl Avoidance {
    /// The cut is silent. Where its margin runs out the pitch moves on, no farther than the margin asks: as
    /// slowly as the cut drifts, not before the margin has been read at the pitch that stands, and not while
    /// chatter of the last minute says where it belongs.
    pub(super) fn forestall(
        &self,
        state: &mut AvoidanceState,
        now: &Situation,
        spindle: SpindleSpeed,
    ) -> Decision {
        match self.before_chatter_rad(state, now, spindle) {
            Ok(pitch_rad) => self.move_to(state, now, pitch_rad),
            Err(reason) => self.renew_or(state, now, reason),
        }
    }

    /// The pitch to go to. Errors: why none.
    fn before_chatter_rad(
        &self,
        state: &mut AvoidanceState,
        now: &Situation,
        spindle: SpindleSpeed,
    ) -> Result<f64, HoldReason> {
        let s = &self.settings;
        let (Some(foreseen), Some(stated), Some(turret)) = (now.foreseen, &s.stated, now.turret) else {
            return Err(HoldReason::NoChatter);
        };
        // Within a minute of chatter its lines say where the pitch belongs.
        let ruled = state.lines.highest_hz().is_some() || state.trial.is_some_and(|t| !t.to_choose);
        if !s.before_chatter || ruled {
            return Err(HoldReason::NoChatter);
        }
        let stands = turret.motion == TurretMotion::Reached;
        if !stands || state.target.is_some() && !self.arrived(state, now) {
            state.forestalled_s = now.now_s;
            return Err(HoldReason::NoChatter);
        }
        let since_s = now.now_s - state.forestalled_s;
        if since_s > FORESTALLED_S {
            state.forestalled = 0;
        }
        // The margin of a new pitch: after a block that began before it and one that did not.
        if since_s < 2.0 * BLOCK_S || state.forestalled >= MOST_MOVES_IN_VAIN {
            return Err(HoldReason::NoChatter);
        }
        if !now.estimate_valid {
            return Err(HoldReason::EstimateNotValid);
        }
        let standing_rad = pitch_of_shift_rad(s.diameter_m, s.turret.shift(&turret.offsets_m));
        let line = HeardLine {
            frequency_hz: foreseen.frequency_hz,
            growth_1_s: Some(-foreseen.margin_1_s),
            turn_s: spindle.period_s(),
            pitch_rad: standing_rad,
        };
        // Without whole waves between the tools.
        let most_rad = MOST_PHASE_RAD / (foreseen.frequency_hz * spindle.period_s());
        if !(standing_rad.abs() < most_rad) {
            return Err(HoldReason::NoChatter);
        }
        let question = PitchQuestion {
            stated,
            lines: &[line],
            spindle,
            largest_pitch_rad: self.reach_rad.min(most_rad),
            fruitless_rad: &[],
        };
        let pitch_rad = pitch_before_chatter(&question, self.side * standing_rad);
        pitch_rad.map(|pitch_rad| self.side * pitch_rad).ok_or(HoldReason::NoChatter)
    }
}
