//! Reading events back, page by page.

use super::evidence::RIGHT;
use super::{StoreError, StoreReader};
use crate::telemetry::{Event, EventKind};
use sqlx::sqlite::SqliteRow;
use sqlx::{QueryBuilder, Row as _, Sqlite};

/// Most events of one page.
pub const MAX_PAGE: i64 = 1000;

/// An alarm that nobody acknowledged: word for word the condition of the index `event_open_alarm`.
pub(super) const OPEN_ALARM: &str = "acknowledged_ns IS NULL AND kind IN ('chatter_onset', \
     'command_failed', 'source_lost', 'fault', 'invariant_violation', 'history_replaced', \
     'history_damaged', 'history_cut')";
/// With the index of these alone, whatever the planner thinks; refused where the condition does not fit.
const OPEN_INDEX: &str = " INDEXED BY event_open_alarm";
/// Open alarms are counted up to here.
const COUNTED: i64 = 1000;

pub(super) const COLUMNS: &str = "sequence, id, wall_ns, kind, axis, t_s, frequency_hz, power_n2, \
     pitch_difference_rad, text, acknowledged_by, acknowledged_ns, silenced_until_ns, judged";

/// Which events to read.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EventFilter {
    /// Only after this place (oldest first), or before it (newest first).
    pub cursor: Option<i64>,
    /// Oldest first instead of newest first.
    pub ascending: bool,
    /// Only this kind.
    pub kind: Option<EventKind>,
    /// Only this axis.
    pub axis: Option<String>,
    /// Only at or after this wall time.
    pub since_ns: Option<i64>,
    /// Only at or before this wall time.
    pub until_ns: Option<i64>,
    /// Only alarms that nobody acknowledged.
    pub unacknowledged_alarms: bool,
    /// Most events to give, 1 to [`MAX_PAGE`].
    pub limit: i64,
}

/// One page.
#[derive(Debug, Clone, PartialEq)]
pub struct EventPage {
    /// In the order asked for.
    pub events: Vec<Event>,
    /// Cursor of the next page, if there is one.
    pub next: Option<i64>,
}

pub(super) fn event_from_row(row: &SqliteRow) -> Result<Event, sqlx::Error> {
    let word: String = row.try_get("kind")?;
    let unknown = || sqlx::Error::Decode(format!("unknown event kind {word}").into());
    Ok(Event {
        sequence: row.try_get("sequence")?,
        id: row.try_get("id")?,
        wall_ns: row.try_get("wall_ns")?,
        kind: EventKind::from_word(&word).ok_or_else(unknown)?,
        axis: row.try_get("axis")?,
        t_s: row.try_get("t_s")?,
        frequency_hz: row.try_get("frequency_hz")?,
        power_n2: row.try_get("power_n2")?,
        pitch_difference_rad: row.try_get("pitch_difference_rad")?,
        text: row.try_get("text")?,
        acknowledged_by: row.try_get("acknowledged_by")?,
        acknowledged_ns: row.try_get("acknowledged_ns")?,
        silenced_until_ns: row.try_get("silenced_until_ns")?,
        judged_right: row.try_get::<Option<String>, _>("judged")?.map(|word| word == RIGHT),
    })
}

fn page_query(filter: &EventFilter) -> QueryBuilder<Sqlite> {
    let mut query = QueryBuilder::new("SELECT ");
    query.push(COLUMNS).push(" FROM event");
    if filter.unacknowledged_alarms {
        query.push(OPEN_INDEX);
    }
    query.push(" WHERE 1 = 1");
    if let Some(cursor) = filter.cursor {
        query.push(if filter.ascending { " AND sequence > " } else { " AND sequence < " }).push_bind(cursor);
    }
    if let Some(kind) = filter.kind {
        query.push(" AND kind = ").push_bind(kind.word());
    }
    if let Some(axis) = &filter.axis {
        query.push(" AND axis = ").push_bind(axis.clone());
    }
    if let Some(since) = filter.since_ns {
        query.push(" AND wall_ns >= ").push_bind(since);
    }
    if let Some(until) = filter.until_ns {
        query.push(" AND wall_ns <= ").push_bind(until);
    }
    if filter.unacknowledged_alarms {
        query.push(" AND ").push(OPEN_ALARM);
    }
    query.push(if filter.ascending {
        " ORDER BY sequence ASC LIMIT "
    } else {
        " ORDER BY sequence DESC LIMIT "
    });
    // One more than asked for tells whether there is a next page.
    query.push_bind(filter.limit.clamp(1, MAX_PAGE) + 1);
    query
}

impl StoreReader {
    /// One page of events. Errors: the database's.
    pub async fn page(&self, filter: &EventFilter) -> Result<EventPage, StoreError> {
        let rows = page_query(filter).build().fetch_all(&self.pool).await.map_err(|e| self.error(e))?;
        let events: Result<Vec<Event>, _> = rows.iter().map(event_from_row).collect();
        let mut events = events.map_err(|e| self.error(e))?;
        let limit = usize::try_from(filter.limit.clamp(1, MAX_PAGE)).unwrap_or(1);
        let more = events.len() > limit;
        events.truncate(limit);
        let next = if more { events.last().map(|e| e.sequence) } else { None };
        Ok(EventPage { events, next })
    }

    /// One event. Errors: the database's.
    pub async fn event(&self, sequence: i64) -> Result<Option<Event>, StoreError> {
        let mut query: QueryBuilder<Sqlite> = QueryBuilder::new("SELECT ");
        query.push(COLUMNS).push(" FROM event WHERE sequence = ").push_bind(sequence);
        let row = query.build().fetch_optional(&self.pool).await.map_err(|e| self.error(e))?;
        row.map(|r| event_from_row(&r)).transpose().map_err(|e| self.error(e))
    }

    /// How many alarms are open and not silenced, up to a thousand; reads nothing but these. Errors: the
    /// database's.
    pub async fn open_alarms(&self, now_ns: i64) -> Result<u64, StoreError> {
        let text = format!(
            "SELECT count(*) FROM (SELECT 1 FROM event{OPEN_INDEX} WHERE {OPEN_ALARM} \
             AND (silenced_until_ns IS NULL OR silenced_until_ns < ?) LIMIT {COUNTED})"
        );
        let query = sqlx::query(sqlx::AssertSqlSafe(text)).bind(now_ns);
        let row = query.fetch_one(&self.pool).await.map_err(|e| self.error(e))?;
        let count: i64 = row.try_get(0).map_err(|e| self.error(e))?;
        Ok(u64::try_from(count).unwrap_or(0))
    }

    /// SHA-256 of the settings of the last life before `epoch` that noted them. Errors: the database's.
    pub async fn settings_before(&self, epoch: i64) -> Result<Option<String>, StoreError> {
        let text = "SELECT settings FROM life WHERE epoch < ? AND settings IS NOT NULL \
             ORDER BY epoch DESC LIMIT 1";
        let row =
            sqlx::query(text).bind(epoch).fetch_optional(&self.pool).await.map_err(|e| self.error(e))?;
        row.map(|r| r.try_get(0)).transpose().map_err(|e| self.error(e))
    }

    /// How far a sink outside has confirmed, and how many events stand above. Errors: the database's.
    pub async fn outbox(&self, sink: &str) -> Result<(i64, i64), StoreError> {
        let confirmed = "SELECT coalesce((SELECT confirmed FROM outbox WHERE sink = ?), 0)";
        let row = sqlx::query(confirmed).bind(sink).fetch_one(&self.pool).await.map_err(|e| self.error(e))?;
        let confirmed: i64 = row.try_get(0).map_err(|e| self.error(e))?;
        let waiting = sqlx::query("SELECT count(*) FROM event WHERE sequence > ?").bind(confirmed);
        let row = waiting.fetch_one(&self.pool).await.map_err(|e| self.error(e))?;
        Ok((confirmed, row.try_get(0).map_err(|e| self.error(e))?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::telemetry::Severity;

    #[test]
    fn the_index_of_open_alarms_names_every_alarm() {
        let alarms = EventKind::ALL.iter().filter(|k| k.severity() == Severity::Alarm);
        let words: Vec<String> = alarms.map(|k| format!("'{}'", k.word())).collect();
        let condition = |text: &str| {
            let list = text.split("kind IN (").nth(1).unwrap().split(')').next().unwrap();
            list.split(',').map(|w| w.trim().to_owned()).collect::<Vec<_>>()
        };
        let migration = super::super::migrations().into_iter().find(|(v, _, _)| *v == 5).unwrap().2;
        for text in [OPEN_ALARM, migration] {
            let (mut found, mut expected) = (condition(text), words.clone());
            found.sort();
            expected.sort();
            assert_eq!(found, expected);
        }
    }
}
