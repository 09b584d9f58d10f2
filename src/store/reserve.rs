//! Room that was taken while there was room: what a full disk does not let into the history when the service
//! ends is written over these bytes, which needs no new ones, and stored at the next start.

use super::{AuditEntry, StoreError, mark};
use crate::ownership::{open_own, own_file};
use crate::telemetry::{Event, EventKind};
use serde::{Deserialize, Serialize};
use std::io::{ErrorKind, Read as _, Seek as _, Write as _};
use std::path::{Path, PathBuf};

/// Room for about a thousand events and, at the end, for the mark.
const BYTES: usize = 256 * 1024;
const KEPT: usize = BYTES - mark::BYTES as usize;
/// Name of the file beside the history.
pub(super) const FILE_NAME: &str = "history.reserve";

/// One write that waits for the next start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "write", rename_all = "snake_case")]
pub(super) enum Kept {
    /// An event that was not stored.
    Event {
        id: String,
        wall_ns: i64,
        kind: EventKind,
        axis: Option<String>,
        t_s: Option<f64>,
        frequency_hz: Option<f64>,
        power_n2: Option<f64>,
        pitch_difference_rad: Option<f64>,
        text: String,
    },
    /// A row of the audit record.
    Audit { wall_ns: i64, actor: String, role: String, action: String, detail: String },
}

impl Kept {
    pub(super) fn event(event: &Event) -> Self {
        Self::Event {
            id: event.id.clone(),
            wall_ns: event.wall_ns,
            kind: event.kind,
            axis: event.axis.clone(),
            t_s: event.t_s,
            frequency_hz: event.frequency_hz,
            power_n2: event.power_n2,
            pitch_difference_rad: event.pitch_difference_rad,
            text: event.text.clone(),
        }
    }

    pub(super) fn audit(entry: &AuditEntry) -> Self {
        let AuditEntry { wall_ns, actor, role, action, detail } = entry.clone();
        Self::Audit { wall_ns, actor, role, action, detail }
    }

    /// What is to be stored: an event or a row of the audit record.
    pub(super) fn restore(self) -> Result<Event, AuditEntry> {
        match self {
            Self::Audit { wall_ns, actor, role, action, detail } => {
                Err(AuditEntry { wall_ns, actor, role, action, detail })
            }
            Self::Event {
                id,
                wall_ns,
                kind,
                axis,
                t_s,
                frequency_hz,
                power_n2,
                pitch_difference_rad,
                text,
            } => {
                let event = Event::new(kind, wall_ns, text);
                Ok(Event { id, axis, t_s, frequency_hz, power_n2, pitch_difference_rad, ..event })
            }
        }
    }
}

/// The file.
#[derive(Debug)]
pub(super) struct Reserve {
    path: PathBuf,
}

impl Reserve {
    /// Takes the room, where it is not taken yet. A disk without room leaves the reserve empty for now.
    /// Errors: the file is a symbolic link, another user's, or writable by everybody.
    pub(super) fn open(folder: &Path) -> Result<Self, StoreError> {
        take(&folder.join(mark::FILE_NAME), mark::BYTES as usize)?;
        let path = folder.join(FILE_NAME);
        take(&path, BYTES)?;
        Ok(Self { path })
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// What an earlier life left. A line that cannot be read ends the list and is told.
    pub(super) fn read(&self) -> Vec<Kept> {
        let mut bytes = Vec::new();
        let read = open_own(&self.path).and_then(|f| f.take(KEPT as u64).read_to_end(&mut bytes));
        if let Err(error) = read {
            tracing::warn!(event = "reserve", "{}: {error}", self.path.display());
        }
        let used = bytes.split(|b| *b == 0).next().unwrap_or_default();
        let mut kept = Vec::new();
        for line in used.split(|b| *b == b'\n').filter(|l| !l.is_empty()) {
            match serde_json::from_slice(line) {
                Ok(one) => kept.push(one),
                Err(error) => {
                    tracing::error!(event = "reserve", "{}: {error}", self.path.display());
                    break;
                }
            }
        }
        kept
    }

    /// Keeps as many as find room, from the first; answers how many.
    pub(super) fn keep(&self, writes: &[Kept]) -> usize {
        let (mut bytes, mut count) = (Vec::new(), 0);
        for write in writes {
            let Ok(line) = serde_json::to_vec(write) else { break };
            if bytes.len() + line.len() + 2 > KEPT {
                break;
            }
            bytes.extend(line);
            bytes.push(b'\n');
            count += 1;
        }
        bytes.push(0);
        match self.put(&bytes) {
            Ok(()) => count,
            Err(error) => {
                tracing::error!(event = "reserve", "{}: {error}", self.path.display());
                0
            }
        }
    }

    /// Forgets what was kept: it is in the history now.
    pub(super) fn clear(&self) {
        if let Err(error) = self.put(&[0]) {
            tracing::warn!(event = "reserve", "{}: {error}", self.path.display());
        }
    }

    /// Writes over the beginning; takes no new room.
    fn put(&self, bytes: &[u8]) -> std::io::Result<()> {
        let mut file = std::fs::File::options().write(true).open(&self.path)?;
        file.rewind()?;
        file.write_all(bytes)?;
        file.sync_data()
    }
}

/// A full or failing disk, not a file that is somebody else's.
fn is_of_the_disk(error: &std::io::Error) -> bool {
    !matches!(
        error.kind(),
        ErrorKind::PermissionDenied | ErrorKind::InvalidInput | ErrorKind::ReadOnlyFilesystem
    )
}

/// Takes room for a file, where it is not taken yet; where the disk has none, that is told.
fn take(path: &Path, bytes: usize) -> Result<(), StoreError> {
    match own_file(path) {
        Err(source) if !is_of_the_disk(&source) => {
            return Err(StoreError::Files { path: path.to_owned(), source });
        }
        _ => {}
    }
    let taken = std::fs::metadata(path).is_ok_and(|m| m.len() == bytes as u64);
    if !taken && let Err(error) = fill(path, bytes) {
        tracing::warn!(event = "reserve", "{}: {error}", path.display());
    }
    Ok(())
}

fn fill(path: &Path, bytes: usize) -> std::io::Result<()> {
    let mut file = std::fs::File::options().create(true).append(true).open(path)?;
    let length = usize::try_from(file.metadata()?.len()).unwrap_or(bytes);
    file.write_all(&vec![0; bytes.saturating_sub(length)])?;
    file.sync_all()?;
    // Its name is durable, too.
    path.parent().map_or(Ok(()), |folder| std::fs::File::open(folder)?.sync_all())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_comes_back_and_takes_no_more_room() {
        let folder = tempfile::tempdir().unwrap();
        let reserve = Reserve::open(folder.path()).unwrap();
        assert!(reserve.read().is_empty());
        let event = Event { id: "e".into(), ..Event::new(EventKind::Fault, 5, "two\nlines \u{fc}") };
        let entry = AuditEntry {
            wall_ns: 7,
            actor: "a".into(),
            role: "r".into(),
            action: "x".into(),
            detail: "d".into(),
        };
        let writes = [Kept::event(&event), Kept::audit(&entry)];
        assert_eq!(reserve.keep(&writes), 2);
        let back = Reserve::open(folder.path()).unwrap().read();
        assert_eq!(back[0].clone().restore(), Ok(event));
        assert_eq!(back[1].clone().restore(), Err(entry));
        assert_eq!(std::fs::metadata(reserve.path()).unwrap().len(), BYTES as u64);
        reserve.clear();
        assert!(Reserve::open(folder.path()).unwrap().read().is_empty());
        let many = vec![writes[0].clone(); 10_000];
        let kept = reserve.keep(&many);
        assert!(kept > 500 && kept < 10_000 && reserve.read().len() == kept, "{kept}");
        assert_eq!(std::fs::metadata(reserve.path()).unwrap().len(), BYTES as u64);
    }
}
