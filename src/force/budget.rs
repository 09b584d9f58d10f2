//! Error budget of an observer: what wrong parameters, delays and encoder steps do to its estimate.
//!
//! The true drive answers a cutting force (the motor is not driven, as in the thesis, appendix B); the
//! observer has its own, wrong, parameters and reads the motion late or in steps:
//!
//!   F_est / F_cut = Q(s) [ m(s) e^{-s d_m} x_m / F_cut + t(s) e^{-s d_t} x_t / F_cut ]
//!
//! Source: Yamada, thesis 4.2, 5.2 and appendix B (B-4). Checked by: identities::mass_error_is_b_4,
//! identities::no_error_leaves_the_low_pass.

use super::balance::{ForceBalance, Method};
use super::response::Chain;
use crate::plant::drive::{DriveParams, ParamError, RawDriveParams};
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;

/// What is wrong with the observer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imperfection {
    /// Nominal over true movable mass.
    pub mass_factor: f64,
    /// Nominal over true rotary inertia.
    pub inertia_factor: f64,
    /// Nominal over true axial stiffness.
    pub stiffness_factor: f64,
    /// By how much the motor's position comes later than the observer believes, s.
    pub motor_late_s: f64,
    /// By how much the stage's position comes later than the observer believes, s.
    pub stage_late_s: f64,
}

impl Default for Imperfection {
    /// Nothing wrong.
    fn default() -> Self {
        Self {
            mass_factor: 1.0,
            inertia_factor: 1.0,
            stiffness_factor: 1.0,
            motor_late_s: 0.0,
            stage_late_s: 0.0,
        }
    }
}

/// An observer with wrong parameters before a true drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Budget {
    truth: Chain,
    balance: ForceBalance,
    imperfection: Imperfection,
}

impl Budget {
    /// Errors: factors that make the nominal drive unphysical.
    pub fn new(method: Method, drive: &DriveParams, imperfection: Imperfection) -> Result<Self, ParamError> {
        let raw = drive.raw();
        let nominal = DriveParams::new(RawDriveParams {
            movable_mass_kg: raw.movable_mass_kg.map(|m| m * imperfection.mass_factor),
            rotary_inertia_kg_m2: raw.rotary_inertia_kg_m2.map(|j| j * imperfection.inertia_factor),
            axial_stiffness_n_m: raw.axial_stiffness_n_m.map(|k| k * imperfection.stiffness_factor),
            ..raw.clone()
        })?;
        Ok(Self { truth: Chain::of_drive(drive), balance: ForceBalance::new(method, &nominal), imperfection })
    }

    /// F_est / F_cut before the low-pass.
    #[must_use]
    pub fn response(&self, frequency_hz: f64) -> Complex64 {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let factors = |f: [f64; 3]| f[0] + s * (f[1] + s * f[2]);
        let x = self.truth.receptance(frequency_hz);
        factors(self.balance.motor.as_array())
            * (-s * self.imperfection.motor_late_s).exp()
            * x.motor_per_cutting
            + factors(self.balance.stage.as_array())
                * (-s * self.imperfection.stage_late_s).exp()
                * x.stage_per_cutting
    }

    /// |F_est / F_cut - 1|: error as a share of the force.
    #[must_use]
    pub fn relative_error(&self, frequency_hz: f64) -> f64 {
        (self.response(frequency_hz) - 1.0).norm()
    }

    /// Standard deviation of what rounding to encoder steps adds, if all of it fell at this frequency, N:
    /// q/sqrt(12) of each encoder through its part of the balance.
    #[must_use]
    pub fn step_error_n(&self, frequency_hz: f64, motor_step_m: f64, stage_step_m: f64) -> f64 {
        let s = Complex64::new(0.0, TAU * frequency_hz);
        let size = |f: [f64; 3], step_m: f64| (f[0] + s * (f[1] + s * f[2])).norm() * step_m / 12f64.sqrt();
        let motor_n = size(self.balance.motor.as_array(), motor_step_m);
        motor_n.hypot(size(self.balance.stage.as_array(), stage_step_m))
    }
}
