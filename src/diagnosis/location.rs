//! Where a mismatch is: port, domain, bands, times.

use super::assemble::Case;
use super::bench::rms;
use super::floor::{SideSpectrum, spectrum};
use super::motion::{Motion, band_hz};
use super::problem::{Column, Sides};
use super::result::*;
use super::shape::Shape;
use super::terms;
use crate::plant::effects::Port;

/// A force between the sides is (1, -1): its share in their sum is at most this.
const BETWEEN_SHARE: f64 = 0.2;
/// Bins over which a residual is averaged to see what it is a function of.
const BINS: usize = 64;
/// A residual is a curve over something when this share of its power is in the curve.
const CURVE_SHARE: f64 = 0.3;

/// What a residual may be a curve over, from position and velocity.
type Abscissa<'a> = &'a dyn Fn(f64, f64) -> f64;

/// Blocks of a quarter second whose power is above a quarter of the loudest's. `powers`: time of the first
/// sample and power of each, recording by recording.
pub(super) fn loud_times(powers: &[(f64, Vec<f64>)], rate_hz: f64) -> Vec<TimeSpans> {
    let block = (0.25 * rate_hz).max(1.0) as usize;
    let block_s = block as f64 / rate_hz;
    let sums: Vec<Vec<f64>> =
        powers.iter().map(|(_, x)| x.chunks_exact(block).map(|b| b.iter().sum()).collect()).collect();
    let most = sums.iter().flatten().fold(0.0_f64, |a, b| a.max(*b));
    let mut times = Vec::new();
    for (recording, (sums, (start_s, _))) in sums.iter().zip(powers).enumerate() {
        let mut spans_s: Vec<[f64; 2]> = Vec::new();
        for (k, _) in sums.iter().enumerate().filter(|(_, power)| **power > 0.25 * most) {
            let span = [start_s + k as f64 * block_s, start_s + (k + 1) as f64 * block_s];
            match spans_s.last_mut() {
                Some(last) if (last[1] - span[0]).abs() < 1e-9 => last[1] = span[1],
                _ => spans_s.push(span),
            }
        }
        times.push(TimeSpans { recording, spans_s });
    }
    times
}

impl Case<'_> {
    pub(super) fn location(&self, verdict: Verdict, findings: &[Finding]) -> Option<Location> {
        if matches!(verdict, Verdict::ModelAdequate | Verdict::ParameterError) {
            return None;
        }
        let p = &self.outcome.state.problem;
        let band = band_hz(p.motions.first().map_or(1.0, |m| m.rate_hz));
        let first_side = spectrum(p, &self.outcome.before, false);
        let above = |s: &SideSpectrum| s.excess(band).iter().map(|e| e.1).sum::<f64>();
        let floored = |mut s: SideSpectrum, side: usize| {
            s.floor = self.spectra[side].floor.clone();
            s
        };
        let motor = floored(first_side, 0);
        let stage = floored(spectrum(p, &self.outcome.before, true), 1);
        let (em, es) = (above(&motor), above(&stage));
        let sum: Column = self.outcome.before.iter().map(summed).collect();
        let both = above(&floored(spectrum(p, &sum, false), 0));
        let total = (em + es).max(1e-300);
        let port = findings.first().map_or_else(
            || {
                let between = both < BETWEEN_SHARE * total && (0.5..2.0).contains(&(em / es.max(1e-300)));
                if between {
                    Port::Coupling
                } else if es <= em {
                    Port::Motor
                } else {
                    Port::Stage
                }
            },
            |f| f.port,
        );
        let mut bands: Vec<[f64; 2]> = motor.excess(band).iter().map(|e| e.0).collect();
        bands.extend(stage.excess(band).iter().map(|e| e.0));
        let stranger = self.outcome.stranger.as_ref().map(|s| &s.hypothesis);
        if let Some(Shape::Resonance { frequency_hz, .. }) = stranger.map(|h| &h.shape) {
            bands = vec![[0.9 * frequency_hz, 1.1 * frequency_hz]];
        }
        let unnamed = match stranger.map(|h| &h.shape) {
            Some(Shape::Resonance { .. }) => "frequency",
            Some(Shape::VelocityMap { .. } | Shape::PositionTimesVelocity) => "velocity",
            Some(Shape::Map { .. }) => "position",
            _ => self.unnamed_domain(),
        };
        Some(Location {
            port: stranger.map_or(port, |h| h.port),
            domain: findings.first().map_or(unnamed, |f| terms::domain(f.effect)),
            bands_hz: merged(bands),
            time: self.times(),
            shares: [em / total, es / total, (both / total).min(1.0)].map(|s| s.max(0.0) + 0.0),
        })
    }

    /// When the mismatch is.
    fn times(&self) -> Vec<TimeSpans> {
        let p = &self.outcome.state.problem;
        let power = |(sides, m): (&Sides, &Motion)| {
            let mut sum: Vec<f64> = Vec::new();
            for x in [&sides.motor, &sides.stage].into_iter().flatten() {
                sum.resize(x.len(), 0.0);
                sum.iter_mut().zip(x).for_each(|(s, v)| *s += v * v);
            }
            (m.time_s(p.thinning.edge()), sum)
        };
        let powers: Vec<_> = self.outcome.before.iter().zip(&p.motions).map(power).collect();
        loud_times(&powers, p.rate_hz())
    }

    /// What the residual is a curve over: position, velocity or the motor's angle; else time.
    ///
    /// Share of the power that the mean over bins holds (correlation ratio).
    fn unnamed_domain(&self) -> &'static str {
        let p = &self.outcome.state.problem;
        let lead_m = p.drive.screw_lead_m();
        let fold = |x: f64| lead_m.map_or(0.0, |lead| (x / lead).rem_euclid(1.0));
        let curves: [(&str, Abscissa<'_>); 3] = [
            ("position", &|x, _| x),
            ("velocity", &|_, v| (v / 1.0e-3).asinh()),
            ("motor_angle", &|x, _| fold(x)),
        ];
        let best =
            curves.iter().map(|(name, of)| (self.curve_share(of), *name)).max_by(|a, b| a.0.total_cmp(&b.0));
        match best {
            Some((share, name)) if share > CURVE_SHARE => name,
            _ => "time",
        }
    }

    /// Share of the residual's power, before findings, that is a curve over `of(position, velocity)`.
    fn curve_share(&self, of: Abscissa<'_>) -> f64 {
        let p = &self.outcome.state.problem;
        let abscissa: Vec<Vec<f64>> = p
            .motions
            .iter()
            .map(|m| {
                let side = &m.stage;
                let (x, v) = (p.thinning.pick(&side.position_m), p.thinning.pick(&side.velocity_m_s));
                x.iter().zip(&v).map(|(x, v)| of(*x, *v)).collect()
            })
            .collect();
        let [low, high] = abscissa
            .iter()
            .flatten()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |e, x| [e[0].min(*x), e[1].max(*x)]);
        let bin = |x: f64| (((x - low) / (high - low).max(1e-300) * BINS as f64) as usize).min(BINS - 1);
        let mut sums = [[(0.0_f64, 0.0_f64); BINS]; 2];
        for (sides, places) in self.outcome.before.iter().zip(&abscissa) {
            for (sum, series) in sums.iter_mut().zip([&sides.motor, &sides.stage]) {
                for (r, x) in series.iter().flatten().zip(places) {
                    let cell = &mut sum[bin(*x)];
                    *cell = (cell.0 + r, cell.1 + 1.0);
                }
            }
        }
        let samples: f64 = sums[0].iter().map(|c| c.1).sum();
        let explained: f64 = sums.iter().flatten().map(|c| c.0 * c.0 / c.1.max(1.0)).sum();
        explained / samples.max(1.0) / rms(&self.outcome.before).powi(2).max(1e-300)
    }
}

fn summed(s: &Sides) -> Sides {
    let motor = s.motor.as_ref().map(|m| match &s.stage {
        Some(t) => m.iter().zip(t).map(|(a, b)| a + b).collect(),
        None => m.clone(),
    });
    Sides { motor, stage: None }
}

fn merged(mut bands: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    bands.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let mut out: Vec<[f64; 2]> = Vec::new();
    for b in bands {
        match out.last_mut() {
            Some(last) if b[0] <= last[1] + 1e-9 => last[1] = last[1].max(b[1]),
            _ => out.push(b),
        }
    }
    out
}
