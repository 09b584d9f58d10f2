//! The edge ploughs: a force that does not depend on the chip.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The edge ploughs: a force that does not depend on the chip.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EdgeForce {
    /// F_e, per tool at the scenario's width, N.
    pub force_n: f64,
}

impl CutLaw for EdgeForce {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::EdgeForce,
        port: Port::Process,
        parameters: &[Parameter {
            name: "force_n",
            unit: "N",
            low: 0.0,
            high: 10000.0,
            neutral: 0.0,
            scale: 6.0,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The edge ploughs: each tool carries a force that is there whatever the chip.",
        equation: "F_j += (b/b0) F_e",
        mistaken_for: &[EffectKind::NonlinearCuttingForce],
        told_apart_by: "calm cuts at four feeds over a factor of four: the force at no feed is the \
                        edge, the bend is the exponent",
    };

    fn from_values([force_n, ..]: Values) -> Self {
        Self { force_n }
    }

    fn values(&self) -> Values {
        [self.force_n, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.edge_force_n += self.force_n;
    }
}
