//! MAT files (version 5 to 7): every numeric vector as a column; fields of a structure as `name.field`.

use super::quiet::quietly;
use super::{RawTable, RecordingError};
use matrw::{MatFile, MatVariable, MatlabType, load_matfile_from_u8};
use std::path::Path;

/// Reads the numeric vectors of a MAT file. Columns may differ in length: constants stand beside signals.
/// Errors: unreadable or damaged file, version 7.3 (HDF5), no numeric variable.
pub(crate) fn read(path: &Path) -> Result<RawTable, RecordingError> {
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    let bytes = std::fs::read(path).map_err(|source| RecordingError::Io { path: path.to_owned(), source })?;
    let file = parse(&bytes).map_err(format_error)?;
    let mut columns = Vec::new();
    for (name, variable) in file.iter() {
        collect(name, variable, &mut columns);
    }
    if columns.is_empty() {
        return Err(format_error("no numeric variable in this MAT file".into()));
    }
    Ok(RawTable { columns, metadata: Vec::new() })
}

/// The parser panics on some damaged files; that is turned into an error here.
fn parse(bytes: &[u8]) -> Result<MatFile, String> {
    match quietly(|| load_matfile_from_u8(bytes)) {
        Some(Ok(file)) => Ok(file),
        Some(Err(error)) => Err(format!(
            "not a readable MAT file: {}",
            error.to_string().split_whitespace().collect::<Vec<_>>().join(" ")
        )),
        None => Err("not a readable MAT file: damaged".to_owned()),
    }
}

fn collect(name: &str, variable: &MatVariable, columns: &mut Vec<(String, Vec<f64>)>) {
    match variable {
        MatVariable::NumericArray(array) => {
            if let Some(values) = numbers(&array.value) {
                columns.push((name.to_owned(), values));
            }
        }
        MatVariable::Structure(structure) => {
            for field in structure.fieldnames() {
                if let Some(inner) = structure.get(&field) {
                    collect(&format!("{name}.{field}"), inner, columns);
                }
            }
        }
        _ => {} // text, cells and sparse matrices carry no signal
    }
}

fn numbers(value: &MatlabType) -> Option<Vec<f64>> {
    fn cast<T: Copy + Into<f64>>(values: &[T]) -> Vec<f64> {
        values.iter().map(|v| (*v).into()).collect()
    }
    Some(match value {
        MatlabType::F64(v) => v.clone(),
        MatlabType::F32(v) => cast(v),
        MatlabType::U8(v) => cast(v),
        MatlabType::I8(v) => cast(v),
        MatlabType::U16(v) => cast(v),
        MatlabType::I16(v) => cast(v),
        MatlabType::U32(v) => cast(v),
        MatlabType::I32(v) => cast(v),
        MatlabType::U64(v) => v.iter().map(|x| *x as f64).collect(),
        MatlabType::I64(v) => v.iter().map(|x| *x as f64).collect(),
        MatlabType::BOOL(v) => v.iter().map(|x| f64::from(u8::from(*x))).collect(),
        MatlabType::UTF8(_) | MatlabType::UTF16(_) => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_file_is_an_error_and_no_panic() {
        for bytes in [&b""[..], &b"MATLAB 5.0 MAT-file"[..], &[0xff_u8; 400][..]] {
            assert!(parse(bytes).is_err());
        }
    }
}
