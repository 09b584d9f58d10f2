//! What is settled before any physics is asked for: that something moves, signs, units, the lead.
//!
//! Seen on means over blocks of 10 ms: slow enough that neither an encoder's steps nor a resonance count.

use super::criteria::{Criteria, Z95};
use super::cuts::Mask;
use super::drive::recorded::{is_locked, position, span, thrust};
use super::{Correction, DiagnoseError};
use crate::plant::effects::backlash::play;
use crate::plant::machine::AxisModel;
use crate::sample::Recording;
use crate::signal::inner_products::dot;

/// Blocks that are averaged, s.
const BLOCK_S: f64 = 0.01;
/// Fewest blocks that say something.
const LEAST_BLOCKS: usize = 16;
/// Refuses recordings of which nothing can be told. A recording without the columns has its own error later.
/// The answer: which of them the axis stands in.
///
/// `masks`: per recording, rows in which motion tells nothing; empty: none.
pub(super) fn check(
    axis: &AxisModel,
    recordings: &[Recording],
    masks: &[Mask],
) -> Result<Vec<bool>, DiagnoseError> {
    let mask = |k: usize| masks.get(k).map_or(&[][..], Vec::as_slice);
    let looks: Vec<Option<Look<'_>>> =
        recordings.iter().enumerate().map(|(k, r)| Look::new(axis, r, mask(k))).collect();
    let stands: Vec<bool> = looks.iter().map(|l| l.as_ref().is_some_and(Look::stands)).collect();
    if stands.iter().all(|s| *s) {
        let recordings: Vec<&str> = recordings.iter().map(|r| r.experiment.as_str()).collect();
        return Err(DiagnoseError::Standing { axis: axis.name.clone(), recordings: recordings.join(", ") });
    }
    looks.iter().flatten().filter(|l| l.motor_m.len() >= LEAST_BLOCKS).try_for_each(|look| {
        look.check_travel()?;
        look.check_sign()
    })?;
    Ok(stands)
}

/// The lead with which the motor's angle and the scale have one travel, where that is another than stated and
/// no unit explains it: told by the recording that knows it best, and by none otherwise.
///
/// `masks`: as for [`check`].
pub(super) fn other_lead(axis: &AxisModel, recordings: &[Recording], masks: &[Mask]) -> Option<Correction> {
    let stated_m = axis.drive.screw_lead_m()?;
    let mask = |k: usize| masks.get(k).map_or(&[][..], Vec::as_slice);
    let looks = recordings.iter().enumerate().filter_map(|(k, r)| Look::new(axis, r, mask(k)));
    let all: Vec<Travel> = looks.filter_map(|l| l.travel()).collect();
    let best = all.iter().min_by(|a, b| a.half.total_cmp(&b.half))?;
    let one = all.iter().all(|t| !is_off(t.ratio / best.ratio));
    let angle = format!("{}_motor_angle_rad", axis.name);
    let by_angle = recordings.iter().all(|r| r.get(&angle).is_some());
    let is_lead = by_angle && one && is_off(best.ratio) && unit_for(best.ratio).is_none();
    let value = stated_m / best.ratio;
    is_lead.then(|| Correction::within("screw_lead_m", stated_m, value, value * best.half / best.ratio))
}

/// Travel of the motor over that of the stage, and half of its 95 % interval.
struct Travel {
    ratio: f64,
    half: f64,
}

/// One recording in blocks, each series about its mean.
struct Look<'a> {
    axis: &'a AxisModel,
    recording: &'a Recording,
    block_s: f64,
    thrust_n: Vec<f64>,
    motor_m: Vec<f64>,
    stage_m: Option<Vec<f64>>,
    /// Blocks in which motion tells something.
    told: Vec<bool>,
}

impl<'a> Look<'a> {
    fn new(axis: &'a AxisModel, recording: &'a Recording, mask: &[bool]) -> Option<Self> {
        let (force, x) = (thrust(axis, recording).ok()?.reference_n, position(axis, recording).ok()?);
        let rate_hz = recording.sample_rate.hz();
        let block = ((BLOCK_S * rate_hz).round() as usize).max(1);
        let stage = recording.get(&format!("{}_stage_position_m", axis.name));
        Some(Self {
            axis,
            recording,
            block_s: block as f64 / rate_hz,
            thrust_n: blocks(&force, block),
            motor_m: blocks(&x, block),
            stage_m: stage.map(|x| blocks(x, block)),
            told: (0..x.len() / block)
                .map(|k| !mask.get(k * block..(k + 1) * block).is_some_and(|rows| rows.iter().any(|m| *m)))
                .collect(),
        })
    }

    fn stands(&self) -> bool {
        let c = &Criteria::STANDARD;
        let still = |x: &[f64], step_m: f64| {
            let told: Vec<f64> =
                x.iter().zip(&self.told).filter(|(_, told)| **told).map(|(x, _)| *x).collect();
            span(&told) <= c.slides_m.max(c.still_steps * step_m)
        };
        let d = &self.axis.drive;
        still(&self.motor_m, d.motor_encoder_resolution_m())
            && self.stage_m.as_ref().is_none_or(|x| still(x, d.stage_encoder_resolution_m()))
    }

    /// Of both encoders, where they have one form: the stretch, as thrust, friction and play have it, aside.
    /// What is left of the motor's travel counts whole, since it is no noise.
    fn travel(&self) -> Option<Travel> {
        let stage_m = self.stage_m.as_ref()?;
        let (c, d) = (&Criteria::STANDARD, &self.axis.drive);
        let stretch_m =
            if d.axial_stiffness_n_m() > 0.0 { span(&self.thrust_n) / d.axial_stiffness_n_m() } else { 0.0 };
        let step_m = c.still_steps * d.motor_encoder_resolution_m();
        // What stretch and steps may be of it is what the ratio may be off by.
        let least_m = c.tells_m.max(stretch_m.max(step_m) / c.travel_off);
        if span(&self.motor_m) < least_m && span(stage_m) < least_m || is_locked(self.axis, self.recording) {
            return None;
        }
        let along = |of: &[f64], by: &[f64]| dot(of, by) / dot(by, by).max(f64::MIN_POSITIVE);
        let without = |of: &[f64], by: &[f64]| -> Vec<f64> {
            let share = along(of, by);
            of.iter().zip(by).map(|(of, by)| of - share * by).collect()
        };
        let velocity = about_mean((0..stage_m.len()).map(|k| slope(stage_m, k)).collect());
        let [mut motor, mut stage] = [self.motor_m.clone(), stage_m.clone()];
        let mut stretched: Vec<Vec<f64>> = Vec::new();
        let way_m = c.slides_m.max(step_m).max(c.still_steps * d.stage_encoder_resolution_m());
        for by in [self.thrust_n.clone(), about_mean(play(stage_m, 0.0, way_m)), velocity] {
            let by = stretched.iter().fold(by, |by, other| without(&by, other));
            (motor, stage) = (without(&motor, &by), without(&stage, &by));
            stretched.push(by);
        }
        // Strokes of one form are all friction and inertia.
        if span(&motor) < least_m && span(&stage) < least_m {
            return None;
        }
        let ratio = along(&motor, &stage);
        let left = without(&motor, &stage);
        let told = dot(&left, &left) <= c.travel_off * dot(&motor, &motor);
        let half = Z95 * (dot(&left, &left) / dot(&stage, &stage).max(f64::MIN_POSITIVE)).sqrt();
        told.then_some(Travel { ratio, half })
    }

    /// Both encoders see one travel: another unit, a wrong scale or a turned sign shows in their ratio.
    fn check_travel(&self) -> Result<(), DiagnoseError> {
        match self.travel() {
            Some(Travel { ratio, .. }) if is_off(ratio) => Err(DiagnoseError::TravelRatio {
                recording: self.recording.experiment.clone(),
                axis: self.axis.name.clone(),
                ratio,
                hint: unit_for(ratio).unwrap_or("check screw_lead_m and the units of both columns"),
            }),
            _ => Ok(()),
        }
    }

    /// Thrust and motion belong together by the stated mass and friction; with the sign of one of them turned
    /// they do so, too, and everything that is found then makes up for it.
    fn check_sign(&self) -> Result<(), DiagnoseError> {
        let (c, d) = (&Criteria::STANDARD, &self.axis.drive);
        if span(&self.motor_m) < c.tells_m || is_locked(self.axis, self.recording) {
            return Ok(());
        }
        let smoothing_m_s = d.friction_smoothing_m_s();
        let dry_n = d.stage_coulomb_friction_n() + d.motor_coulomb_friction_n();
        let wet_n_s_m = d.translational_damping_n_s_m() + d.reflected_damping_n_s_m();
        let x = &self.motor_m;
        let velocity: Vec<f64> = x.windows(3).map(|w| (w[2] - w[0]) / (2.0 * self.block_s)).collect();
        let inertia: Vec<f64> = x
            .windows(3)
            .map(|w| d.total_mass_kg() * (w[0] - 2.0 * w[1] + w[2]) / self.block_s.powi(2))
            .collect();
        let friction = velocity.iter().map(|v| wet_n_s_m * v + dry_n * (v / smoothing_m_s).tanh()).collect();
        // The second difference of means is the acceleration under a triangle of two blocks.
        let thrust = self.thrust_n.windows(3).map(|w| (w[0] + 4.0 * w[1] + w[2]) / 6.0).collect();
        let [f, i, r] = [thrust, inertia, friction].map(about_mean);
        let (ff, ii, rr) = (dot(&f, &f), dot(&i, &i), dot(&r, &r));
        let (fi, fr, ir) = (dot(&f, &i), dot(&f, &r), dot(&i, &r));
        let explained = -(2.0 * (fi + fr) + ii + rr + 2.0 * ir) / ff.max(1e-300);
        // Inertia and friction, fitted beside each other, each against the motion.
        let against = |own: f64, other: f64, power: f64, beside: f64| {
            power < c.silent * ff || own * beside - other * ir < 0.0
        };
        if 1.0 - explained > c.adequate_share || !against(fi, fr, ii, rr) || !against(fr, fi, rr, ii) {
            return Ok(());
        }
        Err(DiagnoseError::OppositeSign {
            recording: self.recording.experiment.clone(),
            axis: self.axis.name.clone(),
            percent: 100.0 * explained,
        })
    }
}

/// Means of consecutive blocks, about their own mean.
fn blocks(x: &[f64], block: usize) -> Vec<f64> {
    let origin = x.first().copied().unwrap_or(0.0);
    let mean = |b: &[f64]| b.iter().map(|v| v - origin).sum::<f64>() / b.len() as f64;
    about_mean(x.chunks_exact(block).map(mean).collect())
}

/// Half the difference of both neighbours.
fn slope(x: &[f64], k: usize) -> f64 {
    0.5 * (x[(k + 1).min(x.len() - 1)] - x[k.saturating_sub(1)])
}

fn about_mean(x: Vec<f64>) -> Vec<f64> {
    let mean = x.iter().sum::<f64>() / x.len().max(1) as f64;
    x.iter().map(|v| v - mean).collect()
}

/// True where two travels are not one.
fn is_off(ratio: f64) -> bool {
    (ratio - 1.0).abs() > Criteria::STANDARD.travel_off
}

/// What a ratio of travels looks like that is no matter of the lead.
fn unit_for(ratio: f64) -> Option<&'static str> {
    let near = |of: f64| !is_off(ratio.abs() / of);
    let degrees = 180.0 / std::f64::consts::PI;
    Some(if ratio < 0.0 {
        "one of the two counts in the other direction"
    } else if near(degrees) {
        "is the motor's angle in degrees instead of rad?"
    } else if near(1.0 / std::f64::consts::TAU) {
        "is the motor's angle in turns instead of rad?"
    } else if near(1e-3) {
        "is the stage's position in mm instead of m?"
    } else if near(1e3) {
        "is the motor's position, or the lead, in mm instead of m?"
    } else {
        return None;
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::drive::{DriveParams, RawDriveParams};
    use crate::sample::Column;
    use crate::units::SampleRate;

    /// An axis of 10 kg with 5 N of friction that swings by 20 mm, its current and motor scaled.
    fn seen(thrust_times: f64, motor_times: f64, swing_m: f64) -> Result<Vec<bool>, DiagnoseError> {
        let raw = RawDriveParams {
            rotary_inertia_kg_m2: Some(1e-6),
            screw_lead_m: Some(5e-3),
            movable_mass_kg: Some(10.0),
            axial_stiffness_n_m: Some(1e7),
            stage_coulomb_friction_n: Some(5.0),
            ..Default::default()
        };
        let axis = AxisModel {
            name: "x".into(),
            drive: DriveParams::new(raw).unwrap(),
            controller: None,
            physics: Vec::new(),
        };
        let w = 6.0;
        let series = |f: &dyn Fn(f64) -> f64| (0..4000).map(|k| f(f64::from(k) * 1e-3)).collect::<Vec<f64>>();
        let mass_kg = axis.drive.total_mass_kg();
        let thrust = |t: f64| {
            let (v, a) = (swing_m * w * (w * t).cos(), -swing_m * w * w * (w * t).sin());
            thrust_times * (mass_kg * a + 5.0 * (v / 1e-4).tanh() + 30.0)
        };
        let column = |name: &str, values| Column { name: name.into(), values };
        let recording = Recording {
            sample_rate: SampleRate::new(1000.0).unwrap(),
            experiment: "swing".into(),
            axes: vec!["x".into()],
            columns: vec![
                column("x_thrust_ref_n", series(&thrust)),
                column("x_motor_position_m", series(&|t| motor_times * swing_m * (w * t).sin())),
                column("x_stage_position_m", series(&|t| swing_m * (w * t).sin())),
            ],
            start_s: 0.0,
            metadata: Vec::new(),
        };
        check(&axis, &[recording], &[])
    }

    #[test]
    fn a_turned_sign_a_unit_and_an_axis_at_rest_are_refused() {
        assert_eq!(seen(1.0, 1.0, 0.02), Ok(vec![false]));
        assert_eq!(seen(1.3, 1.03, 0.02), Ok(vec![false]), "numbers may be off");
        assert!(matches!(seen(-1.0, 1.0, 0.02), Err(DiagnoseError::OppositeSign { .. })));
        let degrees = seen(1.0, 180.0 / std::f64::consts::PI, 0.02);
        assert!(matches!(degrees, Err(DiagnoseError::TravelRatio { hint, .. }) if hint.contains("degrees")));
        assert!(matches!(seen(1.0, 1.0, 0.0), Err(DiagnoseError::Standing { .. })));
        assert!(matches!(seen(1.0, 1.0, 1.5e-6), Err(DiagnoseError::Standing { .. })), "what a cut deflects");
    }
}
