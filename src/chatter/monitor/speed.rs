//! What the spindle's speed tells of where its orders are.

use super::super::detector::PLACED;
use super::{ChatterMonitor, ChatterState, SPEED_LAG_S, TAUS_S};

/// Turns a second at which two lines of the bank that places them, misplaced by 0.05/tau each, are an order
/// apart (120 rpm).
const LEAST_SPEED_HZ: f64 = 2.0 * 0.05 / TAUS_S[PLACED];

impl ChatterMonitor {
    /// The speed only places the notches: 20 ms of smoothing; and what it was about a second ago. Where its
    /// orders stand closer than a line can be placed it tells nothing: it is not known.
    pub(super) fn follow_speed(&self, state: &mut ChatterState) {
        let period_s = 1.0 / self.mix.output_rate_hz();
        let newest_hz = state.newest_speed_hz;
        if newest_hz < LEAST_SPEED_HZ {
            state.speed_hz = 0.0;
        } else if state.speed_hz <= 0.0 {
            (state.speed_hz, state.earlier_speed_hz) = (newest_hz, newest_hz);
            self.restart_orders(state);
        } else {
            state.speed_hz += (newest_hz - state.speed_hz) * (period_s / 0.02).min(1.0);
        }
        state.earlier_speed_hz += (state.speed_hz - state.earlier_speed_hz) * (period_s / SPEED_LAG_S);
    }

    pub(super) fn relative_speed_change_1_s(&self, state: &ChatterState) -> f64 {
        (state.speed_hz - state.earlier_speed_hz).abs() / (SPEED_LAG_S * state.speed_hz.max(1e-9))
    }
}
