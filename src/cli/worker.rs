//! `stillcut worker`.

use super::bad_input;
use crate::service::fleet::{Broker, work};
use crate::telemetry::{LogFormat, start_logs};
use std::path::PathBuf;

/// Takes diagnoses of a whole fleet from a NATS JetStream queue and does them.
///
/// Start as many as there is work for, on any machine that reaches the broker.
/// Example: stillcut worker --server nats://broker:4222
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The broker.
    #[arg(long, default_value = "nats://127.0.0.1:4222")]
    server: String,
    /// File with one line `user:password` for the broker.
    #[arg(long, value_name = "FILE")]
    credentials: Option<PathBuf>,
    /// End after so many jobs; without it, never.
    #[arg(long)]
    jobs: Option<u64>,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    start_logs(LogFormat::Text);
    let broker = Broker { server: arguments.server, credentials: arguments.credentials };
    let program = std::env::current_exe()?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        tokio::select! {
            ended = work(&broker, program, arguments.jobs) => ended.map_err(bad_input),
            _ = tokio::signal::ctrl_c() => Ok(()),
        }
    })
}
