//! The past that a page is opened with, kept beside the history: a restart forgets the last minute at most.
//!
//! One line of JSON a minute, appended; what cannot be read is left out. Two files of eight hours each bound
//! it. Nothing rests on it: a disk that refuses is told once.

use super::clock;
use super::past::{Kept, Past};
use crate::ownership::{existing_file, open_own};
use std::fs::File;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio_util::sync::CancellationToken;

/// The one that is written, and the one before it.
const NAMES: [&str; 2] = ["past.jsonl", "past.before.jsonl"];
/// A minute that is lost with a power cut shows on no chart of hours.
const EVERY: Duration = Duration::from_secs(60);
/// Lines of one file: eight hours.
const LINES: usize = 8 * 60;
/// A line holds a minute: some 30 KB. Longer ones are not ours.
const LONGEST_LINE: u64 = 4 << 20;

/// The files.
struct PastFile {
    paths: [PathBuf; 2],
    lines: usize,
    /// Newest column that was written, ns since 1970.
    until_ns: i64,
    told: bool,
}

impl PastFile {
    fn new(folder: &Path) -> Self {
        Self { paths: NAMES.map(|n| folder.join(n)), lines: 0, until_ns: i64::MIN, told: false }
    }

    /// What earlier lives left, oldest first.
    fn read(&mut self) -> Vec<Kept> {
        let [now, before] = self.paths.each_ref().map(|path| minutes(path));
        self.lines = now.len();
        before.into_iter().chain(now).collect()
    }

    /// Appends what came since the last time.
    fn append(&mut self, kept: &Kept) {
        let done = self.try_append(kept);
        self.until_ns = kept.newest_ns().unwrap_or(self.until_ns);
        if let Err(error) = &done
            && !self.told
        {
            tracing::warn!(
                event = "past",
                "{}: {error}; a restart forgets the charts",
                self.paths[0].display()
            );
        }
        self.told = done.is_err();
    }

    fn try_append(&mut self, kept: &Kept) -> std::io::Result<()> {
        use std::os::unix::fs::OpenOptionsExt as _;
        if self.lines >= LINES {
            std::fs::rename(&self.paths[0], &self.paths[1])?;
            self.lines = 0;
        }
        existing_file(&self.paths[0])?; // nobody leads it elsewhere
        // Begins a line of its own also behind one that a power cut tore.
        let line = format!("\n{}\n", serde_json::to_string(kept)?);
        let mut file = File::options().create(true).append(true).mode(0o640).open(&self.paths[0])?;
        file.write_all(line.as_bytes())?;
        self.lines += 1;
        Ok(())
    }
}

fn minutes(path: &Path) -> Vec<Kept> {
    use std::io::Read as _;
    let file = match open_own(path) {
        Ok(file) => file,
        Err(error) => {
            if error.kind() != std::io::ErrorKind::NotFound {
                tracing::warn!(event = "past", "{}: {error}; its charts are not shown", path.display());
            }
            return Vec::new();
        }
    };
    let mut reader = BufReader::new(file);
    let (mut found, mut line) = (Vec::new(), Vec::new());
    loop {
        line.clear();
        match reader.by_ref().take(LONGEST_LINE).read_until(b'\n', &mut line) {
            Ok(count) if count > 0 && found.len() < 2 * LINES => {
                found.extend(serde_json::from_slice::<Kept>(&line).ok().filter(Kept::is_whole));
            }
            _ => return found,
        }
    }
}

/// Fills the memory from the files, then writes what comes once a minute, and at the end.
pub(super) async fn keep(folder: PathBuf, past: Arc<Mutex<Past>>, stop: CancellationToken) {
    let mut file = PastFile::new(&folder);
    let lock = |past: &Mutex<Past>, kept: Vec<Kept>| {
        past.lock().unwrap_or_else(PoisonError::into_inner).put_before(kept, clock::wall_ns());
    };
    let memory = Arc::clone(&past);
    let read = tokio::task::spawn_blocking(move || {
        let kept = file.read();
        file.until_ns = kept.iter().filter_map(Kept::newest_ns).max().unwrap_or(i64::MIN);
        lock(&memory, kept);
        file
    });
    let Ok(mut file) = read.await else { return };
    loop {
        let ends = tokio::time::timeout(EVERY, stop.cancelled()).await.is_ok();
        let kept = past.lock().unwrap_or_else(PoisonError::into_inner).since(file.until_ns, ends);
        let written = tokio::task::spawn_blocking(move || {
            if let Some(kept) = kept {
                file.append(&kept);
            }
            file
        });
        match written.await {
            Ok(back) if !ends => file = back,
            _ => return,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::past::tests::{filled, seconds_of};

    #[test]
    fn what_was_shown_before_a_restart_is_shown_after_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = PastFile::new(folder.path());
        let before = filled(0, 200);
        file.append(&before.since(i64::MIN, false).unwrap());
        let next = filled(0, 260);
        file.append(&next.since(file.until_ns, true).unwrap());
        assert!(next.since(file.until_ns, true).is_none(), "nothing is written twice");
        // A line that was torn, and one of somebody else.
        let mut bytes = std::fs::read(folder.path().join(NAMES[0])).unwrap();
        bytes.extend_from_slice(b"{\"axes\":[\"x1\"],\"levels\":\"");
        std::fs::write(folder.path().join(NAMES[0]), bytes).unwrap();
        let kept = PastFile::new(folder.path()).read();
        // The new life has begun to hear before the files were read.
        let mut after = filled(300, 330);
        let now_ns = 331_000_000_000;
        after.put_before(kept, now_ns);
        let view = after.view(600, now_ns);
        assert_eq!(seconds_of(&view, now_ns), (0..260).chain(300..330).collect::<Vec<i64>>());
        assert_eq!(view.levels, {
            let mut whole = filled(0, 260);
            whole.put_after(&filled(300, 330));
            whole.view(600, now_ns).levels
        });
    }

    #[test]
    fn another_machines_past_is_not_shown_and_the_files_are_bounded() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = PastFile::new(folder.path());
        let minute = filled(0, 2).since(i64::MIN, true).unwrap();
        (0..3 * LINES).for_each(|_| file.append(&minute));
        assert_eq!(NAMES.map(|n| minutes(&folder.path().join(n)).len()), [LINES, LINES]);
        let mut other = filled(500, 510);
        other.rename("z9");
        other.put_before(vec![minute], 600_000_000_000);
        assert_eq!(other.view(28_800, 511_000_000_000).age_s.len(), 10);
    }
}
