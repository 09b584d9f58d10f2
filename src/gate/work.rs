//! The recording while it passes the gate.

use super::columns::AxisColumns;
use super::criteria::Criteria;
use super::fault::{Action, Fault, FaultKind};
use super::statistics::{digit_step, resolution, step};
use super::{Gated, Logged};
use crate::sample::Recording;
use std::ops::Range;

/// The recording as mended so far.
pub(super) struct Work<'a> {
    pub(super) criteria: &'a Criteria,
    pub(super) recording: Recording,
    /// Time of each row in the file, s.
    pub(super) times_s: Vec<f64>,
    pub(super) usable: Vec<bool>,
    /// Columns about which nothing more can be asked: constant.
    pub(super) silent: Vec<bool>,
    /// Step of each column as it was logged, 0 where there is none: what is interpolated has another.
    steps: Vec<f64>,
    /// The step, or the least change.
    resolutions: Vec<f64>,
    /// Rows between two values of a column that has a lower rate than the recording.
    pub(super) updates: Vec<usize>,
    /// Rows that force and positions were averaged over; 1: none.
    pub(super) averaged: [usize; 2],
    faults: Vec<Fault>,
    /// Faults that were there before the axis that is checked now.
    before: usize,
}

/// What a detector says.
pub(super) struct Told<'a> {
    pub(super) column: &'a str,
    pub(super) kind: FaultKind,
    pub(super) action: Action,
    /// Rows, each stretch first to past the last; empty where the whole column has it.
    pub(super) rows: &'a [Range<usize>],
    pub(super) statement: String,
}

impl<'a> Work<'a> {
    pub(super) fn new(logged: &Logged, axes: &[AxisColumns], criteria: &'a Criteria) -> Self {
        let columns = logged.recording.columns.len();
        let (mut steps, mut resolutions) = (vec![0.0; columns], vec![0.0; columns]);
        for column in axes.iter().flat_map(AxisColumns::measured) {
            let x = &logged.recording.columns[column.index].values;
            steps[column.index] = step(x);
            resolutions[column.index] =
                resolution(x, steps[column.index]).max(digit_step(x, steps[column.index]));
        }
        Self {
            criteria,
            usable: vec![true; logged.recording.len()],
            recording: logged.recording.clone(),
            times_s: logged.times_s.clone(),
            silent: vec![false; columns],
            steps,
            resolutions,
            updates: vec![1; columns],
            averaged: [1; 2],
            faults: Vec::new(),
            before: 0,
        }
    }

    pub(super) fn values(&self, column: usize) -> &[f64] {
        &self.recording.columns[column].values
    }

    /// What of a series is of usable rows.
    pub(super) fn kept(&self, x: &[f64]) -> Vec<f64> {
        x.iter().zip(&self.usable).filter(|(_, usable)| **usable).map(|(x, _)| *x).collect()
    }

    pub(super) fn name(&self, column: usize) -> String {
        self.recording.columns[column].name.clone()
    }

    /// Step of a column; 0: none.
    pub(super) fn step(&self, column: usize) -> f64 {
        self.steps[column]
    }

    /// Step of a column, or the least change that it shows.
    pub(super) fn resolution(&self, column: usize) -> f64 {
        self.resolutions[column]
    }

    pub(super) fn rows(&self) -> usize {
        self.times_s.len()
    }

    pub(super) fn period_s(&self) -> f64 {
        self.recording.sample_rate.period_s()
    }

    /// Rows in a time, at least one.
    pub(super) fn rows_in(&self, time_s: f64) -> usize {
        ((time_s / self.period_s()).round() as usize).max(1)
    }

    /// Surprise from which on a column is dead, decades.
    pub(super) fn surprise(&self) -> f64 {
        self.criteria.surprise_decades + (self.rows().max(1) as f64).log10()
    }

    /// Faults from here on belong to another axis.
    pub(super) fn next_axis(&mut self) {
        self.before = self.faults.len();
    }

    /// True where the axis that is checked now is refused.
    pub(super) fn refused(&self) -> bool {
        self.faults[self.before..].iter().any(|f| f.action == Action::Refuse)
    }

    /// True where a column was told to have a fault.
    pub(super) fn has(&self, column: usize, kind: FaultKind) -> bool {
        let name = &self.recording.columns[column].name;
        self.faults.iter().any(|f| f.kind == kind && f.column == *name)
    }

    /// Notes a fault; its share is that of its rows, or all.
    pub(super) fn tell(&mut self, told: Told<'_>) {
        let count: usize = told.rows.iter().map(Range::len).sum();
        let share = if told.rows.is_empty() { 1.0 } else { count as f64 / self.rows().max(1) as f64 };
        let end = self.rows().saturating_sub(1);
        let spans = told.rows.iter().filter(|r| !r.is_empty());
        let time_s = spans.map(|r| [self.times_s[r.start.min(end)], self.times_s[(r.end - 1).min(end)]]);
        self.faults.push(Fault {
            column: told.column.to_owned(),
            kind: told.kind,
            time_s: time_s.collect(),
            share: share.min(1.0),
            action: told.action,
            statement: told.statement,
        });
    }

    /// Takes rows out of every fit.
    pub(super) fn mask(&mut self, rows: Range<usize>) {
        let end = rows.end.min(self.usable.len());
        self.usable[rows.start.min(end)..end].fill(false);
    }

    /// Draws a straight line over rows of a column, between its neighbours.
    pub(super) fn bridge(&mut self, column: usize, rows: Range<usize>) {
        let values = &mut self.recording.columns[column].values;
        let (n, start) = (values.len(), rows.start);
        let end = rows.end.min(n);
        if start >= end {
            return;
        }
        let before = if start > 0 {
            values[start - 1]
        } else if end < n {
            values[end]
        } else {
            return;
        };
        let after = if end < n { values[end] } else { before };
        let steps = (end - start + 1) as f64;
        for (k, v) in values[start..end].iter_mut().enumerate() {
            *v = before + (after - before) * (k + 1) as f64 / steps;
        }
    }

    pub(super) fn done(mut self) -> Gated {
        if let Some(first) = self.times_s.first() {
            self.recording.start_s = *first;
        }
        in_order(&self.recording, &mut self.faults);
        let Self { recording, usable, averaged, steps, faults, .. } = self;
        Gated { recording, usable, averaged, steps, faults }
    }
}

/// Sorts faults as the columns of the file are; `t_s` is none of the recording and comes first.
pub(super) fn in_order(recording: &Recording, faults: &mut [Fault]) {
    let place = |f: &Fault| recording.columns.iter().position(|c| c.name == f.column);
    faults.sort_by_key(|f| (place(f), f.kind));
}

/// Stretches of rows where `is` holds, those less than `gap` rows apart as one.
pub(super) fn stretches(is: &[bool], gap: usize) -> Vec<Range<usize>> {
    let mut out: Vec<Range<usize>> = Vec::new();
    for (i, _) in is.iter().enumerate().filter(|(_, is)| **is) {
        match out.last_mut() {
            Some(last) if i <= last.end + gap => last.end = i + 1,
            _ => out.push(i..i + 1),
        }
    }
    out
}

/// `in 3 stretches`, `once`, `twice`.
pub(super) fn times(count: usize) -> String {
    match count {
        1 => "once".to_owned(),
        2 => "twice".to_owned(),
        n => format!("{n} times"),
    }
}
