//! Laws along the recorded motion, in time: what the cut's forces would be, and what an effect adds.
//!
//! The motion is that of the bar (and of the holder of tool 2) under the recorded forces, integrated without
//! feedback; the past surface is the same motion a delay ago. For contributions and pictures, not for fits.

use super::force_signal::{filtered, signal_response, stated_filter};
use super::input::CutRecording;
use super::rows::commanded_angle;
use super::stretches::condition;
use crate::plant::cut_effects::{AtAngle, CutEffect};
use crate::plant::cut_loop::{CutLoop, Resonance};
use crate::plant::cut_terms::CutTerms;
use crate::plant::effects::Port;
use crate::plant::scenario::{Scenario, ToolCount};
use crate::signal::butterworth::Butterworth;
use nalgebra::Complex;
use std::f64::consts::PI;

/// The condition is looked up this often, s: nothing moves far in it.
const LOOKED_UP_S: f64 = 5e-3;

/// Samples for which a condition stands.
pub(crate) fn looked_up(rate_hz: f64) -> usize {
    ((LOOKED_UP_S * rate_hz).round() as usize).max(1)
}

/// Where the inverse of the signal's filter is half given up, Hz.
const INVERTED_HZ: f64 = 1300.0;

/// Bar and holder under the recorded forces.
pub(crate) struct Motion {
    /// y, m.
    pub(crate) bar_m: Vec<f64>,
    /// y', m/s.
    pub(crate) bar_m_s: Vec<f64>,
    /// w of the holder, m.
    pub(crate) holder_m: Vec<f64>,
}

/// One resonance integrated: exact for a force that is constant over a sample.
struct Integrated {
    q: f64,
    v: f64,
    resonance: Resonance,
    step: [[f64; 2]; 2],
}

impl Integrated {
    fn at_rest(resonance: Resonance, force: f64, dt: f64) -> Self {
        let mut out = Self { q: resonance.compliance_m_n() * force, v: 0.0, resonance, step: [[0.0; 2]; 2] };
        out.tune(resonance, dt);
        out
    }

    /// Takes on other numbers, its motion kept.
    fn tune(&mut self, resonance: Resonance, dt: f64) {
        let (w, z) = (resonance.rad_s, resonance.damping_ratio);
        let damped = w * (1.0 - z * z).max(1e-12).sqrt();
        let (sin, cos) = (damped * dt).sin_cos();
        let fade = (-z * w * dt).exp();
        let (s, c) = (fade * sin / damped, fade * cos);
        self.step = [[c + z * w * s, s], [-w * w * s, c - z * w * s]];
        self.resonance = resonance;
    }

    /// One sample under a force.
    fn advance(&mut self, force: f64) {
        let rest = self.resonance.compliance_m_n() * force;
        let (q, v) = (self.q - rest, self.v);
        self.q = self.step[0][0] * q + self.step[0][1] * v + rest;
        self.v = self.step[1][0] * q + self.step[1][1] * v;
    }
}

/// The forces of a recording without their signal's filter and delay, N.
pub(crate) fn true_forces(recording: &CutRecording) -> [Vec<f64>; 2] {
    let n = recording.len();
    let rate = recording.sample_rate.hz();
    let filter = stated_filter(recording);
    let gain = |f: f64| inverse(signal_response(filter.as_ref(), recording.signal.delay_s, f), f);
    [0, 1].map(|j| match &recording.forces_n[j] {
        Some(force) => filtered(force, rate, &gain),
        None => vec![0.0; n],
    })
}

/// Inverse of a response up to the band's end; beyond it nothing is known of the force.
fn inverse(response: Complex<f64>, f: f64) -> Complex<f64> {
    if f < 2.5 * INVERTED_HZ {
        response.finv() / (1.0 + (f / INVERTED_HZ).powi(8))
    } else {
        Complex::new(0.0, 0.0)
    }
}

/// What does not change within [`LOOKED_UP_S`].
struct Now {
    terms: CutTerms,
    cut: CutLoop,
    samples: [f64; 2],
}

impl Now {
    fn at(recording: &CutRecording, scenario: &Scenario, k: usize) -> Self {
        let terms = CutTerms::of(scenario, &condition(recording, k, scenario));
        let cut = CutLoop::new(&terms);
        let samples = cut.delays_s.map(|d| d * recording.sample_rate.hz());
        Self { terms, cut, samples }
    }
}

impl Motion {
    /// The motion of a machine under the forces; at rest under the first of them before.
    pub(crate) fn under(recording: &CutRecording, scenario: &Scenario, forces: &[Vec<f64>; 2]) -> Self {
        let n = recording.len();
        let dt = 1.0 / recording.sample_rate.hz();
        let head = ((0.01 / dt) as usize).clamp(1, n.max(1));
        let first = |j: usize| forces[j].iter().take(head).sum::<f64>() / head as f64;
        let often = looked_up(1.0 / dt);
        let start = Now::at(recording, scenario, 0).cut;
        let mut bar = start.bar.map(|r| Integrated::at_rest(r, first(1) - first(0), dt));
        let mut holder = start.holder.map(|r| Integrated::at_rest(r, -first(1), dt));
        let mut out = Self {
            bar_m: Vec::with_capacity(n),
            bar_m_s: Vec::with_capacity(n),
            holder_m: Vec::with_capacity(n),
        };
        for k in 0..n {
            if k % often == 0 && k > 0 {
                let now = Now::at(recording, scenario, k).cut;
                for (part, resonance) in bar.iter_mut().zip(now.bar) {
                    // The modal motion goes on; what the tools see of it changes with the shape.
                    let seen = if part.resonance.gain_1_kg.abs() > 0.0 {
                        resonance.gain_1_kg / part.resonance.gain_1_kg
                    } else {
                        1.0
                    };
                    let seen = seen.abs().sqrt();
                    (part.q, part.v) = (part.q * seen, part.v * seen);
                    part.tune(resonance, dt);
                }
                if let (Some(part), Some(resonance)) = (&mut holder, now.holder) {
                    part.tune(resonance, dt);
                }
            }
            out.bar_m.push(bar.iter().map(|b| b.q).sum());
            out.bar_m_s.push(bar.iter().map(|b| b.v).sum());
            out.holder_m.push(holder.as_ref().map_or(0.0, |h| h.q));
            let (f1, f2) = (forces[0][k], forces[1][k]);
            bar.iter_mut().for_each(|b| b.advance(f2 - f1));
            if let Some(h) = &mut holder {
                h.advance(-f2);
            }
        }
        out
    }
}

/// Value of a series `back` samples before `k`, straight between samples; before its begin the first.
fn before(x: &[f64], k: usize, back: f64) -> f64 {
    let at = k as f64 - back;
    if at <= 0.0 {
        return x[0];
    }
    let low = at.floor() as usize;
    let part = at - low as f64;
    x[low] * (1.0 - part) + x[(low + 1).min(k)] * part
}

/// Forces of the law of a machine along a motion, N.
pub(crate) fn law_forces(recording: &CutRecording, scenario: &Scenario, motion: &Motion) -> [Vec<f64>; 2] {
    let n = recording.len();
    let two = scenario.tools.count() == ToolCount::Two;
    let dt = 1.0 / recording.sample_rate.hz();
    let angle = commanded_angle(recording);
    let effects: Vec<CutEffect> = scenario.physics.iter().collect();
    let mut out = [Vec::with_capacity(n), Vec::with_capacity(n)];
    let mut now = Now::at(recording, scenario, 0);
    let mut lagged = [0.0; 2];
    let often = looked_up(1.0 / dt);
    for k in 0..n {
        if k % often == 0 {
            now = Now::at(recording, scenario, k);
        }
        let (cut, terms) = (&now.cut, &now.terms);
        let ahead = cut.tool2_ahead_m;
        let into = [motion.bar_m[k], motion.holder_m[k] + ahead - motion.bar_m[k]];
        let holder_m_s = if k > 0 { (motion.holder_m[k] - motion.holder_m[k - 1]) / dt } else { 0.0 };
        let speed = [motion.bar_m_s[k], holder_m_s - motion.bar_m_s[k]];
        let past_bar = now.samples.map(|d| before(&motion.bar_m, k, d));
        let past = if two {
            let of_2 = before(&motion.holder_m, k, now.samples[1]) + ahead - past_bar[1];
            [of_2, past_bar[0]]
        } else {
            [past_bar[0], 0.0]
        };
        for j in 0..2 {
            let alpha = if j == 0 { terms.at.pitch_difference_rad / 2.0 } else { PI };
            let mut here = AtAngle::default();
            effects.iter().for_each(|e| e.modulate(angle[k] - alpha, &mut here));
            let width =
                if terms.at.width_m > 0.0 { (1.0 + here.width_m / terms.at.width_m).max(0.0) } else { 0.0 };
            let chip = cut.advance_m[j] + into[j] - cut.overlap * past[j];
            // The mean of the stock's factor is in the loop's numbers already.
            let factor = width * here.factor / terms.stock_factor.max(1e-9);
            let force = if (j == 1 && !two) || chip <= 0.0 || terms.at.width_m <= 0.0 {
                0.0
            } else {
                let h = cut.reference_chip_m.max(1e-12);
                let law = cut.cutting_n_m[j] * h * (chip / h).powf(cut.exponent)
                    + cut.edge_n
                    + cut.damping_n_s_m * speed[j]
                    + cut.contact_n_m * into[j];
                (factor * law).max(0.0)
            };
            let share = if cut.lag_s > 0.0 { 1.0 - (-dt / cut.lag_s).exp() } else { 1.0 };
            lagged[j] += share * (force - lagged[j]);
            out[j].push(lagged[j]);
        }
    }
    out
}

/// What an effect adds over one recording; see [`super::result::CutContribution`].
pub(crate) struct Added {
    /// Tool 1, or alone.
    pub(crate) value: Vec<f64>,
    /// Tool 2, at `process` and `force_sensor`.
    pub(crate) value_2: Option<Vec<f64>>,
}

/// A machine with the effect less the same without it, along the recorded motion.
pub(crate) fn added(recording: &CutRecording, with: &Scenario, effect: &CutEffect) -> Added {
    let without = Scenario { physics: with.physics.without(effect.kind()), ..*with };
    let difference = |a: Vec<f64>, b: &[f64]| a.iter().zip(b).map(|(a, b)| a - b).collect::<Vec<f64>>();
    match effect.port() {
        Port::Spindle => {
            let CutEffect::SpindleSpeedVariation(v) = effect else {
                return Added { value: vec![0.0; recording.len()], value_2: None };
            };
            let wobble = |a: f64| v.relative / v.order * (v.order * a + v.phase_rad).sin();
            let at_start = wobble(0.0);
            let value = commanded_angle(recording).iter().map(|a| wobble(*a) - at_start).collect();
            Added { value, value_2: None }
        }
        Port::ForceSensor => signal_added(recording, effect),
        Port::Workpiece => {
            let forces = true_forces(recording);
            let there = Motion::under(recording, with, &forces);
            let gone = Motion::under(recording, &without, &forces);
            Added { value: difference(there.bar_m, &gone.bar_m), value_2: None }
        }
        Port::Turret => {
            let forces = true_forces(recording);
            Added { value: Motion::under(recording, with, &forces).holder_m, value_2: None }
        }
        _ => {
            let motion = Motion::under(recording, with, &true_forces(recording));
            let [one, two] = law_forces(recording, with, &motion);
            let gone = law_forces(recording, &without, &motion);
            let value_2 = (with.tools.count() == ToolCount::Two).then(|| difference(two, &gone[1]));
            Added { value: difference(one, &gone[0]), value_2 }
        }
    }
}

/// Signal as it is less the signal as stated, of the same force.
fn signal_added(recording: &CutRecording, effect: &CutEffect) -> Added {
    let CutEffect::ForceSensorLag(lag) = effect else {
        return Added { value: vec![0.0; recording.len()], value_2: None };
    };
    let rate = recording.sample_rate;
    let stated = stated_filter(recording);
    let narrow = Butterworth::low_pass(4, lag.bandwidth_hz.min(0.45 * rate.hz()), rate).ok();
    let narrow = narrow.filter(|_| lag.bandwidth_hz.is_finite()).or(stated);
    let gain = |f: f64| {
        let truth = signal_response(narrow.as_ref(), lag.extra_delay_s, f);
        let said = signal_response(stated.as_ref(), 0.0, f);
        let known = inverse(Complex::new(1.0, 0.0), f);
        known - said * inverse(truth, f)
    };
    let of = |j: usize| recording.forces_n[j].as_ref().map(|f| filtered(f, rate.hz(), &gain));
    Added { value: of(0).unwrap_or_else(|| vec![0.0; recording.len()]), value_2: of(1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn a_resonance_rests_under_a_constant_force_and_rings_at_its_own() {
        let resonance = Resonance { gain_1_kg: 2.0, rad_s: TAU * 500.0, damping_ratio: 0.01 };
        let dt = 1.0 / 9000.0;
        let mut rest = Integrated::at_rest(resonance, 3.0, dt);
        let q = rest.q;
        (0..500).for_each(|_| rest.advance(3.0));
        assert!((rest.q - q).abs() < 1e-12 * q.abs().max(1e-9));
        let mut ring = Integrated::at_rest(resonance, 1.0, dt);
        let at_begin = ring.q;
        // 36 periods of the damped vibration later: exp(-zeta w t) of it.
        let t = 36.0 / (500.0 * (1.0f64 - 1e-4).sqrt());
        let steps = 648;
        ring.tune(resonance, t / f64::from(steps));
        (0..steps).for_each(|_| ring.advance(0.0));
        assert!(
            (ring.q / at_begin - (-0.01 * resonance.rad_s * t).exp()).abs() < 1e-6,
            "{}",
            ring.q / at_begin
        );
    }
}
