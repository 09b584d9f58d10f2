//! One band of the force: mixed down, orders off, whitened, tested in four windows.

use super::criteria::{CRITERIA, LOOKS, Levels, SAME_LINE_HZ, WINDOWS};
use super::cut_level::MeanForce;
use super::history::{History, Value};
use super::lines::{COMMON, Place, Standing, Strongest, Test};
use super::orders::{Orders, Turned};
use super::steady::{BLOCK, KEPT, Steady};
use super::whitening::{Noise, Whitener};
use super::window::{Around, Heard, Reason, louder};
use crate::keyframe::keep;
use crate::signal::down_mix::{DownMix, DownMixState};
use crate::units::SampleRate;
use nalgebra::Complex;

type C = Complex<f64>;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Chain {
    mix: DownMix,
    /// Of the mixer in one value.
    turn: C,
    test: Test,
    levels: Levels,
}

/// The mixer's filter has filled after so many of its delays.
const FILLED_DELAYS: f64 = 3.0;
/// Blocks of an alarm after which its scatter counts: a second.
const ENOUGH: usize = 10;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct ChainState {
    mix: DownMixState,
    mixer: C,
    /// In air, and in the cut.
    orders: [Orders; 2],
    noise: [Noise; 2],
    whitener: Whitener,
    /// Which of the two it is now.
    in_cut: bool,
    history: History,
    /// Values since the start, and since what is heard began anew.
    count: u64,
    clean: usize,
    /// The same, where tools that leave begin nothing: what stands on was there before.
    seen: usize,
    heard: [Heard; WINDOWS.len()],
    /// Of the last quarter second, N^2.
    power_n2: f64,
    whole_n2: f64,
    louder: usize,
    steady: Steady,
    standing: Heard,
    /// What was known two to four seconds ago, or before another cut began.
    before: [Whitener; 2],
    since: usize,
    scatters: bool,
    foreign_hz: f64,
    foreign_s: f64,
    foreign_n2: f64,
    alarmed: usize,
}

keep!(ChainState {
    mix, mixer, orders, noise, whitener, in_cut, history, count, clean, seen, heard, power_n2, whole_n2,
    louder, steady, standing, before, since, scatters, foreign_hz, foreign_s, foreign_n2, alarmed,
} if |s| s.seen >= s.clean);

impl ChainState {
    /// Where what is known of the place that it is in stands.
    fn here(&self) -> usize {
        usize::from(self.in_cut)
    }
}

/// What the chain is told with each value.
#[derive(Debug, Clone, Copy)]
pub(super) struct Told {
    pub(super) angle_turns: f64,
    pub(super) speed_hz: f64,
    pub(super) speed_change_1_s: f64,
    pub(super) watched_hz: [f64; 2],
    /// Whether what is heard is noise.
    pub(super) learns: bool,
    /// Whether a line stands declared: it needs no proof but its power.
    pub(super) alarm: bool,
    /// Whether and how the mean force tells of the cut.
    pub(super) mean: MeanForce,
    /// Mean force of the cut, N.
    pub(super) mean_n: f64,
}

impl Chain {
    pub(super) fn new(rate: SampleRate, centre_hz: f64, levels: Levels) -> Self {
        let mix = DownMix::new(rate, centre_hz, CRITERIA.rate_hz / 6.0);
        let turn = C::from_polar(1.0, -std::f64::consts::TAU * centre_hz / mix.output_rate_hz());
        Self { mix, turn, test: Test::new(), levels }
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

    pub(super) fn start(&self) -> ChainState {
        ChainState {
            mix: self.mix.start(),
            mixer: C::new(1.0, 0.0),
            orders: [Orders::new(), Orders::new()],
            noise: [Noise::NEW, Noise::NEW],
            whitener: Whitener::NONE,
            in_cut: false,
            history: History::new(),
            count: 0,
            clean: 0,
            seen: 0,
            heard: [Heard::default(); WINDOWS.len()],
            power_n2: 0.0,
            whole_n2: 0.0,
            louder: 0,
            steady: Steady::new(),
            standing: Heard::default(),
            before: [Whitener::NONE; 2],
            since: 0,
            scatters: false,
            foreign_hz: 0.0,
            foreign_s: 0.0,
            foreign_n2: 0.0,
            alarmed: 0,
        }
    }

    /// What was known before samples were lost: the spindle's angle is not.
    pub(super) fn resume(&self, state: &mut ChainState, known: &ChainState) {
        state.noise.clone_from(&known.noise);
        (state.in_cut, state.before) = (known.in_cut, known.before);
        Self::whiten_by(state, known.whitener);
    }

    /// Takes a sample; true when there is a value to [`Self::hear`].
    #[inline]
    pub(super) fn push(&self, state: &mut ChainState, force_n: f64) -> bool {
        self.mix.push(&mut state.mix, force_n)
    }

    #[inline(never)]
    pub(super) fn hear(&self, state: &mut ChainState, told: &Told) {
        let value = self.mix.output(&mut state.mix);
        let rate_hz = self.rate_hz();
        state.mixer *= self.turn;
        state.mixer *= 1.5 - 0.5 * state.mixer.norm_sqr();
        state.count += 1;
        // Not while the filter before it fills.
        let settled = state.count as f64 > FILLED_DELAYS * self.delay_s() * rate_hz;
        let learns = told.learns && settled;
        let angle_turns = told.angle_turns - told.speed_hz * self.delay_s();
        let mut orders = C::new(0.0, 0.0);
        if told.speed_hz > 0.0 {
            let at = Turned {
                value,
                mixer: state.mixer,
                angle_turns,
                speed_hz: told.speed_hz,
                centre_hz: self.centre_hz(),
                learns,
            };
            orders = state.orders[state.here()].step(&at);
        }
        let residual = value - orders;
        state.history.push(Value { residual, orders, mixer: state.mixer, angle_turns });
        state.power_n2 += (residual.norm_sqr() - state.power_n2) / (0.25 * rate_hz);
        state.whole_n2 += (value.norm_sqr() - state.whole_n2) / (0.5 * rate_hz);
        if state.steady.push(residual) {
            self.stand(state, told);
        }
        self.age(state, told);
        if learns {
            if state.noise[state.here()].learn(&state.history.newest(), CRITERIA.noise_s * rate_hz) {
                self.renew(state);
            }
        }
        self.look(state, told);
    }

    /// One value later.
    fn age(&self, state: &mut ChainState, told: &Told) {
        let rate_hz = self.rate_hz();
        state.clean += 1;
        state.seen += 1;
        state.since += 1;
        state.alarmed = match told.alarm {
            true => state.alarmed + 1,
            // What stood before was heard then.
            false if state.standing.evidence >= 1.0 => KEPT,
            false => 0,
        };
        state.foreign_s = (state.foreign_s - 1.0 / rate_hz).max(0.0);
        if told.learns && state.since as f64 > CRITERIA.before_s * rate_hz {
            state.before = [state.before[1], state.whitener];
            state.since = 0;
        }
    }

    /// Most power that the noise of a stable cut with this mean force has at a place, N^2, and the same where
    /// the mean force is that of a tool in the cut, and no zero that drifts: infinite where it is not known.
    fn stable_n2(&self, state: &ChainState, told: &Told) -> [f64; 2] {
        let share_n2 = (CRITERIA.stable_share * told.mean_n).powi(2);
        let drifts = self.knows(state) && !state.in_cut;
        [share_n2, if Self::cuts(state, told) && !drifts { share_n2 } else { f64::INFINITY }]
    }

    /// Whether a tool is in the cut, by its mean force.
    fn cuts(state: &ChainState, told: &Told) -> bool {
        let pushes = told.mean_n > CRITERIA.over_whole * state.whole_n2.sqrt();
        told.mean != MeanForce::Absent && (state.in_cut || pushes)
    }

    /// The line that stands: a limit cycle that was not there before, or is louder than a stable cut is.
    fn stand(&self, state: &mut ChainState, told: &Told) {
        let rate_hz = self.rate_hz();
        let clean = if told.alarm { state.alarmed } else { state.clean };
        let place = Place {
            rate_hz,
            centre_hz: self.centre_hz(),
            speed_hz: told.speed_hz,
            alarm: told.alarm,
            watched_hz: told.watched_hz,
            clean,
        };
        let Standing { offset_hz, nats, power_n2, side } = self.test.standing(&state.steady, &place);
        let [share_n2, stable_n2] = self.stable_n2(state, told);
        let cut = side > CRITERIA.modulated;
        let over = if state.before[0] == Whitener::NONE {
            2.0 * self.levels.cause_nats * power_n2 / stable_n2
        } else {
            let known = state.before[0].known(offset_hz / rate_hz);
            power_n2 * BLOCK as f64 / known.max(f64::MIN_POSITIVE)
        };
        state.scatters =
            state.alarmed >= ENOUGH * BLOCK && nats <= 0.0 && power_n2 > 0.0 && power_n2 < share_n2;
        // Where nothing is known of air, what the cut modulates is the cut's.
        let new = over > self.levels.cause_nats
            || (cut && nats > self.levels.cause_nats && state.before[0] == Whitener::NONE);
        // Where the noise of this cut is known a line is seen to grow.
        let seen = told.mean != MeanForce::Absent && !self.young(state) && !told.alarm;
        let rules = new && !seen && (cut || power_n2 > CRITERIA.rules * state.whole_n2);
        state.standing = if rules {
            Heard {
                evidence: (nats + louder(power_n2, stable_n2)) / self.levels.cause_nats,
                stands: over / self.levels.noise_nats,
                offset_hz,
                contrast: over,
                ..Heard::default()
            }
        } else {
            Heard::default()
        };
    }

    fn whiten_by(state: &mut ChainState, whitener: Whitener) {
        state.whitener = whitener;
        let known = whitener != Whitener::NONE;
        state.history.whiten_by(if known { whitener } else { Whitener::plain() });
    }

    /// The model that whitens: of this cut, or of the air while the cut's is not known.
    fn renew(&self, state: &mut ChainState) {
        let least = CRITERIA.young_s * self.rate_hz();
        let here = &state.noise[state.here()];
        let air = &state.noise[0];
        let whitener = if self.young(state) && air.known() > least && state.in_cut {
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
    fn remember(&self, state: &mut ChainState) {
        if state.before[0] == Whitener::NONE || state.since as f64 > CRITERIA.noise_s * self.rate_hz() {
            state.before = [state.whitener; 2];
        }
        state.since = 0;
    }

    fn young(&self, state: &ChainState) -> bool {
        state.noise[state.here()].known() < 0.99 * CRITERIA.noise_s * self.rate_hz()
    }

    /// Whether enough noise is known to say anything.
    pub(super) fn knows(&self, state: &ChainState) -> bool {
        state.whitener != Whitener::NONE
    }

    /// What is known beside the windows; nothing while neither noise nor a mean force is.
    fn around(&self, state: &ChainState, told: &Told) -> Option<Around> {
        let means = told.mean != MeanForce::Absent;
        let blind = !self.knows(state);
        if blind && !means {
            return None;
        }
        Some(Around {
            levels: self.levels,
            centre_hz: self.centre_hz(),
            rate_hz: self.rate_hz(),
            speed_hz: told.speed_hz,
            sweep_hz_s: self.centre_hz() * told.speed_change_1_s,
            watched_hz: told.watched_hz,
            seen: state.seen,
            young: self.young(state),
            orders: state.orders[state.here()].known(),
            alarm: told.alarm,
            told: means,
            cuts: Self::cuts(state, told),
            blind,
            scatters: state.scatters,
            stable_n2: self.stable_n2(state, told)[1],
            whitener: if blind { Whitener::plain() } else { state.whitener },
        })
    }

    fn look(&self, state: &mut ChainState, told: &Told) {
        let Some(around) = self.around(state, told) else {
            state.heard = [Heard::default(); WINDOWS.len()];
            return;
        };
        // Without a model nothing stands between the test and the filter that fills.
        let filled = if around.blind { self.filled() } else { 0.0 };
        for (which, n) in WINDOWS.into_iter().enumerate() {
            if !(state.count + which as u64).is_multiple_of((n / LOOKS) as u64) {
                continue;
            }
            let full = state.clean as f64 >= n as f64 + filled;
            state.heard[which] = if full && !(around.young && which == 0) {
                self.test.look(&mut state.history, which, &around)
            } else {
                Heard::default()
            };
            self.foreign(state, which);
            if which == COMMON && state.clean >= n {
                self.compare(state, &around);
            }
        }
    }

    /// Values in which the filter fills.
    fn filled(&self) -> f64 {
        (FILLED_DELAYS * self.delay_s() * self.rate_hz()).floor()
    }

    /// Whether all of the band has another level: then what is known of the noise is of another cut.
    fn compare(&self, state: &mut ChainState, around: &Around) {
        let n = WINDOWS[COMMON];
        let common = self.test.common(&mut state.history, around);
        let other = common * CRITERIA.louder < 1.0 || (common > CRITERIA.louder && !around.told);
        state.louder = if other { state.louder + n / LOOKS } else { 0 };
        if state.louder >= n && !around.alarm && !around.young {
            self.remember(state);
            state.noise[state.here()].doubt(CRITERIA.young_s * self.rate_hz());
            state.louder = 0;
            self.renew(state);
        }
    }

    /// A line that was switched on stays one when that is out of sight.
    fn foreign(&self, state: &mut ChainState, which: usize) {
        let heard = &mut state.heard[which];
        let near = (heard.offset_hz - state.foreign_hz).abs() < SAME_LINE_HZ && state.foreign_s > 0.0;
        let grows = near && heard.power_n2 > CRITERIA.louder * state.foreign_n2;
        if heard.came {
            let before = if near { state.foreign_n2 } else { 0.0 };
            state.foreign_n2 = heard.power_n2.max(before);
        }
        if heard.came || (near && !grows && heard.stands > 1.0) {
            (state.foreign_hz, state.foreign_s) = (heard.offset_hz, CRITERIA.usual_s);
        }
        if near && !grows && heard.evidence > 0.0 {
            (heard.evidence, heard.reason) = (0.0, Reason::Foreign);
        }
    }

    pub(super) fn standing(&self, state: &ChainState) -> Heard {
        state.standing
    }

    pub(super) fn heard<'a>(&self, state: &'a ChainState) -> &'a [Heard; WINDOWS.len()] {
        &state.heard
    }

    /// What is heard from now on is something else: nothing of before counts.
    pub(super) fn begin(&self, state: &mut ChainState, in_cut: Option<bool>) {
        state.clean = 0;
        if in_cut != Some(false) {
            state.seen = 0;
        }
        state.heard = [Heard::default(); WINDOWS.len()];
        state.standing = Heard::default();
        state.scatters = false;
        if let Some(in_cut) = in_cut {
            self.remember(state);
            if in_cut != state.in_cut {
                state.noise[state.here()].settle();
            }
            state.in_cut = in_cut;
            state.orders[state.here()].doubt();
            self.renew(state);
        }
    }

    /// A line was declared: what was learned in the guard time is forgotten.
    pub(super) fn back(&self, state: &mut ChainState) {
        state.noise[state.here()].back();
    }

    /// Strongest line of the last `n` values, a window's length.
    pub(super) fn strongest(&self, state: &ChainState, n: usize, watched_hz: [f64; 2]) -> Strongest {
        self.test.strongest(state.history.last(n), (self.rate_hz(), watched_hz))
    }
}
