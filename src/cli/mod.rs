//! One file per command of the contract; this one picks the command and turns its outcome into an
//! exit status: 0 done, 2 bad input or usage, 1 a fault of ours.

#[cfg(feature = "service")]
mod audit;
mod budget;
mod campaign;
mod completions;
mod conceal;
#[cfg(feature = "service")]
mod demo;
mod diagnose;
mod diagnose_arguments;
mod diagnose_cut;
mod force;
mod gated;
mod identify;
mod import;
#[cfg(feature = "service")]
mod lathe;
mod man;
mod pitch;
mod print_config;
mod print_model;
mod progress;
mod replay;
mod resolution;
#[cfg(feature = "service")]
mod run;
#[cfg(feature = "service")]
mod signals;
mod simulate;
mod stability;
#[cfg(feature = "service")]
mod token;
#[cfg(feature = "nats")]
mod worker;

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use std::io::Write as _;
use std::process::ExitCode;

/// Keeps a lathe from chattering, and says what physics a machine model leaves out.
///
/// Stillcut advises a motion controller; it is not a safety function.
#[derive(Parser)]
#[command(name = "stillcut", version, propagate_version = true)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    #[cfg(feature = "service")]
    Demo(demo::Arguments),
    #[cfg(feature = "service")]
    Run(run::Arguments),
    #[cfg(feature = "service")]
    Lathe(lathe::Arguments),
    Simulate(simulate::Arguments),
    Replay(replay::Arguments),
    Force(force::Arguments),
    Identify(identify::Arguments),
    Resolution(resolution::Arguments),
    Import(import::Arguments),
    Pitch(pitch::Arguments),
    Stability(stability::Arguments),
    Diagnose(diagnose_arguments::Arguments),
    Conceal(conceal::Arguments),
    Campaign(campaign::Arguments),
    PrintConfig(print_config::Arguments),
    PrintModel(print_model::Arguments),
    Completions(completions::Arguments),
    Man(man::Arguments),
    #[cfg(feature = "service")]
    Token(token::Arguments),
    #[cfg(feature = "service")]
    Audit(audit::Arguments),
    #[cfg(feature = "nats")]
    Worker(worker::Arguments),
}

/// A failure that the user can mend: bad input or usage. One line.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub(crate) struct BadInput(pub(crate) String);

/// Turns an error about what was given into [`BadInput`], so that the exit status says so.
pub(crate) fn bad_input(error: impl std::fmt::Display) -> anyhow::Error {
    BadInput(error.to_string()).into()
}

/// A progress bar on a terminal, nothing in a pipe.
pub(crate) fn progress(length: u64, what: &'static str) -> indicatif::ProgressBar {
    use std::io::IsTerminal as _;
    if !std::io::stderr().is_terminal() {
        return indicatif::ProgressBar::hidden();
    }
    let bar = indicatif::ProgressBar::new(length);
    if let Ok(style) = indicatif::ProgressStyle::with_template("{msg} {wide_bar} {percent}% {eta}") {
        bar.set_style(style);
    }
    bar.set_message(what);
    bar
}

/// The error and its causes; a cause that is told already is not told again.
fn in_one_line(error: &anyhow::Error) -> String {
    let join = |text: String, cause: &(dyn std::error::Error + 'static)| {
        let cause = cause.to_string();
        if text.contains(&cause) { text } else { format!("{text}: {cause}") }
    };
    let text = error.chain().skip(1).fold(error.to_string(), join);
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Runs the command named by the process's arguments.
#[must_use]
pub fn main() -> ExitCode {
    // A negative number is a value out of range, not an option that nobody knows.
    let command = Arguments::command().mut_subcommands(|c| c.allow_negative_numbers(true));
    let parsed = command.try_get_matches().and_then(|m| Arguments::from_arg_matches(&m));
    let arguments = match parsed {
        Ok(arguments) => arguments,
        Err(error) => {
            let status = if error.use_stderr() { 2 } else { 0 };
            if status == 0 {
                let _ = error.print();
            } else {
                // One line: the first of clap's message.
                let text = error.to_string();
                let line: Vec<&str> = text
                    .lines()
                    .map(str::trim)
                    .take_while(|l| !l.starts_with("Usage"))
                    .filter(|l| !l.is_empty())
                    .collect();
                use clap::error::ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand as NoCommand;
                let line = match error.kind() {
                    NoCommand => {
                        let audit = std::env::args().any(|a| a == "audit");
                        let example = if audit { "stillcut audit verify" } else { "stillcut demo" };
                        format!("error: a command is missing, such as `{example}`; --help lists all")
                    }
                    _ if !cfg!(feature = "nats") && std::env::args().nth(1).as_deref() == Some("worker") => {
                        "error: worker: this build is without it; expected one with `--features nats`"
                            .to_owned()
                    }
                    _ => line.join(" "),
                };
                let _ = writeln!(std::io::stderr(), "{line}");
            }
            return ExitCode::from(status);
        }
    };
    match dispatch(arguments.command) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let broken_pipe = error
                .downcast_ref::<std::io::Error>()
                .is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe);
            if broken_pipe {
                return ExitCode::SUCCESS;
            }
            let text = in_one_line(&error);
            let _ = writeln!(std::io::stderr(), "error: {text}");
            ExitCode::from(if error.is::<BadInput>() { 2 } else { 1 })
        }
    }
}

fn dispatch(command: Command) -> anyhow::Result<()> {
    match command {
        #[cfg(feature = "service")]
        Command::Demo(a) => demo::run(a),
        #[cfg(feature = "service")]
        Command::Run(a) => run::run(a),
        #[cfg(feature = "service")]
        Command::Lathe(a) => lathe::run(a),
        Command::Simulate(a) => simulate::run(a),
        Command::Replay(a) => replay::run(a),
        Command::Force(a) => force::run(a),
        Command::Identify(a) => identify::run(a),
        Command::Resolution(a) => resolution::run(a),
        Command::Import(a) => import::run(a),
        Command::Pitch(a) => pitch::run(a),
        Command::Stability(a) => stability::run(a),
        Command::Diagnose(a) => diagnose::run(a),
        Command::Conceal(a) => conceal::run(a),
        Command::Campaign(a) => campaign::run(a),
        Command::PrintConfig(a) => print_config::run(a),
        Command::PrintModel(a) => print_model::run(a),
        Command::Completions(a) => completions::run(a),
        Command::Man(a) => man::run(a),
        #[cfg(feature = "service")]
        Command::Token(a) => token::run(a),
        #[cfg(feature = "service")]
        Command::Audit(a) => audit::run(a),
        #[cfg(feature = "nats")]
        Command::Worker(a) => worker::run(a),
    }
}
