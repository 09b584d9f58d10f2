//! The rightmost root of the whole cut: planes, second mode, holder, lag, one tool or two unequal ones.

use super::root::{Root, rightmost_root};
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::{CutCondition, CutTerms};
use crate::plant::scenario::Scenario;
use nalgebra::Complex;
use std::f64::consts::{PI, TAU};

/// Steps of Newton's method before a seed is given up.
const STEPS: usize = 60;
/// Step of the difference that stands for the slope, 1/s: a thousandth of what bends the exponentials.
const SLOPE_STEP_1_S: f64 = 1e-3;
/// Longest step of Newton's method from a root that is near, 1/s: lines stand S/60 apart.
const NEAR_STEP_1_S: f64 = 40.0;
/// Most seeds of one search.
const MOST_SEEDS: f64 = 4000.0;

/// Growth and frequency of small vibration of a scenario at a condition.
///
/// The plain structure goes the fast way of [`rightmost_root`]; see [`rightmost_cut_root`] for the rest.
#[must_use]
pub fn scenario_root(scenario: &Scenario, at: &CutCondition) -> Root {
    rightmost_cut_root(&CutLoop::new(&CutTerms::of(scenario, at)))
}

/// The root farthest to the right of any cut, bending vibration only (as [`rightmost_root`]).
///
/// Newton on Delta times the denominators of its resonances, from seeds half a line apart between
/// half the lowest resonance and the highest that the cut can drive, and from each resonance.
/// Cost: 5 us for the plain structure, some 100 us to 1 ms else.
/// Checked by: `nothing_lies_right_of_the_root`, `an_effect_at_nothing_is_the_plain_cut`, and the lathe in
/// time (`tests/suite/cut_in_time.rs`).
#[must_use]
pub fn rightmost_cut_root(cut: &CutLoop) -> Root {
    if let Some(plain) = cut.two_delay() {
        return rightmost_root(&plain);
    }
    let lowest = cut.resonances().map(|r| r.rad_s).fold(f64::INFINITY, f64::min);
    if !lowest.is_finite() {
        // Tools at the chuck: nothing closes the loop, the bar rings by itself.
        let bar = cut.bar[0];
        return Root { growth_1_s: -bar.damping_ratio * bar.rad_s, frequency_hz: bar.rad_s / TAU };
    }
    search(cut, bending_from_rad_s(cut, lowest))
}

/// Half the lowest resonance, at the step of the ladder of fading marks nearest to it.
fn bending_from_rad_s(cut: &CutLoop, lowest_rad_s: f64) -> f64 {
    let half_step = TAU / (cut.delays_s[0] + cut.delays_s[1]).max(1e-9);
    (0.5 * lowest_rad_s - half_step).max(0.0)
}

/// The root that Newton's method reaches from a measured pole, in steps of at most 40 1/s; `None`: none near.
#[must_use]
pub fn cut_root_near(cut: &CutLoop, guess: Root) -> Option<Root> {
    let start = Complex::new(guess.growth_1_s, TAU * guess.frequency_hz);
    settle(cut, start, NEAR_STEP_1_S, f64::NEG_INFINITY).map(root_of)
}

fn root_of(s: Complex<f64>) -> Root {
    Root { growth_1_s: s.re, frequency_hz: s.im.abs() / TAU }
}

fn longest_delay_s(cut: &CutLoop) -> f64 {
    cut.delays_s[0].max(cut.delays_s[1]).max(1e-6)
}

/// The root that Newton's method reaches from a seed; `None` where it does not settle, or settles left of
/// `worth`.
fn settle(cut: &CutLoop, start: Complex<f64>, longest_step: f64, worth: f64) -> Option<Complex<f64>> {
    let value = |s: Complex<f64>| cut.delta(s) * cut.denominators(s);
    let longest2 = longest_step * longest_step;
    let mut s = start;
    for _ in 0..STEPS {
        let here = value(s);
        let slope = (value(s + SLOPE_STEP_1_S) - here) / SLOPE_STEP_1_S;
        let mut step = here / slope;
        let size2 = step.norm_sqr();
        if !size2.is_finite() {
            return None;
        }
        if size2 > longest2 {
            step *= (longest2 / size2).sqrt();
        }
        s -= step;
        // A billionth of the frequency: the difference quotient is good to a thousandth of that in one step.
        if size2 < 1e-18 * (1.0 + s.norm_sqr()) {
            return Some(s);
        }
        // After a step that is short against the bend of the exponentials the root is within a part of it.
        if size2 < 0.01 * longest2 && s.re + 0.2 * longest_step < worth {
            return None;
        }
    }
    None
}

/// The best root of those with an angular frequency of `lowest_rad_s` or more.
pub(super) fn search(cut: &CutLoop, lowest_rad_s: f64) -> Root {
    let tau = longest_delay_s(cut);
    let driven: f64 = cut.resonances().map(|r| r.gain_1_kg.abs()).sum::<f64>()
        * (cut.slope_n_m[0] + cut.slope_n_m[1] + 2.0 * cut.contact_n_m.abs());
    let highest = cut.resonances().map(|r| r.rad_s).fold(0.0, f64::max);
    // Delayed terms are no larger than those at once: no line stands above sqrt(w^2 + twice them).
    let high = 1.1 * (highest * highest + 2.0 * driven).sqrt();
    let step = (PI / tau).min((high - lowest_rad_s) / 6.0).max((high - lowest_rad_s) / MOST_SEEDS);
    let own = cut.resonances().flat_map(|r| {
        let in_cut = (r.rad_s * r.rad_s + driven).sqrt();
        let growth = -r.damping_ratio * r.rad_s;
        [Complex::new(growth, r.rad_s), Complex::new(growth, in_cut)]
    });
    let mut seeds: Vec<Complex<f64>> = own.collect();
    let likely = Likely { cut, alone: CutLoop { overlap: 0.0, ..*cut }, driven };
    let mut w = lowest_rad_s;
    while w <= high + step {
        seeds.push(Complex::new(likely.growth(w), w));
        w += step;
    }
    // The one that seems farthest to the right first: the root that it leads to makes most others worthless.
    let own = seeds[0];
    seeds.sort_unstable_by(|a, b| b.re.total_cmp(&a.re));
    let mut best: Option<Complex<f64>> = None;
    for seed in seeds {
        let worth = best.map_or(f64::NEG_INFINITY, |best| best.re);
        if let Some(s) = settle(cut, seed, 0.5 / tau, worth)
            && s.im.abs() >= lowest_rad_s
            && s.re > worth
        {
            best = Some(s);
        }
    }
    root_of(best.unwrap_or(own))
}

/// Where roots are likely.
struct Likely<'a> {
    cut: &'a CutLoop,
    /// The same cut without memory.
    alone: CutLoop,
    driven: f64,
}

impl Likely<'_> {
    /// Growth of a root near the angular frequency `w`: there what is delayed is as large as the rest,
    /// |D(j w)| e^{-growth tau} = |P(j w)|.
    fn growth(&self, w: f64) -> f64 {
        let s = Complex::new(0.0, w);
        let rest = self.alone.delta(s);
        // A twentieth: where both delayed terms cancel the root is elsewhere.
        let least = 0.05 * self.cut.bar_response(s).norm() * (self.cut.slope_n_m[0] + self.cut.slope_n_m[1]);
        let delayed = (self.cut.delta(s) - rest).norm().max(least * self.cut.overlap);
        let mean_s = (self.cut.delays_s[0] + self.cut.delays_s[1]) / 2.0;
        let most = self.driven / w.max(1.0);
        let growth = (delayed / rest.norm()).ln() / mean_s;
        if growth.is_finite() { growth.clamp(-most - 200.0, most) } else { -most - 200.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::super::count::cut_roots_right_of;
    use super::*;
    use crate::plant::cut_effects::{CutEffect, MOST_PARAMETERS, Physics, Role};
    use crate::plant::cutting::{RawCutting, TwoDelay};
    use crate::plant::scenario::{RawScenario, ToolCount};

    fn with(effects: &[CutEffect], raw: RawScenario) -> Scenario {
        let physics = Physics::new(effects).unwrap();
        Scenario::new(&RawScenario { physics, ..raw }).unwrap()
    }

    fn root(scenario: &Scenario) -> Root {
        scenario_root(scenario, &CutCondition::of(scenario))
    }

    /// A raw scenario in which an effect of that kind may stand.
    fn bare() -> RawScenario {
        let cutting = RawCutting { process_damping_n: 0.0, regeneration: false, ..RawCutting::default() };
        RawScenario { cutting, pitch_difference_rad: 0.05, position_m: Some(0.15), ..RawScenario::default() }
    }

    fn all_of_size(share: f64) -> Vec<CutEffect> {
        let of = |s: &crate::plant::cut_effects::Specification| {
            let mut values = [0.0; MOST_PARAMETERS];
            for (value, p) in values.iter_mut().zip(s.parameters) {
                let sized = matches!(p.role, Role::Key | Role::Size) && !p.neutral.is_nan();
                *value = if sized { p.of_size(share * p.size_of(p.scale)) } else { p.scale };
            }
            CutEffect::new(s.kind, values).unwrap()
        };
        CutEffect::SPECIFICATIONS.iter().map(of).collect()
    }

    fn plain_root(raw: &RawScenario) -> Root {
        let cutting = RawCutting { regeneration: true, ..raw.cutting };
        let scenario = Scenario::new(&RawScenario { cutting, ..*raw }).unwrap();
        rightmost_root(&TwoDelay::from_scenario(&scenario))
    }

    #[test]
    fn the_general_search_agrees_with_the_fast_one() {
        for pitch_difference_rad in [0.0, 0.05, 0.1, 0.3] {
            let scenario =
                Scenario::new(&RawScenario { pitch_difference_rad, ..RawScenario::default() }).unwrap();
            let cut = CutLoop::new(&CutTerms::of(&scenario, &CutCondition::of(&scenario)));
            let fast = rightmost_root(&TwoDelay::from_scenario(&scenario));
            let from_rad_s = bending_from_rad_s(&cut, cut.bar[0].rad_s);
            let (found, through) = (search(&cut, from_rad_s), root(&scenario));
            assert!((found.growth_1_s - fast.growth_1_s).abs() < 1e-6, "{found:?} {fast:?}");
            assert!((through.growth_1_s - fast.growth_1_s).abs() < 1e-6, "{through:?} {fast:?}");
            assert!((found.frequency_hz - fast.frequency_hz).abs() < 1e-6);
        }
    }

    #[test]
    fn an_effect_at_nothing_is_the_plain_cut() {
        let fast = plain_root(&bare());
        for effect in all_of_size(1e-7) {
            let mut raw = bare();
            raw.cutting.regeneration =
                effect.specification().kind != crate::plant::effects::EffectKind::RegenerativeEffect;
            let effect = if raw.cutting.regeneration { effect } else { all_of_size(1.0)[0] };
            let got = root(&with(&[effect], raw));
            assert!((got.growth_1_s - fast.growth_1_s).abs() < 1e-3, "{effect:?}: {got:?}, {fast:?}");
        }
    }

    /// No root lies right of the answer, by a count that shares nothing with the search.
    #[test]
    fn nothing_lies_right_of_the_root() {
        let whole = all_of_size(1.0);
        let regenerative = |raw: RawScenario, effects: &[CutEffect]| {
            let cutting = RawCutting { regeneration: true, ..raw.cutting };
            with(effects, RawScenario { cutting, ..raw })
        };
        for (case, effect) in whole.iter().enumerate().skip(1) {
            for tool_count in [ToolCount::Two, ToolCount::One] {
                for speed_rpm in [400.0, 1200.0, 2300.0] {
                    let other = whole[1 + (case * 7 + 3) % 20];
                    let effects =
                        if other.kind() == effect.kind() { vec![*effect] } else { vec![*effect, other] };
                    let scenario = regenerative(RawScenario { tool_count, speed_rpm, ..bare() }, &effects);
                    let cut = CutLoop::new(&CutTerms::of(&scenario, &CutCondition::of(&scenario)));
                    let got = search(&cut, 0.0);
                    let right = cut_roots_right_of(&cut, got.growth_1_s + 0.01);
                    assert_eq!(right, 0, "{effects:?} {tool_count:?} {speed_rpm}: {right} right of {got:?}");
                    assert!(cut_roots_right_of(&cut, got.growth_1_s - 0.01) >= 1, "{effects:?}: {got:?}");
                }
            }
        }
    }

    #[test]
    fn one_tool_without_memory_is_a_stiffer_bar() {
        let mut raw = bare();
        raw.tool_count = ToolCount::One;
        let scenario = with(&[], raw);
        let bar = CutTerms::of(&scenario, &CutCondition::of(&scenario)).bar_at_tools();
        let stiffer = scenario.cutting.stiffness_n_m() * bar.shape * bar.shape / bar.mass_kg;
        let wanted = ((TAU * bar.frequency_hz).powi(2) + stiffer).sqrt();
        let got = root(&scenario);
        assert!((got.growth_1_s + bar.damping_ratio * TAU * bar.frequency_hz).abs() < 1e-6, "{got:?}");
        assert!((got.frequency_hz * TAU - (wanted * wanted - got.growth_1_s.powi(2)).sqrt()).abs() < 1e-5);
    }

    #[test]
    fn means_of_the_plain_cut() {
        // Static balance of two equal tools: y = K (h2 - h1)/k_bar, h_j = advance +- 2 y.
        let scenario = with(&[], RawScenario { pitch_difference_rad: 0.3, ..RawScenario::default() });
        let cut = CutLoop::new(&CutTerms::of(&scenario, &CutCondition::of(&scenario)));
        let k = scenario.cutting.stiffness_n_m();
        let compliance = 1.0 / scenario.workpiece.modal_stiffness_n_m();
        let y = compliance * k * (cut.advance_m[1] - cut.advance_m[0]) / (1.0 + 4.0 * k * compliance);
        let means = cut.means();
        assert!((means.bar_m - y).abs() < 1e-12, "{means:?} {y}");
        assert!((means.force_n[0] - k * (cut.advance_m[0] + 2.0 * y)).abs() < 1e-6);
        assert!((means.force_n[1] - k * (cut.advance_m[1] - 2.0 * y)).abs() < 1e-6);
    }
}
