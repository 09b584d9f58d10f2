//! The natural frequency depends on the speed of the spindle.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The natural frequency depends on the speed of the spindle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpeedDependentDynamics {
    /// r, Hz per rpm.
    pub hz_per_rpm: f64,
}

impl CutLaw for SpeedDependentDynamics {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::SpeedDependentDynamics,
        port: Port::Workpiece,
        parameters: &[Parameter {
            name: "hz_per_rpm",
            unit: "Hz/rpm",
            low: -2.0,
            high: 2.0,
            neutral: 0.0,
            scale: 0.03,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The natural frequency depends on the spindle speed: the chuck or the bearings \
                    stiffen or soften.",
        equation: "f_n + r (S - S0), S0 the speed of the scenario",
        mistaken_for: &[EffectKind::SecondPlane, EffectKind::ModeDrift],
        told_apart_by: "calm cuts at four speeds with the same pitch",
    };

    fn from_values([hz_per_rpm, ..]: Values) -> Self {
        Self { hz_per_rpm }
    }

    fn values(&self) -> Values {
        [self.hz_per_rpm, 0.0, 0.0]
    }

    fn enter(&self, place: &Place, terms: &mut CutTerms) {
        terms.frequency_shift_hz += self.hz_per_rpm * (place.at.speed_rpm - place.reference.speed_rpm);
    }
}
