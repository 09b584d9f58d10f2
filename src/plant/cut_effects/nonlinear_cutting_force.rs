//! The force grows with a power of the chip (size effect, Kienzle).

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The force grows with a power of the chip (size effect, Kienzle).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NonlinearCuttingForce {
    /// p; 1 is in proportion.
    pub exponent: f64,
}

impl CutLaw for NonlinearCuttingForce {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::NonlinearCuttingForce,
        port: Port::Process,
        parameters: &[Parameter {
            name: "exponent",
            unit: "",
            low: 0.2,
            high: 2.0,
            neutral: 1.0,
            scale: 0.75,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The cutting force grows with a power of the chip thickness.",
        equation: "F = K_r b h_r (h/h_r)^p, h_r = half the feed of the scenario",
        mistaken_for: &[EffectKind::EdgeForce],
        told_apart_by: "calm cuts at four feeds over a factor of four, and growth at two of them: the \
                        exponent moves growth, the edge does not",
    };

    fn from_values([exponent, ..]: Values) -> Self {
        Self { exponent }
    }

    fn values(&self) -> Values {
        [self.exponent, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.exponent = self.exponent;
    }
}
