//! The virtual lathe against the two-delay characteristic equation (facts, section 7).

use nalgebra::Complex;
use std::f64::consts::TAU;
use stillcut::plant::cutting::TwoDelay;
use stillcut::plant::scenario::{RawScenario, Scenario};
use stillcut::simulation::lathe::{Lathe, LatheSettings};

/// Newton on the characteristic equation from a grid of starts: the rightmost oscillating root.
fn rightmost(equation: &TwoDelay) -> Complex<f64> {
    let derivative = |s: Complex<f64>| {
        let (a, b) = (equation.delay_1_s, equation.delay_2_s);
        s * (2.0 * equation.mass_kg) + equation.damping_n_s_m
            - ((-s * a).exp() * a + (-s * b).exp() * b) * equation.cutting_stiffness_n_m
    };
    let mut best = Complex::new(f64::NEG_INFINITY, 0.0);
    for step in 0..400 {
        let mut s = Complex::new(10.0, TAU * (450.0 + f64::from(step)));
        for _ in 0..60 {
            s -= equation.characteristic(s) / derivative(s);
        }
        if equation.characteristic(s).norm() < 1e-3 && s.im > 0.0 && s.re > best.re {
            best = s;
        }
    }
    best
}

struct Growth {
    growth_1_s: f64,
    frequency_hz: f64,
}

/// Fits growth and frequency to the displacement between two amplitudes.
fn measured(scenario: Scenario, from_m: f64, to_m: f64, longest_s: f64) -> Growth {
    // A tap so small that the rightmost root has left every other behind long before the fit.
    let mut lathe = Lathe::new(LatheSettings { strike_m_s: 1e-12, ..LatheSettings::ideal(scenario) });
    let rest = lathe.truth().workpiece_displacement_m;
    let mut peaks: Vec<(f64, f64)> = Vec::new();
    let mut crossings: Vec<f64> = Vec::new();
    let (mut last, mut peak) = (0.0_f64, 0.0_f64);
    while lathe.truth().t_s < longest_s {
        lathe.step();
        let (t, x) = (lathe.truth().t_s, lathe.truth().workpiece_displacement_m - rest);
        peak = peak.max(x.abs());
        if last <= 0.0 && x > 0.0 {
            if peak > from_m {
                crossings.push(t - x / (x - last) / 9000.0);
                peaks.push((t, peak.ln()));
            }
            if peak > to_m {
                break;
            }
            peak = 0.0;
        }
        last = x;
    }
    let half = peaks.len() / 2;
    let tail = &peaks[half..];
    let n = tail.len() as f64;
    let (mt, mp) = (tail.iter().map(|p| p.0).sum::<f64>() / n, tail.iter().map(|p| p.1).sum::<f64>() / n);
    let growth_1_s = tail.iter().map(|p| (p.0 - mt) * (p.1 - mp)).sum::<f64>()
        / tail.iter().map(|p| (p.0 - mt).powi(2)).sum::<f64>();
    let c = &crossings[half..];
    Growth { growth_1_s, frequency_hz: (c.len() - 1) as f64 / (c[c.len() - 1] - c[0]) }
}

fn scenario(change: impl Fn(&mut RawScenario)) -> Scenario {
    let mut raw = RawScenario::default();
    change(&mut raw);
    Scenario::new(&raw).unwrap()
}

fn pitch_at(phase_over_pi: f64) -> f64 {
    phase_over_pi * std::f64::consts::PI * 1200.0 / (60.0 * 652.0)
}

#[test]
fn growth_and_frequency_agree_with_the_rightmost_root() {
    let cases = [
        scenario(|_| {}),
        scenario(|s| s.position_m = Some(0.9 * 0.18)),
        scenario(|s| s.pitch_difference_rad = pitch_at(0.5)),
        scenario(|s| s.speed_rpm = 1730.0),
        scenario(|s| {
            s.workpiece.diameter_m = 0.0221;
            s.workpiece.projection_length_m = 0.160;
            s.cutting.width_m = 0.3e-3;
        }),
    ];
    for case in cases {
        let root = rightmost(&TwoDelay::from_scenario(&case));
        let got = measured(case, 1e-12, 2e-6, 4.0);
        println!(
            "root {:.2} 1/s {:.2} Hz, lathe {:.2} 1/s {:.2} Hz",
            root.re,
            root.im / TAU,
            got.growth_1_s,
            got.frequency_hz
        );
        assert!((got.growth_1_s / root.re - 1.0).abs() < 0.02, "{} against {}", got.growth_1_s, root.re);
        assert!((got.frequency_hz / (root.im / TAU) - 1.0).abs() < 0.002);
    }
}

#[test]
fn chatter_is_bounded_by_the_flank() {
    let mut lathe = Lathe::new(LatheSettings::ideal(Scenario::default()));
    let mut largest: f64 = 0.0;
    for i in 0..9000 * 3 {
        lathe.step();
        if i > 9000 * 2 {
            largest = largest.max(lathe.truth().workpiece_displacement_m.abs());
        }
    }
    println!("limit cycle {:.1} um", largest * 1e6);
    assert!(largest > 10e-6 && largest < 120e-6, "{largest} m");
}

/// A parameter set that shows the printed window: stable 0.7 pi to 1.1 pi only (facts, 6.3).
fn thesis_window_scenario(phase_over_pi: f64) -> Scenario {
    scenario(|s| {
        s.workpiece.projection_length_m = 0.1622; // 640 Hz
        s.workpiece.damping_ratio = 0.012;
        s.cutting.radial_stiffness_pa = 602e6; // K/k = 0.048
        s.cutting.process_damping_n = 0.0;
        s.pitch_difference_rad = pitch_at(phase_over_pi);
    })
}

/// Largest displacement about rest in a stretch of time.
fn amplitude_m(lathe: &mut Lathe, rest_m: f64, seconds: f64) -> f64 {
    let until = lathe.truth().t_s + seconds;
    let mut largest = 0.0_f64;
    while lathe.truth().t_s < until {
        lathe.step();
        largest = largest.max((lathe.truth().workpiece_displacement_m - rest_m).abs());
    }
    largest
}

#[test]
fn the_pitch_window_of_the_thesis() {
    let stable = |phase: f64| (0.7..=1.1).contains(&phase);
    for phase in [0.0, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.15, 1.2] {
        let settings =
            LatheSettings { strike_m_s: 1e-7, ..LatheSettings::ideal(thesis_window_scenario(phase)) };
        let mut lathe = Lathe::new(settings);
        let rest = lathe.truth().workpiece_displacement_m;
        amplitude_m(&mut lathe, rest, 0.05);
        let early = amplitude_m(&mut lathe, rest, 0.1);
        amplitude_m(&mut lathe, rest, 0.25);
        let late = amplitude_m(&mut lathe, rest, 0.1);
        println!("{phase} pi: {early:.2e} m, then {late:.2e} m");
        assert_eq!(late < early, stable(phase), "at {phase} pi {early} m became {late} m");
    }
}

/// Frequency of the displacement over a window, by rising zero crossings.
fn frequency_hz(lathe: &mut Lathe, seconds: f64) -> f64 {
    let until = lathe.truth().t_s + seconds;
    let (mut last, mut first, mut newest, mut turns) = (0.0_f64, None, 0.0, 0_u32);
    while lathe.truth().t_s < until {
        lathe.step();
        let (t, x) = (lathe.truth().t_s, lathe.truth().workpiece_displacement_m);
        if last < 0.0 && x >= 0.0 {
            newest = t - x / (x - last) / 9000.0;
            if first.is_none() {
                first = Some(newest);
            } else {
                turns += 1;
            }
        }
        last = x;
    }
    first.map_or(0.0, |start| f64::from(turns) / (newest - start))
}

#[test]
fn chatter_hops_down_lobe_by_lobe_as_the_tools_travel() {
    let travelling = scenario(|s| s.travel_m_s = -3.0e-3);
    let natural = travelling.workpiece.bending_frequency_hz();
    let mut lathe = Lathe::new(LatheSettings { force_noise_ratio: 0.02, ..LatheSettings::ideal(travelling) });
    let mut track: Vec<f64> = Vec::new();
    for _ in 0..110 {
        track.push(frequency_hz(&mut lathe, 0.25));
    }
    let track = &track[4..];
    println!("{track:.0?}");
    assert!(track[0] > 1.05 * natural, "chatter at {} Hz stands above {natural} Hz", track[0]);
    // Levels that last, and the steps between them.
    let mut levels: Vec<f64> = vec![track[0]];
    for pair in track.windows(3) {
        let settled = (pair[1] - pair[0]).abs() < 3.0 && (pair[2] - pair[1]).abs() < 3.0;
        if settled && (pair[1] - levels[levels.len() - 1]).abs() > 20.0 {
            levels.push(pair[1]);
        }
    }
    println!("levels {levels:.1?}");
    let steps: Vec<f64> = levels.windows(2).map(|w| w[0] - w[1]).collect();
    assert!(steps.len() >= 2, "at least two hops: {levels:?}");
    assert!(steps.iter().all(|s| (25.0..=45.0).contains(s)), "hops down by a lobe: {steps:?}");
}

/// Tools that travel cut pass after pass: in at the start, out at the chuck, air, in again.
#[test]
fn a_pass_that_ends_at_the_chuck_is_followed_by_the_next() {
    let scenario = scenario(|s| (s.position_m, s.travel_m_s) = (Some(3.0e-3), -3.0e-3));
    let settings = LatheSettings { entry_s: 0.5, pause_s: Some(1.0), ..LatheSettings::ideal(scenario) };
    let mut lathe = Lathe::new(settings);
    let mut cutting = Vec::new();
    for _ in 0..9000 * 5 {
        lathe.step();
        let truth = lathe.truth();
        let in_cut = truth.radial_force_n[0] > 0.0;
        if cutting.last().is_none_or(|(was, _, _)| *was != in_cut) {
            cutting.push((in_cut, truth.t_s, truth.tool_position_m));
        }
    }
    // Air to 0.5 s, a pass to 1.5 s, air to 2.5 s, a pass to 3.5 s, air to 4.5 s, a pass.
    assert_eq!(cutting.len(), 6, "{cutting:?}");
    for ((in_cut, t_s, position_m), (index, due_s)) in
        cutting.iter().zip([0.0, 0.5, 1.5, 2.5, 3.5, 4.5].iter().enumerate())
    {
        assert_eq!(*in_cut, index % 2 == 1);
        assert!((t_s - due_s).abs() < 0.01, "{cutting:?}");
        assert!(!in_cut || (position_m - 3.0e-3).abs() < 1.0e-4, "{cutting:?}");
    }
    assert!((lathe.pass_s() - 1.0).abs() < 1.0e-12);
}
