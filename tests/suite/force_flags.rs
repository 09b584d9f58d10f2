//! What an estimate says against itself out of its own recording: a mode of the motor side, a force above the
//! band of its method, the noise that reaches the thrust; and who asks for it (replay, idle runs).

use crate::force::{RATE_HZ, deviation, milling, test_drive};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::path::Path;
use std::process::{Command, Output};
use stillcut::config::service::service_config_from_text;
use stillcut::force::balance::Method;
use stillcut::force::closed_loop::ClosedLoop;
use stillcut::force::estimator::ForceEstimator;
use stillcut::force::frf::FrfEstimator;
use stillcut::force::frf_stream::force_of_recording;
use stillcut::force::harmonic_settings::HarmonicSettings;
use stillcut::force::motion::{ForceEstimate, MotionSample};
use stillcut::force::observer::Observer;
use stillcut::force::offline::estimate_run;
use stillcut::force::plan::{ForcePlan, ServoPlan};
use stillcut::force::recorded::motion_of_recording;
use stillcut::force::response::{Chain, ChainLink};
use stillcut::force::settings::{ForceSettings, LowPass};
use stillcut::force::signals::{AxisSignals, Signals};
use stillcut::force::validity::Validity;
use stillcut::plant::drive::{DriveParams, RawDriveParams};
use stillcut::plant::machine::{AxisModel, Controller};
use stillcut::recording::{Table, TableColumn, read_recording, write_recording, write_table};
use stillcut::sample::{Column, Recording};
use stillcut::signal::butterworth::Butterworth;
use stillcut::units::SampleRate;

const CONTROLLER: Controller = Controller {
    position_gain_1_s: 60.0,
    velocity_gain_1_s: 220.0,
    velocity_integral_1_s: 20.0,
    velocity_filter_rad_s: 3000.0,
};

fn rate() -> SampleRate {
    SampleRate::new(RATE_HZ).unwrap()
}

/// The drive of the other tests without lags.
fn prompt_drive() -> DriveParams {
    DriveParams::new(RawDriveParams {
        current_loop_bandwidth_rad_s: None,
        amplifier_dead_time_s: None,
        motor_encoder_delay_s: None,
        stage_encoder_delay_s: None,
        ..test_drive().raw().clone()
    })
    .unwrap()
}

/// Steady answer of a chain of masses to lines of cutting force, as its encoders read it; the motor is not
/// driven.
fn shaken(chain: &Chain, lines: &[(f64, f64)]) -> (Vec<MotionSample>, Vec<f64>) {
    shaken_at(RATE_HZ, chain, lines)
}

fn shaken_at(rate_hz: f64, chain: &Chain, lines: &[(f64, f64)]) -> (Vec<MotionSample>, Vec<f64>) {
    let answers: Vec<_> = lines.iter().map(|(hz, n)| (*hz, *n, chain.receptance(*hz))).collect();
    let step = |x: f64, step_m: f64| (x / step_m).round() * step_m;
    let at = |t: f64| {
        let mut sums = [0.0; 3];
        for (hz, n, x) in &answers {
            let turned = Complex64::from_polar(*n, TAU * hz * t + hz);
            let parts = [Complex64::new(1.0, 0.0), x.motor_per_cutting, x.stage_per_cutting];
            sums.iter_mut().zip(parts).for_each(|(sum, x)| *sum += (turned * x).im);
        }
        sums
    };
    (0..30_000)
        .map(|i| {
            let [force_n, motor_m, stage_m] = at(f64::from(i) / rate_hz);
            let sample = MotionSample {
                motor_travel_m: Some(step(motor_m, 6e-10)),
                stage_position_m: Some(step(stage_m, 2.4e-10)),
                ..MotionSample::default()
            };
            (sample, force_n)
        })
        .unzip()
}

/// The motor's rotor and its screw apart, with a torsional mode that two inertias do not have.
fn richer_plant(drive: &DriveParams) -> Chain {
    let motor_kg = drive.reflected_mass_kg();
    let rotor = ChainLink {
        mass_kg: 0.6 * motor_kg,
        damping_n_s_m: drive.reflected_damping_n_s_m(),
        spring_n_m: 4.6e8,
        damper_n_s_m: 1000.0,
    };
    let screw = ChainLink {
        mass_kg: 0.4 * motor_kg,
        damping_n_s_m: 0.0,
        spring_n_m: drive.axial_stiffness_n_m(),
        damper_n_s_m: drive.structural_damping_n_s_m(),
    };
    let stage = ChainLink {
        mass_kg: drive.movable_mass_kg(),
        damping_n_s_m: drive.translational_damping_n_s_m(),
        ..ChainLink::default()
    };
    Chain::new(&[rotor, screw, stage])
}

/// Error of a method over its force, what it says of it, and whether it is flagged at the end.
fn said(method: Method, drive: &DriveParams, run: &(Vec<MotionSample>, Vec<f64>)) -> [f64; 3] {
    said_where((method, true, RATE_HZ), drive, run)
}

/// The same where the stiffness is learned or not, and at another rate.
fn said_where(
    (method, learn_stiffness, rate_hz): (Method, bool, f64),
    drive: &DriveParams,
    (samples, force_n): &(Vec<MotionSample>, Vec<f64>),
) -> [f64; 3] {
    let axis =
        AxisModel { name: "x".to_owned(), drive: drive.clone(), controller: None, physics: Vec::new() };
    let mut plan = ServoPlan::of_axis(&axis, method, Signals::Both);
    plan.settings.learn_stiffness = learn_stiffness;
    plan.settings.low_pass = LowPass::LinearPhase { pass_hz: 800.0, width_hz: 400.0 };
    let rate = SampleRate::new(rate_hz).unwrap();
    let mut observer = Observer::new(&ForcePlan::Servo(plan), rate).unwrap();
    let estimates: Vec<_> = samples.iter().map(|s| observer.step(s)).collect();
    let late = (observer.properties().delay_s * rate_hz).round() as usize;
    let error: Vec<f64> = (20_000..29_000).map(|i| estimates[i + late].force_n - force_n[i]).collect();
    let expected = observer.mismatch().map_or(f64::NAN, |m| m.share());
    let flagged = estimates[29_999].flags.contains(Validity::MODE_OUTSIDE_MODEL);
    [deviation(&error) / deviation(&force_n[20_000..29_000]), expected, f64::from(u8::from(flagged))]
}

/// 1200 rpm with four teeth stays below the mode's reach, 10 000 rpm with two does not: the sum of both sides
/// is wrong there, says by how much, and the vibration mode is right and says nothing.
#[test]
fn a_mode_of_the_motor_side_is_flagged_where_it_carries_force() {
    let drive = prompt_drive();
    let plant = richer_plant(&drive);
    let modes = plant.modes().frequencies_hz;
    assert!((700.0..900.0).contains(&modes[2]), "{modes:?}");
    let slow = shaken(&plant, &[(20.0, 2.0), (80.0, 10.0), (160.0, 2.0)]);
    let [error, expected, flagged] = said(Method::Medob, &drive, &slow);
    assert!(error < 0.08 && expected < 0.1 && flagged == 0.0, "slow: {error} {expected}");
    let fast = shaken(&plant, &[(30.0, 1.0), (167.0, 1.0), (333.0, 8.0), (500.0, 2.0)]);
    for method in [Method::Medob, Method::RigidMode] {
        let [error, expected, flagged] = said(method, &drive, &fast);
        assert!(error > 0.3 && flagged == 1.0, "{method:?}: {error} {expected}");
        assert!((0.7..1.5).contains(&(expected / error)), "{method:?}: {expected} said, {error} true");
    }
    let [error, expected, flagged] = said(Method::VibrationMode, &drive, &fast);
    assert!(error < 0.1 && expected < 0.1 && flagged == 0.0, "vibration mode: {error} {expected}");
    // With the model's stiffness, which is not that of screw and torsion in series.
    let [error, expected, flagged] = said_where((Method::VibrationMode, false, RATE_HZ), &drive, &fast);
    assert!(error > 0.12 && flagged == 1.0, "stiffness kept: {error} {expected}");
    assert!((0.7..1.5).contains(&(expected / error)), "stiffness kept: {expected} said, {error} true");
}

/// The same in rates from the slowest that hears 500 Hz to the fastest.
#[test]
fn the_sides_are_compared_at_any_rate() {
    let drive = prompt_drive();
    let plant = richer_plant(&drive);
    for rate_hz in [5000.0, 7000.0, 12_000.0, 20_000.0] {
        let slow = shaken_at(rate_hz, &plant, &[(20.0, 2.0), (80.0, 10.0), (160.0, 2.0)]);
        let [error, expected, flagged] = said_where((Method::Medob, true, rate_hz), &drive, &slow);
        assert!(error < 0.08 && expected < 0.1 && flagged == 0.0, "{rate_hz} Hz: {error} {expected}");
        let fast = shaken_at(rate_hz, &plant, &[(30.0, 1.0), (167.0, 1.0), (333.0, 8.0), (500.0, 2.0)]);
        let [error, expected, flagged] = said_where((Method::Medob, true, rate_hz), &drive, &fast);
        assert!(error > 0.3 && flagged == 1.0, "{rate_hz} Hz: {error} {expected}");
        assert!((0.7..1.5).contains(&(expected / error)), "{rate_hz} Hz: {expected} said, {error} true");
    }
}

/// Rates at which next to nothing is heard: an estimate or one line, nothing is compared.
#[test]
fn the_slowest_rates_are_no_fault() {
    let drive = prompt_drive();
    for rate_hz in [2.0, 5.0, 9.0, 20.0, 34.0, 100.0, 200.0, 500.0] {
        let signals =
            AxisSignals { drive: &drive, rate: SampleRate::new(rate_hz).unwrap(), signals: Signals::Both };
        for method in [Method::Dob, Method::Medob, Method::RigidMode, Method::VibrationMode] {
            for learn_stiffness in [false, true] {
                let low_pass = LowPass::Butterworth { order: 4, cutoff_hz: 0.25 * rate_hz };
                let settings = ForceSettings { low_pass, learn_stiffness, ..ForceSettings::default() };
                match ForceEstimator::new(method, &signals, settings) {
                    Ok(estimator) => {
                        let run = estimate_run(&estimator, &[MotionSample::default(); 300]);
                        assert!(run.iter().all(|e| e.force_n == 0.0));
                    }
                    Err(error) => assert!(rate_hz <= 10.0 && learn_stiffness, "{rate_hz} Hz: {error}"),
                }
            }
        }
    }
}

/// Milling by another program, its force looked at only to judge: in the middle of the cut rows are flagged
/// where the error is above a tenth of the force, and what is said of it is right within a factor of 1.5.
#[test]
fn milling_is_flagged_where_the_sum_of_both_sides_is_wrong() {
    for (name, true_share) in [
        ("feed-1000rpm-1.5mm", 0.04),
        ("feed-4000rpm-0.5mm", 0.61),
        ("feed-10000rpm-1.5mm", 0.68),
        ("cross-1000rpm-1.5mm", 0.05),
        ("cross-4000rpm-6.0mm", 0.06),
    ] {
        let Some(case) = milling(name) else { return };
        let run = |r: &Recording| motion_of_recording(r, "x", &case.drive).unwrap().samples;
        let axis = AxisModel {
            name: "x".to_owned(),
            drive: case.drive.clone(),
            controller: None,
            physics: Vec::new(),
        };
        let mut plan = ServoPlan::of_axis(&axis, Method::Medob, Signals::Both);
        let idles: Vec<_> = case.idles.iter().map(run).collect();
        plan.settings.idle_map = plan.idle_map(rate(), &idles).unwrap();
        let mut observer = Observer::new(&ForcePlan::Servo(plan), rate()).unwrap();
        let cut = run(&case.cut);
        let estimates: Vec<_> = cut[..25_000].iter().map(|s| observer.step(s)).collect();
        let flagged = |e: &ForceEstimate| e.flags.contains(Validity::MODE_OUTSIDE_MODEL);
        assert!(estimates[22_000..].iter().all(|e| flagged(e) == (true_share > 0.1)), "{name}");
        let said = observer.mismatch().unwrap().share();
        assert!(said < 0.1 || (0.67..1.5).contains(&(said / true_share)), "{name}: {said}");
    }
}

/// A stiffness that is another one than the model's is no mode, whether slow force tells it or not.
#[test]
fn another_stiffness_is_not_taken_for_a_mode() {
    let truth = prompt_drive();
    let stated = truth.with_numbers([("axial_stiffness_n_m", truth.axial_stiffness_n_m() / 0.88)]).unwrap();
    for lines in [&[(20.0, 5.0), (100.0, 5.0), (333.0, 5.0)][..], &[(333.0, 8.0), (500.0, 3.0)][..]] {
        let run = shaken(&Chain::of_drive(&truth), lines);
        let [error, expected, flagged] = said(Method::Medob, &stated, &run);
        assert!(error < 0.02 && expected < 0.1 && flagged == 0.0, "{lines:?}: {error} {expected}");
    }
}

/// What the stage carries beside itself is not seen from its motion: both sides agree, and the estimate is
/// the force at the scale.
#[test]
fn a_mode_of_the_stages_side_is_not_seen() {
    let drive = prompt_drive();
    let links = richer_plant(&drive);
    let [motor, _, stage] = links.links() else { unreachable!() };
    let motor = ChainLink {
        mass_kg: drive.reflected_mass_kg(),
        spring_n_m: drive.axial_stiffness_n_m(),
        damper_n_s_m: drive.structural_damping_n_s_m(),
        ..*motor
    };
    // The tool post takes a fifth of the mass and moves on its own above 900 Hz; the scale is on the stage.
    let post = 0.2 * stage.mass_kg;
    let table = ChainLink { mass_kg: 0.8 * stage.mass_kg, spring_n_m: 4.5e7, damper_n_s_m: 500.0, ..*stage };
    let whole = Chain::new(&[motor, table, ChainLink { mass_kg: post, ..ChainLink::default() }]);
    let hz = 500.0;
    let w2 = (TAU * hz).powi(2);
    // Motion of the table: the post's as the chain says, taken back through its spring.
    let x = whole.receptance(hz);
    let spring = Complex64::new(4.5e7, TAU * hz * 500.0);
    let table_m = x.stage_per_cutting + (1.0 - w2 * post * x.stage_per_cutting) / spring;
    let (mut samples, mut force_n) = (Vec::new(), Vec::new());
    for i in 0..30_000 {
        let turned = Complex64::from_polar(10.0, TAU * hz * f64::from(i) / RATE_HZ);
        samples.push(MotionSample {
            motor_travel_m: Some((turned * x.motor_per_cutting).im),
            stage_position_m: Some((turned * table_m).im),
            ..MotionSample::default()
        });
        force_n.push(turned.im);
    }
    let [error, expected, flagged] = said(Method::Medob, &drive, &(samples, force_n));
    assert!(error > 0.05 && expected < 0.1 && flagged == 0.0, "{error} {expected}");
}

/// One mass for an axis that has two is right below its mode only.
#[test]
fn a_force_above_the_usable_band_is_flagged() {
    let drive = prompt_drive();
    let signals = AxisSignals { drive: &drive, rate: rate(), signals: Signals::Both };
    let estimator = ForceEstimator::new(Method::Dob, &signals, ForceSettings::default()).unwrap();
    let end_hz = estimator.properties().usable_band_hz[1];
    assert!((50.0..200.0).contains(&end_hz), "{end_hz}");
    for (hz, flagged) in [(0.5 * end_hz, false), (2.0 * end_hz, true)] {
        let (samples, _) = shaken(&Chain::of_drive(&drive), &[(hz, 10.0)]);
        let flags = estimate_run(&estimator, &samples)[29_999].flags;
        assert_eq!(flags.contains(Validity::FORCE_ABOVE_BAND), flagged, "{hz} Hz: {flags}");
        assert!(flags.may_act(), "a warning, no reason to hold: {flags}");
    }
}

/// A heavy slide on a heavy motor, as the virtual lathe's turret axes are.
fn heavy_drive() -> DriveParams {
    DriveParams::new(RawDriveParams {
        screw_lead_m: Some(8.0e-3),
        rotary_inertia_kg_m2: Some(2.3e-3),
        movable_mass_kg: Some(150.0),
        axial_stiffness_n_m: Some(1.3e8),
        structural_damping_n_s_m: Some(9.0e3),
        motor_encoder_resolution_m: Some(66.7e-9),
        stage_encoder_resolution_m: Some(1.0e-9),
        ..RawDriveParams::default()
    })
    .unwrap()
}

fn heavy_observer() -> Observer {
    let axis =
        AxisModel { name: "x".to_owned(), drive: heavy_drive(), controller: None, physics: Vec::new() };
    let mut plan = ServoPlan::of_axis(&axis, Method::Medob, Signals::Both);
    plan.motor_cutoff_hz = Some(140.0);
    Observer::new(&ForcePlan::Servo(plan), rate()).unwrap()
}

/// Behind a low-pass of the drive side the observer is wrong around the axial mode alone: above it that side
/// carries nothing, so a line there has the right size and no flag.
#[test]
fn above_the_axial_mode_the_drive_sides_low_pass_lacks_nothing() {
    let [_, end_hz] = heavy_observer().properties().usable_band_hz;
    let again_hz = heavy_observer().properties().usable_above_hz.expect("right again");
    assert!((50.0..140.0).contains(&end_hz) && (450.0..600.0).contains(&again_hz), "{end_hz} {again_hz}");
    for (hz, flagged) in
        [(0.5 * end_hz, false), (250.0, true), (0.75 * again_hz, true), (1.05 * again_hz, false)]
    {
        let mut observer = heavy_observer();
        let (samples, _) = shaken(&Chain::of_drive(&heavy_drive()), &[(hz, 50.0)]);
        let estimates: Vec<ForceEstimate> = samples.iter().map(|s| observer.step(s)).collect();
        let late: Vec<f64> = estimates[20_000..].iter().map(|e| e.force_n).collect();
        let size = deviation(&late) / (50.0 / 2f64.sqrt());
        assert_eq!((size - 1.0).abs() > 0.11, flagged, "{hz} Hz: {size}");
        let flags = estimates[29_999].flags;
        assert_eq!(flags.contains(Validity::FORCE_ABOVE_BAND), flagged, "{hz} Hz: {flags}");
    }
}

/// Steps of the rotary encoder reach the estimate through the drive side's low-pass: the floor that is stated
/// is the scatter that they make.
#[test]
fn the_noise_floor_is_that_behind_the_drive_sides_low_pass() {
    let mut observer = heavy_observer();
    let mut random = 1_u64;
    let mut reading = |step_m: f64| {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        Some(((random >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * step_m)
    };
    let estimates: Vec<f64> = (0..30_000)
        .map(|_| {
            let (motor_travel_m, stage_position_m) = (reading(66.7e-9), reading(1.0e-9));
            observer
                .step(&MotionSample { motor_travel_m, stage_position_m, ..MotionSample::default() })
                .force_n
        })
        .collect();
    let share = deviation(&estimates[3000..]) / observer.properties().noise_floor_n;
    assert!((0.9..1.1).contains(&share), "{share} of {} N", observer.properties().noise_floor_n);
}

/// Where the stated band ends behind a low-pass of the drive side, a tenth of the force is missing.
#[test]
fn the_band_behind_a_low_pass_of_the_drive_side_ends_at_a_tenth() {
    let drive = prompt_drive();
    let axis =
        AxisModel { name: "x".to_owned(), drive: drive.clone(), controller: None, physics: Vec::new() };
    for cutoff_hz in [150.0, 600.0] {
        let mut plan = ServoPlan::of_axis(&axis, Method::Medob, Signals::Both);
        plan.settings.low_pass = LowPass::LinearPhase { pass_hz: 900.0, width_hz: 400.0 };
        plan.motor_cutoff_hz = Some(cutoff_hz);
        let mut observer = Observer::new(&ForcePlan::Servo(plan), rate()).unwrap();
        let end_hz = observer.properties().usable_band_hz[1];
        assert!(end_hz < 900.0, "{cutoff_hz}: {end_hz}");
        let (samples, _) = shaken(&Chain::of_drive(&drive), &[(end_hz, 10.0)]);
        let estimates: Vec<f64> = samples.iter().map(|s| observer.step(s).force_n).collect();
        let force_n = |i: usize| {
            let t = i as f64 / RATE_HZ - observer.properties().delay_s;
            10.0 * (TAU * end_hz * t + end_hz).sin()
        };
        let error: Vec<f64> = (20_000..30_000).map(|i| estimates[i] - force_n(i)).collect();
        let share = deviation(&error) / (10.0 / 2f64.sqrt());
        assert!((0.09..0.12).contains(&share), "{cutoff_hz} Hz, {end_hz} Hz: {share}");
    }
}

/// A mass under the loop of the model, sample by sample, whose readings carry white errors of a step: thrust
/// and lines of the thrust scatter as stated.
#[test]
fn encoder_steps_reach_the_thrust_through_the_loop() {
    const MASS_KG: f64 = 20.0;
    const STEP_M: f64 = 1e-7;
    let drive = DriveParams::new(RawDriveParams {
        movable_mass_kg: Some(MASS_KG),
        stage_encoder_resolution_m: Some(STEP_M),
        motor_encoder_resolution_m: Some(STEP_M),
        ..RawDriveParams::default()
    })
    .unwrap();
    let (c, dt) = (CONTROLLER, 1.0 / RATE_HZ);
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let (mut x, mut v, mut integral, mut speed, mut last) = (0.0, 0.0, 0.0, 0.0, 0.0);
    let samples: Vec<MotionSample> = (0..200_000)
        .map(|_| {
            let mut read = || x + STEP_M * (random.random::<f64>() - 0.5);
            let (motor, stage) = (read(), read());
            // s w/(s + w) by trapezoids.
            let w = c.velocity_filter_rad_s;
            speed = ((1.0 - 0.5 * w * dt) * speed + w * (motor - last)) / (1.0 + 0.5 * w * dt);
            last = motor;
            let error = -c.position_gain_1_s * stage - speed;
            integral += c.velocity_integral_1_s * error * dt;
            let thrust_n = MASS_KG * c.velocity_gain_1_s * (error + integral);
            let a = thrust_n / MASS_KG;
            x += dt * (v + 0.5 * dt * a);
            v += dt * a;
            MotionSample {
                thrust_ref_n: thrust_n,
                motor_travel_m: Some(motor),
                stage_position_m: Some(stage),
                ..MotionSample::default()
            }
        })
        .collect();
    let signals = AxisSignals { drive: &drive, rate: rate(), signals: Signals::Both };
    let settings = ForceSettings {
        controller: Some(c),
        low_pass: LowPass::Butterworth { order: 4, cutoff_hz: 500.0 },
        harmonic: Some(HarmonicSettings { lines_per_turn: 2.0, ..HarmonicSettings::at_speed(3000.0) }),
        ..ForceSettings::default()
    };
    // The window of spectral has no line above 500 Hz.
    for (method, low_pass) in [(Method::Thrust, settings.low_pass), (Method::Spectral, LowPass::None)] {
        let settings = ForceSettings { low_pass, ..settings.clone() };
        let estimator = ForceEstimator::new(method, &signals, settings).unwrap();
        let seen: Vec<f64> = estimate_run(&estimator, &samples)[10_000..].iter().map(|e| e.force_n).collect();
        let (is_n, stated_n) = (deviation(&seen), estimator.properties().noise_floor_n);
        assert!((stated_n / is_n - 1.0).abs() < 0.1, "{method:?}: {stated_n} stated, {is_n} N");
    }
    // One step of 1e-7 m for an octave more of band: the loop, not a constant.
    let of = |hz: f64| {
        let low = Butterworth::low_pass(4, hz, rate()).unwrap();
        ClosedLoop::around(&drive, c, rate()).step_noise_n([STEP_M; 2], rate(), |f| {
            let (re, im) = low.response(f);
            re.hypot(im)
        })
    };
    assert!(of(400.0) > 1.5 * of(200.0));
}

/// Rows of a whole recording have the flags of their own instant: nothing settles, a speed beyond the runs is
/// told of where it is.
#[test]
fn rows_of_accelerometers_have_their_flags() {
    let estimator = FrfEstimator {
        axis: "x".to_owned(),
        nodes_hz: vec![7.0, 400.0],
        values: vec![[Complex64::new(1.0, 0.0); 9]; 2],
        speed_range_rpm: [500.0, 7500.0],
        noise_floor_n: 0.0,
        condition: 1.0,
    };
    let rate = SampleRate::new(1000.0).unwrap();
    let speed = |i: usize| if (8000..8100).contains(&i) { 9000.0 } else { 3000.0 };
    let speeds: Vec<f64> = (0..16_000).map(speed).collect();
    let accel: Vec<[f64; 3]> = (0..16_000).map(|i| [(TAU * 50.0 * i as f64 / 1000.0).sin(); 3]).collect();
    let rows = force_of_recording(&estimator, rate, &accel, &speeds).unwrap();
    assert_eq!(rows.len(), 16_000);
    assert!(rows.iter().all(|row| !row.flags.contains(Validity::SETTLING)));
    let beyond = |i: usize| rows[i].flags.contains(Validity::EXTRAPOLATED);
    assert!(beyond(8000) && beyond(8099), "where it turns too fast");
    assert!((0..16_000).all(|i| !beyond(i) || (7000..9200).contains(&i)), "far from there");
}

const BENCH: &str = "[machine]\nname = \"b\"\nsample_rate_hz = 9000.0\n[axes.x]\nmovable_mass_kg = 6.0\n\
    screw_lead_m = 0.005\nrotary_inertia_kg_m2 = 5.0e-5\ntorque_constant_nm_a = 0.2\n";

fn replay(folder: &Path, flags: f64) -> Output {
    let n = 27_000_u32;
    let noise = |i: u32| (f64::from(i.wrapping_mul(2_654_435_761) >> 8) / 8_388_608.0 - 1.0) * 2.0;
    let force: Vec<f64> = (0..n)
        .map(|i| {
            let t = f64::from(i) / 9000.0;
            let size_n = if t > 1.5 { (0.05 * ((t - 1.5) * 25.0).exp()).min(60.0) } else { 0.0 };
            40.0 + noise(i) + size_n * (TAU * 652.0 * t).sin()
        })
        .collect();
    let (times, speed): (Vec<f64>, Vec<f64>) = (0..n).map(|i| (f64::from(i) / 9000.0, 1200.0)).unzip();
    let bits = vec![flags; force.len()];
    let mut columns = vec![
        ("t_s", TableColumn::Double(&times)),
        ("x_force_n", TableColumn::Double(&force)),
        ("spindle_speed_rpm", TableColumn::Double(&speed)),
    ];
    if flags != 0.0 {
        columns.push(("x_force_flags", TableColumn::Double(&bits)));
    }
    let metadata = [
        ("format", stillcut::recording::FORMAT),
        ("sample_rate_hz", "9000.0"),
        ("experiment", "cut"),
        ("axes", "x"),
        ("analysis_band_hz", "550,750"),
    ]
    .map(|(key, value)| (key.to_owned(), value.to_owned()));
    write_table(&folder.join("f.parquet"), &Table { columns, metadata: metadata.into() }).unwrap();
    Command::new(env!("CARGO_BIN_EXE_stillcut"))
        .current_dir(folder)
        .args(["replay", "--recording", "f.parquet", "--out", "out"])
        .output()
        .unwrap()
}

/// A stored force is as good as its flags say: what settles is not listened to, what forbids acting has no
/// pitch, what only warns has one.
#[test]
fn replay_honours_the_flags_of_a_stored_force() {
    let folder = tempfile::tempdir().unwrap();
    let onset = |flags: Validity| {
        let run = replay(folder.path(), f64::from(flags.bits()));
        assert!(run.status.success(), "{flags}: {}", String::from_utf8_lossy(&run.stderr));
        let events = std::fs::read_to_string(folder.path().join("out/events.jsonl")).unwrap();
        let onset = events.lines().find(|line| line.contains("chatter_onset")).map(str::to_owned);
        (onset, String::from_utf8_lossy(&run.stdout).into_owned())
    };
    let pitch = "pitch_difference_rad\":0.";
    assert!(onset(Validity::VALID).0.unwrap().contains(pitch));
    assert!(onset(Validity::MODE_OUTSIDE_MODEL).0.unwrap().contains(pitch));
    let (line, said) = onset(Validity::EXTRAPOLATED | Validity::MODE_OUTSIDE_MODEL);
    assert!(!line.unwrap().contains(pitch));
    assert!(said.contains("axis x: 27000 of 27000 rows are no ground to act on"), "{said}");
    assert_eq!(onset(Validity::SETTLING).0, None);
    for wrong in [0.5, -1.0, 32_768.0] {
        let run = replay(folder.path(), wrong);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{wrong}: {said}");
        assert!(
            said.contains("column x_force_flags, row 0") && said.trim_end().lines().count() == 1,
            "{said}"
        );
    }
}

fn idle_run(rate_hz: f64, feed_m_s: f64) -> Recording {
    let column = |name: &str, value: &dyn Fn(f64) -> f64| Column {
        name: name.to_owned(),
        values: (0..18_000).map(|i| value(f64::from(i) / rate_hz)).collect(),
    };
    Recording {
        sample_rate: SampleRate::new(rate_hz).unwrap(),
        experiment: "idle".to_owned(),
        axes: vec!["x".to_owned()],
        columns: vec![
            column("x_current_ref_a", &|_| 0.1),
            column("x_motor_angle_rad", &|t| TAU / 0.005 * feed_m_s * t),
            column("x_stage_position_m", &|t| feed_m_s * t),
        ],
        start_s: 0.0,
        metadata: Vec::new(),
    }
}

/// An idle run that no map can be made of is refused with its reason, not left out.
#[test]
fn an_idle_run_that_gives_no_map_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("m.toml"), BENCH).unwrap();
    for (rate_hz, feed_m_s, expected) in [
        (9000.0, 0.01, None),
        (4500.0, 0.01, Some("idle.parquet: axis x: sampled at 4500 Hz, expected 9000 Hz as the machine")),
        (9000.0, 0.0, Some("machine.axes.x.idle: no run moves the axis")),
    ] {
        write_recording(&folder.path().join("idle.parquet"), &idle_run(rate_hz, feed_m_s)).unwrap();
        let text = "[machine]\nmodel = \"m.toml\"\nmethod = \"dob\"\nwatch = [\"x\"]\n\
            [machine.axes.x]\nidle = [\"idle.parquet\"]\n";
        let mut config = service_config_from_text(&folder.path().join("s.toml"), text).unwrap();
        let read = config.force.read_idle_runs(&config.machine.clone(), read_recording);
        match expected {
            None => {
                read.unwrap();
                let settings = config.pipeline_settings(SampleRate::new(9000.0).unwrap(), &["x".into()]);
                let plan = settings.axes[0].force.as_ref().and_then(ForcePlan::servo).unwrap();
                assert_eq!(plan.settings.idle_map.as_ref().map(|map| map.runs()), Some(1));
            }
            Some(expected) => {
                let said = read.unwrap_err();
                assert!(said.contains(expected) && said.lines().count() == 1, "{said}");
            }
        }
    }
}
