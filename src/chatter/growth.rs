//! How fast a line grew while it was suspected: the slope of the logarithm of its amplitude. One window alone
//! tells the growth of its own length, which noise moves by as much as it is.

/// Looks that are kept: 128 ms.
const KEPT: usize = 32;
/// Looks of a slope: 64 ms, the least 24 ms.
const SPAN: usize = 16;
const LEAST: usize = 6;
/// Of the learned noise: less is noise.
const OVER_NOISE: f64 = 4.0;

/// ln(amplitude) of the looks, newest last; not a number where the line does not stand out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Growth {
    t_s: [f64; KEPT],
    ln_amplitude: [f64; KEPT],
    seen: u64,
}

crate::keyframe::keep!(Growth { t_s, ln_amplitude, seen } if |g| g.seen <= KEPT as u64);

impl Growth {
    pub(super) const NEW: Self = Self { t_s: [0.0; KEPT], ln_amplitude: [0.0; KEPT], seen: 0 };

    /// Takes the line of one decision; `seen` counts those in which it stood out.
    pub(super) fn look(&mut self, t_s: f64, power_n2: f64, noise_n2: f64) {
        if !(power_n2 > OVER_NOISE * noise_n2) {
            self.seen = 0;
            return;
        }
        self.t_s.rotate_left(1);
        self.ln_amplitude.rotate_left(1);
        (self.t_s[KEPT - 1], self.ln_amplitude[KEPT - 1]) = (t_s, 0.5 * power_n2.ln());
        self.seen = (self.seen + 1).min(KEPT as u64);
    }

    /// Growth of the amplitude, 1/s: the steepest part, what was grown stands.
    /// Checked by: `the_growth_is_told_within_a_factor_of_two`.
    pub(super) fn slope_1_s(&self) -> Option<f64> {
        #[expect(clippy::cast_possible_truncation, reason = "at most KEPT")]
        let seen = self.seen as usize;
        let span = seen.min(SPAN);
        let from = KEPT - seen;
        let slope = |k: usize| {
            let (t, y) = (&self.t_s[k..k + span], &self.ln_amplitude[k..k + span]);
            let mean = |x: &[f64]| x.iter().sum::<f64>() / span as f64;
            let (mean_t, mean_y) = (mean(t), mean(y));
            let cross: f64 = t.iter().zip(y).map(|(t, y)| (t - mean_t) * (y - mean_y)).sum();
            cross / t.iter().map(|t| (t - mean_t).powi(2)).sum::<f64>().max(1e-12)
        };
        (span >= LEAST).then(|| (from..=KEPT - span).map(slope).fold(f64::NEG_INFINITY, f64::max))
    }
}
