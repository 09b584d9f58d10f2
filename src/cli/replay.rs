//! `stillcut replay`: the live monitor over a recording.

use super::bad_input;
use crate::chatter::{Band, ChatterMonitor, ChatterOutput, ChatterSettings, predicted_band};
use crate::plant::workpiece::{RawWorkpiece, Workpiece};
use crate::recording::read_recording;
use crate::report::events::{EventLine, write_events};
use crate::report::track::Track;
use crate::sample::Recording;
use anyhow::Context as _;
use std::path::PathBuf;

/// Runs the live pipeline over a recording and writes events.jsonl and track.parquet.
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Recording (Parquet or CSV) with <axis>_force_n.
    #[arg(long)]
    recording: PathBuf,
    /// Folder to write into.
    #[arg(long)]
    out: PathBuf,
    /// Band to watch, "low,high"; otherwise the recording's analysis_band_hz or its workpiece's.
    #[arg(long, value_name = "LOW,HIGH")]
    band_hz: Option<String>,
    /// Spindle speed where the recording has none.
    #[arg(long)]
    spindle_speed_rpm: Option<f64>,
}

/// Rows of the track a second, at least.
const TRACK_HZ: f64 = 100.0;

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let recording = read_recording(&arguments.recording).map_err(bad_input)?;
    let place = arguments.recording.display();
    let band =
        band_of(&recording, arguments.band_hz.as_deref()).map_err(|e| bad_input(format!("{place}: {e}")))?;
    let settings = ChatterSettings { sample_rate: recording.sample_rate, band };
    let monitor = ChatterMonitor::new(settings).map_err(|e| bad_input(format!("{place}: {e}")))?;
    let forces: Vec<(&str, &[f64])> = recording
        .columns
        .iter()
        .filter_map(|c| Some((c.name.strip_suffix("_force_n")?, c.values.as_slice())))
        .collect();
    if forces.is_empty() {
        return Err(bad_input(format!("{place}: no column <axis>_force_n")));
    }
    let speed = recording.get("spindle_speed_rpm");
    let (mut events, mut track) = (Vec::new(), Track::default());
    let mut states: Vec<_> = forces.iter().map(|_| monitor.start()).collect();
    let every = (recording.sample_rate.hz() / TRACK_HZ).max(1.0);
    let mut next_row = every;
    for index in 0..recording.len() {
        let rpm = speed.map(|s| s[index]).or(arguments.spindle_speed_rpm);
        let t_s = recording.time_s(index);
        let mut loudest: Option<ChatterOutput> = None;
        for ((axis, values), state) in forces.iter().zip(&mut states) {
            let output = monitor.step(state, values[index], rpm);
            if let Some(event) = &output.event {
                events.push(EventLine::from_chatter(t_s, axis, event));
            }
            let better =
                loudest.is_none_or(|l| (output.chatter(), output.contrast) > (l.chatter(), l.contrast));
            if better {
                loudest = Some(output);
            }
        }
        if (index + 1) as f64 >= next_row {
            next_row += every;
            if let Some(output) = loudest {
                track.push(t_s, &output);
            }
        }
    }
    std::fs::create_dir_all(&arguments.out).with_context(|| arguments.out.display().to_string())?;
    track.write(&arguments.out.join("track.parquet"))?;
    write_events(&arguments.out.join("events.jsonl"), &events)?;
    Ok(())
}

fn band_of(recording: &Recording, given: Option<&str>) -> Result<Band, String> {
    if let Some(text) = given.or_else(|| recording.metadata("analysis_band_hz")) {
        let numbers: Vec<f64> = text.split(',').filter_map(|n| n.trim().parse().ok()).collect();
        let [low_hz, high_hz] = numbers[..] else {
            return Err(format!("band `{text}`, expected two frequencies `low,high`"));
        };
        return Band::new(low_hz, high_hz).map_err(|e| e.to_string());
    }
    let number = |key: &str| recording.metadata(key).and_then(|t| t.trim().parse::<f64>().ok());
    let (Some(diameter_m), Some(projection_length_m)) =
        (number("workpiece_diameter_m"), number("workpiece_projection_length_m"))
    else {
        return Err("neither analysis_band_hz nor the workpiece is in the metadata; state --band-hz".into());
    };
    let raw = RawWorkpiece { diameter_m, projection_length_m, clamp_factor: 1.0, ..RawWorkpiece::default() };
    let workpiece = Workpiece::new(raw).map_err(|e| e.to_string())?;
    predicted_band(workpiece.bending_frequency_hz()).map_err(|e| e.to_string())
}
