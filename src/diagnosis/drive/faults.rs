//! What is wrong with the column of the force, as only the balance shows it: mains, another clock.
//!
//! It stands in the model before any law is asked for, and is told as a fault of the recording.

use super::bank::{Demodulated, strongest_off};
use super::criteria::Criteria;
use super::evidence::ask;
use super::numbers::{Doubt, is_late};
use super::recorded::thrust_column;
use super::shape::{Hypothesis, Shape};
use super::state::{Balance, State, residual};
use super::subject::{Drive, PASSES};
use crate::diagnosis::result::{ForceFault, ForceFaultKind};
use crate::diagnosis::selection::{Fitted, Subject, Work};
use crate::diagnosis::two_cores::on_two_cores;
use crate::plant::effects::{EffectKind as E, Port};
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use crate::signal::inner_products::rms;

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
            let chance = |h: &Hypothesis| match h.shape {
                Shape::Mains { .. } => 0.0,
                _ => ask(self.balance, &state, h, true).chance.max(0.0),
            };
            let fitted = best
                .and_then(|(h, _)| Self::beside_chance(self.balance, chance(h)).fit(&state, h, work))
                .filter(Fitted::qualifies);
            match fitted {
                Some(fitted) => state = self.settled(fitted.model, PASSES, work),
                None => return state,
            }
        }
    }
}

/// What may be wrong with the force's column: lines of the mains; a force later than stated that its motion
/// shows, which is a wrong number or another clock.
fn faults(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let mut list = mains(balance, state);
    let asked = state.inertial && !balance.clock_moved && !state.found_delay;
    let late = [0.5, 1.5, 5.0, 15.0].map(|samples| {
        let shape = Shape::Delay { extra_s: samples / balance.signals.rate_hz, early: true };
        Hypothesis::named(E::DeadTime, Port::Current, shape)
    });
    list.extend(late.into_iter().filter(|_| asked));
    list
}

/// Lines of the mains in the recorded force, within the 0.2 % that mains keep, where what is left has most.
fn mains(balance: &Balance, state: &State) -> Vec<Hypothesis> {
    let s = &balance.signals;
    let left = residual(balance, &state.base.gram, &state.base.design, &state.base.fit.beta);
    let Some(spectrum) = &left.sides[0] else { return Vec::new() };
    let series = balance.plan.series(spectrum, &s.lengths());
    let near = |hz: f64| {
        let all: Vec<Demodulated> =
            series.iter().enumerate().map(|(r, x)| Demodulated::new(balance, x, (hz, r))).collect();
        let hz = hz + strongest_off(&all, Criteria::STANDARD.mains_off * hz);
        Hypothesis::named(E::ExternalDisturbance, Port::Current, Shape::Mains { hz })
    };
    let lines = [50.0, 60.0].into_iter().flat_map(|f| [1.0, 2.0, 3.0, 6.0].map(|k| f * k));
    lines.filter(|hz| *hz < s.top_hz()).map(near).collect()
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
            if let Shape::Mains { hz } = law.hypothesis.shape {
                let rms_n = rms(&law.amplitudes[2 * recording..2 * recording + 2]);
                tell(ForceFaultKind::MainsLine { frequency_hz: hz, rms_n });
            }
        }
        if late {
            tell(ForceFaultKind::ClockOffset { late_s: -state.path.delay_s });
        }
    }
    list
}
