//! A second mass that two encoders show and a model of one mass leaves out.

use super::one_mass::spring;
use super::signals::{Layout, layout};
use crate::diagnosis::criteria::Criteria;
use crate::plant::drive::{DriveParams, Structure};
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use std::f64::consts::TAU;

/// The axis as two masses where its model has one and both encoders show that it is not: a half at either end
/// of a spring on which the stage swings as recorded. A beginning: what each end has is told by the balance.
/// `None`: it is no model of one mass, or the encoders do not resolve the stretch.
pub(super) fn two_masses(axis: &AxisModel, recordings: &[Recording]) -> Option<AxisModel> {
    let d = &axis.drive;
    if d.structure() != Structure::Rigid {
        return None;
    }
    let found = spring(axis, recordings)?;
    let rate_hz = recordings.first()?.sample_rate.hz();
    let half_kg = 0.5 * d.total_mass_kg();
    let mut raw = d.raw().clone();
    raw.movable_mass_kg = Some(half_kg);
    raw.rotary_inertia_kg_m2 = Some(half_kg * d.travel_m_rad().powi(2));
    raw.axial_stiffness_n_m = Some(half_kg * found.swing_rad2_s2);
    // A mass without a lead is no axis with a motor.
    d.screw_lead_m()?;
    let two = AxisModel { drive: DriveParams::new(raw).ok()?, ..axis.clone() };
    let is_in_band = found.swing_rad2_s2.sqrt() < TAU * Criteria::STANDARD.band_share[0] * rate_hz;
    (is_in_band && layout(&two, recordings) == Layout::TwoPositions).then_some(two)
}
