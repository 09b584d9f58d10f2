//! exp(-(v / speed)^2) tanh.

use super::*;
use crate::plant::effects::stribeck_friction::{FORCE, SPECIFICATION, SPEED, stribeck};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let speeds = search.signals.tracks.iter().flat_map(|t| &t.thin.velocity[search.signals.last()]);
        let fastest = speeds.fold(0.0_f64, |m, v| m.max(v.abs()));
        let least = Criteria::STANDARD.turning * search.now.smoothing_m_s;
        let top = (0.3 * fastest).clamp(2.0 * least, 16.0 * least);
        grid(least, top, 6).map(|speed_m_s| Hypothesis::new(Port::Stage, Stribeck { speed_m_s })).collect()
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Stribeck {
    speed_m_s: f64,
}

impl Law for Stribeck {
    fn facts(&self) -> Facts {
        Facts {
            follows: Some(Follows::Speed),
            ..Facts::of(EffectKind::StribeckFriction, Size::Positive, &[FORCE])
        }
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.speed_m_s, &SPEED)]
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        vec![at.of_speed(|v| stribeck(v, self.speed_m_s, at.ground.smoothing_m_s))]
    }

    /// The form in which dry friction turns is no bump.
    fn is_usual(&self, ground: &Ground<'_>, _: f64, _: &[f64]) -> bool {
        self.speed_m_s < Criteria::STANDARD.turning * ground.smoothing_m_s
    }
}
