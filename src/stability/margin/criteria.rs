//! Every number of the margin that is no number of a machine, with where it comes from.

use super::model::PARAMETERS;

/// A margin above this is none that runs out, 1/s: the contract's.
pub const RECOVERED_1_S: f64 = 12.0;
/// Length of a block, s. A mode of 6 1/s is 1.9 Hz wide: bins of 0.5 Hz resolve it, and the spectrum is
/// smeared by the window as the periodogram is, so that narrower ones are not mistaken.
pub const BLOCK_S: f64 = 2.0;

/// Lengths, uncertainties, drifts and levels of the margin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Criteria {
    /// After contact, before the first block, s: the wave of one turn at 600 rpm, and the first passes.
    pub(super) entry_s: f64,
    /// Blocks that are fitted together after an entry; from then on the posterior is carried forward. Ten
    /// blocks of one second: the spread of the margin is below its drift from there on.
    pub(super) joint_blocks: usize,
    /// Blocks up to which several starts are tried: the spectrum of two seconds may have two maxima.
    pub(super) searched_blocks: usize,
    /// Share of a bin in the likelihood: neighbours of a Hann window correlate by 4/9 and 1/36 in power,
    /// blocks that overlap by a half by 1/36: 1/(1 + 2 (4/9 + 1/36))/(1 + 2/36).
    pub(super) bin_share: f64,
    /// Largest change of phase of the delayed wave inside of a block, rad: cos 0.3 = 0.96.
    pub(super) phase_in_block_rad: f64,
    /// Largest change of the cut's stiffness or of the bar's gain inside of a block, as a ratio less one: two
    /// moments stand for a straight line; what bends of it, 0.3^2/8, moves its frequency by less than a bin.
    pub(super) change_in_block: f64,
    /// Force that swings by this share of its mean is no longer linear: contact is lost at 1 (the diagnosis
    /// of cuts uses the same share).
    pub(super) linear_swing: f64,
    /// Fall of the amplitude from a slice of a block to a later one that is the end of a hit, or of an axis
    /// that slips under its new load: random vibration, however slowly it dies out, falls so far in one of
    /// 10 000 blocks.
    pub(super) fall: f64,
    /// Odds of interference in a bin, over the length of the scale of factors by which it is above the cut
    /// (six decades, 13.8): one bin in a hundred, and where it is expected one in two.
    pub(super) interference_odds: [f64; 2],
    /// Of one number over one second of cutting, by random walk; in the order of the parameters.
    pub(super) drift: [f64; PARAMETERS],
    /// What is known of one number before anything is heard, in the same order.
    pub(super) known: [f64; PARAMETERS],
    /// What replaces it where a column is missing: position, of ln phi squared.
    pub(super) unknown_position: f64,
    /// Of the stiffness.
    pub(super) unknown_width: f64,
    /// Of the level of the random force where no mean force tells it.
    pub(super) unknown_level: f64,
    /// Deviations of the told margin over those by the likelihood: the linear equation leaves out what else
    /// is in a cut. Of 30 000 readings of strangers' cuts 76 % were in the interval without, 85 % are with
    /// it; with 1.5 there would be 89 %, and of the warnings that come in time a third would be lost.
    pub(super) wider: f64,
    /// The line must be this many times the measurement noise (5 dB): below, more than a quarter of what
    /// is heard at the line is not the cut.
    pub(super) line_over_noise: f64,
    /// An interval wider than this many times the margin (or `coarse_1_s`) says nothing.
    pub(super) widest_interval: f64,
    /// Below this a margin need not be told to a share of it, 1/s.
    pub(super) coarse_1_s: f64,
    /// The margin runs out when all of its interval lies below this, 1/s: 12 1/s, above which nobody is to be
    /// warned, less one for the many times that it is asked.
    pub(super) warning_1_s: f64,
}

impl Criteria {
    /// As they stand.
    ///
    /// `known`: stated numbers are right to 15 to 20 % (stiffness), 30 % (damping), 2 % (frequency), a factor
    /// of 2 (process damping); random force of 2 to 5 % of the mean; noise in the cut is only loosely that in
    /// air, because the random force above half the rate folds onto it. `drift`: wear doubles the process
    /// damping in minutes; a bar warms by 30 K in ten minutes (0.6 % of its frequency); the mean force tells
    /// the stiffness but for 1 % a second.
    pub(super) const DEFAULT: Self = Self {
        entry_s: 0.1,
        joint_blocks: 10,
        searched_blocks: 3,
        bin_share: 0.4875,
        phase_in_block_rad: 0.3,
        change_in_block: 0.3,
        linear_swing: 0.75,
        fall: 10.0,
        interference_odds: [0.01 / 0.99 / 13.8, 1.0 / 13.8],
        drift: [0.01, 0.002, 0.0003, 0.03, 0.0, 0.0, 0.01, 0.05, 0.01],
        known: [0.14, 0.22, 0.0095, 0.42, 1e-4, 1e-4, 0.28, 1.5, 0.1],
        unknown_position: 0.3,
        unknown_width: 0.5,
        unknown_level: 1.5,
        wider: 1.3,
        line_over_noise: 3.0,
        widest_interval: 2.0,
        coarse_1_s: 8.0,
        warning_1_s: 11.0,
    };
}
