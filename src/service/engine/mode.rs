//! The mode, and what people ask of it: every way up needs its conditions, every way down is free.

use super::{Engine, Ports};
use crate::avoidance::HoldReason;
use crate::service::clock;
use crate::service::control::{Control, ModeNow, Origin, Refusal};
use crate::service::live::Mode;
use crate::telemetry::{Event, EventKind};

/// Why acting ended: no samples came.
pub(super) const SAMPLES_CEASED: &str = "the samples ceased while acting";
/// Why acting ended: this thread was stopped; how long follows.
pub(super) const STOOD_STILL: &str = "the pipeline stood still";

/// Why acting ended: the decision holds until a person has looked.
pub(super) fn stopped_for(reason: HoldReason) -> String {
    format!("stopped acting: {}", reason.name().replace('_', " "))
}

/// True where acting ended only because something was not heard in time.
pub(in crate::service) fn was_late(mode_reason: &str) -> bool {
    let unheard = [HoldReason::InterlockUnheard, HoldReason::TurretSilent].map(stopped_for);
    mode_reason == SAMPLES_CEASED
        || mode_reason.starts_with(STOOD_STILL)
        || unheard.iter().any(|what| what == mode_reason)
}

impl Engine {
    pub(super) fn obey(&mut self, control: Control, ports: &Ports) {
        match control {
            Control::SetMode { mode, revision, origin, done } => {
                let outcome = self.set_mode(mode, revision, (&origin, ports));
                let _ = done.send(outcome);
            }
            Control::Override { actor, done } => {
                self.take_back(&actor);
                let _ = done.send(Ok(self.mode_now()));
            }
            Control::Hold { on: true, done, .. } if self.mode != Mode::Act => {
                let what = "the turret is held in mode act only";
                let _ = done.send(Err(Refusal::NotActing(what.to_owned())));
            }
            Control::Hold { on, origin, done } => {
                self.held = on;
                let words = if on { "holds the turret where it is" } else { "lets the turret go" };
                let text = format!("{} {words} ({})", origin.actor, origin.reason);
                self.report(Event::new(EventKind::OperatorHold, clock::wall_ns(), text));
                let _ = done.send(Ok(self.mode_now()));
            }
            Control::ClearFault { origin, done } => {
                self.acknowledge = self.acting.is_some();
                let cleared = self.fault.take().map(|fault| {
                    self.mode_revision += 1;
                    let text = format!("{} cleared: {fault} ({})", origin.actor, origin.reason);
                    self.report(Event::new(EventKind::FaultCleared, clock::wall_ns(), text));
                    self.mode_now()
                });
                let _ = done.send(cleared.ok_or(Refusal::NoFault));
            }
            Control::SaveRecording { word, reason, done } => {
                let id = self.save_around(word, &reason);
                let _ = done.send(Ok(id));
            }
            Control::Committed { sequence } => self.intent_recorded(sequence),
            Control::Stop => {
                self.stopping = true;
            }
        }
    }

    fn set_mode(
        &mut self,
        mode: Mode,
        revision: Option<u64>,
        (origin, ports): (&Origin, &Ports),
    ) -> Result<ModeNow, Refusal> {
        if let Some(asked) = revision
            && asked != self.mode_revision
        {
            return Err(Refusal::Revision { now: self.mode_revision, asked });
        }
        // Decided here, where the mode is: the picture that the asker saw may be 50 ms old.
        if revision.is_none() && mode as u8 > self.mode as u8 {
            return Err(Refusal::WayUp { now: self.mode.word(), asked: mode.word() });
        }
        if mode == Mode::Act {
            if self.setup.config.turret.commissioned.is_none() {
                let what = "turret.limits_by and turret.limits_date do not say who set the limits and when";
                return Err(Refusal::NotReady(what.to_owned()));
            }
            let incomplete = |missing| Refusal::NotReady(format!("commissioning is not complete: {missing}"));
            if let Some(missing) = self.setup.commissioning.of_history().missing() {
                return Err(incomplete(missing));
            }
            if let Some(fault) = &self.fault {
                return Err(Refusal::Faulted(fault.clone()));
            }
            if self.stream.is_none() {
                return Err(Refusal::NotReady("no samples come".to_owned()));
            }
            if self.source_lost {
                let what = "what comes of samples cannot be used; stillcut_samples_rejected_total says why";
                return Err(Refusal::NotReady(what.to_owned()));
            }
            if let Some(why) = &self.no_pitch {
                return Err(Refusal::NotReady(format!("no pitch control: {why}")));
            }
            if !self.setup.way_back.is_open(clock::now()) {
                let what = "no operator's token is in force: nobody could take the turret back";
                return Err(Refusal::NotReady(what.to_owned()));
            }
            if self.interlocks_open != 0 {
                return Err(Refusal::NotReady("an interlock is open or not heard".to_owned()));
            }
            // Last: what stands in the way otherwise is told by its own name.
            if let Err(why) = self.heard_now() {
                return Err(incomplete(format!("heard_now ({why})")));
            }
            match &mut self.acting {
                Some(acting) => acting.open_port(&ports.who)?,
                None => return Err(Refusal::NotReady("no samples came yet".to_owned())),
            }
        }
        if mode != self.mode {
            self.change_mode(mode, &format!("{}: {}", origin.actor, origin.reason));
        }
        Ok(self.mode_now())
    }

    fn mode_now(&self) -> ModeNow {
        ModeNow { mode: self.mode, revision: self.mode_revision, reason: self.mode_reason.clone() }
    }

    pub(super) fn change_mode(&mut self, mode: Mode, reason: &str) {
        let before = std::mem::replace(&mut self.mode, mode);
        self.held &= before == mode;
        self.mode_revision += 1;
        self.picture_now = true;
        reason.clone_into(&mut self.mode_reason);
        self.show_mode();
        let text = format!("mode {} to {} ({reason})", before.word(), mode.word());
        self.report(Event::new(EventKind::ModeChange, clock::wall_ns(), text));
    }

    pub(super) fn show_mode(&self) {
        for mode in Mode::ALL {
            self.setup.metrics.mode.with_label_values(&[mode.word()]).set(i64::from(mode == self.mode));
        }
    }

    /// Who asked tells the event, with the reason: that may come later, or not at all.
    pub(super) fn take_back(&mut self, actor: &str) {
        if self.mode != Mode::Observe {
            self.change_mode(Mode::Observe, &format!("override by {actor}"));
        }
        if self.stream.is_some() {
            let text = format!("{actor} took the turret back");
            self.save_around(EventKind::Override.word(), &text);
        }
    }

    /// A fault stops acting until a person clears it.
    pub(super) fn latch(&mut self, what: &str) {
        if self.fault.as_deref() == Some(what) {
            return;
        }
        self.fault = Some(what.to_owned());
        self.report(Event::new(EventKind::Fault, clock::wall_ns(), what));
        if self.stream.is_some() {
            self.save_around(EventKind::Fault.word(), what);
        }
        if self.mode == Mode::Act {
            self.change_mode(Mode::Observe, what);
        }
    }
}
