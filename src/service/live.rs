//! What is shown of the running service: the shapes that the API and the page see.

use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::ToSchema;

/// How far the service may go.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// Watches; decides nothing.
    #[default]
    Observe,
    /// Decides and shows what it would command; nothing leaves the process.
    Advise,
    /// Commands the turret.
    Act,
}

impl Mode {
    /// Every mode, from the most careful.
    pub const ALL: [Self; 3] = [Self::Observe, Self::Advise, Self::Act];

    /// The word that stands for it.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Observe => "observe",
            Self::Advise => "advise",
            Self::Act => "act",
        }
    }
}

/// Whether samples come.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct SourceView {
    /// Samples came within the last second.
    pub connected: bool,
    /// Wall clock of the newest sample, RFC 3339; absent before the first.
    pub last_sample_at: Option<String>,
    /// Time of the newest sample on the machine's clock, s.
    pub last_sample_t_s: Option<f64>,
    /// Samples per second that the machine announces.
    pub sample_rate_hz: Option<f64>,
    /// Spindle speed, rpm.
    pub spindle_speed_rpm: Option<f64>,
    /// Samples taken in since the start.
    pub samples: u64,
    /// Samples that never came.
    pub lost: u64,
    /// Samples refused.
    pub rejected: u64,
}

/// One axis.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct AxisView {
    /// Name.
    pub name: String,
    /// Whether its force is estimated and listened to.
    pub watched: bool,
    /// Mean of the cutting force over the last 50 ms, N; absent where it is not watched or not observable.
    pub force_mean_n: Option<f64>,
    /// Standard deviation of it, N; absent where it is not watched.
    pub force_deviation_n: Option<f64>,
    /// Largest deviation from the mean, N; absent where it is not watched.
    pub force_peak_n: Option<f64>,
    /// What speaks against the newest estimate: `valid`, the names of its flags, or `not_watched`.
    pub force_flags: String,
    /// What encoder steps (of accelerometers: their noise) alone cause, standard deviation, N; absent
    /// without an estimator.
    pub noise_floor_n: Option<f64>,
    /// By how much the estimate lags the force, s.
    pub force_delay_s: Option<f64>,
    /// Band in which the estimate is right within a tenth, Hz.
    pub usable_band_hz: Option<[f64; 2]>,
    /// From where on, up to its low-pass, it is so again, Hz; absent where the band is one piece.
    pub usable_above_hz: Option<f64>,
    /// Standard deviation of the difference to the estimator beside it over the last second, N; absent
    /// without one.
    pub disagreement_n: Option<f64>,
    /// Strongest line of the band, Hz; absent while none stands out.
    pub line_hz: Option<f64>,
    /// Damping left before chatter, 1/s: small vibration dies out as exp(-margin t). Absent while it is not
    /// known.
    pub stability_margin_1_s: Option<f64>,
    /// Lower end of its 95 % interval.
    pub stability_margin_lo_1_s: Option<f64>,
    /// Upper end.
    pub stability_margin_hi_1_s: Option<f64>,
    /// `known`; `air`, `settling`; `off` where the axis is not watched for it; or why the cut cannot be
    /// heard: `speed_unknown`, `pitch_unknown`, `cut_unknown`, `noise_over_line`, `interval_too_wide`,
    /// `no_root_in_band`, `force_above_band`, `chatter`.
    pub stability_margin_state: String,
    /// Offset that is commanded, m.
    pub offset_commanded_m: f64,
    /// Offset that the controller reports, m.
    pub offset_reported_m: Option<f64>,
}

/// Chatter.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct ChatterView {
    /// `learning`, `quiet`, `suspected`, `chatter`, or `deaf` where chatter of the bar cannot be heard.
    pub state: String,
    /// While `deaf`: `band_out_of_reach` or `force_above_band`. While `quiet` or `suspected`: what explains
    /// what stands out most: `noise`, `ring_down`, `order`, `mode`, `interference` or `above_push`.
    pub reason: Option<String>,
    /// Tracked line, Hz.
    pub frequency_hz: Option<f64>,
    /// Power of the strongest line, N2.
    pub power_n2: Option<f64>,
    /// Since when it is in this state, RFC 3339.
    pub since: Option<String>,
    /// Watched band, Hz.
    pub band_hz: Option<[f64; 2]>,
}

/// Pitch angle difference of the two tools.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct PitchView {
    /// Commanded (in `act`) or advised, rad.
    pub commanded_rad: f64,
    /// What the controller reports, rad.
    pub reported_rad: Option<f64>,
    /// Optimum for the tracked line before limits, rad.
    pub optimum_rad: Option<f64>,
    /// Largest difference that the commissioned limits allow, rad.
    pub limit_rad: f64,
    /// True when a limit cut the command.
    pub limited: bool,
    /// What the turret does: `reached`, `moving`, `refused`, `limited`, `expired` or `unknown`.
    pub turret: String,
    /// Why there is no pitch control on this stream; absent where there is.
    pub unavailable: Option<String>,
    /// Why the last interval ended without a command; absent when there was one.
    pub hold_reason: Option<String>,
    /// The pitch that stands, or in `advise` the one advised last, is of a cut that was silent then
    /// (`turret.before_chatter`).
    pub before_chatter: bool,
    /// Why the pitch stays although the stability margin of a silent cut runs out: `after_chatter`, `moving`,
    /// `margin_not_read`, `moved_enough` or `estimate_not_valid`; absent where it does not run out, where
    /// `turret.before_chatter` is off, and where no pitch in reach is better.
    pub waits: Option<String>,
    /// Nearest spindle speed at which a pitch is stable, where none is now, rpm.
    pub advised_speed_rpm: Option<f64>,
}

/// One interlock.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct InterlockView {
    /// Name.
    pub name: String,
    /// Open, or not heard within its deadline.
    pub open: bool,
}

/// History and recorder.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct StoreView {
    /// Events can be stored.
    pub healthy: bool,
    /// Events waiting to be stored.
    pub unpersisted: u64,
    /// Size of the history file, bytes.
    pub bytes: u64,
    /// Set when a damaged history was replaced at this start.
    pub replaced: Option<String>,
}

/// The whole picture at one moment.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct LiveState {
    /// Version of the program.
    pub version: String,
    /// Says what this is not.
    pub notice: String,
    /// When this was put together, RFC 3339.
    pub time: String,
    /// The same in ns since 1970.
    pub time_ns: i64,
    /// How far the service may go.
    pub mode: Mode,
    /// Grows with every change of mode; the `If-Match` of a change.
    pub mode_revision: u64,
    /// Why the mode is what it is.
    pub mode_reason: String,
    /// A latched fault that a person must clear before `act`.
    pub fault: Option<String>,
    /// A person asked to leave the turret where it is; ends with the mode.
    pub turret_held: bool,
    /// Whether samples come.
    pub source: SourceView,
    /// Axes in the order of the stream.
    pub axes: Vec<AxisView>,
    /// Chatter.
    pub chatter: ChatterView,
    /// Pitch.
    pub pitch: PitchView,
    /// Interlocks.
    pub interlocks: Vec<InterlockView>,
    /// History.
    pub store: StoreView,
    /// Alarms that nobody acknowledged or silenced.
    pub open_alarms: u64,
}

/// The newest spectrum column.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct SpectrumView {
    /// First bin, Hz.
    pub first_hz: f64,
    /// Distance of the bins, Hz.
    pub step_hz: f64,
    /// Amplitude of each bin, N.
    pub amplitude_n: Vec<f64>,
    /// Time of the newest sample in the window, s on the machine's clock.
    pub t_s: f64,
}

/// What is said of the project on every surface.
pub const NOTICE: &str = "Advice to the motion controller; not a safety function. \
    The machine must be safe with any output of this program.";

/// One message of the live stream, rendered once for all listeners.
#[derive(Debug, Clone)]
pub struct StreamMessage {
    /// Place in the history, for messages that can be resumed from.
    pub id: Option<i64>,
    /// `state`, `force`, `spectrum` or `event`.
    pub kind: &'static str,
    /// JSON.
    pub data: Arc<str>,
}

/// The level byte of an amplitude: half decibels above -80 dB re 1 N.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
pub(super) fn level(amplitude_n: f64) -> u8 {
    let decibel = 20.0 * amplitude_n.max(1e-9).log10();
    (2.0 * (decibel + 80.0)).clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::level;

    #[test]
    fn levels_are_half_decibels_above_a_tenth_of_a_millinewton() {
        assert_eq!(level(1.0), 160);
        assert_eq!(level(10.0), 200);
        assert_eq!(level(1e-4), 0);
        assert_eq!(level(0.0), 0);
        assert_eq!(level(1e6), 255);
    }
}
