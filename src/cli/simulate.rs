//! `stillcut simulate`.

/// Writes a recording from the simulator.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
