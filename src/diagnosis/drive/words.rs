//! From fitted laws to named parameters, terms of a model and sentences.

use super::laws::{Hypothesis, Sheet, Told, scale_deviation};
use crate::diagnosis::result::Estimate;
use crate::plant::effects::{
    EffectKind, ParameterValue, PhysicsTerm, Port, Specification, Spoken, external_disturbance,
};

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
        let name = match specification(effect).parameter(&e.name).map(|p| p.spoken) {
            Some(Spoken::Not) => return None,
            Some(Spoken::As(word)) => word.to_owned(),
            Some(Spoken::Name) | None => quantity(&e.name, e.unit),
        };
        Some(format!("{name} {}", engineering(e.value, e.unit)))
    };
    let numbers: Vec<String> = parameters.iter().filter_map(of).collect();
    format!(
        "The model leaves out {} at the {}: {}.",
        effect.name().replace('_', " "),
        port.name().replace('_', " "),
        numbers.join(", ")
    )
}

/// A parameter's name without its unit, in words.
fn quantity(name: &str, unit: &str) -> String {
    let tail = unit.to_lowercase().replace('/', " ");
    let words = name.replace('_', " ");
    words.strip_suffix(&tail).unwrap_or(&words).trim_end().to_owned()
}

/// A value in the unit of the shop floor: 1.0 um, 165 us, 5.64 N.
pub(in crate::diagnosis) fn engineering(value: f64, unit: &str) -> String {
    let size = value.abs();
    let (factor, prefix) = match unit {
        "m" | "s" | "m/s" if size > 0.0 && size < 1e-6 => (1e9, "n"),
        "m" | "s" | "m/s" if size > 0.0 && size < 1e-3 => (1e6, "u"),
        "m" | "s" | "m/s" if size > 0.0 && size < 0.5 => (1e3, "m"),
        "N/m" if size > 1e6 => (1e-6, "M"),
        _ => (1.0, ""),
    };
    let x = value * factor;
    let text = if x.abs() >= 1e5 || (x != 0.0 && x.abs() < 1e-3) {
        format!("{x:.3e}")
    } else if x.abs() >= 100.0 {
        format!("{x:.0}")
    } else {
        format!("{x:.3}")
    };
    if unit == "1" { text } else { format!("{text} {prefix}{unit}") }
}
