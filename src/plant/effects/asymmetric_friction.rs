//! Friction that differs between the directions.

use super::coulomb_friction::sliding_direction;
use super::gravity_load::AT_REST;
use super::{EffectKind, ForceLaw, Parameter, Specification};

/// Difference of the dry friction.
pub const DRY: Parameter = Parameter::size("force_difference_n", "N");
/// Difference of the viscous friction.
pub const VISCOUS: Parameter = Parameter::size("viscous_difference_n_s_m", "N s/m");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    force: Some(|term, _| {
        let viscous_n_s_m = term.value(&VISCOUS).unwrap_or(0.0);
        Some(ForceLaw::Asymmetric { difference_n: term.value(&DRY)?, viscous_n_s_m })
    }),
    domain: "direction",
    equation: "F = (d / 2) |tanh(v / v_s)|",
    phrase: |_| "friction that differs by {force_difference_n} between the directions",
    mistaken_for: &[EffectKind::GravityLoad],
    told_apart_by: AT_REST,
    ..Specification::new(EffectKind::AsymmetricFriction, &[DRY, VISCOUS])
};

/// Asymmetry per newton of difference between the directions: |tanh(v / v_s)| / 2.
///
/// Friction is F + d/2 forward and F - d/2 backward: the difference adds the same force in both directions,
/// and none at rest (where gravity stays).
#[must_use]
pub fn asymmetric(velocity_m_s: f64, smoothing_m_s: f64) -> f64 {
    0.5 * sliding_direction(velocity_m_s, smoothing_m_s).abs()
}
