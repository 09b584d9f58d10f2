//! What the controller reports of the turret, and what is asked of it.

use super::acting::{Acting, Outcome, SampleOrigin, act_mode};
use super::intake::Stream;
use super::{Engine, STATUS_DEADLINE};
use crate::avoidance::guard::Facts;
use crate::avoidance::invariants::Violation;
use crate::avoidance::pitch::is_same_pitch;
use crate::avoidance::{
    Command, CommandKind, Decision, Heard, HoldReason, Interlock, Mode as ActMode, Situation, TurretMotion,
    TurretReport,
};
use crate::chatter::Phase;
use crate::force::validity::Validity;
use crate::sample::MAX_AXES;
use crate::service::clock;
use crate::service::commissioning::HeardNow;
use crate::service::hub::Report;
use crate::service::live::Mode;
use crate::telemetry::{Event, EventKind};
use crate::transport::wire::{
    INTERLOCK_NAMES, TURRET_EXPIRED, TURRET_LIMITED, TURRET_REACHED, TURRET_REFUSED, TurretStatus,
};
use std::time::Instant;

fn motion_of(state: u32) -> TurretMotion {
    match state {
        TURRET_REACHED => TurretMotion::Reached,
        TURRET_REFUSED => TurretMotion::Refused,
        TURRET_LIMITED => TurretMotion::Limited,
        TURRET_EXPIRED => TurretMotion::Expired,
        _ => TurretMotion::Moving,
    }
}

/// Reasons that stop acting until a person has looked. Acting needs its conditions without a break:
/// interlocks closed and heard, a turret that reports. Losing any one ends it; it never resumes by itself.
fn needs_a_person(reason: HoldReason) -> bool {
    matches!(
        reason,
        HoldReason::TurretNotReached
            | HoldReason::HandedOver
            | HoldReason::Returned
            | HoldReason::InterlockOpen
            | HoldReason::InterlockUnheard
            | HoldReason::TurretSilent
    )
}

impl Engine {
    /// Seconds on the thread's own monotonic clock.
    pub(super) fn seconds(&self, at: Instant) -> f64 {
        at.duration_since(self.began).as_secs_f64()
    }

    /// Makes the decision for the first stream; a later one must have the turret at the same places.
    pub(super) fn prepare_acting(&mut self, stream: &Stream) -> Result<(), String> {
        let now_s = self.seconds(clock::now());
        let made = Acting::new(&self.setup.config, stream.axes(), (self.setup.epoch, now_s))?;
        match &self.acting {
            Some(before) if before.axes == made.axes => Ok(()),
            Some(_) => {
                Err("the turret's axes have other places in the stream; restart the service".to_owned())
            }
            None => {
                self.acting = Some(made);
                Ok(())
            }
        }
    }

    pub(super) fn take_status(&mut self, status: &TurretStatus, now: Instant) {
        // A report that repeats its number says nothing of now, nor does one of another stream.
        let repeated =
            self.status.is_some_and(|(s, _)| (s.stream, s.sequence) == (status.stream, status.sequence));
        if repeated || self.stream.as_ref().is_some_and(|s| s.id() != status.stream) {
            return;
        }
        self.status = Some((*status, now));
        let before = std::mem::replace(&mut self.turret_state, status.state);
        if before == status.state {
            return;
        }
        let outcome = match status.state {
            TURRET_REACHED => "reached",
            TURRET_REFUSED => "refused",
            TURRET_LIMITED => "limited",
            TURRET_EXPIRED => "expired",
            _ => return,
        };
        let commanded = self.acting.as_ref().is_some_and(|a| a.latest.is_some()) && self.mode == Mode::Act;
        let pitch_rad = self.acting.as_ref().map_or(0.0, |a| a.pitch_rad(&status.offset_m));
        let nothing_left = outcome == "expired" && is_same_pitch(pitch_rad, 0.0);
        if !commanded && outcome == "reached" || nothing_left {
            return; // it stands where it stood before we came, or at equal pitch
        }
        self.setup.metrics.commands.with_label_values(&[outcome]).inc();
        let (kind, text) = match outcome {
            "reached" => (EventKind::CommandReached, "the turret reached what was commanded".to_owned()),
            "expired" => (EventKind::PitchReturn, "the last command expired; the turret returns".to_owned()),
            word => (EventKind::CommandFailed, format!("the controller {word} the command")),
        };
        let mut event = Event::new(kind, clock::wall_ns(), text);
        event.t_s = Some(status.t_ns as f64 * 1e-9);
        event.pitch_difference_rad = self.acting.as_ref().map(|a| a.pitch_rad(&status.offset_m));
        if kind == EventKind::CommandFailed && self.stream.is_some() {
            self.save_around(kind.word(), &event.text);
        }
        self.report(event);
    }

    /// Unknown is unsafe: an interlock that is not heard is open.
    pub(super) fn watch_interlocks(&mut self, now: Instant) {
        let fresh = self.fresh_status(now);
        let open = fresh.map_or(u32::MAX, |s| s.interlocks_open);
        let before = std::mem::replace(&mut self.interlocks_open, open);
        if before == open {
            return;
        }
        for (bit, name) in INTERLOCK_NAMES.iter().enumerate() {
            let (was, is) = (before >> bit & 1 == 1, open >> bit & 1 == 1);
            if was != is {
                let (kind, word) = if is {
                    (EventKind::InterlockOpened, if fresh.is_some() { "opened" } else { "is not heard" })
                } else {
                    (EventKind::InterlockClosed, "closed")
                };
                self.report(Event::new(kind, clock::wall_ns(), format!("interlock {name} {word}")));
            }
        }
    }

    pub(super) fn fresh_status(&self, now: Instant) -> Option<TurretStatus> {
        self.status.filter(|(_, at)| now.duration_since(*at) <= STATUS_DEADLINE).map(|(s, _)| s)
    }

    /// What is heard of every watched axis, where its noise is learned and nothing that is not accepted
    /// speaks against its force; else why the first that is not fit is not.
    pub(super) fn heard_now(&self) -> HeardNow {
        let Some(stream) = &self.stream else { return Err("no samples".to_owned()) };
        let watch = &self.setup.config.watch;
        let watched: Vec<_> = stream.axes().iter().enumerate().filter(|(_, n)| watch.contains(n)).collect();
        for (axis, name) in &watched {
            let pipeline = stream.pipeline();
            if pipeline.axis_output(*axis).is_none_or(|heard| heard.phase == Phase::Learning) {
                return Err(format!("{name}: its noise is being learned"));
            }
            let flags = pipeline.force_flags(*axis);
            let held = self.setup.config.turret.holding(flags);
            if !pipeline.axis_may_act(*axis) || !held.is_valid() {
                // Those that are accepted are not in the way.
                let rest = flags.without(Validity::HOLDING_BY_DEFAULT) | held;
                let reach = if pipeline.band_out_of_reach() { ", the band is out of reach" } else { "" };
                return Err(format!("{name}: {rest}{reach}"));
            }
        }
        Ok(watched.into_iter().map(|(_, name)| name.as_str()).collect::<Vec<_>>().join(", "))
    }

    fn situation(&mut self, now: Instant) -> Situation {
        let store_writable = self.setup.store.writable(now);
        let (mut heard, mut speed) = (None, None);
        let (mut window_full, mut estimate_valid, mut foreseen) = (false, false, None);
        if let Some(stream) = &self.stream {
            let chatter = stream.pipeline().agreement();
            heard = Some(Heard {
                phase: chatter.phase,
                frequency_hz: chatter.highest_hz.or(chatter.frequency_hz),
                power_n2: chatter.power_n2,
                growth_1_s: chatter.growth_1_s,
            });
            speed = stream.newest.as_ref().map(|p| p.spindle_speed_rpm);
            window_full = stream.usable_run() as f64 >= stream.sample_rate().hz();
            let pipeline = stream.pipeline();
            let believed = |axis: usize| {
                let held = self.setup.config.turret.holding(pipeline.force_flags(axis));
                pipeline.axis_may_act(axis) && held.is_valid()
            };
            estimate_valid = believed(chatter.leading_axis);
            let runs_out = pipeline.margin_running_out().filter(|(axis, _)| believed(*axis));
            foreseen = runs_out.map(|(_, margin)| margin.into());
        }
        let silent = Heard { phase: Phase::Learning, frequency_hz: None, power_n2: 0.0, growth_1_s: None };
        let report = self.status.map(|(status, at)| TurretReport {
            heard_s: self.seconds(at),
            offsets_m: status.offset_m,
            motion: motion_of(status.state),
            acknowledged: (status.acknowledged_epoch > 0)
                .then_some((status.acknowledged_epoch, status.acknowledged_sequence)),
        });
        Situation {
            now_s: self.seconds(now),
            newest_sample_s: self.last_arrival.map(|(at, _)| self.seconds(at)),
            window_full,
            estimate_valid,
            heard: heard.unwrap_or(silent),
            foreseen,
            spindle_speed_rpm: speed,
            turret: report,
            interlock: self.status.map(|(status, at)| Interlock {
                heard_s: self.seconds(at),
                open: status.interlocks_open != 0,
            }),
            mode: self.decided_mode(),
            operator_hold: self.held,
            operator_acknowledge: self.acknowledge,
            store_writable,
            withheld: self.acting.as_ref().and_then(|a| a.withheld),
            too_soon: false, // `Acting` knows
            diameter_m: self.stream.as_ref().and_then(|s| s.pipeline().measured_diameter_m()),
        }
    }

    /// Without two axes that move the tools apart there is nothing to decide: a turret that stands away from
    /// equal pitch still goes back.
    fn decided_mode(&self) -> ActMode {
        if self.no_pitch.is_some() { ActMode::Observe } else { act_mode(self.mode) }
    }

    pub(super) fn facts(&self, now: Instant) -> Facts {
        let closed = self.status.filter(|(s, _)| s.interlocks_open == 0).map(|(_, at)| self.seconds(at));
        Facts {
            now_s: self.seconds(now),
            mode: self.decided_mode(),
            interlock_closed_s: closed,
            actual_m: self.status.map_or([0.0; MAX_AXES], |(s, _)| s.offset_m),
        }
    }

    /// One look at the decision; most looks find that no interval is over.
    pub(super) fn decide(&mut self, now: Instant) {
        let (situation, facts) = (self.situation(now), self.facts(now));
        let origin = self.stream.as_ref().map_or(SampleOrigin::default(), |s| SampleOrigin {
            stream: s.id(),
            t_ns: s.newest.map_or(0, |p| p.t_ns),
        });
        let t_s = self.stream.as_ref().and_then(|s| s.newest).map(|p| p.t_ns as f64 * 1e-9);
        let Some(acting) = &mut self.acting else { return };
        if self.mode != Mode::Act {
            acting.close_port_later(situation.now_s);
        }
        let overdue = acting.overdue(situation.now_s, situation.mode).or_else(|| acting.return_again(&facts));
        let (decision, verdict) = acting.decide(&situation, (t_s, &mut self.ledger));
        self.acknowledge = false;
        if let Some(outcome) = overdue {
            self.settle(outcome);
        }
        if let Err(violation) = verdict {
            self.distrust(violation);
        }
        if decision != Decision::NotDue {
            self.advise_speed();
        }
        match decision {
            Decision::NotDue => {}
            Decision::Hold(reason) => {
                self.setup.metrics.holds.with_label_values(&[reason.name()]).inc();
                if self.mode == Mode::Act && needs_a_person(reason) {
                    self.latch(&super::mode::stopped_for(reason));
                    self.decide(now);
                }
            }
            Decision::Advice(command) => {
                self.setup.commissioning.evidence.advise(command.pitch_difference_rad);
                self.setup.metrics.commands.with_label_values(&["advised"]).inc();
                if self.is_news(command.pitch_difference_rad) {
                    let event = self.command_event(&command, "advised");
                    self.report(event);
                }
            }
            Decision::Command(command) => self.command(command, (origin, &facts)),
        }
    }

    /// Tells once that no pitch is stable, and the nearest spindle speed at which one is.
    fn advise_speed(&mut self) {
        let (none, speed) = self.acting.as_ref().map_or((false, None), Acting::advised_speed_rpm);
        if std::mem::replace(&mut self.told_speed, none) || !none {
            return;
        }
        let text = match speed {
            Some(rpm) => format!("no pitch is predicted to be stable at this speed; one is at {rpm:.0} rpm"),
            None => "no pitch is predicted to be stable, here or at a speed within 40 %".to_owned(),
        };
        self.report(Event::new(EventKind::SpeedAdvised, clock::wall_ns(), text));
    }

    /// The monitor says that a decision breaks a rule: a fault of ours, nothing more is commanded.
    fn distrust(&mut self, violation: Violation) {
        let name = violation.name();
        self.setup.metrics.invariant_violations.with_label_values(&[name]).inc();
        let what = format!("a decision broke the rule `{name}`; acting is off, please report it");
        if self.fault.as_deref() != Some(what.as_str()) {
            self.report(Event::new(EventKind::InvariantViolation, clock::wall_ns(), what.clone()));
            self.save_around(EventKind::InvariantViolation.word(), &what);
        }
        self.latch(&what);
    }

    /// True once for each pitch that differs from the one told last.
    fn is_news(&mut self, pitch_rad: f64) -> bool {
        let news = !self.told_rad.is_some_and(|told| is_same_pitch(told, pitch_rad));
        if news {
            self.told_rad = Some(pitch_rad);
        }
        news
    }

    fn command(&mut self, command: Command, (origin, facts): (SampleOrigin, &Facts)) {
        let Some(acting) = &mut self.acting else { return };
        if acting.needs_record(&command) {
            acting.wait_for_record(command, origin);
            self.told_rad = Some(command.pitch_difference_rad);
            let event = Event { id: clock::new_id(), ..self.command_event(&command, "commanded") };
            self.queue(Report::Intent { sequence: command.sequence, event: Box::new(event) });
            return;
        }
        let outcome = acting.send(&command, origin, facts);
        self.settle(outcome);
    }

    /// The intent of a command is durable.
    pub(super) fn intent_recorded(&mut self, sequence: u64) {
        let facts = self.facts(clock::now());
        let outcome = self.acting.as_mut().and_then(|a| a.recorded(sequence, &facts));
        if let Some(outcome) = outcome {
            self.settle(outcome);
        }
    }

    fn settle(&mut self, outcome: Outcome) {
        match outcome {
            Outcome::Sent(command) => {
                let word = match command.kind {
                    CommandKind::Move => "sent",
                    CommandKind::Renew => "renewed",
                    CommandKind::Return => "returned",
                };
                self.setup.metrics.commands.with_label_values(&[word]).inc();
                self.told_held = None;
                if command.kind == CommandKind::Return {
                    self.told_rad = None;
                    let text = "asked the turret back to equal pitch";
                    let mut event = Event::new(EventKind::PitchReturn, clock::wall_ns(), text);
                    event.pitch_difference_rad = Some(0.0);
                    self.report(event);
                }
            }
            Outcome::Held(number, reason) => {
                self.setup.metrics.holds.with_label_values(&[reason]).inc();
                // Once for each reason: a renewal may be refused every second.
                if self.told_held.replace(reason) != Some(reason) {
                    let text = format!("command {number} was not sent: {}", reason.replace('_', " "));
                    self.report(Event::new(EventKind::PitchCommand, clock::wall_ns(), text));
                }
            }
        }
    }

    fn command_event(&self, command: &Command, word: &str) -> Event {
        let degrees = command.pitch_difference_rad.to_degrees();
        let text = format!("{word} a pitch difference of {degrees:.2} degrees");
        let mut event = Event::new(EventKind::PitchCommand, clock::wall_ns(), text);
        event.pitch_difference_rad = Some(command.pitch_difference_rad);
        if let Some(stream) = &self.stream {
            let chatter = stream.pipeline().agreement();
            event.frequency_hz = chatter.highest_hz.or(chatter.frequency_hz);
            let silent = command.kind == CommandKind::Move && chatter.phase == Phase::Quiet;
            if let Some((_, margin)) = stream.pipeline().margin_running_out().filter(|_| silent) {
                let (margin_1_s, frequency_hz) = (margin.margin_1_s, margin.frequency_hz);
                event.text +=
                    &format!(" before chatter: {margin_1_s:.1} 1/s are left at {frequency_hz:.0} Hz");
                event.frequency_hz = event.frequency_hz.or(Some(frequency_hz));
            }
            event.power_n2 = Some(chatter.power_n2);
            event.axis = stream.axes().get(chatter.leading_axis).cloned();
            event.t_s = stream.newest.map(|p| p.t_ns as f64 * 1e-9);
        }
        event
    }
}
