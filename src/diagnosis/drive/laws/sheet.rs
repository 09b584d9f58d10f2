//! Estimates of a law with their intervals.

use super::{Balance, Criteria, Z95};
use crate::diagnosis::result::Estimate;
use crate::plant::effects::periodic::amplitude_phase;
use crate::plant::effects::{PHASE, Parameter};

/// Intervals end at this many times a value: the data say nothing.
const MOST_DOUBT: f64 = 1e3;

/// Deviations of a law's amplitudes and of the logarithms of its constants.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct Deviations {
    pub(crate) amplitudes: Vec<f64>,
    pub(crate) constants: Vec<f64>,
}

/// A law as the last fit has it.
pub(crate) struct Told<'a> {
    pub(crate) balance: &'a Balance,
    /// Dry friction of the stage, N.
    pub(crate) coulomb_n: f64,
    pub(crate) amplitudes: &'a [f64],
    pub(crate) deviations: &'a Deviations,
}

impl Told<'_> {
    /// An amplitude.
    pub(crate) fn amplitude(&self, k: usize) -> f64 {
        self.amplitudes.get(k).copied().unwrap_or(0.0)
    }

    /// Its deviation.
    pub(crate) fn deviation(&self, k: usize) -> f64 {
        self.deviations.amplitudes.get(k).copied().unwrap_or(0.0)
    }

    /// Deviation of the logarithm of a constant.
    pub(crate) fn relative(&self, k: usize) -> f64 {
        self.deviations.constants.get(k).copied().unwrap_or(0.0)
    }

    /// A force over the dry friction of the stage.
    pub(crate) fn of_coulomb(&self, force_n: f64) -> f64 {
        force_n / self.coulomb_n.max(1e-300)
    }
}

/// Relative deviation of every force by the torque constant; none where a force is recorded.
pub(crate) fn scale_deviation(balance: &Balance) -> f64 {
    let current = balance.signals.tracks.iter().any(|t| t.reference.is_current);
    if current { Criteria::STANDARD.torque_constant_tolerance } else { 0.0 }
}

/// Collects estimates.
pub(crate) struct Sheet {
    pub(crate) list: Vec<Estimate>,
    /// See [`scale_deviation`].
    pub(crate) scale: f64,
}

impl Sheet {
    pub(crate) fn add(&mut self, p: &Parameter, value: f64, deviation: f64) {
        let half = (Z95 * deviation).min(MOST_DOUBT * value.abs()).max(1e-12 * value.abs());
        self.list.push(Estimate::within(p, value, half));
    }

    /// A number measured in newtons: the torque constant's own error adds.
    pub(crate) fn force(&mut self, p: &Parameter, value: f64, deviation: f64) {
        self.add(p, value, deviation.hypot(self.scale * value));
    }

    /// Amplitude, with that relative deviation of its scale, and phase of a wave.
    pub(crate) fn wave(&mut self, (p, scale): (&Parameter, f64), told: &Told<'_>) {
        let (amplitude, phase) = amplitude_phase(told.amplitude(0), told.amplitude(1));
        let deviation = told.deviation(0).max(told.deviation(1));
        self.add(p, amplitude, deviation.hypot(scale * amplitude));
        self.add(&PHASE, phase, deviation / amplitude.max(1e-300));
    }

    /// A constant of a law that is evaluated between samples, by its logarithm.
    pub(crate) fn constant(&mut self, p: &Parameter, value: f64, relative: f64) {
        let half = (Z95 * relative.hypot(Criteria::STANDARD.exactness)).min(MOST_DOUBT.ln());
        let ci95 = [value * (-half).exp(), value * half.exp()];
        self.list.push(Estimate { ci95, ..Estimate::within(p, value, 0.0) });
    }
}
