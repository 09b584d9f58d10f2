//! The cutting pressure grows with the time that the edges cut.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The cutting pressure grows with the time that the edges cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolWear {
    /// r, 1/s.
    pub relative_per_s: f64,
}

impl CutLaw for ToolWear {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::ToolWear,
        port: Port::Process,
        parameters: &[Parameter {
            name: "relative_per_s",
            unit: "1/s",
            low: -0.1,
            high: 1.0,
            neutral: 0.0,
            scale: 0.015,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The edges wear: the cutting pressure grows with time.",
        equation: "K_r (1 + r t), both tools",
        mistaken_for: &[EffectKind::NoseRadius, EffectKind::SpeedDependentForce, EffectKind::SecondPlane],
        told_apart_by: "the first cut once more at the end: the same condition, another force",
    };

    fn from_values([relative_per_s, ..]: Values) -> Self {
        Self { relative_per_s }
    }

    fn values(&self) -> Values {
        [self.relative_per_s, 0.0, 0.0]
    }

    fn enter(&self, place: &Place, terms: &mut CutTerms) {
        terms.pressure_factor *= (1.0 + self.relative_per_s * place.at.edge_age_s).max(0.0);
    }
}
