//! `events.jsonl`: what happened, one object a line (contracts, section 4).

use crate::avoidance::pitch::optimum_pitch_rad;
use crate::chatter::ChatterEvent;
use crate::pipeline::Margin;
use crate::recording::{RecordingError, write_whole};
use crate::units::SpindleSpeed;
use serde::Serialize;
use std::path::Path;

/// One line of `events.jsonl`. `t_s` is the time of the last sample that the decision used.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EventLine {
    /// Time in the recording.
    pub t_s: f64,
    /// What happened.
    pub kind: &'static str,
    /// Axis that heard it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<String>,
    /// Frequency of the line.
    pub frequency_hz: Option<f64>,
    /// Power of the line, A^2/2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub power_n2: Option<f64>,
    /// Growth of its amplitude.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub growth_1_s: Option<f64>,
    /// Power over learned noise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub contrast: Option<f64>,
    /// Frequency before a hop.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub from_hz: Option<f64>,
    /// Pitch angle difference that would cancel it, eq. (6-10).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pitch_difference_rad: Option<f64>,
    /// What a dismissed line was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reason: Option<&'static str>,
    /// Stability margin, and the ends of its 95 % interval.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stability_margin_1_s: Option<f64>,
    /// Lower end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stability_margin_lo_1_s: Option<f64>,
    /// Upper end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stability_margin_hi_1_s: Option<f64>,
}

impl EventLine {
    fn new(t_s: f64, axis: &str, kind: &'static str) -> Self {
        Self {
            t_s,
            kind,
            axis: Some(axis.to_owned()),
            frequency_hz: None,
            power_n2: None,
            growth_1_s: None,
            contrast: None,
            from_hz: None,
            pitch_difference_rad: None,
            reason: None,
            stability_margin_1_s: None,
            stability_margin_lo_1_s: None,
            stability_margin_hi_1_s: None,
        }
    }

    /// The margin of an axis begins to run out.
    #[must_use]
    pub fn from_margin(t_s: f64, axis: &str, margin: &Margin) -> Self {
        Self {
            frequency_hz: Some(margin.frequency_hz),
            stability_margin_1_s: Some(margin.margin_1_s),
            stability_margin_lo_1_s: Some(margin.lo_1_s),
            stability_margin_hi_1_s: Some(margin.hi_1_s),
            ..Self::new(t_s, axis, "margin_warning")
        }
    }

    /// The line of an event of a monitor.
    #[must_use]
    pub fn from_chatter(t_s: f64, axis: &str, event: &ChatterEvent) -> Self {
        let mut line = Self::new(t_s, axis, "");
        match event {
            ChatterEvent::Onset(heard) => {
                line.kind = "chatter_onset";
                line.frequency_hz = Some(heard.frequency_hz);
                line.power_n2 = Some(heard.power_n2);
                line.growth_1_s = Some(heard.growth_1_s);
                line.contrast = Some(heard.contrast);
            }
            ChatterEvent::End => line.kind = "chatter_end",
            ChatterEvent::Hop { from_hz, to_hz } => {
                line.kind = "frequency_hop";
                line.frequency_hz = Some(*to_hz);
                line.from_hz = Some(*from_hz);
            }
            ChatterEvent::Dismissed(reason) => {
                line.kind = "suspicion_dismissed";
                line.reason = Some(reason.name());
            }
            ChatterEvent::CutChanged => line.kind = "cut_changed",
        }
        line
    }
}

impl EventLine {
    /// The same with the pitch that would cancel a line that has just been declared, eq. (6-10).
    #[must_use]
    pub fn with_pitch_at(mut self, spindle_speed_rpm: f64) -> Self {
        if let (Some(hz), "chatter_onset", Ok(spindle)) =
            (self.frequency_hz, self.kind, SpindleSpeed::from_rpm(spindle_speed_rpm))
        {
            self.pitch_difference_rad = optimum_pitch_rad(spindle, hz, 0).ok();
        }
        self
    }
}

/// Text of `events.jsonl`. Errors: a number that JSON cannot hold.
pub fn events_text(events: &[EventLine]) -> Result<String, serde_json::Error> {
    let mut text = String::new();
    for event in events {
        text.push_str(&serde_json::to_string(event)?);
        text.push('\n');
    }
    Ok(text)
}

/// Writes `events.jsonl`, whole or not at all.
pub fn write_events(path: &Path, events: &[EventLine]) -> Result<(), RecordingError> {
    let text = events_text(events)
        .map_err(|e| RecordingError::Format { path: path.to_owned(), message: e.to_string() })?;
    write_whole(path, text.as_bytes())
}
