//! What the history keeps, and what goes first.

use super::query::OPEN_ALARM;
use sqlx::{Row as _, SqliteConnection};

/// What the history keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Retention {
    /// Events and past cuts older than this go.
    pub max_age_ns: i64,
    /// The oldest events go while the file is larger.
    pub max_bytes: u64,
    /// The oldest rows of the audit record go beyond this many.
    pub audit_rows: u64,
    /// Events wait for the sink outside before they go.
    pub outbox: bool,
}

/// What a look at the retention removed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Removed {
    /// Events, for their age.
    pub aged: u64,
    /// Events, because the file was too large.
    pub oversize: u64,
    /// Events that waited for a person or for the sink, because nothing else was left to remove.
    pub forced: u64,
    /// Rows of the audit record.
    pub audit: u64,
}

impl Removed {
    /// Whether there was as much as is removed at once: there may be more.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.oversize.max(self.forced) >= PRUNE_CHUNK.unsigned_abs()
    }
}

/// Events removed for their age at once: a clock that is wrong at the start costs little until it is set
/// right.
const PRUNE_AGED: i64 = 1000;
/// Events removed at once while the file is too large.
const PRUNE_CHUNK: i64 = 10_000;

/// Removes by age and by size what no person and no sink waits for; beyond a quarter more than the size asked
/// for, what is oldest.
pub(super) async fn prune(
    connection: &mut SqliteConnection,
    now_ns: i64,
    keep: Retention,
) -> Result<Removed, sqlx::Error> {
    let mut removed = Removed {
        audit: super::audit::prune(connection, keep.audit_rows, now_ns).await?,
        ..Removed::default()
    };
    let sent = match keep.outbox {
        true => {
            let least = sqlx::query("SELECT coalesce(min(confirmed), 0) FROM outbox");
            least.fetch_one(&mut *connection).await?.try_get(0)?
        }
        false => i64::MAX,
    };
    let free = format!("sequence <= ? AND NOT ({OPEN_ALARM})");
    let delete = |which: &str| {
        let text =
            format!("DELETE FROM event WHERE sequence IN (SELECT sequence FROM event WHERE {which} LIMIT ?)");
        sqlx::query(sqlx::AssertSqlSafe(text))
    };
    let aged = delete(&format!("{free} AND wall_ns < ? ORDER BY wall_ns"));
    let aged = aged.bind(sent).bind(now_ns.saturating_sub(keep.max_age_ns)).bind(PRUNE_AGED);
    removed.aged = aged.execute(&mut *connection).await?.rows_affected();
    super::cuts::prune(connection, now_ns.saturating_sub(keep.max_age_ns)).await?;
    let used = used_bytes(connection).await?;
    if used > keep.max_bytes {
        let oldest = delete(&format!("{free} ORDER BY sequence")).bind(sent).bind(PRUNE_CHUNK);
        removed.oversize = oldest.execute(&mut *connection).await?.rows_affected();
    }
    if removed.aged + removed.oversize == 0 && used > keep.max_bytes.saturating_add(keep.max_bytes / 4) {
        let oldest = delete("TRUE ORDER BY sequence").bind(PRUNE_CHUNK);
        removed.forced = oldest.execute(&mut *connection).await?.rows_affected();
    }
    Ok(removed)
}

async fn used_bytes(connection: &mut SqliteConnection) -> Result<u64, sqlx::Error> {
    let size = "SELECT (page_count - freelist_count) * page_size \
         FROM pragma_page_count, pragma_freelist_count, pragma_page_size";
    let used: i64 = sqlx::query(size).fetch_one(connection).await?.try_get(0)?;
    Ok(u64::try_from(used).unwrap_or(0))
}
