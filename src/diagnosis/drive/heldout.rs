//! What is left of a balance on parts that nothing was fitted to, with and without each finding: one rule for
//! all of them.
//!
//! A finding is taken out of the final state, the numbers that are then free are fitted again, and each
//! quarter of the recordings is foretold by the other three. What the coarser steps of an encoder leave is
//! explained by them, band by band, up to what is left there: |p|^2 q^2 / 12 beside a force p q of the steps.

use super::gram::{Gram, Part};
use super::likelihood::Design;
use super::number::Number;
use super::numbers::fit_as_stated;
use super::rest::pull_n_m;
use super::signals::Path;
use super::spectra::FOLDS;
use super::state::{Balance, State};
use crate::plant::effects::Port;
use std::f64::consts::TAU;

/// What a finding stands for in a state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Named {
    /// A law, by its place.
    Law(usize),
    /// A dead time, a current loop.
    Delay,
    Loop,
    /// A number that the model leaves out.
    Number(Number),
    /// Steps of the encoder at a port.
    Steps(Port),
    /// What the encoder at a port reads wrong.
    Error(Port),
}

/// Steps of an encoder that were found: variance of the noise that they make, m2, in each recording.
pub(super) struct Stepped {
    pub(super) port: Port,
    pub(super) variance_m2: Vec<f64>,
}

/// A state without what a finding stands for, its numbers fitted again. What is no part of a state leaves it
/// as it is.
pub(super) fn without(balance: &Balance, state: &State, named: Named) -> State {
    let mut others = state.clone();
    let stated = Path::stated(&balance.drive);
    match named {
        Named::Law(k) => drop(others.accepted.remove(k)),
        Named::Delay => (others.now.path.delay_s, others.now.found_delay) = (stated.delay_s, false),
        Named::Loop => (others.now.path.loop_rad_s, others.now.found_loop) = (stated.loop_rad_s, false),
        Named::Number(_) | Named::Steps(_) | Named::Error(_) => return others,
    }
    others.rebuilt(balance)
}

/// Root mean square on parts that nothing was fitted to, N: motor and stage.
pub(super) fn foretold_n(balance: &Balance, (gram, design, beta): (&Gram, &Design, &[f64])) -> f64 {
    let foretold = balance.foretold(gram, design, beta);
    let of = |(part, beta): (Part, Vec<f64>)| -> f64 {
        let spread = |band| (design.spread(band, &beta), band.values);
        gram.sum(&balance.plan, part).iter().map(spread).map(|(s, values)| (s[0] + s[2]) * values).sum()
    };
    let sum: f64 = (0..FOLDS).map(Part::Fold).zip(foretold).map(of).sum();
    (sum / balance.plan.measured().max(1.0)).sqrt()
}

/// A state as it is written: numbers that nothing says or corrects as they are stated, with the steps that
/// were found.
pub(super) struct Written<'a> {
    pub(super) state: &'a State,
    pub(super) held: &'a [Number],
    pub(super) stepped: Vec<Stepped>,
    /// Power that each encoder's error makes of the balance, N2.
    pub(super) errors_n2: Vec<(Port, f64)>,
}

/// A state without what a finding stands for, with numbers held as stated, and its fit.
pub(super) fn fit_taken_out(
    balance: &Balance,
    state: &State,
    named: Option<Named>,
    held: &[Number],
) -> (State, Design, Vec<f64>) {
    let others = named.map_or_else(|| state.clone(), |named| without(balance, state, named));
    let mut held = held.to_vec();
    held.extend(named.and_then(|named| if let Named::Number(n) = named { Some(n) } else { None }));
    let (design, beta) = fit_as_stated(balance, &others, &held);
    (others, design, beta)
}

impl Written<'_> {
    /// What it leaves on parts that nothing was fitted to, or what it leaves without a finding, N.
    pub(super) fn heldout_n(&self, balance: &Balance, named: Option<Named>) -> f64 {
        let (state, design, beta) = fit_taken_out(balance, self.state, named, self.held);
        let all_n = foretold_n(balance, (&state.base.gram, &design, &beta));
        let rest = self.stepped.iter().filter(|s| named != Some(Named::Steps(s.port)));
        let explained_n2 = steps_n2(balance, self.state, &rest.collect::<Vec<_>>());
        let errors = self.errors_n2.iter().filter(|(port, _)| named == Some(Named::Error(*port)));
        let error_n2 = errors.map(|(_, n2)| n2).sum::<f64>();
        (all_n.powi(2) - explained_n2 + error_n2).max(0.0).sqrt()
    }
}

/// Power that steps of encoders make of the balance, no more in a band than is left there, N2.
fn steps_n2(balance: &Balance, state: &State, stepped: &[&Stepped]) -> f64 {
    let (s, plan) = (&balance.signals, &balance.plan);
    let mut sum = 0.0;
    for band in &state.base.gram.sum_by_band(plan) {
        let hz = 0.5 * plan.band_hz(band.band).iter().sum::<f64>();
        let left = state.base.design.spread(band, &state.base.fit.beta);
        let of = |x: &&Stepped| -> f64 {
            let pull = pull_n_m(x.port, &state.now.mechanics, TAU * hz);
            let seen = pull[..s.sides()].iter().map(|p| p.norm_sqr()).sum::<f64>();
            2.0 / s.step as f64 * s.kept_power(hz) * x.variance_m2[band.recording] * seen
        };
        sum += band.values * stepped.iter().map(of).sum::<f64>().min(left[0] + left[2]);
    }
    sum / plan.measured().max(1.0)
}
