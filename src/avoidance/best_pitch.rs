//! Which pitch: the one that keeps the identified cut farthest from growing, whatever the line does next.
//!
//! Margin is minus the growth rate of the rightmost root of the two-delay equation. It is taken at its worst
//! over the tracked lines and their likely drift (the tools move on, the bar gets lighter: the cut holds the
//! bar more or less firmly than now) and averaged over what the cut may be. m = 0 unless more pays.

use super::identified::{Candidate, HeardLine, identify, weigh};
use super::pitch::wave_phase_difference_rad;
use super::structure::{StructuredCut, structured_cuts};
use crate::plant::scenario::Scenario;
use crate::stability::margin::RECOVERED_1_S;
use crate::units::SpindleSpeed;
use std::f64::consts::PI;

/// What the model says.
#[derive(Debug, Clone, PartialEq)]
pub enum PitchAdvice {
    /// It says nothing: no cut was stated, or what is heard contradicts it.
    NotIdentified,
    /// This pitch.
    Pitch {
        /// Pitch difference, rad.
        pitch_rad: f64,
        /// Predicted growth there, at its worst over the drift, 1/s.
        growth_1_s: f64,
    },
    /// Nothing inside the envelope is stable.
    NoStablePitch {
        /// Nearest spindle speed at which there is a stable pitch, rpm.
        nearest_speed_rpm: Option<f64>,
    },
}

/// What is asked.
#[derive(Debug, Clone, PartialEq)]
pub struct PitchQuestion<'a> {
    /// Bar and cut as stated.
    pub stated: &'a Scenario,
    /// Lines of this cut, the newest first; those heard at another pitch weigh the candidates.
    pub lines: &'a [HeardLine],
    /// Speed now.
    pub spindle: SpindleSpeed,
    /// Largest pitch difference that limits and axes allow.
    pub largest_pitch_rad: f64,
    /// Pitches that did not help: these and their neighbours are left out.
    pub fruitless_rad: &'a [f64],
}

/// Phase over pi of the line between which m = 0 is searched.
pub(super) const PHASE_RANGE: [f64; 2] = [0.6, 1.19];
/// And where the envelope ends before that.
const SMALL_PHASE_RANGE: [f64; 2] = [0.3, 0.6];
/// Steps of the search within it.
const STEPS: usize = 20;
/// The cut becomes so much weaker or stronger while a pitch is kept.
const DRIFT: [f64; 2] = [0.7, 1.12];
/// A larger m must be better by this much, 1/s: the tool stands worse there.
const LOBE_PAYS_1_S: f64 = 10.0;
/// m = 0 is good enough with this margin, 1/s.
const COMFORTABLE_1_S: f64 = 5.0;
/// A margin counts up to this: beyond it, more is no better.
const MOST_MARGIN_1_S: f64 = 60.0;
/// What a pitch costs whose waves do not oppose the vibration that is heard, 1/s at a tenth of a wave:
/// linear growth says
/// nothing of a vibration that is loud already; that is fed back least where its own waves oppose each other.
const UNOPPOSED_1_S: f64 = 3.0;
/// Belief from which "nothing is stable" is said.
const SURE: f64 = 0.9;
/// Phase over pi within which two pitches are the same try.
const SAME_PITCH: f64 = 0.08;

/// Answers a [`PitchQuestion`]. Cost: some 400 searches for a root, about ten milliseconds, once per try.
/// Checked by: `the_choice_beats_its_neighbours`, `where_nothing_is_stable_another_speed_is_named`,
/// `stillcut campaign`.
#[must_use]
pub fn best_pitch(question: &PitchQuestion<'_>) -> PitchAdvice {
    best_of(question, &possible_cuts(question))
}

/// The same of cuts that are known.
fn best_of(question: &PitchQuestion<'_>, cuts: &[Cut]) -> PitchAdvice {
    let Some(highest_hz) = question.lines.iter().map(|l| l.frequency_hz).max_by(f64::total_cmp) else {
        return PitchAdvice::NotIdentified;
    };
    if cuts.is_empty() {
        return PitchAdvice::NotIdentified;
    }
    let turn_s = question.spindle.period_s();
    // After a try that did not help, what goes on at that pitch is what must be opposed.
    let newest_hz = question.lines.first().map_or(highest_hz, |l| l.frequency_hz);
    let opposed_hz = if question.fruitless_rad.is_empty() { highest_hz } else { newest_hz };
    let search = |lobe: f64| best_of_lobe(question, cuts, (opposed_hz, lobe), PHASE_RANGE);
    let small = || best_of_lobe(question, cuts, (opposed_hz, 0.0), SMALL_PHASE_RANGE);
    let nothing = || PitchAdvice::NoStablePitch { nearest_speed_rpm: nearest_speed(question, cuts) };
    let Some(mut best) = search(0.0).or_else(small) else { return nothing() };
    if best.growth_1_s > -COMFORTABLE_1_S {
        for lobe in [1.0, 2.0] {
            if let Some(other) = search(lobe)
                && other.growth_1_s < best.growth_1_s - LOBE_PAYS_1_S
            {
                best = other;
            }
        }
    }
    // A pitch that holds now is worth trying, even where it will not hold over all of the drift.
    let unstable = |c: &&Cut| c.growth_1_s(turn_s, best.pitch_rad, 1.0) > 0.0;
    let doubt: f64 = cuts.iter().filter(unstable).map(Cut::weight).sum();
    if doubt > SURE && best.growth_1_s > 0.0 {
        return nothing();
    }
    PitchAdvice::Pitch { pitch_rad: best.pitch_rad, growth_1_s: best.growth_1_s }
}

/// The nearest pitch, by quarters of the way from one that stands to the best, at which a cut that is still
/// silent has its margin back with some to spare; the best where none has. `None`: the cut is not identified,
/// or no pitch within reach is better than the one that stands.
///
/// Cost and errors as [`best_pitch`]. Checked by: `before_chatter_the_pitch_goes_no_farther_than_it_must`.
#[must_use]
pub fn pitch_before_chatter(question: &PitchQuestion<'_>, standing_rad: f64) -> Option<f64> {
    let (cuts, turn_s) = (possible_cuts(question), question.spindle.period_s());
    let PitchAdvice::Pitch { pitch_rad: best_rad, .. } = best_of(question, &cuts) else { return None };
    let growth_1_s = |pitch_rad: f64| -> f64 {
        cuts.iter().map(|c| c.weight() * c.growth_1_s(turn_s, pitch_rad, 1.0)).sum()
    };
    // What is left is read; the model says how it changes.
    let read_1_s = question.lines.first()?.growth_1_s? - growth_1_s(standing_rad);
    let quarter_rad = |quarters: i32| standing_rad + (best_rad - standing_rad) * 0.25 * f64::from(quarters);
    let recovered = |pitch_rad: &f64| read_1_s + growth_1_s(*pitch_rad) < -(RECOVERED_1_S + COMFORTABLE_1_S);
    (1..=4).map(quarter_rad).find(recovered).or_else(|| {
        let better = growth_1_s(best_rad) < growth_1_s(standing_rad) - COMFORTABLE_1_S;
        better.then_some(best_rad)
    })
}

/// What the lines allow the cut to be: the stated scenario where it has physics that two delays do not hold
/// and agrees with what is heard; else the two-delay equation, identified.
fn possible_cuts(question: &PitchQuestion<'_>) -> Vec<Cut> {
    if !question.stated.physics.is_empty() {
        let structured = structured_cuts(question.stated, question.lines);
        if !structured.is_empty() {
            return structured.into_iter().map(Cut::structured).collect();
        }
    }
    candidates(question).iter().map(|c| Cut::new(*c, question.lines)).collect()
}

/// What the lines allow a cut of two delays to be.
fn candidates(question: &PitchQuestion<'_>) -> Vec<Candidate> {
    let Some(source) = HeardLine::source(question.lines) else { return Vec::new() };
    let mut candidates = identify(question.stated, source);
    for line in question.lines.iter().filter(|l| l.pitch_rad.abs() >= 0.01 && *l != source) {
        candidates = weigh(candidates, line);
    }
    candidates
}

struct Best {
    pitch_rad: f64,
    growth_1_s: f64,
}

fn best_of_lobe(
    question: &PitchQuestion<'_>,
    cuts: &[Cut],
    (highest_hz, lobe): (f64, f64),
    range: [f64; 2],
) -> Option<Best> {
    let per_pi = PI / wave_phase_difference_rad(question.spindle, highest_hz, 1.0);
    let mut scores: Vec<(Best, f64)> = Vec::with_capacity(STEPS + 1);
    for step in 0..=STEPS {
        let share = step as f64 / STEPS as f64;
        let phase = 2.0 * lobe + range[0] + (range[1] - range[0]) * share;
        let pitch_rad = phase * per_pi;
        let tried = question.fruitless_rad.iter().any(|p| (p - pitch_rad).abs() < SAME_PITCH * per_pi);
        if pitch_rad > question.largest_pitch_rad || tried {
            continue;
        }
        let turn_s = question.spindle.period_s();
        let mean = |f: &dyn Fn(f64) -> f64| {
            cuts.iter().map(|c| c.weight() * f(c.worst_growth_1_s(turn_s, pitch_rad))).sum::<f64>()
        };
        let growth_1_s = mean(&|g| g.max(-MOST_MARGIN_1_S));
        let off = (phase - 2.0 * lobe - 1.0) / 0.1;
        scores.push((Best { pitch_rad, growth_1_s }, growth_1_s + UNOPPOSED_1_S * off * off));
    }
    scores.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)).map(|s| s.0)
}

/// A possible cut with the strengths of it that must be endured.
struct Cut {
    possible: Possible,
    shares: [f64; 3],
}

enum Possible {
    TwoDelay(Candidate),
    Structured(StructuredCut),
}

impl Cut {
    fn new(candidate: Candidate, lines: &[HeardLine]) -> Self {
        let (mut least, mut most) = (1.0f64, 1.0f64);
        for share in lines.iter().filter_map(|l| candidate.share_of_line(l)) {
            least = least.min(share.max(0.3));
            most = most.max(share.min(1.5));
        }
        Self { possible: Possible::TwoDelay(candidate), shares: [least * DRIFT[0], 1.0, most * DRIFT[1]] }
    }

    fn structured(cut: StructuredCut) -> Self {
        Self { possible: Possible::Structured(cut), shares: [DRIFT[0], 1.0, DRIFT[1]] }
    }

    fn weight(&self) -> f64 {
        match &self.possible {
            Possible::TwoDelay(candidate) => candidate.weight,
            Possible::Structured(cut) => cut.weight,
        }
    }

    fn growth_1_s(&self, turn_s: f64, pitch_rad: f64, share: f64) -> f64 {
        match &self.possible {
            Possible::TwoDelay(candidate) => candidate.growth_1_s(turn_s, pitch_rad, share),
            Possible::Structured(cut) => cut.growth_1_s(turn_s, pitch_rad, share),
        }
    }

    /// Where this cut vibrates while it is cut, Hz.
    fn in_cut_hz(&self, turn_s: f64, heard_hz: f64) -> f64 {
        match &self.possible {
            Possible::TwoDelay(candidate) => candidate.equation(turn_s, 0.0, 1.0).in_cut_frequency_hz(),
            Possible::Structured(_) => heard_hz,
        }
    }

    fn worst_growth_1_s(&self, turn_s: f64, pitch_rad: f64) -> f64 {
        self.shares
            .iter()
            .map(|share| self.growth_1_s(turn_s, pitch_rad, *share))
            .fold(f64::NEG_INFINITY, f64::max)
    }
}

/// Nearest speed, up to 40 % away, at which equal pitch or the opposed pitch holds with some margin.
fn nearest_speed(question: &PitchQuestion<'_>, cuts: &[Cut]) -> Option<f64> {
    let (cut, heard_hz) = (cuts.first()?, question.lines.first()?.frequency_hz);
    let turn_s = question.spindle.period_s();
    for step in 1..=20 {
        for sign in [-1.0, 1.0] {
            let ratio = 1.0 + sign * 0.02 * f64::from(step);
            let turn_s = turn_s / ratio;
            let opposed_rad = PI / (cut.in_cut_hz(turn_s, heard_hz) * turn_s);
            let stable = |pitch_rad: f64| {
                pitch_rad <= question.largest_pitch_rad
                    && cut.worst_growth_1_s(turn_s, pitch_rad) < -COMFORTABLE_1_S
            };
            if stable(0.0) || stable(opposed_rad) {
                return Some(question.spindle.rpm() * ratio);
            }
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::cut_effects::CutEffect;
    use crate::plant::cut_terms::CutCondition;
    use crate::plant::cutting::TwoDelay;
    use crate::plant::effects::EffectKind;
    use crate::plant::scenario::RawScenario;
    use crate::stability::{rightmost_root, scenario_root};

    /// The line of a scenario at equal pitch.
    fn line_of(scenario: &Scenario) -> HeardLine {
        let root = rightmost_root(&TwoDelay::from_scenario(scenario));
        let (frequency_hz, growth_1_s) = (root.frequency_hz, Some(root.growth_1_s));
        HeardLine { frequency_hz, growth_1_s, turn_s: scenario.spindle.period_s(), pitch_rad: 0.0 }
    }

    fn question<'a>(
        stated: &'a Scenario,
        lines: &'a [HeardLine],
        largest_pitch_rad: f64,
    ) -> PitchQuestion<'a> {
        PitchQuestion { stated, lines, spindle: stated.spindle, largest_pitch_rad, fruitless_rad: &[] }
    }

    fn ask(raw: &RawScenario, largest_pitch_rad: f64) -> (PitchAdvice, Scenario) {
        let scenario = Scenario::new(raw).unwrap();
        (best_pitch(&question(&scenario, &[line_of(&scenario)], largest_pitch_rad)), scenario)
    }

    fn growth(scenario: &Scenario, pitch_difference_rad: f64) -> f64 {
        let raw = RawScenario { pitch_difference_rad, ..scenario.raw() };
        rightmost_root(&TwoDelay::from_scenario(&Scenario::new(&raw).unwrap())).growth_1_s
    }

    #[test]
    fn the_choice_beats_its_neighbours() {
        let (advice, scenario) = ask(&RawScenario::default(), 0.14);
        let PitchAdvice::Pitch { pitch_rad, growth_1_s } = advice else { panic!("{advice:?}") };
        let phase = wave_phase_difference_rad(scenario.spindle, 652.0, pitch_rad) / PI;
        assert!((0.8..1.1).contains(&phase), "{phase} pi");
        assert!(growth(&scenario, pitch_rad) < -25.0 && growth_1_s < -10.0);
    }

    #[test]
    fn where_nothing_is_stable_another_speed_is_named() {
        // No damping to speak of, a deep cut, and an envelope too small for any pitch that helps.
        let mut raw = RawScenario::default();
        raw.workpiece.damping_ratio = 0.004;
        raw.cutting.process_damping_n = 10.0;
        raw.cutting.width_m = 0.35e-3;
        for largest_rad in [0.065, 0.055, 0.01] {
            let (advice, _) = ask(&raw, largest_rad);
            assert!(matches!(advice, PitchAdvice::NoStablePitch { .. }), "{largest_rad}: {advice:?}");
        }
    }

    /// A holder of the second tool as compliant as the bar shifts the line and what calms it: with the
    /// scenario that knows it the pitch is one that the whole cut stays stable at.
    #[test]
    fn a_holder_that_gives_is_in_the_choice() {
        let holder = |hz: f64| CutEffect::new(EffectKind::TurretCompliance, [hz, 8e6, 0.03]).unwrap();
        for hz in [620.0, 700.0, 800.0] {
            let physics = crate::plant::cut_effects::Physics::new(&[holder(hz)]).unwrap();
            let raw = RawScenario { physics, ..RawScenario::default() };
            let whole = Scenario::new(&raw).unwrap();
            let growth = |pitch_difference_rad: f64| {
                let at = CutCondition { pitch_difference_rad, ..CutCondition::of(&whole) };
                scenario_root(&whole, &at)
            };
            let heard = growth(0.0);
            assert!(heard.growth_1_s > 0.0, "{heard:?}");
            let line = HeardLine {
                frequency_hz: heard.frequency_hz,
                growth_1_s: Some(heard.growth_1_s),
                turn_s: whole.spindle.period_s(),
                pitch_rad: 0.0,
            };
            let cuts = structured_cuts(&whole, &[line]);
            assert!(
                cuts.iter().any(|c| (c.growth_1_s(line.turn_s, 0.0, 1.0) - heard.growth_1_s).abs() < 1.0)
            );
            let question = PitchQuestion {
                stated: &whole,
                lines: &[line],
                spindle: whole.spindle,
                largest_pitch_rad: 0.14,
                fruitless_rad: &[],
            };
            let advice = best_pitch(&question);
            let PitchAdvice::Pitch { pitch_rad, .. } = advice else { panic!("{hz}: {advice:?}") };
            let calmest =
                (0..=70).map(|k| growth(0.002 * f64::from(k)).growth_1_s).fold(f64::INFINITY, f64::min);
            let got = growth(pitch_rad).growth_1_s;
            assert!(got < 0.0 && got < 0.4 * calmest, "{hz}: {got} at {pitch_rad}, {calmest} at best");
        }
    }

    /// A silent cut near its border: what is asked for brings the true cut well away from it, short of the
    /// best pitch, and where what was stated is wrong, too.
    #[test]
    fn before_chatter_the_pitch_goes_no_farther_than_it_must() {
        let thin = |width_m: f64| {
            let mut raw = RawScenario::default();
            raw.cutting.width_m = width_m;
            Scenario::new(&raw).unwrap()
        };
        let near = |cut: &Scenario| line_of(cut).growth_1_s.is_some_and(|g| (-8.0..-4.0).contains(&g));
        let mut drawn = (20..80).map(|k| thin(1e-6 * f64::from(k)));
        let scenario = drawn.find(near).expect("a cut near its border");
        let lines = [line_of(&scenario)];
        let question = question(&scenario, &lines, 0.14);
        let moved_rad = pitch_before_chatter(&question, 0.0).unwrap();
        let PitchAdvice::Pitch { pitch_rad: best_rad, .. } = best_pitch(&question) else { panic!() };
        assert!(moved_rad > 0.0 && moved_rad < 0.8 * best_rad, "{moved_rad} of {best_rad}");
        let there = growth(&scenario, moved_rad);
        assert!(there < -12.0, "{there}");
        // A bar stated 3 % low and damped half as much again: the level is what was read, not stated.
        let mut raw = scenario.raw();
        raw.workpiece.clamp_factor *= 0.97;
        raw.workpiece.damping_ratio *= 1.5;
        let stated = Scenario::new(&raw).unwrap();
        let moved_rad = pitch_before_chatter(&PitchQuestion { stated: &stated, ..question }, 0.0).unwrap();
        let [before, there] = [0.0, moved_rad].map(|pitch_rad| growth(&scenario, pitch_rad));
        assert!(there < before - 5.0, "{there}");
    }

    /// A fast spindle needs a larger pitch than the envelope has to oppose the waves: less of it can do.
    #[test]
    fn a_small_envelope_is_used_as_far_as_it_goes() {
        let mut raw = RawScenario { speed_rpm: 3000.0, ..RawScenario::default() };
        raw.cutting.width_m = 0.04e-3;
        let (advice, scenario) = ask(&raw, 0.14);
        let PitchAdvice::Pitch { pitch_rad, .. } = advice else { panic!("{advice:?}") };
        let phase = wave_phase_difference_rad(scenario.spindle, 600.0, pitch_rad) / PI;
        assert!(phase < 0.6 && growth(&scenario, 0.0) > 5.0 && growth(&scenario, pitch_rad) < -5.0);
    }
}
