//! What is known of bar and cut before anything is heard.

use super::conditions::{CutConditions, Means};
use super::criteria::Criteria;
use super::judge::DeafReason;
use super::model::{Condition, Noise, PARAMETERS, Parameters, place};
use crate::plant::cutting::Cutting;
use crate::plant::workpiece::{RawWorkpiece, Workpiece};
use std::f64::consts::PI;

/// What is stated of bar and cut; every number may be off by what [`Criteria::known`] says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutPrior {
    /// Bar; its clamp factor and damping ratio are first guesses.
    pub workpiece: Workpiece,
    /// Stiffness, width, feed and process damping.
    pub cutting: Cutting,
    /// Where the tools are along the bar, from the chuck, when nothing tells it: the free end.
    pub position_m: f64,
}

/// Middle of what steel bars in a chuck show: K_r 1.8 to 2.8 GPa, zeta 0.8 to 1.5 %, a clamp that takes 0 to
/// 3 % of the frequency, C_i of 20 to 80 N.
const USUAL_STIFFNESS_PA: f64 = 2.25e9;
const USUAL_DAMPING_RATIO: f64 = 0.0112;
const USUAL_CLAMP_FACTOR: f64 = 0.985;
const USUAL_PROCESS_DAMPING_N: f64 = 40.0;
/// Random part of the cutting force, of its mean: middle of 2 to 5 %.
const USUAL_RANDOM_SHARE: f64 = 0.0335;
/// Speeds outside of these are no turning, rpm.
const SPEEDS_RPM: std::ops::RangeInclusive<f64> = 30.0..=30_000.0;

impl CutPrior {
    /// A bar of which nothing but its size is known, cut as such bars are. Errors: a size that is none.
    pub fn usual(
        diameter_m: f64,
        length_m: f64,
    ) -> Result<Self, crate::plant::scenario_error::ScenarioError> {
        let raw = RawWorkpiece {
            diameter_m,
            projection_length_m: length_m,
            damping_ratio: USUAL_DAMPING_RATIO,
            clamp_factor: USUAL_CLAMP_FACTOR,
            ..RawWorkpiece::default()
        };
        let cutting = Cutting::new(crate::plant::cutting::RawCutting {
            radial_stiffness_pa: USUAL_STIFFNESS_PA,
            process_damping_n: USUAL_PROCESS_DAMPING_N,
            ..crate::plant::cutting::RawCutting::default()
        })?;
        let workpiece = Workpiece::new(raw)?;
        Ok(Self { workpiece, cutting, position_m: length_m })
    }

    /// Radial force of one tool as stated, N.
    pub(super) fn mean_n(&self) -> f64 {
        self.cutting.stiffness_n_m() * self.cutting.raw().feed_m_rev / 2.0
    }

    /// The sample's numbers, with what is stated where a column is missing. Errors: speed or pitch are not
    /// known, and with them the delays.
    pub(super) fn complete(&self, force_n: f64, told: &CutConditions) -> Result<Means, DeafReason> {
        let speed_rpm = told.spindle_speed_rpm.filter(|rpm| SPEEDS_RPM.contains(rpm));
        let rpm = speed_rpm.ok_or(DeafReason::SpeedUnknown)?;
        let cutting = self.cutting.raw();
        Ok(Means {
            force_n,
            turn_s: 60.0 / rpm,
            pitch_rad: told.pitch_difference_rad.ok_or(DeafReason::PitchUnknown)?,
            position_m: told.tool_position_m.unwrap_or(self.position_m),
            feed_m_rev: told.feed_m_rev.unwrap_or(cutting.feed_m_rev),
            width_m: told.width_m.unwrap_or(cutting.width_m),
            chatter_share: f64::from(u8::from(told.chatter)),
            count: 1.0,
        })
    }

    /// Means of the parameters before anything is heard.
    pub(super) fn means(&self) -> Parameters {
        let (bar, cutting) = (self.workpiece.raw(), self.cutting.raw());
        let mut mean = Parameters::zeros();
        mean[place::STIFFNESS] = cutting.radial_stiffness_pa.ln();
        mean[place::DAMPING] = bar.damping_ratio.max(1e-4).ln();
        mean[place::CLAMP] = bar.clamp_factor.ln();
        mean[place::PROCESS] = cutting.process_damping_n.max(1.0).ln();
        mean[place::LEVEL] = USUAL_RANDOM_SHARE.ln();
        mean
    }

    /// Their standard deviations, wider for what no column tells.
    pub(super) fn deviations(
        told: &CutConditions,
        mean_told: bool,
        criteria: &Criteria,
    ) -> [f64; PARAMETERS] {
        let mut known = criteria.known;
        if told.tool_position_m.is_none() {
            known[place::POSITION] = criteria.unknown_position;
        }
        if told.width_m.is_none() {
            known[place::STIFFNESS] = known[place::STIFFNESS].hypot(criteria.unknown_width);
        }
        if !mean_told {
            known[place::LEVEL] = criteria.unknown_level;
        }
        known
    }

    /// The model's conditions over a stretch. `stiffer`: the mean force over the chip area, over what it was
    /// when the cut began.
    pub(super) fn condition(&self, means: &Means, heard: &Heard) -> Condition {
        let bar = &self.workpiece;
        let surface_m_s = PI * bar.diameter_m() / means.turn_s;
        Condition {
            mass_kg: bar.modal_mass_kg(),
            rigid_rad_s: 2.0 * PI * bar.bending_frequency_hz() / bar.raw().clamp_factor,
            turn_s: means.turn_s,
            pitch_rad: means.pitch_rad,
            shape_squared: bar.mode_shape(means.position_m).powi(2).max(1e-3),
            width_m: means.width_m * heard.stiffer,
            process_s_m: means.width_m / self.cutting.raw().width_m.max(f64::MIN_POSITIVE) / surface_m_s,
            mean_n: heard.mean_n,
            force_hz: heard.force_hz,
            noise: heard.noise,
        }
    }
}

/// What the force itself tells of the conditions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Heard {
    pub(super) mean_n: f64,
    pub(super) stiffer: f64,
    pub(super) force_hz: f64,
    pub(super) noise: Noise,
}
