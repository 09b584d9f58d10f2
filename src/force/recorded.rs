//! The motion of one axis out of a recording, whichever of the contract's columns carry it.

use super::motion::MotionSample;
use super::signals::Signals;
use crate::plant::drive::DriveParams;
use crate::sample::Recording;
use thiserror::Error;

/// Why a recording does not hold the motion of an axis.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum MotionError {
    /// Nothing says what the drive was told.
    #[error("no column {axis}_current_ref_a, {axis}_torque_ref_nm or {axis}_thrust_ref_n")]
    NoReference {
        /// Axis.
        axis: String,
    },
    /// A current needs a torque constant.
    #[error("column {axis}_current_ref_a needs torque_constant_nm_a in the model")]
    NoTorqueConstant {
        /// Axis.
        axis: String,
    },
    /// A torque or an angle needs a screw.
    #[error("column {column} needs screw_lead_m in the model")]
    NoScrew {
        /// Column.
        column: String,
    },
    /// No position.
    #[error("no column {axis}_motor_angle_rad, {axis}_motor_position_m or {axis}_stage_position_m")]
    NoPosition {
        /// Axis.
        axis: String,
    },
}

/// Motion of one axis, sample by sample.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedMotion {
    /// Samples in the order of the file.
    pub samples: Vec<MotionSample>,
    /// Which positions are there.
    pub signals: Signals,
}

/// True when the recording says what the drive of this axis was told.
#[must_use]
pub fn has_drive(recording: &Recording, axis: &str) -> bool {
    ["current_ref_a", "torque_ref_nm", "thrust_ref_n"]
        .iter()
        .any(|s| recording.get(&format!("{axis}_{s}")).is_some())
}

/// Motion of an axis. Errors: no reference, no position, or a model that lacks what converts them.
pub fn motion_of_recording(
    recording: &Recording,
    axis: &str,
    drive: &DriveParams,
) -> Result<RecordedMotion, MotionError> {
    let column = |suffix: &str| recording.get(&format!("{axis}_{suffix}"));
    let screw = |suffix: &str| match drive.screw_lead_m() {
        Some(_) => Ok(drive.travel_m_rad()),
        None => Err(MotionError::NoScrew { column: format!("{axis}_{suffix}") }),
    };
    let owned = || axis.to_owned();
    let (reference, factor) = if let Some(thrust) = column("thrust_ref_n") {
        (thrust, 1.0)
    } else if let Some(torque) = column("torque_ref_nm") {
        (torque, 1.0 / screw("torque_ref_nm")?)
    } else if let Some(current) = column("current_ref_a") {
        (current, drive.thrust_constant_n_a().ok_or_else(|| MotionError::NoTorqueConstant { axis: owned() })?)
    } else {
        return Err(MotionError::NoReference { axis: owned() });
    };
    let (motor, motor_factor) = match (column("motor_position_m"), column("motor_angle_rad")) {
        (Some(position), _) => (Some(position), 1.0),
        (None, Some(angle)) => (Some(angle), screw("motor_angle_rad")?),
        (None, None) => (None, 1.0),
    };
    let stage = column("stage_position_m");
    let spindle = recording.get("spindle_speed_rpm");
    let accel = accelerations(recording);
    let nut = column("nut_position_m");
    let signals = match (motor.is_some(), stage.is_some()) {
        (true, true) if nut.is_some() => Signals::Three,
        (true, true) => Signals::Both,
        (true, false) => Signals::MotorOnly,
        (false, true) => Signals::StageOnly,
        (false, false) => return Err(MotionError::NoPosition { axis: owned() }),
    };
    let samples = reference
        .iter()
        .enumerate()
        .map(|(i, reference)| MotionSample {
            thrust_ref_n: factor * reference,
            motor_travel_m: motor.map(|m| motor_factor * m[i]),
            nut_position_m: nut.map(|n| n[i]),
            stage_position_m: stage.map(|s| s[i]),
            spindle_speed_rpm: spindle.map(|s| s[i]),
            accel_m_s2: accel.map(|[x, y, z]| [x[i], y[i], z[i]]),
        })
        .collect();
    Ok(RecordedMotion { samples, signals })
}

/// Columns of the accelerations of the spindle housing, x, y, z; `None` unless all three are there.
#[must_use]
pub fn accelerations(recording: &Recording) -> Option<[&[f64]; 3]> {
    let [x, y, z] = ["x", "y", "z"].map(|axis| recording.get(&format!("{axis}_accel_m_s2")));
    Some([x?, y?, z?])
}
