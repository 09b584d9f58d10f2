//! Thrust lost, z / (1 + (1 - a) z) of it with z = b i^2: a is 0 for K / (1 + z), 1 for K (1 - z).

use super::*;
use crate::plant::effects::torque_constant_saturation::{PARABOLIC, PER_A2, SPECIFICATION, lost_share};

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let tracks = &search.signals.tracks;
        if !search.has_command || !tracks.iter().all(|t| t.reference.is_current) {
            return Vec::new();
        }
        let most = most_a(search.signals);
        let of = |bent: f64| {
            let per_a2 = bent / (most * most);
            [0.0, 1.0].map(|parabolic| Hypothesis::new(Port::Current, Saturation { per_a2, parabolic }))
        };
        [0.02, 0.07, 0.25, 0.8].into_iter().flat_map(of).collect()
    },
    stated: |term, _| {
        let parabolic = term.value(&PARABOLIC).unwrap_or(0.0);
        Some((Saturation { per_a2: term.value(&PER_A2)?, parabolic }.into(), vec![1.0]))
    },
    ..Effect::of(&SPECIFICATION)
};

/// Largest current that is commanded, A.
fn most_a(signals: &Signals) -> f64 {
    let amperes = |t: &Track| {
        t.reference.reference_n.iter().fold(0.0_f64, |m, f| m.max((f / t.reference.per_unit).abs()))
    };
    signals.tracks.iter().map(amperes).fold(1e-9, f64::max)
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Saturation {
    per_a2: f64,
    parabolic: f64,
}

impl Law for Saturation {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::TorqueConstantSaturation, Size::Whole, &[])
    }

    fn write(&self, _: &Told<'_>, term: &mut PhysicsTerm) {
        if self.parabolic != 0.0 {
            term.push(&PARABOLIC, ParameterValue::Number(self.parabolic));
        }
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.per_a2, &PER_A2)]
    }

    /// A thrust that turns over is none of a motor.
    fn is_void(&self, ground: &Ground<'_>, _: &[f64]) -> bool {
        lost_share(self.per_a2 * most_a(ground.signals).powi(2), self.parabolic) >= 1.0
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        let thrust = at.ground.signals.thrust_full(at.track, at.ground.path);
        let per_unit = at.track.reference.per_unit;
        let lost = |f: &f64| f * lost_share(self.per_a2 * (f / per_unit).powi(2), self.parabolic);
        vec![thrust.iter().map(lost).collect()]
    }
}
