//! What physics does a machine model leave out? Locate the mismatch, name it, model it, prove it.
//!
//! ```text
//! recordings, model
//!   first_look   sign, units, something moves               drive/recorded, drive/signals
//!   encoders     what each reads wrong, by the other        drive/encoders
//!   balance      thrust = numbers + laws, per position      drive/state, drive/columns
//!   inner        products per recording, band, fold         drive/spectra, drive/gram
//!   likelihood   numbers and noise spectrum free            drive/likelihood
//!   laws         one file per effect: columns, candidates   drive/laws, plant/effects
//!   bank         all candidates beside a state              drive/bank, drive/lines
//!   T and level  worst of gain, folds, recordings;          drive/evidence
//!                artefacts and knockoffs
//!   selection    ask all, fit some, take one, ask again     selection, drive/subject
//!   rest         what stands above the floor, its port      drive/rest
//!   answer       findings, corrections, model, proof        drive/answer, drive/closed_loop
//! ```
//! The method with its figures: `docs/method-diagnosis.md`.

mod criteria;
pub mod cut;
mod cuts;
mod drive;
mod encoder_noise;
mod first_look;
mod kernel;
mod result;
mod selection;
mod steps;
mod two_cores;

#[cfg(test)]
mod chance;

pub use result::*;

use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
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
        "axis {axis} stands still in {recordings}, cuts left out: it moves by less than a guide gives before \
         it slides, and nothing can be told of it; expected is a recording while it feeds in air"
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
    #[error(
        "recording {recording}: {samples} samples in motion, at least {needed} are needed: its rate, its \
         spring and the noise of its positions leave a band of {below_hz:.3} Hz, and such a band needs more \
         time"
    )]
    TooShort {
        /// Experiment of the recording.
        recording: String,
        /// Samples there are.
        samples: usize,
        /// Samples needed.
        needed: usize,
        /// Band in which a balance is struck.
        below_hz: f64,
        /// With what was recorded at rest there would be enough.
        rests: bool,
        /// This one recording is; else all are together.
        one: bool,
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

/// What an answer may cost, and what of the recordings counts.
#[derive(Debug, Clone, PartialEq)]
pub struct DiagnoseOptions {
    /// Seconds within which the answer stands on a slow machine. Work is counted, not time: a busy machine
    /// answers later, not differently.
    pub budget_s: f64,
    /// Per recording, rows that were not measured: they enter no fit. The caller has bridged them. Empty:
    /// all were measured.
    pub masked: Vec<Vec<bool>>,
    /// Those of them, per recording, in which an axis rests: a force below friction says nothing there, but
    /// where a spindle turns a load that comes does.
    pub resting: Vec<Vec<bool>>,
    /// Per recording, whether the caller has moved a column in time: no delay can be told from it. Empty: of
    /// none.
    pub clock_moved: Vec<bool>,
    /// Per recording, whether the caller has brought it to a lower rate. Empty: none.
    pub thinned: Vec<bool>,
    /// Rows that the logger averaged the force over, and the positions; 1: none.
    pub averaged: [usize; 2],
}

impl Default for DiagnoseOptions {
    fn default() -> Self {
        Self {
            budget_s: 60.0,
            masked: Vec::new(),
            resting: Vec::new(),
            clock_moved: Vec::new(),
            thinned: Vec::new(),
            averaged: [1; 2],
        }
    }
}

impl DiagnoseOptions {
    /// Why a recording is not as it was logged: a time that was mended is good to a row or two.
    fn mended(&self, recording: usize) -> Option<&'static str> {
        let is = |list: &[bool]| list.get(recording).copied().unwrap_or(false);
        match (is(&self.thinned), is(&self.clock_moved)) {
            (true, _) => Some("it was brought to a lower rate"),
            (_, true) => Some("a column was moved in time"),
            _ => None,
        }
    }

    /// The same without some recordings.
    fn without(&self, left_out: &[usize]) -> Self {
        Self {
            masked: without(&self.masked, left_out),
            resting: without(&self.resting, left_out),
            clock_moved: without(&self.clock_moved, left_out),
            thinned: without(&self.thinned, left_out),
            ..*self
        }
    }
}

/// Says what `machine` leaves out, from recordings of it. Deterministic.
///
/// Errors: as [`diagnose_with`].
pub fn diagnose(
    machine: &Machine,
    recordings: &[Recording],
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    diagnose_with(machine, recordings, &DiagnoseOptions::default(), progress)
}

/// [`diagnose`] within a budget, with rows that were not measured.
///
/// Where every axis stands in every recording while the spindle turns, or all that moves is in a cut, the
/// answer says that there is no evidence ([`Diagnosis::no_evidence`]).
///
/// Errors: no recording, no axis in common, a missing column, all recordings shorter than the filters, an
/// axis that stands without a spindle, a sign or a unit that is not the stated one.
pub fn diagnose_with(
    machine: &Machine,
    recordings: &[Recording],
    options: &DiagnoseOptions,
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    let axes = recorded_axes(machine, recordings)?;
    let all_mended = (0..recordings.len()).all(|k| options.mended(k).is_some());
    let counts = |(k, _): &(usize, &Recording)| all_mended || options.mended(*k).is_none();
    one_rate(recordings.iter().enumerate().filter(counts).map(|(_, r)| r))?;
    let cuts = cuts::Cuts::of(recordings, &options.masked);
    let mut refused: Vec<(&str, DiagnoseError)> = Vec::new();
    for (k, stated) in axes.iter().enumerate() {
        let lead = first_look::other_lead(stated, recordings, &cuts.masks);
        let put_right = lead.as_ref().map(|lead| with_lead(machine, stated, lead));
        let (machine, axis) =
            put_right.as_ref().map_or((machine, *stated), |(machine, axis)| (machine, axis));
        let answer = first_look::check(axis, recordings, &cuts.masks).and_then(|stands| {
            let options = DiagnoseOptions { masked: cuts.masks.clone(), ..options.clone() };
            moving((machine, axis), recordings, options, (&stands, progress))
        });
        match answer {
            Ok(mut diagnosis) => {
                lead.into_iter().for_each(|lead| diagnosis.correct_lead(lead));
                diagnosis.notes.extend(cuts.notes);
                diagnosis.notes.extend(not_looked_at(axis, &axes[k + 1..], &refused, &recordings[0].axes));
                return Ok(diagnosis);
            }
            // Nothing to be told of this one; another may move.
            Err(error @ (DiagnoseError::Standing { .. } | DiagnoseError::TooShort { .. })) => {
                refused.push((&stated.name, error));
            }
            Err(error) => return Err(error),
        }
    }
    let why = refusal(refused);
    // An axis that stands while its lathe turns is recorded as it should be. Without a spindle nobody
    // records a drive at rest: a wrong unit, scale or column is likelier.
    let turns = recordings.iter().all(|r| cuts::turns_hz(r).is_some());
    let stands = matches!(why, DiagnoseError::Standing { .. }) && turns;
    if stands || cuts.leave_too_little(recordings, options, &why) {
        let mut diagnosis = Diagnosis::without_evidence(machine, recordings.len(), why.to_string());
        diagnosis.notes.extend(cuts.notes);
        return Ok(diagnosis);
    }
    Err(why)
}

/// Machine and axis with the lead that both encoders show.
fn with_lead(machine: &Machine, axis: &AxisModel, lead: &Correction) -> (Machine, AxisModel) {
    let mut machine = machine.clone();
    let drive = axis.drive.with_numbers([(&*lead.name, lead.value)]).unwrap_or_else(|_| axis.drive.clone());
    let axis = AxisModel { drive, ..axis.clone() };
    machine.axes.iter_mut().filter(|a| a.name == axis.name).for_each(|a| *a = axis.clone());
    (machine, axis)
}

/// Diagnoses an axis from all recordings but those that say less than the others, see [`left_out`]. While one
/// is too short for the filters, the shortest goes, too, as long as the axis moves in another.
fn moving(
    model: (&Machine, &AxisModel),
    recordings: &[Recording],
    options: DiagnoseOptions,
    (stands, progress): (&[bool], Progress<'_>),
) -> Result<Diagnosis, DiagnoseError> {
    let mut out = left_out(model.1, recordings, (&options, stands));
    let mut too_short = None;
    loop {
        out.sort_unstable();
        let left_out: Vec<usize> = out.iter().map(|(k, _)| *k).collect();
        let kept = || (0..recordings.len()).filter(|k| !left_out.contains(k));
        one_rate(kept().map(|k| &recordings[k]))?;
        let others;
        let those = if left_out.is_empty() {
            recordings
        } else {
            others = without(recordings, &left_out);
            &others
        };
        let error = match drive::diagnose(model, those, &options.without(&left_out), progress) {
            Ok(mut diagnosis) => {
                let note = |(k, why): &(usize, &str)| {
                    format!("{}: left out, since {why}.", recordings[*k].experiment)
                };
                diagnosis.notes.extend(out.iter().map(note));
                diagnosis.left_out = left_out;
                return Ok(diagnosis);
            }
            Err(error @ DiagnoseError::TooShort { one: true, .. }) => too_short.get_or_insert(error).clone(),
            Err(error @ DiagnoseError::TooShort { .. }) => return Err(too_short.unwrap_or(error)),
            Err(error) => return Err(error),
        };
        let Some(shortest) = kept().min_by_key(|k| recordings[*k].len()) else { return Err(error) };
        if !kept().any(|k| k != shortest && !stands[k]) {
            return Err(error);
        }
        out.push((shortest, "it is too short for the band that its rate and the noise of all leave"));
    }
}

/// Errors: recordings of different rates.
fn one_rate<'a>(mut recordings: impl Iterator<Item = &'a Recording>) -> Result<(), DiagnoseError> {
    let Some(first_hz) = recordings.next().map(|r| r.sample_rate.hz()) else { return Ok(()) };
    let Some(other) = recordings.find(|r| (r.sample_rate.hz() / first_hz - 1.0).abs() > 1e-6) else {
        return Ok(());
    };
    let (recording, rate_hz) = (other.experiment.clone(), other.sample_rate.hz());
    Err(DiagnoseError::MixedRates { recording, rate_hz, first_hz })
}

/// Recordings of which nothing is asked, and why: where the axis stands while a spindle turns what moves it,
/// by less than a guide gives, is the cut; one whose times were mended says less than one that is whole; and
/// one whose logger rounded a position says nothing of a spring that the others show.
fn left_out(
    axis: &AxisModel,
    recordings: &[Recording],
    (options, stands): (&DiagnoseOptions, &[bool]),
) -> Vec<(usize, &'static str)> {
    let cut = |k: usize| stands[k] && cuts::turns_hz(&recordings[k]).is_some();
    let all = || 0..recordings.len();
    let mut out: Vec<(usize, &str)> =
        all().filter(|k| cut(*k)).map(|k| (k, "the axis stands in it while the spindle turns")).collect();
    let open = |out: &[(usize, &str)]| all().filter(|k| out.iter().all(|(o, _)| o != k)).collect::<Vec<_>>();
    // Where others tell something: the axis moves in them, and they are half as long at least.
    let measured_s = |k: usize| {
        let masked = options.masked.get(k).map_or(0, |m| m.iter().filter(|m| **m).count());
        recordings[k].sample_rate.period_s() * (recordings[k].len() - masked) as f64
    };
    let further = |out: &[(usize, &str)], more: Vec<(usize, &'static str)>| {
        let others = open(out).into_iter().filter(|k| !stands[*k] && more.iter().all(|(m, _)| m != k));
        let tells_s: f64 = others.map(measured_s).sum();
        let left_s: f64 = more.iter().map(|(k, _)| measured_s(*k)).sum();
        if 2.0 * tells_s > left_s { more } else { Vec::new() }
    };
    let mended = open(&out).into_iter().filter_map(|k| options.mended(k).map(|why| (k, why))).collect();
    out.extend(further(&out, mended));
    let rounded = drive::rounded_by_the_logger(axis, recordings, &open(&out));
    let why = "its logger rounded a position, and other recordings tell the spring";
    out.extend(further(&out, rounded.into_iter().map(|k| (k, why)).collect()));
    out.sort_unstable();
    out
}

/// `all` but those with these indices.
fn without<T: Clone>(all: &[T], left_out: &[usize]) -> Vec<T> {
    all.iter().enumerate().filter(|(k, _)| !left_out.contains(k)).map(|(_, one)| one.clone()).collect()
}

/// What is said where no axis tells anything: that all stand, or why the first that moves does not.
fn refusal(refused: Vec<(&str, DiagnoseError)>) -> DiagnoseError {
    let names: Vec<&str> = refused.iter().map(|(name, _)| *name).collect();
    let names = names.join(", ");
    let stands = |e: &DiagnoseError| matches!(e, DiagnoseError::Standing { .. });
    let mut errors: Vec<DiagnoseError> = refused.into_iter().map(|(_, error)| error).collect();
    let first = errors.iter().position(|e| !stands(e)).unwrap_or(0);
    match errors.swap_remove(first) {
        DiagnoseError::Standing { recordings, .. } => DiagnoseError::Standing { axis: names, recordings },
        error => error,
    }
}

/// Every other axis, and why nothing is said of it.
fn not_looked_at(
    axis: &AxisModel,
    later: &[&AxisModel],
    refused: &[(&str, DiagnoseError)],
    recorded: &[String],
) -> Option<String> {
    let why = |(name, error): &(&str, DiagnoseError)| match error {
        DiagnoseError::Standing { .. } => ((*name).to_owned(), "it stands still"),
        _ => ((*name).to_owned(), "too little of it was measured in motion"),
    };
    let mut others: Vec<(String, &str)> = refused.iter().map(why).collect();
    others.extend(later.iter().map(|a| (a.name.clone(), "a model with that axis alone answers for it")));
    let known = |name: &String| *name == axis.name || others.iter().any(|(other, _)| other == name);
    let unknown: Vec<&String> = recorded.iter().filter(|name| !known(name)).collect();
    others.extend(unknown.into_iter().map(|name| (name.clone(), "not in the model")));
    let others: Vec<String> = others.iter().map(|(name, why)| format!("{name} ({why})")).collect();
    (!others.is_empty()).then(|| {
        format!("This is of axis {}. Also recorded and not looked at: {}.", axis.name, others.join(", "))
    })
}

/// Axes of the model that are recorded, in its order.
fn recorded_axes<'a>(
    machine: &'a Machine,
    recordings: &[Recording],
) -> Result<Vec<&'a AxisModel>, DiagnoseError> {
    let first = recordings.first().ok_or(DiagnoseError::NoRecording)?;
    let has =
        |axis: &&AxisModel| first.columns.iter().any(|c| c.name.starts_with(&format!("{}_", axis.name)));
    let recorded: Vec<&AxisModel> = machine.axes.iter().filter(has).collect();
    if recorded.is_empty() {
        return Err(DiagnoseError::NoAxis {
            recording: first.experiment.clone(),
            axes: machine.axes.iter().map(|a| a.name.as_str()).collect::<Vec<_>>().join(", "),
        });
    }
    Ok(recorded)
}
