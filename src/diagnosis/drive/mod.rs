//! The drive: one balance of one or two positions, one bank, one statistic, one verdict.

mod accepted;
mod answer;
mod balance;
mod bank;
mod base;
mod case;
mod closed_loop;
mod columns;
mod dynamics;
mod entry;
mod evidence;
mod faults;
mod given;
mod gram;
mod laws;
mod likelihood;
mod lines;
mod model;
mod notes;
mod number;
mod numbers;
mod one_mass;
pub(in crate::diagnosis) mod recorded;
mod rest;
mod rounding;
mod series;
mod signals;
mod spectra;
mod state;
mod subject;
mod words;

use super::cuts::spindle_hz;
use super::selection::{Reach, Work, select};
use super::{DiagnoseError, DiagnoseOptions, Diagnosis, Progress};
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;

/// Passes in which numbers and the balance follow one another before anything is asked.
const PASSES: usize = 2;
/// Samples times evaluations of screening and fits for a second of the budget on one thread of a slow office
/// machine, which makes 1e7 of them: the rest is for the answer.
const SAMPLES_PER_S: f64 = 6.0e6;

/// Evaluations that screening and fits may take.
fn work_of(options: &DiagnoseOptions, recordings: &[Recording]) -> Work {
    let samples: usize = recordings.iter().map(Recording::len).sum();
    Work::new((options.budget_s * SAMPLES_PER_S / samples.max(1) as f64) as u64)
}

/// The balance of an axis. Errors: as [`signals::Signals::new`]; too little was measured.
fn balance_of(
    axis: &AxisModel,
    recordings: &[Recording],
    options: &DiagnoseOptions,
) -> Result<state::Balance, DiagnoseError> {
    let signals = signals::Signals::new(axis, recordings, &options.masked, options.averaged)?;
    // When a mean over rows acts nobody says.
    let clock_moved = options.clock_moved || options.averaged != [1; 2];
    let balance = state::Balance::new(axis.drive.clone(), signals, clock_moved);
    if let Some(first) = recordings.first().filter(|_| !balance.plan.is_enough()) {
        let recording = first.experiment.clone();
        let samples = balance.plan.measured() as usize * balance.signals.step;
        let needed = spectra::SHORTEST_BLOCK * balance.signals.step;
        return Err(DiagnoseError::TooShort { recording, samples, needed });
    }
    Ok(balance)
}

/// Numbers and balance after they have followed one another, with what the model states and is not heeded.
fn start_of(axis: &AxisModel, balance: &state::Balance) -> (state::State, Vec<String>) {
    let mut start = state::State::new(balance, Vec::new());
    let (laws, notes) = given::given(axis, &state::stated_mechanics(balance));
    if !laws.is_empty() {
        start = state::State::new(balance, laws);
    }
    for _ in 0..PASSES {
        start = start.begun(balance);
    }
    (start, notes)
}

/// An answer before anything was asked. `[stated, axis]`: the axis as stated, and with its terms folded
/// into keys.
fn case_of<'a>(
    machine: &'a Machine,
    [stated, axis]: [&'a AxisModel; 2],
    recordings: &'a [Recording],
    balance: &'a state::Balance,
    start: &'a state::State,
) -> case::Case<'a> {
    case::Case {
        machine,
        stated,
        axis,
        recordings,
        balance,
        start,
        rounds: &[],
        stated_rest_n: 0.0,
        notes: Vec::new(),
        out_of_budget: false,
    }
}

/// The answer where tools cut in a part of a recording and the force alone tells of it: the cut, and what the
/// rest says. At rest the balance of forces stands as it does in motion, and a load that comes is seen there.
fn beside_cut(
    machine: &Machine,
    stated: &AxisModel,
    recordings: &[Recording],
    options: &DiagnoseOptions,
    progress: Progress<'_>,
) -> Option<Diagnosis> {
    if recordings.iter().any(|r| spindle_hz(r).is_none()) {
        return None;
    }
    let axis = given::folded(stated);
    let masked = entry::without(&options.masked, &options.resting);
    let whole = DiagnoseOptions { masked, ..options.clone() };
    let balance = balance_of(&axis, recordings, &whole).ok()?;
    let (start, _) = start_of(&axis, &balance);
    let cut = entry::entered(&balance, &start, &mut work_of(options, recordings))?;
    let rows = cut.rows(&balance);
    let (masked, resting) = (entry::with(&rows, &options.masked), entry::without(&options.resting, &rows));
    let rest = DiagnoseOptions { masked, resting, ..options.clone() };
    let round = cut.round();
    let case = case::Case {
        rounds: std::slice::from_ref(&round),
        notes: vec![
            "What follows is of the rows without the cut: its force is none of the drive.".to_owned(),
        ],
        ..case_of(machine, [stated, &axis], recordings, &balance, &start)
    };
    let in_air = || diagnose((machine, stated), recordings, &rest, progress).ok();
    case.beside_cut(cut.fitted.model, in_air)
}

/// Diagnoses one axis.
pub(in crate::diagnosis) fn diagnose(
    (machine, stated): (&Machine, &AxisModel),
    recordings: &[Recording],
    options: &DiagnoseOptions,
    progress: Progress<'_>,
) -> Result<Diagnosis, DiagnoseError> {
    progress(0.0, "aligning signals");
    if let Some(answer) = beside_cut(machine, stated, recordings, options, progress) {
        return Ok(answer);
    }
    let axis = given::folded(stated);
    let mut work = work_of(options, recordings);
    let balance = balance_of(&axis, recordings, options)?;
    let (start, notes) = start_of(&axis, &balance);
    let drive = subject::Drive::new(&balance);
    let clean = drive.without_faults(start.clone(), &mut work);
    let search = |share: f64, what: &str| progress(0.05 + 0.85 * share, what);
    let mut selected = select(&drive, clean.clone(), Reach::default(), &mut work, &search);
    // What is wrong with the force's column stands where every law was asked beside it.
    let start = if selected.rounds.is_empty() { start } else { clean };
    if selected.rounds.is_empty() {
        selected.model = start.clone();
    }
    progress(0.9, "writing the model, simulating the loop");
    let case = case::Case {
        rounds: &selected.rounds,
        stated_rest_n: given::stated_rest_n(&axis),
        notes,
        out_of_budget: selected.out_of_budget,
        ..case_of(machine, [stated, &axis], recordings, &balance, &start)
    };
    let diagnosis = case.answer(selected.model);
    progress(1.0, "done");
    Ok(diagnosis)
}
