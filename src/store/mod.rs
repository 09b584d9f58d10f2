//! The history: events, past cuts and the audit chain in one SQLite file.
//!
//! One connection writes, owned by one task that commits whatever waits in one transaction with full
//! sync: what is acknowledged survives power loss. Readers have a small read-only pool and page by
//! key, so that no reader keeps the write-ahead log from being checkpointed.

mod ahead;
mod audit;
mod audit_verification;
mod cuts;
mod evidence;
mod mark;
mod open;
mod query;
mod reserve;
mod retention;
mod writer;

pub use audit::{AuditEntry, AuditRow};
pub use audit_verification::{AuditVerdict, verify_audit_file};
pub use cuts::PastCut;
pub use evidence::{Judged, Observation, Observer};
pub use mark::Missing;
pub use open::{Damage, OpenReport, migrations};
pub use query::{EventFilter, EventPage, MAX_PAGE};
pub use retention::{Removed, Retention};
pub use writer::{MakeRoom, StoreWriter, WriterGauges};

use crate::telemetry::Metrics;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous,
};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use thiserror::Error;

/// Name of the history file in the state directory.
pub const FILE_NAME: &str = "history.sqlite";
/// Folder of the recordings beside it.
pub const RECORDINGS: &str = "recordings";
/// Held by the service that writes the history.
pub const LOCK: &str = "service.lock";
/// The files of the history: itself, its log and index, and what stands beside it.
pub const FILES: [&str; 6] =
    [FILE_NAME, "history.sqlite-wal", "history.sqlite-shm", reserve::FILE_NAME, mark::FILE_NAME, LOCK];

/// Why the history cannot be used. One line.
#[derive(Debug, Error)]
pub enum StoreError {
    /// The database refused.
    #[error("{}: {source}", path.display())]
    Database {
        /// File.
        path: PathBuf,
        /// What SQLite said.
        source: sqlx::Error,
    },
    /// The file was written by a later version.
    #[error("{}: schema {found} is newer than this program knows; run the newer version", path.display())]
    NewerSchema {
        /// File.
        path: PathBuf,
        /// First unknown migration.
        found: i64,
    },
    /// The schema cannot be brought up to date.
    #[error("{}: {source}", path.display())]
    Migrate {
        /// File.
        path: PathBuf,
        /// What went wrong.
        source: sqlx::migrate::MigrateError,
    },
    /// A file cannot be moved or made.
    #[error("{}: {source}", path.display())]
    Files {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The writing task has ended.
    #[error("the history is closed")]
    Closed,
}

impl StoreError {
    /// The closed list of codes that metrics and health carry.
    #[must_use]
    pub fn code(&self) -> &'static str {
        match self {
            _ if open::is_whole_check(self) => "corrupt",
            Self::Database { source, .. } => code_of(source),
            Self::Migrate { source: sqlx::migrate::MigrateError::Execute(e), .. } => code_of(e),
            _ => "other",
        }
    }
}

/// The word for SQLite's primary result code (the lowest eight bits of the extended one).
pub(crate) fn code_of(error: &sqlx::Error) -> &'static str {
    if matches!(error, sqlx::Error::Io(e) if e.kind() == std::io::ErrorKind::StorageFull) {
        return "full";
    }
    let code = error.as_database_error().and_then(|e| e.code()).and_then(|c| c.parse::<i64>().ok());
    match code.map(|c| c & 0xff) {
        Some(13) => "full",
        Some(10 | 14 | 8) => "io",
        Some(11) => "corrupt",
        Some(26) => "not_a_database",
        Some(5 | 6) => "busy",
        _ => "other",
    }
}

fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(path)
        .journal_mode(SqliteJournalMode::Wal)
        .synchronous(SqliteSynchronous::Full)
        .busy_timeout(Duration::from_secs(5))
        .foreign_keys(true)
        .pragma("journal_size_limit", "67108864")
        .pragma("trusted_schema", "OFF")
}

/// Readers of the history.
#[derive(Debug, Clone)]
pub struct StoreReader {
    pool: SqlitePool,
    path: PathBuf,
    metrics: Arc<Metrics>,
    /// The first damage that a reader met.
    damage: Arc<OnceLock<String>>,
}

impl StoreReader {
    pub(crate) fn new(path: &Path, metrics: Arc<Metrics>) -> Self {
        let pool = SqlitePoolOptions::new()
            .max_connections(3)
            .acquire_timeout(Duration::from_secs(5))
            .idle_timeout(Duration::from_secs(30))
            .connect_lazy_with(options(path).read_only(true));
        Self { pool, path: path.to_owned(), metrics, damage: Arc::default() }
    }

    /// What readers met that no retry mends; the next start checks the file whole.
    #[must_use]
    pub fn damage(&self) -> Option<&str> {
        self.damage.get().map(String::as_str)
    }

    fn error(&self, source: sqlx::Error) -> StoreError {
        let error = StoreError::Database { path: self.path.clone(), source };
        if open::is_malformed(&error) {
            self.metrics.store_errors.with_label_values(&[error.code()]).inc();
            if self.damage.set(error.to_string()).is_ok() {
                open::mark_suspect(&self.path);
            }
        }
        error
    }

    /// Closes the readers, so that the last checkpoint can end.
    pub async fn close(&self) {
        self.pool.close().await;
    }
}
