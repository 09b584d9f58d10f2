//! Force proportional to speed.

use super::stribeck_friction::SPEEDS;
use super::{EffectKind, ForceLaw, Parameter, Port, Specification};
use std::f64::consts::TAU;

/// Size.
pub const COEFFICIENT: Parameter = Parameter::size("n_s_m", "N s/m");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(|term, _| Some(ForceLaw::Viscous { n_s_m: term.value(&COEFFICIENT)? })),
    key: Some(|term, raw| {
        let n_s_m = term.value(&COEFFICIENT)?;
        let r2 = raw.screw_lead_m.map_or(1.0, |l| (l / TAU).powi(2));
        let (key, extra) = match term.port {
            Port::Motor => (&mut raw.rotary_damping_nm_s_rad, n_s_m * r2),
            _ => (&mut raw.translational_damping_n_s_m, n_s_m),
        };
        *key = Some((key.unwrap_or(0.0) + extra).max(0.0));
        Some(())
    }),
    domain: "velocity",
    equation: "F = C v",
    phrase: |_| "friction that grows with the speed, {n_s_m}",
    mistaken_for: &[EffectKind::StribeckFriction, EffectKind::NonlinearViscosity],
    told_apart_by: SPEEDS,
    ..Specification::new(EffectKind::ViscousFriction, &[COEFFICIENT])
};
