//! What is wrong with the recordings: `recording_faults` of `diagnosis.json`, and the first screen of a page.

use super::plot::escape;
use crate::diagnosis::{ForceFault, ForceFaultKind};
use crate::gate::{Action, Fault, FaultKind};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;

/// A fault and the file that has it.
#[derive(Debug, Clone, PartialEq)]
pub struct FaultOf {
    /// Its place among the recordings as they were handed in.
    pub of: usize,
    /// File as it was given.
    pub recording: String,
    /// What is wrong.
    pub fault: Fault,
}

impl FaultOf {
    /// A fault of the force that only the diagnosis saw.
    #[must_use]
    pub fn of_force((of, recording): (usize, String), found: &ForceFault) -> Self {
        let column = found.column.clone();
        let (kind, statement) = match found.kind {
            ForceFaultKind::MainsLine { frequency_hz, rms_n } => (
                FaultKind::MainsLine,
                format!(
                    "{column} carries a line at {frequency_hz:.2} Hz of {rms_n:.3} N (rms) that moves \
                     nothing: the mains, or something that turns; it was left out."
                ),
            ),
            ForceFaultKind::ClockOffset { late_s } => (
                FaultKind::ClockOffset,
                format!(
                    "{column} is {:.3} ms later than the motion it makes; it was moved in time.",
                    1e3 * late_s
                ),
            ),
        };
        let fault =
            Fault { column, kind, time_s: Vec::new(), share: 1.0, action: Action::Correct, statement };
        Self { of, recording, fault }
    }
}

/// Name of a file without its folder, for people.
#[must_use]
pub fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

/// Value of `recording_faults`: always a list.
#[must_use]
pub fn faults_json(faults: &[FaultOf]) -> Value {
    let one = |f: &FaultOf| {
        json!({
            "recording": f.recording,
            "column": f.fault.column,
            "fault": f.fault.kind.name(),
            "time_s": f.fault.time_s,
            "share": f.fault.share,
            "action": f.fault.action.name(),
            "statement": f.fault.statement,
        })
    };
    faults.iter().map(one).collect()
}

/// A box for the first screen of a report; nothing where nothing is wrong.
pub fn faults_box(out: &mut String, faults: &[FaultOf]) {
    /// Lines that a first screen can bear.
    const MOST: usize = 8;
    if faults.is_empty() {
        return;
    }
    out.push_str("<h2>What is wrong with the recordings</h2><div class=\"card\"><table>");
    let mut sorted: Vec<&FaultOf> = faults.iter().collect();
    sorted.sort_by_key(|f| weight(f.fault.action));
    for f in sorted.iter().take(MOST) {
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td class=\"soft\">{}</td></tr>",
            escape(&file_name(Path::new(&f.recording))),
            escape(&f.fault.statement),
            done(f.fault.action)
        );
    }
    if sorted.len() > MOST {
        let _ =
            write!(out, "<tr><td></td><td>{} more in diagnosis.json</td><td></td></tr>", sorted.len() - MOST);
    }
    out.push_str("</table></div>");
}

fn weight(action: Action) -> usize {
    match action {
        Action::Refuse => 0,
        Action::Mask => 1,
        Action::Correct => 2,
        Action::Tell => 3,
    }
}

fn done(action: Action) -> &'static str {
    match action {
        Action::Refuse => "not used",
        Action::Mask => "these rows left out",
        Action::Correct => "put right",
        Action::Tell => "left as it is",
    }
}
