//! The two tools do not cut alike.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The two tools do not cut alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolDifference {
    /// K_r of tool 2 over that of tool 1.
    pub ratio: f64,
}

impl CutLaw for ToolDifference {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::ToolDifference,
        port: Port::Process,
        parameters: &[Parameter {
            name: "ratio",
            unit: "",
            low: 0.1,
            high: 10.0,
            neutral: 1.0,
            scale: 0.85,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "Tool 2 cuts with another pressure than tool 1.",
        equation: "K_r2 = ratio K_r",
        mistaken_for: &[EffectKind::Runout, EffectKind::TurretCompliance],
        told_apart_by: "calm cuts at three feeds: the difference of the mean forces grows with the feed",
    };

    fn from_values([ratio, ..]: Values) -> Self {
        Self { ratio }
    }

    fn values(&self) -> Values {
        [self.ratio, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.ratio *= self.ratio;
    }
}
