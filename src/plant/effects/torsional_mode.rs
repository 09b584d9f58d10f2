//! A third inertia: motor and screw twist against each other.

use super::{EffectKind, Parameter, PhysicsTerm, Port, Specification};

/// Of motor and screw without the rest.
pub const FREQUENCY: Parameter = Parameter::constant("free_free_frequency_hz", "Hz", [50.0, 20_000.0]);
/// Part of the rotary inertia that is the screw's.
pub const SHARE: Parameter = Parameter::constant("screw_inertia_share", "1", [0.05, 0.95]).usual(0.5);
/// Of the spring between them, by the screw's inertia.
pub const DAMPING: Parameter = Parameter::constant("damping_ratio", "1", [1e-3, 0.5]).usual(0.02);

/// What tells effects of the frequency apart.
pub(super) const SWEEP: &str = "a sweep up to twice the axial resonance at two amplitudes";

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "frequency",
    equation: "J_s e'' + c e' + (k + K) e = -J_s a_m - K D",
    phrase: |_| "that the motor and the screw's far end twist against each other at {free_free_frequency_hz}",
    mistaken_for: &[EffectKind::DeadTime, EffectKind::CurrentLoopLag],
    told_apart_by: SWEEP,
    ..Specification::new(EffectKind::TorsionalMode, &[FREQUENCY, SHARE, DAMPING])
};

/// The mode as a term of a model: frequency in Hz, share of the screw's inertia, damping ratio.
#[must_use]
pub fn term([frequency_hz, share, damping]: [f64; 3]) -> PhysicsTerm {
    let numbers = [(&FREQUENCY, frequency_hz), (&SHARE, share), (&DAMPING, damping)];
    PhysicsTerm::new(EffectKind::TorsionalMode, Port::Coupling, &numbers)
}

/// Stiffness between motor and screw by their free-free frequency, N/m: w^2 = k (1/M_m + 1/M_s).
#[must_use]
pub fn stiffness_of(free_free_frequency_hz: f64, motor_mass_kg: f64, screw_mass_kg: f64) -> f64 {
    let w = std::f64::consts::TAU * free_free_frequency_hz;
    w * w * motor_mass_kg * screw_mass_kg / (motor_mass_kg + screw_mass_kg)
}
