//! Friction that turns over another speed: a wrong number.

use super::*;
use crate::plant::effects::coulomb_friction::{FORCE, SMOOTHING, SPECIFICATION};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        // Of one position parts in several forms are free, and a way besides: a speed is asked about where
        // one is stated.
        let stated = search.balance.drive.raw().friction_smoothing_m_s.is_some();
        let asked = if search.two || stated { &[0.4, 0.7, 1.4, 2.5][..] } else { &[] };
        let of = |r: &f64| Smoothing { speed_m_s: r * search.now.smoothing_m_s };
        asked.iter().map(|r| Hypothesis::new(Port::Stage, of(r))).collect()
    },
    key: |found, _, raw| {
        match found.port {
            Port::Motor => raw.motor_coulomb_friction_n = found.value(&FORCE),
            _ => raw.stage_coulomb_friction_n = found.value(&FORCE),
        }
        true
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Smoothing {
    pub(crate) speed_m_s: f64,
}

impl Law for Smoothing {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::CoulombFriction, Size::Free, &[]);
        Facts { is_number: true, replaces_friction: true, ..facts }
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.speed_m_s, &SMOOTHING)]
    }

    /// Dry friction of each side: it takes the place of that of the numbers.
    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        let other = Ground { smoothing_m_s: self.speed_m_s, ..*ground };
        Some((0..ground.signals.sides()).map(|side| other.dry(side, None)).collect())
    }

    fn move_number(&self, now: &mut Standing, _: &Balance) -> bool {
        now.smoothing_m_s = self.speed_m_s;
        now.found_smoothing = true;
        true
    }
}
