//! The live pipeline and `stillcut force` give the same numbers, for every method; two estimators side by
//! side; what the pipeline does not act on.

use std::f64::consts::TAU;
use std::path::Path;
use std::process::Command;
use stillcut::config::machine::read_machine;
use stillcut::config::service::{ServiceConfig, service_config_from_text};
use stillcut::force::balance::Method;
use stillcut::force::frf::FrfEstimator;
use stillcut::force::observer::Observer;
use stillcut::force::plan::{ForcePlan, ServoPlan};
use stillcut::force::recorded::motion_of_recording;
use stillcut::force::validity::Validity;
use stillcut::pipeline::{Pipeline, StepOutput};
use stillcut::plant::machine::AxisModel;
use stillcut::recording::{read_recording, write_recording};
use stillcut::sample::{AxisSample, Column, MAX_AXES, Recording, ServoSample};
use stillcut::units::SampleRate;

const RATE_HZ: f64 = 5000.0;

const MODEL: &str = r#"
[machine]
name = "bench"
sample_rate_hz = 5000.0

[axes.x]
screw_lead_m = 0.005
rotary_inertia_kg_m2 = 5.0e-5
movable_mass_kg = 6.0
torque_constant_nm_a = 0.2
axial_stiffness_n_m = 4.3e7
structural_damping_n_s_m = 2000.0
rotary_damping_nm_s_rad = 7.0e-3
translational_damping_n_s_m = 600.0
stage_coulomb_friction_n = 8.0
motor_coulomb_friction_n = 50.0
current_loop_bandwidth_rad_s = 5000.0
amplifier_dead_time_s = 2.0e-4
motor_encoder_delay_s = 2.0e-4
stage_encoder_delay_s = 2.0e-4
motor_encoder_resolution_m = 6.0e-10
stage_encoder_resolution_m = 2.4e-10
screw_inertia_kg_m2 = 2.0e-5
torsional_stiffness_nm_rad = 300.0
torsional_damping_nm_s_rad = 1.0e-3

[axes.x.controller]
position_gain_1_s = 60.0
velocity_gain_1_s = 220.0
velocity_integral_1_s = 20.0
velocity_filter_rad_s = 3000.0
"#;

/// Two seconds and a half of an axis that moves and shakes; the spindle turns at one speed, then at another.
fn recording(speeds_rpm: [f64; 2]) -> Recording {
    let n = 12_500;
    let mut columns: Vec<Column> = [
        "x_current_ref_a",
        "x_motor_angle_rad",
        "x_stage_position_m",
        "x_nut_position_m",
        "spindle_speed_rpm",
        "x_accel_m_s2",
        "y_accel_m_s2",
        "z_accel_m_s2",
    ]
    .map(|name| Column { name: name.to_owned(), values: Vec::with_capacity(n) })
    .into();
    for i in 0..n {
        let t = i as f64 / RATE_HZ;
        let rpm = speeds_rpm[usize::from(t > 0.8)];
        let wave = |f: f64, phase: f64| (TAU * f * t + phase).sin();
        let slow_m = 5e-3 * t;
        let stage_m = slow_m + 3e-7 * wave(40.0, 0.4) + 4e-8 * wave(330.0, 0.0);
        let values = [
            1.0 + 0.6 * wave(20.0, 0.1) + 0.2 * wave(40.0, 1.0),
            (slow_m + 2e-7 * wave(40.0, 0.0)) * TAU / 0.005,
            stage_m,
            stage_m + 1e-8 * wave(90.0, 0.3),
            rpm,
            wave(60.0, 0.0) + 0.3 * wave(180.0, 0.7),
            0.5 * wave(60.0, 1.0),
            0.1 * wave(120.0, 2.0),
        ];
        columns.iter_mut().zip(values).for_each(|(c, v)| c.values.push(v));
    }
    Recording {
        sample_rate: SampleRate::new(RATE_HZ).unwrap(),
        experiment: "live".to_owned(),
        axes: vec!["x".to_owned(), "xn".to_owned()],
        columns,
        start_s: 0.0,
        metadata: Vec::new(),
    }
}

fn estimator() -> FrfEstimator {
    let value = |k: usize| rustfft::num_complex::Complex64::new(1e6 * k as f64, 2e5);
    FrfEstimator {
        axis: "x".to_owned(),
        nodes_hz: vec![10.0, 50.0, 200.0, 400.0],
        values: (0..4).map(|k| std::array::from_fn(|u| value(k + u))).collect(),
        speed_range_rpm: [500.0, 3000.0],
        noise_floor_n: 0.1,
        condition: 10.0,
    }
}

/// Each row of the recording as the machine would publish it; the third position travels with an axis of its
/// own.
fn samples(r: &Recording) -> Vec<ServoSample> {
    let column = |name: &str| r.require(name).unwrap();
    let (current, angle) = (column("x_current_ref_a"), column("x_motor_angle_rad"));
    let (stage, nut) = (column("x_stage_position_m"), column("x_nut_position_m"));
    let speed = column("spindle_speed_rpm");
    let accel = ["x", "y", "z"].map(|a| column(&format!("{a}_accel_m_s2")));
    let sample = |i: usize| {
        let mut axes = [AxisSample::default(); MAX_AXES];
        let (current_ref_a, motor_angle_rad) = (current[i], angle[i]);
        axes[0] = AxisSample { current_ref_a, motor_angle_rad, stage_position_m: Some(stage[i]) };
        axes[1].stage_position_m = Some(nut[i]);
        ServoSample {
            sequence: i as u64,
            t_s: r.time_s(i),
            axes,
            spindle_angle_rad: 0.0,
            spindle_speed_rpm: speed[i],
            accel_m_s2: Some(accel.map(|a| a[i])),
            pitch_difference_rad: None,
        }
    };
    (0..r.len()).map(sample).collect()
}

/// The configuration of a service; `axis` is the table of axis x.
fn config(folder: &Path, axis: &str) -> ServiceConfig {
    let text = format!(
        "[machine]\nmodel = \"m.toml\"\naccelerometers = \"e.json\"\nwatch = [\"x\"]\n\
         motor_cutoff_hz = 1e5\n[detection]\nband_hz = [500.0, 700.0]\n[machine.axes.x]\n{axis}"
    );
    service_config_from_text(&folder.join("stillcut.toml"), &text).unwrap()
}

fn pipeline(folder: &Path, axis: &str) -> Pipeline {
    let rate = SampleRate::new(RATE_HZ).unwrap();
    Pipeline::new(config(folder, axis).pipeline_settings(rate, &["x".into(), "xn".into()])).unwrap()
}

fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let text = stillcut::config::accelerometers::estimators_to_text(&[estimator()]);
    std::fs::write(folder.path().join("m.toml"), MODEL).unwrap();
    std::fs::write(folder.path().join("e.json"), text).unwrap();
    folder
}

const METHODS: [&str; 9] = [
    "thrust",
    "dob",
    "medob",
    "rigid_mode",
    "vibration_mode",
    "second_vibration_mode",
    "fitted",
    "spectral",
    "frf",
];

/// Live, sample by sample, against the command on the same recording: the same bits, also where the
/// spindle's speed changes on the way.
#[test]
fn every_method_gives_the_same_numbers_live_and_in_the_command() {
    let folder = folder();
    let r = recording([1200.0, 1500.0]);
    write_recording(&folder.path().join("r.parquet"), &r).unwrap();
    for method in METHODS {
        let run = Command::new(env!("CARGO_BIN_EXE_stillcut"))
            .current_dir(folder.path())
            .args(["force", "--model", "m.toml", "--estimator", "e.json", "--recording", "r.parquet"])
            .args(["--method", method, "--live", "--cutoff-hz", "1000", "--out", "f.parquet"])
            .output()
            .unwrap();
        assert!(run.status.success(), "{method}: {}", String::from_utf8_lossy(&run.stderr));
        let command = read_recording(&folder.path().join("f.parquet")).unwrap();
        let command = command.require("x_force_n").unwrap();
        let mut live = pipeline(folder.path(), &format!("method = \"{method}\"\nnut = \"xn\"\n"));
        let mut largest: f64 = 0.0;
        for (i, sample) in samples(&r).iter().enumerate() {
            let force_n = live.step(sample).forces[0].force_n;
            largest = largest.max(force_n.abs());
            assert_eq!(
                force_n.to_bits(),
                command[i].to_bits(),
                "{method} at sample {i}: {force_n} {}",
                command[i]
            );
        }
        assert!(largest > 1.0, "{method}: nothing but {largest} N");
    }
}

/// Air-cutting runs named in the configuration are taken off live as the command takes them off.
#[test]
fn idle_runs_are_taken_off_live_too() {
    let folder = folder();
    let mut idle = recording([1200.0, 1200.0]);
    write_recording(&folder.path().join("r.parquet"), &idle).unwrap();
    idle.columns.iter_mut().filter(|c| c.name == "x_current_ref_a").for_each(|c| c.values.fill(0.4));
    write_recording(&folder.path().join("i.parquet"), &idle).unwrap();
    for method in ["medob", "fitted"] {
        let run = Command::new(env!("CARGO_BIN_EXE_stillcut"))
            .current_dir(folder.path())
            .args(["force", "--model", "m.toml", "--recording", "r.parquet", "--idle", "i.parquet"])
            .args(["--method", method, "--live", "--cutoff-hz", "1000", "--out", "f.parquet"])
            .output()
            .unwrap();
        assert!(run.status.success(), "{method}: {}", String::from_utf8_lossy(&run.stderr));
        let command = read_recording(&folder.path().join("f.parquet")).unwrap();
        let axis = format!("method = \"{method}\"\nnut = \"xn\"\nidle = [\"i.parquet\"]\n");
        let mut config = config(folder.path(), &axis);
        config.force.read_idle_runs(&config.machine, read_recording).unwrap();
        let rate = SampleRate::new(RATE_HZ).unwrap();
        let mut live = Pipeline::new(config.pipeline_settings(rate, &["x".into(), "xn".into()])).unwrap();
        for (sample, force_n) in samples(&read_recording(&folder.path().join("r.parquet")).unwrap())
            .iter()
            .zip(command.require("x_force_n").unwrap())
        {
            assert_eq!(live.step(sample).forces[0].force_n.to_bits(), force_n.to_bits(), "{method}");
        }
    }
    let mut missing = config(folder.path(), "idle = [\"none.parquet\"]\n");
    assert!(missing.force.read_idle_runs(&missing.machine.clone(), read_recording).is_err());
}

/// What the model has beyond its structure is taken off by every method that balances forces, windows too.
#[test]
fn physics_of_the_model_is_taken_off_by_every_balance() {
    let folder = folder();
    let gravity = "\n[[axes.x.physics]]\neffect = \"gravity_load\"\nport = \"stage\"\nforce_n = 50.0\n";
    std::fs::write(folder.path().join("g.toml"), format!("{MODEL}{gravity}")).unwrap();
    let rate = SampleRate::new(RATE_HZ).unwrap();
    let samples =
        motion_of_recording(&recording([1200.0, 1200.0]), "x", &drive(folder.path(), "m.toml").drive);
    let samples = samples.unwrap();
    let last_n = |model: &str, method: Method| {
        let plan = ServoPlan::of_axis(&drive(folder.path(), model), method, samples.signals);
        let mut observer = Observer::new(&ForcePlan::Servo(plan), rate).unwrap();
        samples.samples.iter().map(|s| observer.step(s).force_n).last().unwrap()
    };
    for method in
        [Method::Dob, Method::Medob, Method::VibrationMode, Method::SecondVibrationMode, Method::Fitted]
    {
        let taken_n = last_n("m.toml", method) - last_n("g.toml", method);
        assert!((taken_n - 50.0).abs() < 1e-3, "{method:?}: {taken_n} N");
    }
}

fn drive(folder: &Path, model: &str) -> AxisModel {
    read_machine(&folder.join(model)).unwrap().axis("x").unwrap().clone()
}

/// A keyframe of a pipeline with two windowed estimators and one of accelerometers, before and after the
/// spindle's new speed made a new design, leads on as the original.
#[test]
fn keyframes_hold_windows_made_for_a_speed() {
    let folder = folder();
    let stream = samples(&recording([1200.0, 1500.0]));
    for axis in ["method = \"fitted\"\nbeside = \"frf\"\n", "method = \"frf\"\nbeside = \"spectral\"\n"] {
        let mut live = pipeline(folder.path(), axis);
        let (mut frames, mut heard) = (Vec::new(), Vec::new());
        for (i, sample) in stream.iter().enumerate() {
            if [0, 700, 4100, 6000, 11_000].contains(&i) {
                let mut words = Vec::new();
                live.keep(&mut words);
                frames.push((i, words));
            }
            heard.push(live.step(sample));
        }
        for (from, words) in frames {
            let mut again = pipeline(folder.path(), axis);
            again.step(&stream[9000]);
            again.restore(&words).unwrap();
            for (sample, before) in stream[from..].iter().zip(&heard[from..]) {
                let now = StepOutput { spectrum_updated: before.spectrum_updated, ..again.step(sample) };
                assert_eq!(now, *before, "{axis} from keyframe {from}");
            }
        }
    }
}

#[test]
fn two_estimators_report_how_far_they_are_apart() {
    let folder = folder();
    let stream = samples(&recording([1200.0, 1200.0]));
    // Two names of one mode agree to the last bit; accelerometers that hear something else do not.
    for (beside, apart) in [("rigid_mode", false), ("frf", true)] {
        let axis = format!("method = \"medob\"\nbeside = \"{beside}\"\n");
        let mut live = pipeline(folder.path(), &axis);
        let outputs: Vec<StepOutput> = stream.iter().map(|s| live.step(s)).collect();
        let apart_n = live.disagreement_n(0).unwrap();
        assert_eq!(apart_n > 1.0, apart, "{beside}: {apart_n} N");
        let flags = outputs.last().unwrap().forces[0].flags;
        assert_eq!(flags.contains(Validity::ESTIMATORS_DISAGREE), apart, "{beside}: {flags}");
        // It is a report: the estimate that is acted on stays what it is.
        assert!(live.axis_may_act(0));
    }
    let alone = pipeline(folder.path(), "method = \"medob\"\n");
    assert_eq!(alone.disagreement_n(0), None);
}

#[test]
fn what_is_not_known_is_not_acted_on() {
    let folder = folder();
    let stream = samples(&recording([1200.0, 1500.0]));
    let mut live = pipeline(folder.path(), "method = \"medob\"\n");
    assert!(!live.axis_may_act(0), "before the first sample");
    live.step(&stream[0]);
    assert!(!live.axis_may_act(0), "while the filters settle");
    stream[1..3000].iter().for_each(|s| {
        live.step(s);
    });
    assert!(live.axis_may_act(0) && live.may_act());
    let mut blind = stream[3000];
    blind.axes[0].stage_position_m = None;
    live.step(&blind);
    assert!(!live.axis_may_act(0) && !live.may_act(), "without the scale");
    // A window for 1200 rpm says nothing at 1500 rpm, until a new one is made and filled.
    let mut live = pipeline(folder.path(), "method = \"fitted\"\n");
    let refused: Vec<bool> = stream
        .iter()
        .map(|s| {
            live.step(s);
            !live.axis_may_act(0)
        })
        .collect();
    let between = |from_s: f64, to_s: f64| &refused[(from_s * RATE_HZ) as usize..(to_s * RATE_HZ) as usize];
    assert!(between(0.0, 0.05).iter().all(|r| *r), "while the window fills");
    assert!(between(0.1, 0.8).iter().all(|r| !r));
    assert!(between(1.05, 1.2).iter().all(|r| *r), "at another speed");
    assert!(between(1.8, 2.4).iter().all(|r| !r), "once the new window is full");
    // Accelerometers that fall silent.
    let mut live = pipeline(folder.path(), "method = \"frf\"\n");
    stream[..6000].iter().for_each(|s| {
        live.step(s);
    });
    assert!(live.axis_may_act(0));
    live.step(&ServoSample { accel_m_s2: None, ..stream[6000] });
    assert!(!live.axis_may_act(0));
}

/// A semi-closed axis and one that stands still under its friction: the estimate is refused, the bound is
/// told.
#[test]
fn below_friction_the_pipeline_holds_and_the_command_has_no_number() {
    let folder = folder();
    let mut r = recording([1200.0, 1200.0]);
    for column in &mut r.columns {
        match column.name.as_str() {
            "x_current_ref_a" => column.values.fill(0.05),
            "x_motor_angle_rad" | "x_stage_position_m" => column.values.fill(0.25),
            _ => {}
        }
    }
    write_recording(&folder.path().join("r.parquet"), &r).unwrap();
    let mut live = pipeline(folder.path(), "method = \"spectral\"\n");
    samples(&r).iter().for_each(|s| {
        live.step(s);
    });
    assert!(!live.axis_may_act(0) && live.force_flags(0).contains(Validity::BELOW_FRICTION));
    let run = Command::new(env!("CARGO_BIN_EXE_stillcut"))
        .current_dir(folder.path())
        .args([
            "force",
            "--model",
            "m.toml",
            "--recording",
            "r.parquet",
            "--method",
            "spectral",
            "--out",
            "f.parquet",
        ])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&run.stdout).into_owned();
    assert!(said.contains("below friction, not observable, bound 58 N"), "{said}");
    let error = read_recording(&folder.path().join("f.parquet")).unwrap_err().to_string();
    assert!(error.contains("x_force_n") && error.contains("NaN"), "{error}");
}

/// `stillcut force` on r.parquet of a folder.
fn force(folder: &Path, options: &[&str]) -> std::process::Output {
    Command::new(env!("CARGO_BIN_EXE_stillcut"))
        .current_dir(folder)
        .args(["force", "--model", "m.toml", "--estimator", "e.json", "--recording", "r.parquet"])
        .args(["--out", "f.parquet"])
        .args(options)
        .output()
        .unwrap()
}

#[test]
fn the_command_flags_rows_in_which_two_estimators_disagree() {
    let folder = folder();
    write_recording(&folder.path().join("r.parquet"), &recording([1200.0, 1200.0])).unwrap();
    for (beside, apart) in [("rigid_mode", false), ("frf", true)] {
        let run = force(folder.path(), &["--method", "medob", "--live", "--beside", beside]);
        assert!(run.status.success(), "{beside}: {}", String::from_utf8_lossy(&run.stderr));
        let flags = read_recording(&folder.path().join("f.parquet")).unwrap();
        let last = *flags.require("x_force_flags").unwrap().last().unwrap();
        let bit = f64::from(Validity::ESTIMATORS_DISAGREE.bits());
        assert_eq!((last / bit).floor() % 2.0 == 1.0, apart, "{beside}: {last}");
    }
}

#[test]
fn options_that_cannot_be_meant_are_refused_in_one_line() {
    let folder = folder();
    let whole = recording([1200.0, 1200.0]);
    write_recording(&folder.path().join("r.parquet"), &whole).unwrap();
    let mut lame = whole;
    lame.columns.retain(|c| c.name != "x_motor_angle_rad");
    write_recording(&folder.path().join("lame.parquet"), &lame).unwrap();
    for (options, expected) in [
        (
            ["--method", "medob", "--idle", "lame.parquet"],
            "lame.parquet: axis x: the linear scale alone, expected rotary encoder",
        ),
        (["--method", "medob", "--notch", "2500"], "a frequency below 2500 Hz"),
        (["--method", "medob", "--teeth", "2"], "--teeth: expected with --method fitted or spectral"),
        (["--method", "medob", "--pass-hz", "0.001"], "--pass-hz 0.001: expected at least"),
    ] {
        let run = force(folder.path(), &options);
        let said = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{options:?}: {said}");
        assert!(said.contains(expected) && said.trim_end().lines().count() == 1, "{options:?}: {said}");
        assert!(!folder.path().join("f.parquet").exists());
    }
}
