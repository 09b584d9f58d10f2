//! What physics does a machine model leave out? Locate the mismatch, name it, model it, prove it.
//!
//! ```text
//! recordings, model
//!   first_look   sign, units, something moves               drive/recorded, drive/signals
//!   balance      thrust = numbers + laws, per position      drive/state, drive/columns
//!   inner        products per recording, band, fold         drive/spectra, drive/gram
//!   likelihood   numbers and noise spectrum free            drive/likelihood
//!   bank         every law of the vocabulary, its shape     drive/bank, drive/shape
//!   T and level  worst of gain, folds, recordings;          drive/evidence
//!                artefacts and knockoffs
//!   selection    ask all, fit some, take one, ask again     selection, drive/subject
//!   rest         what stands above the floor, its port      drive/rest
//!   answer       findings, corrections, model, proof        drive/answer, drive/closed_loop
//! ```
//! The method with its figures: `docs/method-diagnosis.md`.

pub mod cut;
mod drive;
mod encoder_noise;
mod first_look;
mod kernel;
mod result;
mod selection;
mod steps;
mod two_cores;

#[cfg(test)]
mod chance;

pub use result::*;

use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
use thiserror::Error;

/// Why a diagnosis is not possible.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DiagnoseError {
    /// No recording was handed in.
    #[error("no recording to diagnose")]
    NoRecording,
    /// The recording and the model have no axis in common.
    #[error("recording {recording}: no axis of the model ({axes}) has its columns in it")]
    NoAxis {
        /// Experiment of the recording.
        recording: String,
        /// Axes of the model.
        axes: String,
    },
    /// A column is missing.
    #[error("recording {recording}: column {expected} is missing")]
    MissingColumn {
        /// Experiment of the recording.
        recording: String,
        /// What was looked for.
        expected: String,
    },
    /// The model does not say how current becomes torque.
    #[error("axis {axis}: a current is recorded, but the model states no torque_constant_nm_a")]
    NoTorqueConstant {
        /// Axis.
        axis: String,
    },
    /// Recordings of different sampling rates.
    #[error("recording {recording}: sampled at {rate_hz} Hz, the first one at {first_hz} Hz; give one rate")]
    MixedRates {
        /// Experiment of the recording.
        recording: String,
        /// Its rate, Hz.
        rate_hz: f64,
        /// Rate of the first recording, Hz.
        first_hz: f64,
    },
    /// Nothing moves in any recording.
    #[error(
        "axis {axis} stands still in {recordings}: it moves by less than a micrometre, and nothing can be \
         told of it; expected is a recording while it feeds"
    )]
    Standing {
        /// Axis.
        axis: String,
        /// Experiments of the recordings.
        recordings: String,
    },
    /// Thrust and motion have opposite signs.
    #[error(
        "recording {recording}, axis {axis}: the current (or thrust) has the opposite sign of what moves \
         the axis: turned, the stated mass and friction explain {percent:.0} % of it; expected is plus for a \
         push towards plus"
    )]
    OppositeSign {
        /// Experiment of the recording.
        recording: String,
        /// Axis.
        axis: String,
        /// Share of the thrust's power that the model explains once it is turned, per cent.
        percent: f64,
    },
    /// Motor and stage disagree about the travel.
    #[error(
        "recording {recording}, axis {axis}: by its encoder and screw_lead_m the motor travels {ratio:.4} \
         times as far as the stage, expected is 1: {hint}"
    )]
    TravelRatio {
        /// Experiment of the recording.
        recording: String,
        /// Axis.
        axis: String,
        /// Travel of the motor over that of the stage.
        ratio: f64,
        /// What such a ratio looks like.
        hint: &'static str,
    },
    /// Too short for the filters.
    #[error("recording {recording}: {samples} samples, at least {needed} are needed")]
    TooShort {
        /// Experiment of the recording.
        recording: String,
        /// Samples there are.
        samples: usize,
        /// Samples needed.
        needed: usize,
    },
}

impl DiagnoseError {
    /// True where the error speaks of a recording with this experiment.
    #[must_use]
    pub fn concerns(&self, experiment: &str) -> bool {
        match self {
            Self::NoRecording | Self::NoTorqueConstant { .. } => false,
            Self::Standing { .. } => true,
            Self::NoAxis { recording, .. }
            | Self::MissingColumn { recording, .. }
            | Self::MixedRates { recording, .. }
            | Self::OppositeSign { recording, .. }
            | Self::TravelRatio { recording, .. }
            | Self::TooShort { recording, .. } => recording == experiment,
        }
    }
}

/// Progress of a diagnosis: a share from 0 to 1 and what is being done.
pub type Progress<'a> = &'a (dyn Fn(f64, &str) + Sync);

/// What an answer may cost, and what of the recordings counts.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnoseOptions {
    /// Seconds within which the answer stands on a slow machine. Work is counted, not time: a busy machine
    /// answers later, not differently.
    pub budget_s: f64,
    /// Per recording, rows that were not measured: they enter no fit. The caller has bridged them. Empty:
    /// all were measured.
    pub masked: Vec<Vec<bool>>,
    /// The caller has moved a column in time: no delay can be told from these recordings.
    pub clock_moved: bool,
}

impl Default for DiagnoseOptions {
    fn default() -> Self {
        Self { budget_s: 60.0, masked: Vec::new(), clock_moved: false }
    }
}

/// Says what `machine` leaves out, from recordings of it. Deterministic.
///
/// Errors: as [`diagnose_with`].
pub fn diagnose(
    machine: &Machine,
    recordings: &[Recording],
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    diagnose_with(machine, recordings, &DiagnoseOptions::default(), progress)
}

/// [`diagnose`] within a budget, with rows that were not measured.
///
/// Errors: no recording, no axis in common, a missing column, a recording shorter than the filters, an axis
/// that stands still, a sign or a unit that is not the stated one.
pub fn diagnose_with(
    machine: &Machine,
    recordings: &[Recording],
    options: &DiagnoseOptions,
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let (axis, others) = axis_of(machine, recordings)?;
    first_look::check(axis, recordings)?;
    let first_hz = recordings[0].sample_rate.hz();
    if let Some(other) = recordings.iter().find(|r| (r.sample_rate.hz() / first_hz - 1.0).abs() > 1e-6) {
        let (recording, rate_hz) = (other.experiment.clone(), other.sample_rate.hz());
        return Err(DiagnoseError::MixedRates { recording, rate_hz, first_hz });
    }
    let beside = drive::Beside {
        masks: &options.masked,
        budget_s: options.budget_s,
        clock_moved: options.clock_moved,
    };
    let mut diagnosis = drive::diagnose(machine, axis, recordings, (beside, progress))?;
    if !others.is_empty() {
        diagnosis.notes.push(format!(
            "This is of axis {}. Also recorded and not looked at: {}; a model with that axis alone answers \
             for it.",
            axis.name,
            others.join(", ")
        ));
    }
    diagnosis.notes.extend(first_look::frozen(axis, recordings));
    Ok(diagnosis)
}

/// The first axis of the model that is recorded and moves, and the names of the other recorded ones; where
/// all stand, the first.
fn axis_of<'a>(
    machine: &'a Machine,
    recordings: &[Recording],
) -> Result<(&'a AxisModel, Vec<&'a str>), DiagnoseError> {
    let first = recordings.first().ok_or(DiagnoseError::NoRecording)?;
    let has =
        |axis: &&AxisModel| first.columns.iter().any(|c| c.name.starts_with(&format!("{}_", axis.name)));
    let recorded: Vec<&AxisModel> = machine.axes.iter().filter(has).collect();
    let moving = recorded.iter().find(|a| first_look::moves(a, recordings));
    let axis = *moving.or(recorded.first()).ok_or_else(|| DiagnoseError::NoAxis {
        recording: first.experiment.clone(),
        axes: machine.axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>().join(", "),
    })?;
    Ok((axis, recorded.iter().map(|a| a.name.as_str()).filter(|name| *name != axis.name).collect()))
}
