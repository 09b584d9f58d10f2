//! The last look at a command before the wire. It trusts nobody, shares nothing with the decision, and can
//! only refuse.

use super::{Command, CommandKind, Mode};
use crate::sample::MAX_AXES;

/// Commissioned limits, in the units of the wire; by default no motion is inside of them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Guard {
    /// Least offset of each axis.
    pub lowest_m: [f64; MAX_AXES],
    /// Greatest offset of each axis.
    pub highest_m: [f64; MAX_AXES],
    /// Fastest motion of each axis.
    pub speed_m_s: [f64; MAX_AXES],
    /// Largest acceleration of each axis.
    pub acceleration_m_s2: [f64; MAX_AXES],
    /// Direction of each axis from "toward the bar".
    pub direction_rad: [f64; MAX_AXES],
    /// Diameter at the tools.
    pub diameter_m: f64,
    /// Largest pitch difference either way.
    pub largest_pitch_rad: f64,
}

/// What is true at the moment of sending, asked anew.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facts {
    /// Monotonic clock.
    pub now_s: f64,
    /// Mode.
    pub mode: Mode,
    /// Interlocks known to be closed, and when that was heard.
    pub interlock_closed_s: Option<f64>,
    /// Actual offsets that the turret reported.
    pub actual_m: [f64; MAX_AXES],
}

/// What was sent last.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct GuardState {
    last: Option<(u64, u64)>,
    last_s: Option<f64>,
}

/// Why a command was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Refusal {
    /// A number that is none.
    NotFinite,
    /// Outside the commissioned limits, or another pitch than the offsets make (I1).
    Envelope,
    /// An interlock open or unheard for 0.2 s (I2).
    Interlock,
    /// Not in act (I3).
    Mode,
    /// Farther than the axis may go since the last (I4).
    Rate,
    /// Sooner than a second after the last (I5).
    Interval,
    /// Rests on samples older than 50 ms (I6).
    Stale,
    /// Lives longer than 2.5 s (I7).
    Lifetime,
    /// Not newer than the last (I9).
    Identity,
}

impl Refusal {
    /// Every name, for those who count them.
    pub const NAMES: [&str; 9] = [
        "guard_not_finite",
        "guard_envelope",
        "guard_interlock",
        "guard_mode",
        "guard_rate",
        "guard_interval",
        "guard_stale",
        "guard_lifetime",
        "guard_identity",
    ];

    /// As it is counted and recorded.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }
}

/// A report of the interlocks older than this is none.
const INTERLOCK_HEARD_S: f64 = 0.2;
/// Rounding allowed: a tenth of a nanometre, a microradian.
const ROUNDING_M: f64 = 1e-10;
const ROUNDING_RAD: f64 = 1e-6;

impl Guard {
    /// Errors: the first rule that the command breaks. A command that passes counts as sent.
    pub fn pass(&self, state: &mut GuardState, command: &Command, facts: &Facts) -> Result<(), Refusal> {
        self.check(state, command, facts)?;
        state.last = Some((command.epoch, command.sequence));
        state.last_s = Some(facts.now_s);
        Ok(())
    }

    fn check(&self, state: &GuardState, command: &Command, facts: &Facts) -> Result<(), Refusal> {
        let finite = |list: &[f64]| list.iter().all(|x| x.is_finite());
        let numbers = [command.pitch_difference_rad, command.ttl_s, facts.now_s];
        if !(finite(&numbers) && finite(&command.offsets_m)) {
            return Err(Refusal::NotFinite);
        }
        if state.last.is_some_and(|last| (command.epoch, command.sequence) <= last) {
            return Err(Refusal::Identity);
        }
        if command.ttl_s <= 0.0 || command.ttl_s > 2.5 {
            return Err(Refusal::Lifetime);
        }
        if command.kind == CommandKind::Return {
            // Equal pitch may be asked for at any time, whatever is known, and nothing else under that name.
            let zero = command.offsets_m.iter().all(|o| *o == 0.0) && command.pitch_difference_rad == 0.0;
            return if zero { Ok(()) } else { Err(Refusal::Envelope) };
        }
        let known = [command.based_on_s, facts.interlock_closed_s.unwrap_or(0.0)];
        if !(finite(&known) && finite(&facts.actual_m)) {
            return Err(Refusal::NotFinite);
        }
        if facts.mode != Mode::Act {
            return Err(Refusal::Mode);
        }
        let heard =
            facts.interlock_closed_s.is_some_and(|t| (0.0..=INTERLOCK_HEARD_S).contains(&(facts.now_s - t)));
        if !heard {
            return Err(Refusal::Interlock);
        }
        if !(0.0..=0.05).contains(&(facts.now_s - command.based_on_s)) {
            return Err(Refusal::Stale);
        }
        let elapsed_s = state.last_s.map_or(1.0, |t| facts.now_s - t);
        if elapsed_s < 1.0 - 1e-9 {
            return Err(Refusal::Interval);
        }
        self.check_motion(command, facts, elapsed_s)
    }

    fn check_motion(&self, command: &Command, facts: &Facts, elapsed_s: f64) -> Result<(), Refusal> {
        let (mut toward_m, mut around_m) = (0.0, 0.0);
        for axis in 0..MAX_AXES {
            let offset_m = command.offsets_m[axis];
            if !(self.lowest_m[axis]..=self.highest_m[axis]).contains(&offset_m) {
                return Err(Refusal::Envelope);
            }
            toward_m += offset_m * self.direction_rad[axis].cos();
            around_m += offset_m * self.direction_rad[axis].sin();
            let (speed, acceleration) = (self.speed_m_s[axis], self.acceleration_m_s2[axis]);
            // From rest to rest.
            let longest_m = match speed / acceleration {
                up_s if elapsed_s < 2.0 * up_s => acceleration * (0.5 * elapsed_s).powi(2),
                up_s => speed * (elapsed_s - up_s),
            };
            let way_m = (offset_m - facts.actual_m[axis]).abs();
            if self.lowest_m[axis] < self.highest_m[axis] && !(way_m <= longest_m + ROUNDING_M) {
                return Err(Refusal::Rate);
            }
        }
        let pitch_rad = command.pitch_difference_rad;
        let made_rad = 2.0 * around_m.atan2(0.5 * self.diameter_m - toward_m);
        let good = pitch_rad.abs() <= self.largest_pitch_rad && (made_rad - pitch_rad).abs() <= ROUNDING_RAD;
        if good { Ok(()) } else { Err(Refusal::Envelope) }
    }
}
