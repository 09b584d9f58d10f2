//! How far a long piece of work is: a bar on a terminal, lines for a program that watches.

use crate::diagnosis::Progress;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::Write as _;

/// Runs `work` with a bar on a terminal, and lines for a program that watches.
pub(super) fn with_progress<T>(lines: bool, work: impl FnOnce(Progress<'_>) -> T) -> T {
    let bar = ProgressBar::new(100); // drawn on a terminal only
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {percent:>3} % {msg}") {
        bar.set_style(style);
    }
    let progress = |share: f64, what: &str| {
        bar.set_position((100.0 * share) as u64);
        bar.set_message(what.to_owned());
        if lines {
            // Whoever watched may have gone; the diagnosis goes on.
            let _ = writeln!(std::io::stderr(), "progress {share:.3} {what}");
        }
    };
    let out = work(&progress);
    bar.finish_and_clear();
    out
}
