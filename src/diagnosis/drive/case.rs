//! What an answer is made of: the case that was selected, and what was found in it.

use super::encoders::ReadError;
use super::heldout::Named;
use super::laws::Hypothesis;
use super::state::{Balance, State};
use crate::diagnosis::criteria::Criteria;
use crate::diagnosis::result::{Contribution, Estimate};
use crate::diagnosis::selection::Round;
use crate::plant::effects::{EffectKind, PhysicsTerm};
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;

/// Everything an answer is made of.
pub(super) struct Case<'a> {
    pub(super) machine: &'a Machine,
    /// As stated, and with its terms folded into keys.
    pub(super) stated: &'a AxisModel,
    pub(super) axis: &'a AxisModel,
    /// As they came.
    pub(super) recordings: &'a [Recording],
    /// What their encoders read wrong, and the balance does not.
    pub(super) errors: &'a [ReadError],
    pub(super) balance: &'a Balance,
    /// Before anything was found.
    pub(super) start: &'a State,
    pub(super) rounds: &'a [Round<Hypothesis, State>],
    /// What was asked before, of numbers alone.
    pub(super) known: &'a [Round<Hypothesis, State>],
    pub(super) stated_rest_n: f64,
    pub(super) notes: Vec<String>,
    pub(super) out_of_budget: bool,
}

/// What was found, before it is asserted.
pub(super) struct Found {
    pub(super) estimates: Vec<Estimate>,
    pub(super) term: PhysicsTerm,
    pub(super) evidence_nats: f64,
    pub(super) level_nats: f64,
    pub(super) contribution: Vec<Contribution>,
    /// What it stands for in the state.
    pub(super) named: Named,
}

/// What drives the axis, and what of that is left, root mean squares at the motor, N.
pub(super) struct Drives {
    /// By the fit, white or not.
    pub(super) left_n: f64,
    /// By the model that is judged: where nothing is told to be wrong that is the stated one.
    pub(super) judged_n: f64,
    pub(super) thrust_n: f64,
    /// The thrust less loads that were found.
    pub(super) beside_loads_n: f64,
}

impl Drives {
    /// True where the model says less than half of what drives this axis.
    pub(super) fn is_unsaid(&self) -> bool {
        self.judged_n.powi(2) > Criteria::STANDARD.adequate_share * self.beside_loads_n.powi(2)
    }

    /// True where findings say more than the mean of a column, and leave less than drives the axis.
    pub(super) fn are_said_by(&self, found: &[Found]) -> bool {
        let mean_alone = found.iter().all(|f| f.term.effect == EffectKind::GravityLoad);
        !(mean_alone && self.is_unsaid()) && self.left_n < self.thrust_n
    }
}
