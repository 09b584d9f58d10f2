//! From fitted laws to named parameters, terms of a model and sentences.

use super::laws::{Hypothesis, Sheet, Told, scale_deviation};
use crate::diagnosis::result::Estimate;
use crate::plant::effects::{
    EffectKind, ParameterValue, PhysicsTerm, Port, Specification, external_disturbance,
};
use crate::units::engineering;

/// Numbers of a law for people, and the law as a term of a model.
pub(super) fn told(h: &Hypothesis, told: &Told<'_>) -> (Vec<Estimate>, PhysicsTerm) {
    let mut sheet = Sheet { list: Vec::new(), scale: scale_deviation(told.balance) };
    h.tell(told, &mut sheet);
    let mut term = term_of(h.effect, h.port, &sheet.list);
    h.law().write(told, &mut term);
    (sheet.list, term)
}

/// Numbers for people as a term of a model.
pub(super) fn term_of(effect: EffectKind, port: Port, numbers: &[Estimate]) -> PhysicsTerm {
    let number = |e: &Estimate| (e.name.clone(), ParameterValue::Number(e.value));
    PhysicsTerm { effect, port, parameters: numbers.iter().map(number).collect() }
}

/// What is known of an effect.
pub(super) fn specification(effect: EffectKind) -> &'static Specification {
    Specification::of(effect).unwrap_or(&external_disturbance::SPECIFICATION)
}

/// One sentence for a person.
pub(super) fn statement(effect: EffectKind, port: Port, parameters: &[Estimate]) -> String {
    let of = |e: &Estimate| {
        let name = specification(effect).parameter(&e.name)?.in_words()?;
        Some(format!("{name} {}", engineering(e.value, e.unit, 4)))
    };
    let numbers: Vec<String> = parameters.iter().filter_map(of).collect();
    format!(
        "The model leaves out {} at the {}: {}.",
        effect.name().replace('_', " "),
        port.name().replace('_', " "),
        numbers.join(", ")
    )
}
