//! The bar is not equally stiff in two planes, which stand at an angle to the tools.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::{CutTerms, OtherPlane};
use crate::plant::effects::{EffectKind, Port};

/// The bar is not equally stiff in two planes, which stand at an angle to the tools.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SecondPlane {
    /// Frequency in the other plane, Hz.
    pub frequency_hz: f64,
    /// Angle of the stated plane from the tool line, rad.
    pub orientation_rad: f64,
}

impl CutLaw for SecondPlane {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::SecondPlane,
        port: Port::Workpiece,
        parameters: &[
            Parameter {
                name: "frequency_hz",
                unit: "Hz",
                low: 1.0,
                high: 20000.0,
                neutral: f64::NAN,
                scale: 500.0,
                role: Role::Key,
            },
            Parameter {
                name: "orientation_rad",
                unit: "rad",
                low: -6.3,
                high: 6.3,
                neutral: 0.0,
                scale: 0.5,
                role: Role::Size,
            },
        ],
        equivalents: &[],
        statement: "The bar is stiffer in one plane than in the other, and the planes stand at an angle \
                    to the tools.",
        equation: "y = cos a q1 - sin a q2, x = sin a q1 + cos a q2; along x the tangential force acts",
        mistaken_for: &[
            EffectKind::SupportCompliance,
            EffectKind::ForceSensorLag,
            EffectKind::PositionDependentMode,
        ],
        told_apart_by: "the same cut longer and calm: two lines a few per cent apart instead of one",
    };

    fn from_values([frequency_hz, orientation_rad, ..]: Values) -> Self {
        Self { frequency_hz, orientation_rad }
    }

    fn values(&self) -> Values {
        [self.frequency_hz, self.orientation_rad, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.second_plane =
            Some(OtherPlane { frequency_hz: self.frequency_hz, orientation_rad: self.orientation_rad });
    }
}
