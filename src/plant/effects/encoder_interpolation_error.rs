//! Error inside each signal period of an encoder.

use super::law::{harmonics, wave_sum};
use super::{EffectKind, PHASE, Parameter, PhysicsTerm, Specification};

/// Of the first harmonic.
pub const PERIOD: Parameter = Parameter::further("signal_period_m", "m");
/// Of the first harmonic.
pub const AMPLITUDE: Parameter = Parameter::size("amplitude_m", "m");
/// Sine and cosine of each.
pub const HARMONICS: Parameter = Parameter::size("harmonics_m", "m");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "position",
    equation: "x_read = x + sum_h A_h sin(2 pi h x / p + phase_h)",
    phrase: |_| "that the {port} reads wrong by {amplitude_m}, once in {signal_period_m} of travel",
    told_apart_by: "a slow stroke at two speeds, with the signal period's line below the axial resonance",
    ..Specification::new(EffectKind::EncoderInterpolationError, &[AMPLITUDE, HARMONICS, PERIOD, PHASE])
};

/// A periodic error of one encoder.
#[derive(Debug, Clone, PartialEq)]
pub struct EncoderError {
    period_m: f64,
    harmonics_m: Vec<[f64; 2]>,
}

impl EncoderError {
    /// The error that a term states; `None`: another effect, or a parameter is missing.
    #[must_use]
    pub fn of(term: &PhysicsTerm) -> Option<Self> {
        if term.effect != EffectKind::EncoderInterpolationError {
            return None;
        }
        let period_m = term.value(&PERIOD)?;
        Some(Self { period_m, harmonics_m: harmonics(term, &HARMONICS, &AMPLITUDE)? })
    }

    /// Period, and sine and cosine amplitude of each harmonic, m.
    #[must_use]
    pub fn wave(&self) -> (f64, &[[f64; 2]]) {
        (self.period_m, &self.harmonics_m)
    }

    /// What is read too much at a position, m.
    #[must_use]
    pub fn at(&self, position_m: f64) -> f64 {
        wave_sum(position_m, self.period_m, &self.harmonics_m)
    }
}
