//! The monitor of one force stream: signal processing and decision together.

mod learning;
mod report;
mod speed;
mod trial;
mod watch;

use super::band::{Band, BandError};
use super::baseline::{Baseline, Standout};
use super::cut_level::{Change, CutLevel, CutLevelState};
use super::detector::{BANKS, BankEvidence, Detector, Evidence, PLACED, between_orders};
use super::drift::Drift;
use super::foreign::Foreign;
use super::hop::HopWatch;
use super::loudness::Loudness;
use super::past::Past;
use super::scatter::Scatter;
use super::watched::Watched;
use super::wild::Wild;
use super::{ChatterEvent, ChatterOutput, Phase};
use crate::signal::down_mix::{DownMix, DownMixState};
use crate::signal::line_bank::{LineBank, LineBankState};
use crate::signal::order_lines::{OrderLines, OrderLinesState, OrderSample};
use crate::units::SampleRate;
use nalgebra::Complex;
use thiserror::Error;
use watch::{DOUBT_S, START_S, SWELL_S};

/// What to watch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChatterSettings {
    /// Rate of the force.
    pub sample_rate: SampleRate,
    /// Band in which there can be chatter.
    pub band: Band,
    /// Whether the series is the force of a tool with its mean: a tool pushes and never pulls. Not so for
    /// acceleration, nor where friction is left in the mean.
    pub pushes: bool,
}

/// Why a stream cannot be watched.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum ChatterError {
    /// The band is no band.
    #[error(transparent)]
    Band(#[from] BandError),
    /// The band does not fit the rate.
    #[error("band up to {high_hz} Hz needs a rate above {needed_hz} Hz, this one is {rate_hz} Hz")]
    RateTooLow {
        /// Upper edge.
        high_hz: f64,
        /// Lowest rate that would do.
        needed_hz: f64,
        /// Rate given.
        rate_hz: f64,
    },
}

/// Windows of the banks: 4 tau is about their length.
const TAUS_S: [f64; BANKS] = [0.0125, 0.025, 0.05, 0.1];
/// Decisions from one look at a bank to the next: a long window changes slowly.
const STRIDES: [u64; BANKS] = [1, 1, 2, 4];
/// The banks reach this much beyond the band, so that a line at its edge is seen whole.
const EDGE: f64 = 1.08;
/// They are there up to this, for when the band widens.
const REACH: f64 = 1.4;
/// Time over which the variance of the band is taken.
const VARIANCE_S: f64 = 0.25;
/// Between two decisions.
const DECISION_S: f64 = 0.004;
/// What is known of the noise counts as this many looks after the cut changed. Longer windows see the lobes
/// of the new cut as lines: they are trusted less.
const DOUBT_LOOKS: [f64; BANKS] = [10.0, 10.0, 8.0, 6.0];
/// The noise of another cut is learned over this long.
const RELEARN_S: f64 = 0.6;
/// Orders may move this far within the memory of their notches: the structure answers otherwise elsewhere.
const ORDER_DRIFT_HZ: f64 = 3.0;
/// The orders build up for so many turns after the tools enter.
const YOUNG_TURNS: f64 = 8.0;
/// For so many turns after an entry, or so long, nothing is declared: the first passes find no wave that was
/// left by the cut, and vibrate more than it will.
const ENTRY_TURNS: f64 = 4.0;
const ENTRY_S: f64 = 0.25;
/// A change of speed is looked for over this time.
const SPEED_LAG_S: f64 = 1.0;
/// The bank in which lines that move are followed.
const FOLLOWED: usize = 1;
/// The mixer's filter has filled after so many of its delays.
const FILLED_DELAYS: f64 = 3.0;

/// Watches one force stream for chatter: immutable design.
#[derive(Debug, Clone, PartialEq)]
pub struct ChatterMonitor {
    settings: ChatterSettings,
    mix: DownMix,
    orders: OrderLines,
    level: CutLevel,
    banks: Vec<LineBank>,
    /// Half of the width that the banks cover, Hz.
    reach_hz: f64,
    turns_per_rpm: f64,
    decide_every: usize,
}

/// State of [`ChatterMonitor`].
#[derive(Debug, Clone, PartialEq)]
pub struct ChatterState {
    samples: u64,
    wild: Wild,
    loudness: Loudness,
    mix: DownMixState,
    mixer: Complex<f64>,
    orders: OrderLinesState,
    banks: Vec<LineBankState>,
    /// The band since the last decision: the banks take it then.
    fresh: Vec<Complex<f64>>,
    fresh_count: usize,
    baselines: Vec<Baseline>,
    angle_turns: f64,
    newest_speed_hz: f64,
    speed_hz: f64,
    /// Speed of about a second ago.
    earlier_speed_hz: f64,
    until_decision: usize,
    decisions: u64,
    /// What each bank showed when it was looked at last, and the common level of the band in it.
    bank_evidence: [BankEvidence; BANKS],
    bank_common: [f64; BANKS],
    heard_s: f64,
    level: CutLevelState,
    detector: Detector,
    track_hz: Option<f64>,
    watched: Watched,
    hop: HopWatch,
    drift: Drift,
    past: Past,
    foreign: Foreign,
    scatter: Scatter,
    /// The same in the window that places lines, at half the pace.
    long_scatter: Scatter,
    /// Of the strongest line, while what is known of the noise is not to be trusted.
    strongest: Scatter,
    strongest_until_s: f64,
    /// Until when no noise of quiet cutting is known.
    start_until_s: f64,
    /// Until when the noise is learned as it is heard, whatever stands out: it was told by its scatter.
    noise_until_s: f64,
    /// Mean power of the band over the last quarter second, and as it was learned, N^2.
    variance_n2: f64,
    /// The same with the orders in it.
    whole_variance_n2: f64,
    usual_variance_n2: f64,
    /// Decisions in a row with all of the band louder than learned.
    louder: u32,
    /// Decisions in a row in which what stands out is a spindle order, and until when that is to be expected.
    order_line: u32,
    /// Decisions in a row in which the short windows see all of the band louder, and until when that is one
    /// event.
    wide: u32,
    wide_until_s: f64,
    /// Until when nothing is declared for it; 0: nothing is held off.
    held_off_s: f64,
    /// The loudest of the last alarm, N^2, and when it stood last.
    alarm_n2: f64,
    alarm_s: f64,
    /// When the cut changed last; the first sample is a change.
    changed_s: f64,
    orders_new_until_s: f64,
    /// Until when the noise is learned fast, in seconds heard.
    relearn_until_s: f64,
    latest: ChatterOutput,
}

crate::keyframe::keep!(ChatterState {
    samples, wild, loudness, mix, mixer, orders, banks, fresh, fresh_count, baselines, angle_turns,
    newest_speed_hz, speed_hz, earlier_speed_hz, until_decision, decisions, bank_evidence, bank_common,
    heard_s, level, detector, track_hz, watched, hop, drift, past, foreign, scatter, long_scatter, strongest,
    strongest_until_s,
    start_until_s, noise_until_s, variance_n2, whole_variance_n2, usual_variance_n2, louder, order_line,
    wide, wide_until_s, held_off_s, alarm_n2, alarm_s, changed_s, orders_new_until_s, relearn_until_s, latest
} if |s| s.until_decision > 0 && s.fresh_count + s.until_decision <= s.fresh.len());

impl ChatterMonitor {
    /// Errors: a band that reaches too close to half the sample rate.
    pub fn new(settings: ChatterSettings) -> Result<Self, ChatterError> {
        let band = settings.band;
        let half_hz = (band.half_width_hz() * EDGE).min(band.centre_hz() * 0.97);
        let (rate_hz, needed_hz) = (settings.sample_rate.hz(), 2.0 * (band.centre_hz() + half_hz) + 10.0);
        if rate_hz < needed_hz {
            return Err(ChatterError::RateTooLow { high_hz: band.high_hz(), needed_hz, rate_hz });
        }
        // As much more as the band may widen, where rate and zero allow it.
        let most_hz = (0.45 * rate_hz - band.centre_hz()).min(band.centre_hz() * 0.9);
        let reach_hz = (band.half_width_hz() * REACH).min(most_hz).max(half_hz);
        let mix = DownMix::new(settings.sample_rate, band.centre_hz(), reach_hz);
        let rate_hz = mix.output_rate_hz();
        let orders_hz = reach_hz + 20.0;
        let orders =
            OrderLines { low_hz: band.centre_hz() - orders_hz, high_hz: band.centre_hz() + orders_hz };
        let banks = TAUS_S.iter().map(|tau_s| LineBank::new(rate_hz, reach_hz, *tau_s)).collect();
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
        let decide_every = (DECISION_S * rate_hz).round().max(1.0) as usize;
        let level = CutLevel::new(settings.sample_rate);
        let turns_per_rpm = settings.sample_rate.period_s() / 60.0;
        Ok(Self { settings, mix, orders, level, banks, reach_hz, turns_per_rpm, decide_every })
    }

    /// What it watches.
    #[must_use]
    pub fn settings(&self) -> &ChatterSettings {
        &self.settings
    }

    /// Samples between two decisions.
    #[must_use]
    pub fn decision_samples(&self) -> usize {
        self.decide_every * self.mix.decimation()
    }

    /// Nothing heard yet.
    #[must_use]
    pub fn start(&self) -> ChatterState {
        ChatterState {
            samples: 0,
            wild: Wild::default(),
            loudness: Loudness::NEW,
            mix: self.mix.start(),
            mixer: Complex::new(1.0, 0.0),
            orders: self.orders.start(),
            banks: self.banks.iter().map(LineBank::start).collect(),
            fresh: vec![Complex::new(0.0, 0.0); self.decide_every],
            fresh_count: 0,
            baselines: self.banks.iter().map(|b| Baseline::new(b.frequencies_hz().len())).collect(),
            angle_turns: 0.0,
            newest_speed_hz: 0.0,
            speed_hz: 0.0,
            earlier_speed_hz: 0.0,
            until_decision: self.decide_every,
            decisions: 0,
            bank_evidence: [BankEvidence::default(); BANKS],
            bank_common: [1.0; BANKS],
            heard_s: 0.0,
            level: self.level.start(),
            detector: Detector::new(),
            track_hz: None,
            watched: Watched::new(self.settings.band, self.mix.centre_hz(), EDGE),
            hop: HopWatch::default(),
            drift: Drift::default(),
            past: Past::new(self.mix.output_rate_hz()),
            foreign: Foreign::default(),
            scatter: Scatter::NEW,
            long_scatter: Scatter::NEW,
            strongest: Scatter::NEW,
            strongest_until_s: 0.0,
            start_until_s: START_S,
            noise_until_s: 0.0,
            variance_n2: 0.0,
            whole_variance_n2: 0.0,
            usual_variance_n2: 0.0,
            louder: 0,
            order_line: 0,
            wide: 0,
            wide_until_s: 0.0,
            held_off_s: 0.0,
            alarm_n2: 0.0,
            alarm_s: 0.0,
            changed_s: 0.0,
            orders_new_until_s: 0.0,
            relearn_until_s: 0.0,
            latest: ChatterOutput {
                phase: Phase::Learning,
                frequency_hz: None,
                power_n2: 0.0,
                contrast: 0.0,
                growth_1_s: None,
                variance_ratio: 1.0,
                event: None,
            },
        }
    }

    /// Lets the watched band follow the bar: diameter or tool position changed. Lines count in the new band
    /// at once, as far as it lies within what this monitor was designed for; false where none of it does.
    pub fn follow(&self, state: &mut ChatterState, band: Band) -> bool {
        let mut watched = Watched::new(band, self.mix.centre_hz(), 1.0);
        watched.low_hz = watched.low_hz.max(-self.reach_hz);
        watched.high_hz = watched.high_hz.min(self.reach_hz);
        let within = watched.low_hz < watched.high_hz;
        if within {
            state.watched = state.watched.moved_to(watched);
        }
        within
    }

    /// Band in which a line counts now, Hz.
    #[must_use]
    pub fn watched_hz(&self, state: &ChatterState) -> [f64; 2] {
        [state.watched.low_hz, state.watched.high_hz].map(|f| f + self.mix.centre_hz())
    }

    /// Takes one sample; answers what began or ended with it. Without a speed nothing is known of spindle
    /// orders, and they may look like chatter. The orders are the same whichever way the spindle turns.
    ///
    /// Requires: finite force (a gap is a restart with [`ChatterMonitor::start`]). Cost: no allocation.
    /// Checked by: `suite/chatter.rs`.
    #[inline]
    pub fn step(
        &self,
        state: &mut ChatterState,
        force_n: f64,
        spindle_speed_rpm: Option<f64>,
    ) -> Option<ChatterEvent> {
        debug_assert!(force_n.is_finite());
        state.latest.event = None;
        state.samples += 1;
        let force_n = state.wild.bound(force_n, self.settings.sample_rate.period_s());
        if let Some(rpm) = spindle_speed_rpm.map(f64::abs) {
            state.angle_turns += rpm * self.turns_per_rpm;
            state.newest_speed_hz = rpm * (1.0 / 60.0);
        }
        let change = self.level.step(&mut state.level, force_n, state.speed_hz);
        if change != Change::None {
            self.follow_level(state, change);
        }
        if self.mix.push(&mut state.mix, force_n) {
            self.hear(state);
        }
        state.latest.event
    }

    /// What was said last.
    #[must_use]
    pub fn output<'a>(&self, state: &'a ChatterState) -> &'a ChatterOutput {
        &state.latest
    }

    /// The notches on the spindle's orders start anew, at the angle of what leaves the band's filter now.
    fn restart_orders(&self, state: &mut ChatterState) {
        let angle_turns = state.angle_turns - state.speed_hz * self.mix.delay_s();
        self.orders.restart(&mut state.orders, angle_turns);
    }

    #[cold]
    fn follow_level(&self, state: &mut ChatterState, change: Change) {
        if state.detector.phase() == Phase::Chatter {
            return;
        }
        // Until the force has settled, every step starts the notches anew.
        doubt(&mut state.baselines);
        state.relearn_until_s = self.now_s(state) + RELEARN_S;
        self.restart_orders(state);
        if change == Change::Begins {
            state.detector.forget_suspicion();
            state.latest.event = Some(ChatterEvent::CutChanged);
            state.changed_s = self.now_s(state);
            state.strongest.forget();
            if state.detector.phase() == Phase::Learning {
                state.start_until_s = self.now_s(state) + START_S;
            }
        }
    }

    #[inline(never)]
    fn hear(&self, state: &mut ChatterState) {
        let value = self.mix.output(&mut state.mix);
        self.follow_speed(state);
        let rate_hz = self.mix.output_rate_hz();
        state.mixer *= Complex::from_polar(1.0, -std::f64::consts::TAU * self.mix.centre_hz() / rate_hz);
        state.mixer *= 1.5 - 0.5 * state.mixer.norm_sqr();
        let share = 1.0 / (VARIANCE_S * rate_hz);
        state.whole_variance_n2 += (value.norm_sqr() - state.whole_variance_n2) * share;
        let phase = state.detector.phase();
        let adapt = phase != Phase::Chatter;
        // The band is as old as the mixer's filter is long; so must be the angle that its orders stand at.
        let angle_turns = state.angle_turns - state.speed_hz * self.mix.delay_s();
        let whole = value;
        let value = if state.speed_hz > 0.0 {
            let (mixer, speed_hz) = (state.mixer, state.speed_hz);
            let drift_hz = self.mix.centre_hz() * self.relative_speed_change_1_s(state);
            let memory_turns = (ORDER_DRIFT_HZ / drift_hz.max(1e-9) * speed_hz).clamp(4.0, 20.0);
            let known = self.orders.turns_known(&state.orders);
            let sample = OrderSample { value, angle_turns, mixer, speed_hz, memory_turns, adapt };
            let left = self.orders.step(&mut state.orders, &sample);
            if known < 1.0 && self.orders.turns_known(&state.orders) >= 1.0 {
                // What the banks hold is from before the notches: orders, unless a line stands between them.
                self.forget_orders(state);
            }
            left
        } else {
            value
        };
        // Not while the filter before it fills: a force that is there from the first sample rings in it.
        if state.samples as f64 * self.settings.sample_rate.period_s() > FILLED_DELAYS * self.mix.delay_s() {
            state.past.push(whole, value, angle_turns);
        }
        state.fresh[state.fresh_count] = value;
        state.fresh_count += 1;
        state.variance_n2 += (value.norm_sqr() - state.variance_n2) * share;
        state.loudness.hear(value.norm_sqr(), 1.0 / rate_hz);
        state.until_decision -= 1;
        if state.until_decision == 0 {
            state.until_decision = self.decide_every;
            let fresh = &state.fresh[..std::mem::take(&mut state.fresh_count)];
            for (bank, bank_state) in self.banks.iter().zip(&mut state.banks) {
                bank.step(bank_state, fresh);
            }
            self.decide(state);
        }
    }

    fn forget_orders(&self, state: &mut ChatterState) {
        let line = state.bank_evidence[PLACED];
        if line.contrast > line.suspect && between_orders(&line, state.speed_hz) {
            return;
        }
        for (bank, bank_state) in self.banks.iter().zip(&mut state.banks) {
            bank.clear(bank_state);
        }
        state.fresh_count = 0;
        state.bank_evidence = [BankEvidence::default(); BANKS];
        state.scatter.start_anew();
        state.long_scatter.start_anew();
        if self.now_s(state) < state.start_until_s {
            state.strongest.start_anew();
        }
    }

    fn decide(&self, state: &mut ChatterState) {
        let period_s = self.decide_every as f64 / self.mix.output_rate_hz();
        let orders_known = state.speed_hz <= 0.0 || self.orders.turns_known(&state.orders) >= 1.0;
        let t_s = self.now_s(state);
        let first_turns_s = if state.speed_hz > 0.0 { ENTRY_TURNS / state.speed_hz } else { 0.0 };
        let mut evidence = Evidence {
            t_s,
            banks: state.bank_evidence,
            orders_known,
            wide: t_s < state.wide_until_s,
            held_off: t_s < state.held_off_s.max(state.changed_s + first_turns_s.min(ENTRY_S)),
            orders_young: state.speed_hz > 0.0 && self.orders.turns_known(&state.orders) < YOUNG_TURNS,
            speed_hz: state.speed_hz,
            speed_change_hz_s: (state.speed_hz - state.earlier_speed_hz) / SPEED_LAG_S,
            delay_s: self.mix.delay_s(),
            loud: state.loudness.is_loud(),
            stands: self.standing(state),
            doubtful: t_s < state.relearn_until_s.max(state.noise_until_s) + DOUBT_S,
        };
        state.decisions += 1;
        let mean_n = if state.speed_hz > 0.0 && orders_known { state.level.size_n() } else { f64::NAN };
        self.look_at_banks(state, &mut evidence);
        let within_n2 = self.watched_power(state);
        state.loudness.look((within_n2, period_s), mean_n, state.detector.phase() == Phase::Chatter);
        let common = state.bank_common.iter().copied().fold(f64::INFINITY, f64::min);
        let clearest = evidence.banks.iter().map(|b| b.contrast).fold(0.0, f64::max);
        self.watch_level(state, common, clearest);
        self.watch_orders(state, &evidence);
        self.watch_width(state, t_s);
        let strongest = self.watch_strongest(state, &evidence);
        let loud = state.loudness.lasts().then_some(evidence.banks[PLACED]);
        evidence.stands =
            evidence.stands.or(strongest).or(loud).and_then(|line| self.not_foreign(state, line));
        if state.foreign.any() {
            let (bank, heard) = (&state.banks[FOLLOWED], &state.baselines[FOLLOWED]);
            state.foreign.follow(&self.banks[FOLLOWED], bank, heard);
        }
        self.conclude(state, &evidence, strongest.is_some());
        // What is suspected is not noise: chatter that grows with the entry must not be learned.
        let learns = match state.detector.phase() {
            Phase::Learning => true,
            Phase::Quiet => !state.detector.watches(t_s) && !state.loudness.is_loud(),
            Phase::Suspected | Phase::Chatter => false,
        };
        if orders_known && learns {
            self.learn_variance(state, period_s);
        }
        // A window that knows nothing yet cannot tell what to suspect: it learns all the same.
        let first = state.detector.phase() != Phase::Chatter;
        let learns = learns || first && t_s < state.noise_until_s;
        if orders_known && first {
            self.learn(state, period_s, learns);
        }
        self.report(state, &evidence);
    }

    /// Power of the watched band without the orders, N^2.
    fn watched_power(&self, state: &ChatterState) -> f64 {
        let bank = &self.banks[FOLLOWED];
        let among = state.watched.filters(bank.frequencies_hz().len(), self.reach_hz);
        state.baselines[FOLLOWED].sum(among) / bank.overlap()
    }

    /// What each bank shows, as often as its window changes.
    fn look_at_banks(&self, state: &mut ChatterState, evidence: &mut Evidence) {
        for (i, bank) in self.banks.iter().enumerate() {
            if !state.decisions.is_multiple_of(STRIDES[i]) {
                continue;
            }
            let (bank_state, baseline) = (&state.banks[i], &mut state.baselines[i]);
            let among = state.watched.filters(bank.frequencies_hz().len(), self.reach_hz);
            let line = baseline.look(bank, bank_state, among.clone());
            let growth_1_s = bank.growth_1_s(bank_state, line);
            let leak = bank.leak(line, growth_1_s, baseline.power(line));
            let standout = baseline.standout(among, leak, state.foreign.filters(bank));
            // A window that knows no noise yet says nothing, neither of a line nor of the level.
            let known = state.baselines[i].is_known();
            let power_n2 = state.baselines[i].power(line);
            let loudest = Standout { filter: line, contrast: 0.0, power_n2, ..standout };
            let standout = if known { standout } else { loudest };
            state.bank_common[i] = if known { standout.common } else { f64::INFINITY };
            evidence.banks[i] = self.bank_evidence(state, i, (standout, (line, growth_1_s)));
        }
        state.bank_evidence = evidence.banks;
    }

    /// What began or ended, and what that says of the noise. `learned`: the line that stands was learned
    /// as noise.
    fn conclude(&self, state: &mut ChatterState, evidence: &Evidence, learned: bool) {
        let t_s = evidence.t_s;
        let age_s = state.detector.chatter_age_s(t_s);
        let ended = self.watch_scatter(state, evidence);
        let event = ended.or_else(|| self.try_line(state, evidence));
        state.latest.event = event.or(state.latest.event);
        if matches!(event, Some(ChatterEvent::Onset(_))) {
            state.alarm_n2 = 0.0;
        }
        if learned && matches!(event, Some(ChatterEvent::Onset(_))) {
            // It was learned as noise.
            state.baselines.iter_mut().for_each(Baseline::level);
        }
        if matches!(event, Some(ChatterEvent::End)) {
            if age_s.is_some_and(|age_s| age_s < SWELL_S) && !state.scatter.like_a_line() {
                self.doubt_noise(state, t_s);
            }
            state.scatter.forget_line();
            state.long_scatter.forget_line();
            // Another state of the cut; or, after an alarm that was weak, noise that is not yet known well.
            doubt(&mut state.baselines);
            state.relearn_until_s = t_s + RELEARN_S;
            // With another pitch the spindle makes other lines.
            self.restart_orders(state);
        }
    }

    fn now_s(&self, state: &ChatterState) -> f64 {
        state.samples as f64 * self.settings.sample_rate.period_s()
    }

    /// What stands out in a bank, whose strongest filter grows as stated.
    fn bank_evidence(
        &self,
        state: &ChatterState,
        index: usize,
        (standout, (line, growth_1_s)): (Standout, (usize, f64)),
    ) -> BankEvidence {
        let (bank, bank_state) = (&self.banks[index], &state.banks[index]);
        let [suspect, confirm] = state.baselines[index].thresholds();
        BankEvidence {
            tau_s: bank.tau_s(),
            contrast: standout.contrast,
            suspect,
            confirm,
            power_n2: standout.power_n2,
            noise_n2: state.baselines[index].expected(standout.filter),
            frequency_hz: self.mix.centre_hz() + bank.refined_hz(bank_state, standout.filter),
            growth_1_s: if standout.filter == line {
                growth_1_s
            } else {
                bank.growth_1_s(bank_state, standout.filter)
            },
        }
    }
}

fn doubt(baselines: &mut [Baseline]) {
    for (baseline, looks) in baselines.iter_mut().zip(DOUBT_LOOKS) {
        baseline.doubt(looks);
    }
}
