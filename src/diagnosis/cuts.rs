//! Where a recording says that tools cut: the force of a cut is no physics of the drive.

use super::{DiagnoseError, DiagnoseOptions};
use crate::sample::Recording;

/// Width of cut per tool, m; 0 out of the cut.
const WIDTH: &str = "width_m";
/// Speed of the spindle.
const SPEED: &str = "spindle_speed_rpm";

/// Rows of a recording that were not measured; empty: all were.
pub(super) type Mask = Vec<bool>;

/// Rows that enter no fit, and what is said of them.
pub(super) struct Cuts {
    pub(super) masks: Vec<Mask>,
    pub(super) notes: Vec<String>,
}

impl Cuts {
    /// Rows that were not measured (`masked`, empty: all were), and those in which a tool cuts.
    pub(super) fn of(recordings: &[Recording], masked: &[Mask]) -> Self {
        let mut out = Self { masks: Vec::new(), notes: Vec::new() };
        for (k, recording) in recordings.iter().enumerate() {
            let mut mask = masked.get(k).cloned().unwrap_or_default();
            if let Some(width_m) = recording.get(WIDTH).filter(|w| w.iter().any(|w| *w > 0.0)) {
                mask.resize(recording.len(), false);
                mask.iter_mut().zip(width_m).for_each(|(m, w)| *m |= *w > 0.0);
                let cutting = width_m.iter().filter(|w| **w > 0.0).count();
                out.notes.push(format!(
                    "{}: the tools cut in {:.0} % of the rows ({WIDTH}), from {:.2} s on; left out: \
                     a cut's force is none of the drive.",
                    recording.experiment,
                    100.0 * cutting as f64 / recording.len() as f64,
                    width_m.iter().position(|w| *w > 0.0).map_or(0.0, |row| recording.time_s(row)),
                ));
            }
            out.masks.push(mask);
        }
        out
    }

    /// True where too little is left (`why`) because of the cuts that are left out, and of rest beside them.
    pub(super) fn leave_too_little(
        &self,
        recordings: &[Recording],
        options: &DiagnoseOptions,
        why: &DiagnoseError,
    ) -> bool {
        let DiagnoseError::TooShort { needed, .. } = why else { return false };
        let of = |rows: &[Mask], k: usize, row: usize| rows.get(k).and_then(|m| m.get(row)).copied();
        let bad = |k: usize, row: usize| {
            of(&options.masked, k, row) == Some(true) && of(&options.resting, k, row) != Some(true)
        };
        let good = |(k, r): (usize, &Recording)| (0..r.len()).filter(|row| !bad(k, *row)).count();
        !self.notes.is_empty() && recordings.iter().enumerate().map(good).sum::<usize>() >= *needed
    }
}

/// Turns a second of a spindle that may drive a cut: it turns all the time, and nothing says when tools cut.
pub(super) fn spindle_hz(recording: &Recording) -> Option<f64> {
    turns_hz(recording).filter(|_| recording.get(WIDTH).is_none())
}

/// Turns a second of the spindle, where it turns.
pub(super) fn turns_hz(recording: &Recording) -> Option<f64> {
    let rpm = recording.get(SPEED)?;
    let mean = rpm.iter().sum::<f64>() / rpm.len().max(1) as f64;
    (mean > 0.0).then_some(mean / 60.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Column;
    use crate::units::SampleRate;

    fn recording(columns: &[(&str, [f64; 4])]) -> Recording {
        let column =
            |(name, values): &(&str, [f64; 4])| Column { name: (*name).into(), values: values.to_vec() };
        Recording {
            sample_rate: SampleRate::new(10.0).unwrap(),
            experiment: "turning".into(),
            axes: Vec::new(),
            columns: columns.iter().map(column).collect(),
            start_s: 0.0,
            metadata: Vec::new(),
        }
    }

    #[test]
    fn rows_in_the_cut_are_left_out_beside_those_that_were_not_measured() {
        let turning = ("spindle_speed_rpm", [1200.0; 4]);
        let cut = recording(&[turning, ("width_m", [0.0, 0.0, 2e-4, 2e-4])]);
        let cuts = Cuts::of(std::slice::from_ref(&cut), &[vec![true, false, false, false]]);
        assert_eq!(cuts.masks, [vec![true, false, true, true]]);
        assert!(cuts.notes[0].contains("50 % of the rows") && cuts.notes[0].contains("from 0.20 s"));
        assert_eq!(spindle_hz(&cut), None, "it says when tools cut");
        let silent = recording(&[turning]);
        assert_eq!(spindle_hz(&silent), Some(20.0));
        assert_eq!(Cuts::of(&[silent], &[]).masks, [Vec::<bool>::new()]);
    }
}
