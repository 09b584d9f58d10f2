//! The last samples of one signal, readable as one stretch of memory.

use super::finite_difference::{STENCIL_NODES, Stencil};

/// Samples that a [`DelayLine`] remembers.
pub const DELAY_LINE_SAMPLES: usize = 64;

/// The last [`DELAY_LINE_SAMPLES`] samples. Each is stored twice, so that any window lies in one piece.
#[derive(Debug, Clone, PartialEq)]
pub struct DelayLine {
    values: [f64; 2 * DELAY_LINE_SAMPLES],
    /// Index of the youngest sample in the first half; it moves down.
    head: usize,
}

crate::keyframe::keep!(DelayLine { values, head } if |s| s.head < DELAY_LINE_SAMPLES);

impl DelayLine {
    /// A line that has always held `value`.
    #[must_use]
    pub fn filled(value: f64) -> Self {
        Self { values: [value; 2 * DELAY_LINE_SAMPLES], head: 0 }
    }

    /// Adds the youngest sample. Cost: two stores.
    #[inline(always)]
    pub fn push(&mut self, value: f64) {
        self.head = if self.head == 0 { DELAY_LINE_SAMPLES - 1 } else { self.head - 1 };
        self.values[self.head] = value;
        self.values[self.head + DELAY_LINE_SAMPLES] = value;
    }

    /// The sample of `age` samples ago, at most [`DELAY_LINE_SAMPLES`] - 1.
    #[must_use]
    pub fn at(&self, age: usize) -> f64 {
        self.values[self.head + age.min(DELAY_LINE_SAMPLES - 1)]
    }

    /// Sum of the stencil's weights times samples. Cost: [`STENCIL_NODES`] multiplies.
    #[inline(always)]
    #[must_use]
    pub fn apply(&self, stencil: &Stencil) -> f64 {
        let start = self.head + stencil.youngest.min(DELAY_LINE_SAMPLES - STENCIL_NODES);
        let mut sum = 0.0;
        for (w, x) in stencil.weights.iter().zip(&self.values[start..start + STENCIL_NODES]) {
            sum += w * x;
        }
        sum
    }
}
