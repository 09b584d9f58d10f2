//! The whole loop without processes or clocks: virtual lathe -> pipeline -> decision -> guard -> turret.
//!
//! What the service does over shared memory happens here sample by sample, as fast as the machine allows:
//! for campaigns over many cuts and for tests.

use super::lathe::turret::{TurretOrder, TurretState};
use super::lathe::{Lathe, LatheSettings};
use crate::avoidance::guard::{Facts, Guard, GuardState};
use crate::avoidance::invariants::{Commissioned, CommissionedAxis, InvariantMonitor};
use crate::avoidance::pitch::pitch_of_shift_rad;
use crate::avoidance::turret::{TurretAxis, TurretError, TurretKinematics};
use crate::avoidance::{
    Avoidance, AvoidanceSettings, AvoidanceState, Command, Decision, Heard, HoldReason, Interlock, Mode,
    SettingsError, Situation, TurretMotion, TurretReport,
};
use crate::chatter::ChatterEvent;
use crate::pipeline::{Pipeline, PipelineError, PipelineSettings};
use crate::plant::scenario::Scenario;
use crate::sample::MAX_AXES;
use std::f64::consts::FRAC_PI_4;
use thiserror::Error;

/// Why a loop cannot be closed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum LoopError {
    /// The pipeline does not fit the stream.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// The decision's settings are not allowed.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The turret's axes are not usable.
    #[error(transparent)]
    Turret(#[from] TurretError),
}

/// Something that happened in the loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LoopEvent {
    /// Chatter was declared at this frequency, Hz.
    Onset(f64),
    /// Chatter was declared over.
    End,
    /// A command left for the turret.
    Sent(Command),
    /// The last guard refused a command.
    Refused,
}

/// Largest pitch difference of the loop, rad: wide enough for the bars and speeds of the campaign.
pub const LARGEST_PITCH_RAD: f64 = 0.2;

/// Turret of the virtual lathe: X1 toward the bar, Y1 at 45 degrees, 1.9 mm either way at 2 mm/s.
pub fn turret_kinematics() -> Result<TurretKinematics, TurretError> {
    let axis = |index, direction_rad| TurretAxis {
        index,
        direction_rad,
        lowest_m: -1.9e-3,
        highest_m: 1.9e-3,
        speed_m_s: 2.0e-3,
        acceleration_m_s2: 50.0e-3,
    };
    TurretKinematics::new([axis(0, 0.0), axis(1, FRAC_PI_4)])
}

/// What the controller is told beside its limits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Told {
    /// Mode.
    pub mode: Mode,
    /// Bar and cut as the operator states them; `None`: eq. (6-10) alone.
    pub stated: Option<Scenario>,
    /// The pitch may move before chatter.
    pub before_chatter: bool,
}

/// The loop in motion.
#[derive(Debug, Clone)]
pub struct ClosedLoop {
    lathe: Lathe,
    pipeline: Pipeline,
    avoidance: Avoidance,
    state: AvoidanceState,
    guard: Guard,
    guard_state: GuardState,
    watch: InvariantMonitor,
    violations: u32,
    mode: Mode,
    clean: bool,
    hold: Option<HoldReason>,
    /// What happened at the same sample as what was told first.
    untold: Option<LoopEvent>,
}

impl ClosedLoop {
    /// Closes the loop around a lathe with servo turrets.
    /// Errors: settings that do not fit each other, by name.
    pub fn new(lathe: LatheSettings, pipeline: PipelineSettings, mode: Mode) -> Result<Self, LoopError> {
        let stated = lathe.scenario;
        Self::with_stated(lathe, pipeline, Told { mode, stated: Some(stated), before_chatter: false })
    }

    /// The same where the operator stated another bar and cut than the true ones, or none.
    /// Errors: as [`ClosedLoop::new`].
    pub fn with_stated(
        lathe: LatheSettings,
        pipeline: PipelineSettings,
        Told { mode, stated, before_chatter }: Told,
    ) -> Result<Self, LoopError> {
        let turret = turret_kinematics()?;
        let diameter_m = lathe.scenario.workpiece.diameter_m();
        let (largest_pitch_rad, report_deadline_s, reached_m) = (LARGEST_PITCH_RAD, 0.2, 20e-6);
        let avoidance = Avoidance::new(AvoidanceSettings {
            turret,
            diameter_m,
            largest_pitch_rad,
            interval_s: 1.0,
            ttl_s: 2.5,
            freshness_s: 0.05,
            report_deadline_s,
            reached_m,
            stated,
            before_chatter,
        })?;
        let mut guard = Guard { diameter_m, largest_pitch_rad, ..Guard::default() };
        for axis in turret.axes() {
            guard.lowest_m[axis.index] = axis.lowest_m;
            guard.highest_m[axis.index] = axis.highest_m;
            guard.speed_m_s[axis.index] = axis.speed_m_s;
            guard.acceleration_m_s2[axis.index] = axis.acceleration_m_s2;
            guard.direction_rad[axis.index] = axis.direction_rad;
        }
        let axes = turret.axes().map(|axis| CommissionedAxis {
            index: axis.index,
            direction_rad: axis.direction_rad,
            range_m: [axis.lowest_m, axis.highest_m],
            speed_m_s: axis.speed_m_s,
            acceleration_m_s2: axis.acceleration_m_s2,
        });
        let limits = Commissioned {
            axes,
            diameter_m,
            largest_pitch_rad,
            report_deadline_s,
            reached_m,
            before_chatter,
        };
        Ok(Self {
            state: avoidance.start(1, 0.0),
            lathe: Lathe::new(lathe),
            pipeline: Pipeline::new(pipeline)?,
            avoidance,
            guard,
            guard_state: GuardState::default(),
            watch: InvariantMonitor::new(limits, 0.0),
            violations: 0,
            mode,
            clean: false,
            hold: None,
            untold: None,
        })
    }

    /// The lathe.
    #[must_use]
    pub fn lathe(&self) -> &Lathe {
        &self.lathe
    }

    /// The pipeline.
    #[must_use]
    pub fn pipeline(&self) -> &Pipeline {
        &self.pipeline
    }

    /// Why nothing was commanded, last time that it was not.
    #[must_use]
    pub fn hold(&self) -> Option<HoldReason> {
        self.hold
    }

    /// Decisions that broke a command invariant, as the independent monitor saw them.
    #[must_use]
    pub fn violations(&self) -> u32 {
        self.violations
    }

    /// One sample through everything.
    pub fn step(&mut self) -> Option<LoopEvent> {
        let mut sample = self.lathe.step();
        sample.pitch_difference_rad = Some(self.standing_pitch_rad());
        let output = self.pipeline.step(&sample);
        self.clean = self.pipeline.clean_samples() as f64 > self.lathe.settings().sample_rate_hz * 0.5;
        let heard = match output.event {
            Some((_, ChatterEvent::Onset(line))) => Some(LoopEvent::Onset(line.frequency_hz)),
            Some((_, ChatterEvent::End)) => Some(LoopEvent::End),
            _ => None,
        };
        let situation = self.situation(sample.t_s, sample.spindle_speed_rpm);
        let decision = self.avoidance.decide(&mut self.state, &situation);
        self.violations += u32::from(self.watch.watch(&situation, &decision).is_err());
        let decided = match decision {
            Decision::Command(command) => Some(self.send(&command, &situation)),
            Decision::Hold(reason) => {
                self.hold = Some(reason);
                None
            }
            Decision::NotDue | Decision::Advice(_) => None,
        };
        let earlier = self.untold.take();
        let mut news = [earlier, heard, decided].into_iter().flatten();
        let first = news.next();
        self.untold = news.next();
        first
    }

    /// Offsets as the turret reports them.
    fn offsets_m(&self) -> [f64; MAX_AXES] {
        let mut offsets_m = [0.0; MAX_AXES];
        offsets_m[..2].copy_from_slice(&self.lathe.actual_offset_m());
        offsets_m
    }

    /// Pitch difference that they make.
    fn standing_pitch_rad(&self) -> f64 {
        let settings = self.avoidance.settings();
        pitch_of_shift_rad(settings.diameter_m, settings.turret.shift(&self.offsets_m()))
    }

    fn situation(&self, now_s: f64, spindle_speed_rpm: f64) -> Situation {
        let agreement = self.pipeline.agreement();
        let turret = self.lathe.turret();
        Situation {
            now_s,
            newest_sample_s: Some(now_s),
            window_full: self.clean,
            estimate_valid: self.pipeline.axis_may_act(agreement.leading_axis),
            heard: Heard {
                phase: agreement.phase,
                frequency_hz: agreement.highest_hz.or(agreement.frequency_hz),
                power_n2: agreement.power_n2,
                growth_1_s: agreement.growth_1_s,
            },
            foreseen: self
                .pipeline
                .margin_running_out()
                .filter(|(axis, _)| self.pipeline.axis_may_act(*axis))
                .map(|(_, margin)| margin.into()),
            spindle_speed_rpm: Some(spindle_speed_rpm),
            turret: Some(TurretReport {
                heard_s: now_s,
                offsets_m: self.offsets_m(),
                motion: match turret.state() {
                    TurretState::Reached => TurretMotion::Reached,
                    TurretState::Moving | TurretState::Blocked => TurretMotion::Moving,
                    TurretState::Expired => TurretMotion::Expired,
                },
                acknowledged: turret.accepted(),
            }),
            interlock: Some(Interlock { heard_s: now_s, open: turret.interlock_open() }),
            mode: self.mode,
            operator_hold: false,
            operator_acknowledge: false,
            store_writable: true,
            withheld: None,
            too_soon: false,
            diameter_m: self.pipeline.measured_diameter_m(),
        }
    }

    fn send(&mut self, command: &Command, situation: &Situation) -> LoopEvent {
        let facts = Facts {
            now_s: situation.now_s,
            mode: self.mode,
            interlock_closed_s: Some(situation.now_s),
            actual_m: situation.turret.map_or([0.0; MAX_AXES], |t| t.offsets_m),
        };
        if self.guard.pass(&mut self.guard_state, command, &facts).is_err() {
            return LoopEvent::Refused;
        }
        self.lathe.turret_mut().order(&TurretOrder {
            epoch: command.epoch,
            sequence: command.sequence,
            offset_m: [command.offsets_m[0], command.offsets_m[1]],
            ttl_s: command.ttl_s,
        });
        LoopEvent::Sent(*command)
    }
}
