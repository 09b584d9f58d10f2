//! What the lives of the service observed, and what people said of its alarms: the facts of commissioning.

use super::{StoreError, StoreReader};
use sqlx::{Row as _, SqliteConnection};

/// What was observed with one machine, method and turret.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Observation {
    /// Time with usable samples, s.
    pub observed_s: f64,
    /// Cuts whose noise the detector has learned.
    pub cuts: i64,
    /// Commands advised.
    pub advised: i64,
    /// Largest pitch angle difference of them, rad.
    pub largest_pitch_rad: f64,
    /// Windows in which model and machine were compared.
    pub compared: i64,
    /// Significant differences of them.
    pub mismatches: i64,
}

impl Observation {
    /// Both together.
    #[must_use]
    pub fn with(&self, other: &Self) -> Self {
        Self {
            observed_s: self.observed_s + other.observed_s,
            cuts: self.cuts + other.cuts,
            advised: self.advised + other.advised,
            largest_pitch_rad: self.largest_pitch_rad.max(other.largest_pitch_rad),
            compared: self.compared + other.compared,
            mismatches: self.mismatches + other.mismatches,
        }
    }
}

/// Which life observes, and with what.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Observer {
    /// Number of the life.
    pub epoch: i64,
    /// SHA-256 of machine, method and turret.
    pub machine: String,
    /// When the life began, ns since 1970.
    pub started_ns: i64,
}

/// What people said of alarms of chatter.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Judged {
    /// The machine chattered.
    pub right: i64,
    /// It did not.
    pub wrong: i64,
}

/// Word of a right alarm in the history.
pub(super) const RIGHT: &str = "right";
/// Word of a false one.
pub(super) const FALSE: &str = "false";

/// Notes what a life has observed so far, in place of what it had.
pub(super) async fn note(
    connection: &mut SqliteConnection,
    observer: &Observer,
    seen: &Observation,
) -> Result<(), sqlx::Error> {
    let upsert = "INSERT INTO observation (epoch, machine, started_ns, observed_s, cuts, advised, \
         largest_pitch_rad, compared, mismatches) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?) \
         ON CONFLICT (epoch) DO UPDATE SET observed_s = excluded.observed_s, cuts = excluded.cuts, \
         advised = excluded.advised, largest_pitch_rad = excluded.largest_pitch_rad, \
         compared = excluded.compared, mismatches = excluded.mismatches";
    let query = sqlx::query(upsert).bind(observer.epoch).bind(&observer.machine).bind(observer.started_ns);
    let query = query.bind(seen.observed_s).bind(seen.cuts).bind(seen.advised);
    let query = query.bind(seen.largest_pitch_rad).bind(seen.compared).bind(seen.mismatches);
    query.execute(connection).await.map(|_| ())
}

impl StoreReader {
    /// What earlier lives observed with the same machine, and what people said of alarms since the first of
    /// them. Errors: the database's.
    pub async fn observed_before(&self, observer: &Observer) -> Result<(Observation, Judged), StoreError> {
        let sums = "SELECT coalesce(sum(observed_s), 0.0), coalesce(sum(cuts), 0), \
             coalesce(sum(advised), 0), coalesce(max(largest_pitch_rad), 0.0), \
             coalesce(sum(compared), 0), coalesce(sum(mismatches), 0), \
             coalesce(min(started_ns), ?) FROM observation WHERE machine = ? AND epoch < ?";
        let query = sqlx::query(sums).bind(observer.started_ns).bind(&observer.machine).bind(observer.epoch);
        let row = query.fetch_one(&self.pool).await.map_err(|e| self.error(e))?;
        let read = || -> Result<(Observation, i64), sqlx::Error> {
            let seen = Observation {
                observed_s: row.try_get(0)?,
                cuts: row.try_get(1)?,
                advised: row.try_get(2)?,
                largest_pitch_rad: row.try_get(3)?,
                compared: row.try_get(4)?,
                mismatches: row.try_get(5)?,
            };
            Ok((seen, row.try_get(6)?))
        };
        let (seen, since_ns) = read().map_err(|e| self.error(e))?;
        let count = "SELECT coalesce(sum(judged = ?), 0), coalesce(sum(judged = ?), 0) FROM event \
             WHERE kind = 'chatter_onset' AND judged IS NOT NULL AND wall_ns >= ?";
        let query = sqlx::query(count).bind(RIGHT).bind(FALSE).bind(since_ns);
        let row = query.fetch_one(&self.pool).await.map_err(|e| self.error(e))?;
        let judged = || -> Result<Judged, sqlx::Error> {
            Ok(Judged { right: row.try_get(0)?, wrong: row.try_get(1)? })
        };
        Ok((seen, judged().map_err(|e| self.error(e))?))
    }
}
