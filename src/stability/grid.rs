//! Growth and frequency over a grid of pitch difference, position, speed and width.

use super::cut_root::rightmost_cut_root;
use super::root::{Root, rightmost_root_near};
use crate::plant::cut_loop::{CutLoop, Resonance};
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::Scenario;
use crate::plant::scenario_error::ScenarioError;
use crate::signal::dispatch::Fast;
use thiserror::Error;

/// Values from `low` to `high`, `count` of them, evenly spaced.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridRange {
    low: f64,
    high: f64,
    count: usize,
}

/// Most points of a grid.
const MOST_POINTS: usize = 10_000_000;
/// Slowest and fastest spindle: the number of roots to be looked at grows with the length of a turn.
const LEAST_RPM: f64 = 1.0;
const MOST_RPM: f64 = 1e6;
/// Stiffest cut over the bar. Steel at the bar's middle is some hundredths, a parting tool in a slim bar ten.
const MOST_RATIO: f64 = 1e3;

/// Why there is no grid.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum GridError {
    /// Not a range.
    #[error("range {low}:{high}:{count}: expected two finite numbers and a count of 1 or more")]
    Range {
        /// Start.
        low: f64,
        /// End.
        high: f64,
        /// Number of values.
        count: usize,
    },
    /// More points than anyone waits for.
    #[error("{points} points; at most {MOST_POINTS} are computed")]
    TooMany {
        /// Points asked for.
        points: usize,
    },
    /// A corner that no bar, lathe or tool comes near; the search for roots would not end.
    #[error(
        "{speed_rpm} rpm, {width_m} m wide: expected {LEAST_RPM} to {MOST_RPM} rpm and a cut at most \
         {MOST_RATIO} times as stiff as the bar, here {ratio:.3e}"
    )]
    FarOff {
        /// Speed.
        speed_rpm: f64,
        /// Width.
        width_m: f64,
        /// K/k.
        ratio: f64,
    },
    /// A value of the grid is not physical.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
}

impl GridRange {
    /// Errors: ends not finite, no value.
    pub fn new(low: f64, high: f64, count: usize) -> Result<Self, GridError> {
        let good = low.is_finite() && high.is_finite() && count >= 1;
        if good { Ok(Self { low, high, count }) } else { Err(GridError::Range { low, high, count }) }
    }

    /// One value.
    #[must_use]
    pub fn only(value: f64) -> Self {
        Self { low: value, high: value, count: 1 }
    }

    /// Number of values.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Value `index`.
    #[must_use]
    pub fn value(&self, index: usize) -> f64 {
        if self.count == 1 {
            return self.low;
        }
        let share = index as f64 / (self.count - 1) as f64;
        self.low + (self.high - self.low) * share
    }
}

/// A scenario with four of its numbers varied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// All else.
    pub scenario: Scenario,
    /// theta_2 - theta_1.
    pub pitch_rad: GridRange,
    /// Tools from the chuck.
    pub position_m: GridRange,
    /// S.
    pub speed_rpm: GridRange,
    /// b.
    pub width_m: GridRange,
}

/// One point with its answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridPoint {
    /// theta_2 - theta_1.
    pub pitch_rad: f64,
    /// Tools from the chuck.
    pub position_m: f64,
    /// S.
    pub speed_rpm: f64,
    /// b.
    pub width_m: f64,
    /// Rightmost root there.
    pub root: Root,
}

impl Grid {
    /// The scenario alone.
    #[must_use]
    pub fn of(scenario: Scenario) -> Self {
        Self {
            scenario,
            pitch_rad: GridRange::only(scenario.tools.pitch_difference_rad()),
            position_m: GridRange::only(scenario.tools.position_m()),
            speed_rpm: GridRange::only(scenario.spindle.rpm()),
            width_m: GridRange::only(scenario.cutting.raw().width_m),
        }
    }

    /// Number of points.
    #[must_use]
    pub fn points(&self) -> usize {
        [self.pitch_rad, self.position_m, self.speed_rpm, self.width_m]
            .iter()
            .fold(1usize, |n, r| n.saturating_mul(r.count()))
    }

    /// Rows of the grid: all points of the last two axes with more than one value share a row.
    fn indices(&self, point: usize) -> [usize; 4] {
        let mut rest = point;
        let mut take = |range: &GridRange| {
            let index = rest % range.count();
            rest /= range.count();
            index
        };
        let width = take(&self.width_m);
        let speed = take(&self.speed_rpm);
        let position = take(&self.position_m);
        let pitch = take(&self.pitch_rad);
        [pitch, position, speed, width]
    }

    /// Loop of a point. Errors: a value that is not physical.
    ///
    /// The effects are referred to the scenario as it stands, not to the point.
    fn cut(&self, point: usize) -> Result<(GridPoint, CutLoop), GridError> {
        let [pitch, position, speed, width] = self.indices(point);
        let mut raw = self.scenario.raw();
        raw.pitch_difference_rad = self.pitch_rad.value(pitch);
        raw.position_m = Some(self.position_m.value(position));
        raw.speed_rpm = self.speed_rpm.value(speed);
        raw.cutting.width_m = self.width_m.value(width);
        Scenario::new(&raw)?;
        let condition = CutCondition {
            speed_rpm: raw.speed_rpm,
            width_m: raw.cutting.width_m,
            position_m: self.position_m.value(position),
            pitch_difference_rad: raw.pitch_difference_rad,
            ..CutCondition::of(&self.scenario)
        };
        let at = GridPoint {
            pitch_rad: raw.pitch_difference_rad,
            position_m: self.position_m.value(position),
            speed_rpm: raw.speed_rpm,
            width_m: raw.cutting.width_m,
            root: Root { growth_1_s: 0.0, frequency_hz: 0.0 },
        };
        Ok((at, CutLoop::new(&CutTerms::of(&self.scenario, &condition))))
    }

    /// Errors: too many points, a corner that is not physical or far from every lathe.
    pub fn check(&self) -> Result<(), GridError> {
        let points = self.points();
        if points > MOST_POINTS {
            return Err(GridError::TooMany { points });
        }
        for corner in 0..16usize {
            let end =
                |bit: usize, range: &GridRange| if corner >> bit & 1 == 1 { range.count() - 1 } else { 0 };
            let [a, b, c, d] = [
                end(0, &self.pitch_rad),
                end(1, &self.position_m),
                end(2, &self.speed_rpm),
                end(3, &self.width_m),
            ];
            let point =
                ((a * self.position_m.count() + b) * self.speed_rpm.count() + c) * self.width_m.count() + d;
            let (at, cut) = self.cut(point)?;
            let ratio =
                cut.slope_n_m[0] * cut.resonances().map(|r: Resonance| r.compliance_m_n().abs()).sum::<f64>();
            let good = (LEAST_RPM..=MOST_RPM).contains(&at.speed_rpm) && ratio <= MOST_RATIO;
            if !good {
                let GridPoint { speed_rpm, width_m, .. } = at;
                return Err(GridError::FarOff { speed_rpm, width_m, ratio });
            }
        }
        Ok(())
    }

    /// Answers of the points `from..to`; parts of a grid may run side by side.
    ///
    /// Every point is searched over all of its window; its neighbour's root only tells how far left no
    /// root is worth it. Following it alone would lose the one that takes the lead from far away, and a
    /// map would miss an island. Errors: as [`Grid::check`].
    pub fn evaluate(&self, from: usize, to: usize) -> Result<Vec<GridPoint>, GridError> {
        let mut answers: Vec<GridPoint> = Vec::with_capacity(to.saturating_sub(from));
        let fast = Fast::detect_wide();
        for point in from..to {
            let (mut at, cut) = self.cut(point)?;
            at.root = match cut.two_delay() {
                Some(plain) => rightmost_root_near(&plain, answers.last().map(|before| before.root), fast),
                None => rightmost_cut_root(&cut),
            };
            answers.push(at);
        }
        Ok(answers)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_equals_its_points() {
        let mut grid = Grid::of(Scenario::default());
        grid.pitch_rad = GridRange::new(0.0, 0.5, 23).unwrap();
        grid.speed_rpm = GridRange::new(700.0, 2400.0, 61).unwrap();
        let answers = grid.evaluate(0, grid.points()).unwrap();
        assert_eq!(answers.len(), 23 * 61);
        for (point, answer) in answers.iter().enumerate() {
            let (_, cut) = grid.cut(point).unwrap();
            let alone = rightmost_cut_root(&cut);
            assert!((answer.root.growth_1_s - alone.growth_1_s).abs() < 1e-3, "{answer:?} {alone:?}");
        }
    }

    #[test]
    fn impossible_grids_are_refused() {
        assert!(GridRange::new(0.0, f64::NAN, 3).is_err() && GridRange::new(0.0, 1.0, 0).is_err());
        let mut grid = Grid::of(Scenario::default());
        grid.speed_rpm = GridRange::new(-100.0, 1200.0, 5).unwrap();
        assert!(grid.check().is_err());
        let of = |speed_rpm, width_m| Grid { speed_rpm, width_m, ..Grid::of(Scenario::default()) };
        let usual = (GridRange::only(1200.0), GridRange::only(1e-4));
        assert!(of(usual.0, usual.1).check().is_ok());
        for (speed_rpm, width_m) in [(1e-30, 1e-4), (0.5, 1e-4), (1200.0, 1e30), (1200.0, 1e300)] {
            let grid = of(GridRange::only(speed_rpm), GridRange::only(width_m));
            assert!(grid.check().is_err(), "{speed_rpm} {width_m}");
        }
        let wide = GridRange::new(0.0, 1e300, 3).unwrap();
        assert!(of(usual.0, wide).check().is_err());
    }
}
