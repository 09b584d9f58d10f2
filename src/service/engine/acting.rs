//! From decision to wire: intent on record first, last look by the guard, then the command port.
//!
//! The port exists in mode `act` only. A return to equal pitch waits for nothing.

use super::super::control::Refusal;
use crate::avoidance::account::{Look, settings_digest};
use crate::avoidance::guard::{self, Facts, Guard, GuardState};
use crate::avoidance::invariants::{Commissioned, CommissionedAxis, InvariantMonitor, Violation};
use crate::avoidance::pitch::{is_same_pitch, pitch_of_shift_rad};
use crate::avoidance::{
    Avoidance, AvoidanceState, Command, CommandKind, Decision, HoldReason, Mode as ActMode, Situation, Wait,
};
use crate::chatter::Phase;
use crate::config::service::ServiceConfig;
use crate::keyframe::Keep as _;
use crate::sample::MAX_AXES;
use crate::service::ledger::Ledger;
use crate::service::live::Mode;
use crate::service::store_watch::SLOW_RECORD;
use crate::transport::wire::{COMMAND_OFFSET, COMMAND_RETURN, ServoPoint, TurretCommand};
use crate::transport::{CommandPublisher, Participant};

/// A record that takes longer than this makes the command too old to send.
const INTENT_DEADLINE_S: f64 = SLOW_RECORD.as_millis() as f64 * 1e-3;
/// Between two commands (invariant I5), counted from when they went out.
const INTERVAL_S: f64 = 1.0;
/// The port stays this long after the last word, so that a slow reader still finds it.
const PORT_LINGERS_S: f64 = 0.3;

/// A command whose intent is being recorded.
#[derive(Debug, Clone, Copy)]
struct Pending {
    command: Command,
    origin: SampleOrigin,
}

/// Which sample a decision rests on, on the producer's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct SampleOrigin {
    pub(super) stream: u64,
    pub(super) t_ns: u64,
}

/// What became of a command just now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Outcome {
    /// It went out.
    Sent(Command),
    /// The one of this number was not sent, for one of the closed list of reasons.
    Held(u64, &'static str),
}

/// Decision, guard and port.
pub(super) struct Acting {
    avoidance: Avoidance,
    state: AvoidanceState,
    monitor: InvariantMonitor,
    guard: Guard,
    guard_state: GuardState,
    port: Option<CommandPublisher>,
    port_closes_s: Option<f64>,
    pending: Option<Pending>,
    /// Equal pitch was decided and did not go out.
    unreturned: Option<Pending>,
    recorded_rad: Option<f64>,
    sent_s: Option<f64>,
    /// Number of the latest command that did not go out.
    pub(super) withheld: Option<u64>,
    pub(super) axes: [usize; 2],
    /// Last command that went out or was advised.
    pub(super) latest: Option<Command>,
    pub(super) hold: Option<&'static str>,
    /// Why the pitch stays although the margin of a silent cut runs out.
    pub(super) waits: Option<&'static str>,
    /// What was advised last was so before any chatter.
    advised_before: bool,
}

pub(super) fn act_mode(mode: Mode) -> ActMode {
    match mode {
        Mode::Observe => ActMode::Observe,
        Mode::Advise => ActMode::Advise,
        Mode::Act => ActMode::Act,
    }
}

impl Acting {
    /// The decision for a stream of these axes. Errors: one line which setting does not fit.
    pub(super) fn new(
        config: &ServiceConfig,
        names: &[String],
        (epoch, now_s): (u64, f64),
    ) -> Result<Self, String> {
        let settings = config.avoidance_settings(names)?;
        let axes = settings.turret.axes().map(|a| a.index);
        let avoidance = Avoidance::new(settings).map_err(|e| format!("turret: {e}"))?;
        let turret = &config.turret;
        let mut guard = Guard {
            diameter_m: config.cut.workpiece.diameter_m(),
            largest_pitch_rad: turret.largest_pitch_difference_rad,
            ..Guard::default()
        };
        for (i, index) in axes.into_iter().enumerate() {
            guard.lowest_m[index] = turret.lowest_offset_m[i];
            guard.highest_m[index] = turret.highest_offset_m[i];
            guard.speed_m_s[index] = turret.speed_m_s[i];
            guard.acceleration_m_s2[index] = turret.acceleration_m_s2[i];
            guard.direction_rad[index] = turret.direction_rad[i];
        }
        Ok(Self {
            monitor: InvariantMonitor::new(commissioned(config, axes), now_s),
            state: avoidance.start(epoch, now_s),
            avoidance,
            guard,
            guard_state: GuardState::default(),
            port: None,
            port_closes_s: None,
            pending: None,
            unreturned: None,
            recorded_rad: None,
            sent_s: None,
            withheld: None,
            axes,
            latest: None,
            hold: None,
            waits: None,
            advised_before: false,
        })
    }

    /// Tells settings apart that decide differently.
    pub(super) fn settings_digest(&self) -> u64 {
        settings_digest(self.avoidance.settings())
    }

    /// Whether the cut has no stable pitch, and the spindle speed at which it has one.
    pub(super) fn advised_speed_rpm(&self) -> (bool, Option<f64>) {
        self.avoidance.advised_speed_rpm(&self.state)
    }

    /// Pitch difference that offsets make, rad.
    pub(super) fn pitch_rad(&self, offsets_m: &[f64; MAX_AXES]) -> f64 {
        let settings = self.avoidance.settings();
        pitch_of_shift_rad(settings.diameter_m, settings.turret.shift(offsets_m))
    }

    /// Opens the port for mode `act`. Errors: another service commands this turret.
    pub(super) fn open_port(&mut self, who: &Participant) -> Result<(), Refusal> {
        self.port_closes_s = None;
        if self.port.is_none() {
            let opened = CommandPublisher::open(who);
            self.port = Some(opened.map_err(|e| Refusal::NotReady(e.to_string()))?);
        }
        Ok(())
    }

    /// Lets the port go a moment after `act` was left.
    pub(super) fn close_port_later(&mut self, now_s: f64) {
        if self.port.is_some() {
            self.port_closes_s.get_or_insert(now_s + PORT_LINGERS_S);
        }
    }

    /// A stream begins: the monitor counts its samples for itself.
    pub(super) fn stream_begins(&mut self, rate_hz: f64) {
        self.monitor.stream_begins(rate_hz);
    }

    /// Shows the monitor a sample as it travelled; one whose stamp nobody believes is none.
    pub(super) fn sample_seen(&mut self, now_s: f64, (point, believed): (&ServoPoint, bool), axes: usize) {
        let here = |i: usize| point.valid >> (3 * i) & 0b011 == 0b011; // current and motor angle are measured
        let mut signals = point.axes.iter().take(axes).enumerate();
        let usable =
            signals.all(|(i, a)| here(i) && a.current_ref_a.is_finite() && a.motor_angle_rad.is_finite());
        self.monitor.sample(now_s, point.sequence, usable && believed);
    }

    /// A command that waited for its record went out late; the next one keeps its distance.
    pub(super) fn too_soon(&self, now: &Situation) -> bool {
        now.mode == ActMode::Act && self.sent_s.is_some_and(|sent| now.now_s - sent < INTERVAL_S)
    }

    /// One look at the decision, and what the independent monitor says of it: a decision that breaks a rule
    /// is not carried out. The look goes into the ledger with the time of the newest sample.
    pub(super) fn decide(
        &mut self,
        situation: &Situation,
        (t_s, ledger): (Option<f64>, &mut Ledger),
    ) -> (Decision, Result<(), Violation>) {
        if self.port_closes_s.is_some_and(|t| situation.now_s >= t) {
            (self.port, self.port_closes_s, self.unreturned) = (None, None, None);
        }
        // All is looked at: a controller may tell a refusal once.
        let situation = &Situation { too_soon: self.too_soon(situation), ..*situation };
        ledger.before(|words| self.state.keep(words));
        let decision = self.avoidance.decide(&mut self.state, situation);
        self.waits = self.avoidance.waits_before_chatter(&self.state, situation).map(Wait::name);
        ledger.push(&Look { t_s, situation: *situation, decision });
        let verdict = self.monitor.watch(situation, &decision);
        if verdict.is_err() {
            self.hold = Some(HoldReason::Guarded.name());
            return (Decision::Hold(HoldReason::Guarded), verdict);
        }
        match &decision {
            Decision::NotDue => {}
            Decision::Hold(reason) => self.hold = Some(reason.name()),
            Decision::Advice(command) => {
                self.hold = None;
                self.latest = Some(*command);
                self.advised_before = situation.heard.phase != Phase::Chatter;
            }
            Decision::Command(_) => self.hold = None,
        }
        (decision, verdict)
    }

    /// Whether the pitch that stands, or in `advise` the one advised last, is one before any chatter.
    pub(super) fn is_before_chatter(&self, mode: Mode) -> bool {
        match mode {
            Mode::Observe => false,
            Mode::Advise => self.latest.is_some() && self.advised_before,
            Mode::Act => self.state.stands_before_chatter(),
        }
    }

    /// Gives the monitor other limits than the decision has: a planted fault.
    #[cfg(test)]
    pub(super) fn mislead(&mut self, limits: Commissioned, now_s: f64) {
        self.monitor = InvariantMonitor::new(limits, now_s);
    }

    /// As if a command had gone out then.
    #[cfg(test)]
    pub(super) fn sent_at(&mut self, now_s: f64) {
        self.sent_s = Some(now_s);
    }

    /// Whether a command must be on record before it goes: every one that moves something to another pitch
    /// than the one on record. A record that came too late for its own samples is good for the next command.
    pub(super) fn needs_record(&self, command: &Command) -> bool {
        command.kind != CommandKind::Return
            && !self.recorded_rad.is_some_and(|pitch| is_same_pitch(pitch, command.pitch_difference_rad))
    }

    /// Keeps a command until its intent is durable.
    pub(super) fn wait_for_record(&mut self, command: Command, origin: SampleOrigin) {
        self.pending = Some(Pending { command, origin });
    }

    /// The intent of that sequence is durable: send it, if it is still wanted.
    pub(super) fn recorded(&mut self, sequence: u64, facts: &Facts) -> Option<Outcome> {
        let pending = self.pending.filter(|p| p.command.sequence == sequence)?;
        self.pending = None;
        self.recorded_rad = Some(pending.command.pitch_difference_rad);
        if facts.now_s - pending.command.issued_s > INTENT_DEADLINE_S {
            return Some(self.held(sequence, "intent_expired"));
        }
        Some(self.send(&pending.command, pending.origin, facts))
    }

    /// A command whose record nobody waits for any more: it waited too long, or `act` was left.
    pub(super) fn overdue(&mut self, now_s: f64, mode: ActMode) -> Option<Outcome> {
        let left = mode != ActMode::Act;
        let late = self.pending.take_if(|p| left || now_s - p.command.issued_s > INTENT_DEADLINE_S)?;
        Some(self.held(late.command.sequence, if left { "mode_left" } else { "store_unavailable" }))
    }

    /// Tries equal pitch again, where it did not go out, until it does.
    pub(super) fn return_again(&mut self, facts: &Facts) -> Option<Outcome> {
        let Pending { command, origin } = self.unreturned?;
        self.put(&command, origin, facts).ok()?;
        Some(Outcome::Sent(command))
    }

    /// The decision is told with the next look, so that it does not wait for what was never asked.
    fn held(&mut self, sequence: u64, reason: &'static str) -> Outcome {
        (self.hold, self.withheld) = (Some(reason), Some(sequence));
        Outcome::Held(sequence, reason)
    }

    /// Guard, then wire.
    pub(super) fn send(&mut self, command: &Command, origin: SampleOrigin, facts: &Facts) -> Outcome {
        match self.put(command, origin, facts) {
            Ok(()) => Outcome::Sent(*command),
            Err(reason) => {
                let returns = command.kind == CommandKind::Return;
                self.unreturned = returns.then_some(Pending { command: *command, origin });
                self.held(command.sequence, reason)
            }
        }
    }

    fn put(&mut self, command: &Command, origin: SampleOrigin, facts: &Facts) -> Result<(), &'static str> {
        let port = self.port.as_ref().ok_or("no_port")?;
        let mut guard_state = self.guard_state;
        self.guard.pass(&mut guard_state, command, facts).map_err(guard::Refusal::name)?;
        // What did not go out may be tried again under its number.
        port.send(&wire_command(command, origin)).map_err(|_| "stage_failed")?;
        (self.guard_state, self.unreturned) = (guard_state, None);
        (self.latest, self.sent_s) = (Some(*command), Some(facts.now_s));
        if command.kind == CommandKind::Return {
            self.recorded_rad = None;
        }
        Ok(())
    }
}

/// The limits as the monitor is told them: from the configuration, past the decision's settings.
pub(super) fn commissioned(config: &ServiceConfig, axes: [usize; 2]) -> Commissioned {
    let turret = &config.turret;
    let axis = |i: usize| CommissionedAxis {
        index: axes[i],
        direction_rad: turret.direction_rad[i],
        range_m: [turret.lowest_offset_m[i], turret.highest_offset_m[i]],
        speed_m_s: turret.speed_m_s[i],
        acceleration_m_s2: turret.acceleration_m_s2[i],
    };
    Commissioned {
        axes: [axis(0), axis(1)],
        diameter_m: config.cut.workpiece.diameter_m(),
        largest_pitch_rad: turret.largest_pitch_difference_rad,
        report_deadline_s: 0.5,
        reached_m: 20e-6,
        before_chatter: turret.before_chatter,
    }
}

/// The command as it travels: offsets and numbers unchanged, times on the clocks of the wire.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
fn wire_command(command: &Command, origin: SampleOrigin) -> TurretCommand {
    TurretCommand {
        epoch: command.epoch,
        sequence: command.sequence,
        based_on_t_ns: origin.t_ns,
        issued_t_ns: (command.issued_s.max(0.0) * 1e9) as u64,
        ttl_ns: (command.ttl_s * 1e9) as u64,
        stream: origin.stream,
        pitch_difference_rad: command.pitch_difference_rad,
        offset_m: command.offsets_m,
        axis_count: MAX_AXES as u32,
        kind: if command.kind == CommandKind::Return { COMMAND_RETURN } else { COMMAND_OFFSET },
    }
}
