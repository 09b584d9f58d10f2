//! What may be chosen about an estimator, and the low-pass behind it.

use super::guideway::GuidewayTravel;
use super::harmonic_settings::HarmonicSettings;
use super::idle_map::IdleMap;
use super::physics::PhysicsModel;
use crate::plant::drive::DriveParams;
use crate::plant::machine::Controller;
use crate::signal::FilterError;
use crate::signal::butterworth::Butterworth;
use crate::signal::harmonic_fit::HarmonicFitError;
use crate::signal::linear_phase::LinearPhase;
use crate::signal::notch::Notch;
use crate::units::SampleRate;
use thiserror::Error;

/// The low-pass behind the force balance, Q(s) of the observer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LowPass {
    /// Butterworth: short delay that varies with frequency.
    Butterworth {
        /// Order, 1 to 12.
        order: usize,
        /// Half-power frequency.
        cutoff_hz: f64,
    },
    /// FIR with the same delay at every frequency, a whole number of samples.
    LinearPhase {
        /// Flat to here.
        pass_hz: f64,
        /// Dark (-70 dB) this much above.
        width_hz: f64,
    },
    /// None: the bare balance.
    None,
}

/// Where a notch behind the balance sits; it is 10 Hz wide at half power.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum NotchCentre {
    /// Fixed: a torsional mode that the model does not have.
    Fixed {
        /// Hz.
        hz: f64,
    },
    /// At feed over the signal period of the motor encoder.
    MotorEncoder,
    /// At feed over the signal period of the linear scale.
    StageEncoder,
}

impl NotchCentre {
    /// `motor_encoder` or `stage_encoder` (the notch follows feed over signal period), or a frequency in Hz
    /// (a torsional mode). `None`: neither.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "motor_encoder" => Self::MotorEncoder,
            "stage_encoder" => Self::StageEncoder,
            number => Self::Fixed { hz: number.parse().ok().filter(|hz: &f64| hz.is_finite() && *hz > 0.0)? },
        })
    }
}

/// Most notches of one estimator.
pub const MAX_NOTCHES: usize = 4;

/// What may be chosen about an estimator.
#[derive(Debug, Clone, PartialEq)]
pub struct ForceSettings {
    /// Low-pass behind the balance.
    pub low_pass: LowPass,
    /// Disturbance of air-cutting runs by position, taken off where it is given.
    pub idle_map: Option<IdleMap>,
    /// Physics beyond the structure, taken off; see [`super::physics::physics_of`].
    pub physics: Option<PhysicsModel>,
    /// Travel over which the guideway's friction turns.
    pub guideway: GuidewayTravel,
    /// Notches behind the balance, at most [`MAX_NOTCHES`].
    pub notches: Vec<NotchCentre>,
    /// Spindle speed and window; needed by `fitted` and `spectral`.
    pub harmonic: Option<HarmonicSettings>,
    /// Control loop of the axis; needed by `spectral`.
    pub controller: Option<Controller>,
    /// Frequencies of modes that the model does not have, where they are known, Hz.
    pub unmodelled_modes_hz: Vec<f64>,
    /// Low-pass on thrust reference and rotary encoder; the stage's side waits for it.
    pub drive_filter: Option<Butterworth>,
    /// The axial stiffness is learned while the axis cuts (`vibration_mode` of two inertias with both
    /// encoders; the others have no use for it).
    pub learn_stiffness: bool,
    /// The force in the coupling known from both sides is compared; see `two_sides`.
    pub compare_sides: bool,
}

impl ForceSettings {
    /// Friction that can hide a force on an axis that stands still, N.
    pub(super) fn friction_bound_n(&self, drive: &DriveParams) -> f64 {
        drive.motor_coulomb_friction_n()
            + drive.stage_coulomb_friction_n()
            + self.physics.as_ref().map_or(0.0, PhysicsModel::coulomb_n)
    }

    /// The notch of all centres, where there are any.
    pub(super) fn notch(&self, rate: SampleRate) -> Result<Option<Notch>, ForceError> {
        match self.notches.len() {
            0 => Ok(None),
            count if count > MAX_NOTCHES => Err(ForceError::Notches { count }),
            _ => Ok(Some(Notch::new(10.0, rate)?)),
        }
    }
}

impl Default for ForceSettings {
    /// Fourth-order Butterworth at 1 kHz (thesis 4.3 and 6.4), no idle map.
    fn default() -> Self {
        Self {
            low_pass: LowPass::Butterworth { order: 4, cutoff_hz: 1000.0 },
            idle_map: None,
            physics: None,
            guideway: GuidewayTravel::default(),
            notches: Vec::new(),
            harmonic: None,
            controller: None,
            unmodelled_modes_hz: Vec::new(),
            drive_filter: None,
            learn_stiffness: false,
            compare_sides: true,
        }
    }
}

/// Why an estimator cannot be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ForceError {
    /// A filter cannot be designed.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// More notches than a state holds.
    #[error("{count} notches, expected at most {MAX_NOTCHES}")]
    Notches {
        /// How many were asked for.
        count: usize,
    },
    /// An estimator of accelerometers does not fit.
    #[error(transparent)]
    Accelerometers(#[from] super::frf::FrfError),
    /// A window of spindle harmonics cannot be fitted.
    #[error(transparent)]
    Window(#[from] HarmonicFitError),
    /// The method needs a structure that the drive does not have.
    #[error("{method} needs {needs}; there is none")]
    Structure {
        /// Method.
        method: &'static str,
        /// What is missing.
        needs: &'static str,
    },
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Filter {
    Butterworth(Butterworth),
    LinearPhase(LinearPhase),
    None,
}

impl Filter {
    pub(super) fn new(low_pass: LowPass, rate: SampleRate) -> Result<Self, FilterError> {
        Ok(match low_pass {
            LowPass::Butterworth { order, cutoff_hz } => {
                Filter::Butterworth(Butterworth::low_pass(order, cutoff_hz, rate)?)
            }
            LowPass::LinearPhase { pass_hz, width_hz } => {
                Filter::LinearPhase(LinearPhase::low_pass(pass_hz, width_hz, rate)?)
            }
            LowPass::None => Filter::None,
        })
    }

    /// Sum of the squares of what comes out for a short input.
    pub(super) fn energy(&self, input: &[f64], rate: SampleRate) -> f64 {
        match self {
            Filter::LinearPhase(f) => f.energy(input),
            Filter::None => input.iter().map(|x| x * x).sum(),
            Filter::Butterworth(f) => response_to(input, *f, rate).into_iter().map(|x| x * x).sum(),
        }
    }

    /// Gain at a frequency.
    pub(super) fn gain(&self, frequency_hz: f64, rate: SampleRate) -> f64 {
        match self {
            Filter::Butterworth(f) => {
                let (re, im) = f.response(frequency_hz);
                re.hypot(im)
            }
            Filter::LinearPhase(f) => f.gain(frequency_hz, rate),
            Filter::None => 1.0,
        }
    }

    pub(super) fn delay_s(&self, rate: SampleRate) -> f64 {
        match self {
            Filter::Butterworth(f) => f.slow_delay_s(),
            Filter::LinearPhase(f) => f.half_length() as f64 * rate.period_s(),
            Filter::None => 0.0,
        }
    }

    pub(super) fn band_hz(&self, low_pass: LowPass, rate: SampleRate) -> f64 {
        match low_pass {
            LowPass::Butterworth { cutoff_hz, .. } => cutoff_hz,
            LowPass::LinearPhase { pass_hz, .. } => pass_hz,
            // Above a tenth of the rate the stencils' error passes 0.1 %.
            LowPass::None => rate.hz() / 10.0,
        }
    }

    /// Samples until a step has settled to about a thousandth.
    pub(super) fn memory_samples(&self, rate: SampleRate) -> usize {
        match self {
            Filter::Butterworth(f) => (8.0 * f.slow_delay_s() * rate.hz()).ceil() as usize + 8,
            Filter::LinearPhase(f) => 2 * f.half_length() + 1,
            Filter::None => 0,
        }
    }
}

/// What comes out of a low-pass for a short input, until a step has settled to about a thousandth.
pub(super) fn response_to(input: &[f64], low_pass: Butterworth, rate: SampleRate) -> Vec<f64> {
    let mut state = low_pass.settled(0.0);
    let length = input.len() + 4 * Filter::Butterworth(low_pass).memory_samples(rate);
    (0..length).map(|i| low_pass.step(&mut state, input.get(i).copied().unwrap_or(0.0))).collect()
}
