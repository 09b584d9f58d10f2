//! Whether the history can be written, seen from outside of the task that writes it: a disk that hangs says
//! nothing, so what counts is how long something has been waiting without a single commit.

use crate::store::WriterGauges;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// A record that takes longer than this is too late for a command; the history counts as not writable.
pub(super) const SLOW_RECORD: Duration = Duration::from_millis(500);

/// Looks at the writer's gauges, each user with its own.
#[derive(Debug, Clone)]
pub(super) struct StoreWatch {
    gauges: Arc<WriterGauges>,
    /// Commits seen, and since when something waits for the next.
    commits: i64,
    waiting_since: Option<Instant>,
}

impl StoreWatch {
    pub(super) fn new(gauges: Arc<WriterGauges>) -> Self {
        Self { gauges, commits: 0, waiting_since: None }
    }

    /// How long writes have been waiting without a commit.
    pub(super) fn lag(&mut self, now: Instant) -> Duration {
        let commits = self.gauges.commits.load(Ordering::Relaxed);
        // What goes into a file that is gone or damaged waits for ever.
        let broken = self.gauges.broken.load(Ordering::Relaxed);
        if self.gauges.waiting.load(Ordering::Relaxed) == 0 && !broken {
            self.waiting_since = None;
        } else if commits != self.commits && !broken || self.waiting_since.is_none() {
            self.waiting_since = Some(now);
        }
        self.commits = commits;
        self.waiting_since.map_or(Duration::ZERO, |since| now.saturating_duration_since(since))
    }

    /// Whether an intent can be recorded in time.
    pub(super) fn writable(&mut self, now: Instant) -> bool {
        self.lag(now) <= SLOW_RECORD
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::service::clock;

    #[test]
    fn a_disk_that_hangs_is_noticed_by_what_waits() {
        let gauges = Arc::new(WriterGauges::default());
        let mut watch = StoreWatch::new(Arc::clone(&gauges));
        let began = clock::now();
        let after = |ms: u64| began + Duration::from_millis(ms);
        assert!(watch.writable(after(0)) && watch.writable(after(60_000)), "nothing waits, nothing is late");
        gauges.waiting.store(3, Ordering::Relaxed);
        assert!(watch.writable(after(61_000)) && watch.writable(after(61_400)));
        assert!(!watch.writable(after(61_600)));
        assert_eq!(watch.lag(after(71_000)), Duration::from_secs(10));
        gauges.commits.store(1, Ordering::Relaxed);
        assert!(watch.writable(after(71_100)), "a commit went through, others wait");
        gauges.waiting.store(0, Ordering::Relaxed);
        assert_eq!(watch.lag(after(80_000)), Duration::ZERO);
        gauges.broken.store(true, Ordering::Relaxed);
        assert!(watch.writable(after(80_100)));
        gauges.commits.store(2, Ordering::Relaxed);
        assert!(!watch.writable(after(80_700)), "commits into a file that is gone count for nothing");
    }
}
