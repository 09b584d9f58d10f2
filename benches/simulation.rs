//! Closed-loop simulation of feed axes: one model at a time, eight side by side, with and without vector
//! instructions.
//!
//! `cargo bench --bench simulation`. Medians over rounds, cases in turn inside each round; on a shared machine
//! compare the figures of one run. The axis is the one of the shared peer figures: two inertias, Coulomb
//! friction on both sides, P position and PI velocity, 20 kHz, one Runge-Kutta step a sample.
#![allow(clippy::disallowed_methods)] // a bench asks the time

use std::hint::black_box;
use std::path::Path;
use std::time::Instant;
use stillcut::config::machine::machine_from_text;
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::machine::AxisModel;
use stillcut::signal::dispatch::Fast;
use stillcut::simulation::model_axis::{ControlLaw, LANES, Trial, respond_on};

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

fn main() {
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
    let medians: Vec<f64> = times
        .iter_mut()
        .map(|t| {
            t.sort_by(f64::total_cmp);
            t[t.len() / 2]
        })
        .collect();
    println!("{:<14} {:>22} {:>22} {:>10}", "models", "ms per simulated s", "simulated s per s", "ratio");
    for ((name, ..), t) in cases.iter().zip(&medians) {
        println!("{name:<14} {:>22.3} {:>22.0} {:>10.2}", 1.0e3 * t, 1.0 / t, medians[0] / t);
    }
}
