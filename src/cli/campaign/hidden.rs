//! Physics that a random cut has and its operator may not know of, and what a diagnosis makes of it.

use crate::cli::simulate::record;
use crate::diagnosis::cut::diagnose;
use crate::diagnosis::cut::input::{CutEvidence, CutRecording};
use crate::plant::cut_effects::{
    ContactStiffness, CutEffect, ForceLag, Physics, SecondMode, SecondPlane, TurretCompliance,
};
use crate::plant::effects::EffectKind;
use crate::plant::scenario::{RawScenario, Scenario};
use crate::plant::scenario_error::ScenarioError;
use crate::simulation::force_signal::ShownForce;
use crate::simulation::lathe::LatheSettings;
use clap::ValueEnum as _;
use indicatif::ProgressBar;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// Effects that change which pitch is stable: those that another line or another delay comes with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
#[value(rename_all = "snake_case")]
pub(super) enum Effect {
    SecondMode,
    SecondPlane,
    TurretCompliance,
    ContactStiffness,
    ForceLag,
}

/// The effects that were asked for; `all` stands for every one.
pub(super) fn asked(names: &[String]) -> Result<Vec<Effect>, String> {
    let one = |name: &String| {
        let known = || Effect::value_variants().iter().filter_map(|e| e.to_possible_value());
        let names = || known().map(|v| v.get_name().to_owned()).collect::<Vec<_>>().join(", ");
        Effect::from_str(name, false).map_err(|_| format!("`{name}` is not one of {}", names()))
    };
    match names {
        [all] if all == "all" => Ok(Effect::value_variants().to_vec()),
        names => names.iter().map(one).collect(),
    }
}

/// A size that the cut clearly shows.
///
/// Errors: never for a cut that is physical; the types want it checked.
pub(super) fn drawn(
    effect: Effect,
    scenario: &Scenario,
    random: &mut ChaCha8Rng,
) -> Result<Physics, ScenarioError> {
    let bar = &scenario.workpiece;
    let (hz, stiffness_n_m) = (bar.bending_frequency_hz(), bar.modal_stiffness_n_m());
    let mut between = |low: f64, high: f64| random.random_range(low..high);
    let term = match effect {
        Effect::SecondMode => CutEffect::SecondMode(SecondMode {
            frequency_hz: hz * between(1.2, 2.0),
            damping_ratio: between(0.01, 0.03),
            n_m: stiffness_n_m * between(1.5, 3.0),
        }),
        Effect::SecondPlane => CutEffect::SecondPlane(SecondPlane {
            frequency_hz: hz * between(0.95, 1.05),
            orientation_rad: between(0.25, 0.6),
        }),
        Effect::TurretCompliance => CutEffect::TurretCompliance(TurretCompliance {
            frequency_hz: hz * between(0.85, 1.5),
            damping_ratio: between(0.02, 0.05),
            n_m: between(5e6, 12e6),
        }),
        Effect::ContactStiffness => CutEffect::ContactStiffness(ContactStiffness {
            n_m: scenario.cutting.stiffness_n_m() * between(0.2, 0.5),
        }),
        Effect::ForceLag => CutEffect::ForceLag(ForceLag { time_constant_s: between(30e-6, 80e-6) }),
    };
    Ok(Physics::new(&[term])?)
}

/// Cuts that are made before the diagnosis: speed over that of the cut, pitch in rad, place over the length
/// of the bar. Another speed and another pitch tell the delays apart, another place the bar from what holds
/// it.
const BEFORE: [[f64; 3]; 3] = [[1.0, 0.0, 1.0], [0.8, 0.05, 1.0], [1.15, 0.1, 0.7]];
/// How long each lasts, s.
const LASTS_S: f64 = 4.0;
/// Budget of the diagnosis, s.
const BUDGET_S: f64 = 10.0;

/// What `diagnose --scenario` writes for what is stated, from recordings as `simulate --scenario` makes them
/// of the true cut, and the effects that it named. Where nothing can be judged what is stated stays.
///
/// Errors: never for a cut that is physical; the types want it checked.
pub(super) fn diagnosed(
    (scenario, stated): (&Scenario, &Scenario),
    noise: f64,
    seed: u64,
) -> anyhow::Result<(Scenario, Vec<EffectKind>)> {
    let mut recordings = Vec::new();
    for (k, [speed, pitch_difference_rad, place]) in (0..).zip(BEFORE) {
        let raw = RawScenario {
            speed_rpm: speed * scenario.spindle.rpm(),
            pitch_difference_rad,
            position_m: Some(place * scenario.workpiece.projection_length_m()),
            travel_m_s: 0.0,
            ..scenario.raw()
        };
        let seed = seed.wrapping_add(1000 * k);
        let settings =
            LatheSettings { seed, force_noise_ratio: noise, ..LatheSettings::ideal(Scenario::new(&raw)?) };
        let signal = ShownForce { bandwidth_hz: None, delay_s: 0.0 };
        let recording = record(settings, signal, LASTS_S, &ProgressBar::hidden())?;
        recordings.push(CutRecording::new(&recording, stated)?);
    }
    let evidence = CutEvidence { recordings: &recordings, table: None };
    let Ok(said) = diagnose(stated, evidence, BUDGET_S, &|_, _| {}) else {
        return Ok((*stated, Vec::new()));
    };
    Ok((said.scenario, said.findings.iter().map(|f| f.effect).collect()))
}

/// What a diagnosis could hand over at best: the true scenario with its numbers a little off.
///
/// Errors: never for a cut that is physical; the types want it checked.
pub(super) fn nearly_true(scenario: &Scenario, random: &mut ChaCha8Rng) -> Result<Scenario, ScenarioError> {
    let mut off = |share: f64| random.random_range(1.0 - share..1.0 + share);
    let mut raw = RawScenario { position_m: None, ..scenario.raw() };
    raw.workpiece = raw.workpiece.with_frequency_factor(off(0.003));
    raw.workpiece.damping_ratio *= off(0.1);
    raw.cutting.radial_stiffness_pa *= off(0.03);
    Scenario::new(&raw)
}
