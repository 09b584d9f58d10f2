//! Something that happened, as it is stored, shown, logged and counted.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

macro_rules! event_kinds {
    ($($(#[$doc:meta])* $name:ident = $word:literal, $severity:ident;)*) => {
        /// What happened. The list is closed; a new kind is a new line here.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
        #[serde(rename_all = "snake_case")]
        pub enum EventKind {
            $($(#[$doc])* $name,)*
        }

        impl EventKind {
            /// Every kind.
            pub const ALL: &[Self] = &[$(Self::$name),*];

            /// The word that stands for it in files, the API and metrics.
            #[must_use]
            pub fn word(self) -> &'static str {
                match self { $(Self::$name => $word,)* }
            }

            /// How loud it is.
            #[must_use]
            pub fn severity(self) -> Severity {
                match self { $(Self::$name => Severity::$severity,)* }
            }

            /// The kind of that word.
            #[must_use]
            pub fn from_word(word: &str) -> Option<Self> {
                match word { $($word => Some(Self::$name),)* _ => None }
            }
        }
    };
}

event_kinds! {
    /// Chatter began.
    ChatterOnset = "chatter_onset", Alarm;
    /// Chatter ended.
    ChatterEnd = "chatter_end", Info;
    /// The stability margin runs out: no chatter yet.
    MarginWarning = "margin_warning", Warning;
    /// A pitch command was decided (and, in `act`, sent).
    PitchCommand = "pitch_command", Info;
    /// The turret reached what was commanded.
    CommandReached = "command_reached", Info;
    /// The controller refused, cut or ignored a command.
    CommandFailed = "command_failed", Alarm;
    /// The turret was asked back to equal pitch.
    PitchReturn = "pitch_return", Warning;
    /// No pitch is stable at this speed; another speed is advised.
    SpeedAdvised = "speed_advised", Warning;
    /// Samples are missing.
    DataGap = "data_gap", Warning;
    /// Samples that are no numbers, or of another layout, were refused.
    DataRejected = "data_rejected", Warning;
    /// No samples come any more.
    SourceLost = "source_lost", Alarm;
    /// Samples come (again).
    SourceFound = "source_found", Info;
    /// An interlock opened.
    InterlockOpened = "interlock_opened", Warning;
    /// An interlock closed.
    InterlockClosed = "interlock_closed", Info;
    /// The mode changed.
    ModeChange = "mode_change", Warning;
    /// A person took the turret back.
    Override = "override", Warning;
    /// A person asked to leave the turret where it is, or let it go again.
    OperatorHold = "operator_hold", Warning;
    /// A latched fault stopped acting.
    Fault = "fault", Alarm;
    /// The independent monitor found a decision that breaks a rule; nothing was sent.
    InvariantViolation = "invariant_violation", Alarm;
    /// Model and machine differ more than they should.
    ModelMismatch = "model_mismatch", Warning;
    /// A cut chatters where, or as, its model cannot.
    CutMismatch = "cut_mismatch", Warning;
    /// A person cleared a latched fault.
    FaultCleared = "fault_cleared", Info;
    /// The wall clock jumped; order is kept by the place in the history.
    ClockStep = "clock_step", Warning;
    /// The token file cannot be used, or names nobody any more who may take the turret back.
    AccessLost = "access_lost", Warning;
    /// The service started.
    ServiceStart = "service_start", Info;
    /// The service ended in good order.
    ServiceStop = "service_stop", Info;
    /// The history file was damaged; it was set aside and a new one begun.
    HistoryReplaced = "history_replaced", Alarm;
    /// Damage was seen in the history file; the next start sets it aside.
    HistoryDamaged = "history_damaged", Alarm;
    /// Rows that were durable in an earlier life are missing.
    HistoryCut = "history_cut", Alarm;
    /// The disk is full: the oldest recordings went so that the history could go on.
    RecordingsRemoved = "recordings_removed", Warning;
    /// The retention removed events that still waited for a person or for the broker.
    EventsRemoved = "events_removed", Warning;
    /// The settings are others than at the start before.
    ConfigChanged = "config_changed", Warning;
    /// A recording around an event was written.
    RecordingSaved = "recording_saved", Info;
    /// A recording could not be written.
    RecordingFailed = "recording_failed", Warning;
    /// A diagnosis ended.
    DiagnosisDone = "diagnosis_done", Info;
}

/// How loud an event is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// For the record.
    Info,
    /// Something to look at.
    Warning,
    /// Needs a person's acknowledgement.
    Alarm,
}

impl Severity {
    /// The word that stands for it.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Info => "info",
            Self::Warning => "warning",
            Self::Alarm => "alarm",
        }
    }
}

/// Something that happened.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Place in the history, from 1; 0 before it is stored.
    pub sequence: i64,
    /// Unique name, given where the event arose: storing it twice stores it once.
    pub id: String,
    /// Wall clock, nanoseconds since 1970 UTC. A label: order is by `sequence`.
    pub wall_ns: i64,
    /// What happened.
    pub kind: EventKind,
    /// The axis it concerns.
    pub axis: Option<String>,
    /// Time of the newest sample it rests on, on the producer's clock, s.
    pub t_s: Option<f64>,
    /// Chatter frequency, Hz.
    pub frequency_hz: Option<f64>,
    /// Power of the strongest line, N2.
    pub power_n2: Option<f64>,
    /// Pitch angle difference, rad.
    pub pitch_difference_rad: Option<f64>,
    /// One sentence for a person.
    pub text: String,
    /// Who acknowledged it.
    pub acknowledged_by: Option<String>,
    /// When it was acknowledged.
    pub acknowledged_ns: Option<i64>,
    /// Not to be shown as an alarm before this.
    pub silenced_until_ns: Option<i64>,
    /// What a person says of an alarm: that it was right, or false.
    pub judged_right: Option<bool>,
}

/// What a library or a file says may hold line breaks; a log line and a row of a table may not.
fn in_one_line(text: String) -> String {
    if !text.contains(char::is_control) {
        return text;
    }
    let escaped = |c: char| if c.is_control() { c.escape_default().to_string() } else { c.into() };
    text.chars().map(escaped).collect()
}

impl Event {
    /// An event with nothing but its kind and sentence; line breaks and other control characters that the
    /// sentence quotes from elsewhere are escaped here.
    #[must_use]
    pub fn new(kind: EventKind, wall_ns: i64, text: impl Into<String>) -> Self {
        Self {
            sequence: 0,
            id: String::new(),
            wall_ns,
            kind,
            axis: None,
            t_s: None,
            frequency_hz: None,
            power_n2: None,
            pitch_difference_rad: None,
            text: in_one_line(text.into()),
            acknowledged_by: None,
            acknowledged_ns: None,
            silenced_until_ns: None,
            judged_right: None,
        }
    }

    /// Writes the one log line of this event.
    pub fn log(&self) {
        let (event, axis) = (self.kind.word(), self.axis.as_deref().unwrap_or(""));
        // The place is known once it is stored; the name from the start.
        let (id, seq, t_s) = (self.id.as_str(), (self.sequence > 0).then_some(self.sequence), self.t_s);
        let text = self.text.as_str();
        match self.kind.severity() {
            Severity::Info => tracing::info!(event, axis, id, seq, t_s, "{text}"),
            Severity::Warning | Severity::Alarm => tracing::warn!(event, axis, id, seq, t_s, "{text}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Event, EventKind};

    #[test]
    fn the_sentence_of_an_event_is_one_line() {
        let said = "damaged: *** in database main ***\nTree 5 page 7\u{1b}[31m";
        let text = Event::new(EventKind::HistoryDamaged, 0, said).text;
        assert_eq!(text, "damaged: *** in database main ***\\nTree 5 page 7\\u{1b}[31m");
        assert_eq!(Event::new(EventKind::Fault, 0, "Größe").text, "Größe");
    }

    #[test]
    fn every_word_leads_back_to_its_kind() {
        for kind in EventKind::ALL {
            assert_eq!(EventKind::from_word(kind.word()), Some(*kind));
            assert_eq!(serde_json::to_string(kind).unwrap(), format!("\"{}\"", kind.word()));
        }
        assert_eq!(EventKind::from_word("nonsense"), None);
    }
}
