//! The cut in time against the linear cut: the virtual lathe, which stores a surface and integrates, must
//! grow as the rightmost root says, effect by effect; and the linear cut against an independent program.

use crate::folders::shared;
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;
use stillcut::config::scenario::{read_scenario, scenario_from_text};
use stillcut::plant::cut_loop::CutLoop;
use stillcut::plant::cut_terms::{CutCondition, CutTerms};
use stillcut::plant::scenario::{RawScenario, Scenario};
use stillcut::signal::dispatch::Fast;
use stillcut::simulation::lathe::{Lathe, LatheSettings};
use stillcut::simulation::model_cut::{CutModel, CutTrial, free_run, free_run_on};
use stillcut::stability::{Root, scenario_root};

const RATE_HZ: f64 = 9000.0;

/// The virtual lathe after a tap: motion of the bar, m.
fn tapped(scenario: Scenario, seconds: f64) -> Vec<f64> {
    let mut lathe = Lathe::new(LatheSettings { strike_m_s: 1e-11, ..LatheSettings::ideal(scenario) });
    let mut x = Vec::new();
    while lathe.truth().t_s < seconds {
        lathe.step();
        x.push(lathe.truth().workpiece_displacement_m);
    }
    x
}

/// The scenario's own condition for so long, from a feed that is another by that share for 10 ms.
fn trial(scenario: &Scenario, seconds: f64, first_feed: f64) -> CutTrial {
    let at = CutCondition::of(scenario);
    let samples = (seconds * RATE_HZ) as usize;
    let mut conditions = vec![at; samples.div_ceil(90)];
    conditions[0].feed_m_rev *= 1.0 + first_feed;
    CutTrial {
        period_s: 1.0 / RATE_HZ,
        turned_rad: (0..samples).map(|k| TAU / at.turn_s() * k as f64 / RATE_HZ).collect(),
        pitch_difference_rad: vec![at.pitch_difference_rad; samples],
        conditions,
        held: 90,
    }
}

fn silent(scenario: Scenario) -> CutModel {
    CutModel { scenario, random_share: 0.0, seed: 1 }
}

/// Growth and frequency of the last half of a tap's answer: peaks for the one, crossings for the other.
///
/// From the second difference of the motion: what is slow, such as a rest position that moves, is gone.
fn measured(x: &[f64]) -> Root {
    let bent: Vec<f64> = x.windows(3).map(|w| w[0] - 2.0 * w[1] + w[2]).collect();
    let (mut peaks, mut crossings) = (Vec::new(), Vec::new());
    let mut peak = 0.0f64;
    for (i, pair) in bent.windows(2).enumerate() {
        peak = peak.max(pair[1].abs());
        if pair[0] <= 0.0 && pair[1] > 0.0 {
            crossings.push((i as f64 - pair[0] / (pair[1] - pair[0])) / RATE_HZ);
            peaks.push((i as f64 / RATE_HZ, peak.ln()));
            peak = 0.0;
        }
    }
    let tail = &peaks[peaks.len() / 2..];
    let n = tail.len() as f64;
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| tail.iter().map(f).sum::<f64>() / n;
    let (t, p) = (mean(&|x| x.0), mean(&|x| x.1));
    let growth_1_s = mean(&|x| (x.0 - t) * (x.1 - p)) / mean(&|x| (x.0 - t).powi(2));
    let c = &crossings[crossings.len() / 2..];
    Root { growth_1_s, frequency_hz: (c.len() - 1) as f64 / (c[c.len() - 1] - c[0]) }
}

/// A cut of two tools at a pitch that does not treat them alike, and of one; both grow.
fn lathe(more: &str, tools: u32) -> Scenario {
    let text = format!(
        "[workpiece]\ndamping_ratio = 0.006\n[cutting]\nprocess_damping_n = 0.0\n\
         radial_stiffness_pa = 2200e6\n[spindle]\nspeed_rpm = 1310\n[tools]\ncount = {tools}\n\
         pitch_difference_rad = 0.03\n\
         position_m = 0.165\n{more}"
    );
    scenario_from_text(Path::new("lathe.toml"), &text).unwrap()
}

fn effect(name: &str, port: &str, numbers: &str) -> String {
    format!("[[physics]]\neffect = \"{name}\"\nport = \"{port}\"\n{numbers}\n")
}

/// Every effect that the linear cut knows.
fn linear_laws() -> Vec<String> {
    vec![
        String::new(),
        effect("process_damping", "process", "process_damping_n = 25.0"),
        effect("edge_force", "process", "force_n = 6.0"),
        effect("nonlinear_cutting_force", "process", "exponent = 0.75"),
        effect("speed_dependent_force", "process", "exponent = 0.2"),
        effect("runout", "process", "amplitude_m = 8e-6\norder = 0\nphase_rad = 0.0"),
        effect("second_mode", "workpiece", "frequency_hz = 760.0\ndamping_ratio = 0.02\nn_m = 2.5e7"),
        effect("second_plane", "workpiece", "frequency_hz = 480.0\norientation_rad = 0.4"),
        effect("second_plane", "workpiece", "frequency_hz = 540.0\norientation_rad = -0.3"),
        effect("position_dependent_mode", "workpiece", "hz_per_m = 300.0"),
        effect("support_compliance", "workpiece", "n_m = 1.2e7"),
        effect("contact_stiffness", "process", "n_m = 1.5e5"),
        effect("speed_dependent_dynamics", "workpiece", "hz_per_rpm = 0.04"),
        effect("tool_difference", "process", "ratio = 0.8"),
        effect("turret_compliance", "turret", "frequency_hz = 640.0\nn_m = 1.2e7\ndamping_ratio = 0.04"),
        effect("force_lag", "process", "time_constant_s = 4e-5"),
        effect("force_sensor_lag", "force_sensor", "extra_delay_s = 2e-4\nbandwidth_hz = 1500.0"),
    ]
}

#[test]
fn every_linear_effect_grows_in_time_as_its_root_says() {
    for tools in [2, 1] {
        for law in &linear_laws() {
            let scenario = lathe(law, tools);
            let root = scenario_root(&scenario, &CutCondition::of(&scenario));
            // As long as the tap of 10 pm/s needs to grow 10^7 times, half of it for the fit; at least 0.2 s,
            // where the fastest of these has not lost contact yet, at most 3 s.
            let seconds = (16.0 / root.growth_1_s.abs().max(4.0)).clamp(0.2, 3.0);
            let got = measured(&tapped(scenario, seconds));
            println!("{tools} {law:?}: root {root:?}, lathe {got:?}");
            // 2 %: the surface is stored in cells; 0.4 1/s: what other roots leave in a fit of this length.
            let allowed = 0.4 + 0.02 * root.growth_1_s.abs();
            assert!((got.growth_1_s - root.growth_1_s).abs() < allowed, "{tools} {law}: {got:?}, {root:?}");
            // A neighbour S/60 = 22 Hz away that grows nearly as fast pulls the crossings by some of that.
            assert!((got.frequency_hz - root.frequency_hz).abs() < 1.5, "{tools} {law}: {got:?}, {root:?}");
        }
    }
}

/// The model that runs free shares the equation of the root, but not its way: it stores a surface.
#[test]
fn the_model_that_runs_free_grows_as_its_root_says() {
    for tools in [2, 1] {
        for law in &linear_laws() {
            let scenario = lathe(law, tools);
            let root = scenario_root(&scenario, &CutCondition::of(&scenario));
            let seconds = (25.0 / root.growth_1_s.abs().max(4.0)).clamp(0.2, 4.0);
            let run = free_run(&[silent(scenario)], &trial(&scenario, seconds, 1e-12)).remove(0);
            let got = measured(&run.bar_m);
            println!("{tools} {law:?}: root {root:?}, free {got:?}");
            // What other roots leave in a fit of this length, and the straight line between two steps.
            let allowed = 0.3 + 0.005 * root.growth_1_s.abs();
            assert!((got.growth_1_s - root.growth_1_s).abs() < allowed, "{tools} {law}: {got:?}, {root:?}");
            assert!((got.frequency_hz - root.frequency_hz).abs() < 1.5, "{tools} {law}: {got:?}, {root:?}");
        }
    }
}

/// Loss of contact and the flank bound it: two programs that share neither surface nor integration.
#[test]
fn free_chatter_grows_to_what_the_lathe_grows_to() {
    let half = |x: &[f64]| {
        let tail = &x[x.len() / 2..];
        let mean = tail.iter().sum::<f64>() / tail.len() as f64;
        (tail.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / tail.len() as f64).sqrt()
    };
    for more in ["", &effect("nonlinear_cutting_force", "process", "exponent = 0.75")] {
        let scenario = lathe(more, 2);
        let lathe_m = half(&tapped(scenario, 3.0));
        let free = free_run(&[silent(scenario)], &trial(&scenario, 3.0, 1e-5)).remove(0);
        let free_m = half(&free.bar_m);
        assert!((free_m / lathe_m - 1.0).abs() < 0.03, "{more}: {free_m} m, lathe {lathe_m} m");
    }
}

#[test]
fn a_quiet_cut_rests() {
    for tools in [2, 1] {
        for law in &linear_laws() {
            let scenario = lathe(law, tools);
            let run = free_run(&[silent(scenario)], &trial(&scenario, 0.1, 0.0)).remove(0);
            let moved = run.bar_m.iter().map(|y| (y - run.bar_m[0]).abs()).fold(0.0, f64::max);
            assert!(moved < 1e-12, "{tools} {law}: {moved} m");
        }
    }
}

/// A model's answer is its own, whoever runs beside it, and the processor's copies agree.
#[test]
fn free_runs_do_not_see_their_neighbours() {
    let stock =
        effect("stock_variation", "process", "relative_change = 0.4\nsector_rad = 0.8\ncentre_rad = 1.0");
    let all: Vec<CutModel> = ["", &stock, &effect("nonlinear_cutting_force", "process", "exponent = 0.75")]
        .iter()
        .zip(1..)
        .map(|(more, seed)| CutModel { scenario: lathe(more, 2), random_share: 0.03, seed })
        .collect();
    let trial = trial(&all[0].scenario, 0.3, 0.0);
    let together = free_run(&all, &trial);
    for (model, run) in all.iter().zip(&together) {
        let alone = free_run(&[*model], &trial).remove(0);
        assert_eq!(alone.force_n, run.force_n);
    }
    let plain = free_run_on(Fast::off(), &all, &trial);
    let apart = |k: usize| (plain[k].bar_m[900] - together[k].bar_m[900]).abs();
    assert!((0..3).all(|k| apart(k) < 1e-12), "{:?}", [apart(0), apart(1), apart(2)]);
    assert!(free_run(&[], &trial).is_empty());
}

#[test]
fn a_cut_without_memory_rings_at_its_stiffer_bar() {
    let static_cut =
        "[cutting]\nregeneration = false\nprocess_damping_n = 0.0\n[tools]\npitch_difference_rad = 0.03\n";
    for more in ["", "[[physics]]\neffect = \"regenerative_effect\"\nport = \"process\"\noverlap = 0.6\n"] {
        let scenario = scenario_from_text(Path::new("lathe.toml"), &format!("{static_cut}{more}")).unwrap();
        let root = scenario_root(&scenario, &CutCondition::of(&scenario));
        let got = measured(&tapped(scenario, 0.25));
        assert!((got.growth_1_s - root.growth_1_s).abs() < 1.0, "{got:?}, {root:?}");
        assert!((got.frequency_hz - root.frequency_hz).abs() < 0.5, "{got:?}, {root:?}");
    }
}

#[test]
fn mean_forces_in_time_are_those_of_the_linear_cut() {
    let laws = [
        effect("edge_force", "process", "force_n = 6.0"),
        effect("nonlinear_cutting_force", "process", "exponent = 0.75"),
        effect("tool_difference", "process", "ratio = 0.8"),
        effect("turret_compliance", "turret", "frequency_hz = 640.0\nn_m = 1.2e7\ndamping_ratio = 0.04"),
        effect("runout", "process", "amplitude_m = 8e-6\norder = 0\nphase_rad = 0.0"),
        effect("contact_stiffness", "process", "n_m = 1.5e5"),
        effect("nose_radius", "process", "radius_m = 4e-4"),
        effect("second_mode", "workpiece", "frequency_hz = 760.0\ndamping_ratio = 0.02\nn_m = 2.5e7"),
    ];
    for law in &laws {
        let raw = RawScenario { pitch_difference_rad: 0.35, ..lathe(law, 2).raw() };
        let scenario = Scenario::new(&raw).unwrap();
        let means = CutLoop::new(&CutTerms::of(&scenario, &CutCondition::of(&scenario))).means();
        let mut lathe = Lathe::new(LatheSettings { strike_m_s: 0.0, ..LatheSettings::ideal(scenario) });
        let mut sum = [0.0; 2];
        for _ in 0..900 {
            lathe.step();
            sum = std::array::from_fn(|k| sum[k] + lathe.truth().radial_force_n[k] / 900.0);
        }
        for (got, wanted) in sum.iter().zip(means.force_n) {
            assert!((got - wanted).abs() < 2e-3 * wanted, "{law}: {sum:?} {means:?}");
        }
    }
}

#[test]
fn a_force_that_turns_with_the_work_is_where_the_law_puts_it() {
    // Soft cut of a stiff bar: the force is K b_j h, its order as the law says (alpha_1 = d/2, alpha_2 = pi).
    let text = format!(
        "[workpiece]\nnatural_frequency_hz = 900\nmodal_stiffness_n_m = 1e9\n[tools]\n\
         pitch_difference_rad = 0.2\n{}",
        effect("runout", "process", "amplitude_m = 1e-5\norder = 2\nphase_rad = 0.7")
    );
    let scenario = scenario_from_text(Path::new("lathe.toml"), &text).unwrap();
    let mut lathe = Lathe::new(LatheSettings { strike_m_s: 0.0, ..LatheSettings::ideal(scenario) });
    let cutting = scenario.cutting.raw();
    for _ in 0..900 {
        lathe.step();
        let truth = lathe.truth();
        for (tool, alpha) in [0.1, std::f64::consts::PI].into_iter().enumerate() {
            let advance = cutting.feed_m_rev * (0.5 + [1.0, -1.0][tool] * 0.1 / TAU);
            let psi = truth.spindle_angle_rad - alpha;
            let wanted =
                cutting.radial_stiffness_pa * (cutting.width_m + 1e-5 * (2.0 * psi - 0.7).cos()) * advance;
            assert!(
                (truth.radial_force_n[tool] - wanted).abs() < 0.02 * wanted,
                "{tool}: {truth:?} {wanted}"
            );
        }
    }
}

/// What the shared cases withhold is foretold with the true numbers, for every effect that is linear.
#[test]
fn cuts_of_an_independent_program_are_foretold() {
    let Some(cases) = shared("cut-cases") else { return };
    let linear =
        |name: &str| !["stock_variation", "spindle_speed_variation"].contains(&name) && !name.contains('/');
    let mut judged = 0;
    for case in 1..=22 {
        let folder = cases.join(format!("case-{case:02}"));
        let truth: serde_json::Value =
            serde_json::from_str(&fs::read_to_string(folder.join("truth.json")).unwrap()).unwrap();
        let missing = truth["missing"].as_array().unwrap();
        if missing.iter().any(|m| !linear(m["effect"].as_str().unwrap())) {
            continue;
        }
        let scenario = repaired(&folder, &truth, missing);
        for cut in truth["withheld_cuts"].as_array().unwrap() {
            let number = |key: &str, other: f64| cut[key].as_f64().unwrap_or(other);
            let own = CutCondition::of(&scenario);
            let at = CutCondition {
                speed_rpm: number("spindle_speed_rpm", own.speed_rpm),
                width_m: number("width_m", own.width_m),
                feed_m_rev: number("feed_m_rev", own.feed_m_rev),
                position_m: number("tool_position_m", own.position_m),
                pitch_difference_rad: number("pitch_difference_rad", 0.0),
                ..own
            };
            let (root, growth) = (scenario_root(&scenario, &at), number("growth_1_s", f64::NAN));
            let line = number("line_hz", f64::NAN);
            println!("case-{case:02} {}: {root:?}, true {growth} 1/s {line} Hz", cut["cut"]);
            assert!((root.growth_1_s - growth).abs() < 0.1, "case-{case:02} {cut}: {root:?}");
            assert!((root.frequency_hz - line).abs() < 0.1, "case-{case:02} {cut}: {root:?}");
            assert_eq!(root.growth_1_s > 0.0, cut["outcome"] == "chatter", "case-{case:02} {cut}");
            judged += 1;
        }
    }
    assert!(judged > 100, "{judged} cuts");
}

/// The stated scenario of a case with its true numbers and its missing physics.
fn repaired(folder: &Path, truth: &serde_json::Value, missing: &[serde_json::Value]) -> Scenario {
    let stated = read_scenario(&folder.join("scenario.toml")).unwrap();
    let mut raw = stated.raw();
    let actual = |key: &str| truth["actual"][key].as_f64();
    raw.cutting.radial_stiffness_pa = actual("radial_stiffness_pa").unwrap();
    // Where the damping is what is missing, the scenario goes on stating none.
    let found = missing.iter().any(|m| m["effect"] == "process_damping");
    let damping = actual("process_damping_n").filter(|_| !found);
    raw.cutting.process_damping_n = damping.unwrap_or(raw.cutting.process_damping_n);
    raw.workpiece.damping_ratio = actual("damping_ratio").unwrap();
    raw.workpiece.clamp_factor = actual("clamp_factor").unwrap();
    let mut text = stillcut::config::scenario::scenario_to_text(&Scenario::new(&raw).unwrap());
    for term in missing {
        let name = term["effect"].as_str().unwrap().split('/').next().unwrap();
        let mut numbers = String::new();
        for (key, value) in term["parameters"].as_object().unwrap() {
            if key != "split" {
                numbers += &format!("{key} = {:?}\n", value.as_f64().unwrap());
            }
        }
        text += &effect(name, term["port"].as_str().unwrap(), &numbers);
    }
    scenario_from_text(folder, &text).unwrap()
}
