//! How many roots lie right of a line: the argument principle, independent of the search for roots.

use crate::plant::cutting::TwoDelay;
use nalgebra::Complex;

/// Number of roots of the two-delay equation with a real part above `growth_1_s`.
///
/// N = -(1/pi) * change of arg F(sigma + j w)/(s - sigma + a)^2 over w from 0 to infinity
///
/// F over a polynomial of the same degree with both zeros left of the line tends to a constant: the line and
/// the great arc enclose all roots to its right. Roots come in pairs; a real one counts once.
/// Requires: no root on the line. Cost: some 10^3 evaluations. Checked by: `counts_of_known_polynomials`.
#[must_use]
pub fn roots_right_of(equation: &TwoDelay, growth_1_s: f64) -> usize {
    let scale = (equation.stiffness_n_m / equation.mass_kg).sqrt();
    let ratio = |w: f64| {
        let s = Complex::new(growth_1_s, w);
        let reference = Complex::new(scale, w);
        equation.characteristic(s) / (reference * reference * equation.mass_kg)
    };
    let longest_s = equation.delay_1_s.max(equation.delay_2_s);
    let delayed = 2.0 * equation.cutting_stiffness_n_m * (-growth_1_s * longest_s).exp().max(1.0);
    // Beyond this the delayed terms are less than a hundredth of the inertia.
    let far = (100.0 * delayed / equation.mass_kg).sqrt().max(20.0 * scale);
    let widest = (0.2 / longest_s.max(1e-9)).min(scale / 50.0);
    let (mut w, mut turned) = (0.0, 0.0);
    let mut now = ratio(0.0);
    let mut step = widest;
    while w < far {
        let next = ratio(w + step);
        let angle = (next / now).arg();
        if angle.abs() > 0.3 && step > 1e-9 * scale {
            step *= 0.5;
            continue;
        }
        turned += angle;
        w += step;
        now = next;
        step = (step * 1.5).min(widest);
    }
    // What is left to infinity, where the ratio is one.
    turned -= now.arg();
    let count = (-turned / std::f64::consts::PI).round();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    if count > 0.0 { count as usize } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_of_known_polynomials() {
        // Without a cut: a pair at -1 +- 10j, or two real roots at -2 and -50.
        let pair = TwoDelay {
            mass_kg: 1.0,
            damping_n_s_m: 2.0,
            stiffness_n_m: 101.0,
            cutting_stiffness_n_m: 0.0,
            delay_1_s: 0.01,
            delay_2_s: 0.02,
        };
        assert_eq!([-2.0, -0.9, 0.0].map(|x| roots_right_of(&pair, x)), [2, 0, 0]);
        let real = TwoDelay { damping_n_s_m: 52.0, stiffness_n_m: 100.0, ..pair };
        assert_eq!([-60.0, -10.0, -1.0].map(|x| roots_right_of(&real, x)), [2, 1, 0]);
    }
}
