//! The seven standard `process_*` metrics, read from `/proc/self` at scrape time.

use std::fmt::Write as _;

/// Clock ticks a second in `/proc/self/stat`: fixed at 100 by the Linux user interface.
const TICKS_PER_S: f64 = 100.0;
const PAGE_BYTES: f64 = 4096.0;

/// Appends what can be read, in Prometheus text form. `start_s`: seconds since 1970 at start.
pub(super) fn append_process_metrics(out: &mut String, start_s: f64) {
    let mut gauge = |name: &str, kind: &str, help: &str, value: f64| {
        // Writing to a String cannot fail.
        let _ = writeln!(out, "# HELP {name} {help}\n# TYPE {name} {kind}\n{name} {value}");
    };
    if let Some(stat) = stat_fields() {
        let field = |n: usize| stat.get(n).copied().unwrap_or_default();
        // Fields 14, 15, 23, 24 of proc(5), counted after the command name (field 3 is index 0).
        let cpu = (field(11) + field(12)) / TICKS_PER_S;
        gauge(
            "process_cpu_seconds_total",
            "counter",
            "Total user and system CPU time spent in seconds.",
            cpu,
        );
        gauge("process_virtual_memory_bytes", "gauge", "Virtual memory size in bytes.", field(20));
        gauge(
            "process_resident_memory_bytes",
            "gauge",
            "Resident memory size in bytes.",
            field(21) * PAGE_BYTES,
        );
        gauge("process_threads", "gauge", "Number of OS threads in the process.", field(17));
    }
    if let Some(open) = open_files() {
        gauge("process_open_fds", "gauge", "Number of open file descriptors.", open);
    }
    if let Some(limit) = open_file_limit() {
        gauge("process_max_fds", "gauge", "Maximum number of open file descriptors.", limit);
    }
    let help = "Start time of the process since unix epoch in seconds.";
    gauge("process_start_time_seconds", "gauge", help, start_s);
}

/// Numbers of `/proc/self/stat` from field 3 (state, read as 0) on.
fn stat_fields() -> Option<Vec<f64>> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let after_name = text.rsplit_once(')')?.1;
    Some(after_name.split_whitespace().map(|w| w.parse().unwrap_or_default()).collect())
}

/// The folder's size says it since Linux 6.2; listing hundreds costs more than the rest of the answer.
fn open_files() -> Option<f64> {
    let folder = "/proc/self/fd";
    let told = std::fs::metadata(folder).ok()?.len();
    if told > 0 {
        return Some(told as f64);
    }
    std::fs::read_dir(folder).ok().map(|entries| entries.count() as f64)
}

fn open_file_limit() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/limits").ok()?;
    let line = text.lines().find(|l| l.starts_with("Max open files"))?;
    line.split_whitespace().nth(3)?.parse().ok()
}

#[cfg(test)]
mod tests {
    #[test]
    fn this_process_has_memory_and_files() {
        let mut text = String::new();
        super::append_process_metrics(&mut text, 1.0);
        let value = |name: &str| -> f64 {
            let line = text.lines().find(|l| l.starts_with(name)).unwrap();
            line.split(' ').nth(1).unwrap().parse().unwrap()
        };
        let resident = value("process_resident_memory_bytes ");
        assert!((1e6..1e10).contains(&resident), "{resident}");
        assert!(value("process_virtual_memory_bytes ") > resident);
        assert!(value("process_open_fds ") >= 3.0 && value("process_threads ") >= 1.0);
        assert!(value("process_max_fds ") >= value("process_open_fds "));
    }
}
