//! From the terms of the search to the answer: names, numbers with intervals, model, series.

use super::fit::{Fit, correlation_rows};
use super::laws::{Law, Slider};
use super::search::{Found, Origin, Search, Term};
use super::words::{next, words};
use crate::diagnosis::bank::lcm;
use crate::diagnosis::location::loud_times;
use crate::diagnosis::terms::{SCALE_DEVIATION, peak_of_cut, peak_of_map};
use crate::diagnosis::{
    Alternative, Contribution, Correction, Diagnosis, Estimate, Finding, Location, RecordingFit, Tried,
    Verdict,
};
use crate::plant::effects::periodic::amplitude_phase;
use crate::plant::effects::{EffectKind, ParameterValue, PhysicsTerm, Port};
use crate::plant::machine::{AxisModel, Machine};
use crate::signal::inner_products::rms;
use std::f64::consts::TAU;
use std::ops::Range;

pub(super) const Z95: f64 = 1.96;
/// Of a wave with a motor's order, what is left to a force of the screw with the same period.
const TWIN_SHARE: f64 = 0.3;

/// A law of the final model with its amplitudes.
pub(super) struct Fitted<'a> {
    pub(super) index: usize,
    pub(super) term: &'a Term,
    pub(super) amplitudes: Vec<f64>,
    /// Standard deviations, neighbouring rows counted for what they are worth.
    pub(super) deviations: Vec<f64>,
}

pub(super) struct Context<'a> {
    machine: &'a Machine,
    pub(super) axis: &'a AxisModel,
    pub(super) search: &'a Search,
    /// The terms before anything was found.
    start: &'a [Term],
    before: Fit,
    after: Fit,
    /// Left by the structure alone, without physics that the model states.
    structure_n: f64,
    pub(super) floor_n: f64,
    /// The model says that there is dry friction.
    friction_stated: bool,
    pub(super) fitted: Vec<Fitted<'a>>,
}

/// Builds the answer. `start`: the terms before anything was found.
pub(super) fn answer((machine, axis): (&Machine, &AxisModel), search: &Search, start: &[Term]) -> Diagnosis {
    let (before, after) = (search.fit(start), search.fit(&search.terms));
    let widen = correlation_rows(&after.residual).sqrt();
    let fitted = search
        .terms
        .iter()
        .enumerate()
        .map(|(index, term)| Fitted {
            index,
            term,
            amplitudes: search.amplitudes(&search.terms, &after.coefficients, index),
            deviations: search
                .amplitudes(&search.terms, &after.deviations, index)
                .iter()
                .map(|d| d * widen)
                .collect(),
        })
        .collect();
    let floor_n = floor(&after.residual);
    let friction_stated = start.iter().any(|t| matches!(t.law, Law::Friction(_)));
    let structure: Vec<Term> =
        start.iter().filter(|t| !matches!(t.origin, Origin::Given(_))).cloned().collect();
    let structure_n = search.fit(&structure).heldout_rms;
    let c = Context {
        machine,
        axis,
        search,
        start,
        before,
        after,
        structure_n,
        floor_n,
        friction_stated,
        fitted,
    };
    let mut findings = c.findings();
    let unexplained = c.is_unexplained();
    // Numbers fitted beside an unknown cause are bent by it.
    let mut parameter_corrections = if unexplained { Vec::new() } else { c.corrections() };
    let laws = if unexplained { Vec::new() } else { c.laws_of_other_size() };
    if unexplained {
        findings.clear();
    }
    findings.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
    for (k, f) in findings.iter_mut().enumerate() {
        f.rank = k + 1;
    }
    let mut model = c.model(&findings, &parameter_corrections);
    for axis in model.axes.iter_mut().filter(|a| a.name == axis.name) {
        for law in &laws {
            axis.physics[law.index] = law.term.clone();
            // The force of a slider stands in its own table too.
            let force_n =
                law.term.number("force_n").filter(|_| law.term.effect == EffectKind::PreslidingFriction);
            for dry in axis.physics.iter_mut().filter(|t| t.effect == EffectKind::CoulombFriction) {
                *dry = force_n
                    .map_or_else(|| dry.clone(), |force_n| dry.clone().with_number("force_n", force_n));
            }
        }
    }
    parameter_corrections.extend(laws.into_iter().flat_map(|law| law.corrections));
    let verdict = match (unexplained, findings.is_empty(), parameter_corrections.is_empty()) {
        (true, ..) => Verdict::UnexplainedMismatch,
        (_, false, _) => Verdict::MissingPhysics,
        (_, _, false) => Verdict::ParameterError,
        _ => Verdict::ModelAdequate,
    };
    let first = search.series.first();
    Diagnosis {
        axis: axis.name.clone(),
        verdict,
        location: c.location(verdict, &findings),
        model,
        findings,
        residual_band_hz: [0.0, first.map_or(0.0, |s| s.band_hz)],
        parameter_corrections,
        recordings: c.recordings(unexplained),
        balances: vec!["axis"],
        series_rate_hz: first.map_or(1.0, |s| s.rate_hz),
        noise_floor_n: vec![floor_n],
        tried: search
            .tried
            .iter()
            .map(|(e, p, v)| Tried { effect: Some(*e), port: *p, evidence: *v })
            .collect(),
        detection_limits: Vec::new(),
        notes: Vec::new(),
        closed_loop: Err("the loop of an axis with one position is not simulated".to_owned()),
    }
}

/// What a residual holds that changes from row to row: second differences of white noise have the factor root
/// 6.
fn floor(residual: &[f64]) -> f64 {
    let second: Vec<f64> = residual.windows(3).map(|w| w[0] - 2.0 * w[1] + w[2]).collect();
    (rms(&second) / 6.0_f64.sqrt()).min(rms(residual))
}

/// What a law is made of, the poorest first: how much friction there is, over which distance it turns, and
/// the gap before it.
fn parts_of(law: Law, friction_stated: bool) -> Vec<Law> {
    let Law::Friction(s) = law else { return vec![law] };
    let step = (s.yield_m > 0.0 && !friction_stated).then_some(Slider::STEP);
    let soft = (s.gap_m > 0.0).then_some(Slider { gap_m: 0.0, ..s });
    step.into_iter().chain(soft).chain([s]).map(Law::Friction).collect()
}

impl Context<'_> {
    /// True where more is left than noise, and neither what was found nor what the model states beyond its
    /// structure explains most of what is there without both: a model that was found once is judged as it
    /// was when it was found.
    fn is_unexplained(&self) -> bool {
        /// A residual so many times its fast part is no noise.
        const LOUD: f64 = 2.0;
        /// This share of the thrust is worth a word.
        const WORTH: f64 = 0.01;
        /// Share of the power above the floor that must be explained.
        const LEAST_EXPLAINED: f64 = 0.5;
        let left_n = self.after.heldout_rms;
        let above = |rms_n: f64| rms_n.powi(2) - self.floor_n.powi(2);
        left_n >= LOUD * self.floor_n
            && left_n > WORTH * self.thrust_rms_n()
            && above(left_n) > (1.0 - LEAST_EXPLAINED) * above(self.structure_n)
    }

    fn location(&self, verdict: Verdict, findings: &[Finding]) -> Option<Location> {
        let band = self.search.series.first().map_or(0.0, |s| s.band_hz);
        let domain = match findings.first().map(|f| f.effect) {
            Some(EffectKind::GravityLoad | EffectKind::AsymmetricFriction) => "direction",
            Some(EffectKind::PreslidingFriction | EffectKind::Backlash) => "history",
            Some(
                EffectKind::PositionPeriodicForce
                | EffectKind::PositionDependentForce
                | EffectKind::EncoderInterpolationError
                | EffectKind::NonlinearStiffness,
            ) => "position",
            Some(EffectKind::TorqueRipple) => "motor_angle",
            Some(EffectKind::DeadTime | EffectKind::CurrentLoopLag) => "frequency",
            Some(EffectKind::TorqueConstantSaturation) => "current",
            Some(EffectKind::FrictionDrift | EffectKind::CuttingForce) | None => "time",
            Some(_) => "velocity",
        };
        let missing = matches!(verdict, Verdict::MissingPhysics | Verdict::UnexplainedMismatch);
        missing.then(|| Location {
            port: findings.first().map_or(Port::Stage, |f| f.port),
            domain,
            bands_hz: vec![[0.0, band]],
            time: loud_times(&self.powers(), self.search.series.first().map_or(1.0, |s| s.rate_hz)),
            shares: [0.0, 1.0, 1.0],
        })
    }

    /// Squares of what the stated structure leaves, recording by recording, with the time of the first.
    fn powers(&self) -> Vec<(f64, Vec<f64>)> {
        let parts = self.ranges().map(|(s, range)| {
            let squares = self.before.residual[range].iter().map(|r| r * r).collect();
            (s.t_s.first().copied().unwrap_or(0.0), squares)
        });
        parts.collect()
    }

    /// The recordings, and which rows are theirs.
    fn ranges(&self) -> impl Iterator<Item = (&super::Series, Range<usize>)> {
        self.search.series.iter().scan(0, |start, s| {
            let range = *start..*start + s.t_s.len();
            *start = range.end;
            Some((s, range))
        })
    }

    fn findings(&self) -> Vec<Finding> {
        let mut list = Vec::new();
        for f in &self.fitted {
            let Origin::Found(found) = &f.term.origin else { continue };
            let mut poorer = None;
            for law in parts_of(f.term.law, self.friction_stated) {
                let own = poorer.map_or_else(|| found.clone(), |poorer| self.beside(f, found, poorer));
                list.push(self.finding(f, &own, law));
                poorer = Some(law);
            }
        }
        list
    }

    /// How a law was found beside a poorer form of itself, which keeps what it explains.
    fn beside(&self, f: &Fitted<'_>, found: &Found, poorer: Law) -> Found {
        let mut terms = self.search.terms.clone();
        terms[f.index].law = poorer;
        let before_n = self.search.fit(&terms).heldout_rms;
        let evidence = 2.0 * self.search.independent * (before_n / self.after.heldout_rms).ln();
        Found { evidence: evidence.max(0.0), heldout_before_n: before_n, ..found.clone() }
    }

    fn finding(&self, f: &Fitted<'_>, found: &Found, law: Law) -> Finding {
        let (mut effect, mut port) = law.effect();
        let mut parameters = self.estimates(f, law);
        let mut twins = Vec::new();
        if let Law::Wave { wavelength_m } = law
            && let Some(order) = self.of_motor(wavelength_m)
        {
            // One balance cannot tell a force of the screw from one of the motor; the order can.
            twins.push(Alternative { effect, port, probability: TWIN_SHARE * found.probability });
            (effect, port) = (EffectKind::TorqueRipple, Port::Motor);
            let relative = parameters[0].ci95.map(|end| order * parameters[0].value / end);
            parameters[0] = Estimate {
                name: "order_per_rev".to_owned(),
                value: order,
                unit: "1",
                ci95: [relative[1], relative[0]],
            };
        }
        let value = |name: &str| parameters.iter().find(|e| e.name == name).map_or(0.0, |e| e.value);
        let (statement, equation) = words(law, &value);
        let alternatives = found
            .alternatives
            .iter()
            .filter(|(e, _, _)| *e != effect)
            .map(|(effect, port, probability)| Alternative {
                effect: *effect,
                port: *port,
                probability: *probability,
            })
            .chain(twins.clone())
            .collect::<Vec<_>>();
        let probability = found.probability - twins.iter().map(|t| t.probability).sum::<f64>();
        let next_experiment = (!alternatives.is_empty()).then(|| next(effect).to_owned());
        let mut term = PhysicsTerm {
            effect,
            port,
            parameters: parameters
                .iter()
                .map(|e| {
                    // What the slope makes at the mean speed is said to a person; the model has the slope.
                    let told = matches!(law, Law::DirectionalViscous) && e.name == "force_difference_n";
                    (e.name.clone(), ParameterValue::Number(if told { 0.0 } else { e.value }))
                })
                .collect(),
        };
        let mut further = |name: &str, value| term.parameters.push((name.to_owned(), value));
        match law {
            Law::Map { first_m, spacing_m, .. } => {
                further("force_n", ParameterValue::List(f.amplitudes.clone()));
                further("first_m", ParameterValue::Number(first_m));
                further("spacing_m", ParameterValue::Number(spacing_m));
            }
            Law::Friction(s) if s.yield_m > 0.0 && s.gap_m <= 0.0 => {
                further("gradual", ParameterValue::Number(f64::from(u8::from(s.gradual))));
            }
            Law::Cut { harmonics, .. } => further("harmonics", ParameterValue::Number(harmonics as f64)),
            _ => {}
        }
        Finding {
            rank: 0,
            effect,
            port,
            statement,
            equation,
            maps: Vec::new(),
            fit: crate::diagnosis::Fit {
                heldout_rms_before_n: found.heldout_before_n,
                heldout_rms_after_n: self.after.heldout_rms,
                noise_floor_n: self.floor_n,
            },
            probability,
            alternatives,
            next_experiment,
            contribution: self.contribution(f, law),
            term,
            evidence: found.evidence,
            parameters,
        }
    }

    fn contribution(&self, f: &Fitted<'_>, law: Law) -> Vec<Contribution> {
        let each = |(recording, s): (usize, &super::Series)| {
            let of = |law: Law| law.columns(s, &self.search.scales);
            let columns = match law {
                // What an encoder reads too much is a length.
                Law::Interpolation { period_m } => of(Law::Wave { wavelength_m: period_m }),
                // The turn; how much there is has its own line.
                Law::Friction(slider) if slider.yield_m > 0.0 && slider.gap_m <= 0.0 => {
                    let step = of(Law::Friction(Slider::STEP));
                    let turn = of(law)[0].iter().zip(&step[0]).map(|(soft, step)| soft - step).collect();
                    vec![turn]
                }
                law => of(law),
            };
            // At the current the drive misses what the balance has too much.
            let unit = match (law.effect().1, s.thrust_n_a) {
                (Port::Current, Some(per_ampere)) => -1.0 / per_ampere,
                _ => 1.0,
            };
            let at = |k: usize| unit * columns.iter().zip(&f.amplitudes).map(|(c, a)| a * c[k]).sum::<f64>();
            Contribution { recording, t_s: s.t_s.clone(), value: (0..s.t_s.len()).map(at).collect() }
        };
        self.search.series.iter().enumerate().map(each).collect()
    }

    fn estimates(&self, f: &Fitted<'_>, law: Law) -> Vec<Estimate> {
        let a = f.amplitudes[0];
        let half = Z95 * f.deviations[0].hypot(self.scale() * a);
        let linear = |name: &str, unit, factor: f64| {
            let ends = [factor * a - factor.abs() * half, factor * a + factor.abs() * half];
            Estimate { name: name.to_owned(), value: factor * a, unit, ci95: ends }
        };
        let plain = |name: &str, unit, value: f64, half: f64| Estimate {
            name: name.to_owned(),
            value,
            unit,
            ci95: [value - half, value + half],
        };
        let wave = |name: &str, unit, half: f64| {
            let b = f.amplitudes.get(1).copied().unwrap_or(0.0);
            let (size, phase) = amplitude_phase(a, b);
            vec![plain(name, unit, size, half), plain("phase_rad", "rad", phase, half / size.max(1.0e-300))]
        };
        let inner = |name: &str, unit, at: f64, make: &dyn Fn(f64) -> Law| Estimate {
            name: name.to_owned(),
            value: at,
            unit,
            ci95: self.search.profile(f.index, make, at),
        };
        match law {
            Law::Inertia | Law::Viscous => vec![linear("n_s_m", "N s/m", 1.0)],
            Law::Constant => vec![linear("force_n", "N", 1.0)],
            Law::Friction(s) if s.gap_m > 0.0 => {
                vec![inner("gap_m", "m", s.gap_m, &|gap_m| Law::Friction(Slider { gap_m, ..s }))]
            }
            Law::Friction(s) if s.yield_m > 0.0 => {
                let own = if let Law::Friction(own) = f.term.law { own } else { s };
                let y = inner("yield_m", "m", s.yield_m, &|yield_m| Law::Friction(Slider { yield_m, ..own }));
                let stiffness = Estimate {
                    name: "presliding_stiffness_n_m".to_owned(),
                    value: a / y.value,
                    unit: "N/m",
                    ci95: [(a - half) / y.ci95[1], (a + half) / y.ci95[0]],
                };
                vec![stiffness, linear("force_n", "N", 1.0)]
            }
            Law::Friction(_) => vec![linear("force_n", "N", 1.0)],
            Law::DirectionalDry(_) => vec![linear("force_difference_n", "N", 2.0)],
            Law::DirectionalViscous => self.directional(f),
            Law::Square => vec![linear("n_s2_m2", "N s2/m2", 1.0)],
            Law::Stribeck { velocity_m_s } => vec![
                linear("stribeck_force_n", "N", 1.0),
                inner("stribeck_velocity_m_s", "m/s", velocity_m_s, &|velocity_m_s| Law::Stribeck {
                    velocity_m_s,
                }),
            ],
            Law::Drift { time_s, slider } => {
                let level = self.friction_level().max(1.0e-300);
                vec![
                    linear("relative_change", "1", 1.0 / level),
                    inner("time_constant_s", "s", time_s, &|time_s| Law::Drift { time_s, slider }),
                ]
            }
            Law::Wave { wavelength_m } => {
                let length =
                    inner("wavelength_m", "m", wavelength_m, &|wavelength_m| Law::Wave { wavelength_m });
                [vec![length], wave("amplitude_n", "N", half)].concat()
            }
            Law::Interpolation { period_m } => {
                let period = plain("signal_period_m", "m", period_m, 0.0);
                [vec![period], wave("amplitude_m", "m", Z95 * f.deviations[0])].concat()
            }
            Law::Map { .. } => {
                vec![plain("amplitude_n", "N", peak_of_map(&f.amplitudes), half)]
            }
            Law::Cut { fundamental_hz, harmonics, window_s, .. } => {
                let (peak_n, deviation_n) = peak_of_cut(harmonics, &f.amplitudes, &f.deviations);
                // Of a wave with amplitude A over T: deviation of the frequency root 12 s_A / (2 pi A T).
                let wave_n = f.amplitudes[0].hypot(f.amplitudes[1]).max(1.0e-300);
                let turns = 12.0_f64.sqrt() * f.deviations[0] / (TAU * wave_n);
                let half_hz = Z95 * turns / (window_s[1] - window_s[0]);
                let half_s = 0.5 / fundamental_hz;
                vec![
                    plain("fundamental_hz", "Hz", fundamental_hz, half_hz),
                    plain("amplitude_n", "N", peak_n, Z95 * deviation_n.hypot(self.scale() * peak_n)),
                    plain("start_s", "s", window_s[0], half_s),
                    plain("end_s", "s", window_s[1], half_s),
                ]
            }
            Law::Spring { centre_m, gap_m } => {
                let gap = inner("gap_m", "m", gap_m, &|gap_m| Law::Spring { centre_m, gap_m });
                let centre =
                    Estimate { name: "centre_m".to_owned(), value: centre_m, unit: "m", ci95: [centre_m; 2] };
                vec![gap, centre]
            }
            Law::Cubic { .. } => vec![linear("cubic_n_m3", "N/m3", 1.0)],
            Law::Saturation => vec![linear("per_a2", "1/A2", 1.0)],
            Law::Slow { extra_s } => {
                let e = inner("bandwidth_rad_s", "rad/s", extra_s, &|extra_s| Law::Slow { extra_s });
                let bandwidth = |extra_s: f64| 1.0 / (self.search.scales.loop_s + a * extra_s);
                let ci95 = [bandwidth(e.ci95[1]), bandwidth(e.ci95[0])];
                vec![Estimate { value: bandwidth(extra_s), ci95, ..e }]
            }
            Law::Late { delay_s } => {
                // Delay and amplitude trade: to first order their product is what the force is late by.
                let e = inner("extra_delay_s", "s", delay_s, &|delay_s| Law::Late { delay_s });
                vec![Estimate { value: a * e.value, ci95: e.ci95.map(|end| a * end), ..e }]
            }
        }
    }

    pub(super) fn thrust_rms_n(&self) -> f64 {
        rms(&self.search.series.iter().flat_map(|s| s.thrust_n.iter().copied()).collect::<Vec<f64>>())
    }

    /// Relative deviation of every force: that of the torque constant, where forces are measured by a
    /// current.
    pub(super) fn scale(&self) -> f64 {
        if self.search.scales.current { SCALE_DEVIATION } else { 0.0 }
    }

    /// True where a wave is a motor's own: its order is one of the poles and slots, not of the screw.
    fn of_motor(&self, wavelength_m: f64) -> Option<f64> {
        let raw = self.axis.drive.raw();
        let order = self.axis.drive.screw_lead_m()? / wavelength_m;
        let (poles, slots) = (raw.motor_pole_count?, raw.motor_slot_count.unwrap_or(0.0));
        let near = |of: f64| of > 1.0 && (order / of - 1.0).abs() < 0.01;
        (near(0.5 * poles) || near(poles) || near(3.0 * poles) || near(slots) || near(lcm(poles, slots)))
            .then_some(order)
    }

    /// A viscous difference as what it makes at the mean speed, and as a slope.
    fn directional(&self, f: &Fitted<'_>) -> Vec<Estimate> {
        let speeds: Vec<f64> =
            self.search.series.iter().flat_map(|s| s.velocity_m_s.iter().map(|v| v.abs())).collect();
        let moving: Vec<f64> =
            speeds.iter().copied().filter(|v| *v > 5.0 * self.search.scales.smoothing_m_s).collect();
        let mean = moving.iter().sum::<f64>() / moving.len().max(1) as f64;
        let make = |name: &str, unit, factor: f64| {
            let deviation = f.deviations[0].hypot(self.scale() * f.amplitudes[0]);
            let (value, half) = (factor * f.amplitudes[0], (factor * Z95 * deviation).abs());
            Estimate { name: name.to_owned(), value, unit, ci95: [value - half, value + half] }
        };
        vec![make("force_difference_n", "N", 2.0 * mean), make("viscous_difference_n_s_m", "N s/m", 2.0)]
    }

    pub(super) fn friction_level(&self) -> f64 {
        self.fitted
            .iter()
            .find(|f| matches!(f.term.law, Law::Friction(_)))
            .map_or(0.0, |f| f.amplitudes[0].abs())
    }

    /// The model with corrections and findings in it.
    fn model(&self, findings: &[Finding], corrections: &[Correction]) -> Machine {
        let mut machine = self.machine.clone();
        let Some(axis) = machine.axes.iter_mut().find(|a| a.name == self.axis.name) else { return machine };
        if let Ok(drive) = axis.drive.with_numbers(corrections.iter().map(|c| (&*c.name, c.value))) {
            axis.drive = drive;
        }
        axis.physics.extend(findings.iter().map(|f| f.term.clone()));
        machine
    }

    /// Laws that are not named leave nothing smaller: without a cause the model stays as it was stated.
    fn recordings(&self, unexplained: bool) -> Vec<RecordingFit> {
        let nominal = self.nominal_residual();
        let before = self.search.heldout(self.start);
        let after = if unexplained { before.clone() } else { self.search.heldout(&self.search.terms) };
        let written = if unexplained { &nominal } else { &after };
        let fit = |(s, range): (&super::Series, Range<usize>)| {
            let part = |v: &[f64]| v[range.clone()].to_vec();
            RecordingFit {
                experiment: s.experiment.clone(),
                rms_before_n: rms(&nominal[range.clone()]),
                rms_after_n: rms(&written[range.clone()]),
                t_s: s.t_s.clone(),
                position_m: s.position_m.clone(),
                velocity_m_s: s.velocity_m_s.clone(),
                residual_nominal_n: vec![part(&nominal)],
                residual_before_n: vec![part(&before)],
                residual_after_n: vec![part(&after)],
            }
        };
        self.ranges().map(fit).collect()
    }

    /// Thrust minus what the stated numbers need; given physics with the amplitudes that the model states.
    fn nominal_residual(&self) -> Vec<f64> {
        let d = &self.axis.drive;
        let mut left = self.search.rows.target.clone();
        let mut take = |law: Law, amplitudes: &[f64]| {
            for (column, amplitude) in self.search.columns(law).iter().zip(amplitudes) {
                left.iter_mut().zip(column).for_each(|(r, c)| *r -= amplitude * c);
            }
        };
        for t in &self.search.terms {
            if let Origin::Number(key) = t.origin {
                match key {
                    "movable_mass_kg" => take(Law::Inertia, &[d.total_mass_kg()]),
                    "translational_damping_n_s_m" => {
                        let damping = d.translational_damping_n_s_m() + d.reflected_damping_n_s_m();
                        take(Law::Viscous, &[damping]);
                    }
                    "stage_coulomb_friction_n" => {
                        let level = d.stage_coulomb_friction_n() + d.motor_coulomb_friction_n();
                        take(Law::Friction(Slider::STEP), &[level]);
                    }
                    _ => {}
                }
            }
        }
        for p in &self.axis.physics {
            let Some(law) = super::given(p, self.axis) else { continue };
            let Some(amplitudes) = law.stated_amplitudes(p, self.friction_level()) else { continue };
            take(law, &amplitudes);
        }
        left
    }
}
