//! The band in which an estimate can be used: below the low-pass, and as far as the method itself is right
//! within a tenth of the force.
//!
//! ```text
//!  thrust      |u/F - 1| of the closed loop        dob         its error budget on a flexible axis
//!  spectral    first line to last line             fitted      mean to last line
//!  sum of both sides (medob, rigid_mode, fitted) behind a low-pass of the drive side: as far as that side's
//!              share of the force is small above it, and again far above the axial mode
//!  three inertias, two encoders: as far as the screw moves with the motor
//!  the others  all of the low-pass (a tenth of the rate where there is none)
//! ```
//! Checked by: force::each_method_states_the_band_it_is_right_in.

use super::balance::Method;
use super::budget::{Budget, Imperfection};
use super::closed_loop::ClosedLoop;
use super::settings::ForceSettings;
use super::signals::{AxisSignals, Signals};
use crate::plant::drive::{DriveParams, Structure};
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// Share of the force by which a method may be wrong inside its band.
pub(super) const TOLERATED: f64 = 0.1;
/// Below this many times the noise that encoder steps make nothing is taken for a force.
pub(super) const NOISE_RATIO: f64 = 3.0;

/// Lower and upper end, Hz; both zero where nothing says that the method is right anywhere.
pub(super) fn usable_band_hz(
    method: Method,
    axis: &AxisSignals<'_>,
    settings: &ForceSettings,
    low_pass_hz: f64,
) -> [f64; 2] {
    match (method, settings.harmonic, settings.controller) {
        (Method::Spectral | Method::Fitted, Some(harmonic), _) => {
            let reach_hz = heard_up_to_hz(method, axis.drive, settings, low_pass_hz);
            band_of_lines_hz(method, harmonic.lines_hz(axis.rate), reach_hz)
        }
        (Method::Medob | Method::RigidMode | Method::VibrationMode, _, _)
            if axis.drive.structure() == Structure::TripleInertia && axis.signals == Signals::Both =>
        {
            // Two encoders take the screw to move with the motor (2-65), which it does not.
            let budget = Budget::new(method, axis.drive, Imperfection::default());
            let heard_hz = heard_up_to_hz(method, axis.drive, settings, low_pass_hz);
            [0.0, budget.map_or(0.0, |budget| right_up_to(heard_hz, |hz| budget.relative_error(hz)))]
        }
        (Method::Medob | Method::RigidMode, _, _) => {
            [0.0, heard_up_to_hz(method, axis.drive, settings, low_pass_hz)]
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

/// From where on, up to the low-pass, a sum of both sides behind a low-pass of the drive side is right within
/// a tenth again: far above the axial mode that side carries hardly anything of the force. `None` where the
/// band is whole, or never right again.
///
/// Checked by: force_flags::above_the_axial_mode_the_drive_sides_low_pass_lacks_nothing.
pub(super) fn usable_above_hz(
    method: Method,
    axis: &AxisSignals<'_>,
    settings: &ForceSettings,
    low_pass_hz: f64,
) -> Option<f64> {
    let two_of_three = axis.drive.structure() == Structure::TripleInertia && axis.signals == Signals::Both;
    let summed = matches!(method, Method::Medob | Method::RigidMode) && !two_of_three;
    let wrong = |hz: f64| unheard_drive_share(axis.drive, settings, hz) > TOLERATED;
    if !summed || settings.drive_filter.is_none() || wrong(low_pass_hz) {
        return None;
    }
    let below = (0..).map(|k| low_pass_hz / 1.02_f64.powi(k)).take_while(|hz| *hz > 0.5);
    below.take_while(|hz| !wrong(*hz)).last().filter(|hz| *hz > 0.5 * 1.02)
}

/// How far a sum of both sides is right behind a low-pass of the drive side; `low_pass_hz` for the others.
pub(super) fn heard_up_to_hz(
    method: Method,
    drive: &DriveParams,
    settings: &ForceSettings,
    low_pass_hz: f64,
) -> f64 {
    match method {
        Method::Medob | Method::RigidMode | Method::Fitted => {
            right_up_to(low_pass_hz, |hz| unheard_drive_share(drive, settings, hz))
        }
        _ => low_pass_hz,
    }
}

/// Share of the cutting force that the drive side carries and its low-pass H keeps back.
///
/// The drive side's balance is the force S in the coupling. With the motor free, Z = K + C s and
/// Q = Z (M_r s^2 + C_r s) / (M_r s^2 + C_r s + Z): S / F = Q / (M_t s^2 + C_t s + Q), so that
/// |1 - H e^(s T)| |S / F| is missing, T the time that the stage's side waits. Checked by:
/// force::behind_the_drive_sides_low_pass_the_band_ends_where_the_motor_moves.
fn unheard_drive_share(drive: &DriveParams, settings: &ForceSettings, hz: f64) -> f64 {
    let Some(filter) = settings.drive_filter else { return 0.0 };
    let w = TAU * hz;
    let s = Complex64::new(0.0, w);
    let (re, im) = filter.response(hz);
    let heard = Complex64::new(re, im) * Complex64::from_polar(1.0, w * filter.slow_delay_s());
    let coupling = drive.axial_stiffness_n_m() + s * drive.structural_damping_n_s_m();
    let motor = s * s * drive.reflected_mass_kg() + s * drive.reflected_damping_n_s_m();
    let stage = s * s * drive.movable_mass_kg() + s * drive.translational_damping_n_s_m();
    let through = if coupling.norm() > 0.0 { coupling * motor / (motor + coupling) } else { motor };
    ((1.0 - heard) * through / (stage + through)).norm()
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
