//! A diagnosis of the cut in the words of someone who turns: one phrase an effect, two sentences a verdict.

use super::cut_proof::{Off, free_off_db};
use super::naming::{spoken, without_unit};
use super::page::{engineering, significant};
use super::words::SAID;
use crate::diagnosis::cut::result::{CutDiagnosis, CutFinding, TableFit};
use crate::diagnosis::{Correction, Verdict};
use crate::plant::effects::{EffectKind as E, Port};
use std::fmt::Write as _;

/// What is wrong with the model of the cut, in one sentence.
pub(super) fn headline(d: &CutDiagnosis) -> String {
    match d.verdict {
        Verdict::MissingPhysics => {
            let phrases: Vec<String> = d.findings.iter().take(SAID).map(phrase).collect();
            let more = match d.findings.len().saturating_sub(SAID) {
                0 => String::new(),
                1 => "; and one effect more".to_owned(),
                n => format!("; and {n} effects more"),
            };
            format!("The model of the cut leaves out {}{more}.", phrases.join("; and "))
        }
        Verdict::ParameterError => {
            let numbers: Vec<String> = d.parameter_corrections.iter().map(change).collect();
            let what = if numbers.len() == 1 { "one number is" } else { "numbers are" };
            format!("The model of the cut is complete, but {what} off: {}.", numbers.join(", "))
        }
        Verdict::ModelAdequate => adequate(d),
        Verdict::UnexplainedMismatch => {
            let place =
                d.location.as_ref().map_or(String::new(), |l| format!(" It shows {}.", place(l.port)));
            format!("Something is missing in the model of the cut that no known effect explains.{place}")
        }
    }
}

/// Nothing is asserted; cuts that came out otherwise than foretold, and what speaks for whom, are told.
fn adequate(d: &CutDiagnosis) -> String {
    let missed = d.table.map_or(0, |t| t.heldout_cuts.saturating_sub(t.heldout_right_after));
    if missed == 0 {
        return "The model explains these cuts: nothing is missing that they could show.".into();
    }
    let cuts = d.table.map_or(0, |t| t.heldout_cuts);
    let candidates: Vec<String> =
        d.tried.iter().filter_map(|t| t.effect).take(SAID).map(|e| spoken(e.name())).collect();
    let candidates = match candidates.as_slice() {
        [] => String::new(),
        [one] => format!(" The first candidate is {one}."),
        many => format!(" The first candidates are {}.", many.join(" and ")),
    };
    format!(
        "Nothing is proven missing, but {missed} of {cuts} cuts came out otherwise than the model foretells.\
         {candidates}"
    )
}

/// What the answer is worth, in one sentence.
pub(super) fn worth(d: &CutDiagnosis) -> String {
    if let Some((finding, gain)) = d.findings.first().and_then(|f| Some((f, f.fit.gain_nats?))) {
        return shown(d, finding, gain);
    }
    match (&d.table, d.findings.is_empty()) {
        (Some(t), false) => foretold(t, d),
        (Some(t), true) if t.heldout_cuts > 0 => format!(
            "Fitted to the other speeds each time, it foretells {} of {} cuts.",
            t.heldout_right_after, t.heldout_cuts
        ),
        _ => String::new(),
    }
}

/// How the answer shows on stretches that no number was fitted to.
fn shown(d: &CutDiagnosis, finding: &CutFinding, gain_nats: f64) -> String {
    let name = spoken(finding.effect.name());
    let more = if gain_nats > 0.0 {
        format!("are more probable by {gain_nats:.0} nats (a factor of e to that power)")
    } else {
        "are no more probable".to_owned()
    };
    let mut out = format!(
        "On stretches that no number was fitted to, the recordings {more} with {name} than without it, all other numbers \
         fitted anew."
    );
    if let Some(off) = d.proof.as_ref().and_then(Off::of) {
        let _ = write!(
            out,
            " Growth of the vibration there is off by {} as stated, by {} with other numbers alone and by {} with the findings; \
             it is measured to {}.",
            engineering(off.growth_1_s.stated, "1/s", 2),
            engineering(off.growth_1_s.refitted, "1/s", 2),
            engineering(off.growth_1_s.answer, "1/s", 2),
            engineering(off.deviation_1_s, "1/s", 2)
        );
    }
    if let Some([stated, answer]) = free_off_db(d) {
        let _ = write!(
            out,
            " Running free, the stated model vibrates {} dB beside the machine, the repaired one {} dB.",
            significant(stated, 2),
            significant(answer, 2)
        );
    }
    out
}

fn foretold(t: &TableFit, d: &CutDiagnosis) -> String {
    let growth = t.growth_off_1_s.map_or(String::new(), |off| {
        format!(
            "Fitted to the other speeds each time, the growth of the vibration is off by {} as stated, {} with other numbers \
             alone and {} with the findings (middle of the cuts). ",
            engineering(off.stated, "1/s", 2),
            engineering(off.refitted, "1/s", 2),
            engineering(off.answer, "1/s", 2)
        )
    });
    if t.heldout_cuts == 0 {
        return format!("{growth}No cut of the table is judged stable or chattering.");
    }
    // The rows of a table are the last cuts of the map.
    let cuts = d.mapped.iter().rev().zip(d.rows.iter().rev());
    let stated = cuts.filter(|(c, row)| c.chatter == Some(row.before.chatter_probability > 0.5)).count();
    let gain = (t.heldout_log_loss_before - t.heldout_log_loss_after) * t.heldout_cuts as f64;
    format!(
        "{growth}Of {} outcomes {stated} are foretold right as stated, {} with other numbers alone and {} with the findings, \
         which makes them {} probable by {:.1} nats.",
        t.heldout_cuts,
        t.heldout_right_before,
        t.heldout_right_after,
        if gain < 0.0 { "less" } else { "more" },
        gain.abs()
    )
}

fn change(c: &Correction) -> String {
    if c.nominal == 0.0 {
        return without_unit(&c.name);
    }
    let share = format!("{:+.1} %", 100.0 * (c.value / c.nominal - 1.0)).replace('-', "\u{2212}");
    format!("{} {share}", number_name(&c.name))
}

/// A number of the scenario as a person calls it.
pub(super) fn number_name(name: &str) -> String {
    match name {
        "radial_stiffness_pa" => "cutting pressure K_r".to_owned(),
        "damping_ratio" => "damping ratio of the bar".to_owned(),
        "clamp_factor" => "clamp factor (natural frequency)".to_owned(),
        "natural_frequency_hz" => "natural frequency".to_owned(),
        "process_damping_n" => "process damping C_i".to_owned(),
        "pitch_difference_rad" => "pitch difference".to_owned(),
        other => without_unit(other),
    }
}

/// Where a port is, for someone who stands before the lathe.
pub(super) fn place(port: Port) -> &'static str {
    match port {
        Port::Workpiece => "at the bar and its support",
        Port::Turret => "at the holder of tool 2",
        Port::Spindle => "in the rotation of the spindle",
        Port::ForceSensor => "in the force signal",
        _ => "between tool and work",
    }
}

/// A finding as one phrase with its numbers.
pub(super) fn phrase(f: &CutFinding) -> String {
    let value = |name: &str| f.parameters.iter().find(|e| e.name == name).map(|e| e.value);
    let n = |name: &str, unit: &str| {
        value(name).map_or_else(|| "an unknown amount".to_owned(), |v| engineering(v, unit, 3))
    };
    let share = |name: &str, neutral: f64| {
        let off = 100.0 * (value(name).unwrap_or(neutral) - neutral);
        format!("{} %", significant(off.abs(), 2))
    };
    let plain = |name: &str| significant(value(name).unwrap_or(0.0), 3);
    let way = |name: &str, up: &'static str, down: &'static str| {
        if value(name).unwrap_or(0.0) < 0.0 { down } else { up }
    };
    match f.effect {
        E::RegenerativeEffect => format!(
            "that each tool cuts the wave which the last pass has left (overlap {})",
            plain("overlap")
        ),
        E::ProcessDamping => {
            format!(
                "that the flank rubs on the wavy surface and damps, {} per unit slope",
                n("process_damping_n", "N")
            )
        }
        E::EdgeForce => format!("a force of the edge of {}, however thin the chip", n("force_n", "N")),
        E::NonlinearCuttingForce => {
            format!("that the force grows with the power {} of the chip thickness", plain("exponent"))
        }
        E::NoseRadius => {
            format!("the round corner of the tool, radius {}: narrow cuts push harder", n("radius_m", "m"))
        }
        E::SpeedDependentForce => format!(
            "that the cutting pressure {} with the speed, exponent {}",
            way("exponent", "falls", "rises"),
            plain("exponent")
        ),
        E::Runout => runout(f, &n),
        E::SecondMode => format!("a second mode of the bar at {}", n("frequency_hz", "Hz")),
        E::SecondPlane => {
            format!("that the bar has another frequency across the tool line, {}", n("frequency_hz", "Hz"))
        }
        E::ModeDrift => format!("that the natural frequency drifts by {} each second", n("hz_per_s", "Hz")),
        E::PositionDependentMode => {
            let per_100_mm = engineering(0.1 * value("hz_per_m").unwrap_or(0.0), "Hz", 3);
            format!("that the natural frequency moves by {per_100_mm} per 100 mm along the bar")
        }
        E::SupportCompliance => format!("a chuck that rocks, {}", n("n_m", "N/m")),
        E::ContactStiffness => format!("a spring of the contact, {} per tool", n("n_m", "N/m")),
        E::SpeedDependentDynamics => {
            let per_1000 = engineering(1e3 * value("hz_per_rpm").unwrap_or(0.0), "Hz", 3);
            format!("that the natural frequency moves by {per_1000} per 1000 rpm")
        }
        E::ToolWear => {
            format!("wear: the cutting pressure grows by {} a second", share("relative_per_s", 0.0))
        }
        E::ToolDifference => format!("that tool 2 cuts {} differently from tool 1", share("ratio", 1.0)),
        E::TurretCompliance => {
            format!("a holder of tool 2 that gives way at {} ({})", n("frequency_hz", "Hz"), n("n_m", "N/m"))
        }
        E::SpindleSpeedVariation => {
            format!("a speed that varies by {} within a turn", share("relative", 0.0))
        }
        E::StockVariation => {
            format!("a sector of the stock that cuts {} differently", share("relative_change", 0.0))
        }
        E::ForceLag => format!("that the force follows the chip {} late", n("time_constant_s", "s")),
        E::ForceSensorLag => {
            format!("that the force signal comes {} later than stated", n("extra_delay_s", "s"))
        }
        other => super::naming::spoken(other.name()),
    }
}

fn runout(f: &CutFinding, n: &dyn Fn(&str, &str) -> String) -> String {
    let order = f.parameters.iter().find(|e| e.name == "order").map_or(1.0, |e| e.value).round();
    let amplitude = n("amplitude_m", "m");
    if order < 0.5 {
        format!("that tool 2 stands {amplitude} ahead of tool 1")
    } else if order < 1.5 {
        format!("that the work runs {amplitude} out of centre")
    } else if order < 2.5 {
        format!("that the stock is oval by {amplitude}")
    } else {
        format!("that the stock is out of round by {amplitude}, {order:.0} times a turn")
    }
}

/// What to do with the answer where no finding says it.
pub(super) fn next_step(d: &CutDiagnosis) -> Option<String> {
    let asked = d.findings.iter().find_map(|f| f.next_experiment.clone());
    let planned = d.plan.first().map(|cut| {
        format!(
            "Cut once more at {:.0} rpm, feed {:.3} mm, width {:.3} mm, {:.0} mm from the chuck, pitch difference \
             {:.3} rad, for {:.0} s: {}.",
            cut.spindle_speed_rpm,
            1e3 * cut.feed_m_rev,
            1e3 * cut.width_m,
            1e3 * cut.tool_position_m,
            cut.pitch_difference_rad,
            cut.duration_s,
            cut.tells
        )
    });
    planned.or(asked).or_else(|| {
        Some(
            match d.verdict {
                Verdict::MissingPhysics | Verdict::ParameterError => {
                    "Take scenario.toml in the place of the scenario, cut at a speed and a width that are not among these, and \
                     diagnose that with it: the answer must be that nothing is missing."
                }
                Verdict::ModelAdequate => {
                    "Nothing now. What these cuts could not have shown is listed below, with the cut that would show it."
                }
                Verdict::UnexplainedMismatch => {
                    "The same cut twice, then at half the speed, and once with a probe on the bar: what differs between the first \
                     two is not of the machine; what stays at its frequency is of the structure, what follows the speed is of the cut."
                }
            }
            .to_owned(),
        )
    })
}
