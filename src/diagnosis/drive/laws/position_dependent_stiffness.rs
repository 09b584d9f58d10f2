//! D x, a stiffness that changes evenly over the travel, and D sin, cos of x over a length.

use super::*;
use crate::plant::effects::position_dependent_stiffness::{LENGTH, SPECIFICATION, VARIATION};
use std::f64::consts::TAU;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        if !search.two {
            return Vec::new();
        }
        let wave = |lengths: f64| StiffnessWave { length_m: lengths * search.travel_m() };
        let waves = [1.0, 1.5, 2.5, 4.0, 7.0].map(|l| Hypothesis::new(Port::Coupling, wave(l)));
        std::iter::once(Hypothesis::new(Port::Coupling, StiffnessSlope)).chain(waves).collect()
    },
    stated: |term, _| {
        let (r, length_m) = (term.value(&VARIATION)?, term.value(&LENGTH)?);
        Some(match term.value(&PHASE) {
            Some(p) => (StiffnessWave { length_m }.into(), vec![r * p.cos(), r * p.sin()]),
            None => (StiffnessSlope.into(), vec![r / length_m]),
        })
    },
    ..Effect::of(&SPECIFICATION)
};

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StiffnessSlope;

impl Law for StiffnessSlope {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::PositionDependentStiffness, Size::Free, &[])
    }

    /// Over the travel, which is what the recordings saw.
    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        let [low, high] = told.balance.signals.travel_m();
        sheet.add(&VARIATION, told.amplitude(0) * (high - low), told.deviation(0) * (high - low));
        sheet.add(&LENGTH, high - low, 0.0);
        true
    }

    fn springs(&self, ground: &Ground<'_>) -> Vec<SpringLaw> {
        let (k, zero) = (ground.mechanics.stiffness_n_m, ground.zero_m());
        vec![Box::new(move |d, x| k * (d + zero) * x)]
    }
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct StiffnessWave {
    length_m: f64,
}

impl Law for StiffnessWave {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::PositionDependentStiffness, Size::Free, &[])
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        sheet.wave((&VARIATION, 0.0), told);
        sheet.constant(&LENGTH, self.length_m, told.relative(0));
        true
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.length_m, &LENGTH)]
    }

    /// Of a wave that may be longer than the travel the slope.
    fn limit(&self, signals: &Signals, deviations: &[f64]) -> Option<Shape> {
        let [low, high] = signals.travel_m();
        let longest_m = self.length_m * deviations.first().map_or(1.0, |d| (Z95 * d).exp());
        (longest_m > high - low).then_some(StiffnessSlope.into())
    }

    fn springs(&self, ground: &Ground<'_>) -> Vec<SpringLaw> {
        let (k, zero, length_m) = (ground.mechanics.stiffness_n_m, ground.zero_m(), self.length_m);
        [f64::sin, f64::cos]
            .map(|f| Box::new(move |d, x| k * (d + zero) * f(TAU * x / length_m)) as SpringLaw)
            .into()
    }
}
