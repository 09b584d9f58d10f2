//! `stillcut force`.

use super::bad_input;
use crate::config::machine::read_machine;
use crate::force::balance::Method;
use crate::force::estimator::{
    AxisSignals, ForceEstimate, ForceEstimator, ForceSettings, LowPass, NotchCentre, NotchPlan,
};
use crate::force::frf::force_of_recording;
use crate::force::harmonic::HarmonicSettings;
use crate::force::offline::{
    estimate_run, idle_map, standing_zero_n, stiffness_of_runs, with_axial_stiffness,
};
use crate::force::physics::physics_of;
use crate::force::recorded::{has_drive, motion_of_recording};
use crate::force::stiffness::StiffnessCheck;
use crate::force::validity::Validity;
use crate::plant::machine::AxisModel;
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
    /// A second method beside the first: how far they disagree goes into the metadata.
    #[arg(long)]
    beside: Option<String>,
    /// Notch at a frequency in Hz, or following motor_encoder or stage_encoder; repeatable.
    #[arg(long)]
    notch: Vec<String>,
    /// Keeps the model's axial stiffness although the recording shows another (vibration_mode).
    #[arg(long)]
    keep_stiffness: bool,
    /// Length of the window in turns of the spindle (fitted, spectral).
    #[arg(long)]
    turns: Option<f64>,
    /// Number of harmonics (fitted, spectral); as many as lie below 500 Hz when not given.
    #[arg(long)]
    harmonics: Option<usize>,
    /// Teeth of the tool: only multiples of the tooth-pass frequency are taken (fitted, spectral).
    #[arg(long)]
    teeth: Option<f64>,
    /// Low-pass behind the balance: flat to here, same delay at every frequency.
    #[arg(long, default_value_t = 800.0)]
    pass_hz: f64,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if arguments.method == "frf" {
        return run_frf(&arguments);
    }
    let method = method_named("--method", &arguments.method)?;
    let beside = arguments.beside.as_deref().map(|name| method_named("--beside", name)).transpose()?;
    let Some(model) = &arguments.model else {
        return Err(bad_input(format!("--method {} needs --model", method.name())));
    };
    let machine = read_machine(model).map_err(bad_input)?;
    let recording = read_recording(&arguments.recording).map_err(bad_input)?;
    let idles =
        arguments.idle.iter().map(|p| read_recording(p).map_err(bad_input)).collect::<Result<Vec<_>, _>>()?;

    let mut axes = Vec::new();
    for axis in machine.axes.iter().filter(|a| has_drive(&recording, &a.name)) {
        let mut force = axis_force(&arguments, method, axis, (&recording, &idles))?;
        if let Some(beside) = beside {
            let other = axis_force(&arguments, beside, axis, (&recording, &idles))?;
            let apart_n = disagreement_n(&force, &other, recording.sample_rate.hz());
            let text = format!("{apart_n:.4} N against {}", beside.name());
            force.notes.push((format!("{}_disagreement", axis.name), text));
        }
        axes.push(force);
    }
    if axes.is_empty() {
        let names: Vec<&str> = machine.axes.iter().map(|a| a.name.as_str()).collect();
        return Err(bad_input(format!(
            "{}: no drive signal of the model's axes {}",
            arguments.recording.display(),
            names.join(", ")
        )));
    }
    let mut notes = vec![("method".to_owned(), method.name().to_owned())];
    let rate_hz = recording.sample_rate.hz();
    // One delay for the file: what is early waits for what is late.
    let delay_s = axes.iter().map(|a| a.delay_s).fold(0.0, f64::max);
    let mut forces = Vec::new();
    for axis in axes {
        let wait = ((delay_s - axis.delay_s) * rate_hz).round() as usize;
        let mut column = vec![axis.force_n.first().copied().unwrap_or(0.0); wait.min(axis.force_n.len())];
        column.extend_from_slice(&axis.force_n[..axis.force_n.len() - column.len()]);
        forces.push((format!("{}_force_n", axis.name), column));
        notes.extend(axis.notes);
    }
    write_forces(&arguments.out, &recording, &Forces { forces, delay_s, notes })
}

fn method_named(option: &str, name: &str) -> anyhow::Result<Method> {
    Method::from_name(name).ok_or_else(|| {
        let known: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
        bad_input(format!("{option} {name}: expected one of {}, frf", known.join(", ")))
    })
}

/// Root mean square distance of two estimates of one force, each taken at its own lag, N.
fn disagreement_n(a: &AxisForce, b: &AxisForce, rate_hz: f64) -> f64 {
    let lag = |x: &AxisForce| (x.delay_s * rate_hz).round() as usize;
    let pairs = a.force_n.iter().skip(lag(a)).zip(b.force_n.iter().skip(lag(b)));
    let (sum, count) = pairs.fold((0.0, 0.0f64), |(sum, count), (x, y)| (sum + (x - y).powi(2), count + 1.0));
    (sum / count.max(1.0)).sqrt()
}

/// Estimate of one axis.
struct AxisForce {
    name: String,
    force_n: Vec<f64>,
    delay_s: f64,
    notes: Vec<(String, String)>,
}

/// One axis through one method; `runs`: the recording and the idle runs.
fn axis_force(
    arguments: &Arguments,
    method: Method,
    axis: &AxisModel,
    runs: (&Recording, &[Recording]),
) -> anyhow::Result<AxisForce> {
    let (recording, idles) = runs;
    let motion = motion_of_recording(recording, &axis.name, &axis.drive)
        .map_err(|e| bad_input(format!("{}: {e}", arguments.recording.display())))?;
    let mut idle_runs = Vec::new();
    for (idle, path) in idles.iter().zip(&arguments.idle) {
        let run = motion_of_recording(idle, &axis.name, &axis.drive)
            .map_err(|e| bad_input(format!("{}: {e}", path.display())))?;
        idle_runs.push(run.samples);
    }
    let mut notes = Vec::new();
    let mut note = |key: &str, value: String| notes.push((format!("{}_{key}", axis.name), value));
    let rate = recording.sample_rate;
    let (physics, mut drive) = physics_of(&axis.physics, &axis.drive);
    for effect in &physics.not_applied {
        note(
            &format!("not_taken_off_{effect}"),
            "the model states it, its force cannot be computed here".to_owned(),
        );
    }
    if method == Method::VibrationMode && !arguments.keep_stiffness {
        let signals = AxisSignals { drive: &drive, rate, signals: motion.signals };
        let check = stiffness_of_runs(&signals, &motion.samples, &idle_runs).map_err(bad_input)?;
        if let Some(check) = check.filter(StiffnessCheck::is_conclusive) {
            let stiffness_n_m = check.ratio * drive.axial_stiffness_n_m();
            note("axial_stiffness_n_m", format!("{stiffness_n_m:.6e}"));
            note("stiffness_over_model", format!("{:.4}", check.ratio));
            drive = with_axial_stiffness(&drive, stiffness_n_m).map_err(bad_input)?;
        }
    }
    let signals = AxisSignals { drive: &drive, rate, signals: motion.signals };
    let pass_hz = arguments.pass_hz.min(0.2 * rate.hz());
    let low_pass = LowPass::LinearPhase { pass_hz, width_hz: pass_hz / 2.0 };
    let mut settings = ForceSettings {
        low_pass,
        controller: axis.controller,
        notches: notches(&arguments.notch)?,
        presliding_travel_m: physics.presliding_travel_m(),
        unmodelled_modes_hz: physics.modes_hz.clone(),
        physics: Some(physics).filter(|_| method != Method::Thrust),
        ..ForceSettings::default()
    };
    if matches!(method, Method::Fitted | Method::Spectral) {
        settings.harmonic = Some(harmonic_settings(arguments, recording)?);
    }
    if !idle_runs.is_empty() {
        let bare = ForceEstimator::new(method, &signals, settings.clone()).map_err(bad_input)?;
        settings.idle_map = idle_map(&bare, &idle_runs);
    }
    let estimator = ForceEstimator::new(method, &signals, settings).map_err(bad_input)?;
    let estimates = estimate_run(&estimator, &motion.samples);
    let mut force_n: Vec<f64> = estimates.iter().map(|e| e.force_n).collect();
    let travel: Vec<f64> =
        motion.samples.iter().filter_map(|s| s.stage_position_m.or(s.motor_travel_m)).collect();
    let part = (0.3 * rate.hz()) as usize;
    let start = estimator.settling_samples().min(force_n.len());
    let zero_n = standing_zero_n(&force_n[start..], &travel, estimator.friction_bound_n(), part);
    if let Some(zero_n) = zero_n.filter(|_| method != Method::Spectral && method != Method::Thrust) {
        note("zero_n", format!("{zero_n:.4}"));
        force_n.iter_mut().for_each(|f| *f -= zero_n);
    }
    describe(&estimator, &estimates, &mut note);
    Ok(AxisForce { name: axis.name.clone(), force_n, delay_s: estimator.delay_s(), notes })
}

/// What the estimator says of itself, for the file's metadata.
fn describe(estimator: &ForceEstimator, estimates: &[ForceEstimate], note: &mut impl FnMut(&str, String)) {
    note("usable_band_hz", format!("{:?}", estimator.usable_band_hz()));
    note("noise_floor_n", format!("{:.4}", estimator.noise_floor_n()));
    if let Some(condition) = estimator.condition() {
        note("condition", format!("{condition:.3e}"));
    }
    let mut seen = Validity::VALID;
    for flag in estimates.iter().map(|e| e.flags) {
        seen |= flag;
    }
    for name in seen.names() {
        let count = estimates.iter().filter(|e| e.flags.names().any(|n| n == name)).count();
        note(&format!("flag_{name}_share"), format!("{:.4}", count as f64 / estimates.len().max(1) as f64));
    }
    if seen.contains(Validity::BELOW_FRICTION) {
        note("below_friction", format!("not observable, bound {:.0} N", estimator.friction_bound_n()));
    }
}

fn notches(names: &[String]) -> anyhow::Result<Vec<NotchPlan>> {
    const WIDTH_HZ: f64 = 10.0;
    names
        .iter()
        .map(|name| {
            let centre = match name.as_str() {
                "motor_encoder" => NotchCentre::MotorEncoder,
                "stage_encoder" => NotchCentre::StageEncoder,
                number => NotchCentre::Fixed {
                    hz: number.parse().map_err(|_| {
                        bad_input(format!(
                            "--notch {number}: expected motor_encoder, stage_encoder or a frequency in Hz"
                        ))
                    })?,
                },
            };
            Ok(NotchPlan { centre, width_hz: WIDTH_HZ })
        })
        .collect()
}

/// Spindle speed of a recording: one for all of it, else the harmonics have no place.
fn harmonic_settings(arguments: &Arguments, recording: &Recording) -> anyhow::Result<HarmonicSettings> {
    let in_file = |e: String| bad_input(format!("{}: {e}", arguments.recording.display()));
    let speed = recording.require("spindle_speed_rpm").map_err(|e| in_file(e.to_string()))?;
    let mut sorted = speed.to_vec();
    sorted.sort_by(f64::total_cmp);
    let median = sorted[sorted.len() / 2];
    if !(median > 0.0) {
        return Err(in_file(format!(
            "column spindle_speed_rpm has a median of {median}, expected a turning spindle"
        )));
    }
    let default = HarmonicSettings::at_speed(median);
    Ok(HarmonicSettings {
        turns: arguments.turns.unwrap_or(default.turns),
        harmonics: arguments.harmonics,
        lines_per_turn: arguments.teeth.unwrap_or(default.lines_per_turn),
        ..default
    })
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
