//! What comes in: one instant of one axis ([`Sample`]), or many of them in columns ([`Recording`]).

use crate::units::SampleRate;
use thiserror::Error;

/// One named signal of a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    /// Name with its unit, for example `x_stage_position_m`.
    pub name: String,
    /// One value a sample.
    pub values: Vec<f64>,
}

/// A uniformly sampled set of signals with what is known about it.
///
/// Every value is finite and all columns have the same length: the reader refuses anything else.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Samples per second.
    pub sample_rate: SampleRate,
    /// Free word: what was being done.
    pub experiment: String,
    /// Names of the axes, in the order of the file.
    pub axes: Vec<String>,
    /// The signals, without the time.
    pub columns: Vec<Column>,
    /// Time of the first sample in s.
    pub start_s: f64,
    /// Metadata that has no field of its own (workpiece, analysis band, ...).
    pub metadata: Vec<(String, String)>,
}

/// Why a signal of a recording cannot be had.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ColumnError {
    /// The recording has no such column.
    #[error("no column {name}; the recording has {present}")]
    Missing {
        /// What was asked for.
        name: String,
        /// What there is, comma separated.
        present: String,
    },
}

impl Recording {
    /// Number of samples.
    #[must_use]
    pub fn len(&self) -> usize {
        self.columns.first().map_or(0, |c| c.values.len())
    }

    /// True when there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of sample `index` in s.
    #[must_use]
    pub fn time_s(&self, index: usize) -> f64 {
        self.start_s + index as f64 / self.sample_rate.hz()
    }

    /// A signal by its full name, if it is there.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&[f64]> {
        self.columns.iter().find(|c| c.name == name).map(|c| c.values.as_slice())
    }

    /// A signal that must be there. Errors: names the column and what there is instead.
    pub fn require(&self, name: &str) -> Result<&[f64], ColumnError> {
        self.get(name).ok_or_else(|| ColumnError::Missing {
            name: name.to_owned(),
            present: self.columns.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", "),
        })
    }

    /// A piece of metadata, if it is there.
    #[must_use]
    pub fn metadata(&self, key: &str) -> Option<&str> {
        self.metadata.iter().find(|(k, _)| k == key).map(|(_, v)| v.as_str())
    }
}
