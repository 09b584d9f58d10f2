//! `track.parquet`: frequency, power and state over time (contracts, section 4).

use crate::pipeline::Margin;
use crate::recording::{RecordingError, Table, TableColumn, write_table};
use std::path::Path;

/// One row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrackRow {
    /// Time in the recording.
    pub t_s: f64,
    /// Strongest line that is no spindle order, while there is one.
    pub frequency_hz: Option<f64>,
    /// Its power, A^2/2.
    pub power_n2: f64,
    /// Whether chatter is declared.
    pub chatter: bool,
    /// Smallest stability margin of the axes, while one is known.
    pub margin: Option<Margin>,
    /// `known`, or why it is not.
    pub margin_state: &'static str,
    /// What explains best what stands out most, other than chatter.
    pub reason: &'static str,
}

/// Rows of `track.parquet`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Track {
    t_s: Vec<f64>,
    frequency_hz: Vec<Option<f64>>,
    power_n2: Vec<f64>,
    chatter: Vec<bool>,
    margin_1_s: Vec<Option<f64>>,
    margin_lo_1_s: Vec<Option<f64>>,
    margin_hi_1_s: Vec<Option<f64>>,
    margin_state: Vec<&'static str>,
    reason: Vec<&'static str>,
}

impl Track {
    /// Adds a row.
    pub fn push(&mut self, row: TrackRow) {
        self.t_s.push(row.t_s);
        self.frequency_hz.push(row.frequency_hz);
        self.power_n2.push(row.power_n2);
        self.chatter.push(row.chatter);
        self.margin_1_s.push(row.margin.map(|m| m.margin_1_s));
        self.margin_lo_1_s.push(row.margin.map(|m| m.lo_1_s));
        self.margin_hi_1_s.push(row.margin.map(|m| m.hi_1_s));
        self.margin_state.push(row.margin_state);
        self.reason.push(row.reason);
    }

    /// Writes the file, whole or not at all.
    pub fn write(&self, path: &Path) -> Result<(), RecordingError> {
        let texts = |words: &[&str]| words.iter().map(|w| (*w).to_owned()).collect::<Vec<String>>();
        let (margin_state, reason) = (texts(&self.margin_state), texts(&self.reason));
        let columns = vec![
            ("t_s", TableColumn::Double(&self.t_s)),
            ("frequency_hz", TableColumn::OptionalDouble(&self.frequency_hz)),
            ("power_n2", TableColumn::Double(&self.power_n2)),
            ("chatter", TableColumn::Bool(&self.chatter)),
            ("stability_margin_1_s", TableColumn::OptionalDouble(&self.margin_1_s)),
            ("stability_margin_lo_1_s", TableColumn::OptionalDouble(&self.margin_lo_1_s)),
            ("stability_margin_hi_1_s", TableColumn::OptionalDouble(&self.margin_hi_1_s)),
            ("stability_margin_state", TableColumn::Text(&margin_state)),
            ("reason", TableColumn::Text(&reason)),
        ];
        write_table(path, &Table { columns, metadata: vec![("format".into(), "stillcut.track/1".into())] })
    }
}
