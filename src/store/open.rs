//! Opening the history: damage is set aside, the schema is brought up to date, a copy is kept first.

use super::mark::{Found, Mark, Missing};
use super::query::COLUMNS;
use super::{StoreError, StoreReader, code_of, mark, options, reserve};
use crate::ownership::{existing_file, let_owner_write, own_file};
use sqlx::migrate::{Migration, MigrationType, Migrator};
use sqlx::{Connection as _, Row as _, SqlSafeStr as _, SqliteConnection};
use std::path::{Path, PathBuf};

/// The history file was not usable and was set aside.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// Where the damaged file is now.
    pub moved_to: PathBuf,
    /// What was wrong.
    pub reason: String,
}

/// What opening found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OpenReport {
    /// Number of this start; grows with every start on one state directory.
    pub epoch: i64,
    /// Set when a damaged file was replaced.
    pub damage: Option<Damage>,
    /// Set when an older schema was copied before it was changed.
    pub copy: Option<PathBuf>,
    /// The file is too large to be read whole before the service starts: to be checked behind it.
    pub unchecked: bool,
    /// What was durable in an earlier life and is not there.
    pub missing: Option<Missing>,
    /// Where the log was set aside before it was read, where something is missing.
    pub log_kept: Option<PathBuf>,
    /// What is wrong with the notes of how far it was durable, by file; two where nobody knows any more.
    pub spoilt_notes: Vec<String>,
    /// Number of the last mark that stood beside it.
    pub(super) marked: u64,
}

/// Every migration, oldest first. A test compares the list with the folder.
#[must_use]
pub fn migrations() -> Vec<(i64, &'static str, &'static str)> {
    vec![
        (1, "history", include_str!("../../migrations/0001_history.sql")),
        (2, "audit", include_str!("../../migrations/0002_audit.sql")),
        (3, "outbox", include_str!("../../migrations/0003_outbox.sql")),
        (4, "upkeep", include_str!("../../migrations/0004_upkeep.sql")),
        (5, "missing", include_str!("../../migrations/0005_missing.sql")),
        (6, "commissioning", include_str!("../../migrations/0006_commissioning.sql")),
        (7, "cuts", include_str!("../../migrations/0007_cuts.sql")),
        (8, "growth", include_str!("../../migrations/0008_growth.sql")),
    ]
}

fn migrator() -> Migrator {
    let one = |(version, name, sql): (i64, &'static str, &'static str)| {
        Migration::new(version, name.into(), MigrationType::Simple, sql.into_sql_str(), false)
    };
    Migrator::with_migrations(migrations().into_iter().map(one).collect())
}

/// Opens the writing connection, replacing a damaged file and migrating an older one.
/// `wall_ns` names files and the start. Errors: no access, disk full, newer schema.
pub(super) async fn open(path: &Path, wall_ns: i64) -> Result<(SqliteConnection, OpenReport), StoreError> {
    let Found { mark, spoilt } = Mark::read(path);
    let log = LogCopy::make(path);
    let mut damage = None;
    if is_emptied(path) {
        damage = Some(set_aside(path, wall_ns, "empty, and an earlier life left its traces beside it")?);
    }
    let unchecked = !must_be_checked(path);
    own_files(path)?;
    let (mut connection, copy) = match try_open(path, wall_ns).await {
        Ok(opened) => opened,
        Err(error) if is_damage(&error) => {
            damage = Some(set_aside(path, wall_ns, &error.to_string())?);
            own_files(path)?;
            try_open(path, wall_ns).await?
        }
        Err(error) => return Err(error),
    };
    let fail = |source| StoreError::Database { path: path.to_owned(), source };
    // Notes stand beside it before the first life is on record: where one is and no note is, they are lost.
    let lives = sqlx::query("SELECT count(*) FROM life").fetch_one(&mut connection).await.map_err(fail)?;
    let begun = lives.get::<i64, _>(0) == 0;
    if begun && mark.is_none() {
        Mark::of(&mut connection, 0).await.map_err(fail)?.write_first(path)?;
    }
    // The receiver obeys growing epochs only, and a history that was replaced or restored knows fewer of
    // them: the time in seconds, or one above the last where the clock was set back.
    let insert = "INSERT INTO life (epoch, started_ns, version) \
         SELECT max(?, coalesce(max(epoch), 0) + 1), ?, ? FROM life RETURNING epoch";
    let row = sqlx::query(insert)
        .bind(wall_ns / 1_000_000_000)
        .bind(wall_ns)
        .bind(env!("CARGO_PKG_VERSION"))
        .fetch_one(&mut connection)
        .await;
    let epoch = row.map_err(fail)?.get(0);
    let unchecked = unchecked && damage.is_none();
    let missing = match &mark {
        Some(mark) => mark.missing(&mut connection).await.map_err(fail)?,
        None => None,
    };
    // An earlier version, whose schema was another, kept none.
    let spoilt_notes = if begun || copy.is_some() { Vec::new() } else { spoilt };
    let marked = mark.map_or(0, |m| m.number());
    let log_kept = log.filter(|_| missing.is_some() && damage.is_none()).and_then(|l| l.keep(wall_ns));
    let report = OpenReport { epoch, damage, copy, unchecked, missing, log_kept, spoilt_notes, marked };
    Ok((connection, report))
}

/// The log as the last life left it. SQLite reads it up to the first frame that is not whole and writes over
/// it: what stands behind that frame is nowhere else. Removed when nothing is missing.
struct LogCopy {
    path: PathBuf,
    history: PathBuf,
}

impl LogCopy {
    /// A copy beside the history; nothing where there is no log, it is larger than what is checked whole, or
    /// the disk has no room for it.
    fn make(history: &Path) -> Option<Self> {
        let (log, path) = (suffixed(history, "-wal"), history.with_file_name(".history.log.part"));
        let bytes = std::fs::symlink_metadata(&log).ok().filter(std::fs::Metadata::is_file)?.len();
        if bytes == 0 || bytes > CHECKED_BYTES {
            return None;
        }
        let copy = Self { path, history: history.to_owned() };
        let copied = std::fs::remove_file(&copy.path)
            .or_else(|e| if e.kind() == std::io::ErrorKind::NotFound { Ok(()) } else { Err(e) })
            .and_then(|()| std::fs::copy(&log, &copy.path));
        copied
            .map_err(|error| tracing::warn!(event = "log_copy", "{}: {error}", copy.path.display()))
            .ok()?;
        Some(copy)
    }

    /// Gives it the name of a damaged file, which the upkeep keeps as such.
    fn keep(self, wall_ns: i64) -> Option<PathBuf> {
        let kept = suffixed(&self.history, &format!(".damaged-{wall_ns}.log"));
        std::fs::rename(&self.path, &kept).ok()?;
        Some(kept)
    }
}

impl Drop for LogCopy {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.path); // renamed, or not needed
    }
}

/// Moves what stands in the log into the main file: what the log alone holds, its damage takes away.
/// A disk that refuses is met again by the next write.
pub(super) async fn checkpoint(connection: &mut SqliteConnection) {
    if let Err(error) = sqlx::query("PRAGMA wal_checkpoint(PASSIVE)").execute(connection).await {
        tracing::warn!(event = "checkpoint", "{error}");
    }
}

/// Largest file that is checked whole at every start: a third of a second.
const CHECKED_BYTES: u64 = 32 << 20;

/// The history and its log are this user's own, and others cannot read them. SQLite gives log and index the
/// main file's mode as it was when they were made: a mended main file mends them, too.
/// Errors: a symbolic link, another user's, writable by everybody or not by its owner.
fn own_files(path: &Path) -> Result<(), StoreError> {
    own_file(path).map_err(|source| StoreError::Files { path: path.to_owned(), source })?;
    for suffix in ["-wal", "-shm"] {
        let path = suffixed(path, suffix);
        let own = let_owner_write(&path).and_then(|()| existing_file(&path));
        own.map_err(|source| StoreError::Files { path, source })?;
    }
    Ok(())
}

pub(super) fn suffixed(path: &Path, suffix: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(suffix);
    PathBuf::from(name)
}

/// Stands beside a history in which damage was seen: the next start checks it whole, however large it is.
fn suspect(path: &Path) -> PathBuf {
    suffixed(path, ".suspect")
}

/// Notes that damage was seen. A disk that refuses this too shows it again at the next start.
pub(super) fn mark_suspect(path: &Path) {
    if let Err(error) = std::fs::write(suspect(path), "damage was seen; checked whole at the next start\n") {
        tracing::warn!(event = "suspect", "{}: {error}", suspect(path).display());
    }
}

fn must_be_checked(path: &Path) -> bool {
    let bytes = |suffix: &str| std::fs::metadata(suffixed(path, suffix)).map_or(0, |m| m.len());
    suspect(path).exists() || bytes("") + bytes("-wal") <= CHECKED_BYTES
}

/// Reads every page. Errors: damage, or no access.
pub(super) async fn check_whole(connection: &mut SqliteConnection) -> Result<(), sqlx::Error> {
    let row = sqlx::query("PRAGMA quick_check(1)").fetch_one(connection).await?;
    let verdict: String = row.try_get(0)?;
    if verdict == "ok" {
        return Ok(());
    }
    Err(sqlx::Error::Protocol(format!("{QUICK_CHECK}: {}", verdict.replace('\n', "; "))))
}

impl StoreReader {
    /// Reads every page of the file; the next start checks it again where this finds damage.
    /// Errors: damage, or no access.
    pub async fn check_whole(&self) -> Result<(), StoreError> {
        let mut connection = self.pool.acquire().await.map_err(|e| self.error(e))?;
        check_whole(&mut connection).await.map_err(|e| self.error(e))
    }
}

/// Whether the file is empty and was not always: its log, a reserve or recordings tell of an earlier life.
fn is_emptied(path: &Path) -> bool {
    let length = |path: &Path| std::fs::metadata(path).map_or(0, |m| m.len());
    let recordings = std::fs::read_dir(path.with_file_name(super::RECORDINGS));
    path.metadata().is_ok_and(|m| m.len() == 0)
        && (length(&suffixed(path, "-wal")) > 0
            || has_notes(path)
            || recordings.is_ok_and(|mut files| files.next().is_some()))
}

fn has_notes(path: &Path) -> bool {
    [reserve::FILE_NAME, mark::FILE_NAME].iter().any(|name| path.with_file_name(name).exists())
}

async fn try_open(path: &Path, wall_ns: i64) -> Result<(SqliteConnection, Option<PathBuf>), StoreError> {
    let fail = |source| StoreError::Database { path: path.to_owned(), source };
    let mut connection =
        SqliteConnection::connect_with(&options(path).create_if_missing(true)).await.map_err(fail)?;
    match bring_up(&mut connection, path, wall_ns).await {
        Ok(copy) => Ok((connection, copy)),
        Err(error) => {
            // Closing removes the log by its name: not when another file has that name.
            let _ = connection.close().await;
            Err(error)
        }
    }
}

/// Checks the file and brings its schema up to date; answers the copy made before.
async fn bring_up(
    connection: &mut SqliteConnection,
    path: &Path,
    wall_ns: i64,
) -> Result<Option<PathBuf>, StoreError> {
    let fail = |source| StoreError::Database { path: path.to_owned(), source };
    if must_be_checked(path) {
        check_whole(connection).await.map_err(fail)?;
        let _ = std::fs::remove_file(suspect(path)); // it was found whole
    }
    let applied = applied_versions(connection).await.map_err(fail)?;
    let known = migrations();
    if let Some(found) = applied.iter().find(|v| !known.iter().any(|(k, _, _)| k == *v)) {
        return Err(StoreError::NewerSchema { path: path.to_owned(), found: *found });
    }
    let copy = if !applied.is_empty() && applied.len() < known.len() {
        let name = format!("history.before-{}-{wall_ns}.sqlite", known.len());
        // Whole or not at all: a process that is killed meanwhile leaves no half copy under that name.
        let (part, target) = (path.with_file_name(format!(".{name}.part")), path.with_file_name(name));
        let text = part.to_string_lossy().into_owned();
        sqlx::query("VACUUM INTO ?").bind(text).execute(&mut *connection).await.map_err(fail)?;
        std::fs::rename(&part, &target).map_err(|source| StoreError::Files { path: part, source })?;
        Some(target)
    } else {
        None
    };
    let outcome = migrator().run_direct(None, &mut *connection, false).await;
    outcome.map_err(|source| StoreError::Migrate { path: path.to_owned(), source })?;
    for (columns, table) in USED {
        let select = sqlx::AssertSqlSafe(format!("SELECT {columns} FROM {table} LIMIT 0"));
        sqlx::query(select).fetch_all(&mut *connection).await.map_err(fail)?;
    }
    Ok(copy)
}

/// What the program uses of every table. That a migration was applied says nothing of what somebody did to
/// its tables since.
const USED: [(&str, &str); 6] = [
    (COLUMNS, "event"),
    ("epoch, started_ns, version, settings", "life"),
    ("sequence, wall_ns, actor, role, action, detail, hash", "audit"),
    ("sink, confirmed", "outbox"),
    ("one, sequence, hash", "audit_begin"),
    ("epoch, machine, started_ns, observed_s, cuts, advised, compared, mismatches", "observation"),
];

const QUICK_CHECK: &str = "quick_check";

async fn applied_versions(connection: &mut SqliteConnection) -> Result<Vec<i64>, sqlx::Error> {
    let exists = "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = '_sqlx_migrations'";
    let count: i64 = sqlx::query(exists).fetch_one(&mut *connection).await?.try_get(0)?;
    if count == 0 {
        return Ok(Vec::new());
    }
    let rows =
        sqlx::query("SELECT version FROM _sqlx_migrations ORDER BY version").fetch_all(connection).await?;
    rows.iter().map(|r| r.try_get(0)).collect()
}

/// True where the check of the whole file found damage.
pub(super) fn is_whole_check(error: &StoreError) -> bool {
    matches!(error, StoreError::Database { source: sqlx::Error::Protocol(text), .. }
        if text.starts_with(QUICK_CHECK))
}

/// True for pages that are no longer what SQLite wrote.
pub(super) fn is_malformed(error: &StoreError) -> bool {
    let of_sqlite = |source| matches!(code_of(source), "corrupt" | "not_a_database");
    is_whole_check(error) || matches!(error, StoreError::Database { source, .. } if of_sqlite(source))
}

/// True for what no retry mends: malformed pages, another format, a schema that was tampered with.
pub(super) fn is_damage(error: &StoreError) -> bool {
    match error {
        StoreError::Database { source, .. } => is_malformed(error) || is_wrong_schema(source),
        StoreError::Migrate { source, .. } => match source {
            sqlx::migrate::MigrateError::Execute(e) | sqlx::migrate::MigrateError::ExecuteMigration(e, _) => {
                matches!(code_of(e), "corrupt" | "not_a_database") || is_wrong_schema(e)
            }
            sqlx::migrate::MigrateError::VersionMismatch(_) | sqlx::migrate::MigrateError::Dirty(_) => true,
            _ => false,
        },
        _ => false,
    }
}

/// SQLite's general error 1: a table is there that should not be, or lacks what it should have.
fn is_wrong_schema(error: &sqlx::Error) -> bool {
    let code = error.as_database_error().and_then(|e| e.code());
    code.as_deref() == Some("1")
        || matches!(error, sqlx::Error::ColumnDecode { .. } | sqlx::Error::ColumnNotFound(_))
}

/// Renames the file with its log and index, so that nothing of it is read again or lost.
fn set_aside(path: &Path, wall_ns: i64, reason: &str) -> Result<Damage, StoreError> {
    let moved_to = suffixed(path, &format!(".damaged-{wall_ns}"));
    for suffix in ["", "-wal", "-shm", ".suspect"] {
        let from = suffixed(path, suffix);
        match std::fs::rename(&from, suffixed(&moved_to, suffix)) {
            Ok(()) => {}
            // Log and index come and go with SQLite's last connection.
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => {}
            Err(source) => return Err(StoreError::Files { path: from, source }),
        }
    }
    Ok(Damage { moved_to, reason: reason.to_owned() })
}
