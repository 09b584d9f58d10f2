//! A Parquet recording read piece by piece: one page of each column is in memory, however long it is.

use super::parquet_file::{one_line, read_chunk};
use super::parquet_guard::Guarded;
use super::quiet::quietly;
use super::{OWN_KEYS, RecordingError, axes_of, meta_of, no_name_twice, stated_rate, stem};
use crate::sample::{Column, Recording};
use parquet::basic::Type as Physical;
use parquet::errors::ParquetError;
use parquet::file::reader::{FileReader as _, SerializedFileReader};
use std::fs::File;
use std::path::{Path, PathBuf};

/// A recording whose values are read when they are asked for.
pub struct StreamedRecording {
    path: PathBuf,
    reader: SerializedFileReader<Guarded>,
    /// Place and deepest level of each column of the head.
    places: Vec<(usize, i16)>,
    head: Recording,
}

impl std::fmt::Debug for StreamedRecording {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("StreamedRecording").field("path", &self.path).finish_non_exhaustive()
    }
}

fn damaged(path: &Path) -> RecordingError {
    let message = "damaged: its pages are not where its index says".to_owned();
    RecordingError::Format { path: path.to_owned(), message }
}

impl StreamedRecording {
    /// Opens a recording in Parquet. Errors: unreadable file, no time, no rate, no signal.
    pub fn open(path: &Path) -> Result<Self, RecordingError> {
        quietly(|| Self::open_unguarded(path)).unwrap_or_else(|| Err(damaged(path)))
    }

    fn open_unguarded(path: &Path) -> Result<Self, RecordingError> {
        let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
        let file = File::open(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
        let reader = Guarded::new(file)
            .and_then(SerializedFileReader::new)
            .map_err(|e| format_error(format!("not a readable Parquet file: {}", one_line(&e))))?;
        let info = reader.metadata().file_metadata();
        let pairs = info.key_value_metadata().into_iter().flatten();
        let metadata: Vec<_> = pairs.filter_map(|kv| Some((kv.key.clone(), kv.value.clone()?))).collect();
        let sample_rate = stated_rate(path, &metadata)?
            .ok_or_else(|| format_error("no sampling rate: metadata sample_rate_hz is missing".into()))?;
        let (mut places, mut columns, mut time) = (Vec::new(), Vec::new(), None);
        for (index, column) in info.schema_descr().columns().iter().enumerate() {
            let kind = column.physical_type();
            let place = (index, column.max_def_level());
            match column.path().string() {
                // Text carries no signal.
                _ if matches!(
                    kind,
                    Physical::BYTE_ARRAY | Physical::FIXED_LEN_BYTE_ARRAY | Physical::INT96
                ) => {}
                name if name == "t_s" => time = Some(place),
                name => {
                    places.push(place);
                    columns.push(Column { name, values: Vec::new() });
                }
            }
        }
        let time = time.ok_or_else(|| format_error("required column t_s is missing".into()))?;
        if columns.is_empty() {
            return Err(format_error("there is no signal beside t_s".into()));
        }
        no_name_twice(path, columns.iter().map(|c| c.name.as_str()))?;
        let axes = axes_of(&metadata, &columns);
        let experiment = meta_of(&metadata, "experiment").unwrap_or_else(|| stem(path));
        let metadata = metadata.into_iter().filter(|(k, _)| !OWN_KEYS.contains(&k.as_str())).collect();
        let head = Recording { sample_rate, experiment, axes, columns, start_s: 0.0, metadata };
        let mut streamed = Self { path: path.to_owned(), reader, places, head };
        let mut first = None;
        streamed.visit(&[time], 1, &mut |_, values| {
            first = values[0].first().copied();
            false
        })?;
        streamed.head.start_s = first.ok_or_else(|| format_error("0 rows; at least 2 are needed".into()))?;
        Ok(streamed)
    }

    /// What it says beside its values: the columns of this recording are empty.
    #[must_use]
    pub fn head(&self) -> &Recording {
        &self.head
    }

    /// Goes through all rows: `take` gets the number of the first and `at_once` values or fewer of each
    /// column, and answers whether to go on. Errors: damage, or a value that is no finite number.
    pub fn rows(
        &self,
        at_once: usize,
        take: &mut dyn FnMut(usize, &[Vec<f64>]) -> bool,
    ) -> Result<(), RecordingError> {
        quietly(|| self.visit(&self.places, at_once, take)).unwrap_or_else(|| Err(damaged(&self.path)))
    }

    /// Goes through one column. Errors: as of [`Self::rows`].
    pub fn column(
        &self,
        index: usize,
        at_once: usize,
        take: &mut dyn FnMut(usize, &[f64]) -> bool,
    ) -> Result<(), RecordingError> {
        let Some(place) = self.places.get(index) else { return Ok(()) };
        let mut one = |row: usize, values: &[Vec<f64>]| take(row, values.first().map_or(&[], |v| v));
        quietly(|| self.visit(std::slice::from_ref(place), at_once, &mut one))
            .unwrap_or_else(|| Err(damaged(&self.path)))
    }

    fn visit(
        &self,
        places: &[(usize, i16)],
        at_once: usize,
        take: &mut dyn FnMut(usize, &[Vec<f64>]) -> bool,
    ) -> Result<(), RecordingError> {
        let broken = |message: String| RecordingError::Format { path: self.path.clone(), message };
        let failed = |e: ParquetError| broken(one_line(&e));
        let mut values = vec![Vec::with_capacity(at_once); places.len()];
        let mut row = 0;
        for group in 0..self.reader.num_row_groups() {
            let group = self.reader.get_row_group(group).map_err(failed)?;
            let mut left = usize::try_from(group.metadata().num_rows()).unwrap_or(0);
            let chunks: Result<Vec<_>, _> = places.iter().map(|p| group.get_column_reader(p.0)).collect();
            let mut chunks = chunks.map_err(failed)?;
            while left > 0 {
                let count = left.min(at_once);
                for ((chunk, (_, level)), values) in chunks.iter_mut().zip(places).zip(&mut values) {
                    values.clear();
                    read_chunk(chunk, count, *level, values).map_err(failed)?;
                    if values.len() != count || values.iter().any(|v| !v.is_finite()) {
                        let end = row + count;
                        let what = format!("rows {row} to {end}: missing values, or no finite numbers");
                        return Err(broken(what));
                    }
                }
                if !take(row, &values) {
                    return Ok(());
                }
                row += count;
                left -= count;
            }
        }
        Ok(())
    }
}
