//! `report.html` of a diagnosis: for an engineer who has two minutes.
//!
//! One sentence; one picture before and after; where it sits; the numbers with their intervals; what
//! else it could be; what to record next. The page stands alone and everything in it is escaped.

use super::faults::{FaultOf, faults_box};
use super::in_loop::in_loop;
use super::naming::{parameter, spoken};
use super::page::{engineering, key, page, significant};
use super::place::place;
use super::plot::{Axis, Figure, Mark, escape, range_of};
use super::residual_series::{Picked, after, before, telling};
use super::words::{headline, next_step, phrase, place_of, sentence};
use crate::diagnosis::{Correction, Diagnosis, Finding, RecordingFit, Verdict};
use crate::signal::inner_products::rms;
use std::fmt::Write as _;

/// What the page says beside the diagnosis itself.
#[derive(Debug, Clone, Default)]
pub struct ReportContext {
    /// Name of the machine.
    pub machine: String,
    /// File of each recording, in the order they were handed in.
    pub files: Vec<String>,
    /// What is wrong with the recordings.
    pub faults: Vec<FaultOf>,
}

/// The page.
#[must_use]
pub fn diagnosis_page(diagnosis: &Diagnosis, context: &ReportContext) -> String {
    let mut body = String::new();
    header(&mut body, diagnosis, context);
    faults_box(&mut body, &context.faults);
    let next = escape(next_step(diagnosis));
    let _ = write!(body, "<h2>What to do next</h2><div class=\"next\">{next}</div>");
    let picked = telling(diagnosis);
    if let Some(picked) = picked {
        hero(&mut body, diagnosis, picked);
        place(&mut body, diagnosis, picked);
    }
    if diagnosis.no_evidence.is_some() {
        return page(&format!("{}: {}", context.machine, headline(diagnosis)), &body);
    }
    in_loop(&mut body, diagnosis);
    for finding in &diagnosis.findings {
        finding_card(&mut body, diagnosis, finding);
    }
    corrections(&mut body, &diagnosis.parameter_corrections, ["model", "recordings"], escape);
    tried(&mut body, diagnosis);
    limits(&mut body, diagnosis);
    recordings(&mut body, diagnosis, context);
    footer(&mut body, diagnosis);
    page(&format!("{}: {}", context.machine, headline(diagnosis)), &body)
}

fn header(out: &mut String, d: &Diagnosis, context: &ReportContext) {
    let (class, word) = match &d.no_evidence {
        Some(_) => ("", "no evidence".to_owned()),
        None => (d.verdict.name(), spoken(d.verdict.name())),
    };
    let axis = if d.axis.is_empty() { String::new() } else { format!(" \u{b7} axis {}", escape(&d.axis)) };
    let _ = write!(
        out,
        "<div><span class=\"badge {class}\">{word}</span> <span class=\"soft\">{}{axis}</span></div><h1>{}</h1>",
        escape(&context.machine),
        escape(&headline(d))
    );
    if let Some(why) = &d.no_evidence {
        let _ = write!(out, "<p>{}.</p>", escape(why));
    }
    for finding in &d.findings {
        let sure = likely(finding.probability);
        let _ = write!(
            out,
            "<p>{} <span class=\"soft\">Probability {sure}.</span></p>",
            escape(&finding.statement)
        );
    }
    for note in &d.notes {
        let _ = write!(out, "<p class=\"next\">{}</p>", escape(note));
    }
    if d.findings.is_empty() && d.verdict == Verdict::UnexplainedMismatch {
        out.push_str(
            "<p>No effect of the vocabulary passed the test. Where the mismatch sits is shown below; a cause is not \
             named, because none is proven.</p>",
        );
    }
}

/// A series between two times, in pieces: nothing is drawn over rows that were not measured.
fn drawn(fit: &RecordingFit, (class, values): (&'static str, &[f64]), x: [f64; 2]) -> Vec<Mark> {
    let rows: Vec<(bool, [f64; 2])> =
        fit.t_s.iter().zip(values).zip(&fit.measured).map(|((t, v), m)| (*m, [*t, *v])).collect();
    rows.split(|(measured, _)| !measured)
        .map(|piece| piece.iter().map(|(_, p)| *p).filter(|p| (x[0]..=x[1]).contains(&p[0])).collect())
        .filter(|points: &Vec<[f64; 2]>| points.len() > 1)
        .map(|points| Mark::Envelope { class, points })
        .collect()
}

fn hero(out: &mut String, d: &Diagnosis, p: Picked) {
    let fit = &d.recordings[p.recording];
    let (b, a) = (before(d, fit, p.balance), after(fit, p.balance));
    let floor = d.noise_floor_n.get(p.balance).copied().unwrap_or(0.0);
    let side = match d.balances.get(p.balance) {
        Some(side) if d.balances.len() > 1 => format!("{side} side"),
        _ => "force of the whole axis".to_owned(),
    };
    let mut both: Vec<f64> = b.to_vec();
    let y = Axis::linear("force not explained, N", range_of(&mut both, true));
    let whole = [fit.t_s.first().copied().unwrap_or(0.0), fit.t_s.last().copied().unwrap_or(1.0)];
    let zoom = densest(fit, b);
    let figure = |x: [f64; 2], size: [f64; 2], title: &str| Figure {
        size,
        x: Axis::linear("time, s", x),
        y: y.clone(),
        marks: [("before", b), ("after", a)]
            .into_iter()
            .flat_map(|of| drawn(fit, of, x))
            .chain([Mark::Band { class: "floor", y: [-2.0 * floor, 2.0 * floor] }])
            .collect(),
        title: title.to_owned(),
    };
    let (word_before, word_after) = match d.verdict {
        Verdict::ParameterError => ("stated model", "numbers corrected"),
        Verdict::ModelAdequate => ("stated model", "numbers re-estimated"),
        Verdict::UnexplainedMismatch => ("stated model", "what stays with any numbers: no effect is added"),
        Verdict::MissingPhysics => ("without the finding, numbers re-estimated", "with the finding"),
    };
    let _ = write!(
        out,
        "<h2>Before and after: {}, recording \u{201c}{}\u{201d}</h2><div class=\"hero\"><div class=\"card\">{}{}{}{}{}</div>",
        escape(&side),
        escape(&fit.experiment),
        key("before", word_before),
        key("after", word_after),
        key("floor", "noise floor (2 \u{3c3})"),
        figure(whole, [760.0, 250.0], "force not explained over the whole recording").svg(),
        figure(zoom, [760.0, 200.0], "the same, a short stretch").svg(),
    );
    let word_left = if d.verdict == Verdict::UnexplainedMismatch { "stays" } else { "after" };
    let (left, right, floor) = match d.findings.first() {
        Some(f) => (f.fit.heldout_rms_before_n, f.fit.heldout_rms_after_n, f.fit.noise_floor_n),
        None => (rms(b), rms(a), floor),
    };
    let held = match (d.verdict, d.findings.is_empty()) {
        (Verdict::UnexplainedMismatch, _) => "in this recording",
        (_, true) => "in this recording, on parts nothing was fitted to",
        (_, false) => "in all recordings, on parts nothing was fitted to",
    };
    let _ = write!(
        out,
        "<div class=\"card numbers\"><div class=\"before\"><div class=\"big\">{}</div>unexplained before</div>\
         <div class=\"after\"><div class=\"big\">{}</div>{word_left}</div><div class=\"floor\"><div class=\"big\">{}</div>\
         noise floor</div><div class=\"soft small\">Root mean square of the force balance, {} to {} Hz, {held}.</div></div></div>",
        engineering(left, "N", 3),
        engineering(right, "N", 3),
        engineering(floor, "N", 3),
        significant(d.residual_band_hz[0], 3),
        significant(d.residual_band_hz[1], 3),
    );
}

/// A twentieth of the recording (at least 0.15 s) where `values` carry most.
fn densest(fit: &RecordingFit, values: &[f64]) -> [f64; 2] {
    let n = values.len().min(fit.t_s.len());
    if n < 8 {
        return [0.0, 1.0];
    }
    let duration = fit.t_s[n - 1] - fit.t_s[0];
    let share = (0.15 / duration.max(1.0e-9)).clamp(0.05, 1.0);
    let width = ((n as f64 * share) as usize).clamp(4, n);
    let mut sum: f64 = values[..width].iter().map(|v| v * v).sum();
    let (mut best, mut start) = (sum, 0);
    for k in width..n {
        sum += values[k].powi(2) - values[k - width].powi(2);
        if sum > best {
            (best, start) = (sum, k + 1 - width);
        }
    }
    [fit.t_s[start], fit.t_s[start + width - 1]]
}

fn finding_card(out: &mut String, d: &Diagnosis, f: &Finding) {
    let _ = write!(
        out,
        "<h2>Finding {}: {} {}</h2><div class=\"card\"><h3>{}</h3><p class=\"small\"><span class=\"before\">Without it <b>{}</b></span> \
         stay unexplained, <span class=\"after\">with it <b>{}</b></span>; noise floor {}. \
         Probability <b>{}</b>.</p><div class=\"equation\">{}</div>\
         <table><tr><th>number</th><th class=\"n\">value</th><th class=\"n\">95 % interval</th><th></th></tr>",
        f.rank,
        escape(&spoken(f.effect.name())),
        escape(&place_of(f.port, d)),
        escape(&sentence(&phrase(f, d))),
        engineering(f.fit.heldout_rms_before_n, "N", 3),
        engineering(f.fit.heldout_rms_after_n, "N", 3),
        engineering(f.fit.noise_floor_n, "N", 3),
        likely(f.probability),
        escape(f.equation)
    );
    for e in &f.parameters {
        let digits = digits_for(e.value, e.ci95);
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"n\"><b>{}</b></td><td class=\"n\">{} \u{2026} {}</td><td>{}</td></tr>",
            escape(&parameter(f.effect, &e.name)),
            engineering(e.value, e.unit, digits),
            engineering(e.ci95[0], e.unit, digits),
            engineering(e.ci95[1], e.unit, digits),
            interval_bar(e.value, e.ci95)
        );
    }
    let _ = write!(
        out,
        "</table><p class=\"small soft\">Root mean squares on parts nothing was fitted to. Twice the gain in log-likelihood: {}.</p></div>",
        significant(f.evidence, 3)
    );
    alternatives(out, f);
}

/// A probability in per cent; none is certain.
fn likely(probability: f64) -> String {
    const MOST: f64 = 99.9;
    let percent = 100.0 * probability;
    if percent > MOST { format!("above {MOST} %") } else { format!("{percent:.1} %") }
}

/// Enough digits to show the interval's half width with two.
pub(super) fn digits_for(value: f64, ci95: [f64; 2]) -> usize {
    let half = 0.5 * (ci95[1] - ci95[0]).abs();
    if !(half > 0.0 && value.abs() > 0.0) {
        return 4;
    }
    ((value.abs() / half).log10().floor() + 2.0).clamp(2.0, 6.0) as usize
}

/// The interval as a small picture; its width is the share of the value that is uncertain.
pub(super) fn interval_bar(value: f64, ci95: [f64; 2]) -> String {
    let share = if value == 0.0 { 1.0 } else { 0.5 * (ci95[1] - ci95[0]).abs() / value.abs() };
    let width = (100.0 * share).clamp(2.0, 100.0);
    format!(
        "<div class=\"track\"><div class=\"bar after\" style=\"width:{width:.0}%\"></div></div>\
         <span class=\"soft small\">\u{b1} {} %</span>",
        significant(100.0 * share, 2)
    )
}

/// What else it could be, where there is anything above one per cent, and what would tell.
fn alternatives(out: &mut String, f: &Finding) {
    const LEAST: f64 = 0.01;
    let others: Vec<_> = f.alternatives.iter().filter(|a| a.probability > LEAST).collect();
    if !others.is_empty() {
        let _ = write!(
            out,
            "<h2>What else it could be</h2><div class=\"card\"><p class=\"small soft\">{}: as said above. Else:</p><table>",
            likely(f.probability)
        );
        for a in others {
            let share = 100.0 * a.probability.clamp(0.0, 1.0);
            let _ = write!(
                out,
                "<tr><td>{} <span class=\"soft\">at the {}</span></td><td style=\"width:45%\"><div class=\"track\">\
                 <div class=\"bar floor\" style=\"width:{share:.1}%\"></div></div></td><td class=\"n\">{share:.1} %</td></tr>",
                escape(&spoken(a.effect.name())),
                escape(&spoken(a.port.name())),
            );
        }
        out.push_str("</table></div>");
    }
    if let Some(next) = &f.next_experiment {
        let _ = write!(out, "<h2>What to record next</h2><div class=\"next\">{}</div>", escape(next));
    }
}

/// A table of numbers that are told to be wrong: of what, by what; `named`: how a number is called.
pub(super) fn corrections(
    out: &mut String,
    list: &[Correction],
    [of, by]: [&str; 2],
    named: impl Fn(&str) -> String,
) {
    if list.is_empty() {
        return;
    }
    let _ = write!(
        out,
        "<h2>Numbers of the {of} that the {by} contradict</h2><div class=\"card\"><table><tr><th>number</th>\
         <th class=\"n\">{of}</th><th class=\"n\">{by}</th><th class=\"n\">95 % interval</th><th class=\"n\">change</th></tr>",
    );
    for c in list {
        let digits = digits_for(c.value, c.ci95);
        let change = if c.nominal == 0.0 {
            "new".to_owned()
        } else {
            format!("{:+.1} %", 100.0 * (c.value / c.nominal - 1.0))
        };
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"n\">{}</td><td class=\"n\"><b>{}</b></td><td class=\"n\">{} \u{2026} {}</td>\
             <td class=\"n\">{}</td></tr>",
            named(&c.name),
            significant(c.nominal, digits.max(4)),
            significant(c.value, digits),
            significant(c.ci95[0], digits),
            significant(c.ci95[1], digits),
            change.replace('-', "\u{2212}")
        );
    }
    out.push_str("</table></div>");
}

fn tried(out: &mut String, d: &Diagnosis) {
    if d.tried.is_empty() {
        return;
    }
    let most = d.tried.iter().map(|t| t.evidence).fold(1.0_f64, f64::max);
    out.push_str("<h2>What was tried</h2><div class=\"card\"><table>");
    for t in d.tried.iter().take(8) {
        let name = t.effect.map_or("free competitor (no law)", |e| e.name());
        let width = (100.0 * t.evidence / most).clamp(0.0, 100.0);
        let _ = write!(
            out,
            "<tr><td>{} <span class=\"soft\">at the {}</span></td><td style=\"width:45%\"><div class=\"track\"><div \
             class=\"bar after\" style=\"width:{width:.1}%\"></div></div></td><td class=\"n\">{}</td></tr>",
            escape(&spoken(name)),
            escape(&spoken(t.port.name())),
            significant(t.evidence, 3)
        );
    }
    let rest = d.tried.len().saturating_sub(8);
    let _ = write!(
        out,
        "</table><p class=\"small soft\">Twice the gain in log-likelihood on held-out parts, each alone, the model's numbers \
         re-estimated with it.{}</p></div>",
        if rest > 0 { format!(" {rest} more gained less.") } else { String::new() }
    );
}

/// What these recordings would have shown, had it been there: the honest limit of a "nothing else".
fn limits(out: &mut String, d: &Diagnosis) {
    if d.detection_limits.is_empty() {
        return;
    }
    out.push_str(
        "<h2>What would have been seen</h2><div class=\"card\"><table><tr><th>not found</th>\
         <th class=\"n\">claimed from, N rms</th></tr>",
    );
    let mut limits: Vec<_> = d.detection_limits.iter().collect();
    limits.sort_by(|a, b| a.effect.name().cmp(b.effect.name()).then(a.force_rms_n.total_cmp(&b.force_rms_n)));
    limits.dedup_by(|a, b| a.effect == b.effect && a.port == b.port);
    for l in limits {
        let _ = write!(
            out,
            "<tr><td>{} <span class=\"soft\">at the {}</span></td><td class=\"n\">{}</td></tr>",
            escape(&spoken(l.effect.name())),
            escape(&spoken(l.port.name())),
            significant(l.force_rms_n, 2)
        );
    }
    out.push_str("</table></div>");
}

fn recordings(out: &mut String, d: &Diagnosis, context: &ReportContext) {
    out.push_str(
        "<h2>Recordings</h2><div class=\"card\"><table><tr><th>recording</th><th>file</th><th class=\"n\">stated model, N rms</th>\
         <th class=\"n\">with the answer, N rms</th><th></th></tr>",
    );
    for (k, fit) in d.recordings.iter().enumerate() {
        let share = if fit.rms_before_n > 0.0 { 100.0 * fit.rms_after_n / fit.rms_before_n } else { 100.0 };
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"soft\">{}</td><td class=\"n before\">{}</td><td class=\"n after\">{}</td>\
             <td style=\"width:22%\"><div class=\"track\"><div class=\"bar after\" style=\"width:{:.1}%\"></div></div></td></tr>",
            escape(&fit.experiment),
            escape(context.files.get(k).map_or("", String::as_str)),
            significant(fit.rms_before_n, 3),
            significant(fit.rms_after_n, 3),
            share.clamp(0.0, 100.0)
        );
    }
    out.push_str("</table></div>");
}

fn footer(out: &mut String, d: &Diagnosis) {
    let floors: Vec<String> = d
        .balances
        .iter()
        .zip(&d.noise_floor_n)
        .map(|(name, floor)| format!("{} {}", spoken(name), engineering(*floor, "N", 3)))
        .collect();
    let _ = write!(
        out,
        "<footer>Residual: recorded thrust minus the thrust that the model needs for the recorded motion, {} to {} Hz. Noise \
         floor from the encoders, the delays and the recordings themselves: {}. The same in figures: diagnosis.json; as a \
         model: model.toml. Stillcut {}. This page loads nothing from outside.</footer>",
        significant(d.residual_band_hz[0], 3),
        significant(d.residual_band_hz[1], 3),
        escape(&floors.join(", ")),
        env!("CARGO_PKG_VERSION")
    );
}
