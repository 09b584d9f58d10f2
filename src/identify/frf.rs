//! The accelerometer estimator from runs with known force.
//!
//! From each run the lines at whole multiples of the spindle speed are taken; every line gives one
//! complex equation in the 18 unknowns of the two nodes around it. Least squares with two terms that
//! keep it sound: the functions are smooth over frequency, and sensor noise between the lines must
//! not be turned into force (it is, where a response divides by the square of a low frequency).
//!
//! Source: Vogl et al., eq. (2), (3). Deviation: smoothness and noise terms are ours; lines are read
//! at the exact multiple of the speed under a Hann window, not at the nearest bin.
//! Checked by: force::the_accelerometer_estimator_meets_the_range_of_unseen_passes.

use super::banded::{BandedError, BandedHermitian};
use crate::force::frf::{ACCEL_AXES, AccelSample, FrfEstimator, NODE_UNKNOWNS, TERMS, term_factors};
use crate::units::SampleRate;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
use thiserror::Error;

/// One run at one spindle speed with the force that acted.
#[derive(Debug, Clone, PartialEq)]
pub struct FrfRun {
    /// Rate.
    pub rate: SampleRate,
    /// Spindle speed, rpm.
    pub speed_rpm: f64,
    /// Accelerations, m/s2.
    pub accel: Vec<AccelSample>,
    /// Known force of the axis to estimate, N.
    pub force_n: Vec<f64>,
}

/// What may be chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrfSettings {
    /// Lowest node, Hz (below the slowest spindle turn).
    pub low_hz: f64,
    /// Highest node, Hz (below modes of the tool).
    pub high_hz: f64,
    /// Distance of nodes, Hz.
    pub spacing_hz: f64,
    /// Least ratio of a line to the noise beside it, in at least one accelerometer.
    pub least_signal_to_noise: f64,
}

impl Default for FrfSettings {
    /// 7 to 500 Hz every 5 Hz (Vogl 5); lines three times above the noise enter, weighted by their error.
    fn default() -> Self {
        Self { low_hz: 7.0, high_hz: 500.0, spacing_hz: 5.0, least_signal_to_noise: 3.0 }
    }
}

/// Why no estimator can be made.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum FrfFitError {
    /// Too few lines for the unknowns even with smoothing.
    #[error("{lines} spectral lines from {runs} runs; at least {needed} are needed for {nodes} nodes")]
    TooFewLines {
        /// Lines found.
        lines: usize,
        /// Runs.
        runs: usize,
        /// Lines needed.
        needed: usize,
        /// Nodes.
        nodes: usize,
    },
    /// All runs at one speed: no dependence on speed can be told.
    #[error(
        "the runs have {speeds} different spindle speeds; at least 3 are needed for a quadratic in speed"
    )]
    TooFewSpeeds {
        /// Different speeds.
        speeds: usize,
    },
    /// The equations are singular.
    #[error(transparent)]
    Singular(#[from] BandedError),
}

/// The estimator and how well it fits.
#[derive(Debug, Clone, PartialEq)]
pub struct FrfFit {
    /// What was made.
    pub estimator: FrfEstimator,
    /// Lines used.
    pub lines: usize,
    /// Error on runs that were left out, as a share of the force, rms over lines.
    pub heldout_error: f64,
    /// Smoothing that was best on runs left out.
    pub smoothing: f64,
}

struct Line {
    frequency_hz: f64,
    speed_rpm: f64,
    accel: [Complex64; ACCEL_AXES],
    noise: [f64; ACCEL_AXES],
    force: Complex64,
    force_noise: f64,
    /// Amplitude noise of one line to that of the band that the line stands for.
    band_factor: f64,
}

/// Amplitude and phase at one frequency under a Hann window.
fn component(x: impl Iterator<Item = f64>, n: usize, cycles_per_sample: f64) -> Complex64 {
    let step = Complex64::from_polar(1.0, -TAU * cycles_per_sample);
    let window_step = Complex64::from_polar(1.0, TAU / n as f64);
    let (mut rotor, mut window) =
        (Complex64::new(1.0, 0.0), Complex64::from_polar(1.0, 0.5 * TAU / n as f64));
    let mut sum = Complex64::new(0.0, 0.0);
    for x in x {
        sum += rotor * (x * (1.0 - window.re));
        rotor *= step;
        window *= window_step;
    }
    sum * (2.0 / n as f64)
}

fn lines_of_run(run: &FrfRun, settings: &FrfSettings) -> Vec<Line> {
    let n = run.accel.len().min(run.force_n.len());
    let turn_hz = run.speed_rpm / 60.0;
    // A Hann line is four bins wide: slower turning than that cannot be told apart.
    if n < 16 || turn_hz * n as f64 / run.rate.hz() < 4.0 {
        return Vec::new();
    }
    let high_hz = settings.high_hz.min(0.45 * run.rate.hz());
    let at = |frequency_hz: f64| {
        let cycles = frequency_hz / run.rate.hz();
        let axes = [0, 1, 2].map(|j| component(run.accel[..n].iter().map(|a| a[j]), n, cycles));
        (axes, component(run.force_n[..n].iter().copied(), n, cycles))
    };
    let seconds = n as f64 / run.rate.hz();
    let mut lines = Vec::new();
    let mut k = (settings.low_hz / turn_hz).ceil().max(1.0);
    let mut below = at((k - 0.5) * turn_hz);
    while k * turn_hz <= high_hz {
        let here = at(k * turn_hz);
        let above = at((k + 0.5) * turn_hz);
        let beside = |a: Complex64, b: Complex64| (0.5 * (a.norm_sqr() + b.norm_sqr())).sqrt();
        let noise = [0, 1, 2].map(|j| beside(below.0[j], above.0[j]));
        let heard = (0..ACCEL_AXES).any(|j| here.0[j].norm() > settings.least_signal_to_noise * noise[j]);
        if heard {
            lines.push(Line {
                frequency_hz: k * turn_hz,
                speed_rpm: run.speed_rpm,
                accel: here.0,
                noise,
                force: here.1,
                force_noise: beside(below.1, above.1),
                // Hann: 1.5 bins of noise in a line of T seconds; the line stands for turn_hz of band.
                band_factor: (turn_hz * seconds / 1.5).sqrt(),
            });
        }
        below = above;
        k += 1.0;
    }
    lines
}

/// Makes the estimator. Errors: too few lines or speeds, singular equations.
pub fn fit_frf(axis: &str, runs: &[FrfRun], settings: &FrfSettings) -> Result<FrfFit, FrfFitError> {
    let mut speeds: Vec<f64> = runs.iter().map(|r| r.speed_rpm.round()).collect();
    speeds.sort_by(f64::total_cmp);
    speeds.dedup();
    if speeds.len() < 3 {
        return Err(FrfFitError::TooFewSpeeds { speeds: speeds.len() });
    }
    let lines: Vec<Line> = runs.iter().flat_map(|run| lines_of_run(run, settings)).collect();
    let count = ((settings.high_hz - settings.low_hz) / settings.spacing_hz).ceil() as usize + 1;
    let nodes_hz: Vec<f64> = (0..count).map(|k| settings.low_hz + settings.spacing_hz * k as f64).collect();
    let needed = 2 * NODE_UNKNOWNS;
    if lines.len() < needed {
        return Err(FrfFitError::TooFewLines { lines: lines.len(), runs: runs.len(), needed, nodes: count });
    }
    let system = System::new(&lines, &nodes_hz);
    // Runs are left out by speed: a speed that was not trained must be met too.
    let fold = |line: &Line| speeds.partition_point(|s| *s < line.speed_rpm.round()) % 5 == 2;
    let mut best = (f64::INFINITY, 0.0);
    for smoothing in [3.0, 10.0, 30.0, 100.0, 300.0, 1000.0] {
        let (values, _) = system.solve(smoothing, |line| !fold(line))?;
        let error = system.error(&values, fold);
        if error < best.0 {
            best = (error, smoothing);
        }
    }
    let (values, condition) = system.solve(best.1, |_| true)?;
    let mut estimator = FrfEstimator {
        axis: axis.to_owned(),
        nodes_hz: nodes_hz.clone(),
        values,
        speed_range_rpm: [speeds[0], speeds[speeds.len() - 1]],
        noise_floor_n: 0.0,
        condition,
    };
    estimator.noise_floor_n = noise_floor_n(&estimator, &lines);
    Ok(FrfFit { estimator, lines: system.lines.len(), heldout_error: best.0, smoothing: best.1 })
}

/// sigma_F^2 = integral over the band of sum_j |H_j|^2 S_j; S_j from the noise beside the lines.
fn noise_floor_n(estimator: &FrfEstimator, lines: &[Line]) -> f64 {
    let mean = |j: usize| {
        let sum: f64 =
            lines.iter().map(|l| (l.noise[j] * l.band_factor).powi(2) / (l.speed_rpm / 60.0)).sum();
        0.5 * sum / lines.len().max(1) as f64 // amplitude squared to power, per Hz
    };
    let density = [mean(0), mean(1), mean(2)];
    let speed = 0.5 * (estimator.speed_range_rpm[0] + estimator.speed_range_rpm[1]);
    let [low, high] = estimator.band_hz();
    let mut variance = 0.0;
    let mut f = low;
    while f < high {
        let h = estimator.response_kg(f, speed);
        variance += h.iter().zip(density).map(|(h, s)| h.norm_sqr() * s).sum::<f64>();
        f += 1.0;
    }
    variance.sqrt()
}

struct System<'a> {
    lines: &'a [Line],
    nodes_hz: &'a [f64],
    /// Displacement per force, typical of each axis: brings the unknowns to like sizes, m/N.
    scale_m_n: [f64; ACCEL_AXES],
    floor: [f64; ACCEL_AXES],
}

/// Relative error of the model (between nodes and speeds) that no line's weight goes below.
const MODEL_ERROR: f64 = 0.02;
/// A tiny pull to zero where nothing is known.
const RIDGE: f64 = 1e-6;

impl<'a> System<'a> {
    fn new(lines: &'a [Line], nodes_hz: &'a [f64]) -> Self {
        let force: f64 = lines.iter().map(|l| l.force.norm()).sum();
        let scale_m_n = [0, 1, 2].map(|j| {
            let sum: f64 = lines.iter().map(|l| l.accel[j].norm() / (TAU * l.frequency_hz).powi(2)).sum();
            (sum / force).max(f64::MIN_POSITIVE)
        });
        let n = lines.len().max(1) as f64;
        let floor = [0, 1, 2].map(|j| (lines.iter().map(|l| l.noise[j].powi(2)).sum::<f64>() / n).sqrt());
        Self { lines, nodes_hz, scale_m_n, floor }
    }

    fn place(&self, frequency_hz: f64) -> (usize, f64) {
        let k = self.nodes_hz.partition_point(|f| *f <= frequency_hz).clamp(1, self.nodes_hz.len() - 1) - 1;
        (k, (frequency_hz - self.nodes_hz[k]) / (self.nodes_hz[k + 1] - self.nodes_hz[k]))
    }

    /// The 18 factors of one equation, node k first, then node k + 1, for given displacements.
    fn row(
        &self,
        line: &Line,
        displacement: &[Complex64; ACCEL_AXES],
    ) -> (usize, [Complex64; 2 * NODE_UNKNOWNS]) {
        let (k, share) = self.place(line.frequency_hz);
        let factors = term_factors(line.frequency_hz, line.speed_rpm);
        let mut row = [Complex64::new(0.0, 0.0); 2 * NODE_UNKNOWNS];
        for j in 0..ACCEL_AXES {
            for (g, factor) in factors.iter().enumerate() {
                let value = displacement[j] * factor / self.scale_m_n[j];
                row[j * TERMS + g] = value * (1.0 - share);
                row[NODE_UNKNOWNS + j * TERMS + g] = value * share;
            }
        }
        (k * NODE_UNKNOWNS, row)
    }

    fn displacement(line: &Line) -> [Complex64; ACCEL_AXES] {
        line.accel.map(|a| -a / (TAU * line.frequency_hz).powi(2))
    }

    fn weight(line: &Line) -> f64 {
        let error = MODEL_ERROR * line.force.norm();
        1.0 / (error * error + line.force_noise * line.force_noise + 2.5e-3).sqrt()
    }

    fn solve(
        &self,
        smoothing: f64,
        used: impl Fn(&Line) -> bool,
    ) -> Result<(Vec<[Complex64; NODE_UNKNOWNS]>, f64), BandedError> {
        let unknowns = self.nodes_hz.len() * NODE_UNKNOWNS;
        let mut normal = BandedHermitian::new(unknowns, 3 * NODE_UNKNOWNS - 1);
        let mut right = vec![Complex64::new(0.0, 0.0); unknowns];
        for line in self.lines.iter().filter(|l| used(l)) {
            let weight = Self::weight(line);
            let (start, row) = self.row(line, &Self::displacement(line));
            normal.add_outer(start, &row, weight * weight);
            for (i, a) in row.iter().enumerate() {
                right[start + i] += a.conj() * line.force * (weight * weight);
            }
            for j in 0..ACCEL_AXES {
                let mut noise = [Complex64::new(0.0, 0.0); ACCEL_AXES];
                noise[j].re = self.floor[j] * line.band_factor / (TAU * line.frequency_hz).powi(2);
                let (start, row) = self.row(line, &noise);
                normal.add_outer(start, &row, weight * weight);
            }
        }
        self.add_smoothness(&mut normal, smoothing);
        let (solution, condition) = normal.solve(&right)?;
        let values = solution
            .chunks_exact(NODE_UNKNOWNS)
            .map(|chunk| {
                let mut node = [Complex64::new(0.0, 0.0); NODE_UNKNOWNS];
                for (u, (value, x)) in node.iter_mut().zip(chunk).enumerate() {
                    *value = x / self.scale_m_n[u / TERMS];
                }
                node
            })
            .collect();
        Ok((values, condition))
    }

    /// Second differences over frequency are small: a response bends little over one node.
    fn add_smoothness(&self, normal: &mut BandedHermitian, smoothing: f64) {
        let one = Complex64::new(1.0, 0.0);
        for k in 0..self.nodes_hz.len() {
            for u in 0..NODE_UNKNOWNS {
                normal.add_outer(k * NODE_UNKNOWNS + u, &[one], RIDGE);
                if k + 2 < self.nodes_hz.len() {
                    let mut row = [Complex64::new(0.0, 0.0); 2 * NODE_UNKNOWNS + 1];
                    row[0] = one;
                    row[NODE_UNKNOWNS] = -2.0 * one;
                    row[2 * NODE_UNKNOWNS] = one;
                    normal.add_outer(k * NODE_UNKNOWNS + u, &row, smoothing * smoothing);
                }
            }
        }
    }

    /// Root mean square of the error over the force on the lines chosen, lines near their noise counting
    /// less: a share of the force where it stands clear of noise, less than that share where it does not.
    fn error(&self, values: &[[Complex64; NODE_UNKNOWNS]], chosen: impl Fn(&Line) -> bool) -> f64 {
        let (mut error, mut count) = (0.0, 0.0f64);
        for line in self.lines.iter().filter(|l| chosen(l)) {
            let (start, row) = self.row(line, &Self::displacement(line));
            let k = start / NODE_UNKNOWNS;
            let mut force = Complex64::new(0.0, 0.0);
            for (i, a) in row.iter().enumerate() {
                let u = i % NODE_UNKNOWNS;
                force += a * values[k + i / NODE_UNKNOWNS][u] * self.scale_m_n[u / TERMS];
            }
            error += ((force - line.force) * Self::weight(line)).norm_sqr();
            count += 1.0;
        }
        (error / count.max(1.0)).sqrt() * MODEL_ERROR
    }
}

impl FrfFit {
    /// One line for a person.
    #[must_use]
    pub fn describe(&self) -> String {
        format!(
            "{} lines, error on speeds left out {:.1} %, smoothing {}, condition {:.1e}, noise {:.2} N",
            self.lines,
            100.0 * self.heldout_error,
            self.smoothing,
            self.estimator.condition,
            self.estimator.noise_floor_n
        )
    }
}
