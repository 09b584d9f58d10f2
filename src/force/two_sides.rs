//! What an axis itself tells of dynamics that its model leaves out: the coupling's force is known twice.
//!
//! ```text
//!  a = u - M_r a_m - C_r v_m - friction         from the motor side
//!  b = K_r (x_m - x_t) + C_k (v_m - v_t)        from the stretch of the screw
//!  R = a - k b,  k: stiffness over the model's, learned below a fifth of the resonance
//!  medob = a - stage,  k b - stage from the stretch,  vibration mode = (1 + alpha) k b - alpha a - stage
//! ```
//! A mode of the motor side that the model lacks (a screw that winds up), a current loop or a dead time that
//! is not what the model says, make a wrong by R: `medob`, `rigid_mode` and `fitted` err by R, the vibration
//! mode by (1 + alpha)(1 - k) b - alpha R, without its first part where it uses k (alpha = M_t / M_r). Near
//! the axial resonance the coupling carries many times the cutting force, so a small error of the motor side
//! is a large one of the estimate. A stiffness that is merely another one is k and no error. Where nothing
//! below a fifth of the resonance tells k, the k in 0.8 to 1.25 that leaves least of R is taken: what is left
//! then is there at any stiffness.
//!
//! All of it is looked at once in a few samples, see [`super::thinned`].
//!
//! Said is the R that steps of the encoders and idle runs do not explain, over the force from the stretch,
//! all between 5 Hz and the low-pass, with a memory of 2 s. Not seen: a mode of the stage's side (both a and
//! b are right then, and the estimate is the force at the scale), anything on one encoder.
//! Checked by: force_flags::a_mode_of_the_motor_side_is_flagged_where_it_carries_force.

use super::alignment::Alignment;
use super::balance::{ForceBalance, Method};
use super::band::TOLERATED;
use super::idle_map::IdleMap;
use super::settings::{Filter, ForceError, ForceSettings};
use super::signals::AxisSignals;
use super::stiffness_learner::{BELIEVED, LEAST_S, MEMORY_S, StiffnessLearner};
use super::thinned::HIGH_PASS_HZ;
use crate::plant::drive::Structure;

/// R below this many times what encoder steps make of it says nothing.
const LEAST_NOISE: f64 = 2.0;

/// What both sides of an axis say of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mismatch {
    /// Part of the estimate's deviation that the motor side's contradiction makes, N rms.
    pub error_n: f64,
    /// Deviation of the force from the stretch, N rms.
    pub force_n: f64,
}

impl Mismatch {
    /// Expected error as a share of the force.
    #[must_use]
    pub fn share(self) -> f64 {
        if self.force_n > 0.0 { self.error_n / self.force_n } else { 0.0 }
    }

    /// Whether the estimate is wrong by more than a tenth of the force.
    #[must_use]
    pub fn is_large(self) -> bool {
        self.share() > TOLERATED
    }
}

/// Design; immutable.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TwoSides {
    /// Share of R in the estimate, and of the stretch's force that the model's stiffness gets wrong.
    into_estimate: [f64; 2],
    /// The estimate has another lag than the two sides (a window).
    apart: bool,
    /// Mean squares of R that encoder steps and idle runs explain, N^2.
    noise_n2: f64,
    idle_n2: f64,
    forget: f64,
    least_weight: f64,
}

/// Mean products of a, b and the estimate F.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Products {
    aa: f64,
    ab: f64,
    bb: f64,
    fa: f64,
    fb: f64,
    ff: f64,
    weight: f64,
}

/// What has been seen; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct SeenSides {
    mean: Products,
    large: bool,
}

crate::keyframe::keep!(Products { aa, ab, bb, fa, fb, ff, weight });
crate::keyframe::keep!(SeenSides { mean, large });

impl SeenSides {
    /// Whether the estimate was wrong by more than a tenth of the force when it was last judged.
    #[inline]
    pub(super) fn is_large(&self) -> bool {
        self.large
    }
}

impl TwoSides {
    /// One instant of those that are looked at: both sides and the estimate between 5 Hz and the low-pass,
    /// N; the stiffness over the model's where it has been learned.
    #[inline]
    pub(super) fn step(&self, state: &mut SeenSides, [a, b, f]: [f64; 3], known: Option<f64>) {
        let now = [a * a, a * b, b * b, f * a, f * b, f * f, 1.0];
        let Products { aa, ab, bb, fa, fb, ff, weight } = &mut state.mean;
        for (old, new) in [aa, ab, bb, fa, fb, ff, weight].into_iter().zip(now) {
            *old = self.forget * *old + new;
        }
        state.large = self.mismatch(state, known).is_some_and(Mismatch::is_large);
    }

    /// What is seen now; `known`: the stiffness over the model's where it has been learned. `None` before
    /// half a second.
    pub(super) fn mismatch(&self, state: &SeenSides, known: Option<f64>) -> Option<Mismatch> {
        let m = &state.mean;
        if m.weight < self.least_weight {
            return None;
        }
        let fitted = if m.bb > 0.0 { m.ab / m.bb } else { 1.0 };
        let k = known.unwrap_or(fitted).clamp(*BELIEVED.start(), *BELIEVED.end());
        // Nothing is said of the model's stiffness where nothing tells another.
        let wrong = known.map_or(0.0, |k| 1.0 - k);
        // The error is c R + d b = c a + (d - c k) b, and F less the error the force from the stretch.
        let [c, d] = [self.into_estimate[0], self.into_estimate[1] * wrong];
        let e = d - c * k;
        let error2 = (c * c * m.aa + 2.0 * c * e * m.ab + e * e * m.bb) / m.weight;
        let with_force = (c * m.fa + e * m.fb) / m.weight;
        let ff = m.ff / m.weight;
        let force2 = if self.apart { ff } else { ff - 2.0 * with_force + error2 };
        let noise_n2 = c * c * self.noise_n2;
        let seen2 = error2 - noise_n2 - c * c * self.idle_n2;
        let loud = seen2 > LEAST_NOISE * LEAST_NOISE * noise_n2;
        let error_n = if loud { seen2.max(0.0).sqrt() } else { 0.0 };
        Some(Mismatch { error_n, force_n: force2.max(0.0).sqrt() })
    }

    /// R itself, N rms: of idle runs.
    pub(super) fn contradiction_n(&self, state: &SeenSides) -> f64 {
        let m = &state.mean;
        if m.weight < self.least_weight {
            return 0.0;
        }
        ((m.aa - 2.0 * m.ab + m.bb) / m.weight - self.noise_n2).max(0.0).sqrt()
    }
}

/// Learned stiffness and comparison of both sides, for methods that use the motor's motion beside the
/// stage's.
pub(super) fn both_sides(
    (method, balance): (Method, &ForceBalance),
    axis: &AxisSignals<'_>,
    settings: &ForceSettings,
    (alignment, band_hz): (&Alignment, f64),
) -> Result<(Option<StiffnessLearner>, Option<TwoSides>), ForceError> {
    let vibration = method == Method::VibrationMode;
    let summed = matches!(method, Method::Medob | Method::RigidMode | Method::Fitted);
    // Behind a low-pass of the drive side one of the sides lacks what the other has; of a slow recording next
    // to nothing is heard.
    let heard = settings.drive_filter.is_none() && band_hz.min(0.3 * axis.rate.hz()) > 2.0 * HIGH_PASS_HZ;
    let compares = (vibration || summed) && settings.compare_sides && heard;
    let dual = axis.drive.structure() == Structure::DualInertia;
    let applies = settings.learn_stiffness && vibration && dual;
    if !(compares || applies) {
        return Ok((None, None));
    }
    let ages = [alignment.motor, alignment.stage];
    let Some(learner) = StiffnessLearner::new(axis, balance, (ages, band_hz, applies))? else {
        return Ok((None, None));
    };
    if !compares {
        return Ok((Some(learner), None));
    }
    // The factor of the thrust is that of the motor side, the one of the stretch that of its force.
    let stretch = balance.motor.position_n_m / axis.drive.axial_stiffness_n_m();
    let into_estimate = [balance.thrust, if applies { 0.0 } else { stretch }];
    let filter = Filter::Butterworth(*learner.thinned().low_pass());
    let steps_m = [axis.drive.motor_encoder_resolution_m(), axis.drive.stage_encoder_resolution_m()];
    let noise_n2 = learner
        .contradiction()
        .iter()
        .zip(steps_m)
        .map(|(stencil, step_m)| step_m * step_m / 12.0 * filter.energy(&stencil.weights, axis.rate))
        .sum();
    let rate_hz = learner.thinned().rate().hz();
    let two_sides = TwoSides {
        into_estimate,
        apart: method == Method::Fitted,
        noise_n2,
        idle_n2: settings.idle_map.as_ref().map_or(0.0, IdleMap::contradiction_n).powi(2),
        forget: (-1.0 / (MEMORY_S * rate_hz)).exp(),
        least_weight: LEAST_S * rate_hz,
    };
    Ok((Some(learner), Some(two_sides)))
}
