//! The columns of one axis in a recording: thrust in N, positions in m.

use crate::diagnosis::DiagnoseError;
use crate::diagnosis::steps::coarser_step;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;

/// Thrust reference in N, with N per recorded unit.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::diagnosis) struct Thrust {
    pub(in crate::diagnosis) reference_n: Vec<f64>,
    /// N per A where a current is recorded.
    pub(in crate::diagnosis) per_unit: f64,
    /// True for a current.
    pub(in crate::diagnosis) is_current: bool,
    /// Step of the column, N; 0: none is to be seen.
    pub(in crate::diagnosis) step_n: f64,
}

/// The column that [`thrust`] is read from.
pub(in crate::diagnosis) fn thrust_column(axis: &AxisModel, recording: &Recording) -> Option<String> {
    let names = ["thrust_ref_n", "torque_ref_nm", "current_ref_a"].map(|n| format!("{}_{n}", axis.name));
    names.into_iter().find(|name| recording.get(name).is_some())
}

/// Steps of the force that differ by less of its span are the same step.
const SAME_STEP: f64 = 1e-6;

/// Thrust from whichever reference is recorded. Errors: none is, or a current without a torque constant.
pub(in crate::diagnosis) fn thrust(axis: &AxisModel, recording: &Recording) -> Result<Thrust, DiagnoseError> {
    let name = |suffix: &str| format!("{}_{suffix}", axis.name);
    let scaled = |values: &[f64], per_unit: f64, is_current| Thrust {
        reference_n: values.iter().map(|v| v * per_unit).collect(),
        per_unit,
        is_current,
        step_n: per_unit * coarser_step(values, SAME_STEP * span(values)).unwrap_or(0.0),
    };
    if let Some(force) = recording.get(&name("thrust_ref_n")) {
        return Ok(scaled(force, 1.0, false));
    }
    if let Some(torque) = recording.get(&name("torque_ref_nm")) {
        return Ok(scaled(torque, 1.0 / axis.drive.travel_m_rad(), false));
    }
    if let Some(current) = recording.get(&name("current_ref_a")) {
        let constant = axis.drive.thrust_constant_n_a();
        let per_unit = constant.ok_or_else(|| DiagnoseError::NoTorqueConstant { axis: axis.name.clone() })?;
        return Ok(scaled(current, per_unit, true));
    }
    let expected = name("current_ref_a, _torque_ref_nm or _thrust_ref_n");
    Err(DiagnoseError::MissingColumn { recording: recording.experiment.clone(), expected })
}

/// Position in m from the motor encoder.
pub(in crate::diagnosis) fn motor_position(axis: &AxisModel, recording: &Recording) -> Option<Vec<f64>> {
    let name = |suffix: &str| format!("{}_{suffix}", axis.name);
    let travel = axis.drive.travel_m_rad();
    let angle = recording.get(&name("motor_angle_rad")).map(|a| a.iter().map(|v| v * travel).collect());
    angle.or_else(|| recording.get(&name("motor_position_m")).map(<[f64]>::to_vec))
}

/// Position in m of the linear scale.
pub(in crate::diagnosis) fn stage_position<'a>(
    axis: &AxisModel,
    recording: &'a Recording,
) -> Option<&'a [f64]> {
    recording.get(&format!("{}_stage_position_m", axis.name))
}

/// Position in m from the motor encoder, else from the scale.
pub(in crate::diagnosis) fn position(
    axis: &AxisModel,
    recording: &Recording,
) -> Result<Vec<f64>, DiagnoseError> {
    let stage = || stage_position(axis, recording).map(<[f64]>::to_vec);
    motor_position(axis, recording).or_else(stage).ok_or_else(|| {
        let expected = format!("{}_motor_angle_rad, _motor_position_m or _stage_position_m", axis.name);
        DiagnoseError::MissingColumn { recording: recording.experiment.clone(), expected }
    })
}

/// True where the output of a flexible axis is held: the motor turns, the stage stays where it is.
pub(in crate::diagnosis) fn is_locked(axis: &AxisModel, recording: &Recording) -> bool {
    let (Some(stage), Ok(motor)) = (stage_position(axis, recording), position(axis, recording)) else {
        return false;
    };
    let step = axis.drive.stage_encoder_resolution_m().max(axis.drive.motor_encoder_resolution_m());
    span(stage) <= step && span(&motor) > 20.0 * step.max(f64::MIN_POSITIVE)
}

/// Largest less smallest value.
pub(in crate::diagnosis) fn span(x: &[f64]) -> f64 {
    let [low, high] = x.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |e, v| [e[0].min(*v), e[1].max(*v)]);
    (high - low).max(0.0)
}
