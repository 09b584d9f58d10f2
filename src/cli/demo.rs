//! `stillcut demo`.

/// Shows the whole system on a virtual lathe.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
