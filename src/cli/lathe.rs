//! `stillcut lathe`: the virtual lathe alone, in real time over shared memory.

use super::bad_input;
use super::signals::stop_flag;
use crate::config::scenario::read_scenario;
use crate::plant::scenario::{RawScenario, Scenario};
use crate::service::virtual_lathe::VirtualLathe;
use crate::simulation::lathe::turret::TurretState;
use crate::simulation::lathe::{Lathe, LatheSettings, PAUSE_S};
use crate::transport::Domain;
use std::io::{IsTerminal as _, Write as _};
use std::path::PathBuf;

/// Runs the virtual lathe alone, in real time: servo samples at 9 kHz out, turret commands in.
///
/// It stands where a motion controller stands. Where the tools travel, they cut pass after pass. Stop it
/// with Ctrl-C.
#[derive(clap::Args)]
#[command(after_help = "Example: stillcut lathe --config config/lathe.toml & \
                  stillcut run --config config/stillcut.toml")]
pub(super) struct Arguments {
    /// Scenario (lathe.toml); without it, the bar and cut of the README's example.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Prefix of the shared memory domain; the same as the service's `transport.prefix`.
    #[arg(long, default_value = "stillcut")]
    prefix: String,
    /// Folder of the domain; the same as the service's `transport.root`.
    #[arg(long, default_value = "/run/stillcut", value_name = "DIR")]
    root: PathBuf,
    /// Machine time after which to stop, in s; without it, until Ctrl-C.
    #[arg(long, value_name = "SECONDS")]
    duration_s: Option<f64>,
    /// Time in air before the tools enter the cut, in s.
    #[arg(long, value_name = "SECONDS", default_value_t = 2.0)]
    entry_s: f64,
    /// Seed of everything random.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let scenario = match &arguments.config {
        Some(path) => read_scenario(path).map_err(bad_input)?,
        None => Scenario::new(&RawScenario { travel_m_s: -3.0e-3, ..RawScenario::default() })?,
    };
    if !(arguments.entry_s.is_finite() && arguments.entry_s >= 0.0) {
        return Err(bad_input(format!("--entry-s {}: expected zero or more", arguments.entry_s)));
    }
    if let Some(duration) = arguments.duration_s.filter(|d| !(d.is_finite() && *d > 0.0)) {
        return Err(bad_input(format!("--duration-s {duration}: expected a number above zero")));
    }
    let domain = Domain::new(&arguments.prefix, &arguments.root).map_err(bad_input)?;
    let settings = LatheSettings {
        entry_s: arguments.entry_s,
        pause_s: Some(PAUSE_S),
        ..LatheSettings::realistic(scenario, arguments.seed)
    };
    let stop = stop_flag()?;
    let mut lathe = VirtualLathe::join(settings, &domain)?;
    let _ = writeln!(
        std::io::stderr(),
        "virtual lathe: {} Hz, prefix {}, root {}; Ctrl-C ends it",
        settings.sample_rate_hz,
        arguments.prefix,
        arguments.root.display()
    );
    let terminal = std::io::stderr().is_terminal();
    let (mut next_s, mut told) = (0.0, None);
    lathe.run(&stop, arguments.duration_s, |lathe| {
        // What a service does to it is told anywhere; the running line needs a terminal.
        let now = Some((lathe.truth().width_m > 0.0, lathe.turret().state()));
        if told != now {
            told = now;
            tell(lathe, terminal);
        }
        if terminal && lathe.truth().t_s >= next_s {
            next_s = lathe.truth().t_s + 0.5;
            show(lathe);
        }
    })?;
    if terminal {
        eprintln!();
    }
    Ok(())
}

/// One line for what changed: where the tools are, what the turret does.
fn tell(lathe: &Lathe, terminal: bool) {
    let truth = lathe.truth();
    let tools = if truth.width_m > 0.0 { "tools in the cut" } else { "tools in air" };
    let turret = match lathe.turret().state() {
        TurretState::Reached => "stands",
        TurretState::Moving => "moves",
        TurretState::Expired => "returns to equal pitch: its order expired",
        TurretState::Blocked => "is blocked by an interlock",
    };
    let pitch_deg = truth.pitch_difference_rad.to_degrees();
    let start = if terminal { "\r\x1b[K" } else { "" };
    let _ = writeln!(
        std::io::stderr(),
        "{start}{:8.1} s  {tools}, the turret {turret}, pitch difference {pitch_deg:.2} deg",
        truth.t_s
    );
}

fn show(lathe: &Lathe) {
    let truth = lathe.truth();
    let _ = write!(
        std::io::stderr(),
        "\r{:8.1} s  force {:6.1} N  tools {:5.1} mm from the chuck  pitch difference {:5.2} deg   ",
        truth.t_s,
        truth.radial_force_n[0],
        truth.tool_position_m * 1e3,
        truth.pitch_difference_rad.to_degrees(),
    );
}
