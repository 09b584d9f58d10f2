//! Regeneration as a finding: a static model whose chip has no memory is given one.

use super::{CutLaw, Equivalent, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The chip remembers what was cut a turn, or half a turn, before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RegenerativeEffect {
    /// Share of the past motion that the chip sees, 1 for the whole.
    pub overlap: f64,
}

impl CutLaw for RegenerativeEffect {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::RegenerativeEffect,
        port: Port::Process,
        parameters: &[Parameter {
            name: "overlap",
            unit: "",
            low: 0.0,
            high: 2.0,
            neutral: 0.0,
            scale: 1.0,
            role: Role::Key,
        }],
        equivalents: &[
            Equivalent {
                name: "cutting_stiffness_n_m",
                unit: "N/m",
                from_key: |overlap, reference| overlap * reference.cutting_stiffness_n_m,
                to_key: Some(|stiffness, reference| stiffness / reference.cutting_stiffness_n_m),
            },
            Equivalent {
                name: "delay_s",
                unit: "s",
                from_key: |_, reference| reference.mean_delay_s,
                to_key: None,
            },
        ],
        statement: "Each tool cuts the waves that were left before it: the chip remembers the past \
                    motion of the bar.",
        equation: "h = f theta/2pi + u - overlap u_other(t - tau)",
        mistaken_for: &[EffectKind::ForceLag, EffectKind::SecondMode],
        told_apart_by: "the same cut at another speed: lines a spindle frequency apart move with it",
    };

    fn from_values([overlap, ..]: Values) -> Self {
        Self { overlap }
    }

    fn values(&self) -> Values {
        [self.overlap, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.overlap = self.overlap;
    }
}
