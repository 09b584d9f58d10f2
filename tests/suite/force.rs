//! Force estimators and identification against simulated truth that they were not made with.

use crate::folders::shared;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::path::PathBuf;
use stillcut::config::machine::read_machine;
use stillcut::force::balance::Method;
use stillcut::force::estimator::ForceEstimator;
use stillcut::force::frf_stream::force_of_recording;
use stillcut::force::harmonic_settings::{HarmonicSettings, Reading};
use stillcut::force::motion::MotionSample;
use stillcut::force::offline::{estimate_run, idle_map, stiffness_of_runs};
use stillcut::force::recorded::motion_of_recording;
use stillcut::force::settings::{ForceSettings, LowPass};
use stillcut::force::signals::{AxisSignals, Signals};
use stillcut::force::validity::Validity;
use stillcut::identify::frf::{FrfRun, FrfSettings, fit_frf};
use stillcut::identify::resolution::{EncoderSteps, MonteCarlo, force_variance, monte_carlo_variance};
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::recording::read_recording;
use stillcut::sample::Recording;
use stillcut::signal::butterworth::{Butterworth, zero_phase};
use stillcut::units::SampleRate;

pub(crate) fn deviation(x: &[f64]) -> f64 {
    let mean = x.iter().sum::<f64>() / x.len() as f64;
    (x.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / x.len() as f64).sqrt()
}

// ---- a drive simulated here, by small steps of its own --------------------------------------------

pub(crate) const RATE_HZ: f64 = 10_000.0;
const FINE: usize = 20;

pub(crate) fn test_drive() -> DriveParams {
    let r2 = (0.005 / TAU).powi(2);
    DriveParams::new(RawDriveParams {
        movable_mass_kg: Some(7.0),
        screw_lead_m: Some(0.005),
        rotary_inertia_kg_m2: Some(80.0 * r2),
        torque_constant_nm_a: Some(0.2),
        axial_stiffness_n_m: Some(4.0e7),
        structural_damping_n_s_m: Some(1500.0),
        rotary_damping_nm_s_rad: Some(9000.0 * r2),
        translational_damping_n_s_m: Some(700.0),
        current_loop_bandwidth_rad_s: Some(5000.0),
        amplifier_dead_time_s: Some(3.2e-4),
        motor_encoder_delay_s: Some(1.3e-4),
        stage_encoder_delay_s: Some(2.1e-4),
        motor_encoder_resolution_m: Some(6e-10),
        stage_encoder_resolution_m: Some(2.4e-10),
        ..RawDriveParams::default()
    })
    .unwrap()
}

/// Positions that the encoders report for a thrust reference held over each sample and a cutting force.
pub(crate) struct Simulated {
    pub(crate) samples: Vec<MotionSample>,
}

pub(crate) fn simulate(
    drive: &DriveParams,
    thrust: impl Fn(usize) -> f64,
    cutting: impl Fn(f64) -> f64,
    n: usize,
) -> Simulated {
    simulate_at((RATE_HZ, FINE), drive, (thrust, cutting), n)
}

/// The same at another rate, each sample in so many steps: a whole number of them must be the dead time of the
/// amplifier.
pub(crate) fn simulate_at(
    (rate_hz, fine): (f64, usize),
    drive: &DriveParams,
    (thrust, cutting): (impl Fn(usize) -> f64, impl Fn(f64) -> f64),
    n: usize,
) -> Simulated {
    let (m_r, m_t) = (drive.reflected_mass_kg(), drive.movable_mass_kg());
    let (c_r, c_t) = (drive.reflected_damping_n_s_m(), drive.translational_damping_n_s_m());
    let (k, c_k) = (drive.axial_stiffness_n_m(), drive.structural_damping_n_s_m());
    let w = drive.current_loop_bandwidth_rad_s().unwrap();
    let dt = 1.0 / rate_hz / fine as f64;
    let mut y = [0.0f64; 5]; // x_m, v_m, x_t, v_t, thrust
    let steps = n * fine;
    let mut track = Vec::with_capacity(steps + 1);
    track.push([0.0, 0.0]);
    let reference_at = |t: f64| {
        let told = ((t - drive.amplifier_dead_time_s()) * rate_hz + 1e-6).floor();
        if told < 0.0 { 0.0 } else { thrust(told as usize) }
    };
    let slope = |y: &[f64; 5], t: f64, reference: f64| {
        let spring = k * (y[0] - y[2]) + c_k * (y[1] - y[3]);
        [
            y[1],
            (y[4] - c_r * y[1] - spring) / m_r,
            y[3],
            (spring - c_t * y[3] - cutting(t)) / m_t,
            w * (reference - y[4]),
        ]
    };
    for i in 0..steps {
        let t = i as f64 * dt;
        let add = |y: &[f64; 5], d: &[f64; 5], h: f64| std::array::from_fn::<f64, 5, _>(|j| y[j] + h * d[j]);
        // The reference jumps between steps, never within one.
        let u = reference_at(t);
        let k1 = slope(&y, t, u);
        let k2 = slope(&add(&y, &k1, 0.5 * dt), t + 0.5 * dt, u);
        let k3 = slope(&add(&y, &k2, 0.5 * dt), t + 0.5 * dt, u);
        let k4 = slope(&add(&y, &k3, dt), t + dt, u);
        for j in 0..5 {
            y[j] += dt / 6.0 * (k1[j] + 2.0 * k2[j] + 2.0 * k3[j] + k4[j]);
        }
        track.push([y[0], y[2]]);
    }
    let read = |side: usize, t: f64, step_m: f64| {
        let at = (t / dt).max(0.0);
        let i = (at as usize).min(track.len() - 2);
        let x = track[i][side] + (at - i as f64) * (track[i + 1][side] - track[i][side]);
        (x / step_m).round() * step_m
    };
    let samples = (0..n)
        .map(|i| {
            let t = i as f64 / rate_hz;
            MotionSample {
                thrust_ref_n: thrust(i),
                motor_travel_m: Some(read(
                    0,
                    t - drive.motor_encoder_delay_s(),
                    drive.motor_encoder_resolution_m(),
                )),
                stage_position_m: Some(read(
                    1,
                    t - drive.stage_encoder_delay_s(),
                    drive.stage_encoder_resolution_m(),
                )),
                spindle_speed_rpm: None,
                nut_position_m: None,
                accel_m_s2: None,
            }
        })
        .collect();
    Simulated { samples }
}

pub(crate) fn axis(drive: &DriveParams) -> AxisSignals<'_> {
    AxisSignals { drive, rate: SampleRate::new(RATE_HZ).unwrap(), signals: Signals::Both }
}

#[test]
fn a_force_is_seen_at_the_stated_delay_by_both_modes() {
    let drive = test_drive();
    let cutting = |t: f64| {
        if t < 0.05 {
            0.0
        } else {
            20.0 * (TAU * 233.0 * (t - 0.05)).sin() + 8.0 * (TAU * 610.0 * (t - 0.05)).sin()
        }
    };
    let thrust = |i: usize| {
        30.0 * (TAU * 87.0 * i as f64 / RATE_HZ).sin() + 25.0 * (TAU * 410.0 * i as f64 / RATE_HZ).sin()
    };
    let run = simulate(&drive, thrust, cutting, 5000);
    for method in [Method::Medob, Method::RigidMode, Method::VibrationMode] {
        let low_pass = LowPass::LinearPhase { pass_hz: 900.0, width_hz: 400.0 };
        let settings = ForceSettings { low_pass, ..ForceSettings::default() };
        let estimator = ForceEstimator::new(method, &axis(&drive), settings).unwrap();
        let estimates = estimate_run(&estimator, &run.samples);
        let errors: Vec<f64> = (1500..4900)
            .map(|i| estimates[i].force_n - cutting(i as f64 / RATE_HZ - estimator.properties().delay_s))
            .collect();
        // What encoder steps cause is stated. The thrust swings by 6 N a sample and is read at another phase
        // of the hold than the encoders: its images alias to at most 0.4 % of 25 N twice; 0.2 N for all of
        // that.
        let limit = estimator.properties().noise_floor_n.hypot(0.2);
        let error = deviation(&errors);
        assert!(
            error < 1.2 * limit,
            "{method:?}: {error} N, noise floor {}",
            estimator.properties().noise_floor_n
        );
    }
}

#[test]
fn a_causal_butterworth_states_its_slow_delay() {
    let drive = test_drive();
    let cutting = |t: f64| 20.0 * (TAU * 20.0 * t).sin();
    let run = simulate(&drive, |_| 0.0, cutting, 5000);
    let estimator = ForceEstimator::new(Method::Medob, &axis(&drive), ForceSettings::default()).unwrap();
    let estimates = estimate_run(&estimator, &run.samples);
    let errors: Vec<f64> = (2000..5000)
        .map(|i| estimates[i].force_n - cutting(i as f64 / RATE_HZ - estimator.properties().delay_s))
        .collect();
    let limit = estimator.properties().noise_floor_n.hypot(0.1);
    assert!(
        deviation(&errors) < 1.2 * limit,
        "{} {}",
        deviation(&errors),
        estimator.properties().noise_floor_n
    );
}

#[test]
fn a_missing_position_is_flagged_and_held() {
    let drive = test_drive();
    let estimator = ForceEstimator::new(Method::Medob, &axis(&drive), ForceSettings::default()).unwrap();
    let whole = MotionSample {
        thrust_ref_n: 0.0,
        motor_travel_m: Some(0.1),
        stage_position_m: Some(0.1),
        spindle_speed_rpm: None,
        nut_position_m: None,
        accel_m_s2: None,
    };
    let mut state = estimator.settled(&whole);
    for _ in 0..1000 {
        let _ = estimator.step(&mut state, &whole);
    }
    let out = estimator.step(&mut state, &MotionSample { stage_position_m: None, ..whole });
    assert!(out.flags.contains(Validity::SIGNAL_MISSING));
    assert!(out.force_n.abs() < 1e-6);
}

#[test]
fn a_line_of_the_encoder_is_flagged_where_it_falls_into_the_band() {
    // Feed over signal period: 512 periods in 5 mm are 102.4 Hz per mm/s.
    let raw = RawDriveParams { motor_encoder_signals_per_rev: Some(512.0), ..test_drive().raw().clone() };
    let drive = DriveParams::new(raw).unwrap();
    for (pass_hz, expected) in [(100.0, false), (105.0, true)] {
        let low_pass = LowPass::LinearPhase { pass_hz, width_hz: 50.0 };
        let settings = ForceSettings { low_pass, ..ForceSettings::default() };
        let estimator = ForceEstimator::new(Method::Medob, &axis(&drive), settings).unwrap();
        let moving: Vec<MotionSample> = (0..5000)
            .map(|i| {
                let x = Some(1e-3 * f64::from(i) / RATE_HZ);
                MotionSample { motor_travel_m: x, stage_position_m: x, ..MotionSample::default() }
            })
            .collect();
        let last = *estimate_run(&estimator, &moving).last().unwrap();
        assert_eq!(last.flags.contains(Validity::ENCODER_LINE_IN_BAND), expected, "{pass_hz}");
    }
}

// ---- milling with known force ---------------------------------------------------------------------

pub(crate) struct Milling {
    pub drive: DriveParams,
    pub cut: Recording,
    pub idles: Vec<Recording>,
}

pub(crate) fn milling(case: &str) -> Option<Milling> {
    let folder = shared(&format!("milling-cases/{case}"))?;
    let machine = read_machine(&folder.join("machine.toml")).unwrap();
    let idles = (1..=3)
        .map(|k| folder.join(format!("idle-{k}.parquet")))
        .filter(|p| p.exists())
        .map(|p| read_recording(&p).unwrap())
        .collect();
    let cut = read_recording(&folder.join("cut.parquet")).unwrap();
    Some(Milling { drive: machine.axis("x").unwrap().drive.clone(), cut, idles })
}

/// Standard deviation and mean of the error below 500 Hz, as the shared check computes them.
fn milling_error(case: &Milling, method: Method) -> (f64, f64) {
    let run = |r: &Recording| motion_of_recording(r, "x", &case.drive).unwrap().samples;
    let (cut, idles) = (run(&case.cut), case.idles.iter().map(run).collect::<Vec<_>>());
    let mut drive = case.drive.clone();
    if method == Method::VibrationMode {
        let check = stiffness_of_runs(&axis(&drive), &cut, &idles).unwrap().unwrap();
        assert!(check.is_conclusive(), "{check:?}");
        drive =
            drive.with_numbers([("axial_stiffness_n_m", check.ratio * drive.axial_stiffness_n_m())]).unwrap();
    }
    let low_pass = LowPass::LinearPhase { pass_hz: 800.0, width_hz: 400.0 };
    let mut settings = ForceSettings { low_pass, ..ForceSettings::default() };
    let bare = ForceEstimator::new(method, &axis(&drive), settings.clone()).unwrap();
    settings.idle_map = idle_map(&bare, &idles);
    let estimator = ForceEstimator::new(method, &axis(&drive), settings).unwrap();
    let estimate: Vec<f64> = estimate_run(&estimator, &cut).iter().map(|e| e.force_n).collect();
    let low = Butterworth::low_pass(4, 500.0, case.cut.sample_rate).unwrap();
    let truth = zero_phase(&low, case.cut.require("x_force_n").unwrap());
    let estimate = zero_phase(&low, &estimate);
    let lag = (estimator.properties().delay_s * RATE_HZ).round() as usize;
    let errors: Vec<f64> = (20_000..truth.len() - 15_000).map(|i| estimate[i + lag] - truth[i]).collect();
    (deviation(&errors), errors.iter().sum::<f64>() / errors.len() as f64)
}

#[test]
fn milling_forces_are_met_as_by_an_offline_evaluation() {
    for (name, method, limit_n) in [
        ("feed-1000rpm-1.5mm", Method::Medob, 0.6),
        ("feed-1000rpm-1.5mm", Method::VibrationMode, 0.6),
        ("feed-4000rpm-0.5mm", Method::VibrationMode, 0.9),
        ("feed-10000rpm-1.5mm", Method::VibrationMode, 1.1),
        ("cross-1000rpm-1.5mm", Method::VibrationMode, 2.5),
        ("cross-4000rpm-6.0mm", Method::VibrationMode, 4.2),
    ] {
        let Some(case) = milling(name) else { return };
        let (deviation_n, mean_n) = milling_error(&case, method);
        assert!(deviation_n <= limit_n, "{name} {method:?}: {deviation_n:.2} N, expected {limit_n}");
        // A standing axis is judged without the zero that a whole recording gives it.
        let mean_limit_n = if name.starts_with("feed") { 0.5 } else { 6.0 };
        assert!(mean_n.abs() < mean_limit_n, "{name} {method:?}: mean {mean_n:.2} N");
    }
}

#[test]
fn thrust_and_single_encoder_are_as_bad_as_the_thesis_says() {
    let Some(case) = milling("feed-4000rpm-0.5mm") else { return };
    let vibration = milling_error(&case, Method::VibrationMode).0;
    assert!(milling_error(&case, Method::Dob).0 > 5.0 * vibration);
    assert!(milling_error(&case, Method::Thrust).0 > 5.0 * vibration);
}

/// Figure 4-3 and table 4-7: without the dead times the multi-encoder observer is worse.
#[test]
fn without_delay_compensation_the_observer_is_worse() {
    let Some(mut case) = milling("feed-1000rpm-1.5mm") else { return };
    let with = milling_error(&case, Method::Medob).0;
    case.drive = DriveParams::new(RawDriveParams {
        amplifier_dead_time_s: None,
        motor_encoder_delay_s: None,
        stage_encoder_delay_s: None,
        current_loop_bandwidth_rad_s: None,
        ..case.drive.raw().clone()
    })
    .unwrap();
    let without = milling_error(&case, Method::Medob).0;
    assert!(without > 1.3 * with, "{without:.2} N without, {with:.2} N with");
}

/// The window read at its young end lags by the alignment alone, is noisier, and meets the same force.
#[test]
fn a_window_read_at_its_young_end_lags_less_and_is_noisier() {
    let Some(case) = milling("feed-1000rpm-1.5mm") else { return };
    let samples = motion_of_recording(&case.cut, "x", &case.drive).unwrap().samples;
    let make = |reading| {
        let harmonic = HarmonicSettings { reading, band_hz: 100.0, ..HarmonicSettings::at_speed(1000.0) };
        let settings =
            ForceSettings { low_pass: LowPass::None, harmonic: Some(harmonic), ..ForceSettings::default() };
        ForceEstimator::new(Method::Fitted, &axis(&case.drive), settings).unwrap()
    };
    let (middle, young) = (make(Reading::Middle), make(Reading::Young));
    assert!(
        (middle.properties().delay_s - young.properties().delay_s - 0.03).abs() < 1e-3,
        "half a turn of 60 ms"
    );
    assert!(young.properties().delay_s < 1e-3 && young.properties().condition.unwrap() < 20.0);
    assert!(young.properties().noise_floor_n > middle.properties().noise_floor_n);
    let at = |e: &ForceEstimator| {
        let lag = (e.properties().delay_s * RATE_HZ).round() as usize;
        let estimates = estimate_run(e, &samples);
        (25_000..40_000).map(|i| estimates[i + lag].force_n).collect::<Vec<f64>>()
    };
    let apart: Vec<f64> = at(&middle).iter().zip(at(&young)).map(|(a, b)| a - b).collect();
    let all = deviation(&at(&middle));
    assert!(deviation(&apart) < 0.5 * all, "{} of {all}", deviation(&apart));
}

#[test]
fn spectral_gain_is_that_of_the_recorded_loop() {
    // Lines of the thrust divided by the closed loop's response meet the known force within a tenth.
    let Some(case) = milling("feed-1000rpm-1.5mm") else { return };
    let folder = shared("milling-cases/feed-1000rpm-1.5mm").unwrap();
    let machine = read_machine(&folder.join("machine.toml")).unwrap();
    let samples = motion_of_recording(&case.cut, "x", &case.drive).unwrap().samples;
    let settings = ForceSettings {
        low_pass: LowPass::None,
        controller: machine.axis("x").unwrap().controller,
        harmonic: Some(HarmonicSettings {
            lines_per_turn: 2.0,
            band_hz: 150.0,
            ..HarmonicSettings::at_speed(1000.0)
        }),
        ..ForceSettings::default()
    };
    let estimator = ForceEstimator::new(Method::Spectral, &axis(&case.drive), settings).unwrap();
    let estimates = estimate_run(&estimator, &samples);
    let lag = (estimator.properties().delay_s * RATE_HZ).round() as usize;
    let low = Butterworth::low_pass(4, 150.0, case.cut.sample_rate).unwrap();
    let truth = zero_phase(&low, case.cut.require("x_force_n").unwrap());
    let part = 25_000..40_000;
    let mean = truth[part.clone()].iter().sum::<f64>() / part.len() as f64;
    let errors: Vec<f64> = part.clone().map(|i| estimates[i + lag].force_n - (truth[i] - mean)).collect();
    assert!(deviation(&errors) < 0.2 * deviation(&truth[part]), "{}", deviation(&errors));
}

#[test]
fn below_friction_is_not_observable_and_bounded() {
    // Sato, figure 12 (b): a stopped axis of 560 N friction under a small force shows nothing.
    let drive = DriveParams::new(RawDriveParams {
        stage_coulomb_friction_n: Some(560.0),
        ..test_drive().raw().clone()
    })
    .unwrap();
    let settings = ForceSettings {
        controller: Some(stillcut::plant::machine::Controller {
            position_gain_1_s: 60.0,
            velocity_gain_1_s: 220.0,
            velocity_integral_1_s: 20.0,
            velocity_filter_rad_s: 3000.0,
        }),
        harmonic: Some(HarmonicSettings { lines_per_turn: 2.0, ..HarmonicSettings::at_speed(600.0) }),
        ..ForceSettings::default()
    };
    let estimator = ForceEstimator::new(Method::Spectral, &axis(&drive), settings).unwrap();
    let still = MotionSample {
        thrust_ref_n: 12.0,
        motor_travel_m: Some(0.0),
        stage_position_m: Some(0.0),
        spindle_speed_rpm: Some(600.0),
        nut_position_m: None,
        accel_m_s2: None,
    };
    let estimates = estimate_run(&estimator, &vec![still; 10_000]);
    let last = estimates.last().unwrap();
    assert!(last.flags.contains(Validity::BELOW_FRICTION) && !last.flags.may_act());
    assert!(last.force_n.abs() < 1e-6);
    assert!((estimator.properties().friction_bound_n.unwrap() - 560.0).abs() < 1e-9);
}

/// Three inertias whose positions are all measured: every mode returns the force that acts, through the
/// estimator.
#[test]
fn three_positions_return_the_force_in_every_mode() {
    let r2 = (0.005 / TAU).powi(2);
    let drive = DriveParams::new(RawDriveParams {
        rotary_inertia_kg_m2: Some(50.0 * r2),
        screw_inertia_kg_m2: Some(30.0 * r2),
        torsional_stiffness_nm_rad: Some(3.0e8 * r2),
        torsional_damping_nm_s_rad: Some(2000.0 * r2),
        current_loop_bandwidth_rad_s: None,
        amplifier_dead_time_s: None,
        motor_encoder_delay_s: None,
        stage_encoder_delay_s: None,
        motor_encoder_resolution_m: None,
        stage_encoder_resolution_m: None,
        ..test_drive().raw().clone()
    })
    .unwrap();
    // Motion of motor and stage chosen freely, as phasors; the screw's, thrust and cutting force that go
    // with it follow.
    let chain = stillcut::force::response::Chain::of_drive(&drive);
    let links = chain.links().to_vec();
    let w = TAU * 130.0;
    let phasor = |amplitude: f64, phase: f64| Complex64::from_polar(amplitude, phase);
    let s = Complex64::new(0.0, w);
    let spring = |i: usize| links[i].spring_n_m + s * links[i].damper_n_s_m;
    let (motor, stage) = (phasor(2e-6, 0.3), phasor(3e-6, 1.1));
    let own = |i: usize| s * (s * links[i].mass_kg + links[i].damping_n_s_m);
    let nut = (spring(0) * motor + spring(1) * stage) / (spring(0) + spring(1) + own(1));
    let thrust = own(0) * motor + spring(0) * (motor - nut);
    let cutting = spring(1) * (nut - stage) - own(2) * stage;
    let at = |p: Complex64, i: f64| (p * Complex64::from_polar(1.0, w * i / RATE_HZ)).im;
    let samples: Vec<MotionSample> = (0..4000)
        .map(|i| MotionSample {
            // Held over its sample, a reference acts half a sample late.
            thrust_ref_n: at(thrust, f64::from(i) + 0.5),
            motor_travel_m: Some(at(motor, f64::from(i))),
            nut_position_m: Some(at(nut, f64::from(i))),
            stage_position_m: Some(at(stage, f64::from(i))),
            ..MotionSample::default()
        })
        .collect();
    let signals = AxisSignals { signals: Signals::Three, ..axis(&drive) };
    for method in [Method::Medob, Method::RigidMode, Method::VibrationMode, Method::SecondVibrationMode] {
        let settings = ForceSettings { low_pass: LowPass::None, ..ForceSettings::default() };
        let estimator = ForceEstimator::new(method, &signals, settings).unwrap();
        let lag = estimator.alignment_lag_samples() as f64;
        let estimates = estimate_run(&estimator, &samples);
        for i in [1000_u32, 2345, 3999] {
            let error = estimates[i as usize].force_n - at(cutting, f64::from(i) - lag);
            assert!(error.abs() < 1e-3 * cutting.norm(), "{method:?}: {error} N of {}", cutting.norm());
        }
        let mut without = samples[0];
        without.nut_position_m = None;
        let mut state = estimator.settled(&without);
        let flags = estimator.step(&mut state, &without).flags;
        assert!(flags.contains(Validity::SIGNAL_MISSING), "{method:?}");
    }
    let two = ForceEstimator::new(Method::SecondVibrationMode, &axis(&drive), ForceSettings::default());
    assert!(two.unwrap_err().to_string().contains("three measured positions"));
}

// ---- accelerometers -------------------------------------------------------------------------------

fn accelerations(r: &Recording) -> Vec<[f64; 3]> {
    let column = |a: &str| r.require(&format!("{a}_accel_m_s2")).unwrap().to_vec();
    let (x, y, z) = (column("x"), column("y"), column("z"));
    (0..r.len()).map(|i| [x[i], y[i], z[i]]).collect()
}

/// Median over turns of the range within one turn.
fn median_range(x: &[f64], turn: f64) -> f64 {
    let mut ranges = Vec::new();
    let mut start = 0.0;
    while start + turn < x.len() as f64 {
        let part = &x[start as usize..(start + turn) as usize];
        let (low, high) =
            part.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        ranges.push(high - low);
        start += turn;
    }
    ranges.sort_by(f64::total_cmp);
    ranges[ranges.len() / 2]
}

#[test]
fn the_accelerometer_estimator_meets_the_range_of_unseen_passes() {
    let Some(folder) = shared("spindle-cases") else { return };
    let files = |name: &str| {
        let mut all: Vec<PathBuf> =
            std::fs::read_dir(folder.join(name)).unwrap().map(|e| e.unwrap().path()).collect();
        all.sort();
        all
    };
    let runs: Vec<FrfRun> = files("train")
        .iter()
        .map(|p| {
            let r = read_recording(p).unwrap();
            FrfRun {
                rate: r.sample_rate,
                speed_rpm: r.require("spindle_speed_rpm").unwrap()[0],
                accel: accelerations(&r),
                force_n: r.require("x_force_n").unwrap().to_vec(),
            }
        })
        .collect();
    let fit = fit_frf("x", &runs, &FrfSettings::default()).unwrap();
    assert!(fit.heldout_error < 0.08, "{}", fit.describe());
    let (mut above_30, mut above_10) = (Vec::new(), Vec::new());
    for path in files("cut") {
        let r = read_recording(&path).unwrap();
        let speed = r.require("spindle_speed_rpm").unwrap();
        let rows = force_of_recording(&fit.estimator, r.sample_rate, &accelerations(&r), speed).unwrap();
        let force: Vec<f64> = rows.iter().map(|row| row.force_n).collect();
        let low = Butterworth::low_pass(12, 500.0, r.sample_rate).unwrap();
        let truth = zero_phase(&low, r.require("x_force_n").unwrap());
        let turn = 60.0 / speed[0] * r.sample_rate.hz();
        let (range, expected) = (median_range(&force, turn), median_range(&truth, turn));
        let error = (range / expected - 1.0).abs();
        if expected > 30.0 {
            above_30.push(error)
        } else if expected > 10.0 {
            above_10.push(error)
        }
    }
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    assert!(mean(&above_30) < 0.04, "{above_30:?}");
    assert!(mean(&above_10) < 0.10, "{above_10:?}");
}

#[test]
fn a_speed_beyond_the_training_is_flagged() {
    let estimator = stillcut::force::frf::FrfEstimator {
        axis: "x".to_owned(),
        nodes_hz: vec![7.0, 500.0],
        values: vec![[Complex64::new(1.0, 0.0); 9]; 2],
        speed_range_rpm: [500.0, 7500.0],
        noise_floor_n: 0.0,
        condition: 1.0,
    };
    assert!(estimator.flags(2500.0).is_valid());
    let flags = estimator.flags(9000.0);
    assert!(flags.contains(Validity::EXTRAPOLATED) && !flags.may_act());
}

// ---- identification -------------------------------------------------------------------------------

#[test]
fn lyapunov_variance_is_met_by_quantizing_a_motion() {
    // Hayashi, table I at 1 ms.
    let drive = DriveParams::new(RawDriveParams {
        movable_mass_kg: Some(260.0),
        screw_lead_m: Some(1.91e-3 * TAU),
        rotary_inertia_kg_m2: Some(4.06e-3),
        rotary_damping_nm_s_rad: Some(7.61e-3),
        translational_damping_n_s_m: Some(1.53e3),
        axial_stiffness_n_m: Some(1.03e8),
        ..RawDriveParams::default()
    })
    .unwrap();
    let rate = SampleRate::new(1000.0).unwrap();
    let steps = EncoderSteps { motor_m: 1e-8, stage_m: 1e-8 };
    let mut last = 0.0;
    for cutoff_hz in [150.0, 300.0, 450.0] {
        let lyapunov = force_variance(&drive, steps, cutoff_hz, rate).unwrap();
        let settings = MonteCarlo { rate, samples: 400_000, seed: 7, feed_steps: None };
        let tried = monte_carlo_variance(&drive, steps, cutoff_hz, settings).unwrap();
        assert!(
            (tried.motor_n2 / lyapunov.motor_n2 - 1.0).abs() < 0.02,
            "{cutoff_hz}: {tried:?} {lyapunov:?}"
        );
        assert!(
            (tried.stage_n2 / lyapunov.stage_n2 - 1.0).abs() < 0.02,
            "{cutoff_hz}: {tried:?} {lyapunov:?}"
        );
        // Below a step a sample the error is a sawtooth and not white: the equation does not hold there.
        let slow = MonteCarlo { feed_steps: Some(0.13), ..settings };
        let slow = monte_carlo_variance(&drive, steps, cutoff_hz, slow).unwrap();
        assert!((slow.motor_n2 / lyapunov.motor_n2 - 1.0).abs() > 0.1, "{cutoff_hz}: {slow:?}");
        assert!(lyapunov.motor_n2 > last);
        last = lyapunov.motor_n2;
        let double = EncoderSteps { motor_m: 2e-8, stage_m: 2e-8 };
        let four = force_variance(&drive, double, cutoff_hz, rate).unwrap();
        assert!((four.motor_n2 / lyapunov.motor_n2 - 4.0).abs() < 1e-9);
    }
}
