//! v |v|.

use super::*;
use crate::plant::effects::nonlinear_viscosity::{COEFFICIENT, SPECIFICATION, nonlinear_viscosity};

pub(super) const EFFECT: Effect = Effect {
    candidates: |_| vec![Hypothesis::new(Port::Stage, NonlinearViscosity)],
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct NonlinearViscosity;

impl Law for NonlinearViscosity {
    fn facts(&self) -> Facts {
        Facts {
            follows: Some(Follows::Speed),
            ..Facts::of(EffectKind::NonlinearViscosity, Size::Positive, &[COEFFICIENT])
        }
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        vec![at.of_speed(nonlinear_viscosity)]
    }
}
