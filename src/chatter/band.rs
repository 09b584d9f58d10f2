//! The band in which a bar can chatter.

use thiserror::Error;

/// Frequencies from low to high.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Band {
    low_hz: f64,
    high_hz: f64,
}

/// Why two numbers are no band.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("band from {low_hz} to {high_hz} Hz: expected 0 < low < high")]
pub struct BandError {
    /// Lower edge given.
    pub low_hz: f64,
    /// Upper edge given.
    pub high_hz: f64,
}

impl Band {
    /// Errors: not finite, not positive, or upside down.
    pub fn new(low_hz: f64, high_hz: f64) -> Result<Self, BandError> {
        let good = low_hz.is_finite() && high_hz.is_finite() && low_hz > 0.0 && high_hz > low_hz;
        if good { Ok(Self { low_hz, high_hz }) } else { Err(BandError { low_hz, high_hz }) }
    }

    /// Lower edge.
    #[must_use]
    pub fn low_hz(self) -> f64 {
        self.low_hz
    }

    /// Upper edge.
    #[must_use]
    pub fn high_hz(self) -> f64 {
        self.high_hz
    }

    /// Middle.
    #[must_use]
    pub fn centre_hz(self) -> f64 {
        (self.low_hz + self.high_hz) / 2.0
    }

    /// Half of the width.
    #[must_use]
    pub fn half_width_hz(self) -> f64 {
        (self.high_hz - self.low_hz) / 2.0
    }

    /// Whether a frequency lies in it.
    #[must_use]
    pub fn contains(self, frequency_hz: f64) -> bool {
        (self.low_hz..=self.high_hz).contains(&frequency_hz)
    }
}

/// Band to watch for a bar whose bending mode is predicted at `bending_frequency_hz`.
///
/// -8 % .. +31 %: the cut holds the bar and raises its chatter 5-25 % above the natural frequency, the clamp
/// gives way and lowers it. The thesis' own bands lie at -6..-8 % and +25..+31 % (tables 6-3, 6-5); its last
/// run chattered at +23 %.
/// Checked by: `bands_of_the_thesis`.
pub fn predicted_band(bending_frequency_hz: f64) -> Result<Band, BandError> {
    Band::new(0.92 * bending_frequency_hz, 1.31 * bending_frequency_hz)
}

/// Band to watch for a bar whose cutting stiffness is stated as well.
///
/// The cut holds the bar: it chatters near sqrt((k + 2 K)/m)/2 pi = f_n sqrt(1 + 2 K/k), up to one lobe
/// beside it. K is stated to about a quarter: 1.25 K. Never narrower than [`predicted_band`].
/// Checked by: `a_deep_cut_raises_the_band`, `stillcut campaign --wide`.
pub fn predicted_band_in_cut(
    bending_frequency_hz: f64,
    cutting_over_bar_stiffness: f64,
) -> Result<Band, BandError> {
    let free = predicted_band(bending_frequency_hz)?;
    let in_cut_hz = bending_frequency_hz * (1.0 + 2.5 * cutting_over_bar_stiffness).sqrt();
    Band::new(free.low_hz(), free.high_hz().max(1.05 * in_cut_hz))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_of_the_thesis() {
        for (predicted, low, high, heard) in [(533.0, 500.0, 700.0, 652.0), (599.0, 550.0, 750.0, 738.0)] {
            let band = predicted_band(predicted).unwrap();
            assert!((band.low_hz() / low - 1.0).abs() < 0.03 && band.high_hz() > 0.99 * high);
            assert!(band.contains(heard));
        }
    }

    #[test]
    fn a_deep_cut_raises_the_band() {
        let light = predicted_band_in_cut(520.0, 0.05).unwrap();
        assert_eq!(light, predicted_band(520.0).unwrap());
        // 477 Hz and K/k 0.66 chatter at 721 Hz, a half above the bar's own frequency.
        assert!(predicted_band_in_cut(477.0, 0.66).unwrap().contains(721.0));
    }

    #[test]
    fn a_band_upside_down_is_refused() {
        assert!(
            Band::new(700.0, 500.0).is_err()
                && Band::new(f64::NAN, 1.0).is_err()
                && Band::new(0.0, 1.0).is_err()
        );
    }
}
