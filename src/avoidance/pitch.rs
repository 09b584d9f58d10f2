//! The pitch angle difference that cancels the regenerative effect, and what it takes to make it.

use crate::units::SpindleSpeed;
use std::f64::consts::PI;
use thiserror::Error;

/// Why there is no pitch for these numbers.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum PitchError {
    /// A frequency or diameter that is not a positive number.
    #[error("{what} = {value} is not physical: a finite number above zero is needed")]
    NotPhysical {
        /// Quantity.
        what: &'static str,
        /// Value.
        value: f64,
    },
    /// Half a turn or more: there is no such place for the tool.
    #[error("lobe {lobe} needs a pitch difference of {pitch_difference_rad} rad, half a turn or more")]
    TooLarge {
        /// m.
        lobe: u32,
        /// What (6-10) gives.
        pitch_difference_rad: f64,
    },
}

/// Optimum pitch angle difference: the two regenerative waves stand opposed.
///
/// dtheta = 2 pi (m + 1/2) S/(60 f_c)      (6-10)
///
/// Units: rad. Requires: `chatter_frequency_hz` of the highest tracked line, so that lower lines stay below
/// pi. Errors: a frequency that is not positive, a pitch of half a turn or more.
/// Source: Yamada, PhD thesis, Keio Univ. 2017, 6.4.2, eq. (6-10). Deviation: none.
/// Checked by: `the_pitch_of_the_thesis`, `odd_multiples`, `one_pitch_serves_four_lines`.
pub fn optimum_pitch_rad(
    spindle: SpindleSpeed,
    chatter_frequency_hz: f64,
    lobe: u32,
) -> Result<f64, PitchError> {
    let f = positive("chatter_frequency_hz", chatter_frequency_hz)?;
    let pitch_difference_rad = 2.0 * PI * (f64::from(lobe) + 0.5) * spindle.hz() / f;
    if pitch_difference_rad < PI {
        Ok(pitch_difference_rad)
    } else {
        Err(PitchError::TooLarge { lobe, pitch_difference_rad })
    }
}

/// Phase difference of the regenerative waves at a pitch: pi cancels, 0.7 pi .. 1.1 pi was stable in tests.
///
/// de = 60/S f_c dtheta      (6-9)
///
/// Units: rad. Source: as above, eq. (6-9). Checked by: `one_pitch_serves_four_lines`.
#[must_use]
pub fn wave_phase_difference_rad(
    spindle: SpindleSpeed,
    chatter_frequency_hz: f64,
    pitch_difference_rad: f64,
) -> f64 {
    chatter_frequency_hz * pitch_difference_rad / spindle.hz()
}

/// Displacement of tool 1 in the plane across the bar.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ToolShift {
    /// Along the cut, toward the bar's axis.
    pub toward_m: f64,
    /// Around the bar, across the cut.
    pub around_m: f64,
}

/// Shift that moves tool 1 by half the pitch difference around a bar and keeps it on the surface.
///
/// dx = d/2 (1 - cos a), dy = d/2 sin a, a = dtheta/2
///
/// Units: m. Errors: a diameter that is not positive.
/// Source: Yamada, thesis, fig. 6-15 and table 6-4, which it reproduces. Checked by: `table_6_4`.
pub fn tool_shift(diameter_m: f64, pitch_difference_rad: f64) -> Result<ToolShift, PitchError> {
    let radius_m = positive("diameter_m", diameter_m)? / 2.0;
    let a = pitch_difference_rad / 2.0;
    // 1 - cos a = 2 sin^2(a/2): no cancellation at small angles.
    Ok(ToolShift { toward_m: 2.0 * radius_m * (a / 2.0).sin().powi(2), around_m: radius_m * a.sin() })
}

/// Pitch difference that a shift makes: the inverse of [`tool_shift`], also off the surface.
#[must_use]
pub fn pitch_of_shift_rad(diameter_m: f64, shift: ToolShift) -> f64 {
    2.0 * shift.around_m.atan2(diameter_m / 2.0 - shift.toward_m)
}

fn positive(what: &'static str, value: f64) -> Result<f64, PitchError> {
    if value.is_finite() && value > 0.0 { Ok(value) } else { Err(PitchError::NotPhysical { what, value }) }
}

/// Pitch differences that differ by less are one to everybody who reads of them, rad.
const SAME_PITCH_RAD: f64 = 1e-3;

/// Whether two pitch differences are one to everybody who reads of them, rad.
#[must_use]
pub fn is_same_pitch(one: f64, other: f64) -> bool {
    (one - other).abs() <= SAME_PITCH_RAD
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rpm(value: f64) -> SpindleSpeed {
        SpindleSpeed::from_rpm(value).unwrap()
    }

    #[test]
    fn the_pitch_of_the_thesis() {
        let pitch = optimum_pitch_rad(rpm(1200.0), 652.0, 0).unwrap();
        assert!((pitch.to_degrees() - 5.521).abs() < 0.001);
        // Fig. 6-21: 738 Hz, about half a millimetre of movement.
        let pitch = optimum_pitch_rad(rpm(1200.0), 738.0, 0).unwrap();
        assert!((pitch.to_degrees() - 4.88).abs() < 0.005);
        let shift = tool_shift(0.0221, pitch).unwrap();
        assert!((shift.around_m.hypot(shift.toward_m) - 0.470e-3).abs() < 1e-6);
    }

    #[test]
    fn odd_multiples() {
        for (lobe, half_deg) in [(1, 8.28), (2, 13.80), (3, 19.33)] {
            let pitch = optimum_pitch_rad(rpm(1200.0), 652.0, lobe).unwrap();
            assert!((pitch.to_degrees() / 2.0 - half_deg).abs() < 0.006, "{}", pitch.to_degrees() / 2.0);
        }
    }

    #[test]
    fn one_pitch_serves_four_lines() {
        let pitch = optimum_pitch_rad(rpm(1200.0), 652.0, 0).unwrap();
        for (f, phase_pi) in [(652.0, 1.000), (612.0, 0.939), (572.0, 0.877), (532.0, 0.816)] {
            let got = wave_phase_difference_rad(rpm(1200.0), f, pitch) / PI;
            assert!((got - phase_pi).abs() < 5e-4, "{got}");
        }
    }

    #[test]
    fn an_error_of_ten_hertz_hardly_matters() {
        // Fig. 6-14: at most 0.1 degrees of dtheta/2.
        for (f, worst_deg) in [(560.0, 0.058), (600.0, 0.051), (640.0, 0.045)] {
            let half = |f: f64| optimum_pitch_rad(rpm(1200.0), f, 0).unwrap().to_degrees() / 2.0;
            assert!(((half(f - 10.0) - half(f)) - worst_deg).abs() < 1.1e-3);
        }
    }

    #[test]
    fn table_6_4() {
        // Phase/pi, diameter in mm, dx and dy' in um, as printed; its angles agree with 650 Hz.
        let rows = [
            (0.5, 23.4, 3.4, 281.8),
            (0.6, 23.7, 5.0, 343.3),
            (0.7, 24.1, 6.9, 407.9),
            (0.8, 24.5, 9.1, 472.4),
            (0.9, 24.5, 11.6, 532.2),
            (1.1, 22.9, 16.2, 609.2),
            (1.15, 22.5, 17.4, 626.0),
            (1.2, 24.9, 20.9, 721.0),
        ];
        let printed_half_deg = [1.38, 1.66, 1.94, 2.21, 2.49, 3.05, 3.19, 3.32];
        for ((phase, d_mm, dx_um, dy_um), half_deg) in rows.into_iter().zip(printed_half_deg) {
            let pitch = phase * PI * 20.0 / 650.0;
            assert!((f64::to_degrees(pitch / 2.0) - half_deg).abs() < 0.02);
            // The angle that the printed dy' means; within the printed digits of the printed angle.
            let a = (dy_um / (d_mm * 500.0f64)).asin();
            assert!((a.to_degrees() - half_deg).abs() < 0.02);
            let shift = tool_shift(d_mm * 1e-3, 2.0 * a).unwrap();
            assert!((shift.toward_m * 1e6 - dx_um).abs() < 0.1, "{} {dx_um}", shift.toward_m * 1e6);
            assert!((shift.around_m * 1e6 - dy_um).abs() < 0.1);
        }
    }

    #[test]
    fn a_shift_makes_its_pitch() {
        let shift = tool_shift(0.0234, 0.0963).unwrap();
        assert!((pitch_of_shift_rad(0.0234, shift) - 0.0963).abs() < 1e-12);
    }

    #[test]
    fn what_is_not_physical_is_refused() {
        assert!(optimum_pitch_rad(rpm(1200.0), 0.0, 0).is_err());
        assert!(optimum_pitch_rad(rpm(1200.0), 15.0, 0).is_err());
        assert!(tool_shift(f64::NAN, 0.1).is_err());
    }
}
