//! How far an estimate says it can be trusted: hold of the reference, missing samples, friction however it is
//! stated, bands, idle runs, the drive side's own low-pass.

use crate::force::{RATE_HZ, axis, deviation, milling, simulate, test_drive};
use std::f64::consts::TAU;
use stillcut::force::balance::Method;
use stillcut::force::estimator::ForceEstimator;
use stillcut::force::harmonic_settings::HarmonicSettings;
use stillcut::force::motion::MotionSample;
use stillcut::force::observer::Observer;
use stillcut::force::offline::estimate_run;
use stillcut::force::physics::physics_of;
use stillcut::force::plan::{ForcePlan, ServoPlan};
use stillcut::force::recorded::motion_of_recording;
use stillcut::force::settings::{ForceSettings, LowPass};
use stillcut::force::signals::{AxisSignals, Signals};
use stillcut::force::validity::Validity;
use stillcut::identify::sweep::{StatedErrors, Sweep, fit_sweep};
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};
use stillcut::plant::machine::Controller;
use stillcut::signal::butterworth::{Butterworth, zero_phase};
use stillcut::signal::harmonic_fit::{HarmonicBasis, HarmonicDesign, HarmonicFitError};
use stillcut::units::SampleRate;

const CONTROLLER: Controller = Controller {
    position_gain_1_s: 60.0,
    velocity_gain_1_s: 220.0,
    velocity_integral_1_s: 20.0,
    velocity_filter_rad_s: 3000.0,
};

/// A mass under a reference that is held over each sample, through current loops from slow to ideal, moved on
/// exactly in steps of a hundredth of a sample: no force acts, and none is seen.
#[test]
fn a_held_reference_is_seen_where_it_acts() {
    const MASS_KG: f64 = 20.0;
    let told = |i: usize| 100.0 * (TAU * 400.0 * i as f64 / RATE_HZ).sin();
    for bandwidth_rad_s in [Some(1e3), Some(5e3), Some(5e4), Some(2e5), None] {
        let drive = DriveParams::new(RawDriveParams {
            movable_mass_kg: Some(MASS_KG),
            current_loop_bandwidth_rad_s: bandwidth_rad_s,
            ..RawDriveParams::default()
        })
        .unwrap();
        let dt = 0.01 / RATE_HZ;
        let keep = bandwidth_rad_s.map_or(0.0, |w| (-w * dt).exp());
        let (mut thrust, mut v, mut x) = (0.0f64, 0.0, 0.0);
        let samples: Vec<MotionSample> = (0..4000)
            .map(|i| {
                let sample = MotionSample {
                    thrust_ref_n: told(i),
                    motor_travel_m: Some(x),
                    ..MotionSample::default()
                };
                for _ in 0..100 {
                    let before = thrust;
                    thrust = told(i) + (thrust - told(i)) * keep;
                    let a = 0.5 * (before + thrust) / MASS_KG;
                    let a = if keep == 0.0 { told(i) / MASS_KG } else { a };
                    x += dt * (v + 0.5 * dt * a);
                    v += dt * a;
                }
                sample
            })
            .collect();
        let low_pass = LowPass::LinearPhase { pass_hz: 900.0, width_hz: 400.0 };
        let settings = ForceSettings { low_pass, ..ForceSettings::default() };
        let signals = AxisSignals { signals: Signals::MotorOnly, ..axis(&drive) };
        let estimator = ForceEstimator::new(Method::Dob, &signals, settings).unwrap();
        let forces: Vec<f64> = estimate_run(&estimator, &samples)[1000..].iter().map(|e| e.force_n).collect();
        // Half a sample wrong would be 12.6 N, a phase of 0.126 rad; the hold's own sinc leaves 0.3 N.
        let peak = forces.iter().fold(0.0, |a: f64, f| a.max(f.abs()));
        assert!(peak < 0.6, "{bandwidth_rad_s:?}: {peak} N");
    }
}

fn spectral(drive: &DriveParams, settings: ForceSettings) -> ForceEstimator {
    let settings = ForceSettings {
        controller: Some(CONTROLLER),
        low_pass: LowPass::None,
        harmonic: Some(HarmonicSettings { lines_per_turn: 2.0, ..HarmonicSettings::at_speed(3000.0) }),
        ..settings
    };
    ForceEstimator::new(Method::Spectral, &axis(drive), settings).unwrap()
}

/// Sato 4.3 through a loop whose gain is not one: what shows is u/G = F_cut - F_friction.
#[test]
fn a_stopped_axis_adds_friction_to_the_corrected_amplitude() {
    let raw = RawDriveParams { stage_coulomb_friction_n: Some(300.0), ..test_drive().raw().clone() };
    let drive = DriveParams::new(raw).unwrap();
    let estimator = spectral(&drive, ForceSettings::default());
    let amplitude_n = |feed_m_s: f64| {
        let samples: Vec<MotionSample> = (0..8000)
            .map(|i| {
                let t = f64::from(i) / RATE_HZ;
                // Slides to and fro by more than a guideway holds.
                let x = Some(feed_m_s * t + 20e-6 * (TAU * 100.0 * t).sin());
                let thrust_ref_n = 500.0 * (TAU * 100.0 * t).sin();
                MotionSample {
                    thrust_ref_n,
                    motor_travel_m: x,
                    stage_position_m: x,
                    ..MotionSample::default()
                }
            })
            .collect();
        let estimates = estimate_run(&estimator, &samples);
        let largest = estimates[6000..].iter().map(|e| e.force_n.abs()).fold(0.0, f64::max);
        (largest, estimates[7999].flags)
    };
    let ((moving_n, _), (stopped_n, flags)) = (amplitude_n(0.1), amplitude_n(0.0));
    // The loop's gain at 100 Hz is far from one, else nothing would be told apart.
    assert!(moving_n > 1.2 * 500.0, "{moving_n} N");
    assert!((stopped_n - moving_n - 300.0).abs() < 0.01 * stopped_n, "{stopped_n} {moving_n}");
    assert!(flags.contains(Validity::EXTRAPOLATED), "{flags}");
    // 20 um at 100 Hz turn a feed of 3 mm/s around: friction turns with it.
    assert!(amplitude_n(3e-3).1.contains(Validity::EXTRAPOLATED));
    assert!(amplitude_n(0.1).1.may_act());
}

/// Friction hides a force whether it stands in the drive or among the model's physics.
#[test]
fn friction_is_known_however_it_is_stated() {
    let terms = [(Port::Stage, 8.0), (Port::Motor, 110.0)].map(|(port, force_n)| PhysicsTerm {
        effect: EffectKind::CoulombFriction,
        port,
        parameters: vec![("force_n".to_owned(), ParameterValue::Number(force_n))],
    });
    let flexible = test_drive();
    let rigid = DriveParams::new(RawDriveParams { movable_mass_kg: Some(90.0), ..RawDriveParams::default() })
        .unwrap();
    let still = MotionSample {
        thrust_ref_n: 30.0,
        motor_travel_m: Some(0.1),
        stage_position_m: Some(0.1),
        ..MotionSample::default()
    };
    for drive in [flexible.clone(), rigid] {
        let (physics, drive) = physics_of(&terms, &drive);
        let settings = ForceSettings { physics: Some(physics), ..ForceSettings::default() };
        for method in [Method::Thrust, Method::Dob] {
            let estimator = ForceEstimator::new(method, &axis(&drive), settings.clone()).unwrap();
            assert!((estimator.properties().friction_bound_n.unwrap() - 118.0).abs() < 1e-9);
            let flags = estimate_run(&estimator, &vec![still; 500])[499].flags;
            assert!(flags.contains(Validity::BELOW_FRICTION), "{method:?}: {flags}");
        }
    }
    let (physics, drive) = physics_of(&terms, &flexible);
    let estimator = spectral(&drive, ForceSettings { physics: Some(physics), ..ForceSettings::default() });
    assert!(estimate_run(&estimator, &vec![still; 5000])[4999].flags.contains(Validity::BELOW_FRICTION));
}

/// One sample lost on the way: as long as its held value disturbs the estimate, the estimate says so.
#[test]
fn a_missing_sample_is_told_of_as_long_as_it_rings() {
    let drive = test_drive();
    let estimator = ForceEstimator::new(Method::Medob, &axis(&drive), ForceSettings::default()).unwrap();
    let run = |lost: bool| {
        let samples: Vec<MotionSample> = (0..3000)
            .map(|i| {
                let x = Some(0.01 * f64::from(i) / RATE_HZ);
                let stage_position_m = x.filter(|_| !(lost && i == 2000));
                MotionSample { motor_travel_m: x, stage_position_m, ..MotionSample::default() }
            })
            .collect();
        estimate_run(&estimator, &samples)
    };
    let (with, without) = (run(true), run(false));
    let errors: Vec<f64> = with.iter().zip(&without).map(|(a, b)| (a.force_n - b.force_n).abs()).collect();
    let peak = errors.iter().fold(0.0, |a: f64, e| a.max(*e));
    assert!(peak > 10.0, "{peak} N");
    for (i, (error, estimate)) in errors.iter().zip(&with).enumerate() {
        let told = estimate.flags.contains(Validity::SIGNAL_MISSING);
        assert!(*error < 0.01 * peak || (told && !estimate.flags.may_act()), "sample {i}: {error} N");
        assert!(i < 2500 || !told, "for ever");
    }
}

#[test]
fn each_method_states_the_band_it_is_right_in() {
    let drive = test_drive();
    let band = |method: Method| {
        let windowed = matches!(method, Method::Fitted | Method::Spectral);
        let settings = ForceSettings {
            controller: Some(CONTROLLER),
            harmonic: windowed.then(|| HarmonicSettings::at_speed(1200.0)),
            ..ForceSettings::default()
        };
        ForceEstimator::new(method, &axis(&drive), settings).unwrap().properties().usable_band_hz
    };
    assert_eq!(band(Method::Medob), [0.0, 1000.0]);
    assert_eq!(band(Method::VibrationMode), [0.0, 1000.0]);
    // The single-encoder observer is blind above its resonance, 370 Hz here, and wrong by a tenth well below.
    let [_, dob_hz] = band(Method::Dob);
    assert!((50.0..250.0).contains(&dob_hz), "{dob_hz}");
    let [low, thrust_hz] = band(Method::Thrust);
    assert!(low == 0.0 && thrust_hz < dob_hz, "{thrust_hz}");
    let [low, high] = band(Method::Spectral);
    assert!((low - 20.0).abs() < 1e-9 && (high - 500.0).abs() < 1e-9, "{low} {high}");
    let [low, high] = band(Method::Fitted);
    assert!(low == 0.0 && (high - 500.0).abs() < 1e-9, "{low} {high}");
}

/// What the drive side's low-pass keeps back is missing from the sum of both sides.
#[test]
fn behind_the_drive_sides_low_pass_the_band_ends_where_the_motor_moves() {
    let rate = SampleRate::new(RATE_HZ).unwrap();
    let drive = test_drive();
    let high = |cutoff_hz: f64| {
        let filter = Butterworth::low_pass(2, cutoff_hz, rate).unwrap();
        let settings = ForceSettings { drive_filter: Some(filter), ..ForceSettings::default() };
        ForceEstimator::new(Method::Medob, &axis(&drive), settings).unwrap().properties().usable_band_hz[1]
    };
    let ends = [high(150.0), high(600.0), high(2000.0)];
    assert!(ends[0] < 150.0 && ends[0] < ends[1] && ends[1] < ends[2], "{ends:?}");
}

#[test]
fn a_window_that_cannot_be_is_refused_by_the_name_of_its_quantity() {
    let drive = test_drive();
    let refused = |change: fn(&mut HarmonicSettings)| {
        let mut harmonic = HarmonicSettings::at_speed(3000.0);
        change(&mut harmonic);
        let settings = ForceSettings { harmonic: Some(harmonic), ..ForceSettings::default() };
        ForceEstimator::new(Method::Fitted, &axis(&drive), settings).unwrap_err().to_string()
    };
    for (change, quantity) in [
        ((|h| h.turns = f64::NAN) as fn(&mut HarmonicSettings), "turns NaN: expected 0."),
        (|h| h.turns = 0.0, "turns 0: expected 0."),
        (|h| h.turns = 1000.0, "turns 1000: expected 0."),
        (|h| h.lines_per_turn = 0.0, "teeth (lines per turn) 0: expected 1."),
        (|h| h.lines_per_turn = f64::INFINITY, "teeth (lines per turn) inf: expected 1."),
        (|h| h.spindle_speed_rpm = 0.0, "spindle speed in rpm 0: expected "),
        (|h| h.spindle_speed_rpm = f64::NAN, "spindle speed in rpm NaN: expected "),
        (|h| h.harmonics = Some(0), "harmonics 0: expected 1."),
        (|h| h.harmonics = Some(usize::MAX), "harmonics 18446744073709552000: expected 1."),
        (|h| h.harmonics = Some(400), "802 unknowns in a window of "),
    ] {
        let said = refused(change);
        assert!(said.starts_with(quantity), "{said}");
    }
}

#[test]
fn counts_beyond_any_machine_are_refused() {
    let begin = |half_window, harmonics| {
        let basis = HarmonicBasis { half_window, fundamental_rad: 1e-3, harmonics };
        HarmonicDesign::new(1).begin(basis).unwrap_err()
    };
    for harmonics in [22, 1 << 40, usize::MAX] {
        let refused = begin(21, harmonics);
        assert!(matches!(refused, HarmonicFitError::TooShort { samples: 43, .. }), "{refused}");
    }
    assert!(matches!(begin(usize::MAX, 4), HarmonicFitError::TooLong { .. }));
}

/// The lines move with the spindle, and the band with the lines.
#[test]
fn another_spindle_speed_has_another_band() {
    let drive = test_drive();
    // Two lines a turn at 3000 rpm, later at 6000 rpm: every 100 Hz, every 200 Hz.
    let mut estimator = spectral(&drive, ForceSettings::default());
    let stated = |e: &ForceEstimator, [low, high]: [f64; 2]| {
        let band = e.properties().usable_band_hz;
        assert!((band[0] - low).abs() < 1e-9 && (band[1] - high).abs() < 1e-9, "{band:?}");
    };
    stated(&estimator, [100.0, 500.0]);
    estimator.windows().unwrap().begin_tuning(6000.0).unwrap();
    stated(&estimator, [100.0, 500.0]);
    assert!(estimator.advance_tuning(usize::MAX).unwrap());
    stated(&estimator, [200.0, 400.0]);
}

/// As the service runs it by default: the drive side through 150 Hz, the stage's side waiting for it.
#[test]
fn the_drive_side_low_pass_keeps_the_sides_in_step() {
    for (name, method, limits_n) in [
        ("feed-1000rpm-1.5mm", Method::Medob, [1.0, 0.3]),
        ("feed-1000rpm-1.5mm", Method::VibrationMode, [1.2, 1.0]),
        ("feed-4000rpm-0.5mm", Method::VibrationMode, [1.2, 1.0]),
        ("feed-10000rpm-1.5mm", Method::VibrationMode, [1.2, 1.0]),
    ] {
        let Some(case) = milling(name) else { return };
        let run = |r| motion_of_recording(r, "x", &case.drive).unwrap().samples;
        let mut plan = ServoPlan {
            drive: case.drive.clone(),
            signals: Signals::Both,
            method,
            settings: ForceSettings::default(),
            motor_cutoff_hz: Some(150.0),
        };
        let rate = SampleRate::new(RATE_HZ).unwrap();
        let idles: Vec<Vec<MotionSample>> = case.idles.iter().map(run).collect();
        plan.settings.idle_map = plan.idle_map(rate, &idles).unwrap();
        assert_eq!(plan.settings.idle_map.as_ref().unwrap().runs(), 3);
        let mut observer = Observer::new(&ForcePlan::Servo(plan), rate).unwrap();
        let estimate: Vec<f64> = run(&case.cut).iter().map(|s| observer.step(s).force_n).collect();
        let low = Butterworth::low_pass(4, 500.0, rate).unwrap();
        let truth = zero_phase(&low, case.cut.require("x_force_n").unwrap());
        let (estimate, lag) =
            (zero_phase(&low, &estimate), (observer.properties().delay_s * RATE_HZ).round() as usize);
        let errors: Vec<f64> = (20_000..truth.len() - 15_000).map(|i| estimate[i + lag] - truth[i]).collect();
        let mean_n = errors.iter().sum::<f64>() / errors.len() as f64;
        let deviation_n = deviation(&errors);
        assert!(deviation_n < limits_n[0], "{name} {method:?}: {deviation_n} N");
        assert!(mean_n.abs() < limits_n[1], "{name} {method:?}: mean {mean_n} N");
    }
}

/// Beyond the way of the idle runs nothing is known of what returns by position.
#[test]
fn beyond_the_idle_runs_the_estimate_is_extrapolated() {
    let drive = test_drive();
    let rate = SampleRate::new(RATE_HZ).unwrap();
    let way = |n: u32| -> Vec<MotionSample> {
        (0..n)
            .map(|i| {
                let x = Some(0.01 * f64::from(i) / RATE_HZ);
                MotionSample { motor_travel_m: x, stage_position_m: x, ..MotionSample::default() }
            })
            .collect()
    };
    let mut plan = ServoPlan {
        drive,
        signals: Signals::Both,
        method: Method::Medob,
        settings: ForceSettings::default(),
        motor_cutoff_hz: None,
    };
    let still = vec![way(1)[0]; 3000];
    assert!(plan.idle_map(rate, &[still]).unwrap().is_none(), "a standing run has no way");
    plan.settings.idle_map = plan.idle_map(rate, &[way(3000)]).unwrap();
    let mut observer = Observer::new(&ForcePlan::Servo(plan), rate).unwrap();
    let flags: Vec<Validity> = way(6000).iter().map(|s| observer.step(s).flags).collect();
    assert!(!flags[2500].contains(Validity::EXTRAPOLATED), "{}", flags[2500]);
    assert!(flags[3500].contains(Validity::EXTRAPOLATED) && !flags[3500].may_act());
}

#[test]
fn a_sweep_at_too_low_a_rate_is_refused() {
    for hz in [5.0, 50.0] {
        let swept = |i: i32| 1e-6 * (0.001 * f64::from(i * i)).sin();
        let x: Vec<f64> = (0..4000).map(|i| 0.01 * f64::from(i) / hz + swept(i)).collect();
        let rate = SampleRate::new(hz).unwrap();
        let (thrust_ref_n, motor_travel_m) = (x.clone(), x.clone());
        let sweep = Sweep { rate, thrust_ref_n, motor_travel_m, stage_position_m: x };
        let error = fit_sweep(&test_drive(), &sweep, StatedErrors::default()).unwrap_err().to_string();
        assert!(error.contains("excites 0 lines"), "{error}");
    }
}

/// A screw that is 8 % softer than the model says: what the vibration mode learns while it cuts takes most of
/// the error away, the mean stays, and a model that is right is left as it is.
#[test]
fn vibration_mode_learns_the_stiffness_while_it_cuts() {
    let truth = test_drive();
    let cutting = |t: f64| 12.0 * (TAU * 35.0 * t).sin() + 6.0 * (TAU * 70.0 * t).sin();
    let run = simulate(&truth, |_| 0.0, cutting, 40_000);
    for stated in [1.0, 1.0 / 0.92] {
        let drive =
            truth.with_numbers([("axial_stiffness_n_m", stated * truth.axial_stiffness_n_m())]).unwrap();
        let error = |learn_stiffness: bool| {
            let settings = ForceSettings { learn_stiffness, ..ForceSettings::default() };
            let estimator = ForceEstimator::new(Method::VibrationMode, &axis(&drive), settings).unwrap();
            let mut state = estimator.settled(&run.samples[0]);
            let force: Vec<f64> = run.samples.iter().map(|s| estimator.step(&mut state, s).force_n).collect();
            let error: Vec<f64> = (25_000..40_000)
                .map(|i| force[i] - cutting(i as f64 / RATE_HZ - estimator.properties().delay_s))
                .collect();
            (deviation(&error), estimator.learned_stiffness_ratio(&state))
        };
        let ((without_n, none), (with_n, ratio)) = (error(false), error(true));
        let ratio = ratio.unwrap();
        assert_eq!(none, None);
        assert!((ratio * stated - 1.0).abs() < 0.005, "{stated}: {ratio}");
        if stated > 1.0 {
            assert!(with_n < 0.3 * without_n, "{stated}: {with_n} {without_n}");
        } else {
            assert!(with_n < 1.2 * without_n + 0.02, "{stated}: {with_n} {without_n}");
        }
    }
}
