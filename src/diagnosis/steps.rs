//! Steps of an encoder, read off the recording itself: every difference of two samples is a whole number of
//! steps.

use super::criteria::Criteria;
use super::encoder_noise::variance_across_steps_m2;
use crate::plant::effects::{EffectKind, Port, encoder_quantization};
use crate::plant::machine::AxisModel;

/// Differences that are looked at.
const LOOKED_AT: usize = 40_000;
/// What is left of two differences below this share of the stated step is rounding.
const EUCLID_END: f64 = 0.1;

/// Step of an encoder as the model states it, m; in the structure or among its physics.
pub(crate) fn stated_step_m(axis: &AxisModel, port: Port) -> f64 {
    let stated = if port == Port::MotorEncoder {
        axis.drive.motor_encoder_resolution_m()
    } else {
        axis.drive.stage_encoder_resolution_m()
    };
    axis.physics
        .iter()
        .filter(|t| t.effect == EffectKind::EncoderQuantization && t.port == port)
        .filter_map(|t| t.value(&encoder_quantization::STEP))
        .fold(stated, f64::max)
}

/// The step of a recorded position where it is coarser than `stated_m`; `None`: as stated, or no grid to be
/// seen.
///
/// The greatest common measure of the differences, by Euclid's algorithm on real numbers; then every
/// difference, the small ones first, sharpens it. Checked by: tests::a_coarser_step_is_read_off.
pub(crate) fn coarser_step(position_m: &[f64], stated_m: f64) -> Option<f64> {
    let stride = (position_m.len() / LOOKED_AT).max(1);
    let mut differences: Vec<f64> = position_m
        .windows(2)
        .step_by(stride)
        .map(|w| (w[1] - w[0]).abs())
        .filter(|d| *d > 0.3 * stated_m && *d > 1e-13)
        .collect();
    if differences.len() < 200 || stated_m <= 0.0 {
        return None;
    }
    differences.sort_by(f64::total_cmp);
    let measure = differences.iter().step_by(differences.len() / 200).copied();
    let step = measure.reduce(|a, b| common_measure(a, b, EUCLID_END * stated_m))?;
    let step = sharpened(step, &differences);
    (step > Criteria::STANDARD.other_step * stated_m && are_on_grid(&differences, step)).then_some(step)
}

/// True where differences are whole numbers of steps.
fn are_on_grid(differences: &[f64], step: f64) -> bool {
    let is_whole = |count: &f64| count.round() >= 1.0 && (count.round() - count).abs() < 0.05;
    let on_grid = differences.iter().map(|d| d / step).filter(is_whole).count();
    on_grid as f64 >= Criteria::STANDARD.on_grid * differences.len() as f64
}

/// The step of an encoder, m, that is coarser than `stated_m` in all of its recordings: positions in m, rates
/// in Hz. `None`: as stated, or what is seen is no step of an encoder, or not the same in all.
///
/// What is noisier than the step makes it is rounded to digits, or was reckoned. At an even speed rounding is
/// a line that may be less, and an axis that rests crosses no steps; what has everywhere less than half of it
/// is the sum of a rounded speed, whose ninth differences have 0.26.
/// Checked by: tests::a_step_is_told_beside_rest_and_even_speed_and_a_rounded_speed_has_none.
pub(crate) fn coarser_step_of_all(recordings: &[(Vec<f64>, f64)], stated_m: f64) -> Option<f64> {
    let coarser = Criteria::STANDARD.coarser_step;
    let step_m = recordings.iter().filter_map(|(x, _)| coarser_step(x, stated_m)).reduce(f64::max)?;
    let mut loudest = 0.0_f64;
    for (x, rate_hz) in recordings {
        let changes = x.windows(2).map(|w| (w[1] - w[0]).abs()).filter(|d| *d > 0.0);
        if !are_on_grid(&changes.collect::<Vec<f64>>(), step_m) {
            return None;
        }
        let noise_m2 = variance_across_steps_m2(x, *rate_hz, step_m).unwrap_or(0.0);
        loudest = loudest.max(12.0 * noise_m2 / step_m.powi(2));
    }
    let is_of_step = (0.5..coarser.powi(2)).contains(&loudest);
    (is_of_step && step_m > coarser * stated_m).then_some(step_m)
}

/// What steps of `step_m` add to a position, m: the read value less the line between the middles of two runs
/// of equal values that are one step apart, no more than half a step; nothing elsewhere.
pub(crate) fn off_steps_m(position_m: &[f64], step_m: f64) -> Vec<f64> {
    let mut out = vec![0.0; position_m.len()];
    let runs: Vec<&[f64]> = position_m.chunk_by(|a, b| a == b).collect();
    let mut first = 0;
    for pair in runs.windows(2) {
        let second = first + pair[0].len();
        let middle = |start: usize, run: &[f64]| start as f64 + 0.5 * (run.len() as f64 - 1.0);
        let [from, to] = [middle(first, pair[0]), middle(second, pair[1])];
        let way_m = pair[1][0] - pair[0][0];
        if (way_m / step_m).round().abs() <= 1.0 {
            for k in from.ceil() as usize..=to as usize {
                let line_m = pair[0][0] + way_m * (k as f64 - from) / (to - from);
                out[k] = (position_m[k] - line_m).clamp(-0.5 * step_m, 0.5 * step_m);
            }
        }
        first = second;
    }
    out
}

/// Greatest common measure of two lengths; a rest below `end` is none.
fn common_measure(mut a: f64, mut b: f64, end: f64) -> f64 {
    while b > end {
        (a, b) = (b, (a - (a / b).round() * b).abs());
    }
    a
}

/// Least squares over the whole numbers of steps, from the smallest differences on: each part is only as long
/// as what the parts before it can count.
fn sharpened(mut step: f64, sorted: &[f64]) -> f64 {
    let (mut numerator, mut denominator) = (0.0, 0.0);
    for d in sorted {
        let count = (d / step).round();
        if count >= 1.0 && (d / step - count).abs() < 0.2 {
            numerator += count * d;
            denominator += count * count;
            step = numerator / denominator;
        }
    }
    step
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ramp(step: f64) -> Vec<f64> {
        (0..20_000).map(|k| 1e-3 * (k as f64 * 1e-3).sin()).map(|x| (x / step).round() * step).collect()
    }

    #[test]
    fn a_coarser_step_is_read_off() {
        let found = coarser_step(&ramp(40e-9), 0.244e-9);
        assert!(found.is_some_and(|s| (s / 40e-9 - 1.0).abs() < 1e-3), "{found:?}");
        assert_eq!(coarser_step(&ramp(0.244e-9), 0.244e-9), None);
        // No two samples are nearer than some dozens of steps.
        let quick: Vec<f64> =
            (0..20_000).map(|k| 2e-7 * f64::from(k) + 1e-5 * (0.1 * f64::from(k)).sin()).collect();
        let quick: Vec<f64> = quick.iter().map(|x| (x / 5.3e-9).round() * 5.3e-9).collect();
        let found = coarser_step(&quick, 0.244e-9);
        assert!(found.is_some_and(|s| (s / 5.3e-9 - 1.0).abs() < 1e-6), "{found:?}");
        let noisy: Vec<f64> =
            quick.iter().enumerate().map(|(k, x)| x + 1e-9 * (k as f64 * 0.77).sin()).collect();
        assert_eq!(coarser_step(&noisy, 0.244e-9), None);
    }

    #[test]
    fn a_step_is_told_beside_rest_and_even_speed_and_a_rounded_speed_has_none() {
        let step_m = 1e-6;
        let rounded = |x: &dyn Fn(f64) -> f64| -> (Vec<f64>, f64) {
            ((0..40_000).map(|k| (x(f64::from(k) * 1e-4) / step_m).round() * step_m).collect(), 1e4)
        };
        let swings = rounded(&|t| 3e-3 * (9.0 * t).sin());
        let even = rounded(&|t| 0.0075 * t);
        let creeps = rounded(&|t| 5e-5 * (0.7 * t).sin());
        let read = [swings.clone(), even, creeps];
        let told = coarser_step_of_all(&read, 2e-8);
        assert!(told.is_some_and(|s| (s / step_m - 1.0).abs() < 1e-6), "{told:?}");
        assert_eq!(coarser_step_of_all(&read, 0.7e-6), None, "as stated");
        let finer = (0..40_000).map(|k| (2.3e-9 * f64::from(k) / 2e-8).round() * 2e-8).collect();
        assert_eq!(coarser_step_of_all(&[swings.clone(), (finer, 1e4)], 2e-8), None, "of one recording");
        // A speed in steps, added up: less noise than its steps have as those of a position.
        let mut x = 0.0;
        let speed = |k: i32| 27e-7 * (9e-4 * f64::from(k)).cos();
        let of_speed = (0..40_000).map(|k| {
            x += (speed(k) / step_m + 0.3 * f64::from(k % 7) / 7.0).round() * step_m;
            x
        });
        assert_eq!(coarser_step_of_all(&[(of_speed.collect(), 1e4)], 2e-8), None);
        // Digits of a noisy position.
        let noisy = swings.0.iter().enumerate();
        let noisy = noisy.map(|(k, x)| x + (3.0 * ((k * k) as f64).sin()).round() * step_m).collect();
        assert_eq!(coarser_step_of_all(&[(noisy, 1e4)], 2e-8), None);
    }

    #[test]
    fn what_steps_add_is_read_off_between_their_middles() {
        // Four samples a step, then one step a sample.
        let slow = (0..40).map(|k| f64::from(k / 4));
        let x: Vec<f64> = slow.chain((0..10).map(|k| 10.0 + f64::from(k))).collect();
        let off = off_steps_m(&x, 1.0);
        for (k, off) in off.iter().enumerate().take(36).skip(2) {
            let line = (k as f64 - 1.5) / 4.0;
            assert!((off - (x[k] - line)).abs() < 1e-12, "{k}: {off}");
        }
        assert!(off[40..].iter().all(|o| o.abs() < 1e-12), "{off:?}");
        // Where a rest ends steps are jumped over: they tell of no line.
        let rests: Vec<f64> = (0..100).map(|k| f64::from((k - 60).max(0) * 7)).collect();
        assert!(off_steps_m(&rests, 1.0).iter().all(|o| *o == 0.0));
        assert_eq!(off_steps_m(&[2.0; 5], 1.0), [0.0; 5]);
        assert!(off_steps_m(&[], 1.0).is_empty());
    }
}
