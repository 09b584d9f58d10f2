//! Dahl's bristle over its yield length, and its rate.

use super::*;
use crate::plant::effects::presliding_friction as law;
use std::f64::consts::LN_2;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let least_m = search.signals.least_way_m(search.signals.last());
        let (most_m, count) = match search.signals.layout {
            // Of what is held friction's bristle is in the train, and no softer.
            Layout::Locked => (search.coulomb_n / search.now.mechanics.stiffness_n_m, 6),
            Layout::OnePosition => (0.25 * search.travel_m(), 10),
            Layout::TwoPositions => (128.0 * least_m, 8),
        };
        grid(least_m, most_m.max(2.0 * least_m), count)
            .map(|yield_m| Hypothesis::new(Port::Stage, Presliding { yield_m }))
            .collect()
    },
    stated: |term, m| {
        let total_n = m.stage_coulomb_n;
        let yield_m = total_n / term.value(&law::STIFFNESS)?;
        let force_n = term.value(&law::SHARE).unwrap_or(1.0) * total_n;
        Some((Presliding { yield_m }.into(), vec![force_n, term.value(&law::RATE).unwrap_or(0.0)]))
    },
    ..Effect::of(&law::SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Presliding {
    yield_m: f64,
}

impl Law for Presliding {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::PreslidingFriction, Size::Positive, &[]);
        Facts { turns_friction: true, is_dry_friction: true, follows: Some(Follows::Way), ..facts }
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        let stiffness_n_m = told.coulomb_n / self.yield_m;
        sheet.constant(&law::STIFFNESS, stiffness_n_m, told.relative(0).hypot(sheet.scale));
        sheet.add(&law::SHARE, told.of_coulomb(told.amplitude(0)), told.of_coulomb(told.deviation(0)));
        true
    }

    fn write(&self, told: &Told<'_>, term: &mut PhysicsTerm) {
        term.push(&law::RATE, ParameterValue::Number(told.amplitude(1)));
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.yield_m, &law::YIELD)]
    }

    /// The bristle of unit force, and its rate times a second of the speed at which it is half yielded.
    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        let law = law::Presliding { stiffness_n_m: 1.0 / self.yield_m, coulomb_n: 1.0 };
        let rate_hz = at.track.rate_hz;
        let dt = 1.0 / rate_hz;
        let (mut z, mut last, mut out) = (0.0, 0.0, Vec::with_capacity(at.v_m_s.len()));
        for v in at.v_m_s {
            // The speed between two samples: that at either end would make it half a sample early or late.
            z = law.step(z, 0.5 * (last + v), dt);
            last = *v;
            out.push(z);
        }
        let rate =
            out.iter().enumerate().map(|(k, z)| (z - out[k.saturating_sub(1)]) * rate_hz * 1e-3).collect();
        vec![out, rate]
    }

    fn rivals(&self) -> &'static [(Over, bool)] {
        &[(Over::Speed, true)]
    }

    /// After a reversal the bristle pulls neither way at y ln 2, the usual form at the least way.
    fn is_usual(&self, ground: &Ground<'_>, _: f64, _: &[f64]) -> bool {
        self.yield_m * LN_2 < ground.signals.least_way_m(ground.signals.last())
    }
}
