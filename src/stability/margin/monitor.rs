//! The margin of one force stream: blocks, fit and reading together.

use super::conditions::{CutConditions, HOP, Means, NOW, SLICES, Slices, TOLD};
use super::criteria::{BLOCK_S, Criteria};
use super::fit::{Block, Fit, Gaussian, Information, Stage};
use super::judge::{DeafReason, Margin, MarginReading, Warning, read};
use super::knowledge::{CutPrior, Heard};
use super::model::{Condition, Cut, Noise, PARAMETERS, Parameters, place};
use super::roots::{Roots, descend, inside, margin_and_line, normal_points, quantile, seed};
use super::spectrum::{BandBlocks, BandState};
use crate::keyframe::{Keep, Words, keep_list};
use crate::units::SampleRate;
use std::f64::consts::PI;

/// What is listened to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarginSettings {
    /// Rate of the force.
    pub sample_rate: SampleRate,
    /// Analysis band: margins are of roots in it, Hz.
    pub band_hz: [f64; 2],
    /// Bar and cut as stated.
    pub prior: CutPrior,
    /// Whether the force is that of a tool with its mean, which tells cut from air and the stiffness.
    pub pushes: bool,
    /// Corner of the first-order low-pass through which the force was estimated, Hz.
    pub force_hz: f64,
}

/// Points of the posterior that the interval is read from: the 2.5 % quantile of 128 is the third of them.
const PAIRS: usize = 64;
/// The force of cut or air is averaged over this long, s: three turns at 3600 rpm.
const CUT_AVERAGE_S: f64 = 0.05;
/// The cut begins at this share of the stated force, and ends at half of that, where no column tells it.
const CUT_BEGINS: f64 = 0.25;

/// Follows the margin of one stream: immutable design.
#[derive(Debug, Clone)]
pub struct MarginMonitor {
    settings: MarginSettings,
    criteria: Criteria,
    band: BandBlocks,
    points: Vec<Parameters>,
}

/// What is worked at between samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
enum Cloud {
    /// Nothing.
    #[default]
    Idle,
    /// The roots in the band.
    Search,
    /// The posterior's points.
    Points,
}

keep_list!(Cloud { Idle, Search, Points });

/// State of [`MarginMonitor`].
#[derive(Debug, Clone, PartialEq)]
pub struct MarginState {
    band: BandState,
    slices: Slices,
    in_cut: bool,
    mean_force_n: f64,
    air_mean_n: f64,
    air_slices: f64,
    /// Largest swing of the band in the last block of air, N: what swings there too is not the cut.
    air_swing_n: f64,
    /// Samples until the first slice of a cut begins.
    until_cut: usize,
    /// Samples by which this axis lags the others, so that their transforms fall on different samples.
    lag: usize,
    /// Mean force over chip area when the cut began, N/m^2; 0: not yet.
    reference_n_m2: f64,
    noise: Noise,
    blocks: Vec<Block>,
    filled: usize,
    joined: usize,
    deviations: [f64; PARAMETERS],
    fit: Fit,
    per_sample: usize,
    posterior: Gaussian,
    known: bool,
    /// Slices since the posterior's last block.
    age: usize,
    cloud: Cloud,
    number: usize,
    roots: Roots,
    now: Condition,
    spread: Information,
    margins: Vec<f64>,
    found: usize,
    /// Height of the line over the noise at each point. The middle counts: at the limit of stability a line
    /// has no bound, and by chance there is a point near it in every noise.
    lines: Vec<f64>,
    reading: MarginReading,
    /// Whether chatter is declared.
    chatters: bool,
    warning: Warning,
}

impl Keep for MarginState {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { band, slices, in_cut, mean_force_n, air_mean_n, air_slices, air_swing_n, .. } = self;
        band.keep(to);
        slices.keep(to);
        in_cut.keep(to);
        [mean_force_n, air_mean_n, air_slices, air_swing_n].into_iter().for_each(|x| x.keep(to));
        let Self { until_cut, lag: _, .. } = self;
        until_cut.keep(to);
        let Self { reference_n_m2, noise, blocks, filled, joined, deviations, fit, per_sample, .. } = self;
        reference_n_m2.keep(to);
        noise.keep(to);
        [filled, joined, per_sample].into_iter().for_each(|n| n.keep(to));
        blocks[..*filled].iter().for_each(|block| block.keep(to));
        deviations.keep(to);
        fit.keep(to);
        let Self { posterior, known, age, cloud, number, roots, now, spread, margins, found, .. } = self;
        posterior.keep(to);
        known.keep(to);
        [age, number, found].into_iter().for_each(|n| n.keep(to));
        cloud.keep(to);
        roots.keep(to);
        now.keep(to);
        spread.keep(to);
        margins.keep(to);
        self.lines.keep(to);
        self.reading.keep(to);
        self.chatters.keep(to);
        self.warning.keep(to);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let Self { band, slices, in_cut, mean_force_n, air_mean_n, air_slices, air_swing_n, .. } = self;
        band.restore(from)?;
        slices.restore(from)?;
        in_cut.restore(from)?;
        let levels = [mean_force_n, air_mean_n, air_slices, air_swing_n];
        levels.into_iter().try_for_each(|x| x.restore(from))?;
        let Self { until_cut, .. } = self;
        until_cut.restore(from)?;
        let Self { reference_n_m2, noise, blocks, filled, joined, deviations, fit, per_sample, .. } = self;
        reference_n_m2.restore(from)?;
        noise.restore(from)?;
        [&mut *filled, joined, per_sample].into_iter().try_for_each(|n| n.restore(from))?;
        blocks.get_mut(..*filled)?.iter_mut().try_for_each(|block| block.restore(from))?;
        deviations.restore(from)?;
        fit.restore(from)?;
        let Self { posterior, known, age, cloud, number, roots, now, spread, margins, found, .. } = self;
        posterior.restore(from)?;
        known.restore(from)?;
        [age, number, &mut *found].into_iter().try_for_each(|n| n.restore(from))?;
        cloud.restore(from)?;
        roots.restore(from)?;
        now.restore(from)?;
        spread.restore(from)?;
        margins.restore(from)?;
        self.lines.restore(from)?;
        self.reading.restore(from)?;
        self.chatters.restore(from)?;
        self.warning.restore(from)?;
        self.fit.fits(self.band_bins()).then_some(())
    }
}

impl MarginState {
    fn band_bins(&self) -> usize {
        self.blocks.first().map_or(0, |block| block.power.len())
    }
}

impl MarginMonitor {
    /// Designs the monitor. Requires: a band that fits the rate, as the chatter monitor has checked.
    #[must_use]
    pub fn new(settings: MarginSettings) -> Self {
        let criteria = Criteria::DEFAULT;
        let band = BandBlocks::new(settings.sample_rate, settings.band_hz, BLOCK_S);
        Self { settings, criteria, band, points: normal_points(PAIRS) }
    }

    /// Nothing heard yet. `axis`: its place among the others.
    #[must_use]
    pub fn start(&self, axis: usize) -> MarginState {
        let block = Block {
            conditions: [Condition::default(); 2],
            power: vec![0.0; self.band.bins],
            expected: vec![false; self.band.bins],
        };
        MarginState {
            band: self.band.start(),
            slices: Slices::default(),
            in_cut: false,
            mean_force_n: 0.0,
            air_mean_n: 0.0,
            air_slices: 0.0,
            air_swing_n: 0.0,
            until_cut: 0,
            lag: axis * self.band.samples_per_output(),
            reference_n_m2: 0.0,
            noise: Noise::default(),
            blocks: vec![block; self.criteria.joint_blocks],
            filled: 0,
            joined: 0,
            deviations: [1.0; PARAMETERS],
            fit: Fit::default(),
            per_sample: 1,
            posterior: Gaussian::default(),
            known: false,
            age: 0,
            cloud: Cloud::Idle,
            number: 0,
            roots: Roots::default(),
            now: Condition::default(),
            spread: Information::zeros(),
            margins: vec![0.0; 2 * PAIRS],
            found: 0,
            lines: vec![0.0; 2 * PAIRS],
            reading: MarginReading::Air,
            chatters: false,
            warning: Warning::default(),
        }
    }

    /// The margin while it runs out: from the warning on until it has recovered.
    #[must_use]
    pub fn running_out<'a>(&self, state: &'a MarginState) -> Option<&'a Margin> {
        self.reading(state).margin().filter(|_| state.warning.stands())
    }

    /// What it says now.
    #[must_use]
    pub fn reading<'a>(&self, state: &'a MarginState) -> &'a MarginReading {
        // Of a vibration that is not small any more the linear cut says nothing: least that it is stable.
        let contradicts = |m: &Margin| state.chatters && m.lo_1_s > 0.0;
        match &state.reading {
            MarginReading::Known(margin) if contradicts(margin) => &MarginReading::Deaf(DeafReason::Chatter),
            // Nothing will be heard of it before that ends.
            MarginReading::Settling if state.chatters => &MarginReading::Deaf(DeafReason::Chatter),
            reading => reading,
        }
    }

    /// One sample; true when the margin begins to run out.
    ///
    /// Cost: two stores and six sums a sample, a transform of 1600 points a second, and what is worked at:
    /// bins of the spectrum (0.5 us each; up to 25 a sample in the third second of a cut and while nothing is
    /// known of it, up to 9 until the eleventh, then one) or a point of the posterior (3 us).
    pub fn step(&self, state: &mut MarginState, force_n: f64, conditions: &CutConditions) -> bool {
        state.chatters = conditions.chatter;
        let whole = self.band.push(&mut state.band, force_n);
        let share = self.settings.sample_rate.period_s() / CUT_AVERAGE_S;
        state.mean_force_n += (force_n - state.mean_force_n) * share.min(1.0);
        let means = match self.settings.prior.complete(force_n, conditions) {
            Ok(means) => means,
            Err(reason) => {
                self.leave(state, MarginReading::Deaf(reason));
                return false;
            }
        };
        if conditions.chatter && !self.settings.pushes {
            self.leave(state, MarginReading::Deaf(DeafReason::Chatter));
            return false;
        }
        let Some(in_cut) = self.in_cut(state, conditions) else {
            self.leave(state, MarginReading::Deaf(DeafReason::CutUnknown));
            // Where an entry is what is told first, this was air.
            self.listen_to_air(state, whole, &means);
            state.reading = MarginReading::Deaf(DeafReason::CutUnknown);
            return false;
        };
        if in_cut != state.in_cut {
            self.change(state, in_cut, conditions);
        }
        if !in_cut {
            if state.reading == MarginReading::Deaf(DeafReason::CutUnknown) {
                // An exit is what is told first: that was no air.
                (state.air_slices, state.band.air_count) = (0.0, 0.0);
            }
            self.listen_to_air(state, whole, &means);
            return false;
        }
        if state.until_cut > 0 {
            state.until_cut -= 1;
            if state.until_cut == 0 {
                self.band.begin(&mut state.band);
            }
            return false;
        }
        state.slices.add(&means);
        if whole {
            self.end_slice(state);
        }
        self.work(state) && !state.chatters
    }

    /// Whether the tools cut: the column's word, else the mean force's, else what was heard; nothing where
    /// none tells.
    fn in_cut(&self, state: &MarginState, conditions: &CutConditions) -> Option<bool> {
        if let Some(width_m) = conditions.width_m {
            return Some(width_m > 0.0);
        }
        if !self.settings.pushes {
            return conditions.cutting;
        }
        let begins_n = CUT_BEGINS * self.settings.prior.mean_n();
        let least_n = if state.in_cut { begins_n / 2.0 } else { begins_n };
        Some((state.mean_force_n - state.air_mean_n).abs() > least_n)
    }

    fn leave(&self, state: &mut MarginState, reading: MarginReading) {
        if state.in_cut {
            self.change(state, false, &CutConditions::default());
        }
        state.reading = reading;
    }

    /// Tools enter or leave the cut: what was learned of it is forgotten.
    fn change(&self, state: &mut MarginState, in_cut: bool, conditions: &CutConditions) {
        if in_cut {
            let heard = state.slices.whole >= SLICES;
            state.air_swing_n = if heard { self.band.largest_n(&state.band) } else { 0.0 };
        }
        state.in_cut = in_cut;
        state.slices = Slices::default();
        self.band.begin(&mut state.band);
        state.reading = if in_cut { MarginReading::Settling } else { MarginReading::Air };
        (state.warning, state.cloud) = (Warning::default(), Cloud::Idle);
        (state.filled, state.joined, state.age) = (0, 0, 0);
        state.known = false;
        state.fit.stage = Stage::Idle;
        state.reference_n_m2 = 0.0;
        if !in_cut {
            return;
        }
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a tenth of a second")]
        let wait = (self.criteria.entry_s * self.settings.sample_rate.hz()) as usize;
        state.until_cut = wait.max(1) + state.lag;
        state.noise = self.band.air_noise(&state.band).unwrap_or_default();
        state.deviations = CutPrior::deviations(conditions, self.settings.pushes, &self.criteria);
    }

    fn listen_to_air(&self, state: &mut MarginState, whole: bool, means: &Means) {
        state.reading = MarginReading::Air;
        state.slices.add(means);
        if !whole {
            return;
        }
        state.slices.close();
        if state.slices.whole <= TOLD {
            return;
        }
        state.air_slices = (state.air_slices + 1.0).min(SLICES as f64);
        state.air_mean_n += (state.slices.before(TOLD).force_n - state.air_mean_n) / state.air_slices;
        // A quarter of a block is two slices.
        if state.slices.whole >= TOLD + NOW {
            let piece = &mut state.blocks[0].power;
            self.band.learn_air(&mut state.band, piece);
        }
    }

    /// Conditions as the model takes them.
    fn condition(&self, state: &MarginState, means: &Means) -> Condition {
        let stated = &self.settings.prior;
        let mean_n = means.force_n - state.air_mean_n;
        let chip_m2 = means.chip_m2().max(f64::MIN_POSITIVE);
        let told = self.settings.pushes && state.reference_n_m2 > 0.0;
        let heard = Heard {
            mean_n: if self.settings.pushes { mean_n } else { stated.mean_n() },
            stiffer: if told { mean_n.abs() / chip_m2 / state.reference_n_m2 } else { 1.0 },
            force_hz: self.settings.force_hz,
            noise: state.noise,
        };
        stated.condition(means, &heard)
    }

    fn end_slice(&self, state: &mut MarginState) {
        state.slices.close();
        state.age += 1;
        let ready = state.slices.whole >= SLICES && state.slices.whole.is_multiple_of(HOP);
        if ready && state.fit.stage == Stage::Idle && self.may_learn(state) {
            self.take_block(state);
        }
        if state.known && state.cloud == Cloud::Idle {
            self.begin_cloud(state);
        }
    }

    /// Whether the last block was one condition, linear, and without a hit.
    fn may_learn(&self, state: &MarginState) -> bool {
        let middle_hz = self.band.middle_hz;
        let mean_n = (state.slices.mean(SLICES).force_n - state.air_mean_n).abs();
        let swing2 = self.band.largest_n(&state.band).powi(2) - state.air_swing_n.powi(2);
        let linear = !self.settings.pushes || swing2 < (self.criteria.linear_swing * mean_n).powi(2);
        let even = self.band.fall(&state.band) < self.criteria.fall;
        linear && even && !state.slices.chattered() && state.slices.steady(middle_hz, &self.criteria)
    }

    fn take_block(&self, state: &mut MarginState) {
        if state.reference_n_m2 == 0.0 {
            let means = state.slices.mean(SLICES);
            let mean_n = (means.force_n - state.air_mean_n).abs();
            state.reference_n_m2 = mean_n / means.chip_m2().max(f64::MIN_POSITIVE);
        }
        if state.joined >= self.criteria.searched_blocks && !state.known {
            // No fit of them had a stable point: the next ones are asked anew.
            (state.filled, state.joined) = (0, 0);
        }
        let joint = state.joined < self.criteria.joint_blocks;
        state.filled = if joint { state.filled + 1 } else { 1 };
        state.joined += 1;
        let place = state.filled - 1;
        self.band.block(&mut state.band, &mut state.blocks[place].power);
        if state.noise == Noise::default() {
            // There was no air: the lowest tenth of the band, which is exp(-2.2) of its mean.
            state.noise = lowest(&state.blocks[place].power, self.band.middle_hz);
            if !self.settings.pushes {
                // That of a dynamometer is nearly flat; how that of encoders rises is not known.
                state.deviations[place::SLOPE] = state.deviations[place::NOISE];
            }
        }
        let conditions = state.slices.travelled().map(|means| self.condition(state, &means));
        state.blocks[place].conditions = conditions;
        self.expect_interference(&mut state.blocks[place], &state.band);
        if joint {
            let prior = Gaussian::independent(self.settings.prior.means(), &state.deviations);
            if state.joined <= self.criteria.searched_blocks {
                state.fit.search(&prior);
            } else {
                let from = state.posterior.mean;
                state.fit.follow(&prior, &from);
            }
        } else {
            let seconds = state.age as f64 * self.band.slice_s();
            let later = state.posterior.later(seconds, &self.criteria.drift);
            // It stands where the fit has none.
            state.posterior = later.unwrap_or(state.posterior);
            state.fit.follow(&state.posterior, &state.posterior.mean);
        }
        state.age = 0;
        let samples = HOP as f64 * self.band.slice_s() * self.settings.sample_rate.hz();
        let work = state.fit.work(state.filled, self.band.bins);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "some bins a sample")]
        let per_sample = (work as f64 / (samples / 2.0)).ceil() as usize;
        state.per_sample = per_sample.max(1);
    }

    /// Interference is expected at orders of the spindle and where a line stood in air.
    fn expect_interference(&self, block: &mut Block, air: &BandState) {
        // Bins of the window's main lobe to each side, and half of one in which its middle may lie.
        const LOBE: f64 = 2.5;
        let turn_s = block.conditions[0].turn_s;
        for (bin, expected) in block.expected.iter_mut().enumerate() {
            let order = self.band.half_bin_hz(2 * bin as i64) * turn_s;
            let from_order_hz = (order - order.round()).abs() / turn_s;
            *expected = from_order_hz <= LOBE * self.band.bin_hz() || self.band.is_line_of_air(air, bin);
        }
    }

    /// One sample's share of the work; true when the margin begins to run out.
    fn work(&self, state: &mut MarginState) -> bool {
        match state.cloud {
            Cloud::Search => self.search_roots(state),
            Cloud::Points => return self.take_point(state),
            Cloud::Idle => {
                for _ in 0..state.per_sample {
                    if state.fit.stage == Stage::Idle {
                        break;
                    }
                    let blocks = &state.blocks[..state.filled];
                    if let Some(posterior) = state.fit.advance(blocks, &self.band) {
                        (state.posterior, state.known) = (posterior, true);
                    }
                }
            }
        }
        false
    }

    fn begin_cloud(&self, state: &mut MarginState) {
        state.now = self.condition(state, &state.slices.mean(NOW));
        let seconds = 1.0 + state.age as f64 * self.band.slice_s();
        let Some(later) = state.posterior.later(seconds, &self.criteria.drift) else { return };
        let Some(spread) = later.covariance().and_then(Information::cholesky) else { return };
        state.spread = spread.l() * self.criteria.wider;
        state.roots = Roots::default();
        (state.cloud, state.number, state.found) = (Cloud::Search, 0, 0);
    }

    fn search_roots(&self, state: &mut MarginState) {
        let cut = Cut::new(&state.now, &state.posterior.mean);
        let band_hz = self.settings.band_hz;
        if let Some(seed) = seed(&cut, band_hz, state.number) {
            if let Some(root) = descend(&cut, seed).filter(|root| inside(*root, band_hz)) {
                state.roots.insert(root);
            }
            state.number += 1;
        } else if state.roots.first().is_some() {
            (state.cloud, state.number) = (Cloud::Points, 0);
        } else {
            state.cloud = Cloud::Idle;
            state.reading = MarginReading::Deaf(DeafReason::NoRootInBand);
        }
    }

    fn take_point(&self, state: &mut MarginState) -> bool {
        if let Some(point) = self.points.get(state.number) {
            let at = state.posterior.mean + state.spread * point;
            let cut = Cut::new(&state.now, &at);
            let place = state.margins.get_mut(state.found).zip(state.lines.get_mut(state.found));
            if let (Some(found), Some((margin, line))) = (margin_and_line(&cut, &state.roots), place) {
                [*margin, *line] = found;
                state.found += 1;
            }
            state.number += 1;
            return false;
        }
        state.cloud = Cloud::Idle;
        let Some(root) = state.roots.first() else { return false };
        let found = state.found.min(state.margins.len());
        let margins = &mut state.margins[..found];
        let lines = &mut state.lines[..found];
        margins.sort_unstable_by(f64::total_cmp);
        lines.sort_unstable_by(f64::total_cmp);
        if margins.is_empty() {
            return false;
        }
        let margin = Margin {
            margin_1_s: -root.re,
            lo_1_s: quantile(margins, 0.025).min(-root.re),
            hi_1_s: quantile(margins, 0.975).max(-root.re),
            frequency_hz: root.im / (2.0 * PI),
        };
        state.reading = read(margin, quantile(lines, 0.5), &self.criteria);
        state.warning.begins(&state.reading, &self.criteria)
    }
}

/// Noise where there was no air: the lowest tenth of the band.
fn lowest(power: &[f64], middle_hz: f64) -> Noise {
    let mean = power.iter().sum::<f64>() / power.len().max(1) as f64;
    let low = power.iter().filter(|p| **p < mean).sum::<f64>() / power.len().max(1) as f64;
    Noise { level: (low / 10.0).max(f64::MIN_POSITIVE).ln(), slope: 0.0, middle_hz }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Blocks of which no fit had a stable point.
    #[test]
    fn a_cut_of_which_nothing_was_learned_is_asked_anew() {
        let settings = MarginSettings {
            sample_rate: SampleRate::new(9000.0).unwrap(),
            band_hz: [480.0, 760.0],
            prior: CutPrior::usual(0.024, 0.2).unwrap(),
            pushes: true,
            force_hz: 1000.0,
        };
        let monitor = MarginMonitor::new(settings);
        let mut state = monitor.start(0);
        let searched = monitor.criteria.searched_blocks;
        (state.joined, state.filled) = (searched, searched);
        monitor.take_block(&mut state);
        assert_eq!((state.fit.stage, state.joined, state.filled), (Stage::Search, 1, 1));
        // One that is known is followed.
        let all = monitor.criteria.joint_blocks;
        (state.joined, state.filled, state.known) = (all, all, true);
        monitor.take_block(&mut state);
        assert_eq!((state.fit.stage, state.joined, state.filled), (Stage::Refine, all + 1, 1));
    }
}
