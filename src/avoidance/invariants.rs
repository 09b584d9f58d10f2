//! The command invariants, watched from outside: it sees what was known and what was decided, computes
//! everything anew, and shares no code with the decision or the guard. It runs in tests and in production; a
//! violation there is a fault of ours and ends mode `act`.

use super::{Command, CommandKind, Decision, Foreseen, Mode, Situation, TurretMotion};
use crate::chatter::Phase;
use crate::sample::MAX_AXES;

/// Commissioned limits as the watcher was told them, independently of the decision's settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Commissioned {
    /// The two axes of turret 1.
    pub axes: [CommissionedAxis; 2],
    /// Diameter at the tools.
    pub diameter_m: f64,
    /// Largest pitch difference.
    pub largest_pitch_rad: f64,
    /// Oldest report that may be acted on.
    pub report_deadline_s: f64,
    /// Distance that counts as reached.
    pub reached_m: f64,
    /// The pitch may move before chatter, where the stability margin runs out.
    pub before_chatter: bool,
}

/// One axis of turret 1 as the watcher was told of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CommissionedAxis {
    /// Place in the stream.
    pub index: usize,
    /// Direction from "toward the bar", rad.
    pub direction_rad: f64,
    /// Least and greatest offset, m.
    pub range_m: [f64; 2],
    /// Fastest motion, m/s.
    pub speed_m_s: f64,
    /// Largest acceleration, m/s2.
    pub acceleration_m_s2: f64,
}

impl CommissionedAxis {
    /// True where it can go so far and stand again in a time: the time of the fastest such motion is shorter.
    fn can_go(&self, way_m: f64, time_s: f64) -> bool {
        let full_speed_m = self.speed_m_s * self.speed_m_s / self.acceleration_m_s2;
        let needs_s = if way_m > full_speed_m {
            (way_m + full_speed_m) / self.speed_m_s
        } else {
            2.0 * (way_m / self.acceleration_m_s2).sqrt()
        };
        needs_s <= time_s + 1e-6
    }
}

/// Which rule was broken. Numbers are those of the project's list of command invariants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Violation {
    /// I1: outside the limits, not finite, or offsets and pitch do not belong together.
    Envelope,
    /// The pitch has nothing to do with what was heard.
    Purpose,
    /// I2: interlock open or unheard.
    Interlock,
    /// I3, I13: commanded outside of `act`, or while the operator holds.
    Mode,
    /// I4: farther than the axes may go.
    Rate,
    /// I5: too soon.
    Interval,
    /// I6: on stale or incomplete evidence.
    Freshness,
    /// I7: lives too long.
    Lifetime,
    /// I8: no return where there must be one.
    Return,
    /// I9: number not above the last.
    Identity,
    /// I10: commanded though intents cannot be recorded.
    Record,
    /// I11: commanded though the turret refuses or does not follow.
    Reached,
    /// I12: too many reversals, or targets that do not help.
    Hunting,
    /// I15: an interval without a decision.
    Silence,
}

impl Violation {
    /// All of them.
    pub const ALL: [Self; 14] = [
        Self::Envelope,
        Self::Purpose,
        Self::Interlock,
        Self::Mode,
        Self::Rate,
        Self::Interval,
        Self::Freshness,
        Self::Lifetime,
        Self::Return,
        Self::Identity,
        Self::Record,
        Self::Reached,
        Self::Hunting,
        Self::Silence,
    ];

    /// Name in records and metrics.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Envelope => "envelope",
            Self::Purpose => "purpose",
            Self::Interlock => "interlock",
            Self::Mode => "mode",
            Self::Rate => "rate",
            Self::Interval => "interval",
            Self::Freshness => "freshness",
            Self::Lifetime => "lifetime",
            Self::Return => "return",
            Self::Identity => "identity",
            Self::Record => "record",
            Self::Reached => "reached",
            Self::Hunting => "hunting",
            Self::Silence => "silence",
        }
    }
}

/// What the watcher itself saw of the samples, past whoever takes them in.
#[derive(Debug, Clone, Copy, PartialEq)]
struct SamplesSeen {
    /// Samples that fill the detector's window.
    window: u64,
    /// The last usable one: when it came, its number.
    newest: Option<(f64, u64)>,
    /// Usable ones since the last that was missing, repeated or no number.
    run: u64,
}

/// The watcher.
#[derive(Debug, Clone, PartialEq)]
pub struct InvariantMonitor {
    limits: Commissioned,
    last_id: Option<(u64, u64)>,
    last_command_s: f64,
    standing: Option<Command>,
    stood_before: Option<Command>,
    samples: Option<SamplesSeen>,
    must_return: bool,
    /// Since when that stands while nothing forbids a return.
    must_since_s: Option<f64>,
    returned_s: f64,
    last_decision_s: Option<f64>,
    last_now_s: f64,
    was_acting: bool,
    heard_hz: [(f64, f64); 64],
    off_since: u32,
    refusals: i32,
    refused: Option<(u64, u64)>,
    reports_refusal: bool,
    refused_until_s: f64,
    /// Targets since chatter was silent or 3 dB less than `loud_n2`.
    targets: u32,
    loud_n2: f64,
    /// When the last targets before chatter were asked for; the standing one is of these.
    silent_s: [f64; 5],
    stands_silent: bool,
    turns_s: [f64; 7],
    last_step_rad: f64,
}

impl InvariantMonitor {
    /// Watches from `now_s` on, the time at which the decision was started.
    #[must_use]
    pub fn new(limits: Commissioned, now_s: f64) -> Self {
        Self {
            limits,
            last_id: None,
            last_command_s: f64::NEG_INFINITY,
            standing: None,
            stood_before: None,
            samples: None,
            must_return: false,
            must_since_s: None,
            returned_s: f64::NEG_INFINITY,
            last_decision_s: None,
            last_now_s: now_s,
            was_acting: false,
            heard_hz: [(f64::NEG_INFINITY, 0.0); 64],
            off_since: 0,
            refusals: 0,
            refused: None,
            reports_refusal: false,
            refused_until_s: f64::NEG_INFINITY,
            targets: 0,
            loud_n2: 0.0,
            silent_s: [f64::NEG_INFINITY; 5],
            stands_silent: false,
            turns_s: [f64::NEG_INFINITY; 7],
            last_step_rad: 0.0,
        }
    }

    /// A stream of samples begins; from here on the watcher believes its own count of them more than the
    /// situation's.
    pub fn stream_begins(&mut self, rate_hz: f64) {
        // A second of samples; rates are between 1 kHz and some 100 kHz.
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let window = rate_hz.clamp(1.0, 1e9) as u64;
        self.samples = Some(SamplesSeen { window, newest: None, run: 0 });
    }

    /// A sample came, as it travelled.
    pub fn sample(&mut self, now_s: f64, sequence: u64, usable: bool) {
        let Some(seen) = &mut self.samples else { return };
        let next = seen.newest.is_none_or(|(_, last)| Some(sequence) == last.checked_add(1));
        let newer = seen.newest.is_none_or(|(_, last)| sequence > last);
        seen.run = match (usable, next, newer) {
            (true, true, _) => seen.run.saturating_add(1),
            (true, false, true) => 1,
            _ => 0,
        };
        if usable && newer {
            seen.newest = Some((now_s, sequence));
        }
    }

    /// Errors: the first rule that this decision breaks in this situation.
    pub fn watch(&mut self, seen: &Situation, decision: &Decision) -> Result<(), Violation> {
        if !seen.now_s.is_finite() || seen.now_s < self.last_now_s {
            // A clock that runs backwards: nothing may be commanded on it.
            self.last_decision_s = Some(self.last_now_s);
            self.must_since_s = None;
            return if matches!(decision, Decision::Command(_)) { Err(Violation::Interval) } else { Ok(()) };
        }
        self.last_now_s = seen.now_s;
        self.remember(seen);
        let verdict = match decision {
            Decision::Command(command) => self.command(seen, command),
            Decision::NotDue => self.not_due(seen),
            Decision::Hold(_) | Decision::Advice(_) => self.no_command(seen),
        };
        self.was_acting = seen.mode == Mode::Act;
        verdict.and_then(|()| self.goes_back(seen))
    }

    /// What must go back is told so within a second and the interval that a command may have begun.
    fn goes_back(&mut self, seen: &Situation) -> Result<(), Violation> {
        let heard = |t: f64| (0.0..=self.limits.report_deadline_s).contains(&(seen.now_s - t));
        let closed = seen.interlock.is_some_and(|i| !i.open && heard(i.heard_s));
        let turret =
            seen.turret.is_some_and(|t| heard(t.heard_s) && t.offsets_m.iter().all(|o| o.is_finite()));
        let must = self.must_return && self.standing.is_some() && seen.mode == Mode::Act;
        if !(must && closed && turret && !seen.too_soon) {
            self.must_since_s = None;
            return Ok(());
        }
        let since_s = *self.must_since_s.get_or_insert(seen.now_s);
        if seen.now_s - since_s > 1.0 + 1e-6 { Err(Violation::Return) } else { Ok(()) }
    }

    fn remember(&mut self, seen: &Situation) {
        if let (Phase::Chatter, Some(f)) = (seen.heard.phase, seen.heard.frequency_hz)
            && f.is_finite()
            // Asked a thousand times a second: one entry serves half a second of a steady line.
            && !(seen.now_s - self.heard_hz[0].0 < 0.5 && (f - self.heard_hz[0].1).abs() < 1.0)
        {
            self.heard_hz.rotate_right(1);
            self.heard_hz[0] = (seen.now_s, f);
        }
        if self.standing.is_some_and(|s| Some(s.sequence) == seen.withheld) {
            self.standing = self.stood_before.take();
            self.off_since = 0;
            if self.stands_silent {
                self.silent_s.rotate_left(1);
                self.silent_s[4] = f64::NEG_INFINITY;
            } else {
                self.targets = self.targets.saturating_sub(1);
            }
        }
        if seen.operator_acknowledge {
            (self.must_return, self.off_since, self.targets) = (false, 0, 0);
        }
        self.hear_turret(seen);
        self.hear_power(seen);
        let age = |newest: Option<f64>| newest.map_or(f64::INFINITY, |t| seen.now_s - t);
        let own = self.samples.map_or(0.0, |s| age(s.newest.map(|n| n.0)));
        // Not a number counts as silence.
        if self.standing.is_some() && !(age(seen.newest_sample_s) <= 1.0 && own <= 1.0) {
            self.must_return = true;
        }
    }

    /// Refusals count once for each command, whether they are reported once or until another one is taken.
    fn hear_turret(&mut self, seen: &Situation) {
        let (Some(turret), Some(standing)) = (&seen.turret, &self.standing) else { return };
        let after_s = turret.heard_s - self.last_command_s;
        if !(after_s > 0.0) {
            return;
        }
        let (id, refuses) = ((standing.epoch, standing.sequence), turret.motion == TurretMotion::Refused);
        let begins = refuses && !self.reports_refusal;
        self.reports_refusal = refuses;
        let long_after = after_s > 0.25;
        if refuses && self.refused != Some(id) && (begins || long_after || turret.acknowledged == Some(id)) {
            self.refused = Some(id);
            let wait_s = 2.0f64.powi(self.refusals).min(60.0);
            (self.refusals, self.refused_until_s) = ((self.refusals + 1).min(10), seen.now_s + wait_s);
        } else if !refuses && long_after && self.refused != Some(id) {
            self.refusals = 0;
        }
        if turret.motion == TurretMotion::Expired && long_after {
            (self.standing, self.stood_before, self.off_since) = (None, None, 0);
        }
    }

    /// What the next targets must have helped against.
    fn hear_power(&mut self, seen: &Situation) {
        let power_n2 = seen.heard.power_n2;
        match seen.heard.phase {
            Phase::Quiet | Phase::Chatter if power_n2 < 0.5 * self.loud_n2 => {
                (self.targets, self.loud_n2) = (0, power_n2);
            }
            _ => self.loud_n2 = self.loud_n2.max(power_n2),
        }
    }

    fn left_act(&self, seen: &Situation) -> bool {
        self.was_acting && seen.mode != Mode::Act && self.standing.is_some()
    }

    fn not_due(&self, seen: &Situation) -> Result<(), Violation> {
        if self.left_act(seen) {
            return Err(Violation::Return);
        }
        // A command that waited for its record keeps the next one off for as long.
        let most_s = if seen.too_soon { 2.0 } else { 1.0 };
        match self.last_decision_s {
            Some(t) if seen.now_s - t > most_s + 1e-6 => Err(Violation::Silence),
            _ => Ok(()),
        }
    }

    fn no_command(&mut self, seen: &Situation) -> Result<(), Violation> {
        if self.left_act(seen) {
            return Err(Violation::Return);
        }
        self.interval_passed(seen);
        self.last_decision_s = Some(seen.now_s);
        Ok(())
    }

    /// Once an interval: does the turret follow, does it refuse?
    fn interval_passed(&mut self, seen: &Situation) {
        let (Some(standing), Some(turret)) = (&self.standing, &seen.turret) else { return };
        let heard = seen.now_s - turret.heard_s;
        if !(0.0..=self.limits.report_deadline_s).contains(&heard) {
            return;
        }
        if self.refused == Some((standing.epoch, standing.sequence)) {
            return;
        }
        let far = |a: &CommissionedAxis| {
            (turret.offsets_m[a.index] - standing.offsets_m[a.index]).abs() > self.limits.reached_m
        };
        let off = self.limits.axes.iter().any(far) && seen.now_s - standing.issued_s > 0.999;
        self.off_since = if off { self.off_since + 1 } else { 0 };
    }

    fn command(&mut self, seen: &Situation, command: &Command) -> Result<(), Violation> {
        self.last_decision_s = Some(seen.now_s);
        let id = (command.epoch, command.sequence);
        if self.last_id.is_some_and(|last| id <= last) {
            return Err(Violation::Identity);
        }
        self.last_id = Some(id);
        if !(command.ttl_s > 0.0 && command.ttl_s <= 2.5) {
            return Err(Violation::Lifetime);
        }
        if command.kind == CommandKind::Return {
            return self.check_return(seen, command);
        }
        // The operator holds the turret: what stands may be said again, nothing else.
        let same = self.standing.is_some_and(|s| s.offsets_m == command.offsets_m);
        let again = same && command.kind == CommandKind::Renew;
        if seen.mode != Mode::Act || seen.operator_hold && !again {
            return Err(Violation::Mode);
        }
        self.check_evidence(seen, command)?;
        self.check_numbers(seen, command)?;
        if self.must_return && !seen.operator_acknowledge {
            return Err(Violation::Return);
        }
        self.must_return = false;
        self.check_turret(seen, command)?;
        self.last_command_s = seen.now_s;
        let before = self.standing.filter(|b| b.offsets_m == command.offsets_m);
        self.stood_before = self.standing;
        self.standing = Some(Command { issued_s: before.map_or(seen.now_s, |b| b.issued_s), ..*command });
        Ok(())
    }

    fn check_return(&mut self, seen: &Situation, command: &Command) -> Result<(), Violation> {
        let zero = command.offsets_m.iter().all(|o| *o == 0.0) && command.pitch_difference_rad == 0.0;
        let again = self.standing.is_none() && seen.now_s - self.returned_s < 1.0;
        if !zero || again {
            return Err(if zero { Violation::Interval } else { Violation::Envelope });
        }
        // Going back before the second is over is for leaving `act` alone.
        if seen.mode == Mode::Act && seen.now_s - self.last_command_s < 1.0 - 1e-6 {
            return Err(Violation::Interval);
        }
        (self.standing, self.stood_before) = (None, None);
        self.must_return = false;
        (self.off_since, self.targets) = (0, 0);
        self.last_step_rad = 0.0;
        self.returned_s = seen.now_s;
        self.last_command_s = seen.now_s;
        Ok(())
    }

    fn check_evidence(&self, seen: &Situation, command: &Command) -> Result<(), Violation> {
        let within = |t: f64, limit: f64| seen.now_s - t >= 0.0 && seen.now_s - t <= limit;
        let closed =
            seen.interlock.is_some_and(|i| !i.open && within(i.heard_s, self.limits.report_deadline_s));
        if !closed {
            return Err(Violation::Interlock);
        }
        let fresh = seen.newest_sample_s.is_some_and(|t| within(t, 0.05)) && within(command.based_on_s, 0.05);
        let believed = seen.estimate_valid || command.kind != CommandKind::Move;
        let own =
            self.samples.is_none_or(|s| s.run >= s.window && s.newest.is_some_and(|n| within(n.0, 0.05)));
        if !(fresh && own && seen.window_full && believed) {
            return Err(Violation::Freshness);
        }
        // What stands on record already may be said again.
        let same = self.standing.is_some_and(|s| s.offsets_m == command.offsets_m);
        if !(seen.store_writable || (same && command.kind == CommandKind::Renew)) {
            return Err(Violation::Record);
        }
        if seen.now_s - self.last_command_s < 1.0 - 1e-6 {
            return Err(Violation::Interval);
        }
        Ok(())
    }

    fn check_numbers(&self, seen: &Situation, command: &Command) -> Result<(), Violation> {
        let Some(turret) = &seen.turret else { return Err(Violation::Freshness) };
        let pitch = command.pitch_difference_rad;
        if !(pitch.abs() <= self.limits.largest_pitch_rad) {
            return Err(Violation::Envelope);
        }
        let elapsed_s = (seen.now_s - self.last_command_s).min(1.0);
        let (mut toward, mut around) = (0.0, 0.0);
        for index in 0..MAX_AXES {
            let offset = command.offsets_m[index];
            match self.limits.axes.iter().find(|a| a.index == index) {
                None if offset == 0.0 => {}
                Some(axis) if offset >= axis.range_m[0] && offset <= axis.range_m[1] => {
                    toward += offset * axis.direction_rad.cos();
                    around += offset * axis.direction_rad.sin();
                    if !axis.can_go((offset - turret.offsets_m[index]).abs(), elapsed_s) {
                        return Err(Violation::Rate);
                    }
                }
                _ => return Err(Violation::Envelope),
            }
        }
        let made = 2.0 * (around / (self.limits.diameter_m / 2.0 - toward)).atan();
        if (made - pitch).abs() > 1e-6 {
            return Err(Violation::Envelope);
        }
        self.check_purpose(seen, command)
    }

    /// A new target must bring some line heard in the last minute between 0.3 pi and 1.2 pi, or with whole
    /// waves between 0.6 pi and 1.2 pi; before chatter the line that is foreseen now to 1.2 pi at most, where
    /// that is commissioned.
    fn check_purpose(&self, seen: &Situation, command: &Command) -> Result<(), Violation> {
        if command.kind != CommandKind::Move {
            return Ok(());
        }
        let Some(rpm) = seen.spindle_speed_rpm else { return Err(Violation::Purpose) };
        if seen.heard.phase == Phase::Quiet {
            let serves = |root: Foreseen| {
                let phase_rad = 60.0 * root.frequency_hz * command.requested_pitch_rad.abs() / rpm.abs();
                (0.0..=1.2 * std::f64::consts::PI).contains(&phase_rad)
            };
            let foreseen = seen.foreseen.is_some_and(serves) && self.limits.before_chatter;
            return if foreseen { Ok(()) } else { Err(Violation::Purpose) };
        }
        let serves = |(t, f): &(f64, f64)| {
            let phase = 60.0 * f * command.requested_pitch_rad.abs() / rpm.abs() / std::f64::consts::PI;
            seen.now_s - t < 60.5 && ((0.3..=1.2).contains(&phase) || (0.6..=1.2).contains(&(phase % 2.0)))
        };
        if self.heard_hz.iter().any(serves) { Ok(()) } else { Err(Violation::Purpose) }
    }

    fn check_turret(&mut self, seen: &Situation, command: &Command) -> Result<(), Violation> {
        if let Some(turret) = &seen.turret {
            if !(seen.now_s - turret.heard_s <= self.limits.report_deadline_s) {
                return Err(Violation::Freshness);
            }
            if seen.now_s < self.refused_until_s {
                return Err(Violation::Reached);
            }
        }
        self.interval_passed(seen);
        if self.off_since >= 3 {
            return Err(Violation::Reached);
        }
        if command.kind == CommandKind::Move {
            self.stands_silent = seen.heard.phase == Phase::Quiet;
            if self.targets == 0 {
                self.loud_n2 = seen.heard.power_n2;
            }
            if self.stands_silent {
                if seen.now_s - self.silent_s[4] < 60.0 - 1e-6 {
                    return Err(Violation::Hunting);
                }
                // What the last pitch did to the margin takes two of its blocks to be read.
                if seen.now_s - self.silent_s[0] < 4.0 - 1e-6 {
                    return Err(Violation::Interval);
                }
                self.silent_s.rotate_right(1);
                self.silent_s[0] = seen.now_s;
            } else {
                self.targets += 1;
            }
            if self.targets > 5 {
                return Err(Violation::Hunting);
            }
        }
        let step = command.pitch_difference_rad - self.standing.map_or(0.0, |s| s.pitch_difference_rad);
        if command.kind == CommandKind::Move && step.abs() > 1e-6 {
            if step * self.last_step_rad < 0.0 {
                self.turns_s.rotate_right(1);
                self.turns_s[0] = seen.now_s;
                if seen.now_s - self.turns_s[6] < 59.9 {
                    return Err(Violation::Hunting);
                }
            }
            self.last_step_rad = step;
        }
        Ok(())
    }
}
