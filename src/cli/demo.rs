//! `stillcut demo`: the whole system on a virtual lathe.

use super::bad_input;
use super::signals::stop_flag;
use crate::config::scenario::read_scenario;
use crate::plant::scenario::{RawScenario, Scenario};
use crate::service::demo::{DemoPlan, Summary, run_demo};
use crate::service::live::Mode;
use crate::simulation::lathe::{LatheSettings, PAUSE_S};
use std::io::Write as _;
use std::path::PathBuf;

/// Shows the whole system on a virtual lathe: chatter grows, is heard, is silenced.
///
/// Lathe and service run over real shared memory; the page is served on loopback while it lasts.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  stillcut demo\n  stillcut demo --mode observe --duration-s 12 --json")]
pub(super) struct Arguments {
    /// Machine time to run for, in s; Ctrl-C ends it earlier.
    #[arg(long, value_name = "SECONDS", default_value_t = 30.0)]
    duration_s: f64,
    /// How far the service goes: observe, advise or act.
    #[arg(long, default_value = "act", value_parser = ["observe", "advise", "act"])]
    mode: String,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Scenario (lathe.toml); without it, the bar and cut of the README's example.
    #[arg(long, value_name = "FILE")]
    scenario: Option<PathBuf>,
    /// Print one JSON object at the end and nothing else.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let duration_s = arguments.duration_s;
    if !(duration_s.is_finite() && (1.0..=86_400.0).contains(&duration_s)) {
        return Err(bad_input(format!("--duration-s {duration_s}: expected 1 to 86400")));
    }
    let scenario = match &arguments.scenario {
        Some(path) => read_scenario(path).map_err(bad_input)?,
        None => Scenario::new(&RawScenario { travel_m_s: -3.0e-3, ..RawScenario::default() })?,
    };
    let plan = DemoPlan {
        lathe: LatheSettings { pause_s: Some(PAUSE_S), ..LatheSettings::realistic(scenario, arguments.seed) },
        duration_s,
        mode: Mode::ALL.into_iter().find(|m| m.word() == arguments.mode).unwrap_or_default(),
        port: 8620,
    };
    let quiet = arguments.json;
    let summary = run_demo(&plan, stop_flag()?, |line| {
        if !quiet {
            let _ = writeln!(std::io::stdout(), "{line}");
        }
    })?;
    let mut out = std::io::stdout().lock();
    if quiet {
        writeln!(out, "{}", serde_json::to_string(&summary)?)?;
    } else {
        print(&mut out, &summary)?;
    }
    Ok(())
}

fn print(out: &mut impl std::io::Write, s: &Summary) -> std::io::Result<()> {
    let time = |t: Option<f64>| t.map_or_else(|| "-".to_owned(), |t| format!("{t:.3} s"));
    writeln!(out)?;
    writeln!(out, "summary   mode {}, seed {}, {:.0} s of machine time", s.mode, s.seed, s.duration_s)?;
    writeln!(out, "  chatter began to grow     {}", time(s.onset_s))?;
    writeln!(out, "  heard                     {}", time(s.alarm_s))?;
    writeln!(out, "  turret commanded          {}", time(s.command_s))?;
    writeln!(out, "  silent                    {}", time(s.suppressed_s))?;
    if let Some(frequency_hz) = s.frequency_hz {
        writeln!(out, "  chatter frequency         {frequency_hz:.1} Hz")?;
    }
    if let Some(pitch) = s.pitch_difference_rad {
        writeln!(out, "  pitch angle difference    {:.2} deg", pitch.to_degrees())?;
    }
    if let (Some(before), Some(after)) = (s.power_before_n2, s.power_after_n2) {
        let change = 10.0 * (after / before).log10();
        writeln!(
            out,
            "  strongest line            {before:.3} N2 before, {after:.5} N2 after: {change:+.1} dB"
        )?;
    }
    writeln!(out, "  false alarms              {}", s.false_alarms)?;
    writeln!(out, "  samples lost              {}", s.lost_samples)
}
