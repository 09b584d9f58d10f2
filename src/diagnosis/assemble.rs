//! From the search to the answer.

use super::bench::{Accepted, Bench, Score, rms};
use super::corrections::{self, OtherSize, corrections, known_numbers, material};
use super::floor::{SideSpectrum, spectrum};
use super::hypothesis_fit::HypothesisFit;
use super::in_loop::{Rig, in_loop};
use super::loop_fit;
use super::motion::band_hz;
use super::problem::{Column, Sides};
use super::result::*;
use super::search::{Complete, Outcome, least_evidence, rank};
use super::shape::Shape;
use super::steps::stated_step_m;
use super::terms::{self, INEXACT_SHARE};
use crate::plant::effects::{EffectKind, PhysicsTerm, Port};
use crate::plant::machine::{AxisModel, Machine};
use crate::sample::Recording;
use crate::simulation::model_axis::not_simulated;

/// Share of the power above the floor that the findings must explain; else they are not the cause.
const LEAST_EXPLAINED: f64 = 0.6;

/// A found model that leaves this many times what it leaves without its findings is refuted by the loop.
const REFUTED: f64 = 1.05;

/// A fit in the loop that leaves this many times what its start by the balance leaves has lost its way.
const TOO_FAR: f64 = 3.0;

/// Numbers that a balance of slow motion puts far from where they are.
const MASSES: &[&str] = &["rotary_inertia_kg_m2", "movable_mass_kg"];

/// What held-out blocks may have left, over what a fit to everything leaves.
const UNTOLD: f64 = 3.0;

/// Everything that the parts of an answer are made of.
pub(super) struct Case<'a> {
    pub(super) machine: &'a Machine,
    pub(super) axis: &'a AxisModel,
    pub(super) recordings: &'a [Recording],
    pub(super) outcome: &'a Outcome,
    pub(super) bench: &'a Bench<'a>,
    nominal: Column,
    after: Column,
    pub(super) spectra: Vec<SideSpectrum>,
    /// Spectra of what no choice of the numbers absorbs.
    least: Vec<SideSpectrum>,
}

/// What is said of the model, and the proof.
pub(super) struct Answer {
    pub(super) unexplained: bool,
    pub(super) findings: Vec<Finding>,
    pub(super) corrections: Vec<Correction>,
    pub(super) model: Machine,
    pub(super) closed_loop: Result<ClosedLoop, String>,
}

/// Builds the diagnosis.
pub(crate) fn assemble(
    machine: &Machine,
    axis: &AxisModel,
    recordings: &[Recording],
    outcome: &Outcome,
) -> Diagnosis {
    let p = &outcome.state.problem;
    let bench = &outcome.state.bench();
    let after = bench.residual();
    let of = |residual: &Column| [false, true].map(|stage| spectrum(p, residual, stage)).to_vec();
    let spectra: Vec<SideSpectrum> = of(&after);
    let least = of(&Bench::flat(p, &outcome.state.accepted, &after).residual());
    let case = Case {
        machine,
        axis,
        recordings,
        outcome,
        bench,
        nominal: outcome.nominal.clone(),
        after,
        spectra,
        least,
    };
    let Answer { unexplained, mut findings, corrections, model, closed_loop } = match &outcome.told {
        Some(told) => case.of_loop(told),
        None => case.of_balance(),
    };
    for (k, f) in findings.iter_mut().enumerate() {
        f.rank = k + 1;
    }
    let verdict = if unexplained {
        Verdict::UnexplainedMismatch
    } else if !findings.is_empty() {
        Verdict::MissingPhysics
    } else if corrections.iter().any(material) {
        Verdict::ParameterError
    } else {
        Verdict::ModelAdequate
    };
    let location = case.location(verdict, &findings);
    let rate = p.motions.first().map_or(1.0, |m| m.rate_hz);
    Diagnosis {
        axis: axis.name.clone(),
        verdict,
        location,
        findings,
        residual_band_hz: [0.0, band_hz(rate)],
        parameter_corrections: corrections,
        recordings: case.recording_fits(verdict == Verdict::UnexplainedMismatch),
        balances: vec!["motor", "stage"],
        series_rate_hz: p.rate_hz(),
        noise_floor_n: case.spectra.iter().map(|s| s.floor_rms_n(band_hz(rate))).collect(),
        tried: tried(outcome.rounds.first().map_or(&[], Vec::as_slice)),
        detection_limits: detection_limits(bench, outcome.rounds.last().map_or(&[], Vec::as_slice)),
        closed_loop,
        notes: Vec::new(),
        model,
    }
}

/// True for what is a number of the model and no finding: a delay shorter than stated, the speed over which
/// friction turns.
fn is_number(a: &Accepted) -> bool {
    match a.hypothesis.shape {
        Shape::Delay { extra_s } => extra_s < 0.0,
        Shape::Smoothing { .. } => true,
        _ => false,
    }
}

fn tried(scores: &[Score]) -> Vec<Tried> {
    scores
        .iter()
        .map(|s| Tried {
            effect: Some(s.hypothesis.effect),
            port: s.hypothesis.port,
            evidence: if s.plausible { s.evidence } else { 0.0 },
        })
        .collect()
}

/// An amplitude a of deviation s brings the evidence (a / s)^2: from the root of the threshold on it is
/// claimed.
fn detection_limits(bench: &Bench<'_>, scores: &[Score]) -> Vec<DetectionLimit> {
    let deviations = least_evidence(bench).sqrt();
    let scores = scores.iter().filter(|s| s.unit_rms_n > 0.0);
    scores
        .map(|s| DetectionLimit {
            effect: s.hypothesis.effect,
            port: s.hypothesis.port,
            force_rms_n: deviations * s.deviations[0] * s.unit_rms_n,
        })
        .collect()
}

impl Case<'_> {
    /// What the force balance says, its numbers fitted in closed loop where it may err.
    fn of_balance(&self) -> Answer {
        let (p, outcome) = (&self.outcome.state.problem, self.outcome);
        let mut unexplained = self.unexplained();
        // Numbers fitted beside an unknown cause are bent by it.
        let settled = unexplained || outcome.complete == Complete::Stated;
        let mut corrections = if settled { Vec::new() } else { corrections(p, self.bench) };
        if !settled {
            corrections.extend(self.further_corrections());
        }
        let mut findings = if unexplained { Vec::new() } else { self.findings() };
        if !unexplained {
            findings.extend(self.encoder_steps());
        }
        findings.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let laws = if settled { Vec::new() } else { self.laws_of_other_size() };
        let mut model = self.model(&findings, &corrections, &laws);
        let rig = Rig::new(self.axis, self.recordings, p);
        if !settled
            && let Ok(rig) = &rig
            && let Some(fitted) = self.fitted_in_loop(rig, (&mut model, &mut findings), &corrections)
        {
            corrections = fitted;
        }
        corrections.extend(laws.into_iter().flat_map(|law| law.corrections));
        let closed_loop = rig.and_then(|rig| {
            let found = model.axis(&self.axis.name).ok_or("the axis is not in the model")?;
            in_loop(&rig, (self.axis, found), outcome)
        });
        let refuted = |c: &ClosedLoop| {
            c.not_simulated.is_empty() && c.left_n(2) > REFUTED * c.left_n(0).min(c.left_n(1))
        };
        // Where a coarse step rounds is chance: no loop repeats it.
        let told =
            !findings.is_empty() && findings.iter().all(|f| f.effect != EffectKind::EncoderQuantization);
        if told && closed_loop.as_ref().is_ok_and(refuted) {
            unexplained = true;
            (findings, corrections) = (Vec::new(), Vec::new());
            model = self.model(&[], &[], &[]);
        }
        Answer { unexplained, findings, corrections, model, closed_loop }
    }

    fn new_accepted(&self) -> impl Iterator<Item = (usize, &Accepted)> {
        self.outcome.state.accepted.iter().enumerate().skip(self.outcome.state.given)
    }

    /// The model fitted in closed loop, where all of it can be simulated: its corrections beside those that
    /// no loop shows. Findings of which the loop shows nothing are taken out. `None`: the balance's stands;
    /// the loop is quiet with it and no mass, stiffness or friction is put far from what was stated.
    fn fitted_in_loop(
        &self,
        rig: &Rig<'_>,
        (model, findings): (&mut Machine, &mut Vec<Finding>),
        balanced: &[Correction],
    ) -> Option<Vec<Correction>> {
        let given = self.axis.physics.len();
        let found = model.axes.iter_mut().find(|a| a.name == self.axis.name)?;
        if !not_simulated(found).is_empty() {
            return None;
        }
        let far = balanced.iter().any(|c| material(c) && !c.name.contains("damping"));
        if !far && rig.says_all(found, rig.noise_n(found, self.least.get(1)?.white_n2_hz())) {
            return None;
        }
        let fit_from = |start: &AxisModel, as_stated: &[&str], held: &[&str]| {
            let start = loop_fit::with_stated_numbers(self.axis, start, as_stated);
            loop_fit::fit(rig, (self.axis, held), &start, loop_fit::NEAR)
        };
        let mut fit = fit_from(found, loop_fit::NUMBERS, &[])?;
        let left_n = rig.errors(&[fit.axis.clone(), found.clone()])?;
        // From the stated numbers the stage may stand whole signal periods beside its place, and the error of
        // an encoder with it: too far for a fit.
        let too_far = rms(&left_n[0]) > TOO_FAR * rms(&left_n[1]);
        if too_far {
            fit = fit_from(found, MASSES, &[])?;
        }
        let held = self.denied(&fit);
        if !(fit.pointless.is_empty() && held.is_empty()) {
            for k in fit.pointless.iter().rev() {
                found.physics.remove(*k);
                findings.remove(k - given);
            }
            let as_stated = if too_far { &[MASSES, &held].concat() } else { loop_fit::NUMBERS };
            fit = fit_from(found, as_stated, &held)?;
        }
        *found = fit.axis;
        let scaled = corrections::is_scaled(rig.problem());
        let mut list: Vec<Correction> = corrections::of_loop(self.axis, found, &fit.numbers, scaled);
        list.extend(self.further_corrections());
        Some(list)
    }

    /// Numbers that the loop puts elsewhere than stated and the balance does not: two ways of asking that err
    /// differently. What is wrong with a number, both say.
    fn denied(&self, fit: &loop_fit::LoopFit) -> Vec<&'static str> {
        /// Apart, as a share of the change of the logarithm.
        const APART: f64 = 0.35;
        let p = &self.outcome.state.problem;
        let common = corrections::common_scale(p, self.bench);
        let is_denied = |key: &str, value: f64| {
            let Some(k) = p.numbers.iter().position(|n| n.key == Some(key)) else { return false };
            let n = &p.numbers[k];
            let nominal = n.nominal * n.key_per_coefficient;
            let [in_loop, in_balance] =
                [value / nominal, self.bench.solution.coefficients[k] / common / n.nominal].map(f64::ln);
            corrections::is_material(key, value / nominal)
                && !((in_balance - in_loop).abs() < APART * in_loop.abs())
        };
        fit.numbers.iter().filter(|(key, value, _)| is_denied(key, *value)).map(|(key, ..)| *key).collect()
    }

    /// Power that stands above the floor, whitened side by side, in a residual.
    fn excess_power(&self, residual: &Column) -> f64 {
        let p = &self.outcome.state.problem;
        let band = band_hz(p.motions.first().map_or(1.0, |m| m.rate_hz));
        self.spectra
            .iter()
            .enumerate()
            .map(|(side, s)| {
                let own = spectrum(p, residual, side == 1);
                let last = ((band / s.step_hz) as usize).min(s.floor.len());
                let floor: f64 = s.floor[1..last].iter().sum();
                let above: f64 =
                    own.density[1..last].iter().zip(&s.floor[1..last]).map(|(d, f)| (d - f).max(0.0)).sum();
                above / floor.max(1e-300)
            })
            .sum()
    }

    /// True when what is left after the findings stands above the floor and is not a small rest of what they
    /// explain.
    fn unexplained(&self) -> bool {
        if self.outcome.complete != Complete::No {
            return false;
        }
        let band = self.outcome.state.problem.motions.first().map_or(1.0, |m| band_hz(m.rate_hz));
        // A form that describes what does not stand above the floor describes the rest of a law.
        let stands = self.least.iter().any(|s| !s.excess(band).is_empty());
        if self.outcome.stranger.is_some() && stands || self.waves_of_no_origin() > 1 {
            return true;
        }
        let target = &self.outcome.state.problem.target;
        let inexact_n = INEXACT_SHARE * rms(target);
        // Half a coarse step is a force of its own, and near rest it is not white.
        let coarse_n = [Port::MotorEncoder, Port::StageEncoder]
            .into_iter()
            .zip(self.outcome.state.problem.steps_m)
            .filter(|(port, step)| *step > stated_step_m(self.axis, *port))
            .map(|(_, step)| 0.5 * step * self.outcome.state.problem.mechanics.stiffness_n_m)
            .fold(0.0, f64::max);
        let loud = self.least.iter().any(|s| {
            let total: f64 = s.excess(band).iter().map(|e| e.1).sum();
            total > 0.5 * s.floor_rms_n(band).powi(2) + coarse_n.powi(2) + inexact_n.powi(2)
        });
        if !loud {
            return false;
        }
        let unnamed = |power: &dyn Fn(&Column) -> f64| {
            power(&self.after) > (1.0 - LEAST_EXPLAINED) * power(&self.outcome.before)
        };
        self.new_accepted().next().is_none()
            || unnamed(&|residual| self.excess_power(residual))
            || unnamed(&|residual| self.excess_force_n2(residual))
    }

    /// Waves over the stage's position that are neither of the screw nor harmonics of a stronger one.
    ///
    /// Balls have one wavelength. Several without a common origin are the Fourier sum of something that is no
    /// wave.
    fn waves_of_no_origin(&self) -> usize {
        let lead_m = self.outcome.state.problem.drive.screw_lead_m();
        let whole = |ratio: f64| ratio > 0.97 && (ratio / ratio.round() - 1.0).abs() < 0.02;
        let mut origins: Vec<f64> = Vec::new();
        for (_, a) in self.new_accepted().filter(|(_, a)| a.hypothesis.port == Port::Stage) {
            let Shape::Periodic { wavelength_m, .. } = a.hypothesis.shape else { continue };
            let known = lead_m.iter().chain(&origins).any(|o| whole(o / wavelength_m));
            if !known {
                origins.push(wavelength_m);
            }
        }
        origins.len()
    }

    /// Mean square above the floor, all sides and frequencies alike, N2. What stands within twice the floor
    /// counts as the floor. Constants count nothing: a load takes the mean of anything.
    fn excess_force_n2(&self, residual: &Column) -> f64 {
        let floor_n2 = self.floor_rms_n().powi(2);
        let constants: f64 = residual.iter().map(power_of_means).sum();
        let samples: usize = self.outcome.state.problem.lengths().iter().sum();
        let power_n2 = (rms(residual).powi(2) - constants / samples.max(1) as f64).max(0.0);
        if power_n2 > 4.0 * floor_n2 { power_n2 - floor_n2 } else { 0.0 }
    }

    /// Floor of all sides together, N.
    pub(super) fn floor_rms_n(&self) -> f64 {
        self.spectra.iter().map(|s| s.floor_rms_n(f64::MAX).powi(2)).sum::<f64>().sqrt()
    }

    /// Numbers that are not linear in the balance.
    fn further_corrections(&self) -> Vec<Correction> {
        let p = &self.outcome.state.problem;
        let numbers = self.new_accepted().filter(|(_, a)| is_number(a));
        numbers
            .filter_map(|(k, a)| {
                let smoothing = matches!(a.hypothesis.shape, Shape::Smoothing { .. });
                let (name, nominal) = match a.hypothesis.port {
                    _ if smoothing => ("friction_smoothing_m_s", p.mechanics.smoothing_m_s),
                    Port::MotorEncoder => ("motor_encoder_delay_s", p.drive.motor_encoder_delay_s()),
                    Port::StageEncoder => ("stage_encoder_delay_s", p.drive.stage_encoder_delay_s()),
                    _ => ("amplifier_dead_time_s", p.drive.amplifier_dead_time_s()),
                };
                let e = terms::estimates(p, &a.hypothesis, &self.bench.accepted_fit(k)).into_iter().next()?;
                // A delay's estimate is what it has beyond the stated one.
                let from = if smoothing { 0.0 } else { nominal };
                let ends = [from + e.ci95[0].min(e.ci95[1]), from + e.ci95[0].max(e.ci95[1])];
                let (name, value) = (name.into(), (from + e.value).max(0.0));
                Some(Correction { name, nominal, value, ci95: ends })
            })
            .collect()
    }

    fn findings(&self) -> Vec<Finding> {
        self.new_accepted().filter(|(_, a)| !is_number(a)).map(|(k, a)| self.finding(k, a)).collect()
    }

    fn finding(&self, index: usize, accepted: &Accepted) -> Finding {
        let p = &self.outcome.state.problem;
        let fit = self.bench.accepted_fit(index);
        let law =
            (terms::term(p, &accepted.hypothesis, &fit), terms::estimates(p, &accepted.hypothesis, &fit));
        let left_n = [Some(index), None].map(|without| rms(&self.bench.heldout_residual(without)));
        let tried = &self.outcome.rounds[accepted.round];
        let contribution = self.contribution(accepted, &fit);
        Finding { evidence: self.bench.drop_one(index), ..self.named(law, (tried, left_n), contribution) }
    }

    /// A finding in words. `tried`: everything beside it, best first; `left_n`: what is left without and with
    /// it.
    pub(super) fn named(
        &self,
        (term, parameters): (PhysicsTerm, Vec<Estimate>),
        (tried, [before_n, after_n]): (&[Score], [f64; 2]),
        contribution: Vec<Contribution>,
    ) -> Finding {
        let (probability, alternatives) = probabilities(tried);
        let PhysicsTerm { effect, port, .. } = term;
        let floor = self.floor_rms_n();
        Finding {
            rank: 0,
            effect,
            port,
            statement: terms::statement(effect, port, &parameters),
            equation: terms::equation(effect),
            parameters,
            maps: Vec::new(),
            fit: Fit { heldout_rms_before_n: before_n, heldout_rms_after_n: after_n, noise_floor_n: floor },
            probability,
            next_experiment: next_experiment(&alternatives),
            alternatives,
            contribution,
            term,
            evidence: tried.first().map_or(0.0, |s| s.evidence),
        }
    }

    /// What the finding adds, sample by sample of each recording; at the edges, where filters have no data,
    /// held.
    pub(super) fn contribution(&self, accepted: &Accepted, fit: &HypothesisFit) -> Vec<Contribution> {
        let full = self.outcome.state.problem.unthinned();
        let encoder = matches!(accepted.hypothesis.port, Port::MotorEncoder | Port::StageEncoder);
        let series: Vec<Vec<f64>> = if encoder {
            accepted.hypothesis.encoder_series(&full, &fit.amplitudes)
        } else {
            let columns = accepted.hypothesis.columns(&full);
            (0..full.motions.len())
                .map(|r| {
                    let mut sum = vec![0.0; full.motions[r].len()];
                    for (c, a) in columns.iter().zip(&fit.amplitudes) {
                        let at_stage = accepted.hypothesis.port == Port::Stage;
                        let part = if at_stage { &c[r].stage } else { &c[r].motor };
                        if let Some(x) = part {
                            sum.iter_mut().zip(x).for_each(|(s, x)| *s += a * x);
                        }
                    }
                    if accepted.hypothesis.port == Port::Current {
                        sum.iter_mut().for_each(|s| *s /= -full.motions[r].thrust_per_unit);
                    }
                    sum
                })
                .collect()
        };
        self.recordings
            .iter()
            .enumerate()
            .map(|(r, recording)| {
                let (offset, inner) = (full.motions[r].offset, &series[r]);
                let value = (0..recording.len())
                    .map(|k| inner[k.saturating_sub(offset).min(inner.len() - 1)])
                    .collect();
                Contribution {
                    recording: r,
                    t_s: (0..recording.len()).map(|k| recording.time_s(k)).collect(),
                    value,
                }
            })
            .collect()
    }

    fn model(&self, findings: &[Finding], corrections: &[Correction], laws: &[OtherSize]) -> Machine {
        let mut machine = self.machine.clone();
        for axis in machine.axes.iter_mut().filter(|a| a.name == self.axis.name) {
            let changed = !(findings.is_empty() && corrections.is_empty() && laws.is_empty());
            let known = changed.then(|| known_numbers(&self.outcome.state.problem, self.bench));
            let corrected = corrections.iter().map(|c| (&*c.name, c.value));
            if let Ok(drive) = axis.drive.with_numbers(known.into_iter().flatten().chain(corrected)) {
                axis.drive = drive;
            }
            laws.iter().for_each(|law| axis.physics[law.index] = law.term.clone());
            axis.physics.extend(findings.iter().map(|f| f.term.clone()));
        }
        machine
    }

    /// Laws that are not named leave nothing smaller: without a cause the model stays as it was stated.
    fn recording_fits(&self, unexplained: bool) -> Vec<RecordingFit> {
        let p = &self.outcome.state.problem;
        let heldout = (!unexplained).then(|| self.bench.heldout_residual(None));
        // Blocks that cannot tell a number say nothing of the others: then the fit to all of them stands.
        let heldout =
            heldout.map(|h| if rms(&h) < UNTOLD * rms(&self.after) { h } else { self.after.clone() });
        let after = heldout.as_ref().unwrap_or(&self.outcome.before);
        let written = heldout.as_ref().unwrap_or(&self.nominal);
        let sides =
            |c: &Sides| -> Vec<Vec<f64>> { [&c.motor, &c.stage].into_iter().flatten().cloned().collect() };
        (0..p.motions.len())
            .map(|r| {
                let m = &p.motions[r];
                let n = p.thinning.grid(m.len()).count;
                let edge = p.thinning.edge();
                RecordingFit {
                    experiment: m.experiment.clone(),
                    rms_before_n: rms(&self.nominal[r..=r]),
                    rms_after_n: rms(&written[r..=r]),
                    t_s: (0..n).map(|k| m.time_s(edge + k * p.thinning.step)).collect(),
                    position_m: p.thinning.pick(&m.stage.position_m),
                    velocity_m_s: p.thinning.pick(&m.stage.velocity_m_s),
                    residual_nominal_n: sides(&self.nominal[r]),
                    residual_before_n: sides(&self.outcome.before[r]),
                    residual_after_n: sides(&after[r]),
                }
            })
            .collect()
    }
}

/// Sum of squares of the constant part of a recording, N2.
fn power_of_means(sides: &Sides) -> f64 {
    let series = [&sides.motor, &sides.stage].into_iter().flatten();
    series.map(|x| x.iter().sum::<f64>().powi(2) / x.len().max(1) as f64).sum()
}

/// Probability of what a round took up, the first of it, and of the others, from held-out likelihoods.
///
/// exp(gain / 2 / 8): blocks of a residual are not independent; a gain of 16 counts as one step of e. Nothing
/// is likelier than what was taken up once all of them were fitted.
fn probabilities(scores: &[Score]) -> (f64, Vec<Alternative>) {
    let best = scores.first().map_or(0.0, |s| rank(s).max(s.evidence));
    let behind = |s: &Score| ((rank(s) - best) / 16.0).min(0.0).exp();
    let weight = |(k, s): (usize, &Score)| match k {
        0 => 1.0,
        _ if s.plausible => behind(s),
        _ => 0.0,
    };
    let weights: Vec<f64> = scores.iter().enumerate().map(weight).collect();
    let total: f64 = weights.iter().sum::<f64>().max(1e-300);
    let alternatives = scores
        .iter()
        .zip(&weights)
        .skip(1)
        .map(|(s, w)| Alternative {
            effect: s.hypothesis.effect,
            port: s.hypothesis.port,
            probability: w / total,
        })
        .filter(|a| a.probability > 1e-3)
        .collect();
    (weights.first().map_or(0.0, |w| w / total), alternatives)
}

fn next_experiment(alternatives: &[Alternative]) -> Option<String> {
    use EffectKind as E;
    let strongest = alternatives.first().filter(|a| a.probability > 0.05)?;
    let text = match strongest.effect {
        E::GravityLoad | E::AsymmetricFriction => {
            "hold the axis at rest for two seconds at several positions: a load stays, friction's \
             asymmetry does not"
        }
        E::StribeckFriction | E::NonlinearViscosity | E::ViscousFriction => {
            "constant speeds from 0.5 to 50 mm/s in both directions"
        }
        E::PreslidingFriction | E::Backlash => "reversals of 1 to 100 um below 1 mm/s",
        E::DeadTime | E::CurrentLoopLag | E::TorsionalMode => {
            "a sweep up to twice the axial resonance at two amplitudes"
        }
        E::TorqueRipple | E::PositionPeriodicForce | E::PositionDependentForce => {
            "the same slow stroke in both directions at two speeds"
        }
        E::EncoderInterpolationError => {
            "a slow stroke at two speeds, with the signal period's line below the axial resonance"
        }
        E::TorqueConstantSaturation | E::NonlinearStiffness => "accelerations at a third and at full current",
        _ => "the same motion twice, without a cut",
    };
    Some(text.to_owned())
}
