//! `stillcut pitch`.

use super::bad_input;
use crate::avoidance::pitch::{optimum_pitch_rad, tool_shift, wave_phase_difference_rad};
use crate::avoidance::turret::{TurretAxis, TurretKinematics};
use crate::units::SpindleSpeed;
use std::f64::consts::{FRAC_PI_4, PI};
use std::io::Write as _;

/// Gives the optimum pitch angle difference and how far tool 1 must move for it.
///
/// Example: stillcut pitch --spindle-speed-rpm 1200 --chatter-frequency-hz 652 --diameter-mm 23.4
#[derive(clap::Args)]
pub(super) struct Arguments {
    /// Speed of the workpiece.
    #[arg(long)]
    spindle_speed_rpm: f64,
    /// Highest chatter frequency heard.
    #[arg(long)]
    chatter_frequency_hz: f64,
    /// Diameter at the tools.
    #[arg(long)]
    diameter_mm: f64,
    /// m of eq. (6-10): 0 keeps the shift, and with it the change of the rake angle, small.
    #[arg(long, default_value_t = 0)]
    lobe: u32,
    /// One JSON object instead of text.
    #[arg(long)]
    json: bool,
}

pub(super) fn run(arguments: Arguments) -> anyhow::Result<()> {
    let spindle = SpindleSpeed::from_rpm(arguments.spindle_speed_rpm).map_err(bad_input)?;
    let frequency_hz = arguments.chatter_frequency_hz;
    let pitch_rad = optimum_pitch_rad(spindle, frequency_hz, arguments.lobe).map_err(bad_input)?;
    let shift = tool_shift(arguments.diameter_mm * 1e-3, pitch_rad).map_err(bad_input)?;
    let phase_rad = wave_phase_difference_rad(spindle, frequency_hz, pitch_rad);
    let offsets = machine_of_the_thesis().map_err(bad_input)?.offsets_m(shift);
    let mut out = std::io::stdout().lock();
    if arguments.json {
        let object = serde_json::json!({
            "spindle_speed_rpm": arguments.spindle_speed_rpm,
            "chatter_frequency_hz": frequency_hz,
            "diameter_m": arguments.diameter_mm * 1e-3,
            "lobe": arguments.lobe,
            "pitch_difference_rad": pitch_rad,
            "pitch_difference_deg": pitch_rad.to_degrees(),
            "turret_shift_rad": pitch_rad / 2.0,
            "turret_shift_deg": pitch_rad.to_degrees() / 2.0,
            "wave_phase_difference_rad": phase_rad,
            "shift_toward_m": shift.toward_m,
            "shift_around_m": shift.around_m,
            "x1_offset_m": offsets[0],
            "y1_offset_m": offsets[1],
        });
        writeln!(out, "{object}")?;
        return Ok(());
    }
    writeln!(
        out,
        "pitch angle difference   {:8.2} deg   (phase of the waves {:.3} pi)",
        pitch_rad.to_degrees(),
        phase_rad / PI
    )?;
    writeln!(out, "turret 1 shift           {:8.2} deg", pitch_rad.to_degrees() / 2.0)?;
    writeln!(out, "toward the bar's axis    {:8.1} um    (dx1 of table 6-4)", shift.toward_m * 1e6)?;
    writeln!(out, "around the bar           {:8.1} um    (dy'1 of table 6-4)", shift.around_m * 1e6)?;
    writeln!(out, "axes X1, Y1 at 45 deg    {:8.1}, {:.1} um", offsets[0] * 1e6, offsets[1] * 1e6)?;
    Ok(())
}

/// X1 toward the bar, Y1 at 45 degrees to it (thesis 6.2); here only directions count.
fn machine_of_the_thesis() -> Result<TurretKinematics, crate::avoidance::turret::TurretError> {
    let axis = |index, direction_rad| TurretAxis {
        index,
        direction_rad,
        lowest_m: -1.0,
        highest_m: 1.0,
        speed_m_s: 1.0,
        acceleration_m_s2: 1.0,
    };
    TurretKinematics::new([axis(0, 0.0), axis(1, FRAC_PI_4)])
}
