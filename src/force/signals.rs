//! What an axis measures, and the balance that its signals allow.

use super::balance::{ForceBalance, Method, MotionFactors};
use super::settings::ForceError;
use crate::plant::drive::{DriveParams, Structure};
use crate::units::SampleRate;

/// Which positions the axis measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signals {
    /// Rotary encoder only (semi-closed).
    MotorOnly,
    /// Linear scale only (linear motor).
    StageOnly,
    /// Both (full-closed).
    Both,
    /// Both, and the screw at the nut.
    Three,
}

impl Signals {
    /// In words.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::MotorOnly => "the rotary encoder alone",
            Self::StageOnly => "the linear scale alone",
            Self::Both => "rotary encoder and linear scale",
            Self::Three => "rotary encoder, nut and linear scale",
        }
    }

    /// True where every position of `other` is measured too.
    #[must_use]
    pub fn covers(self, other: Self) -> bool {
        self == other
            || match self {
                Self::Three => true,
                Self::Both => other != Self::Three,
                Self::MotorOnly | Self::StageOnly => false,
            }
    }
}

/// What an estimator is made for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisSignals<'a> {
    /// Drive.
    pub drive: &'a DriveParams,
    /// Rate of the samples.
    pub rate: SampleRate,
    /// Which positions are measured.
    pub signals: Signals,
}

/// The balance of a method over what the axis measures: of three inertias where three positions are.
pub(super) fn measured_balance(method: Method, axis: &AxisSignals<'_>) -> Result<ForceBalance, ForceError> {
    let mode = match method {
        Method::Medob | Method::RigidMode => Some(0),
        Method::VibrationMode => Some(1),
        Method::SecondVibrationMode => Some(2),
        _ => None,
    };
    let three = axis.signals == Signals::Three && axis.drive.structure() == Structure::TripleInertia;
    if let Some(balance) = mode.filter(|_| three).and_then(|mode| ForceBalance::of_three(mode, axis.drive)) {
        return Ok(balance);
    }
    if method == Method::SecondVibrationMode {
        let needs = "three inertias and three measured positions";
        return Err(ForceError::Structure { method: method.name(), needs });
    }
    let both = matches!(axis.signals, Signals::Both | Signals::Three);
    // Windows do with one encoder what the single-encoder observer does.
    let known = if method == Method::Fitted && !both { Method::Dob } else { method };
    on_measured_side(ForceBalance::new(known, axis.drive), axis.signals, method)
}

/// Moves what the balance needs to the side that is measured, where one mass carries everything.
fn on_measured_side(
    mut b: ForceBalance,
    signals: Signals,
    method: Method,
) -> Result<ForceBalance, ForceError> {
    let missing = |needs| Err(ForceError::Structure { method: method.name(), needs });
    match signals {
        Signals::Both | Signals::Three => Ok(b),
        Signals::MotorOnly if b.needs_stage() => missing("a stage position"),
        Signals::MotorOnly => Ok(b),
        Signals::StageOnly if b.needs_stage() => missing("a motor position"),
        Signals::StageOnly => {
            b.stage = b.motor;
            b.stage_friction_n += b.motor_friction_n;
            b.motor = MotionFactors::default();
            b.motor_friction_n = 0.0;
            Ok(b)
        }
    }
}

/// Lines per metre of travel of the encoders that enter the balance; 0 where unknown.
pub(super) fn encoder_lines_1_m(drive: &DriveParams, balance: &ForceBalance) -> [f64; 2] {
    let motor = match (drive.raw().motor_encoder_signals_per_rev, drive.screw_lead_m()) {
        (Some(signals), Some(lead_m)) if balance.needs_motor() => signals / lead_m,
        _ => 0.0,
    };
    let stage = match drive.raw().stage_encoder_signal_period_m {
        Some(period_m) if balance.needs_stage() => 1.0 / period_m,
        _ => 0.0,
    };
    [motor, stage]
}
