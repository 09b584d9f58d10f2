//! `report.html` of a diagnosis of the cut: for someone who turns, in two minutes.
//!
//! What is wrong with the model of the cut, and what that is worth; what to cut next; before and after on cuts
//! that nothing was fitted to; the stability map before and after; each finding with its numbers; what these
//! cuts cannot tell.

use super::cut_files::CutFiles;
use super::cut_map::maps;
use super::cut_proof::proof;
use super::cut_words::{headline, next_step, number_name, phrase, place, worth};
use super::faults::faults_box;
use super::html::{corrections, digits_for, interval_bar};
use super::naming::{spoken, without_unit};
use super::page::{SHOWN_ROWS, engineering, key, page, significant};
use super::plot::{Axis, Figure, Mark, escape, range_of};
use crate::diagnosis::Verdict;
use crate::diagnosis::cut::input::CutOutcome;
use crate::diagnosis::cut::result::{CutDiagnosis, CutFinding, CutRecordingFit, CutRowFit, FreeFit};
use std::fmt::Write as _;

/// Probability below which a rival is not worth a line.
const LEAST_SHARE: f64 = 0.01;

/// The page.
#[must_use]
pub fn cut_page(d: &CutDiagnosis, files: &CutFiles<'_>) -> String {
    let mut body = String::new();
    let _ = write!(
        body,
        "<div><span class=\"badge {0}\">{1}</span> <span class=\"soft\">{2}</span></div><h1>{3}</h1><p>{4}</p>",
        d.verdict.name(),
        spoken(d.verdict.name()),
        escape(&files.scenario),
        escape(&headline(d)),
        escape(&worth(d)),
    );
    for finding in &d.findings {
        let _ = write!(
            body,
            "<p>{} <span class=\"soft\">It acts {}.</span></p>",
            escape(&finding.statement),
            place(finding.port)
        );
    }
    faults_box(&mut body, &files.faults);
    for note in &d.notes {
        let _ = write!(body, "<p class=\"next\">{}</p>", escape(note));
    }
    if let Some(next) = next_step(d) {
        let _ = write!(body, "<h2>What to cut next</h2><div class=\"next\">{}</div>", escape(&next));
    }
    proof(&mut body, d);
    free_run(&mut body, d);
    forces(&mut body, d);
    rows(&mut body, d, files);
    maps(&mut body, d);
    for finding in &d.findings {
        finding_card(&mut body, d, finding);
    }
    let named =
        |name: &str| format!("{} <span class=\"soft\">{}</span>", escape(&number_name(name)), escape(name));
    corrections(&mut body, &d.parameter_corrections, ["scenario", "cuts"], named);
    cannot_tell(&mut body, d);
    tried(&mut body, d);
    recordings(&mut body, d, files);
    footer(&mut body, d);
    page(&format!("{}: {}", files.scenario, headline(d)), &body)
}

/// The recording where before and after differ most: what the model cannot foretell, one sample ahead.
fn forces(out: &mut String, d: &CutDiagnosis) {
    let gain = |r: &CutRecordingFit| r.rms_before_n / r.rms_after_n.max(1e-9);
    let drawn = d.recordings.iter().filter(|r| r.series.t_s.len() > 1);
    let Some(fit) = drawn.max_by(|a, b| gain(a).total_cmp(&gain(b))) else { return };
    let series = &fit.series;
    let points =
        |values: &[f64]| -> Vec<[f64; 2]> { series.t_s.iter().zip(values).map(|(t, v)| [*t, *v]).collect() };
    let span = [series.t_s[0], series.t_s[series.t_s.len() - 1]];
    let figure = |values: &[&[f64]], label: &str, marks: Vec<Mark>, title: &str| {
        let mut all: Vec<f64> = values.iter().flat_map(|v| v.iter().copied()).collect();
        Figure {
            size: [760.0, 210.0],
            x: Axis::linear("time, s", span),
            y: Axis::linear(label, range_of(&mut all, false)),
            marks,
            title: title.to_owned(),
        }
    };
    let recorded = figure(
        &[&series.force_n],
        "force of tool 1, N",
        vec![Mark::Envelope { class: "accent", points: points(&series.force_n) }],
        "recorded force",
    );
    let left = figure(
        &[&series.error_before_n, &series.error_after_n],
        "not foretold, N",
        vec![
            Mark::Envelope { class: "before", points: points(&series.error_before_n) },
            Mark::Envelope { class: "after", points: points(&series.error_after_n) },
        ],
        "force less what was foretold, before and after",
    );
    let _ = write!(
        out,
        "<h2>Before and after: recording \u{201c}{}\u{201d}</h2><div class=\"hero\"><div class=\"card\">{}{}{}{}{}</div>\
         <div class=\"card numbers\"><div class=\"before\"><div class=\"big\">{}</div>not foretold, as stated</div>\
         <div class=\"after\"><div class=\"big\">{}</div>with the answer</div><div class=\"soft small\">Root mean square of the \
         radial forces less what the model says of the next sample from all that was recorded before.</div></div></div>",
        escape(&fit.experiment),
        key("accent", "recorded"),
        key("before", "stated model"),
        key("after", "with the answer"),
        recorded.svg(),
        left.svg(),
        engineering(fit.rms_before_n, "N", 3),
        engineering(fit.rms_after_n, "N", 3),
    );
}

/// The recording that free runs of the stated model miss most, beside those of both models.
fn free_run(out: &mut String, d: &CutDiagnosis) {
    let gain = |f: &FreeFit| f.apart_db[0] - f.apart_db[1];
    let runs = d.recordings.iter().filter_map(|r| Some((r, r.free.as_ref()?)));
    let Some((fit, free)) = runs.max_by(|a, b| gain(a.1).total_cmp(&gain(b.1))) else { return };
    let area = |class: &'static str, [low, high]: &[Vec<f64>; 2]| {
        let points = free.t_s.iter().zip(low.iter().zip(high)).map(|(t, (a, b))| [*t, *a, *b]);
        Mark::Area { class, points: points.collect() }
    };
    let recorded: Vec<[f64; 2]> = free.t_s.iter().zip(&free.recorded_n).map(|(t, n)| [*t, *n]).collect();
    let all =
        || free.recorded_n.iter().chain(free.before_n.iter().flatten()).chain(free.after_n.iter().flatten());
    let range = [all().copied().fold(f64::INFINITY, f64::min), all().copied().fold(0.0, f64::max)];
    if !(range[0] > 0.0 && range[1] > range[0]) {
        return;
    }
    let figure = Figure {
        size: [760.0, 240.0],
        x: Axis::linear("time, s", [free.t_s[0], free.t_s[free.t_s.len() - 1]]),
        y: Axis::log("vibration of the forces, N rms", [0.8 * range[0], 1.25 * range[1]]),
        marks: vec![
            area("before", &free.before_n),
            area("after", &free.after_n),
            Mark::Line { class: "accent", points: recorded },
        ],
        title: "vibration of the recorded forces beside free runs of the model".to_owned(),
    };
    let _ = write!(
        out,
        "<h2>Would the model have chattered? Recording \u{201c}{}\u{201d}</h2><div class=\"hero\"><div class=\"card\">{}{}{}{}</div>\
         <div class=\"card numbers\"><div class=\"before\"><div class=\"big\">{} dB</div>off, as stated</div>\
         <div class=\"after\"><div class=\"big\">{} dB</div>off, with the answer</div><div class=\"soft small\">The model runs \
         free: it is given speed, feed, width, position and pitch, and no measured force. The areas are what its random force \
         leaves open.</div></div></div>",
        escape(&fit.experiment),
        key("accent", "recorded"),
        key("before", "stated model"),
        key("after", "with the answer"),
        figure.svg(),
        significant(free.apart_db[0], 2),
        significant(free.apart_db[1], 2),
    );
}

/// A row of the table as the page shows it.
struct Shown<'a> {
    name: &'a str,
    outcome: Option<CutOutcome>,
    condition: String,
    fit: &'a CutRowFit,
}

impl Shown<'_> {
    /// What the likelier outcome has beside what happened: wrong after, wrong before, right.
    fn order(&self) -> u8 {
        let Some(outcome) = self.outcome else { return 3 };
        let right = |p: f64| (p > 0.5) == (outcome == CutOutcome::Chatter);
        match (right(self.fit.after.chatter_probability), right(self.fit.before.chatter_probability)) {
            (false, _) => 0,
            (true, false) => 1,
            (true, true) => 2,
        }
    }
}

/// The table of cuts: foretold against what happened.
fn rows(out: &mut String, d: &CutDiagnosis, files: &CutFiles<'_>) {
    let Some(table) = files.table.filter(|_| !d.rows.is_empty()) else { return };
    let mut shown: Vec<Shown<'_>> = table
        .rows
        .iter()
        .zip(&d.rows)
        .map(|(row, fit)| Shown {
            name: &row.cut,
            outcome: row.outcome,
            condition: format!("{:.0} rpm, {:.3} mm", row.spindle_speed_rpm, 1e3 * row.width_m),
            fit,
        })
        .collect();
    shown.sort_by_key(Shown::order);
    out.push_str("<h2>Each cut foretold by fits that did not see its speed</h2>");
    growths(out, d, files);
    out.push_str(
        "<div class=\"card\"><table><tr><th>cut</th><th>condition</th><th>it was</th>\
         <th class=\"n\">chatter, stated model</th><th class=\"n\">chatter, with the answer</th><th></th></tr>",
    );
    for row in shown.iter().take(SHOWN_ROWS) {
        let verdict = ["still wrong", "was wrong, now right", "", ""][usize::from(row.order())];
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td class=\"n\">{:.0} %</td><td class=\"n\"><b>{:.0} %</b></td>\
             <td class=\"soft\">{verdict}</td></tr>",
            escape(row.name),
            row.condition,
            row.outcome.map_or("not judged", CutOutcome::name),
            100.0 * row.fit.before.chatter_probability,
            100.0 * row.fit.after.chatter_probability,
        );
    }
    let rest = shown.len().saturating_sub(SHOWN_ROWS);
    let more = if rest > 0 { format!(" {rest} more are in cuts.parquet.") } else { String::new() };
    let _ = write!(
        out,
        "</table><p class=\"small soft\">Probability of chatter; first what is foretold wrong.{more}</p></div>"
    );
}

/// Measured growth over the foretold one, before and after.
fn growths(out: &mut String, d: &CutDiagnosis, files: &CutFiles<'_>) {
    let Some(table) = files.table else { return };
    let pairs = |of: fn(&CutRowFit) -> f64| -> Vec<[f64; 2]> {
        let rows = table.rows.iter().zip(&d.rows);
        rows.filter_map(|(row, fit)| Some([of(fit), row.known.growth_1_s?]))
            .filter(|p| p[0].is_finite())
            .collect()
    };
    let (before, after) = (pairs(|f| f.before.growth_1_s), pairs(|f| f.after.growth_1_s));
    if after.len() < 4 {
        return;
    }
    let mut all: Vec<f64> = before.iter().chain(&after).flatten().copied().collect();
    let range = range_of(&mut all, false);
    let figure = Figure {
        size: [760.0, 260.0],
        x: Axis::linear("foretold growth, 1/s", range),
        y: Axis::linear("measured growth, 1/s", range),
        marks: vec![
            Mark::Line { class: "floor", points: vec![[range[0]; 2], [range[1]; 2]] },
            Mark::Dots { class: "before", points: before },
            Mark::Dots { class: "after", points: after },
        ],
        title: "measured growth over the foretold one".to_owned(),
    };
    let _ = write!(
        out,
        "<div class=\"card\">{}{}{}{}</div>",
        key("before", "stated model"),
        key("after", "with the answer, from the other speeds"),
        key("floor", "as it should be"),
        figure.svg()
    );
}

fn finding_card(out: &mut String, d: &CutDiagnosis, f: &CutFinding) {
    let _ = write!(
        out,
        "<h2>Finding {}: {}</h2><div class=\"card\"><p>The model leaves out {}.</p><div class=\"equation\">{}</div>\
         <table><tr><th>number</th><th class=\"n\">value</th><th class=\"n\">95 % interval</th><th></th></tr>",
        f.rank,
        escape(&spoken(f.effect.name())),
        escape(&phrase(f)),
        escape(&f.equation)
    );
    for e in &f.parameters {
        let digits = digits_for(e.value, e.ci95);
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"n\"><b>{}</b></td><td class=\"n\">{} \u{2026} {}</td><td>{}</td></tr>",
            escape(&without_unit(&e.name)),
            engineering(e.value, e.unit, digits),
            engineering(e.ci95[0], e.unit, digits),
            engineering(e.ci95[1], e.unit, digits),
            interval_bar(e.value, e.ci95)
        );
    }
    out.push_str("</table>");
    contribution(out, d, f);
    let _ = write!(
        out,
        "<p class=\"small soft\">Gain in log-likelihood over the model without it, all other numbers fitted anew: {} nats after \
         the price of its numbers{}.</p></div>",
        significant(f.evidence_nats, 3),
        f.fit.gain_nats.map_or(String::new(), |nats| format!(
            "; {} nats on stretches that neither model was fitted to",
            significant(nats, 3)
        ))
    );
    let rivals: Vec<_> = f.alternatives.iter().filter(|a| a.probability > LEAST_SHARE).collect();
    let _ = write!(
        out,
        "<div class=\"card\"><h3>How sure</h3><p>{} %: as said above.{}</p><table>",
        significant(100.0 * f.probability, 3),
        if rivals.is_empty() { " No other effect comes near." } else { " It could also be:" }
    );
    for a in rivals {
        let share = 100.0 * a.probability.clamp(0.0, 1.0);
        let _ = write!(
            out,
            "<tr><td>{} <span class=\"soft\">{}</span></td><td style=\"width:45%\"><div class=\"track\">\
             <div class=\"bar floor\" style=\"width:{share:.1}%\"></div></div></td><td class=\"n\">{share:.1} %</td></tr>",
            escape(&spoken(a.effect.name())),
            place(a.port),
        );
    }
    out.push_str("</table></div>");
}

/// What a finding adds, in the recording where it adds most.
fn contribution(out: &mut String, d: &CutDiagnosis, f: &CutFinding) {
    let power = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64;
    let most = f.contribution.iter().max_by(|a, b| power(&a.value).total_cmp(&power(&b.value)));
    let Some(most) = most.filter(|c| c.t_s.len() > 1) else { return };
    use crate::plant::effects::Port;
    let (label, scale) = match f.port {
        Port::Workpiece => ("adds to the bar, \u{b5}m", 1e6),
        Port::Turret => ("adds to tool 2, \u{b5}m", 1e6),
        Port::Spindle => ("adds to the angle, mrad", 1e3),
        _ => ("adds to the force, N", 1.0),
    };
    let mut values: Vec<f64> = most.value.iter().map(|v| v * scale).collect();
    let points: Vec<[f64; 2]> = most.t_s.iter().zip(&values).map(|(t, v)| [*t, *v]).collect();
    let figure = Figure {
        size: [760.0, 180.0],
        x: Axis::linear("time, s", [most.t_s[0], most.t_s[most.t_s.len() - 1]]),
        y: Axis::linear(label, range_of(&mut values, false)),
        marks: vec![Mark::Envelope { class: "after", points }],
        title: "what the finding adds".to_owned(),
    };
    let name = d.recordings.get(most.recording).map_or("", |r| r.experiment.as_str());
    let _ = write!(
        out,
        "<p class=\"small soft\">What it adds in recording \u{201c}{}\u{201d}:</p>{}",
        escape(name),
        figure.svg()
    );
}

fn cannot_tell(out: &mut String, d: &CutDiagnosis) {
    if d.not_identifiable.is_empty() {
        return;
    }
    out.push_str(
        "<h2>What these cuts cannot tell</h2><div class=\"card\"><p>Each of these may be there: at any size that matters it \
         would not have stood out.</p><table>",
    );
    for n in &d.not_identifiable {
        let _ = write!(
            out,
            "<tr><td style=\"width:30%\">{} <span class=\"soft\">{}</span></td><td class=\"small\">{}</td></tr>",
            escape(&spoken(n.effect.name())),
            place(n.port),
            escape(&n.why)
        );
    }
    out.push_str("</table></div>");
}

fn tried(out: &mut String, d: &CutDiagnosis) {
    if d.tried.is_empty() {
        return;
    }
    let most = d.tried.iter().map(|t| t.evidence_nats).fold(1.0_f64, f64::max);
    out.push_str("<h2>What was tried</h2><div class=\"card\"><table>");
    for t in d.tried.iter().take(8) {
        let (name, at) =
            t.effect.map_or(("the stated structure, numbers fitted", ""), |e| (e.name(), place(t.port)));
        let width = (100.0 * t.evidence_nats / most).clamp(0.0, 100.0);
        let _ = write!(
            out,
            "<tr><td>{} <span class=\"soft\">{at}</span></td><td style=\"width:45%\"><div class=\"track\"><div \
             class=\"bar after\" style=\"width:{width:.1}%\"></div></div></td><td class=\"n\">{:.1}</td></tr>",
            escape(&spoken(name)),
            t.evidence_nats
        );
    }
    out.push_str(
        "</table><p class=\"small soft\">Gain in log-likelihood over the stated structure, nats, less the price of the \
         numbers; each alone, the scenario's numbers fitted with it.</p></div>",
    );
}

fn recordings(out: &mut String, d: &CutDiagnosis, files: &CutFiles<'_>) {
    if d.recordings.is_empty() {
        return;
    }
    out.push_str(
        "<h2>Recordings</h2><div class=\"card\"><table><tr><th>recording</th><th>file</th>\
         <th class=\"n\">stated model, N rms</th><th class=\"n\">with the answer, N rms</th></tr>",
    );
    for (k, fit) in d.recordings.iter().enumerate() {
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"soft\">{}</td><td class=\"n before\">{}</td><td class=\"n after\">{}</td></tr>",
            escape(&fit.experiment),
            escape(files.recordings.get(k).map_or("", String::as_str)),
            significant(fit.rms_before_n, 3),
            significant(fit.rms_after_n, 3),
        );
    }
    out.push_str("</table></div>");
}

fn footer(out: &mut String, d: &CutDiagnosis) {
    let band = d.residual_band_hz.map_or(String::new(), |[low, high]| {
        format!(" Forces are compared from {} to {} Hz.", significant(low, 3), significant(high, 3))
    });
    let take = match d.verdict {
        Verdict::UnexplainedMismatch => "",
        _ => " The repaired model: scenario.toml; stability, simulate and lathe read it.",
    };
    let _ = write!(
        out,
        "<footer>The model is the linear two-delay cut with its statics; loss of contact and the flank limit belong to \
         it.{band} The same in figures: diagnosis.json.{take} Stillcut {}. This page loads nothing from outside.</footer>",
        env!("CARGO_PKG_VERSION")
    );
}
