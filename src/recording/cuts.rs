//! Tables of cuts as files (contracts, section 6): `stillcut.cuts/1`, Parquet or CSV, one row a cut.

use super::{RecordingError, csv_file, meta_of, no_name_twice, parquet_file};
use crate::diagnosis::cut::input::{CutOutcome, CutRow, CutTable, KnownOfCut};
use std::path::Path;

/// The word that a table's metadata carries under `format`.
pub const CUTS_FORMAT: &str = "stillcut.cuts/1";
/// Most rows of a table: a shop's years of cuts; a recording handed in as a table is refused.
const MOST_ROWS: usize = 100_000;

/// The values of a column.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Cells {
    /// Numbers; a null is NaN.
    Numbers(Vec<f64>),
    /// Words; a null is empty.
    Text(Vec<String>),
}

impl Cells {
    pub(super) fn len(&self) -> usize {
        match self {
            Cells::Numbers(values) => values.len(),
            Cells::Text(values) => values.len(),
        }
    }

    fn text(&self, row: usize) -> String {
        match self {
            Cells::Numbers(values) => {
                let value = values.get(row).copied().unwrap_or(f64::NAN);
                if value.is_nan() { String::new() } else { value.to_string() }
            }
            Cells::Text(values) => values.get(row).map_or_else(String::new, |t| t.trim().to_owned()),
        }
    }
}

/// A file of columns with words among them.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CellTable {
    pub(super) columns: Vec<(String, Cells)>,
    pub(super) metadata: Vec<(String, String)>,
}

/// Which numbers a column holds.
#[derive(Clone, Copy)]
struct Rule {
    name: &'static str,
    good: fn(f64) -> bool,
    expected: &'static str,
}

const fn above_zero(name: &'static str) -> Rule {
    Rule { name, good: |x| x > 0.0, expected: "a number above zero" }
}

const fn finite(name: &'static str) -> Rule {
    Rule { name, good: |_| true, expected: "a finite number" }
}

const POSITION: Rule =
    Rule { name: "tool_position_m", good: |x| x >= 0.0, expected: "zero or a number above" };
const PITCH: Rule = Rule {
    name: "pitch_difference_rad",
    good: |x| x.abs() < std::f64::consts::TAU,
    expected: "less than a turn either way",
};
const REQUIRED: [&str; 4] = ["cut", "spindle_speed_rpm", "width_m", "outcome"];
const OPTIONAL: [&str; 12] = [
    "feed_m_rev",
    "tool_position_m",
    "pitch_difference_rad",
    "workpiece_diameter_m",
    "line_hz",
    "growth_1_s",
    "growth_se_1_s",
    "tool1_radial_force_n",
    "tool2_radial_force_n",
    "cutting_force_n",
    "feed_force_n",
    "started_s",
];

/// Reads a table of cuts, Parquet or CSV by its extension. An optional value that is missing (null, NaN,
/// empty) is not known; what is there must be a number that a cut can have.
///
/// Errors: unreadable file, another format, a required column or value missing, a value that no cut has.
pub fn read_cuts(path: &Path) -> Result<CutTable, RecordingError> {
    let is_csv = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("csv"));
    let cells = if is_csv { csv_file::read_cells(path)? } else { parquet_file::read_cells(path)? };
    let format_error = |message: String| RecordingError::Format { path: path.to_owned(), message };
    if let Some(found) = meta_of(&cells.metadata, "format").filter(|f| f != CUTS_FORMAT) {
        let found = found.escape_debug();
        return Err(format_error(format!("metadata format is `{found}`, expected `{CUTS_FORMAT}`")));
    }
    no_name_twice(path, cells.columns.iter().map(|(name, _)| name.as_str()))?;
    for name in REQUIRED {
        if !cells.columns.iter().any(|(n, _)| n == name) {
            let present: Vec<&str> = cells.columns.iter().map(|(n, _)| n.as_str()).collect();
            let present = present.join(", ");
            return Err(format_error(format!("required column {name} is missing; the table has {present}")));
        }
    }
    let rows = cells.columns.first().map_or(0, |(_, c)| c.len());
    if rows == 0 || rows > MOST_ROWS {
        return Err(format_error(format!("{rows} rows; expected 1 to {MOST_ROWS} cuts")));
    }
    let known = |name: &str| REQUIRED.contains(&name) || OPTIONAL.contains(&name);
    let ignored = cells.columns.iter().map(|(name, _)| name).filter(|name| !known(name));
    let ignored_columns = ignored.cloned().collect();
    let source = Source { path, cells: &cells };
    let rows = (0..rows).map(|row| source.row(row)).collect::<Result<Vec<_>, _>>()?;
    Ok(CutTable { rows, ignored_columns })
}

/// A file while its rows are read.
struct Source<'a> {
    path: &'a Path,
    cells: &'a CellTable,
}

impl Source<'_> {
    fn row(&self, row: usize) -> Result<CutRow, RecordingError> {
        let optional = |rule: Rule| self.number(rule, row);
        let outcome_word = self.text("outcome", row);
        Ok(CutRow {
            cut: self.text("cut", row),
            spindle_speed_rpm: self.required(above_zero("spindle_speed_rpm"), row)?,
            width_m: self.required(above_zero("width_m"), row)?,
            outcome: CutOutcome::from_name(&outcome_word),
            outcome_word,
            known: KnownOfCut {
                feed_m_rev: optional(above_zero("feed_m_rev"))?,
                tool_position_m: optional(POSITION)?,
                pitch_difference_rad: optional(PITCH)?,
                workpiece_diameter_m: optional(above_zero("workpiece_diameter_m"))?,
                line_hz: optional(above_zero("line_hz"))?,
                growth_1_s: optional(finite("growth_1_s"))?,
                growth_se_1_s: optional(above_zero("growth_se_1_s"))?,
                tool1_radial_force_n: optional(finite("tool1_radial_force_n"))?,
                tool2_radial_force_n: optional(finite("tool2_radial_force_n"))?,
                cutting_force_n: optional(finite("cutting_force_n"))?,
                feed_force_n: optional(finite("feed_force_n"))?,
                started_s: optional(finite("started_s"))?,
            },
        })
    }

    fn column(&self, name: &str) -> Option<&Cells> {
        self.cells.columns.iter().find(|(n, _)| n == name).map(|(_, cells)| cells)
    }

    fn text(&self, name: &str, row: usize) -> String {
        self.column(name).map_or_else(String::new, |cells| cells.text(row))
    }

    fn wrong(&self, rule: Rule, row: usize, found: &str) -> RecordingError {
        let message = format!("{}, expected {}", found.escape_debug(), rule.expected);
        RecordingError::Value { path: self.path.to_owned(), column: rule.name.to_owned(), row, message }
    }

    fn required(&self, rule: Rule, row: usize) -> Result<f64, RecordingError> {
        self.number(rule, row)?.ok_or_else(|| self.wrong(rule, row, "nothing"))
    }

    fn number(&self, rule: Rule, row: usize) -> Result<Option<f64>, RecordingError> {
        let text = self.text(rule.name, row);
        if text.is_empty() || text.eq_ignore_ascii_case("nan") {
            return Ok(None);
        }
        let value = text.parse::<f64>().ok().filter(|x| x.is_finite() && (rule.good)(*x));
        value.map(Some).ok_or_else(|| self.wrong(rule, row, &text))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Table, TableColumn, write_table, write_whole};
    use super::*;

    fn written(name: &str, text: &str) -> std::path::PathBuf {
        let folder = std::env::temp_dir().join(format!("stillcut-cuts-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let path = folder.join(name);
        write_whole(&path, text.as_bytes()).unwrap();
        path
    }

    const HEAD: &str = "cut,spindle_speed_rpm,width_m,outcome,line_hz,remark\n";

    #[test]
    fn csv_and_parquet_are_the_same_table() {
        let text =
            format!("{HEAD}a,1000,2e-4,stable,,dry\nb,1200,3e-4,chatter,652.5,\nc,900,1e-4,odd,NaN,\n");
        let csv = read_cuts(&written("same.csv", &text)).unwrap();
        assert_eq!(csv.ignored_columns, ["remark"]);
        let outcomes: Vec<_> = csv.rows.iter().map(|r| r.outcome).collect();
        assert_eq!(outcomes, [Some(CutOutcome::Stable), Some(CutOutcome::Chatter), None]);
        assert_eq!(csv.rows[1].known.line_hz, Some(652.5));
        assert_eq!((csv.rows[0].known.line_hz, csv.rows[2].known.line_hz), (None, None));
        let words = |w: [&str; 3]| w.map(str::to_owned);
        let (cuts, outcomes) = (words(["a", "b", "c"]), words(["stable", "chatter", "odd"]));
        let table = Table {
            columns: vec![
                ("cut", TableColumn::Text(&cuts)),
                ("spindle_speed_rpm", TableColumn::Double(&[1000.0, 1200.0, 900.0])),
                ("width_m", TableColumn::Double(&[2e-4, 3e-4, 1e-4])),
                ("outcome", TableColumn::Text(&outcomes)),
                ("line_hz", TableColumn::OptionalDouble(&[None, Some(652.5), Some(f64::NAN)])),
                ("remark", TableColumn::Integer(&[1, 2, 3])),
            ],
            metadata: vec![("format".to_owned(), CUTS_FORMAT.to_owned())],
        };
        let path = written("same.parquet", "");
        write_table(&path, &table).unwrap();
        assert_eq!(read_cuts(&path).unwrap(), csv);
    }

    #[test]
    fn what_is_wrong_is_named_with_column_and_row() {
        let refused = |name: &str, text: &str| read_cuts(&written(name, text)).unwrap_err().to_string();
        assert!(
            refused("a.csv", "cut,width_m,outcome\na,1e-4,stable\n").contains("spindle_speed_rpm is missing")
        );
        let row = refused("b.csv", &format!("{HEAD}a,1000,2e-4,stable,,\nb,0,2e-4,stable,,\n"));
        assert!(row.contains("column spindle_speed_rpm, row 1: 0, expected a number above zero"), "{row}");
        let none = refused("c.csv", &format!("{HEAD}a,1000,,stable,,\n"));
        assert!(none.contains("column width_m, row 0: nothing, expected"), "{none}");
        let word = refused("d.csv", &format!("{HEAD}a,1000,2e-4,stable,high,\n"));
        assert!(word.contains("column line_hz, row 0: high, expected"), "{word}");
        assert!(refused("e.csv", HEAD).contains("0 rows"));
    }
}
