//! The pitch before any chatter: what the stability margin asks for while the cut is still silent.

use super::best_pitch::{PHASE_RANGE, PitchQuestion, pitch_before_chatter};
use super::decide::{Avoidance, MINUTE_S, MOST_MOVES_IN_VAIN};
use super::identified::HeardLine;
use super::pitch::pitch_of_shift_rad;
use super::state::AvoidanceState;
use super::{Decision, HoldReason, Mode, Situation, TurretMotion, TurretReport};
use crate::chatter::Phase;
use crate::stability::margin::BLOCK_S;
use crate::units::SpindleSpeed;
use std::f64::consts::PI;

/// Why the pitch stays although the margin runs out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Wait {
    /// Chatter of the last minute says where the pitch belongs.
    AfterChatter,
    /// The turret has not arrived yet.
    Moving,
    /// The margin of the pitch that stands is being read.
    MarginNotRead,
    /// It was moved so often within a minute.
    MovedEnough,
    /// A flag of the force estimate forbids acting on it.
    EstimateNotValid,
}

impl Wait {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::AfterChatter, Self::Moving, Self::MarginNotRead, Self::MovedEnough, Self::EstimateNotValid];

    /// Name in records and on the page.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::AfterChatter => "after_chatter",
            Self::Moving => "moving",
            Self::MarginNotRead => "margin_not_read",
            Self::MovedEnough => "moved_enough",
            Self::EstimateNotValid => HoldReason::EstimateNotValid.name(),
        }
    }
}

impl Avoidance {
    /// Why the pitch stays although the margin of a silent cut runs out, in a mode that would move it.
    /// Nothing where it does not run out, where that is not asked for, or where no pitch in reach is better.
    #[must_use]
    pub fn waits_before_chatter(&self, state: &AvoidanceState, now: &Situation) -> Option<Wait> {
        let silent = now.heard.phase == Phase::Quiet && now.foreseen.is_some();
        let asked = self.settings.before_chatter && now.mode != Mode::Observe;
        now.turret.filter(|_| silent && asked).and_then(|turret| self.waits(state, now, turret))
    }

    fn waits(&self, state: &AvoidanceState, now: &Situation, turret: TurretReport) -> Option<Wait> {
        // Within a minute of chatter its lines say where the pitch belongs.
        if state.lines.highest_hz().is_some() || state.trial.is_some_and(|t| !t.to_choose) {
            return Some(Wait::AfterChatter);
        }
        let stands = turret.motion == TurretMotion::Reached;
        if !stands || state.target.is_some() && !self.arrived(state, now) {
            return Some(Wait::Moving);
        }
        // The margin of a new pitch: after a block that began before it and one that did not.
        let since_s = now.now_s - state.forestalled_s;
        if since_s < 2.0 * BLOCK_S {
            return Some(Wait::MarginNotRead);
        }
        if state.forestalled >= MOST_MOVES_IN_VAIN && !(since_s > MINUTE_S) {
            return Some(Wait::MovedEnough);
        }
        (!now.estimate_valid).then_some(Wait::EstimateNotValid)
    }

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
        if !s.before_chatter {
            return Err(HoldReason::NoChatter);
        }
        let waits = self.waits(state, now, turret);
        match waits {
            Some(Wait::AfterChatter) => return Err(HoldReason::NoChatter),
            Some(Wait::Moving) => state.forestalled_s = now.now_s,
            _ if now.now_s - state.forestalled_s > MINUTE_S => state.forestalled = 0,
            _ => {}
        }
        match waits {
            Some(Wait::EstimateNotValid) => return Err(HoldReason::EstimateNotValid),
            Some(_) => return Err(HoldReason::NoChatter),
            None => {}
        }
        let standing_rad = pitch_of_shift_rad(s.diameter_m, s.turret.shift(&turret.offsets_m));
        let line = HeardLine {
            frequency_hz: foreseen.frequency_hz,
            growth_1_s: Some(-foreseen.margin_1_s),
            turn_s: spindle.period_s(),
            pitch_rad: standing_rad,
        };
        // Without whole waves between the tools.
        let most_rad = PHASE_RANGE[1] * PI / (foreseen.frequency_hz * spindle.period_s());
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
