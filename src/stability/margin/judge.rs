//! What is said of the margin: a value with its interval, or why there is none; and when it runs out.

use super::criteria::{Criteria, RECOVERED_1_S};
use crate::keyframe::{Keep, Words, keep, keep_list};
use crate::units::Z95;

/// A margin with its interval.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Margin {
    /// Minus the real part of the rightmost root, 1/s: positive dies out.
    pub margin_1_s: f64,
    /// Lower end of its 95 % interval.
    pub lo_1_s: f64,
    /// Upper end.
    pub hi_1_s: f64,
    /// Frequency of the root.
    pub frequency_hz: f64,
}

impl Margin {
    /// Standard error of the margin, 1/s: of a normal distribution with that interval.
    #[must_use]
    pub fn standard_error_1_s(&self) -> f64 {
        (self.hi_1_s - self.lo_1_s) / (2.0 * Z95)
    }
}

keep!(Margin { margin_1_s, lo_1_s, hi_1_s, frequency_hz });

/// Why a cut is not heard.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DeafReason {
    /// Without the speed the delays are not known.
    SpeedUnknown,
    /// Nor are they without the pitch of the tools: equal pitch and the best one differ in all of the margin.
    PitchUnknown,
    /// Nothing tells whether the tools are in the cut.
    CutUnknown,
    /// The measurement noise is higher than the line.
    NoiseOverLine,
    /// The interval is so wide that it says nothing.
    IntervalTooWide,
    /// No root lies in the analysis band.
    NoRootInBand,
    /// The force is not estimated rightly where the roots are.
    ForceAboveBand,
    /// The cut chatters: the vibration is not small, and its mean force is not known.
    Chatter,
}

keep_list!(DeafReason {
    SpeedUnknown => "speed_unknown",
    PitchUnknown => "pitch_unknown",
    CutUnknown => "cut_unknown",
    NoiseOverLine => "noise_over_line",
    IntervalTooWide => "interval_too_wide",
    NoRootInBand => "no_root_in_band",
    ForceAboveBand => "force_above_band",
    Chatter => "chatter",
});

/// What is said of the margin of one axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum MarginReading {
    /// Out of the cut.
    #[default]
    Air,
    /// In the cut, not enough heard yet.
    Settling,
    /// The cut cannot be heard.
    Deaf(DeafReason),
    /// A value.
    Known(Margin),
}

impl MarginReading {
    /// The value, where there is one.
    #[must_use]
    pub fn margin(&self) -> Option<&Margin> {
        match self {
            Self::Known(margin) => Some(margin),
            Self::Air | Self::Settling | Self::Deaf(_) => None,
        }
    }

    /// Its name: `air`, `settling`, `known`, or that of the reason.
    #[must_use]
    pub fn word(&self) -> &'static str {
        match self {
            Self::Air => "air",
            Self::Settling => "settling",
            Self::Known(_) => "known",
            Self::Deaf(reason) => reason.name(),
        }
    }

    /// Why the cut is not heard, where it is not.
    #[must_use]
    pub fn deaf(&self) -> Option<DeafReason> {
        match self {
            Self::Deaf(reason) => Some(*reason),
            Self::Air | Self::Settling | Self::Known(_) => None,
        }
    }
}

impl Keep for MarginReading {
    fn keep(&self, to: &mut Vec<u64>) {
        match self {
            Self::Air => to.push(0),
            Self::Settling => to.push(1),
            Self::Deaf(reason) => {
                to.push(2);
                reason.keep(to);
            }
            Self::Known(margin) => {
                to.push(3);
                margin.keep(to);
            }
        }
    }

    fn restore(&mut self, from: &mut Words<'_>) -> Option<()> {
        *self = match from.next_word()? {
            0 => Self::Air,
            1 => Self::Settling,
            2 => {
                let mut reason = DeafReason::SpeedUnknown;
                reason.restore(from)?;
                Self::Deaf(reason)
            }
            3 => {
                let mut margin = Margin::default();
                margin.restore(from)?;
                Self::Known(margin)
            }
            _ => return None,
        };
        Some(())
    }
}

/// The reading of an estimate: what is not worth saying is not said.
pub(super) fn read(margin: Margin, line_over_noise: f64, criteria: &Criteria) -> MarginReading {
    let width = margin.hi_1_s - margin.lo_1_s;
    if line_over_noise < criteria.line_over_noise {
        MarginReading::Deaf(DeafReason::NoiseOverLine)
    } else if width > criteria.widest_interval * margin.margin_1_s.max(criteria.coarse_1_s) {
        MarginReading::Deaf(DeafReason::IntervalTooWide)
    } else {
        MarginReading::Known(margin)
    }
}

/// Whether the margin has been reported as running out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Warning {
    given: bool,
}

keep!(Warning { given });

impl Warning {
    /// It was given, and the margin has not recovered since.
    pub(super) fn stands(self) -> bool {
        self.given
    }

    /// True once when the margin begins to run out; again only after it has recovered.
    pub(super) fn begins(&mut self, reading: &MarginReading, criteria: &Criteria) -> bool {
        let Some(margin) = reading.margin() else {
            self.given &= *reading != MarginReading::Air;
            return false;
        };
        if self.given {
            self.given = margin.margin_1_s < RECOVERED_1_S;
            return false;
        }
        self.given = margin.hi_1_s < criteria.warning_1_s;
        self.given && margin.margin_1_s > 0.0
    }
}
