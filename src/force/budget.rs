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
use crate::units::SampleRate;
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

/// The weakest line that a detector is asked to find, N, in a band as wide as it rises from (both: contracts,
/// chatter streams).
const WEAKEST_LINE_N: f64 = 1.0;
const LINE_BAND_HZ: f64 = 25.0;
/// Where the step of the rotary encoder is not stated: second-order corner that suits 2^17 counts a turn on a
/// lead of 5 to 10 mm before slides of 100 kg and more, Hz.
const UNSTATED_CUTOFF_HZ: f64 = 150.0;
/// The search goes up by twelfths of an octave from here, Hz.
const LOWEST_CUTOFF_HZ: f64 = 10.0;

/// Where the drive side of a rigid-body balance stops to tell: the lowest frequency at which the steps of the
/// rotary encoder hide what the motor's motion carries of the weakest line. `None`: nowhere below half the
/// rate.
///
///   |m(s)| q sqrt(2 B / f_s) / sqrt(12)  >  |m(s) x_m / F_cut| F_least
///
/// Units: Hz. Source: quantization noise q^2/12 spread evenly to f_s/2 (thesis 4.2), receptance of the drive.
/// Checked by: `steps_of_a_rotary_encoder_end_what_the_drive_side_tells`.
#[must_use]
pub fn drive_side_cutoff_hz(drive: &DriveParams, rate: SampleRate) -> Option<f64> {
    let step_m = drive.motor_encoder_resolution_m();
    let half_rate_hz = 0.5 * rate.hz();
    if step_m <= 0.0 {
        return Some(UNSTATED_CUTOFF_HZ).filter(|hz| *hz < half_rate_hz);
    }
    let chain = Chain::of_drive(drive);
    // The factor m(s) stands on both sides of the comparison.
    let noise_m = step_m / 12f64.sqrt() * (2.0 * LINE_BAND_HZ / rate.hz()).sqrt();
    let hidden = |hz: f64| noise_m > chain.receptance(hz).motor_per_cutting.norm() * WEAKEST_LINE_N;
    let steps = (0..).map(|k| LOWEST_CUTOFF_HZ * 2f64.powf(f64::from(k) / 12.0));
    steps.take_while(|hz| *hz < half_rate_hz).find(|hz| hidden(*hz))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drive(step_m: Option<f64>) -> DriveParams {
        DriveParams::new(RawDriveParams {
            movable_mass_kg: Some(150.0),
            screw_lead_m: Some(6.0e-3),
            rotary_inertia_kg_m2: Some(1.4e-3),
            axial_stiffness_n_m: Some(1.3e8),
            structural_damping_n_s_m: Some(9.0e3),
            motor_encoder_resolution_m: step_m,
            ..RawDriveParams::default()
        })
        .unwrap()
    }

    /// Above the resonance the motor answers F/(M_r w^2) and less: at the cutoff the two sides are equal.
    #[test]
    fn steps_of_a_rotary_encoder_end_what_the_drive_side_tells() {
        let rate = SampleRate::new(9000.0).unwrap();
        let coarse = drive_side_cutoff_hz(&drive(Some(37.5e-9)), rate).unwrap();
        assert!((100.0..250.0).contains(&coarse), "{coarse} Hz");
        let fine = drive_side_cutoff_hz(&drive(Some(37.5e-12)), rate).unwrap();
        assert!(fine > 3.0 * coarse, "{fine} Hz");
        assert_eq!(drive_side_cutoff_hz(&drive(Some(1e-18)), rate), None);
        assert_eq!(drive_side_cutoff_hz(&drive(None), rate), Some(UNSTATED_CUTOFF_HZ));
        // A rate twice as high spreads the same steps over twice the band.
        let faster = drive_side_cutoff_hz(&drive(Some(37.5e-9)), SampleRate::new(18_000.0).unwrap()).unwrap();
        assert!(faster >= coarse);
    }
}
