//! The fit of a drive to the lines of a sweep.

use super::least_squares::minimise;
use super::sweep::{FittedParameter, ResponsePoint};
use super::sweep_lines::Lines;
use crate::force::response::{Chain, ChainLink};
use crate::plant::drive::{DriveParams, RawDriveParams, Structure};
use rustfft::num_complex::Complex64;
use std::f64::consts::TAU;
use std::ops::Range;

/// What is fitted, in the order of the parameter vector.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Unknown {
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
    prior: &'a DriveParams,
    lines: &'a Lines,
    used: [bool; 2],
    unknowns: Vec<Unknown>,
    scale: Vec<f64>,
    start: Vec<f64>,
    parameters: Vec<f64>,
    weights: [Vec<f64>; 2],
    standard_errors: Vec<f64>,
    count: usize,
    bandwidth_trust: f64,
    /// Relative misfit where the model explains no band at all, else 0: as uncertain is every parameter.
    unexplained: f64,
}

/// Relative misfit up to which the model explains a band.
const EXPLAINED: f64 = 0.1;
/// The stated torque constant is believed to within this share; masses, stiffness and damping scale with it.
const TORQUE_CONSTANT_TRUST: f64 = 0.005;
/// Share of a sample within which the instants are known at which a drive takes its reference and its
/// encoders.
const TIMING_TRUST: f64 = 0.1;
/// A current loop is a first-order lag to within this share of its bandwidth.
const LAG_TRUST: f64 = 0.02;
/// The stated bandwidth of the current loop is believed to within this share.
const BANDWIDTH_TRUST: f64 = 0.2;
/// The same where the band had to be cut below a mode: what is left cannot tell a lag from a delay.
const BANDWIDTH_HELD: f64 = 1e-3;

impl<'a> Fit<'a> {
    pub(super) fn new(prior: &'a DriveParams, lines: &'a Lines, used: [bool; 2]) -> Self {
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
            unknowns,
            scale: Vec::new(),
            start: Vec::new(),
            parameters: Vec::new(),
            weights: Default::default(),
            standard_errors: Vec::new(),
            count: lines.frequency_hz.len(),
            bandwidth_trust: BANDWIDTH_TRUST,
            unexplained: 0.0,
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

    fn value(&self, p: &[f64], unknown: Unknown) -> Option<f64> {
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
            self.standard_errors = (0..self.unknowns.len())
                .map(|i| solution.covariance.as_ref().map_or(f64::INFINITY, |c| c[(i, i)].max(0.0).sqrt()))
                .collect();
            self.update_weights();
        }
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

    /// Weight = 1 / standard deviation of one component, from neighbouring residuals (61 lines).
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
                let (a, b) = (k.saturating_sub(30), (k + 31).min(errors.len()));
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
    /// model explains them; a mode beyond is warned of and left out. Returns the end of the band.
    pub(super) fn widen(&mut self, warnings: &mut Vec<String>) -> f64 {
        let end_hz = self.lines.highest_hz();
        let resonance_hz = Chain::of_drive(self.prior).modes().frequencies_hz.get(1).copied().unwrap_or(0.0);
        let mut high_hz = if resonance_hz > 0.0 { (1.25 * resonance_hz).min(end_hz) } else { 0.25 * end_hz };
        let mut good = None;
        loop {
            self.run(high_hz);
            if self.worst_misfit(high_hz) > EXPLAINED {
                break;
            }
            good = Some(high_hz);
            if high_hz >= end_hz {
                return end_hz;
            }
            high_hz = (1.25 * high_hz).min(end_hz);
        }
        let kept_hz = match good {
            Some(kept_hz) => {
                self.restart();
                self.bandwidth_trust = BANDWIDTH_HELD;
                self.run(kept_hz);
                kept_hz
            }
            None => {
                self.unexplained = self.worst_misfit(high_hz);
                high_hz
            }
        };
        let valid = if good.is_some() {
            format!("valid up to {kept_hz:.0} Hz")
        } else {
            format!("even below {kept_hz:.0} Hz the model misses by {:.0} %", 100.0 * self.unexplained)
        };
        warnings.push(match self.mode_beyond_hz(kept_hz) {
            Some(mode_hz) => {
                format!("a mode outside of the model at about {mode_hz:.0} Hz; {valid}")
            }
            None => format!("the model does not explain the whole response: {valid}"),
        });
        kept_hz
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

    pub(super) fn result(&self) -> (RawDriveParams, Vec<FittedParameter>) {
        let mut raw = self.prior.raw().clone();
        let mut fitted = Vec::new();
        let r2 = self.prior.travel_m_rad().powi(2);
        let (t_m, t_t) = (self.prior.motor_encoder_delay_s(), self.prior.stage_encoder_delay_s());
        for (i, unknown) in self.unknowns.iter().enumerate() {
            let (value, error) = (self.parameters[i], self.standard_errors[i]);
            let kept_s = if self.used[0] { t_m } else { t_t };
            let rigid = self.prior.structure() == Structure::Rigid;
            let (name, factor, offset, field): (&'static str, f64, f64, &mut Option<f64>) = match unknown {
                Unknown::MotorMass => ("rotary_inertia_kg_m2", r2, 0.0, &mut raw.rotary_inertia_kg_m2),
                Unknown::StageMass => {
                    let turning = if rigid { self.prior.reflected_mass_kg() } else { 0.0 };
                    ("movable_mass_kg", 1.0, -turning, &mut raw.movable_mass_kg)
                }
                Unknown::Stiffness => ("axial_stiffness_n_m", 1.0, 0.0, &mut raw.axial_stiffness_n_m),
                Unknown::StructuralDamping => {
                    ("structural_damping_n_s_m", 1.0, 0.0, &mut raw.structural_damping_n_s_m)
                }
                Unknown::MotorDamping => {
                    ("rotary_damping_nm_s_rad", r2, 0.0, &mut raw.rotary_damping_nm_s_rad)
                }
                Unknown::StageDamping => {
                    let turning = if rigid { self.prior.reflected_damping_n_s_m() } else { 0.0 };
                    ("translational_damping_n_s_m", 1.0, -turning, &mut raw.translational_damping_n_s_m)
                }
                Unknown::ScrewMass => ("screw_inertia_kg_m2", r2, 0.0, &mut raw.screw_inertia_kg_m2),
                Unknown::TorsionalStiffness => {
                    ("torsional_stiffness_nm_rad", r2, 0.0, &mut raw.torsional_stiffness_nm_rad)
                }
                Unknown::TorsionalDamping => {
                    ("torsional_damping_nm_s_rad", r2, 0.0, &mut raw.torsional_damping_nm_s_rad)
                }
                Unknown::CommonDelay => {
                    ("amplifier_dead_time_s", 1.0, -kept_s, &mut raw.amplifier_dead_time_s)
                }
                Unknown::StageExtraDelay => {
                    ("stage_encoder_delay_s", 1.0, t_m, &mut raw.stage_encoder_delay_s)
                }
                Unknown::CurrentBandwidth => {
                    ("current_loop_bandwidth_rad_s", 1.0, 0.0, &mut raw.current_loop_bandwidth_rad_s)
                }
            };
            let positive = value * factor + offset;
            let damping_or_delay =
                name.contains("damping") || name.contains("delay") || name.contains("dead_time");
            // A damping or delay within its error of zero may come out below it: zero is what it is then.
            let stated = if damping_or_delay { positive.max(0.0) } else { positive };
            let prior = field.unwrap_or(0.0);
            *field = Some(stated);
            let common = match unknown {
                Unknown::CommonDelay => TIMING_TRUST * self.lines.rate.period_s(),
                Unknown::StageExtraDelay => 0.0,
                Unknown::CurrentBandwidth => LAG_TRUST * value,
                _ => TORQUE_CONSTANT_TRUST * value,
            };
            let reach = 1.96 * error.hypot(common).hypot(self.unexplained * value) * factor;
            fitted.push(FittedParameter {
                name,
                prior,
                value: stated,
                ci95: [positive - reach, positive + reach],
            });
        }
        (raw, fitted)
    }
}
