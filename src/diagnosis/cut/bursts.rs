//! Is the random force of calm stretches normal? A loop that is linear makes a normal force of a normal one,
//! whatever its numbers; an edge that builds up and breaks off, a chip that jams, come in bursts.
//!
//! Each force, without lines of the spindle, is made white by its own spectrum; of what is left, z of unit
//! variance, the fourth cumulant is nought, and over n samples
//!
//! var sum (z^4 - 3) = 24 n sum_lag rho(lag)^4,   rho its autocorrelation.

use super::adequacy::{Left, spans};
use super::criteria::CRITERIA;
use super::force_signal::without_line;
use super::input::CutRecording;
use super::observable::{Origin, OriginKind};
use super::result::CutLocation;
use super::rows::turned_angle;
use super::spectra::without_orders;
use super::stretches::{Stretch, Stretches, band_hz, condition};
use crate::plant::effects::Port;
use crate::plant::scenario::Scenario;
use nalgebra::Complex;
use rustfft::FftPlanner;

/// Fourth cumulants of both forces of a stretch, summed over its samples, and their variance.
struct Fourth {
    /// Of each force.
    own: [f64; 2],
    /// Of both: three of one and one of the other, the mean of either way.
    both: f64,
    variance: f64,
}

/// A force of `rate_hz` made white in a band, unit variance, and the sum of the fourths of its
/// autocorrelation. Its spectrum is smoothed over a band of [`super::criteria::Criteria::left_band_hz`]; what
/// that remembers of the jump between its ends is left out.
fn white(force: &[f64], rate_hz: f64, [low, high]: [f64; 2]) -> (Vec<f64>, f64) {
    let n = force.len();
    let half = (CRITERIA.left_band_hz * n as f64 / rate_hz) as usize / 2;
    let ends = (rate_hz / CRITERIA.left_band_hz) as usize;
    let mut planner = FftPlanner::new();
    let (forward, inverse) = (planner.plan_fft_forward(n), planner.plan_fft_inverse(n));
    let mut x: Vec<Complex<f64>> = force.iter().map(|f| Complex::new(*f, 0.0)).collect();
    forward.process(&mut x);
    let power: Vec<f64> = x.iter().map(Complex::norm_sqr).collect();
    for (k, x) in x.iter_mut().enumerate() {
        let f = k.min(n - k) as f64 * rate_hz / n as f64;
        let near = (k + n - half..=k + n + half).map(|k| power[k % n]).sum::<f64>();
        let inside = f > low && f < high && near > 0.0;
        *x *= if inside { near.sqrt().recip() } else { 0.0 };
    }
    let mut correlation: Vec<Complex<f64>> = x.iter().map(|x| Complex::from(x.norm_sqr())).collect();
    inverse.process(&mut correlation);
    inverse.process(&mut x);
    let fourths = correlation.iter().map(|c| (c.re / correlation[0].re).powi(4)).sum();
    let kept = &x[ends..n - ends];
    let sd = (kept.iter().map(|z| z.re * z.re).sum::<f64>() / kept.len() as f64).sqrt();
    (kept.iter().map(|z| z.re / sd).collect(), fourths)
}

impl Fourth {
    /// `None`: a force has no spectrum in the band.
    fn of(recording: &CutRecording, stretch: &Stretch, scenario: &Scenario) -> Option<Self> {
        let rate_hz = recording.sample_rate.hz();
        let band_hz = [CRITERIA.slow_hz, band_hz(recording, scenario)[1]];
        let turned = turned_angle(recording, stretch.samples.clone());
        let turn_hz = condition(recording, stretch.samples.start, scenario).speed_rpm / 60.0;
        let mut out = Self { own: [0.0; 2], both: 0.0, variance: 0.0 };
        let whitened = |force: &Vec<f64>| {
            let mut force = without_line(&force[stretch.samples.clone()]);
            without_orders(&mut force, &turned, turn_hz, band_hz[1]);
            white(&force, rate_hz, band_hz)
        };
        let each: Vec<(Vec<f64>, f64)> = recording.forces_n.iter().flatten().map(whitened).collect();
        for ((z, fourths), own) in each.iter().zip(&mut out.own) {
            *own = z.iter().map(|z| z.powi(4) - 3.0).sum();
            out.variance += 24.0 * z.len() as f64 * fourths;
        }
        if let [(a, _), (b, _)] = &each[..] {
            let of = |(a, b): (&f64, &f64)| 0.5 * (a.powi(3) * b + a * b.powi(3)) - 3.0 * a * b;
            out.both = a.iter().zip(b).map(of).sum();
        }
        out.variance.is_finite().then_some(out)
    }
}

/// Bursts in the random force of calm stretches; `None`: it is as normal as noise.
///
/// Cost: three transforms of each force.
pub(crate) fn bursts(
    recordings: &[CutRecording],
    stretches: &Stretches,
    scenario: &Scenario,
) -> Option<Left> {
    let (mut own, mut both, mut variance) = ([0.0; 2], 0.0, 0.0);
    let mut each: Vec<(f64, Origin)> = Vec::new();
    for stretch in stretches.calm.iter().filter(|s| stretches.is_random(s)) {
        let recording = &recordings[stretch.recording];
        let Some(fourth) = Fourth::of(recording, stretch, scenario) else { continue };
        own.iter_mut().zip(fourth.own).for_each(|(sum, own)| *sum += own);
        both += fourth.both;
        variance += fourth.variance;
        let span_s = [recording.time_s(stretch.samples.start), recording.time_s(stretch.samples.end - 1)];
        let origin = Origin { kind: OriginKind::Calm, recording: Some(stretch.recording), span_s };
        each.push((fourth.own.iter().sum(), origin));
    }
    let deviation = own.iter().sum::<f64>() / f64::max(variance, f64::MIN_POSITIVE).sqrt();
    if deviation <= CRITERIA.left_sd {
        return None;
    }
    // What strikes the bar pushes it into one tool and out of the other: three of one and one of the other
    // is then less by as much as each has of its own.
    let opposed = both < -0.25 * own.iter().sum::<f64>();
    let location = CutLocation {
        port: if opposed { Port::Workpiece } else { Port::Process },
        domain: "time",
        bands_hz: Vec::new(),
        time: spans(&each),
    };
    Some(Left { location, excess_nats: 0.5 * deviation.powi(2) })
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::recording;
    use super::*;
    use crate::diagnosis::chance;

    /// What calm forces of normal noise, with pulses of `size` deviations on either tool, are taken for.
    fn found(size: [f64; 2]) -> Option<Port> {
        let scenario = Scenario::default();
        let (mut normal, mut uniform) = (chance::normal(7), chance::uniform(8));
        let mut pulse = 0.0;
        let force = |_: f64| {
            // A pulse of a millisecond now and then.
            pulse = if uniform() > 0.499 { 1.0 } else { 0.9 * pulse };
            size.map(|size| 50.0 + normal() + size * pulse)
        };
        let cuts = recording(&scenario, 4.0, force);
        let calm = vec![Stretch { recording: 0, samples: 0..cuts.len() }];
        let stretches = Stretches { calm, ..Stretches::default() };
        bursts(&[cuts], &stretches, &scenario).map(|left| left.location.port)
    }

    /// Normal noise has none, whatever it is filtered by; pulses have, and their sign says what was struck.
    #[test]
    fn bursts_are_told_from_noise_and_by_what_they_strike() {
        assert_eq!(found([0.0, 0.0]), None);
        assert_eq!(found([8.0, 0.0]), Some(Port::Process));
        assert_eq!(found([8.0, -8.0]), Some(Port::Workpiece));
    }
}
