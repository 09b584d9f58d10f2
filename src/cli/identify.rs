//! `stillcut identify`.

use super::bad_input;
use super::gated::read_told;
use crate::config::accelerometers::estimators_to_text;
use crate::config::machine::{machine_to_text, read_machine};
use crate::force::frf::{ACCEL_AXES, AccelSample};
use crate::force::motion::MotionSample;
use crate::force::recorded::{RecordedMotion, has_drive, motion_of_recording};
use crate::identify::frf::{FrfRun, FrfSettings, fit_frf};
use crate::identify::sweep::{StatedErrors, Sweep, SweepFit, fit_sweep};
use crate::plant::effects::{EffectKind, torsional_mode};
use crate::plant::machine::AxisModel;
use crate::recording::{read_recording, write_whole};
use crate::report::force_plots::response_svg;
use crate::sample::Recording;
use crate::units::Z95;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Finds mechanical parameters and dead times from a sweep, or makes the accelerometer estimator.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// sweep: parameters from a swept-sine recording; frf: estimator from runs with known force.
    #[arg(long, default_value = "sweep")]
    method: String,
    /// Model to start from (sweep).
    #[arg(long)]
    model: Option<PathBuf>,
    /// Recording; repeatable.
    #[arg(long, required = true)]
    recording: Vec<PathBuf>,
    /// How well the torque constant is known, per cent, one standard deviation (sweep).
    #[arg(long, default_value_t = 0.5)]
    torque_constant_error_percent: f64,
    /// How well the instants are known at which the drive takes its reference and its encoders, us, one
    /// standard deviation (sweep); without it a tenth of a sample.
    #[arg(long)]
    instant_error_us: Option<f64>,
    /// Where the result goes: a model (sweep) or an estimator (frf).
    #[arg(long)]
    out: PathBuf,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    match arguments.method.as_str() {
        "sweep" => run_sweep(&arguments),
        "frf" => run_frf(&arguments),
        other => Err(bad_input(format!("--method {other}: expected sweep or frf"))),
    }
}

/// What the sweeps gave, before anything is written.
#[derive(Default)]
struct Found {
    /// Comments above the model.
    remarks: String,
    /// What is printed.
    text: String,
    pictures: Vec<(PathBuf, String)>,
    /// Which recording each axis was fitted to.
    swept: Vec<(String, PathBuf)>,
    /// Why an axis keeps its prior.
    undetermined: Vec<String>,
}

/// One sweep for each axis that the model and a recording share.
fn run_sweep(arguments: &Arguments) -> anyhow::Result<()> {
    let Some(model) = &arguments.model else {
        return Err(bad_input("--method sweep needs --model, the drive to start from"));
    };
    let stated = stated_errors(arguments)?;
    let mut machine = read_machine(model).map_err(bad_input)?;
    let mut found = Found::default();
    for path in &arguments.recording {
        let axes: Vec<String> = machine.axes.iter().map(|a| a.name.clone()).collect();
        let recording = read_told(path, &axes, true)?;
        for axis in machine.axes.iter_mut().filter(|a| has_drive(&recording, &a.name)) {
            let fit = fit_axis(axis, (path, &recording), stated, &found)?;
            found.add(axis, (path, fit), &arguments.out)?;
        }
    }
    if found.swept.is_empty() {
        let names: Vec<&str> = machine.axes.iter().map(|a| a.name.as_str()).collect();
        return Err(bad_input(format!(
            "{}: no column <axis>_current_ref_a, <axis>_torque_ref_nm or <axis>_thrust_ref_n for the model's \
             axes {}",
            arguments.recording.iter().map(|p| p.display().to_string()).collect::<Vec<_>>().join(", "),
            names.join(", ")
        )));
    }
    if found.undetermined.len() == found.swept.len() {
        return Err(bad_input(found.undetermined.join("; ")));
    }
    let model = format!("{}{}", found.remarks, machine_to_text(&machine));
    // The model last: where it stands, its pictures stand beside it.
    for (path, svg) in found.pictures {
        write_whole(&path, svg.as_bytes()).map_err(bad_input)?;
    }
    write_whole(&arguments.out, model.as_bytes()).map_err(bad_input)?;
    write!(std::io::stdout(), "{}", found.text)?;
    Ok(())
}

/// Errors: a second sweep of the axis, a recording that cannot be fitted.
fn fit_axis(
    axis: &AxisModel,
    (path, recording): (&Path, &Recording),
    stated: StatedErrors,
    found: &Found,
) -> anyhow::Result<SweepFit> {
    let in_file = |e: String| bad_input(format!("{}: axis {}: {e}", path.display(), axis.name));
    if let Some((_, earlier)) = found.swept.iter().find(|(name, _)| *name == axis.name) {
        let earlier = earlier.display();
        return Err(in_file(format!("a second sweep beside {earlier}, expected one sweep for each axis")));
    }
    let motion =
        motion_of_recording(recording, &axis.name, &axis.drive).map_err(|e| in_file(e.to_string()))?;
    fit_sweep(&axis.drive, &sweep_of(recording, &motion), stated).map_err(|e| in_file(e.to_string()))
}

impl Found {
    /// Notes a fit and puts what it determines into the axis.
    fn add(
        &mut self,
        axis: &mut AxisModel,
        (path, fit): (&Path, SweepFit),
        out: &Path,
    ) -> anyhow::Result<()> {
        self.text.push_str(&describe(&axis.name, &fit));
        let picture = out.with_extension(format!("{}.svg", axis.name));
        self.pictures.push((picture, response_svg(&axis.name, &fit)?));
        for warning in &fit.warnings {
            self.remarks.push_str(&format!("# identify, axis {}: {warning}\n", axis.name));
        }
        self.swept.push((axis.name.clone(), path.to_owned()));
        if fit.determined {
            take(axis, fit);
            return Ok(());
        }
        self.remarks.push_str(&format!("# identify, axis {}: nothing determined, as it was\n", axis.name));
        self.undetermined.push(format!(
            "{}: axis {}: determines no parameter, expected a sweep that the model explains: {}",
            path.display(),
            axis.name,
            fit.warnings.join("; ")
        ));
        Ok(())
    }
}

fn stated_errors(arguments: &Arguments) -> anyhow::Result<StatedErrors> {
    let share = 0.01 * arguments.torque_constant_error_percent;
    if !(0.0..1.0).contains(&share) {
        return Err(bad_input(format!(
            "--torque-constant-error-percent {}: expected 0 to 100",
            arguments.torque_constant_error_percent
        )));
    }
    let instants_s = arguments.instant_error_us.map(|us| us * 1e-6);
    if let Some(us) = arguments.instant_error_us.filter(|us| !(us.is_finite() && *us >= 0.0)) {
        return Err(bad_input(format!("--instant-error-us {us}: expected 0 or more")));
    }
    Ok(StatedErrors { torque_constant: share, instants_s, ..StatedErrors::default() })
}

/// The drive of the axis, and its torsional mode as a term beside it.
fn take(axis: &mut AxisModel, fit: SweepFit) {
    axis.drive = fit.drive;
    if let Some(mode) = fit.mode {
        axis.physics.retain(|term| term.effect != EffectKind::TorsionalMode);
        axis.physics.push(torsional_mode::term([mode.frequency_hz, mode.screw_share, mode.damping_ratio]));
    }
}

fn sweep_of(recording: &Recording, motion: &RecordedMotion) -> Sweep {
    let column = |value: fn(&MotionSample) -> Option<f64>| motion.samples.iter().filter_map(value).collect();
    Sweep {
        rate: recording.sample_rate,
        thrust_ref_n: motion.samples.iter().map(|s| s.thrust_ref_n).collect(),
        motor_travel_m: column(|s| s.motor_travel_m),
        stage_position_m: column(|s| s.stage_position_m),
    }
}

fn describe(axis: &str, fit: &SweepFit) -> String {
    let mut text = format!("axis {axis}, {:.0} to {:.0} Hz\n", fit.band_hz[0], fit.band_hz[1]);
    text.push_str(&format!(
        "{:30} {:>13} {:>13}   {:28} {:>11} {:>11}\n",
        "parameter", "prior", "fitted", "95 % interval", "of noise", "as stated"
    ));
    for p in &fit.parameters {
        let interval = match p.ci95 {
            [low, high] if low.is_finite() => format!(
                "{:28} +-{:9.2e} +-{:9.2e}",
                format!("{low:.5e} .. {high:.5e}"),
                Z95 * p.noise,
                Z95 * p.stated
            ),
            _ if p.noise.is_infinite() => "not determined".to_owned(),
            _ => "from means".to_owned(),
        };
        text.push_str(&format!("{:30} {:13.5e} {:13.5e}   {interval}\n", p.name, p.prior, p.value));
    }
    if let Some(mode) = &fit.mode {
        text.push_str(&format!(
            "torsional mode {:.2} +- {:.2} Hz, share of the inertia behind it {:.4} +- {:.4} (noise, 95 %)\n",
            mode.frequency_hz,
            Z95 * mode.frequency_deviation_hz,
            mode.screw_share,
            Z95 * mode.share_deviation
        ));
    }
    for warning in &fit.warnings {
        text.push_str(&format!("warning: {warning}\n"));
    }
    text
}

fn run_frf(arguments: &Arguments) -> anyhow::Result<()> {
    let recordings = arguments
        .recording
        .iter()
        .map(|path| read_recording(path).map_err(bad_input))
        .collect::<Result<Vec<_>, _>>()?;
    let first = recordings.first().ok_or_else(|| bad_input("--recording: none given"))?;
    let axes: Vec<String> =
        first.columns.iter().filter_map(|c| c.name.strip_suffix("_force_n")).map(str::to_owned).collect();
    if axes.is_empty() {
        return Err(bad_input(format!("{}: no column <axis>_force_n", arguments.recording[0].display())));
    }
    let mut estimators = Vec::new();
    for axis in &axes {
        let mut runs = Vec::new();
        for (recording, path) in recordings.iter().zip(&arguments.recording) {
            let run = frf_run(recording, axis).map_err(|e| bad_input(format!("{}: {e}", path.display())))?;
            runs.push(run);
        }
        let fit = fit_frf(axis, &runs, &FrfSettings::default()).map_err(bad_input)?;
        writeln!(std::io::stdout(), "{axis}: {}", fit.describe())?;
        estimators.push(fit.estimator);
    }
    write_whole(&arguments.out, estimators_to_text(&estimators).as_bytes()).map_err(bad_input)
}

/// The accelerations of a recording in the order x, y, z.
pub(super) fn accelerations(recording: &Recording) -> Result<Vec<AccelSample>, String> {
    let mut columns = Vec::with_capacity(ACCEL_AXES);
    for axis in ["x", "y", "z"] {
        columns.push(recording.require(&format!("{axis}_accel_m_s2")).map_err(|e| e.to_string())?);
    }
    Ok((0..recording.len()).map(|i| [columns[0][i], columns[1][i], columns[2][i]]).collect())
}

fn frf_run(recording: &Recording, axis: &str) -> Result<FrfRun, String> {
    let speed = recording.require("spindle_speed_rpm").map_err(|e| e.to_string())?;
    let mean = speed.iter().sum::<f64>() / speed.len() as f64;
    if !(mean > 0.0) {
        return Err(format!("column spindle_speed_rpm has a mean of {mean}, expected a turning spindle"));
    }
    if let Some(row) = speed.iter().position(|s| (s - mean).abs() > 0.01 * mean) {
        return Err(format!(
            "column spindle_speed_rpm, row {row}: {} where the run's mean is {mean:.1}; a run has one speed",
            speed[row]
        ));
    }
    let force = recording.require(&format!("{axis}_force_n")).map_err(|e| e.to_string())?;
    Ok(FrfRun {
        rate: recording.sample_rate,
        speed_rpm: mean,
        accel: accelerations(recording)?,
        force_n: force.to_vec(),
    })
}
