//! Whether somebody could take the turret back: acting needs it without a break.
//!
//! Who knows the tokens confirms it once a second; the pipeline thread believes a confirmation for a few
//! seconds. A side that has died confirms nothing, so the way counts as closed.

use super::clock;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Five confirmations may be late: the thread that answers requests has the lowest priority of all.
const BELIEVED: Duration = Duration::from_secs(5);
/// No confirmation counts.
const CLOSED: u64 = u64::MAX;

/// The last confirmation, and why there is none.
#[derive(Debug)]
pub(super) struct WayBack {
    began: Instant,
    /// Milliseconds after `began`.
    confirmed_ms: AtomicU64,
    trouble: Mutex<Option<String>>,
}

impl WayBack {
    /// Closed until it is confirmed.
    pub(super) fn new() -> Self {
        Self { began: clock::now(), confirmed_ms: AtomicU64::new(CLOSED), trouble: Mutex::default() }
    }

    /// Says that a token is in force that may take the turret back, or that none is.
    pub(super) fn confirm(&self, open: bool, now: Instant) {
        let passed = now.saturating_duration_since(self.began).as_millis();
        let passed = u64::try_from(passed).unwrap_or(CLOSED - 1);
        self.confirmed_ms.store(if open { passed } else { CLOSED }, Ordering::Relaxed);
    }

    /// Whether the turret could be taken back now.
    pub(super) fn is_open(&self, now: Instant) -> bool {
        match self.confirmed_ms.load(Ordering::Relaxed) {
            CLOSED => false,
            ms => now.saturating_duration_since(self.began + Duration::from_millis(ms)) <= BELIEVED,
        }
    }

    /// Notes what is wrong with the tokens; answers it where it is news.
    pub(super) fn note(&self, trouble: Option<String>) -> Option<String> {
        let mut known = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
        let news = trouble.is_some() && *known != trouble;
        known.clone_from(&trouble);
        trouble.filter(|_| news)
    }

    /// What is wrong with the tokens.
    pub(super) fn trouble(&self) -> Option<String> {
        self.trouble.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_confirmation_is_believed_for_a_while_and_a_denial_at_once() {
        let way = WayBack::new();
        let after = |ms| way.began + Duration::from_millis(ms);
        assert!(!way.is_open(after(0)), "nobody has confirmed it");
        way.confirm(true, after(1000));
        assert!(way.is_open(after(1000)) && way.is_open(after(6000)));
        assert!(!way.is_open(after(6001)), "whoever confirms it may be dead");
        way.confirm(true, after(7000));
        way.confirm(false, after(7001));
        assert!(!way.is_open(after(7001)));
    }

    #[test]
    fn trouble_is_news_once() {
        let way = WayBack::new();
        let trouble = || Some("gone".to_owned());
        assert_eq!((way.note(None), way.note(trouble()), way.note(trouble())), (None, trouble(), None));
        assert_eq!(way.trouble(), trouble());
        assert_eq!((way.note(None), way.trouble(), way.note(trouble())), (None, None, trouble()));
    }
}
