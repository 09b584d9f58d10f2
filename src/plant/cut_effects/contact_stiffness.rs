//! The contact of edge and work is a spring without memory.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The contact of edge and work is a spring without memory.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactStiffness {
    /// k_c, per tool at the scenario's width, N/m.
    pub n_m: f64,
}

impl CutLaw for ContactStiffness {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::ContactStiffness,
        port: Port::Process,
        parameters: &[Parameter {
            name: "n_m",
            unit: "N/m",
            low: 0.0,
            high: 1000000000.0,
            neutral: 0.0,
            scale: 100000.0,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The contact of edge and work is a spring: force in proportion to the motion, \
                    without delay.",
        equation: "F_j += (b/b0) k_c u_j",
        mistaken_for: &[
            EffectKind::ModeDrift,
            EffectKind::PositionDependentMode,
            EffectKind::SupportCompliance,
        ],
        told_apart_by: "the same calm cut at half the width: the lines fall together",
    };

    fn from_values([n_m, ..]: Values) -> Self {
        Self { n_m }
    }

    fn values(&self) -> Values {
        [self.n_m, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.contact_stiffness_n_m += self.n_m;
    }
}
