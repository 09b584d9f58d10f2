//! The chuck gives way: the bar rocks besides bending.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The chuck gives way: the bar rocks besides bending.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SupportCompliance {
    /// Stiffness of the rocking at the free end, N/m.
    pub n_m: f64,
}

impl CutLaw for SupportCompliance {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::SupportCompliance,
        port: Port::Workpiece,
        parameters: &[Parameter {
            name: "n_m",
            unit: "N/m",
            low: 1000.0,
            high: f64::INFINITY,
            neutral: f64::INFINITY,
            scale: 10000000.0,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The chuck rocks: nearer to it the bar is softer than a clamped one.",
        equation: "shape (1-s) phi + s z/L, s = k/(k + n_m), k the modal stiffness of phi alone; f_n as \
                   stated",
        mistaken_for: &[EffectKind::PositionDependentMode, EffectKind::SecondPlane],
        told_apart_by: "growth at three positions along the bar, the nearest at half its length, or a \
                        tap test there",
    };

    fn from_values([n_m, ..]: Values) -> Self {
        Self { n_m }
    }

    fn values(&self) -> Values {
        [self.n_m, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.support_stiffness_n_m = Some(self.n_m);
    }
}
