//! The force follows its law late.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The force follows its law late.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceLag {
    /// Of a first-order lag, s.
    pub time_constant_s: f64,
}

impl CutLaw for ForceLag {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::ForceLag,
        port: Port::Process,
        parameters: &[Parameter {
            name: "time_constant_s",
            unit: "s",
            low: 0.0,
            high: 0.005,
            neutral: 0.0,
            scale: 5e-05,
            role: Role::Key,
        }],
        equivalents: &[],
        statement: "The cutting force follows the chip with a lag of first order.",
        equation: "tau F' + F = law(h, u')",
        mistaken_for: &[EffectKind::ForceSensorLag, EffectKind::ProcessDamping, EffectKind::SecondPlane],
        told_apart_by: "a probe on the bar, or loud cuts at two speeds: the lag does not depend on the \
                        speed",
    };

    fn from_values([time_constant_s, ..]: Values) -> Self {
        Self { time_constant_s }
    }

    fn values(&self) -> Values {
        [self.time_constant_s, 0.0, 0.0]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        terms.force_lag_s += self.time_constant_s;
    }
}
