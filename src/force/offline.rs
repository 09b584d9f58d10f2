//! Whole runs through the estimators: idle maps, the check of stiffness, the zero of a standing axis.

use super::balance::Method;
use super::estimator::ForceEstimator;
use super::idle_map::{IdleMap, IdlePoint, LEAST_TRAVEL_M};
use super::motion::{ForceEstimate, MotionSample};
use super::response::Chain;
use super::settings::{ForceError, ForceSettings, LowPass};
use super::signals::AxisSignals;
use super::stiffness::{StiffnessCheck, motor_side_balance, stiffness_check, stretch_balance};
use crate::plant::drive::Structure;

/// Every estimate of a run; the filters start settled on its first sample.
#[must_use]
pub fn estimate_run(estimator: &ForceEstimator, samples: &[MotionSample]) -> Vec<ForceEstimate> {
    let Some(first) = samples.first() else { return Vec::new() };
    let mut state = estimator.settled(first);
    samples.iter().map(|s| estimator.step(&mut state, s)).collect()
}

/// Disturbance by position from idle runs through the same estimator (which must have no map itself).
///
/// Each force is put where the axis was when it acted. `None` where no run moves.
#[must_use]
pub fn idle_map(bare: &ForceEstimator, runs: &[Vec<MotionSample>]) -> Option<IdleMap> {
    let (points, contradictions): (Vec<_>, Vec<_>) = runs.iter().map(|run| idle_points(bare, run)).unzip();
    let mut contradictions: Vec<f64> = contradictions.into_iter().flatten().collect();
    contradictions.sort_by(f64::total_cmp);
    let median_n = contradictions.get(contradictions.len() / 2).copied().unwrap_or(0.0);
    Some(IdleMap::from_runs(&points)?.with_contradiction(median_n))
}

/// Where the disturbance was, and what both sides of the axis contradicted each other by meanwhile, N rms.
fn idle_points(bare: &ForceEstimator, samples: &[MotionSample]) -> (Vec<IdlePoint>, Vec<f64>) {
    let Some(first) = samples.first() else { return (Vec::new(), Vec::new()) };
    let mut state = bare.settled(first);
    let mut contradictions = Vec::new();
    let steps: Vec<_> = samples
        .iter()
        .map(|sample| {
            let step = bare.step_with_motion(&mut state, sample);
            let contradiction_n = bare.contradiction_n(&state);
            contradictions.extend((contradiction_n > 0.0).then_some(contradiction_n));
            step
        })
        .collect();
    let late = bare.filter_delay_samples();
    let skip = bare.properties().settling_samples;
    let points = (skip..steps.len().saturating_sub(late))
        .map(|i| IdlePoint {
            position_m: bare.position_m(&steps[i].1),
            velocity_m_s: bare.travel_velocity_m_s(&steps[i].1),
            force_n: steps[i + late].0.force_n,
        })
        .collect();
    (points, contradictions)
}

/// Compares both ways to the axial force below a quarter of the first resonance, idle runs taken off.
///
/// `None` on a rigid axis, without both encoders, or where the forces do not vary.
/// Errors: as [`ForceEstimator::new`].
pub fn stiffness_of_runs(
    axis: &AxisSignals<'_>,
    cut: &[MotionSample],
    idles: &[Vec<MotionSample>],
) -> Result<Option<StiffnessCheck>, ForceError> {
    // With a third position compliance elsewhere is seen as it is.
    if axis.drive.structure() == Structure::Rigid || axis.signals != super::signals::Signals::Both {
        return Ok(None);
    }
    let resonance_hz = Chain::of_drive(axis.drive).modes().frequencies_hz.get(1).copied().unwrap_or(0.0);
    let pass_hz = (0.25 * resonance_hz).min(0.1 * axis.rate.hz());
    let low_pass = LowPass::LinearPhase { pass_hz, width_hz: pass_hz / 2.0 };
    let mut sides = Vec::with_capacity(2);
    for balance in [motor_side_balance(axis.drive), stretch_balance(axis.drive)] {
        let mut settings = ForceSettings { low_pass, compare_sides: false, ..ForceSettings::default() };
        if !idles.is_empty() {
            let bare = ForceEstimator::from_balance(Method::Medob, balance, axis, settings.clone())?;
            settings.idle_map = idle_map(&bare, idles);
        }
        let estimator = ForceEstimator::from_balance(Method::Medob, balance, axis, settings)?;
        // Half a second at either end: ramps and standstill, where no idle map holds.
        let skip = estimator.properties().settling_samples.max((0.5 * axis.rate.hz()) as usize);
        let forces = estimate_run(&estimator, cut);
        let end = forces.len().saturating_sub(skip);
        sides.push(forces.get(skip..end).unwrap_or(&[]).iter().map(|f| f.force_n).collect::<Vec<f64>>());
    }
    Ok(stiffness_check(&sides[0], &sides[1]))
}

/// Mean of the first stretch of an axis that stands still throughout, where that stretch is quiet
/// against the rest and its mean is within friction: below friction the zero of a standing axis is
/// not observable, and the quiet start is taken for it.
///
/// `None` where the axis moves, where the start is not quiet, or where its mean exceeds `friction_n`.
#[must_use]
pub fn standing_zero_n(
    estimates: &[f64],
    travel_m: &[f64],
    friction_n: f64,
    samples_per_part: usize,
) -> Option<f64> {
    let (low, high) =
        travel_m.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), x| (a.min(*x), b.max(*x)));
    let parts: Vec<(f64, f64)> = estimates
        .chunks_exact(samples_per_part.max(2))
        .map(|part| {
            let mean = part.iter().sum::<f64>() / part.len() as f64;
            let power = part.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / part.len() as f64;
            (mean, power.sqrt())
        })
        .collect();
    let (mean, deviation) = *parts.first()?;
    let largest = parts.iter().map(|p| p.1).fold(0.0, f64::max);
    (high - low < LEAST_TRAVEL_M && deviation < 0.2 * largest && mean.abs() < friction_n).then_some(mean)
}
