//! Names of a model file and of effects as a person writes them.

use crate::plant::effects::{EffectKind, Specification};
use crate::units;

/// `stribeck_friction` as a person writes it.
pub(super) fn spoken(name: &str) -> String {
    name.replace('_', " ")
}

/// `stribeck_force_n` as `stribeck force`: the unit stands beside the value. Of a stated law with its name.
pub(super) fn without_unit(name: &str) -> String {
    spoken(units::without_unit(&name.replace('.', "_")))
}

/// A parameter of an effect by the word that its specification has for it.
pub(super) fn parameter(effect: EffectKind, name: &str) -> String {
    let of = Specification::of(effect).and_then(|s| s.parameter(name));
    of.and_then(|p| p.in_words()).unwrap_or_else(|| without_unit(name))
}
