//! Who goes first: everything but the pipeline thread steps back.

/// By how much, in the system's steps of priority: about a tenth of the share under contention.
const STEPS: i32 = 10;

/// Lowers the priority of the calling thread (Linux: of the thread, not of the process). Allowed to everybody;
/// where it is refused all the same, the thread keeps the priority it has.
pub(super) fn step_back() {
    let _ = rustix::process::nice(STEPS);
}
