//! Error inside each signal period of an encoder.

use super::law::{harmonics, wave_sum};
use super::{EffectKind, PHASE, Parameter, PhysicsTerm, Specification};
use std::f64::consts::TAU;

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

    /// An error by its signal period and sine and cosine of each harmonic, m.
    #[must_use]
    pub fn new(period_m: f64, amplitudes_m: &[f64]) -> Self {
        Self { period_m, harmonics_m: amplitudes_m.chunks_exact(2).map(|c| [c[0], c[1]]).collect() }
    }

    /// What reads backwards somewhere is no encoder.
    #[must_use]
    pub fn reads_forwards(&self) -> bool {
        let slopes = self.harmonics_m.iter().zip(1..).map(|([s, c], n)| f64::from(n) * s.hypot(*c));
        TAU * slopes.sum::<f64>() <= self.period_m
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
