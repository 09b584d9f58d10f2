//! What repeats with each turn of the spindle, at its measured angle: c_k exp(j k theta) for each whole order
//! k in the band, by least mean squares.
//!
//! The gain is 1/(turn + seen): over one turn the orders are orthogonal, so that one turn sets them.

use super::criteria::CRITERIA;
use crate::keyframe::keep;
use nalgebra::Complex;
use std::f64::consts::TAU;

type C = Complex<f64>;
/// Most orders that are followed; with more in the band a line has no place between them.
pub(super) const MOST_ORDERS: usize = 128;

/// Amplitudes of the orders, N.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Orders {
    /// Of order k at k modulo their number.
    lines: Vec<C>,
    first: usize,
    count: usize,
    seen: f64,
}

keep!(Orders { lines, first, count, seen } if |s| s.count <= MOST_ORDERS && s.first < 1 << 40);

/// One value of the band.
#[derive(Debug, Clone, Copy)]
pub(super) struct Turned {
    pub(super) value: C,
    /// e^{-j w t} of the mixer.
    pub(super) mixer: C,
    pub(super) angle_turns: f64,
    pub(super) speed_hz: f64,
    pub(super) centre_hz: f64,
    pub(super) learns: bool,
}

impl Orders {
    pub(super) fn new() -> Self {
        Self { lines: vec![C::ZERO; MOST_ORDERS], first: 0, count: 0, seen: 0.0 }
    }

    /// As sure as after one turn: the cut changed.
    pub(super) fn restart(&mut self) {
        self.seen = 0.0;
    }

    /// Whether they are of this cut, as sure as their memory makes them.
    pub(super) fn known(&self) -> bool {
        self.seen >= CRITERIA.orders_s * CRITERIA.rate_hz
    }

    /// What the orders make of this value. The rest of it is learned from.
    pub(super) fn step(&mut self, at: &Turned) -> C {
        let reach_hz = CRITERIA.half_hz + CRITERIA.line_hz;
        self.follow(at.speed_hz, [at.centre_hz - reach_hz, at.centre_hz + reach_hz]);
        let turn = at.angle_turns.fract();
        let step = C::from_polar(1.0, TAU * turn);
        let first = C::from_polar(1.0, TAU * (self.first as f64 * turn).fract()) * at.mixer;
        let mut wave = first;
        let mut sum = C::ZERO;
        for k in self.first..self.first + self.count {
            sum += self.lines[k % MOST_ORDERS] * wave;
            wave *= step;
        }
        if self.count > 0 {
            let most = CRITERIA.orders_s * CRITERIA.rate_hz;
            // No chatter sits on an order: a slow notch takes nothing of it.
            let known = if at.learns { CRITERIA.rate_hz / at.speed_hz + self.seen } else { most };
            self.seen = (self.seen + 1.0).min(most);
            let gain = 1.0 / known.min(most).max(self.count as f64);
            let left = (at.value - sum) * gain;
            wave = first;
            for k in self.first..self.first + self.count {
                self.lines[k % MOST_ORDERS] += left * wave.conj();
                wave *= step;
            }
        }
        sum
    }

    fn follow(&mut self, speed_hz: f64, [low_hz, high_hz]: [f64; 2]) {
        let (low, high) = ((low_hz / speed_hz).ceil().max(1.0), (high_hz / speed_hz).floor());
        let most = MOST_ORDERS as f64;
        let (first, count) =
            if high >= low && high - low < most { (low as usize, (high - low) as usize + 1) } else { (0, 0) };
        if (first, count) == (self.first, self.count) {
            return;
        }
        let was = self.first..self.first + self.count;
        for k in (first..first + count).filter(|k| !was.contains(k)) {
            self.lines[k % MOST_ORDERS] = C::ZERO;
        }
        (self.first, self.count) = (first, count);
    }
}
