//! What a cut has beyond its structure: up to [`MOST_TERMS`] effects, as one `Copy` value.

use super::{CutEffect, Place};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::EffectKind;
use crate::plant::scenario_error::{MOST_TERMS, PhysicsError};

/// The effects of a scenario, in their order.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Physics {
    terms: [Option<CutEffect>; MOST_TERMS],
}

impl Physics {
    /// Errors: a number that is not physical, an effect twice, more than [`MOST_TERMS`].
    pub fn new(terms: &[CutEffect]) -> Result<Self, PhysicsError> {
        terms.iter().try_fold(Self::default(), |physics, term| physics.with(*term))
    }

    /// With one more effect. Errors: as [`Physics::new`].
    pub fn with(mut self, term: CutEffect) -> Result<Self, PhysicsError> {
        let effect = term.kind();
        for (parameter, value) in term.specification().parameters.iter().zip(term.values()) {
            if !parameter.holds(value) {
                let (name, low, high) = (parameter.name, parameter.low, parameter.high);
                return Err(PhysicsError::NotPhysical { effect, name, value, low, high });
            }
        }
        let order = |t: &CutEffect| match t {
            CutEffect::Runout(runout) => runout.order.to_bits(),
            _ => 0,
        };
        if self.iter().any(|t| t.kind() == effect && order(&t) == order(&term)) {
            return Err(PhysicsError::Twice { effect });
        }
        let free = self.terms.iter_mut().find(|t| t.is_none()).ok_or(PhysicsError::TooMany)?;
        *free = Some(term);
        Ok(self)
    }

    /// Without the effects of that kind.
    #[must_use]
    pub fn without(self, kind: EffectKind) -> Self {
        let mut out = Self::default();
        for (slot, term) in out.terms.iter_mut().zip(self.iter().filter(|t| t.kind() != kind)) {
            *slot = Some(term);
        }
        out
    }

    /// The effects, in their order.
    pub fn iter(&self) -> impl Iterator<Item = CutEffect> + '_ {
        self.terms.iter().flatten().copied()
    }

    /// The first effect of that kind.
    #[must_use]
    pub fn get(&self, kind: EffectKind) -> Option<CutEffect> {
        self.iter().find(|t| t.kind() == kind)
    }

    /// True where there is nothing beyond the structure.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.terms[0].is_none()
    }

    /// The part of all of them in the mean and linear cut.
    pub(crate) fn enter(&self, place: &Place, terms: &mut CutTerms) {
        for term in self.iter() {
            term.enter(place, terms);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{EdgeForce, Runout};
    use super::*;

    #[test]
    fn twice_the_same_too_many_and_impossible_numbers_are_refused() {
        let edge = |force_n| CutEffect::EdgeForce(EdgeForce { force_n });
        let runout = |order| CutEffect::Runout(Runout { amplitude_m: 1e-5, order, phase_rad: 0.0 });
        let one = Physics::new(&[edge(5.0), runout(1.0), runout(2.0)]).unwrap();
        assert_eq!(one.iter().count(), 3);
        assert_eq!(one.with(edge(1.0)), Err(PhysicsError::Twice { effect: EffectKind::EdgeForce }));
        assert_eq!(one.with(runout(2.0)), Err(PhysicsError::Twice { effect: EffectKind::Runout }));
        assert!(Physics::new(&[edge(-5.0)]).unwrap_err().to_string().starts_with("edge_force: force_n = -5"));
        assert!(Physics::new(&[edge(f64::NAN)]).is_err());
        assert_eq!(one.without(EffectKind::Runout), Physics::new(&[edge(5.0)]).unwrap());
    }
}
