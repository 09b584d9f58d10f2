//! The second look at what is about to be declared: whether it is what chatter can be.

use super::super::detector::{BankEvidence, Evidence, PLACED};
use super::super::past::{FAR_HZ, Motion, Sight};
use super::super::{ChatterEvent, Line};
use super::{ChatterMonitor, ChatterState};

/// The window of the second look, s, and the bank that has it.
const LOOK_TAU_S: f64 = 0.025;
const LOOK: usize = 1;
/// A line whose phase advances by less of a turn than this from one turn of the spindle to the next is made
/// of orders.
const REPEATS: f64 = 0.16;
/// If it was there a turn ago, with this share of its amplitude: noise has any phase.
const WAS_THERE: f64 = 0.3;
/// Share of its frequency by which a line may move in a second: a bar that gets thinner or a tool that
/// travels does less.
const DRIFT_1_S: f64 = 0.01;
/// Powers within this of each other, as windows that a line fills in part tell them, may be of one line.
const ALIKE: f64 = 4.0;
/// For so long after the cut changed a line must have this share of the most power that is kept of it: what
/// the entry struck rings down, at 10 1/s and less where the cut is nearly unstable; chatter stays or grows.
const RINGS_S: f64 = 0.8;
const RANG: f64 = 0.5;
/// For so long after an alarm a line must have this share of what was loudest in it: less is what is left of
/// it, or noise that was not learned meanwhile.
const AFTER_S: f64 = 1.5;
const LEFT: f64 = 0.01;
/// While the speed changes a line may move by so much of what an order at its place moves.
const WITH_SPEED: f64 = 1.5;
/// Amplitude of a line over the mean force: a tool that only pushes makes less than 2 (|2 c_1| <= 2 c_0), and
/// less than 1 until it leaves the cut.
pub(super) const MOST_SHARE: f64 = 1.5;
/// A tool that stays in the cut pushes through the noise of the band; less is the drift of a zero.
const OVER_NOISE: f64 = 2.0;

impl ChatterMonitor {
    /// Whether a line that is about to be declared is something else. One that moves is followed from now
    /// on.
    pub(super) fn is_refused(&self, state: &mut ChatterState, line: &Line, banks: &[BankEvidence]) -> bool {
        let rate_hz = self.mix.output_rate_hz();
        let sight = Sight { frequency_hz: line.frequency_hz - self.mix.centre_hz(), tau_s: LOOK_TAU_S };
        if self.now_s(state) < state.alarm_s + AFTER_S && line.power_n2 < LEFT * state.alarm_n2 {
            return true;
        }
        if self.settings.pushes && !self.cuts(state, line.power_n2) {
            let power_n2 = self.power_near(state, line.frequency_hz);
            state.foreign.add(sight.frequency_hz, 0.0, power_n2);
            return true;
        }
        if state.speed_hz > 0.0 {
            // A line that the window does not hear has any phase in it: a longer one tells.
            let heard = banks[LOOK].contrast > banks[LOOK].suspect;
            let tau_s = if heard { LOOK_TAU_S } else { banks[PLACED].tau_s };
            let turn = state.past.turn_phase(rate_hz, self.mix.centre_hz(), Sight { tau_s, ..sight });
            if turn.is_some_and(|(phase, share)| phase.abs() < REPEATS && share > WAS_THERE) {
                return true;
            }
        }
        let rings = self.now_s(state) < state.changed_s + RINGS_S;
        if rings && state.past.share_of_most(rate_hz, sight) < RANG {
            return true;
        }
        if self.came_from_elsewhere(state, line) {
            let power_n2 = self.power_near(state, line.frequency_hz);
            state.foreign.add(sight.frequency_hz, 0.0, power_n2);
            return true;
        }
        let Some(Motion { moves_hz_s, moved_hz }) = state.past.motion(rate_hz, sight, state.speed_hz) else {
            return false;
        };
        // Within a lobe chatter stays where the mode is, or goes with the speed.
        let free_1_s = DRIFT_1_S + WITH_SPEED * state.past.speed_change_1_s(rate_hz).abs();
        let moves = moves_hz_s.abs() > free_1_s * line.frequency_hz;
        if moves {
            let power_n2 = self.power_near(state, line.frequency_hz);
            // What has come so far already has proven it, though it rests now.
            let way_hz = if moved_hz > FAR_HZ { 0.0 } else { 0.5 * moves_hz_s.abs() };
            state.foreign.add(sight.frequency_hz, way_hz, power_n2);
        }
        moves
    }

    /// Whether a line that was known stood elsewhere a moment ago, as strong as this one, and is gone from
    /// there: it has moved, however fast.
    fn came_from_elsewhere(&self, state: &mut ChatterState, line: &Line) -> bool {
        let (bank, rate_hz) = (&self.banks[PLACED], self.mix.output_rate_hz());
        let line_hz = line.frequency_hz - self.mix.centre_hz();
        let past = &state.past;
        state.baselines[PLACED].left().any(|(filter, known_n2)| {
            let sight = Sight { frequency_hz: bank.frequencies_hz()[filter], tau_s: LOOK_TAU_S };
            (sight.frequency_hz - line_hz).abs() > FAR_HZ
                && known_n2 < ALIKE * line.power_n2
                && line.power_n2 < ALIKE * known_n2
                && past.first_power(rate_hz, sight).is_some_and(|then_n2| then_n2 > 0.5 * known_n2)
        })
    }

    /// Whether the mean force is one in which a line of this power can be chatter: that of a tool, not a zero
    /// that is off. A tool's force stands far above the noise, or came since the first sample.
    fn cuts(&self, state: &mut ChatterState, power_n2: f64) -> bool {
        let force_n = state.level.size_n();
        // Chatter with many lines is no noise: what the band held at rest is.
        let noise_n = (state.variance_n2 - power_n2).max(0.0).min(state.loudness.rest_n2()).sqrt();
        let filters = state.watched.filters(self.banks[PLACED].frequencies_hz().len(), self.reach_hz);
        let floor_n2 = state.baselines[PLACED].median(filters) / std::f64::consts::LN_2;
        let came = noise_n * OVER_NOISE < state.level.over_rest_n();
        (2.0 * power_n2).sqrt() < MOST_SHARE * force_n && (came || self.over_noise(force_n, floor_n2))
    }

    /// What the detector concludes, unless the second look refuses it.
    pub(super) fn try_line(&self, state: &mut ChatterState, evidence: &Evidence) -> Option<ChatterEvent> {
        let before = state.detector.clone();
        let event = state.detector.step(evidence);
        if let Some(ChatterEvent::Onset(line)) = event
            && self.is_refused(state, &line, &evidence.banks)
        {
            state.detector.refuse(&before);
            return None;
        }
        event
    }

    /// A line that is followed as something else stands for nothing, nor does what little it leaves beside
    /// it.
    pub(super) fn not_foreign(&self, state: &ChatterState, line: BankEvidence) -> Option<BankEvidence> {
        (!state.foreign.any() || line.contrast > line.suspect && !self.is_foreign(state, &line))
            .then_some(line)
    }

    fn is_foreign(&self, state: &ChatterState, line: &BankEvidence) -> bool {
        state.foreign.has(line.frequency_hz - self.mix.centre_hz(), 0.25 / line.tau_s)
    }
}
