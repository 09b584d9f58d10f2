//! A diagnosis in the words of someone who builds the machine: one phrase an effect, one sentence a verdict.

use super::naming::{spoken, without_unit};
use super::page::{engineering, significant};
use super::residual_series::{after, before, telling};
use crate::diagnosis::{Correction, Diagnosis, Finding, Verdict};
use crate::plant::effects::position_periodic_force::WAVELENGTH;
use crate::plant::effects::{
    EffectKind as E, Parameter, Port, Role, Specification, current_loop_lag, dead_time, torsional_mode,
};
use crate::signal::inner_products::rms;
use std::f64::consts::TAU;

/// Findings and numbers that the first sentence names.
pub(super) const SAID: usize = 2;

/// The first sentence of the page.
pub(super) fn headline(d: &Diagnosis) -> String {
    if d.no_evidence.is_some() {
        return "Nothing can be told of the drive from these recordings.".to_owned();
    }
    match d.verdict {
        Verdict::MissingPhysics => {
            let phrases: Vec<String> = d.findings.iter().take(SAID).map(|f| phrase(f, d)).collect();
            let more = match d.findings.len().saturating_sub(SAID) {
                0 => String::new(),
                1 => "; and one effect more".to_owned(),
                n => format!("; and {n} effects more"),
            };
            format!("The model leaves out {}{more}.", phrases.join("; and "))
        }
        Verdict::ParameterError => {
            format!("Structure complete; wrong in the model: {}{}.", wrong(d), with_answer(d))
        }
        Verdict::ModelAdequate => {
            "Nothing is missing: the model explains these recordings down to their noise.".to_owned()
        }
        Verdict::UnexplainedMismatch => {
            let place = d
                .location
                .as_ref()
                .map_or(String::new(), |l| format!(", {}, over {}", place_of(l.port, d), spoken(l.domain)));
            format!("Something is missing that no known effect explains{place}.")
        }
    }
}

/// The numbers that are off most, worst first.
fn wrong(d: &Diagnosis) -> String {
    let off =
        |c: &Correction| if c.nominal == 0.0 { f64::INFINITY } else { (c.value / c.nominal).ln().abs() };
    let mut worst: Vec<&Correction> = d.parameter_corrections.iter().collect();
    worst.sort_by(|a, b| off(b).total_cmp(&off(a)));
    let said = worst.iter().take(SAID).map(|c| spoken_change(&c.name, c.nominal, c.value));
    let names = said.collect::<Vec<String>>().join(", ");
    match worst.len().saturating_sub(SAID) {
        0 => names,
        n => format!("{names}, and {n} more that are off by less"),
    }
}

/// `: with model.toml 35 N becomes 0.28 N`, in the recording that the page shows.
fn with_answer(d: &Diagnosis) -> String {
    let Some(p) = telling(d) else { return String::new() };
    let fit = &d.recordings[p.recording];
    let (left, right) = (rms(before(d, fit, p.balance)), rms(after(fit, p.balance)));
    format!(": with model.toml {} becomes {}", engineering(left, "N", 2), engineering(right, "N", 2))
}

/// What to do with the answer: what tells a finding from what else it could be, or what confirms the answer.
pub(super) fn next_step(d: &Diagnosis) -> &str {
    if d.no_evidence.is_some() {
        return "A recording of five seconds or more while the axis feeds in air: strokes over the whole travel in both \
                directions at three speeds at least.";
    }
    let confirmed = "Take model.toml in the place of the model, record the axis with another stroke and another speed, \
                     and diagnose that with it: the answer must be that nothing is missing.";
    match d.verdict {
        Verdict::MissingPhysics => {
            d.findings.iter().find_map(|f| f.next_experiment.as_deref()).unwrap_or(confirmed)
        }
        Verdict::UnexplainedMismatch => {
            "The same motion twice, then at half the speed and with another load: what differs between the first two is \
             not of the axis; whether the rest stays at its position, its speed or its time says what to look for."
        }
        Verdict::ParameterError => confirmed,
        Verdict::ModelAdequate => {
            "Nothing now. After a repair, a crash or a year of work record the same motion again and diagnose it with the \
             same model: what has changed since is then what it finds."
        }
    }
}

fn spoken_change(name: &str, nominal: f64, value: f64) -> String {
    if nominal == 0.0 {
        return without_unit(name);
    }
    format!("{} ({:+.0} %)", without_unit(name), 100.0 * (value / nominal - 1.0)).replace('-', "\u{2212}")
}

/// Where a port is, for someone who stands before the machine.
pub(super) fn place_of(port: Port, d: &Diagnosis) -> String {
    match port {
        _ if d.balances.len() == 1 && matches!(port, Port::Stage | Port::Motor) => {
            "in the axis as a whole".into()
        }
        Port::Coupling => "between motor and stage".into(),
        Port::Current => "in the drive's current".into(),
        port => format!("at the {}", spoken(port.name())),
    }
}

/// A phrase that stands alone.
pub(super) fn sentence(phrase: &str) -> String {
    let bare = phrase.strip_prefix("that ").unwrap_or(phrase);
    let mut letters = bare.chars();
    letters.next().map_or_else(String::new, |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}

/// A finding as one phrase with its key number, see [`Specification::phrase`].
pub(super) fn phrase(f: &Finding, d: &Diagnosis) -> String {
    let Some(of) = Specification::of(f.effect) else { return spoken(f.effect.name()) };
    let mut parts = (of.phrase)(f.port).split(['{', '}']);
    let mut out = parts.next().unwrap_or_default().to_owned();
    while let (Some(name), Some(after)) = (parts.next(), parts.next()) {
        out.push_str(&match (name, of.parameter(name)) {
            ("port", _) => spoken(f.port.name()),
            ("period", _) => value(f, &WAVELENGTH).map_or_else(String::new, |length_m| period(length_m, d)),
            (_, Some(p)) => amount(f, p),
            (name, None) => name.to_owned(),
        });
        out.push_str(after);
    }
    out
}

fn value(f: &Finding, p: &Parameter) -> Option<f64> {
    f.parameters.iter().find(|e| e.name == p.name).map(|e| e.value)
}

/// A number of a finding: a relative size in per cent, a rate of the current loop as a frequency.
fn amount(f: &Finding, p: &Parameter) -> String {
    let Some(v) = value(f, p) else { return "an unknown amount".to_owned() };
    match (p.unit, p.role) {
        ("1", Role::Size) => format!("{} %", significant(100.0 * v.abs(), 2)),
        ("1", _) => significant(v, 3),
        ("rad/s", _) => engineering(v / TAU, "Hz", 3),
        _ => engineering(v.abs(), p.unit, 3),
    }
}

/// What a wavelength belongs to: the screw where it is a whole part of its lead.
fn period(length_m: f64, d: &Diagnosis) -> String {
    let length = engineering(length_m, "m", 4);
    let turns =
        d.model.axis(&d.axis).and_then(|a| a.drive.screw_lead_m()).map_or(0.0, |lead| lead / length_m);
    let whole = turns.round();
    if whole < 1.0 || (turns / whole - 1.0).abs() > 0.01 {
        format!("every {length}")
    } else if whole < 1.5 {
        format!("with every turn of the screw ({length})")
    } else {
        format!("{whole:.0} times a turn of the screw (every {length})")
    }
}

/// Where in frequency a finding shows that is no curve over anything else.
pub(super) fn in_frequency(f: &Finding) -> Option<String> {
    match f.effect {
        E::TorsionalMode => {
            let hz = value(f, &torsional_mode::FREQUENCY)?;
            Some(format!(
                "The twist stands at {}; it shows from about half of that on.",
                engineering(hz, "Hz", 3)
            ))
        }
        E::DeadTime => {
            let delay_s = value(f, &dead_time::EXTRA)?;
            let degrees = |hz: f64| significant(360.0 * delay_s * hz, 2);
            Some(format!(
                "The delay grows with the frequency: {}\u{b0} at 10 Hz, {}\u{b0} at 100 Hz, {}\u{b0} at 500 Hz.",
                degrees(10.0),
                degrees(100.0),
                degrees(500.0)
            ))
        }
        E::CurrentLoopLag => {
            let hz = value(f, &current_loop_lag::BANDWIDTH)? / TAU;
            Some(format!(
                "The loop turns by 45\u{b0} at {} and by 6\u{b0} at a tenth of it.",
                engineering(hz, "Hz", 3)
            ))
        }
        _ => None,
    }
}
