//! `stillcut print-config`.

use std::io::Write as _;

/// Prints every setting of the service with its default, unit and meaning.
///
/// The output is a valid configuration: stillcut print-config > stillcut.toml
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    std::io::stdout().write_all(crate::config::service::DEFAULT_TEXT.as_bytes())?;
    Ok(())
}
