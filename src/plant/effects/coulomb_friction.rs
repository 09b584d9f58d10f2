//! Force of constant size against the motion. Every friction opposes the motion (positive along it).

use super::{EffectKind, ForceLaw, Parameter, Port, Specification};

/// Size.
pub const FORCE: Parameter = Parameter::size("force_n", "N");
/// Speed over which it turns, where that is another than stated.
pub const SMOOTHING: Parameter = Parameter::constant("friction_smoothing_m_s", "m/s", [1e-8, 1e3]);

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(|term, _| Some(ForceLaw::Coulomb { force_n: term.value(&FORCE)? })),
    key: Some(|term, raw| {
        let force_n = term.value(&FORCE)?;
        let key = match term.port {
            Port::Motor => &mut raw.motor_coulomb_friction_n,
            _ => &mut raw.stage_coulomb_friction_n,
        };
        *key = Some((key.unwrap_or(0.0) + force_n).max(0.0));
        Some(())
    }),
    domain: "velocity",
    equation: "F = F_c tanh(v / v_s)",
    phrase: |_| "dry friction of {force_n}",
    ..Specification::new(EffectKind::CoulombFriction, &[FORCE, SMOOTHING])
};

/// Direction of sliding, tanh(v / v_s): Coulomb friction per newton. v_s: smoothing speed in m/s.
#[must_use]
pub fn sliding_direction(velocity_m_s: f64, smoothing_m_s: f64) -> f64 {
    (velocity_m_s / smoothing_m_s).tanh()
}
