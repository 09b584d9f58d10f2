//! Numbers and laws of the found model, fitted in closed loop.
//!
//! The balance differentiates what was measured, and what an axis at constant speed hardly does, accelerate,
//! it takes from the noise and from the moment of starting: a mass comes out at half of itself. Here the
//! model runs under the recorded command, and its numbers are those with which it says what the drive was
//! told and how the spring was stretched (output error; Ljung, System Identification, 2nd ed., 1999, 7.2).
//! Nothing measured stands among the columns. What the recording cannot tell stays as it was stated.

use super::in_loop::Rig;
use super::problem::{Column, Problem, Sides};
use super::regression::{self, Beside, Folds, Gram};
use super::whitening::{Layout, Whitener};
use crate::plant::drive::DriveParams;
use crate::plant::effects::{ParameterValue, PhysicsTerm};
use crate::plant::machine::AxisModel;
use crate::signal::inner_products::dot;
use std::f64::consts::TAU;
use std::ops::Range;

/// What an identification is good for, as a share: structure, friction, damping.
const STATED: [f64; 3] = [0.05, 0.1, 0.2];
/// Fits one after the other, at most.
const FITS: usize = 3;
/// Length over which errors are loud or quiet, s.
const BLOCK_S: f64 = 0.1;
/// Steps below this many deviations are none.
const STILL: f64 = 0.3;
/// Deviations that the amplitude of a law must stand from zero, and the share of itself that the loop must
/// leave of it: twice the log-likelihood of the search, as a square root.
const LEAST_DEVIATIONS: f64 = 8.0;
const LEAST_LEFT: f64 = 0.4;
/// Encoders of the model that is fitted: its steps would hide small changes.
const FINE_STEP_M: f64 = 1e-14;
/// Constants of laws that are fitted: all that is neither geometry nor a choice of form.
const CONSTANTS: &[&str] = &[
    "phase_rad",
    "wavelength_m",
    "presliding_stiffness_n_m",
    "free_free_frequency_hz",
    "bandwidth_rad_s",
    "share",
];
/// Constants that the effect of a law is proportional to.
const AMPLITUDES: &[&str] = &[
    "amplitude_n",
    "amplitude_m",
    "stribeck_force_n",
    "n_s_m",
    "force_n",
    "n_s2_m2",
    "force_difference_n",
    "gap_m",
    "per_a2",
    "extra_delay_s",
    "relative_variation",
    "cubic_n_m3",
    "relative_change",
];
/// Numbers of the structure that are fitted.
pub(super) const NUMBERS: &[&str] = &[
    "rotary_inertia_kg_m2",
    "movable_mass_kg",
    "axial_stiffness_n_m",
    "motor_coulomb_friction_n",
    "stage_coulomb_friction_n",
    "rotary_damping_nm_s_rad",
    "translational_damping_n_s_m",
    "structural_damping_n_s_m",
];

/// A model fitted in closed loop.
#[derive(Clone)]
pub(super) struct LoopFit {
    /// The model.
    pub(super) axis: AxisModel,
    /// Its numbers: key, value, standard deviation.
    pub(super) numbers: Vec<(&'static str, f64, f64)>,
    /// Terms, by index, of which the loop shows nothing.
    pub(super) pointless: Vec<usize>,
}

/// What is fitted.
pub(super) enum Knob {
    Number(&'static str),
    /// Index of the term, place of the parameter, and the value of an amplitude at the start: its unit.
    Law(usize, usize, Option<f64>),
    /// Index of the term, place of the parameter and of the entry in its list, and the unit.
    Entry(usize, [usize; 2], f64),
}

/// The model with some of its numbers as they were stated.
pub(super) fn with_stated_numbers(stated: &AxisModel, axis: &AxisModel, numbers: &[&str]) -> AxisModel {
    let numbers = numbers.iter().filter_map(|key| Some((*key, stated.drive.number(key)?)));
    let drive = axis.drive.with_numbers(numbers).unwrap_or_else(|_| axis.drive.clone());
    AxisModel { drive, ..axis.clone() }
}

/// How a model is fitted.
#[derive(Clone, Copy)]
pub(super) struct How<'a> {
    /// Weights; `None`: as the errors of the model ask for.
    pub(super) noise: Option<&'a Noise>,
    /// Laws that may be far from their place: orders and lists are fitted as well, and a wave's length moves
    /// as far as the travel lets it be told.
    pub(super) far: bool,
}

/// Laws that stand where a balance put them.
pub(super) const NEAR: How<'static> = How { noise: None, far: false };

/// Fits numbers and laws of `start` from there on; the terms of `stated` stay; `held`: numbers that stay as
/// well. `None`: a model ran away.
pub(super) fn fit(
    rig: &Rig<'_>,
    (stated, held): (&AxisModel, &[&str]),
    start: &AxisModel,
    how: How<'_>,
) -> Option<LoopFit> {
    let mut knobs = knobs(start, stated.physics.len(), how.far);
    knobs.retain(|k| !matches!(k, Knob::Number(key) if held.contains(key)));
    let bed = Bed::new(rig.problem(), how.far);
    let mut next = start.clone();
    let mut best: Option<Fitted> = None;
    let mut fits = 0;
    for _ in 0..2 * FITS {
        let wanted = fits < FITS && best.as_ref().is_none_or(Fitted::moves);
        let mut axes = vec![next.clone()];
        if wanted {
            axes.extend(knobs.iter().map(|k| k.turned(&next, k.change(&next))));
        }
        let fine: Vec<AxisModel> = axes.iter().map(finely_counted).collect();
        let errors = rig.errors(&fine)?;
        if let Some(best) = best.as_mut().filter(|b| bed.loss(&b.noise, &errors[0]) > b.loss) {
            // Too far: half of it.
            best.steps.iter_mut().for_each(|s| *s *= 0.5);
            next = best.moved(&knobs);
            continue;
        }
        if !wanted {
            if let Some(best) = best.as_mut() {
                best.axis = next;
            }
            break;
        }
        let fitted = bed.fit(&knobs, (next, stated), &errors, how.noise);
        fits += 1;
        next = fitted.moved(&knobs);
        best = Some(fitted);
    }
    let best = best?;
    let numbers = knobs.iter().zip(&best.deviations).filter_map(|(knob, deviation)| match knob {
        Knob::Number(key) => {
            let value = best.axis.drive.number(key)?;
            Some((*key, value, value * deviation))
        }
        _ => None,
    });
    let lost = knobs.iter().zip(&best.deviations).filter_map(|(knob, deviation)| match knob {
        Knob::Law(term, place, Some(unit)) => {
            let left = value(&best.axis.physics[*term], *place)? / unit;
            (left < LEAST_LEFT.max(LEAST_DEVIATIONS * deviation)).then_some(*term)
        }
        _ => None,
    });
    let mut pointless: Vec<usize> = lost.collect();
    pointless.dedup();
    Some(LoopFit { numbers: numbers.collect(), pointless, axis: best.axis })
}

/// A model, the weights that its errors ask for, and where they point.
struct Fitted {
    axis: AxisModel,
    noise: Noise,
    loss: f64,
    steps: Vec<f64>,
    deviations: Vec<f64>,
}

impl Fitted {
    /// True where another fit would change something.
    fn moves(&self) -> bool {
        self.steps.iter().zip(&self.deviations).any(|(s, d)| s.abs() > STILL * d.max(1e-4))
    }

    fn moved(&self, knobs: &[Knob]) -> AxisModel {
        knobs.iter().zip(&self.steps).fold(self.axis.clone(), |axis, (knob, step)| knob.turned(&axis, *step))
    }
}

/// How errors are weighted: whitened by the quiet half of the time, and where they are louder than that,
/// by how loud they are. A start from rest is said less well than noise would allow, and what hangs on it
/// alone is less sure.
#[derive(Clone)]
pub(super) struct Noise {
    whitener: Whitener,
    /// Factor of each whitened value.
    factors: Vec<f64>,
}

impl Noise {
    /// Weights thrust and stretch by one over a scale each.
    pub(super) fn of_scales(bed: &Bed, scales: [f64; 2]) -> Self {
        Self { whitener: Whitener::of_scales(scales), factors: vec![1.0; bed.layout.total()] }
    }
}

/// What stays the same from fit to fit.
pub(super) struct Bed {
    layout: Layout,
    folds: Folds,
    rate_hz: f64,
    /// Stretch at which the spring is free: the encoders have no common zero, lead and scale differ.
    free: Vec<Column>,
    /// Travel of the recordings, m, where laws may be far from their place.
    span_m: Option<f64>,
}

impl Bed {
    pub(super) fn new(p: &Problem, far: bool) -> Self {
        let lengths = p.lengths();
        let layout = p.layout();
        let of = |at: usize| -> Column {
            let one = |(k, n): (usize, &usize)| Sides {
                motor: None,
                stage: (k == at).then(|| vec![p.mechanics.stiffness_n_m * 1e-6; *n]),
            };
            lengths.iter().enumerate().map(one).collect()
        };
        let mut free: Vec<Column> = (0..lengths.len()).map(of).collect();
        free.push(p.column(|m| Sides {
            motor: None,
            stage: Some(m.stage.position_m.iter().map(|x| (x - m.centre_m) * 1e3).collect()),
        }));
        let folds = Folds::new(&layout, p.rate_hz());
        Self { folds, rate_hz: p.rate_hz(), layout, free, span_m: far.then(|| super::terms::travel_m(p)) }
    }

    pub(super) fn folds(&self) -> &Folds {
        &self.folds
    }

    /// Values of both sides in all recordings.
    pub(super) fn samples(&self) -> usize {
        self.layout.total()
    }

    fn noise(&self, errors: &Column) -> Noise {
        let whitener = Whitener::fit(errors, &self.layout, self.rate_hz);
        let mut noise = Noise { whitener, factors: vec![1.0; self.layout.total()] };
        let (columns, target) = (self.weighed(&noise, &[]), self.weigh(&noise, errors));
        let free = self.gram(&columns, &target, Vec::new()).solve(&all(columns.len()));
        let left = regression::left(target, &columns, &free.coefficients);
        let block = ((BLOCK_S * self.rate_hz) as usize).max(1);
        let mut blocks = Vec::new();
        for (recording, n) in self.layout.lengths.iter().enumerate() {
            for first in (0..*n).step_by(block) {
                let ranges = [0, 1].map(|side| {
                    let start = self.layout.start(recording, side);
                    start + first..start + (first + block).min(*n)
                });
                let power = |r: &Range<usize>| dot(&left[r.clone()], &left[r.clone()]) / r.len() as f64;
                blocks.push((ranges.iter().map(power).sum::<f64>(), ranges));
            }
        }
        let mut powers: Vec<f64> = blocks.iter().map(|b| b.0).collect();
        powers.sort_by(f64::total_cmp);
        let usual = powers.get(powers.len() / 2).copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
        for (power, ranges) in blocks {
            let factor = (usual / power.max(usual)).sqrt();
            ranges.into_iter().for_each(|r| noise.factors[r].fill(factor));
        }
        noise
    }

    pub(super) fn weigh(&self, noise: &Noise, column: &Column) -> Vec<f64> {
        let mut z = noise.whitener.whiten(column, &self.layout);
        z.iter_mut().zip(&noise.factors).for_each(|(z, f)| *z *= f);
        z
    }

    /// Columns and those of the free stretch.
    pub(super) fn weighed(&self, noise: &Noise, columns: &[Column]) -> Vec<Vec<f64>> {
        columns.iter().chain(&self.free).map(|c| self.weigh(noise, c)).collect()
    }

    pub(super) fn gram(&self, columns: &[Vec<f64>], target: &[f64], known: Vec<[f64; 2]>) -> Gram {
        let beside = Beside { known, instants: self.folds.instants(), ..Beside::default() };
        Gram::new(columns, target, &self.folds).beside(beside)
    }

    /// Sum of squares that errors leave, free stretch apart.
    pub(super) fn loss(&self, noise: &Noise, errors: &Column) -> f64 {
        let columns = self.weighed(noise, &[]);
        self.gram(&columns, &self.weigh(noise, errors), Vec::new()).solve(&all(columns.len())).left
    }

    /// One Gauss-Newton step. `errors`: of the model, then with each knob turned.
    fn fit(
        &self,
        knobs: &[Knob],
        (axis, stated): (AxisModel, &AxisModel),
        errors: &[Column],
        noise: Option<&Noise>,
    ) -> Fitted {
        let now = &errors[0];
        let noise = noise.cloned().unwrap_or_else(|| self.noise(now));
        let slopes = slopes(knobs, &axis, errors);
        let known = knobs.iter().map(|knob| knob.known(stated, &axis)).collect();
        let columns = self.weighed(&noise, &slopes);
        let gram = self.gram(&columns, &self.weigh(&noise, now), known);
        let used = all(columns.len());
        let (solution, loss) = (gram.solve(&used), gram.solve(&used[knobs.len()..]).left);
        let steps = knobs.iter().zip(&solution.coefficients).map(|(knob, s)| {
            let trust = knob.trust(&axis, self);
            s.clamp(-trust, trust)
        });
        let steps = steps.collect();
        Fitted { axis, noise, loss, steps, deviations: solution.deviations[..knobs.len()].to_vec() }
    }
}

/// What each knob changes of the errors. `errors`: of the model, then with each knob turned.
pub(super) fn slopes(knobs: &[Knob], axis: &AxisModel, errors: &[Column]) -> Vec<Column> {
    let (now, turned) = (&errors[0], &errors[1..]);
    let of = |(turned, knob): (&Column, &Knob)| {
        let change = knob.change(axis);
        let mut slope = now.clone();
        super::bench::add(&mut slope, turned, -1.0);
        for s in slope.iter_mut().flat_map(|s| [&mut s.motor, &mut s.stage]).flatten() {
            s.iter_mut().for_each(|x| *x /= change);
        }
        slope
    };
    turned.iter().zip(knobs).map(of).collect()
}

impl Knob {
    /// The model with this one turned: a factor exp(step); a phase by the step, an amplitude by so much of
    /// its unit.
    pub(super) fn turned(&self, axis: &AxisModel, step: f64) -> AxisModel {
        let mut axis = axis.clone();
        match self {
            Self::Number(key) => {
                let turned = axis.drive.number(key).map(|value| (*key, value * step.exp()));
                axis.drive = axis.drive.with_numbers(turned).unwrap_or(axis.drive);
            }
            Self::Law(term, place, unit) => {
                let (name, value) = &mut axis.physics[*term].parameters[*place];
                if let ParameterValue::Number(x) = value {
                    *x = match unit {
                        Some(unit) => *x + step * unit,
                        None if name == "phase_rad" => *x + step,
                        None => *x * step.exp(),
                    };
                }
            }
            Self::Entry(term, [place, entry], unit) => {
                if let ParameterValue::List(list) = &mut axis.physics[*term].parameters[*place].1 {
                    list[*entry] += step * unit;
                }
            }
        }
        axis
    }

    /// Length of the wave whose length or order this is, m.
    fn wavelength_m(&self, axis: &AxisModel) -> Option<f64> {
        let Self::Law(term, place, _) = self else { return None };
        let x = value(&axis.physics[*term], *place)?;
        match axis.physics[*term].parameters[*place].0.as_str() {
            "wavelength_m" => Some(x),
            "order_per_rev" => Some(axis.drive.screw_lead_m()? / x),
            _ => None,
        }
    }

    /// Change from which a derivative is taken.
    pub(super) fn change(&self, axis: &AxisModel) -> f64 {
        if self.wavelength_m(axis).is_some() { 1e-4 } else { 5e-3 }
    }

    /// Longest step: of a wave's length so much that it moves by a radian over the travel.
    pub(super) fn trust(&self, axis: &AxisModel, bed: &Bed) -> f64 {
        match (self, self.wavelength_m(axis)) {
            (Self::Law(_, _, Some(_)) | Self::Entry(..), _) => 1.0,
            (_, Some(length_m)) => bed.span_m.map_or(2e-3, |span_m| (length_m / (TAU * span_m)).min(0.05)),
            _ => 0.2,
        }
    }

    /// Precision and value of the step before anything is measured.
    pub(super) fn known(&self, stated: &AxisModel, axis: &AxisModel) -> [f64; 2] {
        let Self::Number(key) = self else { return [1.0, 0.0] };
        let [structure, friction, damping] = STATED;
        let share = if key.contains("damping") {
            damping
        } else if key.contains("coulomb") {
            friction
        } else {
            structure
        };
        let apart = stated.drive.number(key).zip(axis.drive.number(key)).map_or(0.0, |(s, a)| (s / a).ln());
        [share.powi(-2), apart]
    }
}

fn all(columns: usize) -> Vec<usize> {
    (0..columns).collect()
}

fn value(term: &PhysicsTerm, place: usize) -> Option<f64> {
    match term.parameters.get(place)?.1 {
        ParameterValue::Number(x) => Some(x),
        ParameterValue::List(_) => None,
    }
}

/// What of a model is fitted; `far`: as in [`How`].
pub(super) fn knobs(axis: &AxisModel, given: usize, far: bool) -> Vec<Knob> {
    let has = |key: &&str| axis.drive.number(key).is_some_and(|x| x > 0.0);
    let mut knobs: Vec<Knob> = NUMBERS.iter().copied().filter(|k| has(k)).map(Knob::Number).collect();
    for (k, term) in axis.physics.iter().enumerate().skip(given) {
        if !far && term.parameters.iter().any(|(_, v)| matches!(v, ParameterValue::List(_))) {
            continue;
        }
        // Where a list says the form, the amplitude and the phase beside it are only read.
        let listed = term.parameters.iter().any(|(_, v)| matches!(v, ParameterValue::List(_)));
        for (j, (name, value_or_list)) in term.parameters.iter().enumerate() {
            if let ParameterValue::List(list) = value_or_list {
                let unit = list.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
                knobs.extend((0..list.len()).map(|entry| Knob::Entry(k, [j, entry], unit)));
            }
            if listed && matches!(name.as_str(), "amplitude_n" | "amplitude_m" | "phase_rad") {
                continue;
            }
            let Some(x) = value(term, j).filter(|x| *x != 0.0) else { continue };
            if AMPLITUDES.contains(&name.as_str()) {
                knobs.push(Knob::Law(k, j, Some(x)));
            } else if CONSTANTS.contains(&name.as_str()) || (far && name == "order_per_rev") {
                knobs.push(Knob::Law(k, j, None));
            }
        }
    }
    knobs
}

/// The axis with encoders that count finely.
pub(super) fn finely_counted(axis: &AxisModel) -> AxisModel {
    let mut axis = axis.clone();
    let mut raw = axis.drive.raw().clone();
    raw.motor_encoder_resolution_m = Some(FINE_STEP_M);
    raw.stage_encoder_resolution_m = Some(FINE_STEP_M);
    if let Ok(drive) = DriveParams::new(raw) {
        axis.drive = drive;
    }
    axis
}
