//! The diagnosis where steps of the encoders hide when friction turns.

use super::diagnosis::{healthy, restated};
use stillcut::diagnosis::{Diagnosis, Verdict, diagnose};
use stillcut::plant::machine::Machine;
use stillcut::sample::Recording;
use stillcut::simulation::concealed_axis::{CaseSpec, conceal};

/// Positions rounded to steps of motor and stage, m, and a model that states them.
fn rounded(machine: &Machine, recordings: &[Recording], steps_m: [f64; 2]) -> (Machine, Vec<Recording>) {
    let m_per_rad = machine.axes[0].drive.travel_m_rad();
    let mut recordings = recordings.to_vec();
    for column in recordings.iter_mut().flat_map(|r| &mut r.columns) {
        let step = match &*column.name {
            "x_motor_angle_rad" => steps_m[0] / m_per_rad,
            "x_stage_position_m" => steps_m[1],
            _ => continue,
        };
        column.values.iter_mut().for_each(|v| *v = (*v / step).round() * step);
    }
    let machine = restated(machine, |raw| {
        raw.motor_encoder_resolution_m = Some(steps_m[0]);
        raw.stage_encoder_resolution_m = Some(steps_m[1]);
    });
    (machine, recordings)
}

/// A screw that winds up by 25 um under friction.
fn soft() -> Machine {
    restated(&super::conceal::model(), |raw| {
        raw.axial_stiffness_n_m = Some(2.0e6);
        raw.structural_damping_n_s_m = Some(100.0);
    })
}

fn named(d: &Diagnosis) -> Vec<(&'static str, &'static str)> {
    d.findings.iter().map(|f| (f.effect.name(), f.port.name())).collect()
}

/// Where the stage sticks, noise of its speed is noise of its friction. It had been taken for noise of the
/// whole recording, and a friction of a fifth of its size was the likeliest.
#[test]
fn friction_is_of_its_size_where_noise_of_the_speed_hides_when_it_turns() {
    let soft = soft();
    let spec = CaseSpec { effects: vec!["asymmetric_friction".to_owned()], seed: 5, ..CaseSpec::default() };
    let case = conceal(&soft.axes[0], soft.sample_rate, &spec).unwrap();
    let (machine, recordings) = rounded(&case.model, &case.recordings, [1.4e-7, 7e-8]);
    let d = diagnose(&machine, &recordings, &|_, _| {}).unwrap();
    assert_eq!(d.balances, ["motor", "stage"]);
    // A load and a friction that differs between the directions are told apart where the axis turns round.
    let [found] = &d.findings[..] else { panic!("{:?} {:?}", named(&d), d.notes) };
    let may_be = found.alternatives.iter().filter(|a| a.probability > 0.2).map(|a| a.effect);
    let effects: Vec<&str> = std::iter::once(found.effect).chain(may_be).map(|e| e.name()).collect();
    assert!(effects.contains(&"asymmetric_friction"), "{effects:?}");
    assert_eq!(found.port.name(), "stage");
    assert!(d.parameter_corrections.is_empty(), "{:?}", d.parameter_corrections);
}

#[test]
fn a_healthy_axis_with_coarse_encoders_has_the_frictions_of_its_model() {
    let (machine, recordings) = healthy(&soft(), 12);
    let (machine, recordings) = rounded(&machine, &recordings, [1e-6, 4e-9]);
    let d = diagnose(&machine, &recordings, &|_, _| {}).unwrap();
    assert_eq!(d.balances, ["motor", "stage"]);
    assert_eq!((d.verdict, named(&d)), (Verdict::ModelAdequate, vec![]), "{:?}", d.notes);
    // Said of a half it is a wrong number, of its size.
    let dry_n = machine.axes[0].drive.motor_coulomb_friction_n();
    let half = restated(&machine, |raw| raw.motor_coulomb_friction_n = Some(0.5 * dry_n));
    let d = diagnose(&half, &recordings, &|_, _| {}).unwrap();
    let [told] = &d.parameter_corrections[..] else {
        panic!("{:?} {:?}", named(&d), d.parameter_corrections)
    };
    assert_eq!(told.name, "motor_coulomb_friction_n");
    assert!((told.value / dry_n - 1.0).abs() < 0.05, "{told:?}, true {dry_n}");
}

/// Friction behind a screw that winds up turns later than at the motor: no clock, dead time or loop is told
/// from that.
#[test]
fn one_mass_in_place_of_two_makes_no_force_late() {
    let stiff = restated(&super::conceal::model(), |raw| raw.axial_stiffness_n_m = Some(2.0e7));
    let (machine, recordings) = healthy(&stiff, 12);
    for steps_m in [[2.5e-7, 8e-7], [8e-7, 2e-8]] {
        let (machine, recordings) = rounded(&machine, &recordings, steps_m);
        let d = diagnose(&machine, &recordings, &|_, _| {}).unwrap();
        assert_eq!(d.balances, ["axis"], "{steps_m:?}");
        assert!(d.force_faults.is_empty(), "{steps_m:?}: {:?}", d.force_faults);
        assert!(d.parameter_corrections.is_empty(), "{steps_m:?}: {:?}", d.parameter_corrections);
        assert!(d.findings.is_empty(), "{steps_m:?}: {:?}", named(&d));
    }
    // What is late by more than friction's part is told.
    let (machine, recordings) = rounded(&machine, &recordings, [2.5e-7, 8e-7]);
    let late = restated(&machine, |raw| {
        raw.amplifier_dead_time_s = raw.amplifier_dead_time_s.map(|s| s + 2e-3);
    });
    let d = diagnose(&late, &recordings, &|_, _| {}).unwrap();
    let is_told = d.parameter_corrections.iter().any(|c| c.name == "amplifier_dead_time_s");
    assert!(is_told || !d.force_faults.is_empty(), "{:?} {:?}", d.verdict, d.notes);
}

#[test]
fn a_current_loop_that_is_stated_too_slow_is_a_wrong_number() {
    let (machine, recordings) = healthy(&super::conceal::model(), 12);
    let true_rad_s = machine.axes[0].drive.current_loop_bandwidth_rad_s().unwrap();
    let slow = restated(&machine, |raw| raw.current_loop_bandwidth_rad_s = Some(0.7 * true_rad_s));
    let d = diagnose(&slow, &recordings, &|_, _| {}).unwrap();
    assert_eq!((d.verdict, named(&d)), (Verdict::ParameterError, vec![]), "{:?}", d.notes);
    let [told] = &d.parameter_corrections[..] else { panic!("{:?}", d.parameter_corrections) };
    assert_eq!(told.name, "current_loop_bandwidth_rad_s");
    assert!((told.ci95[0]..told.ci95[1]).contains(&true_rad_s), "{told:?}, true {true_rad_s}");
    super::own_drive::assert_written(&d);
}

/// Of the motor's position alone: friction of the stage turns when the stage does, after the screw has unwound
/// by 50 um. Taken at the motor's speed it hid a Stribeck bump.
#[test]
fn a_bump_of_friction_is_seen_behind_a_stated_screw() {
    let soft = soft();
    for effects in [vec![], vec!["stribeck_friction".to_owned()]] {
        let spec = CaseSpec { effects: effects.clone(), seed: 6, ..CaseSpec::default() };
        let mut case = conceal(&soft.axes[0], soft.sample_rate, &spec).unwrap();
        for recording in &mut case.recordings {
            recording.columns.retain(|c| c.name != "x_stage_position_m");
        }
        let d = diagnose(&case.model, &case.recordings, &|_, _| {}).unwrap();
        assert_eq!(d.balances, ["axis"]);
        let told: Vec<&str> = named(&d).into_iter().map(|(effect, _)| effect).collect();
        assert_eq!(told, effects, "{:?}", d.notes);
        assert!(d.unexplained.is_none() && d.parameter_corrections.is_empty(), "{:?}", d.notes);
    }
}

/// Of one position nothing but its place tells a wave of the motor from one of the guide: what comes as often in a
/// turn as the motor has pole pairs is the motor's, another order the guide's.
#[test]
fn a_wave_of_one_position_is_the_motors_where_that_has_as_many_pole_pairs() {
    let (machine, mut recordings) = healthy(&super::conceal::model(), 12);
    let machine = restated(&machine, |raw| raw.motor_pole_count = Some(8.0));
    for recording in &mut recordings {
        recording.columns.retain(|c| &*c.name != "x_stage_position_m");
    }
    let told = |order: f64| {
        let mut recordings = recordings.clone();
        for recording in &mut recordings {
            let angle = recording.get("x_motor_angle_rad").unwrap().to_vec();
            let current = recording.columns.iter_mut().find(|c| &*c.name == "x_current_ref_a").unwrap();
            for (current, angle) in current.values.iter_mut().zip(angle) {
                *current += 0.05 * (order * angle + 0.7).sin();
            }
        }
        let d = diagnose(&machine, &recordings, &|_, _| {}).unwrap();
        named(&d)
    };
    assert_eq!(told(4.0), [("torque_ripple", "motor")]);
    assert_eq!(told(3.3), [("position_periodic_force", "stage")]);
}
