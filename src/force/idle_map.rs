//! Disturbance that returns at the same position: learned from air-cutting runs, taken off the cut.
//!
//! What it cannot remove: disturbances that depend on speed, load or time rather than place
//! (amplifier harmonics, friction that warms), anything where the axis was never idle in that
//! direction (the map says so), and what the cut itself changes in the friction.
//!
//! Source: Yamada, thesis 3.4.

use crate::keyframe::Digest;

/// Mean force of idle runs over position, one map for each direction of travel.
#[derive(Clone, PartialEq)]
pub struct IdleMap {
    start_m: f64,
    cell_m: f64,
    forward: Cells,
    backward: Cells,
    slow_m_s: f64,
    runs: usize,
    contradiction_n: f64,
}

/// The cells that one direction of travel came by.
#[derive(Debug, Clone, PartialEq, Default)]
struct Cells {
    /// Index of the first one.
    first: usize,
    /// Means, N; empty where the axis never went that way.
    mean_n: Vec<f64>,
}

/// A digest instead of a million cells: what tells two settings apart is told apart.
impl std::fmt::Debug for IdleMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut digest = Digest::default();
        let firsts = [&self.forward, &self.backward].map(|cells| cells.first as f64);
        let head = [self.start_m, self.cell_m, self.slow_m_s, firsts[0], firsts[1], self.contradiction_n];
        let all = head.iter().chain(&self.forward.mean_n).chain(&self.backward.mean_n);
        all.for_each(|x| digest.word(x.to_bits()));
        f.debug_struct("IdleMap").field("runs", &self.runs).field("digest", &digest.value()).finish()
    }
}

/// An axis that moves by less stands: an idle run has no way to be aligned by, a cut no idle map.
pub(super) const LEAST_TRAVEL_M: f64 = 50e-6;

/// One aligned instant of an idle run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdlePoint {
    /// Where, m.
    pub position_m: f64,
    /// How fast, m/s.
    pub velocity_m_s: f64,
    /// What the balance gave there, N.
    pub force_n: f64,
}

impl IdleMap {
    /// Averages the runs in cells of position, for each direction apart.
    ///
    /// A cell is as wide as the median step between two samples; empty cells between filled ones are
    /// interpolated. Points slower than a tenth of the runs' typical speed are left out: at rest the
    /// friction is not that of motion. `None` where nothing moved.
    #[must_use]
    pub fn from_runs(runs: &[Vec<IdlePoint>]) -> Option<Self> {
        let mut speeds: Vec<f64> = runs.iter().flatten().map(|p| p.velocity_m_s.abs()).collect();
        speeds.sort_by(f64::total_cmp);
        let typical = *speeds.get(speeds.len() * 3 / 4)?;
        let slow_m_s = typical / 10.0;
        let moving = || runs.iter().flatten().filter(|p| p.velocity_m_s.abs() > slow_m_s);
        let (low, high) = moving()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), p| (a.min(p.position_m), b.max(p.position_m)));
        let mut steps: Vec<f64> = runs
            .iter()
            .flat_map(|r| r.windows(2))
            .filter(|w| w[0].velocity_m_s.abs() > slow_m_s)
            .map(|w| (w[1].position_m - w[0].position_m).abs())
            .collect();
        steps.sort_by(f64::total_cmp);
        let step = *steps.get(steps.len() / 2)?;
        // Bounded memory: 2^20 cells are 8 MB a direction.
        let cell_m = step.max((high - low) / f64::from(1 << 20));
        // An axis that stands still shows the noise of its encoder, not its way.
        let travels = high - low > 20.0 * cell_m && high - low > LEAST_TRAVEL_M;
        if !(cell_m > 0.0 && travels) {
            return None;
        }
        let cells = ((high - low) / cell_m).ceil() as usize + 1;
        let average = |sign: f64| {
            let points = moving().filter(|p| p.velocity_m_s * sign > 0.0);
            average_by_cell(points, (low, cell_m), cells)
        };
        Some(Self {
            start_m: low,
            cell_m,
            forward: average(1.0),
            backward: average(-1.0),
            slow_m_s,
            runs: runs.len(),
            contradiction_n: 0.0,
        })
    }

    /// Disturbance at a place in N; `None` where the idle runs did not come by in that direction, or moved
    /// ten times as fast.
    #[inline]
    #[must_use]
    pub fn disturbance_n(&self, position_m: f64, velocity_m_s: f64) -> Option<f64> {
        if velocity_m_s.abs() < self.slow_m_s {
            return None;
        }
        let cells = if velocity_m_s > 0.0 { &self.forward } else { &self.backward };
        let last = cells.mean_n.len().checked_sub(1)?;
        let at = (position_m - self.start_m) / self.cell_m - 0.5 - cells.first as f64;
        // Between the last centre and the end of the way lies half a cell.
        if !(at >= -1.0 && at <= last as f64 + 1.0) {
            return None;
        }
        let at = at.clamp(0.0, last as f64);
        let index = (at as usize).min(last.saturating_sub(1));
        let share = at - index as f64;
        Some(cells.mean_n[index] * (1.0 - share) + cells.mean_n[(index + 1).min(last)] * share)
    }

    /// With what motor side and stretch contradicted each other by in the idle runs, N rms.
    #[must_use]
    pub fn with_contradiction(self, contradiction_n: f64) -> Self {
        Self { contradiction_n, ..self }
    }

    /// What motor side and stretch contradicted each other by in the idle runs, N rms; see
    /// `two_sides`.
    #[must_use]
    pub fn contradiction_n(&self) -> f64 {
        self.contradiction_n
    }

    /// How many runs it was made from.
    #[must_use]
    pub fn runs(&self) -> usize {
        self.runs
    }
}

/// Mean by cell, from the first that a point fell into to the last; gaps between are bridged by straight
/// lines. Empty when no point fell anywhere.
fn average_by_cell<'a>(points: impl Iterator<Item = &'a IdlePoint>, grid: (f64, f64), cells: usize) -> Cells {
    let (start_m, cell_m) = grid;
    let mut sums = vec![(0.0, 0.0); cells];
    for p in points {
        // Linear share to the two cells whose centres lie around the point.
        let at = ((p.position_m - start_m) / cell_m - 0.5).clamp(0.0, (cells - 1) as f64);
        let index = (at as usize).min(cells.saturating_sub(2));
        let share = at - index as f64;
        for (cell, weight) in [(index, 1.0 - share), (index + 1, share)] {
            if let Some(sum) = sums.get_mut(cell) {
                sum.0 += weight * p.force_n;
                sum.1 += weight;
            }
        }
    }
    let filled: Vec<(usize, f64)> =
        sums.iter().enumerate().filter(|(_, s)| s.1 > 1e-6).map(|(i, s)| (i, s.0 / s.1)).collect();
    let (Some(&(first, _)), Some(&(last, last_n))) = (filled.first(), filled.last()) else {
        return Cells::default();
    };
    let mut mean_n = vec![last_n; last - first + 1];
    for pair in filled.windows(2) {
        let ((i, a), (j, b)) = (pair[0], pair[1]);
        for (k, cell) in mean_n[i - first..j - first].iter_mut().enumerate() {
            *cell = a + (b - a) * k as f64 / (j - i) as f64;
        }
    }
    Cells { first, mean_n }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Forward over 0 to 10 mm at 3 N, back from 10 to 6 mm at -2 N.
    fn map(back: bool) -> IdleMap {
        let point = |position_m, velocity_m_s, force_n| IdlePoint { position_m, velocity_m_s, force_n };
        let forward = (0..=1000).map(|i| point(f64::from(i) * 1e-5, 0.01, 3.0));
        let backward = (0..=400).map(|i| point(0.01 - f64::from(i) * 1e-5, -0.01, -2.0));
        let run = forward.chain(backward.filter(|_| back)).collect();
        IdleMap::from_runs(&[run]).unwrap()
    }

    #[test]
    fn it_holds_only_where_the_axis_went_in_that_direction() {
        let both = map(true);
        assert_eq!(both.disturbance_n(0.003, 0.01), Some(3.0));
        assert_eq!(both.disturbance_n(0.008, -0.01), Some(-2.0));
        assert_eq!(both.disturbance_n(0.006, -0.01), Some(-2.0), "where it turned");
        assert_eq!(both.disturbance_n(0.003, -0.01), None, "never went back that far");
        assert_eq!(both.disturbance_n(0.0105, 0.01), None, "beyond the way");
        let one_way = map(false);
        assert_eq!(one_way.disturbance_n(0.003, 0.01), Some(3.0));
        assert_eq!(one_way.disturbance_n(0.003, -0.01), None, "never went back at all");
        assert_eq!(one_way.disturbance_n(0.003, 0.0005), None, "friction of another speed");
    }
}
