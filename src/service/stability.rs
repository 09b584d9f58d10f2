//! Stability over the pitch angle difference, for the bar and cut of the configuration at the speed
//! that the spindle turns now.

use crate::config::service::ServiceConfig;
use crate::plant::scenario::{RawScenario, Scenario};
use crate::stability::{Grid, GridRange};
use serde::Serialize;
use std::sync::{Arc, Mutex, PoisonError};
use utoipa::ToSchema;

/// Points of a curve.
const POINTS: usize = 81;
/// Speeds are rounded to this, so that a curve serves a turning spindle.
const SPEED_STEP_RPM: f64 = 10.0;
/// Speed assumed before the spindle was heard.
const DEFAULT_SPEED_RPM: f64 = 1200.0;

/// Growth rate of the rightmost root over the pitch difference.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct StabilityCurve {
    /// Which equation, and with the tools where.
    pub chatter_model: String,
    /// Speed of the spindle, rpm.
    pub spindle_speed_rpm: f64,
    /// Pitch differences, rad.
    pub pitch_rad: Vec<f64>,
    /// Growth rate at each, 1/s; above zero chatter grows.
    pub growth_1_s: Vec<f64>,
    /// Frequency of that root at each, Hz.
    pub frequency_hz: Vec<f64>,
}

/// The last curve; one speed at a time is enough.
#[derive(Debug, Default)]
pub(super) struct CurveCache(Mutex<Option<Arc<StabilityCurve>>>);

/// The curve of a configuration at a speed. Errors: one line why there is none.
fn curve(config: &ServiceConfig, speed_rpm: f64) -> Result<StabilityCurve, String> {
    let free_end = RawScenario { speed_rpm, position_m: None, ..config.cut.raw() };
    let scenario = Scenario::new(&free_end).map_err(|e| e.to_string())?;
    let far = 1.25 * config.turret.largest_pitch_difference_rad.max(0.02);
    let mut grid = Grid::of(scenario);
    grid.pitch_rad = GridRange::new(0.0, far, POINTS).map_err(|e| e.to_string())?;
    let points = grid.evaluate(0, grid.points()).map_err(|e| e.to_string())?;
    Ok(StabilityCurve {
        chatter_model: "two opposed tools at the free end".to_owned(),
        spindle_speed_rpm: speed_rpm,
        pitch_rad: points.iter().map(|p| p.pitch_rad).collect(),
        growth_1_s: points.iter().map(|p| p.root.growth_1_s).collect(),
        frequency_hz: points.iter().map(|p| p.root.frequency_hz).collect(),
    })
}

impl CurveCache {
    /// The curve for the speed of the spindle that was heard last; computed once for each speed.
    /// Errors: one line why there is none.
    pub(super) async fn at(
        &self,
        config: &Arc<ServiceConfig>,
        spindle_speed_rpm: Option<f64>,
    ) -> Result<StabilityCurve, String> {
        let heard = spindle_speed_rpm.filter(|s| s.is_finite() && *s >= SPEED_STEP_RPM);
        let speed_rpm = (heard.unwrap_or(DEFAULT_SPEED_RPM) / SPEED_STEP_RPM).round() * SPEED_STEP_RPM;
        let cached = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        if let Some(known) = cached.filter(|c| c.spindle_speed_rpm.to_bits() == speed_rpm.to_bits()) {
            return Ok((*known).clone());
        }
        let config = Arc::clone(config);
        let made = tokio::task::spawn_blocking(move || curve(&config, speed_rpm)).await;
        let made = made.map_err(|e| e.to_string()).and_then(|c| c)?;
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(made.clone()));
        Ok(made)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::service::service_config_from_text;
    use std::path::Path;

    /// The scenario of the contract at 1200 rpm (facts, section 7): unstable at equal pitch, stable at pi.
    #[test]
    fn the_curve_has_the_known_window() {
        let curve = curve(&ServiceConfig::default(), 1200.0).unwrap();
        assert!((curve.growth_1_s[0] / 35.67 - 1.0).abs() < 0.01, "{}", curve.growth_1_s[0]);
        let optimum = std::f64::consts::PI * 20.0 / 652.0;
        let step = curve.pitch_rad[1];
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a small positive index")]
        let near = (optimum / step).round() as usize;
        assert!(curve.growth_1_s[near] < -20.0, "{}", curve.growth_1_s[near]);
    }

    /// A bar of any length is looked at with the tools at its own end.
    #[test]
    fn a_short_and_a_long_bar_have_their_curves() {
        let of = |length_m: f64| {
            let text = format!("[workpiece]\nprojection_length_m = {length_m}\n");
            let config = service_config_from_text(Path::new("c.toml"), &text).unwrap();
            assert!((config.cut.tools.position_m() - length_m).abs() < 1e-12);
            curve(&config, 1200.0).unwrap().frequency_hz[0]
        };
        assert!(of(0.160) > 1.1 * of(0.180) && of(0.180) > 1.1 * of(0.200));
    }
}
