//! What recordings say in plain residuals: mean forces, lines locked to the spindle, and the spindle's angle.

use super::criteria::CRITERIA;
use super::force_signal::{signal_response, stated_filter};
use super::input::CutRecording;
use super::machine::Machine;
use super::matrix::ZERO;
use super::observable::{Every, LeftOver, Observable, Origin, OriginKind, Part};
use super::stretches::{Stretch, condition};
use crate::plant::cut_effects::CutEffect;
use crate::plant::cut_loop::CutLoop;
use crate::plant::cut_terms::CutCondition;
use crate::plant::scenario::{Scenario, ToolCount};
use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::{PI, TAU};

/// Mean force of each tool in one calm stretch.
pub(crate) struct MeanForces {
    condition: CutCondition,
    /// Mean and its standard deviation; `None`: not recorded.
    mean: [Option<Measured>; 2],
    origin: Origin,
}

#[derive(Debug, Clone, Copy)]
struct Measured {
    value: f64,
    sd: f64,
}

fn origin(recording: &CutRecording, stretch: &Stretch, kind: OriginKind) -> Origin {
    let span_s = [recording.time_s(stretch.samples.start), recording.time_s(stretch.samples.end - 1)];
    Origin { kind, recording: Some(stretch.recording), span_s }
}

/// Forces of the tools that cut and were recorded.
fn recorded_forces<'a>(recording: &'a CutRecording, scenario: &Scenario) -> [Option<&'a [f64]>; 2] {
    let two = scenario.tools.count() == ToolCount::Two;
    [recording.forces_n[0].as_deref(), recording.forces_n[1].as_deref().filter(|_| two)]
}

impl MeanForces {
    /// sd^2 = (scatter of four parts/2)^2 + 0.03^2 + (0.002 F)^2 N^2
    pub(crate) fn new(recording: &CutRecording, stretch: &Stretch, scenario: &Scenario) -> Self {
        let range = stretch.samples.clone();
        let mean = recorded_forces(recording, scenario).map(|force| {
            force.map(|f| {
                let f = &f[range.clone()];
                let average = |x: &[f64]| x.iter().sum::<f64>() / x.len().max(1) as f64;
                let value = average(f);
                let parts: Vec<f64> = f.chunks(f.len().div_ceil(4)).map(average).collect();
                let scatter = parts.iter().map(|p| (p - value).powi(2)).sum::<f64>() / 3.0;
                let own = CRITERIA.mean_sd_n.powi(2) + (CRITERIA.mean_share * value).powi(2);
                Measured { value, sd: (scatter / 4.0 + own).sqrt() }
            })
        });
        let middle = usize::midpoint(range.start, range.end);
        Self {
            condition: condition(recording, middle, scenario),
            mean,
            origin: origin(recording, stretch, OriginKind::Means),
        }
    }
}

impl Observable for MeanForces {
    fn part(&self, machine: &Machine, _: Every) -> Part {
        let force_n = CutLoop::new(&machine.terms(&self.condition)).means().force_n;
        let row = |j: usize| self.mean[j].map(|m| (m.value - force_n[j]) / m.sd);
        Part::Rows((0..2).filter_map(row).collect())
    }

    fn left_over(&self, machine: &Machine) -> Option<LeftOver> {
        let Part::Rows(rows) = self.part(machine, Every(1)) else { return None };
        let sds: Vec<f64> = self.mean.iter().flatten().map(|m| m.sd * m.sd).collect();
        let n = sds.len().max(1) as f64;
        let recorded_n2 = rows.iter().zip(&sds).map(|(r, v)| r * r * v).sum::<f64>() / n;
        Some(LeftOver { recorded_n2, floor_n2: sds.iter().sum::<f64>() / n })
    }

    fn origin(&self) -> Origin {
        self.origin
    }
}

/// Lines of the spindle's orders in the forces of one calm stretch.
pub(crate) struct OrderLines {
    condition: CutCondition,
    /// (tool, order): force without the signal's filter, and standard deviation of either part.
    lines: Vec<OrderLine>,
    origin: Origin,
}

struct OrderLine {
    tool: usize,
    order: usize,
    line_n: Complex<f64>,
    sd_n: f64,
}

impl OrderLines {
    /// Least squares on the turned angle; the noise from the spectrum between the orders.
    pub(crate) fn new(recording: &CutRecording, stretch: &Stretch, scenario: &Scenario) -> Self {
        let range = stretch.samples.clone();
        let middle = usize::midpoint(range.start, range.end);
        let at = condition(recording, middle, scenario);
        let rate = recording.sample_rate.hz();
        let turned = turned_angle(recording, range.clone());
        let filter = stated_filter(recording);
        let mut lines = Vec::new();
        for (tool, force) in recorded_forces(recording, scenario).iter().enumerate() {
            let Some(force) = force.map(|f| &f[range.clone()]) else { continue };
            let amplitudes = order_amplitudes(&turned, force);
            for (k, line) in amplitudes.iter().enumerate() {
                let order = k + 1;
                let f = order as f64 * at.speed_rpm / 60.0;
                let noise = between_orders_n2_hz(force, rate, at.speed_rpm / 60.0, order);
                let e = signal_response(filter.as_ref(), recording.signal.delay_s, f);
                let line_n = line / e;
                let own = CRITERIA.order_sd_n.powi(2) + (CRITERIA.order_share * line_n.norm()).powi(2);
                let sd_n = (noise * rate / force.len() as f64 + own).sqrt();
                lines.push(OrderLine { tool, order, line_n, sd_n });
            }
        }
        Self { condition: at, lines, origin: origin(recording, stretch, OriginKind::Orders) }
    }
}

impl OrderLines {
    /// Sum of squares of the lines over their deviations, and how many.
    pub(crate) fn power(&self) -> [f64; 2] {
        let sum = self.lines.iter().map(|l| l.line_n.norm_sqr() / (l.sd_n * l.sd_n)).sum();
        [sum, 2.0 * self.lines.len() as f64]
    }
}

/// Angle of the spindle over a range, rad: as measured, or as commanded.
pub(crate) fn turned_angle(recording: &CutRecording, range: std::ops::Range<usize>) -> Vec<f64> {
    match &recording.spindle_angle_rad {
        Some(angle) => angle[range].to_vec(),
        None => commanded_angle(recording)[range].to_vec(),
    }
}

/// Angle that the commanded speed has turned, rad.
pub(crate) fn commanded_angle(recording: &CutRecording) -> Vec<f64> {
    let step = TAU / 60.0 / recording.sample_rate.hz();
    let mut angle = 0.0;
    recording
        .spindle_speed_rpm
        .iter()
        .map(|s| {
            let now = angle;
            angle += s * step;
            now
        })
        .collect()
}

/// Complex amplitudes c of Re(c exp(i n angle)), n from 1, with a constant beside them.
fn order_amplitudes(angle: &[f64], force: &[f64]) -> Vec<Complex<f64>> {
    let columns = 1 + 2 * CRITERIA.orders;
    let mut normal = DMatrix::zeros(columns, columns);
    let mut right = DVector::zeros(columns);
    let mut row = vec![1.0; columns];
    for (angle, force) in angle.iter().zip(force) {
        let (sin, cos) = angle.sin_cos();
        let turn = Complex::new(cos, sin);
        let mut power = turn;
        for n in 0..CRITERIA.orders {
            row[1 + 2 * n] = power.re;
            row[2 + 2 * n] = power.im;
            power *= turn;
        }
        for a in 0..columns {
            right[a] += row[a] * force;
            for b in 0..=a {
                normal[(a, b)] += row[a] * row[b];
            }
        }
    }
    let normal = DMatrix::from_fn(columns, columns, |a, b| normal[(a.max(b), a.min(b))]);
    let x = normal.lu().solve(&right).unwrap_or_else(|| DVector::zeros(columns));
    (0..CRITERIA.orders).map(|n| Complex::<f64>::new(x[1 + 2 * n], -x[2 + 2 * n])).collect()
}

/// Spectrum of a force about an order, the orders themselves left out, N^2/Hz.
fn between_orders_n2_hz(force: &[f64], rate_hz: f64, turn_hz: f64, order: usize) -> f64 {
    let n = force.len();
    let mean = force.iter().sum::<f64>() / n as f64;
    // A few bins by Goertzel would do; eight points between two orders are enough for a spectrum.
    let offsets = [-0.44, -0.36, -0.28, -0.2, 0.2, 0.28, 0.36, 0.44];
    let scale = 2.0 / (rate_hz * 0.375 * n as f64);
    let power = |f: f64| {
        let step = Complex::from_polar(1.0, -TAU * f / rate_hz);
        let mut turned = Complex::new(1.0, 0.0);
        let mut sum = ZERO;
        for (k, x) in force.iter().enumerate() {
            let window = 0.5 * (1.0 - (TAU * k as f64 / n as f64).cos());
            sum += turned * ((x - mean) * window);
            turned *= step;
        }
        sum.norm_sqr() * scale
    };
    offsets.iter().map(|o| power((order as f64 + o) * turn_hz)).sum::<f64>() / offsets.len() as f64
}

/// c_n of the relative change of a tool's force with the angle of the material:
/// F (1 + Re sum c_n exp(i n psi)).
///
/// runout: c_n = (a/b) exp(-i phase)
/// sector: c_n = (2/pi n) r sin(n sector/2) exp(-i n centre)/(1 + r sector/2pi)
fn relative_line(effect: &CutEffect, order: usize, width_m: f64) -> Complex<f64> {
    let n = order as f64;
    match effect {
        CutEffect::Runout(runout) if (runout.order - n).abs() < 0.5 => {
            Complex::from_polar(runout.amplitude_m / width_m, -runout.phase_rad)
        }
        CutEffect::StockVariation(stock) => {
            let (r, sector) = (stock.relative_change, stock.sector_rad);
            let size = 2.0 / (PI * n) * r * (n * sector / 2.0).sin() / (1.0 + r * sector / TAU);
            Complex::from_polar(1.0, -n * stock.centre_rad) * size
        }
        _ => ZERO,
    }
}

impl Observable for OrderLines {
    fn part(&self, machine: &Machine, _: Every) -> Part {
        let cut = CutLoop::new(&machine.terms(&self.condition));
        let force_n = cut.means().force_n;
        let alpha = [self.condition.pitch_difference_rad / 2.0, PI];
        let turning: Vec<CutEffect> = machine.scenario.physics.iter().collect();
        let mut rows = Vec::with_capacity(2 * self.lines.len());
        for line in &self.lines {
            let n = line.order as f64;
            let relative: Complex<f64> =
                turning.iter().map(|e| relative_line(e, line.order, self.condition.width_m)).sum();
            let foretold = if relative.norm() > 0.0 {
                let s = Complex::new(0.0, TAU * n * self.condition.speed_rpm / 60.0);
                let z = cut.closed(s);
                let driven = |j: usize| relative * force_n[j] * Complex::from_polar(1.0, -n * alpha[j]);
                z[line.tool][0] * driven(0) + z[line.tool][1] * driven(1)
            } else {
                ZERO
            };
            let left = line.line_n - foretold;
            rows.extend([left.re / line.sd_n, left.im / line.sd_n]);
        }
        Part::Rows(rows)
    }

    fn left_over(&self, machine: &Machine) -> Option<LeftOver> {
        let Part::Rows(rows) = self.part(machine, Every(1)) else { return None };
        let tools = self.lines.iter().map(|l| l.tool).max().unwrap_or(0) as f64 + 1.0;
        // Mean square of a line: half the square of its amplitude.
        let sds = self.lines.iter().flat_map(|l| [l.sd_n * l.sd_n; 2]);
        let recorded_n2 = rows.iter().zip(sds.clone()).map(|(r, v)| r * r * v / 2.0).sum::<f64>() / tools;
        Some(LeftOver { recorded_n2, floor_n2: sds.sum::<f64>() / 2.0 / tools })
    }

    fn origin(&self) -> Origin {
        self.origin
    }
}

/// The spindle's angle less what the commanded speed has turned, in one recording.
///
/// angle = commanded + (e/n) sin(n commanded + phase) + constant
pub(crate) struct SpindleAngle {
    /// Of order 1 and 2: coefficients of sine and cosine of the commanded angle, and their deviation.
    lines: Vec<AngleLine>,
    origin: Origin,
}

struct AngleLine {
    order: usize,
    sine: f64,
    cosine: f64,
    sd: f64,
}

impl SpindleAngle {
    /// `None`: the angle was not recorded.
    pub(crate) fn new(recording: &CutRecording, index: usize) -> Option<Self> {
        let measured = recording.spindle_angle_rad.as_ref()?;
        let commanded = commanded_angle(recording);
        // 900 samples a second: rounding is independent from there on.
        let stride = ((recording.sample_rate.hz() / 900.0) as usize).max(1);
        let at: Vec<usize> = (0..measured.len()).step_by(stride).collect();
        let columns = 5;
        let row = |k: usize| {
            let (s1, c1) = commanded[k].sin_cos();
            let (s2, c2) = (2.0 * commanded[k]).sin_cos();
            [1.0, s1, c1, s2, c2]
        };
        let mut normal = DMatrix::zeros(columns, columns);
        let mut right = DVector::zeros(columns);
        for k in &at {
            let row = row(*k);
            let left = measured[*k] - commanded[*k];
            for a in 0..columns {
                right[a] += row[a] * left;
                for b in 0..columns {
                    normal[(a, b)] += row[a] * row[b];
                }
            }
        }
        let x = normal.lu().solve(&right)?;
        let residual = |k: &usize| {
            let fitted: f64 = row(*k).iter().zip(x.iter()).map(|(r, x)| r * x).sum();
            (measured[*k] - commanded[*k] - fitted).powi(2)
        };
        let variance = at.iter().map(residual).sum::<f64>() / at.len() as f64;
        let sd = (2.0 * variance / at.len() as f64).sqrt().max(1e-6);
        let lines = (0..2)
            .map(|k| AngleLine { order: k + 1, sine: x[1 + 2 * k], cosine: x[2 + 2 * k], sd })
            .collect();
        let span_s = [recording.start_s, recording.time_s(recording.len() - 1)];
        let origin = Origin { kind: OriginKind::Angle, recording: Some(index), span_s };
        Some(Self { lines, origin })
    }
}

impl Observable for SpindleAngle {
    fn part(&self, machine: &Machine, _: Every) -> Part {
        let mut rows = Vec::with_capacity(4);
        for line in &self.lines {
            let (mut sine, mut cosine) = (line.sine, line.cosine);
            for effect in machine.scenario.physics.iter() {
                if let CutEffect::SpindleSpeedVariation(v) = effect
                    && (v.order - line.order as f64).abs() < 0.5
                {
                    sine -= v.relative / v.order * v.phase_rad.cos();
                    cosine -= v.relative / v.order * v.phase_rad.sin();
                }
            }
            rows.extend([sine / line.sd, cosine / line.sd]);
        }
        Part::Rows(rows)
    }

    fn origin(&self) -> Origin {
        self.origin
    }
}

#[cfg(test)]
mod tests {
    use super::super::synthetic::recording;
    use super::*;

    #[test]
    fn lines_of_the_spindle_come_back_with_size_and_phase() {
        let scenario = Scenario::default();
        let turn = TAU * scenario.spindle.rpm() / 60.0;
        let force = |t: f64| [50.0 + 2.0 * (turn * t + 0.7).cos(), 50.0 + 1.5 * (3.0 * turn * t - 0.4).cos()];
        let cuts = recording(&scenario, 1.0, force);
        let lines = OrderLines::new(&cuts, &Stretch { recording: 0, samples: 500..8500 }, &scenario);
        let of = |tool: usize, order: usize| {
            lines.lines.iter().find(|l| l.tool == tool && l.order == order).map(|l| l.line_n).expect("line")
        };
        assert!((of(0, 1) - Complex::from_polar(2.0, 0.7)).norm() < 1e-6, "{}", of(0, 1));
        assert!((of(1, 3) - Complex::from_polar(1.5, -0.4)).norm() < 1e-6, "{}", of(1, 3));
        assert!(of(0, 2).norm() < 1e-6);
    }
}
