//! The noise of this stream over frequency, learned while nothing stands out.

/// Learned power at each filter of a bank.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Baseline {
    expected: Vec<f64>,
    /// At least most of the neighbours' mean: a filter that was quiet by chance is not believed.
    believed: Vec<f64>,
    scratch: Vec<f64>,
    /// Independent looks in the average.
    looks: f64,
}

crate::keyframe::keep!(Baseline { expected, believed, scratch, looks });

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

impl Baseline {
    pub(super) fn new(filters: usize) -> Self {
        let zeros = vec![0.0; filters];
        Self { expected: zeros.clone(), believed: zeros.clone(), scratch: zeros, looks: 0.0 }
    }

    /// Takes the powers into the average. A power far above what is known counts as `most` times it: a hit or
    /// a line that grows must not become noise.
    pub(super) fn learn(&mut self, power: impl Fn(usize) -> f64, lesson: Lesson) {
        self.looks = (self.looks + lesson.looks).min(lesson.memory_looks);
        let share = lesson.looks / self.looks;
        for (k, known) in self.expected.iter_mut().enumerate() {
            let limit = if self.looks > 2.0 { lesson.most * *known } else { f64::INFINITY };
            *known += share * (power(k).min(limit) - *known);
        }
        let reach = 4;
        let last = self.expected.len() - 1;
        let mut sum: f64 = self.expected[..reach.min(last + 1)].iter().sum();
        let mut count = reach.min(last + 1) as f64;
        for k in 0..=last {
            if k + reach <= last {
                sum += self.expected[k + reach];
                count += 1.0;
            }
            if k > reach {
                sum -= self.expected[k - reach - 1];
                count -= 1.0;
            }
            self.believed[k] = self.expected[k].max(0.7 * sum / count).max(f64::MIN_POSITIVE);
        }
    }

    /// Whether anything is known: before, no power stands out.
    pub(super) fn is_known(&self) -> bool {
        self.looks >= 1.0
    }

    /// Trusts what is known no more than so many looks: the cut changed.
    pub(super) fn doubt(&mut self, looks: f64) {
        self.looks = self.looks.min(looks);
    }

    /// Contrast that noise exceeds with probability e^-`nepers`, when it is known from as many looks as here.
    ///
    /// n (e^{T/n} - 1): the ratio of one exponential to the mean of n others; T for n without end.
    pub(super) fn threshold(&self, nepers: f64) -> f64 {
        if !self.is_known() { f64::INFINITY } else { self.looks * (nepers / self.looks).exp_m1() }
    }

    /// Learned power at a filter.
    pub(super) fn expected(&self, filter: usize) -> f64 {
        self.believed[filter].max(f64::MIN_POSITIVE)
    }

    /// The filter with the greatest ratio of power to learned noise; the ratio divided by the band's common
    /// level when all of the band is louder than learned (its median over ln 2, the median of an exponential
    /// distribution of mean one). `leak` is what the strongest line puts on each filter: that is no noise.
    pub(super) fn standout(
        &mut self,
        among: std::ops::Range<usize>,
        power: impl Fn(usize) -> f64,
        leak: impl Fn(usize) -> f64,
    ) -> Standout {
        let mut best = Standout::default();
        let ratios = &mut self.scratch[among.clone()];
        for (k, ratio) in among.zip(ratios.iter_mut()) {
            let p = power(k);
            let noise = self.believed[k].max(f64::MIN_POSITIVE);
            if p / noise > best.contrast {
                best = Standout { filter: k, contrast: p / noise, power_n2: p, common: 1.0 };
            }
            *ratio = p / (noise + leak(k));
        }
        if ratios.is_empty() {
            return best;
        }
        let middle = ratios.len() / 2;
        let (_, median, _) = ratios.select_nth_unstable_by(middle, f64::total_cmp);
        best.common = *median / std::f64::consts::LN_2;
        best.contrast /= best.common.max(1.0);
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LESSON: Lesson = Lesson { looks: 1.0, memory_looks: 10.0, most: 4.0 };

    #[test]
    fn a_line_stands_out_and_a_loud_band_does_not() {
        let mut baseline = Baseline::new(5);
        for _ in 0..100 {
            baseline.learn(|k| 1.0 + k as f64, LESSON);
        }
        let line = baseline.standout(0..5, |k| if k == 3 { 400.0 } else { 1.0 }, |_| 0.0);
        assert_eq!(line.filter, 3);
        assert!((line.contrast - 100.0).abs() < 1.0);
        let loud = baseline.standout(0..5, |k| 50.0 * (1.0 + k as f64), |_| 0.0);
        // What the line itself puts on its neighbours raises no level.
        let leaking = baseline.standout(0..5, |k| if k == 3 { 4e4 } else { 4e3 }, |_| 4e3);
        assert!(leaking.common < 2.0 && leaking.contrast > 5000.0, "{leaking:?}");
        assert!(loud.contrast < 1.0);
    }

    #[test]
    fn a_hit_does_not_become_noise() {
        let mut baseline = Baseline::new(1);
        (0..100).for_each(|_| baseline.learn(|_| 1.0, LESSON));
        baseline.learn(|_| 1e6, LESSON);
        assert!(baseline.expected(0) < 1.4);
    }
}
