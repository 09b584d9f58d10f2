//! A machine as its model file states it: axes, their drives, controllers and further physics.

use super::drive::DriveParams;
use super::effects::PhysicsTerm;
use crate::units::SampleRate;

/// Position and velocity loop of one axis: P position on the stage encoder (on the motor encoder
/// where there is no other), PI velocity on the motor encoder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Controller {
    /// K_p: velocity command per position error, 1/s.
    pub position_gain_1_s: f64,
    /// K_v: acceleration command per velocity error, 1/s.
    pub velocity_gain_1_s: f64,
    /// K_i: integral of the velocity error, 1/s.
    pub velocity_integral_1_s: f64,
    /// Bandwidth of the filter on the measured velocity, rad/s.
    pub velocity_filter_rad_s: f64,
}

/// One axis.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisModel {
    /// Name, the prefix of its columns.
    pub name: String,
    /// Drive.
    pub drive: DriveParams,
    /// Control loop, where it is known.
    pub controller: Option<Controller>,
    /// Physics beyond the structure.
    pub physics: Vec<PhysicsTerm>,
}

/// One machine.
#[derive(Debug, Clone, PartialEq)]
pub struct Machine {
    /// Free name.
    pub name: String,
    /// Rate of the control loop and of the samples.
    pub sample_rate: SampleRate,
    /// Axes in the order of the file.
    pub axes: Vec<AxisModel>,
}

impl Machine {
    /// The axis of that name.
    #[must_use]
    pub fn axis(&self, name: &str) -> Option<&AxisModel> {
        self.axes.iter().find(|a| a.name == name)
    }
}
