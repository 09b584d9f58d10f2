//! Lines in a spectrum that are not the cut's: tones, orders of the spindle, mains.

use super::criteria::Criteria;

/// What a bin says of the spectrum S of the model where interference may stand in it.
///
/// Its power I is exponential about S, or about k S, all k above 1 alike on a scale of factors of length L:
/// p = e^-x/S + odds (1 - e^-x)/(x S), x = I/S, odds = share/(1 - share)/L.
/// Checked by: `a_bin_scores_by_its_likelihood`.
pub(super) struct Bin {
    /// d ln p/d ln S: what a larger S gains.
    pub(super) score: f64,
    /// Probability that nothing else stands in it.
    pub(super) own: f64,
    over: f64,
    /// The second term's part of p S.
    other: f64,
}

impl Bin {
    /// `over`: I/S; `expected`: where interference is expected.
    pub(super) fn new(over: f64, expected: bool) -> Self {
        Self::with(over, Criteria::DEFAULT.interference_odds[usize::from(expected)])
    }

    fn with(over: f64, odds: f64) -> Self {
        let x = over.clamp(1e-9, 1e200);
        let kept = -(-x).exp_m1();
        let other = odds * kept / x;
        let own = 1.0 / (1.0 + other * x.exp());
        let score = own * (x - 1.0) - (1.0 - own) * x * (1.0 - kept) / kept;
        Self { score, own, over: x, other }
    }

    /// ln p + ln S.
    pub(super) fn nats(&self) -> f64 {
        let other = self.other.ln();
        other.max(-self.over) + (-(other + self.over).abs()).exp().ln_1p()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bin_scores_by_its_likelihood() {
        for odds in [1e-3, 0.07] {
            for over in [0.0, 1e-6, 0.3, 1.0, 4.0, 9.0, 30.0, 1e4, 1e17, 1e150] {
                // S grows by 1 + h.
                let h = 1e-5;
                let nats = |by: f64| Bin::with(over / by, odds).nats() - by.ln();
                let slope = (nats(1.0 + h) - nats(1.0 - h)) / (2.0 * h);
                let Bin { score, own, .. } = Bin::with(over, odds);
                assert!((slope - score).abs() < 1e-4 * (1.0 + slope.abs()), "{over}: {slope} {score}");
                assert!((0.0..=1.0).contains(&own), "{over}: {own}");
            }
        }
        // Without interference it is Whittle's; what is 40 dB over moves nothing.
        assert!((Bin::with(1.7, 1e-12).score - 0.7).abs() < 1e-9);
        assert!(Bin::with(1e4, 1e-3).own < 1e-9 && Bin::with(1e4, 1e-3).score < 1e-3);
        // However far over the model, its likelihood falls as 1/I.
        assert!((Bin::with(1e30, 1e-3).nats() - (1e-33f64).ln()).abs() < 1e-9);
    }
}
