//! What one axis puts into its lane: delays, factors and filters as numbers.

use super::above_band::AboveBand;
use super::alignment::Alignment;
use super::balance::{ForceBalance, Method};
use super::friction::Presliding;
use super::physics::PhysicsModel;
use super::settings::{Filter, ForceSettings};
use super::signals::{AxisSignals, Signals, encoder_lines_1_m};
use super::validity::Validity;
use crate::signal::butterworth::Butterworth;
use crate::signal::finite_difference::{Stencil, stencils};

/// What one axis puts into its lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LanePart {
    /// Low-pass of the drive side.
    pub(super) drive_filter: Option<Butterworth>,
    /// Share of its last value that the current keeps.
    pub(super) current_memory: f64,
    pub(super) current: Stencil,
    /// Force, velocity, position.
    pub(super) motor: [Stencil; 3],
    pub(super) stage: [Stencil; 3],
    /// Inertia and damping of the motor alone, where both sides are compared.
    pub(super) motor_side: Option<Stencil>,
    /// Force, where the balance has a third position.
    pub(super) nut: Option<Stencil>,
    /// Factor of the thrust.
    pub(super) thrust: f64,
    /// Factors of thrust, motor, nut and stage of an axis at rest.
    pub(super) rest: [f64; 4],
    pub(super) motor_friction_n: f64,
    pub(super) stage_friction_n: f64,
    pub(super) smoothing_m_s: f64,
    pub(super) presliding: Presliding,
    /// The axis travels as its motor does: there is no scale.
    pub(super) by_motor: bool,
    pub(super) low_pass: Option<Butterworth>,
    /// Where the method's band ends before the low-pass does.
    pub(super) above: Option<AboveBand>,
    pub(super) law: FlagLaw,
    /// Samples until the filters have forgotten their start.
    pub(super) settling: usize,
}

/// What speaks against an estimate by the motion of its axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct FlagLaw {
    /// Always there.
    pub(super) constant: Validity,
    /// Slower than this the axis stands.
    pub(super) still_m_s: f64,
    /// Lines of the encoders per metre of travel.
    pub(super) lines_1_m: [f64; 2],
    /// A line below this is in band.
    pub(super) band_hz: f64,
    /// Friction that may hide the force; 0: none.
    pub(super) friction_n: f64,
    /// What to say then.
    pub(super) hidden: Validity,
}

impl FlagLaw {
    /// Flags at a speed and under a thrust.
    #[inline(always)]
    pub(super) fn flags(&self, speed_m_s: f64, thrust_n: f64) -> Validity {
        let line = |k: usize| {
            let hz = speed_m_s * self.lines_1_m[k];
            (hz > 1.0) & (hz < self.band_hz)
        };
        let below =
            (speed_m_s < self.still_m_s) & (self.friction_n > 0.0) & (thrust_n.abs() < self.friction_n);
        self.constant
            | Validity::when(line(0) | line(1), Validity::ENCODER_LINE_IN_BAND)
            | Validity::when(below, self.hidden)
    }
}

/// What an axis puts into its lane.
pub(super) fn lane_part(
    (method, balance): (Method, &ForceBalance),
    axis: &AxisSignals<'_>,
    settings: &ForceSettings,
    (alignment, filter): (&Alignment, &Filter),
) -> LanePart {
    let (drive, period_s) = (axis.drive, axis.rate.period_s());
    let side = |age: f64, factors: [f64; 3]| {
        let s = stencils(age, period_s);
        [Stencil::combined(&s, factors), s[1], s[0]]
    };
    let low_pass = match filter {
        Filter::Butterworth(filter) => Some(*filter),
        Filter::LinearPhase(_) | Filter::None => None,
    };
    let rest = [balance.motor, balance.nut, balance.stage].map(|side| side.position_n_m);
    LanePart {
        drive_filter: settings.drive_filter,
        current_memory: alignment.current_memory,
        current: stencils(alignment.current, period_s)[0],
        motor: side(alignment.motor, balance.motor.as_array()),
        stage: side(alignment.stage, balance.stage.as_array()),
        motor_side: None,
        // The screw's encoder is taken to be as late as the stage's.
        nut: balance.needs_nut().then(|| side(alignment.stage, balance.nut.as_array())[0]),
        thrust: balance.thrust,
        rest: [balance.thrust, rest[0], rest[1], rest[2]],
        motor_friction_n: balance.motor_friction_n,
        stage_friction_n: settings.guideway.in_balance_n(balance.stage_friction_n),
        smoothing_m_s: drive.friction_smoothing_m_s(),
        presliding: Presliding::new(settings.guideway.travel_m(), drive.stage_encoder_resolution_m()),
        by_motor: axis.signals == Signals::MotorOnly,
        low_pass,
        above: None,
        law: flag_law((method, balance), axis, settings, filter.band_hz(settings.low_pass, axis.rate)),
        settling: 0,
    }
}

fn flag_law(
    (method, balance): (Method, &ForceBalance),
    axis: &AxisSignals<'_>,
    settings: &ForceSettings,
    band_hz: f64,
) -> FlagLaw {
    let beyond = settings.unmodelled_modes_hz.iter().any(|f| *f < 1.1 * band_hz);
    let physics_n = settings.physics.as_ref().map_or(0.0, PhysicsModel::coulomb_n);
    let friction_n = match method {
        // The window tells for itself where it sees nothing.
        Method::Spectral => 0.0,
        // Its balance knows of no friction, which hides the force all the same.
        Method::Thrust => settings.friction_bound_n(axis.drive),
        _ => balance.motor_friction_n.abs() + balance.stage_friction_n.abs() + physics_n,
    };
    FlagLaw {
        constant: Validity::when(beyond, Validity::MODE_OUTSIDE_MODEL),
        still_m_s: 2.0 * axis.drive.friction_smoothing_m_s(),
        lines_1_m: encoder_lines_1_m(axis.drive, balance),
        band_hz,
        friction_n,
        // Without the stage's own motion in the balance, what friction holds back does not show at all.
        hidden: if balance.needs_stage() { Validity::MEAN_NOT_OBSERVABLE } else { Validity::BELOW_FRICTION },
    }
}
