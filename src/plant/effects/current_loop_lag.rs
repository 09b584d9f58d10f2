//! Finite bandwidth of the current loop.

use super::torsional_mode::SWEEP;
use super::{EffectKind, Parameter, Specification};

/// Of a lag of first order. A drive closes its current loop within some milliseconds: what is slower is an
/// axis.
pub const BANDWIDTH: Parameter = Parameter::constant("bandwidth_rad_s", "rad/s", [100.0, 1e6]);

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    key: Some(|term, raw| {
        raw.current_loop_bandwidth_rad_s = Some(term.value(&BANDWIDTH)?);
        Some(())
    }),
    domain: "frequency",
    equation: "i' = w (i_ref - i)",
    phrase: |_| "that the current loop is slower than stated, {bandwidth_rad_s}",
    mistaken_for: &[EffectKind::DeadTime, EffectKind::TorsionalMode],
    told_apart_by: SWEEP,
    ..Specification::new(EffectKind::CurrentLoopLag, &[BANDWIDTH])
};
