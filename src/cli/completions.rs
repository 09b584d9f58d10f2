//! `stillcut completions`.

use clap::CommandFactory as _;
use std::io::Write as _;

/// Prints what a shell needs to complete the commands and their options.
///
/// Example: stillcut completions bash > /etc/bash_completion.d/stillcut
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The shell.
    shell: clap_complete::Shell,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(arguments.shell, &mut super::Arguments::command(), "stillcut", &mut text);
    Ok(std::io::stdout().write_all(&text)?)
}
