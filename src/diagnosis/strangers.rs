//! Physics outside the vocabulary, in free forms: what explains the mismatch better than every named effect
//! says that none of them is the cause.
//!
//! Three forms compete: a resonance that some acceleration drives and that shows at an encoder, the stage or
//! the motor; a free map over velocity; a force that is position times velocity; an error of the scale over
//! position.

use super::bench::{Accepted, Bench, Score, rms};
use super::problem::Problem;
use super::shape::{Hypothesis, Shape};
use super::two_cores::on_two_cores;
use crate::plant::effects::{EffectKind as E, Port};
use rustfft::{FftPlanner, num_complex::Complex};
use std::f64::consts::PI;

/// Samples of one segment of the averaged spectra.
const SEGMENT: usize = 2048;
/// Resonances that are tried at each port.
const PEAKS: usize = 4;
/// Knots of a free map.
const KNOTS: usize = 16;
/// Forms with this share of the best one's evidence are told apart by what they leave.
const RIVAL_SHARE: f64 = 0.5;
/// Damping ratio at which a resonance is first tried.
const DAMPING_RATIO: f64 = 0.02;

/// The best of the free forms on this bench; `None`: none brings anything.
pub(crate) fn best(bench: &Bench<'_>) -> Option<Score> {
    let bank = bank(bench);
    let mut scores = on_two_cores(&bank, |h| bench.score(h));
    scores.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    scores.truncate(3);
    let refined = on_two_cores(&scores, |s| bench.refine(s));
    let most = refined.iter().map(|s| s.evidence).fold(0.0, f64::max);
    let rivals = refined.into_iter().filter(|s| s.evidence > RIVAL_SHARE * most && s.evidence > 0.0);
    rivals.min_by(|a, b| left_n(bench, a).total_cmp(&left_n(bench, b)))
}

/// What a form leaves of the balance, N rms over both sides, all frequencies alike.
///
/// The evidence is weighted by the mismatch itself: what both sides share by way of the spring counts little
/// there, and that is what tells an error of the scale from a force at the stage.
fn left_n(bench: &Bench<'_>, score: &Score) -> f64 {
    let mut with = bench.accepted.to_vec();
    with.push(Accepted::new(bench.problem, score.hypothesis.clone(), score.amplitudes.clone()));
    rms(&Bench::new(bench.problem, &with, &bench.residual()).residual())
}

fn bank(bench: &Bench<'_>) -> Vec<Hypothesis> {
    let p = bench.problem;
    let h = |port, shape| Hypothesis::new(E::ExternalDisturbance, port, shape);
    let mut list = Vec::new();
    for frequency_hz in resonances(bench) {
        for port in [Port::StageEncoder, Port::Stage, Port::Motor] {
            list.push(h(port, Shape::Resonance { frequency_hz, damping_ratio: DAMPING_RATIO }));
        }
    }
    list.push(h(Port::Stage, Shape::VelocityMap { largest_m_s: largest_velocity(p), knots: KNOTS }));
    list.push(h(Port::Stage, Shape::PositionTimesVelocity));
    let (low, high) = reach(p);
    if high - low > 1e-3 {
        let spacing_m = (high - low) / (KNOTS - 1) as f64;
        list.push(h(Port::StageEncoder, Shape::Map { first_m: low, spacing_m, knots: KNOTS, flips: false }));
    }
    list
}

fn reach(p: &Problem) -> (f64, f64) {
    p.motions
        .iter()
        .flat_map(|m| m.stage.position_m.iter())
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(*x), h.max(*x)))
}

fn largest_velocity(p: &Problem) -> f64 {
    p.motions.iter().flat_map(|m| m.stage.velocity_m_s.iter()).fold(1e-6, |l: f64, v| l.max(v.abs()))
}

/// Frequencies at which the residual follows the acceleration far more than around them.
///
/// Peaks of |S_ra|^2 / S_aa over the median of their neighbourhood.
fn resonances(bench: &Bench<'_>) -> Vec<f64> {
    let p = bench.problem;
    let residual = bench.residual();
    let mut peaks: Vec<(f64, f64)> = Vec::new();
    for stage in [false, true] {
        let mut sums = Spectra::new();
        for (m, r) in p.motions.iter().zip(&residual) {
            let side = if stage { &m.stage } else { &m.motor };
            let Some(r) = (if stage { r.stage.as_ref() } else { r.motor.as_ref() }) else { continue };
            sums.add(r, &p.thinning.pick(&side.accel_m_s2));
        }
        peaks.extend(sums.peaks(p.rate_hz(), super::motion::band_hz(p.motions[0].rate_hz)));
    }
    peaks.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<f64> = Vec::new();
    for (_, f) in peaks {
        if kept.len() < PEAKS && kept.iter().all(|k| (f / k - 1.0).abs() > 0.05) {
            kept.push(f);
        }
    }
    kept
}

struct Spectra {
    cross: Vec<Complex<f64>>,
    drive: Vec<f64>,
    window: Vec<f64>,
}

impl Spectra {
    fn new() -> Self {
        Self {
            cross: vec![Complex::new(0.0, 0.0); SEGMENT / 2],
            drive: vec![0.0; SEGMENT / 2],
            window: (0..SEGMENT).map(|k| (PI * k as f64 / SEGMENT as f64).sin().powi(2)).collect(),
        }
    }

    fn add(&mut self, residual: &[f64], accel: &[f64]) {
        let fft = FftPlanner::new().plan_fft_forward(SEGMENT);
        let transformed = |x: &[f64]| {
            let mut bins: Vec<Complex<f64>> =
                x.iter().zip(&self.window).map(|(x, w)| Complex::new(x * w, 0.0)).collect();
            fft.process(&mut bins);
            bins
        };
        let mut start = 0;
        while start + SEGMENT <= residual.len().min(accel.len()) {
            let r = transformed(&residual[start..start + SEGMENT]);
            let a = transformed(&accel[start..start + SEGMENT]);
            for k in 0..SEGMENT / 2 {
                self.cross[k] += r[k] * a[k].conj();
                self.drive[k] += a[k].norm_sqr();
            }
            start += SEGMENT / 2;
        }
    }

    /// Strength over the neighbourhood and frequency of each local peak.
    fn peaks(&self, rate_hz: f64, band_hz: f64) -> Vec<(f64, f64)> {
        let step = rate_hz / SEGMENT as f64;
        let power: Vec<f64> =
            self.cross.iter().zip(&self.drive).map(|(c, d)| c.norm_sqr() / d.max(1e-300)).collect();
        let last = ((band_hz / step) as usize).min(power.len() - 1);
        let first = ((8.0 / step) as usize).max(2);
        let median = |k: usize| {
            let mut near = power[k.saturating_sub(20).max(1)..(k + 20).min(power.len())].to_vec();
            near.sort_by(f64::total_cmp);
            near[near.len() / 2].max(1e-300)
        };
        (first..last)
            .filter(|&k| power[k] > power[k - 1] && power[k] >= power[k + 1])
            .map(|k| (power[k] / median(k), k as f64 * step))
            .collect()
    }
}
