//! The noise of this stream over frequency, learned while nothing stands out.

use super::detector::{CONFIRM, SUSPECT};
use crate::signal::dispatch::{Fast, Kernel, run};
use crate::signal::line_bank::{Leak, LineBank, LineBankState};

/// Learned power at each filter of a bank.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Baseline {
    expected: Vec<f64>,
    /// At least most of the neighbours' mean: a filter that was quiet by chance is not believed.
    believed: Vec<f64>,
    /// Powers when the bank was looked at last.
    powers: Vec<f64>,
    /// The strongest of them.
    strongest: usize,
    ratios: Vec<f64>,
    /// Independent looks in the average.
    looks: f64,
    /// Contrasts at which to look and to declare, for so many looks.
    suspect: f64,
    confirm: f64,
}

crate::keyframe::keep!(Baseline { expected, believed, powers, strongest, ratios, looks, suspect, confirm });

/// The line that stands out most in a bank.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Standout {
    /// Filter.
    pub(super) filter: usize,
    /// Power over learned noise, over what the band shows now.
    pub(super) contrast: f64,
    /// Power.
    pub(super) power_n2: f64,
    /// Level of all of the band over what was learned: 1 is the noise that is known.
    pub(super) common: f64,
}

/// How one step of learning goes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lesson {
    /// Independent looks that this one counts as: time step over the window's length.
    pub(super) looks: f64,
    /// Looks over which the average is taken at most.
    pub(super) memory_looks: f64,
    /// A power above so many times what is known counts as this.
    pub(super) most: f64,
}

/// What was learned is a line where it stands so far above the middle of the band, and is gone under this
/// part of it: noise of the middle is under it 7 times in 8, a line of that size, in noise, once in 30.
const LEARNED_LINE: f64 = 8.0;
const GONE: f64 = 4.0;
/// Noise stands at most this far above the middle of the band.
const LEVEL: f64 = 4.0;
/// What the middle of the band says of one filter counts as so many looks at it.
const LEVEL_LOOKS: f64 = 6.0;
/// Neighbours on each side that a filter is believed by.
const REACH: usize = 4;
/// Share of their mean that it is believed to have at least.
const FLOOR: f64 = 0.7;
/// Independent looks in that mean for each look at one filter. Filters k apart (0.12 k / tau) correlate by
/// r_k = (1 + (0.12 pi k)^2)^-3; nine of them are 81 / (9 + 2 sum (9 - k) r_k).
const POOLED: f64 = 3.2;

impl Baseline {
    pub(super) fn new(filters: usize) -> Self {
        let zeros = vec![0.0; filters];
        Self {
            expected: zeros.clone(),
            believed: vec![f64::MIN_POSITIVE; filters],
            powers: zeros.clone(),
            strongest: 0,
            ratios: zeros,
            looks: 0.0,
            suspect: f64::INFINITY,
            confirm: f64::INFINITY,
        }
    }

    /// Reads the powers of the bank; answers the strongest filter of some.
    pub(super) fn look(
        &mut self,
        bank: &LineBank,
        state: &LineBankState,
        among: std::ops::Range<usize>,
    ) -> usize {
        bank.powers(state, &mut self.powers);
        self.strongest = among.start + run(Fast::detect(), Largest { values: &self.powers[among] }).0;
        self.strongest
    }

    /// The strongest filter of the last look.
    pub(super) fn strongest(&self) -> usize {
        self.strongest
    }

    /// Sum of the powers of some filters at the last look.
    pub(super) fn sum(&self, among: std::ops::Range<usize>) -> f64 {
        self.powers[among].iter().sum()
    }

    /// Median of the powers of some filters at the last look.
    pub(super) fn median(&mut self, among: std::ops::Range<usize>) -> f64 {
        let (ratios, heard) = (&mut self.ratios[among.clone()], &self.powers[among]);
        ratios.copy_from_slice(heard);
        let middle = ratios.len() / 2;
        if ratios.is_empty() { 0.0 } else { *ratios.select_nth_unstable_by(middle, f64::total_cmp).1 }
    }

    /// Takes what stands far above the rest out of what is known: it was no noise. Where nothing is known the
    /// middle of the band is.
    pub(super) fn level(&mut self) {
        if !self.is_known() {
            let middle = (self.median(0..self.powers.len()) / std::f64::consts::LN_2).max(f64::MIN_POSITIVE);
            self.expected.fill(middle);
            self.believed.fill(middle);
            self.set_looks(LEVEL_LOOKS);
            return;
        }
        let middle = self.expected.len() / 2;
        self.ratios.copy_from_slice(&self.expected);
        let (_, median, _) = self.ratios.select_nth_unstable_by(middle, f64::total_cmp);
        let most = LEVEL * *median;
        for known in self.expected.iter_mut().chain(&mut self.believed) {
            *known = known.min(most).max(f64::MIN_POSITIVE);
        }
    }

    /// Places at which a line was learned that was not heard at the last look, and its power. Checked by:
    /// `a_line_that_left_leaves_a_hole`.
    pub(super) fn left(&mut self) -> impl Iterator<Item = (usize, f64)> {
        let middle = self.expected.len() / 2;
        self.ratios.copy_from_slice(&self.expected);
        let (_, median, _) = self.ratios.select_nth_unstable_by(middle, f64::total_cmp);
        let least = LEARNED_LINE * *median;
        let peaks = self.expected.windows(3).zip(&self.powers[1..]).enumerate();
        peaks.filter_map(move |(k, (known, heard))| {
            let line = known[1] > least && known[1] >= known[0].max(known[2]);
            (line && heard * GONE < known[1]).then_some((k + 1, known[1]))
        })
    }

    /// Power of a filter when the bank was looked at last.
    pub(super) fn power(&self, filter: usize) -> f64 {
        self.powers[filter]
    }

    /// Takes the powers of the last look into the average. A power far above what is known counts as `most`
    /// times it: a hit or a line that grows must not become noise.
    pub(super) fn learn(&mut self, lesson: Lesson) {
        self.set_looks((self.looks + lesson.looks).min(lesson.memory_looks));
        let share = lesson.looks / self.looks;
        let most = if self.looks > 2.0 { lesson.most } else { f64::INFINITY };
        run(Fast::detect(), Learn { baseline: self, share, most });
    }

    fn set_looks(&mut self, looks: f64) {
        if looks.to_bits() != self.looks.to_bits() {
            self.looks = looks;
            (self.suspect, self.confirm) = (self.threshold(SUSPECT), self.threshold(CONFIRM));
        }
    }

    /// Whether anything is known: before, no power stands out.
    pub(super) fn is_known(&self) -> bool {
        self.looks >= 1.0
    }

    /// Trusts what is known no more than so many looks: the cut changed.
    pub(super) fn doubt(&mut self, looks: f64) {
        self.set_looks(self.looks.min(looks));
    }

    /// Contrasts at which to look and to declare.
    pub(super) fn thresholds(&self) -> [f64; 2] {
        [self.suspect, self.confirm]
    }

    /// Contrast that noise exceeds with probability e^-`nepers`, when it is known from as many looks as here.
    ///
    /// n (e^{T/n} - 1): the ratio of one exponential to the mean of n others; T for n without end. What is
    /// believed is at least `FLOOR` of the neighbours' mean, which is of `POOLED` n others.
    fn threshold(&self, nepers: f64) -> f64 {
        let exceeded = |looks: f64| looks * (nepers / looks).exp_m1();
        if !self.is_known() {
            f64::INFINITY
        } else {
            exceeded(self.looks).min(exceeded(POOLED * self.looks) / FLOOR)
        }
    }

    /// Learned power at a filter.
    pub(super) fn expected(&self, filter: usize) -> f64 {
        self.believed[filter]
    }

    /// The filter with the greatest ratio of power to learned noise at the last look; the ratio divided by
    /// the band's common level when all of the band is louder than learned (its median over ln 2, the median
    /// of an exponential distribution of mean one). `leak` is what the strongest line puts on each filter:
    /// that is no noise. `foreign` are the filters of lines that are known to be something else: what falls
    /// off from them on both sides is theirs. Checked by:
    /// `a_line_stands_out_and_a_loud_band_does_not`.
    pub(super) fn standout(
        &mut self,
        among: std::ops::Range<usize>,
        leak: Leak,
        foreign: impl Iterator<Item = usize>,
    ) -> Standout {
        let Self { believed, powers, ratios, .. } = self;
        let (known, heard) = (&believed[among.clone()], &powers[among.clone()]);
        let (ratios, fast) = (&mut ratios[among.clone()], Fast::detect());
        run(fast, Ratios { known, heard, ratios });
        for line in foreign {
            let skirt = Skirt { believed, powers, first: among.start };
            skirt.take_off(ratios, line);
        }
        let (place, contrast) = run(fast, Largest { values: ratios });
        let quiet = run(fast, Leaked { known, heard, ratios, leak, first: among.start });
        // What is quieter than learned matters to nobody: a median below is not looked for.
        let middle = ratios.len() / 2;
        let common = if quiet > middle || ratios.is_empty() {
            1.0
        } else {
            let (_, median, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
            *median / std::f64::consts::LN_2
        };
        let filter = among.start + place;
        Standout { filter, contrast: contrast / common, power_n2: powers[filter], common }
    }
}

/// What a line puts on the filters around it, whatever its shape: one that moves leaves a trail.
struct Skirt<'a> {
    believed: &'a [f64],
    powers: &'a [f64],
    /// Filter of the first ratio.
    first: usize,
}

impl Skirt<'_> {
    /// Counts as noise what falls off from the hill that `line` stands on, down to the least on the way.
    fn take_off(&self, ratios: &mut [f64], line: usize) {
        let powers = self.powers;
        let mut top = line.min(powers.len() - 1);
        let higher = |k: usize| {
            let next = if k > 0 && powers[k - 1] > powers[k] { k - 1 } else { k + 1 };
            (next < powers.len() && powers[next] > powers[k]).then_some(next)
        };
        while let Some(next) = higher(top) {
            top = next;
        }
        let mut count = |k: usize, least: &mut f64| {
            *least = least.min(powers[k]);
            if let Some(ratio) = k.checked_sub(self.first).and_then(|k| ratios.get_mut(k)) {
                *ratio *= self.believed[k] / (self.believed[k] + *least);
            }
        };
        let mut least = f64::INFINITY;
        (0..=top).rev().for_each(|k| count(k, &mut least));
        least = powers[top];
        (top + 1..powers.len()).for_each(|k| count(k, &mut least));
    }
}

/// Place and size of the largest of some values that are not negative; the first of none is 0.
struct Largest<'a> {
    values: &'a [f64],
}

impl Kernel for Largest<'_> {
    type Output = (usize, f64);

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> (usize, f64) {
        const LANES: usize = 8;
        let (chunks, rest) = self.values.as_chunks::<LANES>();
        let mut most = [0.0; LANES];
        for chunk in chunks {
            for lane in 0..LANES {
                most[lane] = if chunk[lane] > most[lane] { chunk[lane] } else { most[lane] };
            }
        }
        let largest = most.iter().chain(rest).fold(0.0, |a: f64, b| a.max(*b));
        let has = |chunk: &&[f64; LANES]| chunk.iter().fold(false, |has, x| has | (*x >= largest));
        // A chunk at a time is asked, all of it at once.
        let before = chunks.iter().take_while(|chunk| !has(chunk)).count() * LANES;
        let place = self.values[before..].iter().position(|x| *x >= largest);
        (place.map_or(0, |place| before + place), largest)
    }
}

/// Power over noise.
struct Ratios<'a> {
    known: &'a [f64],
    heard: &'a [f64],
    ratios: &'a mut [f64],
}

impl Kernel for Ratios<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        for ((ratio, power), noise) in self.ratios.iter_mut().zip(self.heard).zip(self.known) {
            *ratio = power / noise;
        }
    }
}

/// Power over noise and what the strongest line puts there, p / (n + s / b).
struct Leaked<'a> {
    known: &'a [f64],
    heard: &'a [f64],
    ratios: &'a mut [f64],
    leak: Leak,
    first: usize,
}

impl Kernel for Leaked<'_> {
    /// How many are quieter than learned: under the median of an exponential distribution of mean one.
    type Output = usize;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> usize {
        let mut place = self.first as f64;
        for ((ratio, power), noise) in self.ratios.iter_mut().zip(self.heard).zip(self.known) {
            let below = self.leak.below(place);
            *ratio = power * below / (noise * below + self.leak.power);
            place += 1.0;
        }
        self.ratios.iter().filter(|ratio| **ratio <= std::f64::consts::LN_2).count()
    }
}

/// One step of the averages.
struct Learn<'a> {
    baseline: &'a mut Baseline,
    share: f64,
    most: f64,
}

impl Kernel for Learn<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FUSED: bool>(self) {
        let Baseline { expected, believed, powers, .. } = self.baseline;
        for (known, power) in expected.iter_mut().zip(powers.iter()) {
            let limit = if self.most.is_finite() { self.most * *known } else { f64::INFINITY };
            *known += self.share * (power.min(limit) - *known);
        }
        let floor = |sum: f64, count: f64| FLOOR * sum / count;
        let around = expected.windows(2 * REACH + 1).map(|w| floor(w.iter().sum(), (2 * REACH + 1) as f64));
        for ((believed, known), floor) in believed.iter_mut().zip(&*expected).skip(REACH).zip(around) {
            *believed = known.max(floor).max(f64::MIN_POSITIVE);
        }
        let last = expected.len();
        for k in (0..REACH.min(last)).chain(last.saturating_sub(REACH)..last) {
            let there = &expected[k.saturating_sub(REACH)..(k + REACH + 1).min(last)];
            let floor = floor(there.iter().sum(), there.len() as f64);
            believed[k] = expected[k].max(floor).max(f64::MIN_POSITIVE);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LESSON: Lesson = Lesson { looks: 1.0, memory_looks: 10.0, most: 4.0 };

    fn hear(baseline: &mut Baseline, power: impl Fn(usize) -> f64) {
        baseline.powers.iter_mut().enumerate().for_each(|(k, p)| *p = power(k));
    }

    #[test]
    fn a_line_stands_out_and_a_loud_band_does_not() {
        let mut baseline = Baseline::new(25);
        let noise = |k: usize| 1.0 + k as f64 / 5.0;
        for _ in 0..100 {
            hear(&mut baseline, noise);
            baseline.learn(LESSON);
        }
        hear(&mut baseline, |k| if k == 15 { 400.0 } else { 1.0 });
        let line = baseline.standout(0..25, Leak::NONE, std::iter::empty());
        assert_eq!(line.filter, 15);
        assert!((line.contrast - 100.0).abs() < 1.0);
        hear(&mut baseline, |k| 50.0 * noise(k));
        assert!(baseline.standout(0..25, Leak::NONE, std::iter::empty()).contrast < 1.0);
        // What the line itself puts on its neighbours raises no level.
        let leak = Leak { power: 4e4, line: 15.0, per_filter: 0.1 };
        hear(&mut baseline, |k| if k == 15 { 4e4 } else { 4e4 / leak.below(k as f64) });
        let leaking = baseline.standout(0..25, leak, std::iter::empty());
        assert!(leaking.common < 2.0 && leaking.contrast > 5000.0, "{leaking:?}");
    }

    #[test]
    fn a_line_that_left_leaves_a_hole() {
        let mut baseline = Baseline::new(25);
        for _ in 0..50 {
            hear(&mut baseline, |k| if k == 9 { 40.0 } else { 1.0 });
            baseline.learn(LESSON);
        }
        assert_eq!(baseline.left().count(), 0);
        hear(&mut baseline, |k| if k == 15 { 40.0 } else { 1.0 });
        let left: Vec<_> = baseline.left().collect();
        assert!(left.len() == 1 && left[0].0 == 9 && (left[0].1 - 40.0).abs() < 1e-9, "{left:?}");
    }

    #[test]
    fn a_quiet_filter_is_believed_by_its_neighbours() {
        let mut baseline = Baseline::new(12);
        for _ in 0..50 {
            hear(&mut baseline, |k| if k == 5 || k == 0 { 0.0 } else { 9.0 });
            baseline.learn(LESSON);
        }
        // 0.7 of the mean: of nine with one silent, of five at the edge.
        assert!((baseline.expected(5) - 0.7 * 8.0).abs() < 1e-9);
        assert!((baseline.expected(0) - 0.7 * 36.0 / 5.0).abs() < 1e-9);
        assert!((baseline.expected(8) - 9.0).abs() < 1e-9);
    }

    #[test]
    fn few_looks_at_a_filter_are_many_at_its_neighbours() {
        let mut baseline = Baseline::new(25);
        let mut confirm = |looks: f64| {
            baseline.set_looks(looks);
            baseline.thresholds()[1]
        };
        // Alone, six looks ask for 114; long known it is e^-18.
        assert!((confirm(6.0) - 19.2 * (18.0f64 / 19.2).exp_m1() / 0.7).abs() < 1e-9 && confirm(6.0) < 43.0);
        assert!((confirm(1e6) - CONFIRM).abs() < 1e-3);
    }

    #[test]
    fn where_nothing_is_known_the_middle_of_the_band_is() {
        let mut baseline = Baseline::new(25);
        hear(&mut baseline, |k| if k == 15 { 400.0 } else { std::f64::consts::LN_2 });
        baseline.level();
        let line = baseline.standout(0..25, Leak::NONE, std::iter::empty());
        assert!(baseline.is_known() && line.filter == 15 && line.contrast > 300.0, "{line:?}");
    }

    #[test]
    fn a_hit_does_not_become_noise() {
        let mut baseline = Baseline::new(1);
        for _ in 0..100 {
            hear(&mut baseline, |_| 1.0);
            baseline.learn(LESSON);
        }
        hear(&mut baseline, |_| 1e6);
        baseline.learn(LESSON);
        assert!(baseline.expected(0) < 1.4);
    }
}
