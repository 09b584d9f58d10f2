//! From a recording to aligned signals of one axis: thrust, positions, velocities, accelerations.

use super::DiagnoseError;
use super::encoder_noise::variance_m2;
use super::kernel::{Action, Grid, Kernel};
use crate::plant::drive::{DriveParams, Structure};
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use std::sync::Arc;

/// Where inside a sample period the drive takes up a reference is stated nowhere; the middle of what drives
/// and their simulations do is a little before its end.
pub(super) const TAKEN_UP_SAMPLES: f64 = -1.0 / 8.0;

/// The band of the force balance: 800 Hz, or a fifth of a slow recording's rate.
pub(crate) fn band_hz(rate_hz: f64) -> f64 {
    (0.2 * rate_hz).min(800.0)
}

/// Position, velocity and acceleration of one side, low-passed and aligned.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Side {
    pub(crate) position_m: Vec<f64>,
    pub(crate) velocity_m_s: Vec<f64>,
    pub(crate) accel_m_s2: Vec<f64>,
    /// What the encoder's noise makes of the velocity, root mean square, m/s.
    pub(crate) velocity_noise_m_s: f64,
    /// As recorded, same samples, not filtered and not aligned.
    pub(crate) raw_m: Vec<f64>,
    /// As recorded, before the first of these samples: what a force with a memory has seen.
    pub(crate) before_m: Vec<f64>,
}

/// One recording of one axis, every signal at the same instants (`start_s` + k / rate).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Motion {
    pub(crate) experiment: String,
    pub(crate) rate_hz: f64,
    pub(crate) start_s: f64,
    /// Sample of the recording that element 0 belongs to.
    pub(crate) offset: usize,
    /// Thrust on the screw axis after dead time and current loop, N (filtered).
    pub(crate) thrust_n: Vec<f64>,
    /// Reference before the current loop, as thrust, N; not filtered.
    pub(crate) raw_reference_n: Vec<f64>,
    /// N per A where a current is recorded, else 1.
    pub(crate) thrust_per_unit: f64,
    /// Motor side.
    pub(crate) motor: Arc<Side>,
    /// Stage side.
    pub(crate) stage: Arc<Side>,
    /// Mean difference of the two encoders' positions: they do not share a zero. m.
    pub(crate) stretch_zero_m: f64,
    /// Mean position of the stage, m.
    pub(crate) centre_m: f64,
}

impl Motion {
    pub(crate) fn len(&self) -> usize {
        self.thrust_n.len()
    }

    pub(crate) fn time_s(&self, k: usize) -> f64 {
        self.start_s + (self.offset + k) as f64 / self.rate_hz
    }
}

pub(super) struct Columns<'a> {
    pub(super) reference_n: Vec<f64>,
    pub(super) thrust_per_unit: f64,
    pub(super) motor_m: Vec<f64>,
    pub(super) stage_m: &'a [f64],
}

/// The axis' columns as thrust and travel. Errors: a missing column, no torque constant.
pub(super) fn columns<'a>(axis: &AxisModel, recording: &'a Recording) -> Result<Columns<'a>, DiagnoseError> {
    let name = |suffix: &str| format!("{}_{suffix}", axis.name);
    let missing = |expected: &str| DiagnoseError::MissingColumn {
        recording: recording.experiment.clone(),
        expected: name(expected),
    };
    let travel = axis.drive.travel_m_rad();
    let (reference, thrust_per_unit) = if let Some(i) = recording.get(&name("current_ref_a")) {
        let k = axis
            .drive
            .thrust_constant_n_a()
            .ok_or_else(|| DiagnoseError::NoTorqueConstant { axis: axis.name.clone() })?;
        (i, k)
    } else if let Some(t) = recording.get(&name("torque_ref_nm")) {
        (t, 1.0 / travel)
    } else if let Some(f) = recording.get(&name("thrust_ref_n")) {
        (f, 1.0)
    } else {
        return Err(missing("current_ref_a, _torque_ref_nm or _thrust_ref_n"));
    };
    let motor_m = recording
        .get(&name("motor_angle_rad"))
        .map(|th| th.iter().map(|x| x * travel).collect())
        .or_else(|| recording.get(&name("motor_position_m")).map(<[f64]>::to_vec));
    let motor_m = motor_m.ok_or_else(|| missing("motor_angle_rad or _motor_position_m"))?;
    let stage_m = recording.get(&name("stage_position_m")).ok_or_else(|| missing("stage_position_m"))?;
    Ok(Columns {
        reference_n: reference.iter().map(|x| x * thrust_per_unit).collect(),
        thrust_per_unit,
        motor_m,
        stage_m,
    })
}

/// Delay from a reference to the moment at which the drive takes it up and holds it, s.
pub(crate) fn thrust_delay_s(drive: &DriveParams, rate_hz: f64) -> f64 {
    drive.amplifier_dead_time_s() + TAKEN_UP_SAMPLES / rate_hz
}

/// True when the model is flexible and the recording has both encoders.
pub(crate) fn is_flexible(axis: &AxisModel, recording: &Recording) -> bool {
    axis.drive.structure() != Structure::Rigid
        && recording.get(&format!("{}_stage_position_m", axis.name)).is_some()
        && (recording.get(&format!("{}_motor_angle_rad", axis.name)).is_some()
            || recording.get(&format!("{}_motor_position_m", axis.name)).is_some())
}

fn side(raw: &[f64], delay_s: f64, frame: &Frame) -> Side {
    let origin = raw.first().copied().unwrap_or(0.0);
    let local: Vec<f64> = raw.iter().map(|x| x - origin).collect();
    let kernel = |derivative| {
        Kernel::low_pass(frame.band_hz, frame.rate_hz, Action { derivative, advance_s: delay_s })
    };
    let filtered = |kernel: &Kernel| kernel.apply(&local, frame.grid);
    let velocity = kernel(1);
    let end = frame.grid.first + frame.grid.count;
    Side {
        position_m: filtered(&kernel(0)).iter().map(|x| x + origin).collect(),
        velocity_m_s: filtered(&velocity),
        accel_m_s2: filtered(&kernel(2)),
        velocity_noise_m_s: (variance_m2(raw, frame.rate_hz) * velocity.power()).sqrt(),
        raw_m: raw[frame.grid.first..end].to_vec(),
        before_m: raw[..frame.grid.first].to_vec(),
    }
}

struct Frame {
    band_hz: f64,
    rate_hz: f64,
    grid: Grid,
}

/// Positions alone, one of motor and stage, m: a motion without thrust.
pub(crate) fn of_positions(drive: &DriveParams, rate_hz: f64, [motor_m, stage_m]: [&[f64]; 2]) -> Motion {
    let band_hz = band_hz(rate_hz);
    let longest = drive.motor_encoder_delay_s().max(drive.stage_encoder_delay_s());
    let edge = Kernel::low_pass(band_hz, rate_hz, Action { derivative: 0, advance_s: longest }).half() + 2;
    let grid = Grid { first: edge, step: 1, count: motor_m.len() - 2 * edge };
    let frame = Frame { band_hz, rate_hz, grid };
    Motion {
        experiment: String::new(),
        rate_hz,
        start_s: 0.0,
        offset: grid.first,
        thrust_n: vec![0.0; grid.count],
        raw_reference_n: vec![0.0; grid.count],
        thrust_per_unit: 1.0,
        motor: Arc::new(side(motor_m, drive.motor_encoder_delay_s(), &frame)),
        stage: Arc::new(side(stage_m, drive.stage_encoder_delay_s(), &frame)),
        stretch_zero_m: 0.0,
        centre_m: 0.0,
    }
}

/// Aligns and filters one recording.
pub(crate) fn motion(axis: &AxisModel, recording: &Recording) -> Result<Motion, DiagnoseError> {
    let columns = columns(axis, recording)?;
    let drive = &axis.drive;
    let rate_hz = recording.sample_rate.hz();
    let band_hz = band_hz(rate_hz);
    let delay_s = thrust_delay_s(drive, rate_hz);
    let longest = drive.motor_encoder_delay_s().max(drive.stage_encoder_delay_s());
    let reference =
        Kernel::of_held_reference(band_hz, rate_hz, -delay_s, drive.current_loop_bandwidth_rad_s());
    let positions = Kernel::low_pass(band_hz, rate_hz, Action { derivative: 0, advance_s: longest });
    let edge = positions.half().max(reference.half()) + 2;
    let samples = recording.len();
    let needed = 8 * edge + 64;
    if samples < needed {
        return Err(DiagnoseError::TooShort { recording: recording.experiment.clone(), samples, needed });
    }
    let grid = Grid { first: edge, step: 1, count: samples - 2 * edge };
    let frame = Frame { band_hz, rate_hz, grid };
    let thrust = reference.apply(&columns.reference_n, grid);
    let motor = side(&columns.motor_m, drive.motor_encoder_delay_s(), &frame);
    let stage = side(columns.stage_m, drive.stage_encoder_delay_s(), &frame);
    let end = grid.first + grid.count;
    let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len().max(1) as f64;
    let centre_m = mean(&stage.position_m);
    let stretch_zero_m = mean(&motor.position_m) - centre_m;
    Ok(Motion {
        experiment: recording.experiment.clone(),
        rate_hz,
        start_s: recording.start_s,
        offset: grid.first,
        thrust_n: thrust,
        raw_reference_n: columns.reference_n[grid.first..end].to_vec(),
        thrust_per_unit: columns.thrust_per_unit,
        motor: Arc::new(motor),
        stage: Arc::new(stage),
        stretch_zero_m,
        centre_m,
    })
}
