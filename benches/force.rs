//! Cost per sample of each force estimator: one axis, six axes one after the other, six side by side as in
//! the pipeline (alignment, balance and low-pass in vector lanes; windows and accelerometers are long sums
//! already).
//!
//! `cargo bench --bench force`. Medians over rounds, cases in turn inside each round; on a shared machine
//! compare the ratios of one run, not the nanoseconds of two.
#![allow(clippy::disallowed_methods)] // a bench asks the time

use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::hint::black_box;
use std::time::Instant;
use stillcut::force::balance::Method;
use stillcut::force::frf::FrfEstimator;
use stillcut::force::harmonic_settings::HarmonicSettings;
use stillcut::force::lanes::LANES;
use stillcut::force::motion::MotionSample;
use stillcut::force::observer::Observer;
use stillcut::force::observers::{AxisObserver, Observers};
use stillcut::force::plan::{ForcePlan, ServoPlan};
use stillcut::force::settings::ForceSettings;
use stillcut::force::signals::Signals;
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
                nut_position_m: None,
                accel_m_s2: Some([0.1 * x, 0.2 * x, 0.3 * x]),
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

/// Accelerometers of 100 nodes.
fn accelerometers() -> FrfEstimator {
    let value = |k: usize| Complex64::new(1e6 + 1e3 * k as f64, 1e5);
    FrfEstimator {
        axis: "x".to_owned(),
        nodes_hz: (0..100).map(|k| 7.0 + 5.0 * f64::from(k)).collect(),
        values: (0..100).map(|k| std::array::from_fn(|u| value(k + u))).collect(),
        speed_range_rpm: [500.0, 7500.0],
        noise_floor_n: 0.1,
        condition: 10.0,
    }
}

/// Medians by name, in the order of the first mention.
#[derive(Default)]
struct Table(Vec<(String, Vec<f64>)>);

impl Table {
    fn add(&mut self, name: String, ns: f64) {
        match self.0.iter_mut().find(|(n, _)| *n == name) {
            Some((_, all)) => all.push(ns),
            None => self.0.push((name, vec![ns])),
        }
    }

    fn print(&self) {
        println!("{:44} {:>12} {:>12}", "estimator", "ns/sample", "x medob");
        let one = self.0.iter().find(|(n, _)| n == "medob, 1 axis").map_or(1.0, |(_, v)| median(v));
        for (name, values) in &self.0 {
            println!("{name:44} {:12.1} {:12.2}", median(values), median(values) / one);
        }
    }
}

fn plan(method: Method, drive: &DriveParams) -> ForcePlan {
    let windowed = matches!(method, Method::Fitted | Method::Spectral);
    ForcePlan::Servo(ServoPlan {
        drive: drive.clone(),
        signals: Signals::Both,
        method,
        settings: ForceSettings {
            controller: Some(Controller {
                position_gain_1_s: 60.0,
                velocity_gain_1_s: 220.0,
                velocity_integral_1_s: 20.0,
                velocity_filter_rad_s: 3000.0,
            }),
            harmonic: windowed.then(|| HarmonicSettings::at_speed(1200.0)),
            ..ForceSettings::default()
        },
        motor_cutoff_hz: None,
    })
}

/// Time of one sample of all observers.
fn observers_ns(observers: &mut [Observer], input: &[MotionSample]) -> f64 {
    observers.iter_mut().for_each(Observer::restart);
    time_ns(|| {
        for sample in input {
            for observer in observers.iter_mut() {
                black_box(observer.step(sample));
            }
        }
    })
}

/// Time of one sample of six axes side by side, as the pipeline steps them.
fn together_ns(observers: &mut Observers<LANES>, input: &[MotionSample]) -> f64 {
    observers.restart();
    time_ns(|| {
        for sample in input {
            black_box(observers.step(|_| *sample));
        }
    })
}

fn main() {
    let drive = drive();
    let rate = SampleRate::new(RATE_HZ).expect("positive");
    let input = samples();
    let two = Method::ALL.into_iter().filter(|m| *m != Method::SecondVibrationMode);
    let mut plans: Vec<(&str, ForcePlan)> = two.map(|m| (m.name(), plan(m, &drive))).collect();
    let mut learning = plan(Method::VibrationMode, &drive);
    if let ForcePlan::Servo(plan) = &mut learning {
        plan.settings.learn_stiffness = true;
    }
    plans.push(("vibration_mode, learning", learning));
    let mut alone = plan(Method::Medob, &drive);
    if let ForcePlan::Servo(plan) = &mut alone {
        plan.settings.compare_sides = false;
    }
    plans.push(("medob, sides not compared", alone));
    plans.push(("frf", ForcePlan::Accelerometers(accelerometers())));
    let six =
        |plan: &ForcePlan| Observers::<LANES>::new(vec![AxisObserver::new(plan, rate).expect("valid"); 6]);
    let mut table = Table::default();
    for _ in 0..ROUNDS {
        for (name, plan) in &plans {
            let mut alone = vec![Observer::new(plan, rate).expect("valid"); 6];
            table.add(format!("{name}, 1 axis"), observers_ns(&mut alone[..1], &input));
            table.add(format!("{name}, 6 axes one after the other"), observers_ns(&mut alone, &input));
            table.add(format!("{name}, 6 axes side by side"), together_ns(&mut six(plan), &input));
        }
    }
    // Of a longer and longer turn: nothing tells the speed, so none is followed.
    let silent: Vec<MotionSample> =
        input.iter().map(|s| MotionSample { spindle_speed_rpm: None, ..*s }).collect();
    for rpm in [4000.0, 1200.0, 300.0, 100.0] {
        let mut plan = plan(Method::Fitted, &drive);
        if let ForcePlan::Servo(plan) = &mut plan {
            plan.settings.harmonic = Some(HarmonicSettings::at_speed(rpm));
        }
        let mut alone = [Observer::new(&plan, rate).expect("valid")];
        for _ in 0..ROUNDS {
            table.add(format!("fitted at {rpm} rpm, 1 axis"), observers_ns(&mut alone, &silent));
        }
    }
    table.print();
    for rpm in [300.0, 1200.0, 4000.0] {
        let made: Vec<f64> = (0..3)
            .map(|_| {
                let mut plan = plan(Method::Fitted, &drive);
                if let ForcePlan::Servo(plan) = &mut plan {
                    plan.settings.harmonic = Some(HarmonicSettings::at_speed(rpm));
                }
                time_ns(|| drop(black_box(Observer::new(&plan, rate)))) * SAMPLES as f64 * 1e-6
            })
            .collect();
        println!("fitted, design for a new spindle speed of {rpm} rpm: {:.1} ms", median(&made));
    }
}
