//! Vibration that no stable cut has: what the band holds beside the spindle's orders is a large share of the
//! mean force and stands far above what the band held when it was quietest.
//!
//! A cut that is stable answers the noise of its own force, some hundredths of the mean, with a few times as
//! much: near the limit a quarter of the mean. From half of the mean on the vibration is near the chip's
//! thickness: tools lose contact, and lines beat, hop and scatter as noise does. How a line fluctuates proves
//! nothing then.

/// Amplitude of the band over the mean force. A tool that only pushes makes lines of less than twice its
/// mean, several of them a little more: beyond that the mean is none of a cut.
const SHARE: f64 = 0.5;
const MOST_SHARE: f64 = 4.0;
/// Power over the least that the band ever had: 10 dB.
const OVER_REST: f64 = 10.0;
/// The mean stands so far above the noise of then.
const CUTS: f64 = 10.0;
/// Share of its loudest under which it has gone: 10 dB. The loudest is forgotten over 4 s of decisions.
const GONE: f64 = 0.1;
const KEPT: f64 = 0.999;
/// Smoothing of the band's power; the least is looked for after five times as long.
const SMOOTH_S: f64 = 0.1;
/// Loud for so many decisions without a break (0.5 s) it is chatter whatever its lines do.
const LASTS: u32 = 125;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Loudness {
    heard_s: f64,
    /// Of all that the mixer lets through.
    band_n2: f64,
    rest_n2: f64,
    /// Of the watched band.
    within_n2: f64,
    loudest_n2: f64,
    lasts: u32,
}

crate::keyframe::keep!(Loudness { heard_s, band_n2, rest_n2, within_n2, loudest_n2, lasts });

impl Loudness {
    pub(super) const NEW: Self = Self {
        heard_s: 0.0,
        band_n2: 0.0,
        rest_n2: f64::INFINITY,
        within_n2: 0.0,
        loudest_n2: 0.0,
        lasts: 0,
    };

    /// Takes the power of one sample of the band without the orders.
    #[inline]
    pub(super) fn hear(&mut self, power_n2: f64, period_s: f64) {
        self.heard_s += period_s;
        self.band_n2 += (power_n2 - self.band_n2) * (period_s / SMOOTH_S);
    }

    /// Takes the power of the watched band and the mean force at one decision, `NAN` where the orders are not
    /// known, and whether chatter stands declared: then it is loud whatever the band was before.
    pub(super) fn look(&mut self, (within_n2, period_s): (f64, f64), mean_n: f64, declared: bool) {
        if self.heard_s > 5.0 * SMOOTH_S {
            self.rest_n2 = self.rest_n2.min(self.band_n2);
        }
        // What is loud beside the band is no chatter of this bar.
        self.within_n2 += (within_n2 - self.within_n2) * (period_s / SMOOTH_S);
        self.loudest_n2 = (self.loudest_n2 * KEPT).max(self.within_n2);
        let share = (2.0 * self.within_n2).sqrt() / mean_n.abs().max(f64::MIN_POSITIVE);
        let came = mean_n.abs() > CUTS * self.rest_n2.sqrt() && self.within_n2 > OVER_REST * self.rest_n2;
        let loud = (SHARE..MOST_SHARE).contains(&share)
            && (came || declared)
            && self.within_n2 > GONE * self.loudest_n2;
        self.lasts = if loud { (self.lasts + 1).min(LASTS) } else { 0 };
    }

    /// Whether it is loud now.
    pub(super) fn is_loud(&self) -> bool {
        self.lasts > 0
    }

    /// Whether it has been loud for long enough.
    pub(super) fn lasts(&self) -> bool {
        self.lasts >= LASTS
    }

    /// The least power that the band ever had.
    pub(super) fn rest_n2(&self) -> f64 {
        self.rest_n2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Decisions at which it was loud and has lasted: air, a cut, loud for 2 s, quiet again.
    fn loud_at(share: f64) -> [u32; 2] {
        let mut loudness = Loudness::NEW;
        let mut at = [0; 2];
        for k in 0..2000u32 {
            let mean_n = if k < 500 { 0.01 } else { 20.0 };
            let amplitude_n = if (1000..1500).contains(&k) { share * 20.0 } else { 0.03 * mean_n };
            let power_n2 = 0.5 * amplitude_n * amplitude_n;
            (0..4).for_each(|_| loudness.hear(power_n2, 0.001));
            loudness.look((power_n2, 0.004), mean_n, false);
            at[0] += u32::from(loudness.is_loud());
            at[1] += u32::from(loudness.lasts());
        }
        at
    }

    #[test]
    fn half_of_the_mean_force_is_loud_and_a_stable_cut_is_not() {
        assert_eq!(loud_at(0.3), [0, 0]);
        let [loud, lasts] = loud_at(0.8);
        assert!((480..560).contains(&loud) && (350..440).contains(&lasts), "{loud} {lasts}");
    }
}
