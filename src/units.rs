//! Types for the quantities that are easily mixed up.

use thiserror::Error;

/// Half of the 95 % interval of a normal distribution over its standard deviation.
pub const Z95: f64 = 1.96;

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

/// A number with the prefix that a shop floor would use: 1.00 um, 0.164 ms, 3.75 MN/m.
#[must_use]
pub fn engineering(value: f64, unit: &str, digits: usize) -> String {
    const PREFIXES: [(f64, &str); 8] = [
        (1.0e9, "G"),
        (1.0e6, "M"),
        (1.0e3, "k"),
        (1.0, ""),
        (1.0e-3, "m"),
        (1.0e-6, "\u{b5}"),
        (1.0e-9, "n"),
        (1.0e-12, "p"),
    ];
    let unit = if unit == "1" { "" } else { unit };
    let plain = !matches!(unit, "m" | "s" | "m/s" | "N" | "N/m" | "Hz" | "A" | "V" | "N m" | "N m/A");
    let small_only = matches!(unit, "m" | "s" | "m/s" | "Hz");
    let size = value.abs();
    if !value.is_finite() {
        return format!("\u{2013} {unit}");
    }
    let fits = |p: f64| size >= 0.9995 * p;
    let found = PREFIXES.iter().find(|(p, _)| fits(*p) && (!small_only || *p <= 1.0));
    let keep = plain || size == 0.0 || (unit == "Hz") || (unit == "N" && (0.01..1.0e5).contains(&size));
    let (scale, prefix) = if keep { (1.0, "") } else { found.map_or((1.0e-12, "p"), |f| (f.0, f.1)) };
    format!("{} {prefix}{unit}", significant(value / scale, digits)).trim_end().to_owned()
}

/// `digits` significant digits, without an exponent where that is readable.
#[must_use]
pub fn significant(value: f64, digits: usize) -> String {
    if value == 0.0 || !value.is_finite() {
        return "0".to_owned();
    }
    let order = value.abs().log10().floor();
    if !(-5.0..7.0).contains(&order) {
        let text = format!("{value:.*e}", digits.saturating_sub(1));
        return text.replace("e", "\u{b7}10^").replace('-', "\u{2212}");
    }
    let decimals = (digits as f64 - 1.0 - order).max(0.0) as usize;
    format!("{value:.decimals$}").replace('-', "\u{2212}")
}

/// `stribeck_force_n` without its unit, `stribeck_force`; a name that is a unit is that of a coefficient.
#[must_use]
pub fn without_unit(name: &str) -> &str {
    const UNITS: [&str; 17] = [
        "_n_s2_m2",
        "_nm_s_rad",
        "_kg_m2",
        "_kg",
        "_nm_a",
        "_n_s_m",
        "_n_m3",
        "_n_m",
        "_rad_s",
        "_m_s",
        "_per_rev",
        "_rad",
        "_hz",
        "_n",
        "_m",
        "_s",
        "_a",
    ];
    if UNITS.iter().any(|u| u.strip_prefix('_') == Some(name)) {
        return "coefficient";
    }
    UNITS.iter().find_map(|u| name.strip_suffix(u)).filter(|b| !b.is_empty()).unwrap_or(name)
}
