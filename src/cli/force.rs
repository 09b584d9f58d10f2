//! `stillcut force`.

use super::bad_input;
use crate::config::machine::read_machine;
use crate::force::balance::Method;
use crate::force::estimator::{AxisSignals, ForceEstimator, ForceSettings, LowPass, MotionSample, Signals};
use crate::force::idle_map::{IdleMap, IdlePoint};
use crate::plant::drive::DriveParams;
use crate::recording::{Table, TableColumn, read_recording, write_table};
use crate::sample::Recording;
use anyhow::Context as _;
use std::path::PathBuf;

/// Estimates cutting force from servo signals or accelerometers.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Machine model; needed by every method but frf.
    #[arg(long)]
    model: Option<PathBuf>,
    /// Recording to work on.
    #[arg(long)]
    recording: PathBuf,
    /// thrust, dob, medob, rigid_mode, vibration_mode, fitted, spectral or frf.
    #[arg(long)]
    method: String,
    /// Where the estimate goes (Parquet).
    #[arg(long)]
    out: PathBuf,
    /// Air-cutting run of the same motion, whose disturbance is taken off by position; repeatable.
    #[arg(long)]
    idle: Vec<PathBuf>,
    /// Low-pass behind the balance: flat to here, same delay at every frequency.
    #[arg(long, default_value_t = 800.0)]
    pass_hz: f64,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let Some(method) = Method::from_name(&arguments.method) else {
        let known: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
        return Err(bad_input(format!(
            "--method {}: expected one of {}",
            arguments.method,
            known.join(", ")
        )));
    };
    let Some(model) = &arguments.model else {
        return Err(bad_input(format!("--method {} needs --model", method.name())));
    };
    let machine = read_machine(model).map_err(bad_input)?;
    let recording = read_recording(&arguments.recording).map_err(bad_input)?;
    let idles =
        arguments.idle.iter().map(|p| read_recording(p).map_err(bad_input)).collect::<Result<Vec<_>, _>>()?;

    let mut forces = Vec::new();
    let mut delay_s: f64 = 0.0;
    for axis in &machine.axes {
        if !has_drive(&recording, &axis.name) {
            continue;
        }
        let samples = motion_samples(&recording, &axis.name, &axis.drive)
            .map_err(|e| bad_input(format!("{}: {e}", arguments.recording.display())))?;
        let signals =
            AxisSignals { drive: &axis.drive, rate: recording.sample_rate, signals: samples.signals };
        let pass_hz = arguments.pass_hz.min(0.2 * recording.sample_rate.hz());
        let low_pass = LowPass::LinearPhase { pass_hz, width_hz: pass_hz / 2.0 };
        let mut settings = ForceSettings { low_pass, ..ForceSettings::default() };
        if !idles.is_empty() {
            let bare =
                ForceEstimator::new(method, &signals, ForceSettings { low_pass, ..ForceSettings::default() })
                    .map_err(bad_input)?;
            settings.idle_map = idle_map(&bare, &axis.name, &axis.drive, &idles)?;
        }
        let estimator = ForceEstimator::new(method, &signals, settings).map_err(bad_input)?;
        delay_s = estimator.delay_s();
        forces.push((format!("{}_force_n", axis.name), estimate(&estimator, &samples.samples)));
    }
    if forces.is_empty() {
        let names: Vec<&str> = machine.axes.iter().map(|a| a.name.as_str()).collect();
        return Err(bad_input(format!(
            "{}: no drive signal of the model's axes {}",
            arguments.recording.display(),
            names.join(", ")
        )));
    }
    let times: Vec<f64> = (0..recording.len()).map(|i| recording.time_s(i)).collect();
    let mut columns = vec![("t_s", TableColumn::Double(&times))];
    columns.extend(forces.iter().map(|(name, values)| (name.as_str(), TableColumn::Double(values))));
    let metadata = vec![
        ("format".to_owned(), crate::recording::FORMAT.to_owned()),
        ("sample_rate_hz".to_owned(), format!("{:?}", recording.sample_rate.hz())),
        ("experiment".to_owned(), recording.experiment.clone()),
        ("method".to_owned(), method.name().to_owned()),
        ("delay_s".to_owned(), format!("{delay_s:?}")),
    ];
    write_table(&arguments.out, &Table { columns, metadata }).context("writing the estimate")?;
    Ok(())
}

struct AxisSamples {
    samples: Vec<MotionSample>,
    signals: Signals,
}

fn has_drive(recording: &Recording, axis: &str) -> bool {
    ["current_ref_a", "torque_ref_nm", "thrust_ref_n"]
        .iter()
        .any(|s| recording.get(&format!("{axis}_{s}")).is_some())
}

/// The samples of one axis, whichever of the contract's columns carry them.
fn motion_samples(recording: &Recording, axis: &str, drive: &DriveParams) -> Result<AxisSamples, String> {
    let column = |suffix: &str| recording.get(&format!("{axis}_{suffix}"));
    let (reference, factor) = if let Some(thrust) = column("thrust_ref_n") {
        (thrust, 1.0)
    } else if let Some(torque) = column("torque_ref_nm") {
        (torque, 1.0 / drive.travel_m_rad())
    } else if let Some(current) = column("current_ref_a") {
        let factor = drive
            .thrust_constant_n_a()
            .ok_or_else(|| format!("column {axis}_current_ref_a needs torque_constant_nm_a in the model"))?;
        (current, factor)
    } else {
        return Err(format!("no column {axis}_current_ref_a, {axis}_torque_ref_nm or {axis}_thrust_ref_n"));
    };
    let (motor, motor_factor) = match column("motor_position_m") {
        Some(position) => (Some(position), 1.0),
        None => (column("motor_angle_rad"), drive.travel_m_rad()),
    };
    let stage = column("stage_position_m");
    let signals = match (motor.is_some(), stage.is_some()) {
        (true, true) => Signals::Both,
        (true, false) => Signals::MotorOnly,
        (false, true) => Signals::StageOnly,
        (false, false) => return Err(format!("no position of axis {axis}: motor angle or stage position")),
    };
    let samples = (0..recording.len())
        .map(|i| MotionSample {
            thrust_ref_n: factor * reference[i],
            motor_travel_m: motor.map(|m| motor_factor * m[i]),
            stage_position_m: stage.map(|s| s[i]),
        })
        .collect();
    Ok(AxisSamples { samples, signals })
}

fn estimate(estimator: &ForceEstimator, samples: &[MotionSample]) -> Vec<f64> {
    let Some(first) = samples.first() else { return Vec::new() };
    let mut state = estimator.settled(first);
    samples.iter().map(|s| estimator.step(&mut state, s).force_n).collect()
}

/// Idle runs through the same estimator; each force is put where the axis was `delay_s` ago.
fn idle_map(
    bare: &ForceEstimator,
    axis: &str,
    drive: &DriveParams,
    idles: &[Recording],
) -> anyhow::Result<Option<IdleMap>> {
    let mut runs = Vec::new();
    for idle in idles {
        let samples = motion_samples(idle, axis, drive)
            .map_err(|e| bad_input(format!("idle run {}: {e}", idle.experiment)))?;
        runs.push(idle_points(bare, &samples.samples));
    }
    Ok(IdleMap::from_runs(&runs))
}

fn idle_points(bare: &ForceEstimator, samples: &[MotionSample]) -> Vec<IdlePoint> {
    let Some(first) = samples.first() else { return Vec::new() };
    let mut state = bare.settled(first);
    let mut motion_state = bare.settled(first);
    let mut motions = Vec::with_capacity(samples.len());
    let mut forces = Vec::with_capacity(samples.len());
    for sample in samples {
        motions.push(bare.balance_step(&mut motion_state, sample).1);
        forces.push(bare.step(&mut state, sample).force_n);
    }
    let late = bare.filter_delay_samples();
    let skip = bare.settling_samples();
    (skip..forces.len().saturating_sub(late))
        .map(|i| IdlePoint {
            position_m: motions[i].position_m,
            velocity_m_s: motions[i].stage_velocity_m_s,
            force_n: forces[i + late],
        })
        .collect()
}
