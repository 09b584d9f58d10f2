//! The loop closed over passes along the bar: the tools leave at the chuck and enter again after a pause in air.

use stillcut::avoidance::Mode;
use stillcut::config::service::ServiceConfig;
use stillcut::plant::scenario::{RawScenario, Scenario};
use stillcut::simulation::closed_loop::{ClosedLoop, LoopEvent};
use stillcut::simulation::lathe::{AXES, LatheSettings, PAUSE_S};
use stillcut::units::SampleRate;

/// When chatter was told, s, in so many seconds of passes of 20 s, the turret in act.
pub(crate) fn onsets(seed: u64, seconds: f64) -> Vec<f64> {
    let raw = RawScenario { travel_m_s: -9.0e-3, ..RawScenario::default() };
    let scenario = Scenario::new(&raw).unwrap();
    let config = ServiceConfig { cut: scenario, ..ServiceConfig::default() };
    let pipeline = config.pipeline_settings(SampleRate::new(9000.0).unwrap(), &AXES.map(str::to_owned));
    let lathe = LatheSettings { pause_s: Some(PAUSE_S), ..LatheSettings::realistic(scenario, seed) };
    let mut cut = ClosedLoop::new(lathe, pipeline, Mode::Act).unwrap();
    let mut onsets = Vec::new();
    while cut.lathe().truth().t_s < seconds {
        if let Some(LoopEvent::Onset(_)) = cut.step() {
            onsets.push(cut.lathe().truth().t_s);
        }
    }
    onsets
}
