//! Physics that a random cut has and its operator may not know of.

use crate::plant::cut_effects::{CutEffect, Physics};
use crate::plant::effects::EffectKind;
use crate::plant::scenario::{RawScenario, Scenario};
use crate::plant::workpiece::ScenarioError;
use rand::RngExt as _;
use rand_chacha::ChaCha8Rng;

/// Effects that change which pitch is stable: those that another line or another delay comes with.
pub(super) const EFFECTS: [EffectKind; 5] = [
    EffectKind::SecondMode,
    EffectKind::SecondPlane,
    EffectKind::TurretCompliance,
    EffectKind::ContactStiffness,
    EffectKind::ForceLag,
];

/// The effect of that name among [`EFFECTS`].
pub(super) fn named(name: &str) -> Result<EffectKind, String> {
    EFFECTS
        .into_iter()
        .find(|e| e.name() == name)
        .ok_or_else(|| format!("`{name}` is not one of {}", EFFECTS.map(EffectKind::name).join(", ")))
}

/// A size that the cut clearly shows, in the parameters' order.
///
/// Errors: never for a cut that is physical; the types want it checked.
pub(super) fn drawn(
    effect: EffectKind,
    scenario: &Scenario,
    random: &mut ChaCha8Rng,
) -> Result<Physics, ScenarioError> {
    let bar = &scenario.workpiece;
    let (hz, stiffness_n_m) = (bar.bending_frequency_hz(), bar.modal_stiffness_n_m());
    let mut between = |low: f64, high: f64| random.random_range(low..high);
    let values = match effect {
        EffectKind::SecondMode => vec![
            ("frequency_hz", hz * between(1.2, 2.0)),
            ("damping_ratio", between(0.01, 0.03)),
            ("n_m", stiffness_n_m * between(1.5, 3.0)),
        ],
        EffectKind::SecondPlane => {
            vec![("frequency_hz", hz * between(0.95, 1.05)), ("orientation_rad", between(0.25, 0.6))]
        }
        EffectKind::TurretCompliance => vec![
            ("frequency_hz", hz * between(0.85, 1.5)),
            ("damping_ratio", between(0.02, 0.05)),
            ("n_m", between(5e6, 12e6)),
        ],
        EffectKind::ContactStiffness => {
            vec![("n_m", scenario.cutting.stiffness_n_m() * between(0.2, 0.5))]
        }
        _ => vec![("time_constant_s", between(30e-6, 80e-6))],
    };
    let mut ordered = [0.0; crate::plant::cut_effects::MOST_PARAMETERS];
    let specification = CutEffect::SPECIFICATIONS.iter().find(|s| s.kind == effect);
    let parameters = specification.map_or(&[][..], |s| s.parameters);
    for (slot, parameter) in ordered.iter_mut().zip(parameters) {
        *slot = values.iter().find(|(name, _)| *name == parameter.name).map_or(0.0, |(_, value)| *value);
    }
    let term = CutEffect::new(effect, ordered);
    Ok(Physics::new(term.as_slice())?)
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
