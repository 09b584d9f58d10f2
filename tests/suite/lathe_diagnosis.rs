//! The drives of the virtual lathe, diagnosed with the model of that lathe: nothing is missing in it.

use std::path::Path;
use stillcut::config::machine::read_machine;
use stillcut::diagnosis::{DiagnoseError, DiagnoseOptions, Diagnosis, Verdict, diagnose_with};
use stillcut::gate::{Criteria, Gated, Logged, check};
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
    let axes: Vec<String> = machine.axes.iter().map(|a| a.name.clone()).collect();
    let gated = check(&Logged::even(recording), &axes, &Criteria::default());
    let options = DiagnoseOptions {
        masked: vec![Gated::masked(&gated)],
        resting: vec![Gated::resting(&gated)],
        ..DiagnoseOptions::default()
    };
    diagnose_with(machine, &[gated.recording], &options, &|_, _| {})
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
    // An axis that stands is moved by the cut alone, whether the recording says so or not.
    for tells_width in [true, false] {
        let standing = asked(&machine, recorded(&Life { entry_s: 1.0, acts_s: 99.0, tells_width }, 4));
        let all = |axis: &str| axis.contains("x1") && axis.contains("y1");
        assert!(matches!(standing, Err(DiagnoseError::Standing { axis, .. }) if all(&axis)));
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
