//! The band over the last moments: what is left of each value without the orders, and the innovations of the
//! window that is looked at.

use super::criteria::{LONGEST, MEMORY, PAST};
use super::whitening::Whitener;
use crate::keyframe::keep;
use nalgebra::Complex;

type C = Complex<f64>;
/// Values that a look may ask for.
const KEPT: usize = LONGEST + PAST + MEMORY;

/// One value of the band.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Value {
    /// Without the orders, N/sqrt(2).
    pub(super) residual: C,
    /// The orders that were taken off.
    pub(super) orders: C,
    pub(super) mixer: C,
    pub(super) angle_turns: f64,
}

keep!(Value { residual, orders, mixer, angle_turns });

/// The last values; what is long past is left out in one move.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct History {
    values: Vec<Value>,
    /// Innovations, in units of the noise.
    white: Vec<C>,
    /// The newest value ends here.
    end: usize,
    /// So many of the newest are whitened by the model at hand.
    whitened: usize,
    whitener: Whitener,
}

keep!(History { values, white, end, whitened, whitener }
    if |h| (KEPT..=2 * LONGEST).contains(&h.end) && h.whitened <= LONGEST + PAST);

impl History {
    pub(super) fn new() -> Self {
        let none = Value { residual: C::ZERO, orders: C::ZERO, mixer: C::ZERO, angle_turns: 0.0 };
        Self {
            values: vec![none; 2 * LONGEST],
            white: vec![C::ZERO; 2 * LONGEST],
            end: KEPT,
            whitened: 0,
            whitener: Whitener::plain(),
        }
    }

    pub(super) fn push(&mut self, value: Value) {
        if self.end == self.values.len() {
            self.values.copy_within(self.end - KEPT.., 0);
            self.white.copy_within(self.end - KEPT.., 0);
            self.end = KEPT;
        }
        self.values[self.end] = value;
        self.end += 1;
        // What was whitened before is one older.
        if self.whitened > 0 {
            self.white[self.end - 1] = self.innovation(self.end - 1);
            self.whitened = (self.whitened + 1).min(LONGEST + PAST);
        }
    }

    /// All that is looked at is whitened by one model.
    pub(super) fn whiten_by(&mut self, whitener: Whitener) {
        self.whitener = whitener;
        self.whitened = 0;
    }

    fn innovation(&self, at: usize) -> C {
        let r = std::array::from_fn(|m| self.values[at - m].residual);
        self.whitener.white(&r)
    }

    /// Makes innovations of the last `n` values, where there are none by the model at hand.
    pub(super) fn whiten(&mut self, n: usize) {
        for at in self.end - n.max(self.whitened)..self.end - self.whitened {
            self.white[at] = self.innovation(at);
        }
        self.whitened = self.whitened.max(n);
    }

    /// The last `n` values, oldest first.
    pub(super) fn last(&self, n: usize) -> &[Value] {
        &self.values[self.end - n..self.end]
    }

    /// Their innovations. Requires: [`Self::whiten`] of as many.
    pub(super) fn white(&self, n: usize) -> &[C] {
        debug_assert!(n <= self.whitened);
        &self.white[self.end - n..self.end]
    }

    /// Residuals of the newest values, newest first.
    pub(super) fn newest(&self) -> [C; MEMORY + 1] {
        std::array::from_fn(|m| self.values[self.end - 1 - m].residual)
    }

    /// The orders taken off, of value `q` of the last `n`, through the same filter.
    pub(super) fn white_orders(&self, n: usize, q: usize) -> C {
        let s = std::array::from_fn(|m| self.values[self.end - n + q - m].orders);
        self.whitener.white(&s)
    }
}
