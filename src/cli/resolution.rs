//! `stillcut resolution`.

/// Gives the force variance caused by encoder quantization.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
