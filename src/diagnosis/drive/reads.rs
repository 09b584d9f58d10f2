//! Which positions a balance is made of, and the band in which they tell a force.

use super::one_mass::{Spring, spring};
use super::recorded::{motor_position, span, stage_position, thrust};
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::encoder_noise::variance_m2;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use crate::signal::inner_products::rms;
use std::f64::consts::TAU;

/// Lengths of a kernel that a recording holds at least.
pub(super) const KERNELS: f64 = 30.0;

/// How many balances there are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::diagnosis) enum Layout {
    /// Motor and stage, both positions.
    TwoPositions,
    /// One mass, one position.
    OnePosition,
    /// One position against a stage that is held: one mass on the axial spring.
    Locked,
}

/// Position and speed of one side at the full rate.
#[derive(Debug, Clone, Default)]
pub(super) struct Side {
    pub(super) x_m: Vec<f64>,
    /// For laws that are not linear: in a band that the encoder's steps leave clean.
    pub(super) v_m_s: Vec<f64>,
}

/// A position that a balance is made of, when it was read, and the mass that its noise goes through.
pub(super) struct Read {
    pub(super) x_m: Vec<f64>,
    pub(super) delay_s: f64,
    pub(super) mass_kg: f64,
}

impl Read {
    pub(super) fn noise_m2(&self, rate_hz: f64) -> f64 {
        variance_m2(&self.x_m, rate_hz)
    }
}

/// Motor and stage; of one position the motor, or the stage where there is no other, or it is to be that one.
pub(super) fn positions(
    axis: &AxisModel,
    recording: &Recording,
    (layout, by_stage): (Layout, bool),
) -> Vec<Read> {
    let d = &axis.drive;
    let mass_kg = match layout {
        Layout::TwoPositions => [d.reflected_mass_kg(), d.movable_mass_kg()],
        Layout::OnePosition => [d.total_mass_kg(); 2],
        // What is held does not move.
        Layout::Locked => [d.reflected_mass_kg(); 2],
    };
    let motor = motor_position(axis, recording).filter(|_| !by_stage);
    let has_stage = layout == Layout::TwoPositions || motor.is_none();
    let stage = stage_position(axis, recording).filter(|_| has_stage).map(<[f64]>::to_vec);
    let delay_s = [d.motor_encoder_delay_s(), d.stage_encoder_delay_s()];
    let read = |(k, x_m): (usize, Option<Vec<f64>>)| {
        x_m.map(|x_m| Read { x_m, delay_s: delay_s[k], mass_kg: mass_kg[k] })
    };
    [motor, stage].into_iter().enumerate().filter_map(read).collect()
}

/// True where the scale has less than half of the noise of the motor's encoder.
pub(super) fn stage_is_finer(axis: &AxisModel, recordings: &[Recording]) -> bool {
    recordings.iter().all(|r| {
        let (Some(motor), Some(stage)) = (motor_position(axis, r), stage_position(axis, r)) else {
            return false;
        };
        let rate_hz = r.sample_rate.hz();
        // One that never changes is of what is held.
        span(stage) > 0.0 && 4.0 * variance_m2(stage, rate_hz) < variance_m2(&motor, rate_hz)
    })
}

/// Up to where the noise of a position makes little force through the mass, Hz.
///
/// White noise of variance s^2 below f: rms M s (2 pi f)^2 (2 f / (5 rate))^(1/2).
pub(super) fn clean_band_hz(axis: &AxisModel, recording: &Recording, (mass_kg, noise_m2): (f64, f64)) -> f64 {
    let rate_hz = recording.sample_rate.hz();
    let Ok(thrust) = thrust(axis, recording) else { return f64::INFINITY };
    let allowed_n = Criteria::STANDARD.repeatability * deviation(&thrust.reference_n);
    let per_hz = mass_kg * noise_m2.sqrt() * TAU * TAU * (0.4 / rate_hz).sqrt();
    let least_hz = KERNELS * rate_hz / recording.len().max(1) as f64;
    (allowed_n / per_hz.max(1e-300)).powf(0.4).max(least_hz)
}

/// The stage of an axis that is taken as one mass: its spring as stated, else as both positions tell it.
pub(super) fn stage_behind(axis: &AxisModel, recordings: &[Recording]) -> Option<Spring> {
    let d = &axis.drive;
    let k = d.axial_stiffness_n_m();
    let stated = Spring { swing_rad2_s2: k / d.movable_mass_kg(), wound_m: d.stage_coulomb_friction_n() / k };
    if k > 0.0 { Some(stated) } else { spring(axis, recordings) }
}

/// At w the stage of an axis that is taken as one mass lags by (w / swing)^2 of its inertia: by the tolerance
/// of a mass at most.
pub(super) fn band_hz((layout, rate_hz): (Layout, f64), one_mass: Option<Spring>) -> f64 {
    let c = &Criteria::STANDARD;
    let widest = (c.band_share[usize::from(layout != Layout::TwoPositions)] * rate_hz).min(c.band_hz);
    one_mass.map_or(widest, |s| widest.min((c.mass_tolerance * s.swing_rad2_s2).sqrt() / TAU))
}

/// Root mean square about the mean.
fn deviation(x: &[f64]) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
    rms(&x.iter().map(|x| x - mean).collect::<Vec<f64>>())
}
