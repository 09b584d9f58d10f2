//! The friction of a guideway whose travel the model does not state: how far it moves until its friction has
//! turned is learned from motion under no cutting force.
//!
//! ```text
//!  b = K_r (x_m - x_t) + C_k (v_m - v_t) - M_t a_t - C_t v_t = F_cut + F h(x; d)      of both encoders
//!  h_k: Dahl's law for each travel d_k of a series, F: Coulomb friction of the model
//!  means of 50 ms, in stretches of half a second: b - F h_k = c + s m_k + rest_k
//!  m_k = exp(-way / d_k): what is left of a memory of friction that nobody saw arise
//!  where the least rest is below a tenth of the variance of b:  l_k = 0.95 l_k - n/2 ln(rest_k / least rest)
//!  w_k = exp(l_k) / sum,  friction = F sum w_k h_k
//! ```
//! Who drives a standing axis shows in the sign: moved by its own drive, b rises with x by the friction;
//! pushed by the cut, b falls with x by the stiffness of the loop. So no travel explains the stretches in
//! which the cut pushes, and nothing is learned from them: one balance holds two unknown forces there, and
//! any travel leaves a cutting force that fits. What tells the travel is the idle part before an entry, the
//! loop that pulls the axis back after an exit, and reversals in air.
//!
//! Without both encoders b is the estimate itself before friction.
//! Checked by: guideway::*.

use super::balance::ForceBalance;
use super::band::TOLERATED;
use super::guideway::{Each, Evidence, GuidewayTravel, TRAVELS_M};
use super::motion::Underway;
use super::signals::{AxisSignals, Signals};
use super::stiffness::stretch_balance;
use super::validity::Validity;
use crate::plant::drive::Structure;
use crate::signal::dispatch::{Fast, Kernel, multiply_add, run};

/// Mean over this long, s: reversals of an idle axis take some 0.2 s, an encoder's steps average out.
const BLOCK_S: f64 = 0.05;
/// Blocks of one balance.
const BLOCKS: u32 = 10;
/// Share of the variance that a law may leave over where it explains the stretch.
const UNEXPLAINED: f64 = 0.1;
/// What a stretch that teaches leaves of the evidence before it: twenty of them count, so that one that was
/// wrong is outvoted.
const KEPT: f64 = 0.95;

/// How far the laws are apart is looked at in every so manyth sample.
const LOOKED_AT: u32 = 8;

/// Design; immutable.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Guideway {
    friction_n: f64,
    play_m: f64,
    /// Factors of x_m - x_t, v_m - v_t, v_t and a_t in b.
    stretch: [f64; 2],
    stage: [f64; 2],
    /// Factor of the estimate before friction in b.
    estimate: f64,
    /// Variance of b that a step of an encoder makes, N^2.
    step_n2: f64,
    before: Evidence,
    samples: u32,
    period_s: f64,
    fast: Fast,
}

/// Means of [`BLOCK_S`] in the making.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Block {
    count: u32,
    force_n: f64,
    share: Each,
    /// Variance of the share over the travels, summed over every [`LOOKED_AT`]th sample.
    doubt: f64,
    /// Way since the stretch began, at its beginning, m.
    way_m: f64,
    /// Velocity at its beginning, m/s.
    velocity_m_s: f64,
    /// The signals were whole from the sample before it on.
    whole: bool,
}

/// Sums and sums of products of one stretch: b less its first, h_k and m_k.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct Stretch {
    count: u32,
    first_n: f64,
    b: f64,
    bb: f64,
    h: Each,
    hh: Each,
    bh: Each,
    m: Each,
    mm: Each,
    bm: Each,
    hm: Each,
}

/// State of a [`Guideway`]; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct GuidewayState {
    position_m: f64,
    /// Since the stretch began.
    way_m: f64,
    share: Each,
    weights: Each,
    pub(super) evidence: Evidence,
    block: Block,
    stretch: Stretch,
    unknown: bool,
}

crate::keyframe::keep!(Block { count, force_n, share, doubt, way_m, velocity_m_s, whole });
crate::keyframe::keep!(Stretch { count, first_n, b, bb, h, hh, bh, m, mm, bm, hm });
crate::keyframe::keep!(GuidewayState {
    position_m,
    way_m,
    share,
    weights,
    evidence,
    block,
    stretch,
    unknown
});

impl GuidewayState {
    /// Nothing of the stretch before counts.
    fn begin_stretch(&mut self) {
        (self.stretch, self.way_m, self.block.way_m) = (Stretch::default(), 0.0, 0.0);
    }

    /// The same with what was learned before.
    pub(super) fn with(mut self, evidence: Evidence) -> Self {
        self.weights = evidence.weights();
        self.unknown = !evidence.is_known();
        self.evidence = evidence;
        self
    }
}

impl Guideway {
    /// `None` where the model states the travel, or the balance has no friction that travel turns.
    pub(super) fn new(
        travel: GuidewayTravel,
        balance: &ForceBalance,
        axis: &AxisSignals<'_>,
    ) -> Option<Self> {
        let GuidewayTravel::Learned(before) = travel else { return None };
        if !(balance.stage_friction_n > 0.0) {
            return None;
        }
        let (drive, rate) = (axis.drive, axis.rate);
        let both = axis.signals == Signals::Both && drive.structure() != Structure::Rigid;
        let stretch = stretch_balance(drive).motor;
        let stage = [-drive.translational_damping_n_s_m(), -drive.movable_mass_kg()];
        let step_m = drive.motor_encoder_resolution_m().max(drive.stage_encoder_resolution_m());
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "part of a second")]
        let samples = (BLOCK_S * rate.hz()).round().max(1.0) as u32;
        Some(Self {
            friction_n: balance.stage_friction_n,
            play_m: drive.stage_encoder_resolution_m(),
            stretch: if both { [stretch.position_n_m, stretch.velocity_n_s_m] } else { [0.0; 2] },
            stage: if both { stage } else { [0.0; 2] },
            estimate: if both { 0.0 } else { 1.0 },
            step_n2: (stretch.position_n_m * step_m).powi(2) / 12.0,
            before,
            samples,
            period_s: rate.period_s(),
            fast: Fast::detect(),
        })
    }

    /// At rest, no friction stored, nothing learned beyond what the design brings.
    pub(super) fn settled(&self, position_m: f64) -> GuidewayState {
        GuidewayState {
            position_m,
            way_m: 0.0,
            share: [0.0; 8],
            weights: self.before.weights(),
            evidence: self.before,
            block: Block::default(),
            stretch: Stretch::default(),
            unknown: !self.before.is_known(),
        }
    }

    /// The estimate before friction in; the friction to take off and what speaks against it out. No
    /// allocation.
    #[inline]
    pub(super) fn step(&self, state: &mut GuidewayState, now: &Underway) -> (f64, Validity) {
        let motion = &now.motion;
        let learn = !now.flags.shares(Validity::SETTLING | Validity::SIGNAL_MISSING);
        let share = run(self.fast, Turn { design: self, state, position_m: motion.stage_m });
        let velocity_m_s = motion.stage_velocity_m_s;
        let stretch_n = self.stretch[0] * (motion.motor_m - motion.stage_m)
            + self.stretch[1] * (motion.motor_velocity_m_s - velocity_m_s);
        state.block.force_n += stretch_n + self.stage[0] * velocity_m_s + self.estimate * now.force_n;
        state.block.count += 1;
        state.block.whole &= learn;
        if state.block.count >= self.samples {
            self.end_block(state, velocity_m_s);
            state.block.whole = learn;
        }
        let flag = Validity::when(state.unknown, Validity::FRICTION_TRAVEL_UNKNOWN);
        (self.friction_n * share, flag)
    }

    fn end_block(&self, state: &mut GuidewayState, velocity_m_s: f64) {
        let block = state.block;
        state.block = Block { velocity_m_s, way_m: state.way_m, ..Block::default() };
        let part = 1.0 / f64::from(block.count);
        // The level of friction is known to a tenth.
        let looks = block.count.div_ceil(LOOKED_AT);
        state.unknown = (block.doubt / f64::from(looks)).max(0.0).sqrt() > TOLERATED;
        if !block.whole {
            state.begin_stretch();
            return;
        }
        let accel_m_s2 = (velocity_m_s - block.velocity_m_s) * part / self.period_s;
        let force_n = block.force_n * part + self.stage[1] * accel_m_s2;
        let memory = mean_memory([block.way_m, state.way_m]);
        state.stretch.add(force_n, block.share.map(|h| h * part), memory);
        if state.stretch.count >= BLOCKS {
            self.learn(state);
            state.begin_stretch();
        }
    }

    fn learn(&self, state: &mut GuidewayState) {
        let sums = &state.stretch;
        let n = f64::from(sums.count);
        let least_n2 = n * self.step_n2 + f64::MIN_POSITIVE;
        let rest_n2: Each = std::array::from_fn(|k| sums.rest_n2(k, self.friction_n).max(least_n2));
        let best_n2 = rest_n2.into_iter().fold(f64::INFINITY, f64::min);
        if best_n2 < UNEXPLAINED * (sums.bb - sums.b * sums.b / n) {
            let evidence = state.evidence.log_likelihood.iter_mut().zip(rest_n2);
            evidence.for_each(|(l, rest_n2)| *l = KEPT * *l - 0.5 * n * (rest_n2 / best_n2).ln());
            state.weights = state.evidence.weights();
        }
    }
}

/// exp(-way / d) of each travel, its mean over a way that is gone evenly.
fn mean_memory([from_m, to_m]: [f64; 2]) -> Each {
    TRAVELS_M.map(|travel_m| {
        let (first, gone) = ((-from_m / travel_m).exp(), (to_m - from_m) / travel_m);
        if gone < 1e-6 { first } else { -first * (-gone).exp_m1() / gone }
    })
}

impl Stretch {
    fn add(&mut self, force_n: f64, share: Each, memory: Each) {
        if self.count == 0 {
            self.first_n = force_n;
        }
        self.count += 1;
        let b = force_n - self.first_n;
        self.b += b;
        self.bb += b * b;
        for k in 0..share.len() {
            let (h, m) = (share[k], memory[k]);
            self.h[k] += h;
            self.hh[k] += h * h;
            self.bh[k] += b * h;
            self.m[k] += m;
            self.mm[k] += m * m;
            self.bm[k] += b * m;
            self.hm[k] += h * m;
        }
    }

    /// Sum of squares of b - F h_k that a constant and what is left of the memory do not explain, N^2. The
    /// law began from a share between -1 and 1, and so did the guideway: the memory is at most 2 F.
    /// A cut that pushes slowly needs more. Checked by: `a_slow_push_tells_no_travel`.
    fn rest_n2(&self, k: usize, friction_n: f64) -> f64 {
        let n = f64::from(self.count);
        let about = |xy: f64, x: f64, y: f64| xy - x * y / n;
        let (bb, bh) = (about(self.bb, self.b, self.b), about(self.bh[k], self.b, self.h[k]));
        let hh = about(self.hh[k], self.h[k], self.h[k]);
        let (bm, hm) = (about(self.bm[k], self.b, self.m[k]), about(self.hm[k], self.h[k], self.m[k]));
        let mm = about(self.mm[k], self.m[k], self.m[k]);
        let without = bb - 2.0 * friction_n * bh + friction_n * friction_n * hh;
        let with = bm - friction_n * hm;
        // Sums of ones and nearly ones cancel to rounding where the axis did not move.
        let moved = mm > n * f64::EPSILON;
        if !moved {
            return without;
        }
        let memory_n = (with / mm).clamp(-2.0 * friction_n, 2.0 * friction_n);
        without - memory_n * (2.0 * with - memory_n * mm)
    }
}

/// Every travel's law on to a new position; the likely share of friction out.
struct Turn<'a> {
    design: &'a Guideway,
    state: &'a mut GuidewayState,
    position_m: f64,
}

impl Kernel for Turn<'_> {
    type Output = f64;

    /// As [`super::friction::Presliding`], for all travels at once.
    #[inline(always)]
    fn run<const FUSED: bool>(self) -> f64 {
        let s = self.state;
        let moved = self.position_m - s.position_m;
        let beyond = (moved.abs() - self.design.play_m).max(0.0);
        let direction = moved.signum();
        s.position_m = multiply_add::<FUSED>(direction, beyond, s.position_m);
        s.way_m += beyond;
        let mut likely = [0.0; 8];
        for k in 0..likely.len() {
            let u = beyond * (1.0 / TRAVELS_M[k]);
            let keep = 1.0 / (1.0 + u * (1.0 + 0.5 * u * (1.0 + u * (1.0 / 3.0))));
            let share = multiply_add::<FUSED>(s.share[k] - direction, keep, direction);
            s.share[k] = share;
            s.block.share[k] += share;
            likely[k] = s.weights[k] * share;
        }
        let mean: f64 = likely.iter().sum();
        if s.block.count.is_multiple_of(LOOKED_AT) {
            let square: f64 = likely.iter().zip(s.share).map(|(likely, share)| likely * share).sum();
            s.block.doubt += square - mean * mean;
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slow_push_tells_no_travel() {
        // A guideway of 20 N over 3 um, pushed by a cut of 90 N for half a second: the screw's force falls.
        for way_m in [2e-6, 10e-6, 50e-6] {
            let (friction_n, count) = (20.0, 100_u32);
            let mut pushed = Stretch::default();
            for i in 0..=count {
                let part = f64::from(i) / f64::from(count);
                let left = TRAVELS_M.map(|travel_m| (-part * way_m / travel_m).exp());
                let held_n = friction_n * (1.0 - (-part * way_m / 3e-6).exp());
                pushed.add(held_n - 90.0 * part, left.map(|m| 1.0 - m), left);
            }
            let all_n2 = pushed.bb - pushed.b * pushed.b / f64::from(pushed.count);
            for k in 0..TRAVELS_M.len() {
                assert!(pushed.rest_n2(k, friction_n) > UNEXPLAINED * all_n2, "{way_m} m, travel {k}");
            }
        }
    }
}
