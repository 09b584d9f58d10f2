//! `stillcut audit`.

use super::bad_input;
use crate::config::service::{ServiceConfig, read_service_config};
use crate::store::{AuditVerdict, FILE_NAME, verify_audit_file};
use crate::units::counted;
use std::io::Write as _;
use std::path::PathBuf;

/// Checks the audit record: every row's hash covers the row before it.
#[derive(clap::Args)]
#[command(after_help = "Example: stillcut audit verify --config /etc/stillcut/stillcut.toml")]
pub(super) struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    /// Reads the whole chain; says where it breaks, with status 1 when it does.
    Verify {
        /// Configuration that names the folder of the history.
        #[arg(long, value_name = "FILE", conflicts_with = "history")]
        config: Option<PathBuf>,
        /// History file itself.
        #[arg(long, value_name = "FILE")]
        history: Option<PathBuf>,
        /// Hash of the last row as it was noted earlier: notices a cut-off end.
        #[arg(long)]
        head: Option<String>,
    },
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let What::Verify { config, history, head } = arguments.what;
    if let Some(head) = head.as_ref().filter(|h| h.len() != 64 || !h.bytes().all(|b| b.is_ascii_hexdigit())) {
        let what = "expected the 64 hexadecimal digits that an earlier `audit verify` printed";
        return Err(bad_input(format!("--head `{}`: {what}", head.escape_debug())));
    }
    let head = head.map(|h| h.to_ascii_lowercase());
    let elsewhere = history.is_some();
    let path = match (history, config) {
        (Some(path), _) => path,
        (None, Some(config)) => {
            read_service_config(&config).map_err(bad_input)?.history.folder.join(FILE_NAME)
        }
        (None, None) => ServiceConfig::default().history.folder.join(FILE_NAME),
    };
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let report = runtime.block_on(verify_audit_file(&path, head.as_deref())).map_err(bad_input)?;
    match report {
        // A copy elsewhere has no notes beside it; one without the other is a loss anywhere.
        AuditVerdict::Intact { rows, head, cuts, spoilt_notes }
            if cuts.is_empty() && (spoilt_notes.is_empty() || elsewhere && spoilt_notes.len() > 1) =>
        {
            let alone = "; no note beside it says how many there were";
            let note = if spoilt_notes.is_empty() { "" } else { alone };
            writeln!(std::io::stdout(), "intact: {}, head {head}{note}", counted(rows, "row"))?;
            Ok(())
        }
        AuditVerdict::Intact { rows, head, cuts, spoilt_notes } if cuts.is_empty() => {
            let what = spoilt_notes.join(", ");
            anyhow::bail!(
                "{}: what is there follows from one another ({}), head {head}; \
                 the note of how many there were: {what}",
                path.display(),
                counted(rows, "row")
            )
        }
        AuditVerdict::Intact { rows, cuts, .. } => {
            anyhow::bail!(
                "{}: what is there follows from one another ({}), but not all is; {}",
                path.display(),
                counted(rows, "row"),
                cuts.join("; ")
            )
        }
        AuditVerdict::Cut(missing) => anyhow::bail!("{}: {}", path.display(), missing.sentence()),
        AuditVerdict::Broken { sequence } => {
            anyhow::bail!("{}: the audit record is broken at row {sequence}", path.display())
        }
        AuditVerdict::HeadMissing { rows } => {
            anyhow::bail!(
                "{}: the noted head is nowhere in it ({}): the end was cut off",
                path.display(),
                counted(rows, "row")
            )
        }
    }
}
