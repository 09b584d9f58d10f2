//! Disturbance that returns at the same position: learned from air-cutting runs, taken off the cut.
//!
//! What it cannot remove: disturbances that depend on speed, load or time rather than place
//! (amplifier harmonics, friction that warms), anything where the axis was never idle in that
//! direction, and what the cut itself changes in the friction.
//!
//! Source: Yamada, thesis 3.4.

use crate::keyframe::Digest;

/// Mean force of idle runs over position, one map for each direction of travel.
#[derive(Clone, PartialEq)]
pub struct IdleMap {
    start_m: f64,
    cell_m: f64,
    forward_n: Vec<f64>,
    backward_n: Vec<f64>,
    slow_m_s: f64,
    runs: usize,
}

/// A digest instead of a million cells: what tells two settings apart is told apart.
impl std::fmt::Debug for IdleMap {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut digest = Digest::default();
        let head = [self.start_m, self.cell_m, self.slow_m_s];
        let all = head.iter().chain(&self.forward_n).chain(&self.backward_n);
        all.for_each(|x| digest.word(x.to_bits()));
        f.debug_struct("IdleMap").field("runs", &self.runs).field("digest", &digest.value()).finish()
    }
}

/// Idle runs that move by less have no way to be aligned by.
const LEAST_TRAVEL_M: f64 = 50e-6;

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
            forward_n: average(1.0),
            backward_n: average(-1.0),
            slow_m_s,
            runs: runs.len(),
        })
    }

    /// Disturbance at a place in N; zero where the axis was never idle in that direction or stands still.
    #[inline]
    #[must_use]
    pub fn disturbance_n(&self, position_m: f64, velocity_m_s: f64) -> f64 {
        if velocity_m_s.abs() < self.slow_m_s {
            return 0.0;
        }
        let map = if velocity_m_s > 0.0 { &self.forward_n } else { &self.backward_n };
        let at = (position_m - self.start_m) / self.cell_m - 0.5;
        let Some(last) = map.len().checked_sub(1) else { return 0.0 };
        if !(at >= -1.0 && at <= last as f64 + 1.0) {
            return 0.0;
        }
        let at = at.clamp(0.0, last as f64);
        let index = (at as usize).min(last.saturating_sub(1));
        let share = at - index as f64;
        map[index] * (1.0 - share) + map[(index + 1).min(last)] * share
    }

    /// Whether the idle runs came by this place.
    #[inline]
    #[must_use]
    pub fn holds(&self, position_m: f64) -> bool {
        let cells = self.forward_n.len().max(self.backward_n.len()) as f64;
        let at = (position_m - self.start_m) / self.cell_m - 0.5;
        at >= -1.0 && at <= cells
    }

    /// How many runs it was made from.
    #[must_use]
    pub fn runs(&self) -> usize {
        self.runs
    }
}

/// Mean by cell; gaps are bridged by straight lines. Empty when no point fell anywhere.
fn average_by_cell<'a>(
    points: impl Iterator<Item = &'a IdlePoint>,
    grid: (f64, f64),
    cells: usize,
) -> Vec<f64> {
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
    let (Some(first), Some(last)) = (filled.first(), filled.last()) else { return Vec::new() };
    let mut map = vec![0.0; cells];
    map[..first.0].fill(first.1);
    map[last.0..].fill(last.1);
    for pair in filled.windows(2) {
        let ((i, a), (j, b)) = (pair[0], pair[1]);
        for (k, cell) in map[i..j].iter_mut().enumerate() {
            *cell = a + (b - a) * k as f64 / (j - i) as f64;
        }
    }
    map
}
