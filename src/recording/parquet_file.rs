//! Parquet without Arrow: numeric columns in, numeric columns out.

use super::cuts::{CellTable, Cells};
use super::parquet_guard::Guarded;
use super::quiet::quietly;
use super::{RawTable, RecordingError, beside};
use parquet::basic::{Compression, ConvertedType, Repetition, Type as Physical, ZstdLevel};
use parquet::column::reader::ColumnReader;
use parquet::data_type::{BoolType, ByteArray, ByteArrayType, DoubleType, FloatType, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::metadata::KeyValue;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::Type;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

/// Reads a table. The library behind it panics on some damaged files (negative offsets, a dictionary page
/// that is missing): that too is a damaged file, and no fault of ours.
pub(super) fn read(path: &Path) -> Result<RawTable, RecordingError> {
    quietly(|| read_unguarded(path)).unwrap_or_else(|| Err(damaged(path)))
}

/// Reads a table with its text columns.
pub(super) fn read_cells(path: &Path) -> Result<CellTable, RecordingError> {
    quietly(|| read_columns_unguarded(path, Texts::Read)).unwrap_or_else(|| Err(damaged(path)))
}

fn damaged(path: &Path) -> RecordingError {
    let message = "damaged: its pages are not where its index says".to_owned();
    RecordingError::Format { path: path.to_owned(), message }
}

fn read_unguarded(path: &Path) -> Result<RawTable, RecordingError> {
    let table = read_columns_unguarded(path, Texts::Skip)?;
    let numbers = table.columns.into_iter().filter_map(|(name, cells)| match cells {
        Cells::Numbers(values) => Some((name, values)),
        Cells::Text(_) => None,
    });
    Ok(RawTable { columns: numbers.collect(), metadata: table.metadata })
}

/// Whether columns of text are read: in a recording they carry no signal.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Texts {
    Read,
    Skip,
}

fn read_columns_unguarded(path: &Path, texts: Texts) -> Result<CellTable, RecordingError> {
    let file = File::open(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    let reader = Guarded::new(file)
        .and_then(SerializedFileReader::new)
        .map_err(|e| format_error(format!("not a readable Parquet file: {}", one_line(&e))))?;
    let info = reader.metadata().file_metadata();
    let metadata = info
        .key_value_metadata()
        .map(|list| list.iter().filter_map(|kv| Some((kv.key.clone(), kv.value.clone()?))).collect())
        .unwrap_or_default();
    let mut columns: Vec<(String, Cells)> = Vec::new();
    let descriptions = info.schema_descr();
    for (index, column) in descriptions.columns().iter().enumerate() {
        let name = column.path().string();
        let mut cells = match (column.physical_type(), texts) {
            (Physical::BYTE_ARRAY, Texts::Read) => Cells::Text(Vec::new()),
            (Physical::BYTE_ARRAY | Physical::FIXED_LEN_BYTE_ARRAY | Physical::INT96, _) => continue,
            _ => Cells::Numbers(Vec::new()),
        };
        for group in 0..reader.num_row_groups() {
            let group_reader = reader.get_row_group(group).map_err(|e| format_error(one_line(&e)))?;
            let rows = usize::try_from(group_reader.metadata().num_rows()).unwrap_or(0);
            let mut chunk = group_reader.get_column_reader(index).map_err(|e| format_error(one_line(&e)))?;
            let nullable = column.max_def_level();
            match &mut cells {
                Cells::Numbers(values) => read_chunk(&mut chunk, rows, nullable, values),
                Cells::Text(values) => read_text(&mut chunk, rows, nullable, values),
            }
            .map_err(|e| format_error(format!("column {name}: {}", one_line(&e))))?;
        }
        columns.push((name, cells));
    }
    let rows = columns.first().map_or(0, |(_, cells)| cells.len());
    if let Some((name, cells)) = columns.iter().find(|(_, cells)| cells.len() != rows) {
        return Err(format_error(format!("column {name} has {} rows, the first has {rows}", cells.len())));
    }
    Ok(CellTable { columns, metadata })
}

/// Appends the next `rows` texts; a null, or bytes that are no text, become nothing.
fn read_text(
    reader: &mut ColumnReader,
    rows: usize,
    nullable: i16,
    out: &mut Vec<String>,
) -> Result<(), ParquetError> {
    let ColumnReader::ByteArrayColumnReader(reader) = reader else { return Ok(()) };
    let (mut values, mut levels) = (Vec::new(), Vec::new());
    let mut left = rows;
    while left > 0 {
        values.clear();
        levels.clear();
        let (read, _, _) = reader.read_records(left, Some(&mut levels), None, &mut values)?;
        if read == 0 {
            break;
        }
        left -= read;
        let text = |bytes: &ByteArray| bytes.as_utf8().map_or_else(|_| String::new(), str::to_owned);
        if nullable == 0 {
            out.extend(values.iter().map(text));
        } else {
            let mut present = values.iter();
            let of = |level: &i16| {
                if *level == nullable { present.next().map_or_else(String::new, text) } else { String::new() }
            };
            out.extend(levels.iter().map(of));
        }
    }
    Ok(())
}

/// What the library says, without saying again that it is no Parquet.
pub(super) fn one_line(error: &ParquetError) -> String {
    let text = error.to_string().replace("Parquet error: ", "").replace("Invalid Parquet file. ", "");
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Appends the next `rows` values; a null becomes NaN, which the caller refuses with its row.
pub(super) fn read_chunk(
    reader: &mut ColumnReader,
    rows: usize,
    nullable: i16,
    out: &mut Vec<f64>,
) -> Result<(), ParquetError> {
    macro_rules! typed {
        ($reader:expr, $convert:expr) => {{
            let reader = $reader;
            let (mut values, mut levels) = (Vec::new(), Vec::new());
            let mut left = rows;
            while left > 0 {
                values.clear();
                levels.clear();
                let (read, _, _) = reader.read_records(left, Some(&mut levels), None, &mut values)?;
                if read == 0 {
                    break;
                }
                left -= read;
                let mut present = values.iter();
                if nullable == 0 {
                    out.extend(present.map($convert));
                } else {
                    out.extend(levels.iter().map(|l| {
                        if *l == nullable { present.next().map_or(f64::NAN, $convert) } else { f64::NAN }
                    }));
                }
            }
        }};
    }
    match reader {
        ColumnReader::DoubleColumnReader(r) => typed!(r, |v: &f64| *v),
        ColumnReader::FloatColumnReader(r) => typed!(r, |v: &f32| f64::from(*v)),
        ColumnReader::Int32ColumnReader(r) => typed!(r, |v: &i32| f64::from(*v)),
        ColumnReader::Int64ColumnReader(r) => typed!(r, |v: &i64| *v as f64),
        ColumnReader::BoolColumnReader(r) => typed!(r, |v: &bool| f64::from(u8::from(*v))),
        ColumnReader::Int96ColumnReader(_)
        | ColumnReader::ByteArrayColumnReader(_)
        | ColumnReader::FixedLenByteArrayColumnReader(_) => {}
    }
    Ok(())
}

/// Values of one column to write.
#[derive(Debug, Clone, Copy)]
pub enum TableColumn<'a> {
    /// 64-bit numbers.
    Double(&'a [f64]),
    /// 64-bit numbers, some missing.
    OptionalDouble(&'a [Option<f64>]),
    /// 32-bit numbers.
    Float(&'a [f32]),
    /// Integers.
    Integer(&'a [i64]),
    /// Yes or no.
    Bool(&'a [bool]),
    /// Text.
    Text(&'a [String]),
}

/// A table to write.
#[derive(Debug, Clone)]
pub struct Table<'a> {
    /// Name and values, all of one length.
    pub columns: Vec<(&'a str, TableColumn<'a>)>,
    /// Key-value metadata of the file.
    pub metadata: Vec<(String, String)>,
}

/// Writes a table as Parquet (zstd), whole or not at all.
pub fn write_table(path: &Path, table: &Table<'_>) -> Result<(), RecordingError> {
    write_beside(path, |part| write_to(part, table))
}

/// Writes columns of 64-bit numbers as Parquet (zstd), whole or not at all. One column is in memory at a
/// time: `fill` appends the values of the column with that index to an empty list.
pub(super) fn write_doubles(
    path: &Path,
    (names, metadata): (&[String], Vec<(String, String)>),
    fill: &mut dyn FnMut(usize, &mut Vec<f64>),
) -> Result<(), RecordingError> {
    write_beside(path, |part| {
        let mut values = Vec::new();
        let fields = names.iter().map(|name| field(name, TableColumn::Double(&[])));
        write_groups(part, (fields.collect(), metadata), |group| {
            for index in 0..names.len() {
                values.clear();
                fill(index, &mut values);
                write_column(group, TableColumn::Double(&values))?;
            }
            Ok(())
        })
    })
}

fn write_beside(
    path: &Path,
    write: impl FnOnce(&Path) -> Result<(), RecordingError>,
) -> Result<(), RecordingError> {
    let part = beside(path);
    // Nobody knows the name beside: what is told is the one that was asked for.
    let outcome = write(&part).map_err(|error| match error {
        RecordingError::Io { source, .. } => RecordingError::Io { path: path.to_owned(), source },
        RecordingError::Format { message, .. } => RecordingError::Format { path: path.to_owned(), message },
        other => other,
    });
    let finished = outcome.and_then(|()| {
        std::fs::rename(&part, path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })
    });
    if finished.is_err() {
        let _ = std::fs::remove_file(&part); // the error that is reported is the first one
    }
    finished
}

fn write_to(path: &Path, table: &Table<'_>) -> Result<(), RecordingError> {
    let fields = table.columns.iter().map(|(name, column)| field(name, *column));
    write_groups(path, (fields.collect(), table.metadata.clone()), |group| {
        table.columns.iter().try_for_each(|(_, column)| write_column(group, *column))
    })
}

type Fields = Result<Vec<Arc<Type>>, ParquetError>;

/// A file with one row group, whose columns `write` writes.
fn write_groups(
    path: &Path,
    (fields, metadata): (Fields, Vec<(String, String)>),
    write: impl FnOnce(&mut SerializedRowGroupWriter<'_, File>) -> Result<(), ParquetError>,
) -> Result<(), RecordingError> {
    let format_error =
        |e: ParquetError| RecordingError::Format { path: path.to_owned(), message: one_line(&e) };
    let fields = fields.map_err(format_error)?;
    let schema = Type::group_type_builder("schema").with_fields(fields).build().map_err(format_error)?;
    let metadata = metadata.into_iter().map(|(k, v)| KeyValue::new(k, v)).collect();
    let properties = WriterProperties::builder()
        .set_compression(Compression::ZSTD(ZstdLevel::default()))
        .set_key_value_metadata(Some(metadata))
        .build();
    let file = File::create(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    let mut writer =
        SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties)).map_err(format_error)?;
    let mut group = writer.next_row_group().map_err(format_error)?;
    write(&mut group).map_err(format_error)?;
    group.close().map_err(format_error)?;
    writer.close().map_err(format_error)?;
    Ok(())
}

fn field(name: &str, column: TableColumn<'_>) -> Result<Arc<Type>, ParquetError> {
    let (physical, repetition) = match column {
        TableColumn::Double(_) => (Physical::DOUBLE, Repetition::REQUIRED),
        TableColumn::OptionalDouble(_) => (Physical::DOUBLE, Repetition::OPTIONAL),
        TableColumn::Float(_) => (Physical::FLOAT, Repetition::REQUIRED),
        TableColumn::Integer(_) => (Physical::INT64, Repetition::REQUIRED),
        TableColumn::Bool(_) => (Physical::BOOLEAN, Repetition::REQUIRED),
        TableColumn::Text(_) => (Physical::BYTE_ARRAY, Repetition::REQUIRED),
    };
    let builder = Type::primitive_type_builder(name, physical).with_repetition(repetition);
    let is_text = matches!(column, TableColumn::Text(_));
    let builder = if is_text { builder.with_converted_type(ConvertedType::UTF8) } else { builder };
    Ok(Arc::new(builder.build()?))
}

fn write_column(
    group: &mut SerializedRowGroupWriter<'_, File>,
    column: TableColumn<'_>,
) -> Result<(), ParquetError> {
    let Some(mut writer) = group.next_column()? else {
        return Err(ParquetError::General("more columns than the schema has".into()));
    };
    match column {
        TableColumn::Double(v) => writer.typed::<DoubleType>().write_batch(v, None, None)?,
        TableColumn::OptionalDouble(v) => {
            let levels: Vec<i16> = v.iter().map(|x| i16::from(x.is_some())).collect();
            let present: Vec<f64> = v.iter().copied().flatten().collect();
            writer.typed::<DoubleType>().write_batch(&present, Some(&levels), None)?
        }
        TableColumn::Float(v) => writer.typed::<FloatType>().write_batch(v, None, None)?,
        TableColumn::Integer(v) => writer.typed::<Int64Type>().write_batch(v, None, None)?,
        TableColumn::Bool(v) => writer.typed::<BoolType>().write_batch(v, None, None)?,
        TableColumn::Text(v) => {
            let bytes: Vec<ByteArray> = v.iter().map(|s| ByteArray::from(s.as_str())).collect();
            writer.typed::<ByteArrayType>().write_batch(&bytes, None, None)?
        }
    };
    writer.close()
}
