//! Forms of a force against the motion that depends on position and velocity alone; the effects choose them.

use super::asymmetric_friction::asymmetric;
use super::coulomb_friction::sliding_direction;
use super::nonlinear_viscosity::nonlinear_viscosity;
use super::periodic::{knots_at, wave};
use super::stribeck_friction::stribeck;
use super::{PHASE, Parameter, PhysicsTerm, Specification};

/// A force against positive motion that depends on position and velocity alone, N.
#[derive(Debug, Clone, PartialEq)]
pub enum ForceLaw {
    /// F tanh(v / v_s).
    Coulomb {
        /// F, N.
        force_n: f64,
    },
    /// C v.
    Viscous {
        /// C, N s/m.
        n_s_m: f64,
    },
    /// F exp(-(v / v_st)^2) tanh(v / v_s).
    Stribeck {
        /// F, N.
        force_n: f64,
        /// v_st, m/s.
        velocity_m_s: f64,
    },
    /// (d |tanh(v / v_s)| + c |v|) / 2.
    Asymmetric {
        /// d, N.
        difference_n: f64,
        /// c, N s/m.
        viscous_n_s_m: f64,
    },
    /// c v |v|.
    NonlinearViscosity {
        /// c, N s2/m2.
        n_s2_m2: f64,
    },
    /// A load.
    Constant {
        /// N.
        force_n: f64,
    },
    /// Harmonics over position.
    Periodic {
        /// Wavelength of the first harmonic, m.
        wavelength_m: f64,
        /// Sine and cosine amplitude of each harmonic, N.
        harmonics_n: Vec<[f64; 2]>,
        /// True where the force turns with the direction.
        flips: bool,
    },
    /// A table over position, cubic between its knots.
    Map {
        /// Position of the first knot, m.
        first_m: f64,
        /// From knot to knot, m.
        spacing_m: f64,
        /// One force a knot, N.
        force_n: Vec<f64>,
    },
}

impl ForceLaw {
    /// The law that a term states; `None`: not such a force, or a parameter is missing.
    ///
    /// `screw_lead_m` makes a wavelength of an order per revolution.
    #[must_use]
    pub fn of(term: &PhysicsTerm, screw_lead_m: Option<f64>) -> Option<Self> {
        Specification::of(term.effect)?.force?(term, screw_lead_m)
    }

    /// Whether it is a function of the speed alone.
    #[must_use]
    pub fn follows_speed(&self) -> bool {
        match self {
            Self::Coulomb { .. }
            | Self::Viscous { .. }
            | Self::Stribeck { .. }
            | Self::Asymmetric { .. }
            | Self::NonlinearViscosity { .. } => true,
            Self::Constant { .. } | Self::Periodic { .. } | Self::Map { .. } => false,
        }
    }

    /// The force, N. `smoothing_m_s`: v_s of the axis' Coulomb friction.
    #[must_use]
    pub fn force_n(&self, position_m: f64, v: f64, smoothing_m_s: f64) -> f64 {
        match self {
            Self::Coulomb { force_n } => force_n * sliding_direction(v, smoothing_m_s),
            Self::Viscous { n_s_m } => n_s_m * v,
            Self::Stribeck { force_n, velocity_m_s } => force_n * stribeck(v, *velocity_m_s, smoothing_m_s),
            Self::Asymmetric { difference_n, viscous_n_s_m } => {
                difference_n * asymmetric(v, smoothing_m_s) + 0.5 * viscous_n_s_m * v.abs()
            }
            Self::NonlinearViscosity { n_s2_m2 } => n_s2_m2 * nonlinear_viscosity(v),
            Self::Constant { force_n } => *force_n,
            Self::Periodic { wavelength_m, harmonics_n, flips } => {
                let sign = if *flips { sliding_direction(v, smoothing_m_s) } else { 1.0 };
                sign * wave_sum(position_m, *wavelength_m, harmonics_n)
            }
            Self::Map { first_m, spacing_m, force_n } => {
                let (first, parts) = knots_at(position_m, *first_m, *spacing_m, force_n.len());
                force_n[first..].iter().zip(parts).map(|(f, part)| f * part).sum()
            }
        }
    }
}

/// Sine and cosine amplitudes of each harmonic: a list, or one amplitude with its phase.
///
/// An amplitude without a phase says how large a term is, not where: it cannot be evaluated.
pub(super) fn harmonics(
    term: &PhysicsTerm,
    list: &Parameter,
    amplitude: &Parameter,
) -> Option<Vec<[f64; 2]>> {
    if let Some(values) = term.list(list.name) {
        return Some(values.chunks_exact(2).map(|c| [c[0], c[1]]).collect());
    }
    let (a, phase) = (term.value(amplitude)?, term.value(&PHASE)?);
    Some(vec![[a * phase.cos(), a * phase.sin()]])
}

pub(super) fn wave_sum(position_m: f64, period_m: f64, harmonics: &[[f64; 2]]) -> f64 {
    let mut sum = 0.0;
    for (k, [sine, cosine]) in harmonics.iter().enumerate() {
        let (s, c) = wave(position_m, period_m / (k + 1) as f64);
        sum += sine * s + cosine * c;
    }
    sum
}
