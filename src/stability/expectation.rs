//! What a stated cut allows: whether it can chatter at all, and at which frequencies.
//!
//! Numbers are stated to some accuracy and the tools stand somewhere along the outer part of the bar. Over
//! these, the rightmost roots span a growth and a stretch of frequencies. Chatter outside of it is no matter
//! of numbers: the model of the cut leaves something out. So it is with silence where every root grows, and
//! with a measured margin that none of them has.

use super::foretold::{DAMPING_RANGE, FLANK_RANGE, FREQUENCY_RANGE, PRESSURE_RANGE};
use super::scenario_root;
use crate::plant::cut_terms::CutCondition;
use crate::plant::scenario::{RawScenario, Scenario};

/// Where the tools may stand, of the stated place.
const PLACES: [f64; 3] = [0.7, 0.85, 1.0];
/// Growth times its duration after which chatter is heard: 150 times as large.
const HEARD: f64 = 5.0;

/// What is possible at a speed and pitch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CutExpectation {
    /// Largest growth of any root, 1/s; below zero chatter is impossible.
    pub highest_growth_1_s: f64,
    /// Smallest growth of a rightmost root, 1/s; above zero chatter is certain.
    pub lowest_growth_1_s: f64,
    /// Lowest and highest frequency of a rightmost root, Hz.
    pub lines_hz: [f64; 2],
    /// Lines stand this far apart, Hz: the next one may lead in the strongest of cuts.
    pub spacing_hz: f64,
}

/// How a cut differs from it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CutMismatch {
    /// The model calls the chatter that is heard impossible: its largest growth, 1/s.
    Impossible {
        /// Chatter, Hz.
        heard_hz: f64,
        /// Below zero.
        highest_growth_1_s: f64,
    },
    /// It can chatter, at other frequencies.
    OtherLine {
        /// Chatter, Hz.
        heard_hz: f64,
        /// Where it could, Hz.
        lines_hz: [f64; 2],
    },
    /// The model calls chatter certain, and there was none.
    Silence {
        /// How long the tools cut, s.
        lasted_s: f64,
        /// Above zero.
        lowest_growth_1_s: f64,
    },
    /// The measured margin is none that the model has.
    Margin {
        /// 95 % interval of what was measured, 1/s.
        measured_1_s: [f64; 2],
        /// What the model allows, 1/s.
        model_1_s: [f64; 2],
    },
}

impl CutMismatch {
    /// The name in the record.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Impossible { .. } => "impossible",
            Self::OtherLine { .. } => "other_line",
            Self::Silence { .. } => "silence",
            Self::Margin { .. } => "margin",
        }
    }

    /// One sentence for a person.
    #[must_use]
    pub fn sentence(self) -> String {
        match self {
            Self::Impossible { heard_hz, highest_growth_1_s: growth } => format!(
                "the cut differs from its model: chatter at {heard_hz:.1} Hz where the model calls it \
                 impossible (growth {growth:.1} 1/s at most)"
            ),
            Self::OtherLine { heard_hz, lines_hz: [low, high] } => format!(
                "the cut differs from its model: chatter at {heard_hz:.1} Hz, by the model it can stand \
                 between {low:.0} and {high:.0} Hz"
            ),
            Self::Silence { lasted_s, lowest_growth_1_s: growth } => format!(
                "the cut differs from its model: silent for {lasted_s:.1} s where the model calls chatter \
                 certain (growth {growth:.1} 1/s at least)"
            ),
            Self::Margin { measured_1_s: [lo, hi], model_1_s: [low, high] } => format!(
                "the cut differs from its model: a stability margin of {lo:.1} to {hi:.1} 1/s, by the \
                 model it lies between {low:.1} and {high:.1} 1/s"
            ),
        }
    }
}

impl CutExpectation {
    /// Of a scenario at a speed and pitch, the tools somewhere along the outer part of the bar.
    /// Errors: none; numbers that are not physical are left out.
    ///
    /// Cost: 18 searches for a root. Checked by: `what_the_model_foretells_is_no_mismatch`.
    #[must_use]
    pub fn of(scenario: &Scenario, speed_rpm: f64, pitch_rad: f64) -> Self {
        let stated_m = CutCondition::of(scenario).position_m;
        Self::at(scenario, [speed_rpm, pitch_rad], &PLACES.map(|place| place * stated_m))
    }

    /// The same with the tools at these places, m from the chuck.
    #[must_use]
    pub fn at(scenario: &Scenario, [speed_rpm, pitch_rad]: [f64; 2], places_m: &[f64]) -> Self {
        let mut found = Self {
            highest_growth_1_s: f64::NEG_INFINITY,
            lowest_growth_1_s: f64::INFINITY,
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
                    found.hold(&possible, places_m);
                }
            }
        }
        found
    }

    /// Whether the model says anything of this speed and pitch: where no number is physical it does not.
    fn is_known(&self) -> bool {
        self.lowest_growth_1_s.is_finite() && self.highest_growth_1_s.is_finite()
    }

    fn hold(&mut self, possible: &Scenario, places_m: &[f64]) {
        for position_m in places_m.iter().copied() {
            let at = CutCondition { position_m, ..CutCondition::of(possible) };
            let root = scenario_root(possible, &at);
            self.highest_growth_1_s = self.highest_growth_1_s.max(root.growth_1_s);
            self.lowest_growth_1_s = self.lowest_growth_1_s.min(root.growth_1_s);
            self.lines_hz =
                [self.lines_hz[0].min(root.frequency_hz), self.lines_hz[1].max(root.frequency_hz)];
        }
    }

    /// Whether chatter at `heard_hz` is none of what is possible.
    #[must_use]
    pub fn mismatch(&self, heard_hz: f64) -> Option<CutMismatch> {
        let [low, high] = self.lines_hz;
        if !self.is_known() {
            return None;
        }
        if self.highest_growth_1_s < 0.0 {
            let highest_growth_1_s = self.highest_growth_1_s;
            return Some(CutMismatch::Impossible { heard_hz, highest_growth_1_s });
        }
        let possible = low - self.spacing_hz..=high + self.spacing_hz;
        let lines_hz = self.lines_hz;
        (!possible.contains(&heard_hz)).then_some(CutMismatch::OtherLine { heard_hz, lines_hz })
    }

    /// Whether a cut that was silent for so long, with a margin of that 95 % interval where one was measured,
    /// is none of what is possible.
    #[must_use]
    pub fn mismatch_of_silence(&self, lasted_s: f64, margin_1_s: Option<[f64; 2]>) -> Option<CutMismatch> {
        if !self.is_known() {
            return None;
        }
        let lowest_growth_1_s = self.lowest_growth_1_s;
        if lowest_growth_1_s * lasted_s > HEARD {
            return Some(CutMismatch::Silence { lasted_s, lowest_growth_1_s });
        }
        let model_1_s = [-self.highest_growth_1_s, -lowest_growth_1_s];
        let apart = |[lo, hi]: &[f64; 2]| hi < &model_1_s[0] || lo > &model_1_s[1];
        let measured_1_s = margin_1_s.filter(apart)?;
        Some(CutMismatch::Margin { measured_1_s, model_1_s })
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
        assert!(mismatch.sentence().contains("650.0 Hz"));
    }

    #[test]
    fn of_what_is_not_physical_the_model_says_nothing() {
        let nothing = CutExpectation::of(&Scenario::default(), 0.0, 0.0);
        assert_eq!(nothing.mismatch(650.0), None);
        assert_eq!(nothing.mismatch_of_silence(60.0, Some([1.0, 2.0])), None);
    }

    /// At the free end the stated cut grows whatever its numbers' accuracy; with half a period between the
    /// tools it may be either, and its margin is one of those that its numbers allow.
    #[test]
    fn silence_where_all_roots_grow_and_a_margin_that_none_has_are() {
        let scenario = Scenario::default();
        let end_m = CutCondition::of(&scenario).position_m;
        let certain = CutExpectation::at(&scenario, [1200.0, 0.0], &[0.95 * end_m, end_m]);
        assert!(certain.lowest_growth_1_s > 5.0, "{certain:?}");
        let mismatch = certain.mismatch_of_silence(3.0, None).unwrap();
        assert_eq!(mismatch.name(), "silence");
        assert!(mismatch.sentence().contains("3.0 s"), "{}", mismatch.sentence());
        assert!(certain.mismatch_of_silence(1e-3, None).is_none(), "nothing has grown yet");
        // Half a period of 650 Hz between the tools: pi of phase.
        let pitch_rad = std::f64::consts::PI * 20.0 / 650.0;
        let healed = CutExpectation::at(&scenario, [1200.0, pitch_rad], &[end_m]);
        let root = |pitch_difference_rad: f64| {
            scenario_root(&scenario, &CutCondition { pitch_difference_rad, ..CutCondition::of(&scenario) })
        };
        let margin_1_s = -root(pitch_rad).growth_1_s;
        assert!(margin_1_s > 0.0);
        let about = |x: f64| Some([x - 3.0, x + 3.0]);
        assert!(healed.mismatch_of_silence(60.0, about(margin_1_s)).is_none(), "{healed:?}");
        let mismatch = healed.mismatch_of_silence(60.0, about(4.0 * margin_1_s + 100.0)).unwrap();
        assert_eq!(mismatch.name(), "margin");
        assert!(healed.mismatch_of_silence(60.0, None).is_none());
    }
}
