//! The proof of a diagnosis of the cut: what separates the answer from the stated structure with other numbers.

use super::page::{SHOWN_ROWS, engineering, significant};
use super::plot::escape;
use crate::diagnosis::cut::result::{CutDiagnosis, CutProof, ProvenLine, Sides};
use crate::stability::Root;
use std::fmt::Write as _;

/// How far three models are off the measured lines, each a median over them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Off {
    /// Of growth, 1/s.
    pub(super) growth_1_s: Sides<f64>,
    /// Of the line, Hz.
    pub(super) line_hz: Sides<f64>,
    /// How well growth is measured, 1/s.
    pub(super) deviation_1_s: f64,
    /// Lines.
    pub(super) lines: usize,
}

impl Off {
    /// Over the lines that grow; `None`: there is none.
    pub(super) fn of(proof: &CutProof) -> Option<Self> {
        let lines: Vec<&ProvenLine> = told(proof).collect();
        let median = |of: &dyn Fn(&ProvenLine) -> f64| {
            let mut values: Vec<f64> = lines.iter().map(|l| of(l)).collect();
            values.sort_by(f64::total_cmp);
            values.get(values.len() / 2).copied()
        };
        let growth = |side: fn(&Sides<Root>) -> Root| {
            median(&|l| (side(&l.foretold).growth_1_s - l.measured.growth_1_s).abs())
        };
        let line = |side: fn(&Sides<Root>) -> Root| {
            median(&|l| (side(&l.foretold).frequency_hz - l.measured.frequency_hz).abs())
        };
        let (stated, refitted, answer) =
            (|s: &Sides<Root>| s.stated, |s: &Sides<Root>| s.refitted, |s: &Sides<Root>| s.answer);
        Some(Self {
            growth_1_s: Sides {
                stated: growth(stated)?,
                refitted: growth(refitted)?,
                answer: growth(answer)?,
            },
            line_hz: Sides { stated: line(stated)?, refitted: line(refitted)?, answer: line(answer)? },
            deviation_1_s: median(&|l| l.deviation_1_s)?,
            lines: lines.len(),
        })
    }
}

/// The lines that grow, beyond doubt: what fades ends in the random vibration, which is none of the root's.
fn told(proof: &CutProof) -> impl Iterator<Item = &ProvenLine> {
    proof.lines.iter().filter(|l| l.measured.growth_1_s > 2.0 * l.deviation_1_s)
}

/// How far free runs are off the recordings, dB, over all of them: as stated, with the answer.
pub(super) fn free_off_db(d: &CutDiagnosis) -> Option<[f64; 2]> {
    let all: Vec<[f64; 2]> = d.recordings.iter().filter_map(|r| Some(r.free.as_ref()?.apart_db)).collect();
    let mean = |side: usize| (all.iter().map(|a| a[side].powi(2)).sum::<f64>() / all.len() as f64).sqrt();
    (!all.is_empty()).then(|| [mean(0), mean(1)])
}

/// A row of the comparison: what is compared, the three models, and what it means.
struct Row<'a> {
    what: &'a str,
    of: Sides<String>,
    note: String,
}

/// The three models beside each other; nothing from a table alone.
pub(super) fn proof(out: &mut String, d: &CutDiagnosis) {
    let Some(proof) = &d.proof else { return };
    let named = !d.findings.is_empty();
    let answer = |cell: String| {
        if named { format!("<td class=\"n after\"><b>{cell}</b></td>") } else { String::new() }
    };
    let header = if named { "<th class=\"n\">with the findings</th>" } else { "" };
    let _ = write!(
        out,
        "<h2>The proof: {} stretches, each foretold by fits that did not see it</h2><div class=\"card\"><table><tr><th></th>\
         <th class=\"n\">as stated</th><th class=\"n\">other numbers alone</th>{header}<th></th></tr>",
        proof.stretches
    );
    for Row { what, of, note } in compared(d, proof) {
        let _ = write!(
            out,
            "<tr><td>{what}</td><td class=\"n before\">{}</td><td class=\"n\">{}</td>{}<td class=\"small soft\">{note}</td></tr>",
            of.stated,
            of.refitted,
            answer(of.answer)
        );
    }
    out.push_str("</table></div>");
    lines(out, d, proof);
}

fn compared(d: &CutDiagnosis, proof: &CutProof) -> Vec<Row<'static>> {
    let force = |n: f64| engineering(n, "N", 3);
    let loss = &proof.loss_nats;
    let over = |nats: f64| format!("{:+.0} nats", loss.refitted - nats).replace('-', "\u{2212}");
    let mut rows = vec![Row {
        what: "the recordings are more probable by",
        of: Sides { stated: over(loss.stated), refitted: "0".to_owned(), answer: over(loss.answer) },
        note: "log-likelihood over that of the stated structure with other numbers; 5 more is e\u{2075}, 150 times, as probable"
            .to_owned(),
    }];
    if let Some(off) = Off::of(proof) {
        let [growth, line] = [
            ("growth of the vibration is off by", "1/s", off.growth_1_s, off.deviation_1_s),
            ("its frequency is off by", "Hz", off.line_hz, off.deviation_1_s / std::f64::consts::TAU),
        ]
        .map(|(what, unit, of, deviation)| Row {
            what,
            of: Sides {
                stated: engineering(of.stated, unit, 2),
                refitted: engineering(of.refitted, unit, 2),
                answer: engineering(of.answer, unit, 2),
            },
            note: match off.lines {
                1 => format!(
                    "of the one stretch in which it grows; measured to {}",
                    engineering(deviation, unit, 2)
                ),
                n => format!(
                    "middle of {n} stretches in which it grows; measured to {}",
                    engineering(deviation, unit, 2)
                ),
            },
        });
        rows.extend([growth, line]);
    }
    if let Some([stated, answer]) = free_off_db(d) {
        let db = |v: f64| format!("{} dB", significant(v, 2));
        // Without a finding the answer is the structure with other numbers.
        let refitted = if d.findings.is_empty() { db(answer) } else { "not run".to_owned() };
        rows.push(Row {
            what: "running free, vibration is off by",
            of: Sides { stated: db(stated), refitted, answer: db(answer) },
            note: "no measured force enters; whole recordings, numbers fitted to all of them".to_owned(),
        });
    }
    rows.push(Row {
        what: "of the next sample of the forces is not foretold",
        of: Sides {
            stated: force(proof.rms_n.stated),
            refitted: force(proof.rms_n.refitted),
            answer: force(proof.rms_n.answer),
        },
        note: format!(
            "root mean square; of it {} is random and foretold by no model",
            force(proof.noise_floor_n)
        ),
    });
    rows
}

/// Growth and line of each stretch, as measured and as foretold.
fn lines(out: &mut String, d: &CutDiagnosis, proof: &CutProof) {
    let mut lines: Vec<&ProvenLine> = told(proof).collect();
    if lines.is_empty() {
        return;
    }
    let off = |l: &ProvenLine| (l.foretold.stated.growth_1_s - l.measured.growth_1_s).abs() / l.deviation_1_s;
    lines.sort_by(|a, b| off(b).total_cmp(&off(a)));
    let named = !d.findings.is_empty();
    let root =
        |root: Root| format!("{:+.1} at {:.1}", root.growth_1_s, root.frequency_hz).replace('-', "\u{2212}");
    let header = if named { "<th class=\"n\">with the findings</th>" } else { "" };
    let _ = write!(
        out,
        "<div class=\"card\"><table><tr><th>stretch</th><th class=\"n\">measured, 1/s at Hz</th><th class=\"n\">as stated</th>\
         <th class=\"n\">other numbers alone</th>{header}</tr>"
    );
    for line in lines.iter().take(SHOWN_ROWS) {
        let name = d.recordings.get(line.recording).map_or("", |r| r.experiment.as_str());
        let answer = if named {
            format!("<td class=\"n after\"><b>{}</b></td>", root(line.foretold.answer))
        } else {
            String::new()
        };
        let _ = write!(
            out,
            "<tr><td>{} {:.2} to {:.2} s</td><td class=\"n\">{} <span class=\"soft\">\u{b1} {:.1}</span></td>\
             <td class=\"n before\">{}</td><td class=\"n\">{}</td>{answer}</tr>",
            escape(name),
            line.span_s[0],
            line.span_s[1],
            root(line.measured),
            line.deviation_1_s,
            root(line.foretold.stated),
            root(line.foretold.refitted),
        );
    }
    let rest = lines.len().saturating_sub(SHOWN_ROWS);
    let more = if rest > 0 { format!(" {rest} more are not shown.") } else { String::new() };
    let _ = write!(
        out,
        "</table><p class=\"small soft\">Growth and frequency of small vibration: measured from quarter turn to quarter turn, \
         without any model, beside the rightmost root of each. First what the stated model misses most.{more}</p></div>"
    );
}
