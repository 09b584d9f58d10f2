//! The proof in simulation: model and machine given the same command, each in its own closed loop.
//!
//! The force balance that names a cause differentiates what was measured. Here nothing measured is
//! differentiated or fitted: the stated model, the model with its numbers re-estimated and the model with the
//! findings run under the recorded command, and what they would have told the drive stands beside what it was
//! told. Before physics comes the control law: where the stated one does not say the recorded reference, no
//! simulation proves anything.

use super::floor::band_gain;
use super::motion;
use super::problem::{Column, Mechanics, Problem, Sides};
use super::result::{ClosedLoop, SimulatedTrial};
use super::search::Outcome;
use super::two_cores::on_two_cores;
use crate::force::closed_loop;
use crate::plant::drive::{DriveParams, RawDriveParams};
use crate::plant::machine::{AxisModel, Controller};
use crate::sample::Recording;
use crate::signal::inner_products::rms;
use crate::signal::straight_line::straight_line;
use crate::simulation::model_axis::{LoopRecord, Replay, Response, Trial, not_simulated, replay, respond};
use crate::units::SampleRate;

/// Share of the reference's changes that a control law may leave and still be the one that acted.
const LAW_SHARE: f64 = 0.02;
/// Blocks over which the stretch is averaged before it is compared, s.
const STRETCH_BLOCK_S: f64 = 0.05;
/// First samples that the velocity at the start is taken from.
const START_SAMPLES: usize = 20;

/// The recordings as a loop sees them: what command and law were, and what came of them.
pub(super) struct Rig<'a> {
    p: &'a Problem,
    records: Vec<LoopRecord>,
    trials: Vec<Trial>,
    law: Replay,
}

impl<'a> Rig<'a> {
    /// Errors: in a person's words why nothing can be simulated.
    pub(super) fn new(stated: &AxisModel, recordings: &[Recording], p: &'a Problem) -> Result<Self, String> {
        let controller = stated.controller.ok_or("the model states no controller")?;
        let records: Vec<LoopRecord> =
            recordings.iter().map(|r| signals(stated, r)).collect::<Result<Vec<_>, String>>()?;
        let period_s = recordings.first().map_or(1.0, |r| r.sample_rate.period_s());
        let law = law_of(controller, period_s, &records)?;
        let trials = (0..records.len()).map(|k| trial(p, (k, &records[k], &law, period_s))).collect();
        Ok(Self { p, records, trials, law })
    }

    /// The balance of the same recordings.
    pub(super) fn problem(&self) -> &'a Problem {
        self.p
    }

    /// What models leave of the recorded thrust reference, and of the stretch as a force of the spring, N;
    /// thinned, a column a model. `None`: one ran away.
    pub(super) fn errors(&self, axes: &[AxisModel]) -> Option<Vec<Column>> {
        let places: Vec<usize> = (0..self.trials.len()).collect();
        let of = |&k: &usize| -> Option<Vec<Sides>> {
            let (s, m) = (&self.records[k], &self.p.motions[k]);
            let stiffness_n_m = self.p.mechanics.stiffness_n_m;
            let recorded = off(&s.motor_m, &s.stage_m, 1.0);
            let sides = |r: &Response| {
                let thrust = off(&s.reference, &r.reference, m.thrust_per_unit);
                let spring = off(&recorded, &off(&r.motor_m, &r.stage_m, 1.0), stiffness_n_m);
                let thin = |x: &[f64]| Some(self.p.thinning.thin(&x[self.inside(k)]));
                (!r.ran_away()).then(|| Sides { motor: thin(&thrust), stage: thin(&spring) })
            };
            respond(axes, &self.trials[k]).iter().map(sides).collect()
        };
        let of_recordings: Vec<Vec<Sides>> =
            on_two_cores(&places, of).into_iter().collect::<Option<Vec<_>>>()?;
        Some((0..axes.len()).map(|a| of_recordings.iter().map(|r| r[a].clone()).collect()).collect())
    }

    /// What noise alone would leave of the thrust, and of block means of the stretch as a force, N: a white
    /// force on the stage, of the density that its balance shows, and the encoders' own, as the loop answers
    /// them. `None`: no controller is stated.
    pub(super) fn noise_n(&self, stated: &AxisModel, force_n2_hz: f64) -> Option<[f64; 2]> {
        const PARTS: u32 = 1000;
        let rate = SampleRate::new(self.p.motions.first()?.rate_hz).ok()?;
        let noise = self.p.encoder_noise.as_ref()?;
        let band = motion::band_hz(rate.hz());
        let closed = closed_loop::ClosedLoop::around(&stated.drive, stated.controller?, rate);
        let of_encoders_n = closed.step_noise_n(noise.steps_m(), rate, |f| band_gain(f, band));
        let step_hz = band / f64::from(PARTS);
        let places = (1..=PARTS).map(|k| (f64::from(k) - 0.5) * step_hz);
        let of_forces: f64 = places.map(|f| closed.thrust_per_cutting(f).norm_sqr() * step_hz).sum();
        let thrust_n = of_encoders_n.hypot((force_n2_hz * of_forces).sqrt());
        Some([thrust_n, (force_n2_hz * 0.5 / STRETCH_BLOCK_S).sqrt()])
    }

    /// True where the model as stated says every recording down to its noise: nothing is missing, whatever a
    /// balance makes of a recording in which little moves.
    pub(super) fn says_all(&self, stated: &AxisModel, noise_n: Option<[f64; 2]>) -> bool {
        /// Over the noise, which below 10 Hz is more than white.
        const AT_NOISE: [f64; 2] = [2.0, 3.0];
        let Some([thrust_n, stretch_n]) = noise_n else { return false };
        if !not_simulated(stated).is_empty() {
            return false;
        }
        let Some(errors) = self.errors(std::slice::from_ref(stated)) else { return false };
        let block = ((STRETCH_BLOCK_S * self.p.rate_hz()) as usize).max(1);
        errors[0].iter().all(|s| {
            let (Some(thrust), Some(stretch)) = (&s.motor, &s.stage) else { return false };
            let means: Vec<f64> =
                stretch.chunks_exact(block).map(|b| b.iter().sum::<f64>() / b.len() as f64).collect();
            spread(thrust) < AT_NOISE[0] * thrust_n && spread(&means) < AT_NOISE[1] * stretch_n
        })
    }

    /// True where the command asks for next to no force of inertia: what a balance weighs is then its noise.
    pub(super) fn hardly_accelerates(&self) -> bool {
        /// Of the force of inertia, as a share of the thrust; the time over which it is taken, s.
        const SHARE: f64 = 0.1;
        const STEP_S: f64 = 5e-3;
        let m = &self.p.mechanics;
        let mass_kg = m.motor_mass_kg + m.stage_mass_kg;
        self.trials.iter().zip(&self.p.motions).all(|(trial, motion)| {
            let step = ((STEP_S / trial.period_s) as usize).max(1);
            let places: Vec<f64> = trial.command_m.iter().step_by(step).copied().collect();
            let per_s2 = (step as f64 * trial.period_s).powi(-2);
            let inertia: Vec<f64> =
                places.windows(3).map(|x| mass_kg * (x[0] - 2.0 * x[1] + x[2]) * per_s2).collect();
            rms(&inertia) < SHARE * rms(&motion.thrust_n)
        })
    }

    /// The samples of a recording that the balance has, too.
    fn inside(&self, k: usize) -> std::ops::Range<usize> {
        let m = &self.p.motions[k];
        m.offset..m.offset + m.len()
    }
}

/// The model with its numbers re-estimated. Errors: numbers that make no drive.
pub(super) fn recalibrated(stated: &AxisModel, outcome: &Outcome) -> Result<AxisModel, String> {
    let raw = raw_with(&stated.drive, &outcome.recalibrated);
    let drive = DriveParams::new(raw).map_err(|e| e.to_string())?;
    Ok(AxisModel { drive, ..stated.clone() })
}

/// Runs stated, re-estimated and found model beside the machine.
pub(super) fn in_loop(
    rig: &Rig<'_>,
    (stated, found): (&AxisModel, &AxisModel),
    outcome: &Outcome,
) -> Result<ClosedLoop, String> {
    let recalibrated = recalibrated(stated, outcome)?;
    let axes = [stated.clone(), recalibrated, found.clone()];
    let places: Vec<usize> = (0..rig.trials.len()).collect();
    let trials = on_two_cores(&places, |&k| simulated(rig, &axes, k));
    let law_share = rig.law.share.iter().copied().fold(f64::INFINITY, f64::min);
    Ok(ClosedLoop { law_share, trials, not_simulated: not_simulated(&axes[2]) })
}

fn signals(axis: &AxisModel, recording: &Recording) -> Result<LoopRecord, String> {
    let get = |suffix: &str| {
        let name = format!("{}_{suffix}", axis.name);
        recording.get(&name).map(<[f64]>::to_vec).ok_or_else(|| {
            format!(
                "recording {}: column {name} is missing, so the loop has no command",
                recording.experiment
            )
        })
    };
    let columns = motion::columns(axis, recording).map_err(|e| e.to_string())?;
    let unit = columns.thrust_per_unit;
    Ok(LoopRecord {
        command_m: get("position_cmd_m")?,
        motor_m: columns.motor_m,
        stage_m: columns.stage_m.to_vec(),
        reference: columns.reference_n.iter().map(|f| f / unit).collect(),
    })
}

/// The law that acted, or why the stated one did not.
fn law_of(controller: Controller, period_s: f64, records: &[LoopRecord]) -> Result<Replay, String> {
    let replay = replay(controller, period_s, records).ok_or("no recording has a reference that changes")?;
    let best = replay.share.iter().copied().fold(f64::INFINITY, f64::min);
    if best > LAW_SHARE {
        return Err(format!(
            "the stated control law leaves {:.0} % of the recorded reference unsaid: gains, filter, order of \
             samples or a further feed-forward differ",
            100.0 * best
        ));
    }
    Ok(replay)
}

/// What acted in one recording.
fn trial(p: &Problem, (k, s, replay, period_s): (usize, &LoopRecord, &Replay, f64)) -> Trial {
    let injected = replay.share[k] > LAW_SHARE;
    let early = s.motor_m.get(START_SAMPLES).zip(s.motor_m.first());
    Trial {
        period_s,
        command_m: s.command_m.clone(),
        injected: if injected { replay.beyond[k].clone() } else { Vec::new() },
        start_m: [s.motor_m[0], s.stage_m[0]],
        start_m_s: early.map_or(0.0, |(b, a)| (b - a) / (START_SAMPLES as f64 * period_s)),
        law: replay.law,
        integral_m: replay.integral_m[k],
        taken_up_s: motion::TAKEN_UP_SAMPLES * period_s + p.timing_s,
        thrust_per_unit: p.drive.thrust_constant_n_a().is_none().then_some(p.motions[k].thrust_per_unit),
    }
}

/// Root mean square about the straight line: encoders have no common zero, and lead and scale differ.
fn spread(x: &[f64]) -> f64 {
    let [_, scatter] = straight_line(x);
    scatter
}

/// (a - b) `unit`.
fn off(a: &[f64], b: &[f64], unit: f64) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| (a - b) * unit).collect()
}

/// One recording beside its models.
fn simulated(rig: &Rig<'_>, axes: &[AxisModel], k: usize) -> SimulatedTrial {
    let (p, s, m) = (rig.p, &rig.records[k], &rig.p.motions[k]);
    let responses = respond(axes, &rig.trials[k]);
    let thin = |error: Vec<f64>| p.thinning.thin(&error);
    let thrust: Vec<Vec<f64>> =
        responses.iter().map(|r| thin(off(&s.reference, &r.reference, m.thrust_per_unit))).collect();
    let stage_rms_m = [0, 1, 2].map(|i| rms(&thin(off(&s.stage_m, &responses[i].stage_m, 1.0))));
    let edge = p.thinning.edge();
    let count = thrust.first().map_or(0, Vec::len);
    let period_s = rig.trials[k].period_s;
    let first_s = m.time_s(0) - m.offset as f64 * period_s;
    SimulatedTrial {
        recording: k,
        injected: rig.law.share[k] > LAW_SHARE,
        thrust_rms_n: [0, 1, 2].map(|i| rms(&thrust[i])),
        stage_rms_m,
        t_s: (0..count).map(|j| first_s + (edge + j * p.thinning.step) as f64 * period_s).collect(),
        thrust_error_n: thrust,
    }
}

/// The keys of a drive with the numbers of a fit.
fn raw_with(drive: &DriveParams, m: &Mechanics) -> RawDriveParams {
    let r2 = drive.travel_m_rad().powi(2);
    let kept = |stated: Option<f64>, value: f64| stated.map(|_| value.max(0.0));
    let raw = drive.raw();
    RawDriveParams {
        rotary_inertia_kg_m2: kept(raw.rotary_inertia_kg_m2, m.motor_mass_kg * r2),
        rotary_damping_nm_s_rad: kept(raw.rotary_damping_nm_s_rad, m.motor_damping_n_s_m * r2),
        motor_coulomb_friction_n: kept(raw.motor_coulomb_friction_n, m.motor_coulomb_n),
        axial_stiffness_n_m: kept(raw.axial_stiffness_n_m, m.stiffness_n_m),
        structural_damping_n_s_m: kept(raw.structural_damping_n_s_m, m.structural_damping_n_s_m),
        movable_mass_kg: kept(raw.movable_mass_kg, m.stage_mass_kg),
        translational_damping_n_s_m: kept(raw.translational_damping_n_s_m, m.stage_damping_n_s_m),
        stage_coulomb_friction_n: kept(raw.stage_coulomb_friction_n, m.stage_coulomb_n),
        ..raw.clone()
    }
}
