//! One band of the force: mixed down, orders off, whitened, tested in four windows.

use super::criteria::{CRITERIA, FIRST, LOOKS, Levels, WINDOWS};
use super::cut_level::MeanForce;
use super::history::{History, Value};
use super::interference::Interference;
use super::lines::{BAND_LEVEL, Strongest, Sustained, Test};
use super::orders::{Orders, Turned};
use super::sustained::{BLOCK, KEPT, Residuals};
use super::whitening::{Noise, Whitener};
use super::window::{Conditions, Context, Detection, Knowledge, Tools, loudness_nats};
use crate::keyframe::keep;
use crate::signal::down_mix::{DownMix, DownMixState};
use crate::units::SampleRate;
use nalgebra::Complex;

type C = Complex<f64>;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct SubBand {
    mix: DownMix,
    /// Of the mixer in one value.
    turn: C,
    test: Test,
    levels: Levels,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct SubBandState {
    mix: DownMixState,
    mixer: C,
    /// In air, and in the cut.
    orders: [Orders; 2],
    noise: [Noise; 2],
    whitener: Whitener,
    /// Which of the two it is now.
    in_cut: bool,
    /// Whether tools were seen to leave.
    left: bool,
    history: History,
    /// Values since the start, and since what is heard began anew.
    count: u64,
    since_change: usize,
    /// The same, where tools that leave and an alarm that ends begin nothing: what stands on was there
    /// before.
    seen: usize,
    detections: [Detection; WINDOWS.len()],
    /// Of the last half second, N^2: of the band, and of the sensor's noise.
    whole_n2: f64,
    sensor_n2: f64,
    other_level: usize,
    residuals: Residuals,
    sustained: Detection,
    /// What was known a while ago, or before another cut began, and the values since it was put there.
    before: [Whitener; 2],
    before_age: usize,
    interference: Interference,
    /// Values since the alarm began in which the line may stand.
    alarmed: usize,
}

keep!(SubBandState {
    mix, mixer, orders, noise, whitener, in_cut, left, history, count, since_change, seen, detections,
    whole_n2, sensor_n2, other_level, residuals, sustained, before, before_age, interference, alarmed,
} if |s| s.seen >= s.since_change);

impl SubBandState {
    /// Where what is known of the place that it is in stands.
    fn here(&self) -> usize {
        usize::from(self.in_cut)
    }
}

impl SubBand {
    pub(super) fn new(rate: SampleRate, centre_hz: f64, levels: Levels) -> Self {
        let mix = DownMix::new(rate, centre_hz, CRITERIA.rate_hz / 6.0);
        let test = Test::new(mix.output_rate_hz(), centre_hz);
        let turn = C::from_polar(1.0, -std::f64::consts::TAU * centre_hz / mix.output_rate_hz());
        Self { mix, turn, test, levels }
    }

    pub(super) fn centre_hz(&self) -> f64 {
        self.mix.centre_hz()
    }

    pub(super) fn rate_hz(&self) -> f64 {
        self.mix.output_rate_hz()
    }

    pub(super) fn decimation(&self) -> usize {
        self.mix.decimation()
    }

    pub(super) fn delay_s(&self) -> f64 {
        self.mix.delay_s()
    }

    pub(super) fn start(&self) -> SubBandState {
        SubBandState {
            mix: self.mix.start(),
            mixer: C::ONE,
            orders: [Orders::new(), Orders::new()],
            noise: [Noise::NEW, Noise::NEW],
            whitener: Whitener::NONE,
            in_cut: false,
            left: false,
            history: History::new(),
            count: 0,
            since_change: 0,
            seen: 0,
            detections: [Detection::default(); WINDOWS.len()],
            whole_n2: 0.0,
            sensor_n2: 0.0,
            other_level: 0,
            residuals: Residuals::new(),
            sustained: Detection::default(),
            before: [Whitener::NONE; 2],
            before_age: 0,
            interference: Interference::default(),
            alarmed: 0,
        }
    }

    /// What was known before samples were lost: the spindle's angle is not.
    pub(super) fn resume(&self, state: &mut SubBandState, known: &SubBandState) {
        state.noise.clone_from(&known.noise);
        (state.in_cut, state.left, state.before) = (known.in_cut, known.left, known.before);
        state.interference = known.interference;
        Self::whiten_by(state, known.whitener);
    }

    /// Takes a sample; true when there is a value to [`Self::hear`].
    #[inline]
    pub(super) fn push(&self, state: &mut SubBandState, force_n: f64) -> bool {
        self.mix.push(&mut state.mix, force_n)
    }

    #[inline(never)]
    pub(super) fn take(&self, state: &mut SubBandState, now: &Conditions) {
        let value = self.mix.output(&mut state.mix);
        let rate_hz = self.rate_hz();
        state.mixer *= self.turn;
        state.mixer *= 1.5 - 0.5 * state.mixer.norm_sqr();
        state.count += 1;
        // Not while the filter before it fills.
        let settled = state.count as f64 > CRITERIA.filled_delays * self.delay_s() * rate_hz;
        let learns = now.learns && settled;
        let angle_turns = now.angle_turns - now.speed_hz * self.delay_s();
        let mut orders = C::ZERO;
        if now.speed_hz > 0.0 {
            let at = Turned {
                value,
                mixer: state.mixer,
                angle_turns,
                speed_hz: now.speed_hz,
                centre_hz: self.centre_hz(),
                learns,
            };
            orders = state.orders[state.here()].step(&at);
        }
        let residual = value - orders;
        state.history.push(Value { residual, orders, mixer: state.mixer, angle_turns });
        // Of all that was heard until the memory is full: less would make any force that of a tool.
        let memory = (0.5 * rate_hz).min(state.count as f64);
        state.whole_n2 += (value.norm_sqr() - state.whole_n2) / memory;
        state.sensor_n2 += (now.sensor_n2 - state.sensor_n2) / memory;
        if state.residuals.push(residual) {
            self.judge_sustained(state, now);
        }
        self.age(state, now);
        if learns && state.noise[state.here()].learn(&state.history.newest(), CRITERIA.noise_s * rate_hz) {
            self.renew(state);
        }
        self.detect(state, now);
    }

    /// One value later.
    fn age(&self, state: &mut SubBandState, now: &Conditions) {
        let rate_hz = self.rate_hz();
        state.since_change += 1;
        state.seen += 1;
        state.before_age += 1;
        state.alarmed = match now.alarm {
            true => state.alarmed + 1,
            // What stood before was heard then.
            false if state.sustained.evidence >= 1.0 => KEPT,
            false => 0,
        };
        state.interference.age(1.0 / rate_hz);
        if now.learns && state.before_age as f64 > CRITERIA.before_s * rate_hz {
            state.before = [state.before[1], state.whitener];
            state.before_age = 0;
        }
    }

    /// Most power that the noise of a stable cut with this mean force has at a place, N^2: infinite where the
    /// mean force is not that of a tool in the cut, or a zero that drifts.
    fn stable_n2(&self, state: &SubBandState, now: &Conditions) -> f64 {
        let drifts = self.has_model(state) && !state.in_cut;
        let known = Self::cuts(state, now) && !drifts;
        if known { (CRITERIA.stable_share * now.mean_n).powi(2) } else { f64::INFINITY }
    }

    /// Whether a tool is in the cut, by its mean force. Where none was seen to enter, it is none unless it
    /// stands above the noise of the sensor, whose zero may be off, and above all that the band does.
    fn cuts(state: &SubBandState, now: &Conditions) -> bool {
        let pushes = now.mean_n > CRITERIA.over_whole * state.whole_n2.max(state.sensor_n2).sqrt();
        now.mean != MeanForce::Absent && (state.in_cut || pushes)
    }

    /// The line that stands: a limit cycle that was not there before, or is louder than a stable cut is.
    fn judge_sustained(&self, state: &mut SubBandState, now: &Conditions) {
        let since_change = if now.alarm { state.alarmed } else { state.since_change };
        let line = self.test.sustained(&state.residuals, now, since_change);
        let Sustained { offset_hz, nats, power_n2, side } = line;
        let stable_n2 = self.stable_n2(state, now);
        let modulated = side > CRITERIA.modulated;
        let nothing_before = state.before[0] == Whitener::NONE;
        let over = if nothing_before {
            2.0 * self.levels.cause_nats * power_n2 / stable_n2
        } else {
            let known = state.before[0].known(offset_hz / self.rate_hz());
            power_n2 * BLOCK as f64 / known.max(f64::MIN_POSITIVE)
        };
        let proven = |nats: f64| nats > self.levels.cause_nats;
        // Where nothing is known of air, what the cut modulates is the cut's.
        let is_new = proven(over) || (nothing_before && modulated && proven(nats));
        // A line as large as the mean force: a tool that pushes and never pulls leaves the cut in each cycle.
        let leaves_cut =
            now.mean == MeanForce::Whole && 2.0 * power_n2 > stable_n2 / CRITERIA.stable_share.powi(2);
        // Where the noise of this cut is known a line is seen to grow.
        let seen_to_grow =
            now.mean != MeanForce::Absent && !self.learning(state) && !now.alarm && !leaves_cut;
        let rules = modulated || power_n2 > CRITERIA.rules * state.whole_n2;
        state.sustained = Detection::default();
        if is_new && rules && !seen_to_grow {
            let evidence = (nats + loudness_nats(power_n2, stable_n2)) / self.levels.cause_nats;
            let over_noise = over / self.levels.noise_nats;
            state.sustained =
                Detection { evidence, over_noise, offset_hz, contrast: over, ..Detection::default() };
        }
    }

    fn whiten_by(state: &mut SubBandState, whitener: Whitener) {
        state.whitener = whitener;
        let known = whitener != Whitener::NONE;
        state.history.whiten_by(if known { whitener } else { Whitener::plain() });
    }

    /// The model that whitens: of this cut, or of the air while the cut's is not known.
    fn renew(&self, state: &mut SubBandState) {
        let least = FIRST as f64;
        let here = &state.noise[state.here()];
        let air = &state.noise[0];
        let whitener = if self.learning(state) && air.known() > least && state.in_cut {
            air.whitener()
        } else if here.known() > least {
            here.whitener()
        } else {
            Whitener::NONE
        };
        Self::whiten_by(state, whitener);
    }

    /// Another cut begins: what is known now is what was before it. What changes within the memory of the
    /// noise is one change.
    fn remember(&self, state: &mut SubBandState) {
        if state.before[0] == Whitener::NONE || state.before_age as f64 > CRITERIA.noise_s * self.rate_hz() {
            state.before = [state.whitener; 2];
        }
        state.before_age = 0;
    }

    fn learning(&self, state: &SubBandState) -> bool {
        state.noise[state.here()].known() < 0.99 * CRITERIA.noise_s * self.rate_hz()
    }

    /// Whether enough noise is known to say anything.
    pub(super) fn has_model(&self, state: &SubBandState) -> bool {
        state.whitener != Whitener::NONE
    }

    /// What is known beside the windows; nothing while neither noise nor a mean force is.
    fn context(&self, state: &SubBandState, now: &Conditions) -> Option<Context> {
        let noise = match (self.has_model(state), self.learning(state)) {
            (false, _) => Knowledge::Nothing,
            (true, true) => Knowledge::Young,
            (true, false) => Knowledge::Known,
        };
        let tools = match (now.mean, Self::cuts(state, now), state.left) {
            (MeanForce::Absent, ..) if noise == Knowledge::Nothing => return None,
            (_, true, _) => Tools::Cutting,
            (MeanForce::Absent, false, true) if !now.has_mean => Tools::Left,
            (MeanForce::Absent, false, _) => Tools::Untold,
            (_, false, _) => Tools::Unseen,
        };
        Some(Context {
            levels: self.levels,
            centre_hz: self.centre_hz(),
            rate_hz: self.rate_hz(),
            speed_hz: now.speed_hz,
            pitch_rad: now.pitch_rad,
            sweep_hz_s: self.centre_hz() * now.speed_change_1_s,
            watched_hz: now.watched_hz,
            seen: state.seen,
            noise,
            orders: state.orders[state.here()].known(),
            alarm: now.alarm,
            tools,
            stable_n2: self.stable_n2(state, now),
            whitener: if noise == Knowledge::Nothing { Whitener::plain() } else { state.whitener },
        })
    }

    fn detect(&self, state: &mut SubBandState, now: &Conditions) {
        let Some(context) = self.context(state, now) else {
            state.detections = [Detection::default(); WINDOWS.len()];
            return;
        };
        // Without a model nothing stands between the test and the filter that fills.
        let filled = if context.noise == Knowledge::Nothing { self.filled() } else { 0.0 };
        for (which, n) in WINDOWS.into_iter().enumerate() {
            if !(state.count + which as u64).is_multiple_of((n / LOOKS) as u64) {
                continue;
            }
            let full = state.since_change as f64 >= n as f64 + filled;
            state.detections[which] = if full && !(context.is_young() && which == 0) {
                self.test.detect(&mut state.history, which, &context)
            } else {
                Detection::default()
            };
            state.interference.judge(&mut state.detections[which], which, &context);
            if which == BAND_LEVEL && state.since_change >= n {
                self.compare(state, &context);
            }
        }
    }

    /// Values in which the filter fills.
    fn filled(&self) -> f64 {
        (CRITERIA.filled_delays * self.delay_s() * self.rate_hz()).floor()
    }

    /// Whether all of the band has another level: then what is known of the noise is of another cut.
    fn compare(&self, state: &mut SubBandState, context: &Context) {
        let n = WINDOWS[BAND_LEVEL];
        let band_level = self.test.band_level(&mut state.history, context);
        let other = band_level * CRITERIA.louder < 1.0;
        state.other_level = if other { state.other_level + n / LOOKS } else { 0 };
        if state.other_level >= n && !context.alarm && !context.is_young() {
            self.remember(state);
            state.noise[state.here()].shrink(FIRST as f64);
            state.other_level = 0;
            self.renew(state);
        }
    }

    pub(super) fn sustained(&self, state: &SubBandState) -> Detection {
        state.sustained
    }

    pub(super) fn detections<'a>(&self, state: &'a SubBandState) -> &'a [Detection; WINDOWS.len()] {
        &state.detections
    }

    /// What is heard from now on is something else: nothing of before counts but, unless tools enter, how a
    /// line began.
    pub(super) fn begin(&self, state: &mut SubBandState, in_cut: Option<bool>) {
        state.since_change = 0;
        if in_cut == Some(true) {
            state.seen = 0;
        }
        state.detections = [Detection::default(); WINDOWS.len()];
        state.sustained = Detection::default();
        if let Some(in_cut) = in_cut {
            self.remember(state);
            if in_cut != state.in_cut {
                state.noise[state.here()].accept_all();
            }
            (state.in_cut, state.left) = (in_cut, !in_cut);
            if in_cut {
                state.interference.enter();
            }
            state.orders[state.here()].restart();
            self.renew(state);
        }
    }

    /// A line was declared: what was learned in the guard time is forgotten.
    pub(super) fn revert(&self, state: &mut SubBandState) {
        state.noise[state.here()].revert();
    }

    /// Strongest line of the last `n` values, a window's length.
    pub(super) fn strongest(&self, state: &SubBandState, n: usize, watched_hz: [f64; 2]) -> Strongest {
        self.test.strongest(state.history.last(n), watched_hz)
    }
}
