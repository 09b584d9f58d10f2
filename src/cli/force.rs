//! `stillcut force`.

/// Estimates cutting force from servo signals or accelerometers.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
