//! `stillcut force`.

use super::bad_input;
use crate::config::machine::read_machine;
use crate::force::balance::Method;
use crate::force::estimator::{AxisSignals, ForceEstimator, ForceSettings, LowPass, MotionSample};
use crate::force::frf::force_of_recording;
use crate::force::idle_map::{IdleMap, IdlePoint};
use crate::force::recorded::{has_drive, motion_of_recording};
use crate::force::validity::Validity;
use crate::plant::drive::DriveParams;
use crate::recording::{Table, TableColumn, read_recording, write_table};
use crate::report::force_estimator::read_estimators;
use crate::sample::Recording;
use anyhow::Context as _;
use std::path::{Path, PathBuf};

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
    /// Accelerometer estimator (method frf), as `identify --method frf` writes it.
    #[arg(long)]
    estimator: Option<PathBuf>,
    /// Air-cutting run of the same motion, whose disturbance is taken off by position; repeatable.
    #[arg(long)]
    idle: Vec<PathBuf>,
    /// Low-pass behind the balance: flat to here, same delay at every frequency.
    #[arg(long, default_value_t = 800.0)]
    pass_hz: f64,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if arguments.method == "frf" {
        return run_frf(&arguments);
    }
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
        let samples = motion_of_recording(&recording, &axis.name, &axis.drive)
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
    let notes = vec![("method".to_owned(), method.name().to_owned())];
    write_forces(&arguments.out, &recording, &Forces { forces, delay_s, notes })
}

/// What the command writes.
struct Forces {
    /// Column name and values.
    forces: Vec<(String, Vec<f64>)>,
    delay_s: f64,
    /// Further metadata.
    notes: Vec<(String, String)>,
}

fn write_forces(out: &Path, recording: &Recording, forces: &Forces) -> anyhow::Result<()> {
    let times: Vec<f64> = (0..recording.len()).map(|i| recording.time_s(i)).collect();
    let mut columns = vec![("t_s", TableColumn::Double(&times))];
    columns.extend(forces.forces.iter().map(|(name, values)| (name.as_str(), TableColumn::Double(values))));
    let axes: Vec<&str> =
        forces.forces.iter().filter_map(|(name, _)| name.strip_suffix("_force_n")).collect();
    let mut metadata = vec![
        ("format".to_owned(), crate::recording::FORMAT.to_owned()),
        ("sample_rate_hz".to_owned(), format!("{:?}", recording.sample_rate.hz())),
        ("experiment".to_owned(), recording.experiment.clone()),
        ("axes".to_owned(), axes.join(",")),
        ("delay_s".to_owned(), format!("{:?}", forces.delay_s)),
    ];
    metadata.extend(forces.notes.iter().cloned());
    write_table(out, &Table { columns, metadata }).context("writing the estimate")
}

/// Force from accelerometers. The file is filtered as a stream, then shifted back by the stream's lag.
fn run_frf(arguments: &Arguments) -> anyhow::Result<()> {
    let Some(path) = &arguments.estimator else {
        return Err(bad_input("--method frf needs --estimator"));
    };
    let estimators = read_estimators(path).map_err(bad_input)?;
    let recording = read_recording(&arguments.recording).map_err(bad_input)?;
    let in_file = |e: String| bad_input(format!("{}: {e}", arguments.recording.display()));
    let accel = super::identify::accelerations(&recording).map_err(in_file)?;
    let speed = recording.require("spindle_speed_rpm").map_err(|e| in_file(e.to_string()))?;
    let mut forces = Vec::new();
    let mut notes = vec![("method".to_owned(), "frf".to_owned())];
    for estimator in &estimators {
        let force = force_of_recording(estimator, recording.sample_rate, &accel, speed).map_err(bad_input)?;
        let flags = speed.iter().fold(Validity::VALID, |all, s| all | estimator.flags(*s));
        notes.push((format!("{}_flags", estimator.axis), flags.to_string()));
        notes.push((format!("{}_noise_floor_n", estimator.axis), format!("{:.4}", estimator.noise_floor_n)));
        notes.push((format!("{}_usable_band_hz", estimator.axis), format!("{:?}", estimator.band_hz())));
        forces.push((format!("{}_force_n", estimator.axis), force));
    }
    write_forces(&arguments.out, &recording, &Forces { forces, delay_s: 0.0, notes })
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
        let samples = motion_of_recording(idle, axis, drive)
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
