//! How the rows of the balance are weighted: whitened, and the stage's measured in stretch.

use super::bench::Accepted;
use super::problem::{Column, Problem, Sides};
use super::whitening::{Layout, Whitener};
use crate::plant::effects::Port;
use crate::signal::inner_products::dot;

/// Share of the spring that is taken to be left at least.
const LEAST_STIFFNESS: f64 = 0.1;

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
/// is that of D. Minimising r_s / K instead, linearised at the present residual r_0 and stiffness K_0, leaves
/// the residual at K_0 as it is:
///
/// ```text
///   r_s K_0 / K = (t + r_0) - sum_j b_j (X_j + s_j r_0 / K_0),   K = sum_j b_j s_j
/// ```
/// s_j: slope of the force of a column over the stretch, 1 for the spring; what lies between the sides has
/// one, or a gap that takes the force from the spring would pass for a spring twice as stiff. What a force that
/// the model leaves out would gain by a larger K, the motor's balance, in which the spring holds against the
/// known thrust, does not grant.
#[derive(Debug, Clone)]
struct Stretch {
    /// The spring's force per stiffness at the stage, -D.
    spring: Column,
    /// K_0, findings included.
    stiffness_n_m: f64,
    /// r_0 / K_0, whitened.
    left_per_stiffness: Vec<f64>,
}

impl Weights {
    pub(crate) fn new(
        (problem, accepted): (&Problem, &[Accepted]),
        residual: &Column,
        whitener: Whitener,
    ) -> Self {
        let layout = problem.layout();
        let spring = problem.numbers.iter().find(|n| n.is_spring());
        let stretch =
            spring.map(|n| Stretch::new((problem, accepted), (residual, &n.column), (&whitener, &layout)));
        Self { layout, whitener, stretch }
    }

    /// Weights a column that acts at a port; `None`: no force between the sides.
    pub(crate) fn weigh(&self, column: &Column, port: Option<Port>) -> Vec<f64> {
        let mut z = self.whitener.whiten(column, &self.layout);
        if let (Some(stretch), Some(Port::Coupling)) = (&self.stretch, port) {
            stretch.add_left(&mut z, slope(column, &stretch.spring));
        }
        z
    }

    /// Weights the measured thrust.
    pub(crate) fn weigh_thrust(&self, thrust: &Column) -> Vec<f64> {
        let mut z = self.whitener.whiten(thrust, &self.layout);
        if let Some(stretch) = &self.stretch {
            stretch.add_left(&mut z, stretch.stiffness_n_m);
        }
        z
    }
}

impl Stretch {
    fn new(
        (problem, accepted): (&Problem, &[Accepted]),
        (residual, spring): (&Column, &Column),
        (whitener, layout): (&Whitener, &Layout),
    ) -> Self {
        let between = accepted.iter().filter(|a| a.hypothesis.port == Port::Coupling);
        let forces = between.flat_map(|a| a.columns.iter().zip(&a.amplitudes));
        let added: f64 = forces.map(|(column, b)| b * slope(column, spring)).sum();
        // What the findings leave of the spring; a fit on its way may leave none.
        let nominal = problem.mechanics.stiffness_n_m;
        let stiffness_n_m = (nominal + added).max(LEAST_STIFFNESS * nominal);
        let stage: Column = residual.iter().map(|s| Sides { motor: None, stage: s.stage.clone() }).collect();
        let mut left_per_stiffness = whitener.whiten(&stage, layout);
        left_per_stiffness.iter_mut().for_each(|r| *r /= stiffness_n_m);
        Self { spring: spring.clone(), stiffness_n_m, left_per_stiffness }
    }

    fn add_left(&self, z: &mut [f64], stiffness_n_m: f64) {
        z.iter_mut().zip(&self.left_per_stiffness).for_each(|(z, r)| *z += stiffness_n_m * r);
    }
}

/// Slope of a force over the stretch, as a share of the spring's: at the stage, where the spring acts alone.
fn slope(column: &Column, spring: &Column) -> f64 {
    let product = |a: &Column, b: &Column| -> f64 {
        let sides = a.iter().zip(b).filter_map(|(a, b)| Some((a.stage.as_ref()?, b.stage.as_ref()?)));
        sides.map(|(a, b)| dot(a, b)).sum()
    };
    product(column, spring) / product(spring, spring).max(f64::MIN_POSITIVE)
}
