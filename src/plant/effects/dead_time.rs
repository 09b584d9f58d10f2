//! Additional delay.

use super::torsional_mode::SWEEP;
use super::{EffectKind, Parameter, Port, Specification};

/// How much later than stated.
pub const EXTRA: Parameter = Parameter::constant("extra_delay_s", "s", [1e-7, 0.1]);

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    key: Some(|term, raw| {
        let extra_s = term.value(&EXTRA)?;
        let key = match term.port {
            Port::MotorEncoder => &mut raw.motor_encoder_delay_s,
            Port::StageEncoder => &mut raw.stage_encoder_delay_s,
            _ => &mut raw.amplifier_dead_time_s,
        };
        *key = Some((key.unwrap_or(0.0) + extra_s).max(0.0));
        Some(())
    }),
    domain: "frequency",
    equation: "signal(t) -> signal(t - T)",
    phrase: |port| match port {
        Port::Current => "that the drive acts {extra_delay_s} later than stated",
        _ => "that the {port} answers {extra_delay_s} later than stated",
    },
    mistaken_for: &[EffectKind::CurrentLoopLag, EffectKind::TorsionalMode],
    told_apart_by: SWEEP,
    ..Specification::new(EffectKind::DeadTime, &[EXTRA])
};
