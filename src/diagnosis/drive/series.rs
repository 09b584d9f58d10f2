//! Series for people: what is left in time, and what a finding adds sample by sample.

use super::columns::TimeColumn;
use super::numbers::stated_at_motor;
use super::signals::{Layout, Path, Signals};
use super::state::Accepted;
use super::state::{Balance, Number, State};
use crate::diagnosis::result::Contribution;
use crate::plant::effects::Port;
use crate::plant::effects::coulomb_friction::sliding_direction;
use crate::sample::Recording;

/// What is left: per recording, per balance.
pub(super) struct Residuals {
    /// Of the stated model.
    pub(super) nominal: Vec<Vec<Vec<f64>>>,
    /// With its numbers estimated.
    pub(super) before: Vec<Vec<Vec<f64>>>,
    /// With everything.
    pub(super) after: Vec<Vec<Vec<f64>>>,
}

/// The residuals of the stated numbers, of the first state, and of the last one.
pub(super) fn residuals(balance: &Balance, (start, stated): (&State, &[f64]), end: &State) -> Residuals {
    // When inside a sample a reference acts nobody states.
    let path = Path::stated(&balance.drive);
    let path = Path { delay_s: path.delay_s + start.now.timing_s, ..path };
    Residuals {
        nominal: of(balance, start, stated, path),
        before: of(balance, start, &start.base.fit.beta, start.ground(balance).path),
        after: of(balance, end, &end.base.fit.beta, end.ground(balance).path),
    }
}

impl Residuals {
    /// The same of the recordings as they came, before anything was found: with forces that are no part of
    /// these positions.
    pub(super) fn with(mut self, forces: &[(Port, TimeColumn)]) -> Self {
        let both = [&mut self.nominal, &mut self.before];
        let sums = both.into_iter().flat_map(|of| of.iter_mut().enumerate());
        for (recording, sides) in sums {
            for (side, sum) in sides.iter_mut().enumerate() {
                for force in forces.iter().filter_map(|(_, f)| f.sides[side].as_ref()) {
                    sum.iter_mut().zip(&force[recording]).for_each(|(s, f)| *s += f);
                }
            }
        }
        self
    }
}

fn of(balance: &Balance, state: &State, beta: &[f64], path: Path) -> Vec<Vec<Vec<f64>>> {
    let ground = state.ground(balance);
    let mut columns: Vec<TimeColumn> = state
        .base
        .numbers
        .iter()
        .map(|n| match n {
            // The path has it already.
            Number::Timing | Number::Lag => TimeColumn::default(),
            _ => balance.number_column(*n, &ground),
        })
        .collect();
    columns.extend(state.accepted.iter().flat_map(|a| a.columns(&ground)));
    let model = TimeColumn::sum(columns.iter().zip(beta.iter().copied()));
    let target = balance.target(path);
    let lengths = balance.signals.lengths();
    (0..lengths.len())
        .map(|r| {
            (0..balance.signals.sides())
                .map(|side| {
                    let mut left = vec![0.0; lengths[r]];
                    for (column, sign) in [(&target, 1.0), (&model, -1.0)] {
                        if let Some(series) = &column.sides[side] {
                            left.iter_mut().zip(&series[r]).for_each(|(l, v)| *l += sign * v);
                        }
                    }
                    left
                })
                .collect()
        })
        .collect()
}

/// What a law adds, in N at a force port, in m at an encoder, in A at the current.
pub(super) fn contribution(
    balance: &Balance,
    state: &State,
    law: &Accepted,
    recordings: &[Recording],
) -> Vec<Contribution> {
    let ground = state.ground(balance);
    let h = &law.hypothesis;
    let amplitudes: Vec<f64> = law.amplitudes.iter().map(|a| law.scale * a).collect();
    let thin = balance.signals.tracks.iter().all(|t| h.full(&ground, t).is_empty());
    let columns = if thin { h.columns(&ground) } else { Vec::new() };
    let sum = TimeColumn::sum(columns.iter().zip(amplitudes.iter().copied()));
    let side = usize::from(h.port == Port::Stage && balance.signals.layout == Layout::TwoPositions);
    balance
        .signals
        .tracks
        .iter()
        .enumerate()
        .map(|(r, track)| {
            let unit = if h.port == Port::Current { -1.0 / track.reference.per_unit } else { 1.0 };
            let columns = h.full(&ground, track);
            let value = if let Some(first) = columns.first() {
                let mut full = vec![0.0; first.len()];
                for (column, a) in columns.iter().zip(&amplitudes) {
                    full.iter_mut().zip(column).for_each(|(f, c)| *f += unit * a * c);
                }
                spread(&full, (track.full_first, 1), track.samples)
            } else {
                let series = sum.sides[side].as_ref().map_or_else(Vec::new, |s| s[r].clone());
                let scaled: Vec<f64> = series.iter().map(|v| unit * v).collect();
                spread(&scaled, (track.thin_first, balance.signals.step), track.samples)
            };
            of_recording(r, &recordings[r], value)
        })
        .collect()
}

/// What a number of the structure adds, a bristle left out that has its own.
pub(super) fn contribution_of_number(
    balance: &Balance,
    state: &State,
    number: Number,
    recordings: &[Recording],
) -> Vec<Contribution> {
    let s: &Signals = &balance.signals;
    let value = state.now.mechanics.of(number) - stated_at_motor(balance, number);
    let balance_side = usize::from(number.is_of_stage() && s.sides() == 2);
    let is_dry = number.is_dry_friction();
    let side = if is_dry { s.moved_side(balance_side) } else { balance_side };
    let of = |v: &f64| value * if is_dry { sliding_direction(*v, state.now.smoothing_m_s) } else { *v };
    s.tracks
        .iter()
        .enumerate()
        .map(|(r, track)| {
            let full: Vec<f64> = track.sides[side].v_m_s.iter().map(of).collect();
            of_recording(r, &recordings[r], spread(&full, (track.full_first, 1), track.samples))
        })
        .collect()
}

/// A series of all samples of a recording.
pub(super) fn of_recording(recording: usize, of: &Recording, value: Vec<f64>) -> Contribution {
    Contribution { recording, t_s: (0..of.len()).map(|k| of.time_s(k)).collect(), value }
}

/// A series on every `step`-th sample from `first`, straight between them; its ends held.
fn spread(series: &[f64], (first, step): (usize, usize), samples: usize) -> Vec<f64> {
    let Some(last) = series.len().checked_sub(1) else { return vec![0.0; samples] };
    let at = |k: usize| {
        let place = k.saturating_sub(first) as f64 / step as f64;
        let left = (place as usize).min(last);
        let part = (place - left as f64).clamp(0.0, 1.0);
        series[left] + part * (series[(left + 1).min(last)] - series[left])
    };
    (0..samples).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::spread;

    #[test]
    fn a_thinned_series_is_straight_between_its_samples_and_held_at_its_ends() {
        assert_eq!(spread(&[1.0, 3.0], (2, 2), 7), [1.0, 1.0, 1.0, 2.0, 3.0, 3.0, 3.0]);
    }
}
