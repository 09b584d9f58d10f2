//! Cost per sample of each force estimator: one axis, six axes one after the other, six side by side.
//!
//! `cargo bench --bench force`. Medians over rounds, cases in turn inside each round; on a shared machine
//! compare the ratios of one run, not the nanoseconds of two.
#![allow(clippy::disallowed_methods)] // a bench asks the time

use std::f64::consts::TAU;
use std::hint::black_box;
use std::time::Instant;
use stillcut::force::balance::Method;
use stillcut::force::estimator::{AxisSignals, ForceEstimator, ForceSettings, MotionSample, Signals};
use stillcut::force::harmonic::HarmonicSettings;
use stillcut::force::lanes::{ForceLanes, LaneSample};
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::machine::Controller;
use stillcut::units::SampleRate;

const ROUNDS: usize = 9;
const SAMPLES: usize = 9000;
const RATE_HZ: f64 = 9000.0;

fn drive() -> DriveParams {
    DriveParams::new(RawDriveParams {
        movable_mass_kg: Some(6.6),
        screw_lead_m: Some(0.005),
        rotary_inertia_kg_m2: Some(5.2e-5),
        axial_stiffness_n_m: Some(4.05e7),
        structural_damping_n_s_m: Some(1800.0),
        rotary_damping_nm_s_rad: Some(6.5e-3),
        translational_damping_n_s_m: Some(820.0),
        stage_coulomb_friction_n: Some(50.0),
        motor_coulomb_friction_n: Some(35.0),
        current_loop_bandwidth_rad_s: Some(5000.0),
        amplifier_dead_time_s: Some(2e-4),
        motor_encoder_delay_s: Some(2e-4),
        stage_encoder_delay_s: Some(2e-4),
        motor_encoder_resolution_m: Some(0.6e-9),
        stage_encoder_resolution_m: Some(0.24e-9),
        ..RawDriveParams::default()
    })
    .expect("a drive")
}

fn samples() -> Vec<MotionSample> {
    (0..SAMPLES)
        .map(|i| {
            let t = i as f64 / RATE_HZ;
            let x = 1e-3 * (TAU * 2.0 * t).sin() + 2e-8 * (TAU * 650.0 * t).sin();
            MotionSample {
                thrust_ref_n: 100.0 * (TAU * 20.0 * t).sin(),
                motor_travel_m: Some(x),
                stage_position_m: Some(x + 1e-7),
                spindle_speed_rpm: Some(1200.0),
            }
        })
        .collect()
}

fn time_ns(mut work: impl FnMut()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e9 / SAMPLES as f64
}

fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[sorted.len() / 2]
}

fn main() {
    let drive = drive();
    let rate = SampleRate::new(RATE_HZ).expect("positive");
    let axis = AxisSignals { drive: &drive, rate, signals: Signals::Both };
    let input = samples();
    let settings = ForceSettings {
        controller: Some(Controller {
            position_gain_1_s: 60.0,
            velocity_gain_1_s: 220.0,
            velocity_integral_1_s: 20.0,
            velocity_filter_rad_s: 3000.0,
        }),
        harmonic: Some(HarmonicSettings::at_speed(1200.0)),
        ..ForceSettings::default()
    };
    let singles: Vec<ForceEstimator> = Method::ALL
        .iter()
        .map(|m| ForceEstimator::new(*m, &axis, settings.clone()).expect("valid"))
        .collect();
    let plain = ForceSettings::default();
    let lanes = ForceLanes::new(&[(Method::Medob, axis); 6], &plain).expect("valid");
    let slow = lanes.clone().without_fast();
    let mut table: Vec<(String, Vec<f64>)> = Vec::new();
    let mut add = |name: &str, ns: f64| match table.iter_mut().find(|(n, _)| n == name) {
        Some((_, all)) => all.push(ns),
        None => table.push((name.to_owned(), vec![ns])),
    };
    for _ in 0..ROUNDS {
        for estimator in &singles {
            let mut state = estimator.settled(&input[0]);
            let ns = time_ns(|| {
                for sample in &input {
                    black_box(estimator.step(&mut state, sample));
                }
            });
            add(&format!("{}, 1 axis", estimator.method().name()), ns);
        }
        let medob = &singles[2];
        let mut states = vec![medob.settled(&input[0]); 6];
        let ns = time_ns(|| {
            for sample in &input {
                for state in &mut states {
                    black_box(medob.step(state, sample));
                }
            }
        });
        add("medob, 6 axes one after the other", ns);
        for (name, lanes) in [("medob, 6 axes side by side", &lanes), ("the same, any processor", &slow)] {
            let mut state = lanes.settled(&LaneSample::default());
            let ns = time_ns(|| {
                for sample in &input {
                    let row = LaneSample {
                        thrust_ref_n: [sample.thrust_ref_n; 8],
                        motor_travel_m: [sample.motor_travel_m.unwrap_or(0.0); 8],
                        stage_position_m: [sample.stage_position_m.unwrap_or(0.0); 8],
                    };
                    black_box(lanes.step(&mut state, &row));
                }
            });
            add(name, ns);
        }
    }
    println!("{:36} {:>12} {:>12}", "estimator", "ns/sample", "x 1 axis");
    let one = table.iter().find(|(n, _)| n.starts_with("medob, 1")).map_or(1.0, |(_, v)| median(v));
    for (name, values) in &table {
        println!("{name:36} {:12.1} {:12.2}", median(values), median(values) / one);
    }
}
