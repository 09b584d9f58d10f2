//! `stillcut force`.

mod report;

use self::report::{Forces, describe, say_what_is_doubtful, say_what_is_hidden, write_forces};
use super::bad_input;
use super::gated::read_told;
use crate::config::accelerometers::read_estimators;
use crate::config::force::FRF;
use crate::config::machine::read_machine;
use crate::force::balance::Method;
use crate::force::disagreement::Disagreement;
use crate::force::frf::{AccelSample, FrfEstimator};
use crate::force::frf_stream::force_of_recording;
use crate::force::harmonic_settings::Reading;
use crate::force::idle_map::IdleMap;
use crate::force::motion::{ForceEstimate, MotionSample};
use crate::force::observer::Observer;
use crate::force::offline::{standing_zero_n, stiffness_of_runs};
use crate::force::physics::physics_of;
use crate::force::plan::{ForcePlan, ServoPlan};
use crate::force::recorded::{RecordedMotion, has_drive, motion_of_recording};
use crate::force::settings::{LowPass, NotchCentre};
use crate::force::signals::AxisSignals;
use crate::force::stiffness::StiffnessCheck;
use crate::force::two_sides::Mismatch;
use crate::force::validity::{Properties, Validity};
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
use crate::units::SampleRate;
use std::io::Write as _;
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
    /// thrust, dob, medob, rigid_mode, vibration_mode, second_vibration_mode, fitted, spectral or frf.
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
    /// A second method beside the first (frf too): how far they disagree goes into the metadata.
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
    /// Where a window is read: middle (least noise; when not given) or young (three samples from its young
    /// end: shortest delay) (fitted, spectral).
    #[arg(long, value_parser = ["middle", "young"])]
    reading: Option<String>,
    /// Low-pass behind the balance: flat to here, same delay at every frequency.
    #[arg(long, default_value_t = 800.0)]
    pass_hz: f64,
    /// Fourth-order Butterworth low-pass at this frequency instead, as in the live pipeline.
    #[arg(long)]
    cutoff_hz: Option<f64>,
    /// Above this the drive side is not listened to, as in the live pipeline.
    #[arg(long)]
    motor_cutoff_hz: Option<f64>,
    /// Only what the live pipeline can do: nothing that needs the whole recording (axial stiffness, zero of
    /// a standing axis, median spindle speed, ends of frf).
    #[arg(long)]
    live: bool,
}

/// A method of servo signals, or `None` for accelerometers.
type Choice = Option<Method>;

/// What the command works on.
struct Inputs {
    arguments: Arguments,
    machine: Option<Machine>,
    estimators: Vec<FrfEstimator>,
    recording: Recording,
    idles: Vec<Recording>,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let choice = method_named("--method", &arguments.method)?;
    let beside = arguments.beside.as_deref().map(|name| method_named("--beside", name)).transpose()?;
    refuse_window_options(&arguments, [Some(choice), beside])?;
    let inputs = Inputs::read(arguments, [Some(choice), beside])?;
    let rate_hz = inputs.recording.sample_rate.hz();
    let mut axes = Vec::new();
    for name in inputs.axes(choice)? {
        let mut force = inputs.force(choice, &name)?;
        if let Some(beside) = beside {
            let second = inputs.force(beside, &name)?;
            mark_disagreement(&mut force, &second, inputs.recording.sample_rate);
            let apart_n = disagreement_n(&force, &second, rate_hz);
            let other = beside.map_or(FRF, Method::name);
            force.notes.push((format!("{name}_disagreement"), format!("{apart_n:.4} N against {other}")));
        }
        axes.push(force);
    }
    let mut notes = vec![("method".to_owned(), choice.map_or(FRF, Method::name).to_owned())];
    // One delay for the file: what is early waits for what is late.
    let delay_s = axes.iter().map(|a| a.delay_s).fold(0.0, f64::max);
    let (mut forces, mut flags) = (Vec::new(), Vec::new());
    for axis in axes {
        let wait = ((delay_s - axis.delay_s) * rate_hz).round() as usize;
        let mut column = vec![axis.force_n.first().copied().unwrap_or(0.0); wait.min(axis.force_n.len())];
        column.extend_from_slice(&axis.force_n[..axis.force_n.len() - column.len()]);
        forces.push((format!("{}_force_n", axis.name), column));
        if let Some(first) = axis.flags.first() {
            let early = std::iter::repeat_n(first, wait.min(axis.flags.len()));
            let rows = early.chain(&axis.flags).take(axis.flags.len());
            let column = rows.map(|flags| i64::from(flags.bits())).collect();
            flags.push((format!("{}_force_flags", axis.name), column));
        }
        notes.extend(axis.notes);
    }
    write_forces(&inputs.arguments.out, &inputs.recording, &Forces { forces, flags, delay_s, notes })
}

/// Options of the windows say nothing where no method has one.
fn refuse_window_options(arguments: &Arguments, choices: [Option<Choice>; 2]) -> anyhow::Result<()> {
    let windowed = |c: &Option<Choice>| matches!(c, Some(Some(Method::Fitted | Method::Spectral)));
    if choices.iter().any(windowed) {
        return Ok(());
    }
    let given = [
        ("--turns", arguments.turns.is_some()),
        ("--harmonics", arguments.harmonics.is_some()),
        ("--teeth", arguments.teeth.is_some()),
        ("--reading", arguments.reading.is_some()),
    ];
    match given.iter().find(|(_, given)| *given) {
        Some((option, _)) => Err(bad_input(format!("{option}: expected with --method fitted or spectral"))),
        None => Ok(()),
    }
}

fn method_named(option: &str, name: &str) -> anyhow::Result<Choice> {
    if name == FRF {
        return Ok(None);
    }
    Method::from_name(name).map(Some).ok_or_else(|| {
        let known: Vec<&str> = Method::ALL.iter().map(|m| m.name()).collect();
        bad_input(format!("{option} {name}: expected one of {}, {FRF}", known.join(", ")))
    })
}

/// Standard deviation of the difference of two estimates of one force, each taken at its own lag, where both
/// are, N.
fn disagreement_n(a: &AxisForce, b: &AxisForce, rate_hz: f64) -> f64 {
    let from = |x: &AxisForce| x.settled + (x.delay_s * rate_hz).round() as usize;
    let start = a.settled.max(b.settled);
    let pairs = || {
        let skip = |x: &AxisForce| from(x) + start - x.settled;
        let pairs = a.force_n.iter().skip(skip(a)).zip(b.force_n.iter().skip(skip(b)));
        pairs.map(|(x, y)| x - y).filter(|d| d.is_finite())
    };
    let count = pairs().count().max(1) as f64;
    let mean = pairs().sum::<f64>() / count;
    (pairs().map(|d| (d - mean).powi(2)).sum::<f64>() / count).sqrt()
}

/// Flags the rows in which two estimates of one force disagree, as the pipeline does.
fn mark_disagreement(first: &mut AxisForce, second: &AxisForce, rate: SampleRate) {
    let stated = |of: &AxisForce| Properties {
        delay_s: of.delay_s,
        noise_floor_n: of.noise_floor_n,
        ..Properties::default()
    };
    let mut disagreement = Disagreement::new([stated(first), stated(second)], rate);
    let (mut seen, mut count) = (Validity::VALID, 0.0);
    for i in 0..first.flags.len().min(second.force_n.len()) {
        let apart = disagreement.step(first.estimate(i), second.estimate(i));
        first.flags[i] |= apart;
        seen |= first.flags[i];
        count += if apart.is_valid() { 0.0 } else { 1.0 };
    }
    if count > 0.0 {
        let name = first.name.clone();
        let share = format!("{:.4}", count / first.flags.len() as f64);
        first.notes.push((format!("{name}_flag_estimators_disagree_share"), share));
        let key = format!("{name}_flags");
        first.notes.iter_mut().filter(|(k, _)| *k == key).for_each(|(_, v)| *v = seen.to_string());
    }
}

/// Estimate of one axis.
struct AxisForce {
    name: String,
    force_n: Vec<f64>,
    /// Of each row, for the instant of its estimate.
    flags: Vec<Validity>,
    noise_floor_n: f64,
    delay_s: f64,
    /// Samples that the filters need at the start.
    settled: usize,
    notes: Vec<(String, String)>,
}

impl AxisForce {
    /// A row; one without a number counts as missing.
    fn estimate(&self, row: usize) -> ForceEstimate {
        let stated = self.flags.get(row).copied().unwrap_or(Validity::VALID);
        let force_n = self.force_n[row];
        if force_n.is_finite() {
            return ForceEstimate { force_n, flags: stated };
        }
        ForceEstimate { force_n: 0.0, flags: stated | Validity::SIGNAL_MISSING }
    }
}

impl Inputs {
    fn read(arguments: Arguments, choices: [Option<Choice>; 2]) -> anyhow::Result<Self> {
        let (mut machine, mut estimators) = (None, Vec::new());
        for choice in choices.into_iter().flatten() {
            match choice {
                Some(method) => {
                    let missing = || bad_input(format!("--method {} needs --model", method.name()));
                    let path = arguments.model.as_ref().ok_or_else(missing)?;
                    machine = Some(read_machine(path).map_err(bad_input)?);
                }
                None => {
                    let missing = || bad_input(format!("--method {FRF} needs --estimator"));
                    let path = arguments.estimator.as_ref().ok_or_else(missing)?;
                    estimators = read_estimators(path).map_err(bad_input)?;
                }
            }
        }
        let axes: Vec<String> =
            machine.iter().flat_map(|m: &Machine| &m.axes).map(|a| a.name.clone()).collect();
        // What the live pipeline is given nobody has mended.
        let mended = !arguments.live;
        let read = |path: &PathBuf| read_told(path, &axes, mended);
        let idles = arguments.idle.iter().map(read).collect::<Result<_, _>>()?;
        let recording = read(&arguments.recording)?;
        Ok(Self { machine, estimators, recording, idles, arguments })
    }

    fn in_file(&self, error: impl std::fmt::Display) -> anyhow::Error {
        bad_input(format!("{}: {error}", self.arguments.recording.display()))
    }

    /// Axes that the method can estimate. Errors: none.
    fn axes(&self, choice: Choice) -> anyhow::Result<Vec<String>> {
        if choice.is_none() {
            return Ok(self.estimators.iter().map(|e| e.axis.clone()).collect());
        }
        let known = self.machine.iter().flat_map(|m| &m.axes).map(|a| a.name.clone());
        let (driven, others): (Vec<String>, Vec<String>) = known.partition(|a| has_drive(&self.recording, a));
        if driven.is_empty() {
            let columns = "<axis>_current_ref_a, <axis>_torque_ref_nm or <axis>_thrust_ref_n";
            let what = format!("no column {columns} for the model's axes {}", others.join(", "));
            return Err(self.in_file(what));
        }
        Ok(driven)
    }

    fn force(&self, choice: Choice, name: &str) -> anyhow::Result<AxisForce> {
        match choice {
            Some(method) => self.servo_force(method, name),
            None => self.accelerometer_force(name),
        }
    }

    /// One axis through one method of servo signals.
    fn servo_force(&self, method: Method, name: &str) -> anyhow::Result<AxisForce> {
        let axis = self.machine.as_ref().and_then(|m| m.axis(name));
        let axis = axis.ok_or_else(|| bad_input(format!("--model: no axis {name}")))?;
        let motion = motion_of_recording(&self.recording, name, &axis.drive).map_err(|e| self.in_file(e))?;
        let mut notes = Vec::new();
        let mut note = |key: &str, value: String| notes.push((format!("{name}_{key}"), value));
        for effect in &physics_of(&axis.physics, &axis.drive).0.not_applied {
            let what = "the model states it, its force cannot be computed here";
            note(&format!("not_taken_off_{effect}"), what.to_owned());
        }
        let plan = self.plan(method, (axis, &motion), &mut note)?;
        let rate = self.recording.sample_rate;
        let mut observer = Observer::new(&ForcePlan::Servo(plan), rate).map_err(|e| self.of_axis(name, e))?;
        let mut estimates = Vec::with_capacity(motion.samples.len());
        let mut lags = Vec::with_capacity(motion.samples.len());
        let mut mismatch = Mismatch::default();
        for sample in &motion.samples {
            estimates.push(observer.step(sample));
            // Where the force is largest it says most.
            mismatch = observer.mismatch().filter(|m| m.force_n > mismatch.force_n).unwrap_or(mismatch);
            lags.push((observer.properties().delay_s * rate.hz()).round() as usize);
        }
        let lag = if self.arguments.live { 0 } else { wait_for_latest(&mut estimates, &lags) };
        let mut force_n: Vec<f64> = estimates.iter().map(|e| e.force_n).collect();
        let delay_s = observer.properties().delay_s.max(lag as f64 * rate.period_s());
        if force_n.len() <= observer.properties().settling_samples {
            let (is, least) = (force_n.len(), observer.properties().settling_samples);
            let what = format!("{is} samples, all of them within the settling of {}", method.name());
            return Err(self.in_file(format!("axis {name}: {what}; expected more than {least}")));
        }
        let settled = observer.properties().settling_samples;
        let friction_n = observer.properties().friction_bound_n.unwrap_or(0.0);
        if !self.arguments.live && !matches!(method, Method::Spectral | Method::Thrust) {
            let travel = motion.samples.iter().filter_map(|s| s.stage_position_m.or(s.motor_travel_m));
            let travel: Vec<f64> = travel.collect();
            let part = (0.3 * rate.hz()) as usize;
            if let Some(zero_n) = standing_zero_n(&force_n[settled..], &travel, friction_n, part) {
                note("zero_n", format!("{zero_n:.4}"));
                force_n.iter_mut().for_each(|f| *f -= zero_n);
            }
        }
        describe(&observer, &estimates, &mut note);
        if mismatch.force_n > 0.0 {
            note("expected_error_n", format!("{:.4}", mismatch.error_n));
            note("expected_error_over_force", format!("{:.4}", mismatch.share()));
        }
        say_what_is_doubtful((name, method), &estimates, &observer, mismatch)?;
        if let Some(ratio) = observer.learned_stiffness_ratio() {
            note("stiffness_over_model_at_end", format!("{ratio:.4}"));
        }
        let flags = estimates.iter().map(|e| e.flags).collect();
        let noise_floor_n = observer.properties().noise_floor_n;
        if method == Method::Spectral {
            say_what_is_hidden(name, &estimates, &mut force_n, friction_n)?;
        }
        Ok(AxisForce { name: name.to_owned(), force_n, flags, noise_floor_n, delay_s, settled, notes })
    }

    /// An estimator that cannot be made of what the file holds.
    fn of_axis(&self, name: &str, error: impl std::fmt::Display) -> anyhow::Error {
        self.in_file(format!("axis {name}: {error}"))
    }

    /// What the options say of one axis; without `--live` also what the whole recording and the idle runs
    /// say.
    fn plan(
        &self,
        method: Method,
        (axis, motion): (&AxisModel, &RecordedMotion),
        note: &mut impl FnMut(&str, String),
    ) -> anyhow::Result<ServoPlan> {
        let (arguments, rate) = (&self.arguments, self.recording.sample_rate);
        let mut idle_runs = Vec::new();
        for (idle, path) in self.idles.iter().zip(&arguments.idle) {
            let in_file = |e: String| bad_input(format!("{}: {e}", path.display()));
            if (idle.sample_rate.hz() / rate.hz() - 1.0).abs() > 1e-6 {
                let (is, expected) = (idle.sample_rate.hz(), rate.hz());
                return Err(in_file(format!("sampled at {is} Hz, expected {expected} Hz as the recording")));
            }
            let run =
                motion_of_recording(idle, &axis.name, &axis.drive).map_err(|e| in_file(e.to_string()))?;
            if !run.signals.covers(motion.signals) {
                let (is, expected) = (run.signals.name(), motion.signals.name());
                let what = format!("axis {}: {is}, expected {expected} as in the recording", axis.name);
                return Err(in_file(what));
            }
            idle_runs.push(run.samples);
        }
        let mut plan = ServoPlan::of_axis(axis, method, motion.signals);
        if method == Method::VibrationMode && !(arguments.live || arguments.keep_stiffness) {
            let signals = AxisSignals { drive: &plan.drive, rate, signals: motion.signals };
            let check = stiffness_of_runs(&signals, &motion.samples, &idle_runs).map_err(bad_input)?;
            if let Some(check) = check.filter(StiffnessCheck::is_conclusive) {
                let stiffness_n_m = check.ratio * plan.drive.axial_stiffness_n_m();
                note("axial_stiffness_n_m", format!("{stiffness_n_m:.6e}"));
                note("stiffness_over_model", format!("{:.4}", check.ratio));
                plan.drive =
                    plan.drive.with_numbers([("axial_stiffness_n_m", stiffness_n_m)]).map_err(bad_input)?;
            }
        }
        if !(arguments.pass_hz > 0.0) {
            return Err(bad_input(format!(
                "--pass-hz {}: expected a frequency above zero",
                arguments.pass_hz
            )));
        }
        // The filter is some four periods long.
        let least_hz = 4.0 * rate.hz() / self.recording.len() as f64;
        if arguments.cutoff_hz.is_none() && arguments.pass_hz < least_hz {
            let what =
                format!("expected at least {least_hz:.2} Hz, or its filter is as long as the recording");
            return Err(bad_input(format!("--pass-hz {}: {what}", arguments.pass_hz)));
        }
        let pass_hz = arguments.pass_hz.min(0.2 * rate.hz());
        plan.settings.low_pass = match arguments.cutoff_hz {
            Some(cutoff_hz) => LowPass::Butterworth { order: 4, cutoff_hz },
            None => LowPass::LinearPhase { pass_hz, width_hz: pass_hz / 2.0 },
        };
        plan.settings.learn_stiffness = arguments.live && !arguments.keep_stiffness;
        plan.motor_cutoff_hz = arguments.motor_cutoff_hz;
        plan.settings.notches = notches(&arguments.notch, rate)?;
        if let Some(harmonic) = &mut plan.settings.harmonic {
            let median_rpm = self.median_speed_rpm()?;
            harmonic.spindle_speed_rpm = if arguments.live { harmonic.spindle_speed_rpm } else { median_rpm };
            harmonic.turns = arguments.turns.unwrap_or(harmonic.turns);
            harmonic.harmonics = arguments.harmonics;
            let reading = arguments.reading.as_deref().and_then(Reading::from_name);
            harmonic.reading = reading.unwrap_or(harmonic.reading);
            harmonic.lines_per_turn = arguments.teeth.unwrap_or(harmonic.lines_per_turn);
        }
        let whole = (!arguments.live).then_some(&motion.samples);
        let told: Vec<&[MotionSample]> = idle_runs.iter().chain(whole).map(Vec::as_slice).collect();
        plan.learn_travel(rate, &told).map_err(|e| self.of_axis(&axis.name, e))?;
        if !idle_runs.is_empty() {
            plan.settings.idle_map =
                plan.idle_map(rate, &idle_runs).map_err(|e| self.of_axis(&axis.name, e))?;
            let runs = plan.settings.idle_map.as_ref().map_or(0, IdleMap::runs);
            let taken = format!("{runs} of {} taken off by position", idle_runs.len());
            if runs < idle_runs.len() {
                writeln!(std::io::stdout(), "axis {}: idle runs: {taken}", axis.name)?;
            }
            note("idle_runs", taken);
        }
        Ok(plan)
    }

    /// Spindle speed of the recording: without one the harmonics have no place.
    fn median_speed_rpm(&self) -> anyhow::Result<f64> {
        let speed = self.recording.require("spindle_speed_rpm").map_err(|e| self.in_file(e))?;
        let mut sorted = speed.to_vec();
        sorted.sort_by(f64::total_cmp);
        let median = sorted[sorted.len() / 2];
        if median != 0.0 {
            return Ok(median.abs());
        }
        let what = format!("column spindle_speed_rpm has a median of {median}, expected a turning spindle");
        Err(self.in_file(what))
    }

    /// Force from accelerometers. Without `--live` the stream's lag is taken out and the ends are continued.
    fn accelerometer_force(&self, name: &str) -> anyhow::Result<AxisForce> {
        let estimator = self.estimators.iter().find(|e| e.axis == name);
        let estimator = estimator.ok_or_else(|| bad_input(format!("--estimator: no axis {name}")))?;
        let accel = super::identify::accelerations(&self.recording).map_err(|e| self.in_file(e))?;
        let speed = self.recording.require("spindle_speed_rpm").map_err(|e| self.in_file(e))?;
        let rate = self.recording.sample_rate;
        let mut notes = Vec::new();
        let mut note = |key: &str, value: String| notes.push((format!("{name}_{key}"), value));
        let plan = ForcePlan::Accelerometers(estimator.clone());
        let mut observer = Observer::new(&plan, rate).map_err(bad_input)?;
        let sample = |(accel, speed_rpm): (&AccelSample, &f64)| MotionSample {
            accel_m_s2: Some(*accel),
            spindle_speed_rpm: Some(*speed_rpm),
            ..MotionSample::default()
        };
        let (estimates, delay_s, settled) = if self.arguments.live {
            let live = accel.iter().zip(speed).map(|pair| observer.step(&sample(pair)));
            let estimates: Vec<ForceEstimate> = live.collect();
            let settled = observer.properties().settling_samples.min(estimates.len());
            (estimates, observer.properties().delay_s, settled)
        } else {
            (force_of_recording(estimator, rate, &accel, speed).map_err(bad_input)?, 0.0, 0)
        };
        describe(&observer, &estimates, &mut note);
        Ok(AxisForce {
            name: name.to_owned(),
            force_n: estimates.iter().map(|e| e.force_n).collect(),
            flags: estimates.iter().map(|e| e.flags).collect(),
            noise_floor_n: observer.properties().noise_floor_n,
            delay_s,
            settled,
            notes,
        })
    }
}

/// One lag for the whole file where a window followed the spindle: what was early waits for what was latest.
/// Answers that lag.
fn wait_for_latest(estimates: &mut [ForceEstimate], lags: &[usize]) -> usize {
    let latest = lags.iter().copied().max().unwrap_or(0);
    if lags.iter().all(|lag| *lag == latest) {
        return latest;
    }
    let early = estimates.to_vec();
    let mut at = 0;
    for (i, lag) in lags.iter().enumerate() {
        let to = (i + latest - lag).min(estimates.len());
        // Between two windows the last value stands.
        let last = early[i.saturating_sub(1)];
        let between = ForceEstimate { flags: last.flags | Validity::SETTLING, ..last };
        estimates[at.min(to)..to].fill(between);
        if let Some(place) = estimates.get_mut(to) {
            *place = early[i];
        }
        at = to + 1;
    }
    latest
}

fn notches(names: &[String], rate: SampleRate) -> anyhow::Result<Vec<NotchCentre>> {
    let below_hz = 0.5 * rate.hz();
    let plan = |name: &String| {
        let seen = |centre: &NotchCentre| match *centre {
            NotchCentre::Fixed { hz } => hz < below_hz,
            _ => true,
        };
        let expected = format!("expected motor_encoder, stage_encoder or a frequency below {below_hz} Hz");
        let centre = NotchCentre::from_name(name).filter(seen);
        centre.ok_or_else(|| bad_input(format!("--notch {name}: {expected}")))
    };
    names.iter().map(plan).collect()
}
