//! How far an estimate can be trusted.

use std::fmt;
use std::ops::{BitOr, BitOrAssign};

/// Reasons to doubt one estimate; none set: valid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Validity(u16);

/// What an estimator states of its estimates.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Properties {
    /// By how much an estimate lags the force, s: encoder delays, stencil, window and low-pass (its delay for
    /// slow signals where it is not the same at every frequency).
    pub delay_s: f64,
    /// Samples until the filters have forgotten their start.
    pub settling_samples: usize,
    /// Standard deviation that encoder steps (of accelerometers: their noise) cause, N.
    pub noise_floor_n: f64,
    /// Band in which an estimate can be used, Hz.
    pub usable_band_hz: [f64; 2],
    /// From where on it can be used again, Hz; absent where the band is one piece.
    pub usable_above_hz: Option<f64>,
    /// Force that friction can hide on an axis that stands still, N: all that is known below it. Absent where
    /// friction plays no part.
    pub friction_bound_n: Option<f64>,
    /// Condition number of the window of spindle harmonics, or of the fit behind an estimator of
    /// accelerometers.
    pub condition: Option<f64>,
}

impl Validity {
    /// Nothing against it.
    pub const VALID: Validity = Validity(0);
    /// The filters have not yet seen enough samples.
    pub const SETTLING: Validity = Validity(1);
    /// The axis stands still and what is left is smaller than friction: not observable.
    pub const BELOW_FRICTION: Validity = Validity(1 << 1);
    /// A line of the encoder's signal period lies inside the usable band at this feed.
    pub const ENCODER_LINE_IN_BAND: Validity = Validity(1 << 2);
    /// The band reaches a mode that the model does not have: stated by it, or seen in the recording, where
    /// motor side and stretch of the screw contradict each other by more than a tenth of the force (see
    /// `two_sides`).
    pub const MODE_OUTSIDE_MODEL: Validity = Validity(1 << 3);
    /// The system of equations behind the estimate is close to singular.
    pub const ILL_CONDITIONED: Validity = Validity(1 << 4);
    /// Outside of the conditions (speed, position) that the estimator was made from.
    pub const EXTRAPOLATED: Validity = Validity(1 << 5);
    /// A signal that the method needs was not there; the last value was held.
    pub const SIGNAL_MISSING: Validity = Validity(1 << 6);
    /// The axis stands still within friction: mean and slow parts are not observable, what shakes the
    /// stage is.
    pub const MEAN_NOT_OBSERVABLE: Validity = Validity(1 << 7);

    /// A second estimator of the same force, running beside, says something else. A report, no reason to
    /// hold: the two see different bands.
    pub const ESTIMATORS_DISAGREE: Validity = Validity(1 << 8);

    /// A third of the estimate's deviation or more lies above the band in which the method is right within a
    /// tenth: its size there is not that of the force.
    pub const FORCE_ABOVE_BAND: Validity = Validity(1 << 9);

    /// Over which travel the friction of the guideway turns is neither stated nor learned, and the axis moves
    /// where that matters: the estimate holds an error within that friction.
    pub const FRICTION_TRAVEL_UNKNOWN: Validity = Validity(1 << 10);

    /// Flags that make a force unfit to act on unless somebody who knows the machine accepts them by name.
    pub const HOLDING_BY_DEFAULT: Validity = Validity(
        Self::ENCODER_LINE_IN_BAND.0
            | Self::MODE_OUTSIDE_MODEL.0
            | Self::ESTIMATORS_DISAGREE.0
            | Self::FORCE_ABOVE_BAND.0,
    );

    const NAMES: [(Validity, &'static str); 11] = [
        (Self::SETTLING, "settling"),
        (Self::BELOW_FRICTION, "below_friction"),
        (Self::ENCODER_LINE_IN_BAND, "encoder_line_in_band"),
        (Self::MODE_OUTSIDE_MODEL, "mode_outside_model"),
        (Self::ILL_CONDITIONED, "ill_conditioned"),
        (Self::EXTRAPOLATED, "extrapolated"),
        (Self::SIGNAL_MISSING, "signal_missing"),
        (Self::MEAN_NOT_OBSERVABLE, "mean_not_observable"),
        (Self::ESTIMATORS_DISAGREE, "estimators_disagree"),
        (Self::FORCE_ABOVE_BAND, "force_above_band"),
        (Self::FRICTION_TRAVEL_UNKNOWN, "friction_travel_unknown"),
    ];

    /// True when no flag is set.
    #[must_use]
    #[inline]
    pub fn is_valid(self) -> bool {
        self.0 == 0
    }

    /// True when nothing stands against acting on the estimate: a flag that warns of a line, a mode, an
    /// unseen mean or another opinion is tolerated, one that makes the number meaningless is not.
    #[must_use]
    #[inline]
    pub fn may_act(self) -> bool {
        let forbids = Self::SETTLING
            | Self::BELOW_FRICTION
            | Self::ILL_CONDITIONED
            | Self::EXTRAPOLATED
            | Self::SIGNAL_MISSING;
        !self.shares(forbids)
    }

    /// The flag of that name; none set where there is none.
    #[must_use]
    pub fn named(name: &str) -> Validity {
        Self::NAMES.into_iter().find(|(_, n)| *n == name).map_or(Self::VALID, |(flag, _)| flag)
    }

    /// True when any flag of `other` is set here.
    #[must_use]
    #[inline]
    pub fn shares(self, other: Validity) -> bool {
        self.0 & other.0 != 0
    }

    /// True when every flag of `other` is set here.
    #[must_use]
    #[inline]
    pub fn contains(self, other: Validity) -> bool {
        self.0 & other.0 == other.0
    }

    /// All but these flags.
    #[must_use]
    #[inline]
    pub fn without(self, these: Validity) -> Validity {
        Validity(self.0 & !these.0)
    }

    /// These flags alone.
    #[must_use]
    #[inline]
    pub fn only(self, these: Validity) -> Validity {
        Validity(self.0 & these.0)
    }

    /// `flag` when `condition`, else valid.
    #[must_use]
    #[inline]
    pub fn when(condition: bool, flag: Validity) -> Validity {
        if condition { flag } else { Self::VALID }
    }

    /// The flags of a number out of a file; `None`: no whole number, or a bit that has no name.
    #[must_use]
    pub fn from_number(bits: f64) -> Option<Validity> {
        let all = Self::NAMES.iter().fold(0, |all, (flag, _)| all | flag.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked below")]
        let whole = bits as u16;
        (f64::from(whole) == bits && whole & !all == 0).then_some(Validity(whole))
    }

    /// The flags as a number, for files.
    #[must_use]
    pub fn bits(self) -> u16 {
        self.0
    }

    /// All flags by name and bit, for files: "settling=1,below_friction=2,...".
    #[must_use]
    pub fn describe_bits() -> String {
        Self::NAMES.map(|(flag, name)| format!("{name}={}", flag.0)).join(",")
    }

    /// Names of the flags that are set.
    pub fn names(self) -> impl Iterator<Item = &'static str> {
        Self::NAMES.into_iter().filter(move |(flag, _)| self.contains(*flag)).map(|(_, name)| name)
    }
}

impl BitOr for Validity {
    type Output = Validity;
    #[inline]
    fn bitor(self, other: Validity) -> Validity {
        Validity(self.0 | other.0)
    }
}

impl BitOrAssign for Validity {
    #[inline]
    fn bitor_assign(&mut self, other: Validity) {
        self.0 |= other.0;
    }
}

impl fmt::Display for Validity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.is_valid() {
            return f.write_str("valid");
        }
        for (i, name) in self.names().enumerate() {
            write!(f, "{}{name}", if i == 0 { "" } else { "," })?;
        }
        Ok(())
    }
}
