//! The most likely numbers of the cut given the periodograms of its blocks, a few bins a sample.

use super::criteria::Criteria;
use super::interference::Bin;
use super::model::{Condition, Cut, Density, PARAMETERS, Parameters, place};
use super::spectrum::{BandBlocks, REACH};
use crate::keyframe::{Keep, Words, keep, keep_list};
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
/// All of them with process damping this many standard deviations up: there the cut is stable, and steps from
/// there end at the border that the fit would have to find its way back over from the other side.
const DAMPED_START: f64 = 2.0;
const SEARCH_STEPS: usize = 8;
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
/// which it does has the likelihood zero; a root and its mirror image would have nearly the same.
///
/// Source: Whittle 1953; Kay, Statistical Signal Processing I, 3.11; the cut-method note, section 3.
/// Checked by: `a_cut_that_has_a_spectrum_is_stable`, `the_margin_is_the_decay_of_the_vibration`,
/// `a_cut_under_noise_is_not_heard` (suite).
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Fit {
    pub(super) stage: Stage,
    prior: Gaussian,
    longest: Parameters,
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
    /// Turn of the return difference over the block, and whether it goes round zero in any block: such a cut
    /// is not stable.
    turned_rad: f64,
    unstable: bool,
    /// The last point at which every block was stable.
    stable_at: Option<Parameters>,
    /// Whether an unstable point was met since the fit began, or went on from its best start.
    crossed: bool,
    window: [Density; WINDOW],
}

keep!(Density { total, cut, difference, by });
keep!(Fit {
    stage,
    prior,
    longest,
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
    turned_rad,
    unstable,
    stable_at,
    crossed,
    window
});

impl Default for Fit {
    fn default() -> Self {
        Self {
            stage: Stage::Idle,
            prior: Gaussian::default(),
            longest: Parameters::zeros(),
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
            turned_rad: 0.0,
            unstable: false,
            stable_at: None,
            crossed: false,
            window: [Density::default(); WINDOW],
        }
    }
}

impl Fit {
    /// Begins from several starts around the prior's mean.
    pub(super) fn search(&mut self, prior: &Gaussian, longest: &Parameters) {
        self.know(prior, longest);
        (self.stage, self.steps, self.start) = (Stage::Search, SEARCH_STEPS, 0);
        self.begin(self.starting_point());
        (self.best, self.best_likelihood) = (self.at, f64::NEG_INFINITY);
    }

    /// Begins from one point.
    pub(super) fn follow(&mut self, prior: &Gaussian, longest: &Parameters, from: &Parameters) {
        self.know(prior, longest);
        (self.stage, self.steps) = (Stage::Refine, FOLLOW_STEPS);
        self.begin(*from);
    }

    /// Bins that the whole fit takes at most.
    pub(super) fn work(&self, blocks: usize, bins: usize) -> usize {
        let steps = match self.stage {
            Stage::Search => STARTS * SEARCH_STEPS + REFINE_STEPS,
            Stage::Refine | Stage::Idle => FOLLOW_STEPS,
        };
        steps * blocks * (bins + REACH)
    }

    /// Whether a fit that was taken back from a keyframe stands inside of its bins.
    pub(super) fn fits(&self, bins: usize) -> bool {
        self.bin < bins
    }

    fn know(&mut self, prior: &Gaussian, longest: &Parameters) {
        (self.prior, self.longest) = (*prior, longest * LONGEST_STEP);
    }

    /// From a point on nothing is known of what is stable.
    fn begin(&mut self, at: Parameters) {
        (self.at, self.step, self.stable_at, self.crossed) = (at, 0, None, false);
        self.clear();
    }

    fn starting_point(&self) -> Parameters {
        let mut at = self.prior.mean;
        let deviation = self.longest / LONGEST_STEP;
        at[place::CLAMP] += deviation[place::CLAMP] * ((self.start % FREQUENCIES) as f64 - 1.0);
        at[place::PROCESS] += deviation[place::PROCESS] * DAMPED_START;
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
            for half in 0..WINDOW {
                self.window[half] = self.density(band.half_bin_hz(half as i64 - REACH as i64));
            }
            self.turned_rad = 0.0;
            self.turn(0);
        } else {
            self.window.rotate_left(2);
            for half in WINDOW - 2..WINDOW {
                let from = (2 * self.bin + half) as i64 - REACH as i64;
                self.window[half] = self.density(band.half_bin_hz(from));
            }
            self.turn(WINDOW - 3);
        }
        self.take(block.power[self.bin], block.expected[self.bin], band.leakage());
        self.bin += 1;
        if self.bin == band.bins {
            self.unstable |= self.turned_rad.abs() > PI;
            (self.bin, self.block) = (0, self.block + 1);
        }
        None
    }

    /// Follows the return difference over the densities from that one on.
    fn turn(&mut self, from: usize) {
        let turns = self.window[from..].windows(2).map(|w| (w[1].difference * w[0].difference.conj()).arg());
        self.turned_rad = turns.fold(self.turned_rad, |sum, turn| sum + turn);
    }

    /// Mean spectrum and return difference of the block at a frequency.
    fn density(&self, frequency_hz: f64) -> Density {
        let [early, late] = &self.cuts;
        let mut density = early.density(frequency_hz);
        if late != early {
            let other = late.density(frequency_hz);
            density.total = 0.5 * (density.total + other.total);
            density.cut = 0.5 * (density.cut + other.cut);
            density.difference = 0.5 * (density.difference + other.difference);
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

    /// The next point of Fisher's scoring, from an unstable one half the way back, to more process damping
    /// where none was stable yet; whether the fit has settled.
    fn move_on(&mut self) -> bool {
        if self.unstable {
            self.crossed = true;
            match self.stable_at {
                Some(stable) => self.at = 0.5 * (self.at + stable),
                None => self.at[place::PROCESS] += self.longest[place::PROCESS],
            }
            return false;
        }
        self.stable_at = Some(self.at);
        let Some(information) = self.information.cholesky() else { return true };
        let mut step = information.solve(&self.gradient);
        let excess = step.component_div(&self.longest).amax();
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
        // At the border of stability there is no maximum and no curvature that tells: what was known stands.
        let borders = self.crossed && !settled;
        let information = if borders { self.prior.information } else { self.information };
        Some(Gaussian { mean: self.stable_at.unwrap_or(self.at), information })
    }
}

#[cfg(test)]
mod tests {
    use super::super::model::tests::example;
    use super::super::roots::all;
    use super::*;
    use crate::units::SampleRate;

    const BAND_HZ: [f64; 2] = [480.0, 760.0];

    fn margin_1_s(condition: &Condition, at: &Parameters) -> f64 {
        -all(&Cut::new(condition, at), BAND_HZ).first().unwrap().re
    }

    /// A fit of the spectrum of a stable cut that begins at an unstable one.
    #[test]
    fn a_cut_that_has_a_spectrum_is_stable() {
        let band = BandBlocks::new(SampleRate::new(9000.0).unwrap(), BAND_HZ, 2.0);
        let pitches = (0..60).map(|k| 0.06 + 0.001 * f64::from(k));
        let (condition, truth) =
            pitches.map(example).find(|(c, at)| (5.0..9.0).contains(&margin_1_s(c, at))).unwrap();
        let cut = Cut::new(&condition, &truth);
        let power = (0..band.bins).map(|bin| cut.density(band.half_bin_hz(2 * bin as i64)).total).collect();
        let blocks = [Block { conditions: [condition; 2], power, expected: vec![false; band.bins] }];
        let mut start = truth;
        start[place::PROCESS] -= 1.0;
        start[place::DAMPING] -= 0.3;
        assert!(margin_1_s(&condition, &start) < -3.0);
        let deviations = Criteria::DEFAULT.known;
        let prior = Gaussian::independent(start, &deviations);
        let mut fit = Fit::default();
        let mut found = prior;
        for _ in 0..6 {
            fit.follow(&prior, &Parameters::from(deviations), &found.mean);
            found = (0..).find_map(|_: usize| fit.advance(&blocks, &band)).unwrap();
        }
        let margin_1_s = margin_1_s(&condition, &found.mean);
        assert!((1.0..15.0).contains(&margin_1_s), "{margin_1_s}");
    }
}
