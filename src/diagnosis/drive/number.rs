//! Which numbers a balance has beside its laws.

/// Forms in which parts of dry friction may turn beside tanh(v / v_s), u = v / v_s: the algebraic step
/// u / (1 + u^2)^(1/2), the other smooth one in use, and one that turns later, tanh(u / 3).
///
/// Dry friction grows with speed up to its level, and nobody states in what form: F (tanh + sum w_k (step_k -
/// tanh)), w_k >= 0. The level is that of the number; a bump at low speed is none of these.
pub(super) const TURNING: [fn(f64) -> f64; 2] = [|u| u / u.hypot(1.0), |u| (u / 3.0).tanh()];

/// A number of the structure, and the two constants that encoders without a common zero and scale leave free.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::diagnosis) enum Number {
    MotorMass,
    MotorDamping,
    MotorCoulomb,
    Stiffness,
    StructuralDamping,
    /// All of the mass where there is one position.
    StageMass,
    StageDamping,
    StageCoulomb,
    /// Parts of the dry friction of motor and stage that turn over one of [`TURNING`].
    MotorTurning(usize),
    StageTurning(usize),
    /// When a reference acts.
    Timing,
    /// Bandwidth of a current loop that was found, in steps of a fiftieth.
    Lag,
    /// Zero of the stretch.
    Zero,
    /// Travel of the motor over that of the scale.
    Scale,
}

impl Number {
    /// The part of [`TURNING`] that it is.
    pub(super) fn part(self) -> Option<usize> {
        match self {
            Self::MotorTurning(part) | Self::StageTurning(part) => Some(part),
            _ => None,
        }
    }

    /// True for a level of dry friction or a part of it.
    pub(super) fn is_dry_friction(self) -> bool {
        matches!(self, Self::MotorCoulomb | Self::StageCoulomb) || self.part().is_some()
    }
}
