//! What the decision remembers from one look to the next.

use super::choice::{GrowthMeter, TrackedLines};
use super::{HoldReason, Mode};
use crate::keyframe::keep;
use crate::sample::MAX_AXES;

/// Pitches tried before a person is asked.
pub(super) const ATTEMPTS: u32 = 2;
/// Intervals at a pitch after which it is judged.
pub(super) const JUDGE_INTERVALS: u32 = 2;
/// Reversals of direction a minute (invariant I12).
pub(super) const REVERSALS: usize = 6;

/// What the decision remembers.
#[derive(Debug, Clone, PartialEq)]
pub struct AvoidanceState {
    pub(super) epoch: u64,
    pub(super) sequence: u64,
    pub(super) next_due_s: f64,
    pub(super) latest_now_s: f64,
    pub(super) clock_stepped: bool,
    pub(super) lines: TrackedLines,
    pub(super) growth: GrowthMeter,
    pub(super) in_chatter: bool,
    pub(super) last_command_s: f64,
    /// No pitch was stable when one was chosen last, and the nearest speed at which one is.
    pub(super) no_stable_pitch: bool,
    pub(super) advised_speed_rpm: Option<f64>,
    /// What the turret was last told.
    pub(super) target: Option<Target>,
    /// What it was told before: stands again when the last command did not go out.
    pub(super) before: Option<Target>,
    pub(super) trial: Option<Trial>,
    pub(super) latched: Option<Latched>,
    pub(super) off_target: u32,
    /// Refusals in a row, the command refused last, and whether the latest report is one of a refusal.
    pub(super) refusals: u32,
    pub(super) refused: Option<u64>,
    pub(super) refusing: bool,
    pub(super) refused_until_s: f64,
    pub(super) reversals_s: [f64; REVERSALS],
    pub(super) last_step_rad: f64,
    /// Targets since chatter last fell by 3 dB or fell silent.
    pub(super) moves_in_vain: u32,
    /// Targets before chatter since the margin last recovered, and when the last of them was asked for.
    pub(super) forestalled: u32,
    pub(super) forestalled_s: f64,
    pub(super) mode: Mode,
}

#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Target {
    pub(super) sequence: u64,
    pub(super) pitch_rad: f64,
    pub(super) requested_rad: f64,
    pub(super) offsets_m: [f64; MAX_AXES],
    pub(super) issued_s: f64,
    /// It was asked for before any chatter.
    pub(super) before_chatter: bool,
}

/// A pitch under trial.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Trial {
    pub(super) attempt: u32,
    /// No pitch has been asked for in this attempt yet.
    pub(super) to_choose: bool,
    /// Intervals for which the turret has stood where it was asked to.
    pub(super) intervals: u32,
    /// And after how many of them it is judged.
    pub(super) judged_at: u32,
    pub(super) power_before_n2: f64,
    /// Pitches that did not help.
    pub(super) fruitless_rad: [Option<f64>; ATTEMPTS as usize],
}

impl Trial {
    pub(super) fn new(power_before_n2: f64) -> Self {
        let judged_at = JUDGE_INTERVALS;
        Self { to_choose: true, judged_at, power_before_n2, ..Self::default() }
    }
}

/// A state that a person must clear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Latched {
    pub(super) reason: HoldReason,
    /// The return to equal pitch was commanded.
    pub(super) returned: bool,
}

impl Default for Latched {
    fn default() -> Self {
        Self { reason: HoldReason::HandedOver, returned: false }
    }
}

keep!(Target { sequence, pitch_rad, requested_rad, offsets_m, issued_s, before_chatter });
keep!(Trial { attempt, to_choose, intervals, judged_at, power_before_n2, fruitless_rad });
keep!(Latched { reason, returned });
keep!(AvoidanceState {
    epoch,
    sequence,
    next_due_s,
    latest_now_s,
    clock_stepped,
    lines,
    growth,
    in_chatter,
    last_command_s,
    no_stable_pitch,
    advised_speed_rpm,
    target,
    before,
    trial,
    latched,
    off_target,
    refusals,
    refused,
    refusing,
    refused_until_s,
    reversals_s,
    last_step_rad,
    moves_in_vain,
    forestalled,
    forestalled_s,
    mode
});

impl AvoidanceState {
    /// A command that did not go out changes nothing: the turret is still told what it was told before, and
    /// no pitch is judged that was never asked for.
    pub(super) fn withhold(&mut self, number: Option<u64>) {
        let Some(target) = self.target.filter(|t| Some(t.sequence) == number) else { return };
        self.target = self.before.take();
        self.off_target = 0;
        if self.target.is_some_and(|t| t.requested_rad == target.requested_rad) {
            return; // a renewal: its pitch is under trial already
        }
        let counted = if target.before_chatter { &mut self.forestalled } else { &mut self.moves_in_vain };
        *counted = counted.saturating_sub(1);
        self.choose_anew();
    }

    /// What was asked for does not stand: the attempt begins again.
    pub(super) fn choose_anew(&mut self) {
        let begun = self.trial.filter(|t| t.attempt > 0);
        self.trial = begun.map(|t| Trial { to_choose: true, intervals: 0, judged_at: JUDGE_INTERVALS, ..t });
    }

    /// The turret went back to equal pitch by itself: its command expired while nothing could be renewed.
    pub(super) fn expire(&mut self) {
        (self.target, self.before, self.off_target) = (None, None, 0);
        self.choose_anew();
    }

    /// The pitch that stands was asked for before any chatter.
    #[must_use]
    pub fn stands_before_chatter(&self) -> bool {
        self.target.is_some_and(|t| t.before_chatter)
    }

    /// The turret must go back to equal pitch and was not told so yet.
    pub(super) fn must_go_back(&self) -> bool {
        self.mode == Mode::Act && self.target.is_some() && self.latched.is_some_and(|l| !l.returned)
    }

    /// The pitches that were tried did not help: a person must look.
    pub(super) fn hand_over(&mut self) {
        self.trial = None;
        self.latched = Some(Latched { reason: HoldReason::HandedOver, returned: false });
    }

    /// A person has looked: everything latched is open again. What still is so latches again.
    pub(super) fn acknowledge(&mut self) {
        (self.latched, self.trial, self.moves_in_vain, self.off_target) = (None, None, 0, 0);
    }
}
