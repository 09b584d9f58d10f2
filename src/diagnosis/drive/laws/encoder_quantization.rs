//! Read off the recordings before any balance.

use super::*;
use crate::plant::effects::Port;
use crate::plant::effects::encoder_quantization::{SPECIFICATION, STEP};

pub(super) const EFFECT: Effect = Effect {
    key: |found, _, raw| {
        match found.port {
            Port::MotorEncoder => raw.motor_encoder_resolution_m = found.value(&STEP),
            _ => raw.stage_encoder_resolution_m = found.value(&STEP),
        }
        true
    },
    ..Effect::of(&SPECIFICATION)
};
