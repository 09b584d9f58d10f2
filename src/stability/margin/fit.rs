//! The most likely numbers of the cut given the periodograms of its blocks, a few bins a sample.

use super::criteria::Criteria;
use super::interference::Bin;
use super::model::{Condition, Cut, Density, PARAMETERS, Parameters, place};
use super::spectrum::{BandBlocks, REACH};
use crate::keyframe::{Keep, Words, keep, keep_list};
use crate::stability::count::Turn;
use nalgebra::SMatrix;
use std::f64::consts::PI;

/// Square of the parameters.
pub(super) type Information = SMatrix<f64, PARAMETERS, PARAMETERS>;

impl<const R: usize, const C: usize> Keep for SMatrix<f64, R, C> {
    fn keep(&self, to: &mut Vec<u64>) {
        self.as_slice().keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        self.as_mut_slice().restore(from)
    }
}

/// Normal distribution of the parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gaussian {
    pub(super) mean: Parameters,
    /// Inverse of the covariance.
    pub(super) information: Information,
}

keep!(Gaussian { mean, information });

impl Default for Gaussian {
    fn default() -> Self {
        Self { mean: Parameters::zeros(), information: Information::identity() }
    }
}

impl Gaussian {
    /// Independent numbers with these standard deviations, none of them zero.
    pub(super) fn independent(mean: Parameters, deviation: &[f64; PARAMETERS]) -> Self {
        let weights = Parameters::from(deviation.map(|sd| 1.0 / (sd * sd)));
        Self { mean, information: Information::from_diagonal(&weights) }
    }

    /// Covariance; nothing where the information is not positive.
    pub(super) fn covariance(&self) -> Option<Information> {
        self.information.cholesky().map(|c| c.inverse())
    }

    /// The same `seconds` later, each number having walked by `drift` in a second.
    pub(super) fn later(&self, seconds: f64, drift: &[f64; PARAMETERS]) -> Option<Self> {
        let walked = Parameters::from(drift.map(|sd| sd * sd * seconds));
        let covariance = self.covariance()? + Information::from_diagonal(&walked);
        Some(Self { mean: self.mean, information: covariance.cholesky()?.inverse() })
    }
}

/// Periodogram of a block and the conditions under which it was cut.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Block {
    /// At two moments that stand for it: the tools travel.
    pub(super) conditions: [Condition; 2],
    /// N^2/Hz, one a bin.
    pub(super) power: Vec<f64>,
    /// Where interference is expected.
    pub(super) expected: Vec<bool>,
}

keep!(Block { conditions, power, expected });

/// What a fit does now.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Stage {
    /// Nothing.
    #[default]
    Idle,
    /// Tries its starts.
    Search,
    /// Goes on from the best.
    Refine,
}

keep_list!(Stage { Idle, Search, Refine });

/// Starts of a search: three natural frequencies, a standard deviation apart, with every line taken for the
/// cut's and without.
const FREQUENCIES: usize = 3;
const STARTS: usize = 2 * FREQUENCIES;
const SEARCH_STEPS: usize = 8;
/// From the best start, and where a fit meets the border of stability.
const REFINE_STEPS: usize = 6;
/// From the posterior of a second before, the step is short.
const FOLLOW_STEPS: usize = 3;
/// Longest step in prior standard deviations: beyond, the expected curvature is not the curvature.
const LONGEST_STEP: f64 = 0.7;
/// A step below this share of every standard deviation ends the fit.
const SETTLED: f64 = 0.03;
const WINDOW: usize = 2 * REACH + 1;

/// Fisher's scoring of Whittle's likelihood with a Gaussian prior.
///
/// -ln L = share sum_f [I/S + ln S] + 1/2 (x-m)' P^-1 (x-m),  S the model smeared as the window smears
/// information = P^-1 + share sum R R',  gradient = share sum R (I/S - 1) - P^-1 (x-m),  R = d ln S/dx,
/// both where nothing else stands in a bin. Where it may, see [`Bin`], the square of its probability that
/// nothing does weighs R R': where nothing does, a bin tells 0.96 and 0.5 to 0.6 of what it would, and the
/// square is 1.00 and 0.77.
///
/// Only a stable cut has a spectrum: by Nyquist's criterion, 1 + L(j w) does not go round zero. A point at
/// which it does has the likelihood zero; a root and its mirror image would have nearly the same. A fit that
/// met no other has no posterior.
///
/// Source: Whittle 1953; Kay, Statistical Signal Processing I, 3.11; the cut-method note, section 3.
/// Checked by: `a_cut_that_has_a_spectrum_is_stable`, `across_the_border_it_does_not_climb`,
/// `without_a_stable_point_there_is_no_posterior`, `the_margin_is_the_decay_of_the_vibration`,
/// `a_cut_under_noise_is_not_heard` (suite).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    pub(super) stage: Stage,
    prior: Gaussian,
    at: Parameters,
    best: Parameters,
    best_likelihood: f64,
    start: usize,
    step: usize,
    steps: usize,
    block: usize,
    bin: usize,
    cuts: [Cut; 2],
    information: Information,
    gradient: Parameters,
    likelihood: f64,
    /// Of the return difference over the block at each of its moments, and whether one goes round zero in any
    /// block: such a cut is not stable.
    turns: [Turn; 2],
    unstable: bool,
    /// The last point at which every block was stable, and what is known there.
    stable: Option<Gaussian>,
    window: [Density; WINDOW],
}

keep!(Density { total, cut, difference, by });
keep!(Fit {
    stage,
    prior,
    at,
    best,
    best_likelihood,
    start,
    step,
    steps,
    block,
    bin,
    cuts,
    information,
    gradient,
    likelihood,
    turns,
    unstable,
    stable,
    window
});

impl Default for Fit {
    fn default() -> Self {
        Self {
            stage: Stage::Idle,
            prior: Gaussian::default(),
            at: Parameters::zeros(),
            best: Parameters::zeros(),
            best_likelihood: 0.0,
            start: 0,
            step: 0,
            steps: 0,
            block: 0,
            bin: 0,
            cuts: [Cut::default(); 2],
            information: Information::zeros(),
            gradient: Parameters::zeros(),
            likelihood: 0.0,
            turns: [Turn::default(); 2],
            unstable: false,
            stable: None,
            window: [Density::default(); WINDOW],
        }
    }
}

impl Fit {
    /// Begins from several starts around the prior's mean.
    pub(super) fn search(&mut self, prior: &Gaussian) {
        self.prior = *prior;
        (self.stage, self.steps, self.start) = (Stage::Search, SEARCH_STEPS, 0);
        self.begin(self.starting_point());
        (self.best, self.best_likelihood) = (self.at, f64::NEG_INFINITY);
    }

    /// Begins from one point.
    pub(super) fn follow(&mut self, prior: &Gaussian, from: &Parameters) {
        self.prior = *prior;
        (self.stage, self.steps) = (Stage::Refine, FOLLOW_STEPS);
        self.begin(*from);
    }

    /// Bins that the whole fit takes at most.
    pub(super) fn work(&self, blocks: usize, bins: usize) -> usize {
        let steps = match self.stage {
            Stage::Search => STARTS * SEARCH_STEPS + REFINE_STEPS,
            Stage::Refine | Stage::Idle => REFINE_STEPS,
        };
        steps * blocks * (bins + REACH)
    }

    /// Whether a fit that was taken back from a keyframe stands inside of its bins.
    pub(super) fn fits(&self, bins: usize) -> bool {
        self.bin < bins
    }

    /// From a point on nothing is known of what is stable.
    fn begin(&mut self, at: Parameters) {
        (self.at, self.step, self.stable) = (at, 0, None);
        self.clear();
    }

    fn starting_point(&self) -> Parameters {
        let mut at = self.prior.mean;
        let deviations = (self.start % FREQUENCIES) as f64 - 1.0;
        at[place::CLAMP] += deviations / self.prior.information[(place::CLAMP, place::CLAMP)].sqrt();
        at
    }

    /// Whether the first steps from this start take every line for the cut's.
    fn takes_all(&self) -> bool {
        self.stage == Stage::Search && self.start < FREQUENCIES && self.step < SEARCH_STEPS / 2
    }

    fn clear(&mut self) {
        (self.block, self.bin, self.unstable) = (0, 0, false);
        self.information = self.prior.information;
        let off = self.at - self.prior.mean;
        self.gradient = -(self.prior.information * off);
        self.likelihood = 0.5 * off.dot(&self.gradient);
    }

    /// Works on one bin; the posterior when all is done.
    pub(super) fn advance(&mut self, blocks: &[Block], band: &BandBlocks) -> Option<Gaussian> {
        let Some(block) = blocks.get(self.block) else {
            return self.end_step();
        };
        if self.bin == 0 {
            self.cuts = block.conditions.map(|condition| Cut::new(&condition, &self.at));
            self.turns = [Turn::default(); 2];
            for half in 0..WINDOW {
                self.window[half] = self.density(band.half_bin_hz(half as i64 - REACH as i64));
            }
        } else {
            self.window.rotate_left(2);
            for half in WINDOW - 2..WINDOW {
                let from = (2 * self.bin + half) as i64 - REACH as i64;
                self.window[half] = self.density(band.half_bin_hz(from));
            }
        }
        self.take(block.power[self.bin], block.expected[self.bin], band.leakage());
        self.bin += 1;
        if self.bin == band.bins {
            self.unstable |= self.turns.iter().any(|turn| turn.rad.abs() > PI);
            (self.bin, self.block) = (0, self.block + 1);
        }
        None
    }

    /// Mean spectrum of the block at a frequency, up to which its return differences turn on.
    fn density(&mut self, frequency_hz: f64) -> Density {
        let [early, late] = self.cuts;
        let mut density = early.density(frequency_hz);
        self.turns[0].to(density.difference);
        if late != early {
            let other = late.density(frequency_hz);
            self.turns[1].to(other.difference);
            density.total = 0.5 * (density.total + other.total);
            density.cut = 0.5 * (density.cut + other.cut);
            density.by = 0.5 * (density.by + other.by);
        }
        density
    }

    /// One bin's part of information, gradient and likelihood.
    fn take(&mut self, power: f64, expected: bool, leakage: &[f64; REACH + 1]) {
        let (mut total, mut by) = (0.0, Parameters::zeros());
        for (i, density) in self.window.iter().enumerate() {
            let weight = leakage[i.abs_diff(REACH)];
            total += weight * density.total;
            by += density.by * weight;
        }
        let share = Criteria::DEFAULT.bin_share;
        let relative = by / total;
        let over = power / total;
        let bin = Bin::new(over, expected);
        self.likelihood += share * (bin.nats() - total.ln());
        // Beside a spectrum that is far too low all of a line looks like interference.
        let (score, own) = if self.takes_all() { (over - 1.0, 1.0) } else { (bin.score, bin.own) };
        self.gradient += relative * (share * score);
        self.information.ger(share * own * own, &relative, &relative, 1.0);
    }

    /// The next point of Fisher's scoring; whether the fit has settled.
    ///
    /// From an unstable point half the way back to the last stable one. Where none was stable yet, to more
    /// process damping, with what the prior moves along with it: by one standard deviation, then two, then
    /// four. What is stable beyond is none that the prior can take for true.
    fn move_on(&mut self) -> bool {
        if !self.unstable {
            self.stable = Some(Gaussian { mean: self.at, information: self.information });
        }
        let Some(known) = self.prior.covariance() else { return true };
        if self.unstable {
            self.steps = self.steps.max(REFINE_STEPS);
            match self.stable {
                Some(stable) => self.at = 0.5 * (self.at + stable.mean),
                None if self.step > FOLLOW_STEPS => return true,
                None => {
                    let damped = known.column(place::PROCESS);
                    let deviations = f64::from(1u32 << (self.step - 1));
                    self.at += damped * (deviations / damped[place::PROCESS].sqrt());
                }
            }
            return false;
        }
        let Some(information) = self.information.cholesky() else { return true };
        let mut step = information.solve(&self.gradient);
        let longest = known.diagonal().map(f64::sqrt) * LONGEST_STEP;
        let excess = step.component_div(&longest).amax();
        if excess > 1.0 {
            step /= excess;
        }
        self.at += step;
        let covariance = information.inverse();
        (0..PARAMETERS).all(|k| step[k] * step[k] < SETTLED * SETTLED * covariance[(k, k)])
    }

    fn end_step(&mut self) -> Option<Gaussian> {
        if self.stage == Stage::Search && !self.unstable && self.likelihood > self.best_likelihood {
            (self.best, self.best_likelihood) = (self.at, self.likelihood);
        }
        let plain = self.takes_all();
        self.step += 1;
        let settled = self.move_on();
        if plain && settled {
            self.step = SEARCH_STEPS / 2;
        }
        if self.step < self.steps && (plain || !settled) {
            self.clear();
            return None;
        }
        if self.stage == Stage::Search {
            self.start += 1;
            if self.start == STARTS {
                (self.stage, self.steps) = (Stage::Refine, REFINE_STEPS);
                self.begin(self.best);
            } else {
                self.begin(self.starting_point());
            }
            return None;
        }
        self.stage = Stage::Idle;
        let mut found = self.stable?;
        if self.unstable {
            // At the border there is no maximum and no curvature that tells: what was known stands.
            found.information = self.prior.information;
        }
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::tests::example;
    use super::super::roots::all;
    use super::*;
    use crate::units::SampleRate;
    use std::ops::Range;

    const BAND_HZ: [f64; 2] = [480.0, 760.0];

    fn band() -> BandBlocks {
        BandBlocks::new(SampleRate::new(9000.0).unwrap(), BAND_HZ, 2.0)
    }

    fn margin_1_s(condition: &Condition, at: &Parameters) -> f64 {
        -all(&Cut::new(condition, at), BAND_HZ).first().unwrap().re
    }

    /// The example at the first pitch with such a margin.
    fn stable_cut(margins_1_s: Range<f64>) -> (Condition, Parameters) {
        let mut pitches = (0..600).map(|k| 0.06 + 1e-4 * f64::from(k)).map(example);
        pitches.find(|(condition, at)| margins_1_s.contains(&margin_1_s(condition, at))).unwrap()
    }

    /// So much less process damping that the cut grows by this.
    fn growing(condition: &Condition, at: &Parameters, growth_1_s: f64) -> Parameters {
        let less = |k: i32| {
            let mut less = *at;
            less[place::PROCESS] -= 1e-3 * f64::from(k);
            less
        };
        (0..4000).map(less).find(|at| margin_1_s(condition, at) < -growth_1_s).unwrap()
    }

    /// What is known at an entry, to this share of it.
    fn known(mean: Parameters, share: f64) -> Gaussian {
        Gaussian::independent(mean, &Criteria::DEFAULT.known.map(|sd| share * sd))
    }

    /// The spectrum itself of a cut.
    fn block(band: &BandBlocks, condition: Condition, at: &Parameters) -> Block {
        let cut = Cut::new(&condition, at);
        let power = (0..band.bins).map(|bin| cut.density(band.half_bin_hz(2 * bin as i64)).total).collect();
        Block { conditions: [condition; 2], power, expected: vec![false; band.bins] }
    }

    fn end(fit: &mut Fit, blocks: &[Block], band: &BandBlocks) -> Option<Gaussian> {
        let mut found = None;
        while fit.stage != Stage::Idle {
            found = fit.advance(blocks, band);
        }
        found
    }

    fn follow(prior: &Gaussian, blocks: &[Block], band: &BandBlocks) -> Option<Gaussian> {
        let mut fit = Fit::default();
        fit.follow(prior, &prior.mean);
        end(&mut fit, blocks, band)
    }

    /// One fit of the spectrum of a stable cut, with a prior whose mean is unstable.
    #[test]
    fn a_cut_that_has_a_spectrum_is_stable() {
        let band = band();
        let (condition, truth) = stable_cut(5.0..9.0);
        let mut mean = truth;
        mean[place::PROCESS] -= 1.0;
        mean[place::DAMPING] -= 0.3;
        assert!(margin_1_s(&condition, &mean) < -3.0);
        let found = follow(&known(mean, 1.0), &[block(&band, condition, &truth)], &band).unwrap();
        let [found_1_s, true_1_s] = [found.mean, truth].map(|at| margin_1_s(&condition, &at));
        // The prior's mean is 2.4 standard deviations off, toward less.
        assert!((0.7 * true_1_s..true_1_s).contains(&found_1_s), "{found_1_s} for {true_1_s}");
    }

    /// What is known is carried forward across zero again and again; the spectrum is that of a cut just this
    /// side of it.
    #[test]
    fn across_the_border_it_does_not_climb() {
        let band = band();
        for (margins_1_s, share) in [(1.2..1.6, 0.1), (1.2..1.6, 0.2), (1.2..1.6, 0.5), (3.0..4.0, 0.2)] {
            let (condition, truth) = stable_cut(margins_1_s);
            let blocks = [block(&band, condition, &truth)];
            let true_1_s = margin_1_s(&condition, &truth);
            let mut prior = known(growing(&condition, &truth, 0.3), share);
            for second in 0..6 {
                let found = follow(&prior, &blocks, &band).unwrap();
                let found_1_s = margin_1_s(&condition, &found.mean);
                assert!(
                    (-0.1..true_1_s + 0.1).contains(&found_1_s),
                    "{found_1_s} for {true_1_s}, {second} s"
                );
                prior = found.later(1.0, &Criteria::DEFAULT.drift).unwrap();
                prior.mean = growing(&condition, &prior.mean, 0.3);
            }
        }
    }

    /// All that the prior can take for true is unstable.
    #[test]
    fn without_a_stable_point_there_is_no_posterior() {
        let band = band();
        let (condition, at) = example(0.055);
        let (other, truth) = stable_cut(5.0..9.0);
        let blocks = [Block { conditions: [condition; 2], ..block(&band, other, &truth) }];
        assert!(margin_1_s(&condition, &at) < -15.0);
        assert_eq!(follow(&known(at, 0.02), &blocks, &band), None);
    }

    /// Stable in its middle, and in the mean of its two moments.
    #[test]
    fn a_block_whose_end_is_unstable_is_unstable() {
        let band = band();
        let (middle, at) = stable_cut(1.0..2.0);
        let moved = |by_rad: f64| Condition { pitch_rad: middle.pitch_rad + by_rad, ..middle };
        let mut by_rad = (1..200).map(|k| 1e-4 * f64::from(k));
        let by_rad = by_rad.find(|by_rad| margin_1_s(&moved(-by_rad), &at) < -1.0).unwrap();
        let conditions = [moved(by_rad), moved(-by_rad)];
        assert!(margin_1_s(&conditions[0], &at) > 2.0);
        let blocks = [Block { conditions, ..block(&band, middle, &at) }];
        let mut fit = Fit::default();
        fit.follow(&known(at, 1.0), &at);
        (0..band.bins).for_each(|_| assert_eq!(fit.advance(&blocks, &band), None));
        assert!(fit.unstable);
    }

    /// From everywhere in a fit that the prior draws over the border.
    #[test]
    fn it_goes_on_from_a_keyframe() {
        let band = band();
        let (condition, truth) = stable_cut(1.2..1.6);
        let blocks = [block(&band, condition, &truth)];
        let prior = known(growing(&condition, &truth, 3.0), 0.05);
        let mut fit = Fit::default();
        fit.follow(&prior, &growing(&condition, &truth, -0.1));
        let found = end(&mut fit.clone(), &blocks, &band);
        let (mut stable_then_not, mut advances) = (false, 0);
        while fit.stage != Stage::Idle {
            stable_then_not |= fit.stable.is_some() && fit.unstable;
            if advances % 97 == 0 {
                let mut words = Vec::new();
                fit.keep(&mut words);
                let mut again = Fit::default();
                again.restore(&mut Words::new(&words)).unwrap();
                assert_eq!(end(&mut again, &blocks, &band), found, "after {advances}");
            }
            fit.advance(&blocks, &band);
            advances += 1;
        }
        assert!(stable_then_not);
    }
}
