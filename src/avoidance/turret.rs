//! From a shift of tool 1 to offsets of the turret's axes, which need not stand at right angles, and back.
//!
//! ```text
//!        Y1 (45 degrees)
//!       /
//!      /  around
//!     /   ^
//!    o----+--> X1 = toward the bar's axis          [toward]   [cos x  cos y] [offset x]
//!  tool 1                                          [around] = [sin x  sin y] [offset y]
//! ```

use super::pitch::ToolShift;
use crate::sample::MAX_AXES;
use thiserror::Error;

/// One axis of the turret that carries tool 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurretAxis {
    /// Place of the axis in the servo stream and in commands.
    pub index: usize,
    /// Angle of its positive direction from "toward the bar's axis", positive in the sense in which the
    /// pitch difference grows.
    pub direction_rad: f64,
    /// Least offset allowed.
    pub lowest_m: f64,
    /// Greatest offset allowed.
    pub highest_m: f64,
    /// Fastest motion of the offset.
    pub speed_m_s: f64,
    /// Largest acceleration of the offset.
    pub acceleration_m_s2: f64,
}

impl TurretAxis {
    /// Longest way from rest to rest within a time: half of it speeding up where that stays below the largest
    /// speed, else with a stretch at that speed between.
    #[must_use]
    pub fn way_m(&self, time_s: f64) -> f64 {
        let (v, a) = (self.speed_m_s, self.acceleration_m_s2);
        if a * time_s < 2.0 * v { 0.25 * a * time_s * time_s } else { v * (time_s - v / a) }
    }
}

/// The two axes that move tool 1 across the bar.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurretKinematics {
    axes: [TurretAxis; 2],
    inverse: [[f64; 2]; 2],
}

/// Why a turret cannot be moved as described.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum TurretError {
    /// The axes span no plane.
    #[error(
        "turret axes at {first_rad} and {second_rad} rad are parallel: they cannot move the tool around \
         the bar"
    )]
    Parallel {
        /// Direction of the first.
        first_rad: f64,
        /// Direction of the second.
        second_rad: f64,
    },
    /// An axis has no place in the stream, no direction, range, speed or acceleration.
    #[error(
        "turret axis {index}: expected a place below {MAX_AXES}, a direction that is a number, a range \
         around zero, speed and acceleration above zero"
    )]
    Axis {
        /// Place given.
        index: usize,
    },
}

impl TurretKinematics {
    /// Errors: parallel axes, an axis without range around zero, speed or acceleration.
    pub fn new(axes: [TurretAxis; 2]) -> Result<Self, TurretError> {
        for axis in &axes {
            let good = axis.index < MAX_AXES
                && axis.direction_rad.is_finite()
                && axis.lowest_m.is_finite()
                && axis.highest_m.is_finite()
                && axis.lowest_m <= 0.0
                && axis.highest_m >= 0.0
                && [axis.speed_m_s, axis.acceleration_m_s2].iter().all(|x| x.is_finite() && *x > 0.0);
            if !good || axes[0].index == axes[1].index {
                return Err(TurretError::Axis { index: axis.index });
            }
        }
        let [(sx, cx), (sy, cy)] = [axes[0].direction_rad.sin_cos(), axes[1].direction_rad.sin_cos()];
        let determinant = cx * sy - cy * sx;
        // Nearer than 5 degrees to parallel a small shift needs a long travel.
        if determinant.abs() < 0.09 {
            let (first_rad, second_rad) = (axes[0].direction_rad, axes[1].direction_rad);
            return Err(TurretError::Parallel { first_rad, second_rad });
        }
        let inverse = [[sy / determinant, -cy / determinant], [-sx / determinant, cx / determinant]];
        Ok(Self { axes, inverse })
    }

    /// The axes.
    #[must_use]
    pub fn axes(&self) -> &[TurretAxis; 2] {
        &self.axes
    }

    /// Offset of each axis of the stream for a shift of tool 1; zero for axes of others.
    /// Checked by: `offsets_make_the_shift`, `the_machine_of_the_thesis`.
    #[must_use]
    pub fn offsets_m(&self, shift: ToolShift) -> [f64; MAX_AXES] {
        let mut offsets = [0.0; MAX_AXES];
        for (axis, row) in self.axes.iter().zip(&self.inverse) {
            offsets[axis.index] = row[0] * shift.toward_m + row[1] * shift.around_m;
        }
        offsets
    }

    /// Shift of tool 1 that offsets make.
    #[must_use]
    pub fn shift(&self, offsets_m: &[f64; MAX_AXES]) -> ToolShift {
        let mut shift = ToolShift::default();
        for axis in &self.axes {
            let (sin, cos) = axis.direction_rad.sin_cos();
            shift.toward_m += cos * offsets_m[axis.index];
            shift.around_m += sin * offsets_m[axis.index];
        }
        shift
    }

    /// Whether every offset lies in its axis' range.
    #[must_use]
    pub fn reaches(&self, offsets_m: &[f64; MAX_AXES]) -> bool {
        self.axes.iter().all(|a| (a.lowest_m..=a.highest_m).contains(&offsets_m[a.index]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avoidance::pitch::tool_shift;

    fn turret(first_rad: f64, second_rad: f64) -> Result<TurretKinematics, TurretError> {
        let axis = |index, direction_rad| TurretAxis {
            index,
            direction_rad,
            lowest_m: -2e-3,
            highest_m: 2e-3,
            speed_m_s: 1e-3,
            acceleration_m_s2: 0.05,
        };
        TurretKinematics::new([axis(0, first_rad), axis(1, second_rad)])
    }

    #[test]
    fn offsets_make_the_shift() {
        let shift = ToolShift { toward_m: 13.6e-6, around_m: 563.0e-6 };
        for (first, second) in [(0.0, 0.785), (0.3, -1.2), (2.0, 0.4), (-0.1, 1.7)] {
            let turret = turret(first, second).unwrap();
            let back = turret.shift(&turret.offsets_m(shift));
            assert!((back.toward_m - shift.toward_m).abs() < 1e-15);
            assert!((back.around_m - shift.around_m).abs() < 1e-15);
        }
    }

    #[test]
    fn the_machine_of_the_thesis() {
        // X1 toward the bar, Y1 at 45 degrees: y carries all of the motion around, x takes its part back.
        let turret = turret(0.0, std::f64::consts::FRAC_PI_4).unwrap();
        let shift = tool_shift(0.0234, 5.52f64.to_radians()).unwrap();
        let offsets = turret.offsets_m(shift);
        assert!((offsets[1] - shift.around_m * std::f64::consts::SQRT_2).abs() < 1e-12);
        assert!((offsets[0] - (shift.toward_m - shift.around_m)).abs() < 1e-12);
        assert!(turret.reaches(&offsets));
    }

    #[test]
    fn the_longest_way_is_that_of_a_trapezoid() {
        let axis = |speed_m_s, acceleration_m_s2| TurretAxis {
            speed_m_s,
            acceleration_m_s2,
            ..turret(0.0, 1.0).unwrap().axes[0]
        };
        // 0.2 s to 2 mm/s, 0.6 s at it, 0.2 s to rest.
        assert!((axis(2e-3, 0.01).way_m(1.0) - 1.6e-3).abs() < 1e-15);
        // Never at full speed: up for half a second, down for half a second.
        assert!((axis(2e-3, 1e-3).way_m(1.0) - 0.25e-3).abs() < 1e-15);
        let (a, b) = (axis(2e-3, 4e-3).way_m(1.0 - 1e-9), axis(2e-3, 4e-3).way_m(1.0 + 1e-9));
        assert!((a - b).abs() < 1e-11);
    }

    #[test]
    fn parallel_axes_are_refused() {
        assert!(matches!(turret(0.3, 0.3 + std::f64::consts::PI), Err(TurretError::Parallel { .. })));
    }
}
