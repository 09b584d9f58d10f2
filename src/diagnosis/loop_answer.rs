//! What the loop found, as an answer.

use super::assemble::{Answer, Case, next_experiment, probabilities};
use super::bench::{Accepted, HypothesisFit};
use super::corrections;
use super::in_loop::{Rig, in_loop};
use super::loop_search::{self, Told};
use super::result::{Finding, Fit};
use super::terms;

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
        let (probability, alternatives) = probabilities(&found.scores);
        let (effect, port) = (found.hypothesis.effect, found.hypothesis.port);
        let floor: f64 = self.spectra.iter().map(|s| s.floor_rms_n(f64::MAX).powi(2)).sum::<f64>().sqrt();
        let [before_n, after_n] = found.left_n;
        let fit = HypothesisFit::exact(&found.hypothesis, found.amplitudes.clone());
        Finding {
            rank: 0,
            effect,
            port,
            statement: terms::statement(effect, port, &found.parameters),
            equation: terms::equation(effect),
            parameters: found.parameters.clone(),
            maps: Vec::new(),
            fit: Fit { heldout_rms_before_n: before_n, heldout_rms_after_n: after_n, noise_floor_n: floor },
            probability,
            next_experiment: next_experiment(&alternatives),
            alternatives,
            contribution: self.contribution(accepted, &fit),
            term: found.term.clone(),
            evidence: found.scores.first().map_or(0.0, |s| s.evidence),
        }
    }
}
