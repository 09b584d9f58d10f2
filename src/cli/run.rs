//! `stillcut run`.

use super::bad_input;
use super::signals::stop_token;
use crate::config::service::{ServiceConfig, read_service_config};
use crate::ownership;
use crate::service::{Running, ServiceError, check, check_shared_memory, clock, start, user_of};
use crate::store::StoreError;
use crate::telemetry::{LogFormat, start_logs};
use crate::units::counted;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// Runs the service until it is told to stop.
///
/// It starts in mode observe; SIGINT, SIGTERM and SIGHUP end it in good order.
/// Example: stillcut run --config /etc/stillcut/stillcut.toml
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Configuration; without it every setting has the default that `print-config` shows.
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Only read the configuration and the files that it names, and say whether they are good.
    #[arg(long)]
    check: bool,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let mut config = match &arguments.config {
        Some(path) => read_service_config(path).map_err(bad_input)?,
        None => ServiceConfig::default(),
    };
    let place = |error: String| match &arguments.config {
        Some(path) => bad_input(format!("{}: {error}", path.display())),
        None => bad_input(error),
    };
    config.force.read_idle_runs(&config.machine, crate::recording::read_recording).map_err(place)?;
    let this = ownership::own_user();
    let user = if arguments.check { user_of(&config) } else { this };
    check(&config, user).map_err(|e| place(e.to_string()))?;
    if arguments.check {
        check_shared_memory(&config, user).map_err(|e| place(e.to_string()))?;
        let name = arguments.config.as_deref().map_or("defaults".into(), |path| path.to_string_lossy());
        let whose = if user == this { String::new() } else { format!(" for user {user}") };
        writeln!(std::io::stdout(), "{name}: the configuration is good{whose}")?;
        return Ok(());
    }
    ownership::keep_others_out();
    start_logs(if config.log_json { LogFormat::Json } else { LogFormat::Text });
    // Heard from here on; a start that is under way is ended in good order when it is done.
    let signals = stop_token()?;
    let running = start(config).map_err(|error| match error {
        // A person must go back or forward: trying again does not help.
        ServiceError::Store(StoreError::NewerSchema { .. }) => bad_input(error),
        _ if ownership::is_refusal(&error) => bad_input(error),
        // A full disk, a port that is taken, shared memory of another user: may be over at the next start.
        _ => anyhow::Error::new(error),
    })?;
    tracing::info!(event = "listening", address = %running.handle().address(), "the page is served");
    let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
    let failed = wait_for_the_end(&running, &signals);
    let _ = sd_notify::notify(&[sd_notify::NotifyState::Stopping]);
    let lost = running.stop();
    if let Some(part) = failed {
        anyhow::bail!("{part} ended by itself; see the log");
    }
    let writes = counted(lost, "write");
    anyhow::ensure!(lost == 0, "{writes} to the history lost: the disk refused them; see the log");
    Ok(())
}

/// Feeds the watchdog from the pipeline's progress until a signal comes or a part ends; answers which.
fn wait_for_the_end(running: &Running, signals: &CancellationToken) -> Option<&'static str> {
    let every = sd_notify::watchdog_enabled().map_or(Duration::from_secs(1), |limit| limit / 3);
    let every = every.min(Duration::from_secs(1));
    running.wait(async {
        let mut last = running.progress();
        let mut ended = std::pin::pin!(signals.cancelled());
        loop {
            tokio::select! {
                () = &mut ended => return None,
                () = tokio::time::sleep(every) => {}
            }
            if let Some(part) = running.failed_part() {
                tracing::error!(event = "part_ended", part, "it ended by itself; the service ends with it");
                return Some(part);
            }
            let now = running.progress();
            if now != last {
                last = now;
                let _ = sd_notify::notify(&[sd_notify::NotifyState::Watchdog]);
            } else {
                tracing::warn!(event = "pipeline_stalled", wall_ns = clock::wall_ns(), "no progress");
            }
        }
    })
}
