//! `stillcut conceal`.

/// Judges the diagnosis blind on simulated machines with a hidden effect.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
