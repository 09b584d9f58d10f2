//! The holder of tool 2 gives way.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::{CutTerms, Oscillator};
use crate::plant::effects::{EffectKind, Port};

/// The holder of tool 2 gives way.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurretCompliance {
    /// Its frequency, Hz.
    pub frequency_hz: f64,
    /// Its stiffness, N/m.
    pub n_m: f64,
    /// Its damping.
    pub damping_ratio: f64,
}

impl CutLaw for TurretCompliance {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::TurretCompliance,
        port: Port::Turret,
        parameters: &[
            Parameter {
                name: "frequency_hz",
                unit: "Hz",
                low: 1.0,
                high: 20000.0,
                neutral: f64::NAN,
                scale: 650.0,
                role: Role::Key,
            },
            Parameter {
                name: "n_m",
                unit: "N/m",
                low: 1000.0,
                high: f64::INFINITY,
                neutral: f64::INFINITY,
                scale: 10000000.0,
                role: Role::Size,
            },
            Parameter {
                name: "damping_ratio",
                unit: "",
                low: 0.0001,
                high: 0.9,
                neutral: f64::NAN,
                scale: 0.04,
                role: Role::Shape,
            },
        ],
        equivalents: &[],
        statement: "The holder of tool 2 gives way and has a resonance of its own.",
        equation: "u_2 = -y + w, m w'' + c w' + n_m w = -F_2",
        mistaken_for: &[EffectKind::Runout, EffectKind::ToolDifference, EffectKind::SecondMode],
        told_apart_by: "the same cut at another pitch and at half the width: the peak stands in the \
                        force of tool 2",
    };

    fn from_values([frequency_hz, n_m, damping_ratio]: Values) -> Self {
        Self { frequency_hz, n_m, damping_ratio }
    }

    fn values(&self) -> Values {
        [self.frequency_hz, self.n_m, self.damping_ratio]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.turret = Some(Oscillator {
            frequency_hz: self.frequency_hz,
            damping_ratio: self.damping_ratio,
            stiffness_n_m: self.n_m,
        });
    }
}
