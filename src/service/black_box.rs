//! The black box: the last seconds of samples, kept in memory, saved around every event.
//!
//! Samples fill chunks of a quarter of a second. A full chunk is shared, not copied: saving hands out
//! references, so the pipeline thread pays the same whether anything is saved or not.

use crate::sample::{MAX_AXES, ServoSample};
use std::collections::VecDeque;
use std::sync::Arc;

/// Samples of one chunk at 9 kHz: a quarter of a second.
const CHUNK: usize = 2250;

/// A run of samples.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chunk {
    pub(super) samples: Vec<ServoSample>,
}

/// What is kept.
#[derive(Debug)]
pub(super) struct BlackBox {
    full: VecDeque<Arc<Chunk>>,
    filling: Chunk,
    spare: Vec<Arc<Chunk>>,
    chunks: usize,
}

impl BlackBox {
    /// Room for about `seconds` at `rate_hz`, all of it taken at once.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    pub(super) fn new(seconds: f64, rate_hz: f64) -> Self {
        let chunks = ((seconds * rate_hz / CHUNK as f64).ceil() as usize).clamp(1, 400);
        let fresh = || Chunk { samples: Vec::with_capacity(CHUNK) };
        let spare = (0..chunks + 1).map(|_| Arc::new(fresh())).collect();
        Self { full: VecDeque::with_capacity(chunks + 1), filling: fresh(), spare, chunks }
    }

    /// Takes one sample.
    pub(super) fn push(&mut self, sample: &ServoSample) {
        self.filling.samples.push(*sample);
        if self.filling.samples.len() >= CHUNK {
            self.turn();
        }
    }

    /// Puts the full chunk away and takes an empty one, from the spare ones where one is free.
    fn turn(&mut self) {
        let empty =
            self.spare.iter().position(|c| Arc::strong_count(c) == 1).map(|i| self.spare.swap_remove(i));
        let mut next =
            empty.and_then(Arc::into_inner).unwrap_or_else(|| Chunk { samples: Vec::with_capacity(CHUNK) });
        next.samples.clear();
        let done = std::mem::replace(&mut self.filling, next);
        self.full.push_back(Arc::new(done));
        if self.full.len() > self.chunks
            && let Some(oldest) = self.full.pop_front()
            && self.spare.len() <= self.chunks
        {
            self.spare.push(oldest); // free once nobody is writing it
        }
    }

    /// Forgets everything: what comes next has another clock or other axes.
    pub(super) fn clear(&mut self) {
        while let Some(chunk) = self.full.pop_front() {
            self.spare.push(chunk);
        }
        self.filling.samples.clear();
    }

    /// Everything that is kept, oldest first. Copies only the chunk that is being filled.
    pub(super) fn snapshot(&self) -> Vec<Arc<Chunk>> {
        let mut all: Vec<Arc<Chunk>> = self.full.iter().cloned().collect();
        if !self.filling.samples.is_empty() {
            all.push(Arc::new(self.filling.clone()));
        }
        all
    }
}

/// The longest run at the end in which no sample is missing: a recording is uniformly sampled.
pub(super) fn last_unbroken(chunks: &[Arc<Chunk>]) -> Vec<&ServoSample> {
    let all: Vec<&ServoSample> = chunks.iter().flat_map(|c| &c.samples).collect();
    let begin = all.windows(2).rposition(|w| w[1].sequence != w[0].sequence + 1).map_or(0, |i| i + 1);
    all.get(begin..).unwrap_or_default().to_vec()
}

/// Name of the signals of an axis that every sample has.
pub(super) const AXIS_SIGNALS: [&str; 2] = ["current_ref_a", "motor_angle_rad"];

/// Columns of a recording: name and values.
pub(super) fn columns(samples: &[&ServoSample], axes: &[String]) -> Vec<crate::sample::Column> {
    let mut out = Vec::new();
    let mut add = |name: String, value: &dyn Fn(&ServoSample) -> f64| {
        out.push(crate::sample::Column { name, values: samples.iter().map(|s| value(s)).collect() });
    };
    for (index, axis) in axes.iter().enumerate().take(MAX_AXES) {
        add(format!("{axis}_{}", AXIS_SIGNALS[0]), &|s| s.axes[index].current_ref_a);
        add(format!("{axis}_{}", AXIS_SIGNALS[1]), &|s| s.axes[index].motor_angle_rad);
        if samples.iter().all(|s| s.axes[index].stage_position_m.is_some()) {
            add(format!("{axis}_stage_position_m"), &|s| s.axes[index].stage_position_m.unwrap_or_default());
        }
    }
    add("spindle_angle_rad".into(), &|s| s.spindle_angle_rad);
    add("spindle_speed_rpm".into(), &|s| s.spindle_speed_rpm);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::AxisSample;

    fn sample(sequence: u64) -> ServoSample {
        ServoSample {
            sequence,
            t_s: sequence as f64 / 9000.0,
            axes: [AxisSample::default(); MAX_AXES],
            spindle_angle_rad: 0.0,
            spindle_speed_rpm: 1200.0,
        }
    }

    #[test]
    fn keeps_the_newest_and_reuses_its_memory() {
        let mut kept = BlackBox::new(1.0, 9000.0);
        for k in 0..50_000 {
            kept.push(&sample(k));
        }
        let chunks = kept.snapshot();
        let run = last_unbroken(&chunks);
        assert_eq!(run.last().unwrap().sequence, 49_999);
        assert!((9000..9000 + 2 * CHUNK).contains(&run.len()), "{}", run.len());
        assert!(kept.full.len() + kept.spare.len() <= 2 * kept.chunks + 2);
    }

    #[test]
    fn a_recording_begins_after_the_last_gap() {
        let mut kept = BlackBox::new(1.0, 9000.0);
        for k in (0..3000).chain(3001..5000) {
            kept.push(&sample(k));
        }
        let chunks = kept.snapshot();
        let run = last_unbroken(&chunks);
        assert_eq!((run[0].sequence, run.len()), (3001, 1999));
        let columns = columns(&run, &["x1".into()]);
        let names: Vec<_> = columns.iter().map(|c| c.name.as_str()).collect();
        assert_eq!(
            names,
            ["x1_current_ref_a", "x1_motor_angle_rad", "spindle_angle_rad", "spindle_speed_rpm"]
        );
    }
}
