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
    #[error("{what} {}: {source}", path.display())]
    Read {
        /// What the file was to hold.
        what: &'static str,
        /// File.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The text is not what the format expects.
    #[error("{}:{line}:{column}: {}", path.display(), in_one_line(message))]
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
    #[error("{}: {}: {}", path.display(), in_one_line(place), in_one_line(message))]
    Content {
        /// File.
        path: PathBuf,
        /// Table or key.
        place: String,
        /// What is wrong, one line.
        message: String,
    },
}

/// Names in a file may hold line breaks; what is said of them may not.
pub(crate) fn in_one_line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { c.escape_default().to_string() } else { c.into() }).collect()
}

/// Reads a text file that is to hold `what`. Errors: [`ConfigError::Read`].
pub fn read_text(path: &Path, what: &'static str) -> Result<String, ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::InvalidData => std::io::Error::new(e.kind(), "not text; expected TOML in UTF-8"),
        _ => e,
    });
    text.map_err(|source| ConfigError::Read { what, path: path.to_owned(), source })
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

/// Names the known key that is nearest to an unknown one.
fn with_nearest(message: String) -> String {
    let words: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let Some((unknown, known)) = words.split_first().filter(|_| message.starts_with("unknown ")) else {
        return message;
    };
    let nearest = known.iter().map(|k| (edits(unknown, k), *k)).min();
    match nearest {
        Some((count, key)) if count * 2 <= key.len() => {
            format!("{message}; did you mean `{key}`?")
        }
        _ => message,
    }
}

/// Names the key of the line that an error is about, where the parser does not; a key without a value is
/// pointed at behind its sign, and not into the remark that follows.
fn with_key(line: &str, column: usize, message: String) -> (usize, String) {
    let Some((key, rest)) = line.split_once('=') else {
        let table = line.trim().split_once(']').map(|(table, _)| format!("{table}]"));
        let named = table.filter(|table| table.starts_with('[') && !message.contains('`'));
        return (column, named.map_or_else(|| message.clone(), |table| format!("`{table}`: {message}")));
    };
    let key = key.trim();
    let plain = |c: char| c.is_ascii_alphanumeric() || "_-.\"".contains(c);
    if key.is_empty() || !key.chars().all(plain) {
        return (column, message);
    }
    if rest.trim_start().is_empty() || rest.trim_start().starts_with('#') {
        let behind = line.chars().take_while(|c| *c != '=').count() + 2;
        return (behind, format!("`{key}` has no value"));
    }
    if message.contains(&format!("`{key}`")) {
        return (column, message);
    }
    (column, format!("`{key}`: {message}"))
}

/// How many letters must be changed, put in or left out to make one word of the other (Levenshtein).
fn edits(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut corner = std::mem::replace(&mut row[0], i + 1);
        for (j, y) in b.bytes().enumerate() {
            let change = corner + usize::from(x != y);
            corner = row[j + 1];
            row[j + 1] = change.min(corner + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

/// Parses TOML into `T` and turns a failure into one line with its place.
pub fn parse<T: serde::de::DeserializeOwned>(path: &Path, text: &str) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|e| {
        let offset = e.span().map_or(0, |s| s.start.min(text.len()));
        let before = text.get(..offset).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let column = before.rsplit('\n').next().map_or(0, |l| l.chars().count()) + 1;
        let message = e.message().split_whitespace().collect::<Vec<_>>().join(" ");
        let message = with_nearest(message);
        let message = message.replace("integer number overflowed", "a whole number has 19 digits at most");
        let line_text = text.lines().nth(line - 1).unwrap_or_default();
        let (column, message) = with_key(line_text, column, message);
        ConfigError::Syntax { path: path.to_owned(), line, column, message }
    })
}

/// Year, month and day with dashes, a day that the calendar has.
pub(crate) fn is_date(text: &str) -> bool {
    let numbers: Vec<u32> = text.split('-').filter_map(|part| part.parse().ok()).collect();
    let form = text.len() == 10 && text.bytes().enumerate().all(|(i, b)| (b == b'-') == (i == 4 || i == 7));
    let leap = |year: u32| year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400));
    let last = |year, month| match month {
        2 if leap(year) => 29,
        2 => 28,
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    };
    form && matches!(numbers[..], [year, month @ 1..=12, day] if (1..=last(year, month)).contains(&day))
}

#[cfg(test)]
mod tests {
    use super::{edits, in_one_line, parse, with_nearest};

    #[test]
    fn what_is_said_of_a_file_stays_in_one_line() {
        assert_eq!(in_one_line("axis a\n\u{1}\\ü"), "axis a\\n\\u{1}\\ü");
    }

    #[test]
    fn the_key_at_fault_is_named_and_pointed_at() {
        let said = |text: &str| {
            let parsed = parse::<toml::Table>(std::path::Path::new("c.toml"), text);
            parsed.unwrap_err().to_string()
        };
        assert_eq!(said("[a]\nbefore_s =   # s kept before\n"), "c.toml:2:11: `before_s` has no value");
        assert_eq!(said("[a]\nbefore_s =\nx = 1\n"), "c.toml:2:11: `before_s` has no value");
        let twice = said("[a]\nx = 1\nx = 2\n");
        assert!(
            twice.starts_with("c.toml:3:1: ") && twice.contains("`x`") && twice.contains("duplicate"),
            "{twice}"
        );
        let long = said(&format!("x = {}\n", "9".repeat(300)));
        assert_eq!(long, "c.toml:1:5: `x`: a whole number has 19 digits at most");
        assert!(said("x = yes\n").contains("`x`"), "{}", said("x = yes\n"));
        let table = said("[log]\nx = 1\n[log] # again\n");
        assert!(table.starts_with("c.toml:3:") && table.contains("`[log]`: duplicate key"), "{table}");
    }

    #[test]
    fn the_nearest_key_is_named() {
        assert_eq!([edits("kitten", "sitting"), edits("", "abc"), edits("http", "http")], [3, 3, 0]);
        let said = with_nearest("unknown field `htpp`, expected one of `machine`, `http`".into());
        assert!(said.ends_with("did you mean `http`?"), "{said}");
        let far = with_nearest("unknown field `colour`, expected one of `machine`, `http`".into());
        assert!(!far.contains("mean"), "{far}");
    }
}
