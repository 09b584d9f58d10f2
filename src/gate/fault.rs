//! What is said of a fault.

/// What is wrong with a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum FaultKind {
    /// Repeats its last value while the axis moves.
    Held,
    /// A new value every k rows only.
    LowerRate,
    /// A row twice.
    Doubled,
    /// Rows missing.
    Dropped,
    /// Time stamps that are not even.
    IrregularTime,
    /// A step as large as what it should show.
    Rounded,
    /// Stands at its limit.
    Clipped,
    /// Single rows far off.
    Outlier,
    /// A magnitude where a signed value is expected.
    Rectified,
    /// Drives against the motion.
    WrongSign,
    /// Two columns in each other's place.
    Swapped,
    /// A speed that is not that of the travel.
    WrongScale,
    /// Earlier or later than the motion.
    ClockOffset,
    /// A moving average.
    Smoothed,
    /// A line of the mains.
    MainsLine,
    /// Hardly ever moves.
    LongRest,
    /// Always one value.
    Empty,
}

impl FaultKind {
    /// All of them.
    pub const ALL: [Self; 17] = [
        Self::Held,
        Self::LowerRate,
        Self::Doubled,
        Self::Dropped,
        Self::IrregularTime,
        Self::Rounded,
        Self::Clipped,
        Self::Outlier,
        Self::Rectified,
        Self::WrongSign,
        Self::Swapped,
        Self::WrongScale,
        Self::ClockOffset,
        Self::Smoothed,
        Self::MainsLine,
        Self::LongRest,
        Self::Empty,
    ];

    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Held => "held",
            Self::LowerRate => "lower_rate",
            Self::Doubled => "doubled",
            Self::Dropped => "dropped",
            Self::IrregularTime => "irregular_time",
            Self::Rounded => "rounded",
            Self::Clipped => "clipped",
            Self::Outlier => "outlier",
            Self::Rectified => "rectified",
            Self::WrongSign => "wrong_sign",
            Self::Swapped => "swapped",
            Self::WrongScale => "wrong_scale",
            Self::ClockOffset => "clock_offset",
            Self::Smoothed => "smoothed",
            Self::MainsLine => "mains_line",
            Self::LongRest => "long_rest",
            Self::Empty => "empty",
        }
    }
}

/// What is done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    /// Nothing can be judged from it.
    Refuse,
    /// The rows enter no fit.
    Mask,
    /// Brought to the true rate, moved in time, turned round.
    Correct,
    /// Said, and left as it is.
    Tell,
}

impl Action {
    /// Name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Refuse => "refuse",
            Self::Mask => "mask",
            Self::Correct => "correct",
            Self::Tell => "tell",
        }
    }
}

/// One fault of one column.
#[derive(Debug, Clone, PartialEq)]
pub struct Fault {
    /// Column, `t_s` for the time.
    pub column: String,
    /// What.
    pub kind: FaultKind,
    /// When, in the time of the file, s; empty where the whole column has it.
    pub time_s: Vec<[f64; 2]>,
    /// Share of the rows, 0 to 1.
    pub share: f64,
    /// What is done about it.
    pub action: Action,
    /// One sentence for a person.
    pub statement: String,
}
