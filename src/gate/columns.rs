//! What a column measures, by its name.

use crate::sample::Recording;

/// What a column of an axis holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    /// Current, torque or thrust of the drive.
    Drive,
    /// An encoder.
    Position,
    /// A speed that was logged.
    Speed,
    /// A force sensor, an accelerometer, anything else that is measured.
    Sensor,
    /// What was asked for, or a flag: it may stand still.
    Command,
}

/// A column of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct AxisColumn {
    /// Index in the recording.
    pub(super) index: usize,
    pub(super) role: Role,
}

/// The columns of one axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct AxisColumns {
    pub(super) columns: Vec<AxisColumn>,
}

impl AxisColumns {
    /// Columns whose names begin with `axis` and an underscore.
    pub(super) fn of(recording: &Recording, axis: &str) -> Self {
        let role = |name: &str| name.strip_prefix(axis)?.strip_prefix('_').and_then(role_of);
        let found = recording.columns.iter().enumerate();
        let columns = found.filter_map(|(index, c)| Some(AxisColumn { index, role: role(&c.name)? }));
        Self { columns: columns.collect() }
    }

    pub(super) fn with(&self, role: Role) -> impl Iterator<Item = usize> + '_ {
        self.columns.iter().filter(move |c| c.role == role).map(|c| c.index)
    }

    /// The position that stands for the motion: the motor's where there is one.
    pub(super) fn position(&self, recording: &Recording) -> Option<usize> {
        let motor = |i: &usize| recording.columns[*i].name.contains("_motor_");
        self.with(Role::Position).find(motor).or_else(|| self.with(Role::Position).next())
    }

    /// What is measured, commands left out.
    pub(super) fn measured(&self) -> impl Iterator<Item = AxisColumn> + '_ {
        self.columns.iter().copied().filter(|c| c.role != Role::Command)
    }
}

/// `None`: nothing that the gate knows how to judge.
fn role_of(name: &str) -> Option<Role> {
    let says = |words: &[&str]| words.iter().any(|w| name.contains(w));
    let ends = |units: &[&str]| units.iter().any(|u| name.ends_with(u));
    if says(&["cmd", "command", "set_point", "reference_position", "flag", "segment", "following_error"]) {
        return Some(Role::Command);
    }
    if says(&["current", "torque", "thrust", "voltage", "motor_force"]) {
        return ends(&["_a", "_nm", "_n", "_v"]).then_some(Role::Drive);
    }
    if says(&["velocity", "speed"]) {
        return ends(&["_m_s", "_rad_s", "_rpm"]).then_some(Role::Speed);
    }
    if says(&["position", "angle"]) {
        return ends(&["_m", "_rad"]).then_some(Role::Position);
    }
    ends(&["force_n", "accel_m_s2"]).then_some(Role::Sensor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_the_contract_say_what_they_measure() {
        let of = |name| role_of(name);
        assert_eq!(of("current_ref_a"), Some(Role::Drive));
        assert_eq!(of("torque_ref_nm"), Some(Role::Drive));
        assert_eq!(of("thrust_ref_n"), Some(Role::Drive));
        assert_eq!(of("motor_angle_rad"), Some(Role::Position));
        assert_eq!(of("stage_position_m"), Some(Role::Position));
        assert_eq!(of("motor_velocity_rad_s"), Some(Role::Speed));
        assert_eq!(of("position_cmd_m"), Some(Role::Command));
        assert_eq!(of("force_n"), Some(Role::Sensor));
        assert_eq!(of("dc_bus_voltage_raw"), None);
    }
}
