//! A calm cut without feedback of its own, for tests: what it holds is known exactly.

use super::input::{CutRecording, ForceSignal};
use super::machine::{Machine, Noise};
use crate::plant::cut_terms::ChipMemory;
use crate::plant::scenario::Scenario;
use crate::units::SampleRate;

/// Samples per second of the recordings here.
pub(crate) const RATE_HZ: f64 = 9000.0;

/// A recording of `seconds` at the scenario's own condition, with these forces.
///
/// `force` gives both forces at a time, N; the spindle turns uniformly.
pub(crate) fn recording(
    scenario: &Scenario,
    seconds: f64,
    mut force: impl FnMut(f64) -> [f64; 2],
) -> CutRecording {
    let n = (seconds * RATE_HZ) as usize;
    let forces: Vec<[f64; 2]> = (0..n).map(|k| force(k as f64 / RATE_HZ)).collect();
    let turn = std::f64::consts::TAU * scenario.spindle.rpm() / 60.0 / RATE_HZ;
    let cutting = scenario.cutting.raw();
    CutRecording {
        experiment: "synthetic".to_owned(),
        sample_rate: SampleRate::new(RATE_HZ).expect("a rate"),
        start_s: 0.0,
        forces_n: [0, 1].map(|j| Some(forces.iter().map(|f| f[j]).collect())),
        signal: ForceSignal { bandwidth_hz: None, delay_s: 0.0 },
        signal_is_stated: true,
        spindle_angle_rad: Some((0..n).map(|k| turn * k as f64).collect()),
        speed_factor: 1.0,
        spindle_speed_rpm: vec![scenario.spindle.rpm(); n],
        tool_position_m: vec![scenario.tools.position_m(); n],
        pitch_difference_rad: vec![scenario.tools.pitch_difference_rad(); n],
        feed_m_rev: vec![cutting.feed_m_rev; n],
        width_m: vec![cutting.width_m; n],
        displacement_m: None,
        workpiece_diameter_m: None,
        missing: Vec::new(),
        masked: Vec::new(),
    }
}

/// The scenario of the contracts with next to no noise.
pub(crate) fn machine() -> Machine {
    let noise = Noise {
        random_share: 1e-6,
        corner_factor: 1.0,
        pitch_rad: 0.0,
        sensor: 1e-6,
        sensor_rise: 0.0,
        sensor_behind: 0.0,
        late_s: 0.0,
        signal_late_s: 0.0,
        bandwidth_factor: 1.0,
        probe_m: 1e-9,
        line_spread_hz: 0.5,
        growth_spread_1_s: 1.0,
        outcome_spread_1_s: 1.0,
        force_scatter: 0.02,
        cutting_gain: 1.0,
    };
    Machine { scenario: Scenario::default(), noise, memory: ChipMemory::NONE }
}
