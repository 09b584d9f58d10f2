//! What a fit says of one hypothesis.

use super::regression::Solution;
use super::shape::{Hypothesis, Shape};

/// Fit of one hypothesis.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct HypothesisFit {
    pub(crate) amplitudes: Vec<f64>,
    pub(crate) amplitude_deviations: Vec<f64>,
    /// Steps of the logarithms of the constants.
    pub(crate) steps: Vec<f64>,
    pub(crate) step_deviations: Vec<f64>,
}

impl HypothesisFit {
    /// True where no constant steps further than its law is taken to be linear.
    pub(crate) fn is_whole(&self, shape: &Shape) -> bool {
        self.steps.iter().all(|s| s.abs() <= shape.trust())
    }

    /// Amplitudes and constants that are as they are.
    pub(crate) fn exact(h: &Hypothesis, amplitudes: Vec<f64>) -> Self {
        let still = vec![0.0; h.shape.constants().len()];
        let amplitude_deviations = vec![0.0; amplitudes.len()];
        Self { amplitudes, amplitude_deviations, steps: still.clone(), step_deviations: still }
    }

    pub(super) fn of(shape: &Shape, columns: usize, (solution, first): (&Solution, usize)) -> Self {
        let free = if shape.unit() { 0 } else { columns };
        let constants = shape.constants().len();
        let (b, d) = (&solution.coefficients, &solution.deviations);
        Self {
            amplitudes: if shape.unit() { vec![1.0] } else { b[first..first + free].to_vec() },
            amplitude_deviations: if shape.unit() { vec![0.0] } else { d[first..first + free].to_vec() },
            steps: b[first + free..first + free + constants].to_vec(),
            step_deviations: d[first + free..first + free + constants].to_vec(),
        }
    }
}
