//! `stillcut simulate`: a recording from the virtual lathe.

use super::bad_input;
use crate::config::scenario::read_scenario;
use crate::plant::scenario::ToolCount;
use crate::recording::write_recording;
use crate::sample::{Column, Recording};
use crate::simulation::force_signal::ShownForce;
use crate::simulation::lathe::{AXES, Lathe, LatheSettings, Truth};
use crate::units::SampleRate;
use indicatif::ProgressBar;
use std::path::PathBuf;

/// Writes a recording from the simulator: what an ideal dynamometer and probe would see.
///
/// Without --servo the cut is ideal: one bending mode, rigid turrets, no random force. With it, the
/// turrets are servo drives, the bar has its second mode and the force is random by 3 %.
#[derive(clap::Args)]
#[command(after_help = "Example: stillcut simulate --scenario lathe.toml --duration-s 5 --out cut.parquet")]
pub(super) struct Arguments {
    /// Scenario (contracts, section 3); keys not given have their defaults.
    #[arg(long, value_name = "FILE")]
    scenario: PathBuf,
    /// How long to cut, in s.
    #[arg(long, value_name = "SECONDS", default_value_t = 5.0)]
    duration_s: f64,
    /// Recording to write (Parquet).
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Add the servo columns of each turret axis.
    #[arg(long)]
    servo: bool,
    /// Random part of the cutting force over the force (default 0, with --servo 0.03).
    #[arg(long, value_name = "RATIO")]
    force_noise_ratio: Option<f64>,
    /// Time in air before the tools enter the cut, in s.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    entry_s: f64,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Show the forces through a low-pass of this corner, in Hz, and state it (default: none).
    #[arg(long, value_name = "HZ")]
    force_bandwidth_hz: Option<f64>,
    /// Show the forces so late, in s, and state it.
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    force_delay_s: f64,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let scenario = read_scenario(&arguments.scenario).map_err(bad_input)?;
    let duration_s = arguments.duration_s;
    if !(duration_s.is_finite() && (0.001..=86_400.0).contains(&duration_s)) {
        return Err(bad_input(format!("--duration-s {duration_s}: expected 0.001 to 86400")));
    }
    let base = if arguments.servo {
        LatheSettings::realistic(scenario, arguments.seed)
    } else {
        LatheSettings::ideal(scenario)
    };
    let noise = arguments.force_noise_ratio.unwrap_or(base.force_noise_ratio);
    if !(0.0..=1.0).contains(&noise) {
        return Err(bad_input(format!("--force-noise-ratio {noise}: expected 0 to 1")));
    }
    if !(arguments.entry_s.is_finite() && arguments.entry_s >= 0.0) {
        return Err(bad_input(format!("--entry-s {}: expected zero or more", arguments.entry_s)));
    }
    let signal = ShownForce { bandwidth_hz: arguments.force_bandwidth_hz, delay_s: arguments.force_delay_s };
    let good = signal.bandwidth_hz.is_none_or(|hz| hz.is_finite() && hz > 0.0);
    if !(good && (0.0..=1.0).contains(&signal.delay_s)) {
        let expected = "expected --force-bandwidth-hz above zero and --force-delay-s from 0 to 1";
        return Err(bad_input(expected.to_owned()));
    }
    let settings =
        LatheSettings { seed: arguments.seed, force_noise_ratio: noise, entry_s: arguments.entry_s, ..base };
    for note in notes(&settings, duration_s) {
        eprintln!("note: {note}");
    }
    let bar = super::progress(rows(&settings, duration_s) as u64, "simulating");
    let recording = record(settings, signal, duration_s, &bar).map_err(bad_input)?;
    bar.finish_and_clear();
    write_recording(&arguments.out, &recording).map_err(bad_input)?;
    Ok(())
}

/// What whoever asked for this may not expect.
fn notes(settings: &LatheSettings, duration_s: f64) -> Vec<String> {
    let tools = &settings.scenario.tools;
    let lathe = Lathe::new(*settings);
    let end_s = settings.entry_s + lathe.pass_s();
    let mut notes = Vec::new();
    if settings.entry_s >= duration_s {
        let entry_s = settings.entry_s;
        notes.push(format!(
            "nothing is cut: the tools enter after {entry_s} s, the recording ends after {duration_s} s"
        ));
    }
    if tools.travel_m_s() > 0.0 && lathe.travel_m_s() < 0.0 {
        notes.push(
            "tools.travel_m_s leads off the free end of the bar: they travel toward the chuck".to_owned(),
        );
    }
    if end_s < duration_s {
        notes.push(format!(
            "the tools are at the end of the bar after {end_s:.1} s and stay there in the cut"
        ));
    }
    notes
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded by the caller")]
fn rows(settings: &LatheSettings, duration_s: f64) -> usize {
    (duration_s * settings.sample_rate_hz).round().max(2.0) as usize
}

/// Lets the lathe run and keeps what it showed.
pub(super) fn record(
    settings: LatheSettings,
    signal: ShownForce,
    duration_s: f64,
    progress: &ProgressBar,
) -> anyhow::Result<Recording> {
    let mut lathe = Lathe::new(settings);
    let rows = rows(&settings, duration_s);
    let mut truth = Vec::with_capacity(rows);
    let mut servo = Vec::with_capacity(if settings.with_servo { rows } else { 0 });
    for row in 0..rows {
        let sample = lathe.step();
        truth.push(*lathe.truth());
        if settings.with_servo {
            servo.push(sample);
        }
        if row % 9000 == 0 {
            progress.set_position(row as u64);
        }
    }
    let rate = SampleRate::new(settings.sample_rate_hz)?;
    let mut columns = cut_columns(&settings, signal, &truth, rate);
    let column = |name: &str, values: Vec<f64>| Column { name: name.to_owned(), values };
    for (index, axis) in AXES.iter().enumerate().take(if settings.with_servo { AXES.len() } else { 0 }) {
        columns.push(column(
            &format!("{axis}_current_ref_a"),
            servo.iter().map(|s| s.axes[index].current_ref_a).collect(),
        ));
        columns.push(column(
            &format!("{axis}_motor_angle_rad"),
            servo.iter().map(|s| s.axes[index].motor_angle_rad).collect(),
        ));
        if servo.iter().all(|s| s.axes[index].stage_position_m.is_some()) {
            let positions = servo.iter().filter_map(|s| s.axes[index].stage_position_m).collect();
            columns.push(column(&format!("{axis}_stage_position_m"), positions));
        }
    }
    Ok(Recording {
        sample_rate: rate,
        experiment: "simulate".to_owned(),
        axes: if settings.with_servo { AXES.map(str::to_owned).to_vec() } else { Vec::new() },
        start_s: 1.0 / settings.sample_rate_hz,
        columns,
        metadata: metadata(&settings, signal),
    })
}

/// The columns of a recording of a cut (contracts, section 6).
fn cut_columns(
    settings: &LatheSettings,
    signal: ShownForce,
    truth: &[Truth],
    rate: SampleRate,
) -> Vec<Column> {
    let scenario = &settings.scenario;
    let series = |value: fn(&Truth) -> f64| truth.iter().map(value).collect::<Vec<f64>>();
    let column = |name: &str, values: Vec<f64>| Column { name: name.to_owned(), values };
    let shown = |force: Vec<f64>| signal.with_physics(scenario).of(&force, rate);
    let mut columns = vec![
        column("workpiece_displacement_m", series(|t| t.workpiece_displacement_m)),
        column("tool1_radial_force_n", shown(series(|t| t.radial_force_n[0]))),
    ];
    if scenario.tools.count() == ToolCount::Two {
        columns.push(column("tool2_radial_force_n", shown(series(|t| t.radial_force_n[1]))));
    }
    columns.extend([
        column("tool_position_m", series(|t| t.tool_position_m)),
        column("pitch_difference_rad", series(|t| t.pitch_difference_rad)),
        column("feed_m_rev", vec![scenario.cutting.raw().feed_m_rev; truth.len()]),
        column("width_m", series(|t| t.width_m)),
        column("spindle_angle_rad", series(|t| t.spindle_angle_rad)),
        column("spindle_speed_rpm", vec![scenario.spindle.rpm(); truth.len()]),
    ]);
    columns
}

fn metadata(settings: &LatheSettings, signal: ShownForce) -> Vec<(String, String)> {
    let workpiece = &settings.scenario.workpiece;
    let mut metadata = vec![("workpiece_diameter_m".to_owned(), format!("{:?}", workpiece.diameter_m()))];
    if !workpiece.is_tapped() {
        let length = format!("{:?}", workpiece.projection_length_m());
        metadata.push(("workpiece_projection_length_m".to_owned(), length));
    }
    metadata.push(("seed".to_owned(), settings.seed.to_string()));
    // As stated: what the scenario says that the signal has beyond it is what a diagnosis is to find.
    if let Some(hz) = signal.bandwidth_hz {
        metadata.push(("force_bandwidth_hz".to_owned(), format!("{hz:?}")));
    }
    metadata.push(("force_delay_s".to_owned(), format!("{:?}", signal.delay_s)));
    metadata
}
