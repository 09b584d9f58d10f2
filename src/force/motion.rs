//! One instant of one axis: its samples, its aligned motion, the estimate of its force.

use super::validity::Validity;

/// One instant of one axis. A position that is absent is held at its last value and flagged.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MotionSample {
    /// Thrust reference K_t I / R on the screw axis, N.
    pub thrust_ref_n: f64,
    /// Motor angle as stage travel, m.
    pub motor_travel_m: Option<f64>,
    /// Screw at the nut as stage travel, where a third position is measured, m.
    pub nut_position_m: Option<f64>,
    /// Linear scale, m.
    pub stage_position_m: Option<f64>,
    /// Spindle speed, where it is known, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// Accelerations of the spindle housing (x, y, z), for `frf` alone, m/s2.
    pub accel_m_s2: Option<[f64; 3]>,
}

/// Aligned motion of one instant: what the balance works on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlignedMotion {
    /// Thrust that acted, N.
    pub thrust_n: f64,
    /// Motor travel, m.
    pub motor_m: f64,
    /// Motor travel velocity, m/s.
    pub motor_velocity_m_s: f64,
    /// Stage position, m.
    pub stage_m: f64,
    /// Stage velocity, m/s.
    pub stage_velocity_m_s: f64,
}

/// An instant as the comparison needs it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Aligned {
    pub(super) motion: AlignedMotion,
    /// M_r and C_r parts of the motor side.
    pub(super) inertia_n: f64,
    /// Share of the motor's friction at its speed, -1 to 1.
    pub(super) friction: f64,
}

/// An estimate on its way: before the low-pass, with the motion behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Underway {
    pub(super) force_n: f64,
    pub(super) flags: Validity,
    pub(super) motion: AlignedMotion,
    /// Of this instant, also where the estimate is a window's.
    pub(super) aligned: Aligned,
}

/// One estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceEstimate {
    /// Cutting force as it was `Properties::delay_s` ago, N; positive opposes stage motion.
    pub force_n: f64,
    /// What speaks against it.
    pub flags: Validity,
}
