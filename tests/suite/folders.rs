//! Where tests find data, in the project or beside it, and how they say that they cannot run.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

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
    not_run(&format!("../shared/{relative} is not there"));
    None
}

/// How often a test, or a part of one, could not run in this process.
static NOT_RUN: AtomicUsize = AtomicUsize::new(0);

/// Says on the screen, not in captured output, that a test or a part of it does not run, and counts it: the
/// number of the last such line is how many there were.
pub(crate) fn not_run(why: &str) {
    let count = NOT_RUN.fetch_add(1, Ordering::Relaxed) + 1;
    let thread = std::thread::current();
    let test = thread.name().unwrap_or("a test");
    // The macros write where the test harness captures; the stream itself is the screen.
    let _ = writeln!(std::io::stderr(), "not run ({count}): {test}: {why}");
}
