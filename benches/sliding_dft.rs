//! Cost of the sliding DFT per bin and sample, as a ratio to the plain recursion in the same binary.
//!
//! `cargo bench --no-default-features --features cli --bench sliding_dft`. Medians over rounds, cases in turn
//! inside each round: on a shared machine only the ratios of one run are worth anything.
//! With `-- drift N` it feeds N samples and prints the error against the direct transform instead.
#![allow(clippy::disallowed_methods)] // a bench asks the time

#[path = "plain_loop/mod.rs"]
mod plain_loop;

use plain_loop::{BINS, WINDOW, plain};
use std::hint::black_box;
use std::time::Instant;
use stillcut::signal::sliding_dft::{EverySample, Real, SlidingDft, SlidingDftSettings};
use stillcut::units::SampleRate;

const SAMPLES: usize = 36_000;
const ROUNDS: usize = 9;

fn settings(axes: usize) -> SlidingDftSettings {
    SlidingDftSettings {
        sample_rate: SampleRate::new(9000.0).expect("positive"),
        window_samples: WINDOW,
        first_bin_hz: 500.0,
        bin_step_hz: 1.0,
        bins: BINS,
        axes,
    }
}

fn signal(n: usize) -> f64 {
    let t = (n % 90_000) as f64 / 9000.0;
    2.0 + (std::f64::consts::TAU * 612.0 * t).sin() + 0.2 * ((n * 7919 % 1000) as f64 / 1000.0 - 0.5)
}

/// Nanoseconds per bin, axis and sample.
fn block<T: Real>(axes: usize, input: &[f64]) -> f64 {
    let design = SlidingDft::<T>::new(settings(axes)).expect("fits");
    let mut state = design.start();
    let mut row = vec![0.0; axes];
    let begin = Instant::now();
    for x in input {
        row.fill(*x);
        black_box(design.step(&mut state, &row));
    }
    begin.elapsed().as_secs_f64() * 1e9 / (input.len() * axes * BINS) as f64
}

fn every_sample(input: &[f64]) -> f64 {
    let design = EverySample::new(settings(1)).expect("fits");
    let mut state = design.start();
    let begin = Instant::now();
    input.iter().for_each(|x| design.step(&mut state, *x));
    let spent = begin.elapsed().as_secs_f64();
    black_box(design.power(&state, 3));
    spent * 1e9 / (input.len() * BINS) as f64
}

fn drift<T: Real>(samples: usize) {
    // The narrow band of 16 bins has few nodes: rounding is what is looked for.
    let few = SlidingDftSettings { bins: 16, axes: 1, ..settings(1) };
    let design = SlidingDft::<T>::new(few).expect("fits");
    let mut state = design.start();
    for n in 0..samples {
        design.step(&mut state, &[signal(n)]);
    }
    let whole = samples / design.block_samples() * design.block_samples();
    let mut worst = 0.0f64;
    for k in 0..16 {
        let f = design.bin_hz(k);
        let (mut re, mut im) = (0.0, 0.0);
        for i in 0..WINDOW {
            let angle = -std::f64::consts::TAU * (f * i as f64 / 9000.0).fract();
            let x = signal(whole - WINDOW + i);
            re += x * angle.cos();
            im += x * angle.sin();
        }
        let value = design.value(&state, 0, k);
        worst = worst.max((value.re - re).hypot(value.im - im) / (WINDOW as f64 / 2.0));
    }
    let kind = std::any::type_name::<T>();
    println!("{kind}, {samples} samples: worst error {worst:.2e} of a unit line");
}

fn main() {
    let words: Vec<String> = std::env::args().collect();
    if let Some(at) = words.iter().position(|w| w == "drift") {
        let samples = words.get(at + 1).and_then(|n| n.parse().ok()).unwrap_or(100_000_000);
        drift::<f64>(samples);
        drift::<f32>(samples);
        return;
    }
    let input: Vec<f64> = (0..SAMPLES).map(signal).collect();
    type Case = (&'static str, fn(&[f64]) -> f64);
    let cases: [Case; 6] = [
        ("plain recursion, f64, 1 axis", plain),
        ("blocks, f64, 1 axis", |i| block::<f64>(1, i)),
        ("blocks, f64, 6 axes", |i| block::<f64>(6, i)),
        ("blocks, f32, 1 axis", |i| block::<f32>(1, i)),
        ("blocks, f32, 6 axes", |i| block::<f32>(6, i)),
        ("every sample, f64, 1 axis", every_sample),
    ];
    let mut spent = vec![Vec::new(); cases.len()];
    for _ in 0..ROUNDS {
        for (case, list) in cases.iter().zip(&mut spent) {
            list.push((case.1)(&input));
        }
    }
    let medians: Vec<f64> = spent
        .iter_mut()
        .map(|l| {
            l.sort_by(f64::total_cmp);
            l[ROUNDS / 2]
        })
        .collect();
    println!("201 bins, window 9000; ns per bin, axis and sample; ratio to the plain recursion");
    for ((name, _), ns) in cases.iter().zip(&medians) {
        println!("{name:32} {ns:7.3} ns   R = {:.2}", ns / medians[0]);
    }
}
