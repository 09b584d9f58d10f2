//! `stillcut lathe`.

/// Runs the virtual lathe alone, over shared memory.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
