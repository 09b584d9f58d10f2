//! The page for a person: it stands alone, says the sentence, and lets no markup through.

use stillcut::diagnosis::{
    Alternative, ClosedLoop, Contribution, Correction, DetectionLimit, Diagnosis, Estimate, Finding, Fit,
    Location, RecordingFit, SimulatedTrial, TimeSpans, Tried, Verdict,
};
use stillcut::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};
use stillcut::report::html::{ReportContext, diagnosis_page};

use super::conceal::model;

/// Noise that is the same in every run.
fn noise(state: &mut u64) -> f64 {
    let mut sum = 0.0;
    for _ in 0..4 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        sum += (*state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
    }
    sum * 3.0_f64.sqrt()
}

fn recording(index: usize) -> RecordingFit {
    let rate = 1000.0;
    let mut state = 7 + index as u64;
    let n = 12_000;
    let t_s: Vec<f64> = (0..n).map(|k| f64::from(k) / rate).collect();
    let (mut position_m, mut velocity_m_s) = (Vec::new(), Vec::new());
    for t in &t_s {
        let speed: f64 = [1.0e-3, 3.0e-3, 10.0e-3, 30.0e-3][((t / 3.0) as usize).min(3)];
        let phase = (t % 3.0) / 3.0;
        let way = if phase < 0.5 { phase } else { 1.0 - phase };
        position_m.push(speed * 3.0 * way);
        velocity_m_s.push(if phase < 0.5 { speed } else { -speed });
    }
    let law = |v: f64| 9.9 * (-(v / 5.0e-3_f64).powi(2)).exp() * v.signum();
    let quiet: Vec<f64> = (0..n).map(|_| 0.25 * noise(&mut state)).collect();
    let before: Vec<f64> = velocity_m_s.iter().zip(&quiet).map(|(v, e)| -law(*v) + e).collect();
    let nominal: Vec<f64> = before.iter().zip(&velocity_m_s).map(|(b, v)| b - 30.0 * v).collect();
    let motor: Vec<f64> = (0..n).map(|_| 0.08 * noise(&mut state)).collect();
    RecordingFit {
        experiment: if index == 0 { "idle".into() } else { "<b>moves</b>".into() },
        rms_before_n: 7.1,
        rms_after_n: 0.26,
        measured: vec![true; t_s.len()],
        t_s,
        position_m,
        velocity_m_s,
        residual_nominal_n: vec![motor.clone(), nominal],
        residual_before_n: vec![motor.clone(), before],
        residual_after_n: vec![motor, quiet],
    }
}

fn estimate(name: &str, value: f64, unit: &'static str, ci95: [f64; 2]) -> Estimate {
    Estimate { name: name.to_owned(), value, unit, ci95 }
}

fn diagnosis() -> Diagnosis {
    let term = PhysicsTerm {
        effect: EffectKind::StribeckFriction,
        port: Port::Stage,
        parameters: vec![("stribeck_force_n".into(), ParameterValue::Number(9.97))],
    };
    let finding = Finding {
        rank: 1,
        effect: EffectKind::StribeckFriction,
        port: Port::Stage,
        statement: "Friction of the stage is 9.97 N higher at creep speeds and falls off over 4.9 mm/s; <i>nothing</i> \
                    else explains the residual."
            .into(),
        equation: "F = F_s exp(-(v/v_s)^2) sgn v",
        parameters: vec![
            estimate("stribeck_force_n", 9.97, "N", [9.83, 10.11]),
            estimate("stribeck_velocity_m_s", 4.93e-3, "m/s", [4.86e-3, 5.0e-3]),
        ],
        maps: Vec::new(),
        fit: Fit { heldout_rms_before_n: 5.62, heldout_rms_after_n: 0.262, noise_floor_n: 0.25 },
        probability: 0.93,
        alternatives: vec![
            Alternative { effect: EffectKind::PreslidingFriction, port: Port::Stage, probability: 0.05 },
            Alternative { effect: EffectKind::NonlinearViscosity, port: Port::Stage, probability: 0.02 },
        ],
        next_experiment: Some("Strokes of 100 um at 0.5 mm/s, both ways.".into()),
        contribution: vec![Contribution { recording: 0, t_s: vec![0.0], value: vec![1.0] }],
        term,
        evidence: 18_412.0,
    };
    let tried = [
        (Some(EffectKind::StribeckFriction), 18_412.0),
        (Some(EffectKind::PreslidingFriction), 9_120.0),
        (None, 7_300.0),
        (Some(EffectKind::NonlinearViscosity), 4_200.0),
        (Some(EffectKind::Backlash), 220.0),
    ];
    Diagnosis {
        axis: "x".into(),
        verdict: Verdict::MissingPhysics,
        location: Some(Location {
            port: Port::Stage,
            domain: "velocity",
            bands_hz: vec![[0.5, 12.0]],
            time: vec![TimeSpans { recording: 0, spans_s: vec![[0.0, 6.0]] }],
            shares: Some([0.02, 0.97, 0.98]),
        }),
        findings: vec![finding],
        unexplained: None,
        candidates: Vec::new(),
        residual_band_hz: [0.0, 300.0],
        force_faults: Vec::new(),
        parameter_corrections: vec![Correction {
            name: "movable_mass_kg".into(),
            nominal: 6.6,
            value: 7.92,
            ci95: [7.9, 7.94],
        }],
        recordings: vec![recording(0), recording(1)],
        balances: vec!["motor", "stage"],
        series_rate_hz: 1000.0,
        noise_floor_n: vec![0.08, 0.25],
        tried: tried
            .into_iter()
            .map(|(effect, evidence)| Tried { effect, port: Port::Stage, evidence })
            .collect(),
        left_out: Vec::new(),
        no_evidence: None,
        detection_limits: vec![DetectionLimit {
            effect: EffectKind::Backlash,
            port: Port::Coupling,
            force_rms_n: 0.042,
        }],
        notes: Vec::new(),
        model: model(),
        closed_loop: Ok(ClosedLoop {
            read: None,
            law_share: 2.0e-5,
            trials: vec![SimulatedTrial {
                recording: 0,
                injected: false,
                thrust_rms_n: [9.5, 5.6, 0.27],
                stage_rms_m: [3.1e-6, 2.0e-6, 4.4e-8],
                t_s: vec![0.0, 0.5, 1.0],
                thrust_error_n: vec![vec![9.0, -9.0, 9.0], vec![5.0, -5.0, 5.0], vec![0.2, -0.2, 0.2]],
            }],
            not_simulated: Vec::new(),
        }),
    }
}

fn context() -> ReportContext {
    ReportContext {
        machine: "bench & <script>alert(1)</script>".into(),
        files: vec!["idle.parquet".into()],
        faults: Vec::new(),
    }
}

#[test]
fn the_page_says_the_sentence_and_the_numbers() {
    let page = diagnosis_page(&diagnosis(), &context());
    assert!(page.contains("What would have been seen") && page.contains("0.042"));
    assert!(page.contains("In simulation") && page.contains("5.60 N") && page.contains("44.0 nm"));
    for expected in [
        "The model leaves out friction that is 9.97 N higher at creep speed",
        "Without it <b>5.62 N</b>",
        "93.0 %: as said above",
        "Probability <b>93.0 %</b>",
        "9.97 N",
        "4.93 mm/s",
        "5.62 N",
        "presliding friction",
        "Strokes of 100 um",
        "it sits here",
        "movable_mass_kg",
        "+20.0 %",
    ] {
        assert!(page.contains(expected), "{expected} is not on the page");
    }
    assert_eq!(
        page.matches("<svg class=").count(),
        6,
        "two of before and after, three maps, one of the simulation"
    );
    std::fs::write(concat!(env!("CARGO_TARGET_TMPDIR"), "/report.html"), &page).unwrap();
}

#[test]
fn the_page_loads_nothing_and_lets_no_markup_through() {
    let page = diagnosis_page(&diagnosis(), &context());
    for outside in
        ["http:", "https:", "<script", "<link", "<img", "@import", "url(", "src=", "<b>moves", "<i>nothing"]
    {
        assert!(!page.contains(outside), "{outside} stands in the page");
    }
    assert!(page.contains("&lt;b&gt;moves&lt;/b&gt;"));
    assert!(page.len() < 1_500_000, "{} bytes", page.len());
}

#[test]
fn every_verdict_has_its_page() {
    for verdict in [Verdict::ParameterError, Verdict::ModelAdequate, Verdict::UnexplainedMismatch] {
        let mut d = diagnosis();
        d.verdict = verdict;
        d.findings.clear();
        let page = diagnosis_page(&d, &context());
        assert!(page.contains(verdict.name()) && !page.contains("NaN") && !page.contains("inf "));
    }
}

/// What is left is one and a half times its floor, and the engine that measured both calls that noise.
#[test]
fn a_healthy_machine_reads_that_nothing_is_missing() {
    let mut d = diagnosis();
    (d.verdict, d.location) = (Verdict::ModelAdequate, None);
    d.findings.clear();
    d.parameter_corrections.clear();
    d.noise_floor_n.iter_mut().for_each(|n| *n *= 0.3);
    let page = diagnosis_page(&d, &context());
    assert!(page.contains("<h1>Nothing is missing: "));
    assert!(!page.contains("hold more than the model says") && !page.contains("No missing effect is proven"));
}

#[test]
fn a_finding_without_a_rival_is_told_with_what_confirms_it() {
    let next = |d: &Diagnosis| {
        let page = diagnosis_page(d, &context());
        let from = page.find("What to do next").expect("a next step");
        page[from..from + 300].to_owned()
    };
    let mut d = diagnosis();
    assert!(next(&d).contains("Strokes of 100 um"), "what tells the finding from its rivals");
    d.findings[0].alternatives.clear();
    d.findings[0].next_experiment = None;
    d.findings[0].probability = 0.9999;
    assert!(next(&d).contains("Take model.toml in the place of the model"));
    assert!(diagnosis_page(&d, &context()).contains("Probability <b>above 99.9 %</b>"));
}

#[test]
fn an_empty_series_still_gives_a_page() {
    let mut d = diagnosis();
    for r in &mut d.recordings {
        *r = RecordingFit {
            t_s: vec![],
            position_m: vec![],
            velocity_m_s: vec![],
            residual_nominal_n: vec![vec![], vec![]],
            residual_before_n: vec![vec![], vec![]],
            residual_after_n: vec![vec![], vec![]],
            ..r.clone()
        };
    }
    assert!(diagnosis_page(&d, &context()).contains("The model leaves out"));
}

/// Nothing is drawn over rows that were not measured: a curve ends before them and begins behind them.
#[test]
fn rows_that_were_not_measured_are_not_drawn() {
    let curves = |page: &str| page.matches("<path").count();
    let mut d = diagnosis();
    let whole = curves(&diagnosis_page(&d, &context()));
    for r in &mut d.recordings {
        r.measured[6000..6400].fill(false);
    }
    // Before and after, in the picture of the whole recording at least.
    assert!(curves(&diagnosis_page(&d, &context())) >= whole + 2);
}
