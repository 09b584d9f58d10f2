//! Which cuts to add: those in which the two likeliest machines differ most.
//!
//! Needs no data: of a grid of cuts about the scenario's, each machine foretells growth and line of the
//! rightmost root and the mean forces; what a recording of a few seconds tells of them is known beforehand.
//! The expected gain is half the squared distance in those standard deviations.

use super::answer::Fitting;
use super::laws::Law;
use super::result::PlannedCut;
use super::search::level_nats;
use crate::plant::cut_loop::{CutLoop, CutMeans};
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::Scenario;
use crate::stability::{Root, rightmost_cut_root};

/// Accuracy with which one cut of a few seconds tells its line, Hz, its growth, 1/s, and its mean forces, of
/// themselves (the rows of a table of cuts: contracts, section 6).
const TOLD: Told = Told { line_hz: 0.5, growth_1_s: 1.0, force_share: 0.008 };
/// Cuts that are proposed at most.
const MOST: usize = 3;
/// How long each, s: wear and drift need the time.
const DURATION_S: f64 = 6.0;

struct Told {
    line_hz: f64,
    growth_1_s: f64,
    force_share: f64,
}

/// What a machine foretells of a cut.
struct Foretold {
    root: Root,
    means: CutMeans,
}

impl Foretold {
    fn of(scenario: &Scenario, at: &CutCondition) -> Self {
        let cut = CutLoop::new(&CutTerms::of(scenario, at));
        Self { root: rightmost_cut_root(&cut), means: cut.means() }
    }

    /// Half the squared distance, nats.
    fn apart_nats(&self, other: &Self) -> f64 {
        let line = (self.root.frequency_hz - other.root.frequency_hz) / TOLD.line_hz;
        let growth = (self.root.growth_1_s - other.root.growth_1_s) / TOLD.growth_1_s;
        let force = |j: usize| {
            let [a, b] = [self.means.force_n[j], other.means.force_n[j]];
            (a - b) / (TOLD.force_share * a.abs().max(1.0))
        };
        // A line may hop to the next lobe, and a difference of a hundred tells no more than one of ten.
        let bounded = |d: f64| d.clamp(-10.0, 10.0).powi(2);
        0.5 * (bounded(line) + bounded(growth) + bounded(force(0)) + bounded(force(1)))
    }
}

/// Cuts to add, the most telling first; none where nothing is left to tell.
pub(crate) fn plan(fitting: &Fitting<'_>) -> Vec<PlannedCut> {
    let Some((machines, between)) = rivals(fitting) else { return Vec::new() };
    let stated = &fitting.problem.frame.stated;
    let mut ranked: Vec<(f64, CutCondition)> = grid(stated)
        .into_iter()
        .map(|at| {
            let [a, b] = [0, 1].map(|k| Foretold::of(&machines[k], &at));
            (a.apart_nats(&b), at)
        })
        .filter(|(nats, _)| *nats > 1.0)
        .collect();
    ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut out: Vec<PlannedCut> = Vec::new();
    let mut sum = 0.0;
    for (nats, at) in ranked {
        if out.len() == MOST || sum > 2.0 * level_nats() {
            break;
        }
        // Two cuts that differ in nothing but one setting say the same twice.
        let alike = |p: &PlannedCut| {
            (p.spindle_speed_rpm - at.speed_rpm).abs() < 1.0
                && (p.tool_position_m - at.position_m).abs() < 1e-6
        };
        if out.iter().any(alike) {
            continue;
        }
        sum += nats;
        out.push(PlannedCut {
            spindle_speed_rpm: at.speed_rpm,
            feed_m_rev: at.feed_m_rev,
            width_m: at.width_m,
            tool_position_m: at.position_m,
            pitch_difference_rad: at.pitch_difference_rad,
            duration_s: DURATION_S,
            tells: between.clone(),
            expected_nats: nats,
        });
    }
    out
}

/// The two machines that are hardest to tell apart and matter, and what lies between them.
fn rivals(fitting: &Fitting<'_>) -> Option<([Scenario; 2], String)> {
    let frame = fitting.problem.frame;
    let round = fitting.selected.rounds.first()?;
    let scenario = |point| frame.machine(point).map(|m| m.scenario);
    let best = round.fitted.first()?;
    let spoken = |law: Law| law.name().replace('_', " ");
    let found = spoken(best.hypothesis.law);
    let second = round.fitted.get(1);
    let rival = second.filter(|s| round.accepted && best.evidence_nats - s.evidence_nats < level_nats());
    if let Some(rival) = rival {
        let between = format!("it tells {found} from {}", spoken(rival.hypothesis.law));
        return Some(([scenario(&best.model.point)?, scenario(&rival.model.point)?], between));
    }
    if round.accepted {
        return None;
    }
    // Nothing was taken up: the likeliest of what was not, at the size that it may have, against nothing.
    let between = format!("it tells whether there is any {found}");
    Some(([scenario(&fitting.start.point)?, scenario(&best.model.point)?], between))
}

/// Cuts about the scenario's own, as a shop can set them.
fn grid(stated: &Scenario) -> Vec<CutCondition> {
    let own = CutCondition::of(stated);
    let mut out = Vec::new();
    for speed in [0.7, 1.0, 1.3] {
        for width in [0.7, 1.3] {
            for position in [1.0, 0.75, 0.5] {
                for (feed, pitch) in [(1.0, 0.0), (0.6, 0.1), (1.6, 0.1)] {
                    out.push(CutCondition {
                        speed_rpm: own.speed_rpm * speed,
                        width_m: own.width_m * width,
                        position_m: own.position_m * position,
                        feed_m_rev: own.feed_m_rev * feed,
                        pitch_difference_rad: pitch,
                        time_s: DURATION_S / 2.0,
                        edge_age_s: DURATION_S / 2.0,
                        ..own
                    });
                }
            }
        }
    }
    out
}
