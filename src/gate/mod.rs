//! The recording first: what is wrong with it, before any physics is asked.
//!
//! A recording is a measurement by a logger that nobody checked, and whoever trusts it invents physics.
//!
//! ```text
//!  Logged --> time --> rate --> rows --> limits, holds, outliers --> sign, scale, clock --> rest --> Gated
//!  (rows and  even     true     none      masked and bridged         refused or corrected    masked
//!   stamps)   grid     rate     missing
//! ```
//!
//! Each step works on what the one before has mended, so that one fault is told once. A step knows columns by
//! what their names say ([`columns`]) and no machine: numbers of a model have no part in it.

mod clipping;
mod clock;
mod columns;
mod criteria;
mod fault;
mod held;
mod motion;
mod outliers;
mod rate;
mod rest;
mod rounding;
mod rows;
mod scaling;
mod signs;
mod spectrum;
mod statistics;
mod timing;
mod work;

pub use criteria::Criteria;
pub use fault::{Action, Fault, FaultKind};
pub use rounding::rounded_by_one;

use crate::sample::Recording;
use columns::{AxisColumns, Role};
use work::Work;

/// A recording with the time stamps of its rows, as a logger wrote them.
#[derive(Debug, Clone, PartialEq)]
pub struct Logged {
    /// Rows in the order of the file; its rate is the stated one, or that of the mean step.
    pub recording: Recording,
    /// Time stamp of each row, s, none before the one above.
    pub times_s: Vec<f64>,
}

impl Logged {
    /// A recording whose rows are even.
    #[must_use]
    pub fn even(recording: Recording) -> Self {
        let times_s = (0..recording.len()).map(|i| recording.time_s(i)).collect();
        Self { recording, times_s }
    }
}

/// A recording behind the gate.
#[derive(Debug, Clone, PartialEq)]
pub struct Gated {
    /// At its true rate, with the clocks and signs of its columns put right; masked rows are bridged by
    /// straight lines.
    pub recording: Recording,
    /// One a row: whether it may enter a fit.
    pub usable: Vec<bool>,
    /// Rows that the logger averaged the force over, and the positions; 1: none.
    pub averaged: [usize; 2],
    /// Step of each column as it was logged; 0: none was found.
    pub steps: Vec<f64>,
    /// What is wrong, in the order of the columns of the file.
    pub faults: Vec<Fault>,
}

impl Gated {
    /// Why nothing can be judged from it, if so.
    #[must_use]
    pub fn refusal(&self) -> Option<&Fault> {
        self.faults.iter().find(|f| f.action == Action::Refuse)
    }

    /// True where a column was moved in time against another.
    #[must_use]
    pub fn moved_in_time(&self) -> bool {
        self.corrected(FaultKind::ClockOffset)
    }

    /// True where the recording was brought to a lower rate.
    #[must_use]
    pub fn thinned(&self) -> bool {
        self.corrected(FaultKind::LowerRate)
    }

    fn corrected(&self, kind: FaultKind) -> bool {
        self.faults.iter().any(|f| f.kind == kind && f.action == Action::Correct)
    }

    /// One a row: whether it lies in a stretch that a fit must leave out. A row or two that were bridged bend
    /// nothing, and a fit that goes by blocks would lose much more with them.
    #[must_use]
    pub fn masked(&self) -> Vec<bool> {
        const BRIDGED: usize = 2;
        let mut masked: Vec<bool> = self.usable.iter().map(|u| !u).collect();
        let bad = work::stretches(&masked, 0);
        bad.into_iter().filter(|rows| rows.len() <= BRIDGED).for_each(|rows| masked[rows].fill(false));
        masked
    }

    /// One a row: whether an axis rests there for long.
    #[must_use]
    pub fn resting(&self) -> Vec<bool> {
        let mut rests = vec![false; self.recording.len()];
        let row = |t_s: f64| ((t_s - self.recording.start_s) * self.recording.sample_rate.hz()).round();
        for [from_s, to_s] in
            self.faults.iter().filter(|f| f.kind == FaultKind::LongRest).flat_map(|f| &f.time_s)
        {
            let [from, to] = [from_s, to_s].map(|t| (row(*t).max(0.0) as usize).min(rests.len()));
            rests[from..to.max(from)].fill(true);
        }
        rests
    }
}

/// Checks the columns of `axes` and mends what can be mended. Deterministic.
///
/// A fault that refuses ends the check of that axis: what follows would be read into a wrong column.
#[must_use]
pub fn check(logged: &Logged, axes: &[String], criteria: &Criteria) -> Gated {
    let of = |axis: &String| AxisColumns::of(&logged.recording, axis);
    let axes: Vec<AxisColumns> = axes.iter().map(of).collect();
    let mut work = Work::new(logged, &axes, criteria);
    timing::even(&mut work, logged);
    for axis in &axes {
        rest::empty(&mut work, axis);
    }
    rate::true_rate(&mut work, &axes);
    // An axis that is refused says nothing more: what follows would be read into a wrong column.
    let mut judged = Vec::new();
    for axis in &axes {
        work.next_axis();
        signs::rectified(&mut work, axis);
        signs::swapped(&mut work, axis);
        if !work.refused() && says_something(&work, axis) {
            judged.push(axis);
        }
    }
    for axis in &judged {
        rows::whole(&mut work, axis);
    }
    for axis in judged {
        check_axis(&mut work, axis);
    }
    work.done()
}

/// False where neither drive nor position nor sensor was recorded.
fn says_something(work: &Work<'_>, axis: &AxisColumns) -> bool {
    [Role::Drive, Role::Position, Role::Sensor]
        .into_iter()
        .any(|role| axis.with(role).any(|i| !work.silent[i]))
}

fn check_axis(work: &mut Work<'_>, axis: &AxisColumns) {
    // One position that stands beside one that moves: an output that is held. What sticks there sticks under
    // a force that goes on, which tells of friction, play and spring.
    let locked = axis.with(Role::Position).any(|i| work.silent[i]);
    clipping::clipped(work, axis);
    if !locked {
        held::held(work, axis);
    }
    rows::jumps(work, axis);
    outliers::outliers(work, axis);
    rounding::rounded(work, axis);
    signs::opposite_encoder(work, axis);
    signs::wrong_sign(work, axis);
    scaling::wrong_scale(work, axis);
    spectrum::smoothed(work, axis);
    clock::offsets(work, axis);
    spectrum::mains_line(work, axis);
    if !locked {
        rest::long_rest(work, axis);
    }
}
