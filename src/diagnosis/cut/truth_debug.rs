use super::fit::{Problem, Quadratic};
use super::machine::Number;
use super::observable::{Every, Part};
use super::search::Model;
use std::collections::BTreeMap;
pub(super) fn show(problem: &Problem<'_>, start: &Model) {
    let Ok(path) = std::env::var("STILLCUT_TRUTH") else { return };
    let Ok(truth) = crate::config::scenario::read_scenario(std::path::Path::new(&path)) else { return };
    let frame = problem.frame;
    let mut point = start.point.clone();
    point.terms.clear();
    let mut fitted = start.point.clone();
    let scales = &frame.scales;
    for effect in truth.physics.iter() {
        use crate::plant::cut_effects::CutEffect as E;
        use super::laws::{Law, Term};
        let (law, x) = match effect {
            E::ForceLag(l) => (Law::Lag, l.time_constant_s / 5e-5),
            E::ToolDifference(d) => (Law::Difference, (d.ratio - 1.0) / 0.15),
            E::ModeDrift(d) => (Law::Drift, d.hz_per_s / (0.004 * scales.frequency_hz)),
            E::SpeedDependentForce(d) => (Law::Speed, d.exponent / 0.12),
            E::NonlinearCuttingForce(d) => (Law::Exponent, (d.exponent - 1.0) / 0.25),
            _ => continue,
        };
        point.terms.push(Term { law, values: vec![x] });
    }
    fitted.terms.retain(|t| point.terms.iter().any(|p| p.law == t.law));
    if fitted.terms.len() != point.terms.len() { fitted = point.clone(); }
    let start = problem.fit(&fitted, &super::fit::Effort::FULL).map_or(start.clone(), |e| Model { point: e.point, value: e.value });
    for (k, n) in frame.numbers.iter().enumerate() {
        if matches!(n, Number::Pitch) { point.numbers[k] = 0.0; } else if let (Some((_, a)), Some((_, b))) = (n.stated(&frame.stated, 0.0), n.stated(&truth, 0.0)) {
            point.numbers[k] = (b[0] / a[0]).ln() / n.log_sd();
        }
        if matches!(n, Number::Late | Number::SignalLate | Number::SignalBandwidth) {
            point.numbers[k] = 0.0;
        }
    }
    let noise: Vec<usize> = (0..frame.numbers.len())
        .filter(|k| !frame.numbers[*k].is_stated() && !matches!(frame.numbers[*k], Number::Late | Number::SignalLate | Number::SignalBandwidth))
        .collect();
    for _ in 0..6 {
        let Some(q) = problem.quadratic(&point, Every(1)) else { return };
        let h = nalgebra::DMatrix::from_fn(noise.len(), noise.len(), |a, b| q.information[(noise[a], noise[b])]);
        let g = nalgebra::DVector::from_fn(noise.len(), |a, _| -q.gradient[noise[a]]);
        let Some(s) = h.lu().solve(&g) else { return };
        for (a, k) in noise.iter().enumerate() { point.numbers[*k] += s[a].clamp(-1.0, 1.0); }
    }
    let at = problem.quadratic(&point, Every(1)).map_or(f64::NAN, |q| q.value);
    println!("truth {at:.1} fitted {:.1}  excess {:.1}", start.value, at - start.value);
    let Some(q) = problem.quadratic(&start.point, Every(1)) else { return };
    let cov = q.information.clone().try_inverse();
    for (k, n) in frame.numbers.iter().enumerate() {
        let sd = cov.as_ref().map_or(f64::NAN, |c| c[(k, k)].sqrt());
        println!("  {n:?}: truth {:.3} fitted {:.3} sd {sd:.3} z {:.1}", point.numbers[k], start.point.numbers[k], (start.point.numbers[k] - point.numbers[k]) / sd);
    }
    let Some((steps, parts)) = problem.jacobian(&point, Every(1)) else { return };
    let mut sums: BTreeMap<String, Vec<(f64, f64)>> = BTreeMap::new();
    for (o, p) in problem.observables.iter().zip(&parts) {
        let moved: Vec<&Part> = p[1..].iter().collect();
        let q = Quadratic::of_part(&p[0], &moved, &steps);
        let origin = o.origin();
        let line: Vec<String> = (0..steps.len()).map(|k| format!("{:+.1}", -q.gradient[k] / q.information[(k, k)].max(1e-12).sqrt())).collect();
        let mut pw = (0.0, 0.0); let mut near = (0.0, 0.0);
        if let Part::Bins { channels, bins } = &p[0] { for b in bins { if let Some(l) = super::fit::cholesky(&b.s, *channels) { let v: f64 = super::fit::forward(&l, &b.x, *channels)[..*channels].iter().map(|u| u.norm_sqr()).sum(); pw.0 += v; pw.1 += *channels as f64; let f = b.frequency_hz / frame.scales.frequency_hz; if f > 0.9 && f < 1.5 { near.0 += v; near.1 += *channels as f64; } } } }
        println!("  {:?} rec {:?} {:.2}..{:.2} power {:.3} ({}) near {:.3} ({}): {}", origin.kind, origin.recording, origin.span_s[0], origin.span_s[1], pw.0 / pw.1, pw.1, near.0 / near.1, near.1, line.join(" "));
        let e = sums.entry(format!("{:?}", origin.kind)).or_insert_with(|| vec![(0.0, 0.0); steps.len()]);
        for k in 0..steps.len() { e[k].0 -= q.gradient[k]; e[k].1 += q.information[(k, k)]; }
    }
    for (kind, v) in sums {
        let line: Vec<String> = v.iter().map(|(g, h)| format!("{:+.1}", g / h.max(1e-12).sqrt())).collect();
        println!("  sum {kind}: {}", line.join(" "));
    }
}
