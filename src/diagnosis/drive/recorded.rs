//! The columns of one axis in a recording: thrust in N, positions in m.

use super::spectra::SHORTEST_BLOCK;
use crate::diagnosis::DiagnoseError;
use crate::diagnosis::steps::coarser_step;
use crate::plant::effects::Port;
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
    /// A command that changes less often than the shortest block has samples: it is switched, and answers to
    /// nothing that acts on the axis, so that nothing can be told from when it changes.
    pub(in crate::diagnosis) is_switched: bool,
}

/// What a force may be recorded as.
const REFERENCES: [&str; 3] = ["thrust_ref_n", "torque_ref_nm", "current_ref_a"];

/// The column that [`thrust`] is read from.
pub(in crate::diagnosis) fn thrust_column(axis: &AxisModel, recording: &Recording) -> Option<String> {
    let names = REFERENCES.map(|n| format!("{}_{n}", axis.name));
    names.into_iter().find(|name| recording.get(name).is_some())
}

/// Thrust from whichever reference is recorded. Errors: none is, or a current without a torque constant.
pub(in crate::diagnosis) fn thrust(axis: &AxisModel, recording: &Recording) -> Result<Thrust, DiagnoseError> {
    let d = &axis.drive;
    let per_unit = [Some(1.0), Some(1.0 / d.travel_m_rad()), d.thrust_constant_n_a()];
    let values = |kind: usize| recording.get(&format!("{}_{}", axis.name, REFERENCES[kind]));
    let Some((kind, values)) = (0..3).find_map(|kind| Some((kind, values(kind)?))) else {
        let expected = format!("{}_current_ref_a, _torque_ref_nm or _thrust_ref_n", axis.name);
        return Err(DiagnoseError::MissingColumn { recording: recording.experiment.clone(), expected });
    };
    let no_constant = || DiagnoseError::NoTorqueConstant { axis: axis.name.clone() };
    let per_unit = per_unit[kind].ok_or_else(no_constant)?;
    // What single precision rounds is no step.
    let least = 8.0 * f64::from(f32::EPSILON) * span(values);
    Ok(Thrust {
        reference_n: values.iter().map(|v| v * per_unit).collect(),
        per_unit,
        is_current: kind == 2,
        step_n: per_unit * coarser_step(values, least).unwrap_or(0.0),
        is_switched: values.windows(2).filter(|w| w[0] != w[1]).take(SHORTEST_BLOCK).count() < SHORTEST_BLOCK,
    })
}

/// The column of an encoder and travel per unit of it, m.
pub(in crate::diagnosis) fn position_column(
    axis: &AxisModel,
    recording: &Recording,
    port: Port,
) -> Option<(String, f64)> {
    let of_motor = [("motor_angle_rad", axis.drive.travel_m_rad()), ("motor_position_m", 1.0)];
    let of_stage = [("stage_position_m", 1.0)];
    let all = if port == Port::MotorEncoder { &of_motor[..] } else { &of_stage };
    let mut named = all.iter().map(|(suffix, m_per_unit)| (format!("{}_{suffix}", axis.name), *m_per_unit));
    named.find(|(name, _)| recording.get(name).is_some())
}

/// Position in m from the motor encoder.
pub(in crate::diagnosis) fn motor_position(axis: &AxisModel, recording: &Recording) -> Option<Vec<f64>> {
    position_at(axis, recording, Port::MotorEncoder)
}

/// Position in m of the linear scale.
pub(in crate::diagnosis) fn stage_position<'a>(
    axis: &AxisModel,
    recording: &'a Recording,
) -> Option<&'a [f64]> {
    recording.get(&format!("{}_stage_position_m", axis.name))
}

/// Position in m that an encoder reads.
pub(in crate::diagnosis) fn position_at(
    axis: &AxisModel,
    recording: &Recording,
    port: Port,
) -> Option<Vec<f64>> {
    let (name, m_per_unit) = position_column(axis, recording, port)?;
    Some(recording.get(&name)?.iter().map(|v| v * m_per_unit).collect())
}

/// True where motor and stage are both read.
pub(in crate::diagnosis) fn has_both_positions(axis: &AxisModel, recording: &Recording) -> bool {
    [Port::MotorEncoder, Port::StageEncoder].iter().all(|p| position_column(axis, recording, *p).is_some())
}

/// Position in m from the motor encoder, else from the scale.
pub(in crate::diagnosis) fn position(
    axis: &AxisModel,
    recording: &Recording,
) -> Result<Vec<f64>, DiagnoseError> {
    let read = |port| position_at(axis, recording, port);
    read(Port::MotorEncoder).or_else(|| read(Port::StageEncoder)).ok_or_else(|| {
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
