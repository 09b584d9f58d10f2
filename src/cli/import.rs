//! `stillcut import`.

/// Turns a foreign CSV, Parquet or MAT file into a recording.
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    anyhow::bail!("being built")
}
