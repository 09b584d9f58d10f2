//! Axes side by side: alignment, force balance, friction and low-pass of up to [`LANES`] axes, one axis a
//! lane of a vector register.
//!
//! ```text
//!  thrust, motor, [nut], stage --[motor side low-pass]--> lag, lines --> stencils - friction --> flags
//!                                                                              |
//!                       what an axis has beyond that (windows, physics, map) --+--> Butterworth --> N
//! ```
//! A lane does the same operations in the same order whatever stands beside it, so an axis alone
//! (`L = 1`, `ForceEstimator`) and the same axis among others have the same bits.
//! Checked by: lanes_give_the_bits_of_single_axes.

use super::above_band::{LanesAbove, SeenAbove};
use super::friction::{Presliding, PreslidingState, rational_tanh};
use super::lane_line::{LaneLine, LaneStencils};
use super::lane_part::{FlagLaw, LanePart};
use super::lane_sections::{LaneSection, filter, lane_sections, settle_sections};
use super::validity::Validity;
use crate::signal::butterworth::Butterworth;
use crate::signal::dispatch::{Fast, Kernel, multiply_add, run};
use crate::signal::finite_difference::{STENCIL_NODES, Stencil};

/// Axes of one vector estimator.
pub const LANES: usize = 8;

/// The designed estimators of axes side by side.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LaneDesign<const L: usize> {
    parts: Vec<Option<LanePart>>,
    drive_filter: Vec<LaneSection<L>>,
    current_memory: [f64; L],
    current: LaneStencils<L, 1>,
    motor: LaneStencils<L, 3>,
    stage: LaneStencils<L, 3>,
    motor_side: LaneStencils<L, 1>,
    nut: LaneStencils<L, 1>,
    thrust: [f64; L],
    motor_friction_n: [f64; L],
    stage_friction_n: [f64; L],
    smoothing_s_m: [f64; L],
    per_travel_1_m: [f64; L],
    play_m: [f64; L],
    by_motor: [f64; L],
    constant: [Validity; L],
    hidden: [Validity; L],
    still_m_s: [f64; L],
    lines_1_m: [[f64; L]; 2],
    band_hz: [f64; L],
    friction_n: [f64; L],
    settling: [f64; L],
    low_pass: Vec<LaneSection<L>>,
    above: Option<LanesAbove<L>>,
    /// Samples that a line holds.
    line: usize,
    fast: Fast,
}

/// What was read last: a signal that is absent keeps its place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LaneInput<const L: usize> {
    /// Thrust references, N.
    pub(super) thrust_ref_n: [f64; L],
    /// Motor angles as travel, m.
    pub(super) motor_m: [f64; L],
    /// Screws at the nut, m.
    pub(super) nut_m: [f64; L],
    /// Stage positions, m.
    pub(super) stage_m: [f64; L],
    /// 1 where a signal that the balance needs was absent.
    pub(super) absent: [f64; L],
}

crate::keyframe::keep!(LaneInput<L> { thrust_ref_n, motor_m, nut_m, stage_m, absent });

/// State of a [`LaneDesign`]; a clone is a keyframe.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LaneState<const L: usize> {
    pub(super) input: LaneInput<L>,
    drive_filter: [Vec<[[f64; L]; 2]>; 2],
    current_n: [f64; L],
    last_ref_n: [f64; L],
    current: LaneLine<L>,
    motor: LaneLine<L>,
    stage: LaneLine<L>,
    nut: LaneLine<L>,
    slip_m: [f64; L],
    share: [f64; L],
    seen: [f64; L],
    /// Samples for which a value that was not there still rings on.
    missing: [f64; L],
    low_pass: Vec<[[f64; L]; 2]>,
    above: SeenAbove<L>,
}

crate::keyframe::keep!(LaneState<L> {
    input,
    drive_filter,
    current_n,
    last_ref_n,
    current,
    motor,
    stage,
    nut,
    slip_m,
    share,
    seen,
    missing,
    low_pass,
    above
});

/// The balance of one instant, before what an axis has beyond it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LaneMotion<const L: usize> {
    pub(super) raw_n: [f64; L],
    pub(super) thrust_n: [f64; L],
    pub(super) motor_velocity_m_s: [f64; L],
    pub(super) motor_m: [f64; L],
    pub(super) stage_velocity_m_s: [f64; L],
    pub(super) stage_m: [f64; L],
    /// Inertia and damping of the motor, where both sides are compared.
    pub(super) motor_side_n: [f64; L],
    /// Share of the motor's friction.
    pub(super) turned: [f64; L],
    pub(super) flags: [Validity; L],
}

impl<const L: usize> LaneDesign<L> {
    /// Puts axes side by side; a place without an axis stays zero. Requires: at most `L` places, ages that
    /// `Alignment` allowed.
    pub(super) fn new(parts: Vec<Option<LanePart>>) -> Self {
        fn lanes<const L: usize, T: Copy>(
            parts: &[Option<LanePart>],
            absent: T,
            pick: impl Fn(&LanePart) -> T,
        ) -> [T; L] {
            std::array::from_fn(|k| parts.get(k).and_then(Option::as_ref).map_or(absent, &pick))
        }
        let of = |pick: &dyn Fn(&LanePart) -> f64| lanes::<L, f64>(&parts, 0.0, pick);
        let three = |pick: &dyn Fn(&LanePart) -> [Stencil; 3]| {
            LaneStencils::new(&parts.iter().map(|p| p.as_ref().map(pick)).collect::<Vec<_>>())
        };
        let one = |pick: &dyn Fn(&LanePart) -> Option<Stencil>| {
            LaneStencils::new(
                &parts.iter().map(|p| p.as_ref().and_then(pick).map(|s| [s])).collect::<Vec<_>>(),
            )
        };
        let filters = |pick: &dyn Fn(&LanePart) -> Option<Butterworth>| {
            let cascade = |p: &Option<LanePart>| Some(p.as_ref().and_then(pick)?.sections().to_vec());
            lane_sections(parts.iter().map(|p| cascade(p).unwrap_or_default()))
        };
        let mut design = Self {
            drive_filter: filters(&|p| p.drive_filter),
            current_memory: of(&|p| p.current_memory),
            current: one(&|p| Some(p.current)),
            motor: three(&|p| p.motor),
            stage: three(&|p| p.stage),
            motor_side: one(&|p| p.motor_side),
            nut: one(&|p| p.nut),
            thrust: of(&|p| p.thrust),
            motor_friction_n: of(&|p| p.motor_friction_n),
            stage_friction_n: of(&|p| p.stage_friction_n),
            smoothing_s_m: of(&|p| 1.0 / p.smoothing_m_s),
            per_travel_1_m: of(&|p| p.presliding.per_travel_1_m),
            play_m: of(&|p| p.presliding.play_m),
            by_motor: of(&|p| if p.by_motor { 1.0 } else { 0.0 }),
            constant: lanes(&parts, Validity::VALID, |p| p.law.constant),
            hidden: lanes(&parts, Validity::VALID, |p| p.law.hidden),
            still_m_s: of(&|p| p.law.still_m_s),
            lines_1_m: [of(&|p| p.law.lines_1_m[0]), of(&|p| p.law.lines_1_m[1])],
            band_hz: of(&|p| p.law.band_hz),
            friction_n: of(&|p| p.law.friction_n),
            settling: of(&|p| p.settling as f64),
            low_pass: filters(&|p| p.low_pass),
            above: LanesAbove::new(&parts.iter().map(|p| p.as_ref()?.above).collect::<Vec<_>>()),
            line: 0,
            fast: Fast::detect(),
            parts,
        };
        let oldest = [design.current.oldest(), design.motor.oldest(), design.stage.oldest()];
        design.line = oldest.into_iter().fold(design.nut.oldest(), usize::max).max(1);
        design
    }

    /// The same without the processor's fast instructions, for comparison.
    #[cfg(test)]
    pub(super) fn without_fast(mut self) -> Self {
        self.fast = Fast::off();
        self
    }

    /// Another settling time of one lane: its window changed.
    pub(super) fn set_settling(&mut self, lane: usize, samples: usize) {
        self.settling[lane] = samples as f64;
    }

    /// Lines of zeros.
    pub(super) fn start(&self) -> LaneState<L> {
        let zeros = [0.0; L];
        let line = || LaneLine::of(self.line);
        LaneState {
            input: LaneInput {
                thrust_ref_n: zeros,
                motor_m: zeros,
                nut_m: zeros,
                stage_m: zeros,
                absent: zeros,
            },
            drive_filter: [(); 2].map(|()| vec![[zeros; 2]; self.drive_filter.len()]),
            current_n: zeros,
            last_ref_n: zeros,
            current: line(),
            motor: line(),
            stage: line(),
            nut: line(),
            slip_m: zeros,
            share: zeros,
            seen: zeros,
            missing: zeros,
            low_pass: vec![[zeros; 2]; self.low_pass.len()],
            above: SeenAbove::of(self.above.as_ref()),
        }
    }

    /// Settles one lane on what its input holds: as if the axis had stood there for ever. No allocation.
    pub(super) fn settle(&self, state: &mut LaneState<L>, lane: usize) {
        let Some(part) = self.parts.get(lane).and_then(Option::as_ref) else { return };
        let LaneInput { thrust_ref_n, motor_m, nut_m, stage_m, .. } = state.input;
        let [thrust_n, motor_m, nut_m, stage_m] = [thrust_ref_n, motor_m, nut_m, stage_m].map(|x| x[lane]);
        for (filter, x) in state.drive_filter.iter_mut().zip([thrust_n, motor_m]) {
            settle_sections(&self.drive_filter, filter, lane, x);
        }
        (state.current_n[lane], state.last_ref_n[lane]) = (thrust_n, thrust_n);
        state.current.settle(lane, thrust_n);
        state.motor.settle(lane, motor_m);
        state.nut.settle(lane, nut_m);
        state.stage.settle(lane, stage_m);
        (state.slip_m[lane], state.share[lane]) = (stage_m, 0.0);
        (state.seen[lane], state.missing[lane]) = (0.0, 0.0);
        let at_rest = part.rest.iter().zip([thrust_n, motor_m, nut_m, stage_m]);
        let rest_n = at_rest.map(|(factor, x)| factor * x).sum();
        settle_sections(&self.low_pass, &mut state.low_pass, lane, rest_n);
        state.above.settle(lane);
    }

    /// The balance of the sample that the state's input holds. No allocation.
    #[inline]
    pub(super) fn balance(&self, state: &mut LaneState<L>) -> LaneMotion<L> {
        run(self.fast, Balance { design: self, state })
    }

    /// The low-pass behind it; adds what speaks against the share above the band. No allocation.
    #[inline]
    pub(super) fn low_pass(
        &self,
        state: &mut LaneState<L>,
        force_n: [f64; L],
        flags: &mut [Validity; L],
    ) -> [f64; L] {
        run(self.fast, LowPass { design: self, state, force_n, flags })
    }
}

impl<const L: usize> LaneState<L> {
    /// Whether a held value rings in the estimate of a lane.
    #[inline]
    pub(super) fn is_missing(&self, lane: usize) -> bool {
        self.missing[lane] > 0.0
    }
}

struct Balance<'a, const L: usize> {
    design: &'a LaneDesign<L>,
    state: &'a mut LaneState<L>,
}

impl<const L: usize> Kernel for Balance<'_, L> {
    type Output = LaneMotion<L>;

    #[inline(always)]
    fn run<const FUSED: bool>(self) -> LaneMotion<L> {
        let (d, s) = (self.design, self.state);
        let (mut told, mut motor) = (s.input.thrust_ref_n, s.input.motor_m);
        let [of_thrust, of_motor] = &mut s.drive_filter;
        filter::<L, FUSED>(&d.drive_filter, of_thrust, &mut told);
        filter::<L, FUSED>(&d.drive_filter, of_motor, &mut motor);
        let (before_n, last_n) = (s.current_n, s.last_ref_n);
        let mut current_n = [0.0; L];
        for lane in 0..L {
            // The reference given at the last sample has driven the current until now.
            let (memory, last) = (d.current_memory[lane], last_n[lane]);
            let lagged = multiply_add::<FUSED>(memory, before_n[lane] - last, last);
            current_n[lane] = if memory == 0.0 { told[lane] } else { lagged };
        }
        s.current_n = current_n;
        s.last_ref_n = told;
        s.current.push(s.current_n);
        s.motor.push(motor);
        s.stage.push(s.input.stage_m);
        let [thrust_n] = s.current.apply::<1, FUSED>(&d.current);
        let [motor_n, motor_velocity_m_s, motor_m] = s.motor.apply::<3, FUSED>(&d.motor);
        let [stage_n, stage_velocity_m_s, stage_m] = s.stage.apply::<3, FUSED>(&d.stage);
        let mut nut_n = [0.0; L];
        if !d.nut.is_empty() {
            s.nut.push(s.input.nut_m);
            [nut_n] = s.nut.apply::<1, FUSED>(&d.nut);
        }
        let mut motor_side_n = [0.0; L];
        if !d.motor_side.is_empty() {
            [motor_side_n] = s.motor.apply::<1, FUSED>(&d.motor_side);
        }
        let (mut slip_m, mut share) = (s.slip_m, s.share);
        for lane in 0..L {
            let law = Presliding { per_travel_1_m: d.per_travel_1_m[lane], play_m: d.play_m[lane] };
            let slip = PreslidingState { position_m: slip_m[lane], share: share[lane] };
            let slip = law.step::<FUSED>(slip, stage_m[lane]);
            (slip_m[lane], share[lane]) = (slip.position_m, slip.share);
        }
        (s.slip_m, s.share) = (slip_m, share);
        let (mut raw_n, mut turned) = ([0.0; L], [0.0; L]);
        for lane in 0..L {
            turned[lane] = rational_tanh::<FUSED>(motor_velocity_m_s[lane] * d.smoothing_s_m[lane]);
            let stage_n = stage_n[lane] - d.stage_friction_n[lane] * share[lane];
            let sides_n =
                multiply_add::<FUSED>(-d.motor_friction_n[lane], turned[lane], stage_n + nut_n[lane]);
            raw_n[lane] = multiply_add::<FUSED>(d.thrust[lane], thrust_n[lane], motor_n[lane]) + sides_n;
        }
        let (mut seen, mut missing, absent) = (s.seen, s.missing, s.input.absent);
        for lane in 0..L {
            seen[lane] += 1.0;
            let rings = d.settling[lane] + STENCIL_NODES as f64;
            let one_less = (missing[lane] - 1.0).max(0.0);
            missing[lane] = if absent[lane] > 0.0 { rings } else { one_less };
        }
        (s.seen, s.missing) = (seen, missing);
        let mut flags = [Validity::VALID; L];
        for lane in 0..L {
            let by_motor = d.by_motor[lane] > 0.0;
            let speed_m_s = if by_motor { motor_velocity_m_s[lane] } else { stage_velocity_m_s[lane] }.abs();
            let law = FlagLaw {
                constant: d.constant[lane],
                hidden: d.hidden[lane],
                still_m_s: d.still_m_s[lane],
                lines_1_m: [d.lines_1_m[0][lane], d.lines_1_m[1][lane]],
                band_hz: d.band_hz[lane],
                friction_n: d.friction_n[lane],
            };
            flags[lane] = law.flags(speed_m_s, thrust_n[lane] * d.thrust[lane])
                | Validity::when(missing[lane] > 0.0, Validity::SIGNAL_MISSING)
                | Validity::when(seen[lane] < d.settling[lane], Validity::SETTLING);
        }
        LaneMotion {
            raw_n,
            thrust_n,
            motor_velocity_m_s,
            motor_m,
            stage_velocity_m_s,
            stage_m,
            motor_side_n,
            turned,
            flags,
        }
    }
}

struct LowPass<'a, const L: usize> {
    design: &'a LaneDesign<L>,
    state: &'a mut LaneState<L>,
    force_n: [f64; L],
    flags: &'a mut [Validity; L],
}

impl<const L: usize> Kernel for LowPass<'_, L> {
    type Output = [f64; L];

    #[inline(always)]
    fn run<const FUSED: bool>(mut self) -> [f64; L] {
        if let Some(above) = &self.design.above {
            above.step::<FUSED>(&mut self.state.above, &self.force_n, self.flags);
        }
        filter::<L, FUSED>(&self.design.low_pass, &mut self.state.low_pass, &mut self.force_n);
        self.force_n
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::force::balance::Method;
    use crate::force::estimator::ForceEstimator;
    use crate::force::guideway::GuidewayTravel;
    use crate::force::motion::MotionSample;
    use crate::force::settings::ForceSettings;
    use crate::force::signals::{AxisSignals, Signals};
    use crate::plant::drive::{DriveParams, RawDriveParams};
    use crate::units::SampleRate;

    fn estimator(k: usize) -> ForceEstimator {
        let methods =
            [Method::Medob, Method::VibrationMode, Method::Medob, Method::Dob, Method::Thrust, Method::Medob];
        let drive = DriveParams::new(RawDriveParams {
            movable_mass_kg: Some(7.0),
            screw_lead_m: Some(0.005),
            rotary_inertia_kg_m2: Some(5e-5),
            axial_stiffness_n_m: Some(4e7),
            structural_damping_n_s_m: Some(1500.0),
            stage_coulomb_friction_n: Some(50.0),
            motor_coulomb_friction_n: Some(30.0),
            current_loop_bandwidth_rad_s: Some(5000.0),
            amplifier_dead_time_s: Some(1e-4 * k as f64),
            stage_encoder_resolution_m: Some(1e-9),
            ..RawDriveParams::default()
        })
        .unwrap();
        let rate = SampleRate::new(9000.0).unwrap();
        // What is learned lies beyond the lane.
        let guideway = GuidewayTravel::Stated(3e-6);
        let mut settings = ForceSettings { guideway, ..ForceSettings::default() };
        if k == 2 {
            settings.drive_filter = Some(Butterworth::low_pass(2, 150.0, rate).unwrap());
        }
        ForceEstimator::new(
            methods[k],
            &AxisSignals { drive: &drive, rate, signals: Signals::Both },
            settings,
        )
        .unwrap()
    }

    fn sample(k: usize, i: i32) -> MotionSample {
        let t = f64::from(i) / 9000.0;
        let wave = |f: f64| (std::f64::consts::TAU * f * t + k as f64).sin() - (k as f64).sin();
        MotionSample {
            thrust_ref_n: 80.0 * wave(40.0),
            motor_travel_m: Some(1e-4 * wave(9.0) + 1e-8 * wave(600.0)),
            // Every hundredth value of one axis is absent.
            stage_position_m: (k != 3 || i % 100 != 50).then(|| 1e-4 * wave(9.0) + 3e-8 * wave(600.0)),
            ..MotionSample::default()
        }
    }

    fn compare(fast: bool, close: impl Fn(f64, f64) -> bool) {
        let singles: Vec<ForceEstimator> = (0..6).map(estimator).collect();
        let parts = singles.iter().map(|e| Some(e.part())).chain([None]).collect();
        let lanes = LaneDesign::<LANES>::new(parts);
        let lanes = if fast { lanes } else { lanes.without_fast() };
        let mut state = lanes.start();
        let mut states: Vec<_> = (0..6).map(|k| singles[k].settled(&sample(k, 0))).collect();
        for i in 0..3000 {
            for k in 0..6 {
                singles[k].put(&sample(k, i), (&mut state, k));
                if i == 0 {
                    lanes.settle(&mut state, k);
                }
            }
            let mut balance = lanes.balance(&mut state);
            let together_n = lanes.low_pass(&mut state, balance.raw_n, &mut balance.flags);
            for k in 0..6 {
                let alone = singles[k].step(&mut states[k], &sample(k, i));
                assert!(close(alone.force_n, together_n[k]), "lane {k}, {i}: {alone:?} {}", together_n[k]);
                assert_eq!(alone.flags, balance.flags[k], "lane {k}, sample {i}");
            }
            assert!(together_n[6] == 0.0 && together_n[7] == 0.0);
        }
    }

    #[test]
    fn lanes_give_the_bits_of_single_axes() {
        compare(true, |alone, together| alone.to_bits() == together.to_bits());
    }

    #[test]
    fn any_processor_gives_nearly_the_same() {
        // Rounding of positions times 1e9 N/m.
        compare(false, |alone, together| (alone - together).abs() < 2e-4);
    }
}
