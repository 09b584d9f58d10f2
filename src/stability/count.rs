//! How many roots lie right of a line: the argument principle, independent of the search for roots.

use crate::keyframe::keep;
use crate::plant::cut_loop::{CutLoop, Resonance};
use crate::plant::cutting::TwoDelay;
use nalgebra::Complex;

/// How far a curve has turned round zero.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Turn {
    last: Option<Complex<f64>>,
    pub(super) rad: f64,
}

keep!(Turn { last, rad });

impl Turn {
    /// Angle from its last point to another one, less than half a turn away.
    fn angle_to(&self, point: Complex<f64>) -> f64 {
        self.last.map_or(0.0, |last| (point * last.conj()).arg())
    }

    /// On to its next point.
    pub(super) fn to(&mut self, point: Complex<f64>) {
        self.rad += self.angle_to(point);
        self.last = Some(point);
    }
}

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
    zeros_right(ratio, far, (0.2 / longest_s.max(1e-9)).min(scale / 50.0))
}

/// The same for the whole cut: roots of Delta with a real part above `growth_1_s`.
///
/// Delta times the denominators of its resonances over (s - sigma + w_r)^2 each tends to one.
/// Requires: no lag whose pole lies right of the line. Checked by: `counts_of_the_plain_cut`.
#[must_use]
pub fn cut_roots_right_of(cut: &CutLoop, growth_1_s: f64) -> usize {
    let resonances: Vec<_> = cut.resonances().collect();
    let lowest = resonances.iter().map(|r| r.rad_s).fold(f64::INFINITY, f64::min);
    let highest = resonances.iter().map(|r| r.rad_s).fold(0.0, f64::max);
    let ratio = |w: f64| {
        let s = Complex::new(growth_1_s, w);
        let over = |r: &Resonance| r.denominator(s) / Complex::new(r.rad_s, w).powi(2);
        cut.delta(s) * resonances.iter().map(over).product::<Complex<f64>>()
    };
    let longest_s = cut.delays_s[0].max(cut.delays_s[1]);
    let gain: f64 = resonances.iter().map(|r| r.gain_1_kg.abs()).sum();
    let cutting = cut.slope_n_m[0] + cut.slope_n_m[1] + cut.contact_n_m;
    let delayed = 2.0 * gain * cutting * (-growth_1_s * longest_s).exp().max(1.0).powi(2);
    let far = (100.0 * delayed).sqrt().max(20.0 * highest);
    zeros_right(ratio, far, (0.2 / longest_s.max(1e-9)).min(lowest / 50.0))
}

/// Half the turns of a ratio of equal degrees along the line, from 0 to where it is nearly one.
fn zeros_right(ratio: impl Fn(f64) -> Complex<f64>, far: f64, widest: f64) -> usize {
    let (mut w, mut turn) = (0.0, Turn::default());
    turn.to(ratio(0.0));
    let mut step = widest;
    while w < far {
        let next = ratio(w + step);
        if turn.angle_to(next).abs() > 0.3 && step > 1e-9 * widest {
            step *= 0.5;
            continue;
        }
        turn.to(next);
        w += step;
        step = (step * 1.5).min(widest);
    }
    // What is left to infinity, where the ratio is one.
    turn.to(Complex::new(1.0, 0.0));
    let count = (-turn.rad / std::f64::consts::PI).round();
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
    if count > 0.0 { count as usize } else { 0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::cut_terms::{CutCondition, CutTerms};
    use crate::plant::scenario::Scenario;

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

    #[test]
    fn counts_of_the_plain_cut() {
        let scenario = Scenario::default();
        let cut = CutLoop::new(&CutTerms::of(&scenario, &CutCondition::of(&scenario)));
        let plain = TwoDelay::from_scenario(&scenario);
        for line in [-60.0, -20.0, 0.0, 30.0, 35.0, 36.0] {
            assert_eq!(cut_roots_right_of(&cut, line), roots_right_of(&plain, line), "{line}");
        }
    }
}
