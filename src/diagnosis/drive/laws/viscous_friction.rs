//! A number of the structure.

use super::*;
use crate::plant::effects::Port;
use crate::plant::effects::viscous_friction::{COEFFICIENT, SPECIFICATION};
use std::f64::consts::TAU;

pub(super) const EFFECT: Effect = Effect {
    key: |found, _, raw| {
        let n_s_m = found.value(&COEFFICIENT);
        let r2 = raw.screw_lead_m.map_or(1.0, |lead_m| (lead_m / TAU).powi(2));
        match found.port {
            Port::Motor => raw.rotary_damping_nm_s_rad = n_s_m.map(|c| c * r2),
            _ => raw.translational_damping_n_s_m = n_s_m,
        }
        true
    },
    ..Effect::of(&SPECIFICATION)
};
