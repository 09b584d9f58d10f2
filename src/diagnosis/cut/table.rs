//! A table of cuts as an observable: growth, lines, mean forces and outcomes of whole cuts.
//!
//! ```text
//! growth    (g - Re s)/sd,       sd^2 = se^2 + spread^2     s: root next to the measured pole
//! line      (f - Im s/2 pi)/sd,  sd^2 = 0.1^2 (at chatter; 2^2 out of noise) + spread^2 Hz^2
//! dominance max(0, Re s_max - Re s)/sd       no other line may outgrow the one that was seen
//! outcome   P(chatter) = 0.01 + 0.98/(1 + exp(-Re s_max/spread)), as its deviance residual; its spread is
//!           its own: how fast a vibration was seen to grow may say little of how it began
//! force     ln F less ln of the model's mean: mean of the tools, and tool 2 over tool 1
//! ```
//! All spreads are free: cuts are not set as exactly as they are written down, and how much so is in the
//! table itself. A residual with a free deviation carries sqrt(2 ln(sd/least sd)) beside it, so that a sum of
//! half squares is the whole of -ln L. One row in a hundred is written down wrong, whatever the model says:
//!
//! -ln L = -ln(0.99 exp(-r^2/2) + 0.01 sqrt(2 pi) sd/range)

use super::input::{CutOutcome, CutRow, CutTable};
use super::machine::Machine;
use super::observable::{Every, Observable, Origin, OriginKind, Part};
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::effects::EffectKind;
use crate::plant::scenario::Scenario;
use crate::stability::{Root, cut_root_near, rightmost_cut_root};

/// Accuracy of a line at chatter (of ten periods of a second's spectrum), and of one that stands out of the
/// noise of a stable cut: as wide as its damping, Hz.
const LINE_SD_HZ: [f64; 2] = [0.1, 2.0];
/// Where a wrong line may stand, Hz; where a wrong growth, 1/s; and the logarithm of a wrong force.
const LINE_RANGE_HZ: f64 = 500.0;
const GROWTH_RANGE_1_S: f64 = 100.0;
const FORCE_RANGE: f64 = 2.0;
/// Standard error of a growth whose own is not given: a few hundred periods of a swelling line, 1/s.
const UNSTATED_GROWTH_SE_1_S: f64 = 1.0;
/// No table of mean forces is better than this share: sensitivity of a calibrated dynamometer.
const LEAST_FORCE_SCATTER: f64 = 2e-3;
/// Scatter of one tool's force over that in common to both.
const OWN_OVER_COMMON: f64 = 0.4;
/// Share of rows that are written down wrong, whatever the model says of them.
const MISTAKEN_SHARE: f64 = 0.01;

/// Growth and line of a row.
#[derive(Debug, Clone, Copy)]
struct Pole {
    growth_1_s: f64,
    growth_se_1_s: f64,
    line_hz: f64,
    line_sd_hz: f64,
    chatters: bool,
}

/// What a row says.
#[derive(Debug, Clone)]
struct Row {
    at: CutCondition,
    pole: Option<Pole>,
    outcome: Option<CutOutcome>,
    /// Frequency at chatter of a row without growth.
    line_hz: Option<f64>,
    radial_n: [Option<f64>; 2],
    cutting_n: Option<f64>,
}

/// Rows of a table of cuts.
pub(crate) struct TableRows {
    rows: Vec<Row>,
}

/// The condition of a row; what it does not say is the scenario's.
pub(crate) fn row_condition(row: &CutRow, scenario: &Scenario) -> CutCondition {
    let stated = CutCondition::of(scenario);
    let known = &row.known;
    CutCondition {
        speed_rpm: row.spindle_speed_rpm,
        feed_m_rev: known.feed_m_rev.unwrap_or(stated.feed_m_rev),
        width_m: row.width_m,
        position_m: known.tool_position_m.unwrap_or(stated.position_m),
        pitch_difference_rad: known.pitch_difference_rad.unwrap_or(stated.pitch_difference_rad),
        diameter_m: known.workpiece_diameter_m.unwrap_or(stated.diameter_m),
        time_s: 0.0,
        edge_age_s: known.started_s.unwrap_or(0.0),
    }
}

impl Row {
    fn new(row: &CutRow, scenario: &Scenario) -> Self {
        let known = &row.known;
        let chatters = row.outcome == Some(CutOutcome::Chatter);
        let pole = known.growth_1_s.zip(known.line_hz).map(|(growth_1_s, line_hz)| Pole {
            growth_1_s,
            growth_se_1_s: known.growth_se_1_s.unwrap_or(UNSTATED_GROWTH_SE_1_S),
            line_hz,
            line_sd_hz: LINE_SD_HZ[usize::from(!chatters)],
            chatters,
        });
        let force = |n: Option<f64>| n.filter(|n| *n > 0.0);
        Self {
            at: row_condition(row, scenario),
            outcome: row.outcome,
            line_hz: known.line_hz.filter(|_| pole.is_none() && chatters),
            pole,
            radial_n: [force(known.tool1_radial_force_n), force(known.tool2_radial_force_n)],
            cutting_n: force(known.cutting_force_n),
        }
    }

    /// Residuals of this row; their number depends on the table alone.
    fn residuals(&self, machine: &Machine, out: &mut Vec<f64>) {
        let terms = CutTerms::of(&machine.scenario, &self.at);
        let cut = CutLoop::new(&terms);
        let spread = machine.noise.growth_spread_1_s;
        let asked = self.outcome.is_some() || self.pole.as_ref().is_some_and(|p| p.chatters);
        let fastest = asked.then(|| rightmost_cut_root(&cut));
        if let Some(pole) = &self.pole {
            let seen = Root { growth_1_s: pole.growth_1_s, frequency_hz: pole.line_hz };
            let near = cut_root_near(&cut, seen).or(fastest);
            let root = near.unwrap_or_else(|| rightmost_cut_root(&cut));
            let sd = pole.growth_se_1_s.hypot(spread);
            out.push(doubted(pole.growth_1_s - root.growth_1_s, sd, GROWTH_RANGE_1_S));
            out.push(free_deviation(sd / pole.growth_se_1_s));
            let line_sd = pole.line_sd_hz.hypot(machine.noise.line_spread_hz);
            out.push(doubted(pole.line_hz - root.frequency_hz, line_sd, LINE_RANGE_HZ));
            out.push(free_deviation(line_sd / pole.line_sd_hz));
            if let Some(fastest) = fastest.filter(|_| pole.chatters) {
                out.push((fastest.growth_1_s - root.growth_1_s).max(0.0) / sd);
            }
        }
        if let Some((outcome, root)) = self.outcome.zip(fastest) {
            out.push(deviance(outcome, root.growth_1_s / machine.noise.outcome_spread_1_s));
            if let Some(line_hz) = self.line_hz {
                let near = cut_root_near(&cut, Root { growth_1_s: root.growth_1_s, frequency_hz: line_hz });
                let sd = LINE_SD_HZ[0].hypot(machine.noise.line_spread_hz);
                out.push(doubted(line_hz - near.unwrap_or(root).frequency_hz, sd, LINE_RANGE_HZ));
                out.push(free_deviation(sd / LINE_SD_HZ[0]));
            }
        }
        self.forces(machine, &cut, out);
    }

    fn forces(&self, machine: &Machine, cut: &CutLoop, out: &mut Vec<f64>) {
        let common = machine.noise.force_scatter.max(LEAST_FORCE_SCATTER);
        let own = OWN_OVER_COMMON * common;
        // A force of nothing in the model: far off, and no infinite residual.
        let log_ratio = |measured: f64, model: f64| (measured / model.max(1e-3 * measured)).ln();
        let mut push = |difference: f64, sd: f64| {
            out.push(doubted(difference, sd, FORCE_RANGE));
            out.push(free_deviation(common / LEAST_FORCE_SCATTER));
        };
        let means = cut.means();
        match self.radial_n {
            [Some(one), Some(two)] => {
                let each = [log_ratio(one, means.force_n[0]), log_ratio(two, means.force_n[1])];
                push(f64::midpoint(each[0], each[1]), common.hypot(own / 2f64.sqrt()));
                push(each[1] - each[0], own * 2f64.sqrt());
            }
            [Some(one), None] => push(log_ratio(one, means.force_n[0]), common.hypot(own)),
            [None, Some(two)] => push(log_ratio(two, means.force_n[1]), common.hypot(own)),
            [None, None] => {}
        }
        if let Some(measured) = self.cutting_n {
            // The round corner turns the radial share of the force, not the tangential one.
            let straight = Scenario {
                physics: machine.scenario.physics.without(EffectKind::NoseRadius),
                ..machine.scenario
            };
            let radial = CutLoop::new(&CutTerms::of(&straight, &self.at)).means().force_n[0];
            let model = radial * machine.scenario.cutting.raw().tangential_ratio * machine.noise.cutting_gain;
            push(log_ratio(measured, model), common.hypot(own));
        }
    }
}

/// Half the square of this is ln(sd/least sd).
fn free_deviation(over_least: f64) -> f64 {
    (2.0 * over_least.ln()).max(0.0).sqrt()
}

/// A residual of which one in a hundred is a mistake within `range`: half its square is -ln L.
fn doubted(difference: f64, sd: f64, range: f64) -> f64 {
    let r = difference / sd;
    let mistake = MISTAKEN_SHARE * (2.0 * std::f64::consts::PI).sqrt() * (sd / range).min(1.0);
    let right = 1.0 - MISTAKEN_SHARE;
    // Over what nothing at all would cost.
    let cost = -((right * (-0.5 * r * r).exp() + mistake) / (right + mistake)).ln();
    (2.0 * cost.max(0.0)).sqrt().copysign(r)
}

/// P(chatter) where the growth is that many spreads.
pub(crate) fn chatter_probability(growth_over_spread: f64) -> f64 {
    MISTAKEN_SHARE + (1.0 - 2.0 * MISTAKEN_SHARE) / (1.0 + (-growth_over_spread).exp())
}

/// Half the square of this is -ln P(outcome).
fn deviance(outcome: CutOutcome, growth_over_spread: f64) -> f64 {
    let chatter = chatter_probability(growth_over_spread);
    match outcome {
        CutOutcome::Chatter => (-2.0 * chatter.ln()).sqrt(),
        CutOutcome::Stable => -(-2.0 * (1.0 - chatter).ln()).sqrt(),
    }
}

impl TableRows {
    /// The rows of a table for which `taken` is true.
    pub(crate) fn new(table: &CutTable, scenario: &Scenario, taken: impl Fn(usize) -> bool) -> Self {
        let rows = table.rows.iter().enumerate().filter(|(k, _)| taken(*k));
        Self { rows: rows.map(|(_, row)| Row::new(row, scenario)).collect() }
    }
}

impl Observable for TableRows {
    fn part(&self, machine: &Machine, _: Every) -> Part {
        let mut out = Vec::with_capacity(6 * self.rows.len());
        for row in &self.rows {
            row.residuals(machine, &mut out);
        }
        Part::Rows(out)
    }

    fn origin(&self) -> Origin {
        Origin { kind: OriginKind::Table, recording: None, span_s: [0.0, 0.0] }
    }
}
