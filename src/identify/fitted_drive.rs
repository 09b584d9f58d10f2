//! What a fit to a sweep tells of a drive: values with their errors, a further mode, responses.

use rustfft::num_complex::Complex64;

/// One fitted parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct FittedParameter {
    /// Key of the model file.
    pub name: &'static str,
    /// Value of the prior model.
    pub prior: f64,
    /// Fitted value.
    pub value: f64,
    /// Standard deviation from the noise of this sweep and the misfit of the model; infinite where the model
    /// does not explain the sweep.
    pub noise: f64,
    /// Standard deviation from what no sweep shows: `StatedErrors`.
    pub stated: f64,
    /// 95 % interval of both.
    pub ci95: [f64; 2],
}

/// A torsional mode that the sweep shows beside two inertias.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FittedMode {
    /// Free-free frequency of the two parts of the inertia, Hz.
    pub frequency_hz: f64,
    /// Its standard deviation from noise, Hz.
    pub frequency_deviation_hz: f64,
    /// Share of the inertia behind the torsional spring.
    pub screw_share: f64,
    /// Its standard deviation from noise.
    pub share_deviation: f64,
    /// Damping over critical, of the screw on the torsional spring.
    pub damping_ratio: f64,
}

/// Measured and fitted response averaged over a narrow band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResponsePoint {
    /// Centre, Hz.
    pub frequency_hz: f64,
    /// Acceleration of the motor per thrust, 1/kg: measured, fitted.
    pub motor_1_kg: [Complex64; 2],
    /// Acceleration of the stage per thrust, 1/kg: measured, fitted.
    pub stage_1_kg: [Complex64; 2],
    /// Squared coherence of motor and stage with the thrust.
    pub coherence: [f64; 2],
}
