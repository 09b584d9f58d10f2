//! What an answer is made of: the case that was selected, and what was found in it.

use super::heldout::Named;
use super::laws::Hypothesis;
use super::state::{Balance, State};
use crate::diagnosis::result::{Contribution, Estimate};
use crate::diagnosis::selection::Round;
use crate::plant::effects::PhysicsTerm;
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;

/// Everything an answer is made of.
pub(super) struct Case<'a> {
    pub(super) machine: &'a Machine,
    /// As stated, and with its terms folded into keys.
    pub(super) stated: &'a AxisModel,
    pub(super) axis: &'a AxisModel,
    pub(super) recordings: &'a [Recording],
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
