//! Verifying the audit chain of a history file, beside the mark of how far it was durable.

use super::StoreError;
use super::audit::{CUT, PRUNED, SELECT, chain_begin, chain_hash, hex, row};
use super::mark::{Found, Mark, Missing};
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{Connection as _, SqliteConnection};
use std::io::{Error, ErrorKind};
use std::path::Path;

/// What verification found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AuditVerdict {
    /// All rows follow from one another; the head is the hash of the last.
    Intact {
        /// Number of rows.
        rows: i64,
        /// Hash of the last row, hexadecimal; keep it elsewhere to notice a cut tail.
        head: String,
        /// What rows of the chain say of rows that went missing before them.
        cuts: Vec<String>,
        /// What is wrong with the notes beside the file of how far it was durable; two where nobody knows.
        spoilt_notes: Vec<String>,
    },
    /// The first row that does not follow from the one before it.
    Broken {
        /// Its place.
        sequence: i64,
    },
    /// All rows follow from one another, but the head that was noted earlier is not among them.
    HeadMissing {
        /// Number of rows.
        rows: i64,
    },
    /// All rows follow from one another, but the service had noted more, or others, outside of the file.
    Cut(Missing),
}

/// Reads the whole chain of a history file and says where it breaks, if it does. `noted`: a head of
/// earlier, which must be among the rows: a chain whose end was cut off is intact in itself. The mark beside
/// the file is compared, too, also where there is no file, or nothing in it.
/// Errors: no file is there and no mark, or it cannot be read.
pub async fn verify_audit_file(path: &Path, noted: Option<&str>) -> Result<AuditVerdict, StoreError> {
    let fail = |source| StoreError::Database { path: path.to_owned(), source };
    // Before the rows: the service may be writing.
    let Found { mark, spoilt: spoilt_notes } = Mark::read(path);
    if !path.is_file() {
        let what = "no history there; expected the history.folder of a service that has run";
        let absent =
            || StoreError::Files { path: path.to_owned(), source: Error::new(ErrorKind::NotFound, what) };
        return mark.map(|mark| AuditVerdict::Cut(mark.all_missing())).ok_or_else(absent);
    }
    let connect =
        SqliteConnection::connect_with(&SqliteConnectOptions::new().filename(path).read_only(true)).await;
    let mut connection = connect.map_err(fail)?;
    if let Some(mark) = &mark {
        let table = sqlx::query("SELECT 1 FROM sqlite_schema WHERE name = 'audit'");
        if table.fetch_optional(&mut connection).await.map_err(fail)?.is_none() {
            return Ok(AuditVerdict::Cut(mark.all_missing()));
        }
    }
    let begin = chain_begin(&mut connection).await.map_err(fail)?;
    let (mut last, mut previous) = begin.clone().unwrap_or_default();
    // Where older rows were removed, a row of the chain says so.
    let (mut noted_seen, mut begin_seen) = (noted.is_none(), begin.is_none());
    let mut cuts = Vec::new();
    loop {
        let rows = sqlx::query(SELECT).bind(last).fetch_all(&mut connection).await.map_err(fail)?;
        if rows.is_empty() {
            break;
        }
        for r in &rows {
            let (found, hash) = row(r).map_err(fail)?;
            let follows =
                found.sequence == last + 1 && chain_hash(&previous, found.sequence, &found.entry) == hash;
            if !follows {
                return Ok(AuditVerdict::Broken { sequence: found.sequence });
            }
            begin_seen = begin_seen
                || found.entry.action == PRUNED
                    && begin.as_ref().is_some_and(|(_, h)| found.entry.detail.ends_with(&hex(h)));
            noted_seen = noted_seen || noted.is_some_and(|n| n.eq_ignore_ascii_case(&hex(&hash)));
            if found.entry.action == CUT {
                cuts.push(format!("row {}: {}", found.sequence, found.entry.detail));
            }
            (last, previous) = (found.sequence, hash);
        }
    }
    if !begin_seen {
        return Ok(AuditVerdict::Broken { sequence: begin.map_or(1, |(sequence, _)| sequence + 1) });
    }
    if !noted_seen {
        return Ok(AuditVerdict::HeadMissing { rows: last });
    }
    if let Some(mark) = mark
        && let Some(missing) = mark.missing(&mut connection).await.map_err(fail)?
    {
        return Ok(AuditVerdict::Cut(missing));
    }
    Ok(AuditVerdict::Intact { rows: last, head: hex(&previous), cuts, spoilt_notes })
}
