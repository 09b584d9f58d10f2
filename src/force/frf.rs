//! Force from accelerometers on the spindle housing, by frequency responses that depend on speed.
//!
//! ```text
//!  F_i(f) = sum_j [ H_ij(f) + 2 pi i f Omega G_ij(f) + Omega^2 N_ij(f) ] X_j(f),   X = -A / (2 pi f)^2
//! ```
//! Nine functions for each force axis, piecewise linear over nodes of frequency; `frf_stream`
//! filters by them.
//! The mean force is not estimated: accelerometers do not see it.
//!
//! Source: Vogl, Regli and Corson, 2022, eq. (1), (2).

use super::validity::Validity;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
use thiserror::Error;

/// Accelerometer axes that an estimator reads.
pub const ACCEL_AXES: usize = 3;

/// Functions for each accelerometer axis: H, G, N.
pub const TERMS: usize = 3;

/// Unknowns at one node: H, G, N of x, then of y, then of z.
pub const NODE_UNKNOWNS: usize = ACCEL_AXES * TERMS;

/// Speed by which Omega is scaled, rpm; frequency by which the derivative is: so that the three
/// functions have the same unit (N/m) and like sizes.
pub const SPEED_SCALE_RPM: f64 = 10_000.0;
/// See [`SPEED_SCALE_RPM`].
pub const FREQUENCY_SCALE_HZ: f64 = 500.0;

/// Why an accelerometer estimator cannot be used.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FrfError {
    /// Nodes are not at least two growing frequencies, or the functions have another length.
    #[error(
        "estimator has {nodes} nodes and {functions} values a function, expected at least 2 nodes and as many"
    )]
    Shape {
        /// Nodes.
        nodes: usize,
        /// Values.
        functions: usize,
    },
    /// The rate is too low for the band.
    #[error("the estimator reaches {high_hz} Hz, the recording ends at {nyquist_hz} Hz, half its rate")]
    Rate {
        /// Upper end of the estimator.
        high_hz: f64,
        /// Half the rate.
        nyquist_hz: f64,
    },
}

/// Nine functions of one force axis, and what they were made from.
#[derive(Debug, Clone, PartialEq)]
pub struct FrfEstimator {
    /// Force axis.
    pub axis: String,
    /// Node frequencies, growing, Hz.
    pub nodes_hz: Vec<f64>,
    /// At each node the nine values, N/m.
    pub values: Vec<[Complex64; NODE_UNKNOWNS]>,
    /// Slowest and fastest spindle speed it was made from, rpm.
    pub speed_range_rpm: [f64; 2],
    /// Standard deviation that sensor noise causes in the force, N (in the whole band, mid speed).
    pub noise_floor_n: f64,
    /// Condition number of the fit.
    pub condition: f64,
}

/// Condition number of normal equations from which on a fit is not believed.
const ILL_CONDITIONED: f64 = 1e10;

/// The factors of H, G, N in the response at a frequency and speed; G's is imaginary.
#[must_use]
pub fn term_factors(frequency_hz: f64, speed_rpm: f64) -> [Complex64; TERMS] {
    let omega = speed_rpm / SPEED_SCALE_RPM;
    [
        Complex64::new(1.0, 0.0),
        Complex64::new(0.0, omega * frequency_hz / FREQUENCY_SCALE_HZ),
        Complex64::new(omega * omega, 0.0),
    ]
}

impl FrfEstimator {
    /// Errors: fewer than two nodes, or values that do not fit them.
    pub fn check(&self) -> Result<(), FrfError> {
        let growing = self.nodes_hz.windows(2).all(|w| w[1] > w[0]) && self.nodes_hz.iter().all(|f| *f > 0.0);
        if self.nodes_hz.len() < 2 || self.values.len() != self.nodes_hz.len() || !growing {
            return Err(FrfError::Shape { nodes: self.nodes_hz.len(), functions: self.values.len() });
        }
        Ok(())
    }

    /// Band of the estimator, Hz.
    #[must_use]
    pub fn band_hz(&self) -> [f64; 2] {
        [self.nodes_hz.first().copied().unwrap_or(0.0), self.nodes_hz.last().copied().unwrap_or(0.0)]
    }

    /// Force per acceleration of each axis, N s2/m = kg, at a frequency and spindle speed; zero outside
    /// the band.
    #[must_use]
    pub fn response_kg(&self, frequency_hz: f64, speed_rpm: f64) -> [Complex64; ACCEL_AXES] {
        let zero = [Complex64::new(0.0, 0.0); ACCEL_AXES];
        let [low, high] = self.band_hz();
        if !(low..=high).contains(&frequency_hz) {
            return zero;
        }
        let k = self.nodes_hz.partition_point(|f| *f <= frequency_hz).clamp(1, self.nodes_hz.len() - 1) - 1;
        let share = (frequency_hz - self.nodes_hz[k]) / (self.nodes_hz[k + 1] - self.nodes_hz[k]);
        let factors = term_factors(frequency_hz, speed_rpm);
        let displacement = -1.0 / (TAU * frequency_hz).powi(2);
        let mut out = zero;
        for (j, sum) in out.iter_mut().enumerate() {
            for (g, factor) in factors.iter().enumerate() {
                let u = j * TERMS + g;
                let value = self.values[k][u] * (1.0 - share) + self.values[k + 1][u] * share;
                *sum += value * factor * displacement;
            }
        }
        out
    }

    /// Whether the fit behind it was close to singular: beyond this condition number of its normal equations
    /// double precision keeps fewer than six digits of a function.
    #[must_use]
    pub fn condition_flags(&self) -> Validity {
        Validity::when(!(self.condition < ILL_CONDITIONED), Validity::ILL_CONDITIONED)
    }

    /// What speaks against an estimate at this speed.
    #[must_use]
    pub fn flags(&self, speed_rpm: f64) -> Validity {
        let [slow, fast] = self.speed_range_rpm;
        // Between two trained speeds the functions interpolate; beyond them the quadratic runs away.
        let margin = 0.02 * (fast - slow);
        let outside = speed_rpm < slow - margin || speed_rpm > fast + margin;
        Validity::when(outside, Validity::EXTRAPOLATED)
    }
}

/// Samples of one instant of the three accelerometers, m/s2.
pub type AccelSample = [f64; ACCEL_AXES];
