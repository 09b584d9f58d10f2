//! Physics that a random cut has and its operator may not know of.

use crate::plant::cut_effects::{
    ContactStiffness, CutEffect, ForceLag, Physics, SecondMode, SecondPlane, TurretCompliance,
};
use crate::plant::scenario::{RawScenario, Scenario};
use crate::plant::workpiece::ScenarioError;
use clap::ValueEnum as _;
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

/// What a diagnosis hands over: the true scenario with its numbers a little off.
///
/// Errors: never for a cut that is physical; the types want it checked.
pub(super) fn repaired(scenario: &Scenario, random: &mut ChaCha8Rng) -> Result<Scenario, ScenarioError> {
    let mut off = |share: f64| random.random_range(1.0 - share..1.0 + share);
    let mut raw = RawScenario { position_m: None, ..scenario.raw() };
    raw.workpiece = raw.workpiece.with_frequency_factor(off(0.003));
    raw.workpiece.damping_ratio *= off(0.1);
    raw.cutting.radial_stiffness_pa *= off(0.03);
    Scenario::new(&raw)
}
