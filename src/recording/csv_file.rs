//! CSV with a header line: columns of numbers, the rate from `t_s`.

use super::{RawTable, RecordingError};
use std::path::Path;

pub(super) fn read(path: &Path) -> Result<RawTable, RecordingError> {
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    let file =
        std::fs::File::open(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    let mut reader =
        csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(std::io::BufReader::new(file));
    let header = reader.headers().map_err(|e| format_error(e.to_string()))?.clone();
    let mut columns: Vec<(String, Vec<f64>)> =
        header.iter().map(|name| (name.to_owned(), Vec::new())).collect();
    for (row, record) in reader.records().enumerate() {
        let record = record.map_err(|e| format_error(format!("row {row}: {e}")))?;
        for ((name, values), text) in columns.iter_mut().zip(record.iter()) {
            let value = text.parse::<f64>().map_err(|_| RecordingError::Value {
                path: path.to_owned(),
                column: name.clone(),
                row,
                message: format!("`{text}` is not a number"),
            })?;
            values.push(value);
        }
    }
    Ok(RawTable { columns, metadata: Vec::new() })
}
