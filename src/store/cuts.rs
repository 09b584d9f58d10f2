//! The table of past cuts: what a diagnosis of the cut starts from (contracts, section 6).

use super::{StoreError, StoreReader};
use sqlx::sqlite::SqliteRow;
use sqlx::{Row as _, SqliteConnection};

/// One stretch of a cut at one speed and one pitch.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PastCut {
    /// Place in the table, from 1; 0 before it is stored.
    pub sequence: i64,
    /// Unique name, given where it was heard: storing it twice stores it once.
    pub id: String,
    /// When it began, ns since 1970 UTC.
    pub began_ns: i64,
    /// How long it lasted, s.
    pub lasted_s: f64,
    /// Spindle speed, rpm.
    pub spindle_speed_rpm: f64,
    /// Width of cut per tool as the configuration states it, m.
    pub width_m: f64,
    /// Feed per turn as the configuration states it, m.
    pub feed_m_rev: f64,
    /// Pitch angle difference, rad.
    pub pitch_difference_rad: f64,
    /// Tools from the chuck, where an axis of the stream tells it: where a stable cut was farthest, and where
    /// chatter began, m.
    pub tool_position_m: Option<f64>,
    /// It chattered.
    pub chattered: bool,
    /// Chatter frequency; of a stable cut the line that dies out slowest, where its margin was read, Hz.
    pub line_hz: Option<f64>,
    /// Growth of that line and its standard error, 1/s: of a stable cut minus its stability margin.
    pub growth_1_s: Option<[f64; 2]>,
}

/// Words of the column `outcome` (contracts, section 6).
const CHATTER: &str = "chatter";
const STABLE: &str = "stable";

impl PastCut {
    /// `chatter` or `stable`.
    #[must_use]
    pub fn outcome(&self) -> &'static str {
        if self.chattered { CHATTER } else { STABLE }
    }
}

/// Stores it once.
pub(super) async fn insert(connection: &mut SqliteConnection, cut: &PastCut) -> Result<(), sqlx::Error> {
    let text = "INSERT INTO cut (id, began_ns, lasted_s, spindle_speed_rpm, width_m, feed_m_rev, \
         tool_position_m, pitch_difference_rad, outcome, line_hz, growth_1_s, growth_se_1_s) \
         VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) DO NOTHING";
    let query = sqlx::query(text).bind(&cut.id).bind(cut.began_ns).bind(cut.lasted_s);
    let query = query.bind(cut.spindle_speed_rpm).bind(cut.width_m).bind(cut.feed_m_rev);
    let query = query.bind(cut.tool_position_m);
    let query = query.bind(cut.pitch_difference_rad).bind(cut.outcome()).bind(cut.line_hz);
    let query = query.bind(cut.growth_1_s.map(|g| g[0])).bind(cut.growth_1_s.map(|g| g[1]));
    query.execute(connection).await.map(|_| ())
}

/// Removes what is older than that.
pub(super) async fn prune(connection: &mut SqliteConnection, before_ns: i64) -> Result<(), sqlx::Error> {
    let old = sqlx::query("DELETE FROM cut WHERE began_ns < ?").bind(before_ns);
    old.execute(connection).await.map(|_| ())
}

fn cut_from_row(row: &SqliteRow) -> Result<PastCut, sqlx::Error> {
    let outcome: String = row.try_get("outcome")?;
    let growth: Option<f64> = row.try_get("growth_1_s")?;
    let error: Option<f64> = row.try_get("growth_se_1_s")?;
    Ok(PastCut {
        sequence: row.try_get("sequence")?,
        id: row.try_get("id")?,
        began_ns: row.try_get("began_ns")?,
        lasted_s: row.try_get("lasted_s")?,
        spindle_speed_rpm: row.try_get("spindle_speed_rpm")?,
        width_m: row.try_get("width_m")?,
        feed_m_rev: row.try_get("feed_m_rev")?,
        pitch_difference_rad: row.try_get("pitch_difference_rad")?,
        tool_position_m: row.try_get("tool_position_m")?,
        chattered: outcome == CHATTER,
        line_hz: row.try_get("line_hz")?,
        growth_1_s: growth.zip(error).map(|(growth, error)| [growth, error]),
    })
}

impl StoreReader {
    /// Past cuts before a place in the table (the newest where none is given), newest first. Errors: the
    /// database's.
    pub async fn cuts(&self, before: Option<i64>, limit: i64) -> Result<Vec<PastCut>, StoreError> {
        let text = "SELECT * FROM cut WHERE sequence < ? ORDER BY sequence DESC LIMIT ?";
        let query = sqlx::query(text).bind(before.unwrap_or(i64::MAX)).bind(limit);
        let rows = query.fetch_all(&self.pool).await.map_err(|e| self.error(e))?;
        let cuts: Result<Vec<PastCut>, _> = rows.iter().map(cut_from_row).collect();
        cuts.map_err(|e| self.error(e))
    }
}
