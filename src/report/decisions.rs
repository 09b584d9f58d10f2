//! `decisions.jsonl`: what was decided about the turret, one object a line, without the looks that found that
//! no interval was over.

use crate::avoidance::account::Look;
use crate::avoidance::{Command, CommandKind, Decision};
use crate::recording::{RecordingError, write_whole};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// One line of `decisions.jsonl`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DecisionLine<'a> {
    /// Time of the newest sample, on the machine's clock.
    pub t_s: Option<f64>,
    /// `move`, `renew`, `return` (commanded), `advice` or `hold`.
    pub decision: &'static str,
    /// Why nothing was commanded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<&'static str>,
    /// What was or would be commanded.
    #[serde(flatten)]
    pub command: Option<CommandLine<'a>>,
}

/// A command.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CommandLine<'a> {
    /// Start of the service that it belongs to.
    pub epoch: u64,
    /// Number within it.
    pub sequence: u64,
    /// Pitch difference that the offsets make.
    pub pitch_difference_rad: f64,
    /// Pitch difference that was wanted before limits.
    pub requested_pitch_rad: f64,
    /// Offset of each axis that has one.
    pub offsets_m: BTreeMap<&'a str, f64>,
}

impl<'a> DecisionLine<'a> {
    /// Line of a look at a turret of these axes; nothing where no decision was due.
    #[must_use]
    pub fn of(look: &Look, axes: &'a [String]) -> Option<Self> {
        let line = |decision, reason, command| Some(Self { t_s: look.t_s, decision, reason, command });
        let offsets = |command: &Command| CommandLine {
            epoch: command.epoch,
            sequence: command.sequence,
            pitch_difference_rad: command.pitch_difference_rad,
            requested_pitch_rad: command.requested_pitch_rad,
            offsets_m: axes.iter().map(String::as_str).zip(command.offsets_m).collect(),
        };
        match &look.decision {
            Decision::NotDue => None,
            Decision::Hold(reason) => line("hold", Some(reason.name()), None),
            Decision::Advice(command) => line("advice", None, Some(offsets(command))),
            Decision::Command(command) => {
                let word = match command.kind {
                    CommandKind::Move => "move",
                    CommandKind::Renew => "renew",
                    CommandKind::Return => "return",
                };
                line(word, None, Some(offsets(command)))
            }
        }
    }
}

/// Writes `decisions.jsonl`, whole or not at all. Errors: a number that JSON cannot hold, the file.
pub fn write_decisions(path: &Path, (looks, axes): (&[Look], &[String])) -> Result<(), RecordingError> {
    let mut text = String::new();
    for line in looks.iter().filter_map(|look| DecisionLine::of(look, axes)) {
        let line = serde_json::to_string(&line)
            .map_err(|e| RecordingError::Format { path: path.to_owned(), message: e.to_string() })?;
        text.push_str(&line);
        text.push('\n');
    }
    write_whole(path, text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avoidance::HoldReason;

    #[test]
    fn a_line_for_each_decision_that_was_due() {
        let axes = ["x1".to_owned(), "y1".to_owned()];
        let text = |decision| {
            let look = Look { t_s: Some(1.5), decision, ..Look::default() };
            DecisionLine::of(&look, &axes).map(|line| serde_json::to_string(&line).unwrap())
        };
        assert_eq!(text(Decision::NotDue), None);
        let hold = text(Decision::Hold(HoldReason::NoChatter)).unwrap();
        assert_eq!(hold, "{\"t_s\":1.5,\"decision\":\"hold\",\"reason\":\"no_chatter\"}");
        let command = Command { sequence: 3, offsets_m: [1e-3; 6], ..Command::default() };
        let line = text(Decision::Command(command)).unwrap();
        assert!(
            line.starts_with("{\"t_s\":1.5,\"decision\":\"return\",\"epoch\":0,\"sequence\":3,"),
            "{line}"
        );
        assert!(line.ends_with("\"offsets_m\":{\"x1\":0.001,\"y1\":0.001}}"), "{line}");
    }
}
