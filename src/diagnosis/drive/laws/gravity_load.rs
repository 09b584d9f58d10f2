//! 1.

use super::*;
use crate::plant::effects::gravity_load::{FORCE, SPECIFICATION};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| match search.signals.spindle_hz() {
        // Beside a spindle that turns a load and the mean force of a cut are one.
        Some(_) => Vec::new(),
        None => vec![Hypothesis::new(Port::Stage, Gravity)],
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Gravity;

impl Law for Gravity {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::GravityLoad, Size::Free, &[FORCE])
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        vec![vec![1.0; at.v_m_s.len()]]
    }
}
