//! A diagnosis in the words of someone who builds the machine: one phrase an effect, one sentence a verdict.

use super::html::{after, before, spoken, telling, without_unit};
use super::page::{engineering, significant};
use crate::diagnosis::{Correction, Diagnosis, Finding, Verdict};
use crate::plant::effects::{EffectKind as E, Port};
use crate::signal::inner_products::rms;
use std::f64::consts::TAU;

/// Over the floor: what is more than this is not "down to the noise".
const AT_NOISE: f64 = 1.5;
/// Findings and numbers that the first sentence names.
const SAID: usize = 2;

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
            format!("Structure complete; wrong in the model: {}{}.{}", wrong(d), with_answer(d), rest(d))
        }
        Verdict::ModelAdequate => adequate(d),
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

fn adequate(d: &Diagnosis) -> String {
    let largest =
        d.parameter_corrections.iter().map(|c| (c.value / c.nominal - 1.0).abs()).fold(0.0, f64::max);
    let numbers = match d.parameter_corrections.len() {
        0 => String::new(),
        1 => format!("one number off by {} %", significant(100.0 * largest, 2)),
        n => format!("{n} numbers off by up to {} %", significant(100.0 * largest, 2)),
    };
    match (numbers.is_empty(), times_the_floor(d) < AT_NOISE) {
        (false, _) => format!("Structure complete; {numbers}{}.{}", with_answer(d), rest(d)),
        (true, true) => "Nothing is missing: the model explains these recordings down to their noise.".into(),
        (true, false) => format!("No missing effect is proven.{}", rest(d)),
    }
}

/// `: with model.toml 35 N becomes 0.28 N`, in the recording that the page shows.
fn with_answer(d: &Diagnosis) -> String {
    let Some(p) = telling(d) else { return String::new() };
    let fit = &d.recordings[p.recording];
    let (left, right) = (rms(before(d, fit, p.balance)), rms(after(fit, p.balance)));
    format!(": with model.toml {} becomes {}", engineering(left, "N", 2), engineering(right, "N", 2))
}

/// What is left, over the noise floor, of the balance where that is most.
fn times_the_floor(d: &Diagnosis) -> f64 {
    let of = |balance: usize| {
        let squares: Vec<f64> = d.recordings.iter().flat_map(|r| after(r, balance).iter().copied()).collect();
        rms(&squares) / d.noise_floor_n.get(balance).copied().unwrap_or(0.0).max(1.0e-12)
    };
    (0..d.balances.len()).map(of).fold(0.0, f64::max)
}

fn rest(d: &Diagnosis) -> String {
    let times = times_the_floor(d);
    if times < AT_NOISE {
        return String::new();
    }
    format!(
        " What is left is {} times the noise of these recordings: they hold more than the model says, and no \
         effect is proven to be the cause.",
        significant(times, 2)
    )
}

/// What to do with the answer where no finding says it.
pub(super) fn next_step(d: &Diagnosis) -> Option<&'static str> {
    if d.no_evidence.is_some() {
        return Some(
            "A recording of five seconds or more while the axis feeds in air: strokes over the whole travel in both \
             directions at three speeds at least.",
        );
    }
    let loud = times_the_floor(d) >= AT_NOISE;
    match d.verdict {
        Verdict::MissingPhysics => None,
        Verdict::UnexplainedMismatch => Some(
            "The same motion twice, then at half the speed and with another load: what differs between the first two is \
             not of the axis; whether the rest stays at its position, its speed or its time says what to look for.",
        ),
        _ if loud => Some(
            "Another recording, five seconds or more: strokes over the whole travel in both directions at three speeds at \
             least. Diagnosed with model.toml beside this one it shows whether the rest belongs to the axis.",
        ),
        Verdict::ModelAdequate if d.parameter_corrections.is_empty() => Some(
            "Nothing now. After a repair, a crash or a year of work record the same motion again and diagnose it with the \
             same model: what has changed since is then what it finds.",
        ),
        _ => Some(
            "Take model.toml in the place of the model, record the axis with another stroke and another speed, and \
             diagnose that with it: the answer must be that nothing is missing.",
        ),
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

/// A finding as one phrase with its key number.
pub(super) fn phrase(f: &Finding, d: &Diagnosis) -> String {
    let value = |name: &str| f.parameters.iter().find(|e| e.name == name).map(|e| e.value);
    let n = |name: &str, unit: &str, digits| {
        value(name).map_or_else(|| "an unknown amount".to_owned(), |v| engineering(v.abs(), unit, digits))
    };
    let share = |name: &str| format!("{} %", significant(100.0 * value(name).unwrap_or(0.0).abs(), 2));
    match f.effect {
        E::CoulombFriction => format!("dry friction of {}", n("force_n", "N", 3)),
        E::ViscousFriction => format!("friction that grows with the speed, {}", n("n_s_m", "N s/m", 3)),
        E::StribeckFriction => format!(
            "friction that is {} higher at creep speed and falls off over {}",
            n("stribeck_force_n", "N", 3),
            n("stribeck_velocity_m_s", "m/s", 3)
        ),
        E::PreslidingFriction => format!(
            "friction that gives like a spring of {} after each reversal before it slides",
            n("presliding_stiffness_n_m", "N/m", 3)
        ),
        E::AsymmetricFriction => {
            format!("friction that differs by {} between the directions", n("force_difference_n", "N", 3))
        }
        E::NonlinearViscosity => {
            format!("friction that grows with the square of the speed, {}", n("n_s2_m2", "N s2/m2", 3))
        }
        E::FrictionDrift => format!(
            "friction that changes by {} with a time constant of {}",
            share("relative_change"),
            n("time_constant_s", "s", 3)
        ),
        E::PositionPeriodicForce => {
            let length_m = value("wavelength_m").unwrap_or(0.0);
            format!("a force that repeats {}, {}", period(length_m, d), n("amplitude_n", "N", 3))
        }
        E::PositionDependentForce => {
            format!("a force of up to {} that depends on the position", n("amplitude_n", "N", 3))
        }
        E::TorqueRipple => format!(
            "a ripple of the motor's torque {} times a turn, {}",
            significant(value("order_per_rev").unwrap_or(0.0), 3),
            n("amplitude_n", "N", 3)
        ),
        E::TorqueConstantSaturation => {
            format!("a torque that falls behind large currents, {}", n("per_a2", "1/A2", 3))
        }
        E::GravityLoad => {
            format!("a constant force of {} (weight, or an offset of the drive)", n("force_n", "N", 3))
        }
        E::Backlash => format!("{} of play between motor and stage", n("gap_m", "m", 3)),
        E::TorsionalMode => format!(
            "that the motor and the screw's far end twist against each other at {}",
            n("free_free_frequency_hz", "Hz", 3)
        ),
        E::PositionDependentStiffness => {
            format!(
                "a stiffness of the screw that changes by {} over the travel",
                share("relative_variation")
            )
        }
        E::NonlinearStiffness => "a stiffness of the screw that changes with the load".to_owned(),
        E::DeadTime if f.port == Port::Current => {
            format!("that the drive acts {} later than stated", n("extra_delay_s", "s", 3))
        }
        E::DeadTime => {
            format!(
                "that the {} answers {} later than stated",
                spoken(f.port.name()),
                n("extra_delay_s", "s", 3)
            )
        }
        E::CurrentLoopLag => format!(
            "that the current loop is slower than stated, {}",
            engineering(value("bandwidth_rad_s").unwrap_or(0.0) / TAU, "Hz", 3)
        ),
        E::EncoderInterpolationError => format!(
            "that the {} reads wrong by {}, once in {} of travel",
            spoken(f.port.name()),
            n("amplitude_m", "m", 3),
            n("signal_period_m", "m", 3)
        ),
        E::EncoderQuantization => {
            format!("that the {} counts in steps of {}", spoken(f.port.name()), n("step_m", "m", 3))
        }
        E::CuttingForce => format!(
            "a cutting force of up to {} at {}, from {} to {}",
            n("amplitude_n", "N", 3),
            n("fundamental_hz", "Hz", 3),
            n("start_s", "s", 3),
            n("end_s", "s", 3)
        ),
        other => spoken(other.name()),
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
    let value = |name: &str| f.parameters.iter().find(|e| e.name == name).map(|e| e.value);
    match f.effect {
        E::TorsionalMode => {
            let hz = value("free_free_frequency_hz")?;
            Some(format!(
                "The twist stands at {}; it shows from about half of that on.",
                engineering(hz, "Hz", 3)
            ))
        }
        E::DeadTime => {
            let delay_s = value("extra_delay_s")?;
            let degrees = |hz: f64| significant(360.0 * delay_s * hz, 2);
            Some(format!(
                "The delay grows with the frequency: {}\u{b0} at 10 Hz, {}\u{b0} at 100 Hz, {}\u{b0} at 500 Hz.",
                degrees(10.0),
                degrees(100.0),
                degrees(500.0)
            ))
        }
        E::CurrentLoopLag => {
            let hz = value("bandwidth_rad_s")? / TAU;
            Some(format!(
                "The loop turns by 45\u{b0} at {} and by 6\u{b0} at a tenth of it.",
                engineering(hz, "Hz", 3)
            ))
        }
        _ => None,
    }
}
