//! What `stillcut diagnose` is given.

use std::path::PathBuf;

/// Says what physics a machine model, or the scenario of a cut, leaves out.
///
/// Example: stillcut diagnose --scenario lathe.toml --recording entry.parquet --cuts cuts.csv --out answer
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// The machine's model: what does the drive leave out?
    #[arg(long, conflicts_with = "scenario", required_unless_present = "scenario")]
    pub(super) model: Option<PathBuf>,
    /// The scenario of a cut: what does the cut leave out?
    #[arg(long)]
    pub(super) scenario: Option<PathBuf>,
    /// A recording of the machine; may be given several times.
    #[arg(long = "recording")]
    pub(super) recordings: Vec<PathBuf>,
    /// A table of cuts (stillcut.cuts/1, Parquet or CSV), beside the recordings or instead of them.
    #[arg(long, requires = "scenario")]
    pub(super) cuts: Option<PathBuf>,
    /// Folder for diagnosis.json, report.html, model.toml (scenario.toml) and the contributions.
    #[arg(long)]
    pub(super) out: PathBuf,
    /// Seconds within which the answer stands: work is counted, so a busy machine answers later, not
    /// differently.
    #[arg(long, value_name = "S", default_value_t = 60.0)]
    pub(super) budget_s: f64,
    /// Print the smallest set of cuts that would tell the alternatives apart.
    #[arg(long, requires = "scenario")]
    pub(super) plan: bool,
    /// Write lines `progress SHARE WHAT` to standard error, for programs that watch.
    #[arg(long)]
    pub(super) progress: bool,
}
