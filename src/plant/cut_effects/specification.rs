//! What a fit and a person need to know of an effect of the cut.

use crate::plant::cut_terms::CutReferences;
use crate::plant::effects::{EffectKind, Port};

/// What a parameter is to its effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The number by which the effect is known.
    Key,
    /// How large it is, where the key is not.
    Size,
    /// Its shape: frequency, phase, damping.
    Shape,
    /// A whole number that is chosen, not fitted.
    Choice,
}

/// One parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name in files, with its unit.
    pub name: &'static str,
    /// Unit for people.
    pub unit: &'static str,
    /// Least value that is physical.
    pub low: f64,
    /// Greatest value that is physical.
    pub high: f64,
    /// Value at which the effect vanishes (infinite for a stiffness or radius); NaN: none of itself.
    pub neutral: f64,
    /// Order of magnitude on machines.
    pub scale: f64,
    /// What it is to its effect.
    pub role: Role,
}

impl Parameter {
    /// True for a value within the physical bounds. Infinite is within where it means "nothing".
    #[must_use]
    pub fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value) && (value.is_finite() || self.neutral.is_infinite())
    }

    /// The value as a size with 0 at nothing: 1/x where infinite is nothing, the distance from neutral else.
    #[must_use]
    pub fn size_of(&self, value: f64) -> f64 {
        if self.neutral.is_infinite() {
            1.0 / value
        } else if self.neutral.is_nan() {
            value
        } else {
            value - self.neutral
        }
    }

    /// The value of a size; the inverse of [`Parameter::size_of`].
    #[must_use]
    pub fn of_size(&self, size: f64) -> f64 {
        if self.neutral.is_infinite() {
            1.0 / size
        } else if self.neutral.is_nan() {
            size
        } else {
            size + self.neutral
        }
    }
}

/// A parameter that says what the key says, in other units.
#[derive(Debug, Clone, Copy)]
pub struct Equivalent {
    /// Name in files.
    pub name: &'static str,
    /// Unit for people.
    pub unit: &'static str,
    /// Its value for a key.
    pub from_key: fn(f64, &CutReferences) -> f64,
    /// The key for its value; `None`: it says nothing of the key.
    pub to_key: Option<fn(f64, &CutReferences) -> f64>,
}

/// What a fit and a person need to know of an effect.
#[derive(Debug, Clone, Copy)]
pub struct Specification {
    /// What it is.
    pub kind: EffectKind,
    /// Where it enters.
    pub port: Port,
    /// Its numbers, the key first.
    pub parameters: &'static [Parameter],
    /// Others that say the same as the key.
    pub equivalents: &'static [Equivalent],
    /// One sentence.
    pub statement: &'static str,
    /// Its law.
    pub equation: &'static str,
    /// What it is mistaken for.
    pub mistaken_for: &'static [EffectKind],
    /// The cut that tells them apart.
    pub told_apart_by: &'static str,
}

impl Specification {
    /// The specification of that kind of effect; `None`: no effect of the cut.
    #[must_use]
    pub fn of(kind: EffectKind) -> Option<&'static Self> {
        super::CutEffect::SPECIFICATIONS.iter().find(|s| s.kind == kind)
    }

    /// The parameter of that name.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&Parameter> {
        self.parameters.iter().find(|p| p.name == name)
    }
}
