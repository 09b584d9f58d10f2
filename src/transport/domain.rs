//! One iceoryx2 domain: its files, the lock that says who lives in it, and the janitor.
//!
//! A process killed in its first milliseconds can leave management files that make every later start
//! hang or fail for good. So each participant holds a shared lock on `<root>/domain.lock` for life.
//! Who gets it exclusively at start is alone, and removes what was left before it joins.

use super::TransportError;
use crate::ownership::{own_folder, own_lock, own_user};
use iceoryx2::prelude::{
    CallbackProgression, Config, FileName, Node, NodeBuilder, NodeName, NodeState, Path as IoxPath,
    SemanticString as _, SignalHandlingMode, ipc,
};
use std::fs::{File, Permissions, TryLockError};
use std::io::Write as _;
use std::os::unix::fs::{MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::{Path, PathBuf};
use std::sync::mpsc;
use std::time::Duration;

/// How long joining may take before it counts as wedged.
pub const JOIN_DEADLINE: Duration = Duration::from_secs(5);

const SHARED_MEMORY: &str = "/dev/shm";

/// Where a set of processes meet: a prefix of shared memory names and a folder.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Domain {
    prefix: String,
    root: PathBuf,
}

impl Domain {
    /// A domain. `prefix`: 1 to 24 lower-case letters and digits. `root`: an absolute path.
    /// Errors: anything else.
    pub fn new(prefix: &str, root: &Path) -> Result<Self, TransportError> {
        let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit();
        if prefix.is_empty() || prefix.len() > 24 || !prefix.chars().all(plain) {
            return Err(TransportError::Domain(format!(
                "transport.prefix `{prefix}` is not 1 to 24 lower-case letters and digits"
            )));
        }
        let text = root.to_str().unwrap_or_default();
        if !root.is_absolute() || text.len() > 128 {
            return Err(TransportError::Domain(format!(
                "transport.root `{}` is not an absolute path of at most 128 bytes",
                root.display()
            )));
        }
        // The underscore ends the prefix, so no domain's names can start another's.
        let domain = Self { prefix: format!("{prefix}_"), root: root.to_owned() };
        domain.config()?;
        Ok(domain)
    }

    /// Folder of the domain's files.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// First part of the names of the domain's files in shared memory.
    #[must_use]
    pub fn prefix(&self) -> &str {
        &self.prefix
    }

    fn config(&self) -> Result<Config, TransportError> {
        let bad = |what: &str| TransportError::Domain(format!("transport.{what}: not a valid name"));
        let mut config = Config::default();
        config.global.prefix = FileName::new(self.prefix.as_bytes()).map_err(|_| bad("prefix"))?;
        let root = self.root.to_str().unwrap_or_default();
        config.global.set_root_path(&IoxPath::new(root.as_bytes()).map_err(|_| bad("root"))?);
        Ok(config)
    }

    /// Joins the domain as `name`, cleaning up first when nobody else is in it.
    ///
    /// Ports live on the thread that made them; call this on the thread that will use them.
    /// Errors: no access to the folder, or no node within five seconds: the caller exits, is started
    /// again, and the janitor cures what a killed process left.
    pub fn join(&self, name: &str) -> Result<Participant, TransportError> {
        let lock = self.enter(name)?;
        self.probe(name)?;
        let node = create_node(&self.config()?, name)?;
        self.tighten();
        Ok(Participant { node, _lock: lock })
    }

    /// Takes the life-long shared lock; whoever is alone cleans up first, and makes what all share.
    fn enter(&self, name: &str) -> Result<File, TransportError> {
        let io = |path: &Path| {
            let path = path.to_owned();
            move |source| TransportError::Files { path, source }
        };
        own_folder(&self.root, 0o700).map_err(io(&self.root))?;
        self.refuse_foreign(own_user())?;
        let path = self.root.join("domain.lock");
        let file = own_lock(&path).map_err(io(&path))?;
        match file.try_lock() {
            Ok(()) => {
                self.sweep()?;
                self.probe(name)?;
                self.make_own()?;
                file.unlock().map_err(io(&path))?;
            }
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(source)) => return Err(TransportError::Files { path, source }),
        }
        file.lock_shared().map_err(io(&path))?;
        Ok(file)
    }

    /// Removes the domain's files unless a foreign process (which holds no lock) is alive in it.
    fn sweep(&self) -> Result<(), TransportError> {
        let config = self.config()?;
        let mut alive = false;
        let listed = Node::<ipc::Service>::list(&config, |state| {
            alive = matches!(state, NodeState::Alive(_) | NodeState::Inaccessible(_));
            if alive { CallbackProgression::Stop } else { CallbackProgression::Continue }
        });
        // A list that fails shows nobody; only files of this prefix and root are removed.
        if alive && listed.is_ok() {
            return Ok(());
        }
        self.remove_files();
        Ok(())
    }

    /// Files of the domain in shared memory.
    fn shared_files(&self) -> impl Iterator<Item = PathBuf> {
        let ours = |p: &PathBuf| p.file_name().is_some_and(|n| n.to_string_lossy().starts_with(&self.prefix));
        entries(Path::new(SHARED_MEMORY)).into_iter().filter(ours)
    }

    /// Errors: another user than `user`, root too, made a file of this name in shared memory, where everybody
    /// may make files; `user` can neither use nor remove it, and it keeps everybody out.
    pub fn refuse_foreign(&self, user: u32) -> Result<(), TransportError> {
        for path in self.shared_files() {
            // One that has gone meanwhile is nobody's.
            let owner = std::fs::symlink_metadata(&path).ok().map(|m| m.uid());
            if let Some(owner) = owner.filter(|owner| *owner != user) {
                return Err(TransportError::Foreign { path, owner, user });
            }
        }
        Ok(())
    }

    /// The library lets every user write its management segment, whatever the mask; the domain is one user's.
    fn tighten(&self) {
        for path in self.shared_files() {
            let Ok(found) = std::fs::symlink_metadata(&path) else { continue };
            let mode = found.permissions().mode() & 0o777;
            if found.uid() == own_user() && found.is_file() && mode & 0o077 != 0 {
                let outcome = std::fs::set_permissions(&path, Permissions::from_mode(mode & 0o700));
                drop(outcome); // it may have gone meanwhile
            }
        }
    }

    /// The library lets every user open its management segment from the moment it is made, and who did
    /// keeps it: the segment that stays is a copy that only this user ever could open. One that was spoilt
    /// before it was copied shows when joining.
    fn make_own(&self) -> Result<(), TransportError> {
        let part = Path::new(SHARED_MEMORY).join(format!("{}part", self.prefix));
        for path in self.shared_files().filter(|path| *path != part) {
            let mode = std::fs::symlink_metadata(&path).map_or(0, |m| m.permissions().mode());
            if mode & 0o077 != 0 {
                let copied = copy_own(&path, &part).and_then(|()| std::fs::rename(&part, &path));
                copied.map_err(|source| TransportError::Files { path, source })?;
            }
        }
        Ok(())
    }

    /// Removes every file of the domain but the lock. What cannot be removed shows when joining.
    fn remove_files(&self) {
        for path in self.shared_files() {
            let _ = std::fs::remove_file(path);
        }
        for folder in ["services", "nodes"] {
            for entry in entries(&self.root.join(folder)) {
                let _ =
                    if entry.is_dir() { std::fs::remove_dir_all(entry) } else { std::fs::remove_file(entry) };
            }
        }
    }

    /// Removes every trace, for a domain that was made for one run. Call when all have left.
    pub fn remove(&self) {
        self.remove_files();
        let _ = std::fs::remove_dir_all(&self.root);
    }

    /// Makes and drops a node on a thread of its own: a wedged domain would hang for ever.
    fn probe(&self, name: &str) -> Result<(), TransportError> {
        let (config, name) = (self.config()?, name.to_owned());
        let (done, outcome) = mpsc::sync_channel(1);
        let spawned = std::thread::Builder::new().name("iceoryx2-probe".into()).spawn(move || {
            let _ = done.send(create_node(&config, &name).map(drop));
        });
        spawned.map_err(|source| TransportError::Files { path: self.root.clone(), source })?;
        outcome.recv_timeout(JOIN_DEADLINE).map_err(|_| TransportError::Wedged { root: self.root.clone() })?
    }
}

/// Copies a file into one that is made here, for this user alone.
fn copy_own(from: &Path, to: &Path) -> std::io::Result<()> {
    let bytes = std::fs::read(from)?;
    let _ = std::fs::remove_file(to); // of a life that was killed
    let mut file = File::options().write(true).create_new(true).mode(0o600).open(to)?;
    file.write_all(&bytes)
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(folder).map(|list| list.flatten().map(|e| e.path()).collect()).unwrap_or_default()
}

fn create_node(config: &Config, name: &str) -> Result<Node<ipc::Service>, TransportError> {
    let fail = |e: String| TransportError::Join(e);
    let name: NodeName = name.try_into().map_err(|e| fail(format!("{e:?}")))?;
    let builder =
        NodeBuilder::new().config(config).name(&name).signal_handling_mode(SignalHandlingMode::Disabled);
    builder.create::<ipc::Service>().map_err(|e| fail(format!("{e:?}")))
}

/// One member of a domain; its ports are made from it, on the same thread.
pub struct Participant {
    pub(super) node: Node<ipc::Service>,
    _lock: File,
}

impl std::fmt::Debug for Participant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Participant").finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Somebody else's open file of the management segment, from the moment that the library made it.
    #[test]
    fn who_opened_the_segment_as_it_was_made_has_no_part_in_it() {
        let folder = tempfile::tempdir().unwrap();
        let domain = Domain::new(&format!("own{}", std::process::id()), folder.path()).unwrap();
        let lock = domain.enter("first").unwrap();
        domain.remove_files();
        drop(create_node(&domain.config().unwrap(), "maker").unwrap());
        let open = |path: &PathBuf| std::fs::metadata(path).unwrap().permissions().mode() & 0o077 != 0;
        let made: Vec<PathBuf> = domain.shared_files().filter(open).collect();
        assert!(!made.is_empty(), "the library makes one that is open to all");
        let held: Vec<File> =
            made.iter().map(|p| File::options().read(true).write(true).open(p).unwrap()).collect();
        domain.make_own().unwrap();
        assert!(!made.iter().any(open));
        for mut file in held {
            file.write_all(&[0xff; 4096]).unwrap();
        }
        assert!(domain.join("second").is_ok(), "what is written there spoils nothing");
        drop(lock);
        domain.remove();
    }

    #[test]
    fn a_prefix_that_could_start_another_ones_names_is_refused() {
        let root = Path::new("/tmp/x");
        for prefix in ["", "a_b", "Upper", "a/b", "aaaaaaaaaaaaaaaaaaaaaaaaa"] {
            assert!(Domain::new(prefix, root).is_err(), "{prefix}");
        }
        assert!(Domain::new("a", Path::new("relative")).is_err());
        assert_eq!(Domain::new("line3", root).unwrap().prefix(), "line3_");
    }
}
