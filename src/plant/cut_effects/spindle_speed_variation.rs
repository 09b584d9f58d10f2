//! The spindle does not turn uniformly.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The spindle does not turn uniformly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpindleSpeedVariation {
    /// e.
    pub relative: f64,
    /// Per turn.
    pub order: f64,
    /// Phase, rad.
    pub phase_rad: f64,
}

impl CutLaw for SpindleSpeedVariation {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::SpindleSpeedVariation,
        port: Port::Spindle,
        parameters: &[
            Parameter {
                name: "relative",
                unit: "",
                low: -0.5,
                high: 0.5,
                neutral: 0.0,
                scale: 0.015,
                role: Role::Key,
            },
            Parameter {
                name: "order",
                unit: "1/rev",
                low: 0.01,
                high: 100.0,
                neutral: f64::NAN,
                scale: 1.0,
                role: Role::Choice,
            },
            Parameter {
                name: "phase_rad",
                unit: "rad",
                low: -12.6,
                high: 12.6,
                neutral: f64::NAN,
                scale: 1.0,
                role: Role::Shape,
            },
        ],
        equivalents: &[],
        statement: "The spindle does not turn uniformly: its speed ripples with the angle.",
        equation: "S (1 + e cos(order angle + phase)), angle that of the commanded speed",
        mistaken_for: &[EffectKind::ContactStiffness, EffectKind::StockVariation],
        told_apart_by: "the spindle turning in air: the ripple of the angle is there without a cut",
    };

    fn from_values([relative, order, phase_rad]: Values) -> Self {
        Self { relative, order, phase_rad }
    }

    fn values(&self) -> Values {
        [self.relative, self.order, self.phase_rad]
    }

    fn enter(&self, _: &Place, _: &mut CutTerms) {}

    fn speed_factor(&self, angle_rad: f64) -> f64 {
        1.0 + self.relative * (self.order * angle_rad + self.phase_rad).cos()
    }
}
