//! Chatter or not, at which frequency, growing or fading: from a force (or any number series with a rate)
//! and the spindle speed, sample by sample.
//!
//! ```text
//! force --> mix the band down --> orders off at the --> whiten by the --> windows 48 .. 384 ms --> decision
//! (outliers)  (signal::DownMix)    spindle's angle      noise learned     line against all else
//! ```
//!
//! One question is asked of every window: does one line that grows or stays explain it better than everything
//! else that can be there? The answer is a log-likelihood ratio in nats, the least over named alternatives:
//! noise of unknown level and of the level learned, a ring, an order, a damped mode, a line that was switched
//! on, or one at a frequency that the pitch of the tools does not feed. Every number that decides stands in
//! `criteria`.
//!
//! It does not know what is cut or what to do about it: see `avoidance`.

mod agreement;
mod alternatives;
mod band;
mod beginning;
mod criteria;
mod cut_level;
mod decision;
mod fourier;
mod history;
mod interference;
mod lines;
mod monitor;
mod near;
mod orders;
mod outliers;
mod regeneration;
mod sub_band;
mod sustained;
mod sweep;
mod track;
mod whitening;
mod window;

pub use agreement::{Agreement, AgreementState, agree};
pub use band::{Band, BandError, predicted_band, predicted_band_in_cut};
pub use criteria::FALSE_ALARM_S;
pub(crate) use criteria::SAME_LINE_HZ;
pub use cut_level::MeanForce;
pub use monitor::{ChatterError, ChatterMonitor, ChatterSettings, ChatterState};

use crate::keyframe::{Keep, Words};

/// What a monitor says after each sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ChatterOutput {
    /// Where the decision stands.
    pub phase: Phase,
    /// Strongest line that is not a spindle order, while there is chatter or suspicion of it.
    pub frequency_hz: Option<f64>,
    /// Power of the band's strongest line (A^2/2), N^2.
    pub power_n2: f64,
    /// Power of that line over the noise learned at its place; 1 is noise.
    pub contrast: f64,
    /// Rate of growth of the line's amplitude, while there is one.
    pub growth_1_s: Option<f64>,
    /// What explains best what stands out most, other than chatter.
    pub reason: Reason,
    /// What began or ended with this sample.
    pub event: Option<ChatterEvent>,
}

/// Without the event, which belongs to one sample and is told when it happens.
impl Keep for ChatterOutput {
    fn keep(&self, to: &mut Vec<u64>) {
        let Self { phase, frequency_hz, power_n2, contrast, growth_1_s, reason, event: _ } = self;
        phase.keep(to);
        reason.keep(to);
        [frequency_hz, growth_1_s].into_iter().for_each(|x| x.keep(to));
        [power_n2, contrast].into_iter().for_each(|x| x.keep(to));
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        let Self { phase, frequency_hz, power_n2, contrast, growth_1_s, reason, event } = self;
        *event = None;
        phase.restore(from)?;
        reason.restore(from)?;
        [frequency_hz, growth_1_s].into_iter().try_for_each(|x| x.restore(from))?;
        [power_n2, contrast].into_iter().try_for_each(|x| x.restore(from))
    }
}

impl ChatterOutput {
    /// Whether chatter is declared.
    #[must_use]
    pub fn chatter(&self) -> bool {
        self.phase == Phase::Chatter
    }
}

/// Where the decision stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Phase {
    /// The noise is not known yet.
    #[default]
    Learning,
    /// Nothing but noise, orders and known lines.
    Quiet,
    /// A line stands out; it may still ring down.
    Suspected,
    /// A line stands out and stays.
    Chatter,
}

crate::keyframe::keep_list!(Phase {
    Learning => "learning",
    Quiet => "quiet",
    Suspected => "suspected",
    Chatter => "chatter",
});

/// What began or ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ChatterEvent {
    /// A line was confirmed as chatter.
    Onset(Line),
    /// The line is gone.
    End,
    /// The line jumped to another lobe.
    Hop {
        /// Before.
        from_hz: f64,
        /// After.
        to_hz: f64,
    },
    /// A line stood out and was recognised as something else.
    Dismissed(Reason),
    /// Mean force or noise changed at once: the tools entered or left the cut.
    CutChanged,
}

/// A line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Frequency.
    pub frequency_hz: f64,
    /// A^2/2.
    pub power_n2: f64,
    /// Growth of the amplitude.
    pub growth_1_s: f64,
    /// Power over learned noise.
    pub contrast: f64,
}

/// What explains what is heard nearly as well as chatter, or better: why there is no alarm.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reason {
    /// Noise, of the level that is known or of another.
    #[default]
    Noise,
    /// Something was struck and rings down.
    RingDown,
    /// An order of the spindle changed.
    Order,
    /// Noise through a damped mode.
    Mode,
    /// It was there without the cut, was switched on, moved here, or the pitch of the tools does not feed it.
    Interference,
    /// A line larger than a tool makes that only pushes.
    AbovePush,
}

crate::keyframe::keep_list!(Reason {
    Noise => "noise",
    RingDown => "ring_down",
    Order => "order",
    Mode => "mode",
    Interference => "interference",
    AbovePush => "above_push",
});
