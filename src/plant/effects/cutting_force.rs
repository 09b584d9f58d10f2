//! A cut while the recording was taken for idle.

use super::{EffectKind, Parameter, Specification, Spoken};

/// Lines of the force stand at its multiples.
pub const FUNDAMENTAL: Parameter = Parameter::constant("fundamental_hz", "Hz", [0.1, 1e4]);
/// Largest force over a period.
pub const PEAK: Parameter = Parameter::size("amplitude_n", "N").spoken(Spoken::As("peak"));
/// When it begins.
pub const START: Parameter = Parameter::further("start_s", "s");
/// When it ends.
pub const END: Parameter = Parameter::further("end_s", "s");
/// How many there are.
pub const HARMONICS: Parameter = Parameter::further("harmonics", "1");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    equation: "F = F_0 + sum_h A_h sin(2 pi h f t + phase_h) from start to end",
    phrase: |_| "a cutting force of up to {amplitude_n} at {fundamental_hz}, from {start_s} to {end_s}",
    ..Specification::new(EffectKind::CuttingForce, &[PEAK, FUNDAMENTAL, START, END, HARMONICS])
};
