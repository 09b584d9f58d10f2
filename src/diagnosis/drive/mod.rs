//! The drive: one balance of one or two positions, one bank, one statistic, one verdict.

mod accepted;
mod answer;
mod balance;
mod bank;
mod base;
mod case;
mod closed_loop;
mod columns;
mod corrections;
mod dynamics;
mod encoders;
mod entry;
mod evidence;
mod faults;
mod following;
mod given;
mod gram;
mod heldout;
mod laws;
mod likelihood;
mod lines;
mod model;
mod notes;
mod number;
mod numbers;
mod of_encoders;
mod one_mass;
mod reads;
pub(in crate::diagnosis) mod recorded;
mod rest;
mod rounding;
mod second_mass;
mod series;
mod signals;
mod sliding;
mod spectra;
mod standstill;
mod state;
mod subject;
mod thrust_left;
mod together;
mod turning;
mod words;

use super::cuts::spindle_hz;
use super::selection::{Reach, Round, Work, select};
use super::{DiagnoseError, DiagnoseOptions, Diagnosis, Progress};
use crate::plant::drive::Structure;
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
use encoders::Readings;
use together::together;

/// Samples times evaluations of screening and fits for a second of the budget on one thread of a slow office
/// machine, which makes 2e7 of them: the rest is for the answer.
const SAMPLES_PER_S: f64 = 1.6e7;

/// Of these recordings those in which a position has twice the step that it has in another one, if without
/// them both positions are a balance and with them they are not.
pub(in crate::diagnosis) fn rounded_by_the_logger(
    axis: &AxisModel,
    recordings: &[Recording],
    among: &[usize],
) -> Vec<usize> {
    let layout =
        |of: &[usize]| signals::layout(axis, &of.iter().map(|k| recordings[*k].clone()).collect::<Vec<_>>());
    if among.len() < 2 || layout(among) != signals::Layout::OnePosition {
        return Vec::new();
    }
    let steps_m: Vec<[f64; 2]> =
        among.iter().map(|k| signals::found_steps_m(axis, &recordings[*k])).collect();
    let finest_m = [0, 1].map(|side| steps_m.iter().map(|s| s[side]).fold(f64::INFINITY, f64::min));
    let is_coarse = |s: &[f64; 2]| (0..2).any(|side| s[side] > 2.0 * finest_m[side]);
    let (coarse, fine): (Vec<usize>, Vec<usize>) = (0..among.len()).partition(|k| is_coarse(&steps_m[*k]));
    let [coarse, fine] = [coarse, fine].map(|of| of.into_iter().map(|k| among[k]).collect::<Vec<_>>());
    let tells = !fine.is_empty() && layout(&fine) == signals::Layout::TwoPositions;
    if tells { coarse } else { Vec::new() }
}

/// Evaluations that screening and fits may take.
fn work_of(options: &DiagnoseOptions, recordings: &[Recording]) -> Work {
    let samples: usize = recordings.iter().map(Recording::len).sum();
    Work::new((options.budget_s * SAMPLES_PER_S / samples.max(1) as f64) as u64)
}

/// The balance of an axis; `stage_later_s`: see [`state::Balance`]; `rest_counts`: standing still is looked
/// at.
/// Errors: as [`signals::Signals::new`]; too little was measured.
fn balance_of(
    axis: &AxisModel,
    readings: &Readings<'_>,
    options: &DiagnoseOptions,
    (stage_later_s, rest_counts): (Option<f64>, bool),
) -> Result<state::Balance, DiagnoseError> {
    let recordings = &readings.recordings;
    let mut signals = signals::Signals::new(axis, recordings, &options.masked, options.averaged)?;
    if rest_counts {
        signals.tracks.iter_mut().for_each(|t| t.rests.fill(false));
    }
    // When a mean over rows acts nobody says.
    let clock_moved = options.clock_moved.contains(&true) || options.averaged != [1; 2];
    let mut balance = state::Balance::new(axis.drive.clone(), signals, (clock_moved, stage_later_s));
    balance.read_right = readings.ports();
    if let Some(first) = recordings.first().filter(|_| !balance.plan.is_enough()) {
        let recording = first.experiment.clone();
        let samples = balance.plan.measured() as usize * balance.signals.step;
        let needed = spectra::SHORTEST_BLOCK * balance.signals.step;
        let below_hz = balance.signals.top_hz();
        let rests = balance.plan.in_blocks() >= spectra::SHORTEST_BLOCK as f64;
        return Err(DiagnoseError::TooShort { recording, samples, needed, below_hz, rests, one: false });
    }
    Ok(balance)
}

/// Numbers and balance after they have followed one another, with what the model states and is not heeded.
/// `axes`: as stated, and with its terms folded into keys.
fn start_of(axes: [&AxisModel; 2], balance: &state::Balance) -> (state::State, Vec<String>) {
    let (laws, notes) = given::given(axes, balance);
    let start = state::State::new(balance, &laws, subject::PASSES);
    (start, notes)
}

/// An answer before anything was asked. `[stated, axis]`: the axis as stated, and with its terms folded
/// into keys.
fn case_of<'a>(
    machine: &'a Machine,
    [stated, axis]: [&'a AxisModel; 2],
    (recordings, readings): (&'a [Recording], &'a Readings<'a>),
    balance: &'a state::Balance,
    start: &'a state::State,
) -> case::Case<'a> {
    case::Case {
        machine,
        stated,
        axis,
        recordings,
        errors: &readings.errors,
        balance,
        start,
        rounds: &[],
        known: &[],
        stated_rest_n: 0.0,
        notes: Vec::new(),
        out_of_budget: false,
    }
}

/// The answer where tools cut in a part of a recording and the force alone tells of it: the cut, and what the
/// rest says. At rest the balance of forces stands as it does in motion, and a load that comes is seen there.
fn beside_cut(
    (machine, stated): (&Machine, &AxisModel),
    (recordings, readings): (&[Recording], &Readings<'_>),
    options: &DiagnoseOptions,
    progress: Progress<'_>,
) -> Option<Diagnosis> {
    if recordings.iter().any(|r| spindle_hz(r).is_none()) {
        return None;
    }
    let masked = entry::without(&options.masked, &options.resting);
    let whole = DiagnoseOptions { masked, ..options.clone() };
    let axis = given::folded(stated);
    let balance = balance_of(&axis, readings, &whole, (None, true)).ok()?;
    let (start, _) = start_of([stated, &axis], &balance);
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
        ..case_of(machine, [stated, &axis], (recordings, readings), &balance, &start)
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
    let readings = Readings::of(stated, recordings, options);
    if let Some(answer) = beside_cut((machine, stated), (recordings, &readings), options, progress) {
        return Ok(answer);
    }
    let mut work = work_of(options, recordings);
    let (axis, balance, known) = together(stated, &readings, options, &mut work)?;
    let (start, mut notes) = start_of([stated, &axis], &balance);
    if stated.drive.structure() == Structure::Rigid && axis.drive.structure() != Structure::Rigid {
        notes.push(
            "The model has one mass. Its two encoders show two on a spring: what is said is of both, begun \
             from a half at either end."
                .to_owned(),
        );
    }
    let drive = subject::Drive::new(&balance);
    let clean = drive.without_faults(start.clone(), &mut work);
    let search = |share: f64, what: &str| progress(0.05 + 0.85 * share, what);
    let begin = known.beside(&balance, clean.clone());
    let mut selected = select(&drive, begin, Reach::default(), &mut work, &search);
    selected.out_of_budget |= work.has_refused();
    let reach = Reach::default();
    for _ in 0..reach.most_findings {
        let Some(fitted) = drive.exchanged(&selected.model, &selected.rounds, &mut work) else { break };
        let model = fitted[0].model.clone();
        let stand = model.accepted.iter().filter(|a| a.given.is_none()).count();
        let reach = Reach { most_findings: reach.most_findings.saturating_sub(stand), ..reach };
        let mut more = select(&drive, model, reach, &mut work, &search);
        selected.rounds.push(Round { fitted, screened: Vec::new(), accepted: true });
        selected.rounds.append(&mut more.rounds);
        selected.model = more.model;
        selected.out_of_budget |= more.out_of_budget;
    }
    // What is wrong with the force's column stands where every law was asked beside it.
    let start = if selected.rounds.is_empty() { start } else { clean };
    if selected.rounds.is_empty() {
        selected.model = start.clone();
    }
    progress(0.9, "writing the model, simulating the loop");
    let case = case::Case {
        rounds: &selected.rounds,
        known: &known.rounds,
        stated_rest_n: given::stated_rest_n(&axis),
        notes,
        out_of_budget: selected.out_of_budget,
        ..case_of(machine, [stated, &axis], (recordings, &readings), &balance, &start)
    };
    let diagnosis = case.answer(selected.model);
    progress(1.0, "done");
    Ok(diagnosis)
}
