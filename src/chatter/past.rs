//! The last part of a second of the band, kept for a second look at a line before it is declared.
//!
//! Two things are asked that no window ending now can tell:
//!
//! - Does the line repeat with the turn? Spindle orders do, whatever their number and however their
//!   amplitudes change: over one turn their phase advances by nothing. Regenerative chatter cannot, its
//!   growth needs sin(pi f/S) away from zero.
//! - Was the line there before, at another frequency? Chatter grows where it is: its frequency is a mode's,
//!   within one lobe. What comes through the band at full amplitude is driven by something else that moves,
//!   whether it still does, rests by now, or was known to rest elsewhere and is gone from there.

use crate::signal::straight_line::straight_line;
use nalgebra::Complex;
use std::f64::consts::TAU;

/// What is kept: the half second in which a feed changes, the time in which the line is heard after it, and
/// a window.
const KEPT_S: f64 = 0.8;
/// The way back of a trace and a window at its far end.
const TRACED_S: f64 = 0.6;
/// The window reaches so many tau back: 4 % of its weight is left out.
const REACH_TAUS: f64 = 5.0;
/// A line is traced back in steps of this, so far, and over no less than this.
const STEP_S: f64 = 0.02;
const STEPS: usize = 20;
const LEAST_STEPS: usize = 8;
/// From one step to the next it is looked for within three times this on both sides.
const APART_HZ: f64 = 4.0;
/// Time over which the spindle's speed is taken.
const SPEED_S: f64 = 0.1;
/// It is there while it has this share of its present amplitude.
const THERE: f64 = 0.5;
/// It moved if that is so much more than it scatters about a steady motion, and at least this.
const OVER_SCATTER: f64 = 9.0;
const LEAST_MOVE_HZ: f64 = 4.0;
/// Noise beside a weak line leads its trace no farther: the width of its window, 1 / (pi tau).
pub(super) const FAR_HZ: f64 = 13.0;
/// The windows in which a line is what it is and was what it was, so many of these in a row, and what its
/// power was at most of what it is: 10 dB.
const RISEN_TAU_S: f64 = 0.025;
const BEFORE_TAU_S: f64 = 0.0125;
const BEFORE_LOOKS: usize = 3;
const ROSE: f64 = 0.1;

/// The band and the spindle's angle, newest at `next - 1`.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Past {
    /// With the spindle's orders.
    whole: Vec<Complex<f64>>,
    /// Without them.
    values: Vec<Complex<f64>>,
    angles_turns: Vec<f64>,
    next: usize,
    seen: usize,
}

crate::keyframe::keep!(Past { whole, values, angles_turns, next, seen }
    if |s| s.next < s.values.len() && s.seen <= s.values.len());

/// A line as a window sees it: relative to the centre of the band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sight {
    pub(super) frequency_hz: f64,
    pub(super) tau_s: f64,
}

/// A steady motion: its rate, and how far it has gone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Motion {
    pub(super) moves_hz_s: f64,
    pub(super) moved_hz: f64,
}

impl Past {
    pub(super) fn new(rate_hz: f64) -> Self {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive and small")]
        let kept = (KEPT_S * rate_hz).ceil() as usize;
        let values = vec![Complex::new(0.0, 0.0); kept];
        Self { whole: values.clone(), values, angles_turns: vec![0.0; kept], next: 0, seen: 0 }
    }

    #[inline]
    pub(super) fn push(&mut self, whole: Complex<f64>, value: Complex<f64>, angle_turns: f64) {
        (self.whole[self.next], self.values[self.next]) = (whole, value);
        self.angles_turns[self.next] = angle_turns;
        self.next = if self.next + 1 == self.values.len() { 0 } else { self.next + 1 };
        self.seen = (self.seen + 1).min(self.values.len());
    }

    fn place(&self, back: usize) -> usize {
        let from = self.next + self.values.len() - 1 - back;
        if from >= self.values.len() { from - self.values.len() } else { from }
    }

    /// Complex amplitude of a line `back` samples ago; nothing where the window is not filled.
    fn amplitude(
        &self,
        series: &[Complex<f64>],
        rate_hz: f64,
        sight: Sight,
        back: usize,
    ) -> Option<Complex<f64>> {
        let taus = sight.tau_s * rate_hz;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive and small")]
        let taps = (REACH_TAUS * taus) as usize;
        if back + taps > self.seen {
            return None;
        }
        let turn = Complex::from_polar((-1.0 / taus).exp(), TAU * sight.frequency_hz / rate_hz);
        let (mut sum, mut wave) = (Complex::new(0.0, 0.0), Complex::new(1.0 / (taus * taus), 0.0));
        for m in 0..taps {
            sum += series[self.place(back + m)] * wave * (m + 1) as f64;
            wave *= turn;
        }
        Some(sum)
    }

    /// Power of a line the longest time ago that the window still fits into what is kept, N^2.
    pub(super) fn first_power(&self, rate_hz: f64, sight: Sight) -> Option<f64> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive and small")]
        let taps = (REACH_TAUS * sight.tau_s * rate_hz) as usize;
        let back = self.seen.checked_sub(taps)?;
        self.amplitude(&self.values, rate_hz, sight, back).map(|a| a.norm_sqr())
    }

    /// Power of a line over the most that it had within what is kept. Checked by:
    /// `what_rings_down_has_fallen_and_what_stands_has_not`.
    pub(super) fn share_of_most(&self, rate_hz: f64, sight: Sight) -> f64 {
        let power = |k| self.power(rate_hz, sight, k);
        let Some(now) = power(0) else { return 1.0 };
        now / (1..).map_while(power).fold(now.max(f64::MIN_POSITIVE), f64::max)
    }

    /// Power of a line so many steps ago; nothing where the window is not filled.
    fn power(&self, rate_hz: f64, sight: Sight, steps: usize) -> Option<f64> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive and small")]
        let back = (STEP_S * steps as f64 * rate_hz) as usize;
        self.amplitude(&self.values, rate_hz, sight, back).map(|a| a.norm_sqr())
    }

    /// Turns by which the phase of a line advances over one turn of the spindle, -0.5 to 0.5, and its
    /// amplitude of then over that of now. Orders, known or not: 0. Checked by:
    /// `orders_repeat_with_the_turn_and_a_line_between_does_not`.
    pub(super) fn turn_phase(&self, rate_hz: f64, centre_hz: f64, sight: Sight) -> Option<(f64, f64)> {
        let now_turns = self.angles_turns[self.place(0)];
        let back = (1..self.seen).find(|back| now_turns - self.angles_turns[self.place(*back)] >= 1.0)?;
        // Where between two samples the turn began.
        let [after, before] = [back - 1, back].map(|k| now_turns - self.angles_turns[self.place(k)]);
        let turn = (back - 1) as f64 + (1.0 - after) / (before - after).max(f64::MIN_POSITIVE);
        let (now, then) = (
            self.amplitude(&self.values, rate_hz, sight, 0)?,
            self.amplitude(&self.values, rate_hz, sight, back)?,
        );
        let shift = (centre_hz * turn - sight.frequency_hz * (back as f64 - turn)) / rate_hz;
        let phase = (now * then.conj()).arg() / TAU + shift;
        Some((phase - phase.round(), then.norm() / now.norm().max(f64::MIN_POSITIVE)))
    }

    /// How a line has moved steadily, at an amplitude that it had before; nothing where it stood,
    /// was not there, or wandered. Checked by: `a_line_that_sweeps_is_traced_and_one_that_grows_is_not`.
    pub(super) fn motion(&self, rate_hz: f64, sight: Sight, speed_hz: f64) -> Option<Motion> {
        // The notches take what crosses an order, the orders hide what is weaker than they are; where they
        // stand closer than a window tells them apart, a trace walks from one to the next.
        let trace = |series| self.trace(series, rate_hz, sight);
        trace(&self.values).or_else(|| (speed_hz > FAR_HZ).then(|| trace(&self.whole)).flatten())
    }

    /// Whether a line (relative to the centre) has risen by 10 dB within what is kept. Checked by:
    /// `what_grows_has_risen_and_what_stood_has_not`.
    pub(super) fn rose(&self, rate_hz: f64, frequency_hz: f64) -> bool {
        let power = |tau_s: f64, k: usize| self.power(rate_hz, Sight { frequency_hz, tau_s }, k);
        let Some(now) = power(RISEN_TAU_S, 0) else { return false };
        let mut before = [f64::INFINITY; BEFORE_LOOKS];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive and small")]
        let looks = ((TRACED_S - REACH_TAUS * BEFORE_TAU_S) / STEP_S) as usize;
        (1..=looks).map_while(|k| power(BEFORE_TAU_S, k)).any(|then| {
            before.rotate_left(1);
            before[BEFORE_LOOKS - 1] = then;
            before.iter().sum::<f64>() < ROSE * now * BEFORE_LOOKS as f64
        })
    }

    /// Relative change of the spindle's speed over the stretch in which a line is traced, 1/s; 0 where it is
    /// not known.
    pub(super) fn speed_change_1_s(&self, rate_hz: f64) -> f64 {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive and small")]
        let part = (SPEED_S * rate_hz) as usize;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "positive and small")]
        let seen = self.seen.min((TRACED_S * rate_hz).ceil() as usize);
        let Some(apart) = seen.checked_sub(part + 1).filter(|apart| *apart > part) else { return 0.0 };
        let turned =
            |back: usize| self.angles_turns[self.place(back)] - self.angles_turns[self.place(back + part)];
        let (now, then) = (turned(0), turned(apart));
        if now + then > 0.0 { 2.0 * (now - then) / (now + then) * rate_hz / apart as f64 } else { 0.0 }
    }

    fn trace(&self, series: &[Complex<f64>], rate_hz: f64, sight: Sight) -> Option<Motion> {
        let least = THERE * self.amplitude(series, rate_hz, sight, 0)?.norm();
        let mut places = [0.0; STEPS];
        let mut hz = sight.frequency_hz;
        let mut found = 0;
        for place in &mut places {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "within what is kept"
            )]
            let back = (STEP_S * found as f64 * rate_hz) as usize;
            let size = |k: i32| {
                let sight = Sight { frequency_hz: hz + APART_HZ * f64::from(k), ..sight };
                self.amplitude(series, rate_hz, sight, back).map_or(0.0, |a| a.norm())
            };
            let sizes: [f64; 7] = std::array::from_fn(|k| size(k as i32 - 3));
            let best = (1..6).max_by(|a, b| sizes[*a].total_cmp(&sizes[*b])).unwrap_or(3);
            if sizes[best] < least {
                break;
            }
            let [low, middle, high] = [0, 1, 2].map(|k| sizes[best + k - 1].max(f64::MIN_POSITIVE).ln());
            let bend = low - 2.0 * middle + high;
            let between = if bend < 0.0 { (0.5 * (low - high) / bend).clamp(-1.0, 1.0) } else { 0.0 };
            hz += APART_HZ * (best as f64 - 3.0 + between);
            *place = hz;
            found += 1;
        }
        moved(&places[..found])
    }
}

/// Motion over all of the places that are a step apart, newest first; or, farther than noise beside a weak
/// line leads a trace, over those before it came to rest or after it left its rest.
fn moved(places: &[f64]) -> Option<Motion> {
    let far = |places: &[f64]| steady_motion(places).filter(|motion| motion.moved_hz > FAR_HZ);
    let parts = |least| (least..places.len()).rev();
    (places.len() >= LEAST_STEPS).then(|| steady_motion(places)).flatten().or_else(|| {
        let left = parts(LEAST_STEPS).find_map(|n| far(&places[..n]));
        left.or_else(|| parts(LEAST_STEPS).find_map(|n| far(&places[places.len() - n..])))
    })
}

/// Motion through places that are a step apart, newest first, if they lie on a line that is no level one.
fn steady_motion(places: &[f64]) -> Option<Motion> {
    let n = places.len() as f64;
    let [slope, scatter] = straight_line(places);
    let moved = slope.abs() * (n - 1.0);
    (moved > LEAST_MOVE_HZ && moved > OVER_SCATTER * scatter)
        .then_some(Motion { moves_hz_s: -slope / STEP_S, moved_hz: moved })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RATE_HZ: f64 = 1000.0;
    const CENTRE_HZ: f64 = 650.0;

    /// A second of a force, mixed down, with a spindle of 20 turns a second.
    fn past(force: impl Fn(f64) -> Complex<f64>) -> Past {
        let mut past = Past::new(RATE_HZ);
        for n in 0..1000 {
            let t = f64::from(n) / RATE_HZ;
            let value = force(t) * Complex::from_polar(1.0, -TAU * CENTRE_HZ * t);
            past.push(value, value, 20.13 * t);
        }
        past
    }

    fn wave(turns: f64) -> Complex<f64> {
        Complex::from_polar(1.0, TAU * turns)
    }

    fn sight(hz: f64) -> Sight {
        Sight { frequency_hz: hz - CENTRE_HZ, tau_s: 0.025 }
    }

    #[test]
    fn orders_repeat_with_the_turn_and_a_line_between_does_not() {
        // Three orders that fade; looked at from between two of them.
        let orders =
            |t: f64| [30.0, 31.0, 33.0].iter().map(|o| wave(o * 20.13 * t)).sum::<Complex<f64>>() * (1.4 - t);
        let (phase, share) = past(orders).turn_phase(RATE_HZ, CENTRE_HZ, sight(612.0)).unwrap();
        assert!(phase.abs() < 0.02 && share > 1.0 && share < 1.3, "{phase} {share}");
        // A line at order 31.3 that grows.
        let line = |t: f64| wave(31.3 * 20.13 * t) * (10.0 * t).exp();
        let (phase, share) = past(line).turn_phase(RATE_HZ, CENTRE_HZ, sight(632.0)).unwrap();
        assert!(
            (phase - 0.3).abs() < 0.01 && (share - (-10.0f64 / 20.13).exp()).abs() < 0.02,
            "{phase} {share}"
        );
    }

    #[test]
    fn what_grows_has_risen_and_what_stood_has_not() {
        let rose = |force: &dyn Fn(f64) -> Complex<f64>| past(force).rose(RATE_HZ, 1.3);
        assert!(rose(&|t| wave(651.3 * t) * (15.0 * t).exp().min((15.0f64 * 0.9).exp())));
        assert!(!rose(&|t| wave(651.3 * t) * (1.0 + 0.3 * (30.0 * t).sin())));
    }

    #[test]
    fn what_rings_down_has_fallen_and_what_stands_has_not() {
        let share = |force: &dyn Fn(f64) -> Complex<f64>| past(force).share_of_most(RATE_HZ, sight(651.3));
        assert!(share(&|t| wave(651.3 * t) * (-8.0 * (t - 0.8).max(0.0)).exp()) < 0.5);
        assert!(share(&|t| wave(651.3 * t) * (1.0 + 0.1 * (30.0 * t).sin())) > 0.5);
        assert!(share(&|t| wave(651.3 * t) * (5.0 * t).exp()) > 0.99);
    }

    #[test]
    fn a_line_that_came_to_rest_has_moved_and_one_that_wanders_has_not() {
        let places = |from: i32, to: i32| {
            let step = move |k: i32| 2.0 * f64::from(k.clamp(from, to));
            std::array::from_fn::<f64, STEPS, _>(|k| step(k as i32))
        };
        // Newest first: at rest for eight steps after a fall, and leaving its rest ten steps ago.
        for (from, to) in [(8, 20), (0, 10)] {
            let motion = moved(&places(from, to)).unwrap();
            assert!((-105.0..-60.0).contains(&motion.moves_hz_s) && motion.moved_hz > FAR_HZ, "{motion:?}");
        }
        // Noise leads a trace by six hertz, and to and fro.
        assert_eq!(moved(&places(0, 3)), None);
        assert_eq!(moved(&std::array::from_fn::<f64, STEPS, _>(|k| 9.0 * (k as f64 * 0.8).sin())), None);
    }

    #[test]
    fn a_line_that_sweeps_is_traced_and_one_that_grows_is_not() {
        let moves = |force: &dyn Fn(f64) -> Complex<f64>, hz| {
            past(force).motion(RATE_HZ, sight(hz), 20.0).map(|m| m.moves_hz_s)
        };
        for rate in [-300.0, -40.0, 60.0, 250.0] {
            let sweep = move |t: f64| wave(650.0 * (t - 1.0) + 0.5 * rate * (t - 1.0).powi(2));
            let found = moves(&sweep, 650.0 - rate * 0.05).unwrap();
            assert!((found / rate - 1.0).abs() < 0.15, "{rate} {found}");
        }
        assert_eq!(moves(&|t| wave(651.3 * t), 651.0), None);
        assert!(past(|t| wave(651.3 * t)).speed_change_1_s(RATE_HZ).abs() < 1e-9);
        // Growth that ends in a drift of 5 Hz/s, and one that begins off its place.
        assert_eq!(moves(&|t| wave(651.3 * t + 2.5 * t * t) * (20.0 * t).exp().min(1e6), 656.0), None);
    }
}
