//! The natural frequency moves with time.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The natural frequency moves with time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeDrift {
    /// r, Hz/s.
    pub hz_per_s: f64,
}

impl CutLaw for ModeDrift {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::ModeDrift,
        port: Port::Workpiece,
        parameters: &[Parameter {
            name: "hz_per_s",
            unit: "Hz/s",
            low: -100.0,
            high: 100.0,
            neutral: 0.0,
            scale: 2.0,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The natural frequency of the bar moves during the cut.",
        equation: "f_n + r t, t from the start of the recording",
        mistaken_for: &[EffectKind::PositionDependentMode, EffectKind::ContactStiffness],
        told_apart_by: "the same cut early and late in one long recording, tools at the same position",
    };

    fn from_values([hz_per_s, ..]: Values) -> Self {
        Self { hz_per_s }
    }

    fn values(&self) -> Values {
        [self.hz_per_s, 0.0, 0.0]
    }

    fn enter(&self, place: &Place, terms: &mut CutTerms) {
        terms.frequency_shift_hz += self.hz_per_s * place.at.time_s;
    }
}
