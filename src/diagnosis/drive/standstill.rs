//! When an axis stands still: dry friction then balances whatever there is, up to its level, and a balance of
//! forces says nothing.

use crate::diagnosis::criteria::Criteria;
use std::collections::VecDeque;

/// Rows in which an axis stands still: it stays within a step, which may flip, four times as long as it takes
/// over the next three steps on the side where it goes faster.
///
/// Where it turns round by x = a t^2 / 2 on one side and b t^2 / 2 on the other, b the larger one, two
/// rounded places hold at most two steps q of it, (4 q)^(1/2) (a^(-1/2) + b^(-1/2)), and the next three take
/// 0.58 (4 q / b)^(1/2): 3.4 times as long at most where a is b; at an even speed two thirds. Of a turn whose
/// sides differ more the rows of its last step may go, in which nothing tells when friction turned. No speed,
/// acceleration or force need be known.
/// Checked by: tests::a_stop_is_found_and_turning_round_is_none, tests::a_slow_sine_never_stands.
pub(super) fn standstill(x_m: &[f64], step_m: f64) -> Vec<bool> {
    let near_m = Criteria::STANDARD.other_step * step_m;
    let far_m = near_m + 3.0 * step_m;
    let backwards: Vec<f64> = x_m.iter().rev().copied().collect();
    let begins = begins_within(x_m, near_m);
    let [comes, goes] = [x_m, &backwards].map(|x| begins_within(x, far_m));
    let last = x_m.len().saturating_sub(1);
    let (mut out, mut marked) = (vec![false; x_m.len()], 0);
    for (end, begin) in begins.into_iter().enumerate() {
        // Rows over the next steps; of an end of the file nothing is known.
        let sides = [(comes[begin], begin), (goes[last - end], last - end)];
        let rows = sides.into_iter().filter(|(from, _)| *from > 0).map(|(from, to)| (to - from).max(1));
        if end - begin > 4 * rows.min().unwrap_or(1) {
            out[begin.max(marked)..=end].fill(true);
            marked = end + 1;
        }
    }
    out
}

/// Up to each row, the first one from which on all stay within a length.
fn begins_within(x_m: &[f64], length_m: f64) -> Vec<usize> {
    // Rows of a window that may yet be its highest and its lowest, in order.
    let (mut highest, mut lowest) = (VecDeque::new(), VecDeque::new());
    let mut begin = 0;
    let mut of = |k: usize| {
        keep(&mut highest, k, |other: &usize| x_m[*other] > x_m[k]);
        keep(&mut lowest, k, |other: &usize| x_m[*other] < x_m[k]);
        while x_m[highest[0]] - x_m[lowest[0]] > length_m {
            begin += 1;
            drop_before(&mut highest, begin);
            drop_before(&mut lowest, begin);
        }
        begin
    };
    (0..x_m.len()).map(&mut of).collect()
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
    use std::f64::consts::TAU;

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
        let found = standstill(&x, step_m);
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
        assert_eq!(standstill(&x, 1e-5).iter().filter(|rests| **rests).count(), 0);
    }

    /// However slow: a sine of 1 mm that stays within a step of 1 um for 500 rows where it turns round.
    #[test]
    fn a_slow_sine_never_stands() {
        let x: Vec<f64> = (0..72_000).map(|k| 1e-3 * (TAU * f64::from(k) / 36_000.0).sin()).collect();
        let read: Vec<f64> = x.iter().map(|x| (x / 1e-6).round() * 1e-6).collect();
        assert!(!standstill(&read, 1e-6).contains(&true));
    }
}
