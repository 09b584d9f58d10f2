//! How fast an axis moves, and when it rests.

use super::columns::AxisColumns;
use super::statistics::{median, percentile};
use super::work::Work;

/// Shortest reach of the travel that is a speed, s: below, encoders show their steps.
const REACH_S: f64 = 2e-3;

/// Travel of an axis a second.
pub(super) struct Motion {
    /// Units of the position per second, one a row.
    pub(super) speed: Vec<f64>,
    /// Speed below which the axis rests.
    pub(super) rest: f64,
    /// Column of the position.
    pub(super) position: usize,
    /// Rows to either side over which it is taken.
    pub(super) reach: usize,
}

impl Motion {
    /// Of the position that stands for the axis; `None`: there is none.
    ///
    /// v_i = (x_{i+h} - x_{i-h}) / 2 h dt, h = max(2 rows, 2 updates, 2 ms).
    pub(super) fn of(work: &Work<'_>, axis: &AxisColumns) -> Option<Self> {
        let position = axis.position(&work.recording).filter(|p| !work.silent[*p])?;
        Some(Self::of_position(work, position))
    }

    pub(super) fn of_position(work: &Work<'_>, position: usize) -> Self {
        let x = work.values(position);
        let reach = 2.max(2 * between_changes(x)).max(work.rows_in(REACH_S));
        let speed = travel(x, reach, work.period_s());
        let sizes: Vec<f64> = speed.iter().map(|v| v.abs()).collect();
        let c = work.criteria;
        let of_steps = c.rest_steps * work.step(position) / (2.0 * reach as f64 * work.period_s());
        let rest = (c.rest_speed * percentile(&sizes, 0.99)).max(of_steps);
        Self { speed, rest, position, reach }
    }

    pub(super) fn rests(&self, row: usize) -> bool {
        self.speed[row].abs() <= self.rest
    }

    /// Shares of the rows with motion in the one and the other direction.
    pub(super) fn both_ways(&self) -> [f64; 2] {
        let share = |f: &dyn Fn(f64) -> bool| {
            self.speed.iter().filter(|v| f(**v)).count() as f64 / self.speed.len().max(1) as f64
        };
        [share(&|v| v > self.rest), share(&|v| v < -self.rest)]
    }
}

/// Rows between two changes of a column, in the median: a coarse encoder in slow motion takes several.
fn between_changes(x: &[f64]) -> usize {
    let changes: Vec<usize> = (1..x.len()).filter(|&i| x[i] != x[i - 1]).collect();
    let gaps: Vec<f64> = changes.windows(2).map(|w| (w[1] - w[0]) as f64).collect();
    (median(&gaps) as usize).clamp(1, x.len() / 8 + 1)
}

/// (x_{i+h} - x_{i-h}) / 2 h dt; at the ends with what there is.
pub(super) fn travel(x: &[f64], reach: usize, period_s: f64) -> Vec<f64> {
    let n = x.len();
    let at = |i: usize| {
        let (from, to) = (i.saturating_sub(reach), (i + reach).min(n - 1));
        if to > from { (x[to] - x[from]) / ((to - from) as f64 * period_s) } else { 0.0 }
    };
    (0..n).map(at).collect()
}

/// Mean over the same rows that [`travel`] spans, so that both are smoothed alike.
pub(super) fn averaged(x: &[f64], reach: usize) -> Vec<f64> {
    let n = x.len();
    let mut sums = Vec::with_capacity(n + 1);
    let mut sum = 0.0;
    sums.push(sum);
    for v in x {
        sum += v;
        sums.push(sum);
    }
    // Trapezoids: (x_{i-h} + x_{i+h}) / 2 and all between.
    let at = |i: usize| {
        let (from, to) = (i.saturating_sub(reach), (i + reach).min(n - 1));
        let inside = sums[to + 1] - sums[from] - 0.5 * (x[from] + x[to]);
        if to > from { inside / (to - from) as f64 } else { x[i] }
    };
    (0..n).map(at).collect()
}
