//! After `Pipeline::new`, a step allocates nothing: counted by the allocator itself.
#![allow(unsafe_code)] // a counting allocator is unsafe by nature; it only counts and forwards

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::path::Path;
use stillcut::config::machine::read_machine;
use stillcut::force::balance::Method;
use stillcut::force::estimator::{ForceSettings, Signals};
use stillcut::pipeline::{AxisPlan, BandPlan, ForcePlan, Pipeline, PipelineSettings, ServoPlan};
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
    };
    let mut pipeline = Pipeline::new(PipelineSettings {
        sample_rate: SampleRate::new(9000.0).unwrap(),
        axes: ["x1", "y1", "x2", "y2"].map(plan).to_vec(),
        band: BandPlan::Workpiece(scenario.workpiece),
        tools: None,
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
