//! How far the history was durable, noted outside of it: what a damaged or deleted log took away shows at the
//! next start, instead of a shorter history that looks whole.
//!
//! Two slots in the last kilobyte of the reserve are written in turn, each with its own digest, so that a
//! write that is torn leaves the one before. The same stands in a file of its own: what damages or removes
//! one of them is told by the other, and what removes both is told as such.

use super::StoreError;
use super::audit::{chain_end, hash_at, hex};
use super::reserve::{self, Reserve};
use crate::units::counted;
use sha2::{Digest as _, Sha256};
use sqlx::{Row as _, SqliteConnection};
use std::io::{Read as _, Seek as _, SeekFrom};
use std::os::unix::fs::FileExt as _;
use std::path::{Path, PathBuf};

/// One slot: a disk writes a sector whole or not at all, most of the time.
const SLOT: u64 = 512;
/// Room of both slots, at the end of the reserve.
pub(super) const BYTES: u64 = 2 * SLOT;

/// Name of the second copy beside the history.
pub(super) const FILE_NAME: &str = "history.mark";

/// What stands of the mark beside a history.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Found {
    /// The newest of both copies.
    pub(super) mark: Option<Mark>,
    /// What is wrong with a copy, by its name.
    pub(super) spoilt: Vec<String>,
}

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
        let rows = counted(audit_rows, "row");
        format!(
            "{} and {rows} of the audit record that were durable are missing: it \
             ended at row {row} with hash {head}, now at row {found}{other}",
            counted(events, "event")
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

    /// The mark beside a history, and which of its copies is missing or damaged.
    pub(super) fn read(history: &Path) -> Found {
        let copies = [reserve::FILE_NAME, FILE_NAME].map(|name| {
            let of_file = |what: &str| format!("{name} {what}");
            let path = history.with_file_name(name);
            if !path.exists() {
                return Err(of_file("is not there"));
            }
            Self::read_copy(&path).ok_or_else(|| of_file("holds no whole note"))
        });
        let mark = copies.iter().flatten().max_by_key(|mark| mark.number).cloned();
        Found { mark, spoilt: copies.into_iter().filter_map(Result::err).collect() }
    }

    fn read_copy(path: &Path) -> Option<Self> {
        let mut file = crate::ownership::open_own(path).ok()?;
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

    /// Takes room for both copies and writes them, before there is a row. A disk that refuses is told.
    /// Errors: a copy is a symbolic link, another user's, or writable by everybody.
    pub(super) fn write_first(&self, history: &Path) -> Result<(), StoreError> {
        let reserve = Reserve::open(history.parent().unwrap_or(history))?;
        for copy in copies(reserve.path()) {
            if let Err(error) = self.write(&copy) {
                tracing::warn!(event = "mark", "{}: {error}", copy.display());
            }
        }
        Ok(())
    }

    pub(super) fn number(&self) -> u64 {
        self.number
    }

    /// What is missing where nothing is there.
    pub(super) fn all_missing(&self) -> Missing {
        let Self { event, audit, head, .. } = self;
        Missing { events: *event, audit_rows: *audit, noted: (*audit, head.clone()), found: 0 }
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

    /// Writes over the older slot of a copy; durable when it returns.
    pub(super) fn write(&self, copy: &Path) -> std::io::Result<()> {
        let file = std::fs::File::options().write(true).open(copy)?;
        let end = file.metadata()?.len();
        let place = end.saturating_sub(BYTES) + SLOT * (self.number % 2);
        let mut slot = self.line().into_bytes();
        slot.resize(usize::try_from(SLOT).unwrap_or_default(), 0);
        file.write_all_at(&slot, place)?;
        file.sync_data()
    }
}

/// Both copies of the mark, of which one stands in the reserve.
fn copies(reserve: &Path) -> [PathBuf; 2] {
    [reserve.to_owned(), reserve.with_file_name(FILE_NAME)]
}

/// The mark that goes on with the history, and what the history lacks of the mark that stood beside it.
#[derive(Debug)]
pub(super) struct Marker {
    copies: [PathBuf; 2],
    number: u64,
    /// A disk that refuses is told once.
    told: bool,
}

impl Marker {
    pub(super) fn new(reserve: &Path, number: u64) -> Self {
        Self { copies: copies(reserve), number, told: false }
    }

    /// Notes what was committed. A mark that cannot be written is told once: it lags, and what it does not
    /// cover would not be missed.
    pub(super) async fn note(&mut self, connection: &mut SqliteConnection) -> Result<(), StoreError> {
        let closed = |_| StoreError::Closed;
        let failed = |source| StoreError::Database { path: self.copies[0].clone(), source };
        let mark = Mark::of(connection, self.number).await.map_err(failed)?;
        self.number = mark.number;
        // The disk is waited for on threads of their own, for both at once.
        let [one, other] = self.copies.clone().map(|path| {
            let mark = mark.clone();
            tokio::task::spawn_blocking(move || {
                mark.write(&path).map_err(|source| StoreError::Files { path, source })
            })
        });
        let (one, other) = (one.await.map_err(closed)?, other.await.map_err(closed)?);
        let outcome = one.and(other);
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
        let reserve = folder.path().join(reserve::FILE_NAME);
        std::fs::write(&reserve, vec![0; 8192]).unwrap();
        let history = folder.path().join("history.sqlite");
        let read = || Mark::read(&history).mark;
        assert_eq!(read(), None);
        let mark = |number| Mark { number, event: 7, audit: 3, head: hex(&[5; 32]) };
        for number in 1..4 {
            mark(number).write(&reserve).unwrap();
            assert_eq!(read(), Some(mark(number)));
        }
        assert_eq!(std::fs::metadata(&reserve).unwrap().len(), 8192, "it takes no new room");
        // The slot of number 3 is torn.
        let file = std::fs::File::options().write(true).open(&reserve).unwrap();
        file.write_all_at(b"4", 8192 - BYTES + SLOT).unwrap();
        assert_eq!(read(), Some(mark(2)));
        let mut short = std::fs::File::create(&reserve).unwrap();
        short.write_all(b"short").unwrap();
        assert_eq!(read(), None);
    }

    #[test]
    fn one_that_is_missing_is_told_as_one() {
        let said = |events, audit_rows| {
            let noted = (7, "ab".to_owned());
            Missing { events, audit_rows, noted, found: 7 - audit_rows }.sentence()
        };
        assert!(said(1, 2).starts_with("1 event and 2 rows of"), "{}", said(1, 2));
        assert!(said(31, 1).starts_with("31 events and 1 row of"), "{}", said(31, 1));
    }

    #[test]
    fn what_spoils_one_copy_is_told_by_the_other() {
        let folder = tempfile::tempdir().unwrap();
        let history = folder.path().join("history.sqlite");
        let [one, other] = [reserve::FILE_NAME, FILE_NAME].map(|name| folder.path().join(name));
        let mark = Mark { number: 5, event: 7, audit: 3, head: hex(&[5; 32]) };
        let both = || {
            for copy in [&one, &other] {
                std::fs::write(copy, vec![0; 8192]).unwrap();
                mark.write(copy).unwrap();
            }
        };
        both();
        assert_eq!(Mark::read(&history), Found { mark: Some(mark.clone()), spoilt: vec![] });
        for copy in [&one, &other] {
            let name = copy.file_name().unwrap().to_string_lossy().into_owned();
            std::fs::write(copy, "spoilt").unwrap();
            let found = Mark::read(&history);
            assert!(found.mark == Some(mark.clone()) && found.spoilt[0].starts_with(&name), "{found:?}");
            std::fs::remove_file(copy).unwrap();
            let found = Mark::read(&history);
            assert_eq!((found.spoilt.len(), found.mark), (1, Some(mark.clone())));
            both();
        }
        std::fs::remove_file(&one).unwrap();
        std::fs::write(&other, "").unwrap();
        let found = Mark::read(&history);
        assert_eq!((found.spoilt.len(), found.mark), (2, None), "nobody knows");
    }
}
