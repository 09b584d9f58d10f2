//! When an axis stands still: dry friction then balances whatever there is, up to its level, and a balance of
//! forces says nothing.

use crate::diagnosis::criteria::Criteria;
use std::collections::VecDeque;

/// Rows in which an axis stands still: it stays within a step q, which may flip, for twice as long as where
/// it turns round under a common acceleration a, 2 (2 q / a)^(1/2), and for as long as a common speed takes
/// over ten steps.
///
/// Checked by: tests::a_stop_is_found_and_turning_round_is_none.
pub(super) fn standstill(
    x_m: &[f64],
    rate_hz: f64,
    (step_m, speed_m_s, accel_m_s2): (f64, f64, f64),
) -> Vec<bool> {
    let c = &Criteria::STANDARD;
    let turn_s = 2.0 * (2.0 * step_m / accel_m_s2.max(f64::MIN_POSITIVE)).sqrt();
    let creep_s = step_m / (c.step_share * speed_m_s).max(f64::MIN_POSITIVE);
    let least = (((2.0 * turn_s).max(creep_s) * rate_hz).ceil() as usize).max(3);
    let length_m = c.other_step * step_m;
    let mut out = vec![false; x_m.len()];
    // Rows of a window that may yet be its highest and its lowest, in order.
    let (mut highest, mut lowest) = (VecDeque::new(), VecDeque::new());
    let (mut begin, mut marked) = (0, 0);
    for (k, x) in x_m.iter().enumerate() {
        keep(&mut highest, k, |other: &usize| x_m[*other] > *x);
        keep(&mut lowest, k, |other: &usize| x_m[*other] < *x);
        while x_m[highest[0]] - x_m[lowest[0]] > length_m {
            begin += 1;
            drop_before(&mut highest, begin);
            drop_before(&mut lowest, begin);
        }
        if k + 1 - begin >= least {
            out[begin.max(marked)..=k].fill(true);
            marked = k + 1;
        }
    }
    out
}

/// Takes a row behind those that it does not outdo.
fn keep(rows: &mut VecDeque<usize>, row: usize, outdoes: impl Fn(&usize) -> bool) {
    while rows.back().is_some_and(|other| !outdoes(other)) {
        rows.pop_back();
    }
    rows.push_back(row);
}

/// Drops rows before the first.
fn drop_before(rows: &mut VecDeque<usize>, first: usize) {
    while rows.front().is_some_and(|row| *row < first) {
        rows.pop_front();
    }
}

#[cfg(test)]
mod tests {
    use super::standstill;

    /// Down to rest at 2 m/s2, 100 ms of rest, back; then round without a stop, encoder of 10 um.
    #[test]
    fn a_stop_is_found_and_turning_round_is_none() {
        let (rate_hz, step_m, accel_m_s2) = (1000.0, 1e-5, 2.0);
        let way = |t: f64| 0.5 * accel_m_s2 * t * t;
        let at = |t: f64| -> f64 {
            match t {
                t if t < 0.5 => -way(0.5 - t),
                t if t < 0.6 => 0.0,
                t if t < 1.1 => -way(t - 0.6),
                t => -way(1.6 - t),
            }
        };
        let x: Vec<f64> = (0..2100).map(|k| (at(f64::from(k) / rate_hz) / step_m).round() * step_m).collect();
        let found = standstill(&x, rate_hz, (step_m, 0.5, accel_m_s2));
        let rows: Vec<usize> = (0..x.len()).filter(|k| found[*k]).collect();
        // Within a step from 4 ms before the stop to 4 ms after.
        assert!(rows.first().is_some_and(|k| (494..=500).contains(k)), "{rows:?}");
        assert!(rows.last().is_some_and(|k| (600..=606).contains(k)), "{rows:?}");
        assert_eq!(rows.len(), rows[rows.len() - 1] - rows[0] + 1);
    }

    #[test]
    fn a_long_creep_takes_no_longer_than_a_walk() {
        // A million rows that leave a step only slowly: a row enters and leaves the window once.
        let x: Vec<f64> = (0..1_000_000).map(|k| 1e-9 * f64::from(k)).collect();
        let found = standstill(&x, 1000.0, (1e-3, 1e-3, 1e-3));
        assert!(found[500_000]);
    }
}
