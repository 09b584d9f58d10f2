//! Types for the quantities that are easily mixed up.

use thiserror::Error;

/// Why a number is not the quantity it was meant to be.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum UnitError {
    /// The value must be finite and greater than zero.
    #[error("{what} of {value} is not positive")]
    NotPositive {
        /// The quantity.
        what: &'static str,
        /// The value that was given.
        value: f64,
    },
}

fn positive(what: &'static str, value: f64) -> Result<f64, UnitError> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(UnitError::NotPositive { what, value }) }
}

/// Samples per second, finite and positive.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct SampleRate(f64);

impl SampleRate {
    /// A rate in Hz. Errors: zero, negative or not finite.
    pub fn new(hz: f64) -> Result<Self, UnitError> {
        positive("sample rate in Hz", hz).map(Self)
    }

    /// Samples per second.
    #[must_use]
    pub fn hz(self) -> f64 {
        self.0
    }

    /// Seconds between two samples.
    #[must_use]
    pub fn period_s(self) -> f64 {
        1.0 / self.0
    }
}

/// Spindle speed, finite and positive.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd)]
pub struct SpindleSpeed(f64);

impl SpindleSpeed {
    /// A speed in revolutions per minute. Errors: zero, negative or not finite.
    pub fn from_rpm(rpm: f64) -> Result<Self, UnitError> {
        positive("spindle speed in rpm", rpm).map(Self)
    }

    /// Revolutions per minute.
    #[must_use]
    pub fn rpm(self) -> f64 {
        self.0
    }

    /// Revolutions per second, S/60.
    #[must_use]
    pub fn hz(self) -> f64 {
        self.0 / 60.0
    }

    /// Seconds for one revolution, 60/S.
    #[must_use]
    pub fn period_s(self) -> f64 {
        60.0 / self.0
    }
}

/// A number of things in words: `1 sample`, `2 samples`. `what`: one of them, with a regular plural.
#[cfg(feature = "cli")]
pub(crate) fn counted(count: impl std::fmt::Display, what: &str) -> String {
    let count = count.to_string();
    let plural = if count == "1" { "" } else { "s" };
    format!("{count} {what}{plural}")
}
