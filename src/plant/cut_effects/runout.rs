//! The bar does not turn on its axis, is not round, or one tool stands ahead.

use super::{AtAngle, CutLaw, Parameter, Place, Role, Specification, Values};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::{EffectKind, Port};

/// The bar does not turn on its axis, is not round, or one tool stands ahead.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Runout {
    /// a: of the width (order 1 and above); of tool 2 ahead (order 0), m.
    pub amplitude_m: f64,
    /// n per turn; 0: tool 2 stands ahead.
    pub order: f64,
    /// phase, rad.
    pub phase_rad: f64,
}

impl CutLaw for Runout {
    const SPECIFICATION: Specification = Specification {
        kind: EffectKind::Runout,
        port: Port::Process,
        parameters: &[
            Parameter {
                name: "amplitude_m",
                unit: "m",
                low: -0.001,
                high: 0.001,
                neutral: 0.0,
                scale: 1e-05,
                role: Role::Key,
            },
            Parameter {
                name: "order",
                unit: "1/rev",
                low: 0.0,
                high: 12.0,
                neutral: f64::NAN,
                scale: 1.0,
                role: Role::Choice,
            },
            Parameter {
                name: "phase_rad",
                unit: "rad",
                low: -12.6,
                high: 12.6,
                neutral: f64::NAN,
                scale: 1.0,
                role: Role::Shape,
            },
        ],
        equivalents: &[],
        statement: "The width of cut changes as the bar turns (eccentric, oval stock), or one tool \
                    stands ahead of the other.",
        equation: "b_j = b + a cos(n psi_j - phase); order 0: u_2 = -y + a",
        mistaken_for: &[EffectKind::StockVariation, EffectKind::ToolDifference],
        told_apart_by: "a second pass over the same surface: what is in the stock is gone, what is in \
                        the chuck stays; order 0: another feed, at which the difference of the mean \
                        forces stays",
    };

    fn from_values([amplitude_m, order, phase_rad]: Values) -> Self {
        Self { amplitude_m, order, phase_rad }
    }

    fn values(&self) -> Values {
        [self.amplitude_m, self.order, self.phase_rad]
    }

    fn enter(&self, _: &Place, terms: &mut CutTerms) {
        if self.order < 0.5 {
            terms.tool2_ahead_m += self.amplitude_m;
        }
    }

    fn modulate(&self, psi_rad: f64, now: &mut AtAngle) {
        if self.order > 0.5 {
            now.width_m += self.amplitude_m * (self.order * psi_rad - self.phase_rad).cos();
        }
    }
}
