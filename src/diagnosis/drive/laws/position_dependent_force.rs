//! Cubic B-splines over the position, with the direction or without; over speed and way they are no findings,
//! but what one over the position stands beside.

use super::*;
use crate::plant::effects::position_dependent_force::{FIRST, FORCE, SPACING, SPECIFICATION};

/// Splines when it is first asked about, and then.
const PIECES: [usize; 4] = [20, 40, 60, 90];

pub(super) const EFFECT: Effect = Effect {
    candidates: |search| match search.signals.layout {
        Layout::Locked => Vec::new(),
        Layout::TwoPositions | Layout::OnePosition => {
            [false, true].map(|flips| Map::free(Over::Position, flips)).into()
        }
    },
    ..Effect::of(&SPECIFICATION)
};

/// What a map is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Over {
    Position,
    Speed,
    /// Way since the last reversal.
    Way,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Map {
    pub(crate) pieces: usize,
    pub(crate) flips: bool,
    over: Over,
}

impl Map {
    /// Where it is first asked about.
    pub(crate) fn free(over: Over, flips: bool) -> Hypothesis {
        Hypothesis::new(Port::Stage, Self { pieces: PIECES[0], flips, over })
    }

    /// Its splines over what it is a map of: together they are one everywhere.
    fn splines(&self, signals: &Signals) -> Vec<Series> {
        let side = signals.last();
        let abscissa = signals.each(|t| match self.over {
            Over::Position => t.thin.position.clone(),
            Over::Speed => t.thin.velocity[side].iter().map(|v| v.abs()).collect(),
            Over::Way => since_reversal(&t.thin.position, signals.least_way_m(side)),
        });
        let ends = |e: [f64; 2], v: &f64| [e[0].min(*v), e[1].max(*v)];
        let [low, high] = abscissa.iter().flatten().fold([f64::INFINITY, f64::NEG_INFINITY], ends);
        let spacing = (high - low).max(1e-300) / self.pieces as f64;
        let piece = |k: usize, x: &f64| spline((x - low) / spacing - k as f64 + 3.0);
        let series = |k: usize| abscissa.iter().map(|x| x.iter().map(|x| piece(k, x)).collect()).collect();
        (0..self.pieces + 3).map(series).collect()
    }

    /// Mean of each over the recordings.
    pub(crate) fn means(&self, signals: &Signals) -> Vec<f64> {
        self.splines(signals).iter().map(mean).collect()
    }

    /// Its table, two places a piece: first place, spacing, forces.
    fn table(&self, told: &Told<'_>) -> Table {
        let [low, high] = told.balance.signals.travel_m();
        let at = |place: f64| -> f64 {
            let of = |(k, a): (usize, &f64)| a * spline(place - k as f64 + 3.0);
            told.amplitudes.iter().enumerate().map(of).sum()
        };
        Table {
            first_m: low,
            spacing_m: 0.5 * (high - low) / self.pieces as f64,
            force_n: (0..=2 * self.pieces).map(|k| at(0.5 * k as f64 - 1e-9)).collect(),
        }
    }
}

fn mean(series: &Series) -> f64 {
    let count: usize = series.iter().map(Vec::len).sum();
    series.iter().flatten().sum::<f64>() / count.max(1) as f64
}

/// A map as a table.
struct Table {
    first_m: f64,
    spacing_m: f64,
    force_n: Vec<f64>,
}

impl Law for Map {
    fn facts(&self) -> Facts {
        Facts::of(EffectKind::PositionDependentForce, Size::Free, &[])
    }

    fn sizes(&self, _: &Signals) -> Vec<Shape> {
        let others = PIECES.iter().filter(|pieces| **pieces != self.pieces);
        others.map(|pieces| Self { pieces: *pieces, ..*self }.into()).collect()
    }

    /// In strokes that repeat the speed and the way since the axis turned round are functions of position.
    fn told_beside(&self, _: &Signals) -> Vec<Hypothesis> {
        [(Over::Way, true), (Over::Way, false), (Over::Speed, self.flips)]
            .map(|(over, flips)| Self::free(over, flips))
            .to_vec()
    }

    /// Largest force about its mean: the form is kept, its size is what the last fit tells.
    fn tell(&self, told: &Told<'_>, sheet: &mut Sheet) -> bool {
        let relative = |(d, a): (&f64, &f64)| d / a.abs().max(1e-300);
        let pairs = told.deviations.amplitudes.iter().zip(told.amplitudes);
        let most = pairs.map(relative).fold(0.0, f64::max);
        let knots = self.table(told).force_n;
        let mean = knots.iter().sum::<f64>() / knots.len().max(1) as f64;
        let peak_n = knots.iter().map(|f| (f - mean).abs()).fold(0.0, f64::max);
        sheet.force(&AMPLITUDE_N, peak_n, most * peak_n);
        true
    }

    fn write(&self, told: &Told<'_>, term: &mut PhysicsTerm) {
        let table = self.table(told);
        term.push(&FORCE, ParameterValue::List(table.force_n));
        term.push(&FIRST, ParameterValue::Number(table.first_m));
        term.push(&SPACING, ParameterValue::Number(table.spacing_m));
        if self.flips {
            term.push(&WITH_DIRECTION, ParameterValue::Number(1.0));
        }
    }

    /// Splines over the travel. Those of a friction are each about its mean: the level of the friction is a
    /// number of its own.
    fn columns(&self, ground: &Ground<'_>, _: Port) -> Option<Vec<TimeColumn>> {
        let signals = ground.signals;
        let side = signals.last();
        // The direction as the friction of the balance has it; a spline is slow beside it.
        let dry = self.flips.then(|| ground.dry(side, None).sides[side].take()).flatten();
        let of = |piece: Series| {
            let Some(dry) = &dry else { return TimeColumn::at(side, piece) };
            let mean = mean(&piece);
            let about =
                |(x, dry): (&Vec<f64>, &Vec<f64>)| x.iter().zip(dry).map(|(x, d)| (x - mean) * d).collect();
            TimeColumn::at(side, piece.iter().zip(dry).map(about).collect())
        };
        Some(self.splines(signals).into_iter().map(of).collect())
    }

    fn rivals(&self) -> &'static [(Over, bool)] {
        match self.flips {
            true => &[(Over::Speed, true), (Over::Way, true)],
            false => &[(Over::Speed, false), (Over::Way, false)],
        }
    }

    /// A force over the place that is twice what ever drove the axis stands where nothing was measured.
    /// Splines at either end are hardly seen.
    fn is_void(&self, ground: &Ground<'_>, amplitudes: &[f64]) -> bool {
        let s = ground.signals;
        let thrust = s.tracks.iter().flat_map(|track| s.thrust(track, ground.path));
        let most_n = thrust.fold(0.0, |most: f64, f| most.max(f.abs()));
        let inner = amplitudes.get(3..amplitudes.len().saturating_sub(3)).unwrap_or_default();
        inner.iter().any(|a| a.abs() > 2.0 * most_n)
    }

    fn is_usual(&self, _: &Ground<'_>, dry_n: f64, amplitudes: &[f64]) -> bool {
        rms(amplitudes) < Criteria::STANDARD.texture * dry_n
    }
}

/// Way since the axis last turned round; a way back of no more than `turned` is none.
fn since_reversal(x: &[f64], turned: f64) -> Vec<f64> {
    let (mut from, mut end, mut sign) = (x.first().copied().unwrap_or(0.0), 0.0, 0.0_f64);
    let mut out = Vec::with_capacity(x.len());
    for v in x {
        let way = v - from;
        if sign == 0.0 && way.abs() > turned {
            (sign, end) = (way.signum(), *v);
        }
        if sign != 0.0 {
            if sign * (v - end) > 0.0 {
                end = *v;
            } else if sign * (end - v) > turned {
                (from, end, sign) = (end, *v, -sign);
            }
        }
        out.push((v - from).abs());
    }
    out
}

/// Uniform cubic B-spline on [0, 4].
fn spline(t: f64) -> f64 {
    match t {
        t if (0.0..1.0).contains(&t) => t * t * t / 6.0,
        t if (1.0..2.0).contains(&t) => {
            let u = t - 1.0;
            (1.0 + 3.0 * u + 3.0 * u * u - 3.0 * u * u * u) / 6.0
        }
        t if (2.0..3.0).contains(&t) => {
            let u = t - 2.0;
            (4.0 - 6.0 * u * u + 3.0 * u * u * u) / 6.0
        }
        t if (3.0..4.0).contains(&t) => (4.0 - t).powi(3) / 6.0,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splines_add_to_one() {
        for k in 0..100 {
            let t = 3.0 + 0.01 * f64::from(k);
            let sum: f64 = (0..7).map(|j| spline(t - f64::from(j))).sum();
            assert!((sum - 1.0).abs() < 1e-12, "{t} {sum}");
        }
    }
}
