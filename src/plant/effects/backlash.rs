//! Dead zone in the coupling.

use super::presliding_friction::REVERSALS;
use super::{EffectKind, Parameter, Specification};

/// Way between the flanks.
pub const GAP: Parameter = Parameter::constant("gap_m", "m", [1e-9, 1.0]);
/// Of a stage that is held: from the least stretch to the lower flank.
pub const FLANK: Parameter = Parameter::constant("flank_m", "m", [1e-9, 1.0]);
/// Not zero: the gap takes the damper as well.
pub const LOOSE: Parameter = Parameter::further("loose_damper", "1");
/// Of a slider behind the play: what it holds, and the spring before it.
pub const FORCE: Parameter = Parameter::size("force_n", "N");
/// See [`FORCE`].
pub const STIFFNESS: Parameter = Parameter::further("stiffness_n_m", "N/m");

/// The effect.
pub const SPECIFICATION: Specification = Specification {
    domain: "history",
    equation: "S = K (D - clamp(D, -gap/2, gap/2)), at most the friction behind it",
    phrase: |_| "{gap_m} of play between motor and stage",
    mistaken_for: &[EffectKind::PreslidingFriction],
    told_apart_by: REVERSALS,
    ..Specification::new(EffectKind::Backlash, &[GAP, FORCE, STIFFNESS, FLANK, LOOSE])
};

/// Stretch that a backlash of `gap_m` leaves to the spring: D - clamp(D, -gap/2, gap/2).
#[must_use]
pub fn after_backlash(stretch_m: f64, gap_m: f64) -> f64 {
    stretch_m - stretch_m.clamp(-0.5 * gap_m, 0.5 * gap_m)
}

/// Force of a slider of unit friction behind a spring with play: the way between axis and slider is lost in
/// the gap, then in the spring, then the slider gives.
#[must_use]
pub fn play(x: &[f64], gap_m: f64, yield_m: f64) -> Vec<f64> {
    let most = 0.5 * gap_m + yield_m;
    let (mut between, mut last) = (0.0_f64, x.first().copied().unwrap_or(0.0));
    let mut of = |x: &f64| {
        between = (between + x - last).clamp(-most, most);
        last = *x;
        after_backlash(between, gap_m) / yield_m
    };
    x.iter().map(&mut of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_takes_the_first_stretch() {
        assert!((after_backlash(0.4e-6, 1e-6)).abs() < 1e-20);
        assert!((after_backlash(-1.5e-6, 1e-6) + 1.0e-6).abs() < 1e-18);
    }
}
