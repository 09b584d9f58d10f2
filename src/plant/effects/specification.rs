//! What a fit and a person need to know of an effect of the drive.

use super::{EffectKind, ForceLaw, PhysicsTerm, Port};
use crate::plant::drive::RawDriveParams;
use crate::units::without_unit;

/// What a parameter is to its effect.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The law is linear in it.
    Size,
    /// A constant that is fitted within its bounds.
    Constant,
    /// Anything else that a term may say: a phase, a choice, a table's spacing.
    Further,
}

/// How the sentence of a finding tells a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Spoken {
    /// By its name.
    Name,
    /// By another word.
    As(&'static str),
    /// Not at all.
    Not,
}

/// One parameter of an effect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Parameter {
    /// Name in files, with its unit.
    pub name: &'static str,
    /// Unit for people.
    pub unit: &'static str,
    /// What it is to its effect.
    pub role: Role,
    /// Between what it is fitted, or asked about.
    pub bounds: [f64; 2],
    /// What it is where nothing says it.
    pub usual: f64,
    /// How it is told.
    pub spoken: Spoken,
}

impl Parameter {
    const fn new(name: &'static str, unit: &'static str, role: Role) -> Self {
        let bounds = [f64::NEG_INFINITY, f64::INFINITY];
        Self { name, unit, role, bounds, usual: 0.0, spoken: Spoken::Name }
    }

    /// One that the law is linear in.
    pub(super) const fn size(name: &'static str, unit: &'static str) -> Self {
        Self::new(name, unit, Role::Size)
    }

    /// One that is fitted between bounds.
    pub(super) const fn constant(name: &'static str, unit: &'static str, bounds: [f64; 2]) -> Self {
        Self { bounds, ..Self::new(name, unit, Role::Constant) }
    }

    /// One that is neither.
    pub(super) const fn further(name: &'static str, unit: &'static str) -> Self {
        Self::new(name, unit, Role::Further)
    }

    /// The same with what it usually is.
    pub(super) const fn usual(self, usual: f64) -> Self {
        Self { usual, ..self }
    }

    /// The same, told by another word or not at all.
    pub(super) const fn spoken(self, spoken: Spoken) -> Self {
        Self { spoken, ..self }
    }
}

impl Parameter {
    /// How a sentence calls it; `None`: it says nothing of it.
    #[must_use]
    pub fn in_words(&self) -> Option<String> {
        match self.spoken {
            Spoken::Not => None,
            Spoken::As(word) => Some(word.to_owned()),
            Spoken::Name => Some(without_unit(self.name).replace('_', " ")),
        }
    }
}

/// Phase of the first harmonic.
pub const PHASE: Parameter = Parameter::further("phase_rad", "rad").spoken(Spoken::Not);
/// Amplitude of a force, and its harmonics: sine and cosine of each.
pub const AMPLITUDE_N: Parameter = Parameter::size("amplitude_n", "N");
/// See [`AMPLITUDE_N`].
pub const HARMONICS_N: Parameter = Parameter::size("harmonics_n", "N");
/// Not zero: the force turns with the direction.
pub const WITH_DIRECTION: Parameter = Parameter::further("with_direction", "1");

/// The force that a term states, with the screw's lead, m. `None`: a parameter is missing.
pub type ForceOf = fn(&PhysicsTerm, Option<f64>) -> Option<ForceLaw>;

/// What a fit and a person need to know of an effect.
#[derive(Debug, Clone, Copy)]
pub struct Specification {
    /// What it is.
    pub kind: EffectKind,
    /// Its parameters; the size that a correction names first.
    pub parameters: &'static [Parameter],
    /// The force of position and velocity that a term of it states.
    pub force: Option<ForceOf>,
    /// Puts a term that is a number of the drive by another name into it. `None`: a parameter is missing.
    pub key: Option<fn(&PhysicsTerm, &mut RawDriveParams) -> Option<()>>,
    /// In what the effect is a curve.
    pub domain: &'static str,
    /// Its law.
    pub equation: &'static str,
    /// What the model leaves out, for someone who builds the machine: `{name}` is the parameter of that name,
    /// `{port}` its place, `{period}` its wavelength beside the lead of the screw.
    pub phrase: fn(Port) -> &'static str,
    /// What it is mistaken for.
    pub mistaken_for: &'static [EffectKind],
    /// What to record to tell them apart.
    pub told_apart_by: &'static str,
}

impl Specification {
    /// Of an effect that is no force of position and velocity alone, no key of a drive, mistaken for none.
    pub(super) const fn new(kind: EffectKind, parameters: &'static [Parameter]) -> Self {
        Self {
            kind,
            parameters,
            force: None,
            key: None,
            domain: "time",
            equation: "",
            phrase: |_| "",
            mistaken_for: &[],
            told_apart_by: "the same motion twice, without a cut",
        }
    }

    /// The specification of an effect of the drive; `None`: an effect of the cut.
    #[must_use]
    pub fn of(kind: EffectKind) -> Option<&'static Self> {
        super::SPECIFICATIONS.iter().find(|s| s.kind == kind)
    }

    /// The parameter of that name.
    #[must_use]
    pub fn parameter(&self, name: &str) -> Option<&Parameter> {
        self.parameters.iter().find(|p| p.name == name)
    }
}
