//! What a scenario foretells of a cut: root, and chance of chatter with what it says of its own accuracy.

use super::cut_root::scenario_root;
use super::root::Root;
use crate::plant::cut_terms::CutCondition;
use crate::plant::scenario::{RawScenario, Scenario};

/// Half ranges of the stated numbers, as shares (contracts, section 6).
pub(super) const PRESSURE_RANGE: f64 = 0.15;
pub(super) const DAMPING_RANGE: f64 = 0.30;
pub(super) const FREQUENCY_RANGE: f64 = 0.02;
pub(super) const FLANK_RANGE: f64 = 0.20;
/// A logistic curve of this steepness is the normal distribution within 0.01.
const LOGISTIC: f64 = 1.702;

/// What is foretold of one cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foretold {
    /// Rightmost root.
    pub root: Root,
    /// Standard deviation of its growth from the stated numbers, 1/s.
    pub growth_sd_1_s: f64,
}

impl Foretold {
    /// Chance that small vibration grows.
    #[must_use]
    pub fn chatter_probability(&self) -> f64 {
        // A thousandth of a 1/s: no scenario is better than that.
        1.0 / (1.0 + (-LOGISTIC * self.root.growth_1_s / self.growth_sd_1_s.max(1e-3)).exp())
    }
}

/// Root at a condition, and how far the accuracy of K_r, zeta, f_n and C_i moves its growth.
///
/// sd^2 = sum_i ((g(p_i + sd_i) - g(p_i - sd_i))/2)^2, sd_i = range/sqrt 3 (uniform), all independent.
/// Cost: nine roots. Checked by: `the_border_is_a_toss_up_and_far_from_it_is_not`.
#[must_use]
pub fn foretell(scenario: &Scenario, at: &CutCondition) -> Foretold {
    let raw = scenario.raw();
    let growth =
        |changed: RawScenario| Scenario::new(&changed).map_or(f64::NAN, |s| scenario_root(&s, at).growth_1_s);
    let moved = |range: f64, change: &dyn Fn(&mut RawScenario, f64)| {
        let by = |sign: f64| {
            let mut changed = raw;
            change(&mut changed, 1.0 + sign * range / 3.0f64.sqrt());
            growth(changed)
        };
        let half = (by(1.0) - by(-1.0)) / 2.0;
        if half.is_finite() { half } else { 0.0 }
    };
    let parts = [
        moved(PRESSURE_RANGE, &|r, factor| r.cutting.radial_stiffness_pa *= factor),
        moved(DAMPING_RANGE, &|r, factor| r.workpiece.damping_ratio *= factor),
        moved(FREQUENCY_RANGE, &|r, factor| r.workpiece = r.workpiece.with_frequency_factor(factor)),
        moved(FLANK_RANGE, &|r, factor| r.cutting.process_damping_n *= factor),
    ];
    Foretold {
        root: scenario_root(scenario, at),
        growth_sd_1_s: parts.iter().map(|p| p * p).sum::<f64>().sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_border_is_a_toss_up_and_far_from_it_is_not() {
        let scenario = Scenario::default();
        let at = |pitch_difference_rad| {
            foretell(&scenario, &CutCondition { pitch_difference_rad, ..CutCondition::of(&scenario) })
        };
        let (mut low, mut high) = (0.05, 0.096);
        for _ in 0..40 {
            let middle = (low + high) / 2.0;
            if at(middle).root.growth_1_s > 0.0 { low = middle } else { high = middle }
        }
        assert!((at(low).chatter_probability() - 0.5).abs() < 0.01);
        let [equal, opposed] = [0.0, 0.096].map(|d| at(d).chatter_probability());
        assert!(equal > 0.98 && opposed < 0.1, "{equal} {opposed}");
    }
}
