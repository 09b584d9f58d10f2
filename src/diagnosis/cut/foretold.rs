//! Rows of a table foretold by fits that did not see the rows of the same speed.

use super::answer::{Fitting, Posterior};
use super::fit::{Effort, Problem};
use super::input::{CutOutcome, CutTable};
use super::machine::{Frame, Machine, Point};
use super::observable::Observable;
use super::result::{CutRowFit, ForetoldCut, Sides, TableFit};
use super::table::{TableRows, chatter_probability, row_condition};
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::stability::rightmost_cut_root;
use nalgebra::DVector;

/// Speeds that differ by less are the same setting of the machine.
const SAME_SPEED: f64 = 0.02;
/// Machines drawn from the posterior of a fit to foretell a row.
const DRAWS: usize = 32;

/// What is foretold of a table.
pub(crate) struct Foretold {
    /// Row by row.
    pub(crate) rows: Vec<CutRowFit>,
    /// All of it; before: the stated structure refitted in the same way.
    pub(crate) fit: TableFit,
}

/// Rows before (as stated) and after (cross-fitted), and how the outcomes are foretold.
pub(crate) fn rows(frame: &Frame, table: &CutTable, fitting: &Fitting<'_>) -> Foretold {
    let conditions: Vec<CutCondition> =
        table.rows.iter().map(|row| row_condition(row, &frame.stated)).collect();
    let groups = groups(&conditions);
    let stated = frame.machine(&frame.origin());
    let crossed = |start: &Point| -> Vec<Option<ForetoldCut>> {
        let mut out = vec![None; conditions.len()];
        for group in &groups {
            let draws = posterior_without(frame, table, group, start);
            for row in group {
                out[*row] = draws.as_ref().map(|d| foretell(d, &conditions[*row]));
            }
        }
        out
    };
    let structure = crossed(&fitting.start.point);
    let after = if fitting.selected.model.point.terms.is_empty() {
        structure.clone()
    } else {
        crossed(&fitting.selected.model.point)
    };
    let unknown = ForetoldCut { growth_1_s: f64::NAN, frequency_hz: f64::NAN, chatter_probability: 0.5 };
    let before =
        |row: usize| stated.as_ref().map_or(unknown, |m| foretell(&Drawn::alone(*m), &conditions[row]));
    let rows: Vec<CutRowFit> = (0..conditions.len())
        .map(|k| CutRowFit { before: before(k), after: after[k].unwrap_or(unknown) })
        .collect();
    let off = |of: &dyn Fn(usize) -> Option<f64>| {
        let off = |k: usize| Some((of(k)? - table.rows[k].known.growth_1_s?).abs());
        let mut all: Vec<f64> = (0..rows.len()).filter_map(off).collect();
        all.sort_by(f64::total_cmp);
        all.get(all.len() / 2).copied()
    };
    let growth = |of: &[Option<ForetoldCut>], k: usize| of[k].map(|f| f.growth_1_s);
    let [stated, refitted, answer] = [
        off(&|k| Some(rows[k].before.growth_1_s)),
        off(&|k| growth(&structure, k)),
        off(&|k| growth(&after, k)),
    ];
    let sides = |((stated, refitted), answer)| Sides { stated, refitted, answer };
    let growth_off_1_s = stated.zip(refitted).zip(answer).map(sides);
    Foretold { rows, fit: TableFit { growth_off_1_s, ..table_fit(table, &structure, &after) } }
}

/// Rows of one speed each; of one condition each where there is one speed only.
fn groups(conditions: &[CutCondition]) -> Vec<Vec<usize>> {
    let same_speed =
        |a: &CutCondition, b: &CutCondition| (a.speed_rpm / b.speed_rpm - 1.0).abs() < SAME_SPEED;
    let same_cut = |a: &CutCondition, b: &CutCondition| {
        same_speed(a, b)
            && (a.width_m - b.width_m).abs() <= 1e-9
            && (a.feed_m_rev - b.feed_m_rev).abs() <= 1e-9
            && (a.position_m - b.position_m).abs() <= 1e-9
            && (a.pitch_difference_rad - b.pitch_difference_rad).abs() <= 1e-9
    };
    let split = |same: &dyn Fn(&CutCondition, &CutCondition) -> bool| {
        let mut out: Vec<Vec<usize>> = Vec::new();
        for (k, condition) in conditions.iter().enumerate() {
            match out.iter_mut().find(|group| same(&conditions[group[0]], condition)) {
                Some(group) => group.push(k),
                None => out.push(vec![k]),
            }
        }
        out
    };
    let by_speed = split(&same_speed);
    if by_speed.len() > 1 { by_speed } else { split(&same_cut) }
}

/// Machines that a fit leaves possible.
struct Drawn {
    best: Machine,
    draws: Vec<Machine>,
}

impl Drawn {
    fn alone(machine: Machine) -> Self {
        Self { best: machine, draws: vec![machine] }
    }
}

/// The fit to all rows but those of a group, and draws from what it leaves open. The table alone enters:
/// recordings may hold cuts of that speed.
fn posterior_without(frame: &Frame, table: &CutTable, group: &[usize], start: &Point) -> Option<Drawn> {
    let kept = TableRows::new(table, &frame.stated, |row| !group.contains(&row));
    let observables: Vec<Box<dyn Observable>> = vec![Box::new(kept)];
    let problem = Problem { frame, observables: &observables };
    let ended = problem.fit(start, &Effort::FULL)?;
    let best = frame.machine(&ended.point)?;
    let Some(posterior) = Posterior::new(&problem, &ended.point) else { return Some(Drawn::alone(best)) };
    let Some(root) = posterior.covariance.clone().cholesky() else { return Some(Drawn::alone(best)) };
    let here = ended.point.coordinates();
    let bounds = frame.bounds(&ended.point);
    let mut normal = Normal::default();
    let draw = |_| {
        let z = DVector::from_fn(here.len(), |_, _| normal.next());
        let moved = root.l() * z;
        let to = here.iter().zip(moved.iter()).zip(&bounds);
        let to: Vec<f64> = to.map(|((x, d), [low, high])| (x + d).clamp(*low, *high)).collect();
        frame.machine(&ended.point.with(&to))
    };
    let draws: Vec<Machine> = (0..DRAWS).filter_map(draw).collect();
    Some(Drawn { best, draws })
}

/// Growth and frequency of the best machine; probability over all draws.
fn foretell(drawn: &Drawn, at: &CutCondition) -> ForetoldCut {
    let root = |m: &Machine| rightmost_cut_root(&CutLoop::new(&CutTerms::of(&m.scenario, at)));
    let best = root(&drawn.best);
    let chatter = |m: &Machine| chatter_probability(root(m).growth_1_s / m.noise.outcome_spread_1_s);
    let sum: f64 = drawn.draws.iter().map(chatter).sum();
    ForetoldCut {
        growth_1_s: best.growth_1_s,
        frequency_hz: best.frequency_hz,
        chatter_probability: sum / drawn.draws.len().max(1) as f64,
    }
}

fn table_fit(table: &CutTable, before: &[Option<ForetoldCut>], after: &[Option<ForetoldCut>]) -> TableFit {
    let judged: Vec<(usize, CutOutcome)> =
        table.rows.iter().enumerate().filter_map(|(k, row)| Some((k, row.outcome?))).collect();
    let of_outcome = |foretold: &[Option<ForetoldCut>], (k, outcome): &(usize, CutOutcome)| {
        let chatter = foretold[*k].map_or(0.5, |f| f.chatter_probability);
        if *outcome == CutOutcome::Chatter { chatter } else { 1.0 - chatter }
    };
    let loss = |foretold: &[Option<ForetoldCut>]| {
        let sum: f64 = judged.iter().map(|j| -of_outcome(foretold, j).ln()).sum();
        sum / judged.len().max(1) as f64
    };
    let right =
        |foretold: &[Option<ForetoldCut>]| judged.iter().filter(|j| of_outcome(foretold, j) > 0.5).count();
    TableFit {
        heldout_log_loss_before: loss(before),
        heldout_log_loss_after: loss(after),
        heldout_right_before: right(before),
        heldout_right_after: right(after),
        heldout_cuts: judged.len(),
        growth_off_1_s: None,
    }
}

/// Standard normal numbers, always the same ones: an answer is repeated exactly.
#[derive(Default)]
struct Normal {
    state: u64,
    other: Option<f64>,
}

impl Normal {
    /// Box and Muller's way on a linear congruence.
    fn next(&mut self) -> f64 {
        if let Some(other) = self.other.take() {
            return other;
        }
        let mut uniform = || {
            self.state =
                self.state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.state >> 11) as f64 + 0.5) / (1u64 << 53) as f64
        };
        let radius = (-2.0 * uniform().ln()).sqrt();
        let angle = std::f64::consts::TAU * uniform();
        self.other = Some(radius * angle.sin());
        radius * angle.cos()
    }
}
