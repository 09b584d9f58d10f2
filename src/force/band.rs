//! The band in which an estimate can be used: below the low-pass, and as far as the method itself is right
//! within a tenth of the force.
//!
//! ```text
//!  thrust      |u/F - 1| of the closed loop        dob         its error budget on a flexible axis
//!  spectral    first line to last line             fitted      mean to last line
//!  the others  all of the low-pass (a tenth of the rate where there is none)
//! ```
//! Checked by: force::each_method_states_the_band_it_is_right_in.

use super::balance::Method;
use super::budget::{Budget, Imperfection};
use super::closed_loop::ClosedLoop;
use super::estimator::{AxisSignals, ForceSettings};

/// Share of the force by which a method may be wrong inside its band.
const TOLERATED: f64 = 0.1;

/// Lower and upper end, Hz; both zero where nothing says that the method is right anywhere.
pub(super) fn usable_band_hz(
    method: Method,
    axis: &AxisSignals<'_>,
    settings: &ForceSettings,
    low_pass_hz: f64,
) -> [f64; 2] {
    match (method, settings.harmonic, settings.controller) {
        (Method::Spectral | Method::Fitted, Some(harmonic), _) => {
            band_of_lines_hz(method, harmonic.lines_hz(axis.rate), low_pass_hz)
        }
        (Method::Thrust, _, Some(controller)) => {
            let closed = ClosedLoop::new(axis, controller);
            [0.0, right_up_to(low_pass_hz, |hz| (closed.thrust_per_cutting(hz) - 1.0).norm())]
        }
        (Method::Thrust, _, None) => [0.0, 0.0],
        (Method::Dob, _, _) => match Budget::new(method, axis.drive, Imperfection::default()) {
            Ok(budget) => [0.0, right_up_to(low_pass_hz, |hz| budget.relative_error(hz))],
            Err(_) => [0.0, 0.0],
        },
        _ => [0.0, low_pass_hz],
    }
}

/// The band of a method that knows the spindle, from its first and last line, Hz.
pub(super) fn band_of_lines_hz(method: Method, [first_hz, last_hz]: [f64; 2], low_pass_hz: f64) -> [f64; 2] {
    let low_hz = if method == Method::Spectral { first_hz } else { 0.0 };
    [low_hz, last_hz.min(low_pass_hz)]
}

/// First frequency at which the error passes what is tolerated, in steps of 2 %.
fn right_up_to(highest_hz: f64, error: impl Fn(f64) -> f64) -> f64 {
    let mut hz: f64 = 0.5;
    while hz < highest_hz && error(hz) <= TOLERATED {
        hz *= 1.02;
    }
    if hz > 0.5 { hz.min(highest_hz) } else { 0.0 }
}
