//! Whose a file or folder is: what another user of the machine may change, or lead elsewhere by a link, is
//! not used, and is named.

use rustix::fs::Access;
use std::io::{Error, ErrorKind};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _, OpenOptionsExt as _, PermissionsExt as _};
use std::path::Path;

/// Permission bit: every user of the machine may write.
const WORLD_WRITABLE: u32 = 0o002;
/// What a file of ours may allow at most.
const KEPT: u32 = 0o640;
/// The administrator may read and change everything anyhow.
const ROOT: u32 = 0;

/// The user that this process acts as.
#[must_use]
pub fn own_user() -> u32 {
    rustix::process::geteuid().as_raw()
}

/// A place that another user may change: a person must mend it, trying again does not help.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
struct Refused(String);

fn refused(what: String) -> Error {
    Error::new(ErrorKind::PermissionDenied, Refused(what))
}

/// Whether an error, or one of its causes, is that a file or folder is not this user's own.
#[must_use]
pub fn is_refusal(error: &(dyn std::error::Error + 'static)) -> bool {
    let of_ours = |e: &Error| e.get_ref().is_some_and(|inner| inner.is::<Refused>());
    std::iter::successors(Some(error), |e| e.source()).any(|e| e.downcast_ref::<Error>().is_some_and(of_ours))
}

/// Lets others read nothing of what this process makes from here on, whatever the shell's mask is.
pub fn keep_others_out() {
    use rustix::{fs::Mode, process::umask};
    let others = Mode::WGRP | Mode::RWXO;
    let stated = umask(others);
    umask(stated | others);
}

/// What stands at a path, where nobody can lead it elsewhere or write to it but its user and group. Nothing
/// where nothing stands there. Errors: a symbolic link, writable by everybody, or the system's.
pub fn kept(path: &Path) -> Result<Option<std::fs::Metadata>, Error> {
    let found = match std::fs::symlink_metadata(path) {
        Ok(found) => found,
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(error),
    };
    if found.file_type().is_symlink() {
        return Err(refused("is a symbolic link; expected the place itself".to_owned()));
    }
    let mode = found.permissions().mode() & 0o7777;
    if mode & WORLD_WRITABLE != 0 {
        return Err(writable_by_all(mode));
    }
    Ok(Some(found))
}

/// The same, and this user's or root's. Errors: another user's, too.
fn inspected(path: &Path) -> Result<Option<std::fs::Metadata>, Error> {
    kept_by(own_user(), path)
}

/// As [`kept`], and of `user` or root. Errors: another user's, too.
pub fn kept_by(user: u32, path: &Path) -> Result<Option<std::fs::Metadata>, Error> {
    let found = kept(path)?;
    match &found {
        Some(f) if ![user, ROOT].contains(&f.uid()) => Err(of_another(f.uid(), user)),
        _ => Ok(found),
    }
}

fn of_another(owner: u32, user: u32) -> Error {
    let not = if user == own_user() { "this one" } else { "the service's" };
    refused(format!("belongs to user {owner}, not to {not} ({user})"))
}

/// Whose files the service would find its own: this user, or, where the administrator asks, the owner of the
/// first of these places that is there.
pub fn user_of(places: &[&Path]) -> u32 {
    let owner = |path: &&Path| std::fs::symlink_metadata(path).ok().map(|found| found.uid());
    let asked = if own_user() == ROOT { places.iter().find_map(owner) } else { None };
    asked.unwrap_or_else(own_user)
}

/// Whether `user` can read a file that only its owner may read. Errors: it is another's, also root's.
pub fn read_by(user: u32, path: &Path) -> Result<(), Error> {
    let owner = std::fs::metadata(path)?.uid();
    if owner == user || user == ROOT {
        return Ok(());
    }
    Err(refused(format!("belongs to user {owner}, and the service's user ({user}) cannot read it")))
}

/// Whether not every user of the machine can write a file, by whatever link it is named. Errors: all can.
pub fn not_everybodys(path: &Path) -> Result<(), Error> {
    let mode = std::fs::metadata(path)?.permissions().mode() & 0o777;
    if mode & WORLD_WRITABLE == 0 { Ok(()) } else { Err(writable_by_all(mode)) }
}

fn writable_by_all(mode: u32) -> Error {
    refused(format!("mode {mode:03o} lets every user write"))
}

/// Whether the modes let `user` read a file, or make what is not there in the folder above it. A group other
/// than root's may be the user's. Errors: the first place on the way that keeps the user out, by its name.
pub fn reachable_by(user: u32, path: &Path) -> Result<(), Error> {
    let path = std::path::absolute(path)?;
    let there = path.ancestors().find(|place| place.exists()).unwrap_or(Path::new("/")).canonicalize()?;
    let last = if there.is_dir() { 0o3 } else { 0o4 };
    let needed = there.ancestors().zip(std::iter::once(last).chain(std::iter::repeat(0o1)));
    for (place, bits) in needed.filter(|_| user != ROOT) {
        let found = std::fs::metadata(place)?;
        let mode = found.permissions().mode() & 0o777;
        let of_group = if found.gid() == ROOT { 0 } else { mode >> 3 };
        let allowed = if found.uid() == user { mode >> 6 } else { (mode | of_group) & 0o7 };
        if allowed & bits != bits {
            let (place, owner) = (place.display(), found.uid());
            let what =
                format!("{place} of user {owner} and mode {mode:03o} keeps the service's user ({user}) out");
            return Err(refused(what));
        }
    }
    Ok(())
}

/// A folder of this user's own; made with `mode`, and what leads to it, where it is not there.
/// Errors: it is no folder, a symbolic link, another user's, or writable by everybody.
pub fn own_folder(path: &Path, mode: u32) -> Result<(), Error> {
    if inspected(path)?.is_none() {
        std::fs::DirBuilder::new().recursive(true).mode(mode).create(path)?;
    }
    match inspected(path)? {
        Some(found) if found.is_dir() => Ok(()),
        _ => Err(Error::new(ErrorKind::NotADirectory, "is no folder")),
    }
}

/// A file of this user's own, as a lock; made where it is not there. Errors: as [`own_file`], or the
/// system's.
pub fn own_lock(path: &Path) -> Result<std::fs::File, Error> {
    own_file(path)?;
    std::fs::File::options().read(true).write(true).open(path)
}

/// A file of this user's own, opened to read. Errors: nothing is there, or it is no file (a pipe would be
/// waited for), a symbolic link, another user's, or writable by everybody.
pub fn open_own(path: &Path) -> Result<std::fs::File, Error> {
    match inspected(path)? {
        Some(found) if found.is_file() => std::fs::File::open(path),
        Some(_) => Err(no_file()),
        None => Err(ErrorKind::NotFound.into()),
    }
}

/// What stands where a file should.
pub fn no_file() -> Error {
    Error::new(ErrorKind::InvalidInput, "is no file")
}

/// A file of this user's own that nobody else writes and others than its group cannot read; made empty where
/// it is not there. Errors: it is no file, a symbolic link, another user's, or writable by everybody.
pub fn own_file(path: &Path) -> Result<(), Error> {
    if inspected(path)?.is_none() {
        let mut options = std::fs::File::options();
        options.write(true).create_new(true).mode(0o640).open(path)?;
        return Ok(());
    }
    existing_file(path)
}

/// As [`own_file`], where the file is there; nothing is made. Errors: also one that its owner may not write,
/// and one of root's that this user may not.
pub fn existing_file(path: &Path) -> Result<(), Error> {
    let Some(found) = inspected(path)? else { return Ok(()) };
    if !found.is_file() {
        return Err(no_file());
    }
    let mode = found.permissions().mode() & 0o7777;
    if !is_its_owners(mode) {
        return Err(refused(format!("mode {mode:03o} does not let its owner read and write; expected 640")));
    }
    let usable = Access::READ_OK | Access::WRITE_OK;
    if found.uid() != own_user() && rustix::fs::access(path, usable).is_err() {
        return Err(of_another(found.uid(), own_user()));
    }
    if mode & !KEPT != 0 && found.uid() == own_user() {
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode & KEPT))?;
    }
    Ok(())
}

/// Lets its owner read and write what was made after a file that could not be written then.
pub fn let_owner_write(path: &Path) -> Result<(), Error> {
    let Some(found) = inspected(path)?.filter(std::fs::Metadata::is_file) else { return Ok(()) };
    let mode = found.permissions().mode() & 0o7777;
    if is_its_owners(mode) {
        return Ok(());
    }
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode | 0o600))
}

/// Whether its owner may read and write it.
fn is_its_owners(mode: u32) -> bool {
    mode & 0o600 == 0o600
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_others_can_change_is_refused_by_what_it_is() {
        let place = tempfile::tempdir().unwrap();
        let at = |name: &str| place.path().join(name);
        let mode = |name: &str| std::fs::metadata(at(name)).unwrap().permissions().mode() & 0o7777;
        own_folder(&at("deep/made"), 0o750).unwrap();
        assert_eq!(mode("deep/made") & 0o007, 0);
        own_folder(&at("deep/made"), 0o750).unwrap();
        std::os::unix::fs::symlink(at("deep/made"), at("link")).unwrap();
        let link = own_folder(&at("link"), 0o750).unwrap_err();
        assert!(is_refusal(&link) && link.to_string().contains("symbolic link"), "{link}");
        let absent = std::fs::File::open(at("absent")).unwrap_err();
        assert!(!is_refusal(&absent), "{absent}");
        std::fs::set_permissions(at("deep"), std::fs::Permissions::from_mode(0o777)).unwrap();
        let open = own_folder(&at("deep"), 0o750).unwrap_err().to_string();
        assert!(open.contains("777"), "{open}");
        own_file(&at("file")).unwrap();
        assert_eq!(mode("file") & 0o027, 0);
        assert!(own_folder(&at("file"), 0o750).is_err() && own_file(&at("deep/made")).is_err());
        std::fs::set_permissions(at("file"), std::fs::Permissions::from_mode(0o644)).unwrap();
        existing_file(&at("file")).unwrap();
        assert_eq!(mode("file"), 0o640, "others could read it");
        std::os::unix::fs::symlink(at("file"), at("file-link")).unwrap();
        assert!(own_file(&at("file-link")).is_err());
        std::fs::set_permissions(at("file"), std::fs::Permissions::from_mode(0o664)).unwrap();
        existing_file(&at("file")).unwrap();
        assert_eq!(mode("file"), 0o640, "its group could write it");
        std::fs::set_permissions(at("file"), std::fs::Permissions::from_mode(0o400)).unwrap();
        let read_only = own_file(&at("file")).unwrap_err().to_string();
        assert!(read_only.contains("mode 400"), "{read_only}");
        let_owner_write(&at("file")).unwrap();
        own_file(&at("file")).unwrap();
        drop(own_lock(&at("lock")).unwrap());
        assert_eq!(mode("lock") & 0o027, 0);
        existing_file(&at("nothing")).unwrap();
        // What leads to a file counts as the file does; what is not there must be made by the user.
        std::fs::create_dir(at("way")).unwrap();
        std::fs::write(at("way/plain"), "").unwrap();
        let set = |name: &str, bits| {
            std::fs::set_permissions(at(name), std::fs::Permissions::from_mode(bits)).unwrap();
        };
        let (me, other) = (own_user(), own_user() + 4321);
        let by = |user, name: &str| reachable_by(user, &at(name)).map_err(|e| e.to_string());
        set(".", 0o755);
        set("way", 0o755);
        for (bits, of_others) in [(0o644, true), (0o600, false)] {
            set("way/plain", bits);
            assert_eq!((by(me, "way/plain").is_ok(), by(other, "way/plain").is_ok()), (true, of_others));
        }
        set("way/plain", 0o666);
        assert!(not_everybodys(&at("way/plain")).is_err() && not_everybodys(&at("way")).is_ok());
        set("way/plain", 0o644);
        assert!(by(me, "way/new").is_ok() && by(other, "way/new").unwrap_err().contains("way of user"));
        set("way", 0o700);
        assert!(by(other, "way/plain").unwrap_err().contains("mode 700 keeps"));
        assert!(open_own(&at("file")).is_ok() && open_own(&at("file-link")).is_err());
        assert_eq!(open_own(&at("nothing")).unwrap_err().kind(), ErrorKind::NotFound);
        // A pipe without a writer: whoever opened it would wait for ever.
        let pipe = rustix::fs::FileType::Fifo;
        rustix::fs::mknodat(rustix::fs::CWD, at("pipe"), pipe, rustix::fs::Mode::RWXU, 0).unwrap();
        for waits in [open_own(&at("pipe")).map(drop), own_file(&at("pipe"))] {
            assert_eq!(waits.unwrap_err().kind(), ErrorKind::InvalidInput);
        }
        // Another user's: only an administrator can make one.
        if own_user() == ROOT {
            std::os::unix::fs::chown(at("file"), Some(12_345), None).unwrap();
            let foreign = own_file(&at("file")).unwrap_err().to_string();
            assert!(foreign.contains("user 12345"), "{foreign}");
        } else {
            let of_root = existing_file(Path::new("/etc/passwd")).unwrap_err().to_string();
            assert!(of_root.contains("belongs to user 0"), "{of_root}");
        }
    }
}
