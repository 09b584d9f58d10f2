//! A foreign file through a map into a [`Recording`]: renamed, scaled, on a uniform grid.

use super::{RawTable, RecordingError, csv_file, mat_file, parquet_file};
use crate::config::import_map::{Clock, ImportMap, Origin, Signal};
use crate::sample::{Column, Recording};
use crate::units::SampleRate;
use std::path::Path;

/// How far the measured rate may be from the stated one, as a share.
const RATE_TOLERANCE: f64 = 0.01;

/// Reads `path` as `map` says.
/// Errors: unreadable file, a column that is not there, a value that is not finite, a time that runs
/// backwards, a rate that is not the stated one, times that are not uniform where no grid is asked for.
pub fn import(path: &Path, map: &ImportMap) -> Result<Recording, RecordingError> {
    let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let raw = match extension.as_str() {
        "parquet" => parquet_file::read(path)?,
        "mat" => mat_file::read(path)?,
        _ => csv_file::read_with(path, &map.source)?,
    };
    Importer { path, raw }.run(map)
}

struct Importer<'a> {
    path: &'a Path,
    raw: RawTable,
}

/// Times and signals, row by row.
struct Rows {
    times_s: Vec<f64>,
    signals: Vec<Vec<f64>>,
}

impl Importer<'_> {
    fn format_error(&self, message: String) -> RecordingError {
        RecordingError::Format { path: self.path.to_owned(), message }
    }

    fn column(&self, name: &str) -> Result<&[f64], RecordingError> {
        let found = self.raw.columns.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_slice());
        found.ok_or_else(|| {
            let present: Vec<&str> = self.raw.columns.iter().map(|(n, _)| n.as_str()).collect();
            self.format_error(format!("no column `{name}`; the file has {}", present.join(", ")))
        })
    }

    fn run(&self, map: &ImportMap) -> Result<Recording, RecordingError> {
        let rows = self.kept_rows(map)?;
        let mut table = self.read_rows(map, &rows)?;
        if table.times_s.len() < 2 {
            return Err(
                self.format_error(format!("{} rows are kept; at least 2 are needed", table.times_s.len()))
            );
        }
        let rate = self.check_rate(map, &table)?;
        for (signal, values) in map.signals.iter().zip(&mut table.signals) {
            if signal.integrate {
                integrate(&table.times_s, values);
            }
        }
        if let Some(hz) = map.resample_hz {
            table = resampled(&table, hz);
        }
        let sample_rate =
            SampleRate::new(map.resample_hz.unwrap_or(rate)).map_err(|e| self.format_error(e.to_string()))?;
        Ok(self.recording(map, table, sample_rate))
    }

    /// Rows where every condition holds.
    fn kept_rows(&self, map: &ImportMap) -> Result<Vec<usize>, RecordingError> {
        let first = map.signals.iter().find_map(|s| match &s.origin {
            Origin::Column(name) => Some(name.as_str()),
            Origin::Constant(_) => None,
        });
        let Some(first) = first else {
            return Err(self.format_error("the map takes no column from the file".into()));
        };
        let mut rows: Vec<usize> = (0..self.column(first)?.len()).collect();
        for keep in &map.source.keep {
            let values = self.column(&keep.column)?;
            rows.retain(|r| values.get(*r).is_some_and(|v| (keep.from..=keep.to).contains(v)));
        }
        Ok(rows)
    }

    fn read_rows(&self, map: &ImportMap, rows: &[usize]) -> Result<Rows, RecordingError> {
        let times_s = match &map.clock {
            Clock::Column { name, scale, restarts } => {
                let times = self.pick(name, rows, |v| v * scale)?;
                if *restarts { joined(times) } else { times }
            }
            Clock::Rate(hz) => (0..rows.len()).map(|k| k as f64 / hz).collect(),
        };
        if let Some(k) = times_s.windows(2).position(|w| w[1] <= w[0]) {
            let column =
                if let Clock::Column { name, .. } = &map.clock { name.clone() } else { "t_s".into() };
            let message = format!("time runs from {} to {} s, expected to grow", times_s[k], times_s[k + 1]);
            return Err(RecordingError::Value {
                path: self.path.to_owned(),
                column,
                row: rows[k + 1],
                message,
            });
        }
        let take = |s: &Signal| match &s.origin {
            Origin::Column(name) => self.pick(name, rows, |v| (v - s.offset) * s.scale),
            Origin::Constant(value) => Ok(vec![(value - s.offset) * s.scale; rows.len()]),
        };
        Ok(Rows { times_s, signals: map.signals.iter().map(take).collect::<Result<_, _>>()? })
    }

    fn pick(
        &self,
        name: &str,
        rows: &[usize],
        convert: impl Fn(f64) -> f64,
    ) -> Result<Vec<f64>, RecordingError> {
        let values = self.column(name)?;
        let mut out = Vec::with_capacity(rows.len());
        for &row in rows {
            let value = values.get(row).copied().ok_or_else(|| {
                self.format_error(format!("column `{name}` has {} rows, row {row} is needed", values.len()))
            })?;
            if !value.is_finite() {
                let message = format!("{value} is not a finite number");
                return Err(RecordingError::Value {
                    path: self.path.to_owned(),
                    column: name.to_owned(),
                    row,
                    message,
                });
            }
            out.push(convert(value));
        }
        Ok(out)
    }

    /// The rate from the times; it must be the stated one, and uniform unless a grid is asked for.
    fn check_rate(&self, map: &ImportMap, table: &Rows) -> Result<f64, RecordingError> {
        let times = &table.times_s;
        let rate = (times.len() - 1) as f64 / (times[times.len() - 1] - times[0]);
        if let Some(stated) = map.sample_rate_hz
            && (rate / stated - 1.0).abs() > RATE_TOLERANCE
        {
            return Err(self.format_error(format!("the times give {rate:.6} Hz, the map states {stated} Hz")));
        }
        if map.resample_hz.is_some() {
            return Ok(rate);
        }
        let worst = times
            .windows(2)
            .map(|w| ((w[1] - w[0]) * rate - 1.0).abs())
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((row, deviation)) = worst
            && deviation > 0.5
        {
            let step = times[row + 1] - times[row];
            return Err(self.format_error(format!(
                "row {}: step of {step:.4e} s at a mean rate of {rate:.4} Hz: not uniformly sampled; state \
                 recording.resample_hz to put it on a uniform grid",
                row + 1
            )));
        }
        Ok(map.sample_rate_hz.unwrap_or(rate))
    }

    fn recording(&self, map: &ImportMap, table: Rows, sample_rate: SampleRate) -> Recording {
        let columns: Vec<Column> = map
            .signals
            .iter()
            .zip(table.signals)
            .map(|(s, values)| Column { name: s.to.clone(), values })
            .collect();
        let axes = super::axes_of(&[], &columns);
        let mut metadata = map.metadata.clone();
        let name = self.path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
        metadata.push(("imported_from".to_owned(), name));
        Recording {
            sample_rate,
            experiment: map.experiment.clone().unwrap_or_else(|| super::stem(self.path)),
            axes,
            columns,
            start_s: table.times_s.first().copied().unwrap_or(0.0),
            metadata,
        }
    }
}

/// Blocks end to end: where the time jumps back, the block starts one usual step after the last.
fn joined(times: Vec<f64>) -> Vec<f64> {
    let mut shift = 0.0;
    let mut out: Vec<f64> = Vec::with_capacity(times.len());
    for (k, &t) in times.iter().enumerate() {
        if k > 0 && t <= times[k - 1] {
            let step = times.get(k + 1).map_or(0.0, |next| next - t).max(1.0e-9);
            shift = out[k - 1] + step - t;
        }
        out.push(t + shift);
    }
    out
}

/// Trapezoidal sum over time, from zero.
fn integrate(times_s: &[f64], values: &mut [f64]) {
    let mut sum = 0.0;
    let mut last = values.first().copied().unwrap_or(0.0);
    for k in 0..values.len() {
        if k > 0 {
            sum += 0.5 * (last + values[k]) * (times_s[k] - times_s[k - 1]);
        }
        last = values[k];
        values[k] = sum;
    }
}

/// Linear between the rows; where a step of the grid holds several rows, their mean instead.
fn resampled(table: &Rows, hz: f64) -> Rows {
    let (first, last) = (table.times_s[0], table.times_s[table.times_s.len() - 1]);
    let count = ((last - first) * hz).floor() as usize + 1;
    let times_s: Vec<f64> = (0..count).map(|k| first + k as f64 / hz).collect();
    let half = 0.5 / hz;
    let signals = table.signals.iter().map(|values| {
        let mut next = 0;
        let mut from = 0;
        let mut at = |t: f64| {
            while next + 1 < table.times_s.len() - 1 && table.times_s[next + 1] <= t {
                next += 1;
            }
            while table.times_s[from] < t - half {
                from += 1;
            }
            let inside = table.times_s[from..].iter().take_while(|u| **u < t + half).count();
            if inside > 2 {
                return values[from..from + inside].iter().sum::<f64>() / inside as f64;
            }
            let (a, b) = (table.times_s[next], table.times_s[next + 1]);
            let share = ((t - a) / (b - a)).clamp(0.0, 1.0);
            values[next] * (1.0 - share) + values[next + 1] * share
        };
        times_s.iter().map(|t| at(*t)).collect()
    });
    let signals = signals.collect();
    Rows { times_s, signals }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_put_end_to_end() {
        let times = joined(vec![0.0, 0.1, 0.2, 0.0, 0.05, 0.1]);
        let expected = [0.0, 0.1, 0.2, 0.25, 0.3, 0.35];
        assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1.0e-12), "{times:?}");
    }

    #[test]
    fn a_line_stays_a_line_on_the_new_grid() {
        let times_s: Vec<f64> = [0.0, 0.9, 2.1, 3.0, 4.05, 5.0].to_vec();
        let signals = vec![times_s.iter().map(|t| 3.0 * t - 1.0).collect()];
        let out = resampled(&Rows { times_s, signals }, 1.0);
        for (t, v) in out.times_s.iter().zip(&out.signals[0]) {
            assert!((v - (3.0 * t - 1.0)).abs() < 1.0e-12, "{v} at {t}");
        }
        assert_eq!(out.times_s.len(), 6);
    }

    #[test]
    fn a_coarser_grid_takes_the_mean() {
        let times_s: Vec<f64> = (0..100).map(|k| f64::from(k) * 0.01).collect();
        let signals = vec![(0..100).map(|k| if k % 2 == 0 { 1.0 } else { -1.0 }).collect()];
        let out = resampled(&Rows { times_s, signals }, 5.0);
        assert!(out.signals[0].iter().skip(1).all(|v| v.abs() < 0.11), "{:?}", out.signals[0]);
    }

    #[test]
    fn a_constant_velocity_integrates_to_a_ramp() {
        let mut values = vec![2.0; 5];
        integrate(&[0.0, 0.5, 1.0, 1.5, 2.0], &mut values);
        assert_eq!(values, vec![0.0, 1.0, 2.0, 3.0, 4.0]);
    }
}
