//! The one statistic of a hypothesis: the worst of its gain, of that where the axis is heard, of the held-out
//! quarters and of the held-out recordings; and what chance reaches in the same recordings.

use super::columns::TimeColumn;
use super::gram::{BandGram, Gram, Part};
use super::laws::Hypothesis;
use super::likelihood::{Design, FREE, Fit, POSITIVE, values};
use super::state::{Balance, Number, State, amplitude_bounds, knockoff_design};
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::selection::Work;

/// A hypothesis beside a state, fitted.
pub(super) struct Asked {
    pub(super) gram: Gram,
    pub(super) design: Design,
    pub(super) fit: Fit,
    /// Gain less the price, nats.
    pub(super) score: f64,
    /// Largest score against the knockoffs.
    pub(super) chance: f64,
    /// Place of its first amplitude.
    pub(super) first: usize,
}

impl Asked {
    /// Its amplitudes.
    pub(super) fn amplitudes(&self) -> &[f64] {
        &self.fit.beta[self.first..]
    }

    /// True where its first amplitude is at a bound.
    pub(super) fn held(&self) -> bool {
        self.fit.held.get(self.first).copied().unwrap_or(false)
    }
}

/// Price of k constants, nats.
pub(super) fn price(constants: usize, count: f64) -> f64 {
    0.5 * constants as f64 * (2.0 * count).ln()
}

/// A fit with further columns behind its own.
pub(super) struct Wider {
    pub(super) gram: Gram,
    /// Over all recordings.
    pub(super) bands: Vec<BandGram>,
    pub(super) design: Design,
    /// The coefficients of the fit, none of the columns.
    pub(super) start: Vec<f64>,
}

/// Further columns, free or between bounds, beside a fit.
pub(super) fn wider(
    balance: &Balance,
    (gram, design, beta): (&Gram, &Design, &[f64]),
    (columns, bounds): (&[TimeColumn], Vec<[f64; 2]>),
) -> Wider {
    let old = gram.len();
    let gram = gram.with(&balance.plan, columns.iter().map(|c| balance.column(c)).collect());
    let bands = gram.sum(&balance.plan, Part::All);
    let mut design = design.clone();
    design.add(&gram, old..gram.len(), bounds);
    let start = beta.iter().copied().chain(std::iter::repeat_n(0.0, columns.len())).collect();
    Wider { gram, bands, design, start }
}

/// Fits a hypothesis beside a state. `chance`: against the knockoffs, too.
pub(super) fn ask(balance: &Balance, state: &State, h: &Hypothesis, chance: bool) -> Asked {
    let base = &state.base;
    let columns = h.columns(&state.ground(balance));
    let added = columns.len();
    let mut bounds = amplitude_bounds(h, added);
    if chance && h.has_dose() {
        // On the grid neither shape nor numbers are where they belong, and the amplitude makes up for both;
        // not for the sign: a drive that is late is no early one.
        bounds = vec![FREE; added];
        bounds[0] = POSITIVE;
    }
    let first = base.fit.beta.len();
    let Wider { gram, bands, mut design, mut start } = wider(balance, base.fitted(), (&columns, bounds));
    if h.has_dose() {
        start[first] = 1.0;
    }
    if h.is_whole() && !chance {
        design.bounds[first] = [1.0, 1.0];
    }
    if h.facts().replaces_friction {
        // One friction takes the place of the other.
        let dry = |n: &Number| matches!(n, Number::MotorCoulomb | Number::StageCoulomb);
        let places = base.numbers.iter().enumerate().filter(|(_, n)| dry(n)).map(|(k, _)| k);
        for (new, old) in (first..first + added).zip(places) {
            start[new] = std::mem::replace(&mut start[old], 0.0);
            design.bounds[old] = [0.0, 0.0];
            // Its parts are of the new one.
            design.dry.iter_mut().filter(|dry| dry.level == old).for_each(|dry| dry.level = new);
            if design.bounds[new] == FREE {
                design.bounds[new] = POSITIVE;
            }
        }
    }
    if h.facts().turns_friction {
        // In place of the forms over speed.
        let places = base.numbers.iter().enumerate().filter(|(_, n)| matches!(n, Number::StageTurning(_)));
        places.for_each(|(k, _)| (start[k], design.bounds[k]) = (0.0, [0.0, 0.0]));
    }
    let fit = balance.fit(&design, &bands, &start, &base.weights);
    let cost = price(added + h.constants(), values(&bands));
    let score = base.fit.nats - fit.nats - cost;
    let mut most = f64::NEG_INFINITY;
    if chance {
        for (k, null) in base.knockoff_fits.iter().enumerate() {
            let mut of = knockoff_design(&base.design, &base.fit.beta, base.knockoffs + k);
            // The null world holds no law: an amplitude of any size is one of chance.
            let bounds = if h.has_dose() { vec![FREE; added] } else { amplitude_bounds(h, added) };
            of.add(&gram, base.gram.len()..gram.len(), bounds);
            let start: Vec<f64> = null.beta.iter().copied().chain(vec![0.0; added]).collect();
            let weights = of.weights(&bands, &start);
            let chance = of.fit(&bands, start, weights);
            most = most.max(null.nats - chance.nats - cost);
        }
    }
    Asked { gram, design, fit, score, chance: most, first }
}

/// Evaluations that a fit beside so many new columns costs: eight of them take as long as the rest of it.
pub(super) fn evaluations(columns: usize) -> u64 {
    1 + columns as u64 / 8
}

/// [`ask`] without the knockoffs, off a budget. `None`: it is spent.
pub(super) fn ask_within(balance: &Balance, state: &State, h: &Hypothesis, work: &mut Work) -> Option<Asked> {
    let asked = work.take(1).then(|| ask(balance, state, h, false))?;
    work.spend(evaluations(asked.amplitudes().len()) - 1);
    Some(asked)
}

/// T, nats: the worst of score, of that where the axis is heard, sum over folds and sum over recordings.
pub(super) fn statistic(balance: &Balance, state: &State, h: &Hypothesis, asked: &Asked) -> f64 {
    let after = balance.held_out_nats(&asked.gram, &asked.design, &asked.fit.beta);
    let gains = part_gains(balance, &state.base.held_out_nats, &after);
    let carries_over = |k: usize| k == 0 || !h.facts().is_of_one_recording;
    let counted = gains.iter().enumerate().filter(|(k, _)| carries_over(*k));
    let worst = counted.filter_map(|(_, gain)| *gain).fold(asked.score, f64::min);
    if balance.signals.sides() == 2 { worst.min(heard_nats(balance, state, h, asked)) } else { worst }
}

/// Score in the bands in which motor and stage move by more than their encoders' steps make.
///
/// Elsewhere the positions are noise, and what is commanded answers to that noise by the control law: there
/// an axis that is the controller, late and damped, is the likeliest. Such an encoder's delay earned 30,000
/// nats where none was missing, and loses 17,000 where the axis is heard.
fn heard_nats(balance: &Balance, state: &State, h: &Hypothesis, asked: &Asked) -> f64 {
    let base = &state.base;
    let n = base.gram.len();
    let is_heard = |(band, steps): (&BandGram, &BandGram)| {
        // What was recorded holds both.
        base.design.masses.iter().enumerate().all(|(side, (k, _))| {
            band.products[2 * side][(k + 1) * (n + 1)] > 2.0 * steps.products[2 * side][0]
        })
    };
    let heard: Vec<bool> = base.all.iter().zip(balance.accel_of_steps()).map(is_heard).collect();
    let of = |bands: &[BandGram], design: &Design, beta: &[f64]| {
        let bands = bands.iter().zip(&heard).filter(|(_, heard)| **heard);
        design.nats(&bands.map(|(band, _)| band.clone()).collect::<Vec<_>>(), beta)
    };
    let all = asked.gram.sum(&balance.plan, Part::All);
    let gained = of(&base.all, &base.design, &base.fit.beta) - of(&all, &asked.design, &asked.fit.beta);
    let added = asked.fit.beta.len() - base.fit.beta.len();
    gained - price(added + h.constants(), values(&all))
}

/// What one fit gains over another on quarters, and on recordings where there are several, that are left
/// out in turn, nats: sums of what [`Balance::held_out_nats`] says of each.
pub(super) fn part_gains(balance: &Balance, before: &[f64], after: &[f64]) -> [Option<f64>; 2] {
    let mut gains = [None; 2];
    for (part, (before, after)) in balance.parts().iter().zip(before.iter().zip(after)) {
        let of: &mut Option<f64> = &mut gains[usize::from(matches!(part, Part::Recording(_)))];
        *of = Some(of.unwrap_or(0.0) + before - after);
    }
    gains
}

/// Root mean square of the force, N, from which on a law beside a state would exceed the level.
///
/// Of an amplitude a the gain is a^2 / var(a), numbers and laws free beside it: a^2 = (level + price) var(a).
/// Of several amplitudes the first, their columns alike in size. `None`: nothing of it is in the recordings.
pub(super) fn least_seen_n(balance: &Balance, state: &State, h: &Hypothesis, level_nats: f64) -> Option<f64> {
    let base = &state.base;
    let (old, first) = (base.gram.len(), base.fit.beta.len());
    let columns = h.columns(&state.ground(balance));
    let free = vec![FREE; columns.len()];
    let Wider { gram, bands, design, start } = wider(balance, base.fitted(), (&columns, free));
    let fit = design.fit(&bands, start, base.weights.clone());
    let cost = price(columns.len() + h.constants(), values(&bands));
    let variance = fit.inverse()[(first, first)];
    let place = old * gram.len() + old;
    let power = |side: usize| bands.iter().map(|b| b.products[side][place]).sum::<f64>();
    let rms_n = (power(0).max(power(2)) / balance.plan.measured().max(1.0)).sqrt();
    let least_n = rms_n * ((level_nats + cost) * variance).sqrt();
    (least_n.is_finite() && least_n > 0.0).then_some(least_n)
}

/// What a finding must exceed beside `state`, nats. Of the hypotheses of a screening, `asked` in number,
/// chance alone lets one exceed ln(asked odds), and deviations that are wider count squared.
pub(super) fn level(state: &State, (asked, chance_nats): (usize, f64)) -> f64 {
    let c = &Criteria::STANDARD;
    let artefact_nats = c.artefact_nats.min(c.artefact_share * values(&state.base.all));
    let by_chance = c.serial.powi(2) * (c.odds * asked as f64).ln();
    artefact_nats.max(c.knockoff_factor * chance_nats).max(by_chance)
}
