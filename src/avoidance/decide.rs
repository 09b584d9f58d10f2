//! The decision, once an interval.

use super::best_pitch::{PitchAdvice, PitchQuestion, best_pitch};
use super::choice::{GrowthMeter, TrackedLines, pitch_for_attempt_rad, plausible_speed};
use super::identified::HeardLine;
use super::pitch::{pitch_of_shift_rad, tool_shift};
use super::state::{ATTEMPTS, AvoidanceState, JUDGE_INTERVALS, Latched, REVERSALS, Target, Trial};
use super::{
    AvoidanceSettings, Command, CommandKind, Decision, HoldReason, Mode, SettingsError, Situation,
    TurretMotion,
};
use crate::chatter::Phase;
use crate::sample::MAX_AXES;
use crate::units::SpindleSpeed;

/// Longest lifetime of a command (invariant I7).
const LONGEST_TTL_S: f64 = 2.5;
/// Shortest interval between commands (invariant I5).
const SHORTEST_INTERVAL_S: f64 = 1.0;
/// Silence of the samples after which the turret goes back (invariant I8).
const STALE_RETURN_S: f64 = 1.0;
/// Targets without 3 dB less chatter before a person is asked (invariant I12).
pub(super) const MOST_MOVES_IN_VAIN: u32 = 5;
/// Power over that before at which a pitch has helped: 3 dB less (invariant I12).
const HELPED: f64 = 0.5;
/// Share by which the measured diameter may differ from the stated one, by which offsets and pitch are
/// made of each other.
const DIAMETER_OFF: f64 = 0.05;
/// A report of a refusal that stood before a command is one of it only this long after.
const REFUSAL_HEARD_S: f64 = 0.25;
/// Intervals off the target before the turret counts as stuck (invariant I11).
const STUCK_INTERVALS: u32 = 3;
/// Longest wait after refusals (invariant I11).
const LONGEST_BACKOFF_S: f64 = 60.0;
/// The minute of the rules: for lines that are kept, reversals, and pitches before chatter.
pub(super) const MINUTE_S: f64 = 60.0;

/// The decision: immutable design.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Avoidance {
    pub(super) settings: AvoidanceSettings,
    /// Largest pitch that limits and axes allow, on the side on which it is larger.
    pub(super) reach_rad: f64,
    /// That side: the sign of the pitch. The waves cancel alike on both.
    pub(super) side: f64,
}

impl Avoidance {
    /// Errors: a time, limit or diameter that is not allowed.
    pub fn new(settings: AvoidanceSettings) -> Result<Self, SettingsError> {
        let check = |name, value: f64, good: bool, expected| {
            if value.is_finite() && good {
                Ok(())
            } else {
                Err(SettingsError::Value { name, value, expected })
            }
        };
        let s = &settings;
        check("diameter_m", s.diameter_m, s.diameter_m > 0.0, "a number above zero")?;
        let pitch = s.largest_pitch_rad;
        check("largest_pitch_rad", pitch, (0.0..=1.0).contains(&pitch), "zero to one")?;
        check("interval_s", s.interval_s, s.interval_s >= SHORTEST_INTERVAL_S, "1 s or more")?;
        let ttl = s.ttl_s > s.interval_s && s.ttl_s <= LONGEST_TTL_S;
        check("ttl_s", s.ttl_s, ttl, "more than interval_s and at most 2.5 s")?;
        check("freshness_s", s.freshness_s, s.freshness_s > 0.0 && s.freshness_s <= 0.05, "at most 0.05 s")?;
        let deadline = s.report_deadline_s;
        check("report_deadline_s", deadline, deadline > 0.0 && deadline <= 1.0, "at most 1 s")?;
        check("reached_m", s.reached_m, s.reached_m > 0.0, "a number above zero")?;
        let reaches = |pitch_rad: f64| {
            tool_shift(s.diameter_m, pitch_rad).is_ok_and(|w| s.turret.reaches(&s.turret.offsets_m(w)))
        };
        let reach_rad = |side: f64| {
            let pitches = (1..=400).map(|k| s.largest_pitch_rad * f64::from(k) / 400.0);
            pitches.take_while(|pitch| reaches(side * pitch)).last().unwrap_or(0.0)
        };
        let side = if reach_rad(-1.0) > reach_rad(1.0) { -1.0 } else { 1.0 };
        Ok(Self { settings, reach_rad: reach_rad(side), side })
    }

    /// Limits and times.
    #[must_use]
    pub fn settings(&self) -> &AvoidanceSettings {
        &self.settings
    }

    /// A new life: `epoch` above every one before (invariant I9), the first decision one interval from now.
    #[must_use]
    pub fn start(&self, epoch: u64, now_s: f64) -> AvoidanceState {
        AvoidanceState {
            epoch,
            sequence: 0,
            next_due_s: now_s + self.settings.interval_s,
            latest_now_s: now_s,
            clock_stepped: false,
            lines: TrackedLines::default(),
            growth: GrowthMeter::default(),
            in_chatter: false,
            last_command_s: f64::NEG_INFINITY,
            no_stable_pitch: false,
            advised_speed_rpm: None,
            target: None,
            before: None,
            trial: None,
            latched: None,
            off_target: 0,
            refusals: 0,
            refused: None,
            refusing: false,
            refused_until_s: f64::NEG_INFINITY,
            reversals_s: [f64::NEG_INFINITY; REVERSALS],
            last_step_rad: 0.0,
            moves_in_vain: 0,
            forestalled: 0,
            forestalled_s: f64::NEG_INFINITY,
            mode: Mode::Observe,
        }
    }

    /// Decides, if the interval is over or the mode was left. Call it as often as you like.
    ///
    /// A return that leaving `act` causes comes at once and once; everything else comes an interval apart.
    /// Checked by: `suite/avoidance.rs` (invariants I1-I15 under an independent monitor).
    pub fn decide(&self, state: &mut AvoidanceState, now: &Situation) -> Decision {
        if !now.now_s.is_finite() || now.now_s < state.latest_now_s {
            // A monotonic clock does not do this: wait a whole interval from the latest time that was seen.
            let first = !state.clock_stepped;
            state.clock_stepped = true;
            state.next_due_s = state.latest_now_s + self.settings.interval_s;
            return if first { Decision::Hold(HoldReason::ClockStepped) } else { Decision::NotDue };
        }
        state.clock_stepped = false;
        state.latest_now_s = now.now_s;
        state.withhold(now.withheld);
        if now.operator_acknowledge {
            // In any mode: a fault has always ended `act` before a person can clear it.
            state.acknowledge();
        }
        let begins = self.listen(state, now);
        // A command at the onset finds the line still growing: what the pitch is judged against is its
        // loudest before the first look.
        if let Some(trial) = &mut state.trial
            && trial.intervals == 0
            && now.heard.power_n2.is_finite()
        {
            trial.power_before_n2 = trial.power_before_n2.max(now.heard.power_n2);
        }
        self.watch_silence(state, now);
        self.watch_motion(state, now);
        let left_act = state.mode == Mode::Act && now.mode != Mode::Act;
        state.mode = now.mode;
        if left_act && state.target.take().is_some() {
            return self.leave_act(state, now);
        }
        // Chatter that has just been declared does not wait for the interval, if the last command is that
        // old.
        let at_once =
            begins && state.trial.is_none() && now.now_s - state.last_command_s >= self.settings.interval_s;
        if now.too_soon || now.now_s < state.next_due_s && !at_once {
            return Decision::NotDue;
        }
        // Never a burst: after a stall the next one is a whole interval away.
        state.next_due_s = now.now_s + self.settings.interval_s;
        state.lines.forget(now.now_s, MINUTE_S);
        self.decide_due(state, now)
    }

    /// Remembers lines and how they grew; true when chatter has just been declared.
    fn listen(&self, state: &mut AvoidanceState, now: &Situation) -> bool {
        let before = state.in_chatter;
        state.in_chatter = now.heard.phase == Phase::Chatter;
        match now.heard.phase {
            Phase::Suspected | Phase::Chatter => state.growth.look(now.now_s, now.heard.power_n2),
            Phase::Learning | Phase::Quiet => state.growth = GrowthMeter::default(),
        }
        let speed = now.spindle_speed_rpm.and_then(plausible_speed);
        if let (true, Some(frequency_hz), Some(speed)) = (state.in_chatter, now.heard.frequency_hz, speed) {
            let s = &self.settings;
            let offsets = now.turret.map(|t| t.offsets_m).filter(|o| o.iter().all(|x| x.is_finite()));
            let pitch = offsets.map(|o| pitch_of_shift_rad(s.diameter_m, s.turret.shift(&o)));
            let heard = HeardLine {
                frequency_hz,
                growth_1_s: state.growth.growth_1_s().map(|g| g.clamp(0.0, 200.0)),
                turn_s: speed.period_s(),
                pitch_rad: pitch.unwrap_or(0.0),
            };
            state.lines.hear(&heard, now.now_s);
        }
        state.in_chatter && !before
    }

    /// True where the identified cut had no stable pitch when one was chosen last, and the nearest spindle
    /// speed at which it has one.
    #[must_use]
    pub fn advised_speed_rpm(&self, state: &AvoidanceState) -> (bool, Option<f64>) {
        (state.no_stable_pitch, state.advised_speed_rpm)
    }

    /// The mode was left: nothing more is asked of the turret but to go back.
    fn leave_act(&self, state: &mut AvoidanceState, now: &Situation) -> Decision {
        (state.trial, state.latched, state.moves_in_vain) = (None, None, 0);
        state.next_due_s = now.now_s + self.settings.interval_s;
        Decision::Command(self.back(state, now))
    }

    fn decide_due(&self, state: &mut AvoidanceState, now: &Situation) -> Decision {
        if now.mode == Mode::Observe {
            return Decision::Hold(HoldReason::Observing);
        }
        self.watch_target(state, now);
        let obstacle = self.obstacle(now);
        // Silence of the samples is why the turret goes back, not why it may not.
        let deaf = matches!(obstacle, Some(HoldReason::StaleSamples | HoldReason::WindowNotFull));
        if let Some(reason) = obstacle
            && !(deaf && state.must_go_back())
        {
            return Decision::Hold(reason);
        }
        if let Some(latched) = &mut state.latched {
            let reason = latched.reason;
            if !latched.returned && now.mode == Mode::Act && state.target.is_some() {
                latched.returned = true;
                state.target = None;
                return Decision::Command(self.back(state, now));
            }
            return Decision::Hold(reason);
        }
        if now.now_s < state.refused_until_s {
            return Decision::Hold(HoldReason::TurretRefused);
        }
        if now.operator_hold {
            return self.stay(state, now);
        }
        self.judge(state, now);
        if state.latched.is_some() {
            return self.decide_latched(state, now);
        }
        self.aim(state, now)
    }

    fn decide_latched(&self, state: &mut AvoidanceState, now: &Situation) -> Decision {
        let Some(latched) = &mut state.latched else { return Decision::Hold(HoldReason::Returned) };
        let reason = latched.reason;
        if state.target.take().is_some() && now.mode == Mode::Act {
            latched.returned = true;
            return Decision::Command(self.back(state, now));
        }
        Decision::Hold(reason)
    }

    /// Silence of the samples beyond a second latches the return; looked at on every call, not once an
    /// interval.
    fn watch_silence(&self, state: &mut AvoidanceState, now: &Situation) {
        let silent = now.newest_sample_s.is_none_or(|t| !(now.now_s - t <= STALE_RETURN_S));
        if silent && state.target.is_some() {
            state.latched.get_or_insert(Latched { reason: HoldReason::Returned, returned: false });
        }
    }

    /// What forbids any command now.
    fn obstacle(&self, now: &Situation) -> Option<HoldReason> {
        let s = &self.settings;
        let age = |t_s: f64| now.now_s - t_s;
        let fresh = |t_s: f64, limit_s: f64| (0.0..=limit_s).contains(&age(t_s));
        let stale = now.newest_sample_s.is_none_or(|t| !fresh(t, s.freshness_s));
        match now.interlock {
            Some(i) if !fresh(i.heard_s, s.report_deadline_s) => return Some(HoldReason::InterlockUnheard),
            None => return Some(HoldReason::InterlockUnheard),
            Some(i) if i.open => return Some(HoldReason::InterlockOpen),
            Some(_) => {}
        }
        if now.turret.is_none_or(|t| !fresh(t.heard_s, s.report_deadline_s)) {
            return Some(HoldReason::TurretSilent);
        }
        if now.turret.is_some_and(|t| t.offsets_m.iter().any(|o| !o.is_finite())) {
            return Some(HoldReason::TurretSilent);
        }
        if stale {
            return Some(HoldReason::StaleSamples);
        }
        if !now.window_full {
            return Some(HoldReason::WindowNotFull);
        }
        None
    }

    /// What the turret did with the last command; looked at on every call: a controller may report a refusal
    /// once only, or until it takes a command.
    fn watch_motion(&self, state: &mut AvoidanceState, now: &Situation) {
        let (Some(turret), Some(target)) = (now.turret, state.target) else { return };
        let since_s = turret.heard_s - state.last_command_s;
        if !(since_s > 0.0) {
            return;
        }
        let refused_before = std::mem::replace(&mut state.refusing, turret.motion == TurretMotion::Refused);
        match turret.motion {
            TurretMotion::Refused if state.refused != Some(target.sequence) => {
                let of_this = turret.acknowledged == Some((state.epoch, target.sequence));
                if !refused_before || of_this || since_s > REFUSAL_HEARD_S {
                    state.refused = Some(target.sequence);
                    state.refusals = (state.refusals + 1).min(16);
                    let wait_s = f64::from(1u32 << (state.refusals - 1).min(6)).min(LONGEST_BACKOFF_S);
                    state.refused_until_s = now.now_s + wait_s;
                }
            }
            TurretMotion::Refused => {}
            TurretMotion::Expired if since_s > REFUSAL_HEARD_S => state.expire(),
            _ if since_s > REFUSAL_HEARD_S && state.refused != Some(target.sequence) => state.refusals = 0,
            _ => {}
        }
    }

    /// A target that is not reached, counted once an interval whatever else forbids a command.
    fn watch_target(&self, state: &mut AvoidanceState, now: &Situation) {
        let (Some(turret), Some(target), s) = (now.turret, state.target, &self.settings) else { return };
        let heard = (0.0..=s.report_deadline_s).contains(&(now.now_s - turret.heard_s));
        if !heard || state.refused == Some(target.sequence) {
            return;
        }
        let apart_m = |i: usize| (turret.offsets_m[i] - target.offsets_m[i]).abs();
        let off = s.turret.axes().iter().any(|a| apart_m(a.index) > s.reached_m);
        let time_to_move = now.now_s - target.issued_s >= s.interval_s;
        state.off_target = if off && time_to_move { state.off_target + 1 } else { 0 };
        if state.off_target >= STUCK_INTERVALS {
            state.latched.get_or_insert(Latched { reason: HoldReason::TurretNotReached, returned: false });
        }
    }

    /// True where the turret stands at the pitch that was wanted, not only where one interval takes it.
    pub(super) fn arrived(&self, state: &AvoidanceState, now: &Situation) -> bool {
        let (Some(turret), Some(target), s) = (now.turret, state.target, &self.settings) else {
            return false;
        };
        let Ok(shift) = tool_shift(s.diameter_m, target.requested_rad) else { return false };
        let wanted_m = s.turret.offsets_m(shift);
        let near = |i: usize| (turret.offsets_m[i] - wanted_m[i]).abs() <= s.reached_m;
        s.turret.axes().iter().all(|a| near(a.index))
    }

    /// Two intervals at a new pitch: did it help?
    fn judge(&self, state: &mut AvoidanceState, now: &Situation) {
        let arrived = self.arrived(state, now);
        let Some(trial) = state.trial.as_mut().filter(|t| !t.to_choose) else { return };
        if arrived {
            trial.intervals += 1;
        }
        if trial.intervals < trial.judged_at {
            return;
        }
        let helped = now.heard.power_n2 < HELPED * trial.power_before_n2;
        match now.heard.phase {
            Phase::Quiet if helped => {
                (state.trial, state.moves_in_vain) = (None, 0);
                return;
            }
            // A detector that fell silent over a vibration that is as loud as before proves nothing.
            Phase::Chatter | Phase::Quiet => {}
            // Neither over nor declared.
            Phase::Learning | Phase::Suspected => return,
        }
        // More time.
        if helped {
            trial.judged_at = trial.intervals + JUDGE_INTERVALS;
            trial.power_before_n2 = now.heard.power_n2;
            state.moves_in_vain = 0;
            return;
        }
        let tried = state.target.map(|t| t.requested_rad);
        if let Some(place) = trial.fruitless_rad.iter_mut().find(|p| p.is_none()) {
            *place = tried;
        }
        let next = trial.attempt + 1;
        if next >= ATTEMPTS || state.moves_in_vain >= MOST_MOVES_IN_VAIN {
            state.hand_over();
        } else {
            let fruitless_rad = trial.fruitless_rad;
            *trial = Trial { attempt: next, fruitless_rad, ..Trial::new(now.heard.power_n2) };
        }
    }

    /// Picks the target and makes the command.
    fn aim(&self, state: &mut AvoidanceState, now: &Situation) -> Decision {
        let Some(spindle) = now.spindle_speed_rpm.and_then(plausible_speed) else {
            return self.renew_or(state, now, HoldReason::SpindleUnknown);
        };
        match now.heard.phase {
            Phase::Chatter => {}
            Phase::Learning => return self.renew_or(state, now, HoldReason::Learning),
            Phase::Suspected => return self.renew_or(state, now, HoldReason::Suspected),
            Phase::Quiet => {
                state.no_stable_pitch = false;
                return self.forestall(state, now, spindle);
            }
        }
        if !now.estimate_valid {
            return self.renew_or(state, now, HoldReason::EstimateNotValid);
        }
        if state.trial.is_some_and(|t| !t.to_choose) {
            return self.renew_or(state, now, HoldReason::NoChatter);
        }
        if state.moves_in_vain >= MOST_MOVES_IN_VAIN {
            state.hand_over();
            return self.decide_latched(state, now);
        }
        let Some(highest_hz) = state.lines.highest_hz() else {
            return self.renew_or(state, now, HoldReason::NoChatter);
        };
        let wanted_rad = match self.choose(state, spindle, highest_hz) {
            Ok(wanted_rad) => wanted_rad,
            Err(reason) => return self.renew_or(state, now, reason),
        };
        if wanted_rad > self.settings.largest_pitch_rad {
            return self.renew_or(state, now, HoldReason::OutsideLimits);
        }
        self.move_to(state, now, self.side * wanted_rad)
    }

    /// Size of the pitch by the identified two-delay model; by eq. (6-10) where the cut cannot be identified.
    fn choose(
        &self,
        state: &mut AvoidanceState,
        spindle: SpindleSpeed,
        highest_hz: f64,
    ) -> Result<f64, HoldReason> {
        (state.no_stable_pitch, state.advised_speed_rpm) = (false, None);
        if let Some(stated) = &self.settings.stated {
            let fruitless: Vec<f64> =
                state.trial.iter().flat_map(|t| t.fruitless_rad).flatten().map(f64::abs).collect();
            let advice = best_pitch(&PitchQuestion {
                stated,
                lines: &state.lines.newest_first(),
                spindle,
                largest_pitch_rad: self.reach_rad,
                fruitless_rad: &fruitless,
            });
            match advice {
                PitchAdvice::Pitch { pitch_rad, .. } => return Ok(pitch_rad),
                PitchAdvice::NoStablePitch { nearest_speed_rpm } => {
                    (state.no_stable_pitch, state.advised_speed_rpm) = (true, nearest_speed_rpm);
                    return Err(HoldReason::NoStablePitch);
                }
                PitchAdvice::NotIdentified => {}
            }
        }
        let attempt = state.trial.map_or(0, |t| t.attempt);
        pitch_for_attempt_rad(spindle, highest_hz, attempt).map_err(|_| HoldReason::OutsideLimits)
    }

    pub(super) fn move_to(&self, state: &mut AvoidanceState, now: &Situation, wanted_rad: f64) -> Decision {
        let Some(turret) = now.turret else { return Decision::Hold(HoldReason::TurretSilent) };
        if !now.store_writable {
            return self.renew_or(state, now, HoldReason::StoreNotWritable);
        }
        let stated_m = self.settings.diameter_m;
        if now.diameter_m.is_some_and(|d| !((d - stated_m).abs() <= DIAMETER_OFF * stated_m)) {
            return self.renew_or(state, now, HoldReason::OutsideLimits);
        }
        let Some((offsets_m, pitch_rad)) = self.reachable(&turret.offsets_m, wanted_rad) else {
            return self.renew_or(state, now, HoldReason::OutsideLimits);
        };
        let step_rad = pitch_rad - state.target.map_or(0.0, |t| t.pitch_rad);
        if step_rad * state.last_step_rad < 0.0 {
            if now.now_s - state.reversals_s[0] < MINUTE_S {
                return self.renew_or(state, now, HoldReason::Hunting);
            }
            state.reversals_s.rotate_left(1);
            state.reversals_s[REVERSALS - 1] = now.now_s;
        }
        if step_rad != 0.0 {
            state.last_step_rad = step_rad;
        }
        let before_chatter = now.heard.phase != Phase::Chatter;
        if !before_chatter {
            let trial = state.trial.unwrap_or(Trial::new(now.heard.power_n2));
            // What the pitch is judged against is how loud it is now, not when the one before was given up.
            state.trial = Some(Trial { to_choose: false, power_before_n2: now.heard.power_n2, ..trial });
        }
        let (requested_rad, issued_s) = (wanted_rad, now.now_s);
        let target = Target { sequence: 0, pitch_rad, requested_rad, offsets_m, issued_s, before_chatter };
        self.issue(state, now, target, CommandKind::Move)
    }

    /// Offsets for a pitch, cut to what the axes can do in one interval from where they are, and the pitch
    /// that they make. `None`: outside the ranges.
    fn reachable(&self, actual_m: &[f64; MAX_AXES], wanted_rad: f64) -> Option<([f64; MAX_AXES], f64)> {
        let s = &self.settings;
        let shift = tool_shift(s.diameter_m, wanted_rad).ok()?;
        let wanted_m = s.turret.offsets_m(shift);
        if !s.turret.reaches(&wanted_m) {
            return None;
        }
        // All axes the same share of their way, so that the tool stays on its path.
        let share = s.turret.axes().iter().fold(1.0f64, |share, axis| {
            let way_m = (wanted_m[axis.index] - actual_m[axis.index]).abs();
            let possible_m = axis.way_m(s.interval_s);
            if way_m > possible_m { share.min(possible_m / way_m) } else { share }
        });
        let mut offsets_m = [0.0; MAX_AXES];
        for axis in s.turret.axes() {
            let i = axis.index;
            let part_m = actual_m[i] + share * (wanted_m[i] - actual_m[i]);
            offsets_m[i] = if share < 1.0 { part_m } else { wanted_m[i] };
        }
        // From outside of its range an axis may be too far to come back in one interval: then nothing.
        if !s.turret.reaches(&offsets_m) {
            return None;
        }
        let pitch_rad = pitch_of_shift_rad(s.diameter_m, s.turret.shift(&offsets_m));
        (pitch_rad.abs() <= s.largest_pitch_rad).then_some((offsets_m, pitch_rad))
    }

    /// The operator holds the turret: what stands is said again so that it does not expire, nothing else.
    fn stay(&self, state: &mut AvoidanceState, now: &Situation) -> Decision {
        let (Some(target), Some(turret)) = (state.target, now.turret) else {
            return Decision::Hold(HoldReason::OperatorHold);
        };
        let way_m = |i: usize| (target.offsets_m[i] - turret.offsets_m[i]).abs();
        let axes = self.settings.turret.axes();
        if axes.iter().any(|a| way_m(a.index) > a.way_m(self.settings.interval_s)) {
            return Decision::Hold(HoldReason::OperatorHold);
        }
        self.issue(state, now, target, CommandKind::Renew)
    }

    /// Keeps the turret where it is told to be; without a target: hold. A target that is on record is renewed
    /// while the record cannot be written (invariant I10); another one is not.
    pub(super) fn renew_or(
        &self,
        state: &mut AvoidanceState,
        now: &Situation,
        reason: HoldReason,
    ) -> Decision {
        let (Some(target), Some(turret)) = (state.target, now.turret) else { return Decision::Hold(reason) };
        // A target that was cut to one interval's way goes on toward what was wanted.
        let Some((offsets_m, pitch_rad)) = self.reachable(&turret.offsets_m, target.requested_rad) else {
            return Decision::Hold(HoldReason::OutsideLimits);
        };
        let same = offsets_m == target.offsets_m;
        if !same && !now.store_writable {
            return Decision::Hold(HoldReason::StoreNotWritable);
        }
        let issued_s = if same { target.issued_s } else { now.now_s };
        let target = Target { pitch_rad, offsets_m, issued_s, ..target };
        self.issue(state, now, target, CommandKind::Renew)
    }

    fn issue(
        &self,
        state: &mut AvoidanceState,
        now: &Situation,
        target: Target,
        kind: CommandKind,
    ) -> Decision {
        let command = Command {
            epoch: state.epoch,
            sequence: state.sequence + 1,
            issued_s: now.now_s,
            based_on_s: now.newest_sample_s.unwrap_or(now.now_s),
            ttl_s: self.settings.ttl_s,
            kind,
            pitch_difference_rad: target.pitch_rad,
            requested_pitch_rad: target.requested_rad,
            offsets_m: target.offsets_m,
        };
        if kind == CommandKind::Move && target.before_chatter {
            state.forestalled_s = now.now_s;
        }
        if now.mode != Mode::Act {
            // Advice changes nothing else: no target, no trial, no number.
            state.trial = None;
            return Decision::Advice(command);
        }
        match kind {
            CommandKind::Move if target.before_chatter => state.forestalled += 1,
            CommandKind::Move => state.moves_in_vain += 1,
            CommandKind::Renew | CommandKind::Return => {}
        }
        state.sequence += 1;
        state.last_command_s = now.now_s;
        state.before = state.target.replace(Target { sequence: command.sequence, ..target });
        Decision::Command(command)
    }

    /// Back to equal pitch.
    fn back(&self, state: &mut AvoidanceState, now: &Situation) -> Command {
        state.before = None;
        state.sequence += 1;
        state.last_command_s = now.now_s;
        Command {
            epoch: state.epoch,
            sequence: state.sequence,
            issued_s: now.now_s,
            based_on_s: now.newest_sample_s.unwrap_or(now.now_s),
            ttl_s: self.settings.ttl_s,
            kind: CommandKind::Return,
            pitch_difference_rad: 0.0,
            requested_pitch_rad: 0.0,
            offsets_m: [0.0; MAX_AXES],
        }
    }
}
