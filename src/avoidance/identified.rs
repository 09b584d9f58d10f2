//! The linear two-delay equation of the cut that is heard: what its line says about the bar and the tools.
//!
//! ```text
//!  frequency, growth, S, pitch --> s = growth + j w is a root --> two linear equations for damping and
//!                                                                  cutting stiffness, for each likely bar
//!  bar and cut as the operator stated them --> how likely is each answer --> candidates with weights
//! ```
//!
//! One line gives two real equations; the natural frequency is the third unknown. It is known from the
//! workpiece to a few percent, so a handful of values are tried and each answer is weighed by how well it
//! agrees with what was stated. When no answer is plausible there is no identification: say so.

use crate::plant::cutting::{TwoDelay, delays_s};
use crate::plant::scenario::Scenario;
use crate::stability::rightmost_root;
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// One chatter line with what held while it was heard.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct HeardLine {
    /// Frequency.
    pub frequency_hz: f64,
    /// Growth of its amplitude while it grew, where that was seen.
    pub growth_1_s: Option<f64>,
    /// One turn of the spindle.
    pub turn_s: f64,
    /// Pitch difference then.
    pub pitch_rad: f64,
}

crate::keyframe::keep!(HeardLine { frequency_hz, growth_1_s, turn_s, pitch_rad });

impl HeardLine {
    /// The line that says most: one that was seen to grow at equal pitch; the newest of them the most of now.
    pub(super) fn source(lines: &[Self]) -> Option<&Self> {
        lines.iter().find(|l| l.pitch_rad.abs() < 0.01).or(lines.first())
    }

    /// Growth and its uncertainty, 1/s.
    pub(super) fn growth_and_sigma_1_s(&self) -> [f64; 2] {
        self.growth_1_s.map_or(UNSEEN_GROWTH_1_S, |g| [g, HEARD_1_S + 0.25 * g.abs()])
    }
}

/// How likely chatter is to be heard where the root grows by `growth_1_s`.
pub(super) fn audible(growth_1_s: f64) -> f64 {
    1.0 / (1.0 + (-growth_1_s / HEARD_1_S).exp())
}

/// One possible cut, frozen at the place where the line was heard.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Share of belief; all together one.
    pub weight: f64,
    /// Square of the bar's natural frequency, 1/s2.
    pub stiffness_1_s2: f64,
    /// Damping of the bar alone, 1/s.
    pub bar_damping_1_s: f64,
    /// Damping by the flanks at the speed of the line, 1/s.
    pub flank_damping_1_s: f64,
    /// Cutting stiffness of one tool over the mass, 1/s2.
    pub cutting_1_s2: f64,
    /// One turn while it was heard, s: flank damping falls with the speed.
    pub turn_s: f64,
}

/// Natural frequencies tried, in units of their uncertainty.
const FREQUENCY_STEPS: [f64; 7] = [-2.0, -1.3, -0.65, 0.0, 0.65, 1.3, 2.0];
/// The stated bar bends at its frequency within this (one sigma): clamp and material.
const FREQUENCY_SIGMA: f64 = 0.025;
/// ln of cutting stiffness: material, wear, and where along the bar the tools are.
const CUTTING_SIGMA: f64 = 0.6;
/// ln of damping.
const DAMPING_SIGMA: f64 = 0.6;
/// The tools stand somewhere in the outer half of the bar: phi^2 about this.
const SHAPE_SQUARED: f64 = 0.75;
/// Growth of chatter that was not seen to grow, and its uncertainty.
const UNSEEN_GROWTH_1_S: [f64; 2] = [25.0, 20.0];
/// Accuracy of a growth near zero, and the width of the border between silence and chatter, 1/s.
const HEARD_1_S: f64 = 8.0;
/// Chatter is heard at the root that grows fastest, or nearly.
const LEAD_SIGMA_1_S: f64 = 12.0;
/// Candidates of less weight than this part of the best are dropped.
const WORTH: f64 = 0.05;
/// Most candidates that are kept.
const MOST: usize = 6;
/// Worse than this (three sigma) even the best answer contradicts what was stated.
pub(super) const PLAUSIBLE: f64 = 0.011;

impl Candidate {
    /// The equation at a turn and pitch, with the cut (stiffness and flank) `share` times as strong.
    #[must_use]
    pub fn equation(&self, turn_s: f64, pitch_rad: f64, share: f64) -> TwoDelay {
        let [delay_1_s, delay_2_s] = delays_s(turn_s, pitch_rad);
        TwoDelay {
            mass_kg: 1.0,
            damping_n_s_m: self.bar_damping_1_s + self.flank_damping_1_s * share * turn_s / self.turn_s,
            stiffness_n_m: self.stiffness_1_s2,
            cutting_stiffness_n_m: self.cutting_1_s2 * share,
            delay_1_s,
            delay_2_s,
        }
    }

    /// Growth of the rightmost root there.
    #[must_use]
    pub fn growth_1_s(&self, turn_s: f64, pitch_rad: f64, share: f64) -> f64 {
        rightmost_root(&self.equation(turn_s, pitch_rad, share)).growth_1_s
    }

    /// Share of the cut at which a line stands, from its frequency alone (growth zero):
    ///
    /// K'/K = (w^2 - w_n^2) / (K (2 + cos w tau1 + cos w tau2))
    #[must_use]
    pub fn share_of_line(&self, line: &HeardLine) -> Option<f64> {
        let w = TAU * line.frequency_hz;
        let [tau1, tau2] = delays_s(line.turn_s, line.pitch_rad);
        let share =
            (w * w - self.stiffness_1_s2) / (self.cutting_1_s2 * (2.0 + (w * tau1).cos() + (w * tau2).cos()));
        (share.is_finite() && share > 0.0).then_some(share)
    }
}

/// Solves s^2 + c s + w_n^2 + K g(s) = 0, g = 2 + e^{-s tau1} + e^{-s tau2}, for c and K (over the mass).
///
/// Real and imaginary part are two linear equations. `None` where they do not tell the two apart.
/// Checked by: `a_root_gives_its_equation_back`.
#[must_use]
pub fn damping_and_cutting(line: &HeardLine, growth_1_s: f64, stiffness_1_s2: f64) -> Option<[f64; 2]> {
    let s = Complex::new(growth_1_s, TAU * line.frequency_hz);
    let [tau1, tau2] = delays_s(line.turn_s, line.pitch_rad);
    let g = (-s * tau1).exp() + (-s * tau2).exp() + 2.0;
    // Per unit of frequency, so that both rows are of one size.
    let (a, b) = (s.re, g.re / s.im);
    let (c, d) = (s.im, g.im / s.im);
    let right = [s.im * s.im - s.re * s.re - stiffness_1_s2, -2.0 * s.re * s.im];
    let determinant = a * d - c * b;
    if determinant.abs() < 1e-3 {
        return None;
    }
    let damping = (right[0] * d - b * right[1]) / determinant;
    let cutting = (a * right[1] - c * right[0]) / determinant / s.im;
    (damping.is_finite() && cutting.is_finite()).then_some([damping, cutting])
}

fn normal(x: f64) -> f64 {
    (-0.5 * x * x).exp()
}

/// What one line says, weighed by what was stated. Empty: no answer is plausible.
///
/// Cost: 21 searches for a root, about half a millisecond. Checked by: `the_cut_is_found_from_its_line`.
#[must_use]
pub fn identify(stated: &Scenario, line: &HeardLine) -> Vec<Candidate> {
    let bar = &stated.workpiece;
    let mass_kg = bar.modal_mass_kg();
    let flank = 2.0 * stated.cutting.process_damping_n_s_m(PI * bar.diameter_m() / line.turn_s);
    let flank_1_s = flank / mass_kg * SHAPE_SQUARED;
    let bar_1_s = bar.modal_damping_n_s_m() / mass_kg;
    let stated_cutting = stated.cutting.stiffness_n_m() / mass_kg * SHAPE_SQUARED;
    let [growth, sigma] = line.growth_and_sigma_1_s();
    let mut found = Vec::new();
    for step in FREQUENCY_STEPS {
        let natural = TAU * bar.bending_frequency_hz() * (1.0 + step * FREQUENCY_SIGMA);
        for aside in [-1.0, 0.0, 1.0] {
            let growth_1_s = growth + aside * sigma;
            let Some([damping, cutting]) = damping_and_cutting(line, growth_1_s, natural * natural) else {
                continue;
            };
            if !(damping > 0.0 && cutting > 0.0) {
                continue;
            }
            let off_cutting = (cutting / stated_cutting).ln() / CUTTING_SIGMA;
            let off_damping = (damping / (bar_1_s + flank_1_s)).ln() / DAMPING_SIGMA;
            let weight = normal(step) * normal(aside) * normal(off_cutting) * normal(off_damping);
            let split = bar_1_s / (bar_1_s + flank_1_s);
            let candidate = Candidate {
                weight,
                stiffness_1_s2: natural * natural,
                bar_damping_1_s: damping * split,
                flank_damping_1_s: damping * (1.0 - split),
                cutting_1_s2: cutting,
                turn_s: line.turn_s,
            };
            found.push((candidate, growth_1_s));
        }
    }
    let best = found.iter().map(|(c, _)| c.weight).fold(0.0, f64::max);
    found.retain(|(c, _)| c.weight > WORTH * best);
    let led = found.into_iter().map(|(c, growth_1_s)| {
        let lead = c.growth_1_s(line.turn_s, line.pitch_rad, 1.0) - growth_1_s;
        Candidate { weight: c.weight * normal(lead / LEAD_SIGMA_1_S), ..c }
    });
    settle(led.collect())
}

/// Weighs candidates by another line that was heard: chatter there must be likely.
pub(super) fn weigh(candidates: Vec<Candidate>, line: &HeardLine) -> Vec<Candidate> {
    let weighed = candidates.into_iter().map(|c| {
        let share = c.share_of_line(line).unwrap_or(1.0).clamp(0.5, 1.5);
        let growth = c.growth_1_s(line.turn_s, line.pitch_rad, share);
        Candidate { weight: c.weight * audible(growth), ..c }
    });
    let weighed: Vec<Candidate> = weighed.collect();
    let best = weighed.iter().map(|c| c.weight).fold(0.0, f64::max);
    // None of them expected it: they are all wrong.
    if best < 0.02 { Vec::new() } else { normalized(weighed) }
}

/// The best few, or none when even the best is implausible.
fn settle(mut candidates: Vec<Candidate>) -> Vec<Candidate> {
    candidates.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    let best = candidates.first().map_or(0.0, |c| c.weight);
    if best < PLAUSIBLE {
        return Vec::new();
    }
    candidates.retain(|c| c.weight > WORTH * best);
    candidates.truncate(MOST);
    normalized(candidates)
}

fn normalized(mut candidates: Vec<Candidate>) -> Vec<Candidate> {
    let sum: f64 = candidates.iter().map(|c| c.weight).sum();
    candidates.iter_mut().for_each(|c| c.weight /= sum.max(f64::MIN_POSITIVE));
    candidates
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::cutting::RawCutting;
    use crate::plant::scenario::RawScenario;
    use crate::plant::workpiece::RawWorkpiece;

    fn scenario(raw: &RawScenario) -> Scenario {
        Scenario::new(raw).unwrap()
    }

    fn line_of(scenario: &Scenario) -> (HeardLine, TwoDelay) {
        let equation = TwoDelay::from_scenario(scenario);
        let root = rightmost_root(&equation);
        let line = HeardLine {
            frequency_hz: root.frequency_hz,
            growth_1_s: Some(root.growth_1_s),
            turn_s: scenario.spindle.period_s(),
            pitch_rad: scenario.tools.pitch_difference_rad(),
        };
        (line, equation)
    }

    #[test]
    fn a_root_gives_its_equation_back() {
        for pitch_difference_rad in [0.0, 0.03, 0.07] {
            let cut = scenario(&RawScenario { pitch_difference_rad, ..RawScenario::default() });
            let (line, equation) = line_of(&cut);
            let m = equation.mass_kg;
            let natural = equation.stiffness_n_m / m;
            let [c, k] = damping_and_cutting(&line, line.growth_1_s.unwrap(), natural).unwrap();
            assert!((c / (equation.damping_n_s_m / m) - 1.0).abs() < 1e-6, "damping {c}");
            assert!((k / (equation.cutting_stiffness_n_m / m) - 1.0).abs() < 1e-6, "cutting {k}");
        }
    }

    /// The operator's numbers are wrong by usual amounts; frequency and growth set them right.
    #[test]
    fn the_cut_is_found_from_its_line() {
        let stated = scenario(&RawScenario {
            workpiece: RawWorkpiece { clamp_factor: 0.99, ..RawWorkpiece::default() },
            cutting: RawCutting { radial_stiffness_pa: 1600e6, ..RawCutting::default() },
            ..RawScenario::default()
        });
        let (line, equation) = line_of(&Scenario::default());
        let found = identify(&stated, &line);
        assert!(!found.is_empty());
        let mean: f64 = found.iter().map(|c| c.weight * c.cutting_1_s2).sum();
        let truth = equation.cutting_stiffness_n_m / equation.mass_kg;
        assert!((mean / truth - 1.0).abs() < 0.25, "{mean} for {truth}");
        assert!((found.iter().map(|c| c.weight).sum::<f64>() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_line_below_the_bar_says_nothing() {
        let line = HeardLine { frequency_hz: 420.0, growth_1_s: Some(20.0), turn_s: 0.05, pitch_rad: 0.0 };
        assert!(identify(&Scenario::default(), &line).is_empty());
    }
}
