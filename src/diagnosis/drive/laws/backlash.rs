//! Dead zone of the spring: between two positions, of a stage that is held, in front of a slider.

use super::*;
use crate::plant::effects::backlash::{
    FLANK, FORCE, GAP, LOOSE, SPECIFICATION, STIFFNESS, after_backlash, play,
};
use crate::plant::effects::presliding_friction::YIELD;

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| {
        let shapes = match search.signals.layout {
            Layout::TwoPositions => between_positions(search.balance),
            Layout::Locked => gaps(search.balance),
            Layout::OnePosition => plays(search),
        };
        shapes.into_iter().map(|shape| Hypothesis::new(Port::Coupling, shape)).collect()
    },
    stated: |term, _| {
        let gap_m = term.value(&GAP)?;
        if let Some(force_n) = term.value(&FORCE) {
            let yield_m = force_n / term.value(&STIFFNESS)?;
            return Some((Play { gap_m, yield_m }.into(), vec![force_n]));
        }
        let shape = match term.value(&FLANK) {
            Some(flank_m) => Gap { gap_m, flank_m }.into(),
            None => Backlash { gap_m, loose: term.says(&LOOSE) }.into(),
        };
        Some((shape, vec![1.0]))
    },
    ..Effect::of(&SPECIFICATION)
};

fn between_positions(balance: &Balance) -> Vec<Shape> {
    let stretch: Vec<f64> = balance.signals.tracks.iter().map(|t| rms(&t.thin.stretch)).collect();
    let size_m = rms(&stretch);
    let of = |share: f64| [false, true].map(|loose| Backlash { gap_m: share * size_m, loose }.into());
    [0.02, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.0].into_iter().flat_map(of).collect()
}

/// Gaps of a stage that is held, over the travel of the motor.
fn gaps(balance: &Balance) -> Vec<Shape> {
    let [low, high] = balance.signals.travel_m();
    let travel_m = high - low;
    let least = (4.0 * balance.signals.steps_m[0] / travel_m).clamp(0.02, 0.5);
    let of = |share: f64| {
        let gap_m = share * travel_m;
        [0.2, 0.35, 0.5, 0.65, 0.8].map(|part| Gap { gap_m, flank_m: part * (travel_m - gap_m) }.into())
    };
    grid(least, 0.8, 6).flat_map(of).collect()
}

/// Play in front of a slider, where one position is all that there is.
fn plays(search: &Search<'_>) -> Vec<Shape> {
    let travel_m = search.travel_m();
    let least_m = 4.0 * search.signals.steps_m[0].max(1e-3 * travel_m);
    let of = |gap_m: f64| [0.1, 0.5].map(|share| Play { gap_m, yield_m: share * gap_m }.into());
    grid(least_m, 0.3 * travel_m, 6).flat_map(of).collect()
}

/// What a gap takes off the spring, its middle at a stretch.
fn dead_zone(ground: &Ground<'_>, gap_m: f64, middle_m: f64) -> Vec<SpringLaw> {
    let k = ground.mechanics.stiffness_n_m;
    vec![Box::new(move |d, _| k * (after_backlash(d - middle_m, gap_m) - (d - middle_m)))]
}

/// Of two positions. `loose`: of the damper, too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Backlash {
    gap_m: f64,
    loose: bool,
}

impl Law for Backlash {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::Backlash, Size::Dose, &[]);
        Facts { moves_with_numbers: true, ..facts }
    }

    fn write(&self, _: &Told<'_>, term: &mut PhysicsTerm) {
        if self.loose {
            term.push(&LOOSE, ParameterValue::Number(1.0));
        }
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.gap_m, &GAP)]
    }

    /// A dry nut between its flanks has neither spring nor damper.
    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        if !self.loose {
            return at.springs(&self.springs(at.ground));
        }
        let (m, zero) = (&at.ground.mechanics, at.ground.zero_m());
        let stretch = &at.track.stretch_m;
        let d = |i: usize| stretch[i.min(stretch.len() - 1)] + zero;
        let per_m = 0.5 * at.track.rate_hz * m.structural_damping_n_s_m;
        let of = |i: usize| {
            let inside = d(i).abs() < 0.5 * self.gap_m;
            let damper = if inside { per_m * (d(i + 1) - d(i.saturating_sub(1))) } else { 0.0 };
            m.stiffness_n_m * (after_backlash(d(i), self.gap_m) - d(i)) - damper
        };
        vec![(0..stretch.len()).map(of).collect()]
    }

    fn springs(&self, ground: &Ground<'_>) -> Vec<SpringLaw> {
        let (k, zero, gap_m) = (ground.mechanics.stiffness_n_m, ground.zero_m(), self.gap_m);
        vec![Box::new(move |d, _| k * (after_backlash(d + zero, gap_m) - (d + zero)))]
    }

    /// A small part of a wide gap looks like all of a narrow one on the grid.
    fn starts(&self, balance: &Balance) -> Vec<Shape> {
        let of_its_kind =
            |shape: &Shape| matches!(shape, Shape::Backlash(other) if other.loose == self.loose);
        between_positions(balance).into_iter().filter(of_its_kind).collect()
    }

    /// Whether the gap takes the damper, too.
    fn twin(&self) -> Option<Shape> {
        Some(Self { loose: !self.loose, ..*self }.into())
    }

    /// A gap in which the spring is most of the time is no spring, and its Jacobian none.
    fn is_void(&self, ground: &Ground<'_>, _: &[f64]) -> bool {
        let lost = ground.mean_stiffness(&self.springs(ground));
        ground.signals.sides() == 2 && lost.iter().any(|l| -l > 0.5 * ground.mechanics.stiffness_n_m)
    }
}

/// Of a stage that is held, its lower flank that far from the least stretch: a load on the motor hides where
/// the spring is without force.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Gap {
    gap_m: f64,
    flank_m: f64,
}

impl Law for Gap {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::Backlash, Size::Dose, &[]);
        Facts { moves_with_numbers: true, ..facts }
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        sheet.constant(&GAP, self.gap_m, told.relative(0));
        true
    }

    fn write(&self, _: &Told<'_>, term: &mut PhysicsTerm) {
        term.push(&FLANK, ParameterValue::Number(self.flank_m));
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.gap_m, &GAP), Free::of(&mut self.flank_m, &FLANK)]
    }

    fn springs(&self, ground: &Ground<'_>) -> Vec<SpringLaw> {
        let all = ground.signals.tracks.iter().flat_map(|t| &t.stretch_m).copied();
        dead_zone(ground, self.gap_m, all.fold(0.0, f64::min) + self.flank_m + 0.5 * self.gap_m)
    }

    /// A gap's width and place trade with the spring.
    fn starts(&self, balance: &Balance) -> Vec<Shape> {
        gaps(balance)
    }
}

/// A slider of unit friction behind a spring with play: yields after that way, and a gap when it turns.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Play {
    gap_m: f64,
    yield_m: f64,
}

impl Law for Play {
    fn facts(&self) -> Facts {
        let facts = Facts::of(EffectKind::Backlash, Size::Positive, &[]);
        Facts { turns_friction: true, ..facts }
    }

    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        let (force_n, sd_n) = (told.amplitude(0), told.deviation(0));
        sheet.constant(&GAP, self.gap_m, told.relative(0));
        let relative = told.relative(1).hypot(sd_n / force_n.max(1e-300));
        sheet.constant(&STIFFNESS, force_n / self.yield_m, relative);
        sheet.force(&FORCE, force_n, sd_n);
        true
    }

    fn constants(&mut self) -> Vec<Free<'_>> {
        vec![Free::of(&mut self.gap_m, &GAP), Free::of(&mut self.yield_m, &YIELD)]
    }

    fn full(&self, at: &At<'_>) -> Vec<Vec<f64>> {
        vec![play(at.x_m, self.gap_m, self.yield_m)]
    }

    fn rivals(&self) -> &'static [(Over, bool)] {
        &[(Over::Speed, true), (Over::Position, false)]
    }
}
