//! The drives of the virtual lathe, diagnosed with the model of that lathe: nothing is missing in it.

use std::path::Path;
use stillcut::config::machine::read_machine;
use stillcut::diagnosis::{DiagnoseError, DiagnoseOptions, Diagnosis, Verdict, diagnose_with};
use stillcut::gate::{Criteria, FaultKind, Gated, Logged, check};
use stillcut::plant::machine::Machine;
use stillcut::plant::scenario::{RawScenario, Scenario};
use stillcut::sample::{Column, Recording};
use stillcut::simulation::lathe::turret::TurretOrder;
use stillcut::simulation::lathe::{AXES, Lathe, LatheSettings};
use stillcut::units::SampleRate;

/// What a life of the lathe is made of.
struct Life {
    /// When the tools enter, s.
    entry_s: f64,
    /// A turret order a second from here on, s; never: none.
    acts_s: f64,
    /// The recording says when tools cut.
    tells_width: bool,
}

fn recorded(life: &Life, seconds: usize) -> Recording {
    let scenario = Scenario::new(&RawScenario { travel_m_s: -3.0e-3, ..RawScenario::default() }).unwrap();
    let settings = LatheSettings { entry_s: life.entry_s, ..LatheSettings::realistic(scenario, 5) };
    let mut lathe = Lathe::new(settings);
    let mut series: Vec<(String, Vec<f64>)> = Vec::new();
    let mut put = |name: String, value: f64| match series.iter_mut().find(|(n, _)| *n == name) {
        Some((_, values)) => values.push(value),
        None => series.push((name, vec![value])),
    };
    for row in 0..seconds * 9000 {
        if row % 9000 == 4500 && row as f64 / 9000.0 >= life.acts_s {
            // From -0.5 to 0.5 mm and back, never twice the same.
            let way = 0.5e-3 * (2.4 * (row / 9000) as f64).sin();
            let sequence = 1 + row as u64;
            lathe.turret_mut().order(&TurretOrder {
                epoch: 1,
                sequence,
                offset_m: [way, -1.3 * way],
                ttl_s: 2.5,
            });
        }
        let sample = lathe.step();
        for (axis, name) in sample.axes.iter().zip(AXES) {
            put(format!("{name}_current_ref_a"), axis.current_ref_a);
            put(format!("{name}_motor_angle_rad"), axis.motor_angle_rad);
            if let Some(x) = axis.stage_position_m {
                put(format!("{name}_stage_position_m"), x);
            }
        }
        put("spindle_speed_rpm".into(), sample.spindle_speed_rpm);
        put("radial_force_n".into(), lathe.truth().radial_force_n[0]);
        if life.tells_width {
            put("width_m".into(), lathe.truth().width_m);
        }
    }
    Recording {
        sample_rate: SampleRate::new(9000.0).unwrap(),
        experiment: "lathe".into(),
        axes: AXES.map(str::to_owned).to_vec(),
        columns: series.into_iter().map(|(name, values)| Column { name, values }).collect(),
        start_s: 0.0,
        metadata: Vec::new(),
    }
}

/// As the command does: the gate, then the physics.
fn asked(machine: &Machine, recording: Recording) -> Result<Diagnosis, DiagnoseError> {
    asked_of(machine, [recording])
}

fn asked_of<const N: usize>(
    machine: &Machine,
    recordings: [Recording; N],
) -> Result<Diagnosis, DiagnoseError> {
    let axes: Vec<String> = machine.axes.iter().map(|a| a.name.clone()).collect();
    let gated = recordings.map(|r| check(&Logged::even(r), &axes, &Criteria::default()));
    let options = DiagnoseOptions {
        masked: gated.iter().map(Gated::masked).collect(),
        resting: gated.iter().map(Gated::resting).collect(),
        ..DiagnoseOptions::default()
    };
    diagnose_with(machine, &gated.map(|g| g.recording), &options, &|_, _| {})
}

fn model() -> Machine {
    read_machine(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/turrets.toml")).unwrap()
}

#[test]
fn moves_in_air_are_those_of_the_model() {
    let recording = recorded(&Life { entry_s: 99.0, acts_s: 0.0, tells_width: false }, 9);
    let machine = model();
    for axis in &machine.axes {
        let alone = Machine { axes: vec![axis.clone()], ..machine.clone() };
        let d = asked(&alone, recording.clone()).unwrap();
        let said: Vec<&str> = d.findings.iter().map(|f| f.effect.name()).collect();
        assert_eq!((d.verdict, said), (Verdict::ModelAdequate, vec![]), "{}: {:?}", axis.name, d.notes);
        let others = AXES.iter().filter(|name| **name != axis.name);
        others.for_each(|name| assert!(d.notes.iter().any(|n| n.contains(name)), "{name}: {:?}", d.notes));
    }
}

#[test]
fn the_force_of_a_cut_is_no_physics_of_the_drive() {
    let machine = model();
    let told = asked(&machine, recorded(&Life { entry_s: 6.0, acts_s: 0.0, tells_width: true }, 9)).unwrap();
    assert_eq!(told.verdict, Verdict::ModelAdequate, "{:?}", told.notes);
    assert!(told.notes.iter().any(|n| n.contains("33 % of the rows")), "{:?}", told.notes);
}

/// An axis that stands is moved by the cut alone, whether the recording says so or not: that is no evidence for
/// or against its model, alone; beside a recording in which it moves the other is named and left out.
#[test]
fn where_every_axis_stands_in_the_cut_nothing_is_told_of_the_drive() {
    let machine = model();
    for tells_width in [true, false] {
        let standing = recorded(&Life { entry_s: 1.0, acts_s: 99.0, tells_width }, 4);
        let d = asked(&machine, standing.clone()).unwrap();
        let why = d.no_evidence.as_deref().unwrap();
        assert!(why.contains("x1") && why.contains("y1") && why.contains("nothing can be told"), "{why}");
        assert!(d.findings.is_empty() && d.parameter_corrections.is_empty() && d.recordings.is_empty());
        assert_eq!(d.model, machine, "the model is as it was");
        let moving = recorded(&Life { entry_s: 99.0, acts_s: 0.0, tells_width }, 9);
        let x1 = Machine { axes: machine.axes[..1].to_vec(), ..machine.clone() };
        let d = asked_of(&x1, [Recording { experiment: "onset".into(), ..standing }, moving]).unwrap();
        assert_eq!((d.no_evidence, d.left_out), (None, vec![0]));
        assert_eq!((d.verdict, d.findings.len()), (Verdict::ModelAdequate, 0), "{:?}", d.notes);
        assert_eq!(d.recordings.len(), 1, "what was left out has no residual");
        assert!(d.notes.iter().any(|n| n.starts_with("onset: left out")), "{:?}", d.notes);
    }
}

/// The current of a drive that holds its axis under the load of a cut has one sign and comes near zero between
/// two pushes; nothing of it was folded.
#[test]
fn a_load_that_comes_on_an_axis_that_stands_is_no_magnitude() {
    for (seed, width_mm) in [(1, 0.2), (2, 0.3), (3, 0.5)] {
        let folder = tempfile::tempdir().unwrap();
        let [scenario, out] = ["s.toml", "r.parquet"].map(|name| folder.path().join(name));
        let text = format!("[cutting]\nwidth_m = {width_mm}e-3\n[tools]\ntravel_m_s = 0.0\n");
        std::fs::write(&scenario, text).unwrap();
        let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_stillcut"));
        command
            .args(["simulate", "--servo", "--duration-s", "4", "--entry-s", "1", "--scenario"])
            .arg(scenario);
        command.args(["--seed", &format!("{seed}"), "--out"]).arg(&out);
        assert!(command.status().unwrap().success());
        let recording = stillcut::recording::read_recording(&out).unwrap();
        let current = recording.get("y2_current_ref_a").unwrap();
        assert!(current.iter().all(|i| *i >= 0.0), "one sign only");
        let gated = check(&Logged::even(recording), &AXES.map(str::to_owned), &Criteria::default());
        let rectified: Vec<_> = gated.faults.iter().filter(|f| f.kind == FaultKind::Rectified).collect();
        assert!(rectified.is_empty(), "{rectified:?}");
    }
}

/// Nothing says when tools cut: the force does, from when they enter and by how much, whether the axis feeds all
/// the time or stands but for a command or two; and nothing else is found.
#[test]
fn a_cut_that_no_column_tells_is_named_by_its_mean_force() {
    let machine = model();
    let x1 = Machine { axes: machine.axes[..1].to_vec(), ..machine.clone() };
    for (entry_s, acts_s, seconds) in [(6.0, 0.0, 12), (3.0, 11.0, 13)] {
        let recording = recorded(&Life { entry_s, acts_s, tells_width: false }, seconds);
        let in_cut: Vec<f64> =
            recording.get("radial_force_n").unwrap()[(entry_s * 9000.0) as usize..].to_vec();
        let true_n = in_cut.iter().sum::<f64>() / in_cut.len() as f64;
        let d = asked(&x1, recording).unwrap();
        let said: Vec<&str> = d.findings.iter().map(|f| f.effect.name()).collect();
        assert_eq!((d.verdict, said), (Verdict::MissingPhysics, vec!["cutting_force"]), "{:?}", d.notes);
        assert!(d.parameter_corrections.is_empty(), "{:?}", d.parameter_corrections);
        let of = |name: &str| d.findings[0].parameters.iter().find(|e| e.name == name).unwrap();
        let (start, end, mean) = (of("start_s"), of("end_s"), of("amplitude_n"));
        println!("{} s to {} s, {:?}; true {true_n} N", start.value, end.value, mean);
        assert!((start.value - entry_s).abs() < 0.1 && (end.value - seconds as f64).abs() < 0.1);
        assert!((mean.value / true_n - 1.0).abs() < 0.15);
        assert!(mean.ci95[0] > 0.0, "{:?}", mean.ci95);
    }
}
