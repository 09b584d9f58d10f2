//! A sample that no force can be: a spike of one or a few samples far outside of what the force does. A
//! tool, a bar or a hit moves the force over a millisecond and more; a fault of sensor, cable or converter
//! does not.

use super::criteria::CRITERIA;

/// What goes on for more samples than this is no spike.
const FEW: u32 = 3;

/// The level and how far samples usually are from it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct OutlierFilter {
    seen: u64,
    level_n: f64,
    square_n2: f64,
    /// Mean square of the second difference.
    bend_n2: f64,
    /// Newest first.
    last_n: [f64; 2],
    run: u32,
}

crate::keyframe::keep!(OutlierFilter { seen, level_n, square_n2, bend_n2, last_n, run } if |w| w.run <= FEW);

impl OutlierFilter {
    /// Mean square of a sensor's noise, N^2: of second differences, in which little else is left.
    pub(super) fn noise_n2(&self) -> f64 {
        self.bend_n2 / 6.0
    }

    /// The sample, or the level where it is wild. Checked by: `spikes_are_left_out_and_steps_pass`.
    #[inline]
    pub(super) fn bound(&mut self, force_n: f64, period_s: f64) -> f64 {
        let apart_n = force_n - self.level_n;
        let known = self.seen as f64 * period_s > CRITERIA.outlier_memory_s;
        if known
            && self.run < FEW
            && apart_n * apart_n > CRITERIA.outlier_deviations * CRITERIA.outlier_deviations * self.square_n2
        {
            self.run += 1;
            return self.level_n;
        }
        let believed = std::mem::take(&mut self.run) >= FEW;
        self.seen += 1;
        let share = if known { period_s * (1.0 / CRITERIA.outlier_memory_s) } else { 1.0 / self.seen as f64 };
        self.level_n += apart_n * share;
        self.square_n2 += (apart_n * apart_n - self.square_n2) * share;
        let bend_n = force_n - 2.0 * self.last_n[0] + self.last_n[1];
        self.last_n = [force_n, self.last_n[0]];
        // Not of the two samples before the first.
        if self.seen > 2 {
            self.bend_n2 += (bend_n * bend_n - self.bend_n2) * share;
        }
        if believed {
            // It goes on: the force is elsewhere now.
            self.square_n2 = self.square_n2.max(apart_n * apart_n);
        }
        force_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spikes_are_left_out_and_steps_pass() {
        let mut filter = OutlierFilter::default();
        let force = |k: u32| match k {
            0..3000 => 0.1 * (f64::from(k) * 0.7).sin(),
            3000..6000 => 80.0 + 5.0 * (f64::from(k) * 0.4).sin(),
            _ => 80.0 + (5.0 + 0.01 * f64::from(k - 6000)) * (f64::from(k) * 0.4).sin(),
        };
        for k in 0..9000 {
            for spike in [500.0, -3e4, 1e30] {
                let mut struck = filter;
                let quiet = k > 1000 && !(2990..4500).contains(&k);
                assert!(!quiet || struck.bound(spike, 1.0 / 9000.0).abs() < 120.0, "{k} {spike}");
            }
            let passed = filter.bound(force(k), 1.0 / 9000.0) == force(k);
            assert!(passed || (3000..3004).contains(&k), "{k}");
        }
    }
}
