//! `stillcut pitch`.

/// Gives the optimum pitch angle difference.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
