//! The monitor of one force stream.

use super::band::{Band, BandError};
use super::criteria::{CRITERIA, Levels, SAME_LINE_HZ, WINDOWS};
use super::cut_level::{Change, CutLevel, CutLevelState, MeanForce};
use super::decision::{Decision, Turn};
use super::lines::Strongest;
use super::outliers::OutlierFilter;
use super::sub_band::{SubBand, SubBandState};
use super::track::Hop;
use super::window::{Conditions, Detection};
use super::{ChatterEvent, ChatterOutput, Line, Phase, Reason};
use crate::keyframe::keep;
use crate::units::SampleRate;
use thiserror::Error;

/// What to watch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChatterSettings {
    /// Rate of the force.
    pub sample_rate: SampleRate,
    /// Band in which there can be chatter.
    pub band: Band,
    /// What its mean tells.
    pub mean: MeanForce,
    /// Mean time between false alarms, of cutting, s.
    pub false_alarm_s: f64,
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

/// Values between two looks at the quiet band.
const REPORT_VALUES: u64 = 8;
/// The band may widen by so much.
const REACH: f64 = 1.4;
/// Slower spindles have orders too close to be told apart, Hz.
const LEAST_SPEED_HZ: f64 = 2.0;
/// Memory of the speed and of its change, s.
const SPEED_S: f64 = 0.02;
const SPEED_CHANGE_S: f64 = 0.1;

/// Watches one force stream for chatter: immutable design.
#[derive(Debug, Clone, PartialEq)]
pub struct ChatterMonitor {
    settings: ChatterSettings,
    level: CutLevel,
    sub_bands: Vec<SubBand>,
    /// Part of the band that each chain answers for, Hz.
    parts_hz: Vec<[f64; 2]>,
    turns_per_rpm: f64,
}

/// State of [`ChatterMonitor`].
#[derive(Debug, Clone, PartialEq)]
pub struct ChatterState {
    samples: u64,
    /// Of the band.
    values: u64,
    hop: Hop,
    /// Whether the line that is heard in an alarm is another one.
    another: bool,
    outliers: OutlierFilter,
    level: CutLevelState,
    sub_bands: Vec<SubBandState>,
    watched_hz: [f64; 2],
    angle_turns: f64,
    newest_speed_hz: f64,
    speed_hz: f64,
    slow_speed_hz: f64,
    decision: Decision,
    lambda: f64,
    cuts: bool,
    mean_tells: bool,
    pitch_rad: Option<f64>,
    latest: ChatterOutput,
}

keep!(ChatterState {
    samples,
    values,
    hop,
    another,
    outliers,
    level,
    sub_bands,
    watched_hz,
    angle_turns,
    newest_speed_hz,
    speed_hz,
    slow_speed_hz,
    decision,
    lambda,
    cuts,
    mean_tells,
    pitch_rad,
    latest
});

impl ChatterMonitor {
    /// Errors: a band that reaches too close to half the sample rate.
    pub fn new(settings: ChatterSettings) -> Result<Self, ChatterError> {
        let band = settings.band;
        let (rate_hz, needed_hz) = (settings.sample_rate.hz(), 2.0 * band.high_hz() + 10.0);
        if rate_hz < needed_hz {
            return Err(ChatterError::RateTooLow { high_hz: band.high_hz(), needed_hz, rate_hz });
        }
        let reach_hz = REACH * band.half_width_hz();
        let low_hz = (band.centre_hz() - reach_hz).max(CRITERIA.line_hz);
        let high_hz = (band.centre_hz() + reach_hz).min(0.47 * rate_hz);
        let parts = ((high_hz - low_hz) / (2.0 * CRITERIA.half_hz)).ceil().max(1.0);
        let wide_hz = (high_hz - low_hz) / parts;
        let part = |k: f64| [low_hz + k * wide_hz, low_hz + (k + 1.0) * wide_hz];
        let parts_hz: Vec<[f64; 2]> = (0..parts as u32).map(|k| part(f64::from(k))).collect();
        let levels = Levels::of(settings.false_alarm_s);
        let sub_band = |[a, b]: &[f64; 2]| SubBand::new(settings.sample_rate, 0.5 * (a + b), levels);
        let sub_bands = parts_hz.iter().map(sub_band).collect();
        let turns_per_rpm = settings.sample_rate.period_s() / 60.0;
        Ok(Self {
            settings,
            level: CutLevel::new(settings.sample_rate, settings.mean),
            sub_bands,
            parts_hz,
            turns_per_rpm,
        })
    }

    /// What it watches.
    #[must_use]
    pub fn settings(&self) -> &ChatterSettings {
        &self.settings
    }

    /// Samples between two decisions.
    #[must_use]
    pub fn decision_samples(&self) -> usize {
        2 * self.sub_bands[0].decimation()
    }

    /// Nothing heard yet.
    #[must_use]
    pub fn start(&self) -> ChatterState {
        let band = self.settings.band;
        ChatterState {
            samples: 0,
            values: 0,
            hop: Hop::default(),
            another: false,
            outliers: OutlierFilter::default(),
            level: self.level.start(),
            sub_bands: self.sub_bands.iter().map(SubBand::start).collect(),
            watched_hz: [band.low_hz(), band.high_hz()],
            angle_turns: 0.0,
            newest_speed_hz: 0.0,
            speed_hz: 0.0,
            slow_speed_hz: 0.0,
            decision: Decision::default(),
            lambda: 0.0,
            cuts: false,
            mean_tells: true,
            pitch_rad: None,
            latest: ChatterOutput {
                phase: Phase::Learning,
                frequency_hz: None,
                power_n2: 0.0,
                contrast: 0.0,
                growth_1_s: None,
                reason: Reason::default(),
                event: None,
            },
        }
    }

    /// After samples were lost: the noise of air and cut stays known, all else begins anew.
    pub fn resume(&self, state: &mut ChatterState) {
        let known = std::mem::replace(state, self.start());
        for ((sub_band, new), old) in self.sub_bands.iter().zip(&mut state.sub_bands).zip(&known.sub_bands) {
            sub_band.resume(new, old);
        }
        (state.level, state.cuts, state.watched_hz) = (known.level, known.cuts, known.watched_hz);
    }

    /// Lets the watched band follow the bar; false where none of it was designed for.
    pub fn follow(&self, state: &mut ChatterState, band: Band) -> bool {
        let [first, last] = [self.parts_hz[0][0], self.parts_hz[self.parts_hz.len() - 1][1]];
        let low_hz = band.low_hz().max(first);
        let high_hz = band.high_hz().min(last);
        let within = low_hz < high_hz;
        if within {
            state.watched_hz = [low_hz, high_hz];
        }
        within
    }

    /// Whether the mean tells of the cut now: that of a drive in motion is what moves it.
    pub fn listen_to_mean(&self, state: &mut ChatterState, tells: bool) {
        state.mean_tells = tells;
    }

    /// Tells the pitch of two opposed tools that cut one wave each of the other, theta_2 - theta_1, rad;
    /// `None` where it is not known.
    pub fn follow_pitch(&self, state: &mut ChatterState, pitch_rad: Option<f64>) {
        state.pitch_rad = pitch_rad.filter(|rad| rad.is_finite());
    }

    /// Band in which a line counts now, Hz.
    #[must_use]
    pub fn watched_hz(&self, state: &ChatterState) -> [f64; 2] {
        state.watched_hz
    }

    /// What was said last.
    #[must_use]
    pub fn output<'a>(&self, state: &'a ChatterState) -> &'a ChatterOutput {
        &state.latest
    }

    /// Takes one sample; answers what began or ended with it.
    #[inline]
    pub fn step(
        &self,
        state: &mut ChatterState,
        force_n: f64,
        spindle_speed_rpm: Option<f64>,
    ) -> Option<ChatterEvent> {
        state.latest.event = None;
        state.samples += 1;
        let force_n = state.outliers.bound(force_n, self.settings.sample_rate.period_s());
        if let Some(rpm) = spindle_speed_rpm.map(f64::abs) {
            state.angle_turns += rpm * self.turns_per_rpm;
            state.newest_speed_hz = rpm * (1.0 / 60.0);
        }
        let change = self.level.step(&mut state.level, force_n, state.speed_hz, state.cuts);
        if change != Change::None {
            self.change(state, change);
        }
        let mut fresh = false;
        for at in 0..self.sub_bands.len() {
            if self.sub_bands[at].push(&mut state.sub_bands[at], force_n) {
                if !fresh {
                    self.follow_speed(state);
                }
                fresh = true;
                self.take(state, at);
            }
        }
        if fresh {
            self.decide(state);
        }
        state.latest.event
    }

    /// The tools entered or left. What moves the mean in the cut is chatter itself, or a change of depth,
    /// which the noise tells.
    fn change(&self, state: &mut ChatterState, change: Change) {
        let place = match change {
            Change::Rises
                if !state.cuts && (self.settings.mean == MeanForce::Whole || !state.decision.alarm) =>
            {
                true
            }
            // Without a tool there is no chatter: it ends, and at the next look the cut does.
            Change::Gone if state.decision.alarm => {
                state.decision = Decision::default();
                return self.end(state);
            }
            Change::Falls | Change::Gone if !state.decision.alarm => false,
            _ => return,
        };
        state.cuts = place;
        for (sub_band, s) in self.sub_bands.iter().zip(&mut state.sub_bands) {
            sub_band.begin(s, Some(place));
        }
        state.lambda = 0.0;
        state.latest.event = Some(ChatterEvent::CutChanged);
    }

    /// An alarm ended.
    fn end(&self, state: &mut ChatterState) {
        for (sub_band, s) in self.sub_bands.iter().zip(&mut state.sub_bands) {
            sub_band.begin(s, None);
        }
        state.lambda = 0.0;
        state.latest.event = Some(ChatterEvent::End);
    }

    fn follow_speed(&self, state: &mut ChatterState) {
        let period_s = 1.0 / self.sub_bands[0].rate_hz();
        let newest_hz = state.newest_speed_hz;
        if newest_hz < LEAST_SPEED_HZ {
            state.speed_hz = 0.0;
        } else if state.speed_hz <= 0.0 {
            (state.speed_hz, state.slow_speed_hz) = (newest_hz, newest_hz);
        } else {
            state.speed_hz += (newest_hz - state.speed_hz) * (period_s / SPEED_S).min(1.0);
        }
        state.slow_speed_hz += (state.speed_hz - state.slow_speed_hz) * (period_s / SPEED_CHANGE_S);
    }

    /// Relative change of the speed, 1/s; zero where it moves no line.
    fn speed_change_1_s(&self, state: &ChatterState) -> f64 {
        if state.speed_hz <= 0.0 {
            return 0.0;
        }
        let change = (state.speed_hz - state.slow_speed_hz) / (SPEED_CHANGE_S * state.speed_hz);
        if change.abs() < 1e-3 { 0.0 } else { change }
    }

    fn take(&self, state: &mut ChatterState, at: usize) {
        let centre_hz = self.sub_bands[at].centre_hz();
        let ([low, high], [a, b]) = (self.parts_hz[at], state.watched_hz);
        let now = Conditions {
            angle_turns: state.angle_turns,
            speed_hz: state.speed_hz,
            speed_change_1_s: self.speed_change_1_s(state),
            pitch_rad: state.pitch_rad,
            watched_hz: [low.max(a - SAME_LINE_HZ) - centre_hz, high.min(b + SAME_LINE_HZ) - centre_hz],
            learns: !state.decision.alarm && state.lambda < CRITERIA.hold,
            alarm: state.decision.alarm,
            mean: if state.mean_tells { self.settings.mean } else { MeanForce::Absent },
            has_mean: self.settings.mean != MeanForce::Absent,
            mean_n: state.level.reached_n(),
            sensor_n2: state.outliers.noise_n2(),
        };
        self.sub_bands[at].take(&mut state.sub_bands[at], &now);
    }

    fn now_s(&self, state: &ChatterState) -> f64 {
        state.samples as f64 * self.settings.sample_rate.period_s()
    }

    fn decide(&self, state: &mut ChatterState) {
        let mut evidence = [0.0; 4];
        let mut best = Detection::default();
        for (sub_band, s) in self.sub_bands.iter().zip(&state.sub_bands) {
            let at = |d: &Detection| Detection { offset_hz: d.offset_hz + sub_band.centre_hz(), ..*d };
            let sustained = sub_band.sustained(s);
            evidence[3] = sustained.evidence.max(evidence[3]);
            if sustained.evidence > best.evidence {
                best = at(&sustained);
            }
            for (to, detection) in evidence.iter_mut().zip(sub_band.detections(s)) {
                *to = detection.evidence.max(*to);
                if (detection.evidence, detection.over_noise) >= (best.evidence, best.over_noise) {
                    best = at(detection);
                }
            }
        }
        let contrast = best.contrast;
        // A tool that only pushes makes no line that is larger than what it pushes with.
        let amplitude_n = (2.0 * state.latest.power_n2.max(best.power_n2)).sqrt();
        let too_large = amplitude_n > CRITERIA.most_share * state.level.reached_n();
        if self.settings.mean == MeanForce::Whole && too_large && !state.decision.alarm {
            evidence = [0.0; 4];
            best.least(0.0, Reason::AbovePush);
        }
        state.lambda = best.evidence;
        let t_s = self.now_s(state);
        let period_s = 1.0 / self.sub_bands[0].rate_hz();
        let heard = (state.latest.power_n2, state.another);
        let turn = state.decision.step(t_s, evidence, heard, period_s);
        self.report(state, &best);
        match turn {
            Some(Turn::Begins) => {
                for (sub_band, s) in self.sub_bands.iter().zip(&mut state.sub_bands) {
                    sub_band.revert(s);
                }
                state.latest.event = Some(ChatterEvent::Onset(Line {
                    frequency_hz: best.offset_hz,
                    power_n2: state.latest.power_n2,
                    growth_1_s: state.latest.growth_1_s.unwrap_or(0.0),
                    contrast,
                }));
            }
            Some(Turn::Ends) => self.end(state),
            None => {}
        }
    }

    fn report(&self, state: &mut ChatterState, best: &Detection) {
        let known = self.sub_bands.iter().zip(&state.sub_bands).any(|(c, s)| c.has_model(s));
        let before = state.latest.phase;
        state.latest.phase = match (known, state.decision.alarm, best.evidence > CRITERIA.hold) {
            (_, true, _) => Phase::Chatter,
            (false, ..) => Phase::Learning,
            (_, _, true) => Phase::Suspected,
            _ => Phase::Quiet,
        };
        (state.latest.contrast, state.latest.reason) = (best.contrast, best.reason);
        if before == Phase::Suspected && state.latest.phase == Phase::Quiet {
            state.latest.event = state.latest.event.or(Some(ChatterEvent::Dismissed(best.reason)));
        }
        let line = matches!(state.latest.phase, Phase::Suspected | Phase::Chatter);
        state.values += 1;
        if line || state.values.is_multiple_of(REPORT_VALUES) {
            self.follow_line(state, line.then_some(best.offset_hz));
        }
        if !line {
            (state.latest.frequency_hz, state.latest.growth_1_s) = (None, None);
        }
    }

    /// The strongest line now: near what stands out, or of all the band where nothing does.
    fn follow_line(&self, state: &mut ChatterState, near_hz: Option<f64>) {
        let rate_hz = self.sub_bands[0].rate_hz();
        let alarm = state.decision.alarm;
        let age_s = self.now_s(state) - state.decision.since_s;
        // A longer window places a line better, once it has filled.
        let [_, short, long, _] = WINDOWS;
        let n = if alarm && age_s * rate_hz > long as f64 { long } else { short };
        let about = |[a, b]: [f64; 2]| [a - SAME_LINE_HZ, b + SAME_LINE_HZ];
        let all_hz = about(state.watched_hz);
        let among_hz = near_hz.map_or(all_hz, |hz| about([hz, hz]));
        state.another = false;
        let Some((hz, line)) = self.strongest(state, n, among_hz) else { return };
        // A window heard what was half its length ago.
        let late_s = self.sub_bands[0].delay_s() + 0.5 * n as f64 / rate_hz;
        let now_hz = hz * (1.0 + self.speed_change_1_s(state) * late_s);
        state.latest.power_n2 = line.power_n2;
        (state.latest.frequency_hz, state.latest.growth_1_s) = (Some(now_hz), Some(line.growth_1_s));
        // Chatter may stand on several lobes, and another than its loudest be the clearest.
        let fainter = |line: Strongest| state.decision.is_fainter(line.power_n2);
        state.another = alarm
            && fainter(line)
            && state.hop.leaves(now_hz)
            && self.strongest(state, n, all_hz).is_none_or(|(_, loudest)| fainter(loudest));
        if state.another {
            return;
        }
        let hop = state.hop.look(alarm.then_some(now_hz));
        let hop = hop.map(|(from_hz, to_hz)| ChatterEvent::Hop { from_hz, to_hz });
        state.latest.event = state.latest.event.or(hop);
    }

    /// The strongest line of the last `n` values, a window's length, within `among_hz`, and its place, Hz.
    fn strongest(&self, state: &ChatterState, n: usize, among_hz: [f64; 2]) -> Option<(f64, Strongest)> {
        let mut found: Option<(f64, Strongest)> = None;
        for ((sub_band, s), [low, high]) in self.sub_bands.iter().zip(&state.sub_bands).zip(&self.parts_hz) {
            let centre_hz = sub_band.centre_hz();
            let band_hz = [low.max(among_hz[0]) - centre_hz, high.min(among_hz[1]) - centre_hz];
            if band_hz[1] <= band_hz[0] {
                continue;
            }
            let now = sub_band.strongest(s, n, band_hz);
            if found.is_none_or(|(_, best)| now.power_n2 > best.power_n2) {
                found = Some((centre_hz + now.offset_hz, now));
            }
        }
        found
    }
}
