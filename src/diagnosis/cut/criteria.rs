//! Every number that a diagnosis of the cut rests on and that is not physics, with where it comes from.

/// Thresholds and weights of the diagnosis of a cut.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Criteria {
    /// Least frequency of the residuals, Hz: above what spindle and servo do.
    pub(crate) from_hz: f64,
    /// Greatest frequency over the bandwidth of the force signal: the noise goes through the same filter, and
    /// at 1.3 a low-pass of fourth order leaves a third of the amplitude.
    pub(crate) to_bandwidths: f64,
    /// Below the band nothing is fitted, but what is left there tells of a slow force; from here, Hz.
    pub(crate) slow_hz: f64,
    /// Shortest calm stretch, s: bins then stand 2.5 Hz apart, the width of a calm line.
    pub(crate) shortest_calm_s: f64,
    /// Shortest stretch that is followed in time, s: some hundred periods.
    pub(crate) shortest_followed_s: f64,
    /// Pieces of loudness over the floor that are no random ringing: amplitudes of a narrow line are
    /// Rayleigh, 3.5 rms is passed once in 200 000.
    pub(crate) loud_floors: f64,
    /// Loudness that swells by more than this over a stretch is no stationary noise.
    pub(crate) swelling: f64,
    /// Swing of a force over its mean beyond which contact may be lost (1) in between samples, and slope of
    /// the surface over the clearance beyond which the flank may rub (1).
    pub(crate) largest_swing: f64,
    /// Loudness over the loudest of a block up to which growing chatter is linear (the reference's).
    pub(crate) largest_of_loudest: f64,
    /// Accuracy of a followed force over its own amplitude: position and frequency move within a stretch.
    pub(crate) followed_share: f64,
    /// Bins next to an order of the spindle that are lost with its line: the estimate of the line has them.
    pub(crate) order_bins: f64,
    /// Standard deviations beyond which a residual counts as its root: one bad stretch must not decide.
    pub(crate) outlying_sd: f64,
    /// Accuracy of a mean force: N, and of itself (the reference of the contract's simulation).
    pub(crate) mean_sd_n: f64,
    /// See `mean_sd_n`.
    pub(crate) mean_share: f64,
    /// Accuracy of a line of the spindle: N, and of itself.
    pub(crate) order_sd_n: f64,
    /// See `order_sd_n`.
    pub(crate) order_share: f64,
    /// Orders of the spindle that are looked at.
    pub(crate) orders: usize,
    /// Price of a parameter, nats: three standard deviations (9/2), also half the log of 8 000 values.
    pub(crate) price_nats: f64,
    /// The same of a table alone, nats: 20 to 1. Its spreads are free, so that errors of the likelihood are
    /// in it already; with the price a gain of 7.5, which chance gives one of 20 laws twice in a thousand.
    pub(crate) table_level_nats: f64,
    /// What a step of a fit gains, nats, below which it has ended.
    pub(crate) decides_nothing_nats: f64,
    /// A gain after a first look is right to this factor where it may become a name.
    pub(crate) promise_factor: f64,
    /// Share by which a taper may smear a bin that counts as smooth.
    pub(crate) smooth_share: f64,
    /// Standard deviations of a wrong number that is told.
    pub(crate) correction_sd: f64,
    /// Whitened power of a band of bins, in standard deviations of its scatter, that is something left.
    pub(crate) left_sd: f64,
    /// Share by which a spectrum of a model that holds may be off: position and frequency move in a stretch.
    pub(crate) left_share: f64,
    /// The same below the band of the fit, where the sensor drifts.
    pub(crate) left_slow_share: f64,
    /// Width of such a band, Hz.
    pub(crate) left_band_hz: f64,
    /// Probability from which on a rival is alive: 1 in 20.
    pub(crate) alive: f64,
    /// Sizes of an effect, in typical ones, beyond which no machine has it.
    pub(crate) largest_size: f64,
    /// Standard deviations of a size from which on it is seen, and named.
    pub(crate) visible_sd: f64,
    /// Cost of an evaluation, seconds of two cores of 3 GHz a second of recording.
    pub(crate) evaluation_s_per_s: f64,
    /// Cost of an evaluation, seconds of one core of 3 GHz a row of a table.
    pub(crate) evaluation_s_per_row: f64,
}

/// The ones in use.
pub(crate) const CRITERIA: Criteria = Criteria {
    from_hz: 70.0,
    to_bandwidths: 1.3,
    slow_hz: 4.0,
    shortest_calm_s: 0.4,
    shortest_followed_s: 0.15,
    loud_floors: 3.5,
    swelling: 1.5,
    largest_swing: 0.75,
    largest_of_loudest: 0.4,
    followed_share: 0.02,
    order_bins: 1.2,
    outlying_sd: 4.0,
    mean_sd_n: 0.03,
    mean_share: 0.002,
    order_sd_n: 0.05,
    order_share: 0.03,
    orders: 12,
    price_nats: 4.5,
    table_level_nats: 3.0,
    decides_nothing_nats: 0.05,
    promise_factor: 3.0,
    smooth_share: 0.01,
    correction_sd: 3.0,
    left_sd: 9.0,
    left_share: 0.05,
    left_slow_share: 0.2,
    left_band_hz: 12.0,
    alive: 0.05,
    largest_size: 3.0,
    visible_sd: 5.0,
    evaluation_s_per_s: 3e-4,
    evaluation_s_per_row: 1e-4,
};
