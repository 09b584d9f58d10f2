//! After `Pipeline::new` and its first sample, a step allocates nothing: counted by the allocator itself.
#![allow(unsafe_code)] // a counting allocator is unsafe by nature; it only counts and forwards

use rustfft::num_complex::Complex64;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use stillcut::config::machine::read_machine;
use stillcut::force::balance::Method;
use stillcut::force::frf::FrfEstimator;
use stillcut::force::settings::ForceSettings;
use stillcut::force::signals::Signals;
use stillcut::pipeline::{AxisPlan, BandPlan, ForcePlan, Pipeline, PipelineSettings, ServoPlan};
use stillcut::plant::machine::Controller;
use stillcut::plant::scenario::Scenario;
use stillcut::simulation::lathe::{Lathe, LatheSettings};
use stillcut::units::SampleRate;

thread_local! {
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call is forwarded unchanged to the system's allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|n| n.set(n.get() + 1));
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn a_step_of_the_pipeline_allocates_nothing() {
    let scenario = Scenario::default();
    let machine = read_machine(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/turrets.toml")).unwrap();
    let plan = |name: &str| AxisPlan {
        name: name.to_owned(),
        force: machine.axis(name).map(|axis| {
            ForcePlan::Servo(ServoPlan {
                drive: axis.drive.clone(),
                signals: Signals::Both,
                method: Method::Medob,
                settings: ForceSettings::default(),
                motor_cutoff_hz: Some(150.0),
            })
        }),
        beside: None,
        nut: None,
        watch: machine.axis(name).is_some(),
        pushed: 0.0,
    };
    let mut pipeline = Pipeline::new(PipelineSettings {
        sample_rate: SampleRate::new(9000.0).unwrap(),
        axes: ["x1", "y1", "x2", "y2"].map(plan).to_vec(),
        band: BandPlan::Workpiece(scenario.workpiece),
        tools: None,
        infeed: None,
        stated_pitch_rad: None,
        margin: None,
        mean: stillcut::chatter::MeanForce::OverAir,
        false_alarm_s: stillcut::chatter::FALSE_ALARM_S,
    })
    .unwrap();
    // Air, entry, chatter: every state of the detector is passed.
    let mut lathe = Lathe::new(LatheSettings { entry_s: 1.0, ..LatheSettings::realistic(scenario, 9) });
    let stream: Vec<_> = (0..9000 * 3).map(|_| lathe.step()).collect();
    pipeline.step(&stream[0]); // the observers settle on the first sample
    let before = ALLOCATIONS.with(Cell::get);
    let mut chatter = 0_u32;
    for sample in &stream[1..] {
        chatter += u32::from(pipeline.step(sample).event.is_some());
    }
    let after = ALLOCATIONS.with(Cell::get);
    assert!(chatter > 0, "the stream held something to hear");
    assert_eq!(after - before, 0, "allocations in {} steps", stream.len() - 1);
}

/// Estimators of windows and of accelerometers, each beside another one, while the spindle settles at other
/// speeds.
#[test]
fn a_new_spindle_speed_allocates_nothing() {
    let rate_hz = 9000.0;
    let machine = read_machine(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/turrets.toml")).unwrap();
    let servo = |name: &str, method: Method| {
        let mut axis = machine.axis(name).unwrap().clone();
        axis.controller = Some(Controller {
            position_gain_1_s: 60.0,
            velocity_gain_1_s: 220.0,
            velocity_integral_1_s: 20.0,
            velocity_filter_rad_s: 3000.0,
        });
        ForcePlan::Servo(ServoPlan::of_axis(&axis, method, Signals::Both))
    };
    let accelerometers = || {
        ForcePlan::Accelerometers(FrfEstimator {
            axis: "y2".to_owned(),
            nodes_hz: (0..100).map(|k| 7.0 + 5.0 * f64::from(k)).collect(),
            values: (0..100).map(|k| [Complex64::new(1e6 + 1e3 * f64::from(k), 1e5); 9]).collect(),
            speed_range_rpm: [500.0, 7500.0],
            noise_floor_n: 0.1,
            condition: 10.0,
        })
    };
    let plan = |name: &str, force, beside| AxisPlan {
        name: name.to_owned(),
        force: Some(force),
        beside: Some(beside),
        nut: None,
        watch: true,
        pushed: 0.0,
    };
    let mut pipeline = Pipeline::new(PipelineSettings {
        sample_rate: SampleRate::new(rate_hz).unwrap(),
        axes: vec![
            plan("x1", servo("x1", Method::Fitted), servo("x1", Method::Medob)),
            plan("y1", servo("y1", Method::Medob), servo("y1", Method::Fitted)),
            plan("x2", servo("x1", Method::Medob), servo("x1", Method::Spectral)),
            plan("y2", servo("y1", Method::Medob), accelerometers()),
        ],
        band: BandPlan::Workpiece(Scenario::default().workpiece),
        tools: None,
        infeed: None,
        stated_pitch_rad: None,
        margin: None,
        mean: stillcut::chatter::MeanForce::OverAir,
        false_alarm_s: stillcut::chatter::FALSE_ALARM_S,
    })
    .unwrap();
    let mut lathe =
        Lathe::new(LatheSettings { entry_s: 10.0, ..LatheSettings::realistic(Scenario::default(), 9) });
    let speeds_rpm = [1200.0, 2400.0, 400.0];
    let stream: Vec<_> = (0..9000 * 6)
        .map(|i| {
            let mut sample = lathe.step();
            sample.spindle_speed_rpm = speeds_rpm[i / 18_000];
            sample.accel_m_s2 = Some([0.1, 0.2, 0.3].map(|a| a * (0.05 * i as f64).sin()));
            sample
        })
        .collect();
    pipeline.step(&stream[0]); // the observers settle on the first sample
    let mut delays_s = Vec::with_capacity(8);
    let mut first = None;
    let before = ALLOCATIONS.with(Cell::get);
    for (i, sample) in stream[1..].iter().enumerate() {
        pipeline.step(sample);
        if first.is_none() && ALLOCATIONS.with(Cell::get) != before {
            first = Some(i + 1);
        }
        if i % 18_000 == 17_900 {
            delays_s.push(pipeline.observer(0).unwrap().properties().delay_s);
            assert!(pipeline.disagreement_n(0).is_some() && pipeline.disagreement_n(1).is_some());
        }
    }
    let after = ALLOCATIONS.with(Cell::get);
    let turns: Vec<f64> = delays_s.windows(2).map(|d| d[1] - d[0]).collect();
    // Half a turn: 25, 12.5 and 75 ms.
    assert!((turns[0] + 0.0125).abs() < 1e-3 && (turns[1] - 0.0625).abs() < 1e-3, "{turns:?}");
    assert_eq!(after - before, 0, "allocations in {} steps, first at {first:?}", stream.len() - 1);
}
