//! What the estimate takes off for friction.
//!
//! At the motor: F tanh(v/v_s), the law of the model file. At the stage: the same size, but turned by
//! travel instead of velocity (Dahl), because a guideway that vibrates in place by less than a
//! micrometre sticks: its friction is a spring, and sign(v) would subtract a square wave that is not
//! there. In motion both laws are one. Over which travel is stated by the model, or
//! learned: [`super::guideway`].

use crate::signal::dispatch::multiply_add;

/// Friction that turns over a stretch of travel (Dahl 1968).
///
/// dz/dx = (1 - sign(dx) z) / delta, friction = F z; exact for each straight step with
/// exp(-u) = 1/(1 + u + u^2/2 + ...). Moves smaller than the encoder's step are noise and are not followed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Presliding {
    pub(super) per_travel_1_m: f64,
    pub(super) play_m: f64,
}

/// State of [`Presliding`].
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PreslidingState {
    pub(super) position_m: f64,
    /// Friction over its full size, -1 to 1.
    pub(super) share: f64,
}

crate::keyframe::keep!(PreslidingState { position_m, share });

impl Presliding {
    /// Friction that turns over `travel_m`, on an encoder of step `step_m`.
    #[must_use]
    pub fn new(travel_m: f64, step_m: f64) -> Self {
        Self { per_travel_1_m: 1.0 / travel_m.max(1e-9), play_m: step_m }
    }

    /// At rest, no friction stored.
    #[must_use]
    pub fn settled(position_m: f64) -> PreslidingState {
        PreslidingState { position_m, share: 0.0 }
    }

    /// The state at a new position. Cost: one division.
    #[inline(always)]
    #[must_use]
    pub fn step<const FUSED: bool>(&self, state: PreslidingState, position_m: f64) -> PreslidingState {
        let moved = position_m - state.position_m;
        let beyond = (moved.abs() - self.play_m).max(0.0);
        let u = beyond * self.per_travel_1_m;
        let keep = 1.0 / (1.0 + u * (1.0 + 0.5 * u * (1.0 + u * (1.0 / 3.0))));
        let direction = moved.signum();
        PreslidingState {
            position_m: multiply_add::<FUSED>(direction, beyond, state.position_m),
            share: multiply_add::<FUSED>(state.share - direction, keep, direction),
        }
    }
}

/// tanh by a rational function of degree 13 over 6, within 4e-7: no branch, no call.
///
/// Coefficients: the single-precision minimax of the Eigen library (MathFunctionsImpl.h).
/// Checked by: rational_tanh_is_close.
#[inline(always)]
#[must_use]
pub fn rational_tanh<const FUSED: bool>(x: f64) -> f64 {
    const NUMERATOR: [f64; 7] = [
        -2.760_768_477_423_55e-16,
        2.000_187_904_824_77e-13,
        -8.604_671_522_137_35e-11,
        5.122_297_090_371_14e-8,
        1.485_722_357_179_79e-5,
        6.372_619_288_754_36e-4,
        4.893_524_558_917_86e-3,
    ];
    const DENOMINATOR: [f64; 4] =
        [1.198_258_394_667_02e-6, 1.185_347_056_866_54e-4, 2.268_434_632_439_00e-3, 4.893_525_185_543_85e-3];
    let x = x.clamp(-7.905_311, 7.905_311);
    let x2 = x * x;
    let mut p = NUMERATOR[0];
    for c in &NUMERATOR[1..] {
        p = multiply_add::<FUSED>(p, x2, *c);
    }
    let mut q = DENOMINATOR[0];
    for c in &DENOMINATOR[1..] {
        q = multiply_add::<FUSED>(q, x2, *c);
    }
    x * p / q
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rational_tanh_is_close() {
        for i in -2000..=2000 {
            let x = f64::from(i) * 0.01;
            assert!((rational_tanh::<false>(x) - x.tanh()).abs() < 1e-6, "{x}");
        }
    }

    #[test]
    fn a_long_move_gives_full_friction_and_a_small_swing_almost_none() {
        let law = Presliding::new(3e-6, 1e-9);
        let mut state = Presliding::settled(0.0);
        (1..=1000).for_each(|i| state = law.step::<false>(state, 1e-7 * f64::from(i)));
        assert!((state.share - 1.0).abs() < 1e-3);
        state = Presliding::settled(0.0);
        for i in 0..2000 {
            state = law.step::<false>(state, 50e-9 * (0.4 * f64::from(i)).sin());
            assert!(state.share.abs() < 0.02, "{}", state.share);
        }
    }
}
