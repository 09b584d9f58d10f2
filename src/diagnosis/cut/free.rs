//! The model running free under what was recorded beside the forces: when and how far it would have
//! chattered.
//!
//! Nothing is fed back from the measured forces, so that this is what no fit can bend: growth, what ends it,
//! and what the noise of a calm cut is. Random forces of several seeds say what part of a gap is chance.

use super::along::looked_up;
use super::force_signal::{filtered, signal_response, stated_filter};
use super::input::CutRecording;
use super::machine::Machine;
use super::matrix::ZERO;
use super::result::FreeFit;
use super::rows::turned_angle;
use super::stretches::{band_hz, condition};
use crate::plant::cut_terms::CutCondition;
use crate::plant::scenario::Scenario;
use crate::signal::butterworth::Butterworth;
use crate::simulation::model_cut::{CutModel, CutTrial, FreeRun, LANES, free_run};
use nalgebra::Complex;

/// The recording beside free runs of a machine before and after, each under as many random forces as run side
/// by side, in windows of a turn. `None`: the tools do not cut in it.
pub(crate) fn free_fit(recording: &CutRecording, [before, after]: [&Machine; 2]) -> Option<FreeFit> {
    let turn_s = CutCondition::of(&before.scenario).turn_s();
    let window = ((turn_s * recording.sample_rate.hz()) as usize).max(1);
    let seeds = LANES / 2;
    let cutting = |w: &usize| {
        let end = ((w + 1) * window).min(recording.len());
        recording.width_m[w * window..end].iter().all(|b| *b > 0.0)
    };
    let windows: Vec<usize> = (0..recording.len() / window).filter(cutting).collect();
    if windows.is_empty() {
        return None;
    }
    let model = |machine: &Machine, seed: usize| CutModel {
        scenario: machine.scenario,
        random_share: machine.noise.random_share,
        seed: seed as u64,
    };
    let models: Vec<CutModel> =
        [before, after].iter().flat_map(|m| (0..seeds).map(|seed| model(m, seed))).collect();
    let runs = free_run(&models, &trial(recording, &before.scenario, after.noise.pitch_rad));
    let heard = Heard::new(recording, &before.scenario);
    let floor_n2 = heard.floor_n2(after);
    let own = loudness(&heard.of(recording.forces_n.each_ref().map(|f| f.as_deref()), true), window, 0.0);
    let loud = |run: &FreeRun| {
        let forces = [0, 1].map(|j| recording.forces_n[j].as_ref().map(|_| run.force_n[j].as_slice()));
        loudness(&heard.of(forces, false), window, floor_n2)
    };
    let louds: Vec<Vec<f64>> = runs.iter().map(loud).collect();
    let recorded_n: Vec<f64> = windows.iter().map(|w| own[*w]).collect();
    let sorted = |runs: &[Vec<f64>], w: usize| {
        let mut at: Vec<f64> = runs.iter().map(|r| r[w]).collect();
        at.sort_by(f64::total_cmp);
        at
    };
    let of = |runs: &[Vec<f64>]| {
        let each: Vec<Vec<f64>> = windows.iter().map(|w| sorted(runs, *w)).collect();
        let ends = [0, seeds - 1].map(|k| each.iter().map(|at| at[k]).collect::<Vec<f64>>());
        let db = |(at, own): (&Vec<f64>, &f64)| (20.0 * (own / at[seeds / 2]).log10()).powi(2);
        let apart = each.iter().zip(&recorded_n).map(db).sum::<f64>() / windows.len() as f64;
        (ends, apart.sqrt())
    };
    let ((before_n, before_db), (after_n, after_db)) = (of(&louds[..seeds]), of(&louds[seeds..]));
    let middle = |w: &usize| recording.time_s(w * window + window / 2);
    Some(FreeFit {
        t_s: windows.iter().map(middle).collect(),
        recorded_n,
        before_n,
        after_n,
        apart_db: [before_db, after_db],
    })
}

/// What drives a free run: all that was recorded but forces and motion.
fn trial(recording: &CutRecording, scenario: &Scenario, pitch_rad: f64) -> CutTrial {
    let rate_hz = recording.sample_rate.hz();
    let held = looked_up(rate_hz);
    let at = |k: usize| {
        let at = condition(recording, k, scenario);
        let pitch_difference_rad = at.pitch_difference_rad + pitch_rad;
        CutCondition { pitch_difference_rad, ..at }
    };
    CutTrial {
        period_s: 1.0 / rate_hz,
        turned_rad: turned_angle(recording, 0..recording.len()),
        pitch_difference_rad: recording.pitch_difference_rad.iter().map(|d| d + pitch_rad).collect(),
        conditions: (0..recording.len()).step_by(held).map(at).collect(),
        held,
    }
}

/// Vibration as it is heard: from below the bar's first bending up to where the force signal still says
/// something.
struct Heard<'a> {
    recording: &'a CutRecording,
    filter: Option<Butterworth>,
    band_hz: [f64; 2],
}

impl<'a> Heard<'a> {
    fn new(recording: &'a CutRecording, scenario: &Scenario) -> Self {
        let natural = scenario.workpiece.bending_frequency_hz();
        let highest = (1.7 * natural).min(band_hz(recording, scenario)[1]);
        Self { recording, filter: stated_filter(recording), band_hz: [0.75 * natural, highest] }
    }

    /// Forces in the band; `recorded`: the signal's filter taken off.
    fn of(&self, forces: [Option<&[f64]>; 2], recorded: bool) -> Vec<Vec<f64>> {
        let gain = |f: f64| match (f >= self.band_hz[0] && f <= self.band_hz[1], recorded) {
            (false, _) => ZERO,
            (true, false) => Complex::new(1.0, 0.0),
            (true, true) => signal_response(self.filter.as_ref(), self.recording.signal.delay_s, f).finv(),
        };
        let rate_hz = self.recording.sample_rate.hz();
        forces.iter().flatten().map(|force| filtered(force, rate_hz, &gain)).collect()
    }

    /// Power of the signals' own noise in the band, its filter taken off, N^2.
    fn floor_n2(&self, machine: &Machine) -> f64 {
        let [low, high] = self.band_hz;
        let bins = 64;
        let step = (high - low) / bins as f64;
        let density = |k: usize| {
            let f = low + (k as f64 + 0.5) * step;
            let passed = signal_response(self.filter.as_ref(), 0.0, f).norm_sqr();
            machine.noise.before_filter_n2_hz(f) + machine.noise.behind_filter_n2_hz() / passed
        };
        let tools = self.recording.forces_n.iter().flatten().count() as f64;
        tools * step * (0..bins).map(density).sum::<f64>()
    }
}

/// Root mean square of forces together over windows.
fn loudness(forces: &[Vec<f64>], window: usize, floor_n2: f64) -> Vec<f64> {
    let count = forces.first().map_or(0, |f| f.len() / window);
    let power = |w: usize| {
        let sum: f64 = forces.iter().flat_map(|f| &f[w * window..(w + 1) * window]).map(|v| v * v).sum();
        sum / window as f64 + floor_n2
    };
    (0..count).map(|w| power(w).sqrt()).collect()
}
