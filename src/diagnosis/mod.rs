//! What physics does a machine model leave out? Locate the mismatch, name it, model it, prove it.

mod assemble;
mod bank;
mod bench;
#[cfg(test)]
mod chance;
mod coarse_steps;
mod columns;
mod corrections;
pub mod cut;
mod encoder_noise;
mod first_look;
mod floor;
mod hypothesis_fit;
mod in_loop;
mod kernel;
mod location;
mod loop_answer;
mod loop_fit;
mod loop_search;
mod motion;
mod problem;
mod regression;
mod result;
mod rigid;
mod search;
#[expect(dead_code, reason = "the selection that drive and cut are moved to")]
mod selection;
mod shape;
mod state;
mod stated_laws;
mod steps;
mod strangers;
mod terms;
mod triple;
mod two_cores;
mod weights;
mod whitening;

pub use result::*;

use crate::plant::effects::{EffectKind, PhysicsTerm};
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
use search::Complete;
use thiserror::Error;

/// Why a diagnosis is not possible.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum DiagnoseError {
    /// No recording was handed in.
    #[error("no recording to diagnose")]
    NoRecording,
    /// The recording and the model have no axis in common.
    #[error("recording {recording}: no axis of the model ({axes}) has its columns in it")]
    NoAxis {
        /// Experiment of the recording.
        recording: String,
        /// Axes of the model.
        axes: String,
    },
    /// A column is missing.
    #[error("recording {recording}: column {expected} is missing")]
    MissingColumn {
        /// Experiment of the recording.
        recording: String,
        /// What was looked for.
        expected: String,
    },
    /// The model does not say how current becomes torque.
    #[error("axis {axis}: a current is recorded, but the model states no torque_constant_nm_a")]
    NoTorqueConstant {
        /// Axis.
        axis: String,
    },
    /// Recordings of different sampling rates.
    #[error("recording {recording}: sampled at {rate_hz} Hz, the first one at {first_hz} Hz; give one rate")]
    MixedRates {
        /// Experiment of the recording.
        recording: String,
        /// Its rate, Hz.
        rate_hz: f64,
        /// Rate of the first recording, Hz.
        first_hz: f64,
    },
    /// Nothing moves in any recording.
    #[error(
        "axis {axis} stands still in {recordings}: it moves by less than a micrometre, and nothing can be \
         told of it; expected is a recording while it feeds"
    )]
    Standing {
        /// Axis.
        axis: String,
        /// Experiments of the recordings.
        recordings: String,
    },
    /// Thrust and motion have opposite signs.
    #[error(
        "recording {recording}, axis {axis}: the current (or thrust) has the opposite sign of what moves \
         the axis: turned, the stated mass and friction explain {percent:.0} % of it; expected is plus for a \
         push towards plus"
    )]
    OppositeSign {
        /// Experiment of the recording.
        recording: String,
        /// Axis.
        axis: String,
        /// Share of the thrust's power that the model explains once it is turned, per cent.
        percent: f64,
    },
    /// Motor and stage disagree about the travel.
    #[error(
        "recording {recording}, axis {axis}: by its encoder and screw_lead_m the motor travels {ratio:.4} \
         times as far as the stage, expected is 1: {hint}"
    )]
    TravelRatio {
        /// Experiment of the recording.
        recording: String,
        /// Axis.
        axis: String,
        /// Travel of the motor over that of the stage.
        ratio: f64,
        /// What such a ratio looks like.
        hint: &'static str,
    },
    /// Too short for the filters.
    #[error("recording {recording}: {samples} samples, at least {needed} are needed")]
    TooShort {
        /// Experiment of the recording.
        recording: String,
        /// Samples there are.
        samples: usize,
        /// Samples needed.
        needed: usize,
    },
}

impl DiagnoseError {
    /// True where the error speaks of a recording with this experiment.
    #[must_use]
    pub fn concerns(&self, experiment: &str) -> bool {
        match self {
            Self::NoRecording | Self::NoTorqueConstant { .. } => false,
            Self::Standing { .. } => true,
            Self::NoAxis { recording, .. }
            | Self::MissingColumn { recording, .. }
            | Self::MixedRates { recording, .. }
            | Self::OppositeSign { recording, .. }
            | Self::TravelRatio { recording, .. }
            | Self::TooShort { recording, .. } => recording == experiment,
        }
    }
}

/// Progress of a diagnosis: a share from 0 to 1 and what is being done.
pub type Progress<'a> = &'a (dyn Fn(f64, &str) + Sync);

/// Says what `machine` leaves out, from recordings of it. Deterministic.
///
/// Errors: no recording, no axis in common, a missing column, a recording shorter than the filters, an axis
/// that stands still, a sign or a unit that is not the stated one.
pub fn diagnose(
    machine: &Machine,
    recordings: &[Recording],
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let (axis, others) = axis_of(machine, recordings)?;
    first_look::check(axis, recordings)?;
    if rigid::applies(axis, recordings) {
        let mut diagnosis = rigid::diagnose(machine, axis, recordings, progress)?;
        diagnosis.notes.extend(left_aside(axis, &others, |term| rigid::knows(term, axis)));
        diagnosis.notes.extend(first_look::frozen(axis, recordings));
        return Ok(diagnosis);
    }
    let first = &recordings[0];
    let first_hz = first.sample_rate.hz();
    if let Some(other) = recordings.iter().find(|r| (r.sample_rate.hz() / first_hz - 1.0).abs() > 1e-6) {
        let (recording, rate_hz) = (other.experiment.clone(), other.sample_rate.hz());
        return Err(DiagnoseError::MixedRates { recording, rate_hz, first_hz });
    }
    let lumped = triple::lumped(machine, axis);
    let stated = axis;
    let (machine, axis) = lumped.as_ref().map_or((machine, axis), |(m, a)| (m, a));
    let start = start_of(axis, recordings)?;
    let rig = in_loop::Rig::new(axis, recordings, &start.state.problem).ok();
    let noise_n = rig.as_ref().and_then(|rig| rig.noise_n(axis, start.white_force_n2_hz()));
    let mut outcome = search::search(start.clone(), (Complete::No, progress));
    progress(0.9, "writing the model, simulating the loop");
    let mut diagnosis = assemble::assemble(machine, axis, recordings, &outcome);
    let says_all = |axis: &AxisModel| rig.as_ref().is_some_and(|rig| rig.says_all(axis, noise_n));
    let numbers_say_all =
        || in_loop::recalibrated(axis, &outcome).is_ok_and(|recalibrated| says_all(&recalibrated));
    let complete = match diagnosis.verdict {
        Verdict::UnexplainedMismatch if says_all(axis) => Complete::Stated,
        Verdict::UnexplainedMismatch if numbers_say_all() => Complete::Numbers,
        // A law that changes nothing in the loop is one of the balance's own errors.
        Verdict::MissingPhysics if !diagnosis.earned_in_loop() && numbers_say_all() => Complete::Numbers,
        _ => Complete::No,
    };
    if complete != Complete::No {
        outcome = search::search(start, (complete, &|_, _| ()));
        diagnosis = assemble::assemble(machine, axis, recordings, &outcome);
    } else if let Some(rig) = &rig
        && let Some(noise_n) = noise_n
        && diagnosis.left_in_loop_n().is_some_and(|left| left > FAR_FROM_NOISE * noise_n[0])
    {
        let case = (machine, axis, recordings);
        let told = second_look(case, (rig, &start, noise_n), (&outcome, &diagnosis), progress)?;
        if let Some(told) = told {
            (outcome, diagnosis) = told;
        }
    }
    let p = &outcome.state.problem;
    let notes = left_aside(stated, &others, |term| {
        term.effect == EffectKind::EncoderQuantization || terms::hypothesis(p, term).is_some()
    });
    diagnosis.notes.extend(notes);
    diagnosis.notes.extend(first_look::frozen(axis, recordings));
    if lumped.is_some() {
        diagnosis = triple::unlumped(diagnosis, stated, (&outcome, &outcome.state.bench()));
    }
    progress(1.0, "done");
    Ok(diagnosis)
}

/// What else can be said where the loop is far from its noise; `None`: nothing that the loop confirms.
fn second_look(
    (machine, axis, recordings): (&Machine, &AxisModel, &[Recording]),
    (rig, start, noise_n): (&in_loop::Rig<'_>, &search::Start, [f64; 2]),
    (outcome, answer): (&search::Outcome, &Diagnosis),
    progress: Progress<'_>,
) -> Result<Option<(search::Outcome, Diagnosis)>, DiagnoseError> {
    let silent = (Complete::No, &(|_: f64, _: &str| ()) as Progress<'_>);
    let assembled = |other: search::Outcome| {
        let said = assemble::assemble(machine, axis, recordings, &other);
        (said.verdict == Verdict::MissingPhysics).then_some((other, said))
    };
    // What is loud and has no name is no weak finding.
    if answer.verdict != Verdict::UnexplainedMismatch
        && let Some(weak) = start.asking_the_loop()
    {
        progress(0.9, "asking the loop about weak findings");
        let confirmed = |(_, said): &(search::Outcome, Diagnosis)| {
            said.left_in_loop_n().zip(answer.left_in_loop_n()).is_some_and(|(with_n, without_n)| {
                with_n < CONFIRMED_SHARE * without_n && with_n < FAR_FROM_NOISE * noise_n[0]
            })
        };
        if let Some(weak) = assembled(search::search(weak, silent)).filter(confirmed) {
            return Ok(Some(weak));
        }
    }
    if recordings.len() > 1 {
        progress(0.9, "one recording at a time");
        for recording in recordings {
            let one = start_of(axis, std::slice::from_ref(recording))?;
            let alone = search::search(one, silent);
            let other = assembled(search::with_findings_of(start.clone(), alone));
            if let Some(other) = other.filter(|(_, said)| said.is_quiet_in_loop(noise_n[0])) {
                return Ok(Some(other));
            }
        }
    }
    if !rig.hardly_accelerates() {
        return Ok(None);
    }
    progress(0.9, "running hypotheses in the loop");
    Ok(by_loop((machine, axis, recordings), (rig, start, noise_n), (outcome, answer)))
}

/// What the loop says where it contradicts the balance; `None`: it does not know either.
fn by_loop(
    (machine, axis, recordings): (&Machine, &AxisModel, &[Recording]),
    (rig, start, noise_n): (&in_loop::Rig<'_>, &search::Start, [f64; 2]),
    (outcome, diagnosis): (&search::Outcome, &Diagnosis),
) -> Option<(search::Outcome, Diagnosis)> {
    let accepted = &outcome.state.accepted[outcome.state.given..];
    let tried = |f: &Finding| {
        let law = accepted.iter().find(|a| a.hypothesis.effect == f.effect && a.hypothesis.port == f.port);
        law.map(|law| outcome.rounds[law.round].clone())
    };
    let tried: Vec<_> = diagnosis.findings.iter().filter_map(tried).collect();
    let found = diagnosis.model.axis(&axis.name)?;
    let told = loop_search::search(rig, axis, (&start.state.weighted_bench(), found, tried), noise_n)?;
    let other = search::as_told(start.clone(), told);
    let told = assemble::assemble(machine, axis, recordings, &other);
    (told.left_in_loop_n()? < diagnosis.left_in_loop_n()? && told.is_quiet_in_loop(noise_n[0]))
        .then_some((other, told))
}

/// Share of what the loop leaves that it may leave with a finding that is weak in the balance.
const CONFIRMED_SHARE: f64 = 0.5;
/// Over the noise of the loop: what a model leaves that is beside the cause. Then what one recording alone
/// says is tried on all of them, and stands only if the loop is quiet with it.
const FAR_FROM_NOISE: f64 = 3.0;

/// The balance of recordings, and what the model says beyond its structure.
fn start_of(axis: &AxisModel, recordings: &[Recording]) -> Result<search::Start, DiagnoseError> {
    let motions = recordings.iter().map(|r| motion::motion(axis, r)).collect::<Result<Vec<_>, _>>()?;
    let steps_m = steps::steps_m(axis, &motions);
    let mut problem = problem::Problem::new(&axis.drive, motions);
    if problem.steps_m.iter().zip(steps_m).any(|(stated, found)| found > *stated) {
        problem.proof = problem::Proof::Coarse;
    }
    problem.steps_m = steps_m;
    let noise = encoder_noise::EncoderNoise::new(&axis.drive, &problem.motions, problem.thinning.step);
    problem.encoder_noise = Some(noise);
    let laws = axis.physics.iter().filter_map(|term| terms::hypothesis(&problem, term));
    let given = laws.map(|(h, amplitudes)| bench::Accepted::new(&problem, h, amplitudes)).collect();
    Ok(search::Start::new(problem, given))
}

/// The first axis of the model that is recorded and moves, and the names of the other recorded ones; where
/// all stand, the first.
fn axis_of<'a>(
    machine: &'a Machine,
    recordings: &[Recording],
) -> Result<(&'a AxisModel, Vec<&'a str>), DiagnoseError> {
    let first = recordings.first().ok_or(DiagnoseError::NoRecording)?;
    let has =
        |axis: &&AxisModel| first.columns.iter().any(|c| c.name.starts_with(&format!("{}_", axis.name)));
    let recorded: Vec<&AxisModel> = machine.axes.iter().filter(has).collect();
    let moving = recorded.iter().find(|a| first_look::moves(a, recordings));
    let axis = *moving.or(recorded.first()).ok_or_else(|| DiagnoseError::NoAxis {
        recording: first.experiment.clone(),
        axes: machine.axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>().join(", "),
    })?;
    Ok((axis, recorded.iter().map(|a| a.name.as_str()).filter(|name| *name != axis.name).collect()))
}

/// What is in the model or in the recordings and was not looked at.
fn left_aside(axis: &AxisModel, others: &[&str], known: impl Fn(&PhysicsTerm) -> bool) -> Vec<String> {
    let mut notes = Vec::new();
    if !others.is_empty() {
        notes.push(format!(
            "This is of axis {}. Also recorded and not looked at: {}; a model with that axis alone answers \
             for it.",
            axis.name,
            others.join(", ")
        ));
    }
    for term in axis.physics.iter().filter(|term| !known(term)) {
        let (effect, port) = (term.effect.name(), term.port.name());
        notes.push(format!("{effect} at {port} stands in the model and is not heeded by this diagnosis."));
    }
    notes
}
