//! From what was typed (TOML, unknown keys refused by name) to what it means (checked core types).

pub mod accelerometers;
pub mod force;
pub mod import_map;
pub mod machine;
pub mod scenario;
pub mod service;

use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a file is not the configuration it was meant to be. One line: file, place, what was expected.
#[derive(Debug, Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: {source}", path.display())]
    Read {
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not what the format expects.
    #[error("{}:{line}:{column}: {message}", path.display())]
    Syntax {
        /// File.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// Column, from 1.
        column: usize,
        /// What is wrong, one line.
        message: String,
    },
    /// The text is well formed, its content is not.
    #[error("{}: {place}: {message}", path.display())]
    Content {
        /// File.
        path: PathBuf,
        /// Table or key.
        place: String,
        /// What is wrong, one line.
        message: String,
    },
}

/// Reads a text file. Errors: [`ConfigError::Read`].
pub fn read_text(path: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(path).map_err(|source| ConfigError::Read { path: path.to_owned(), source })
}

/// A number within a range. Errors: one line with its place.
pub(crate) fn parse_number(
    path: &Path,
    place: &str,
    value: f64,
    (low, high): (f64, f64),
) -> Result<f64, ConfigError> {
    if value.is_finite() && (low..=high).contains(&value) {
        return Ok(value);
    }
    let message = format!("{value} is not between {low} and {high}");
    Err(ConfigError::Content { path: path.to_owned(), place: place.to_owned(), message })
}

/// Parses TOML into `T` and turns a failure into one line with its place.
pub fn parse<T: serde::de::DeserializeOwned>(path: &Path, text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|e| {
        let offset = e.span().map_or(0, |s| s.start.min(text.len()));
        let before = text.get(..offset).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |l| l.chars().count()) + 1;
        let message = e.message().split_whitespace().collect::<Vec<_>>().join(" ");
        ConfigError::Syntax { path: path.to_owned(), line, column, message }
    })
}
