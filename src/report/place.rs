//! Where a mismatch sits: the residual over position, velocity, one period, travel since reversal, frequency.

use super::maps::{Bin, amplitude_density, binned, since_reversal};
use super::naming::spoken;
use super::page::{engineering, significant};
use super::plot::{Axis, Figure, Mark, escape, range_of};
use super::residual_series::{Picked, after, before};
use super::words::{in_frequency, place_of};
use crate::diagnosis::{Diagnosis, RecordingFit};
use std::fmt::Write as _;

/// How the mismatch divides between the two sides of a flexible axis.
fn sides(d: &Diagnosis, shares: Option<[f64; 3]>) -> String {
    if d.balances.len() < 2 {
        return "One position is measured, so the side is not seen, only what the force is a function of."
            .to_owned();
    }
    let Some([motor, stage, sum]) = shares.map(|of| of.map(|s| 100.0 * s)) else { return String::new() };
    format!(
        "Power of the mismatch: {motor:.0} % motor side, {stage:.0} % stage side, {sum:.0} % in their sum (which the spring \
         cannot reach)."
    )
}

/// One small picture of where the mismatch sits.
struct PlaceMap {
    title: &'static str,
    /// Domains of the location that this picture shows.
    domains: &'static [&'static str],
    note: String,
    svg: String,
}

/// The pictures of where the mismatch sits, the telling one marked.
pub(super) fn place(out: &mut String, d: &Diagnosis, p: Picked) {
    let domain = d.location.as_ref().map_or("", |l| l.domain);
    let mut maps = vec![position_map(d, p), velocity_map(d, p), frequency_map(d, p)];
    if let Some(folded) = folded_map(d, p) {
        maps.insert(0, folded);
    }
    if matches!(domain, "history" | "direction")
        || d.location.as_ref().is_some_and(|l| l.port == crate::plant::effects::Port::Coupling)
    {
        maps.insert(0, reversal_map(d, p));
    }
    out.push_str("<h2>Where it sits</h2>");
    if let Some(l) = &d.location {
        let bands: Vec<String> = l
            .bands_hz
            .iter()
            .map(|b| format!("{}\u{2013}{} Hz", significant(b[0], 3), significant(b[1], 3)))
            .collect();
        let _ = write!(
            out,
            "<p>Enters <b>{}</b>, seen over <b>{}</b>{}. {}</p>",
            escape(&place_of(l.port, d)),
            spoken(l.domain),
            if bands.is_empty() { String::new() } else { format!(", strongest in {}", bands.join(", ")) },
            sides(d, l.shares)
        );
    }
    for f in &d.findings {
        if let Some(told) = in_frequency(f) {
            let _ = write!(out, "<p>{}</p>", escape(&told));
        }
    }
    out.push_str("<div class=\"row\">");
    for map in maps {
        let here = map.domains.contains(&domain);
        let _ = write!(
            out,
            "<div class=\"card{}\"><h3>{}{}</h3><div class=\"soft small\">{}</div>{}</div>",
            if here { " here" } else { "" },
            map.title,
            if here { "<span class=\"tag\">it sits here</span>" } else { "" },
            escape(&map.note),
            map.svg
        );
    }
    out.push_str("</div>");
}

const SMALL: [f64; 2] = [340.0, 210.0];

fn binned_figure(title: &str, x: Axis, sets: Vec<(&'static str, &'static str, Vec<Bin>)>) -> String {
    let mut ends: Vec<f64> = sets
        .iter()
        .flat_map(|(_, _, b)| b.iter().flat_map(|b| [b.mean - b.spread, b.mean + b.spread]))
        .collect();
    let [low, high] = range_of(&mut ends, false);
    let y = Axis::linear("mean residual, N", [low.min(0.0), high.max(0.0)]);
    let mut marks = Vec::new();
    for (class, line, bins) in sets {
        let area = bins.iter().map(|b| [b.at, b.mean - b.spread, b.mean + b.spread]).collect();
        marks.push(Mark::Area { class, points: area });
        marks.push(Mark::Line { class: line, points: bins.iter().map(|b| [b.at, b.mean]).collect() });
    }
    Figure { size: SMALL, x, y, marks, title: title.to_owned() }.svg()
}

fn extent(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let [a, b] = values.fold([f64::INFINITY, f64::NEG_INFINITY], |e, v| [e[0].min(v), e[1].max(v)]);
    if a < b { [a, b] } else { [a - 1.0, a + 1.0] }
}

fn position_map(d: &Diagnosis, p: Picked) -> PlaceMap {
    let positions = || d.recordings.iter().flat_map(|f| f.position_m.iter().map(|x| x * 1.0e3));
    let range = extent(positions());
    let forward = |keep: f64, s: fn(&Diagnosis, &RecordingFit, usize) -> Vec<f64>| {
        let pairs = d.recordings.iter().flat_map(move |f| {
            let values = s(d, f, p.balance);
            let moving = f.velocity_m_s.iter().map(move |v| v * keep > 1.0e-4);
            let all = f.position_m.iter().zip(values).zip(moving);
            all.filter(|(_, m)| *m).map(|((x, r), _)| (x * 1.0e3, r)).collect::<Vec<_>>()
        });
        binned(pairs, range, 80)
    };
    let sets = vec![
        ("before", "before", forward(1.0, |d, f, b| before(d, f, b).to_vec())),
        ("before", "before dash", forward(-1.0, |d, f, b| before(d, f, b).to_vec())),
        ("after", "after", forward(1.0, |_, f, b| after(f, b).to_vec())),
    ];
    let svg = binned_figure("residual over position", Axis::linear("position, mm", range), sets);
    PlaceMap {
        title: "Position",
        domains: &["position"],
        note: "solid: forwards, dashed: backwards".into(),
        svg,
    }
}

fn velocity_map(d: &Diagnosis, p: Picked) -> PlaceMap {
    let fastest =
        d.recordings.iter().flat_map(|f| &f.velocity_m_s).fold(0.0_f64, |a, v| a.max(v.abs())) * 1.0e3;
    // A root scale opens the creep speeds, where friction lives.
    let root = |v: f64| v.signum() * v.abs().sqrt();
    let reach = root(fastest.max(1.0e-6));
    let velocity = move |f: &RecordingFit| f.velocity_m_s.iter().map(|v| root(v * 1.0e3)).collect::<Vec<_>>();
    let set = |values: fn(&Diagnosis, &RecordingFit, usize) -> Vec<f64>| {
        let pairs = d.recordings.iter().flat_map(|f| velocity(f).into_iter().zip(values(d, f, p.balance)));
        binned(pairs, [-reach, reach], 90)
            .into_iter()
            .map(|b| Bin { at: b.at * b.at.abs(), ..b })
            .collect::<Vec<_>>()
    };
    let sets = vec![
        ("before", "before", set(|d, f, b| before(d, f, b).to_vec())),
        ("after", "after", set(|_, f, b| after(f, b).to_vec())),
    ];
    let x = Axis::linear("velocity, mm/s", [-fastest, fastest]);
    PlaceMap {
        title: "Velocity",
        domains: &["velocity", "direction"],
        note: "bins are narrow at creep speeds".into(),
        svg: binned_figure("residual over velocity", x, sets),
    }
}

fn frequency_map(d: &Diagnosis, p: Picked) -> PlaceMap {
    let fit = &d.recordings[p.recording];
    let density = |values: &[f64]| amplitude_density(values, d.series_rate_hz, 2048.min(values.len() / 4));
    let (b, a) = (density(before(d, fit, p.balance)), density(after(fit, p.balance)));
    let top = d.residual_band_hz[1].min(0.5 * d.series_rate_hz);
    let inside = |s: &[[f64; 2]]| s.iter().copied().filter(|p| p[0] <= top).collect::<Vec<_>>();
    let (b, a) = (inside(&b), inside(&a));
    let [low, high] = extent(b.iter().chain(&a).map(|p| p[1]).filter(|v| *v > 0.0));
    let lowest = b.first().map_or(1.0, |p| p[0]).max(0.05);
    let svg = Figure {
        size: SMALL,
        x: Axis::log("frequency, Hz", [lowest, top.max(2.0 * lowest)]),
        y: Axis::log("N per root Hz", [(0.7 * low).max(1.0e-9), (1.4 * high).max(1.0e-8)]),
        marks: vec![Mark::Line { class: "before", points: b }, Mark::Line { class: "after", points: a }],
        title: "spectrum of the residual".into(),
    }
    .svg();
    PlaceMap {
        title: "Frequency",
        domains: &["frequency", "acceleration", "time"],
        note: format!("recording \u{201c}{}\u{201d}", fit.experiment),
        svg,
    }
}

/// Residual over one period, where the finding names one.
fn folded_map(d: &Diagnosis, p: Picked) -> Option<PlaceMap> {
    let lead = d.model.axis(&d.axis).and_then(|a| a.drive.screw_lead_m());
    let named = d.findings.iter().flat_map(|f| &f.parameters).find_map(|e| match e.name.as_str() {
        "wavelength_m" | "signal_period_m" => Some(e.value),
        "order_per_rev" => lead.map(|l| l / e.value),
        _ => None,
    })?;
    let period = named.abs();
    if !(period.is_finite() && period > 0.0) {
        return None;
    }
    let scale = if period < 1.0e-3 { 1.0e6 } else { 1.0e3 };
    let unit = if period < 1.0e-3 { "\u{b5}m" } else { "mm" };
    let set = |values: fn(&Diagnosis, &RecordingFit, usize) -> Vec<f64>| {
        let pairs = d.recordings.iter().flat_map(|f| {
            // Slow enough that one period holds at least four samples.
            let slow = 0.25 * period * d.series_rate_hz;
            let all = f.position_m.iter().zip(f.velocity_m_s.iter()).zip(values(d, f, p.balance));
            let kept = all.filter(move |((_, v), _)| v.abs() < slow && v.abs() > 1.0e-4);
            kept.map(|((x, _), r)| (x.rem_euclid(period) * scale, r)).collect::<Vec<_>>()
        });
        binned(pairs, [0.0, period * scale], 48)
    };
    let sets = vec![
        ("before", "before", set(|d, f, b| before(d, f, b).to_vec())),
        ("after", "after", set(|_, f, b| after(f, b).to_vec())),
    ];
    let x = Axis::linear(&format!("position within one period, {unit}"), [0.0, period * scale]);
    Some(PlaceMap {
        title: "One period",
        domains: &["position", "motor_angle"],
        note: format!("every period of {} laid over the others", engineering(period, "m", 4)),
        svg: binned_figure("residual over one period", x, sets),
    })
}

fn reversal_map(d: &Diagnosis, p: Picked) -> PlaceMap {
    // Logarithmic travel from 0.1 um to 10 mm.
    let range = [-1.0, 4.0];
    let set = |values: fn(&Diagnosis, &RecordingFit, usize) -> Vec<f64>| {
        let pairs = d.recordings.iter().flat_map(|f| {
            let travel = since_reversal(&f.position_m, &f.velocity_m_s);
            let all = travel.into_iter().zip(values(d, f, p.balance));
            all.filter(|([s, _], _)| *s > 0.0)
                .map(|([s, way], r)| ((s * 1.0e6).log10(), r * way))
                .collect::<Vec<_>>()
        });
        binned(pairs, range, 60).into_iter().map(|b| Bin { at: 10.0_f64.powf(b.at), ..b }).collect::<Vec<_>>()
    };
    let sets = vec![
        ("before", "before", set(|d, f, b| before(d, f, b).to_vec())),
        ("after", "after", set(|_, f, b| after(f, b).to_vec())),
    ];
    PlaceMap {
        title: "Travel since reversal",
        domains: &["history"],
        note: "sign turned with the direction of motion".into(),
        svg: binned_figure(
            "residual over travel since the last reversal",
            Axis::log("travel, \u{b5}m", [10.0_f64.powf(range[0]), 10.0_f64.powf(range[1])]),
            sets,
        ),
    }
}
