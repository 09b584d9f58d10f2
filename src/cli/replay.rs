//! `stillcut replay`: the live pipeline over a recording.

use super::bad_input;
use super::gated::tell_of;
use crate::avoidance::Avoidance;
use crate::avoidance::account::{Account, Look, decide_again};
use crate::chatter::{Band, MeanForce, predicted_band};
use crate::config::service::{ServiceConfig, read_service_config};
use crate::force::motion::ForceEstimate;
use crate::force::recorded::accelerations;
use crate::force::validity::Validity;
use crate::keyframe::Digest;
use crate::pipeline::{
    AxisPlan, BandPlan, CutConditions, CutPrior, MarginPlan, MarginWarning, Pipeline, PipelineSettings,
    StepOutput,
};
use crate::plant::workpiece::{RawWorkpiece, Workpiece};
use crate::recording::{Evidence, read_recording};
use crate::report::decisions::write_decisions;
use crate::report::events::{EventLine, events_text, write_events};
use crate::report::track::{Track, TrackRow};
use crate::sample::{AxisSample, MAX_AXES, Recording, ServoSample};
use crate::signal::order_tracking::speed_from_orders;
use crate::units::{SampleRate, SpindleSpeed, counted};
use anyhow::Context as _;
use std::borrow::Cow;
use std::io::Write as _;
use std::path::PathBuf;

/// Runs the live pipeline over a recording and writes events.jsonl and track.parquet.
///
/// Of a recording of the service's black box the decisions on the turret are made again too: decisions.jsonl.
///
/// A recording with servo signals goes through the force observer of the configuration's machine; one with
/// <axis>_force_n and no servo signals enters behind it, with what <axis>_force_flags say against it. Without
/// a configuration the defaults hold, and the band and workpiece that the recording names.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Configuration of the service.
    #[arg(long)]
    config: Option<PathBuf>,
    /// Recording, Parquet or CSV.
    #[arg(long)]
    recording: PathBuf,
    /// Folder to write into.
    #[arg(long)]
    out: PathBuf,
    /// Band to watch, "low,high"; otherwise the configuration's, the recording's, or its workpiece's.
    #[arg(long, value_name = "LOW,HIGH")]
    band_hz: Option<String>,
    /// Spindle speed where the recording has none.
    #[arg(long)]
    spindle_speed_rpm: Option<f64>,
    /// Columns to listen to as they are, where there are no servo signals: force_n or accel_m_s2.
    #[arg(long, default_value = "force_n", value_parser = ["force_n", "accel_m_s2"])]
    signal: String,
    /// Fail unless the recording carries what the live service decided and this replay decides the same, bit
    /// for bit. Needs the configuration that the service ran with.
    #[arg(long)]
    verify: bool,
}

/// Rows of the track a second.
const TRACK_HZ: f64 = 100.0;

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    if arguments.out.exists() && !arguments.out.is_dir() {
        return Err(bad_input(format!("--out {}: is a file; expected a folder", arguments.out.display())));
    }
    let recording = read_recording(&arguments.recording).map_err(bad_input)?;
    tell_of(&arguments.recording, &recording);
    let config = arguments.config.as_deref().map(read_service_config).transpose().map_err(bad_input)?;
    let place = |error: String| bad_input(format!("{}: {error}", arguments.recording.display()));
    let given = arguments.config.is_some();
    let mut config = config.unwrap_or_default();
    config.force.read_idle_runs(&config.machine, read_recording).map_err(bad_input)?;
    let asked = arguments.band_hz.as_deref().map(stated_band);
    let asked = asked.transpose().map_err(|error| bad_input(format!("--band-hz: {error}")))?;
    let band = match asked {
        Some(band) => Some(band),
        None => band_of(&recording, given.then_some(&config)).map_err(place)?,
    };
    let source = Source::of(&recording, &arguments, &config).map_err(place)?;
    source.say_what_is_invalid()?;
    let mut settings = source.settings(&config, band);
    settings.margin = margin_of(&recording, given.then_some(&config)).map_err(place)?;
    let evidence = Evidence::of(&recording).map_err(|e| place(e.to_string()))?;
    if evidence.is_some() {
        // The live service listens with what the turret reports alone.
        settings.stated_pitch_rad = None;
    }
    let pipeline = Pipeline::new(settings);
    let mut pipeline = pipeline.map_err(|error| match &arguments.band_hz {
        Some(band) => bad_input(format!("--band-hz {band}: {error} ({})", arguments.recording.display())),
        None => place(error.to_string()),
    })?;
    let account = evidence.as_ref().and_then(|e| e.account.clone());
    let carries_evidence = evidence.is_some();
    let begun = evidence.filter(|e| e.settings == pipeline.settings_digest());
    if let Some(evidence) = &begun {
        pipeline.restore(&evidence.keyframe).map_err(|e| place(e.to_string()))?;
    }
    if arguments.verify && begun.is_none() {
        let what = if carries_evidence {
            "nothing to compare: the configuration differs from that of the live service which recorded it, \
             or the version does"
        } else {
            "nothing to compare: it carries no decisions of a live service"
        };
        return Err(place(what.to_owned()));
    }
    let first_sequence = begun.as_ref().map_or(0, |e| e.first_sequence);
    let mut stretches = Stretches::of(begun.as_ref());
    let (events, track) = replay(&recording, (&source, first_sequence), (&mut pipeline, &mut stretches));
    let folder = |e| bad_input(format!("--out {}: {e}", arguments.out.display()));
    std::fs::create_dir_all(&arguments.out).map_err(folder)?;
    track.write(&arguments.out.join("track.parquet"))?;
    write_events(&arguments.out.join("events.jsonl"), &events)?;
    let turret = account.map(|account| turret_decisions(&config, &source.axes, &account));
    if let Some(Ok(looks)) = &turret {
        write_decisions(&arguments.out.join("decisions.jsonl"), (looks, &source.axes))?;
    }
    if let (true, Some(evidence)) = (arguments.verify, &begun) {
        stretches.compare(evidence)?;
        let here = events_text(&events)?;
        anyhow::ensure!(here == evidence.decisions, "{}", first_difference(&here, &evidence.decisions));
        let looks = turret.context("it carries no looks at the decision on the turret")??;
        let (samples, events) = (counted(recording.len(), "sample"), counted(events.len(), "event"));
        let said = format!("the same: {samples}, {events}, {} at the turret", counted(looks.len(), "look"));
        writeln!(std::io::stdout(), "{said}")?;
    }
    Ok(())
}

/// The first event that is not the same in both.
fn first_difference(here: &str, live: &str) -> String {
    let (mut here, mut live) = (here.lines(), live.lines());
    for number in 1_usize.. {
        match (here.next(), live.next()) {
            (Some(a), Some(b)) if a == b => {}
            (None, None) => break,
            (a, b) => {
                let [a, b] = [a, b].map(|line| line.unwrap_or("nothing"));
                return format!("event {number} differs: {a} here, {b} live");
            }
        }
    }
    "the events differ".to_owned()
}

/// Every decision on the turret made again, compared bit for bit.
fn turret_decisions(config: &ServiceConfig, axes: &[String], account: &Account) -> anyhow::Result<Vec<Look>> {
    let settings = config.avoidance_settings(axes).map_err(anyhow::Error::msg)?;
    Ok(decide_again(&Avoidance::new(settings)?, account)?)
}

/// Digests of what the replay said, over the stretches that the live service made its own over.
struct Stretches {
    lengths: Vec<usize>,
    left: usize,
    current: Digest,
    done: Vec<u64>,
}

impl Stretches {
    fn of(evidence: Option<&Evidence>) -> Self {
        let mut lengths: Vec<usize> =
            evidence.map(|e| e.stretches.iter().map(|s| s.0).rev().collect()).unwrap_or_default();
        let left = lengths.pop().unwrap_or(usize::MAX);
        Self { lengths, left, current: Digest::default(), done: Vec::new() }
    }

    fn take(&mut self, output: &StepOutput, axes: usize) {
        output.digest(axes, &mut self.current);
        self.left = self.left.saturating_sub(1);
        if self.left == 0 {
            self.done.push(std::mem::take(&mut self.current).value());
            self.left = self.lengths.pop().unwrap_or(usize::MAX);
        }
    }

    fn compare(&self, evidence: &Evidence) -> anyhow::Result<()> {
        let mut sample = 0;
        for (index, (length, digest)) in evidence.stretches.iter().enumerate() {
            let same = self.done.get(index) == Some(digest);
            anyhow::ensure!(
                same,
                "the replay differs from the live run between sample {sample} and {}",
                sample + length
            );
            sample += length;
        }
        Ok(())
    }
}

fn replay(
    recording: &Recording,
    (source, first_sequence): (&Source<'_>, u64),
    (pipeline, stretches): (&mut Pipeline, &mut Stretches),
) -> (Vec<EventLine>, Track) {
    let (mut events, mut track) = (Vec::new(), Track::default());
    let every = (recording.sample_rate.hz() / TRACK_HZ).max(1.0);
    let mut next_row = every;
    for index in 0..recording.len() {
        let sequence = first_sequence + index as u64;
        let output = source.step(pipeline, recording, (index, sequence));
        stretches.take(&output, source.axes.len());
        if let Some(MarginWarning { axis, margin }) = output.margin_warning {
            let name = source.axes.get(axis).map_or("", String::as_str);
            events.push(EventLine::from_margin(output.t_s, name, &margin));
        }
        if let Some((axis, event)) = &output.event {
            let name = source.axes.get(*axis).map_or("", String::as_str);
            let line = EventLine::from_chatter(output.t_s, name, event);
            // On an estimate that is no ground to act on, no pitch is advised. What a live service kept of
            // its own events is compared as it stands.
            let may_act = !source.is_direct() || pipeline.axis_may_act(*axis);
            let speed_rpm = source.speed_rpm(index).filter(|_| may_act);
            events.push(speed_rpm.map_or(line.clone(), |rpm| line.with_pitch_at(rpm)));
        }
        if (index + 1) as f64 >= next_row {
            next_row += every;
            let chatter = &output.chatter;
            track.push(TrackRow {
                t_s: output.t_s,
                frequency_hz: chatter.frequency_hz,
                power_n2: chatter.power_n2,
                chatter: chatter.phase == crate::chatter::Phase::Chatter,
                margin: pipeline.margin().copied(),
                margin_state: pipeline.margin_word(),
                reason: pipeline.reason().name(),
            });
        }
    }
    (events, track)
}

/// Where the pipeline's input is found in a recording.
struct Source<'a> {
    axes: Vec<String>,
    rate: SampleRate,
    signals: Signals<'a>,
    /// What their mean tells.
    mean: MeanForce,
    speed: Option<Cow<'a, [f64]>>,
    speed_given_rpm: Option<f64>,
    angle: Option<&'a [f64]>,
    accel: Option<[&'a [f64]; 3]>,
    accel_valid: Option<&'a [f64]>,
    /// The machine's own times, where a black box kept them.
    times: Option<&'a [f64]>,
    cut: CutColumns<'a>,
}

/// Speed at each row, rpm, where the recording itself shows that the spindle did not turn at the one stated;
/// says so on standard error.
fn turned(columns: &[&[f64]], rate: SampleRate, stated_rpm: f64) -> Option<Vec<f64>> {
    let mut speed = speed_from_orders(columns, rate, SpindleSpeed::from_rpm(stated_rpm).ok()?)?;
    speed.iter_mut().for_each(|hz| *hz *= 60.0);
    let [least, most] = speed.iter().fold([f64::MAX, 0.0], |[a, b], x| [x.min(a), x.max(b)]);
    // Whoever reads standard error may have gone; the answer is written all the same.
    let _ = writeln!(
        std::io::stderr(),
        "note: the spindle did not turn at the stated {stated_rpm} rpm: its orders show {least:.0} to \
         {most:.0} rpm, which is what this replay goes by"
    );
    Some(speed)
}

/// Conditions of the cut, as far as the recording has them (contracts, section 4).
struct CutColumns<'a> {
    pitch_rad: Option<&'a [f64]>,
    pitch_valid: Option<&'a [f64]>,
    position_m: Option<&'a [f64]>,
    feed_m_rev: Option<&'a [f64]>,
    width_m: Option<&'a [f64]>,
}

impl<'a> CutColumns<'a> {
    fn of(recording: &'a Recording) -> Self {
        Self {
            pitch_rad: recording.get("pitch_difference_rad"),
            pitch_valid: recording.get("pitch_valid"),
            position_m: recording.get("tool_position_m"),
            feed_m_rev: recording.get("feed_m_rev"),
            width_m: recording.get("width_m"),
        }
    }

    fn pitch(&self, index: usize) -> Option<f64> {
        let valid = self.pitch_valid.is_none_or(|v| v[index] != 0.0);
        self.pitch_rad.filter(|_| valid).map(|c| c[index])
    }
}

enum Signals<'a> {
    /// One column an axis, heard as it is, and what speaks against it where the file says so.
    Direct(Vec<DirectColumn<'a>>),
    /// Current, motor angle, stage position of each axis; none of an axis that accelerometers alone hear.
    Servo(Vec<Option<ServoColumns<'a>>>),
}

struct DirectColumn<'a> {
    values: &'a [f64],
    flags: Option<&'a [f64]>,
}

impl<'a> DirectColumn<'a> {
    /// `<axis>_force_n` with `<axis>_force_flags` beside it, as `stillcut force` writes them.
    fn of(recording: &'a Recording, (axis, signal): (&str, &str)) -> Result<Self, String> {
        let values = recording.require(&format!("{axis}_{signal}")).map_err(|e| e.to_string())?;
        let name = format!("{axis}_force_flags");
        let flags = recording.get(&name).filter(|_| signal == "force_n");
        if let Some(row) =
            flags.and_then(|f| f.iter().position(|bits| Validity::from_number(*bits).is_none()))
        {
            let known = Validity::describe_bits();
            let is = flags.map_or(0.0, |f| f[row]);
            return Err(format!("column {name}, row {row}: {is:?}, expected a sum of {known}"));
        }
        Ok(Self { values, flags })
    }

    fn estimate(&self, index: usize) -> ForceEstimate {
        let flags = self.flags.and_then(|f| Validity::from_number(f[index]));
        ForceEstimate { force_n: self.values[index], flags: flags.unwrap_or(Validity::VALID) }
    }
}

struct ServoColumns<'a> {
    current_a: &'a [f64],
    motor_rad: &'a [f64],
    stage_m: Option<&'a [f64]>,
    stage_valid: Option<&'a [f64]>,
}

impl<'a> Source<'a> {
    fn of(recording: &'a Recording, arguments: &Arguments, config: &ServiceConfig) -> Result<Self, String> {
        let with = |suffix: &str| -> Vec<String> {
            let name =
                |c: &crate::sample::Column| Some(c.name.strip_suffix(suffix)?.strip_suffix('_')?.to_owned());
            recording.columns.iter().filter_map(name).collect()
        };
        let servo = with("current_ref_a");
        let accel = accelerations(recording);
        // Accelerometers are heard where the configuration says so and the force is not there already.
        let housing = accel.is_some() && (!servo.is_empty() || with("force_n").is_empty());
        let other = |axis: &&str| housing && !servo.iter().any(|s| s == axis);
        let heard: Vec<String> = config.force.accelerometer_axes().filter(other).map(str::to_owned).collect();
        let (axes, signals) = if servo.is_empty() && heard.is_empty() || arguments.signal != "force_n" {
            let axes = with(&arguments.signal);
            let columns = axes.iter().map(|axis| DirectColumn::of(recording, (axis, &arguments.signal)));
            let columns = columns.collect::<Result<Vec<_>, _>>()?;
            (axes, Signals::Direct(columns))
        } else {
            let columns = servo.iter().map(|axis| ServoColumns::of(recording, axis).map(Some));
            let mut columns = columns.collect::<Result<Vec<_>, _>>()?;
            columns.extend(heard.iter().map(|_| None));
            (servo.into_iter().chain(heard).collect(), Signals::Servo(columns))
        };
        if axes.is_empty() {
            return Err(format!("no column <axis>_{} and no <axis>_current_ref_a", arguments.signal));
        }
        if axes.len() > MAX_AXES {
            return Err(format!("{} axes; at most {MAX_AXES} are watched", axes.len()));
        }
        let stated = arguments.spindle_speed_rpm.filter(|_| recording.get("spindle_speed_rpm").is_none());
        let speed = match (&signals, stated) {
            (Signals::Direct(columns), Some(rpm)) => {
                let columns: Vec<&[f64]> = columns.iter().map(|c| c.values).collect();
                turned(&columns, recording.sample_rate, rpm).map(Cow::Owned)
            }
            _ => recording.get("spindle_speed_rpm").map(Cow::Borrowed),
        };
        let measured = |column: &DirectColumn<'_>| column.flags.is_none();
        let mean = match &signals {
            Signals::Direct(_) if arguments.signal != "force_n" => MeanForce::Absent,
            Signals::Direct(columns) if columns.iter().all(measured) => MeanForce::Whole,
            _ => MeanForce::OverAir,
        };
        Ok(Self {
            axes,
            rate: recording.sample_rate,
            signals,
            mean,
            speed,
            speed_given_rpm: arguments.spindle_speed_rpm,
            angle: recording.get("spindle_angle_rad"),
            accel,
            accel_valid: recording.get("accel_valid"),
            times: recording.get("source_t_s"),
            cut: CutColumns::of(recording),
        })
    }

    fn settings(&self, config: &ServiceConfig, band: Option<Band>) -> PipelineSettings {
        let configured = config.pipeline_settings(self.rate, &self.axes);
        let mut settings = match &self.signals {
            Signals::Servo(_) => configured,
            Signals::Direct(_) => PipelineSettings {
                sample_rate: self.rate,
                axes: self
                    .axes
                    .iter()
                    .map(|name| AxisPlan {
                        name: name.clone(),
                        force: None,
                        beside: None,
                        nut: None,
                        watch: true,
                        pushed: 0.0,
                    })
                    .collect(),
                band: configured.band,
                tools: None,
                infeed: None,
                stated_pitch_rad: None,
                margin: None,
                mean: self.mean,
                false_alarm_s: config.false_alarm_s,
            },
        };
        if let Some(band) = band {
            settings.band = BandPlan::Stated(band);
        }
        if self.cut.pitch_rad.is_none() {
            settings.stated_pitch_rad = config.stated_pitch_rad(&self.axes);
        }
        settings
    }

    /// Whether forces come from the file instead of the observer.
    fn is_direct(&self) -> bool {
        matches!(self.signals, Signals::Direct(_))
    }

    /// Rows of each axis whose flags forbid acting, and the flags seen there.
    fn say_what_is_invalid(&self) -> anyhow::Result<()> {
        let Signals::Direct(columns) = &self.signals else { return Ok(()) };
        for (axis, column) in self.axes.iter().zip(columns) {
            let flags = (0..column.values.len()).map(|i| column.estimate(i).flags);
            let (mut seen, mut count) = (Validity::VALID, 0);
            for flags in flags.filter(|f| !f.may_act()) {
                seen |= flags;
                count += 1;
            }
            if count > 0 {
                let rows = format!("{count} of {} rows are no ground to act on", column.values.len());
                writeln!(std::io::stdout(), "axis {axis}: {rows} ({seen}): no pitch is advised there")?;
            }
        }
        Ok(())
    }

    fn speed_rpm(&self, index: usize) -> Option<f64> {
        self.speed.as_ref().map(|s| s[index]).or(self.speed_given_rpm)
    }

    /// What the recording tells of the cut at a row.
    fn conditions(&self, index: usize) -> CutConditions {
        CutConditions {
            spindle_speed_rpm: self.speed_rpm(index),
            pitch_difference_rad: self.cut.pitch(index),
            tool_position_m: self.cut.position_m.map(|c| c[index]),
            feed_m_rev: self.cut.feed_m_rev.map(|c| c[index]),
            width_m: self.cut.width_m.map(|c| c[index]),
            ..CutConditions::default()
        }
    }

    fn step(
        &self,
        pipeline: &mut Pipeline,
        recording: &Recording,
        (index, sequence): (usize, u64),
    ) -> StepOutput {
        let t_s = self.times.map_or(recording.time_s(index), |t| t[index]);
        match &self.signals {
            Signals::Direct(columns) => {
                let mut forces = [ForceEstimate { force_n: 0.0, flags: Validity::VALID }; MAX_AXES];
                for (to, column) in forces.iter_mut().zip(columns) {
                    *to = column.estimate(index);
                }
                pipeline.step_estimates(t_s, &forces[..columns.len()], &self.conditions(index))
            }
            Signals::Servo(columns) => {
                let mut axes = [AxisSample::default(); MAX_AXES];
                for (to, column) in axes.iter_mut().zip(columns) {
                    let Some(column) = column else { continue };
                    *to = AxisSample {
                        current_ref_a: column.current_a[index],
                        motor_angle_rad: column.motor_rad[index],
                        stage_position_m: column.stage(index),
                    };
                }
                pipeline.step(&ServoSample {
                    sequence,
                    t_s,
                    axes,
                    spindle_angle_rad: self.angle.map_or(0.0, |a| a[index]),
                    spindle_speed_rpm: self.speed_rpm(index).unwrap_or(0.0),
                    accel_m_s2: self
                        .accel
                        .filter(|_| self.accel_valid.is_none_or(|v| v[index] != 0.0))
                        .map(|a| a.map(|column| column[index])),
                    pitch_difference_rad: self.cut.pitch(index),
                })
            }
        }
    }
}

impl<'a> ServoColumns<'a> {
    fn stage(&self, index: usize) -> Option<f64> {
        let valid = self.stage_valid.is_none_or(|v| v[index] != 0.0);
        self.stage_m.filter(|_| valid).map(|s| s[index])
    }

    fn of(recording: &'a Recording, axis: &str) -> Result<Self, String> {
        let column = |name: &str| recording.require(&format!("{axis}_{name}")).map_err(|e| e.to_string());
        Ok(Self {
            current_a: column("current_ref_a")?,
            motor_rad: column("motor_angle_rad")?,
            stage_m: recording.get(&format!("{axis}_stage_position_m")),
            stage_valid: recording.get(&format!("{axis}_stage_valid")),
        })
    }
}

/// A band as it is written: `low,high`.
fn stated_band(text: &str) -> Result<Band, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let Some([low_hz, high_hz]) = numbers.and_then(|n| <[f64; 2]>::try_from(n).ok()) else {
        return Err(format!("band `{}`, expected two frequencies `low,high`", text.escape_debug()));
    };
    Band::new(low_hz, high_hz).map_err(|e| e.to_string())
}

/// Configuration, recording's band, recording's workpiece, in this order; `None`: the
/// configuration's.
fn band_of(recording: &Recording, config: Option<&ServiceConfig>) -> Result<Option<Band>, String> {
    let in_recording = if config.is_some() { None } else { recording.metadata("analysis_band_hz") };
    if let Some(text) = in_recording {
        return stated_band(text).map(Some);
    }
    if config.is_some() {
        return Ok(None);
    }
    let Some([diameter_m, projection_length_m]) = bar_of(recording)? else { return Ok(None) };
    let raw = RawWorkpiece { diameter_m, projection_length_m, clamp_factor: 1.0, ..RawWorkpiece::default() };
    let workpiece = Workpiece::new(raw).map_err(|e| e.to_string())?;
    predicted_band(workpiece.bending_frequency_hz()).map(Some).map_err(|e| e.to_string())
}

/// Diameter and length of the bar that the recording names, m.
fn bar_of(recording: &Recording) -> Result<Option<[f64; 2]>, String> {
    let number = |key: &str| {
        let Some(text) = recording.metadata(key) else { return Ok(None) };
        let wrong = || format!("metadata {key} is `{}`, expected a number of metres", text.escape_debug());
        text.trim().parse::<f64>().map(Some).map_err(|_| wrong())
    };
    let diameter_m = number("workpiece_diameter_m")?;
    let length_m = number("workpiece_projection_length_m")?;
    Ok(diameter_m.zip(length_m).map(|(diameter_m, length_m)| [diameter_m, length_m]))
}

/// What the margin rests on: the configuration's cut, or the bar that the recording names, cut as such bars
/// are.
fn margin_of(recording: &Recording, config: Option<&ServiceConfig>) -> Result<Option<MarginPlan>, String> {
    if let Some(config) = config {
        return Ok(Some(config.margin_plan()));
    }
    let Some([diameter_m, length_m]) = bar_of(recording)? else { return Ok(None) };
    let prior = CutPrior::usual(diameter_m, length_m).map_err(|e| e.to_string())?;
    Ok(Some(MarginPlan { prior, force_hz: MarginPlan::FORCE_HZ }))
}
