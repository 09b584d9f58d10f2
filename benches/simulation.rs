//! Simulation in batch, of feed axes in closed loop and of cuts: one model at a time, several side by side,
//! with and without vector instructions.
//!
//! `cargo bench --bench simulation`. Medians over rounds, cases in turn inside each round; on a shared machine
//! compare the figures of one run. The axis is the one of the shared peer figures: two inertias, Coulomb
//! friction on both sides, P position and PI velocity, 20 kHz, one Runge-Kutta step a sample. The cut too:
//! two tools, one mode near 600 Hz, delays of half a turn, loss of contact, flank limit, steps of 10 us; its
//! ratios are to a plain loop of the same equations by the Runge-Kutta method, which takes as long as the
//! best peer (a compiled loop in Python).
#![allow(clippy::disallowed_methods)] // a bench asks the time

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;
use stillcut::config::machine::machine_from_text;
use stillcut::plant::cut_terms::{CutCondition, CutTerms};
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::machine::AxisModel;
use stillcut::plant::scenario::{RawScenario, Scenario};
use stillcut::signal::dispatch::Fast;
use stillcut::simulation::model_axis::{ControlLaw, LANES, Trial, respond_on};
use stillcut::simulation::model_cut::{self, CutModel, CutTrial, free_run_on};

const ROUNDS: usize = 9;
const RATE_HZ: f64 = 20_000.0;
const SECONDS: f64 = 2.0;

const MODEL: &str = include_str!("../tests/suite/feed-axis.toml");

fn trial(axis: &AxisModel) -> Trial {
    let samples = (SECONDS * RATE_HZ) as usize;
    let per_accel = axis.drive.total_mass_kg() / axis.drive.thrust_constant_n_a().expect("a torque constant");
    Trial {
        period_s: 1.0 / RATE_HZ,
        command_m: (0..samples).map(|k| 5.0e-3 * (1.0 - (6.0 * k as f64 / RATE_HZ).cos())).collect(),
        injected: Vec::new(),
        start_m: [0.0; 2],
        start_m_s: 0.0,
        law: ControlLaw {
            controller: axis.controller.expect("a controller"),
            per_accel,
            feeds_forward: true,
            exact_filter: false,
        },
        integral_m: 0.0,
        taken_up_s: 0.0,
        thrust_per_unit: None,
    }
}

/// Two tools and one mode by the classical Runge-Kutta method, nothing else in the loop.
fn plain_cut(scenario: &Scenario, seconds: f64) -> f64 {
    const DT: f64 = 1.0e-5;
    let terms = CutTerms::of(scenario, &CutCondition::of(scenario));
    let bar = terms.bar_at_tools();
    let (w, share) = (std::f64::consts::TAU * bar.frequency_hz, bar.shape * bar.shape / bar.mass_kg);
    let surface_m_s = terms.at.surface_speed_m_s();
    let k = terms.radial_stiffness_pa * terms.at.width_m;
    let (damping, flank) = (terms.process_damping_n / surface_m_s, terms.flank_force_n / surface_m_s);
    let (limit, advance) = (surface_m_s * terms.clearance_slope, terms.chips_m());
    let back = terms.delays_s().map(|d| (d / DT).round() as usize);
    let room = (back[0].max(back[1]) + 2).next_power_of_two();
    let mut surface = vec![[0.0f64; 2]; room];
    let force = |tool: usize, u: f64, v: f64, met: f64| {
        let chip = advance[tool] + u - met;
        if chip <= 0.0 { 0.0 } else { (k * chip + damping * v + flank * (v - limit).max(0.0)).max(0.0) }
    };
    let rate = |y: f64, v: f64, met: [f64; 2]| {
        let driving = force(1, -y, -v, met[1]) - force(0, y, v, met[0]);
        (v, share * driving - 2.0 * bar.damping_ratio * w * v - w * w * y)
    };
    let (mut y, mut v) = (1.0e-7, 0.0);
    for step in 0..(seconds / DT) as usize {
        let older = |d: usize, k: usize| surface[(step + room - d) & (room - 1)][k];
        let next = |d: usize, k: usize| surface[(step + 1 + room - d) & (room - 1)][k];
        let met = [older(back[1], 1), older(back[0], 0)];
        let then = [next(back[1], 1), next(back[0], 0)];
        let half = [f64::midpoint(met[0], then[0]), f64::midpoint(met[1], then[1])];
        let a = rate(y, v, met);
        let b = rate(y + 0.5 * DT * a.0, v + 0.5 * DT * a.1, half);
        let c = rate(y + 0.5 * DT * b.0, v + 0.5 * DT * b.1, half);
        let d = rate(y + DT * c.0, v + DT * c.1, then);
        let left = |tool: usize, u: f64| u - (advance[tool] + u - met[tool]).min(0.0);
        surface[step & (room - 1)] = [left(0, y), left(1, -y)];
        y += DT / 6.0 * (a.0 + 2.0 * (b.0 + c.0) + d.0);
        v += DT / 6.0 * (a.1 + 2.0 * (b.1 + c.1) + d.1);
    }
    y
}

fn cut_trial(scenario: &Scenario) -> CutTrial {
    let rate_hz = 10_000.0;
    let at = CutCondition::of(scenario);
    let samples = (SECONDS * rate_hz) as usize;
    let step_rad = std::f64::consts::TAU / at.turn_s() / rate_hz;
    CutTrial {
        period_s: 1.0 / rate_hz,
        turned_rad: (0..samples).map(|k| step_rad * k as f64).collect(),
        pitch_difference_rad: vec![at.pitch_difference_rad; samples],
        conditions: vec![at; samples.div_ceil(100)],
        held: 100,
    }
}

fn medians(times: Vec<Vec<f64>>) -> Vec<f64> {
    let of = |mut t: Vec<f64>| {
        t.sort_by(f64::total_cmp);
        t[t.len() / 2]
    };
    times.into_iter().map(of).collect()
}

fn table(names: &[&str], medians: &[f64]) {
    println!("{:<22} {:>22} {:>22} {:>10}", "models", "ms per simulated s", "simulated s per s", "ratio");
    for (name, t) in names.iter().zip(medians) {
        println!("{name:<22} {:>22.3} {:>22.0} {:>10.2}", 1.0e3 * t, 1.0 / t, medians[0] / t);
    }
}

fn axes() {
    let machine = machine_from_text(Path::new("bench.toml"), MODEL).expect("a model");
    let stated = &machine.axes[0];
    // Friction that turns over 0.5 mm/s, as in the peers' runs: the step of 50 us follows it.
    let raw = RawDriveParams { friction_smoothing_m_s: Some(5.0e-4), ..stated.drive.raw().clone() };
    let axis = &AxisModel { drive: DriveParams::new(raw).expect("a drive"), ..stated.clone() };
    let trial = trial(axis);
    let crowd = vec![axis.clone(); LANES];
    let cases: [(&str, Fast, &[AxisModel]); 6] = [
        ("one, plain", Fast::off(), &crowd[..1]),
        ("one, AVX2", Fast::detect(), &crowd[..1]),
        ("one, widest", Fast::detect_wide(), &crowd[..1]),
        ("eight, plain", Fast::off(), &crowd),
        ("eight, AVX2", Fast::detect(), &crowd),
        ("eight, widest", Fast::detect_wide(), &crowd),
    ];
    let mut times = vec![Vec::new(); cases.len()];
    for _ in 0..ROUNDS {
        for ((_, fast, axes), times) in cases.iter().zip(&mut times) {
            let start = Instant::now();
            black_box(respond_on(*fast, black_box(axes), black_box(&trial)));
            times.push(start.elapsed().as_secs_f64() / SECONDS / axes.len() as f64);
        }
    }
    table(&cases.map(|c| c.0), &medians(times));
}

fn cuts() {
    let scenario = Scenario::new(&RawScenario { pitch_difference_rad: 0.05, ..RawScenario::default() })
        .expect("a scenario");
    let trial = cut_trial(&scenario);
    let model = |seed: usize| CutModel { scenario, random_share: 0.03, seed: seed as u64 };
    let crowd: Vec<CutModel> = (0..model_cut::LANES).map(model).collect();
    let cases: [(&str, Fast, usize); 5] = [
        ("cut, Runge-Kutta loop", Fast::off(), 0),
        ("one, widest", Fast::detect_wide(), 1),
        ("sixteen, plain", Fast::off(), model_cut::LANES),
        ("sixteen, AVX2", Fast::detect(), model_cut::LANES),
        ("sixteen, widest", Fast::detect_wide(), model_cut::LANES),
    ];
    let mut times = vec![Vec::new(); cases.len()];
    for _ in 0..ROUNDS {
        for ((_, fast, count), times) in cases.iter().zip(&mut times) {
            let start = Instant::now();
            if *count == 0 {
                black_box(plain_cut(black_box(&scenario), SECONDS));
            } else {
                black_box(free_run_on(*fast, black_box(&crowd[..*count]), black_box(&trial)));
            }
            times.push(start.elapsed().as_secs_f64() / SECONDS / (*count).max(1) as f64);
        }
    }
    table(&cases.map(|c| c.0), &medians(times));
}

fn main() {
    axes();
    cuts();
}
