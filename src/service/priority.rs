//! Who goes first: everything but the pipeline thread steps back.

use std::process::{Child, Command, Stdio};

/// By how much, in the system's steps of priority: about a third of the share under contention.
const STEPS: &str = "5";

/// Lowers the priority of the calling thread and of those that it starts (Linux: priority belongs to
/// threads).
/// Allowed to everybody; where it fails all the same, the thread keeps the priority it has. The system's own
/// `renice` does it: one process at the start is cheaper than unsafe code.
pub(super) fn step_back() {
    // `1234/task/5678`
    let Ok(place) = std::fs::read_link("/proc/thread-self") else { return };
    let Some(thread) = place.file_name() else { return };
    if stepped_back() {
        return; // inherited
    }
    let mut command = Command::new("renice");
    command.arg("-n").arg(STEPS).arg("-p").arg(thread);
    let _ = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
}

/// Where memory runs out a child goes before the service. Allowed to everybody; where it fails all the same,
/// the child stands like any process.
pub(super) fn first_to_go(child: &Child) {
    let _ = std::fs::write(format!("/proc/{}/oom_score_adj", child.id()), "500");
}

/// Whether this thread goes after the others already.
fn stepped_back() -> bool {
    let stat = std::fs::read_to_string("/proc/thread-self/stat").unwrap_or_default();
    // Fields after the name, which may hold spaces: the 17th of them is the priority step.
    let nice = stat.rsplit(") ").next().and_then(|rest| rest.split(' ').nth(16)?.parse::<i32>().ok());
    nice.is_some_and(|n| n >= 5)
}

#[cfg(test)]
mod tests {
    use super::{first_to_go, step_back, stepped_back};

    #[test]
    fn a_thread_steps_back_and_its_children_with_it_and_nobody_else() {
        let child = std::thread::spawn(|| {
            step_back();
            (stepped_back(), std::thread::spawn(stepped_back).join().unwrap())
        });
        let outcome = child.join().unwrap();
        if std::path::Path::new("/usr/bin/renice").exists() {
            assert_eq!(outcome, (true, true));
        }
    }

    #[test]
    fn a_child_goes_first_where_memory_runs_out() {
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        first_to_go(&child);
        let place = format!("/proc/{}/oom_score_adj", child.id());
        let score = std::fs::read_to_string(place).unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
        assert!(score.trim().parse::<i32>().unwrap() >= 500, "{score}");
    }
}
