//! A first-time user's model: numbers guessed, frictions and delays not in it.

use crate::diagnosis::{healthy, restated};
use crate::own_drive::assert_written;
use stillcut::diagnosis::{Verdict, diagnose};
use stillcut::simulation::concealed_axis::{CaseSpec, conceal};

/// Motor and scale disagree about the travel: once that was refused, now it is a wrong number, and nothing
/// else is wrong beside it.
#[test]
fn a_lead_that_is_off_by_two_is_put_right() {
    let (machine, recordings) = healthy(&super::conceal::model(), 12);
    let true_m = machine.axes[0].drive.screw_lead_m().unwrap();
    for off in [0.5, 2.0] {
        let guessed = restated(&machine, |raw| raw.screw_lead_m = Some(off * true_m));
        let d = diagnose(&guessed, &recordings[2..], &|_, _| {}).unwrap();
        assert_eq!(d.verdict, Verdict::ParameterError, "{off}: {:?}", d.notes);
        assert!(d.findings.is_empty(), "{off}: {:?}", d.findings);
        assert_eq!(d.parameter_corrections.len(), 1, "{off}: {:?}", d.parameter_corrections);
        let lead = &d.parameter_corrections[0];
        assert_eq!(lead.name, "screw_lead_m");
        assert!((lead.ci95[0]..=lead.ci95[1]).contains(&true_m), "{off}: {lead:?}");
        assert!(lead.ci95[1] - lead.ci95[0] < 1e-3 * true_m, "{off}: {lead:?}");
        assert!(d.notes.iter().any(|n| n.contains("screw_lead_m")), "{:?}", d.notes);
        assert_written(&d);
    }
}

/// Nobody states over which speed friction turns. Where the usual one was kept and the next that was asked
/// about was 0.4 of it, friction of another speed was taken for a fall with speed and for negative damping.
#[test]
fn frictions_that_are_left_out_are_found_though_they_turn_over_a_speed_that_nobody_states() {
    let slow = restated(&super::conceal::model(), |raw| raw.friction_smoothing_m_s = Some(1.6e-4));
    let (machine, recordings) = healthy(&slow, 12);
    let bare = restated(&machine, |raw| {
        raw.friction_smoothing_m_s = None;
        raw.stage_coulomb_friction_n = None;
        raw.motor_coulomb_friction_n = None;
        raw.translational_damping_n_s_m = None;
        raw.rotary_damping_nm_s_rad = None;
    });
    let d = diagnose(&bare, &recordings, &|_, _| {}).unwrap();
    assert_eq!(d.verdict, Verdict::MissingPhysics, "{:?}", d.notes);
    let named: Vec<(&str, &str)> = d.findings.iter().map(|f| (f.effect.name(), f.port.name())).collect();
    let drive = &machine.axes[0].drive;
    let dry = [("stage", drive.stage_coulomb_friction_n()), ("motor", drive.motor_coulomb_friction_n())];
    for (port, force_n) in dry {
        let found =
            d.findings.iter().find(|f| f.effect.name() == "coulomb_friction" && f.port.name() == port);
        let found = &found.unwrap_or_else(|| panic!("{port}: {named:?}")).parameters[0];
        assert!((found.value / force_n - 1.0).abs() < 0.05, "{port}: {found:?} for {force_n} N");
    }
    let friction = ["coulomb_friction", "viscous_friction"];
    assert!(named.iter().all(|(effect, _)| friction.contains(effect)), "{named:?}");
    assert!(d.parameter_corrections.is_empty(), "{:?}", d.parameter_corrections);
}

/// Friction that turns over a speed that nobody states is a damper between motor and stage, as a late encoder
/// is. Where the delay was asked for before that speed the stage's balance shrank, and nothing was told.
#[test]
fn all_that_is_guessed_or_left_out_is_found_though_the_scale_is_read_late() {
    let (late_s, soft_n_m) = (2.5e-4, 8e5);
    let soft = restated(&super::conceal::model(), |raw| {
        raw.friction_smoothing_m_s = Some(6e-4);
        raw.axial_stiffness_n_m = Some(soft_n_m);
        raw.structural_damping_n_s_m = Some(90.0);
        raw.stage_encoder_delay_s = raw.motor_encoder_delay_s.map(|motor_s| motor_s + late_s);
    });
    let spec = CaseSpec { effects: vec!["backlash".to_owned()], seed: 31, ..CaseSpec::default() };
    let case = conceal(&soft.axes[0], soft.sample_rate, &spec).unwrap();
    let guessed = restated(&case.model, |raw| {
        raw.movable_mass_kg = raw.movable_mass_kg.map(|kg| 0.6 * kg);
        raw.rotary_inertia_kg_m2 = raw.rotary_inertia_kg_m2.map(|kg_m2| 1.5 * kg_m2);
        raw.axial_stiffness_n_m = raw.axial_stiffness_n_m.map(|n_m| 1.6 * n_m);
        for left_out in [
            &mut raw.structural_damping_n_s_m,
            &mut raw.friction_smoothing_m_s,
            &mut raw.stage_coulomb_friction_n,
            &mut raw.motor_coulomb_friction_n,
            &mut raw.translational_damping_n_s_m,
            &mut raw.rotary_damping_nm_s_rad,
            &mut raw.amplifier_dead_time_s,
            &mut raw.current_loop_bandwidth_rad_s,
            &mut raw.motor_encoder_delay_s,
            &mut raw.stage_encoder_delay_s,
        ] {
            *left_out = None;
        }
    });
    let d = diagnose(&guessed, &case.recordings, &|_, _| {}).unwrap();
    assert_eq!(d.verdict, Verdict::MissingPhysics, "{:?}", d.notes);
    let named: Vec<&str> = d.findings.iter().map(|f| f.effect.name()).collect();
    let left_out = ["coulomb_friction", "viscous_friction", "dead_time", "current_loop_lag"];
    assert!(left_out.iter().all(|effect| named.contains(effect)), "{named:?}");
    assert!(named.iter().all(|effect| left_out.contains(effect) || *effect == "backlash"), "{named:?}");
    let drive = &case.model.axes[0].drive;
    for (name, truth, within) in [
        ("movable_mass_kg", drive.movable_mass_kg(), 0.05),
        ("rotary_inertia_kg_m2", drive.rotary_inertia_kg_m2(), 0.05),
        ("axial_stiffness_n_m", drive.axial_stiffness_n_m(), 0.05),
    ] {
        let told = d.parameter_corrections.iter().find(|c| c.name == name);
        let told = told.unwrap_or_else(|| panic!("{name}: {:?}", d.parameter_corrections));
        assert!((told.value / truth - 1.0).abs() < within, "{told:?} for {truth}");
    }
}
