//! The page of a concealment study: how often the diagnosis notices and names, over depth.

use super::page::page;
use super::plot::{Axis, Figure, Mark, escape};
use crate::diagnosis::Verdict;
use crate::units::Z95;
use std::collections::BTreeMap;
use std::fmt::Write as _;

/// What kind of thing was hidden.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Truth {
    /// Nothing.
    Healthy,
    /// A wrong number of the model.
    WrongNumber,
    /// Something outside the vocabulary.
    Outsider,
    /// One or more effects of the vocabulary.
    Effect,
}

/// One machine and what was said about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// What was hidden.
    pub label: String,
    /// How deep.
    pub depth: f64,
    /// Seed of the machine.
    pub seed: u64,
    /// Kind.
    pub truth: Truth,
    /// Verdict.
    pub verdict: Verdict,
    /// Findings, the strongest first.
    pub said: Vec<Said>,
    /// The whole answer is right.
    pub named: bool,
    /// Something was noticed.
    pub noticed: bool,
    /// The first port is right.
    pub port_right: bool,
    /// Each reported 95 % interval of a hidden parameter.
    pub intervals: Vec<JudgedInterval>,
    /// Share of the concealed force that the contribution explains, mean square.
    pub agreement: Option<f64>,
    /// Held-out residual over noise floor after the first finding.
    pub heldout_over_floor: Option<f64>,
}

/// A finding as it was said.
#[derive(Debug, Clone, PartialEq)]
pub struct Said {
    /// Name of the effect.
    pub effect: &'static str,
    /// Name of its port.
    pub port: &'static str,
    /// Stated probability.
    pub probability: f64,
}

/// An interval that was reported, and the value that was hidden.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedInterval {
    /// Key of the parameter.
    pub name: String,
    /// Estimate, SI.
    pub value: f64,
    /// 95 % interval, SI.
    pub ci95: [f64; 2],
    /// Simulated value, SI.
    pub truth: f64,
}

impl JudgedInterval {
    /// Whether the interval holds the simulated value.
    #[must_use]
    pub fn holds(&self) -> bool {
        (self.ci95[0]..=self.ci95[1]).contains(&self.truth)
    }
}

/// All of them.
#[derive(Debug, Clone, PartialEq)]
pub struct Study {
    /// Model that machines were drawn around.
    pub model: String,
    /// In the order they were run.
    pub outcomes: Vec<Outcome>,
}

/// Counts for one thing hidden at one depth.
#[derive(Debug, Clone, PartialEq)]
pub struct Rate {
    /// What was hidden.
    pub label: String,
    /// How deep.
    pub depth: f64,
    /// Kind.
    pub truth: Truth,
    /// Machines.
    pub machines: usize,
    /// Noticed.
    pub noticed: usize,
    /// Right.
    pub named: usize,
    /// Port right.
    pub port_right: usize,
}

impl Rate {
    /// 95 % interval of the share that is right.
    #[must_use]
    pub fn named_ci95(&self) -> [f64; 2] {
        wilson(self.named, self.machines)
    }
}

/// Wilson's 95 % interval of a share.
///
/// (p + z^2/2n +- z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n), z = 1.96. Checked by:
/// tests::wilson_is_the_book_value.
#[must_use]
pub fn wilson(hits: usize, of: usize) -> [f64; 2] {
    if of == 0 {
        return [0.0, 1.0];
    }
    let (n, p) = (of as f64, hits as f64 / of as f64);
    let centre = p + Z95 * Z95 / (2.0 * n);
    let half = Z95 * (p * (1.0 - p) / n + Z95 * Z95 / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z95 * Z95 / n;
    [((centre - half) / scale).max(0.0), ((centre + half) / scale).min(1.0)]
}

impl Study {
    /// Counts by what was hidden and how deep, deepest first, in the order of the study.
    #[must_use]
    pub fn rates(&self) -> Vec<Rate> {
        let mut rates: Vec<Rate> = Vec::new();
        for o in &self.outcomes {
            let index =
                rates.iter().position(|r| r.label == o.label && r.depth == o.depth).unwrap_or_else(|| {
                    rates.push(Rate {
                        label: o.label.clone(),
                        depth: o.depth,
                        truth: o.truth,
                        machines: 0,
                        noticed: 0,
                        named: 0,
                        port_right: 0,
                    });
                    rates.len() - 1
                });
            let r = &mut rates[index];
            r.machines += 1;
            r.noticed += usize::from(o.noticed);
            r.named += usize::from(o.named);
            r.port_right += usize::from(o.port_right);
        }
        rates
    }

    fn labels(&self, truth: Truth) -> Vec<&str> {
        let mut labels: Vec<&str> = Vec::new();
        for o in self.outcomes.iter().filter(|o| o.truth == truth) {
            if !labels.contains(&o.label.as_str()) {
                labels.push(&o.label);
            }
        }
        labels
    }
}

/// The page.
#[must_use]
pub fn study_page(study: &Study) -> String {
    let mut body = String::new();
    let effects: Vec<&Outcome> = study.outcomes.iter().filter(|o| o.truth == Truth::Effect).collect();
    let healthy: Vec<&Outcome> = study.outcomes.iter().filter(|o| o.truth == Truth::Healthy).collect();
    let right = effects.iter().filter(|o| o.named).count();
    let accused = healthy.iter().filter(|o| !o.named).count();
    let _ = write!(
        body,
        "<div><span class=\"badge\">concealment study</span> <span class=\"soft\">machines drawn around {}</span></div>\
         <h1>{}</h1><p>Each machine hides something; the diagnosis sees its model and its recordings and nothing else. The \
         plant that made the recordings shares no equation with the diagnosis.</p>",
        escape(&study.model),
        headline(right, effects.len(), accused, healthy.len())
    );
    overall(&mut body, study);
    pictures(&mut body, study);
    table(&mut body, study);
    confusions(&mut body, study);
    page("Concealment study", &body)
}

fn headline(right: usize, of: usize, accused: usize, healthy: usize) -> String {
    let named = if of > 0 {
        format!("{right} of {of} concealed effects named ({:.0} %)", 100.0 * right as f64 / of as f64)
    } else {
        "No effect was concealed".to_owned()
    };
    let silent = if healthy > 0 {
        format!("; {accused} of {healthy} healthy machines accused")
    } else {
        String::new()
    };
    format!("{named}{silent}.")
}

fn overall(out: &mut String, study: &Study) {
    let rates = study.rates();
    let mut depths: Vec<f64> = rates.iter().filter(|r| r.truth == Truth::Effect).map(|r| r.depth).collect();
    depths.sort_by(|a, b| b.total_cmp(a));
    depths.dedup();
    out.push_str("<h2>In short</h2><div class=\"row\">");
    for depth in depths {
        let of: Vec<&Rate> = rates.iter().filter(|r| r.truth == Truth::Effect && r.depth == depth).collect();
        let sum = |f: fn(&Rate) -> usize| of.iter().map(|r| f(r)).sum::<usize>();
        let (named, machines) = (sum(|r| r.named), sum(|r| r.machines));
        let [low, high] = wilson(named, machines);
        let _ = write!(
            out,
            "<div class=\"card\"><div class=\"big after\">{:.0} %</div>named at depth {depth}<div class=\"soft small\">{named} of \
             {machines}; 95 %: {:.0} to {:.0} %. Noticed {:.0} %, port right {:.0} %.</div></div>",
            share(named, machines),
            100.0 * low,
            100.0 * high,
            share(sum(|r| r.noticed), machines),
            share(sum(|r| r.port_right), machines),
        );
    }
    for (truth, title) in [
        (Truth::Healthy, "healthy machines left in peace"),
        (Truth::WrongNumber, "wrong numbers called that"),
        (Truth::Outsider, "outsiders given no invented cause"),
    ] {
        let of: Vec<&Outcome> = study.outcomes.iter().filter(|o| o.truth == truth).collect();
        if of.is_empty() {
            continue;
        }
        let good = of.iter().filter(|o| o.named || (truth == Truth::Outsider && o.said.is_empty())).count();
        let [low, high] = wilson(good, of.len());
        let _ = write!(
            out,
            "<div class=\"card\"><div class=\"big\">{:.0} %</div>{title}<div class=\"soft small\">{good} of {}; 95 %: {:.0} to \
             {:.0} %.</div></div>",
            share(good, of.len()),
            of.len(),
            100.0 * low,
            100.0 * high
        );
    }
    let (covered, intervals) = study
        .outcomes
        .iter()
        .flat_map(|o| &o.intervals)
        .fold((0, 0), |(c, n), i| (c + usize::from(i.holds()), n + 1));
    if intervals > 0 {
        let _ = write!(
            out,
            "<div class=\"card\"><div class=\"big\">{:.0} %</div>of the 95 % intervals hold the true value<div class=\"soft \
             small\">{covered} of {intervals}.</div></div>",
            share(covered, intervals)
        );
    }
    let mut agreements: Vec<f64> = study.outcomes.iter().filter_map(|o| o.agreement).collect();
    agreements.sort_by(f64::total_cmp);
    if let Some(median) = agreements.get(agreements.len() / 2) {
        let _ = write!(
            out,
            "<div class=\"card\"><div class=\"big\">{median:.2}</div>median R\u{b2} between what a finding adds and the concealed \
             force<div class=\"soft small\">{} findings at force ports.</div></div>",
            agreements.len()
        );
    }
    out.push_str("</div>");
}

fn share(part: usize, of: usize) -> f64 {
    100.0 * part as f64 / of.max(1) as f64
}

fn pictures(out: &mut String, study: &Study) {
    let rates = study.rates();
    out.push_str(
        "<h2>Over depth</h2><p><span class=\"key\"><i class=\"after\"></i>named</span><span class=\"key\"><i \
         class=\"floor\"></i>noticed</span><span class=\"soft small\">shaded: 95 % interval of the named share</span></p><div \
         class=\"row\">",
    );
    for label in study.labels(Truth::Effect) {
        let mut of: Vec<&Rate> = rates.iter().filter(|r| r.label == label).collect();
        of.sort_by(|a, b| a.depth.total_cmp(&b.depth));
        let (low, high) = (of[0].depth, of[of.len() - 1].depth);
        let named = |r: &&Rate| [r.depth, share(r.named, r.machines)];
        let noticed = |r: &&Rate| [r.depth, share(r.noticed, r.machines)];
        let band = |r: &&Rate| [r.depth, 100.0 * r.named_ci95()[0], 100.0 * r.named_ci95()[1]];
        let figure = Figure {
            size: [340.0, 190.0],
            x: Axis::log("depth", [0.8 * low, 1.25 * high]),
            y: Axis::linear("%", [-3.0, 105.0]),
            marks: vec![
                Mark::Area { class: "after", points: of.iter().map(band).collect() },
                Mark::Line { class: "floor dash", points: of.iter().map(noticed).collect() },
                Mark::Dots { class: "floor", points: of.iter().map(noticed).collect() },
                Mark::Line { class: "after", points: of.iter().map(named).collect() },
                Mark::Dots { class: "after", points: of.iter().map(named).collect() },
            ],
            title: format!("{label}: share named and noticed over depth"),
        };
        let _ = write!(
            out,
            "<div class=\"card\"><h3>{}</h3>{}</div>",
            escape(&label.replace('_', " ")),
            figure.svg()
        );
    }
    out.push_str("</div>");
}

fn table(out: &mut String, study: &Study) {
    out.push_str(
        "<h2>Counts</h2><div class=\"card\"><table><tr><th>hidden</th><th class=\"n\">depth</th><th class=\"n\">machines</th>\
         <th class=\"n\">noticed</th><th class=\"n\">right</th><th class=\"n\">port right</th></tr>",
    );
    for r in study.rates() {
        let _ = write!(
            out,
            "<tr><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\">{}</td><td class=\"n\"><b>{}</b></td>\
             <td class=\"n\">{}</td></tr>",
            escape(&r.label),
            r.depth,
            r.machines,
            r.noticed,
            r.named,
            r.port_right
        );
    }
    out.push_str("</table></div>");
}

/// What was said where the answer was wrong.
fn confusions(out: &mut String, study: &Study) {
    let mut wrong: BTreeMap<(String, String), usize> = BTreeMap::new();
    for o in study.outcomes.iter().filter(|o| !o.named) {
        let findings: Vec<String> = o.said.iter().map(|s| format!("{} at {}", s.effect, s.port)).collect();
        let said = if findings.is_empty() { o.verdict.name().to_owned() } else { findings.join(" + ") };
        *wrong.entry((format!("{} at depth {}", o.label, o.depth), said)).or_insert(0) += 1;
    }
    if wrong.is_empty() {
        return;
    }
    out.push_str(
        "<h2>Where it was wrong</h2><div class=\"card\"><table><tr><th>hidden</th><th>said</th><th class=\"n\">times</th></tr>",
    );
    for ((hidden, said), times) in wrong {
        let _ = write!(
            out,
            "<tr><td>{}</td><td>{}</td><td class=\"n\">{times}</td></tr>",
            escape(&hidden),
            escape(&said)
        );
    }
    out.push_str("</table></div>");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wilson_is_the_book_value() {
        // Newcombe 1998, table I: 81 of 263 gives 0.2553 to 0.3662.
        let [low, high] = wilson(81, 263);
        assert!((low - 0.2553).abs() < 5.0e-5 && (high - 0.3662).abs() < 5.0e-5, "{low} {high}");
        assert_eq!(wilson(0, 0), [0.0, 1.0]);
    }

    fn outcome(label: &str, depth: f64, named: bool) -> Outcome {
        Outcome {
            label: label.into(),
            depth,
            seed: 1,
            truth: if label == "healthy" { Truth::Healthy } else { Truth::Effect },
            verdict: if named { Verdict::MissingPhysics } else { Verdict::ModelAdequate },
            said: Vec::new(),
            named,
            noticed: named,
            port_right: named,
            intervals: vec![JudgedInterval {
                name: "gap_m".into(),
                value: 1.0,
                ci95: [0.9, 1.1],
                truth: 1.05,
            }],
            agreement: Some(0.97),
            heldout_over_floor: Some(1.02),
        }
    }

    #[test]
    fn the_page_counts_what_was_right() {
        let outcomes = vec![
            outcome("backlash", 1.0, true),
            outcome("backlash", 1.0, false),
            outcome("backlash", 0.1, false),
            outcome("healthy", 1.0, true),
        ];
        let study = Study { model: "bench".into(), outcomes };
        assert_eq!(study.rates()[0].named, 1);
        let page = study_page(&study);
        assert!(page.contains("1 of 3 concealed effects named (33 %); 0 of 1 healthy machines accused."));
        assert!(page.contains("backlash at depth 0.1"));
    }
}
