//! Why numbers describe no cut, and the bounds within which they do.

use super::effects::EffectKind;
use thiserror::Error;

/// Why numbers do not describe a workpiece, a cut, a spindle or a tool position.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum ScenarioError {
    /// A value outside what is physical.
    #[error("{name} = {value} is not physical: {expected}")]
    NotPhysical {
        /// Key.
        name: &'static str,
        /// Value given.
        value: f64,
        /// What was expected.
        expected: &'static str,
    },
    /// An effect that is not physical, or contradicts what the scenario states.
    #[error(transparent)]
    Physics(#[from] PhysicsError),
}

/// Refuses a value outside `(low, high]` (or `[low, high]` with `low_included`).
pub(super) fn checked(name: &'static str, value: f64, rule: Rule) -> Result<f64, ScenarioError> {
    let (good, expected) = match rule {
        Rule::Positive => (value > 0.0, "a finite number above zero"),
        Rule::NotNegative => (value >= 0.0, "zero or a finite number above"),
        Rule::Fraction => ((0.0..1.0).contains(&value), "zero or above and below one"),
        Rule::Angle => ((0.0..1.5).contains(&value), "zero or above and below 1.5"),
        Rule::Power => ((0.2..=2.0).contains(&value), "a number from 0.2 to 2"),
        Rule::Finite => (true, "a finite number"),
    };
    if value.is_finite() && good {
        Ok(value)
    } else {
        Err(ScenarioError::NotPhysical { name, value, expected })
    }
}

#[derive(Debug, Clone, Copy)]
pub(super) enum Rule {
    Positive,
    NotNegative,
    Fraction,
    Angle,
    Power,
    Finite,
}

/// Effects that one scenario may carry.
pub const MOST_TERMS: usize = 8;

/// Why effects do not make a physical cut.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum PhysicsError {
    /// A number outside its physical bounds.
    #[error("{effect}: {name} = {value} is not physical: expected {low} to {high}")]
    NotPhysical {
        /// Effect.
        effect: EffectKind,
        /// Parameter.
        name: &'static str,
        /// Value given.
        value: f64,
        /// Least value.
        low: f64,
        /// Greatest value.
        high: f64,
    },
    /// The same effect twice.
    #[error("{effect} stands there twice; expected once (runout: once of each order)")]
    Twice {
        /// Effect.
        effect: EffectKind,
    },
    /// More than fit.
    #[error("more than {MOST_TERMS} effects")]
    TooMany,
    /// An effect of a part that the scenario states otherwise.
    #[error("{effect} only where the scenario says {expected}")]
    Stated {
        /// Effect.
        effect: EffectKind,
        /// What the scenario would have to say.
        expected: &'static str,
    },
}
