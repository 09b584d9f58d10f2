//! How the noise of a stream is learned, while nothing stands out.

use super::super::baseline::Lesson;
use super::{ChatterMonitor, ChatterState, STRIDES};

/// Noise is averaged over this long once it is known.
const NOISE_MEMORY_S: f64 = 15.0;
/// Most that a power counts over what is known, usually and while the noise is another.
const USUAL_MOST: f64 = 4.0;
const LEARNING_MOST: f64 = 8.0;
/// Nothing is decided before this much noise was heard.
const LEARN_S: f64 = 0.4;

impl ChatterMonitor {
    pub(super) fn learn_variance(&self, state: &mut ChatterState, period_s: f64) {
        let usual = &mut state.usual_variance_n2;
        let counted = if *usual > 0.0 { state.variance_n2.min(4.0 * *usual) } else { state.variance_n2 };
        *usual += (counted - *usual) * (period_s / (state.heard_s + period_s).min(NOISE_MEMORY_S));
    }

    /// Of every window, or of those alone that know nothing yet.
    pub(super) fn learn(&self, state: &mut ChatterState, period_s: f64, every: bool) {
        if every || state.baselines.iter().any(|b| !b.is_known()) {
            state.heard_s += period_s;
        }
        // The lobes of the noise move with the speed: what is older than their move of 3 Hz is no guide.
        let relative_1_s = self.relative_speed_change_1_s(state);
        let now_s = self.now_s(state);
        let most = match now_s {
            now_s if now_s < state.noise_until_s => f64::INFINITY,
            now_s if now_s < state.relearn_until_s => LEARNING_MOST,
            _ => USUAL_MOST,
        };
        let memory_s = (3.0 / (self.mix.centre_hz() * relative_1_s).max(1e-9)).clamp(1.5, NOISE_MEMORY_S);
        let parts = self.banks.iter().zip(&mut state.baselines).zip(STRIDES);
        for ((bank, baseline), stride) in parts {
            if !state.decisions.is_multiple_of(stride) || (!every && baseline.is_known()) {
                continue;
            }
            let period_s = period_s * stride as f64;
            // Not before the window is full; the window's noise is independent after about 3 tau.
            if state.heard_s > 6.0 * bank.tau_s() {
                let looks = period_s / (3.0 * bank.tau_s());
                let memory_looks = memory_s / (3.0 * bank.tau_s());
                baseline.learn(Lesson { looks, memory_looks, most });
            }
        }
        if state.heard_s > LEARN_S {
            state.detector.learned();
        }
    }
}
