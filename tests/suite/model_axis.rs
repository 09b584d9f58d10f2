//! The executable model against a plant whose equations share no line with it, and against recordings.

use crate::conceal::model;
use stillcut::plant::effects::{EffectKind, ParameterValue, PhysicsTerm};
use stillcut::plant::machine::AxisModel;
use stillcut::sample::Recording;
use stillcut::simulation::concealed_axis::{Case, CaseSpec, conceal};
use stillcut::simulation::model_axis::{
    LoopRecord, Replay, Response, Trial, read_controller, replay, respond,
};

/// A machine whose model is exact but for what is hidden, without noise.
fn exact(effect: Option<&str>) -> Case {
    let machine = model();
    let effects = effect.map(str::to_owned).into_iter().collect();
    let spec = CaseSpec { effects, seed: 11, model_error: 0.0, background: 0.0, ..CaseSpec::default() };
    conceal(&machine.axes[0], machine.sample_rate, &spec).unwrap()
}

fn signals(axis: &AxisModel, r: &Recording) -> LoopRecord {
    let get = |suffix: &str| r.get(&format!("x_{suffix}")).unwrap().to_vec();
    let travel = axis.drive.travel_m_rad();
    LoopRecord {
        command_m: get("position_cmd_m"),
        motor_m: get("motor_angle_rad").iter().map(|x| x * travel).collect(),
        stage_m: get("stage_position_m"),
        reference: get("current_ref_a"),
    }
}

fn replayed(axis: &AxisModel, records: &[LoopRecord], period_s: f64) -> Replay {
    replay(axis.controller.unwrap(), period_s, records).unwrap()
}

fn trial(s: &LoopRecord, replay: &Replay, (k, period_s): (usize, f64)) -> Trial {
    Trial {
        period_s,
        command_m: s.command_m.clone(),
        injected: if replay.share[k] < 0.01 { Vec::new() } else { replay.beyond[k].clone() },
        start_m: [s.motor_m[0], s.stage_m[0]],
        start_m_s: 0.0,
        law: replay.law,
        integral_m: replay.integral_m[k],
        // The judge's drive takes a reference up about a sixth of a sample before it is held.
        taken_up_s: -period_s / 6.0,
        thrust_per_unit: None,
    }
}

fn rms(x: impl Iterator<Item = f64>) -> f64 {
    let (sum, n) = x.fold((0.0, 0.0), |(s, n), v| (s + v * v, n + 1.0));
    (sum / n).sqrt()
}

/// Share of the recorded current that a response misses.
fn missed(response: &Response, s: &LoopRecord) -> f64 {
    rms(response.reference.iter().zip(&s.reference).map(|(a, b)| a - b)) / rms(s.reference.iter().copied())
}

#[test]
fn the_law_replays_a_recorded_loop_and_shows_what_was_added_to_it() {
    let case = exact(None);
    let axis = &case.model.axes[0];
    let all: Vec<LoopRecord> = case.recordings.iter().map(|r| signals(axis, r)).collect();
    let r = replayed(axis, &all, 1.0e-4);
    let by_name = |name: &str| case.recordings.iter().position(|r| r.experiment == name).unwrap();
    assert!(r.share[by_name("idle")] < 2e-4 && r.share[by_name("moves")] < 2e-4, "{:?}", r.share);
    assert!(r.share[by_name("sweep")] > 0.1, "{:?}", r.share);
    let total = case.truth.reflected_mass_kg + case.truth.movable_mass_kg;
    assert!((r.law.per_accel * case.truth.thrust_constant_n_a / total - 1.0).abs() < 1e-3);
}

/// Of three recordings, one of them with a sine added to the loop: the gains that ran it.
#[test]
fn the_law_is_read_from_a_recorded_loop() {
    let case = exact(None);
    let axis = &case.model.axes[0];
    let all: Vec<LoopRecord> = case.recordings.iter().map(|r| signals(axis, r)).collect();
    let stated = axis.controller.unwrap();
    let drive = &axis.drive;
    let of = (drive.total_mass_kg(), drive.thrust_constant_n_a().unwrap());
    let read = read_controller(of, 1.0e-4, &all).unwrap();
    let pairs = [
        (read.position_gain_1_s, stated.position_gain_1_s),
        (read.velocity_gain_1_s, stated.velocity_gain_1_s),
        (read.velocity_integral_1_s, stated.velocity_integral_1_s),
    ];
    assert!(pairs.iter().all(|(a, b)| (a / b - 1.0).abs() < 0.03), "{read:?} {stated:?}");
    // A reference that no loop made follows no law.
    let mut strange = all[0].clone();
    strange.reference.iter_mut().enumerate().for_each(|(k, u)| *u = (0.01 * (k * k) as f64).sin());
    let share = |c| replay(c, 1.0e-4, &[strange.clone()]).unwrap().share[0];
    assert!(read_controller(of, 1.0e-4, &[strange.clone()]).is_none_or(|c| share(c) > 0.9));
}

/// The hidden effect as a term of the model, as its judge simulated it.
fn stated(case: &Case) -> Option<PhysicsTerm> {
    let hidden = case.hidden.first()?;
    let name = hidden.name.split('/').next()?;
    let mut parameters: Vec<(String, ParameterValue)> =
        hidden.parameters.iter().map(|(n, v)| ((*n).to_owned(), ParameterValue::Number(*v))).collect();
    if name == "position_dependent_stiffness" {
        parameters.retain(|p| p.0 != "length_m");
        parameters.push(("length_m".to_owned(), ParameterValue::Number(0.02)));
    }
    Some(PhysicsTerm { effect: EffectKind::from_name(name)?, port: hidden.port, parameters })
}

/// With the true constants and the hidden law stated, the loop does what was recorded; without it, not.
#[test]
fn a_model_that_states_everything_repeats_the_recording_in_closed_loop() {
    for (effect, gain) in [
        (None, 0.0),
        (Some("stribeck_friction"), 30.0),
        (Some("gravity_load"), 30.0),
        (Some("backlash"), 5.0),
        (Some("asymmetric_friction"), 30.0),
        (Some("nonlinear_viscosity"), 30.0),
        (Some("friction_drift"), 30.0),
        (Some("dead_time"), 20.0),
    ] {
        let case = exact(effect);
        let bare = case.model.axes[0].clone();
        let mut full = bare.clone();
        full.physics.extend(stated(&case));
        let all: Vec<LoopRecord> = case.recordings.iter().map(|r| signals(&bare, r)).collect();
        let r = replayed(&bare, &all, 1.0e-4);
        let mut worst = (0.0_f64, 0.0_f64);
        for (k, s) in all.iter().enumerate() {
            let responses = respond(&[bare.clone(), full.clone()], &trial(s, &r, (k, 1.0e-4)));
            let now = (missed(&responses[0], s), missed(&responses[1], s));
            println!("{effect:?} {} without {:.4} with {:.4}", case.recordings[k].experiment, now.0, now.1);
            worst = (worst.0.max(now.0), worst.1.max(now.1));
        }
        assert!(worst.1 < 5e-4, "{effect:?}: {worst:?}");
        assert!(worst.0 > gain * worst.1, "{effect:?}: {worst:?}");
    }
}

/// Side by side a model does what it does alone.
#[test]
fn lanes_do_not_see_each_other() {
    let case = exact(Some("backlash"));
    let bare = case.model.axes[0].clone();
    let mut full = bare.clone();
    full.physics.extend(stated(&case));
    let s = signals(&bare, &case.recordings[2]);
    let r = replayed(&bare, std::slice::from_ref(&s), 1.0e-4);
    let t = trial(&s, &r, (0, 1.0e-4));
    let alone = respond(std::slice::from_ref(&full), &t);
    let crowd = respond(&[bare.clone(), full.clone(), bare.clone(), bare.clone(), full, bare], &t);
    assert_eq!(alone[0].reference.len(), crowd[4].reference.len());
    let worst = alone[0].reference.iter().zip(&crowd[4].reference).map(|(a, b)| (a - b).abs());
    assert!(worst.fold(0.0, f64::max) < 1e-9);
    assert!(crowd[1] == crowd[4] && crowd[0] == crowd[5]);
}
