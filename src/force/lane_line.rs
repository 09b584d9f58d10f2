//! Lines of samples of several axes, and the stencils that read them.

use crate::signal::dispatch::multiply_add;
use crate::signal::finite_difference::{STENCIL_NODES, Stencil};

/// Samples of delay and stencil together that an axis may need.
pub(super) const LONGEST_AGE: usize = 64;

/// Weights of `K` outputs of all lanes over a common stretch of one line.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LaneStencils<const L: usize, const K: usize> {
    youngest: usize,
    weights: Vec<[[f64; L]; K]>,
}

impl<const L: usize, const K: usize> LaneStencils<L, K> {
    /// True when no axis has any.
    pub(super) fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    pub(super) fn new(lanes: &[Option<[Stencil; K]>]) -> Self {
        let all = || lanes.iter().flatten().flatten();
        let youngest = all().map(|s| s.youngest).min().unwrap_or(0);
        let oldest = all().map(|s| s.youngest + STENCIL_NODES).max().unwrap_or(0);
        let mut weights = vec![[[0.0; L]; K]; oldest - youngest];
        for (lane, stencils) in lanes.iter().enumerate() {
            for (k, stencil) in stencils.iter().flatten().enumerate() {
                for (j, w) in stencil.weights.iter().enumerate() {
                    weights[stencil.youngest - youngest + j][k][lane] = *w;
                }
            }
        }
        Self { youngest, weights }
    }

    /// Samples that a line must hold.
    pub(super) fn oldest(&self) -> usize {
        self.youngest + self.weights.len()
    }
}

/// A line of samples of all lanes, each stored twice.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LaneLine<const L: usize> {
    values: Vec<[f64; L]>,
    head: usize,
}

crate::keyframe::keep!(LaneLine<L> { values, head } if |s| s.head < s.values.len() / 2);

impl<const L: usize> LaneLine<L> {
    /// Of so many samples, zeros.
    pub(super) fn of(length: usize) -> Self {
        Self { values: vec![[0.0; L]; 2 * length], head: 0 }
    }

    pub(super) fn settle(&mut self, lane: usize, value: f64) {
        self.values.iter_mut().for_each(|row| row[lane] = value);
    }

    #[inline(always)]
    pub(super) fn push(&mut self, value: [f64; L]) {
        let length = self.values.len() / 2;
        self.head = if self.head == 0 { length - 1 } else { self.head - 1 };
        self.values[self.head] = value;
        self.values[self.head + length] = value;
    }

    #[inline(always)]
    pub(super) fn apply<const K: usize, const FUSED: bool>(
        &self,
        stencils: &LaneStencils<L, K>,
    ) -> [[f64; L]; K] {
        let mut sums = [[0.0; L]; K];
        let start = self.head + stencils.youngest;
        for (weights, values) in stencils.weights.iter().zip(&self.values[start..]) {
            for (sum, weights) in sums.iter_mut().zip(weights) {
                for lane in 0..L {
                    sum[lane] = multiply_add::<FUSED>(weights[lane], values[lane], sum[lane]);
                }
            }
        }
        sums
    }
}
