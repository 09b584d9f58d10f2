//! How the rows of the balance are weighted: whitened, and the stage's measured in stretch.

use super::problem::{Column, Number, Problem, Sides};
use super::whitening::{Layout, Whitener};

/// See the module.
#[derive(Debug, Clone)]
pub(crate) struct Weights {
    pub(crate) layout: Layout,
    pub(crate) whitener: Whitener,
    stretch: Option<Stretch>,
}

/// Takes the scale out of the stage balance, which has no known force to hold it.
///
/// Every term of 0 = M_t a_s + ... - K D can shrink together and leave less without fitting better: the error
/// is that of D. Minimising r_s / K instead, linearised at the present residual r_0 and stiffness K_0: the
/// column of the stiffness becomes -D + r_0 / K_0 and the known side r_0; the residual at K_0 is unchanged.
/// What a force that the model leaves out would gain by a larger K, the motor's balance, in which the spring
/// holds against the known thrust, does not grant.
#[derive(Debug, Clone)]
struct Stretch {
    /// K_0.
    stiffness_n_m: f64,
    /// r_0 / K_0, whitened.
    left_per_stiffness: Vec<f64>,
}

impl Weights {
    pub(crate) fn new(problem: &Problem, residual: &Column, whitener: Whitener) -> Self {
        let layout = problem.layout();
        let stiffness_n_m = problem.fitted_stiffness_n_m;
        let stretch = problem.numbers.iter().any(Number::is_spring).then(|| {
            let left_per_stiffness = left_per_stiffness(residual, (&whitener, &layout), stiffness_n_m);
            Stretch { stiffness_n_m, left_per_stiffness }
        });
        Self { layout, whitener, stretch }
    }

    /// The same weights for other recordings, which leave `residual`.
    pub(crate) fn beside(&self, layout: Layout, residual: &Column) -> Self {
        let stretch = self.stretch.as_ref().map(|s| Stretch {
            stiffness_n_m: s.stiffness_n_m,
            left_per_stiffness: left_per_stiffness(residual, (&self.whitener, &layout), s.stiffness_n_m),
        });
        Self { layout, whitener: self.whitener.clone(), stretch }
    }

    /// Weights a column.
    pub(crate) fn weigh(&self, column: &Column) -> Vec<f64> {
        self.whitener.whiten(column, &self.layout)
    }

    /// Weights the column of a number.
    pub(crate) fn weigh_number(&self, number: &Number) -> Vec<f64> {
        let share = if number.is_spring() { 1.0 } else { 0.0 };
        self.with_left(&number.column, share)
    }

    /// Weights the measured thrust.
    pub(crate) fn weigh_thrust(&self, thrust: &Column) -> Vec<f64> {
        self.with_left(thrust, self.stretch.as_ref().map_or(0.0, |s| s.stiffness_n_m))
    }

    fn with_left(&self, column: &Column, stiffness_n_m: f64) -> Vec<f64> {
        let mut z = self.weigh(column);
        if let Some(s) = self.stretch.as_ref().filter(|_| stiffness_n_m > 0.0) {
            z.iter_mut().zip(&s.left_per_stiffness).for_each(|(z, r)| *z += stiffness_n_m * r);
        }
        z
    }
}

/// r_0 / K_0 of the stage, whitened.
fn left_per_stiffness(
    residual: &Column,
    (whitener, layout): (&Whitener, &Layout),
    stiffness_n_m: f64,
) -> Vec<f64> {
    let stage: Column = residual.iter().map(|s| Sides { motor: None, stage: s.stage.clone() }).collect();
    let mut left = whitener.whiten(&stage, layout);
    left.iter_mut().for_each(|r| *r /= stiffness_n_m);
    left
}
