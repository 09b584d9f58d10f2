//! The second look at what is about to be declared: whether it is what chatter can be.

use super::super::past::Sight;
use super::super::{ChatterEvent, Line};
use super::{ChatterMonitor, ChatterState};
use crate::chatter::detector::BankEvidence;

/// The window of the second look, s.
const LOOK_TAU_S: f64 = 0.025;
/// A line whose phase advances by less of a turn than this from one turn of the spindle to the next is made
/// of orders.
const REPEATS: f64 = 0.16;
/// If it was there a turn ago, with this share of its amplitude: noise has any phase.
const WAS_THERE: f64 = 0.3;
/// Share of its frequency by which a line may move in a second: a bar that gets thinner or a tool that
/// travels does less.
const DRIFT_1_S: f64 = 0.01;

impl ChatterMonitor {
    /// Whether a line that is about to be declared is something else. One that moves is followed from now
    /// on.
    pub(super) fn is_refused(&self, state: &mut ChatterState, line: &Line) -> bool {
        let rate_hz = self.mix.output_rate_hz();
        let sight = Sight { frequency_hz: line.frequency_hz - self.mix.centre_hz(), tau_s: LOOK_TAU_S };
        if state.speed_hz > 0.0 {
            let turn = state.past.turn_phase(rate_hz, self.mix.centre_hz(), sight);
                eprintln!("{:.3} {:?} {:?}", self.now_s(state), line, turn);
            }
            if turn.is_some_and(|(phase, share)| phase.abs() < REPEATS && share > WAS_THERE) {
                return true;
            }
        }
        let Some(moves_hz_s) = state.past.moves_hz_s(rate_hz, sight) else { return false };
        // Within a lobe chatter goes with the speed or stays; one that would cross an order within a second
        // does neither.
        let lobe_hz_s = line.frequency_hz * self.relative_speed_change_1_s(state);
        let free_hz_s = DRIFT_1_S * line.frequency_hz;
        let moves = moves_hz_s.abs() > free_hz_s + lobe_hz_s;
        if moves {
            state.foreign.add(sight.frequency_hz, line.power_n2);
        }
        moves
    }

    /// What the detector concludes, unless the second look refuses it.
    pub(super) fn try_line(
        &self,
        state: &mut ChatterState,
        evidence: &super::Evidence,
    ) -> Option<ChatterEvent> {
        let before = state.detector.clone();
        let event = state.detector.step(evidence);
        if let Some(ChatterEvent::Onset(line)) = event
            && self.is_refused(state, &line)
        {
            state.detector.refuse(&before);
            return None;
        }
        event
    }

    /// A line that is followed as something else stands for nothing, nor does what little it leaves beside it.
    pub(super) fn not_foreign(&self, state: &ChatterState, line: BankEvidence) -> Option<BankEvidence> {
        (!state.foreign.any() || line.contrast > line.suspect && !self.is_foreign(state, &line))
            .then_some(line)
    }

    fn is_foreign(&self, state: &ChatterState, line: &BankEvidence) -> bool {
        state.foreign.has(line.frequency_hz - self.mix.centre_hz(), 0.25 / line.tau_s)
    }
}
