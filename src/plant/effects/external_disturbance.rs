//! A force with no known law.

use super::{EffectKind, Parameter, Specification};

/// Root mean square of what a model states to leave.
pub const RMS: Parameter = Parameter::further("force_rms_n", "N");
/// Up to which frequency.
pub const UP_TO: Parameter = Parameter::further("up_to_hz", "Hz");
/// Of a line of the mains in a recorded force.
pub const FREQUENCY: Parameter = Parameter::further("frequency_hz", "Hz");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    equation: "a force with no known law",
    phrase: |_| "external disturbance",
    ..Specification::new(EffectKind::ExternalDisturbance, &[RMS, UP_TO, FREQUENCY])
};
