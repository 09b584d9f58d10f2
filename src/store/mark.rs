//! How far the history was durable, noted outside of it: what a damaged or deleted log took away shows at the
//! next start, instead of a shorter history that looks whole.
//!
//! Two slots in the last kilobyte of the reserve are written in turn, each with its own digest, so that a
//! write that is torn leaves the one before.

use super::StoreError;
use super::audit::{chain_end, hash_at, hex};
use super::reserve::FILE_NAME;
use sha2::{Digest as _, Sha256};
use sqlx::{Row as _, SqliteConnection};
use std::io::{Read as _, Seek as _, SeekFrom};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

/// One slot: a disk writes a sector whole or not at all, most of the time.
const SLOT: u64 = 512;
/// Room of both slots, at the end of the reserve.
pub(super) const BYTES: u64 = 2 * SLOT;

/// The last rows that were durable.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Mark {
    /// Counts the marks.
    number: u64,
    /// Highest place of an event so far.
    pub(super) event: i64,
    /// Place of the last row of the audit record; 0 before the first.
    pub(super) audit: i64,
    /// Its hash, hexadecimal.
    pub(super) head: String,
}

/// What was durable once and is not there any more.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Missing {
    /// Events.
    pub events: i64,
    /// Rows of the audit record; each write by a person is one.
    pub audit_rows: i64,
    /// Place and hash of the last row of the audit record that was noted.
    pub noted: (i64, String),
    /// Where the audit record ended at this start.
    pub found: i64,
}

impl Missing {
    /// One sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let Self { events, audit_rows, noted: (row, head), found } = self;
        let other =
            if *audit_rows == 0 && *events == 0 { "; the rows are not those that were noted" } else { "" };
        format!(
            "{events} events and {audit_rows} rows of the audit record that were durable are missing: it \
             ended at row {row} with hash {head}, now at row {found}{other}"
        )
    }
}

impl Mark {
    fn line(&self) -> String {
        let Self { number, event, audit, head } = self;
        let text = format!("{number} {event} {audit} {head}");
        format!("{text} {}\n", hex(&Sha256::digest(text.as_bytes())))
    }

    fn from_slot(slot: &[u8]) -> Option<Self> {
        let line = std::str::from_utf8(slot.split(|b| *b == b'\n').next()?).ok()?;
        let (text, digest) = line.rsplit_once(' ')?;
        if hex(&Sha256::digest(text.as_bytes())) != digest {
            return None;
        }
        let mut words = text.split(' ');
        let mut number = || words.next()?.parse::<i64>().ok();
        let (count, event, audit) = (number()?, number()?, number()?);
        Some(Self { number: u64::try_from(count).ok()?, event, audit, head: words.next()?.to_owned() })
    }

    /// The mark beside a history; nothing where there is none, as beside one of an earlier version.
    pub(super) fn read(history: &Path) -> Option<Self> {
        let mut file = std::fs::File::open(history.with_file_name(FILE_NAME)).ok()?;
        file.seek(SeekFrom::End(-i64::try_from(BYTES).ok()?)).ok()?;
        let mut bytes = Vec::new();
        file.read_to_end(&mut bytes).ok()?;
        let slots = bytes.chunks(usize::try_from(SLOT).ok()?).filter_map(Self::from_slot);
        slots.max_by_key(|mark| mark.number)
    }

    /// What the connection's last commit made durable.
    pub(super) async fn of(connection: &mut SqliteConnection, before: u64) -> Result<Self, sqlx::Error> {
        let highest = "SELECT coalesce((SELECT seq FROM sqlite_sequence WHERE name = 'event'), 0)";
        let event = sqlx::query(highest).fetch_one(&mut *connection).await?.try_get(0)?;
        let (audit, hash) = chain_end(connection).await?;
        Ok(Self { number: before + 1, event, audit, head: hex(&hash) })
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// What a history lacks of what this mark says. Errors: the database's.
    pub(super) async fn missing(
        &self,
        connection: &mut SqliteConnection,
    ) -> Result<Option<Missing>, sqlx::Error> {
        let now = Self::of(connection, 0).await?;
        let (events, audit_rows) = ((self.event - now.event).max(0), (self.audit - now.audit).max(0));
        let there = hash_at(connection, self.audit).await?;
        let other = there.is_some_and(|hash| hex(&hash) != self.head);
        let noted = (self.audit, self.head.clone());
        let missing = Missing { events, audit_rows, noted, found: now.audit };
        Ok((events > 0 || audit_rows > 0 || other).then_some(missing))
    }

    /// Writes over the older slot; durable when it returns.
    pub(super) fn write(&self, reserve: &Path) -> std::io::Result<()> {
        let file = std::fs::File::options().write(true).open(reserve)?;
        let end = file.metadata()?.len();
        let place = end.saturating_sub(BYTES) + SLOT * (self.number % 2);
        let mut slot = self.line().into_bytes();
        slot.resize(usize::try_from(SLOT).unwrap_or_default(), 0);
        file.write_all_at(&slot, place)?;
        file.sync_data()
    }
}

/// The mark that goes on with the history, and what the history lacks of the mark that stood beside it.
#[derive(Debug)]
pub(super) struct Marker {
    reserve: PathBuf,
    number: u64,
    /// A disk that refuses is told once.
    told: bool,
}

impl Marker {
    pub(super) fn new(reserve: &Path, number: u64) -> Self {
        Self { reserve: reserve.to_owned(), number, told: false }
    }

    /// Notes what was committed. A mark that cannot be written is told once: it lags, and what it does not
    /// cover would not be missed.
    pub(super) async fn note(&mut self, connection: &mut SqliteConnection) -> Result<(), StoreError> {
        let closed = |_| StoreError::Closed;
        let path = self.reserve.clone();
        let failed = |source| StoreError::Database { path: path.clone(), source };
        let mark = Mark::of(connection, self.number).await.map_err(failed)?;
        self.number = mark.number;
        // The disk is waited for on a thread of its own.
        let (reserve, written) = (self.reserve.clone(), mark);
        let outcome = tokio::task::spawn_blocking(move || written.write(&reserve)).await.map_err(closed)?;
        let files = |source| StoreError::Files { path, source };
        let outcome = outcome.map_err(files);
        if let Err(error) = &outcome
            && !std::mem::replace(&mut self.told, true)
        {
            tracing::warn!(event = "mark", "{error}");
        }
        self.told &= outcome.is_err();
        outcome
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    #[test]
    fn a_torn_mark_leaves_the_one_before() {
        let folder = tempfile::tempdir().unwrap();
        let reserve = folder.path().join(FILE_NAME);
        std::fs::write(&reserve, vec![0; 8192]).unwrap();
        let history = folder.path().join("history.sqlite");
        assert_eq!(Mark::read(&history), None);
        let mark = |number| Mark { number, event: 7, audit: 3, head: hex(&[5; 32]) };
        for number in 1..4 {
            mark(number).write(&reserve).unwrap();
            assert_eq!(Mark::read(&history), Some(mark(number)));
        }
        assert_eq!(std::fs::metadata(&reserve).unwrap().len(), 8192, "it takes no new room");
        // The slot of number 3 is torn.
        let file = std::fs::File::options().write(true).open(&reserve).unwrap();
        file.write_all_at(b"4", 8192 - BYTES + SLOT).unwrap();
        assert_eq!(Mark::read(&history), Some(mark(2)));
        let mut short = std::fs::File::create(&reserve).unwrap();
        short.write_all(b"short").unwrap();
        assert_eq!(Mark::read(&history), None);
    }
}
