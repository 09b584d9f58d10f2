//! What the loop found, as an answer.

use super::assemble::{Answer, Case};
use super::bench::Accepted;
use super::corrections;
use super::hypothesis_fit::HypothesisFit;
use super::in_loop::{Rig, in_loop};
use super::loop_search::{self, Told};
use super::result::Finding;

impl Case<'_> {
    /// What the loop says.
    pub(super) fn of_loop(&self, told: &Told) -> Answer {
        let p = &self.outcome.state.problem;
        let given = self.outcome.state.given;
        let accepted = &self.outcome.state.accepted[given..];
        let findings = told.findings.iter().zip(accepted).map(|(f, a)| self.told(f, a)).collect();
        let corrections =
            corrections::of_loop(self.axis, &told.axis, &told.numbers, corrections::is_scaled(p));
        let mut model = self.machine.clone();
        for axis in model.axes.iter_mut().filter(|a| a.name == self.axis.name) {
            *axis = told.axis.clone();
        }
        let closed_loop = Rig::new(self.axis, self.recordings, p)
            .and_then(|rig| in_loop(&rig, (self.axis, &told.axis), self.outcome));
        Answer { unexplained: false, findings, corrections, model, closed_loop }
    }

    /// A finding of the loop; `accepted`: its law in the balance.
    fn told(&self, found: &loop_search::Finding, accepted: &Accepted) -> Finding {
        let fit = HypothesisFit::exact(&found.hypothesis, found.amplitudes.clone());
        let law = (found.term.clone(), found.parameters.clone());
        self.named(law, (&found.scores, found.left_n), self.contribution(accepted, &fit))
    }
}
