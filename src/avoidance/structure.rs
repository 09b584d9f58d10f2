//! A stated cut with physics beyond two delays: the scenario itself, moved within what is left of its doubt.
//!
//! ```text
//!  scenario as diagnosed --> five frequencies, three strengths, three dampings --> root near the heard line
//!  heard frequency and growth ------------------------------------------------> how likely is each
//! ```
//!
//! The two-delay equation of [`identified`](super::identified) has no second plane, holder or lag; a line
//! that these shift would be given to damping and stiffness, and the pitch be chosen for another cut.

use super::identified::{HeardLine, PLAUSIBLE, audible};
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::Scenario;
use crate::stability::{Root, cut_root_near, rightmost_cut_root};

/// Natural frequencies tried, as factors: a diagnosed bar is known to a percent, warmth and stock included.
const FREQUENCY_FACTORS: [f64; 5] = [0.98, 0.99, 1.0, 1.01, 1.02];
/// Strengths of the cut tried: where along the bar the tools are, wear.
const CUT_FACTORS: [f64; 3] = [0.8, 1.0, 1.2];
/// Damping ratios tried.
const DAMPING_FACTORS: [f64; 3] = [0.8, 1.0, 1.25];
/// A line stands where the root does within this, Hz: the contract's accuracy of a foretold line.
const LINE_SIGMA_HZ: f64 = 3.0;
/// Most that are kept: each costs some 60 searches for a root.
const MOST: usize = 3;
/// One possible cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct StructuredCut {
    /// Share of belief; all together one.
    pub(super) weight: f64,
    scenario: Scenario,
}

impl StructuredCut {
    /// Growth of the rightmost root at a turn and pitch, with the cut `share` times as strong.
    pub(super) fn growth_1_s(&self, turn_s: f64, pitch_rad: f64, share: f64) -> f64 {
        rightmost_cut_root(&self.at(turn_s, pitch_rad, share)).growth_1_s
    }

    fn at(&self, turn_s: f64, pitch_rad: f64, share: f64) -> CutLoop {
        let stated = CutCondition::of(&self.scenario);
        CutLoop::new(&CutTerms::of(
            &self.scenario,
            &CutCondition {
                speed_rpm: 60.0 / turn_s,
                pitch_difference_rad: pitch_rad,
                width_m: stated.width_m * share,
                ..stated
            },
        ))
    }

    /// How well the root near a line explains it: one where both agree.
    fn likelihood(&self, line: &HeardLine) -> f64 {
        let [growth_1_s, sigma_1_s] = line.growth_and_sigma_1_s();
        let heard = Root { growth_1_s, frequency_hz: line.frequency_hz };
        cut_root_near(&self.at(line.turn_s, line.pitch_rad, 1.0), heard).map_or(0.0, |root| {
            let off_line = (root.frequency_hz - line.frequency_hz) / LINE_SIGMA_HZ;
            let off_growth = (root.growth_1_s - growth_1_s) / sigma_1_s;
            (-0.5 * (off_line * off_line + off_growth * off_growth)).exp()
        })
    }
}

/// What the lines allow a stated scenario to be, the likeliest first; empty: it contradicts what is heard.
///
/// Cost: 45 searches near a line, some milliseconds. Checked by: `a_holder_that_gives_is_in_the_choice`.
pub(super) fn structured_cuts(stated: &Scenario, lines: &[HeardLine]) -> Vec<StructuredCut> {
    let Some(source) = HeardLine::source(lines) else { return Vec::new() };
    let mut cuts = Vec::new();
    for frequency in FREQUENCY_FACTORS {
        for strength in CUT_FACTORS {
            for damping in DAMPING_FACTORS {
                let mut raw = stated.raw();
                raw.workpiece = raw.workpiece.with_frequency_factor(frequency);
                raw.workpiece.damping_ratio *= damping;
                raw.cutting.radial_stiffness_pa *= strength;
                if let Ok(scenario) = Scenario::new(&raw) {
                    let cut = StructuredCut { weight: 1.0, scenario };
                    cuts.push(StructuredCut { weight: cut.likelihood(source), ..cut });
                }
            }
        }
    }
    cuts.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    cuts.truncate(MOST);
    // What was heard at another pitch must have been able to grow there.
    for line in lines.iter().filter(|l| *l != source) {
        for cut in &mut cuts {
            cut.weight *= audible(cut.growth_1_s(line.turn_s, line.pitch_rad, 1.0));
        }
    }
    let best = cuts.iter().map(|c| c.weight).fold(0.0, f64::max);
    if best < PLAUSIBLE {
        return Vec::new();
    }
    let sum: f64 = cuts.iter().map(|c| c.weight).sum();
    cuts.iter_mut().for_each(|c| c.weight /= sum);
    cuts
}
