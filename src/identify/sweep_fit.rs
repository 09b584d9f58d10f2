//! The fit of a drive to the lines of a sweep.

use super::fitted_drive::ResponsePoint;
use super::least_squares::minimise;
use super::sweep_lines::Lines;
use super::sweep_recording::StatedErrors;
use crate::force::response::{Chain, ChainLink};
use crate::plant::drive::{DriveParams, Structure};
use nalgebra::DMatrix;
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::Range;

/// What is fitted, in the order of the parameter vector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Unknown {
    MotorMass,
    StageMass,
    Stiffness,
    StructuralDamping,
    MotorDamping,
    StageDamping,
    ScrewMass,
    TorsionalStiffness,
    TorsionalDamping,
    CommonDelay,
    StageExtraDelay,
    CurrentBandwidth,
}

pub(super) struct Fit<'a> {
    pub(super) prior: &'a DriveParams,
    lines: &'a Lines,
    pub(super) used: [bool; 2],
    pub(super) stated: StatedErrors,
    pub(super) unknowns: Vec<Unknown>,
    scale: Vec<f64>,
    start: Vec<f64>,
    pub(super) parameters: Vec<f64>,
    weights: [Vec<f64>; 2],
    /// Of the parameters, as the noise of the sweep and the misfit of the model leave it.
    covariance: Option<DMatrix<f64>>,
    count: usize,
    bandwidth_trust: f64,
    /// The responses of the whole sweep are explained: the parameters are those of the machine.
    pub(super) explained: bool,
}

/// How far a fit came.
pub(super) struct Band {
    /// Where the band ends that was fitted, Hz.
    pub(super) high_hz: f64,
    /// Where measured stands highest above fitted beyond it.
    pub(super) mode_hz: Option<f64>,
    /// Largest relative distance of measured from fitted within it.
    pub(super) misfit: f64,
}

/// Relative misfit up to which the model explains a band.
const EXPLAINED: f64 = 0.1;
/// The stated bandwidth of the current loop is believed to within this share.
const BANDWIDTH_TRUST: f64 = 0.2;
/// The same where the band had to be cut below a mode: what is left cannot tell a lag from a delay.
const BANDWIDTH_HELD: f64 = 1e-3;

/// Lines over which the noise is taken to be the same.
const NEIGHBOURS: usize = 61;

impl<'a> Fit<'a> {
    pub(super) fn new(
        prior: &'a DriveParams,
        lines: &'a Lines,
        used: [bool; 2],
        stated: StatedErrors,
    ) -> Self {
        use Unknown as U;
        let mut unknowns = match prior.structure() {
            Structure::Rigid => vec![U::StageMass, U::StageDamping],
            Structure::DualInertia => {
                vec![
                    U::MotorMass,
                    U::StageMass,
                    U::Stiffness,
                    U::StructuralDamping,
                    U::MotorDamping,
                    U::StageDamping,
                ]
            }
            Structure::TripleInertia => vec![
                U::MotorMass,
                U::StageMass,
                U::Stiffness,
                U::StructuralDamping,
                U::MotorDamping,
                U::StageDamping,
                U::ScrewMass,
                U::TorsionalStiffness,
                U::TorsionalDamping,
            ],
        };
        unknowns.push(U::CommonDelay);
        if used == [true, true] && prior.structure() != Structure::Rigid {
            unknowns.push(U::StageExtraDelay);
        }
        if prior.current_loop_bandwidth_rad_s().is_some() {
            unknowns.push(U::CurrentBandwidth);
        }
        let mut fit = Self {
            prior,
            lines,
            used,
            stated,
            unknowns,
            scale: Vec::new(),
            start: Vec::new(),
            parameters: Vec::new(),
            weights: Default::default(),
            covariance: None,
            count: lines.frequency_hz.len(),
            bandwidth_trust: BANDWIDTH_TRUST,
            explained: false,
        };
        fit.start = fit.unknowns.iter().map(|u| fit.prior_value(*u)).collect();
        fit.scale = fit.unknowns.iter().zip(&fit.start).map(|(u, p)| fit.natural_scale(*u, *p)).collect();
        fit.restart();
        fit
    }

    fn restart(&mut self) {
        self.parameters = self.start.clone();
        let n = self.lines.frequency_hz.len();
        self.weights = [vec![1.0; n], vec![1.0; n]];
        for (weights, output) in self.weights.iter_mut().zip(&self.lines.outputs) {
            let size = output.iter().map(|x| x.norm()).sum::<f64>() / n as f64;
            weights.fill(1.0 / size.max(f64::MIN_POSITIVE));
        }
    }

    pub(super) fn period_s(&self) -> f64 {
        self.lines.rate.period_s()
    }

    fn prior_value(&self, unknown: Unknown) -> f64 {
        let p = self.prior;
        let r2 = p.travel_m_rad().powi(2);
        match unknown {
            Unknown::MotorMass => p.reflected_mass_kg(),
            Unknown::StageMass if p.structure() == Structure::Rigid => p.total_mass_kg(),
            Unknown::StageMass => p.movable_mass_kg(),
            Unknown::Stiffness => p.axial_stiffness_n_m(),
            Unknown::StructuralDamping => p.structural_damping_n_s_m(),
            Unknown::MotorDamping => p.reflected_damping_n_s_m(),
            Unknown::StageDamping => p.translational_damping_n_s_m(),
            Unknown::ScrewMass => p.screw_inertia_kg_m2() / r2,
            Unknown::TorsionalStiffness => p.torsional_stiffness_nm_rad() / r2,
            Unknown::TorsionalDamping => p.torsional_damping_nm_s_rad() / r2,
            Unknown::CommonDelay if self.used[0] => p.amplifier_dead_time_s() + p.motor_encoder_delay_s(),
            Unknown::CommonDelay => p.amplifier_dead_time_s() + p.stage_encoder_delay_s(),
            Unknown::StageExtraDelay => p.stage_encoder_delay_s() - p.motor_encoder_delay_s(),
            Unknown::CurrentBandwidth => p.current_loop_bandwidth_rad_s().unwrap_or(0.0),
        }
    }

    fn natural_scale(&self, unknown: Unknown, value: f64) -> f64 {
        match unknown {
            Unknown::CommonDelay | Unknown::StageExtraDelay => self.lines.rate.period_s(),
            Unknown::StructuralDamping
            | Unknown::MotorDamping
            | Unknown::StageDamping
            | Unknown::TorsionalDamping => {
                let critical = (self.prior.axial_stiffness_n_m() * self.prior.movable_mass_kg()).sqrt();
                value.max(0.02 * critical).max(1.0)
            }
            _ => value,
        }
    }

    pub(super) fn value(&self, p: &[f64], unknown: Unknown) -> Option<f64> {
        self.unknowns.iter().position(|u| *u == unknown).map(|i| p[i])
    }

    fn chain(&self, p: &[f64]) -> Chain {
        let get = |u: Unknown| self.value(p, u).unwrap_or(0.0);
        let stage = ChainLink {
            mass_kg: get(Unknown::StageMass),
            damping_n_s_m: get(Unknown::StageDamping),
            ..ChainLink::default()
        };
        let motor = ChainLink {
            mass_kg: get(Unknown::MotorMass),
            damping_n_s_m: get(Unknown::MotorDamping),
            spring_n_m: get(Unknown::Stiffness),
            damper_n_s_m: get(Unknown::StructuralDamping),
        };
        match self.prior.structure() {
            Structure::Rigid => Chain::new(&[stage]),
            Structure::DualInertia => Chain::new(&[motor, stage]),
            Structure::TripleInertia => {
                let rotor = ChainLink {
                    spring_n_m: get(Unknown::TorsionalStiffness),
                    damper_n_s_m: get(Unknown::TorsionalDamping),
                    ..motor
                };
                let screw = ChainLink { mass_kg: get(Unknown::ScrewMass), damping_n_s_m: 0.0, ..motor };
                Chain::new(&[rotor, screw, stage])
            }
        }
    }

    /// Acceleration of motor and stage per thrust reference, as the central second difference of
    /// sampled positions sees it: hold, dead time, current loop, chain, encoder delay.
    fn response(&self, chain: &Chain, p: &[f64], frequency_hz: f64) -> [Complex64; 2] {
        let w = TAU * frequency_hz;
        let period_s = self.lines.rate.period_s();
        let hold_angle = 0.5 * w * period_s;
        let hold = hold_angle.sin() / hold_angle;
        let delay_s = self.value(p, Unknown::CommonDelay).unwrap_or(0.0) + 0.5 * period_s;
        let mut drive = Complex64::from_polar(hold, -w * delay_s);
        if let Some(bandwidth) = self.value(p, Unknown::CurrentBandwidth) {
            drive *= bandwidth / Complex64::new(bandwidth, w);
        }
        let difference = -(2.0 * hold_angle.sin() / period_s).powi(2);
        let x = chain.receptance(frequency_hz);
        let extra_s = self.value(p, Unknown::StageExtraDelay).unwrap_or(0.0);
        let late = Complex64::from_polar(1.0, -w * extra_s);
        [drive * x.motor_per_thrust * difference, drive * x.stage_per_thrust * difference * late]
    }

    fn run(&mut self, high_hz: f64) {
        self.count = self.lines.frequency_hz.partition_point(|f| *f <= high_hz);
        // Weights and parameters in turn; a change of weights moves the result little after the third.
        for _ in 0..4 {
            let solution = minimise(&self.parameters, &self.scale, |p, r| self.residuals(p, r));
            self.parameters = solution.parameters;
            self.covariance = solution.covariance;
            self.update_weights();
        }
        let dispersion = self.dispersion();
        self.covariance = self.covariance.take().map(|c| c * dispersion);
    }

    /// How much more the residuals of neighbouring lines agree than noise would: 1 for noise alone.
    ///
    /// t_b = sum w^2 e conj(h u) / sqrt(sum w^2 |h u|^2) over a band b of 61 lines; |t_b|^2 / 2 has the mean
    /// 1 where the weights are those of independent errors. What the model lacks leaves the same relative
    /// error in all lines of a band, and their covariance is short by that factor.
    /// Source: overdispersion as in McCullagh and Nelder, Generalized Linear Models, 9.2.
    /// Checked by: identify::the_noise_part_of_an_interval_holds_the_truth_in_95_of_100_repeats.
    fn dispersion(&self) -> f64 {
        let chain = self.chain(&self.parameters);
        let (mut sum, mut bands) = (0.0, 0.0);
        for from in (0..self.count).step_by(NEIGHBOURS) {
            let mut score = [Complex64::new(0.0, 0.0); 2];
            let mut power = [0.0; 2];
            for k in from..(from + NEIGHBOURS).min(self.count) {
                let h = self.response(&chain, &self.parameters, self.lines.frequency_hz[k]);
                for side in (0..2).filter(|s| self.used[*s]) {
                    let fitted = h[side] * self.lines.thrust[k];
                    let w2 = self.weights[side][k].powi(2);
                    score[side] += (self.lines.outputs[side][k] - fitted) * fitted.conj() * w2;
                    power[side] += w2 * fitted.norm_sqr();
                }
            }
            for side in (0..2).filter(|s| power[*s] > 0.0) {
                sum += 0.5 * score[side].norm_sqr() / power[side];
                bands += 1.0;
            }
        }
        if bands > 0.0 { (sum / bands).max(1.0) } else { 1.0 }
    }

    /// Standard deviation of a function of the parameters: sqrt(g^T C g), g by central differences.
    pub(super) fn deviation_of(&self, f: impl Fn(&[f64]) -> f64) -> f64 {
        let Some(c) = &self.covariance else { return f64::INFINITY };
        let gradient: Vec<f64> = (0..self.parameters.len())
            .map(|i| {
                let step = 1e-6 * self.scale[i];
                let at = |by: f64| {
                    let mut p = self.parameters.clone();
                    p[i] += by;
                    f(&p)
                };
                (at(step) - at(-step)) / (2.0 * step)
            })
            .collect();
        let mut variance = 0.0;
        for (i, gi) in gradient.iter().enumerate() {
            for (j, gj) in gradient.iter().enumerate() {
                variance += gi * gj * c[(i, j)];
            }
        }
        variance.max(0.0).sqrt()
    }

    /// The whole sweep at once. Returns the largest relative distance of measured from fitted.
    pub(super) fn whole(&mut self) -> f64 {
        let end_hz = self.lines.highest_hz();
        self.run(end_hz);
        let misfit = self.worst_misfit(end_hz);
        self.explained = misfit <= EXPLAINED;
        misfit
    }

    fn residuals(&self, p: &[f64], r: &mut Vec<f64>) {
        r.clear();
        let chain = self.chain(p);
        for k in 0..self.count {
            let h = self.response(&chain, p, self.lines.frequency_hz[k]);
            for side in 0..2 {
                if self.used[side] {
                    let e = (self.lines.outputs[side][k] - h[side] * self.lines.thrust[k])
                        * self.weights[side][k];
                    r.push(e.re);
                    r.push(e.im);
                }
            }
        }
        if let (Some(now), Some(stated)) =
            (self.value(p, Unknown::CurrentBandwidth), self.prior.current_loop_bandwidth_rad_s())
        {
            r.push((now / stated - 1.0) / self.bandwidth_trust);
        }
    }

    /// Weight = 1 / standard deviation of one component, from neighbouring residuals.
    fn update_weights(&mut self) {
        let chain = self.chain(&self.parameters);
        let errors: Vec<[f64; 2]> = (0..self.lines.frequency_hz.len())
            .map(|k| {
                let h = self.response(&chain, &self.parameters, self.lines.frequency_hz[k]);
                [0, 1].map(|s: usize| (self.lines.outputs[s][k] - h[s] * self.lines.thrust[k]).norm_sqr())
            })
            .collect();
        for side in 0..2 {
            let mut sums = vec![0.0; errors.len() + 1];
            for (k, e) in errors.iter().enumerate() {
                sums[k + 1] = sums[k] + e[side];
            }
            for k in 0..errors.len() {
                let (a, b) = (k.saturating_sub(NEIGHBOURS / 2), (k + NEIGHBOURS / 2 + 1).min(errors.len()));
                let variance = 0.5 * (sums[b] - sums[a]) / (b - a) as f64;
                self.weights[side][k] = 1.0 / variance.sqrt().max(f64::MIN_POSITIVE);
            }
        }
    }

    /// Responses averaged over bands of 3 % width, cross spectrum over input power.
    pub(super) fn points(&self) -> Vec<ResponsePoint> {
        let chain = self.chain(&self.parameters);
        let mut points = Vec::new();
        let mut from = 0;
        let f = &self.lines.frequency_hz;
        while from < f.len() {
            let to = f.partition_point(|x| *x < f[from] * 1.03).max((from + 8).min(f.len()));
            points.push(self.point(&chain, from..to));
            from = to;
        }
        points
    }

    fn point(&self, chain: &Chain, range: Range<usize>) -> ResponsePoint {
        let lines = self.lines;
        let centre = lines.frequency_hz[range.clone()].iter().sum::<f64>() / range.len() as f64;
        let mut result = [[Complex64::new(0.0, 0.0); 2]; 2];
        let mut coherence = [0.0; 2];
        let here = self.response(chain, &self.parameters, centre);
        for side in 0..2 {
            let (mut cross, mut input, mut output) = (Complex64::new(0.0, 0.0), 0.0, 0.0);
            for k in range.clone() {
                // The fitted response turns within the band (delays); take that turn out before averaging.
                let turn = self.response(chain, &self.parameters, lines.frequency_hz[k])[side] / here[side];
                let turn =
                    if turn.is_finite() && turn.norm() > 0.0 { turn } else { Complex64::new(1.0, 0.0) };
                let y = lines.outputs[side][k] / turn;
                cross += y * lines.thrust[k].conj();
                input += lines.thrust[k].norm_sqr();
                output += y.norm_sqr();
            }
            result[side] = [cross / input, here[side]];
            coherence[side] = if output > 0.0 { cross.norm_sqr() / (input * output) } else { 0.0 };
        }
        ResponsePoint { frequency_hz: centre, motor_1_kg: result[0], stage_1_kg: result[1], coherence }
    }

    /// Fits bands that grow from around the first resonance to the end of the sweep, as long as the
    /// model explains them. A band that ends earlier says where the mode is, not what the machine is:
    /// compliance and mass of a mode beyond it are in every parameter (mass 20 to 90 % off at the torsional
    /// modes of two simulated axes, with 2 to 10 % of misfit).
    pub(super) fn widen(&mut self) -> Band {
        let end_hz = self.lines.highest_hz();
        let resonance_hz = Chain::of_drive(self.prior).modes().frequencies_hz.get(1).copied().unwrap_or(0.0);
        let mut high_hz = if resonance_hz > 0.0 { (1.25 * resonance_hz).min(end_hz) } else { 0.25 * end_hz };
        let mut good = None;
        let mut misfit;
        loop {
            self.run(high_hz);
            misfit = self.worst_misfit(high_hz);
            if misfit > EXPLAINED {
                break;
            }
            good = Some(high_hz);
            if high_hz >= end_hz {
                self.explained = true;
                return Band { high_hz, mode_hz: None, misfit };
            }
            high_hz = (1.25 * high_hz).min(end_hz);
        }
        if let Some(kept_hz) = good {
            high_hz = kept_hz;
            self.restart();
            self.bandwidth_trust = BANDWIDTH_HELD;
            self.run(kept_hz);
            misfit = self.worst_misfit(kept_hz);
        }
        Band { high_hz, mode_hz: self.mode_beyond_hz(high_hz), misfit }
    }

    /// Largest relative distance of measured from fitted where the coherence says that the measurement
    /// is good; the median of three neighbours, so that a single disturbed line does not count.
    fn worst_misfit(&self, high_hz: f64) -> f64 {
        let misfit = |p: &ResponsePoint| {
            let side = |used: bool, h: [Complex64; 2], coherence: f64| {
                if used && coherence > 0.95 {
                    (h[0] - h[1]).norm() / h[1].norm().max(h[0].norm())
                } else {
                    0.0
                }
            };
            side(self.used[0], p.motor_1_kg, p.coherence[0]).max(side(
                self.used[1],
                p.stage_1_kg,
                p.coherence[1],
            ))
        };
        let values: Vec<f64> =
            self.points().iter().filter(|p| p.frequency_hz <= high_hz).map(misfit).collect();
        values.windows(3).map(|w| w[0].max(w[1]).min(w[0].max(w[2])).min(w[1].max(w[2]))).fold(0.0, f64::max)
    }

    /// Where measured stands highest above fitted beyond the band.
    fn mode_beyond_hz(&self, kept_hz: f64) -> Option<f64> {
        let points = self.points();
        let excess =
            |p: &ResponsePoint| p.motor_1_kg[0].norm() / p.motor_1_kg[1].norm().max(f64::MIN_POSITIVE);
        points
            .iter()
            .filter(|p| p.frequency_hz > 0.8 * kept_hz && p.coherence[0] > 0.8)
            .max_by(|a, b| excess(a).total_cmp(&excess(b)))
            .filter(|p| excess(p) > 1.2)
            .map(|p| p.frequency_hz)
    }
}
