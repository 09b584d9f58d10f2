//! The folder of black-box recordings: names, list, retention.

use crate::ownership::own_folder;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use thiserror::Error;
use utoipa::ToSchema;

/// Why recordings cannot be listed.
#[derive(Debug, Error)]
pub enum RecordingsError {
    /// The folder cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// Folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
}

/// One stored recording.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct RecordingInfo {
    /// Name, also of its file without `.parquet`.
    pub id: String,
    /// Size, bytes.
    pub bytes: u64,
    /// When it was written, RFC 3339.
    pub written_at: String,
    /// The same in ns since 1970.
    pub written_ns: i64,
}

/// The folder.
#[derive(Debug, Clone)]
pub struct Recordings {
    folder: PathBuf,
    /// What went to make room on a full disk and was not told yet.
    gone: Arc<Mutex<Vec<String>>>,
}

/// How much the folder may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RecordingLimits {
    /// The oldest go while there is more.
    pub max_bytes: u64,
    /// Older ones go.
    pub max_age_ns: i64,
}

/// Removed for their age at once: a wall clock that is wrong for a while must not empty the folder.
const AGED_AT_ONCE: usize = 4;

impl Recordings {
    /// The folder, made where it is not there. Errors: it is no folder, or not this user's own.
    pub fn open(folder: &Path) -> Result<Self, RecordingsError> {
        own_folder(folder, 0o750).map_err(|source| {
            let is_file = folder.is_file();
            let told = || std::io::Error::new(source.kind(), "is a file; expected a folder, or nothing");
            let source = if is_file { told() } else { source };
            RecordingsError::Io { path: folder.to_owned(), source }
        })?;
        Ok(Self { folder: folder.to_owned(), gone: Arc::default() })
    }

    /// Makes the folder anew where somebody removed it. A disk that refuses shows it at the write itself.
    pub fn restore(&self) {
        let _ = std::fs::create_dir_all(&self.folder);
    }

    /// Where a recording of that name stands or would stand. `None`: not a name of ours.
    #[must_use]
    pub fn target(&self, id: &str) -> Option<PathBuf> {
        let plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let ours = !id.is_empty() && id.len() <= 80 && id.chars().all(plain);
        ours.then(|| self.folder.join(format!("{id}.parquet")))
    }

    /// File of an existing recording.
    #[must_use]
    pub fn path(&self, id: &str) -> Option<PathBuf> {
        self.target(id).filter(|p| p.is_file())
    }

    /// All, newest first. Errors: the folder cannot be read.
    pub fn list(&self) -> Result<Vec<RecordingInfo>, RecordingsError> {
        let fail = |source| RecordingsError::Io { path: self.folder.clone(), source };
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&self.folder).map_err(fail)?.flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            let (Some(id), Ok(info)) = (name.strip_suffix(".parquet"), entry.metadata()) else { continue };
            if id.starts_with('.') {
                continue; // being written
            }
            let written_ns = wall_ns_of(&info);
            let written_at = super::clock::rfc3339(written_ns);
            found.push(RecordingInfo { id: id.to_owned(), bytes: info.len(), written_at, written_ns });
        }
        found.sort_by(|a, b| b.written_ns.cmp(&a.written_ns).then_with(|| b.id.cmp(&a.id)));
        Ok(found)
    }

    /// Removes what the limits say, oldest first; answers how many went.
    /// Errors: the folder cannot be read.
    pub fn prune(&self, limits: RecordingLimits, now_ns: i64) -> Result<usize, RecordingsError> {
        let mut removed = 0;
        let mut total = 0_u64;
        let list = self.list()?;
        let oldest = list.len().saturating_sub(AGED_AT_ONCE);
        for (place, info) in list.iter().enumerate() {
            total = total.saturating_add(info.bytes);
            let old = now_ns.saturating_sub(info.written_ns) > limits.max_age_ns && place >= oldest;
            if (old || total > limits.max_bytes) && self.remove(&info.id) {
                total = total.saturating_sub(info.bytes);
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Removes the oldest where the disk is full; [`Self::take_gone`] tells it. Answers its bytes, nothing
    /// when there is none.
    #[must_use]
    pub fn make_room(&self) -> Option<u64> {
        let oldest = self.list().ok()?.pop().filter(|info| self.remove(&info.id))?;
        self.gone.lock().unwrap_or_else(PoisonError::into_inner).push(oldest.id);
        Some(oldest.bytes)
    }

    /// Names of what went to make room since the last time this was asked.
    #[must_use]
    pub fn take_gone(&self) -> Vec<String> {
        std::mem::take(&mut *self.gone.lock().unwrap_or_else(PoisonError::into_inner))
    }

    fn remove(&self, id: &str) -> bool {
        self.target(id).is_some_and(|p| std::fs::remove_file(p).is_ok())
    }
}

fn wall_ns_of(info: &std::fs::Metadata) -> i64 {
    let modified = info.modified().ok().and_then(|t| t.duration_since(std::time::UNIX_EPOCH).ok());
    modified.map_or(0, |d| i64::try_from(d.as_nanos()).unwrap_or(i64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_cannot_leave_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let recordings = Recordings::open(folder.path()).unwrap();
        for bad in ["", "..", "../etc/passwd", "a/b", "a.b", "a\0b"] {
            assert_eq!(recordings.target(bad), None, "{bad:?}");
        }
        assert!(recordings.target("chatter_onset-01JD").is_some());
        let file = folder.path().join("recordings");
        std::fs::write(&file, "").unwrap();
        let link = folder.path().join("link");
        std::os::unix::fs::symlink(folder.path(), &link).unwrap();
        assert!(Recordings::open(&link).unwrap_err().to_string().contains("symbolic link"));
        let told = Recordings::open(&file).unwrap_err().to_string();
        assert!(told.ends_with("recordings: is a file; expected a folder, or nothing"), "{told}");
    }

    #[test]
    fn a_folder_that_was_removed_is_made_again() {
        let folder = tempfile::tempdir().unwrap();
        let recordings = Recordings::open(&folder.path().join("recordings")).unwrap();
        std::fs::remove_dir(folder.path().join("recordings")).unwrap();
        assert!(recordings.list().is_err());
        recordings.restore();
        assert!(recordings.list().unwrap().is_empty());
    }

    #[test]
    fn the_oldest_go_first() {
        let folder = tempfile::tempdir().unwrap();
        let recordings = Recordings::open(folder.path()).unwrap();
        for (name, age_s) in [("old", 300), ("middle", 200), ("new", 100)] {
            let path = folder.path().join(format!("{name}.parquet"));
            std::fs::write(&path, [0_u8; 1000]).unwrap();
            let time = std::time::UNIX_EPOCH + std::time::Duration::from_secs(1_000_000 - age_s);
            std::fs::File::options().write(true).open(&path).unwrap().set_modified(time).unwrap();
        }
        let limits = RecordingLimits { max_bytes: 2500, max_age_ns: i64::MAX };
        assert_eq!(recordings.prune(limits, 1_000_000_000_000_000).unwrap(), 1);
        let left: Vec<_> = recordings.list().unwrap().into_iter().map(|i| i.id).collect();
        assert_eq!(left, ["new", "middle"]);
        let limits = RecordingLimits { max_bytes: u64::MAX, max_age_ns: 150_000_000_000 };
        assert_eq!(recordings.prune(limits, 1_000_000_000_000_000).unwrap(), 1);
        assert_eq!((recordings.make_room(), recordings.make_room()), (Some(1000), None));
        assert_eq!((recordings.take_gone(), recordings.take_gone()), (vec!["new".to_owned()], Vec::new()));
    }
}
