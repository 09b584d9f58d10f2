//! Where tests find data: in the project, or beside it.

use std::path::{Path, PathBuf};

/// A path of the project.
pub(crate) fn project(relative: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(relative)
}

/// A file or folder of the data beside the project; `None`, said aloud, where it is not there.
pub(crate) fn shared(relative: &str) -> Option<PathBuf> {
    let path = project("../shared").join(relative);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: ../shared/{relative} is not there");
    None
}
