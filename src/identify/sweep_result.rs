//! What a fit to a sweep says of the drive: values in the keys of a model file, with intervals.

use super::fitted_drive::{FittedMode, FittedParameter};
use super::sweep_fit::{Fit, Unknown};
use crate::plant::drive::{DriveParams, RawDriveParams, Structure};
use crate::plant::effects::torsional_mode::stiffness_of;
use crate::units::Z95;
use std::f64::consts::TAU;

/// Damping ratio that a torsional mode starts from.
const START_DAMPING_RATIO: f64 = 0.02;

/// A two-inertia drive with half of its inertia behind a torsional spring that puts the free-free mode at
/// `mode_hz`. `None` where that is no drive.
pub(super) fn with_torsion(prior: &DriveParams, mode_hz: f64) -> Option<DriveParams> {
    let half = 0.5 * prior.rotary_inertia_kg_m2();
    let stiffness = stiffness_of(mode_hz, half, half);
    DriveParams::new(RawDriveParams {
        rotary_inertia_kg_m2: Some(half),
        screw_inertia_kg_m2: Some(half),
        torsional_stiffness_nm_rad: Some(stiffness),
        torsional_damping_nm_s_rad: Some(2.0 * START_DAMPING_RATIO * (stiffness * half).sqrt()),
        ..prior.raw().clone()
    })
    .ok()
}

/// A value of the result: where it stands, what it is of the parameters, what errs beside noise.
struct Row<'a> {
    name: &'static str,
    field: &'a mut Option<f64>,
    value: &'a dyn Fn(&[f64]) -> f64,
    /// One standard deviation of what no sweep shows.
    stated: f64,
}

impl Fit<'_> {
    /// The drive with fitted values in place, and what was fitted. `lumped`: the inertias before and behind
    /// a torsional spring as the one that a two-inertia model has.
    pub(super) fn result(&self, lumped: Option<&DriveParams>) -> (RawDriveParams, Vec<FittedParameter>) {
        let mut raw = lumped.unwrap_or(self.prior).raw().clone();
        let mut fitted = Vec::new();
        for (i, unknown) in self.unknowns.iter().enumerate() {
            use Unknown as U;
            if lumped.is_some()
                && matches!(unknown, U::ScrewMass | U::TorsionalStiffness | U::TorsionalDamping)
            {
                continue;
            }
            let screw = self.unknowns.iter().position(|u| lumped.is_some() && *u == U::ScrewMass);
            let (factor, offset) = self.as_stated(*unknown);
            let screw = screw.filter(|_| *unknown == U::MotorMass);
            let value = |p: &[f64]| (p[i] + screw.map_or(0.0, |s| p[s])) * factor + offset;
            let (name, field) = place(*unknown, &mut raw);
            let stated = match unknown {
                U::CommonDelay => self.instants_s(),
                U::StageExtraDelay => 0.0,
                U::CurrentBandwidth => self.stated.current_lag * value(&self.parameters),
                _ => self.stated.torque_constant * (value(&self.parameters) - offset),
            };
            fitted.push(self.row(Row { name, field, value: &value, stated }));
        }
        (raw, fitted)
    }

    fn instants_s(&self) -> f64 {
        self.stated.instants_s.unwrap_or(0.1 * self.period_s())
    }

    /// Factor and offset from a parameter of the fit to the key of a model.
    fn as_stated(&self, unknown: Unknown) -> (f64, f64) {
        use Unknown as U;
        let r2 = self.prior.travel_m_rad().powi(2);
        let (t_m, t_t) = (self.prior.motor_encoder_delay_s(), self.prior.stage_encoder_delay_s());
        let rigid = self.prior.structure() == Structure::Rigid;
        match unknown {
            U::MotorMass | U::MotorDamping | U::ScrewMass | U::TorsionalStiffness | U::TorsionalDamping => {
                (r2, 0.0)
            }
            U::StageMass if rigid => (1.0, -self.prior.reflected_mass_kg()),
            U::StageDamping if rigid => (1.0, -self.prior.reflected_damping_n_s_m()),
            U::CommonDelay => (1.0, if self.used[0] { -t_m } else { -t_t }),
            U::StageExtraDelay => (1.0, t_m),
            _ => (1.0, 0.0),
        }
    }

    fn row(&self, row: Row<'_>) -> FittedParameter {
        let Row { name, field, value, stated } = row;
        let best = value(&self.parameters);
        let noise = if self.explained { self.deviation_of(value) } else { f64::INFINITY };
        let reach = Z95 * noise.hypot(stated);
        // A damping or delay within its error of zero may come out below it: zero is what it is then.
        let least = ["damping", "delay", "dead_time"].iter().any(|part| name.contains(part));
        let kept = if least { best.max(0.0) } else { best };
        let prior = field.unwrap_or(0.0);
        *field = Some(kept);
        FittedParameter { name, prior, value: kept, noise, stated, ci95: [best - reach, best + reach] }
    }

    /// The torsional mode of a fit of three inertias.
    pub(super) fn mode(&self) -> Option<FittedMode> {
        use Unknown as U;
        let get = |u: U| self.unknowns.iter().position(|x| *x == u);
        let (motor, screw) = (get(U::MotorMass)?, get(U::ScrewMass)?);
        let (spring, damper) = (get(U::TorsionalStiffness)?, get(U::TorsionalDamping)?);
        let frequency_hz = |p: &[f64]| (p[spring] * (1.0 / p[motor] + 1.0 / p[screw])).sqrt() / TAU;
        let share = |p: &[f64]| p[screw] / (p[motor] + p[screw]);
        let p = &self.parameters;
        let real = p[spring] > 0.0 && p[motor] > 0.0 && p[screw] > 0.0;
        real.then(|| FittedMode {
            frequency_hz: frequency_hz(p),
            frequency_deviation_hz: self.deviation_of(frequency_hz),
            screw_share: share(p),
            share_deviation: self.deviation_of(share),
            damping_ratio: (0.5 * p[damper] / (p[spring] * p[screw]).sqrt()).clamp(1e-4, 0.95),
        })
    }
}

/// Key of the model file and its place.
fn place(unknown: Unknown, raw: &mut RawDriveParams) -> (&'static str, &mut Option<f64>) {
    use Unknown as U;
    match unknown {
        U::MotorMass => ("rotary_inertia_kg_m2", &mut raw.rotary_inertia_kg_m2),
        U::StageMass => ("movable_mass_kg", &mut raw.movable_mass_kg),
        U::Stiffness => ("axial_stiffness_n_m", &mut raw.axial_stiffness_n_m),
        U::StructuralDamping => ("structural_damping_n_s_m", &mut raw.structural_damping_n_s_m),
        U::MotorDamping => ("rotary_damping_nm_s_rad", &mut raw.rotary_damping_nm_s_rad),
        U::StageDamping => ("translational_damping_n_s_m", &mut raw.translational_damping_n_s_m),
        U::ScrewMass => ("screw_inertia_kg_m2", &mut raw.screw_inertia_kg_m2),
        U::TorsionalStiffness => ("torsional_stiffness_nm_rad", &mut raw.torsional_stiffness_nm_rad),
        U::TorsionalDamping => ("torsional_damping_nm_s_rad", &mut raw.torsional_damping_nm_s_rad),
        U::CommonDelay => ("amplifier_dead_time_s", &mut raw.amplifier_dead_time_s),
        U::StageExtraDelay => ("stage_encoder_delay_s", &mut raw.stage_encoder_delay_s),
        U::CurrentBandwidth => ("current_loop_bandwidth_rad_s", &mut raw.current_loop_bandwidth_rad_s),
    }
}
