//! How long ago the surface that a tool meets was left.

use super::CutTrial;
use std::f64::consts::{PI, TAU};

/// Samples since the place that each tool meets was passed, by sample of a trial.
pub(super) struct Course {
    /// Of what tool 1 meets and of what tool 2 meets, samples.
    pub(super) since: [Vec<f64>; 2],
}

impl Course {
    /// Two tools: each meets what the other left, half a turn and half the difference of pitch ago; tool 1
    /// stands where the pitch has it at either time. `one`: it meets its own, a turn ago.
    pub(super) fn new(trial: &CutTrial, one: bool) -> Self {
        let turned = &trial.turned_rad;
        let shift = |k: usize| trial.pitch_difference_rad.get(k).copied().unwrap_or(0.0) / 2.0;
        // Angle of the material under tool 1, and under tool 2 with half a turn added.
        let under_1: Vec<f64> = turned.iter().enumerate().map(|(k, a)| a - shift(k)).collect();
        if one {
            return Self { since: [passed(turned, turned, TAU), Vec::new()] };
        }
        Self { since: [passed(&under_1, turned, PI), passed(turned, &under_1, PI)] }
    }

    /// The longest of them, samples.
    pub(super) fn longest(&self) -> f64 {
        self.since.iter().flatten().copied().fold(1.0, f64::max)
    }
}

/// For each sample: how many samples before it `other` was where `own` is now, less `apart`.
fn passed(own: &[f64], other: &[f64], apart: f64) -> Vec<f64> {
    let last = other.len() - 1;
    let first_rate = if last > 0 { (other[1] - other[0]).max(1e-9) } else { 1.0 };
    let mut at = 0;
    let since = |(k, own): (usize, &f64)| {
        let wanted = own - apart;
        if wanted <= other[0] || last == 0 {
            return k as f64 + (other[0] - wanted) / first_rate;
        }
        while at + 1 < last && other[at + 1] <= wanted {
            at += 1;
        }
        let step = (other[at + 1] - other[at]).max(1e-12);
        // At least a step ago: what is cut now is not yet there.
        (k as f64 - at as f64 - (wanted - other[at]) / step).max(1.0)
    };
    own.iter().enumerate().map(since).collect()
}
