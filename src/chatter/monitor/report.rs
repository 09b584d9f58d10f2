//! What the monitor says of the line that it hears.

use super::super::detector::{BankEvidence, Evidence, LEAVE, on_an_order};
use super::super::{ChatterEvent, ChatterOutput, Phase};
use super::{ChatterMonitor, ChatterState, STRIDES};

/// What a window heard is told for now where the speed has moved the line by this meanwhile.
const BEHIND_HZ: f64 = 0.2;

impl ChatterMonitor {
    pub(super) fn report(&self, state: &mut ChatterState, evidence: &Evidence) {
        // The longest window that the chatter has filled gives the frequency, up to 50 ms of tau.
        let index = match state.detector.chatter_age_s(evidence.t_s) {
            Some(age_s) if age_s > 0.1 => 2,
            _ => 1,
        };
        let heard = self.line_told(state, evidence, index);
        let phase = state.detector.phase();
        // An order is no line that another axis could confirm, nor that proves itself by lasting.
        let line = matches!(phase, Phase::Suspected | Phase::Chatter) && !on_an_order(&heard, evidence);
        if !line {
            state.drift.forget();
        }
        state.track_hz = line.then(|| self.now_hz(state, &heard));
        let declared = (phase == Phase::Chatter).then_some(heard.frequency_hz);
        if declared.is_some() {
            (state.alarm_n2, state.alarm_s) = (state.alarm_n2.max(heard.power_n2), evidence.t_s);
        }
        state.watched.follow(declared.map(|hz| hz - self.mix.centre_hz()), self.reach_hz);
        // What is left of a line that has gone is no new one.
        let told = declared.is_none() || heard.contrast > LEAVE;
        let hop = if told { state.hop.look(declared) } else { None };
        let hop = hop.map(|(from_hz, to_hz)| ChatterEvent::Hop { from_hz, to_hz });
        let event = state.latest.event.or(hop);
        state.latest = ChatterOutput {
            phase,
            frequency_hz: state.track_hz,
            power_n2: heard.power_n2,
            contrast: evidence.banks.iter().fold(0.0, |m, b| f64::max(m, b.contrast)),
            growth_1_s: line.then_some(heard.growth_1_s),
            variance_ratio: state.variance_n2 / state.usual_variance_n2.max(f64::MIN_POSITIVE),
            event,
        };
    }

    /// The line that is told: the strongest in a window, or what stands out beside what is something else.
    fn line_told(&self, state: &mut ChatterState, evidence: &Evidence, index: usize) -> BankEvidence {
        let heard = evidence.banks[index];
        if state.foreign.any() {
            return heard;
        }
        let (bank, bank_state) = (&self.banks[index], &state.banks[index]);
        let best = if STRIDES[index] == 1 {
            state.baselines[index].strongest()
        } else {
            let among = state.watched.filters(bank.frequencies_hz().len(), self.reach_hz);
            state.baselines[index].look(bank, bank_state, among)
        };
        BankEvidence {
            frequency_hz: self.mix.centre_hz() + bank.refined_hz(bank_state, best),
            power_n2: state.baselines[index].power(best),
            growth_1_s: bank.growth_1_s(bank_state, best),
            ..heard
        }
    }

    /// Where the line is now, Hz: a window heard it some time ago.
    fn now_hz(&self, state: &mut ChatterState, heard: &BankEvidence) -> f64 {
        let age_s = self.mix.delay_s() + 2.0 * heard.tau_s;
        let period_s = self.decide_every as f64 / self.mix.output_rate_hz();
        let since_hz = state.drift.since_hz(heard.frequency_hz, period_s, age_s);
        let behind_hz = heard.frequency_hz * self.relative_speed_change_1_s(state) * age_s;
        heard.frequency_hz + if behind_hz > BEHIND_HZ { since_hz } else { 0.0 }
    }
}
