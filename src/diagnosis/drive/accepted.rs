//! A law that stands in the model of a balance.

use super::columns::{DIFFERENCE, Ground, TimeColumn};
use super::laws::Hypothesis;
use super::number::Number;
use crate::plant::effects::law::ForceLaw;

/// A law in the model.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Accepted {
    pub(super) hypothesis: Hypothesis,
    /// Its amplitudes.
    pub(super) amplitudes: Vec<f64>,
    /// Its place among the physics that the model states; `None`: found.
    pub(super) given: Option<usize>,
    /// A force that the model states, evaluated as it stands there.
    pub(super) stated: Option<ForceLaw>,
    /// Part of itself that the last fit has it at, for a law that enters as one column.
    pub(super) scale: f64,
}

/// Amplitudes from which on a law enters further fits as one column, its form kept.
const MOST_FREE: usize = 8;

impl Accepted {
    /// What was found.
    pub(super) fn found(hypothesis: Hypothesis, amplitudes: Vec<f64>) -> Self {
        Self { hypothesis, amplitudes, given: None, stated: None, scale: 1.0 }
    }

    /// True where it enters as one column.
    pub(super) fn is_one_column(&self) -> bool {
        self.given.is_some() || self.amplitudes.len() > MOST_FREE
    }

    /// True for a law that is made of numbers of the structure, all of its size in its shape.
    pub(super) fn moves_with_numbers(&self) -> bool {
        self.given.is_none() && self.hypothesis.facts().moves_with_numbers
    }

    /// Coefficients that it has in a fit.
    pub(super) fn coefficients(&self) -> usize {
        if self.is_one_column() { 1 } else { self.amplitudes.len() }
    }

    /// Its force with the amplitudes that it has.
    pub(super) fn sum(&self, ground: &Ground<'_>) -> TimeColumn {
        TimeColumn::sum(self.hypothesis.columns(ground).iter().zip(self.amplitudes.iter().copied()))
    }

    /// Its columns in a fit.
    pub(super) fn columns(&self, ground: &Ground<'_>) -> Vec<TimeColumn> {
        let all = match &self.stated {
            Some(law) => vec![ground.stated(law, self.hypothesis.port)],
            None => self.hypothesis.columns(ground),
        };
        if !self.is_one_column() {
            return all;
        }
        vec![TimeColumn::sum(all.iter().zip(self.amplitudes.iter().copied()))]
    }
}

/// What a law that is made of numbers of the structure becomes more with each of them: number, its value,
/// derivative. Together with the numbers' own columns a fit moves both at once.
pub(super) fn moved_laws(ground: &Ground<'_>, accepted: &[Accepted]) -> Vec<(Number, f64, TimeColumn)> {
    let laws = || accepted.iter().filter(|a| a.moves_with_numbers());
    let columns = |ground: &Ground<'_>| laws().flat_map(|l| l.columns(ground)).collect::<Vec<_>>();
    if laws().next().is_none() {
        return Vec::new();
    }
    let here = columns(ground);
    let of = |number: Number| -> Option<(Number, f64, TimeColumn)> {
        let mut there = *ground;
        let value = there.mechanics.of_mut(number)?;
        let (now, by) = (*value, DIFFERENCE * *value);
        *value += by;
        let there = columns(&there);
        let parts = here.iter().map(|c| (c, -1.0 / by)).chain(there.iter().map(|c| (c, 1.0 / by)));
        (by != 0.0).then(|| (number, now, TimeColumn::sum(parts)))
    };
    [Number::MotorMass, Number::Stiffness, Number::StructuralDamping, Number::Zero]
        .into_iter()
        .filter_map(of)
        .collect()
}
