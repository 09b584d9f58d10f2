//! Which hypotheses there are for a state: what each effect asks of it.

use super::gram::Column;
use super::laws::{EFFECTS, Hypothesis, Search, Shape};
use super::spectra::Series;
use super::state::{Balance, State, residual};
use std::cell::OnceCell;

fn search<'a>(balance: &'a Balance, state: &State) -> Search<'a> {
    let left = residual(balance, state.base.fitted());
    let whitened = whitened(balance, state, &left);
    let has_command = state.now.inertial && !state.is_measured(balance);
    Search {
        balance,
        signals: &balance.signals,
        two: balance.signals.sides() == 2,
        now: state.now,
        coulomb_n: state.coulomb_n(),
        has_command,
        left,
        whitened,
        found: OnceCell::new(),
    }
}

/// Everything that may be asked of a state.
pub(super) fn candidates(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let search = search(balance, state);
    let taken = |h: &Hypothesis| {
        state.accepted.iter().any(|a| {
            let other = &a.hypothesis;
            other.effect == h.effect
                && other.port == h.port
                && (!h.facts().is_of_one_recording || is_one_cut(h, other, balance.signals.tracks.len()))
                && other.facts().is_number == h.facts().is_number
        })
    };
    let mut list: Vec<Hypothesis> = Vec::new();
    for h in EFFECTS.iter().flat_map(|effect| (effect.candidates)(&search)) {
        if !taken(&h) && !list.contains(&h) {
            list.push(h);
        }
    }
    list
}

/// Whether two cuts at one time are one: a harmonic may differ from its mean, and is no other spindle.
fn is_one_cut(a: &Hypothesis, b: &Hypothesis, recordings: usize) -> bool {
    let (Shape::Cut(a), Shape::Cut(b)) = (a.shape, b.shape) else { return false };
    let both_s = a.longest_beside_s(&b, recordings);
    let [low_hz, high_hz] = [a.hz.min(b.hz), a.hz.max(b.hz)];
    let off_hz = high_hz - low_hz * (high_hz / low_hz).round();
    // Nearer than what that time tells apart.
    both_s > 0.0 && off_hz.abs() * both_s < 1.0
}

/// What may be wrong with the column of the force.
pub(super) fn faults(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let search = search(balance, state);
    EFFECTS.iter().rev().flat_map(|effect| (effect.faults)(&search)).collect()
}

/// What is left, through the weights of its bands, in time.
fn whitened(balance: &Balance, state: &State, left: &Column) -> [Series; 2] {
    let base = &state.base;
    let lengths = balance.signals.lengths();
    std::array::from_fn(|side| {
        if side >= balance.signals.sides() {
            return Vec::new();
        }
        let zero = vec![0.0; left.sides[side].as_ref().map_or(0, |s| s.len())];
        let mut out = zero;
        for cell in &balance.plan.cells {
            let Some(k) = base
                .all
                .iter()
                .position(|b| b.recording == cell.recording && (balance.plan.white || b.band == cell.band))
            else {
                continue;
            };
            let w = base.weights[k];
            let row = if side == 0 { [w[0], w[1]] } else { [w[1], w[2]] };
            for (other, factor) in row.iter().enumerate() {
                if let Some(spectrum) = &left.sides[other] {
                    let into = cell.of_mut(&mut out);
                    into.iter_mut().zip(cell.of(spectrum)).for_each(|(o, v)| *o += factor * v);
                }
            }
        }
        balance.plan.series(&out, &lengths)
    })
}
