//! The cutting pressure falls with the surface speed.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The cutting pressure falls with the surface speed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedDependentForce {
    /// q.
    pub exponent: f64,
}

impl CutLaw for SpeedDependentForce {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::SpeedDependentForce,
        port: Port::Process,
        parameters: &[Parameter {
            name: "exponent",
            unit: "",
            low: -1.0,
            high: 2.0,
            neutral: 0.0,
            scale: 0.2,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The cutting pressure changes with the surface speed.",
        equation: "K_r (v/v0)^-q, v0 at the speed of the scenario",
        mistaken_for: &[EffectKind::SecondPlane, EffectKind::ToolWear],
        told_apart_by: "calm cuts at three speeds in no order of time: the mean force follows the \
                        speed, not the time",
    };

    fn from_values([exponent, ..]: Values) -> Self {
        Self { exponent }
    }

    fn values(&self) -> Values {
        [self.exponent, 0.0, 0.0]
    }

    fn enter(&self, place: &Place, terms: &mut CutTerms) {
        let speed = place.at.surface_speed_m_s() / place.reference.surface_speed_m_s;
        terms.pressure_factor *= speed.powf(-self.exponent);
    }
}
