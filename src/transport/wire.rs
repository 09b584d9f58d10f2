//! What crosses shared memory: the layout that every participant, in whatever language, must share.
//!
//! `deploy/include/stillcut.h` states the same layout for C, `deploy/python/publish_samples.py` for
//! Python; `tests/suite/transport.rs` holds offsets and sizes. A new layout is a new type name.
//!
//! All times are nanoseconds of the **producer's** monotonic clock. A command echoes the time of the
//! newest sample that it rests on, so the receiver judges its age by its own clock alone.
#![allow(unsafe_code)] // the derive marks plain-old-data types as safe to share between processes

use crate::sample::{AxisSample, SampleError, ServoSample};
use iceoryx2::prelude::ZeroCopySend;

pub use crate::sample::MAX_AXES;

/// Most samples one batch may carry.
pub const MAX_SAMPLES: usize = 32;
/// Bytes of an axis name, padded with zeros.
pub const AXIS_NAME_BYTES: usize = 8;

/// Bit of [`ServoPoint::valid`], shifted by three times the axis: the reference current is valid.
pub const VALID_CURRENT: u32 = 1;
/// Bit of [`ServoPoint::valid`]: the motor angle is valid.
pub const VALID_MOTOR: u32 = 2;
/// Bit of [`ServoPoint::valid`]: the stage position is valid.
pub const VALID_STAGE: u32 = 4;
/// Bit of [`ServoPoint::valid`], for the whole sample: the accelerations are valid.
pub const VALID_ACCEL: u32 = 1 << 24;
/// All three signals of an axis are valid.
pub const VALID_ALL: u32 = VALID_CURRENT | VALID_MOTOR | VALID_STAGE;

/// Bit of [`TurretStatus::interlocks_open`]: the controller's permissive.
pub const INTERLOCK_PERMISSIVE: u32 = 1;
/// Bit of [`TurretStatus::interlocks_open`]: the operator's release at the machine.
pub const INTERLOCK_OPERATOR: u32 = 2;
/// Bit of [`TurretStatus::interlocks_open`]: door, chuck or feed hold.
pub const INTERLOCK_MACHINE: u32 = 4;
/// Names of the interlock bits, in their order.
pub const INTERLOCK_NAMES: [&str; 3] = ["permissive", "operator", "machine"];

/// One axis at one instant.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("stillcut.ServoAxis.v1")]
pub struct ServoAxis {
    /// Reference current of the motor in A.
    pub current_ref_a: f64,
    /// Rotary encoder in rad.
    pub motor_angle_rad: f64,
    /// Linear scale in m.
    pub stage_position_m: f64,
}

/// All axes at one instant: 208 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("stillcut.ServoPoint.v2")]
pub struct ServoPoint {
    /// Counts every sample of the producer from 0; a step of more than one is a loss.
    pub sequence: u64,
    /// Producer's monotonic clock in ns at the instant of sampling.
    pub t_ns: u64,
    /// Workpiece angle in rad, growing.
    pub spindle_angle_rad: f64,
    /// Spindle speed in rpm.
    pub spindle_speed_rpm: f64,
    /// Three bits an axis, axis 0 lowest: current, motor, stage; bit 24: accelerations.
    pub valid: u32,
    /// Zero.
    pub reserved: u32,
    /// Signals; entries beyond the axis count are zero.
    pub axes: [ServoAxis; MAX_AXES],
    /// Accelerations of the spindle housing in x, y, z, m/s2.
    pub accel_m_s2: [f64; 3],
}

/// Up to 32 consecutive samples of up to 6 axes: 6728 bytes.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, ZeroCopySend)]
#[type_name("stillcut.ServoBatch.v2")]
pub struct ServoBatch {
    /// Changes whenever the producer starts anew; sequences are only compared within one stream.
    pub stream: u64,
    /// Samples per second.
    pub sample_rate_hz: f64,
    /// Used entries of `points`, 1 to 32.
    pub sample_count: u32,
    /// Used axes, 1 to 6.
    pub axis_count: u32,
    /// ASCII names padded with zeros.
    pub axis_names: [[u8; AXIS_NAME_BYTES]; MAX_AXES],
    /// The samples, oldest first.
    pub points: [ServoPoint; MAX_SAMPLES],
}

impl Default for ServoBatch {
    fn default() -> Self {
        Self {
            stream: 0,
            sample_rate_hz: 0.0,
            sample_count: 0,
            axis_count: 0,
            axis_names: [[0; AXIS_NAME_BYTES]; MAX_AXES],
            points: [ServoPoint::default(); MAX_SAMPLES],
        }
    }
}

/// What a [`TurretCommand`] asks for.
pub const COMMAND_OFFSET: u32 = 1;
/// Ramp back to equal pitch and stay there.
pub const COMMAND_RETURN: u32 = 2;

/// Turret offsets asked of the motion controller.
///
/// The receiver obeys only a pair (epoch, sequence) above every one it has seen, ramps with its own
/// speed limit, and returns to equal pitch when its clock passes `based_on_t_ns + ttl_ns`.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("stillcut.TurretCommand.v1")]
pub struct TurretCommand {
    /// Grows with every start of the service on one state directory.
    pub epoch: u64,
    /// Grows with every command of an epoch; a repetition carries the same number.
    pub sequence: u64,
    /// Producer's clock in ns of the newest sample that the decision used.
    pub based_on_t_ns: u64,
    /// Service's monotonic clock in ns when the command was issued; for records only.
    pub issued_t_ns: u64,
    /// Lifetime counted from `based_on_t_ns`.
    pub ttl_ns: u64,
    /// The stream that `based_on_t_ns` belongs to.
    pub stream: u64,
    /// Pitch angle difference that the offsets make, in rad.
    pub pitch_difference_rad: f64,
    /// Offset of each axis from its programmed path, along the axis, in m.
    pub offset_m: [f64; MAX_AXES],
    /// Used entries of `offset_m`.
    pub axis_count: u32,
    /// [`COMMAND_OFFSET`] or [`COMMAND_RETURN`].
    pub kind: u32,
}

/// The turret stands where the last command (or none) put it.
pub const TURRET_REACHED: u32 = 1;
/// On the way.
pub const TURRET_MOVING: u32 = 2;
/// The last command was not accepted.
pub const TURRET_REFUSED: u32 = 3;
/// The last command was cut to the controller's own limits.
pub const TURRET_LIMITED: u32 = 4;
/// The last command expired; the turret is on its way to, or at, equal pitch.
pub const TURRET_EXPIRED: u32 = 5;

/// What the motion controller reports, at least ten times a second.
#[repr(C)]
#[derive(Debug, Clone, Copy, Default, PartialEq, ZeroCopySend)]
#[type_name("stillcut.TurretStatus.v1")]
pub struct TurretStatus {
    /// The stream of the servo samples of the same controller.
    pub stream: u64,
    /// Counts the reports from 0.
    pub sequence: u64,
    /// Producer's clock in ns.
    pub t_ns: u64,
    /// Epoch of the newest command seen; 0 before the first.
    pub acknowledged_epoch: u64,
    /// Sequence of the newest command seen.
    pub acknowledged_sequence: u64,
    /// Actual offset of each axis in m.
    pub offset_m: [f64; MAX_AXES],
    /// Used entries of `offset_m`.
    pub axis_count: u32,
    /// One bit each, set = open; see [`INTERLOCK_NAMES`].
    pub interlocks_open: u32,
    /// One of the `TURRET_` values.
    pub state: u32,
    /// Zero.
    pub reserved: u32,
}

/// An axis name as it travels: cut to 8 bytes, padded with zeros.
#[must_use]
pub fn axis_name_bytes(name: &str) -> [u8; AXIS_NAME_BYTES] {
    let mut bytes = [0; AXIS_NAME_BYTES];
    for (to, from) in bytes.iter_mut().zip(name.bytes()) {
        *to = from;
    }
    bytes
}

/// The text of a travelled axis name; what is not printable ASCII becomes `?`.
#[must_use]
pub fn axis_name_text(bytes: &[u8; AXIS_NAME_BYTES]) -> String {
    let used = bytes.iter().take_while(|b| **b != 0);
    used.map(|b| if b.is_ascii_graphic() { char::from(*b) } else { '?' }).collect()
}

impl ServoBatch {
    /// The used samples; none where the count is not 1 to 32 (a foreign producer's slip).
    #[must_use]
    pub fn used_points(&self) -> &[ServoPoint] {
        usize::try_from(self.sample_count).ok().and_then(|n| self.points.get(..n)).unwrap_or_default()
    }

    /// Number of axes, if it is 1 to 6.
    #[must_use]
    pub fn axes(&self) -> Option<usize> {
        usize::try_from(self.axis_count).ok().filter(|n| (1..=MAX_AXES).contains(n))
    }
}

impl ServoPoint {
    /// The sample that travelled. An axis without a valid stage is semi-closed.
    /// Errors: a current or motor angle that is not valid, anything that is not finite.
    pub fn to_sample(&self, axes: usize) -> Result<ServoSample, SampleError> {
        let mut sample = ServoSample {
            sequence: self.sequence,
            t_s: self.t_ns as f64 * 1e-9,
            axes: [AxisSample::default(); MAX_AXES],
            spindle_angle_rad: self.spindle_angle_rad,
            spindle_speed_rpm: self.spindle_speed_rpm,
            accel_m_s2: (self.valid & VALID_ACCEL != 0).then_some(self.accel_m_s2),
            pitch_difference_rad: None,
        };
        for (index, (to, from)) in sample.axes.iter_mut().zip(&self.axes).take(axes).enumerate() {
            let valid = self.valid >> (3 * index);
            if valid & (VALID_CURRENT | VALID_MOTOR) != VALID_CURRENT | VALID_MOTOR {
                return Err(SampleError::AxisNotFinite { axis: index });
            }
            *to = AxisSample {
                current_ref_a: from.current_ref_a,
                motor_angle_rad: from.motor_angle_rad,
                stage_position_m: (valid & VALID_STAGE != 0).then_some(from.stage_position_m),
            };
        }
        sample.check().map(|()| sample)
    }

    /// The sample as it travels, taken at `t_ns` of the producer's clock.
    #[must_use]
    pub fn from_sample(sample: &ServoSample, t_ns: u64, axes: usize) -> Self {
        let mut point = Self {
            sequence: sample.sequence,
            t_ns,
            spindle_angle_rad: sample.spindle_angle_rad,
            spindle_speed_rpm: sample.spindle_speed_rpm,
            valid: if sample.accel_m_s2.is_some() { VALID_ACCEL } else { 0 },
            accel_m_s2: sample.accel_m_s2.unwrap_or_default(),
            ..Self::default()
        };
        for (index, (to, from)) in point.axes.iter_mut().zip(&sample.axes).take(axes).enumerate() {
            let stage = if from.stage_position_m.is_some() { VALID_STAGE } else { 0 };
            point.valid |= (VALID_CURRENT | VALID_MOTOR | stage) << (3 * index);
            *to = ServoAxis {
                current_ref_a: from.current_ref_a,
                motor_angle_rad: from.motor_angle_rad,
                stage_position_m: from.stage_position_m.unwrap_or_default(),
            };
        }
        point
    }

    /// `valid` with all signals of the first `axes` axes marked.
    #[must_use]
    pub fn all_valid(axes: usize) -> u32 {
        (0..axes.min(MAX_AXES)).fold(0, |bits, axis| bits | VALID_ALL << (3 * axis))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{offset_of, size_of};

    #[test]
    fn layout_is_the_documented_one() {
        assert_eq!(size_of::<ServoAxis>(), 24);
        assert_eq!(size_of::<ServoPoint>(), 208);
        assert_eq!(offset_of!(ServoPoint, accel_m_s2), 184);
        assert_eq!(offset_of!(ServoPoint, axes), 40);
        assert_eq!(size_of::<ServoBatch>(), 24 + 48 + 32 * 208);
        assert_eq!(offset_of!(ServoBatch, points), 72);
        assert_eq!(size_of::<TurretCommand>(), 7 * 8 + 6 * 8 + 8);
        assert_eq!(offset_of!(TurretCommand, kind), 108);
        assert_eq!(size_of::<TurretStatus>(), 5 * 8 + 6 * 8 + 16);
        assert_eq!(offset_of!(TurretStatus, state), 96);
    }

    #[test]
    fn names_survive_the_wire_and_foreign_bytes_do_no_harm() {
        assert_eq!(axis_name_text(&axis_name_bytes("x1")), "x1");
        assert_eq!(axis_name_text(&axis_name_bytes("longer-than-eight")), "longer-t");
        assert_eq!(axis_name_text(&[b'x', 0xff, b'\n', 0, b'z', 0, 0, 0]), "x??");
    }

    #[test]
    fn a_batch_that_overstates_its_counts_has_no_samples() {
        let batch = ServoBatch { sample_count: 33, axis_count: 7, ..ServoBatch::default() };
        assert!(batch.used_points().is_empty());
        assert_eq!(batch.axes(), None);
    }

    #[test]
    fn samples_survive_the_wire_and_what_is_no_number_is_refused() {
        let mut sample =
            ServoPoint { valid: ServoPoint::all_valid(2), ..ServoPoint::default() }.to_sample(2).unwrap();
        sample.axes[0] =
            AxisSample { current_ref_a: 1.5, motor_angle_rad: -2.0, stage_position_m: Some(0.25) };
        sample.axes[1].stage_position_m = None;
        sample.t_s = 3.0;
        sample.accel_m_s2 = Some([0.5, -9.0, 1e-3]);
        let mut point = ServoPoint::from_sample(&sample, 3_000_000_000, 2);
        assert_eq!(point.to_sample(2), Ok(sample));
        assert_eq!(point.to_sample(3), Err(SampleError::AxisNotFinite { axis: 2 }), "not marked");
        point.axes[1].current_ref_a = f64::NAN;
        assert_eq!(point.to_sample(2), Err(SampleError::AxisNotFinite { axis: 1 }));
        point.accel_m_s2[1] = f64::NAN;
        assert_eq!(point.to_sample(2), Err(SampleError::HeadNotFinite));
        point.spindle_angle_rad = f64::INFINITY;
        assert_eq!(point.to_sample(2), Err(SampleError::HeadNotFinite));
    }
}
