//! What is chosen about windows of spindle harmonics: speed, harmonics, length, where they are read.

use crate::signal::harmonic_fit::{HarmonicBasis, HarmonicFitError, LONGEST_WINDOW, USUAL_HARMONICS};
use crate::units::SampleRate;
use std::f64::consts::TAU;

/// What the two estimators must know besides the drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HarmonicSettings {
    /// Spindle speed that the weights are made for.
    pub spindle_speed_rpm: f64,
    /// Lines per turn that the first harmonic stands for: 1, or the number of teeth.
    pub lines_per_turn: f64,
    /// Harmonics; `None`: as many as lie below `band_hz`, at most 40.
    pub harmonics: Option<usize>,
    /// Length of the window in turns; half a turn or less cannot tell the harmonics apart.
    pub turns: f64,
    /// Where the fitted curve is read: in the middle of the window, or close to its young end.
    pub reading: Reading,
    /// Upper end of the band that is wanted, Hz.
    pub band_hz: f64,
}

/// Where a window is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reading {
    /// In the middle: least noise, delay of half the window.
    Middle,
    /// Three samples from the young end: shortest delay, more noise.
    Young,
}

impl Reading {
    /// `middle` or `young`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "middle" => Some(Self::Middle),
            "young" => Some(Self::Young),
            _ => None,
        }
    }
}

impl HarmonicSettings {
    /// One turn, read in the middle, every harmonic of the spindle below 500 Hz.
    ///
    /// Longer windows hold less noise but let slow motion of the axis leak into the harmonics, whose
    /// accelerations magnify it.
    #[must_use]
    pub fn at_speed(spindle_speed_rpm: f64) -> Self {
        Self {
            spindle_speed_rpm,
            lines_per_turn: 1.0,
            harmonics: None,
            turns: 1.0,
            reading: Reading::Middle,
            band_hz: 500.0,
        }
    }

    /// First and last line, Hz.
    pub(super) fn lines_hz(&self, rate: SampleRate) -> [f64; 2] {
        let basis = self.basis(rate);
        let first_hz = basis.fundamental_rad * rate.hz() / TAU;
        [first_hz, first_hz * basis.harmonics as f64]
    }

    /// Errors: a quantity that no window can be made of, by its name.
    pub(super) fn check(&self, rate: SampleRate) -> Result<(), HarmonicFitError> {
        let within = |name, value: f64, range: [f64; 2]| {
            let fits = value >= range[0] && value <= range[1];
            if fits { Ok(()) } else { Err(HarmonicFitError::OutOfRange { name, value, range }) }
        };
        // A turn lasts at least two samples, and fits into the longest window.
        let slowest_rpm = 60.0 * rate.hz() / LONGEST_WINDOW as f64;
        within("spindle speed in rpm", self.spindle_speed_rpm, [slowest_rpm, 30.0 * rate.hz()])?;
        let turn_samples = 60.0 * rate.hz() / self.spindle_speed_rpm;
        // With constant, ramp, sine and cosine a window has four samples at least.
        within("turns", self.turns, [4.0 / turn_samples, (LONGEST_WINDOW - 1) as f64 / turn_samples])?;
        within("teeth (lines per turn)", self.lines_per_turn, [1.0, 0.5 * turn_samples])?;
        let most = ((LONGEST_WINDOW - 3) / 2) as f64;
        within("harmonics", self.harmonics.map_or(1.0, |n| n as f64), [1.0, most])
    }

    pub(super) fn basis(&self, rate: SampleRate) -> HarmonicBasis {
        let line_hz = self.lines_per_turn * self.spindle_speed_rpm / 60.0;
        let below = (self.band_hz.min(0.45 * rate.hz()) / line_hz).floor().clamp(1.0, USUAL_HARMONICS as f64);
        HarmonicBasis {
            half_window: (0.5 * self.turns * 60.0 / self.spindle_speed_rpm * rate.hz()).round().min(1e9)
                as usize,
            fundamental_rad: TAU * line_hz / rate.hz(),
            harmonics: self.harmonics.unwrap_or(below as usize),
        }
    }
}
