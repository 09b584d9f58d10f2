//! Discrete Fourier transforms of a few hundred complex values.

use super::criteria::WINDOWS;
use nalgebra::Complex;
use rustfft::{Fft, FftPlanner};
use std::fmt;
use std::sync::Arc;

type C = Complex<f64>;
/// Points of the transforms: twice the values of the windows and more.
pub(super) const POINTS: [usize; WINDOWS.len()] = [points(0), points(1), points(2), points(3)];
/// Of the longest.
pub(super) const MOST_POINTS: usize = POINTS[POINTS.len() - 1];

const fn points(window: usize) -> usize {
    2 * WINDOWS[window].next_power_of_two()
}

/// Transforms of the lengths in [`POINTS`].
#[derive(Clone)]
pub(super) struct Fourier([Arc<dyn Fft<f64>>; POINTS.len()]);

impl Fourier {
    pub(super) fn new() -> Self {
        let mut planner = FftPlanner::new();
        Self(POINTS.map(|points| planner.plan_fft_forward(points)))
    }

    /// sum_q x_q e^{-j 2 pi k q / n} for all k, n the length of `x`. Requires: a length in [`POINTS`].
    /// Cost: no allocation.
    pub(super) fn transform(&self, x: &mut [C]) {
        let Some(plan) = self.0.iter().find(|plan| plan.len() == x.len()) else { return };
        let need = plan.get_inplace_scratch_len();
        match need {
            0 => plan.process_with_scratch(x, &mut []),
            1..=128 => plan.process_with_scratch(x, &mut [C::ZERO; 128][..need]),
            129..=256 => plan.process_with_scratch(x, &mut [C::ZERO; 256][..need]),
            _ => plan.process_with_scratch(x, &mut [C::ZERO; 2 * MOST_POINTS][..need]),
        }
    }
}

impl fmt::Debug for Fourier {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Fourier").field(&POINTS).finish()
    }
}

/// There is one.
impl PartialEq for Fourier {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}
