//! `stillcut print-model`.

use std::io::Write as _;

/// A machine to start from: what is needed, and everything else as comments.
const START: &str = include_str!("../../config/machine.toml");

/// Prints a commented machine model to start from; what is left out of it is estimated.
///
/// The output is a valid model: stillcut print-model > machine.toml
#[derive(clap::Args)]
pub(super) struct Arguments {}

pub(super) fn run(_arguments: Arguments) -> anyhow::Result<()> {
    std::io::stdout().write_all(START.as_bytes())?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::START;
    use crate::config::machine::machine_from_text;
    use std::path::Path;

    #[test]
    fn what_is_printed_is_a_model() {
        let machine = machine_from_text(Path::new("machine.toml"), START).unwrap();
        assert_eq!(machine.axes.len(), 1);
    }

    #[test]
    fn so_it_is_with_every_comment_taken_away() {
        // A line that holds a key or a table; sentences do not.
        let is_setting = |line: &str| {
            line.starts_with('[')
                || line.split(" = ").next().is_some_and(|key| {
                    key.len() < line.len()
                        && !key.is_empty()
                        && key.chars().all(|c| c.is_ascii_lowercase() || c == '_' || c.is_ascii_digit())
                })
        };
        let bare = |line: &str| line.strip_prefix("# ").filter(|l| is_setting(l)).unwrap_or(line).to_owned();
        let full: Vec<String> = START.lines().map(bare).collect();
        let machine = machine_from_text(Path::new("machine.toml"), &full.join("\n")).unwrap();
        let axis = &machine.axes[0];
        assert!(axis.controller.is_some() && axis.physics.len() == 1, "{full:#?}");
        assert_eq!(axis.drive.axial_stiffness_n_m(), 5.0e7);
    }
}
