//! The natural frequency depends on where the tools stand.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The natural frequency depends on where the tools stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PositionDependentMode {
    /// r, Hz/m.
    pub hz_per_m: f64,
}

impl CutLaw for PositionDependentMode {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::PositionDependentMode,
        port: Port::Workpiece,
        parameters: &[Parameter {
            name: "hz_per_m",
            unit: "Hz/m",
            low: -20000.0,
            high: 20000.0,
            neutral: 0.0,
            scale: 200.0,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The natural frequency depends on the position of the tools: stock is removed, or a \
                    steady rest holds.",
        equation: "f_n + r (z - z0), z0 the position of the scenario",
        mistaken_for: &[EffectKind::SupportCompliance, EffectKind::ModeDrift],
        told_apart_by: "growth and lines at three positions in another order of time, or a tap test at two",
    };

    fn from_values([hz_per_m, ..]: Values) -> Self {
        Self { hz_per_m }
    }

    fn values(&self) -> Values {
        [self.hz_per_m, 0.0, 0.0]
    }

    fn enter(&self, place: &Place, terms: &mut CutTerms) {
        terms.frequency_shift_hz += self.hz_per_m * (place.at.position_m - place.reference.position_m);
    }
}
