//! Numbers of the model that the recordings contradict.

use super::given;
use super::laws::scale_deviation;
use super::number::Number;
use super::numbers::{Doubt, beside, told_scale};
use super::state::{Balance, State};
use crate::diagnosis::criteria::{Criteria, Z95};
use crate::diagnosis::result::Correction;
use crate::plant::effects::current_loop_lag::BANDWIDTH;
use crate::plant::machine::AxisModel;

/// True where the force comes later than its motion, whatever its dead time and the sample in which it acts:
/// its clock is another.
pub(super) fn is_late(balance: &Balance, state: &State, doubt: &Doubt) -> bool {
    let within_s = balance.timing_deviation_s(state.coulomb_n());
    let earliest_s = Criteria::STANDARD.timing_samples[0] / balance.signals.rate_hz;
    state.now.found_delay && state.now.path.delay_s < earliest_s - Z95 * doubt.path[0].hypot(within_s)
}

/// Numbers that the recordings contradict.
pub(super) fn corrections(
    balance: &Balance,
    axis: &AxisModel,
    state: &State,
    doubt: &Doubt,
) -> Vec<Correction> {
    let c = &Criteria::STANDARD;
    let all = beside(balance, axis, state, doubt);
    let scale = scale_deviation(balance);
    let off = told_scale(balance, &all);
    let mut list = Vec::new();
    for n in all.iter().filter(|n| n.nominal > 0.0 && n.is_told_wrong(off)) {
        let value = n.under(off);
        let half = Z95 * n.deviation.hypot(scale * (value + n.other));
        list.push(Correction::within(n.key, n.nominal, value, half));
    }
    for n in all.iter().filter(|n| n.is_of_second_mass(balance) && n.value > Z95 * n.deviation) {
        list.push(Correction::within(n.key, 0.0, n.value, Z95 * n.deviation.hypot(scale * n.value)));
    }
    if let Some(nominal) = balance.drive.torque_constant_nm_a().filter(|_| off != 0.0) {
        let value = nominal * (-off).exp();
        let half = Z95 * c.torque_constant_tolerance * value;
        list.push(Correction::within("torque_constant_nm_a", nominal, value, half));
    }
    let stated_s = balance.drive.amplifier_dead_time_s();
    let found_s = state.now.path.delay_s.max(0.0);
    let half_s = Z95 * doubt.path[0].hypot(balance.timing_deviation_s(state.coulomb_n()));
    if state.now.found_delay && found_s + half_s < stated_s && !is_late(balance, state, doubt) {
        list.push(Correction::within("amplifier_dead_time_s", stated_s, found_s, half_s));
    }
    list.extend(quicker_loop(balance, state, doubt));
    list.extend(read_apart(balance, axis, state, doubt));
    if state.now.found_smoothing && axis.drive.raw().friction_smoothing_m_s.is_some() {
        let (nominal, value) = (balance.signals.smoothing_m_s, state.now.smoothing_m_s);
        let told = Correction::within("friction_smoothing_m_s", nominal, value, 0.0);
        list.push(Correction { ci95: [0.9 * value, 1.1 * value], ..told });
    }
    list
}

/// A current loop that is quicker than stated. One at a bound is none.
fn quicker_loop(balance: &Balance, state: &State, doubt: &Doubt) -> Option<Correction> {
    let stated = balance.drive.current_loop_bandwidth_rad_s().filter(|_| state.now.found_loop)?;
    let most = (1.0 - Criteria::STANDARD.at_bound) * BANDWIDTH.bounds[1];
    let found = state.now.path.loop_rad_s.filter(|found| *found < most)?;
    let k = state.base.numbers.iter().position(|n| *n == Number::Lag)?;
    // Of a loop its lag is told.
    let half = Z95 * doubt.path[1].hypot(balance.timing_deviation_s(state.coulomb_n()) * found);
    let told = Correction::within("current_loop_bandwidth_rad_s", stated, found, 0.0);
    let is_told = (found / stated).ln() > half && !state.base.fit.held[k];
    is_told.then(|| Correction { ci95: [-half, half].map(|h| found * h.exp()), ..told })
}

/// How much later one encoder is read than the other, where nobody states when both are. One at a bound is
/// none.
fn read_apart(balance: &Balance, axis: &AxisModel, state: &State, doubt: &Doubt) -> Option<Correction> {
    let k = state.base.numbers.iter().position(|n| *n == Number::EncoderTiming)?;
    let more_s = balance.stage_later_s? + state.base.fit.beta[k];
    let half_s = Z95 * doubt.numbers[k].hypot(Criteria::STANDARD.timing_deviation / balance.signals.rate_hz);
    let stated = given::folded(axis).drive;
    let (key, nominal_s) = if more_s > 0.0 {
        ("stage_encoder_delay_s", stated.stage_encoder_delay_s())
    } else {
        ("motor_encoder_delay_s", stated.motor_encoder_delay_s())
    };
    let told = Correction::within(key, nominal_s, nominal_s + more_s.abs(), half_s);
    (more_s.abs() > half_s && !state.base.fit.held[k]).then_some(told)
}
