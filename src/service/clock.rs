//! The only place that asks the time. The wall clock labels, the monotonic clock decides.
#![allow(clippy::disallowed_methods)]

use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Nanoseconds since 1970 UTC by the wall clock; 0 for a clock set before that.
#[must_use]
pub fn wall_ns() -> i64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since.as_nanos()).unwrap_or(i64::MAX)
}

/// Seconds since 1970 UTC by the wall clock.
#[must_use]
pub fn wall_s() -> f64 {
    wall_ns() as f64 * 1e-9
}

/// An instant of the monotonic clock.
#[must_use]
pub fn now() -> Instant {
    Instant::now()
}

/// A fresh name that sorts by time.
#[must_use]
pub fn new_id() -> String {
    ulid::Ulid::generate().to_string()
}

/// RFC 3339 UTC with milliseconds; the start of 1970 for what no calendar holds.
#[must_use]
pub fn rfc3339(wall_ns: i64) -> String {
    let time = jiff::Timestamp::from_nanosecond(i128::from(wall_ns)).unwrap_or(jiff::Timestamp::UNIX_EPOCH);
    format!("{time:.3}")
}

/// Nanoseconds since 1970 of an RFC 3339 time. `None`: not one.
#[must_use]
pub fn parse_rfc3339(text: &str) -> Option<i64> {
    let time: jiff::Timestamp = text.parse().ok()?;
    let ns = time.as_nanosecond();
    // Further away than nanoseconds reach: as far as they do.
    Some(i64::try_from(ns).unwrap_or(if ns < 0 { i64::MIN } else { i64::MAX }))
}

/// Sleeps on the calling thread.
pub fn sleep(duration: Duration) {
    std::thread::sleep(duration);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_go_to_text_and_back() {
        let text = rfc3339(1_789_000_000_123_456_789);
        assert_eq!(text, "2026-09-10T00:26:40.123Z");
        assert_eq!(parse_rfc3339(&text), Some(1_789_000_000_123_000_000));
        assert_eq!(parse_rfc3339("yesterday"), None);
    }
}
