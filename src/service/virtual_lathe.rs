//! The virtual lathe as a participant of a domain: servo samples and turret reports out, commands in,
//! in real time. It stands where a motion controller stands and knows as little of the service.

use super::clock;
use crate::simulation::lathe::turret::{TurretOrder, TurretState};
use crate::simulation::lathe::{AXES, CARRIAGE, Lathe, LatheSettings};
use crate::transport::wire::{
    COMMAND_RETURN, INTERLOCK_PERMISSIVE, ServoBatch, ServoPoint, TURRET_EXPIRED, TURRET_MOVING,
    TURRET_REACHED, TURRET_REFUSED, TurretCommand, TurretStatus, axis_name_bytes,
};
use crate::transport::{
    CommandSubscriber, Domain, Participant, ServoPublisher, StatusPublisher, TransportError,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Axes of the stream: those of the turrets and the carriage.
const STREAM_AXES: usize = AXES.len() + 1;
/// Samples per batch: one millisecond at 9 kHz.
const BATCH: usize = 9;
/// Batches between two turret reports: 50 a second.
const REPORT_EVERY: u64 = 20;
/// Further behind real time than this, the lathe does not hurry after: it was stopped.
const LARGEST_LAG_S: f64 = 0.5;

/// How the lathe runs.
#[derive(Debug)]
pub struct VirtualLathe {
    lathe: Lathe,
    ports: Ports,
    stream: u64,
    batches: u64,
    refused_since_report: bool,
}

#[derive(Debug)]
struct Ports {
    servo: ServoPublisher,
    status: StatusPublisher,
    commands: CommandSubscriber,
    _who: Participant,
}

impl VirtualLathe {
    /// Joins the domain. Call on the thread that will run it. Errors: shared memory cannot be used.
    pub fn join(settings: LatheSettings, domain: &Domain) -> Result<Self, TransportError> {
        let who = domain.join("stillcut-lathe")?;
        let ports = Ports {
            servo: ServoPublisher::open(&who)?,
            status: StatusPublisher::open(&who)?,
            commands: CommandSubscriber::open(&who)?,
            _who: who,
        };
        let stream = clock::wall_ns().unsigned_abs();
        Ok(Self { lathe: Lathe::new(settings), ports, stream, batches: 0, refused_since_report: false })
    }

    /// The lathe itself.
    #[must_use]
    pub fn lathe(&self) -> &Lathe {
        &self.lathe
    }

    /// Runs in real time until `stop` or, where given, for `duration_s` of machine time.
    /// `watch` sees the lathe after each batch. Errors: shared memory failed.
    pub fn run(
        &mut self,
        stop: &AtomicBool,
        duration_s: Option<f64>,
        mut watch: impl FnMut(&Lathe),
    ) -> Result<(), TransportError> {
        let rate_hz = self.lathe.settings().sample_rate_hz;
        let mut began = clock::now();
        let mut began_at_s = self.lathe.truth().t_s;
        while !stop.load(Ordering::Relaxed) && duration_s.is_none_or(|d| self.lathe.truth().t_s < d) {
            let behind_s = began.elapsed().as_secs_f64() - (self.lathe.truth().t_s - began_at_s);
            if behind_s > LARGEST_LAG_S {
                began = clock::now();
                began_at_s = self.lathe.truth().t_s;
            }
            if behind_s * rate_hz < BATCH as f64 {
                clock::sleep(Duration::from_micros(500));
                continue;
            }
            self.batch()?;
            watch(&self.lathe);
        }
        Ok(())
    }

    /// One batch of samples; commands are heard before, a report is given now and then.
    fn batch(&mut self) -> Result<(), TransportError> {
        self.hear()?;
        let mut batch = ServoBatch {
            stream: self.stream,
            sample_rate_hz: self.lathe.settings().sample_rate_hz,
            sample_count: BATCH as u32,
            axis_count: STREAM_AXES as u32,
            ..ServoBatch::default()
        };
        for (to, name) in batch.axis_names.iter_mut().zip(AXES.into_iter().chain([CARRIAGE])) {
            *to = axis_name_bytes(name);
        }
        for point in batch.points.iter_mut().take(BATCH) {
            let sample = self.lathe.step();
            *point = ServoPoint::from_sample(&sample, ns(sample.t_s), STREAM_AXES);
        }
        self.ports.servo.send(&batch)?;
        self.batches += 1;
        if self.batches.is_multiple_of(REPORT_EVERY) {
            self.report()?;
        }
        Ok(())
    }

    fn hear(&mut self) -> Result<(), TransportError> {
        let (lathe, stream, refused) = (&mut self.lathe, self.stream, &mut self.refused_since_report);
        let now_ns = ns(lathe.truth().t_s);
        self.ports.commands.drain(|command| {
            let taken =
                order_of(command, stream, now_ns).is_some_and(|order| lathe.turret_mut().order(&order));
            *refused |= !taken;
        })?;
        Ok(())
    }

    fn report(&mut self) -> Result<(), TransportError> {
        let turret = self.lathe.turret();
        let (epoch, sequence) = turret.accepted().unwrap_or((0, 0));
        let state = match turret.state() {
            _ if self.refused_since_report => TURRET_REFUSED,
            TurretState::Reached => TURRET_REACHED,
            TurretState::Moving | TurretState::Blocked => TURRET_MOVING,
            TurretState::Expired => TURRET_EXPIRED,
        };
        let mut status = TurretStatus {
            stream: self.stream,
            sequence: self.batches / REPORT_EVERY,
            t_ns: ns(self.lathe.truth().t_s),
            acknowledged_epoch: epoch,
            acknowledged_sequence: sequence,
            axis_count: STREAM_AXES as u32,
            interlocks_open: if turret.interlock_open() { INTERLOCK_PERMISSIVE } else { 0 },
            state,
            ..TurretStatus::default()
        };
        status.offset_m[..2].copy_from_slice(&self.lathe.actual_offset_m());
        self.refused_since_report = false;
        self.ports.status.send(&status).map(|_| ())
    }
}

/// The order that a command is, if it is for this stream and still lives.
fn order_of(command: &TurretCommand, stream: u64, now_ns: u64) -> Option<TurretOrder> {
    let expires_ns = command.based_on_t_ns.saturating_add(command.ttl_ns);
    if command.stream != stream || expires_ns <= now_ns {
        return None;
    }
    let offset_m =
        if command.kind == COMMAND_RETURN { [0.0; 2] } else { [command.offset_m[0], command.offset_m[1]] };
    let ttl_s = (expires_ns - now_ns) as f64 * 1e-9;
    Some(TurretOrder { epoch: command.epoch, sequence: command.sequence, offset_m, ttl_s })
}

/// Nanoseconds of a time on the lathe's clock.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the lathe's clock starts at zero"
)]
fn ns(t_s: f64) -> u64 {
    (t_s * 1e9).round() as u64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_of_another_stream_or_past_its_life_is_no_order() {
        let command =
            TurretCommand { stream: 7, based_on_t_ns: 1_000, ttl_ns: 1_000, ..TurretCommand::default() };
        assert!(order_of(&command, 7, 1_500).is_some());
        assert!(order_of(&command, 8, 1_500).is_none());
        assert!(order_of(&command, 7, 2_000).is_none());
    }
}
