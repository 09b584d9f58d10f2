//! A second mode of the bar, of straight shape z/L.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::{CutTerms, Oscillator};
use crate::plant::effects::{EffectKind, Port};

/// A second mode of the bar, of straight shape z/L.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecondMode {
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Its damping.
    pub damping_ratio: f64,
    /// Its modal stiffness at the free end, N/m.
    pub n_m: f64,
}

impl CutLaw for SecondMode {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::SecondMode,
        port: Port::Workpiece,
        parameters: &[
            Parameter {
                name: "frequency_hz",
                unit: "Hz",
                low: 1.0,
                high: 20000.0,
                neutral: f64::NAN,
                scale: 900.0,
                role: Role::Key,
            },
            Parameter {
                name: "damping_ratio",
                unit: "",
                low: 0.0001,
                high: 0.5,
                neutral: f64::NAN,
                scale: 0.02,
                role: Role::Shape,
            },
            Parameter {
                name: "n_m",
                unit: "N/m",
                low: 1000.0,
                high: f64::INFINITY,
                neutral: f64::INFINITY,
                scale: 30000000.0,
                role: Role::Size,
            },
        ],
        equivalents: &[],
        statement: "The bar and its clamp have a second mode that the cut drives too.",
        equation: "m2 w'' + c2 w' + n_m w = (z/L)(F2 - F1), y += (z/L) w",
        mistaken_for: &[EffectKind::SecondPlane, EffectKind::TurretCompliance],
        told_apart_by: "the same cut nearer to the chuck: the second peak falls with (z/L)^2; the force \
                        of tool 1 shows it as much as that of tool 2",
    };

    fn from_values([frequency_hz, damping_ratio, n_m]: Values) -> Self {
        Self { frequency_hz, damping_ratio, n_m }
    }

    fn values(&self) -> Values {
        [self.frequency_hz, self.damping_ratio, self.n_m]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.second_mode = Some(Oscillator {
            frequency_hz: self.frequency_hz,
            damping_ratio: self.damping_ratio,
            stiffness_n_m: self.n_m,
        });
    }
}
