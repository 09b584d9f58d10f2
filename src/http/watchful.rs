//! Security refusals in the log, each kind once in a while: whoever is refused again and again fills no log.

use super::secrets::without_tokens;
use crate::telemetry::Metrics;
use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// A kind is told at most once in this time; in between it is counted.
const TELL_EVERY: Duration = Duration::from_secs(10);
/// A path in the log is cut here.
const LONGEST_PATH: usize = 200;

/// Who was refused where.
#[derive(Debug, Clone, Copy)]
pub(super) struct Where<'a> {
    pub(super) address: IpAddr,
    pub(super) path: &'a str,
    /// Name of the token, where one was good.
    pub(super) caller: &'a str,
}

/// When each kind was told, and how many were not told since.
#[derive(Debug, Default)]
pub(super) struct Refusals(Mutex<HashMap<&'static str, (Instant, u64)>>);

impl Refusals {
    /// Counts a refusal, and writes the log line when it is time.
    pub(super) fn tell(&self, metrics: &Metrics, kind: &'static str, place: Where<'_>, now: Instant) {
        metrics.security_events.with_label_values(&[kind]).inc();
        let Some(untold) = self.due(kind, now) else { return };
        let Where { address, caller, .. } = place;
        let path: String = without_tokens(place.path).chars().take(LONGEST_PATH).collect();
        tracing::warn!(event = kind, %address, path, caller, untold, "a request was refused");
    }

    /// How many were not told, when this one is to be.
    fn due(&self, kind: &'static str, now: Instant) -> Option<u64> {
        let mut kinds = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        match kinds.get_mut(kind) {
            Some((told, untold)) if now.duration_since(*told) < TELL_EVERY => {
                *untold += 1;
                None
            }
            _ => Some(kinds.insert(kind, (now, 0)).map_or(0, |(_, untold)| untold)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_kind_is_told_once_in_a_while_and_counted_in_between() {
        let (refusals, began) = (Refusals::default(), crate::service::clock::now());
        let due = |kind, ms| refusals.due(kind, began + Duration::from_millis(ms));
        assert_eq!(due("forbidden", 0), Some(0));
        assert_eq!((due("forbidden", 1), due("forbidden", 9_999)), (None, None));
        assert_eq!(due("bad_host", 2), Some(0), "each kind by itself");
        assert_eq!(due("forbidden", 10_001), Some(2));
        assert_eq!(due("forbidden", 20_002), Some(0));
    }
}
