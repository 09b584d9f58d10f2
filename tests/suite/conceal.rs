//! The judge's axis: what it writes down must be what its equations and its control law say.

use std::path::Path;
use stillcut::config::machine::machine_from_text;
use stillcut::plant::machine::Machine;
use stillcut::simulation::concealed_axis::{Case, CaseSpec, conceal};

const MODEL: &str = include_str!("feed-axis.toml");

pub(crate) fn model() -> Machine {
    machine_from_text(Path::new("bench.toml"), MODEL).unwrap()
}

fn case(effects: &[&str], depth: f64) -> Case {
    let machine = model();
    let effects = effects.iter().map(|s| (*s).to_owned()).collect();
    let spec = CaseSpec { effects, depth, seed: 11, ..CaseSpec::default() };
    conceal(&machine.axes[0], machine.sample_rate, &spec).unwrap()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn the_control_law_replays_from_the_recording() {
    let case = case(&[], 1.0);
    let moves = &case.recordings[2];
    let (cmd, angle, stage, current) = (
        moves.require("x_position_cmd_m").unwrap(),
        moves.require("x_motor_angle_rad").unwrap(),
        moves.require("x_stage_position_m").unwrap(),
        moves.require("x_current_ref_a").unwrap(),
    );
    let travel = 0.005 / std::f64::consts::TAU;
    let gain = (case.truth.reflected_mass_kg + case.truth.movable_mass_kg) / case.truth.thrust_constant_n_a;
    let (mut filtered, mut sum, mut worst) = (0.0, 0.0, 0.0_f64);
    for k in 1..cmd.len() {
        let raw = (angle[k] - angle[k - 1]) * travel / 1.0e-4;
        filtered += 0.3 / 1.3 * (raw - filtered);
        let error = (cmd[k] - cmd[k - 1]) / 1.0e-4 + 60.0 * (cmd[k] - stage[k]) - filtered;
        sum += error * 1.0e-4;
        worst = worst.max((gain * 220.0 * (error + 20.0 * sum) - current[k]).abs());
    }
    assert!(worst < 1.5e-4, "{worst} A: the reference is rounded to 0.1 mA and no more than that may differ");
}

#[test]
fn a_healthy_machine_hides_no_force_and_a_deeper_effect_hides_more() {
    let healthy = case(&[], 1.0);
    let all = healthy.hidden_force_n.iter().flatten().flatten();
    assert!(all.map(|f| f.abs()).fold(0.0, f64::max) < 1.0e-9);
    let (plain, shallow) = (case(&["stribeck_friction"], 1.0), case(&["stribeck_friction"], 0.1));
    let (a, b) = (rms(&plain.hidden_force_n[1][2]), rms(&shallow.hidden_force_n[1][2]));
    assert!((a / b - 10.0).abs() < 1.0, "{a} N against {b} N");
}

#[test]
fn the_same_seed_gives_the_same_recording() {
    let (a, b) = (case(&["backlash"], 1.0), case(&["backlash"], 1.0));
    assert_eq!(a.recordings, b.recordings);
    assert_eq!(a.model, b.model);
}

#[test]
fn thrust_balances_motion_and_hidden_force_over_a_slow_stroke() {
    // Independent of the integrator: over a stroke at constant speed the mean current carries friction,
    // damping and the hidden constant force, whatever the dynamics between.
    let case = case(&["gravity_load"], 1.0);
    let idle = &case.recordings[1];
    let (cmd, current) =
        (idle.require("x_position_cmd_m").unwrap(), idle.require("x_current_ref_a").unwrap());
    let truth = &case.truth;
    let mut checked = 0;
    for start in (0..cmd.len() - 2000).step_by(500) {
        let speed = (cmd[start + 2000] - cmd[start]) / 0.2;
        let steady = (0..20).all(|j| {
            let k = start + 100 * j;
            ((cmd[k + 100] - cmd[k]) / 0.01 - speed).abs() < 1.0e-6
        });
        let settled = start > 3000 && ((cmd[start] - cmd[start - 3000]) / 0.3 - speed).abs() < 1.0e-6;
        if speed.abs() < 5.0e-3 || !steady || !settled {
            continue;
        }
        let mean = current[start..start + 2000].iter().sum::<f64>() / 2000.0;
        let friction = truth.stage_coulomb_friction_n + truth.motor_coulomb_friction_n;
        let damping = truth.reflected_damping_n_s_m + truth.translational_damping_n_s_m;
        let expected = friction * speed.signum() + damping * speed + case.hidden[0].parameters[0].1;
        let thrust = truth.thrust_constant_n_a * mean;
        assert!((thrust - expected).abs() < 0.4, "{thrust} N against {expected} N at {speed} m/s");
        checked += 1;
    }
    assert!(checked > 10, "only {checked} steady stretches");
}

#[test]
fn an_unknown_effect_and_a_rigid_axis_are_refused_by_name() {
    let machine = model();
    let spec = CaseSpec { effects: vec!["gremlins".to_owned()], ..CaseSpec::default() };
    let error = conceal(&machine.axes[0], machine.sample_rate, &spec).unwrap_err().to_string();
    assert!(error.starts_with("no effect gremlins can be hidden"), "{error}");
    let text = "[machine]\nname = \"m\"\nsample_rate_hz = 1000.0\n[axes.y]\nmovable_mass_kg = 95.0\n";
    let rigid = machine_from_text(Path::new("m.toml"), text).unwrap();
    let error = conceal(&rigid.axes[0], rigid.sample_rate, &CaseSpec::default()).unwrap_err().to_string();
    assert!(error.starts_with("axis y states no screw_lead_m"), "{error}");
}
