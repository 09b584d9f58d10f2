//! What a stated cut allows: whether it can chatter at all, and at which frequencies.
//!
//! Numbers are stated to some accuracy and the tools stand somewhere along the outer part of the bar. Over
//! these, the rightmost roots span a growth and a stretch of frequencies. Chatter outside of it is no matter
//! of numbers: the model of the cut leaves something out.

use super::foretold::{DAMPING_RANGE, FLANK_RANGE, FREQUENCY_RANGE, PRESSURE_RANGE};
use super::scenario_root;
use crate::plant::cut_terms::CutCondition;
use crate::plant::scenario::{RawScenario, Scenario};

/// Where the tools may stand, of the stated place.
const PLACES: [f64; 3] = [0.7, 0.85, 1.0];

/// What is possible at a speed and pitch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutExpectation {
    /// Largest growth of any root, 1/s; below zero chatter is impossible.
    pub highest_growth_1_s: f64,
    /// Lowest and highest frequency of a rightmost root, Hz.
    pub lines_hz: [f64; 2],
    /// Lines stand this far apart, Hz: the next one may lead in the strongest of cuts.
    pub spacing_hz: f64,
}

/// How heard chatter differs from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CutMismatch {
    /// The model calls chatter impossible: its largest growth, 1/s.
    Impossible {
        /// Below zero.
        highest_growth_1_s: f64,
    },
    /// It can chatter, at other frequencies.
    OtherLine {
        /// Where it could, Hz.
        lines_hz: [f64; 2],
    },
}

impl CutMismatch {
    /// The name in the record.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Impossible { .. } => "impossible",
            Self::OtherLine { .. } => "other_line",
        }
    }

    /// One sentence for a person.
    #[must_use]
    pub fn sentence(self, heard_hz: f64) -> String {
        match self {
            Self::Impossible { highest_growth_1_s: growth } => format!(
                "the cut differs from its model: chatter at {heard_hz:.1} Hz where the model calls it \
                 impossible (growth {growth:.1} 1/s at most)"
            ),
            Self::OtherLine { lines_hz: [low, high] } => format!(
                "the cut differs from its model: chatter at {heard_hz:.1} Hz, by the model it can stand \
                 between {low:.0} and {high:.0} Hz"
            ),
        }
    }
}

impl CutExpectation {
    /// Of a scenario at a speed and pitch. Errors: none; numbers that are not physical are left out.
    ///
    /// Cost: 18 searches for a root. Checked by: `what_the_model_foretells_is_no_mismatch`.
    #[must_use]
    pub fn of(scenario: &Scenario, speed_rpm: f64, pitch_rad: f64) -> Self {
        let mut found = Self {
            highest_growth_1_s: f64::NEG_INFINITY,
            lines_hz: [f64::INFINITY, 0.0],
            spacing_hz: speed_rpm / 60.0,
        };
        for off in [-1.0, 0.0, 1.0] {
            // The quiet corner of what damps and what feeds, and the loud one.
            for loud in [-1.0, 1.0] {
                let raw = scenario.raw();
                let mut raw = RawScenario { speed_rpm, pitch_difference_rad: pitch_rad, ..raw };
                raw.workpiece = raw.workpiece.with_frequency_factor(1.0 + off * FREQUENCY_RANGE);
                raw.workpiece.damping_ratio *= 1.0 - loud * DAMPING_RANGE;
                raw.cutting.radial_stiffness_pa *= 1.0 + loud * PRESSURE_RANGE;
                raw.cutting.process_damping_n *= 1.0 - loud * FLANK_RANGE;
                if let Ok(possible) = Scenario::new(&raw) {
                    found.hold(&possible);
                }
            }
        }
        found
    }

    fn hold(&mut self, possible: &Scenario) {
        let stated = CutCondition::of(possible);
        for place in PLACES {
            let at = CutCondition { position_m: place * stated.position_m, ..stated };
            let root = scenario_root(possible, &at);
            self.highest_growth_1_s = self.highest_growth_1_s.max(root.growth_1_s);
            self.lines_hz =
                [self.lines_hz[0].min(root.frequency_hz), self.lines_hz[1].max(root.frequency_hz)];
        }
    }

    /// Whether chatter at `heard_hz` is none of what is possible.
    #[must_use]
    pub fn mismatch(&self, heard_hz: f64) -> Option<CutMismatch> {
        let [low, high] = self.lines_hz;
        if self.highest_growth_1_s < 0.0 {
            return Some(CutMismatch::Impossible { highest_growth_1_s: self.highest_growth_1_s });
        }
        let possible = low - self.spacing_hz..=high + self.spacing_hz;
        (!possible.contains(&heard_hz)).then_some(CutMismatch::OtherLine { lines_hz: self.lines_hz })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::cut_effects::{CutEffect, Physics};
    use crate::plant::effects::EffectKind;

    #[test]
    fn what_the_model_foretells_is_no_mismatch() {
        let scenario = Scenario::default();
        for (speed_rpm, pitch_rad) in [(900.0, 0.0), (1200.0, 0.0), (1200.0, 0.03), (1730.0, 0.0)] {
            let raw = RawScenario { speed_rpm, pitch_difference_rad: pitch_rad, ..scenario.raw() };
            let now = Scenario::new(&raw).unwrap();
            let root = scenario_root(&now, &CutCondition::of(&now));
            let expected = CutExpectation::of(&scenario, speed_rpm, pitch_rad);
            assert!(root.growth_1_s > 0.0 && expected.mismatch(root.frequency_hz).is_none(), "{expected:?}");
        }
    }

    #[test]
    fn a_second_mode_and_a_calm_cut_that_chatters_are() {
        let plain = Scenario::default();
        let mode = CutEffect::new(EffectKind::SecondMode, [900.0, 0.006, 1.2e6]).unwrap();
        let richer = Scenario { physics: Physics::new(&[mode]).unwrap(), ..plain };
        let line_hz = scenario_root(&richer, &CutCondition::of(&richer)).frequency_hz;
        let mismatch = CutExpectation::of(&plain, 1200.0, 0.0).mismatch(line_hz).unwrap();
        assert_eq!(mismatch.name(), "other_line", "{line_hz} {mismatch:?}");
        assert!(CutExpectation::of(&richer, 1200.0, 0.0).mismatch(line_hz).is_none());
        let mut light = plain.raw();
        light.cutting.width_m = 0.01e-3;
        let light = Scenario::new(&light).unwrap();
        let mismatch = CutExpectation::of(&light, 1200.0, 0.0).mismatch(650.0).unwrap();
        assert_eq!(mismatch.name(), "impossible");
        assert!(mismatch.sentence(650.0).contains("650.0 Hz"));
    }
}
