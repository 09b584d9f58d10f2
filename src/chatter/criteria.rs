//! Every number that decides whether there is chatter, with where it comes from.

/// Thresholds of the detector, in nats, shares, seconds and hertz.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Criteria {
    /// Rate of the complex band, Hz: 2 ms a value hold a band of 350 Hz.
    pub(super) rate_hz: f64,
    /// Half of what one band holds, Hz: where its filter is down by a decibel.
    pub(super) half_hz: f64,
    /// How far around a frequency is "the line", and beyond the edges of the band, Hz.
    pub(super) line_hz: f64,
    /// How often white noise passes h nats over all windows: so many times exp(-h), 1/s.
    pub(super) noise_1_s: f64,
    /// How often a cause comes that is rare, such as a hit, at most, 1/s.
    pub(super) cause_1_s: f64,
    /// How often noise through a mode is a line that the whitening has not resolved, 1/s. Not derived: with a
    /// twentieth there was a false alarm in an hour, with fifty times as much the weakest chatter is lost.
    pub(super) mode_1_s: f64,
    /// The same where nothing tells when another cut begins, on three axes in three bands, 1/s.
    pub(super) entry_unknown_1_s: f64,
    /// Share of the thresholds under which nothing is heard; above it nothing is learned.
    pub(super) hold: f64,
    /// Memory of the noise, s.
    pub(super) noise_s: f64,
    /// A line that stands is no news when it was known for so long, and what was an alarm is known for so
    /// long, s.
    pub(super) before_s: f64,
    /// What is newer is not used to whiten: growth must not teach the model that explains it away, s.
    pub(super) guard_s: f64,
    /// Memory of the orders, s.
    pub(super) orders_s: f64,
    /// Most that the power of a value counts over what is known.
    pub(super) most: f64,
    /// Share of the threshold above which a window usually hears a line.
    pub(super) usual: f64,
    /// Silence before the end, and memory of what is usual in an alarm, s.
    pub(super) end_s: f64,
    pub(super) usual_s: f64,
    /// Ratio from which two powers are not the same: of all the band, known and heard, or of a line, before
    /// and now.
    pub(super) louder: f64,
    /// Mean over the rms of all vibration from which a tool is in the cut though none was seen to enter.
    pub(super) over_whole: f64,
    /// Share of all vibration that a line has that rules it.
    pub(super) rules: f64,
    /// Power beside a line, one turn of the spindle away, over its own from which the cut modulates it. Real
    /// cuts have 0.1 to 0.6, lines of motors, which stand in air as well, below 0.02.
    pub(super) modulated: f64,
    /// Amplitude of a line over the mean force of a tool that only pushes: pi/2 where it leaves the cut for
    /// half of the time, in the limit of pulses 2, never more.
    pub(super) most_share: f64,
    /// Most that the noise of a stable cut is, rms over the mean force: some hundredths, a few times as much
    /// through the mode.
    pub(super) stable_share: f64,
    /// Share of the lines that are switched on which may pass as grown, and of the grown ones that may pass
    /// as switched on: before that the line is heard longer.
    pub(super) switched: f64,
    /// Widest cut over the narrowest that chatters.
    pub(super) widest: f64,
    /// Evidence that a line may have against it whose beginning nobody saw well: chatter begins three times
    /// as often as a tone, where it is not small for chatter that stands.
    pub(super) unseen_nats: f64,
    /// Against the fastest of the rates of growth, which is nearly that of a tone: of ten beginnings of
    /// chatter one is as fast.
    pub(super) fastest_nats: f64,
    /// Shape of the gamma distribution of its power: known within 50 %. Of 2, 3, 4 and 6 the one with which
    /// loud noise of a servo is silent and violent first entries are heard.
    pub(super) stable_shape: f64,
    /// The mixer's filter has filled after so many of its delays.
    pub(super) filled_delays: f64,
    /// Turns in which orders are told apart from each other.
    pub(super) resolved_turns: f64,
    /// Share of a line that an order explains: it is one.
    pub(super) mostly: f64,
    /// Distance of the rates at which a line may move, Hz/s: what half a second resolves. One that moves by
    /// less than two of them may be chatter.
    pub(super) sweep_hz_s: f64,
    /// Distance from the running level over its running mean square root from which a sample is wild: a line
    /// reaches 1.4, noise 6 once in a day, the impacts of interrupted cutting 8.
    pub(super) outlier_deviations: f64,
    /// Memory of level and distance, s: for so long nothing is known.
    pub(super) outlier_memory_s: f64,
    /// White noise that is added to what is known, of its power: 30 dB.
    pub(super) white_share: f64,
}

/// The numbers.
pub(super) const CRITERIA: Criteria = Criteria {
    rate_hz: 500.0,
    half_hz: 175.0,
    line_hz: 20.0,
    noise_1_s: 7000.0,
    cause_1_s: 0.2,
    mode_1_s: 0.00225,
    entry_unknown_1_s: 130.0,
    hold: 0.5,
    noise_s: 1.5,
    before_s: 5.0,
    guard_s: 0.25,
    orders_s: 1.0,
    most: 3.0,
    usual: 0.8,
    end_s: 0.1,
    usual_s: 0.5,
    louder: 4.0,
    over_whole: 2.0,
    rules: 0.3,
    modulated: 0.1,
    most_share: 2.0,
    stable_share: 0.15,
    switched: 0.05,
    widest: 10.0,
    unseen_nats: 1.0,
    fastest_nats: 2.0,
    stable_shape: 4.0,
    filled_delays: 3.0,
    resolved_turns: 3.0,
    mostly: 0.8,
    sweep_hz_s: 15.0,
    outlier_deviations: 12.0,
    outlier_memory_s: 0.05,
    white_share: 1e-3,
};

/// Two lines nearer than this are the same line, Hz: a short window places one to a few.
pub(crate) const SAME_LINE_HZ: f64 = 8.0;
/// It may drift with speed and tools: of each look in its place.
pub(super) const FOLLOWS: f64 = 0.03;

/// Mean time between false alarms, s: 1000 h of cutting.
pub const FALSE_ALARM_S: f64 = 3.6e6;

/// Evidence h at which to alarm, nats: what comes exp(-h) times its rate comes once in the mean time between
/// false alarms.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Levels {
    /// Against noise of any level.
    pub(super) noise_nats: f64,
    /// Against a cause that is rare.
    pub(super) cause_nats: f64,
    /// Against a mode that the whitening has not resolved.
    pub(super) mode_nats: f64,
    /// The same where nothing tells when another cut begins.
    pub(super) entry_unknown_nats: f64,
    /// That a line grew and was not switched on, or the other way about.
    pub(super) switched_nats: f64,
}

impl Levels {
    pub(super) fn of(false_alarm_s: f64) -> Self {
        let nats = |rate_1_s: f64| (rate_1_s * false_alarm_s).ln();
        Self {
            noise_nats: nats(CRITERIA.noise_1_s),
            cause_nats: nats(CRITERIA.cause_1_s),
            mode_nats: nats(CRITERIA.mode_1_s),
            entry_unknown_nats: nats(CRITERIA.entry_unknown_1_s),
            switched_nats: -CRITERIA.switched.ln(),
        }
    }
}

/// Rates of growth that are looked for, beside a line that stands, 1/s.
pub(super) const GROWTHS_1_S: [f64; 2] = [15.0, 40.0];
/// Rates at which a line may have grown until it stands, or rings down, 1/s. A line that fades more slowly
/// than the first is not stable.
pub(super) const RATES_1_S: [f64; 4] = [10.0, 20.0, 40.0, 80.0];
/// Values of the windows: 48 to 384 ms.
pub(super) const WINDOWS: [usize; 4] = [24, 48, 96, 192];
/// Of the longest.
pub(super) const LONGEST: usize = WINDOWS[WINDOWS.len() - 1];
/// Values before a window in which the beginning of its line may be: 192 ms.
pub(super) const PAST: usize = LONGEST / 2;
/// Windows are looked at so many times in their length.
pub(super) const LOOKS: usize = 12;
/// Values in which a line that is switched on reaches its size: at once to 12 ms.
pub(super) const RISES: [usize; 3] = [1, 3, 6];
/// Order of the whitening model: 16 and 24 have too little to learn from at entries.
pub(super) const MEMORY: usize = 10;
/// Values of noise before anything is evidence: ten for each coefficient.
pub(super) const FIRST: usize = 10 * MEMORY;
