//! Steps of an encoder.

use super::{EffectKind, Parameter, Specification};

/// Of the position.
pub const STEP: Parameter = Parameter::further("step_m", "m");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    equation: "x_read = step round(x / step)",
    phrase: |_| "that the {port} counts in steps of {step_m}",
    ..Specification::new(EffectKind::EncoderQuantization, &[STEP])
};
