//! The proof in simulation on the page: what the models would have told the drive, beside what it was told.

use super::naming::spoken;
use super::page::{engineering, key, significant};
use super::plot::{Axis, Figure, Mark, escape, range_of};
use crate::diagnosis::{ClosedLoop, Diagnosis, SimulatedTrial};
use std::fmt::Write as _;

/// Writes the section, or why there is none.
pub(super) fn in_loop(out: &mut String, d: &Diagnosis) {
    out.push_str("<h2>In simulation</h2><div class=\"card\">");
    match &d.closed_loop {
        Ok(loops) => proof(out, d, loops),
        Err(why) => {
            let _ = write!(out, "<p class=\"small soft\">No simulation of the loop: {}.</p>", escape(why));
        }
    }
    out.push_str("</div>");
}

fn proof(out: &mut String, d: &Diagnosis, loops: &ClosedLoop) {
    let found = !d.findings.is_empty();
    if let Some(trial) = telling(loops) {
        figure(out, d, trial, found);
    }
    out.push_str(
        "<table><tr><th>recording</th><th class=\"n\">stated model</th><th class=\"n\">numbers re-estimated</th>\
         <th class=\"n\">this answer</th><th class=\"n\">stage position, this answer</th></tr>",
    );
    for t in &loops.trials {
        let word = d.recordings.get(t.recording).map_or("", |r| r.experiment.as_str());
        let _ = write!(
            out,
            "<tr><td>{}{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n after\">{}</td>\
             <td class=\"n\">{}</td></tr>",
            escape(word),
            if t.injected { " <span class=\"soft\">(with what was added to the loop)</span>" } else { "" },
            size(t.thrust_rms_n[0], "N"),
            size(t.thrust_rms_n[1], "N"),
            size(t.thrust_rms_n[2], "N"),
            size(t.stage_rms_m[2], "m"),
        );
    }
    let _ = write!(
        out,
        "</table><p class=\"small soft\">Recorded thrust less the thrust of each model in its own closed loop under the \
         recorded command, root mean square. Nothing measured is differentiated here. {} leaves {} % of the recorded reference \
         unsaid.",
        law_said(loops),
        significant(100.0 * loops.law_share, 2)
    );
    if !loops.not_simulated.is_empty() {
        let names: Vec<String> = loops.not_simulated.iter().map(|e| spoken(e.name())).collect();
        let _ = write!(out, " Not in the simulation: {}.", escape(&names.join(", ")));
    }
    out.push_str("</p>");
}

/// The law in words.
fn law_said(loops: &ClosedLoop) -> String {
    let Some(read) = loops.read else { return "The stated control law".to_owned() };
    let unit = |value: f64, unit: &str| engineering(value, unit, 3);
    format!(
        "The control law, which the model does not state, was read from the recordings (position gain {}, velocity \
         gain {}, its integral {}); it",
        unit(read.position_gain_1_s, "1/s"),
        unit(read.velocity_gain_1_s, "1/s"),
        unit(read.velocity_integral_1_s, "1/s"),
    )
}

fn size(value: f64, unit: &str) -> String {
    if value.is_finite() { engineering(value, unit, 3) } else { "ran away".to_owned() }
}

/// The recording in which the answer brings most.
fn telling(loops: &ClosedLoop) -> Option<&SimulatedTrial> {
    let gain = |t: &&SimulatedTrial| (t.thrust_rms_n[1] / t.thrust_rms_n[2].max(1.0e-12)).ln();
    loops
        .trials
        .iter()
        .filter(|t| t.thrust_rms_n.iter().all(|x| x.is_finite()))
        .max_by(|a, b| gain(a).total_cmp(&gain(b)))
}

fn figure(out: &mut String, d: &Diagnosis, t: &SimulatedTrial, found: bool) {
    let shown = if found { 1 } else { 0 };
    let [Some(before), Some(after)] = [t.thrust_error_n.get(shown), t.thrust_error_n.get(2)] else { return };
    let points = |values: &[f64]| t.t_s.iter().zip(values).map(|(t, v)| [*t, *v]).collect::<Vec<_>>();
    let x = [t.t_s.first().copied().unwrap_or(0.0), t.t_s.last().copied().unwrap_or(1.0)];
    let figure = Figure {
        size: [760.0, 220.0],
        x: Axis::linear("time, s", x),
        y: Axis::linear("thrust not simulated, N", range_of(&mut before.clone(), true)),
        marks: vec![
            Mark::Envelope { class: "before", points: points(before) },
            Mark::Envelope { class: "after", points: points(after) },
        ],
        title: "what the simulated loop gets wrong".to_owned(),
    };
    let word = d.recordings.get(t.recording).map_or("", |r| r.experiment.as_str());
    let _ = write!(
        out,
        "<p class=\"small\">Recording \u{201c}{}\u{201d}. {}{}</p>{}",
        escape(word),
        key("before", if found { "numbers re-estimated, without the finding" } else { "stated model" }),
        key("after", "this answer"),
        figure.svg()
    );
}
