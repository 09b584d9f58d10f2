//! |tanh| / 2, and |v| / 2 beside it.

use super::*;
use crate::plant::effects::asymmetric_friction::{DRY, SPECIFICATION, VISCOUS, asymmetric};

pub(super) const EFFECT: Effect = Effect {
    candidates: |_| [false, true].map(|viscous| Hypothesis::new(Port::Stage, Asymmetric { viscous })).into(),
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Asymmetric {
    /// Viscous friction differs as well.
    viscous: bool,
}

impl Law for Asymmetric {
    fn facts(&self) -> Facts {
        let amplitudes = if self.viscous { &[DRY, VISCOUS][..] } else { &[DRY] };
        Facts {
            follows: Some(Follows::Speed),
            ..Facts::of(EffectKind::AsymmetricFriction, Size::Free, amplitudes)
        }
    }

    /// Friction resists both ways: no difference is more than twice its level.
    fn is_void(&self, ground: &Ground<'_>, amplitudes: &[f64]) -> bool {
        amplitudes.first().is_some_and(|d| d.abs() > 2.0 * ground.mechanics.stage_coulomb_n)
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        let dry = at.of_speed(|v| asymmetric(v, at.ground.smoothing_m_s));
        let viscous = self.viscous.then(|| at.of_speed(|v| 0.5 * v.abs()));
        std::iter::once(dry).chain(viscous).collect()
    }
}
