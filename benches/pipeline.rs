//! Cost per sample of the pipeline (1 and 6 axes, 201 bins), of it the force estimators and what listens to
//! them, and real-time factor of the virtual lathe.
//!
//! `cargo bench --bench pipeline`. Medians over rounds, cases in turn inside each round; on a shared machine
//! compare the figures of one run.
#![allow(clippy::disallowed_methods)] // a bench asks the time

#[path = "plain_loop/mod.rs"]
mod plain_loop;

use plain_loop::{BINS, plain};
use std::hint::black_box;
use std::path::Path;
use std::time::Instant;
use stillcut::chatter::Band;
use stillcut::config::machine::read_machine;
use stillcut::force::balance::Method;
use stillcut::force::settings::ForceSettings;
use stillcut::force::signals::Signals;
use stillcut::pipeline::{
    AxisPlan, BandPlan, CutConditions, ForcePlan, Pipeline, PipelineSettings, ServoPlan,
};
use stillcut::plant::drive::DriveParams;
use stillcut::plant::scenario::Scenario;
use stillcut::sample::ServoSample;
use stillcut::simulation::lathe::{Lathe, LatheSettings};
use stillcut::units::SampleRate;

const ROUNDS: usize = 9;

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

fn pipeline(axes: usize, rate_hz: f64, drive: &DriveParams) -> Pipeline {
    let plan = |index: usize| AxisPlan {
        name: format!("a{index}"),
        force: Some(ForcePlan::Servo(ServoPlan {
            drive: drive.clone(),
            signals: Signals::Both,
            method: Method::Medob,
            settings: ForceSettings::default(),
            motor_cutoff_hz: Some(150.0),
        })),
        beside: None,
        nut: None,
        watch: true,
        pushed: 0.0,
    };
    let settings = PipelineSettings {
        sample_rate: SampleRate::new(rate_hz).expect("positive"),
        axes: (0..axes).map(plan).collect(),
        band: BandPlan::Stated(Band::new(500.0, 700.0).expect("a band")),
        tools: None,
        infeed: None,
        stated_pitch_rad: None,
        margin: None,
        mean: stillcut::chatter::MeanForce::OverAir,
        false_alarm_s: stillcut::chatter::FALSE_ALARM_S,
    };
    Pipeline::new(settings).expect("valid settings")
}

/// One second of six equal axes in the cut.
fn stream(rate_hz: f64) -> Vec<ServoSample> {
    let settings =
        LatheSettings { sample_rate_hz: rate_hz, ..LatheSettings::realistic(Scenario::default(), 1) };
    let mut lathe = Lathe::new(LatheSettings { entry_s: 0.0, ..settings });
    let count = rate_hz as usize * 2;
    let mut samples: Vec<ServoSample> = (0..count).map(|_| lathe.step()).collect();
    for sample in &mut samples {
        sample.axes = [sample.axes[0]; 6];
    }
    samples
}

/// What a sample tells of the cut.
fn conditions(sample: &ServoSample) -> CutConditions {
    CutConditions {
        spindle_speed_rpm: Some(sample.spindle_speed_rpm),
        pitch_difference_rad: sample.pitch_difference_rad,
        ..CutConditions::default()
    }
}

fn main() {
    let machine =
        read_machine(&Path::new(env!("CARGO_MANIFEST_DIR")).join("config/turrets.toml")).expect("model");
    let drive = machine.axis("x1").expect("axis").drive.clone();
    let cases: Vec<(usize, f64)> = vec![(1, 9000.0), (6, 9000.0), (6, 20_000.0)];
    let mut times = vec![[Vec::new(), Vec::new()]; cases.len()];
    let mut lathe_factor = Vec::new();
    let mut ruler = Vec::new();
    for _ in 0..ROUNDS {
        ruler.push(plain(&[0.5; 20_000]) * BINS as f64);
        for ((axes, rate_hz), out) in cases.iter().zip(&mut times) {
            let samples = stream(*rate_hz);
            let mut pipeline = pipeline(*axes, *rate_hz, &drive);
            let half = samples.len() / 2;
            for sample in &samples[..half] {
                black_box(pipeline.step(sample));
            }
            let mut listening = pipeline.clone();
            let ns = |began: Instant| began.elapsed().as_secs_f64() * 1e9 / (samples.len() - half) as f64;
            let began = Instant::now();
            for sample in &samples[half..] {
                black_box(pipeline.step(sample));
            }
            out[0].push(ns(began));
            let mut estimating = listening.clone();
            let forces: Vec<_> = samples[half..].iter().map(|s| (s.t_s, estimating.step(s).forces)).collect();
            let known: Vec<_> = samples[half..].iter().map(conditions).collect();
            let began = Instant::now();
            for ((t_s, forces), known) in forces.iter().zip(&known) {
                black_box(listening.step_estimates(*t_s, &forces[..*axes], known));
            }
            out[1].push(ns(began));
        }
        let mut lathe =
            Lathe::new(LatheSettings { entry_s: 0.0, ..LatheSettings::realistic(Scenario::default(), 1) });
        let began = Instant::now();
        for _ in 0..9000 {
            black_box(lathe.step());
        }
        lathe_factor.push(1.0 / began.elapsed().as_secs_f64());
    }
    let ruler = median(ruler);
    println!("plain recursion of 201 bins, one axis: {ruler:.0} ns a sample");
    for ((axes, rate_hz), out) in cases.iter().zip(times) {
        let [whole, listens] = out.map(median);
        let (percent, ratio) = (whole * rate_hz * 1e-7, whole / ruler);
        let share = format!("{percent:.2} % of a core = {ratio:.1} x that");
        println!("pipeline, {axes} axes, {rate_hz} Hz: {whole:.0} ns a sample = {share}");
        let (forces, ratio) = (whole - listens, listens / ruler);
        println!(
            "  spectrum and detection {listens:.0} ns = {ratio:.1} x that; force estimators {forces:.0} ns"
        );
    }
    println!("lathe with four servo axes at 9 kHz: {:.0} times real time", median(lathe_factor));
}
