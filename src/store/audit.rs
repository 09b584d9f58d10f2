//! The audit chain: each row's hash covers the row before it.

use super::StoreError;
use sha2::{Digest as _, Sha256};
use sqlx::{Row as _, SqliteConnection};

/// A write that somebody made or was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditEntry {
    /// Wall clock, ns since 1970.
    pub wall_ns: i64,
    /// Name of the token, or what stands for it.
    pub actor: String,
    /// Role of the actor.
    pub role: String,
    /// What was asked for.
    pub action: String,
    /// With what, and why.
    pub detail: String,
}

/// An entry in its place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AuditRow {
    /// Place, from 1 without holes.
    pub sequence: i64,
    /// What it says.
    pub entry: AuditEntry,
}

/// SHA-256 over the previous hash and each field with its length, so that no two rows read the same.
pub(super) fn chain_hash(previous: &[u8], sequence: i64, entry: &AuditEntry) -> Vec<u8> {
    let mut hash = Sha256::new();
    hash.update(previous);
    hash.update(sequence.to_be_bytes());
    hash.update(entry.wall_ns.to_be_bytes());
    for text in [&entry.actor, &entry.role, &entry.action, &entry.detail] {
        hash.update((text.len() as u64).to_be_bytes());
        hash.update(text.as_bytes());
    }
    hash.finalize().to_vec()
}

pub(super) async fn append(
    connection: &mut SqliteConnection,
    entry: &AuditEntry,
) -> Result<i64, sqlx::Error> {
    let last = sqlx::query("SELECT sequence, hash FROM audit ORDER BY sequence DESC LIMIT 1");
    let (sequence, previous) = match last.fetch_optional(&mut *connection).await? {
        Some(row) => (row.try_get::<i64, _>(0)? + 1, row.try_get::<Vec<u8>, _>(1)?),
        None => (1, Vec::new()),
    };
    let hash = chain_hash(&previous, sequence, entry);
    let insert = "INSERT INTO audit (sequence, wall_ns, actor, role, action, detail, hash) \
         VALUES (?, ?, ?, ?, ?, ?, ?)";
    let query = sqlx::query(insert).bind(sequence).bind(entry.wall_ns).bind(&entry.actor).bind(&entry.role);
    query.bind(&entry.action).bind(&entry.detail).bind(hash).execute(connection).await?;
    Ok(sequence)
}

/// Place and hash of the last row; where there is none, of the last one that the retention removed.
pub(super) async fn chain_end(connection: &mut SqliteConnection) -> Result<(i64, Vec<u8>), sqlx::Error> {
    let last = sqlx::query("SELECT sequence, hash FROM audit ORDER BY sequence DESC LIMIT 1");
    match last.fetch_optional(&mut *connection).await? {
        Some(row) => Ok((row.try_get(0)?, row.try_get(1)?)),
        None => Ok(chain_begin(connection).await?.unwrap_or_default()),
    }
}

/// Hash of one row, where it is there.
pub(super) async fn hash_at(
    connection: &mut SqliteConnection,
    sequence: i64,
) -> Result<Option<Vec<u8>>, sqlx::Error> {
    let row = sqlx::query("SELECT hash FROM audit WHERE sequence = ?").bind(sequence);
    row.fetch_optional(connection).await?.map(|r| r.try_get(0)).transpose()
}

/// Action of the row that says that durable ones are missing.
pub(super) const CUT: &str = "history_cut";
/// Action of the row that says that older ones were removed.
pub(super) const PRUNED: &str = "audit_pruned";
/// Rows removed at once.
const PRUNE_ROWS: i64 = 10_000;

/// Last row that was removed and its hash, where the retention removed any.
pub(super) async fn chain_begin(
    connection: &mut SqliteConnection,
) -> Result<Option<(i64, Vec<u8>)>, sqlx::Error> {
    let exists = "SELECT count(*) FROM sqlite_master WHERE name = 'audit_begin'";
    let count: i64 = sqlx::query(exists).fetch_one(&mut *connection).await?.try_get(0)?;
    if count == 0 {
        return Ok(None); // a history of an earlier version
    }
    let row = sqlx::query("SELECT sequence, hash FROM audit_begin").fetch_optional(connection).await?;
    row.map(|r| Ok((r.try_get(0)?, r.try_get(1)?))).transpose()
}

/// Removes the oldest rows beyond `keep`; the chain then begins behind them, and a row of it says so.
/// Answers how many went.
pub(super) async fn prune(
    connection: &mut SqliteConnection,
    keep: u64,
    now_ns: i64,
) -> Result<u64, sqlx::Error> {
    let ends = "SELECT coalesce(min(sequence), 1), coalesce(max(sequence), 0) FROM audit";
    let row = sqlx::query(ends).fetch_one(&mut *connection).await?;
    let (first, last): (i64, i64) = (row.try_get(0)?, row.try_get(1)?);
    let keep = i64::try_from(keep).unwrap_or(i64::MAX);
    let surplus = (last - first + 1).saturating_sub(keep);
    // One row is added for what is removed: a surplus of one would never end.
    if surplus <= 1 {
        return Ok(0);
    }
    let cut = first + surplus.min(PRUNE_ROWS) - 1;
    let hash = sqlx::query("SELECT hash FROM audit WHERE sequence = ?").bind(cut);
    let hash: Vec<u8> = hash.fetch_one(&mut *connection).await?.try_get(0)?;
    let detail =
        format!("rows up to {cut} were removed by the retention; the last had the hash {}", hex(&hash));
    let entry = AuditEntry {
        wall_ns: now_ns,
        actor: "service".into(),
        role: "service".into(),
        action: PRUNED.into(),
        detail,
    };
    append(connection, &entry).await?;
    let begin = "INSERT INTO audit_begin (one, sequence, hash) VALUES (1, ?, ?) \
         ON CONFLICT (one) DO UPDATE SET sequence = excluded.sequence, hash = excluded.hash";
    sqlx::query(begin).bind(cut).bind(hash).execute(&mut *connection).await?;
    let removed = sqlx::query("DELETE FROM audit WHERE sequence <= ?").bind(cut).execute(connection).await?;
    Ok(removed.rows_affected())
}

pub(super) fn row(row: &sqlx::sqlite::SqliteRow) -> Result<(AuditRow, Vec<u8>), sqlx::Error> {
    let entry = AuditEntry {
        wall_ns: row.try_get("wall_ns")?,
        actor: row.try_get("actor")?,
        role: row.try_get("role")?,
        action: row.try_get("action")?,
        detail: row.try_get("detail")?,
    };
    Ok((AuditRow { sequence: row.try_get("sequence")?, entry }, row.try_get("hash")?))
}

pub(super) const SELECT: &str = "SELECT sequence, wall_ns, actor, role, action, detail, hash FROM audit \
     WHERE sequence > ? ORDER BY sequence LIMIT 1000";

pub(super) fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

impl super::StoreReader {
    /// Audit rows after `after`, oldest first, at most 1000. Errors: the database's.
    pub async fn audit(&self, after: i64) -> Result<Vec<AuditRow>, StoreError> {
        let rows = sqlx::query(SELECT).bind(after).fetch_all(&self.pool).await.map_err(|e| self.error(e))?;
        rows.iter().map(|r| row(r).map(|(a, _)| a)).collect::<Result<_, _>>().map_err(|e| self.error(e))
    }
}
