//! A sweep as recorded, what is stated beside it, and why one cannot be used.

use crate::units::SampleRate;
use thiserror::Error;

/// A sweep of one axis in force and travel.
#[derive(Debug, Clone, PartialEq)]
pub struct Sweep {
    /// Rate.
    pub rate: SampleRate,
    /// Thrust reference K_t I / R, N.
    pub thrust_ref_n: Vec<f64>,
    /// Motor travel, m; may be empty on a rigid axis with a stage.
    pub motor_travel_m: Vec<f64>,
    /// Stage position, m; may be empty on a rigid axis with a motor encoder.
    pub stage_position_m: Vec<f64>,
}

/// Why a sweep cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum SweepError {
    /// No stretch of steady feed (or rest) is long enough.
    #[error("no stretch of steady feed of {least_s} s or more in {seconds:.1} s of recording")]
    NoStretch {
        /// Needed.
        least_s: f64,
        /// There is.
        seconds: f64,
    },
    /// The input does not excite the band.
    #[error(
        "the current reference excites {bins} lines between {low_hz} and {high_hz} Hz; a sweep is needed"
    )]
    NotExcited {
        /// Lines with enough input.
        bins: usize,
        /// Band.
        low_hz: f64,
        /// Band.
        high_hz: f64,
    },
    /// A signal that the structure needs is missing.
    #[error("a {structure} axis needs {needs}")]
    Signal {
        /// Structure.
        structure: &'static str,
        /// Signal.
        needs: &'static str,
    },
    /// The result is not a drive.
    #[error("the fit ended at a drive that is not physical: {0}")]
    NotPhysical(#[from] crate::plant::drive::ParamError),
}

/// What no sweep shows, one standard deviation each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StatedErrors {
    /// Relative, of the torque constant: masses, stiffness and damping scale with it.
    pub torque_constant: f64,
    /// Of the instants at which the drive takes its reference and its encoders, s; `None`: a tenth of a
    /// sample.
    pub instants_s: Option<f64>,
    /// Relative: how well a first-order lag is the current loop.
    pub current_lag: f64,
}

impl Default for StatedErrors {
    /// A torque constant known to 1 % with 95 % of trust, a current loop that is a lag to 4 %.
    fn default() -> Self {
        Self { torque_constant: 0.005, instants_s: None, current_lag: 0.02 }
    }
}
