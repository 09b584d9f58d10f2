//! What to do about chatter: which pitch angle difference, whether it may be made now, and whether it helped.
//!
//! ```text
//!  heard lines --> choice of pitch --> Avoidance::decide, once an interval --> Command | Advice |
//! Hold(reason)
//!  turret report, interlock, mode, ages ----------^                                 |
//!                                                                      Guard (last look, trusts nobody)
//! ```
//!
//! Pure logic: time is an argument, nothing is read or sent here. Every interval ends in one decision; a
//! decision not to act is a value with a reason from a closed list. `guard::Guard` and
//! `invariants::InvariantMonitor` share no
//! code with the decision.
//!
//! This is advice to a motion controller, not a safety function: the machine must be safe with any output.

pub mod account;
pub mod best_pitch;
pub mod choice;
mod decide;
mod forestall;
pub mod guard;
pub mod identified;
pub mod invariants;
pub mod pitch;
mod state;
mod structure;
pub mod turret;

pub use decide::Avoidance;
pub use forestall::Wait;
pub use state::AvoidanceState;

use crate::chatter::Phase;
use crate::keyframe::{Keep, Words, keep, keep_list};
use crate::sample::MAX_AXES;
use crate::stability::margin::Margin;
use thiserror::Error;

/// How far Stillcut may go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Mode {
    /// Listens; nothing leaves the process.
    #[default]
    Observe,
    /// Says what it would do.
    Advise,
    /// Commands the turret.
    Act,
}

/// Limits and times of the decision: commissioned values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AvoidanceSettings {
    /// Turret that carries tool 1.
    pub turret: turret::TurretKinematics,
    /// Diameter at the tools.
    pub diameter_m: f64,
    /// Largest pitch difference either way.
    pub largest_pitch_rad: f64,
    /// Between two decisions; the thesis takes 1.0 s so that the motion excites nothing.
    pub interval_s: f64,
    /// Lifetime of a command.
    pub ttl_s: f64,
    /// Oldest sample that a command may rest on.
    pub freshness_s: f64,
    /// Oldest turret report and interlock report that a command may rest on.
    pub report_deadline_s: f64,
    /// Distance from a commanded offset that counts as reached.
    pub reached_m: f64,
    /// Bar and cut as the operator stated them: the choice of pitch by the model of the cut starts here.
    /// `None`: eq. (6-10) alone.
    pub stated: Option<crate::plant::scenario::Scenario>,
    /// The pitch may move while the cut is still silent, where its stability margin runs out.
    pub before_chatter: bool,
}

/// Why settings cannot be used.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum SettingsError {
    /// A value outside what is allowed.
    #[error("{name} = {value}: expected {expected}")]
    Value {
        /// Setting.
        name: &'static str,
        /// Value.
        value: f64,
        /// What is allowed.
        expected: &'static str,
    },
}

/// What is known when a decision is due. Times are of one monotonic clock. By default nothing is known.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Situation {
    /// Now.
    pub now_s: f64,
    /// Newest sample, when there is one.
    pub newest_sample_s: Option<f64>,
    /// Whether the detector's window is full of samples without a gap.
    pub window_full: bool,
    /// Whether nothing stands against acting on the force estimate of the axis that hears the line.
    pub estimate_valid: bool,
    /// What the detector says.
    pub heard: Heard,
    /// The line that is about to grow, while the stability margin runs out.
    pub foreseen: Option<Foreseen>,
    /// Spindle speed, where it is measured.
    pub spindle_speed_rpm: Option<f64>,
    /// Latest report of the turret.
    pub turret: Option<TurretReport>,
    /// Latest word on the interlocks.
    pub interlock: Option<Interlock>,
    /// Mode now.
    pub mode: Mode,
    /// The operator asks to leave the turret alone.
    pub operator_hold: bool,
    /// The operator has seen the latched reason and clears it.
    pub operator_acknowledge: bool,
    /// Intents can be recorded.
    pub store_writable: bool,
    /// Number of the latest command that did not go out: held back by guard, record or port.
    pub withheld: Option<u64>,
    /// The last command went out less than an interval ago, later than it was decided: all is looked at,
    /// nothing is decided.
    pub too_soon: bool,
    /// Diameter at the tools, where an axis tells it.
    pub diameter_m: Option<f64>,
}

/// What the detector says, reduced to what a decision needs.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Heard {
    /// Where the detector stands.
    pub phase: Phase,
    /// Strongest line.
    pub frequency_hz: Option<f64>,
    /// Its power.
    pub power_n2: f64,
    /// Growth of its amplitude.
    pub growth_1_s: Option<f64>,
}

/// A line that does not grow yet: the root whose margin runs out.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Foreseen {
    /// Of the root.
    pub frequency_hz: f64,
    /// What is left of its damping, 1/s.
    pub margin_1_s: f64,
}

impl From<&Margin> for Foreseen {
    fn from(margin: &Margin) -> Self {
        Self { frequency_hz: margin.frequency_hz, margin_1_s: margin.margin_1_s }
    }
}

/// What the motion controller reports of the turret.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TurretReport {
    /// When it was heard.
    pub heard_s: f64,
    /// Actual offset of each axis.
    pub offsets_m: [f64; MAX_AXES],
    /// What it does.
    pub motion: TurretMotion,
    /// Newest (epoch, sequence) that it has seen.
    pub acknowledged: Option<(u64, u64)>,
}

/// What the turret does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum TurretMotion {
    /// It stands where the last command put it.
    Reached,
    /// On the way.
    #[default]
    Moving,
    /// It did not take the last command.
    Refused,
    /// It took the last command in part.
    Limited,
    /// The last command expired.
    Expired,
}

/// Latest word on the interlocks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interlock {
    /// When it was heard.
    pub heard_s: f64,
    /// Any of them open.
    pub open: bool,
}

/// Unknown is unsafe.
impl Default for Interlock {
    fn default() -> Self {
        Self { heard_s: f64::NEG_INFINITY, open: true }
    }
}

/// A command to the turret.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Command {
    /// Grows with each start.
    pub epoch: u64,
    /// Grows with each command.
    pub sequence: u64,
    /// When it was decided.
    pub issued_s: f64,
    /// Newest sample that it rests on; its lifetime counts from here.
    pub based_on_s: f64,
    /// Lifetime.
    pub ttl_s: f64,
    /// What it asks for.
    pub kind: CommandKind,
    /// Pitch difference that the offsets make.
    pub pitch_difference_rad: f64,
    /// Pitch difference that was wanted before limits.
    pub requested_pitch_rad: f64,
    /// Offset of each axis.
    pub offsets_m: [f64; MAX_AXES],
}

/// What a command asks for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CommandKind {
    /// A new target.
    Move,
    /// The same target again, so that it does not expire.
    Renew,
    /// Back to equal pitch, to stay there.
    #[default]
    Return,
}

/// What a decision ends in.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Decision {
    /// The interval is not over.
    #[default]
    NotDue,
    /// To be recorded, guarded and sent.
    Command(Command),
    /// What would be commanded in mode act.
    Advice(Command),
    /// Nothing, and why.
    Hold(HoldReason),
}

macro_rules! hold_reasons {
    ($($(#[$doc:meta])* $name:ident => $text:literal),* $(,)?) => {
        /// Why nothing is commanded: a closed list.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum HoldReason { $($(#[$doc])* $name),* }

        impl HoldReason {
            /// All of them.
            pub const ALL: &'static [HoldReason] = &[$(HoldReason::$name),*];

            /// Name in records and metrics.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(HoldReason::$name => $text),* }
            }
        }
    };
}

hold_reasons! {
    /// Mode observe.
    Observing => "observing",
    /// There is nothing to cancel.
    NoChatter => "no_chatter",
    /// A line stands out and is not confirmed yet.
    Suspected => "suspected",
    /// The noise is not known yet.
    Learning => "learning",
    /// An interlock is open.
    InterlockOpen => "interlock_open",
    /// Nothing was heard of the interlocks within the deadline.
    InterlockUnheard => "interlock_unheard",
    /// Nothing was heard of the turret within the deadline.
    TurretSilent => "turret_silent",
    /// The newest sample is too old.
    StaleSamples => "stale_samples",
    /// A flag of the force estimate forbids acting on it.
    EstimateNotValid => "estimate_not_valid",
    /// There is a gap in the detector's window.
    WindowNotFull => "window_not_full",
    /// The spindle stands or its speed is not known.
    SpindleUnknown => "spindle_unknown",
    /// The operator asked to leave the turret alone.
    OperatorHold => "operator_hold",
    /// Intents cannot be recorded.
    StoreNotWritable => "store_not_writable",
    /// The turret refused; waiting longer after each refusal.
    TurretRefused => "turret_refused",
    /// The turret does not reach what it was told: a person must look.
    TurretNotReached => "turret_not_reached",
    /// Two pitches did not silence it: a person must look.
    HandedOver => "handed_over",
    /// The direction was changed too often.
    Hunting => "hunting",
    /// No pitch inside the limits is predicted to be stable.
    NoStablePitch => "no_stable_pitch",
    /// The needed offset lies outside of the limits.
    OutsideLimits => "outside_limits",
    /// Returned to equal pitch after stale data; a person must clear it.
    Returned => "returned",
    /// The clock ran backwards.
    ClockStepped => "clock_stepped",
    /// The last guard refused what was decided.
    Guarded => "guarded",
}

keep_list!(Mode { Observe, Advise, Act });
keep_list!(TurretMotion { Reached, Moving, Refused, Limited, Expired });
keep_list!(CommandKind { Move, Renew, Return });
keep!(Heard { phase, frequency_hz, power_n2, growth_1_s });
keep!(Foreseen { frequency_hz, margin_1_s });
keep!(Interlock { heard_s, open });

impl Keep for TurretReport {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { heard_s, offsets_m, motion, acknowledged } = self;
        heard_s.keep(to);
        offsets_m.keep(to);
        motion.keep(to);
        acknowledged.is_some().keep(to);
        // Whatever the turret says.
        acknowledged.iter().for_each(|(epoch, sequence)| to.extend([*epoch, *sequence]));
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let Self { heard_s, offsets_m, motion, acknowledged } = self;
        heard_s.restore(from)?;
        offsets_m.restore(from)?;
        motion.restore(from)?;
        let mut there = false;
        there.restore(from)?;
        *acknowledged = if there { Some((from.next_word()?, from.next_word()?)) } else { None };
        Some(())
    }
}

keep!(Situation {
    now_s,
    newest_sample_s,
    window_full,
    estimate_valid,
    heard,
    foreseen,
    spindle_speed_rpm,
    turret,
    interlock,
    mode,
    operator_hold,
    operator_acknowledge,
    store_writable,
    withheld,
    too_soon,
    diameter_m
});
keep!(Command {
    epoch,
    sequence,
    issued_s,
    based_on_s,
    ttl_s,
    kind,
    pitch_difference_rad,
    requested_pitch_rad,
    offsets_m
});

impl Keep for HoldReason {
    fn keep(&self, to: &mut Vec<u64>) {
        to.push(*self as u64);
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let word = from.next_word()?;
        *self = Self::ALL.iter().copied().find(|r| *r as u64 == word)?;
        Some(())
    }
}

impl Keep for Decision {
    fn keep(&self, to: &mut Vec<u64>) {
        match self {
            Self::NotDue => to.push(0),
            Self::Command(command) => {
                to.push(1);
                command.keep(to);
            }
            Self::Advice(command) => {
                to.push(2);
                command.keep(to);
            }
            Self::Hold(reason) => {
                to.push(3);
                reason.keep(to);
            }
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let mut command = Command::default();
        *self = match from.next_word()? {
            0 => Self::NotDue,
            1 => {
                command.restore(from)?;
                Self::Command(command)
            }
            2 => {
                command.restore(from)?;
                Self::Advice(command)
            }
            3 => {
                let mut reason = HoldReason::Observing;
                reason.restore(from)?;
                Self::Hold(reason)
            }
            _ => return None,
        };
        Some(())
    }
}
