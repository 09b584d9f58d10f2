//! (1 - exp(-t / tau)) tanh.

use super::*;
use crate::plant::effects::coulomb_friction::sliding_direction;
use crate::plant::effects::friction_drift::{CHANGE, SPECIFICATION, TIME, drift};

/// Shortest time constant that is asked about: what is over in half of it is how a recording begins.
fn shortest_s(signals: &Signals) -> f64 {
    0.04 * signals.longest_s()
}

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        grid(shortest_s(search.signals), 0.6 * search.signals.longest_s(), 5)
            .map(|tau_s| Hypothesis::new(Port::Stage, Drift { tau_s }))
            .collect()
    },
    stated: |term, m| {
        let change_n = term.value(&CHANGE)? * m.stage_coulomb_n;
        Some((Drift { tau_s: term.value(&TIME)? }.into(), vec![change_n]))
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Drift {
    tau_s: f64,
}

impl Law for Drift {
    fn facts(&self) -> Facts {
        Facts { follows: Some(Follows::Speed), ..Facts::of(EffectKind::FrictionDrift, Size::Free, &[]) }
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        sheet.add(&CHANGE, told.of_coulomb(told.amplitude(0)), told.of_coulomb(told.deviation(0)));
        sheet.constant(&TIME, self.tau_s, told.relative(0));
        true
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.tau_s, &TIME)]
    }

    fn is_void(&self, ground: &Ground<'_>, _: &[f64]) -> bool {
        self.tau_s < 0.5 * shortest_s(ground.signals)
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        let of = |(k, v): (usize, &f64)| {
            drift(at.track.full_s(k), self.tau_s) * sliding_direction(*v, at.ground.smoothing_m_s)
        };
        vec![at.v_m_s.iter().enumerate().map(of).collect()]
    }
}
