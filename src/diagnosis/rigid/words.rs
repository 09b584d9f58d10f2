//! What a finding of one position is called: a sentence, the law in symbols, the experiment that would tell.

use super::laws::Law;
use crate::plant::effects::EffectKind;

/// One sentence for a person and the law in symbols.
pub(super) fn words(law: Law, value: &dyn Fn(&str) -> f64) -> (String, &'static str) {
    let n = |name: &str, unit: &str| spelled(value(name), unit);
    match law {
        Law::Inertia | Law::Viscous => {
            (format!("A force of {} acts against the motion.", n("n_s_m", "N per m/s")), "F = C v")
        }
        Law::Constant => (
            format!(
                "A force of {} acts whatever the motion: weight, or an offset of the drive.",
                n("force_n", "N")
            ),
            "F = F_0",
        ),
        Law::Friction(s) if s.gap_m > 0.0 => (
            format!(
                "At each reversal {} pass before force builds up again: play in what transmits it.",
                n("gap_m", "m")
            ),
            "F = F_c dz(D, gap/2)/yield, D = clamp(D + dx, +-(gap/2 + yield))",
        ),
        Law::Friction(s) if s.yield_m > 0.0 => (
            format!(
                "Friction of {} turns over with the distance after a reversal, not with the speed: a \
                 stiffness of {}.",
                n("force_n", "N"),
                n("presliding_stiffness_n_m", "N/m")
            ),
            if s.gradual {
                "F = F_c z, dz = (sgn dx - z) |dx|/yield, stiffness = F_c/yield"
            } else {
                "F = F_c D/yield, D = clamp(D + dx, +-yield), stiffness = F_c/yield"
            },
        ),
        Law::Friction(_) => (
            format!("A force of {} acts against the direction of motion.", n("force_n", "N")),
            "F = F_c sgn v",
        ),
        Law::DirectionalDry(_) => (
            format!("Friction differs by {} between the directions.", n("force_difference_n", "N")),
            "F = (F_difference/2) |sgn v|",
        ),
        Law::DirectionalViscous => (
            format!(
                "Viscous friction differs by {} between the directions, {} at the mean speed.",
                n("viscous_difference_n_s_m", "N s/m"),
                n("force_difference_n", "N")
            ),
            "F = (C_difference/2) |v|",
        ),
        Law::Square => {
            (format!("A force of {} acts against the motion.", n("n_s2_m2", "N per (m/s)^2")), "F = c v |v|")
        }
        Law::Stribeck { .. } => (
            format!(
                "At creep speeds friction is {} higher; it falls off over {}.",
                n("stribeck_force_n", "N"),
                n("stribeck_velocity_m_s", "m/s")
            ),
            "F = F_s exp(-(v/v_s)^2) sgn v",
        ),
        Law::Drift { .. } => (
            format!(
                "Friction changes by {} of itself with a time constant of {}.",
                n("relative_change", ""),
                n("time_constant_s", "s")
            ),
            "F = F_c change (1 - exp(-t/tau)) sgn v",
        ),
        Law::Wave { .. } => (
            format!("A force of {} repeats every {}.", n("amplitude_n", "N"), n("wavelength_m", "m")),
            "F = A sin(2 pi x/lambda + phase)",
        ),
        Law::Map { .. } => (
            format!("A force of up to {} hangs on the place.", n("amplitude_n", "N")),
            "F = F(x), cubic between knots",
        ),
        Law::Cut { .. } => (
            format!(
                "A force of {} at {} Hz acts from {} s to {} s: a cut.",
                n("amplitude_n", "N"),
                n("fundamental_hz", ""),
                n("start_s", ""),
                n("end_s", "")
            ),
            "F = F_0 + sum A_k sin(2 pi k f t + phase_k) while it lasts",
        ),
        Law::Late { .. } => (
            format!("The drive acts {} later than the model says.", n("extra_delay_s", "s")),
            "F(t) -> F(t - T)",
        ),
        Law::Slow { .. } => (
            format!("The current loop is slower than stated: {}.", n("bandwidth_rad_s", "rad/s")),
            "F(s) -> F(s) w/(s + w)",
        ),
        Law::Interpolation { .. } => (
            format!(
                "The motor encoder errs by {} with a period of {} of travel.",
                n("amplitude_m", "m"),
                n("signal_period_m", "m")
            ),
            "x -> x + A sin(2 pi x/p + phase)",
        ),
        Law::Saturation => (
            format!("Torque falls behind large currents by {}.", n("per_a2", "per A2")),
            "T = K_t i (1 - b i^2)",
        ),
        Law::Spring { .. } => (
            format!(
                "The drive turns {} (rad where one metre is one radian) before the output pushes back.",
                n("gap_m", "m")
            ),
            "F = K dz(x - x_0, gap/2)",
        ),
        Law::Cubic { .. } => ("The stiffness changes with the load.".to_owned(), "F = K_3 (x - x_0)^3"),
    }
}

/// Four significant digits with the prefix of a shop floor: `4.929 mm`, `10.41 kN`.
fn spelled(value: f64, unit: &str) -> String {
    const PREFIXES: [(f64, &str); 6] =
        [(1.0e6, "M"), (1.0e3, "k"), (1.0, ""), (1.0e-3, "m"), (1.0e-6, "u"), (1.0e-9, "n")];
    let scaled = matches!(unit, "N" | "m" | "m/s" | "N/m");
    let fitting = PREFIXES.iter().find(|(p, _)| value.abs() >= 0.99995 * p);
    let large_length = unit.starts_with('m') && value.abs() >= 1.0;
    let (scale, prefix) =
        if scaled && !large_length { fitting.copied().unwrap_or((1.0, "")) } else { (1.0, "") };
    let x = value / scale;
    let order = if x == 0.0 { 0 } else { x.abs().log10().floor() as i32 };
    if !(-5..7).contains(&order) {
        return format!("{x:.3e} {prefix}{unit}");
    }
    format!("{x:.*} {prefix}{unit}", (3 - order).max(0) as usize).trim_end().to_owned()
}

/// What tells the alternatives of an effect apart.
pub(super) fn next(effect: EffectKind) -> &'static str {
    match effect {
        EffectKind::GravityLoad | EffectKind::AsymmetricFriction => {
            "Rest for a second at several places with the drive on, between slow strokes in both directions: \
             a weight holds at rest, a difference of friction does not."
        }
        EffectKind::CoulombFriction | EffectKind::PreslidingFriction | EffectKind::Backlash => {
            "Reversals of 10 um to 1 mm at less than 1 mm/s, both under load from one side and from the \
             other."
        }
        EffectKind::ViscousFriction | EffectKind::NonlinearViscosity | EffectKind::StribeckFriction => {
            "Strokes at constant speed, at least six speeds from creep to traverse, both directions, same \
             path."
        }
        EffectKind::DeadTime | EffectKind::CurrentLoopLag => {
            "A sweep of the reference up to a third of the sampling rate: a delay and a lag part there."
        }
        EffectKind::CuttingForce => "The same motion without the tool in the work.",
        EffectKind::FrictionDrift => {
            "The same stroke once a minute from cold until nothing changes any more."
        }
        _ => "The same path at two speeds and in both directions.",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_person_reads_millimetres_and_kilonewtons() {
        assert_eq!(spelled(0.004_929, "m"), "4.929 mm");
        assert_eq!(spelled(10_412.0, "N"), "10.41 kN");
        assert_eq!(spelled(-78.72, "N s/m"), "-78.72 N s/m");
        assert_eq!(spelled(0.0, "N"), "0.000 N");
    }
}
