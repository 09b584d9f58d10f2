//! The force signal is later and narrower than stated; the cut itself is as it was.

use super::{CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The force signal is later and narrower than stated; the cut itself is as it was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceSensorLag {
    /// Beside the stated delay, s.
    pub extra_delay_s: f64,
    /// Of the signal, Hz; infinite: as stated.
    pub bandwidth_hz: f64,
}

impl CutLaw for ForceSensorLag {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::ForceSensorLag,
        port: Port::ForceSensor,
        parameters: &[
            Parameter {
                name: "extra_delay_s",
                unit: "s",
                low: 0.0,
                high: 0.02,
                neutral: 0.0,
                scale: 0.0002,
                role: Role::Key,
            },
            Parameter {
                name: "bandwidth_hz",
                unit: "Hz",
                low: 1.0,
                high: f64::INFINITY,
                neutral: f64::INFINITY,
                scale: 1500.0,
                role: Role::Shape,
            },
        ],
        equivalents: &[],
        statement: "The force signal is later and narrower than stated; the cut itself is not.",
        equation: "signal(t) = low-pass(F(t - delay - extra_delay)) at bandwidth_hz",
        mistaken_for: &[EffectKind::ForceLag],
        told_apart_by: "a probe on the bar beside the force: the signal lags the motion, the growth is \
                        as foretold",
    };

    fn from_values([extra_delay_s, bandwidth_hz, ..]: Values) -> Self {
        Self { extra_delay_s, bandwidth_hz }
    }

    fn values(&self) -> Values {
        [self.extra_delay_s, self.bandwidth_hz, 0.0]
    }

    fn enter(&self, _: &Place, _: &mut CutTerms) {}
}
