//! `stillcut man`.

use clap::CommandFactory as _;
use clap_mangen::Man;
use clap_mangen::roff::{Roff, roman};
use std::io::Write as _;

/// Prints the manual page, all commands in one.
///
/// Example: stillcut man | man -l -
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    let mut command = super::Arguments::command();
    command.build();
    let page = Man::new(command.clone()).manual("Stillcut");
    let mut text = Vec::new();
    page.render_title(&mut text)?;
    page.render_name_section(&mut text)?;
    page.render_synopsis_section(&mut text)?;
    page.render_description_section(&mut text)?;
    page.render_options_section(&mut text)?;
    for command in command.get_subcommands().filter(|c| c.get_name() != "help") {
        let said_above = |a: clap::Arg| {
            let hidden = ["help", "version"].contains(&a.get_id().as_str());
            if hidden { a.hide(true) } else { a }
        };
        let page = Man::new(command.clone().mut_args(said_above));
        let name = command.get_bin_name().unwrap_or(command.get_name()).to_uppercase();
        Roff::new().control("SH", [name.as_str()]).to_writer(&mut text)?;
        // The parts of a command are sections of their own elsewhere; here they follow one another.
        let mut parts = Vec::new();
        page.render_description_section(&mut parts)?;
        page.render_options_section(&mut parts)?;
        let parts = String::from_utf8_lossy(&parts);
        for line in parts.lines().filter(|l| !l.starts_with(".ie") && !l.starts_with(".el")) {
            match line.strip_prefix(".SH ") {
                Some("DESCRIPTION") => {}
                Some(title) => writeln!(text, ".SS {title}")?,
                None => writeln!(text, "{line}")?,
            }
        }
    }
    let status = "0: done. 1: a fault of ours, or one that may pass. 2: bad input or usage; one line says \
         what and where.";
    Roff::new().control("SH", ["EXIT STATUS"]).text([roman(status)]).to_writer(&mut text)?;
    Ok(std::io::stdout().write_all(&text)?)
}
