//! CSV with a header line: columns of numbers, the rate from `t_s`.

use super::cuts::{CellTable, Cells};
use super::{RawTable, RecordingError};
use crate::config::import_map::Source;
use std::path::Path;

pub(super) fn read(path: &Path) -> Result<RawTable, RecordingError> {
    read_with(path, &Source::default())
}

/// Reads a CSV whose first line holds the names, every cell as text.
pub(super) fn read_cells(path: &Path) -> Result<CellTable, RecordingError> {
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    let file =
        std::fs::File::open(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(std::io::BufReader::new(file));
    let head = reader.headers().map_err(|e| format_error(e.to_string()))?;
    // The first name may carry a byte-order mark.
    let mut columns: Vec<(String, Vec<String>)> =
        head.iter().map(|name| (name.trim_start_matches('\u{feff}').to_owned(), Vec::new())).collect();
    for record in reader.records() {
        let record = record.map_err(|e| format_error(e.to_string()))?;
        for ((_, values), text) in columns.iter_mut().zip(record.iter()) {
            values.push(text.to_owned());
        }
    }
    let columns = columns.into_iter().map(|(name, values)| (name, Cells::Text(values))).collect();
    Ok(CellTable { columns, metadata: Vec::new() })
}

/// Reads a CSV of a stated shape: separator, line of the names, first line of numbers.
pub(super) fn read_with(path: &Path, source: &Source) -> Result<RawTable, RecordingError> {
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    let delimiter = u8::try_from(source.delimiter)
        .map_err(|_| format_error(format!("delimiter `{}` is not a single byte", source.delimiter)))?;
    let file =
        std::fs::File::open(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    let mut reader = csv::ReaderBuilder::new()
        .trim(csv::Trim::All)
        .has_headers(false)
        .flexible(source.header_row != 1)
        .delimiter(delimiter)
        .from_reader(std::io::BufReader::new(file));
    let data_row = source.data_row.unwrap_or(source.header_row + 1).max(1);
    let mut columns: Vec<(String, Vec<f64>)> = Vec::new();
    for (line, record) in reader.records().enumerate() {
        let line = line + 1;
        let record = record.map_err(|e| format_error(format!("line {line}: {e}")))?;
        if line == source.header_row {
            // The first name may carry a byte-order mark.
            columns =
                record.iter().map(|n| (n.trim_start_matches('\u{feff}').to_owned(), Vec::new())).collect();
        }
        if line < data_row {
            continue;
        }
        if columns.is_empty() {
            columns = (1..=record.len()).map(|k| (k.to_string(), Vec::new())).collect();
        }
        let row = line - data_row;
        if record.len() < columns.len() {
            let (missing, _) = &columns[record.len()];
            let message = "the line ends before this column".to_owned();
            return Err(RecordingError::Value {
                path: path.to_owned(),
                column: missing.clone(),
                row,
                message,
            });
        }
        for ((name, values), text) in columns.iter_mut().zip(record.iter()) {
            let value = text.parse::<f64>().map_err(|_| RecordingError::Value {
                path: path.to_owned(),
                column: name.clone(),
                row,
                message: format!("`{}` is not a number", text.escape_debug()),
            })?;
            values.push(value);
        }
    }
    if columns.is_empty() {
        return Err(format_error("the file is empty; a header line is expected".into()));
    }
    Ok(RawTable { columns, metadata: Vec::new() })
}
