//! Conditions of the cut, sample by sample and averaged over slices of an eighth of a block.

use super::criteria::Criteria;
use crate::keyframe::keep;

/// What is known of the cut at a sample; nothing where no column tells it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct CutConditions {
    /// Speed.
    pub spindle_speed_rpm: Option<f64>,
    /// theta_2 - theta_1.
    pub pitch_difference_rad: Option<f64>,
    /// Both tools, from the chuck.
    pub tool_position_m: Option<f64>,
    /// Feed per turn.
    pub feed_m_rev: Option<f64>,
    /// Width of cut per tool; 0: out of the cut.
    pub width_m: Option<f64>,
    /// Whether the tools cut, where no width tells it.
    pub cutting: Option<bool>,
    /// Whether chatter is declared.
    pub chatter: bool,
}

/// Means over a stretch.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Means {
    pub(super) force_n: f64,
    pub(super) turn_s: f64,
    pub(super) pitch_rad: f64,
    pub(super) position_m: f64,
    pub(super) feed_m_rev: f64,
    pub(super) width_m: f64,
    /// Share of the samples in which chatter is declared.
    pub(super) chatter_share: f64,
    /// Samples.
    pub(super) count: f64,
}

keep!(Means { force_n, turn_s, pitch_rad, position_m, feed_m_rev, width_m, chatter_share, count });

impl Means {
    /// Takes a value of each in, as a sum.
    pub(super) fn add(&mut self, other: &Self) {
        self.force_n += other.force_n;
        self.turn_s += other.turn_s;
        self.pitch_rad += other.pitch_rad;
        self.position_m += other.position_m;
        self.feed_m_rev += other.feed_m_rev;
        self.width_m += other.width_m;
        self.chatter_share += other.chatter_share;
        self.count += other.count;
    }

    /// Sums to means.
    pub(super) fn mean(&self) -> Self {
        let share = 1.0 / self.count.max(1.0);
        Self {
            force_n: self.force_n * share,
            turn_s: self.turn_s * share,
            pitch_rad: self.pitch_rad * share,
            position_m: self.position_m * share,
            feed_m_rev: self.feed_m_rev * share,
            width_m: self.width_m * share,
            chatter_share: self.chatter_share * share,
            count: self.count,
        }
    }

    /// Mean chip area of tool 1 for a share of the turn of (pi + d/2)/2 pi: f b theta_2/2 pi, m^2.
    pub(super) fn chip_m2(&self) -> f64 {
        self.feed_m_rev * self.width_m * (0.5 + self.pitch_rad / (4.0 * std::f64::consts::PI))
    }
}

/// Slices in a block: the conditions of half a second (two slices) are those of now, a block begins every
/// four, so that blocks overlap by a half.
pub(super) const SLICES: usize = 8;
/// Slices from the start of one block to the next.
pub(super) const HOP: usize = SLICES / 2;
/// Slices that stand for now.
pub(super) const NOW: usize = 2;

/// Slices within which an entry is told: those before it is told may have it in them.
pub(super) const TOLD: usize = 2;

/// The last [`SLICES`] slices.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Slices {
    ring: [Means; SLICES],
    current: Means,
    /// Whole slices since the start.
    pub(super) whole: usize,
}

keep!(Slices { ring, current, whole });

impl Slices {
    pub(super) fn add(&mut self, sample: &Means) {
        self.current.add(sample);
    }

    pub(super) fn close(&mut self) {
        self.ring[self.whole % SLICES] = self.current.mean();
        self.current = Means::default();
        self.whole += 1;
    }

    /// The last `count` slices, newest first.
    fn last(&self, count: usize) -> impl Iterator<Item = &Means> {
        (1..=count.min(self.whole)).map(|back| &self.ring[(self.whole - back) % SLICES])
    }

    /// The slice that was whole `back` slices ago. Requires: there are that many.
    pub(super) fn before(&self, back: usize) -> &Means {
        &self.ring[(self.whole - 1 - back) % SLICES]
    }

    /// Mean of the last `count` slices. Requires: one is whole.
    pub(super) fn mean(&self, count: usize) -> Means {
        let mut sum = Means::default();
        for slice in self.last(count) {
            sum.add(&Means { count: 1.0, ..*slice });
        }
        sum.mean()
    }

    /// Mean of the last block with the tools where they were at two moments of it, which stand for it as the
    /// window weighs it: sin^4 has a standard deviation of 0.1414 of its length.
    pub(super) fn travelled(&self) -> [Means; 2] {
        const DEVIATION: f64 = 0.1414;
        let mean = self.mean(SLICES);
        // Half a block is from the middle of its first half to that of its last.
        let travel_m = (self.mean(HOP).position_m - mean.position_m) * 2.0;
        let at =
            |side: f64| Means { position_m: mean.position_m + side * travel_m * DEVIATION / 0.5, ..mean };
        [at(-1.0), at(1.0)]
    }

    /// Whether chatter was declared in the last block: its vibration is a limit cycle, not the answer of a
    /// linear cut to a random force.
    pub(super) fn chattered(&self) -> bool {
        self.last(SLICES).any(|slice| slice.chatter_share > 0.0)
    }

    /// Whether the last block was cut under one condition at a line of `frequency_hz`: the delayed wave
    /// kept its phase, chip and position their size.
    pub(super) fn steady(&self, frequency_hz: f64, criteria: &Criteria) -> bool {
        let spread = |of: fn(&Means) -> f64| {
            let ends = self.last(SLICES).map(of).fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
            ends.1 - ends.0
        };
        let mean = self.mean(SLICES);
        let wave = 2.0 * std::f64::consts::PI * frequency_hz;
        let turned = wave * (spread(|m| m.turn_s) / 2.0)
            + wave * mean.turn_s * spread(|m| m.pitch_rad) / (4.0 * std::f64::consts::PI);
        let chip = spread(Means::chip_m2) / mean.chip_m2().max(f64::MIN_POSITIVE);
        // phi falls about as z^2 along a cantilever, its square as z^4.
        let place = 4.0 * spread(|m| m.position_m) / mean.position_m.max(f64::MIN_POSITIVE);
        turned < criteria.phase_in_block_rad && chip + place < criteria.change_in_block
    }
}
