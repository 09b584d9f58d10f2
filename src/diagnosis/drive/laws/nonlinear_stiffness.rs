//! D^3.

use super::*;
use crate::plant::effects::nonlinear_stiffness::{CUBIC, SPECIFICATION, cubic};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| match search.signals.layout {
        Layout::OnePosition => Vec::new(),
        Layout::TwoPositions | Layout::Locked => vec![Hypothesis::new(Port::Coupling, Cubic)],
    },
    stated: |term, _| Some((Cubic.into(), vec![term.value(&CUBIC)?])),
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cubic;

impl Law for Cubic {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::NonlinearStiffness, Size::Free, &[CUBIC])
    }

    fn springs(&self, ground: &Ground<'_>) -> Vec<SpringLaw> {
        let zero = ground.zero_m();
        vec![Box::new(move |d, _| cubic(d + zero))]
    }
}
