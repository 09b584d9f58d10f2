//! Room that is taken ahead: free pages of the main file, and a log of that length. On a full disk the
//! history goes on in them, also where a program takes each byte that becomes free.

use super::open::{checkpoint, suffixed};
use rustix::fs::{FallocateFlags, fallocate};
use sqlx::{Row as _, SqliteConnection};
use std::fs::File;
use std::io::ErrorKind;
use std::path::Path;

/// Free pages that are kept ahead: 1 MB of 4 KiB pages, some two thousand events with their rows of the audit
/// record.
const PAGES: u64 = 256;

/// What is left of it.
#[derive(Debug)]
pub(super) struct Ahead {
    /// More is taken where fewer pages are free.
    least: u64,
    /// Main file and log. Closing one would drop the locks that SQLite holds on it for this process.
    files: Option<[File; 2]>,
}

impl Default for Ahead {
    fn default() -> Self {
        Self { least: PAGES / 2, files: None }
    }
}

impl Ahead {
    /// Whether more is to be taken now. A history that cannot be asked shows its trouble at the next write.
    pub(super) async fn is_short(&self, connection: &mut SqliteConnection) -> bool {
        free(connection).await.is_ok_and(|free| free < self.least)
    }

    /// Takes it. First the blocks of the disk, where that can be had: what does not fit then leaves nothing
    /// in the log. Then pages are written and given up, which stay in the file, while a checkpoint cuts off
    /// blocks behind its end. Errors: the disk is full; what was free stays so.
    pub(super) async fn take(
        &mut self,
        path: &Path,
        connection: &mut SqliteConnection,
    ) -> Result<(), sqlx::Error> {
        let short = PAGES.saturating_sub(free(connection).await?);
        let size: i64 = sqlx::query("PRAGMA page_size").fetch_one(&mut *connection).await?.try_get(0)?;
        self.reserve(path, short, size.unsigned_abs())?;
        sqlx::query("CREATE TABLE IF NOT EXISTS room (bytes BLOB)").execute(&mut *connection).await?;
        let fill = sqlx::query("INSERT INTO room VALUES (zeroblob(?))").bind(PAGES.cast_signed() * size);
        let filled = fill.execute(&mut *connection).await;
        checkpoint(connection).await; // the main file has them now, before they are free
        sqlx::query("DROP TABLE room").execute(connection).await?;
        filled.map(drop)
    }

    /// Blocks for `short` pages of `page` bytes behind the end of the main file, and those of the log; an
    /// eighth more, for what makes the pages and gives them up, and for the heads of the log's frames.
    fn reserve(&mut self, path: &Path, short: u64, page: u64) -> Result<(), std::io::Error> {
        if self.files.is_none() {
            let open = |path: &Path| File::options().read(true).write(true).open(path);
            self.files = Some([open(path)?, open(&suffixed(path, "-wal"))?]);
        }
        let Some([main, log]) = &self.files else { return Ok(()) };
        for (file, from, pages) in [(log, 0, PAGES), (main, main.metadata()?.len(), short)] {
            let bytes = (pages + PAGES / 8) * page;
            match fallocate(file, FallocateFlags::KEEP_SIZE, from, bytes).map_err(std::io::Error::from) {
                Err(error) if error.kind() != ErrorKind::Unsupported => return Err(error),
                _ => {}
            }
        }
        Ok(())
    }

    /// Notes whether it was taken. Where it was not, the next try comes when a sixteenth more is used up:
    /// each costs a recording.
    pub(super) async fn note(&mut self, taken: bool, connection: &mut SqliteConnection) {
        let left = free(connection).await.unwrap_or(0);
        self.least = if taken { PAGES / 2 } else { left.saturating_sub(PAGES / 16) };
    }
}

/// Pages of the main file that hold nothing.
async fn free(connection: &mut SqliteConnection) -> Result<u64, sqlx::Error> {
    let free: i64 = sqlx::query("PRAGMA freelist_count").fetch_one(connection).await?.try_get(0)?;
    Ok(free.unsigned_abs())
}
