//! A recording of an axis with one position: thrust, position, velocity, acceleration on a thinned grid.

use crate::diagnosis::DiagnoseError;
use crate::diagnosis::encoder_noise::rounding_m;
use crate::diagnosis::kernel::{Action, Grid, Kernel};
use crate::diagnosis::motion::thrust_delay_s;
use crate::plant::drive::Structure;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use crate::signal::inner_products::rms;

/// Share of the sampling rate that the balance looks at: enough for friction, below where encoder steps rule.
const BAND_SHARE: f64 = 0.1;
/// Share of the thrust that the encoder's steps may amount to once differentiated twice and times the mass.
const NOISE_SHARE: f64 = 0.02;
/// Share of the axial resonance up to which a flexible axis with one encoder moves as one mass: there its
/// stage lags by 2 % of its inertia.
pub(super) const RIGID_SHARE: f64 = 0.15;
/// Rows per band: the residual is barely oversampled.
const ROWS_PER_BAND: f64 = 3.2;
/// Fewest rows that a diagnosis can be fitted to and judged on.
const LEAST_ROWS: usize = 64;

/// One recording.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Series {
    pub(super) experiment: String,
    /// Its place among the recordings.
    pub(super) recording: usize,
    pub(super) rate_hz: f64,
    pub(super) band_hz: f64,
    /// Time of the recording's first sample.
    pub(super) start_s: f64,
    pub(super) t_s: Vec<f64>,
    pub(super) position_m: Vec<f64>,
    pub(super) velocity_m_s: Vec<f64>,
    pub(super) accel_m_s2: Vec<f64>,
    pub(super) thrust_n: Vec<f64>,
    /// Thrust per ampere where a current is recorded, N/A.
    pub(super) thrust_n_a: Option<f64>,
}

/// Thrust in N from whichever reference is recorded.
pub(in crate::diagnosis) fn thrust(
    axis: &AxisModel,
    recording: &Recording,
) -> Result<Vec<f64>, DiagnoseError> {
    let name = |suffix: &str| format!("{}_{suffix}", axis.name);
    let scaled = |values: &[f64], factor: f64| values.iter().map(|v| v * factor).collect();
    if let Some(force) = recording.get(&name("thrust_ref_n")) {
        return Ok(force.to_vec());
    }
    if let Some(torque) = recording.get(&name("torque_ref_nm")) {
        return Ok(scaled(torque, 1.0 / axis.drive.travel_m_rad()));
    }
    if let Some(current) = recording.get(&name("current_ref_a")) {
        let k = axis.drive.thrust_constant_n_a();
        return Ok(scaled(
            current,
            k.ok_or_else(|| DiagnoseError::NoTorqueConstant { axis: axis.name.clone() })?,
        ));
    }
    let expected = name("current_ref_a, _torque_ref_nm or _thrust_ref_n");
    Err(DiagnoseError::MissingColumn { recording: recording.experiment.clone(), expected })
}

/// Thrust per ampere where the current is what is recorded.
fn thrust_per_ampere(axis: &AxisModel, recording: &Recording) -> Option<f64> {
    let other = ["thrust_ref_n", "torque_ref_nm"];
    let direct = other.iter().any(|s| recording.get(&format!("{}_{s}", axis.name)).is_some());
    if direct { None } else { axis.drive.thrust_constant_n_a() }
}

/// The encoder that the position is read from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Encoder {
    pub(super) delay_s: f64,
    pub(super) resolution_m: f64,
    /// Period of its signals, as travel.
    pub(super) signal_m: Option<f64>,
}

impl Encoder {
    /// The motor's where it is recorded, else the scale.
    pub(super) fn of(axis: &AxisModel, recording: &Recording) -> Self {
        let d = &axis.drive;
        if motor_position(axis, recording).is_some() || d.structure() == Structure::Rigid {
            let (delay_s, resolution_m) = (d.motor_encoder_delay_s(), d.motor_encoder_resolution_m());
            Self { delay_s, resolution_m, signal_m: d.motor_encoder_signal_m() }
        } else {
            let (delay_s, resolution_m) = (d.stage_encoder_delay_s(), d.stage_encoder_resolution_m());
            Self { delay_s, resolution_m, signal_m: d.raw().stage_encoder_signal_period_m }
        }
    }
}

/// Position in m from the motor encoder.
pub(in crate::diagnosis) fn motor_position(axis: &AxisModel, recording: &Recording) -> Option<Vec<f64>> {
    let name = |suffix: &str| format!("{}_{suffix}", axis.name);
    let travel = axis.drive.travel_m_rad();
    let angle = recording.get(&name("motor_angle_rad")).map(|a| a.iter().map(|v| v * travel).collect());
    angle.or_else(|| recording.get(&name("motor_position_m")).map(<[f64]>::to_vec))
}

/// Position in m from the motor encoder, else from the scale.
pub(in crate::diagnosis) fn position(
    axis: &AxisModel,
    recording: &Recording,
) -> Result<Vec<f64>, DiagnoseError> {
    let name = |suffix: &str| format!("{}_{suffix}", axis.name);
    let stage = || recording.get(&name("stage_position_m")).map(<[f64]>::to_vec);
    motor_position(axis, recording).or_else(stage).ok_or_else(|| {
        let expected = name("motor_angle_rad, _motor_position_m or _stage_position_m");
        DiagnoseError::MissingColumn { recording: recording.experiment.clone(), expected }
    })
}

/// Band in which the inertial force is known better than [`NOISE_SHARE`] of the thrust.
///
/// `q`: the encoder's step, or the one whose rounding would make the noise that the position shows. Steps
/// of q are white with density q^2/12 / (rate/2); the second derivative up to f has the variance
/// q^2/(6 rate) (2 pi)^4 f^5/5.
/// Checked by: tests::a_coarse_encoder_narrows_the_band.
fn band_hz(mass: f64, (thrust_rms_n, q): (f64, f64), rate_hz: f64) -> f64 {
    let widest = BAND_SHARE * rate_hz;
    if q <= 0.0 || mass <= 0.0 || thrust_rms_n <= 0.0 {
        return widest;
    }
    let accel = NOISE_SHARE * thrust_rms_n / mass;
    let fifth = accel * accel * 30.0 * rate_hz / (q * q * std::f64::consts::TAU.powi(4));
    fifth.powf(0.2).max(0.01 * rate_hz).min(widest)
}

/// Frequency at which the stage swings against a motor that is held, Hz; infinite on a rigid axis.
fn axial_resonance_hz(axis: &AxisModel) -> f64 {
    let (k, mass) = (axis.drive.axial_stiffness_n_m(), axis.drive.movable_mass_kg());
    if k > 0.0 { (k / mass).sqrt() / std::f64::consts::TAU } else { f64::INFINITY }
}

/// Filters and thins one recording; thrust and motion pass the same low-pass.
pub(super) fn series(
    axis: &AxisModel,
    (place, recording): (usize, &Recording),
) -> Result<Series, DiagnoseError> {
    let (force, x) = (thrust(axis, recording)?, position(axis, recording)?);
    let rate_hz = recording.sample_rate.hz();
    let encoder = Encoder::of(axis, recording);
    let step_m = encoder.resolution_m.max(rounding_m(&x, rate_hz));
    let mut band_hz = band_hz(axis.drive.total_mass_kg(), (rms(&force), step_m), rate_hz);
    if !is_locked(axis, recording) {
        band_hz = band_hz.min(RIGID_SHARE * axial_resonance_hz(axis));
    }
    let step = ((rate_hz / (ROWS_PER_BAND * band_hz)).floor() as usize).max(1);
    let (delay_s, loop_rad_s) =
        (thrust_delay_s(&axis.drive, rate_hz), axis.drive.current_loop_bandwidth_rad_s());
    let reference = Kernel::of_held_reference(band_hz, rate_hz, -delay_s, loop_rad_s);
    let advance_s = encoder.delay_s;
    let kernel = |derivative| Kernel::low_pass(band_hz, rate_hz, Action { derivative, advance_s });
    let kernels = [reference, kernel(0), kernel(1), kernel(2)];
    let edge = kernels.iter().map(Kernel::half).max().unwrap_or(0);
    let inside = x.len().saturating_sub(2 * edge);
    let needed = 2 * edge + LEAST_ROWS * step;
    if inside < LEAST_ROWS * step {
        return Err(DiagnoseError::TooShort {
            recording: recording.experiment.clone(),
            samples: x.len(),
            needed,
        });
    }
    let grid = Grid { first: edge, step, count: inside.div_ceil(step) };
    let origin = x[0];
    let local: Vec<f64> = x.iter().map(|v| v - origin).collect();
    Ok(Series {
        experiment: recording.experiment.clone(),
        recording: place,
        rate_hz: rate_hz / step as f64,
        band_hz,
        start_s: recording.start_s,
        t_s: (0..grid.count).map(|k| recording.time_s(edge + k * step)).collect(),
        thrust_n: kernels[0].apply(&force, grid),
        thrust_n_a: thrust_per_ampere(axis, recording),
        position_m: kernels[1].apply(&local, grid).iter().map(|v| v + origin).collect(),
        velocity_m_s: kernels[2].apply(&local, grid),
        accel_m_s2: kernels[3].apply(&local, grid),
    })
}

/// True where the output of a flexible axis is held: the motor turns, the stage stays where it is.
pub(in crate::diagnosis) fn is_locked(axis: &AxisModel, recording: &Recording) -> bool {
    let name = |suffix: &str| format!("{}_{suffix}", axis.name);
    let (Some(stage), Ok(motor)) = (recording.get(&name("stage_position_m")), position(axis, recording))
    else {
        return false;
    };
    let span = |v: &[f64]| {
        let [a, b] = v.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |e, x| [e[0].min(*x), e[1].max(*x)]);
        b - a
    };
    let step = axis.drive.stage_encoder_resolution_m().max(axis.drive.motor_encoder_resolution_m());
    span(stage) <= step && span(&motor) > 20.0 * step.max(f64::MIN_POSITIVE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coarse_encoder_narrows_the_band() {
        assert!((band_hz(100.0, (50.0, 1.0e-9), 1000.0) - 100.0).abs() < 1.0e-9);
        let band = band_hz(100.0, (50.0, 1.0e-5), 1000.0);
        // The variance that the formula promises, summed over the lines of a spectrum instead of integrated.
        let (density, step) = (1.0e-10 / 12.0 / 500.0, 0.01);
        let lines = (band / step) as usize;
        let variance: f64 =
            (1..=lines).map(|k| density * (std::f64::consts::TAU * k as f64 * step).powi(4) * step).sum();
        assert!((100.0 * variance.sqrt() / (0.02 * 50.0) - 1.0).abs() < 0.01);
    }
}
