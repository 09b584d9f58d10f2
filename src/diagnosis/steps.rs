//! Steps of an encoder, read off the recording itself: every difference of two samples is a whole number of
//! steps.

use super::criteria::Criteria;
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
    let on_grid = differences.iter().filter(|d| ((*d / step).round() - *d / step).abs() < 0.05).count();
    let c = &Criteria::STANDARD;
    let all_on_grid = on_grid as f64 > c.on_grid * differences.len() as f64;
    (step > c.other_step * stated_m && all_on_grid).then_some(step)
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
}
