//! Force variance that encoder steps cause in an observer Q(s) (M s^2 + C s), by the discrete Lyapunov
//! equation, and by trying it out.
//!
//! Source: Hayashi et al., IV, eq. (8)-(14), figure 5. Q is taken as the second-order low-pass
//! w^2/(s^2 + 1.414 w s + w^2) (its damping is not printed), discretised by the bilinear rule.
//! Checked by: force::lyapunov_variance_is_met_by_quantizing_a_motion.

use crate::plant::drive::DriveParams;
use crate::signal::butterworth::Section;
use crate::units::SampleRate;
use nalgebra::{DMatrix, DVector};
use rand::RngExt as _;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{SQRT_2, TAU};
use thiserror::Error;

/// Why a variance cannot be had.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ResolutionError {
    /// The cutoff must be below half the rate.
    #[error("cutoff of {cutoff_hz} Hz is not between 0 and {nyquist_hz} Hz, half the sampling rate")]
    Cutoff {
        /// Value.
        cutoff_hz: f64,
        /// Half the rate.
        nyquist_hz: f64,
    },
    /// The filter is not stable, so no variance settles.
    #[error("the discretised observer is not stable at {cutoff_hz} Hz")]
    Unstable {
        /// Value.
        cutoff_hz: f64,
    },
}

/// Solves X = A X A^T + Q by vectorisation; `None` where A is not stable (no such X).
#[must_use]
pub fn discrete_lyapunov(a: &DMatrix<f64>, q: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = a.nrows();
    let system = DMatrix::identity(n * n, n * n) - a.kronecker(a);
    let right = DVector::from_column_slice(q.as_slice());
    let x = system.lu().solve(&right)?;
    let x = DMatrix::from_column_slice(n, n, x.as_slice());
    // A variance is not negative; a solution of an unstable system is no variance.
    (0..n).all(|i| x[(i, i)] >= 0.0).then_some(x)
}

/// Q(s) (M s^2 + C s) at a rate: force from position.
///
/// Errors: a cutoff that is not below half the rate.
pub fn observer_section(
    mass_kg: f64,
    damping_n_s_m: f64,
    cutoff_hz: f64,
    rate: SampleRate,
) -> Result<Section, ResolutionError> {
    let nyquist_hz = rate.hz() / 2.0;
    if !(cutoff_hz > 0.0 && cutoff_hz < nyquist_hz) {
        return Err(ResolutionError::Cutoff { cutoff_hz, nyquist_hz });
    }
    let w = TAU * cutoff_hz;
    let k = 2.0 * rate.hz(); // s = k (z - 1)/(z + 1)
    let a0 = k * k + SQRT_2 * w * k + w * w;
    let gain = w * w / a0;
    let (m, c) = (mass_kg * k * k, damping_n_s_m * k);
    Ok(Section {
        b: [gain * (m + c), gain * -2.0 * m, gain * (m - c)],
        a: [2.0 * (w * w - k * k) / a0, (k * k - SQRT_2 * w * k + w * w) / a0],
    })
}

/// Output variance for white input of unit variance: c X c^T + d^2, X = A X A^T + b b^T   (13), (14)
///
/// Errors: the section is not stable.
pub fn section_variance(section: &Section, cutoff_hz: f64) -> Result<f64, ResolutionError> {
    let [a1, a2] = section.a;
    let [b0, b1, b2] = section.b;
    let a = DMatrix::from_row_slice(2, 2, &[-a1, -a2, 1.0, 0.0]);
    let b = DVector::from_column_slice(&[1.0, 0.0]);
    let c = DVector::from_column_slice(&[b1 - a1 * b0, b2 - a2 * b0]);
    let stable = a2.abs() < 1.0 && a1.abs() < 1.0 + a2;
    let x = discrete_lyapunov(&a, &(&b * b.transpose())).filter(|_| stable);
    let x = x.ok_or(ResolutionError::Unstable { cutoff_hz })?;
    Ok((c.transpose() * x * &c)[(0, 0)] + b0 * b0)
}

/// Force variance of the multi-encoder observer at one cutoff.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceVariance {
    /// Cutoff of Q, Hz.
    pub cutoff_hz: f64,
    /// From the steps of the motor encoder, N^2.
    pub motor_n2: f64,
    /// From the steps of the stage encoder, N^2.
    pub stage_n2: f64,
}

impl ForceVariance {
    /// Standard deviation of both together, N.
    #[must_use]
    pub fn deviation_n(&self) -> f64 {
        (self.motor_n2 + self.stage_n2).sqrt()
    }
}

/// Encoder steps as stage travel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EncoderSteps {
    /// Motor encoder, m.
    pub motor_m: f64,
    /// Stage encoder, m.
    pub stage_m: f64,
}

/// Variance q^2/12 of each encoder through its observer. Errors: cutoff not below half the rate.
pub fn force_variance(
    drive: &DriveParams,
    steps: EncoderSteps,
    cutoff_hz: f64,
    rate: SampleRate,
) -> Result<ForceVariance, ResolutionError> {
    let side = |mass: f64, damping: f64, step_m: f64| {
        let section = observer_section(mass, damping, cutoff_hz, rate)?;
        Ok(step_m * step_m / 12.0 * section_variance(&section, cutoff_hz)?)
    };
    let turning_kg = drive.total_mass_kg() - drive.movable_mass_kg();
    Ok(ForceVariance {
        cutoff_hz,
        motor_n2: side(turning_kg, drive.reflected_damping_n_s_m(), steps.motor_m)?,
        stage_n2: side(drive.movable_mass_kg(), drive.translational_damping_n_s_m(), steps.stage_m)?,
    })
}

/// The same variance found by trying: both positions rounded to their steps, the difference through the
/// observer. Reproducible by its seed.
///
/// A fast feed with random vibration of a few steps makes the error white, as the Lyapunov equation takes it
/// to be; a slow one (`feed_steps`) shows what becomes of that below a step a sample: a sawtooth.
///
/// Errors: cutoff not below half the rate.
pub fn monte_carlo_variance(
    drive: &DriveParams,
    steps: EncoderSteps,
    cutoff_hz: f64,
    settings: MonteCarlo,
) -> Result<ForceVariance, ResolutionError> {
    let rate = settings.rate;
    let mut random = ChaCha8Rng::seed_from_u64(settings.seed);
    let turning_kg = drive.total_mass_kg() - drive.movable_mass_kg();
    let mut side = |mass: f64, damping: f64, step_m: f64| -> Result<f64, ResolutionError> {
        let section = observer_section(mass, damping, cutoff_hz, rate)?;
        if step_m == 0.0 {
            return Ok(0.0);
        }
        let (mut state, mut sum) = ([0.0; 2], 0.0);
        let skip = 1000;
        // Feed of 7.3 to 9.3 steps a sample: no common measure with the step, so the error is white.
        let feed = 7.3 + 2.0 * random.random::<f64>();
        let (feed, vibration) = settings.feed_steps.map_or((feed, 5.0), |slow| (slow, 0.0));
        let phase = random.random::<f64>();
        for i in 0..settings.samples + skip {
            let t = i as f64;
            let wobble = vibration * random.random::<f64>();
            let position = (feed * t + wobble + phase) * step_m;
            let error = (position / step_m).round() * step_m - position;
            let y = section.step(&mut state, error);
            if i >= skip {
                sum += y * y;
            }
        }
        Ok(sum / settings.samples as f64)
    };
    Ok(ForceVariance {
        cutoff_hz,
        motor_n2: side(turning_kg, drive.reflected_damping_n_s_m(), steps.motor_m)?,
        stage_n2: side(drive.movable_mass_kg(), drive.translational_damping_n_s_m(), steps.stage_m)?,
    })
}

/// How to try it out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MonteCarlo {
    /// Rate.
    pub rate: SampleRate,
    /// Samples.
    pub samples: usize,
    /// Seed.
    pub seed: u64,
    /// Feed in steps a sample without vibration; `None`: fast and vibrating.
    pub feed_steps: Option<f64>,
}
