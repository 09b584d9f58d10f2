//! What is wrong with the column of the force, as only the balance shows it: mains, another clock.
//!
//! It stands in the model before any law is asked for, and is told as a fault of the recording.

use super::bank::faults;
use super::corrections::is_late;
use super::evidence::ask;
use super::laws::Hypothesis;
use super::numbers::Doubt;
use super::recorded::thrust_column;
use super::state::{Balance, State};
use super::subject::{Drive, PASSES};
use crate::diagnosis::result::{ForceFault, ForceFaultKind};
use crate::diagnosis::selection::{Fitted, Subject, Work};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;

impl Drive<'_> {
    /// What is wrong with the column of the force stands in the model before any law: it is none. A line that
    /// lasts is its own knockoff, and is asked without.
    pub(super) fn without_faults(&self, mut state: State, work: &mut Work) -> State {
        loop {
            let list = faults(self.balance, &state);
            if !work.take(list.len() as u64) {
                return state;
            }
            let scores = on_two_cores(&list, |h| ask(self.balance, &state, h, false).score);
            let best = list.iter().zip(scores).max_by(|a, b| a.1.total_cmp(&b.1));
            let chance = |h: &Hypothesis| match h.facts().is_of_one_recording {
                true => 0.0,
                false => ask(self.balance, &state, h, true).chance.max(0.0),
            };
            let fitted = best
                .and_then(|(h, _)| Self::beside_chance(self.balance, chance(h)).fit(&state, h, work))
                .filter(Fitted::qualifies);
            let Some(fitted) = fitted else { return state };
            let settled = self.settled(fitted.model, PASSES, work);
            if !(settled.gain_nats(&state) > fitted.level_nats) {
                return state;
            }
            state = settled;
        }
    }
}

/// What is wrong with the column of the force.
pub(super) fn force_faults(
    (axis, recordings): (&AxisModel, &[Recording]),
    balance: &Balance,
    state: &State,
    doubt: &Doubt,
) -> Vec<ForceFault> {
    let mut list = Vec::new();
    let late = is_late(balance, state, doubt);
    for (recording, of) in recordings.iter().enumerate() {
        let Some(column) = thrust_column(axis, of) else { continue };
        let mut tell = |kind| list.push(ForceFault { recording, column: column.clone(), kind });
        for law in &state.accepted {
            law.hypothesis.law().fault(&law.amplitudes, recording).into_iter().for_each(&mut tell);
        }
        if late {
            tell(ForceFaultKind::ClockOffset { late_s: -state.now.path.delay_s });
        }
    }
    list
}
